"""Cells that change: energy, forces and stress follow them without an anchor; ASE's filters find the lattice under a pressure."""

import numpy as np
import pytest
from ase.calculators.calculator import PropertyNotImplementedError
from ase.calculators.fd import calculate_numerical_stress
from ase.filters import FrechetCellFilter, StrainFilter
from ase.optimize import BFGS
from cells import cauchy_stress
from oracles import LAWS, lattice
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices, modes

LAW = InversePower(b=4000.0, a=4.5824)
PLANE, LINE = (1, 1, 0, 0, 0, 1), (1, 0, 0, 0, 0, 0)


class Spring:
    """A law with a rest length: a lattice that needs no pressure."""

    def phi(self, r):
        return (r - 10) ** 2 / 2

    def dphi(self, r):
        return r - 10.0

    def d2phi(self, r):
        return 1 + 0 * r


def deformed(atoms, seed, size=0.05):
    """A copy whose periodic directions are strained and turned at random."""
    dim, rng = atoms.calc.dim, np.random.default_rng(seed)
    F = np.eye(3)
    F[:dim, :dim] += rng.uniform(-size, size, (dim, dim))
    other = atoms.copy()
    other.calc = atoms.calc
    other.set_cell(np.where(atoms.pbc[:, None], atoms.cell.array @ F, atoms.cell.array), scale_atoms=True)
    return other


def rattled(name, shells):
    """A cell repeated and displaced by 3 %, so that no force vanishes."""
    rest = lattice(name).repeat(np.where(lattice(name).pbc, 2, 1))
    atoms = rest.copy()
    atoms.calc = MagneticRepulsion(rest, LAW, shells=shells)
    atoms.positions[:, : atoms.calc.dim] += np.random.default_rng(3).uniform(-0.3, 0.3, (len(atoms), atoms.calc.dim))
    return atoms


@pytest.mark.parametrize(('name', 'shells'), [('triangular', 3), ('honeycomb', 2), ('fcc', 2)])
def test_stress_is_the_slope_of_the_energy_by_the_cell(name, shells):
    atoms = deformed(rattled(name, shells), 1)
    stress = atoms.get_stress()
    numerical = calculate_numerical_stress(atoms, eps=1e-5) if atoms.calc.dim == 3 else planar_slope(atoms, 1e-5)
    # 1e-8: the square of the step times higher derivatives, and the round-off of the energy over the step
    np.testing.assert_allclose(stress, numerical, rtol=0, atol=1e-8 * abs(stress).max())
    # the control: the virial of the forces on the particles, without that of the cell, is no stress
    virial = -np.einsum('ix,iy->xy', atoms.get_forces(), atoms.positions) / atoms.get_volume()
    assert abs(virial - atoms.get_stress(voigt=False)).max() > 0.1 * abs(stress).max()


def planar_slope(atoms, step):
    """Slope of the energy by the strain over the volume, in Voigt's order; zero out of the plane."""
    found = np.zeros(6)
    for k, (i, j) in {0: (0, 0), 1: (1, 1), 5: (0, 1)}.items():
        ends = []
        for sign in (1, -1):
            e = np.eye(3)
            e[i, j] += sign * step / 2
            e[j, i] += sign * step / 2
            other = atoms.copy()
            other.calc = atoms.calc
            other.set_cell(atoms.cell.array @ e, scale_atoms=True)
            ends.append(other.get_potential_energy())
        found[k] = (ends[0] - ends[1]) / (2 * step) / atoms.get_volume()
    return found


@pytest.mark.parametrize('name', ['chain', 'honeycomb', 'bcc'])
def test_a_scaled_cell_is_that_of_a_new_calculator(name):
    atoms = lattice(name)
    atoms.calc = MagneticRepulsion(atoms, LAW, shells=2)
    wide = lattice(name, spacing=11.0)
    wide.calc = MagneticRepulsion(wide, LAW, shells=2)
    atoms.set_cell(np.where(atoms.pbc[:, None], wide.cell, atoms.cell), scale_atoms=True)
    difference = LAW.phi(wide.calc.bonds.lengths) - LAW.phi(wide.calc.bonds.lengths / 1.1)
    assert atoms.get_potential_energy() == pytest.approx(difference.sum(), rel=1e-12)
    np.testing.assert_allclose(cauchy_stress(atoms), cauchy_stress(wide), rtol=1e-12, atol=1e-14)
    path = wide.cell.bandpath(npoints=5, pbc=wide.pbc)
    np.testing.assert_allclose(analytic_bands(atoms, path).omega, analytic_bands(wide, path).omega, rtol=0, atol=1e-9)


