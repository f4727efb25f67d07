"""phonopy's finite displacements against the analytic Hessian and bands and against the numbers of the paper."""

import functools
import os

import numpy as np
import pytest
from ase import Atoms
from ase.build import bulk
from ase.constraints import FixAtoms
from cells import PILLAR, PROTOTYPE, at, path_through, prototype
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, analytic_bands, finite_displacements, lattices, phonopy_bands, units as u
from magphonon.bands import extracted_dstar, force_constants, foundation_recovered

PATHS = {'chain': 'GX', 'square': 'GXMG', 'triangular': 'GMKG', 'honeycomb': 'GMKG', 'kagome': 'GMKG'}

# The promise of the default displacement 1e-5 L0, in units of the highest frequency or of the largest force constant.
# What the curvature of these laws leaves is 2 to 20 times (d/L0)^2: 2e-10 to 2e-9.
PROMISE = 1e-8

STIFFNESS = 0.108554846744
"""-df/dr of the prototype's bond in N/mm (recomputed in 50-digit arithmetic): the scale of the force constants."""

FORCE = 0.236895178822
"""f(L0) of the prototype's bond in N."""


def fcc():
    cell = bulk('Nd', 'fcc', a=10 * np.sqrt(2))
    cell.set_masses([0.707])
    cell.calc = MagneticRepulsion(cell, PROTOTYPE, foundation=PILLAR)
    return cell


def awkward():
    """Kagome with unequal masses, off the origin, two of its particles in other cells than their neighbours."""
    cell = lattices.kagome(spacing=10 * u.mm, mass=1 * u.g)
    cell.set_masses([0.5, 0.7, 1.1])
    cell.positions += [1.2, 0.7, 0.3]
    cell.positions[:2] += [cell.cell[0] - 2 * cell.cell[1], -cell.cell[1]]
    cell.calc = MagneticRepulsion(cell, PROTOTYPE, foundation=PILLAR)
    return cell


def discrepancy(a, b):
    return abs(a.omega - b.omega).max() / b.omega.max()


# --- modes ---------------------------------------------------------------------------------------------------------


def subspace_overlap(exact, modes):
    """Smallest share of a mode that lies within the exact modes of the same frequency."""
    n = exact.omega.shape[1]
    worst = 1.0
    for omega, v, x in zip(exact.omega, exact.vectors.reshape(-1, n, n), modes.reshape(-1, n, n), strict=True):
        same = abs(omega[:, None] - omega) < 1e-5 * omega.max()
        worst = min(worst, (abs(v.conj() @ x.T) ** 2 * same).sum(axis=0).min())
    return worst


@pytest.mark.parametrize('cell', [awkward(), prototype('honeycomb'), prototype('chain'), fcc()], ids=lambda c: str(c.symbols))
def test_modes_are_the_analytic_ones_with_their_phase(cell):
    path = path_through(cell, 'GX' if cell.pbc.sum() == 1 else 'GXWKG' if cell.pbc.all() else 'GMKG', 23)
    numerical = phonopy_bands(finite_displacements(cell), path, vectors=True)
    # mixed with a neighbour 1e-5 away by a perturbation of 2e-9: 4e-8 in the square
    assert subspace_overlap(analytic_bands(cell, path, vectors=True), numerical.vectors) > 1 - 1e-6


def test_modes_with_phonopys_own_phase_would_not_overlap():
    cell = awkward()
    path = path_through(cell, 'GMKG', 23)
    numerical = phonopy_bands(finite_displacements(cell), path, vectors=True)
    back = np.exp(-2j * np.pi * path.kpts @ cell.get_scaled_positions(wrap=False).T)[:, None, :, None]
    assert subspace_overlap(analytic_bands(cell, path, vectors=True), back * numerical.vectors) < 0.5


# --- force constants -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize('cell', [*map(prototype, PATHS), awkward()], ids=[*PATHS, 'awkward'])
def test_dstar_extracted_from_phonopy(cell):
    n = cell.calc.bonds.vectors[:, :2] / 10
    expected = -FORCE / 10 * (np.eye(2) - n[:, :, None] * n[:, None, :])  # phi'/r (I - nn)
    assert_allclose(extracted_dstar(finite_displacements(cell), cell), expected, atol=PROMISE * STIFFNESS)


def test_frozen_directions_have_no_dstar():
    cell = prototype(model='conventional')
    assert abs(extracted_dstar(finite_displacements(cell), cell)).max() < PROMISE * STIFFNESS


@pytest.mark.parametrize('cell', [*map(prototype, PATHS), fcc()], ids=[*PATHS, 'fcc'])
def test_row_sums_recover_the_foundation(cell):
    dim = 3 if cell.pbc.all() else 2
    k = foundation_recovered(finite_displacements(cell))
    assert_allclose(k, np.broadcast_to(PILLAR * np.eye(dim), (len(cell), dim, dim)), atol=1e-9 * PILLAR)


def test_a_lattice_without_foundation_has_none_to_recover():
    # round-off of the forces, f * 1e-16, over the displacement
    assert abs(foundation_recovered(finite_displacements(prototype(foundation=0.0)))).max() < 1e-11


def test_symmetrised_force_constants_lose_the_foundation_gap():
    cell = prototype()
    phonon = finite_displacements(cell)
    assert_allclose(phonopy_bands(phonon, at(cell, 'G')).frequencies_Hz, 26.550686524, rtol=PROMISE)
    phonon.symmetrize_force_constants()
    assert abs(phonopy_bands(phonon, at(cell, 'G')).frequencies_Hz).max() < 1e-4  # the root of round-off
    assert abs(foundation_recovered(phonon)).max() < 1e-12


