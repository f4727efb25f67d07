"""What holds for every lattice, law and wavevector, searched by hypothesis: symmetries and conservation laws."""

import numpy as np
import pytest
from ase import Atoms
from hypothesis import given, settings, strategies as st
from oracles import LAWS, lattice, small_cluster

from magphonon import InversePower, MagneticRepulsion, Yukawa
from magphonon.bands.bloch import bloch_modes
from magphonon.stiffness.bond import MODELS

PLANAR = ('chain', 'square', 'triangular', 'honeycomb', 'kagome')
EVERY = (*PLANAR, 'fcc')
HEXAGONAL = ('triangular', 'honeycomb', 'kagome')

inverse_powers = st.builds(InversePower, b=st.floats(1, 1e4), a=st.floats(0.5, 12))
laws = st.one_of(inverse_powers, st.builds(Yukawa, c=st.floats(1, 1e3), kappa=st.floats(0.01, 1)))
seeds = st.integers(0, 2**32 - 1)
angles = st.floats(0, 2 * np.pi)
fractions = st.floats(-1.5, 1.5)
wavevectors = st.tuples(fractions, fractions)
few = settings(max_examples=40, deadline=None)

# Drawn laws may be so soft or stiff that the package asks whether units were forgotten.
pytestmark = pytest.mark.filterwarnings('ignore:.*multiply SI values by their units:UserWarning')

# Round-off: of squared frequencies against the highest, of forces against that of a bond.
EXACT = 1e-12


def with_law(atoms, law, **options):
    atoms.calc = MagneticRepulsion(atoms, law, **options)
    return atoms


def rattled(atoms, seed, amplitude=1.0):
    """Displaced in the plane by up to `amplitude` mm, a tenth of the spacing."""
    moved = atoms.copy()
    moved.calc = atoms.calc
    u = np.random.default_rng(seed).uniform(-amplitude, amplitude, (len(atoms), atoms.calc.dim))
    moved.positions[:, : atoms.calc.dim] += u
    return moved


def squares(atoms, q, model='complete'):
    """Squared frequencies, negative where unstable."""
    omega = bloch_modes(atoms, q, model)[0]
    return omega * abs(omega)


def in_fractions(atoms, k):
    """Wavevectors k (rad/mm) in fractions of the reciprocal vectors: q_i = k.a_i/2 pi."""
    return np.asarray(k) @ atoms.cell.array.T / (2 * np.pi)


def highest(atoms):
    """Scale of the squared frequencies: 4 (phi'' + |phi'|/r) for each bond, and the foundation, over the mass."""
    law, r = atoms.calc.laws, atoms.calc.bonds.lengths.min()
    stiffness = 4 * len(atoms.calc.bonds) * (abs(law.d2phi(r)) + abs(law.dphi(r)) / r) + atoms.calc.parameters.foundation
    return stiffness / atoms.get_masses().min()


# Conservation

@few
@given(law=laws, seed=seeds, angle=angles, shift=st.tuples(st.floats(-50, 50), st.floats(-50, 50)))
def test_energy_knows_neither_place_nor_direction(law, seed, angle, shift):
    rest = with_law(small_cluster(), law, cutoff=18.0)
    atoms = rattled(rest, seed)
    energy, forces = atoms.get_potential_energy(), atoms.get_forces()
    atoms.rotate(np.degrees(angle), 'z', center=(3, 4, 0))
    atoms.translate([*shift, 0])
    scale = abs(law.phi(6.0)) * len(rest.calc.bonds)
    assert atoms.get_potential_energy() == pytest.approx(energy, rel=0, abs=EXACT * scale)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    # positions up to 100 mm are rounded at 1e-14 mm: 1e-14 times the stiffness of the shortest bond
    np.testing.assert_allclose(atoms.get_forces(), forces @ turn.T, rtol=0, atol=1e-13 * 8 * law.d2phi(6.0))


