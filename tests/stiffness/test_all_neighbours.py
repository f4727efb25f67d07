"""Lattices in which all particles repel each other: published crystals, direct sums, and phonopy where it is exact."""

from itertools import product

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixedPlane
from numpy.testing import assert_allclose

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, analytic_bands, finite_displacements, lattices, phonopy_bands
from magphonon.bands import group_velocities, sound_speeds
from magphonon.bands.bloch import bloch_modes
from magphonon.interactions import Yukawa
from magphonon.lattices import find_bonds
from magphonon.lattices.bonds import bonds_within
from magphonon.scenes.scene import reference
from magphonon.stability.buckling import critical_foundation
from magphonon.stiffness import AllNeighbours
from magphonon.stiffness.ewald import lattice_sum
from magphonon.stiffness.matrices import bloch_matrix, bloch_series, model_stiffness

DIPOLES = InversePower(b=3.0, a=4.0)  # phi = r^-3
COULOMB = InversePower(b=1.0, a=2.0)


def with_all(atoms, law, **options):
    atoms.calc = AllNeighbours(atoms, law, **options)
    return atoms


def zigzag():
    atoms = lattices.chain(10.0, 1.0).repeat((2, 1, 1))
    atoms.positions[1, :2] = 8.0, 4.0
    return atoms


def skew():
    cell = 10 * np.array([[0, 1, 1.1], [0.9, 0.1, 1], [1, 1.2, 0]]) / np.sqrt(2)
    return Atoms('Nd2', scaled_positions=[[0, 0, 0], [0.5, 0.4, 0.6]], masses=[1, 1.5], cell=cell, pbc=True)


STRUCTURES = {'honeycomb': (lambda: lattices.honeycomb(10.0, 1.0), 130.0), 'zigzag': (zigzag, 300.0), 'skew': (skew, 75.0)}
LAWS = {'r^-12': InversePower(1e12, 13.0), 'yukawa': Yukawa(50.0, 0.5)}


# --- crystals of others ----------------------------------------------------------------------------------------------

def test_dipole_crystal_is_isotropic_and_its_speeds_are_those_of_golden_and_kalman():
    known = reference()['all_neighbours']
    expected = [known['dipole_c_T_squared'], known['dipole_c_L_squared']]
    cell = lattices.triangular(1.0, 1.0)
    for direction in ([1, 0], [0, 1], [0.3, -0.7]):
        speeds = sound_speeds(with_all(cell, DIPOLES), direction)
        assert_allclose(speeds**2, expected, rtol=1e-13)
    assert_allclose(speeds[1] / speeds[0], np.sqrt(11), rtol=1e-13)
    # the 2-D colloidal crystal: shear modulus n m c_T^2 over Gamma kT = (pi n)^{3/2} C, n = 2/sqrt(3)
    n = 2 / np.sqrt(3)
    assert_allclose(n * speeds[0] ** 2 / (np.pi * n) ** 1.5, known['dipole_shear_modulus'], rtol=1e-9)
    cell.calc = MagneticRepulsion(cell, DIPOLES)  # the control: with nearest neighbours the shear speed is 20 % lower
    assert sound_speeds(cell)[0] ** 2 < 0.6 * expected[0]


@pytest.mark.parametrize('s', [0.7, 1.0, 1.9, 2.5, 3.5824, 7.0])
def test_speeds_in_the_triangular_lattice_follow_from_its_sum(s):
    """m c_T^2 = s (s - 2) S(s) C/16 L^s, m c_L^2 = s (3s + 2) S(s) C/16 L^s; below s = 2 long waves know no c_L."""
    speeds = sound_speeds(with_all(lattices.triangular(1.0, 1.0), InversePower(b=s, a=s + 1)))
    S = lattice_sum(lattices.triangular(1.0, 1.0), s)
    c_L2 = s * (3 * s + 2) * S / 16 if s > 2 else np.inf
    assert_allclose(np.sign(speeds) * speeds**2, [s * (s - 2) * S / 16, c_L2], rtol=1e-12)


def test_wigner_crystal():
    known = reference()['all_neighbours']
    cell = with_all(lattices.triangular(1.0, 1.0), COULOMB)
    n = 2 / np.sqrt(3)
    c_T, c_L = sound_speeds(cell)
    assert_allclose(c_T**2, known['wigner_shear'] * np.sqrt(n), rtol=3e-6)  # printed to six digits
    assert c_L == np.inf
    for k in (1e-2, 1e-4, 1e-6):  # the plasmon of a sheet, w^2 = 2 pi n e^2 k/m, up to the order k^2
        w = bloch_modes(cell, [[k / (2 * np.pi), k / (4 * np.pi), 0]])[0][0]
        assert_allclose(w[1] ** 2, 2 * np.pi * n * k, rtol=3 * k)
        assert_allclose(w[0], c_T * k, rtol=1e-3 + 1e-8 / k**2)


