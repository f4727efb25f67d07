"""Linear answers about the rest that was found: structures that others have asked about, against the energy of single pairs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles import Pairs, free_basis, lattice, neighbour_vectors

from magphonon import InversePower, MagneticRepulsion, lattices, modes, relaxed, units as u, verdict
from magphonon.errors import Unstable
from magphonon.lattices.patches import RIM
from magphonon.response.normal_modes import natural_frequencies
from magphonon.stiffness import LinearSystem

LAW = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
HZ = 1e3 / (2 * np.pi)


def truth(atoms):
    """Newton's step and the squared frequencies at any positions, of atoms that stand at their anchors."""
    pairs, basis, anchors = Pairs(atoms, LAW, 12.0, dim=2), free_basis(atoms, 2), atoms.positions.copy()
    k, mass = atoms.calc.parameters.foundation, atoms.get_masses()[0]

    def hessian(x):
        return basis.T @ pairs.hessian(x) @ basis + k * np.eye(basis.shape[1])

    def step(x):
        force = pairs.forces(x) - k * (x - anchors)[:, :2]
        return (basis @ np.linalg.solve(hessian(x), basis.T @ force.ravel())).reshape(-1, 2)

    return step, lambda x: np.linalg.eigvalsh(hessian(x)) / mass


def holed(k):
    """A hexagon whose middle is missing, on springs of k."""
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.707), 60.0)
    del atoms[int(np.linalg.norm(atoms.positions, axis=1).argmin())]
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=k, cutoff=12.0)
    return atoms


@pytest.mark.parametrize('seed', range(8))
def test_a_displaced_particle_is_driven_back_unless_a_load_holds_it(seed):
    """Its force by the energy of single pairs, with strengths and springs of each particle, in cells and in patches."""
    rng = np.random.default_rng(seed)
    cell = lattice(['triangular', 'honeycomb', 'kagome', 'square'][seed % 4])
    atoms = cell.repeat((4, 4, 1)) if seed < 4 else lattices.hexagon(cell, 30.0)
    atoms.set_constraint()
    springs, strengths = rng.uniform(0.1, 0.5, (len(atoms), 2)), rng.uniform(0.5, 2, len(atoms))
    calc = MagneticRepulsion(atoms, LAW, foundation=springs, strengths=strengths, cutoff=12.0)
    moved = atoms.copy()
    moved.positions[:, :2] += rng.normal(0, 0.3, (len(atoms), 2))
    u = moved.positions - atoms.positions
    k = int(np.linalg.norm(u, axis=1).argmax())
    force = -springs[k] * u[k, :2]
    for i, j, _, vector in neighbour_vectors(atoms, 12.0):
        R = (vector + u[j] - u[i])[:2]
        force -= (i == k) * strengths[i] * strengths[j] * LAW.b * np.linalg.norm(R) ** (-LAW.a - 1) * R
    load = np.zeros((len(atoms), 3))
    load[k, :2] = -force
    for held in (False, True):
        system = LinearSystem.about(calc.about(atoms, held * load), moved)
        left = system.unbalanced(system.static + system.calc.forces_beyond_rest(system.calc.displacements(moved)))
        assert (left[k] == 0) == held


def test_a_vacancy_on_pillars_stays_or_buckles_as_its_stiffness_says():
    """The symmetric rest is a saddle below some 48 N/m: `relaxed` leaves it; on weak pillars there is no place to go."""
    stiff = relaxed(holed(0.050))
    assert stiff.saddles == 0
    assert verdict(stiff.atoms).stable
    soft = relaxed(holed(0.047))
    assert soft.saddles == 1
    assert soft.lowest > 0
    assert verdict(soft.atoms).stable
    for k, found in (0.050, stiff), (0.047, soft):
        assert found.lowest == pytest.approx(truth(holed(k))[1](found.atoms.positions)[0], rel=1e-8)
    with pytest.raises(Unstable, match='the structure buckles or slides'):  # round-off says in which way
        relaxed(holed(0.0196757))


def test_the_verdict_on_a_saddle_is_that_it_buckles():
    """The symmetric rest of the vacancy on the prototype's pillars, found by Newton's steps of the oracle alone."""
    atoms = holed(0.0196757)
    step, squares_at = truth(atoms)
    for _ in range(12):
        atoms.positions[:, :2] += step(atoms.positions)
    squares = squares_at(atoms.positions)
    assert (squares < 0).sum() == 3
    assert -np.sqrt(-squares[0]) * HZ == pytest.approx(-35.74, abs=0.005)
    assert modes(atoms).omega[0] * HZ == pytest.approx(-35.74, abs=0.005)
    judged = verdict(atoms)
    assert judged['residual'] == 0
    assert not judged.stable
    assert judged['buckling'].growth == pytest.approx(np.sqrt(-squares[0]), rel=1e-8)


def test_magnets_placed_by_hand_assemble_themselves():
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.707), 60.0)
    free = atoms.get_tags() != RIM
    atoms.positions[free, :2] += 0.8 * np.random.default_rng(0).normal(size=(free.sum(), 2))
    atoms.calc = MagneticRepulsion(atoms, LAW, cutoff=14.5)
    f = natural_frequencies(relaxed(atoms).atoms) * HZ
    assert_allclose(f[[0, -1]], [16.34, 145.0], rtol=5e-4)
