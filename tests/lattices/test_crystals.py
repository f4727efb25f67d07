"""Cells, patches with their rim, and the oscillator."""

import numpy as np
import pytest
from ase.constraints import FixAtoms
from hypothesis import given, settings, strategies as st
from oracles import neighbour_vectors

from magphonon import InversePower, MagneticRepulsion, lattices, modes, units as u
from magphonon.interactions.pair_laws import repulsion
from magphonon.lattices import find_bonds
from magphonon.lattices.patches import RIM

LAW = InversePower(b=6200.0, a=4.5824)
SPACING, MASS = 10 * u.mm, 0.7 * u.g
CELLS = {'chain': (1, 2), 'square': (1, 4), 'triangular': (1, 6), 'honeycomb': (2, 3), 'kagome': (3, 4)}
PLANAR = [name for name in CELLS if name != 'chain']


def cell(name):
    return getattr(lattices, name)(SPACING, MASS)


@pytest.mark.parametrize(('name', 'particles', 'neighbours'), [(name, *counts) for name, counts in CELLS.items()])
def test_cells(name, particles, neighbours):
    atoms = cell(name)
    bonds = find_bonds(atoms)
    assert len(atoms) == particles
    assert (bonds.coordination == neighbours).all()
    np.testing.assert_allclose(bonds.lengths, SPACING, rtol=1e-15)  # spacing is the nearest-neighbour distance
    assert (atoms.get_masses() == MASS).all()
    assert not atoms.positions[:, 2].any()
    assert tuple(atoms.pbc) == ((True, False, False) if name == 'chain' else (True, True, False))


def test_the_papers_basis():
    np.testing.assert_allclose(cell('triangular').cell.array[:2] / SPACING, [[1, 0, 0], [0.5, np.sqrt(0.75), 0]], rtol=1e-15)


PATCHES = {
    'parallelogram': lambda atoms: lattices.parallelogram(atoms, 7, 6),
    'rectangle': lambda atoms: lattices.rectangle(atoms, 82 * u.mm, 71 * u.mm),
    'hexagon': lambda atoms: lattices.hexagon(atoms, 50 * u.mm),
    'half_hexagon': lambda atoms: lattices.half_hexagon(atoms, 70 * u.mm),
}


@pytest.mark.parametrize('name', PLANAR)
@pytest.mark.parametrize('cut', PATCHES.values(), ids=PATCHES)
def test_patches_hold_their_rim_and_balance_inside(name, cut):
    atoms = cell(name)
    patch = cut(atoms)
    bonds = find_bonds(patch)
    rim = patch.get_tags() == RIM
    full = CELLS[name][1]

    assert not patch.pbc.any()
    assert 0 < rim.sum() < len(patch)
    np.testing.assert_array_equal(bonds.coordination == full, ~rim)
    np.testing.assert_allclose(bonds.lengths, SPACING, rtol=1e-13)
    assert len(patch.constraints) == 1
    assert isinstance(patch.constraints[0], FixAtoms)
    np.testing.assert_array_equal(patch.constraints[0].index, np.flatnonzero(rim))
    assert (patch.get_masses() == MASS).all()

    patch.calc = MagneticRepulsion(patch, LAW)
    f = repulsion(LAW, SPACING)
    forces = patch.get_forces(apply_constraint=False)
    # round-off of the positions, 1e-16 of the patch against the spacing, times the exponent
    assert abs(forces[~rim]).max() < 1e-13 * f
    # the control: on the rim it is not so; where two neighbours are left opposite each other they balance (kagome)
    assert np.linalg.norm(forces[rim], axis=1).max() > 0.5 * f


@settings(max_examples=20, deadline=None)
@given(name=st.sampled_from(PLANAR), skew=st.tuples(*[st.integers(-2, 2)] * 2), sizes=st.tuples(*[st.integers(1, 5)] * 2),
       strip=st.booleans(), seed=st.integers(0, 2**32 - 1))
