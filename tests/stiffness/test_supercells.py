"""A calculator answers for the supercells of others, oblique, displaced, in any order and image, and refuses the rest."""

import pickle

import numpy as np
import pytest
from ase import Atoms
from ase.build import make_supercell
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices
from magphonon.interactions import Yukawa
from magphonon.stiffness import AllNeighbours

LAW = InversePower(1.0, 4.0)
CELLS = {'chain': lambda: lattices.chain(1.0, 1.0), 'square': lambda: lattices.square(1.0, 1.0),
         'triangular': lambda: lattices.triangular(1.0, 1.0), 'honeycomb': lambda: lattices.honeycomb(1.0, 1.0),
         'kagome': lambda: lattices.kagome(1.0, 1.0), 'fcc': lambda: lattices.fcc(1.0, 1.0)}


def drawn(rng, name):
    """A cell with everything of its own at each site, and a whole matrix that repeats it along its periods."""
    cell = CELLS[name]()
    n, dim = len(cell), 3 if cell.pbc.all() else 2
    cell.set_masses(rng.uniform(0.5, 2, n))
    cell.set_tags(rng.integers(0, 2, n))
    laws = {(0, 0): LAW, (0, 1): InversePower(1.3, 3.0), (1, 1): Yukawa(1.0, 0.8)}
    load = np.zeros((n, 3))
    load[:, :dim] = rng.normal(scale=0.02, size=(n, dim))
    anchors = cell.positions.copy()
    anchors[:, :dim] += rng.normal(scale=0.02, size=(n, dim))
    cell.calc = MagneticRepulsion(cell, laws, foundation=rng.uniform(4, 8, (n, dim)), strengths=rng.uniform(0.8, 1.2, n),
                                  load=load, anchors=anchors, shells=int(rng.integers(1, 3)))
    periods = np.flatnonzero(cell.pbc)
    T = np.eye(3, dtype=int)
    while not 4 <= np.linalg.det(T) <= 30:
        T[np.ix_(periods, periods)] = rng.integers(-2, 6, (len(periods), len(periods)))
    return cell, T


def disguised(rng, big, cell):
    """The same structure as others hand it over: another order, images, origin, periodicity; no masses, tags, constraints."""
    order = rng.permutation(len(big))
    other = Atoms(big.symbols[order], positions=big.positions[order], cell=big.cell, pbc=True)
    other.positions += rng.integers(-2, 3, (len(big), 3)) * cell.pbc @ big.cell.array
    other.positions += rng.integers(-3, 4, 3) * cell.pbc @ cell.cell.array
    return other, order


@pytest.mark.parametrize('name', CELLS)
@pytest.mark.parametrize('seed', range(3))
def test_forces_are_those_of_the_calculator_made_for_the_supercell(name, seed):
    rng = np.random.default_rng([seed, len(name)])
    cell, T = drawn(rng, name)
    big = make_supercell(cell, T)
    big.calc = cell.calc.on(big)
    dim = cell.calc.dim
    big.positions[:, :dim] += 0.1 * rng.uniform(-1, 1, (len(big), dim))
    want, energy = big.get_forces(), big.get_potential_energy()
    for _ in range(2):
        other, order = disguised(rng, big, cell)
        other.calc = cell.calc
        assert_allclose(other.get_forces(), want[order], atol=1e-12 * abs(want).max())
        assert other.get_potential_energy() == pytest.approx(energy, rel=1e-12, abs=1e-13)
    assert abs(want[order] - want).max() > 1e-3 * abs(want).max()  # the order matters
    assert len(cell.calc.supercells) <= 4


def test_strained_supercells_have_the_energy_and_stress_of_strained_cells():
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, LAW)
    answers = []
    for atoms in (cell.copy(), cell.repeat((4, 3, 1))):
        atoms.set_cell(atoms.cell.array @ np.diag([1.01, 0.98, 1]), scale_atoms=True)
        atoms.calc = cell.calc
        answers.append([atoms.get_potential_energy() / len(atoms), *atoms.get_stress()])
    assert_allclose(answers[1], answers[0], rtol=1e-12, atol=1e-15)


