"""The blocks of the page "With other tools" run in their order, as they stand there."""

import json
import re
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest

PAGE = Path(__file__).parents[1] / 'docs/reference/other_tools.md'
BLOCKS = re.findall(r'```python\n(.*?)```', PAGE.read_text(encoding='utf-8'), re.S)
OTHERS = 'janus_core', 'matcalc', 'pymatgen', 'euphonic'  # not on every machine


@pytest.mark.filterwarnings('ignore')  # of the other programs
@pytest.mark.parametrize('other', [None, *(pytest.param(name, marks=pytest.mark.peer) for name in OTHERS)])
def test_the_blocks_run(other, tmp_path, monkeypatch):
    """Those without other programs, or with one of them."""
    monkeypatch.chdir(tmp_path)
    if other:
        pytest.importorskip(other)
    matplotlib.use('Agg')
    names = {}
    for block in BLOCKS:
        if not any(name in block for name in OTHERS if name != other):
            exec(compile(block, str(PAGE), 'exec'), names)
            if other and other in block and 'phonon' in names:
                found = names['phonon'].run_qpoints([[0, 0, 0], [0.5, 0, 0]]).frequencies
                np.testing.assert_allclose(found[:, -2:], [[26.5507, 26.5507], [58.2327, 149.4763]], rtol=2e-6)
    plt.close('all')
    np.testing.assert_allclose(names['at_M'], [58.2327, 149.4763], rtol=2e-6)
    np.testing.assert_allclose(names['found']['standard'], [[26.55, 26.55], [58.23, 149.48]], atol=0.005)
    np.testing.assert_allclose(names['found']['Frederiksen'], [[0, 0], [51.83, 147.10]], atol=0.02)  # as the page says
    assert (names['again'].get_potential_energy(), names['ax'].get_ylabel()) == (0.0, 'frequency (Hz)')
    assert all(Path(file).stat().st_size > 1000 for file in ('patch.data', 'patch.cif', 'POSCAR', 'patch.xyz'))
    if other == 'pymatgen':
        assert json.loads(Path('phononwebsite.json').read_text())['natoms'] == 1
        assert names['symmetry_lines'].bands.max() == pytest.approx(149.4763, rel=2e-6)
    if other == 'euphonic':
        assert (names['modes'].frequencies / names['ureg']('planck_constant')).to('THz').magnitude[0, 1:] == pytest.approx(
            [58.2327, 149.4763], rel=2e-6)
