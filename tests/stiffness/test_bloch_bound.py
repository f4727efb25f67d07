"""Proofs of stability by Bloch waves, against dense algebra and against the lowest wave of a fine mesh."""

import numpy as np
import pytest
from ase.constraints import FixAtoms
from oracles import lattice
from structures import L0, REACHES, structure

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.stiffness.lowest import ROUND_OFF, proves_stable
from magphonon.stiffness.rest import LinearSystem


def held(name, shells, foundation, a, **own):
    """A patch of a lattice whose rim is held deep enough for every free particle to have all its bonds."""
    cell = lattice(name, L0)
    counts = np.where(cell.pbc, 2 * shells + 5, 1)
    atoms = cell.repeat(counts)
    if not atoms.pbc.all():  # in space every structure repeats; there held layers part the patch from its images
        atoms.pbc = False
    along = np.arange(len(atoms))[:, None] // [counts[1] * counts[2], counts[2], 1] % counts
    rim = ((np.minimum(along, counts - 1 - along) < shells) & (counts > 1)).any(axis=1)
    atoms.set_constraint(FixAtoms(np.flatnonzero(rim)))
    law = InversePower(0.2 * L0**a, a)
    atoms.calc = MagneticRepulsion(atoms, law, foundation=foundation, cutoff=REACHES[name][shells - 1] * L0, **own)
    return atoms


def softest(name, shells, a):
    """The foundation that the endless lattice needs, by an ordinary sum over bonds on a fine mesh of waves, N/mm."""
    cell = lattice(name, L0)
    images = np.indices([9] * 3).reshape(3, -1).T - 4
    R = images[(images[:, ~cell.pbc] == 0).all(axis=1)] @ cell.cell.array
    r = np.linalg.norm(R, axis=1)
    near = (r > 0) & (r < REACHES[name][shells - 1] * L0)
    R, r = R[near], r[near]
    dim = 3 if cell.pbc.all() else 2
    n = (R / r[:, None])[:, :dim]
    nn = n[:, :, None] * n[:, None, :]
    f = 0.2 * (L0 / r) ** a
    K = (a * f / r)[:, None, None] * nn - (f / r)[:, None, None] * (np.eye(dim) - nn)
    axes = [np.linspace(0, 1, {1: 2001, 2: 181, 3: 41}[cell.pbc.sum()]) if p else [0.0] for p in cell.pbc]
    q = 2 * np.pi * np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3) @ cell.cell.reciprocal().array
    return -np.linalg.eigvalsh(np.einsum('qb,bxy->qxy', 1 - np.cos(q @ R.T), K)).min()


def test_never_proves_what_is_not_so():
    proofs = 0
    for seed in range(60):
        atoms = structure(seed, most=40, foundation=(0.03, 0.1, 0.3), unlike=False, relaxed=False, moved=seed % 3 == 0).atoms
        system = LinearSystem.about(atoms.calc, atoms)
        if system.directions and proves_stable(system):
            squares = np.linalg.eigvalsh(system.K.toarray())
            assert squares[0] >= -ROUND_OFF * abs(squares).max()
            proofs += 1
    assert proofs > 4


@pytest.mark.parametrize('name', ['chain', 'square', 'triangular', 'fcc', 'bcc'])
@pytest.mark.parametrize('shells', [1, 2])
def test_on_each_side_of_the_threshold(name, shells):
    a = np.random.default_rng([len(name), shells]).uniform(2, 9)
    needed = softest(name, shells, a)  # zero where the lattice holds itself: waves as long as one likes cost nothing
    assert needed > 0.01 or abs(needed) < 1e-12
    assert proves_stable(LinearSystem.of(held(name, shells, max(1.02 * needed, 0.0), a)))
    assert needed < 0.01 or not proves_stable(LinearSystem.of(held(name, shells, 0.98 * needed, a)))


def test_what_is_no_cutting_of_one_lattice_is_left_to_the_factors():
    rng = np.random.default_rng(0)
    whole = held('triangular', 1, 0.1, 4.0)
    free = np.setdiff1d(np.arange(len(whole)), whole.constraints[0].index)
    assert proves_stable(LinearSystem.of(whole))
    hole, rims, scattered = whole.copy(), whole.copy(), whole.copy()
    del hole[int(free[0])]
    rims.set_constraint()
    scattered.positions[free, :2] += 1e-3 * rng.normal(size=(len(free), 2))
    stronger = np.where(np.arange(len(whole)) == free[0], 1.5, 1.0)
    others = [held('triangular', 1, 0.1, 4.0, strengths=stronger), lattices.hexagon(lattices.honeycomb(L0, 0.7), 30.0)]
    for atoms in (hole, rims, scattered, *others):
        if atoms.calc is None:
            atoms.calc = MagneticRepulsion(atoms, InversePower(0.2 * L0**4, 4.0), foundation=0.1, cutoff=1.3 * L0)
        system = LinearSystem.about(atoms.calc, atoms)
        assert not proves_stable(system)
        assert system.stable == (np.linalg.eigvalsh(system.K.toarray())[0] > 0)