def test_where_particles_stand_is_counted_modulo_the_new_periods():
    atoms = deformed(rattled('triangular', 2), 2, 0.2)
    energy, forces, stress = atoms.get_potential_energy(), atoms.get_forces(), atoms.get_stress()
    atoms.positions += atoms.cell.array[0] * np.array([0, 1, -1, 2])[:, None]
    assert atoms.get_potential_energy() == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(atoms.get_forces(), forces, rtol=0, atol=1e-12 * abs(forces).max())
    np.testing.assert_allclose(atoms.get_stress(), stress, rtol=0, atol=1e-12 * abs(stress).max())


def relax(filtered, fmax):
    with BFGS(filtered, logfile=None) as optimizer:
        assert optimizer.run(fmax=fmax, steps=300)


@pytest.mark.parametrize('seed', few_first(range(2), 1))
def test_a_planar_lattice_under_a_pressure(seed):
    pressure = np.random.default_rng(seed).uniform(0.02, 0.08)  # N/mm, between those of spacings of 8 and 13 mm
    cell = lattices.triangular(10.0, 0.7)
    cell.calc = MagneticRepulsion(cell, LAW)
    atoms = deformed(cell, seed, 0.1)
    height = atoms.cell[2, 2]
    relax(FrechetCellFilter(atoms, mask=PLANE, scalar_pressure=pressure / height), 1e-9)
    spacing = (np.sqrt(3) * LAW.b / pressure) ** (1 / (LAW.a + 1))  # p = sqrt(3) f/L
    a, b = atoms.cell.array[:2]
    np.testing.assert_allclose([np.linalg.norm(v) for v in (a, b, a - b)], spacing, rtol=1e-6)
    np.testing.assert_allclose(cauchy_stress(atoms), -pressure * np.eye(2), rtol=0, atol=1e-6 * pressure)
    # the linear theory goes on from there: bands of a lattice of that spacing
    fresh = lattices.triangular(spacing, 0.7)
    fresh.calc = MagneticRepulsion(fresh, LAW)
    M = analytic_bands(fresh, fresh.cell.bandpath('M', npoints=1, pbc=fresh.pbc)).omega
    np.testing.assert_allclose(modes_at(atoms, (a, b)), M[0], rtol=1e-5)
    # the control: a pressure per area of the plane taken for one per area of the cell's wall
    relax(FrechetCellFilter(atoms, mask=PLANE, scalar_pressure=pressure), 1e-9)
    assert abs(np.linalg.norm(atoms.cell[0]) / spacing - 1) > 0.1


def modes_at(atoms, vectors):
    """Frequencies of the wave that is opposite in neighbouring rows, from a supercell of two of them."""
    pair = atoms.repeat((1, 2, 1))
    pair.calc = atoms.calc.about(atoms).on(pair)
    return modes(pair).omega[2:]


def test_strain_filter_of_a_crystal_and_a_chain():
    for name, mask, fmax in (('fcc', None, 1e-8), ('chain', LINE, 1e-8)):
        atoms = lattice(name, spacing=11.0)
        atoms.calc = MagneticRepulsion(atoms, Spring())
        relax(StrainFilter(atoms, mask), fmax)
        assert np.linalg.norm(atoms.cell[0]) == pytest.approx(10.0, rel=1e-8)


def test_what_does_not_follow_a_cell_is_refused():
    anchored, loaded, frozen, free = ({'foundation': 0.02}, {'load': [[0.1, 0, 0]]}, {'model': 'conventional'}, {})
    for options, words in ((anchored, 'to which the particles are anchored'), (loaded, 'where neither foundation nor load'),
                           (frozen, 'fixes the directions'), (free, None)):
        atoms = lattice('triangular')
        atoms.calc = MagneticRepulsion(atoms, LAW, **options)
        if words is None:
            atoms.get_stress()
        else:
            with pytest.raises(PropertyNotImplementedError, match='the stress on a cell is defined by its bonds'):
                atoms.get_stress()
        atoms = deformed(atoms, 0)
        if words:
            with pytest.raises(ValueError, match=words):
                atoms.get_forces()


def test_repulsion_without_a_pressure_and_a_height_that_changes():
    atoms = lattice('triangular')
    atoms.calc = MagneticRepulsion(atoms, LAW)
    with pytest.raises(ValueError, match=r'no longer neighbours.*scalar_pressure='):
        relax(FrechetCellFilter(atoms, mask=PLANE), 1e-9)
    atoms = lattice('triangular')
    atoms.calc = MagneticRepulsion(atoms, LAW)
    with pytest.raises(ValueError, match=r'perpendicular to its periodic directions the cell changes.*mask='):
        relax(FrechetCellFilter(atoms, scalar_pressure=0.01), 1e-9)
    atoms = lattice('triangular')
    atoms.set_cell(np.diag([1, 1, 0]) @ atoms.cell.array)
    atoms.calc = MagneticRepulsion(atoms, LAWS['dipoles'])
    with pytest.raises(ValueError, match='give the cell three vectors'):
        atoms.get_stress()