def test_frozen_directions_and_foundations_do_know():
    # the control: a conventional cluster resists a turn, and so does a foundation
    for options in ({'model': 'conventional'}, {'foundation': 0.1}):
        rest = with_law(small_cluster(), LAWS['magnets'], cutoff=18.0, **options)
        atoms = rest.copy()
        atoms.calc = rest.calc
        atoms.rotate(5, 'z', center=(3, 4, 0))
        assert abs(atoms.get_potential_energy()) > 1e-3


@few
@given(name=st.sampled_from(EVERY), law=laws, seed=seeds, model=st.sampled_from(MODELS))
def test_forces_sum_to_zero(name, law, seed, model):
    cell = lattice(name)
    rest = with_law(cell.repeat(np.where(cell.pbc, 3, 1)), law, model=model)
    atoms = rattled(rest, seed)
    assert abs(atoms.get_forces().sum(axis=0)).max() < EXACT * -law.dphi(7.0)
    rest.calc.set(foundation=0.1)
    # the control, and the law: springs give the momentum of the lattice away
    expected = -0.1 * rest.calc.displacements(atoms).sum(axis=0)
    total = atoms.get_forces().sum(axis=0)[: rest.calc.dim]
    np.testing.assert_allclose(total, expected, rtol=0, atol=EXACT * (1 - law.dphi(7.0)))


@few
@given(name=st.sampled_from(EVERY), law=laws, seed=seeds, model=st.sampled_from(MODELS))
def test_hessian_is_symmetric(name, law, seed, model):
    cell = lattice(name)
    rest = with_law(cell.repeat(np.where(cell.pbc, 2, 1)), law, model=model, foundation=0.1)
    H = rest.calc.get_hessian(rattled(rest, seed))
    assert abs(H - H.T).max() <= 1e-15 * abs(H).max()


@few
@given(name=st.sampled_from(EVERY), law=laws, seed=seeds)
def test_translations_cost_nothing_but_the_foundation(name, law, seed):
    cell = lattice(name)
    rest = with_law(cell.repeat(np.where(cell.pbc, 2, 1)), law, foundation=0.1)
    H = rest.calc.get_hessian(rattled(rest, seed))
    dim = rest.calc.dim
    translations = np.tile(np.eye(3)[:, :dim], (len(rest), 1))
    assert abs(H @ translations - 0.1 * translations).max() < EXACT * abs(H).max()


# Symmetries of the bands

@few
@given(name=st.sampled_from(EVERY), law=laws, q=wavevectors, model=st.sampled_from(MODELS))
def test_time_reversal(name, law, q, model):
    atoms = with_law(lattice(name), law)
    there, back = squares(atoms, [[*q, 0], [-q[0], -q[1], 0]], model)
    np.testing.assert_allclose(back, there, rtol=0, atol=EXACT * highest(atoms))


@few
@given(name=st.sampled_from(EVERY), q=wavevectors, G=st.tuples(st.integers(-3, 3), st.integers(-3, 3)))
def test_reciprocal_vectors_change_nothing(name, q, G):
    atoms = with_law(lattice(name), LAWS['magnets'])
    G = np.where(atoms.pbc, (*G, 0), 0)
    here, there = squares(atoms, [np.array([*q, 0]), np.array([*q, 0]) + G])
    np.testing.assert_allclose(there, here, rtol=0, atol=EXACT * highest(atoms))


@few
@given(name=st.sampled_from(HEXAGONAL), law=laws, q=wavevectors, model=st.sampled_from(MODELS), turns=st.integers(1, 5))
def test_six_fold_symmetry(name, law, q, model, turns):
    atoms = with_law(lattice(name), law)
    k = 2 * np.pi * np.array([*q, 0]) @ atoms.cell.reciprocal().array
    angle = turns * np.pi / 3
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    here, there = squares(atoms, [in_fractions(atoms, k), in_fractions(atoms, turn @ k)], model)
    np.testing.assert_allclose(there, here, rtol=0, atol=EXACT * highest(atoms))


