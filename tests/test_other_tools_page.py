"""The blocks of the pages "With other tools" and "phonopy" run as they stand there, each by itself."""

import json
import re
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest

PAGES = [Path(__file__).parents[1] / f'docs/reference/{name}.md' for name in ('other_tools', 'phonopy')]
BLOCKS = [block for page in PAGES for block in re.findall(r'```python\n(.*?)```', page.read_text(encoding='utf-8'), re.S)]
OTHERS = 'janus_core', 'matcalc', 'pymatgen', 'euphonic'  # not on every machine
AT = [[0, 0, 0], [0.5, 0, 0]]  # Gamma and M


def run(block):
    """The names that a block leaves behind, which begins with none."""
    exec(compile(block, 'a block of the page', 'exec'), names := {})
    return names


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """One with the files that some blocks read."""
    matplotlib.use('Agg')
    monkeypatch.chdir(tmp_path)
    [writes] = [block for block in BLOCKS if 'write_phonopy_params(' in block]
    run(writes)
    yield tmp_path
    plt.close('all')


@pytest.mark.slow
def test_the_blocks_run(folder):
    found = {}
    for block in BLOCKS:
        if not any(name in block for name in OTHERS):
            names = run(block)
            if 'phonon' in names:  # on both pages
                np.testing.assert_allclose(names['phonon'].run_qpoints(AT).frequencies[:, -2:],
                                           [[26.5507, 26.5507], [58.2327, 149.4763]], rtol=2e-6)
            found |= names
    np.testing.assert_allclose(found['found']['standard'], [[26.55, 26.55], [58.23, 149.48]], atol=0.005)
    np.testing.assert_allclose(found['found']['Frederiksen'], [[0, 0], [51.83, 147.10]], atol=0.02)  # as the page says
    assert (found['again'].get_potential_energy(), found['ax'].get_ylabel()) == (0.0, 'frequency (Hz)')
    assert all((folder / file).stat().st_size > 1000 for file in ('patch.data', 'patch.cif', 'POSCAR', 'patch.xyz'))


@pytest.mark.peer
@pytest.mark.filterwarnings('ignore')  # of the other programs
@pytest.mark.parametrize('other', OTHERS)
def test_the_block_of_another_program_runs(other, folder):
    pytest.importorskip(other)
    [names] = [run(block) for block in BLOCKS if other in block]
    if 'phonon' in names:
        np.testing.assert_allclose(names['phonon'].run_qpoints(AT).frequencies[:, -2:],
                                   [[26.5507, 26.5507], [58.2327, 149.4763]], rtol=2e-6)
    if other == 'pymatgen':
        assert json.loads((folder / 'phononwebsite.json').read_text())['natoms'] == 1
        assert names['symmetry_lines'].bands.max() == pytest.approx(149.4763, rel=2e-6)
    if other == 'euphonic':
        assert (names['modes'].frequencies / names['ureg']('planck_constant')).to('THz').magnitude[0, 1:] == pytest.approx(
            [58.2327, 149.4763], rel=2e-6)