def test_rims_in_any_basis_and_size_against_brute_force(name, skew, sizes, strip, seed):
    """A bond may lead farther than the patch has cells; the particles of the cell may stand in any of its images."""
    atoms, rng = cell(name), np.random.default_rng(seed)
    atoms.cell[1] += skew[0] * atoms.cell[0]
    atoms.cell[0] += skew[1] * atoms.cell[1]
    atoms.positions += rng.integers(-2, 3, (len(atoms), 3)) * [1, 1, 0] @ atoms.cell.array
    n1, n2 = (1, sizes[1]) if strip else sizes
    whole = atoms.repeat((n1, n2, 1))
    whole.pbc = strip, False, False
    ends = [i for i, *_ in neighbour_vectors(whole, 1.01 * SPACING, images=10)]
    rim = np.bincount(ends, minlength=len(whole)) < CELLS[name][1]
    cut = (lambda: lattices.ribbon(atoms, n2)) if strip else (lambda: lattices.parallelogram(atoms, n1, n2))
    if rim.all():
        with pytest.raises(ValueError, match='none of them inside its rim'):
            cut()
    else:
        np.testing.assert_array_equal(cut().get_tags() == RIM, rim)


def test_hexagon_of_the_triangular_lattice_counts_right():
    # n rings around one particle: 3 n (n + 1) + 1, of which 6 n on the rim
    patch = lattices.hexagon(cell('triangular'), 4 * SPACING)
    assert len(patch) == 3 * 4 * 5 + 1
    assert (patch.get_tags() == RIM).sum() == 6 * 4


def test_half_hexagon_is_half_of_it():
    whole, half = (cut(cell('triangular'), 4 * SPACING) for cut in (lattices.hexagon, lattices.half_hexagon))
    assert len(half) == (len(whole) + 9) // 2  # both keep the row of 9 along the diameter
    assert half.positions[:, 1].min() == pytest.approx(0, abs=1e-12)


def test_a_border_through_particles_keeps_them():
    # width and height that end on particles, in numbers that are no binary fractions
    patch = lattices.rectangle(lattices.square(0.1, MASS), 0.6, 0.4)
    assert len(patch) == 7 * 5


def test_sites_number_the_parallelogram():
    atoms = cell('kagome')
    whole, cut = lattices.parallelogram(atoms, 9, 9), lattices.hexagon(atoms, 45 * u.mm)
    np.testing.assert_array_equal(whole.get_array('site'), np.arange(len(whole)))
    # in the parallelogram, sites run as in `repeat`: the same difference of sites is the same vector
    site = cut.get_array('site')
    assert (np.diff(site) > 0).all()
    offsets = {}
    bonds = find_bonds(cut)
    for i, j in zip(bonds.i, bonds.j, strict=True):
        vector = np.round(cut.positions[j] - cut.positions[i], 9) + 0.0
        key = (int(site[j] - site[i]), int(site[i] % 3))  # of a given particle of the cell
        assert tuple(offsets.setdefault(key, vector)) == tuple(vector)
    assert len(offsets) == 6  # the bonds of one cell


def test_patch_of_a_cell_with_a_calculator_has_none():
    atoms = cell('triangular')
    atoms.calc = MagneticRepulsion(atoms, LAW)
    assert lattices.hexagon(atoms, 30 * u.mm).calc is None


@pytest.mark.parametrize('theta0', [0.0, 10.0, 30.0, 44.9, 45.0, 60.0, 75.0, 89.9, 90.0])
@pytest.mark.parametrize('a', [2.0, 4.0, 9.0])
def test_oscillator_vibrates_as_its_closed_form_without_being_told_its_bonds(theta0, a):
    """Sec. III: each bond adds a f/r along itself and -f/r across; above 30 degrees two fixed magnets are nearest neighbours."""
    b, r, m = 2.0, 3.0, 1.7
    atoms = lattices.oscillator(theta0 * u.deg, r, m)
    atoms.calc = MagneticRepulsion(atoms, InversePower(b, a)).balanced([3])
    along_y = 2 * np.sin(theta0 * u.deg) ** 2 + 1  # sum of n_y^2 over the three bonds
    k = b * r**-a / r * (np.array([a * (3 - along_y) - along_y, a * along_y - (3 - along_y)]))
    expected = np.sort(np.sign(k) * np.sqrt(abs(k / m)))
    scale = abs(expected).max()
    np.testing.assert_allclose(modes(atoms).omega, expected, rtol=0, atol=1e-7 * scale)  # the root of the round-off of a zero
    if 30 < theta0 < 80:  # the control: what the nearest pairs of all four would be
        atoms.calc = MagneticRepulsion(atoms, InversePower(b, a), bonds=[(0, 2), (1, 2)])
        assert abs(modes(atoms).omega).max() < 1e-3 * scale
