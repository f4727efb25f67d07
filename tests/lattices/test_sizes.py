"""What would need more memory than is free is refused before it is built, with the number; the number is what building takes."""

import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
from ase import Atoms
from structures import few_first

from magphonon import InversePower, frequency_response, lattices, modes, propagate
from magphonon.lattices import bonds, find_bonds, patches
from magphonon.lattices.bonds import bonds_within
from magphonon.response import natural_frequencies
from magphonon.stiffness import PairCalculator

TRIANGULAR = lattices.triangular(1.0, 1.0)


@pytest.mark.parametrize('build', [
    lambda: lattices.parallelogram(TRIANGULAR, 40_000, 25_000), lambda: lattices.rectangle(TRIANGULAR, 1e5, 1e5),
    lambda: lattices.hexagon(TRIANGULAR, 1e200), lambda: lattices.ribbon(TRIANGULAR, 10**9),
    lambda: find_bonds(TRIANGULAR, cutoff=1e4), lambda: find_bonds(lattices.chain(1.0, 1.0), cutoff=1e9 + 0.1),
    lambda: find_bonds(lattices.parallelogram(TRIANGULAR, 300, 300), cutoff=400.3),
    lambda: find_bonds(lattices.fcc(1.0, 1.0), cutoff=500.1)])
def test_what_no_memory_holds_is_refused_at_once(build):
    tracemalloc.start()
    with pytest.raises(ValueError, match=r'would take about .* GB of memory, and .* GB are free; '):
        build()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3e7


@pytest.mark.parametrize('build', [
    lambda patch: propagate(patch, np.arange(1e6)), lambda patch: frequency_response(
        patch, np.ones((len(patch), 3)) * [1, 0, 0], np.linspace(1, 2, 10**6), 0.1)], ids=['motion', 'response'])
def test_a_long_record_of_many_particles_is_refused(build, monkeypatch):
    monkeypatch.setattr('psutil.virtual_memory', lambda: SimpleNamespace(available=2**30))
    patch = lattices.parallelogram(TRIANGULAR, 12, 12)
    patch.calc = PairCalculator(patch, InversePower(1.0, 4.0), foundation=1.0)
    with pytest.raises(ValueError, match=r'would take about .* GB of memory, and 1.07 GB are free; ask for fewer'):
        build(patch)


@pytest.mark.parametrize('seed', few_first(range(4), 0))
def test_the_memory_that_is_asked_for_is_what_it_takes(seed, monkeypatch):
    """Traced while it is built: within a factor of two, of drawn patches, cells and clouds."""
    rng, asked = np.random.default_rng(seed), []
    for module in (bonds, patches):
        monkeypatch.setattr(module, 'refuse_memory', lambda what, needed, mend: asked.append(needed))
    cell = [lattices.square, lattices.triangular, lattices.honeycomb, lattices.kagome][seed % 4](1.0, 1.0)
    cloud = Atoms('H1000', rng.uniform(0, [40, 40, rng.choice([0, 1, 40])], (1000, 3)))
    big, patch = rng.uniform(40, 70), lattices.hexagon(cell, 9.0)
    for build in (lambda: lattices.hexagon(cell, big), lambda: lattices.parallelogram(cell, 200, int(big)),
                  lambda: lattices.ribbon(cell, 10_000), lambda: bonds_within(cloud, rng.uniform(5, 12)),
                  lambda: bonds_within(patch, rng.uniform(5, 40)), lambda: bonds_within(cell, rng.uniform(30, 40)),
                  lambda: bonds_within(lattices.bcc(1.0, 1.0), rng.uniform(6, 9))):
        build()
        asked.clear()
        tracemalloc.start()
        build()
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert max(asked) / 2 < peak < 2 * max(asked)


def test_all_modes_of_many_particles_are_refused():
    patch = lattices.parallelogram(lattices.square(1.0, 1.0), 180, 180)
    patch.calc = PairCalculator(patch, InversePower(1.0, 4.0), foundation=5.0)
    for ask in (natural_frequencies, modes):
        with pytest.raises(ValueError, match=r'all 63368 modes would take about 1\d\d GB'):
            ask(patch)
    patch.calc.set(gyration=0.5)
    with pytest.raises(ValueError, match=r'all 63368 modes would take about 5\d\d GB.*take a smaller structure'):
        natural_frequencies(patch)