@pytest.mark.parametrize(('kind', 's', 'model', 'signs'), [
    ('chain', 0.3, 'complete', [-1, 1]), ('chain', 0.7, 'complete', [-1, 1]), ('triangular', 1.0, 'conventional', [1, 1])])
def test_speeds_without_bound_have_the_signs_of_long_waves(kind, s, model, signs):
    cell = with_all(getattr(lattices, kind)(1.0, 1.0), InversePower(1.0, s + 1))
    assert (sound_speeds(cell, model=model) == np.inf * np.array(signs)).all()
    slow, fast = (bloch_modes(cell, [[k, 0, 0]], model)[0][0] / k for k in (1e-3, 1e-5))
    assert (np.sign(fast) == signs).all()
    assert (abs(fast) > 1.5 * abs(slow)).all()  # (k/k')^((d-s)/2): a factor 2 at the least


def test_plasma_oscillates_at_its_frequency_in_space():
    """In three dimensions the squared frequencies of a Coulomb crystal add up to w_p^2 = 4 pi n e^2/m (Kohn's sum rule)."""
    cell = Atoms('Nd', masses=[1.0], cell=np.array([[-1, 1, 1], [1, -1, 1], [1, 1, -1]]) / 2, pbc=True)
    w = bloch_modes(with_all(cell, COULOMB), [[0.1, 0.2, 0.05], [1e-5, 0, 0], [0.5, 0, 0]])[0]
    assert_allclose((w * abs(w)).sum(axis=1), 4 * np.pi * 2, rtol=1e-12)
    assert_allclose(w[1, 2] ** 2, 4 * np.pi * 2, rtol=1e-8)
    assert sound_speeds(cell)[2] == np.inf


# --- direct sums -----------------------------------------------------------------------------------------------------

@pytest.mark.parametrize('law', LAWS.values(), ids=LAWS)
@pytest.mark.parametrize('name', STRUCTURES)
@pytest.mark.parametrize('model', ['complete', 'conventional'])
def test_bloch_matrices_against_direct_sums(name, law, model):
    atoms, reach = STRUCTURES[name][0](), STRUCTURES[name][1]
    calc, bonds = AllNeighbours(atoms, law, foundation=0.3), bonds_within(atoms, reach)
    q = np.array([[0.1, 0.2, 0.3], [0.5, -0.1, 1.05], [0, 0, 0]]) * atoms.pbc
    K = model_stiffness(bonds.vectors[:, : calc.dim], law, model)
    direct = bloch_matrix(bonds, K, q, 0.3)
    # what the direct sum leaves out is 1e-11 of the rest at most, that of Yukawa's law in space
    assert_allclose(calc.bloch_matrix(q, model), direct, rtol=0, atol=3e-11 * abs(direct).max())
    split = AllNeighbours(atoms, law, foundation=0.3, split=1.3).bloch_matrix(q, model)
    assert_allclose(calc.bloch_matrix(q, model), split, rtol=0, atol=1e-13 * abs(direct).max())
    near = find_bonds(atoms)  # the control: nearest neighbours
    nearest = bloch_matrix(near, model_stiffness(near.vectors[:, : calc.dim], law, model), q, 0.3)
    assert abs(nearest - direct).max() > 1e-4 * abs(direct).max()

    along = np.array([1.0, 0, 0] if name == 'zigzag' else [0.6, -0.8, 0])[: calc.dim]
    for ours, theirs in zip(calc.bloch_series(along, model), bloch_series(bonds, K, bonds.vectors[:, : calc.dim] @ along),
                            strict=True):
        assert_allclose(ours, theirs, rtol=0, atol=1e-8 * abs(theirs).max())  # k^2 brings r^2, which converges later


@pytest.mark.parametrize('name', STRUCTURES)
def test_energy_and_forces(name):
    """Energy against the direct sum of a law that converges, forces against the energy, for one that does not."""
    atoms = STRUCTURES[name][0]()
    dim = 3 if atoms.pbc.all() else 2
    atoms.positions[:, :dim] += np.random.default_rng(2).uniform(-0.5, 0.5, (len(atoms), dim))
    law = LAWS['yukawa']
    direct = law.phi(bonds_within(atoms, STRUCTURES[name][1]).lengths).sum()
    assert_allclose(with_all(atoms, law).get_potential_energy(), direct, rtol=1e-11)

    with_all(atoms, InversePower(50.0, 1.7), foundation=0.2)
    forces, h = atoms.get_forces(), 1e-3
    for i, x in np.ndindex(len(atoms), dim):
        energies = []
        for step in (-2, -1, 1, 2):
            displaced = atoms.copy()
            displaced.calc = atoms.calc
            displaced.positions[i, x] += step * h
            energies.append(displaced.get_potential_energy())
        slope = np.dot([1, -8, 8, -1], energies) / (12 * h)
        assert_allclose(forces[i, x], -slope, rtol=0, atol=1e-9 * abs(forces).max())


