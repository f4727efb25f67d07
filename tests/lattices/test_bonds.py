"""Bonds against brute force: each pair once, whatever the cell, the shells, the order of the particles."""

import re
from unittest import mock

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from hypothesis import example, given, settings, strategies as st
from oracles import LATTICES, lattice, neighbour_vectors

from magphonon.lattices import bonds as of_bonds, cells, find_bonds
from magphonon.lattices.bonds import Bonds, bonds_within, explicit_bonds, repeat_bonds
from magphonon.lattices.patches import parallelogram


def as_set(bonds):
    """Bonds as a set that does not depend on their direction; shorter than the list if one of them is listed twice."""
    listed = zip(bonds.i.tolist(), bonds.j.tolist(), map(tuple, bonds.shift.tolist()), strict=True)
    return {min((i, j, shift), (j, i, tuple(-k for k in shift))) for i, j, shift in listed}


def by_brute_force(atoms, reach):
    return {min((i, j, shift), (j, i, tuple(-k for k in shift))) for i, j, shift, _ in neighbour_vectors(atoms, reach)}


def found_by_cells(so):
    """Within it the cells of a grid find the pairs, or else the k-d tree."""
    return mock.patch.object(of_bonds, 'compiled', return_value=cells if so else None)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0, 4), flat=st.integers(1, 3), cells=st.booleans())
