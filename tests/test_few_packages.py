"""What compiled packages add can be missing: bands, checks, fits and the explorer work without them."""

import subprocess
import sys

import pytest

HIDDEN = 'phonopy', 'spglib', 'numba', 'joblib', 'xarray', 'h5py'
RUN = f'''
import sys
sys.modules.update(dict.fromkeys({HIDDEN}))  # to import one of them fails
from magphonon.cli.main import main
'''
BANDS = '''
from magphonon import InversePower, MagneticRepulsion, analytic_bands, finite_displacements, lattices, units as u
cell = lattices.triangular(10.0, 0.707)
cell.calc = MagneticRepulsion(cell, InversePower(1.6209e-10 * u.N * u.m**4.5824, 4.5824), foundation=19.6757 * u.N / u.m)
print(f"{analytic_bands(cell, 'GMKG').frequencies_Hz.max():.4f} Hz")
try:
    finite_displacements(cell)
except ModuleNotFoundError as error:
    print(error)
'''


def told(code, folder):
    run = subprocess.run([sys.executable, '-W', 'error', '-c', RUN + code], cwd=folder, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_bands_are_computed(tmp_path):
    out = told(BANDS, tmp_path)
    assert '155.0505 Hz' not in out  # that of D0 alone
    assert '149.4763 Hz' in out
    assert 'finite_displacements needs phonopy, which is not installed: pip install phonopy' in out


@pytest.mark.slow
@pytest.mark.parametrize(('command', 'words'), [
    (['bands', '--verbose', 'prototype'], ['58.23269        92.106\n', 'phonopy is not installed', 'Stable in the plane']),
    (['check', '--verbose', 'prototype'], ['highest frequency of 149.5 Hz']),
    (['fit', 'synthetic_force', '--spacing', '10mm'], ['[law]']),
    (['explore', 'prototype', '-o', 'page.html'], ['page.html is written'])])
def test_commands_run(command, words, tmp_path):
    out = told(f'assert main({command}) == 0', tmp_path)
    assert not [missing for missing in words if missing not in out]