@pytest.mark.parametrize(('make', 's', 'supercell'), [(lambda: lattices.chain(10.0, 1.0), 1.0, (4, 1, 1)),
                                                      (lambda: lattices.honeycomb(10.0, 1.0), 2.0, (2, 2, 1))])
def test_sums_that_diverge_with_a_logarithm_have_forces(make, s, supercell):
    """s = d: a chain of charges, magnets with a = 3 in the plane.  The energy has no zero of its own, its slopes are there."""
    law = InversePower(50.0, s + 1)
    with pytest.raises(ValueError, match='logarithm of the size'):
        lattice_sum(make(), s)
    atoms = with_all(make().repeat(supercell), law)
    atoms.positions[:, :2] += np.random.default_rng(2).uniform(-0.5, 0.5, (len(atoms), 2))
    energies = [with_all(atoms.copy(), law, split=split).get_potential_energy() for split in (1.0, 1.3)]
    assert_allclose(energies[1], energies[0], rtol=1e-12)
    slope = []
    for step in (-2e-3, -1e-3, 1e-3, 2e-3):
        displaced = atoms.copy()
        displaced.positions[1, 1] += step
        slope.append(with_all(displaced, law).get_potential_energy())
    assert_allclose(atoms.get_forces()[1, 1], -np.dot([1, -8, 8, -1], slope) / 12e-3, rtol=1e-7)
    cell = with_all(make(), law)
    q = np.divide([1, 0, 0], supercell)
    path = cell.cell.bandpath('GX', npoints=2, special_points={'G': [0, 0, 0], 'X': q}, pbc=cell.pbc)
    expected = analytic_bands(cell, path).omega
    phonon = finite_displacements(cell, supercell)
    assert_allclose(phonopy_bands(phonon, path).omega[1], expected[1], rtol=1e-8)


def test_wrapping_a_particle_changes_nothing():
    atoms = with_all(lattices.honeycomb(10.0, 1.0), DIPOLES, foundation=0.3)
    energy = atoms.get_potential_energy()
    atoms.positions[1] -= atoms.cell[0] - 2 * atoms.cell[1]
    assert_allclose(atoms.get_potential_energy(), energy, rtol=1e-13)


# --- the other method --------------------------------------------------------------------------------------------------

@pytest.mark.parametrize(('lattice', 'supercell', 'points'), [('triangular', (2, 2, 1), 'GM'), ('honeycomb', (3, 3, 1), 'GK'),
                                                              ('chain', (4, 1, 1), 'GX')])
def test_phonopy_agrees_where_the_wave_fits_its_supercell(lattice, supercell, points):
    cell = with_all(getattr(lattices, lattice)(10.0, 1.0), InversePower(6200.0, 4.5824), foundation=0.02)
    phonon = finite_displacements(cell, supercell)
    path = cell.cell.bandpath(points, npoints=2, pbc=cell.pbc)
    exact = analytic_bands(cell, path).omega
    assert_allclose(phonopy_bands(phonon, path).omega, exact, rtol=1e-8)
    between = cell.cell.bandpath(points, npoints=8, pbc=cell.pbc)  # the control: in between phonopy only interpolates
    difference = phonopy_bands(phonon, between).omega - analytic_bands(cell, between).omega
    assert abs(difference).max() > 1e-4 * exact.max()


@pytest.mark.parametrize('model', ['complete', 'conventional'])
@pytest.mark.parametrize(('name', 'law'), [('honeycomb', Yukawa(1.0, 0.4)), ('square', DIPOLES), ('chain', DIPOLES)])
def test_group_velocities_are_slopes_of_the_frequencies(name, law, model):
    cell = with_all(getattr(lattices, name)(1.0, 1.0), law, foundation=30.0)
    q, h = np.random.default_rng(4).uniform(0.1, 0.4, (6, 3)) * cell.pbc, 1e-4
    velocity = group_velocities(cell, q, model).velocity
    for axis in range(2):
        step = cell.cell.array[:, axis] * h / (2 * np.pi) * cell.pbc
        slope = (bloch_modes(cell, q + step, model)[0] - bloch_modes(cell, q - step, model)[0]) / (2 * h)
        assert_allclose(velocity[..., axis], slope, rtol=0, atol=1e-6 * abs(velocity).max())  # of the differences here
    cell.calc = MagneticRepulsion(cell, law, foundation=30.0)  # the control: nearest neighbours
    assert abs(group_velocities(cell, q, model).velocity - velocity).max() > 1e-2 * abs(velocity).max()


