"""Linear answers about the rest that was found: structures that others have asked about, against the energy of single pairs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles import LATTICES, LAWS, Pairs, free_basis, lattice, neighbour_vectors

from magphonon import InversePower, MagneticRepulsion, lattices, modes, relaxed, units as u, verdict
from magphonon.errors import Unstable
from magphonon.lattices import bonds as of_bonds, cells
from magphonon.lattices.patches import RIM
from magphonon.response.normal_modes import natural_frequencies
from magphonon.stiffness.matrices import MODELS

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


@pytest.mark.parametrize('seed', range(14))
def test_forces_and_energies_are_sums_over_pairs_compiled_or_not(seed, monkeypatch):
    """With holes, and strengths, springs and loads of each particle, in any image; both ways agree to the last bit."""
    rng, model = np.random.default_rng(seed), MODELS[seed % 3 == 1]
    cell, law = lattice(LATTICES[seed % 7]), LAWS[sorted(LAWS)[seed % 8]]
    atoms = lattices.hexagon(cell, 30.0) if seed > 6 and cell.pbc.sum() == 2 else cell.repeat(np.where(cell.pbc, 4, 1))
    del atoms[int(rng.integers(len(atoms)))]
    n, dim = len(atoms), 3 if cell.pbc.all() else 2
    springs, strengths, load = rng.uniform(0.1, 0.5, (n, dim)), rng.uniform(0.5, 2, n), np.zeros((n, 3))
    load[:, :dim] = rng.normal(size=(n, dim))
    atoms.calc = MagneticRepulsion(atoms, law, foundation=springs, strengths=strengths, load=load, cutoff=12.0, model=model)
    u = np.where(np.arange(3) < dim, rng.normal(0, 0.3, (n, 3)), 0.0)
    energies, forces = (springs * u[:, :dim] ** 2).sum(axis=1) / 2 - (load * u).sum(axis=1), load.copy()
    forces[:, :dim] -= springs * u[:, :dim]
    i, j, _, R = map(np.array, zip(*neighbour_vectors(atoms, 12.0, images=1), strict=True))
    r0, s = np.linalg.norm(R, axis=1), strengths[i] * strengths[j]
    vectors = R + u[j] - u[i] if model == 'complete' else R * (1 + np.einsum('bx,bx->b', R, u[j] - u[i]) / r0**2)[:, None]
    r = np.linalg.norm(vectors, axis=1)
    np.add.at(forces, i, (s * law.dphi(r) / r)[:, None] * vectors)
    np.add.at(energies, i, s * (law.phi(r) - law.phi(r0)) / 2)
    size = max(1.0, abs(s * law.phi(r)).max(), abs(s * law.dphi(r)).max())  # of terms that cancel
    atoms.positions += u + (rng.integers(0, 2, (n, 3)) * atoms.pbc) @ atoms.cell.array
    found = []
    for passes in (cells, None):
        monkeypatch.setattr(of_bonds, 'compiled', lambda particles, passes=passes: passes)
        atoms.calc.reset()
        found.append(np.column_stack([atoms.get_potential_energies(), atoms.get_forces(apply_constraint=False)]))
    np.testing.assert_array_equal(*found)
    assert_allclose(found[0], np.column_stack([energies, forces]), rtol=0, atol=1e-13 * size)


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
