"""The paper's two systems and its numbers."""

import os
import tempfile
import tomllib
from importlib.resources import files
from pathlib import Path

os.environ.setdefault('OMP_NUM_THREADS', '1')  # before numpy is loaded: on small matrices threads of OpenBLAS only wait

import hypothesis
import pytest

from magphonon import InversePower, MagneticRepulsion, lattices, units as u

hypothesis.settings.register_profile('everywhere', derandomize=True, database=None, deadline=None,
                                     suppress_health_check=[hypothesis.HealthCheck.too_slow])
hypothesis.settings.load_profile('everywhere')  # the same draws in every run, on a busy machine too

# numba's cache gives two processes that compile at once the same file name: each worker has a cache of its own
if 'PYTEST_XDIST_WORKER' in os.environ:
    os.environ['NUMBA_CACHE_DIR'] = str(Path(tempfile.gettempdir(), f'magphonon-numba-{os.environ["PYTEST_XDIST_WORKER"]}'))

COMPILED = 'tests/dynamics/'  # where most steps are compiled, which takes a minute


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """One worker runs all tests of compiled steps, since each would compile them again; any worker runs any other test."""
    from xdist.scheduler import LoadScopeScheduling

    class Scheduling(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return 'compiled steps' if nodeid.startswith(COMPILED) else nodeid

    return Scheduling(config, log)


def pytest_collection_modifyitems(items):
    """Slow tests draw numbers that no bench has, and mean them; `test_plausibility` decides which numbers are doubted."""
    for item in items:
        if item.get_closest_marker('slow') and item.path.name != 'test_plausibility.py':
            item.add_marker(pytest.mark.filterwarnings('ignore::magphonon.stiffness.plausibility.UnitWarning'), append=False)


PAPER = tomllib.loads(files('magphonon.data').joinpath('reference.toml').read_text(encoding='utf-8'))


@pytest.fixture(scope='session')
def paper():
    """Numbers of arXiv:1911.10410 in SI, stated there or recomputed in 50-digit arithmetic from its formulas."""
    return PAPER


@pytest.fixture
def ideal():
    """The paper's ideal law and lattice (Secs. III and IV): f = 1e4 N m^4 r^-4, 1 m, 1 kg."""
    law = InversePower(b=1e4 * u.N * u.m**4, a=4.0)
    cell = lattices.triangular(1 * u.m, 1 * u.kg)
    cell.calc = MagneticRepulsion(cell, law)
    return cell


@pytest.fixture
def prototype():
    """The paper's prototype (Supplement): magnets on pillars."""
    p = PAPER['prototype']
    law = InversePower(b=p['b'] * u.N * u.m ** p['a'], a=p['a'])
    cell = lattices.triangular(p['spacing'] * u.m, p['mass'] * u.kg)
    cell.calc = MagneticRepulsion(cell, law, foundation=p['k_eq'] * u.N / u.m)
    return cell