# --- refusals --------------------------------------------------------------------------------------------------------

class Foreign:
    phi = dphi = d2phi = staticmethod(lambda r: 0 * r)


def test_what_has_no_infinite_sum_is_refused():
    cell = lattices.square(1.0, 1.0)
    with pytest.raises(ValueError, match='choose a number of shells'):
        AllNeighbours(cell, Foreign())
    with pytest.raises(ValueError, match='s = a - 1 > 0'):
        AllNeighbours(cell, InversePower(1.0, 1.0))
    with pytest.raises(ValueError, match='not periodic'):
        AllNeighbours(lattices.parallelogram(cell, 4, 4), DIPOLES)
    warped = cell.repeat((2, 1, 1))
    warped.positions[1, 2] = 0.1
    with pytest.raises(ValueError, match='share one z'):
        AllNeighbours(warped, DIPOLES)


def test_parts_that_diverge_are_refused():
    cell = with_all(Atoms('Nd', masses=[1.0], cell=np.eye(3), pbc=True), COULOMB)
    with pytest.raises(ValueError, match='only their sum converges'):
        sound_speeds(cell, model='conventional')
    with pytest.raises(ValueError, match='model must be one of'):
        bloch_modes(cell, [[0, 0, 0]], model='D0')


def test_foundation_that_all_neighbours_ask_for():
    """The square Wigner crystal buckles, whatever the mesh shows first; the triangular one holds itself."""
    square, triangular = (with_all(kind(1.0, 1.0), COULOMB, foundation=0.1) for kind in (lattices.square, lattices.triangular))
    needed, softest = critical_foundation(square)
    assert_allclose(bloch_modes(square, [softest])[0].min() ** 2, needed - 0.1, rtol=1e-12)
    assert needed > 0.3
    assert critical_foundation(triangular, steps=12)[0] == 0


# --- what is not the lattice of the calculator -------------------------------------------------------------------------

def planar(seed):
    rng = np.random.default_rng(seed)
    cell = np.diag([*rng.uniform(8, 14, 2), 20.0])
    cell[1, 0] = rng.uniform(-3, 3)
    pbc = [(True, True, False), (True, False, False)][seed % 2]
    atoms = Atoms('Nd2', [[0, 0, 1.5], [*rng.uniform(0.3, 0.7, 2) @ cell[:2, :2], 1.5]], masses=[1, 1.5], cell=cell, pbc=pbc)
    return with_all(atoms, InversePower(b=3e3, a=rng.uniform(3, 6)), split=rng.uniform(0.6, 1.6)), rng


@pytest.mark.parametrize('seed', range(8))
def test_another_periodicity_is_refused(seed):
    atoms, rng = planar(seed)
    atoms.get_potential_energy()
    others = [pbc for pbc in product((True, False), repeat=3) if pbc != tuple(atoms.pbc)]
    atoms.pbc = others[rng.integers(len(others))]
    with pytest.raises(ValueError, match='cell or its periodicity differs'):
        atoms.get_potential_energy()


@pytest.mark.parametrize('seed', range(8))
def test_particles_that_leave_the_plane_are_refused_and_nothing_acts_along_z(seed):
    atoms, rng = planar(seed)
    forces, energy = atoms.get_forces(), atoms.get_potential_energy()
    atoms.positions[1, 2] += 1e-3 * rng.uniform(0.1, 1)  # as by finite differences: neither force nor energy knows z
    assert_allclose(atoms.get_forces(), forces, rtol=0, atol=1e-14 * abs(forces).max())
    assert atoms.get_potential_energy() == pytest.approx(energy, rel=1e-14)
    atoms.positions[1, 2] += 2
    with pytest.raises(ValueError, match=r'particle 1 is 2\.00\d* mm out of the plane'):
        atoms.get_forces()
    atoms.positions[1, 2] = 1.5
    atoms.set_velocities(rng.normal(size=(2, 3)))
    with pytest.raises(ValueError, match='moves out of the plane'):
        DrivenVerlet(atoms, 0.01).run(3)
    atoms.set_constraint(FixedPlane(range(2), (0, 0, 1)))
    atoms.set_velocities(rng.normal(size=(2, 3)))
    DrivenVerlet(atoms, 0.01).run(3)
    assert np.ptp(atoms.positions[:, 2]) == 0