def test_all_neighbours_answer_too():
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = AllNeighbours(cell, LAW, foundation=2.0)
    big = make_supercell(cell, [[2, 1, 0], [-1, 2, 0], [0, 0, 1]])
    big.positions[2, 0] += 0.05
    own = big.copy()
    own.calc = cell.calc.on(make_supercell(cell, [[2, 1, 0], [-1, 2, 0], [0, 0, 1]]))
    big.calc = cell.calc
    assert_allclose(big.get_forces(), own.get_forces(), atol=1e-12)


def test_the_calculator_follows_its_settings_and_is_pickled_without_supercells():
    cell = lattices.square(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=5.0)
    big = cell.repeat((3, 3, 1))
    big.positions[4, 0] += 0.01
    big.calc = cell.calc
    before = big.get_forces()
    cell.calc.set(foundation=6.0)
    assert_allclose((big.get_forces() - before)[4, 0], -0.01, rtol=1e-9)  # another N/mm
    assert not pickle.loads(pickle.dumps(cell.calc)).supercells
    assert cell.calc.supercells


BIG = lattices.triangular(1.0, 1.0).repeat((3, 3, 1))


def moved(k, by):
    atoms = BIG.copy()
    atoms.positions[k] += by
    return atoms


def strained():
    atoms = BIG.copy()
    atoms.set_cell(atoms.cell.array * [1.01, 1.01, 1], scale_atoms=True)
    return atoms


def rotated():
    atoms = BIG.copy()
    atoms.rotate(20, 'z', rotate_cell=True)
    return atoms


@pytest.mark.parametrize(('atoms', 'words'), [
    (moved(4, [0.0, 0.56, 0]), 'more than half the shortest bond'),
    (moved(4, BIG.positions[5] - BIG.positions[4] + [0.05, 0, 0]), 'particles 4 and 5 are at one site'),
    (rotated(), 'not 9'),
    (lattices.triangular(1.0, 1.0).repeat((3, 3, 2)), 'not 18'),
    (BIG[1:], 'not 8'),
    (strained(), 'anchored'),
])
def test_what_is_no_supercell_is_refused(atoms, words):
    cell = lattices.triangular(1.0, 1.0)
    atoms.calc = MagneticRepulsion(cell, LAW, foundation=1.0)
    with pytest.raises(ValueError, match=words):
        atoms.get_forces()


@pytest.mark.parametrize('distance', [0.499, 0.501])
def test_half_a_bond_is_the_border(distance):
    cell = lattices.square(1.0, 1.0)
    big = cell.repeat((3, 3, 1))
    big.positions[4, 0] += distance
    big.calc = MagneticRepulsion(cell, LAW, foundation=1.0)
    if distance < 0.5:
        assert np.isfinite(big.get_forces()).all()
    else:
        with pytest.raises(ValueError, match=r'at one site|half the shortest'):
            big.get_forces()