def test_a_triangular_lattice_has_no_four_fold_symmetry():
    # the control: a quarter turn does change the frequencies
    atoms = with_law(lattice('triangular'), LAWS['magnets'])
    k = np.array([0.2, 0.05, 0])
    here, there = squares(atoms, [in_fractions(atoms, k), in_fractions(atoms, [-k[1], k[0], 0])])
    assert abs(there - here).max() > 1e-3 * highest(atoms)


@st.composite
def unimodular(draw):
    """Integer matrices of determinant +-1 that mix the first two lattice vectors: other bases of the same lattice."""
    step = st.sampled_from([[[1, 1], [0, 1]], [[1, 0], [1, 1]], [[0, 1], [-1, 0]], [[1, 0], [0, -1]]])
    M = np.eye(3, dtype=int)
    for part in draw(st.lists(step, min_size=1, max_size=5)):
        M[:2] = part @ M[:2]
    return M


@few
@given(name=st.sampled_from(('square', *HEXAGONAL)), law=laws, q=wavevectors, basis=unimodular(), model=st.sampled_from(MODELS))
def test_bands_do_not_depend_on_the_basis(name, law, q, basis, model):
    atoms = with_law(lattice(name), law, shells=2, foundation=0.01)
    other = atoms.copy()
    other.set_cell(basis @ atoms.cell.array)
    other.wrap()
    with_law(other, law, shells=2, foundation=0.01)
    k = 2 * np.pi * np.array([*q, 0]) @ atoms.cell.reciprocal().array
    np.testing.assert_allclose(squares(other, in_fractions(other, k), model), squares(atoms, in_fractions(atoms, k), model),
                               rtol=0, atol=10 * EXACT * highest(atoms))  # cell vectors of up to ten spacings


@few
@given(name=st.sampled_from(('honeycomb', 'kagome')), law=laws, q=wavevectors, seed=seeds)
def test_order_of_the_particles_does_not_matter(name, law, q, seed):
    atoms = lattice(name)
    rng = np.random.default_rng(seed)
    atoms.set_masses(rng.uniform(0.5, 2, len(atoms)))
    order = rng.permutation(len(atoms))
    other = with_law(atoms[order], law)
    with_law(atoms, law)
    np.testing.assert_allclose(squares(other, [*q, 0]), squares(atoms, [*q, 0]), rtol=0, atol=EXACT * highest(atoms))

    moved = rattled(atoms, seed)
    there = other.copy()
    there.calc = other.calc
    there.positions = moved.positions[order]
    np.testing.assert_allclose(there.get_forces(), moved.get_forces()[order], rtol=0, atol=EXACT * -law.dphi(7.0))
    np.testing.assert_allclose(there.get_potential_energies(), moved.get_potential_energies()[order],
                               rtol=0, atol=EXACT * abs(law.phi(7.0)))


@pytest.mark.parametrize('model', MODELS)
@pytest.mark.parametrize('name', EVERY)
def test_supercell_folds_the_zone(name, model):
    atoms = with_law(lattice(name), LAWS['magnets'], foundation=0.01, shells=2)
    cells = np.where(atoms.pbc, 4, 1) if name != 'fcc' else np.array([4, 4, 1])
    large = atoms.repeat(cells)
    large.calc = atoms.calc.on(large)
    steps = np.stack(np.meshgrid(*(np.arange(n) / n for n in cells)), axis=-1).reshape(-1, 3)
    assert len(steps) == (4 if name == 'chain' else 16)
    folded = np.sort(squares(atoms, steps, model).ravel())
    np.testing.assert_allclose(squares(large, [0, 0, 0], model)[0], folded, rtol=0, atol=EXACT * highest(atoms))
    # any other wavevector folds as well
    q = np.array([0.13, -0.2, 0]) * (cells > 1)
    folded = np.sort(squares(atoms, steps + q / cells, model).ravel())
    np.testing.assert_allclose(squares(large, q, model)[0], folded, rtol=0, atol=EXACT * highest(atoms))
    # the control: a twentieth of a mesh step further on the spectrum is another one
    elsewhere = np.sort(squares(atoms, steps + (q + 0.05 * (cells > 1)) / cells, model).ravel())
    assert abs(elsewhere - folded).max() > 1e-5 * highest(atoms)


