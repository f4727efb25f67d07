"""What phonopy cannot do right is refused: supercells, distances, atoms, phonons and paths."""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from cells import PROTOTYPE, at, prototype

from magphonon import InversePower, MagneticRepulsion, analytic_bands, finite_displacements, lattices, phonopy_bands
from magphonon.bands import extracted_dstar, foundation_recovered


@pytest.mark.parametrize(('supercell', 'message'), [
    ((1, 1, 1), r'repeats every 10 mm.*give supercell=\(3, 3, 1\)'),
    ((2, 3, 1), r'repeats every 20 mm.*bonds of 10 mm.*give supercell=\(3, 3, 1\)'),
    ((3, 3, 2), r'not periodic; give supercell=\(3, 3, 1\)'),
    ((3, 3), r'three numbers of cells.*\(3, 3\)'),
    (3, 'three numbers of cells.*not 3'),
    ((3, 3.5, 1), r'supercell\[1\] must be a whole number.*3\.5'),
    ((3, 0, 1), r'supercell\[1\] must be a whole number of at least 1'),
    ((3, float('nan'), 1), r'supercell\[1\].*nan'),
])
def test_impossible_supercells_are_refused(supercell, message):
    with pytest.raises(ValueError, match=message):
        finite_displacements(prototype(), supercell=supercell)


@pytest.mark.parametrize(('distance', 'message'), [
    (0, 'distance must be a positive number in mm, not 0'),
    (-1e-4, 'distance must be a positive'),
    (float('nan'), 'distance must be a positive.*nan'),
    (1.01, 'distance 1.01 mm is 1.0e-01 of the shortest bond.*leave it out for 0.0001 mm'),
    (0.9e-11, 'outside 1e-12 to 0.1'),
])
def test_impossible_distances_are_refused(distance, message):
    with pytest.raises(ValueError, match=message):
        finite_displacements(prototype(), distance=distance)


def held(cell):
    cell.set_constraint(FixAtoms([0]))
    return cell


def patch():
    patch = lattices.parallelogram(lattices.triangular(10, 0.707), 4, 4)
    patch.calc = MagneticRepulsion(patch, PROTOTYPE)
    return patch


def ghost():
    cell = lattices.triangular(10, 0.707)
    cell.symbols = 'X'
    cell.calc = MagneticRepulsion(cell, PROTOTYPE)
    return cell


def flat():
    cell = lattices.triangular(10, 0.707)
    cell.cell[2] = 0
    cell.calc = MagneticRepulsion(cell, PROTOTYPE)
    return cell


def foreign():
    cell = prototype()
    cell.cell[0] *= 1.1
    return cell


@pytest.mark.parametrize(('make', 'message'), [
    (lambda: lattices.triangular(10, 0.707), 'attach atoms.calc = MagneticRepulsion'),
    (lambda: held(prototype()), 'the constraints hold every particle; free one'),
    (patch, 'not periodic, it has no bands'),
    (ghost, "symbol 'X' of particle 0"),
    (flat, 'three lattice vectors, not 2'),
    (foreign, 'cell or its periodicity differs'),
])
def test_unsuitable_atoms_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        finite_displacements(make())


def test_unsuitable_phonons_and_paths_are_refused():
    import phonopy

    cell = prototype()
    phonon = finite_displacements(cell)
    empty = phonopy.Phonopy(phonon.unitcell, np.diag([3, 3, 1]), primitive_matrix='P')
    for function in (foundation_recovered, lambda p: phonopy_bands(p, at(cell, 'G')), lambda p: extracted_dstar(p, cell)):
        with pytest.raises(ValueError, match=r'holds no force constants; get a phonon from finite_displacements\(atoms\)'):
            function(empty)
    with pytest.raises(ValueError, match='Atoms holds no force constants'):
        phonopy_bands(cell, at(cell, 'G'))
    with pytest.raises(ValueError, match=r'path must be a BandPath .*, not list'):
        phonopy_bands(phonon, [[0, 0, 0]])
    with pytest.raises(ValueError, match='another shape'):
        phonopy_bands(phonon, at(prototype('square'), 'G'))


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