@pytest.mark.parametrize('name', ['triangular', 'honeycomb'])
def test_phonons_of_ase_and_phonopy_take_the_calculator_of_the_cell(name, tmp_path):
    """As their users do: the cell's calculator, nothing else; ASE's default sum rule would erase the foundation."""
    from ase.phonons import Phonons
    from phonopy import Phonopy
    from phonopy.structure.atoms import PhonopyAtoms

    cell = CELLS[name]()
    cell.calc = MagneticRepulsion(cell, LAW, foundation=6.0)
    q = np.array([[0.3, 0.1, 0.0], [0.5, 0.0, 0.0]])
    expected = analytic_bands(cell, cell.cell.bandpath(special_points={'A': q[0], 'B': q[1]}, path='AB', npoints=2,
                                                       pbc=cell.pbc)).omega**2

    phonons = Phonons(cell, cell.calc, supercell=(4, 4, 1), delta=1e-4, name=str(tmp_path / 'p'))
    phonons.run()
    phonons.read(method='standard', acoustic=False)
    planar = [3 * k + x for k in range(len(cell)) for x in range(2)]
    of_ase = [np.linalg.eigvalsh(phonons.compute_dynamical_matrix(k, phonons.D_N)[np.ix_(planar, planar)]) for k in q]
    assert_allclose(of_ase, expected, rtol=1e-6)

    phonon = Phonopy(PhonopyAtoms(symbols=cell.get_chemical_symbols(), cell=cell.cell.array, positions=cell.positions,
                                  masses=cell.get_masses()), np.diag([4, 4, 1]), primitive_matrix='P', is_symmetry=False)
    phonon.generate_displacements(distance=1e-4, is_plusminus=True, is_diagonal=False)
    forces = []
    for moved in phonon.supercells_with_displacements:
        atoms = Atoms(moved.symbols, positions=moved.positions, cell=moved.cell, pbc=True, calculator=cell.calc)
        if abs(atoms.positions[:, 2] - cell.positions[0, 2]).max() > 0:  # phonopy moves particles out of the plane too
            atoms.positions[:, 2] = cell.positions[0, 2]
        forces.append(atoms.get_forces())
    phonon.forces = forces
    phonon.produce_force_constants()
    matrices = phonon.run_qpoints(q, with_dynamical_matrices=True).dynamical_matrices
    found = [np.linalg.eigvalsh(matrix[np.ix_(planar, planar)]) for matrix in matrices]
    assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize('name', [*CELLS, 'patch', 'walled'])
@pytest.mark.parametrize('used', [False, True])
def test_its_own_particles_in_another_order_are_refused(name, used):
    rng = np.random.default_rng(len(name))
    if name in CELLS:
        cell, T = drawn(rng, name)
        own = make_supercell(cell, T)
        own.calc = cell.calc.on(own)
    else:
        own = lattices.rectangle(lattices.honeycomb(1.0, 1.0), 6.0, 5.0)
        del own.constraints
        if name == 'walled':
            own.cell, own.pbc = [20.0, 20.0, 20.0], (1, 0, 0)
        own.calc = MagneticRepulsion(own, LAW, foundation=4.0)
    at_rest, calc = own.get_forces() if used else None, own.calc
    for order in np.arange(len(own))[::-1], rng.permutation(len(own)), np.array([1, 0, *range(2, len(own))]):
        other = own[order]
        other.positions[:, 0] += 0.01 * rng.uniform(-1, 1, len(own))
        other.calc = calc
        if not used:  # motion excuses nothing at the first call
            other.set_momenta(np.pad(rng.normal(size=(len(own), 2)), ((0, 0), (0, 1))))
        for _ in range(2):  # a refusal does not make it the last call
            with pytest.raises(ValueError, match=r'in another order .* is at the site of particle'):
                other.get_forces()
    if used:
        assert_allclose(own.get_forces(), at_rest)


def test_particles_that_move_together_or_change_places_by_and_by_are_themselves():
    own = lattices.square(1.0, 1.0).repeat((5, 5, 1))
    own.calc = MagneticRepulsion(own, LAW)
    own.positions += (1.0, 0, 0)  # onto the sites of others, all of them
    assert_allclose(own.get_forces(), 0, atol=1e-12)
    own.positions += np.random.default_rng(0).integers(-2, 3, (25, 3)) @ (own.cell.array * own.pbc)
    assert_allclose(own.get_forces(), 0, atol=1e-12)
    pair = Atoms('Nd2', positions=[(-0.5, 0, 0), (0.5, 0, 0)], masses=[1.0, 1.0])
    pair.calc = MagneticRepulsion(pair, LAW, foundation=1.0)
    for angle in np.linspace(0, np.pi, 9):  # half a turn: each comes to the place of the other
        pair.positions[1] = np.array([np.cos(angle), np.sin(angle), 0]) / 2
        pair.positions[0] = -pair.positions[1]
        forces = pair.get_forces()
    assert_allclose(forces[:, 0], [0.0, 0.0], atol=1e-12)  # springs of 1 pulled by 1, against f = 1: as the sum along x says