# --- displacement and supercell: both sides of what works ------------------------------------------------------------


def displacement_errors(cell, path, distances):
    exact = analytic_bands(cell, path)
    return np.array([discrepancy(phonopy_bands(finite_displacements(cell, distance=d), path), exact) for d in distances])


def test_error_grows_with_the_square_of_the_displacement():
    cell = prototype()
    d = np.geomspace(1e-4, 1e-2, 5)
    errors = displacement_errors(cell, path_through(cell, 'GMKG'), 10 * d)
    assert np.polyfit(np.log(d), np.log(errors), 1)[0] == pytest.approx(2, abs=0.1)
    assert errors[0] < 20 * d[0] ** 2  # the prefactor that makes 1e-5 L0 keep its promise


@pytest.mark.slow
def test_error_grows_with_the_inverse_of_the_smallest_displacements():
    cell = prototype()
    d = np.geomspace(1e-11, 1e-7, 41)  # round-off is noise: many displacements make a slope
    errors = displacement_errors(cell, path_through(cell, 'GMKG', 10), 10 * d)
    assert np.polyfit(np.log(d), np.log(errors), 1)[0] == pytest.approx(-1, abs=0.2)


@pytest.mark.parametrize(('supercell', 'right'), [((1, 1, 1), False), ((2, 2, 1), True)])
def test_a_refused_supercell_would_give_wrong_bands(supercell, right, monkeypatch):
    cell = prototype('honeycomb')
    monkeypatch.setattr(force_constants, 'checked_supercell', lambda calc, supercell: np.diag(supercell))
    path = path_through(cell, 'GMKG')
    error = discrepancy(phonopy_bands(finite_displacements(cell, supercell), path), analytic_bands(cell, path))
    assert error < PROMISE if right else error > 0.1


@pytest.mark.parametrize('seed', range(6))
def test_a_supercell_that_is_not_diagonal_gives_the_same_bands(seed):
    """Matrices as phonopy takes them, drawn until no bond spans half of the supercell; held particles stand at their images."""
    rng = np.random.default_rng(seed)
    cell = prototype(['triangular', 'honeycomb', 'kagome'][seed % 3])
    if seed >= 3:
        cell = cell.repeat((2, 1, 1))
        cell.set_constraint(FixAtoms([int(rng.integers(len(cell)))]))
        cell.calc = MagneticRepulsion(cell, InversePower(b=6200.0, a=4.5824), foundation=0.2)
    path, matrix = cell.cell.bandpath(npoints=9, pbc=cell.pbc), np.eye(3, dtype=int)
    while True:
        matrix[:2, :2] = rng.integers(-3, 5, (2, 2))
        try:
            phonon = finite_displacements(cell, matrix)
            break
        except ValueError:
            continue
    assert matrix[0, 1] or matrix[1, 0]
    assert discrepancy(phonopy_bands(phonon, path), analytic_bands(cell, path)) < PROMISE


def test_phonopys_symmetry_search_would_let_a_planar_chain_move_along_z(monkeypatch):
    import phonopy

    cell = prototype('chain')
    assert force_constants.force_constants_of(finite_displacements(cell)).shape[-1] == 2
    searching = functools.partial(phonopy.Phonopy)
    monkeypatch.setattr(phonopy, 'Phonopy', lambda *args, is_symmetry, **kw: searching(*args, is_symmetry=True, **kw))
    assert force_constants.force_constants_of(finite_displacements(cell)).shape[-1] == 3


def test_files_in_the_working_directory_neither_matter_nor_appear(tmp_path, monkeypatch):
    cell = prototype()
    path = path_through(cell, 'GMKG')
    expected = phonopy_bands(finite_displacements(cell), path).omega
    monkeypatch.chdir(tmp_path)
    stray = 'FORCE_CONSTANTS', 'FORCE_SETS', 'force_constants.hdf5', 'BORN', 'phonopy.yaml', 'phonopy_disp.yaml'
    for name in stray:
        (tmp_path / name).write_text('9 9\nnonsense\n')
    assert np.array_equal(phonopy_bands(finite_displacements(cell), path).omega, expected)
    assert sorted(os.listdir()) == sorted(stray)


@pytest.mark.parametrize('seed', range(8))
def test_round_off_along_z_does_not_make_a_layer_three_dimensional(seed):
    """Forces that do not cancel at rest leave round-off in phonopy's differences, here up to 1e-11 of the largest one."""
    rng = np.random.default_rng(seed)
    cell = np.diag([*np.sort(rng.uniform(12, 16, 2)), 20.0])
    basis = [[0, 0, 0], [*rng.uniform(0.35, 0.65, 2), 0]]
    atoms = Atoms('Nd2', scaled_positions=basis, cell=cell, pbc=(1, 1, 0), masses=[0.7, 1.1])
    atoms.positions[:, 2] = rng.uniform(-20, 20)
    atoms.calc = MagneticRepulsion(atoms, InversePower(b=6200.0, a=4.5824), cutoff=16.7, foundation=0.02).balanced([0, 1])
    phonon = finite_displacements(atoms)
    phonon.force_constants[:, :, 2, :2] += rng.uniform(-1e-11, 1e-11) * abs(phonon.force_constants).max()
    path = atoms.cell.bandpath('GX', npoints=5, pbc=atoms.pbc)
    bands = phonopy_bands(phonon, path)
    assert bands.omega.shape == (5, 4)
    exact = analytic_bands(atoms, path).omega
    assert abs(bands.omega * abs(bands.omega) - exact * abs(exact)).max() < 1e-8 * (exact**2).max()