def test_pairs_of_scattered_particles_with_holes(seed, reach, flat, cells):
    """Particles on a line, in a plane or in space, in clumps with empty space between them, against all distances."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 120))
    places = rng.uniform(-9, 9, (n, 3)) + 10.0 ** rng.integers(-1, 4) * rng.integers(-1, 2, (n, 3))
    places[:, rng.permutation(3)[flat:]] = 0.5
    vectors = places - places[:, None]
    i, j = np.nonzero(np.triu(np.sqrt((vectors**2).sum(axis=-1)) <= reach, 1))
    with found_by_cells(cells):
        found = of_bonds.pairs_within(Atoms(['Nd'] * n, positions=places), reach)
    assert np.array_equal(found[:2], (i, j))  # in this order
    assert np.array_equal(found[3], vectors[i, j])
    assert not found[2].any()


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), particles=st.integers(1, 4), pbc=st.tuples(st.booleans(), st.booleans(), st.booleans()),
       cells=st.booleans())
def test_any_structure_against_brute_force(seed, particles, pbc, cells):
    rng = np.random.default_rng(seed)
    cell = np.eye(3) + rng.uniform(-0.25, 0.25, (3, 3))
    if rng.random() < 0.5:
        cell = cell[[1, 0, 2]]  # left-handed
    fractions = rng.uniform(-0.7, 1.3, (particles, 3))  # also outside the cell
    atoms = Atoms(['Nd'] * particles, scaled_positions=fractions, cell=cell, pbc=pbc)
    with found_by_cells(cells):
        bonds = bonds_within(atoms, 0.9)  # the images up to four cells away that the oracle searches suffice for this
    assert as_set(bonds) == by_brute_force(atoms, 0.9)
    assert len(as_set(bonds)) == len(bonds)
    ends = atoms.positions[bonds.j] + bonds.shift @ cell
    np.testing.assert_allclose(bonds.vectors, ends - atoms.positions[bonds.i], rtol=0, atol=1e-15)
    assert not bonds.shift[:, ~atoms.pbc].any()


@pytest.mark.parametrize('name', LATTICES)
def test_bonds_follow_particles_that_move_and_stand_in_other_cells(name):
    atoms = lattice(name)
    atoms = atoms.repeat(np.where(atoms.pbc, 3, 1))
    bonds, rng = find_bonds(atoms, shells=2), np.random.default_rng(7)
    u = rng.uniform(-1, 1, (len(atoms), 3))  # the spacing is 10
    moved = atoms.copy()
    moved.positions += u + (rng.integers(-2, 3, (len(atoms), 3)) * atoms.pbc) @ atoms.cell.array
    found = bonds.at(moved)
    ends = moved.positions[found.j] + found.shift @ moved.cell.array - moved.positions[found.i]
    np.testing.assert_allclose(found.vectors, ends, atol=1e-12)
    np.testing.assert_allclose(found.vectors, bonds.vectors + u[bonds.j] - u[bonds.i], atol=1e-12)
    assert (found.shift != bonds.shift).any()  # the control: the old list of cells would be wrong


def shuffled(atoms, seed):
    return atoms[np.random.default_rng(seed).permutation(len(atoms))]


@pytest.mark.parametrize('name', LATTICES)
def test_repeated_bonds_are_those_of_the_supercell(name):
    atoms = lattice(name)
    bonds = find_bonds(atoms, shells=2)
    supercell = shuffled(atoms.repeat(np.where(atoms.pbc, (3, 2, 2), 1)), seed=4)
    repeated = repeat_bonds(bonds, atoms, supercell)
    assert as_set(repeated) == as_set(find_bonds(supercell, shells=2))
    assert len(repeated) == len(supercell) // len(atoms) * len(bonds)
    ends = supercell.positions[repeated.j] + repeated.shift @ supercell.cell.array
    np.testing.assert_allclose(ends - supercell.positions[repeated.i], repeated.vectors, atol=1e-12)


def test_repeated_bonds_may_be_listed_ones():
    # every other bond of a chain of two: a dimer lattice, which no cutoff finds
    atoms = lattice('chain').repeat((2, 1, 1))
    repeated = repeat_bonds(explicit_bonds(atoms, [(0, 1)]), atoms, atoms.repeat((3, 1, 1)))
    assert as_set(repeated) == {(0, 1, (0, 0, 0)), (2, 3, (0, 0, 0)), (4, 5, (0, 0, 0))}


def test_listed_bonds():
    atoms = lattice('square')
    bonds = explicit_bonds(atoms, [(0, 0, (1, 0, 0)), (0, 0, (1, 1, 0))])
    np.testing.assert_allclose(bonds.vectors, [[10, 0, 0], [10, 10, 0]])
    assert bonds.cutoff is None


@pytest.mark.parametrize('name', LATTICES)
def test_incidence_matrix(name):
    bonds = find_bonds(lattice(name).repeat(2), shells=2)
    q = (0.3, -0.1, 0.7)
    C = np.zeros((len(bonds), bonds.particles), dtype=complex)
    for row, (i, j, shift) in enumerate(zip(bonds.i, bonds.j, bonds.shift, strict=True)):
        C[row, i] -= 1
        C[row, j] += np.exp(2j * np.pi * np.dot(q, shift))
    np.testing.assert_allclose(bonds.incidence_at(q).toarray(), C, atol=1e-15)
    # at q = 0 each row takes a difference: nothing of a translation is left
    assert not (bonds.incidence @ np.ones(bonds.particles)).any()
    assert bonds.incidence.dtype == float


def scattered(scatter):
    """A patch of spacing 10, and the same with each coordinate off by about `scatter`."""
    patch = parallelogram(lattice('triangular'), 6, 5)
    moved = patch.copy()
    moved.positions[:, :2] += np.random.default_rng(7).normal(0, scatter, (len(patch), 2))
    return patch, moved


@pytest.mark.parametrize('scatter', [1e-2, 0.1, 0.5])
@pytest.mark.parametrize('shells', [1, 3])
def test_measured_positions_that_scatter_are_refused(scatter, shells):
    """Each distance is then a shell of its own: one shell would be a single bond."""
    patch, moved = scattered(scatter)
    with pytest.raises(ValueError, match=r'positions are irregular|shells of neighbours are not clear') as refusal:
        find_bonds(moved, shells=shells)
    advised = float(re.search(r'\(([\d.]+) mm lies', str(refusal.value)).group(1))
    assert as_set(find_bonds(moved, cutoff=advised)) == as_set(find_bonds(patch))


@pytest.mark.parametrize(('inside', 'clear'), [(5e-5, True), (7e-5, False)])
def test_a_gap_to_the_next_shell_is_four_times_those_inside_the_shells_that_count(inside, clear):
    """Of distances 1, 1.004 and one that differs by `inside`, 2.5e-4 to the next; what lies beyond does not matter."""
    distances = np.cumprod([1, 1.004, 1 + inside, 1 + 2.5e-4, 1 + 9e-5, 1.004])
    atoms = Atoms('Nd2', positions=[[0, 0, 0], [np.pi, np.e, 0]])
    assert of_bonds.clear_shells(atoms, distances, [2]) == [2] * clear


@pytest.mark.parametrize('scatter', [1e-9, 1e-6, 1e-4])
def test_positions_good_to_a_hundred_thousandth_keep_their_bonds(scatter):
    patch, moved = scattered(scatter)
    assert as_set(find_bonds(moved)) == as_set(find_bonds(patch))


def ideal_bonds(name, shells):
    """Bonds in a cell of the ideal lattice, by brute force: its distances differ by much more than they are rounded here."""
    lengths = np.sort(np.round([np.linalg.norm(v) for *_, v in neighbour_vectors(lattice(name), 42.0)], 6))
    farthest = np.unique(lengths)[shells - 1]
    return int((lengths <= farthest).sum()) // 2


def written(atoms, decimals, turn):
    """A structure turned about z, or about all axes if it fills space, and written with so many decimals."""
    axis = (1, 2, 3) if atoms.pbc.all() else 'z'
    turned = atoms.copy()
    turned.rotate(turn, axis, rotate_cell=True)
    turned.set_cell(np.round(turned.cell.array, decimals))
    turned.positions = np.round(turned.positions, decimals)
    return turned


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(name=st.sampled_from(LATTICES), shells=st.integers(1, 4), decimals=st.integers(2, 8),
       spacing=st.one_of(st.sampled_from([0.5, 1.0, 3.3, 7.07, 9.8027, 10.0]), st.floats(0.5, 25)), repeats=st.integers(1, 3),
       turn=st.one_of(st.just(0.0), st.floats(0, 360)))
@example(name='chain', shells=2, decimals=2, spacing=9.8027, repeats=2, turn=0.0)
@example(name='fcc', shells=3, decimals=2, spacing=3.3, repeats=2, turn=0.0)
def test_rounded_structures_keep_their_bonds_or_are_refused(name, shells, decimals, spacing, repeats, turn):
    """Two decimals move a vector of 10 by up to 7e-4 of it, four by 7e-6, and the latter must be understood."""
    atoms = lattice(name, spacing).repeat(np.where(lattice(name).pbc, [repeats, 1, 1], 1))
    expected = ideal_bonds(name, shells) * repeats
    assert len(find_bonds(atoms, shells=shells)) == expected  # as exact as it is, it is never refused
    try:
        found = len(find_bonds(written(atoms, decimals, turn), shells=shells))
    except ValueError as error:
        if 10.0**-decimals <= 1e-5 * spacing or 'shells of neighbours are not clear' not in str(error):
            raise
    else:
        assert found == expected


@pytest.mark.parametrize('height', [8.65, 8.67, 8.7, 8.72])
def test_a_shell_split_by_coarse_rounding_is_refused_with_both_distances(height):
    typed = Atoms('Nd', cell=[[10, 0, 0], [5, height, 0], [0, 0, 20]], pbc=(1, 1, 0))
    with pytest.raises(ValueError, match='not clear') as refusal:
        find_bonds(typed)
    for distance in (10, np.hypot(5, height)):
        assert f'{distance:.9g} mm' in str(refusal.value)
    advised = float(re.search(r'\(([\d.]+) mm lies', str(refusal.value)).group(1))
    assert len(find_bonds(typed, cutoff=advised)) == 3


@pytest.mark.parametrize('decimals', range(2, 9))
def test_the_last_decimal_of_positions_is_found(decimals):
    places = np.random.default_rng(decimals).uniform(-30, 30, (9, 3))
    written = Atoms('Nd9', positions=places.round(decimals))
    assert of_bonds._last_decimal(written) == pytest.approx(10.0**-decimals if decimals < 8 else 0.0, rel=1e-12)
    assert of_bonds._last_decimal(Atoms('Nd9', positions=places)) == 0


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'shells'), [('chain', 300), ('square', 290), ('triangular', 250), ('honeycomb', 250),
                                              ('kagome', 250), ('fcc', 250), ('bcc', 290)])
def test_far_shells_of_exact_lattices_stay_apart(name, shells):
    """Their squared distances are whole numbers of one unit, and two that follow each other are 6e-4 to 3e-3 apart."""
    unit = {'bcc': 1 / 3, 'fcc': 1.0}.get(name, 1.0)
    bonds = find_bonds(lattice(name, 1.0), shells=shells)
    whole = np.unique(np.round(bonds.lengths**2 / unit).astype(int))
    assert len(whole) == shells
    np.testing.assert_allclose(np.unique(np.round(bonds.lengths, 9)) ** 2 / unit, whole, rtol=1e-7)


@settings(max_examples=40, deadline=None)
@given(excess=st.floats(2e-3, 0.1), sign=st.sampled_from([-1, 1]))
def test_crystals_with_nearly_the_ideal_axial_ratio(excess, sign):
    """hcp: six neighbours in the plane, six beside it; both groups together are twelve, by one shell or by two."""
    ratio = np.sqrt(8 / 3) * (1 + sign * excess)
    cell = 10 * np.array([[1, 0, 0], [-1 / 2, np.sqrt(3) / 2, 0], [0, 0, ratio]])
    hcp = Atoms('Nd2', cell=cell, scaled_positions=[[0, 0, 0], [1 / 3, 2 / 3, 1 / 2]], pbc=True)
    assert (find_bonds(hcp, shells=2).coordination == 12).all()
    apart = abs(np.sqrt(1 / 3 + ratio**2 / 4) - 1)
    if apart > 1.1e-2:
        assert (find_bonds(hcp).coordination == 6).all()
    elif apart < 0.9e-2:
        with pytest.raises(ValueError, match='not clear'):
            find_bonds(hcp)


def test_a_pair_far_from_the_others_is_no_scatter():
    pair_and_one = Atoms('Nd3', positions=[[0, 0, 0], [1, 0, 0], [2.5, 0, 0]])
    assert len(find_bonds(pair_and_one)) == 1


@given(seed=st.integers(0, 2**32 - 1), dense=st.floats(0.1, 0.9))
@settings(max_examples=30, deadline=None)
def test_shells_are_counted_from_what_is_free(seed, dense):
    """Free particles among held ones that crowd: the bonds of what is free are those by brute force."""
    rng = np.random.default_rng(seed)
    atoms = parallelogram(lattice('triangular'), 5, 5)
    crowd = atoms[[0]].positions + rng.uniform(0, 1, (4, 3)) * [dense, dense, 0] - [3.0, 3.0, 0]  # all within 2 mm of each other
    crowd[1] = crowd[0]
    atoms += Atoms('Nd4', positions=crowd)
    held = np.append(np.flatnonzero(atoms.get_tags()[:-4]), len(atoms) - np.arange(1, 5))
    atoms.set_constraint(FixAtoms(held))
    free = np.setdiff1d(np.arange(len(atoms)), held)
    found = find_bonds(atoms)
    near = {pair for pair in by_brute_force(atoms, 10.0 * (1 + 1e-6)) if set(pair[:2]) & set(free.tolist())}
    assert {pair for pair in as_set(found) if set(pair[:2]) & set(free.tolist())} == near
    assert found.lengths.min() > 9.9
    atoms.set_constraint()  # the control: what is free crowds
    with pytest.raises(ValueError, match='coincide'):
        find_bonds(atoms)


@pytest.mark.parametrize('particles', [46_341, 46_342, 196_610, 2**31 - 1])
def test_pairs_are_told_apart_where_their_numbers_exceed_32_bits(particles):
    """Numbers i n + j exceed 2^31 from 46 342 particles on; of 196 610 those of (0, 1) and (21 845, 21 847) differ by 2^32."""
    rng = np.random.default_rng(0)
    i = np.concatenate([[0, 21_845, particles - 2], rng.integers(0, particles - 1, 50)])
    j = np.concatenate([[1, 21_847, particles - 1], rng.integers(0, particles, 50)])
    bonds = Bonds(np.append(i, i[::-1]), np.append(j, j[::-1]), np.zeros((106, 3), int), np.ones((106, 3)), particles)
    first, second, own = bonds.distinct_pairs
    assert sorted(zip(first.tolist(), second.tolist(), strict=True)) == sorted({*zip(i.tolist(), j.tolist(), strict=True)})
    np.testing.assert_array_equal(first[own], bonds.i)
    np.testing.assert_array_equal(second[own], bonds.j)
    assert (bonds.i[1], bonds.j[1], bonds.i[2], bonds.j[2]) == (21_845, 21_847, particles - 2, particles - 1)


def test_more_particles_than_32_bits_number_are_refused():
    none = np.zeros((0, 3))
    Bonds([], [], none, none, 2**31 - 1)
    with pytest.raises(ValueError, match='at most 2147483647 particles, not 2147483648'):
        Bonds([], [], none, none, 2**31)


def test_a_free_particle_on_a_held_one_is_refused():
    atoms = Atoms('Nd3', positions=[[0, 0, 0], [10, 0, 0], [10, 0, 0]])
    atoms.set_constraint(FixAtoms([0, 1]))
    with pytest.raises(ValueError, match='coincide'):
        find_bonds(atoms)


def test_pairs_are_found_where_nothing_can_be_compiled_or_kept(monkeypatch):
    def refuse(self):
        raise PermissionError('read-only')

    monkeypatch.setattr('numba.core.caching._CacheLocator.ensure_cache_path', refuse)
    assert cells.kept(lambda x: 2 * x)(3) == 6
    assert of_bonds.compiled(1) is cells  # numba is loaded
    monkeypatch.setenv('NUMBA_DISABLE_JIT', '1')
    assert of_bonds.compiled(10**6) is None
