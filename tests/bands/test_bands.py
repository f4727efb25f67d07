"""Bands: modes in batches, polarisations, group velocities and sound speeds against differences, labels."""

import numpy as np
import pytest
from ase import Atoms
from ase.dft.kpoints import BandPath
from cells import LAW, cell_of
from numpy.testing import assert_allclose
from oracles import LATTICES, lattice
from structures import few_first

from magphonon import MagneticRepulsion, analytic_bands
from magphonon.bands import Bands, band_path, group_velocities, sound_speeds
from magphonon.bands.bands import path_of
from magphonon.bands.bloch import bloch_modes

MODELS = ('complete', 'conventional')


def random_q(atoms, n=20, seed=0):
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (n, 3)) * atoms.pbc


# Modes


def test_large_zones_are_diagonalised_in_batches(monkeypatch):
    atoms = cell_of('kagome')
    q = random_q(atoms, 100)
    at_once = bloch_modes(atoms, q, vectors=True)
    monkeypatch.setattr('magphonon.bands.bloch.BATCH_BYTES', 5000)
    for whole, parts in zip(at_once, bloch_modes(atoms, q, vectors=True), strict=True):
        np.testing.assert_array_equal(whole, parts)


def test_polarisations_of_a_triangular_lattice():
    atoms = cell_of('triangular', foundation=0.02)
    path = atoms.cell.bandpath('GM', npoints=20, pbc=atoms.pbc)
    bands = analytic_bands(atoms, path, vectors=True)
    # a mirror line of the lattice: modes are purely one or the other
    np.testing.assert_allclose(bands.longitudinal[1:], np.tile([0, 1], (19, 1)), atol=1e-14)
    assert np.isnan(bands.longitudinal[0]).all()
    assert (bands.polarisations[1:] == ['transverse', 'longitudinal']).all()
    assert (bands.polarisations[0] == '').all()
    # off the mirror lines and near the border they are mixed; at K they cross, and any two of them would do
    K = atoms.cell.bandpath('K', npoints=1, pbc=atoms.pbc).kpts[0]
    q = [[0.3, -0.35, 0], K]
    off = Bands(BandPath(atoms.cell, q, {}, ''), *bloch_modes(atoms, q, vectors=True))
    assert (off.polarisations == 'mixed').all()
    np.testing.assert_allclose(off.longitudinal.sum(axis=1), 1, rtol=1e-14)  # two modes share two directions
    np.testing.assert_allclose(off.longitudinal[1], 0.5, rtol=1e-12)


def test_polarisations_in_a_turned_cell():
    # ASE returns paths on a turned copy of the cell; labels must refer to the real one
    atoms = lattice('triangular')
    atoms.rotate(37, 'z', rotate_cell=True)
    atoms.calc = MagneticRepulsion(atoms, LAW)
    bands = analytic_bands(atoms, atoms.cell.bandpath('GM', npoints=5, pbc=atoms.pbc), vectors=True)
    assert (bands.polarisations[1:] == ['transverse', 'longitudinal']).all()


# Group velocities


def test_group_velocity_of_the_gap():
    # at k = 0 with a foundation every branch is flat; without one sound has no unique direction: not a number
    atoms = cell_of('triangular', foundation=0.02)
    assert abs(group_velocities(atoms, [[0, 0, 0]])[1]).max() < 1e-12
    atoms.calc.set(foundation=0.0)
    assert np.isnan(group_velocities(atoms, [[0, 0, 0]])[1]).all()


def test_group_velocity_of_an_unstable_branch_is_none():
    velocity = group_velocities(cell_of('square'), [[0.1, 0.0, 0]])[1][0]
    assert np.isnan(velocity[0]).all()
    assert np.isfinite(velocity[1]).all()


def test_group_velocity_at_a_crossing_is_the_mean():
    # at the Dirac point K of the triangular lattice the cones open evenly to all sides
    atoms = cell_of('triangular')
    omega, velocity = group_velocities(atoms, [[2 / 3, 1 / 3, 0], [2 / 3, 1 / 3 + 1e-4, 0]])
    assert omega[0, 1] - omega[0, 0] < 1e-12 * omega.max()
    assert abs(velocity[0]).max() < 1e-9 * abs(velocity[1]).max()  # the slope a little further on: the control


# Sound

MECHANISM = ('kagome', 'conventional', 1)  # its triangles turn against each other at no cost


def test_a_mechanism_leaves_no_sound_speeds():
    name, model, shells = MECHANISM
    atoms = cell_of(name, shells=shells)
    assert np.isnan(sound_speeds(atoms, model=model)).all()
    # three branches start from zero, and no direction is like another
    slopes = [bloch_modes(atoms, [atoms.cell.array @ n * 1e-3 / (2 * np.pi)], model)[0][0, :4] / 1e-3
              for n in np.array([[1, 0, 0], [np.sqrt(0.75), 0.5, 0]])]
    assert all(slope[2] < 5 < slope[3] for slope in slopes)
    assert abs(slopes[0][0] - slopes[1][0]) > 1
    assert np.isfinite(sound_speeds(atoms)).all()  # the static forces take the mechanism's zero away: it buckles


@pytest.mark.parametrize(('name', 'model', 'shells'), [
    (name, model, shells) for name in LATTICES for model in MODELS for shells in (1, 2) if (name, model, shells) != MECHANISM])