@few
@given(name=st.sampled_from(EVERY), law=laws, q=wavevectors, k=st.floats(1e-6, 1e3), model=st.sampled_from(MODELS))
def test_a_foundation_shifts_the_squares_by_k_over_m(name, law, q, k, model):
    atoms = with_law(lattice(name), law)
    free = squares(atoms, [*q, 0], model)
    atoms.calc.set(foundation=k)
    mass = atoms.get_masses()[0]
    np.testing.assert_allclose(squares(atoms, [*q, 0], model), free + k / mass, rtol=0, atol=1e-14 * highest(atoms))


@few
@given(law=inverse_powers, q=wavevectors, scale=st.floats(0.1, 10), mass=st.floats(0.1, 10))
def test_frequencies_scale_with_the_root_of_stiffness_over_mass(law, q, scale, mass):
    # with f = b r^-a, lengths times s: omega^2 times s^-(a+1); and 1/M
    one, other = with_law(lattice('kagome'), law), with_law(lattice('kagome', spacing=10 * scale, mass=0.7 * mass), law)
    expected = squares(one, [*q, 0]) * scale ** (-law.a - 1) / mass
    np.testing.assert_allclose(squares(other, [*q, 0]), expected, rtol=0, atol=EXACT * highest(other))


@few
@given(name=st.sampled_from(EVERY), law=laws, q=wavevectors)
def test_static_repulsion_softens_every_mode(name, law, q):
    # phi' < 0 makes D* negative semidefinite, so that by Weyl's inequality no branch rises
    atoms = with_law(lattice(name), law)
    complete, conventional = (squares(atoms, [*q, 0], model) for model in MODELS)
    assert (complete <= conventional + EXACT * highest(atoms)).all()


def test_bloch_waves_are_waves_of_the_forces():
    # a small wave of one mode is pushed by -M omega^2 u everywhere: bands and calculator are one model
    atoms = with_law(lattice('kagome'), LAWS['magnets'], foundation=0.01)
    large = atoms.repeat((6, 6, 1))
    large.calc = atoms.calc.on(large)
    q = np.array([1 / 6, 2 / 6, 0])
    omega, vectors = bloch_modes(atoms, q, vectors=True)
    cells = np.array([[a, b, 0] for a in range(6) for b in range(6)])  # in the order of `repeat`
    for w, mode in zip(omega[0], vectors[0], strict=True):
        u = 1e-6 * np.real(np.exp(2j * np.pi * cells @ q)[:, None, None] * mode / np.sqrt(0.7)).reshape(-1, 2)
        moved = large.copy()
        moved.calc = large.calc
        moved.positions[:, :2] += u
        # next order u/L0 = 1e-7, round-off of positions 1e-14/1e-6
        assert abs(moved.get_forces()[:, :2] + 0.7 * w * abs(w) * u).max() < 1e-6 * highest(atoms) * abs(u).max()


def test_left_handed_cells_are_cells():
    atoms = with_law(lattice('honeycomb'), LAWS['magnets'])
    other = Atoms('Nd2', positions=atoms.positions, masses=atoms.get_masses(), cell=atoms.cell.array[[1, 0, 2]], pbc=atoms.pbc)
    with_law(other, LAWS['magnets'])
    np.testing.assert_allclose(squares(other, [0.2, 0.1, 0]), squares(atoms, [0.1, 0.2, 0]), rtol=0, atol=EXACT * highest(atoms))
