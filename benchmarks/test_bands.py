"""Cost of a band diagram by each method, and of a mesh of the zone: `pytest benchmarks`, OMP_NUM_THREADS=1 for steady numbers.

In the group 'bands, 300 points', the number in brackets behind phonopy's median is how many times faster the analytic method is.
Targets: analytic bands under 2 ms and 100 times faster than phonopy's; the mesh under 0.2 s.
"""

import numpy as np
import pytest

from magphonon import InversePower, MagneticRepulsion, analytic_bands, finite_displacements, lattices, phonopy_bands, units as u
from magphonon.bands.bloch import bloch_modes

LAW = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)


def prototype(lattice):
    """The paper's magnets and pillars in a cell of any lattice."""
    cell = lattice(10 * u.mm, 0.707 * u.g)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=19.6757 * u.N / u.m)
    return cell


@pytest.fixture(scope='module')
def triangular():
    """The prototype and its path."""
    cell = prototype(lattices.triangular)
    return cell, cell.cell.bandpath('GMKG', npoints=300, pbc=cell.pbc)


@pytest.mark.benchmark(group='bands, 300 points')
def test_analytic(benchmark, triangular):
    """From the Bloch matrix."""
    bands = benchmark(analytic_bands, *triangular)
    assert bands.omega.shape == (300, 2)


@pytest.mark.benchmark(group='bands, 300 points')
@pytest.mark.parametrize('cells', [3, 10])  # the smallest supercell for nearest neighbours, and one for a long-ranged law
def test_phonopy(benchmark, triangular, cells):
    """Displacements, forces, force constants and bands; phonopy's search for symmetries is off."""
    cell, path = triangular
    bands = benchmark(lambda: phonopy_bands(finite_displacements(cell, supercell=(cells, cells, 1)), path))
    analytic = analytic_bands(cell, path)
    assert abs(bands.omega - analytic.omega).max() < 1e-8 * analytic.omega.max()  # the same answer, at another price


@pytest.mark.benchmark(group='mesh, 10 000 wavevectors, two particles')
def test_mesh(benchmark):
    """Frequencies of a honeycomb lattice over its zone."""
    axis = np.arange(100) / 100
    q = np.stack(np.meshgrid(axis, axis, 0), axis=-1).reshape(-1, 3)
    omega, _ = benchmark(bloch_modes, prototype(lattices.honeycomb), q)
    assert omega.shape == (10_000, 4)