def test_sound_speeds_are_the_slopes_at_small_k(name, model, shells):
    atoms = cell_of(name, shells=shells)
    dim = atoms.calc.dim
    direction = np.array([1.0, 0, 0] if name == 'chain' else [0.8, 0.6, 0] if dim == 2 else [0.48, 0.6, 0.64])
    speeds = sound_speeds(atoms, direction[:dim], model)
    k = 1e-3  # rad/mm
    omega = bloch_modes(atoms, [atoms.cell.array @ direction * k / (2 * np.pi)], model)[0][0]
    slopes = omega[np.argsort(abs(omega))[:dim]] / k  # internal modes are the faster ones
    # squares, where a vanishing speed leaves round-off: (kL)^2 (fourth order) times a stiffness ratio of at most ten
    fastest = abs(speeds).max() ** 2
    assert abs(np.sort(slopes * abs(slopes)) - speeds * abs(speeds)).max() < 10 * (k * 20) ** 2 * fastest


# Paths


@pytest.mark.parametrize('lengths', [(12, 10), (10, 12)])
def test_a_path_whose_vectors_ase_swapped_follows_those_of_the_atoms(lengths):
    atoms = Atoms('X', [[0, 0, 0]], cell=[*lengths, 20], pbc=(True, True, False), masses=[1.0])
    atoms.calc = MagneticRepulsion(atoms, LAW, cutoff=13.0)
    path = path_of(atoms, atoms.cell.bandpath('GX', npoints=5, pbc=atoms.pbc))  # X lies along the shorter one
    assert_allclose(path.kpts[-1], path.special_points['X'])
    assert_allclose(abs(path.kpts[-1]), [0.5, 0, 0] if lengths[0] == 10 else [0, 0.5, 0])
    omega = analytic_bands(atoms, path).omega[-1]
    along = 4 * LAW.d2phi(10.0), 4 * LAW.dphi(10.0) / 10.0  # waves of 20 mm along the bonds of 10 mm, which alone they strain
    assert_allclose(np.sort(omega * abs(omega)), np.sort(along), rtol=1e-12)


PLANE = {'triangular': ([[1, 0], [1 / 2, np.sqrt(3) / 2]], 'GMKG'), 'obtuse': ([[1, 0], [-1 / 2, np.sqrt(3) / 2]], 'GMKG'),
         'square': (np.eye(2), 'GXMG'), 'rectangular': ([[1, 0], [0, 1.3]], 'GXSYG')}


@pytest.mark.parametrize('digits', few_first(range(3, 13), 4))
@pytest.mark.parametrize('kind', PLANE)
def test_cells_typed_with_some_digits_have_bands_along_every_path_that_ase_finds(kind, digits):
    rng = np.random.default_rng(digits)
    vectors, points = PLANE[kind]
    spacing, turn = rng.uniform(1, 30), rng.uniform(0, 2 * np.pi)
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])

    def atoms_of(plane):
        cell = np.diag([0, 0, 2 * spacing])
        cell[:2, :2] = plane
        atoms = Atoms('Nd', cell=cell, pbc=(1, 1, 0), masses=[1.0])
        atoms.calc = MagneticRepulsion(atoms, LAW, foundation=1.0, cutoff=1.2 * spacing)
        return atoms

    exact = spacing * np.array(vectors) @ rotation
    typed, ideal = atoms_of(np.round(exact, digits)), atoms_of(exact)
    expected = analytic_bands(ideal, ideal.cell.bandpath(points, npoints=9, pbc=ideal.pbc)).omega
    tolerance = 20 * 10.0**-digits / spacing * expected.max() + 1e-9  # a frequency goes with some power of the spacing
    assert_allclose(analytic_bands(typed, band_path(typed, points, 9)).omega, expected, atol=tolerance)
    assert analytic_bands(typed, points).omega.shape == (300, 2)
    try:
        path = typed.cell.bandpath(points, npoints=9, pbc=typed.pbc)
    except (KeyError, RuntimeError):
        assert digits < 5  # ASE takes it for another lattice
    else:
        assert_allclose(analytic_bands(typed, path).omega, expected, atol=tolerance)
    # the other side: a path of another lattice, and of the same one if it is clearly larger
    for other in ('square' if points == 'GMKG' else 'triangular', kind):
        foreign = atoms_of(spacing * (1.01 if other == kind else 1) * np.array(PLANE[other][0]) @ rotation)
        with pytest.raises(ValueError, match='belongs to a cell of another shape'):
            analytic_bands(typed, foreign.cell.bandpath(npoints=9, pbc=foreign.pbc))


def test_ases_band_structure_holds_hertz():
    atoms = cell_of('triangular', foundation=0.02)
    bands = analytic_bands(atoms, atoms.cell.bandpath('GMKG', npoints=30, pbc=atoms.pbc))
    structure = bands.to_ase()
    np.testing.assert_array_equal(structure.energies[0], bands.frequencies_Hz)
    # rad/ms / 2 pi = kHz
    assert bands.frequencies_Hz[0, 0] == pytest.approx(1e3 * np.sqrt(0.02 / 0.7) / (2 * np.pi), rel=1e-12)


@pytest.mark.parametrize('foundation', few_first([0.02, 0.0], 1))
def test_ases_picture_of_bands_has_all_of_them_within_its_axes(foundation):
    from matplotlib.figure import Figure

    atoms = cell_of('square', foundation=foundation)  # without a foundation it buckles
    bands = analytic_bands(atoms, 'GXMG')
    ax = bands.plot(Figure().add_subplot())
    low, high = ax.get_ylim()
    assert low <= bands.frequencies_Hz.min() < bands.frequencies_Hz.max() <= high < 1.2 * bands.frequencies_Hz.max()
    assert (low < 0) == (bands.omega.min() < 0)
    assert ax.get_ylabel() == 'frequency (Hz)'
    assert len(ax.lines) >= 2
    assert bands.to_ase().plot(Figure().add_subplot(), emax=50).get_ylim()[1] == 50
