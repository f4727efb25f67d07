"""Motions that cost no energy, counted by the verdict, against dense eigenvalues of matrices assembled bond by bond."""

from itertools import product

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from structures import few_first

from magphonon import verdict
from magphonon.interactions import Cable, Spring
from magphonon.stiffness import net


def drawn(seed):
    """A jittered grid in the plane or in space, periodic along some axes, with removed bonds, held nodes and stiffnesses of bars
    at their natural lengths that differ by a factor of 10; the bars as (i, j, shift, k, length).
    """
    rng = np.random.default_rng(seed)
    dim = 2 + seed % 2
    pbc = np.append(rng.random(dim) < 0.4, [False] * (3 - dim))
    shape = np.where(pbc, 3, rng.integers(2, 4 if dim == 2 else 3, 3)) if dim == 3 else np.append(np.where(pbc[:2], 3, 3), 1)
    grid = np.array(list(np.ndindex(*shape)))
    nodes = grid + np.pad(rng.uniform(-0.2, 0.2, (len(grid), dim)), ((0, 0), (0, 3 - dim)))
    bars = []
    for i, j in product(range(len(grid)), repeat=2):
        for shift in product(*((-1, 0, 1) if along else (0,) for along in pbc)):
            steps = abs(grid[j] + shift * shape - grid[i])
            if i < j and steps.max() == 1 and (steps.sum() == 1 or rng.random() < 0.4) and rng.random() < 0.8:
                length = np.linalg.norm(nodes[j] + shift * shape - nodes[i])
                bars.append((i, j, shift, 10 ** rng.uniform(0, 1), length))
    atoms = Atoms(f'H{len(grid)}', nodes, cell=shape, pbc=pbc, masses=rng.uniform(0.5, 2, len(grid)))
    atoms.set_constraint(FixAtoms(rng.choice(len(grid), rng.integers(0, 3), replace=False)))
    return atoms, bars, dim, rng


def stiffness(atoms, bars, dim, q, spring=0.0, without=()):
    """K(q) of the free nodes by the sum over bars, entry by entry, with the springs of a foundation."""
    n = len(atoms)
    K = np.zeros((n, dim, n, dim), complex)
    for at, (i, j, shift, k, _) in enumerate(bars):
        along = (atoms.positions[j] + shift @ atoms.cell.array - atoms.positions[i])[:dim]
        block = 0.0 if at in without else k * np.outer(along, along) / (along @ along)
        phase = np.exp(2j * np.pi * np.dot(q, shift))
        K[i, :, i, :] += block
        K[j, :, j, :] += block
        K[i, :, j, :] -= block * phase
        K[j, :, i, :] -= block * np.conj(phase)
    free = np.setdiff1d(np.arange(n), np.concatenate([c.index for c in atoms.constraints]))
    K = K[free][:, :, free].reshape(len(free) * dim, -1)
    return K + spring * np.eye(len(K)), free


def motions(atoms, bars, dim, spring=0.0, without=()):
    """Number of motions without energy besides rigid ones at the wave with most, and that of rigid ones of a finite structure."""
    found = []
    for m in product(*(range(6) if along else (0,) for along in atoms.pbc)):
        K, free = stiffness(atoms, bars, dim, np.array(m) / 6, spring, without)
        values, vectors = np.linalg.eigh(K)
        scale = max([bar[3] for at, bar in enumerate(bars) if at not in without])
        assert not ((1e-13 * scale < abs(values)) & (abs(values) < 1e-11 * scale)).any()  # a factor 10 from the threshold
        null = vectors[:, values < 1e-12 * scale]
        found.append(null.shape[1])
        if not any(m):
            x, held = atoms.positions[free], len(free) < len(atoms)
            periods = np.count_nonzero(atoms.pbc)
            axes = np.eye(3)[atoms.pbc] if periods == 1 else np.eye(3) * (periods == 0)
            moves = [np.tile(e, (len(free), 1)) for e in np.eye(3)] + [np.cross(e, x - atoms.positions[0]) for e in axes]
            if held:  # and the held nodes must not move
                h = np.setdiff1d(np.arange(len(atoms)), free)
                every = [np.tile(e, (len(h), 1)) for e in np.eye(3)]
                every += [np.cross(e, atoms.positions[h] - atoms.positions[0]) for e in axes]
                A = np.array([move[:, :dim].ravel() for move in every]).T
                _, s, vt = np.linalg.svd(A)
                moves = [sum(c * move for c, move in zip(v, moves, strict=True)) for v in vt[np.count_nonzero(s > 1e-9):]]
            R = np.array([move[:, :dim].ravel() for move in moves]).reshape(-1, len(K)).T
            common = (np.linalg.matrix_rank(R, 1e-9) + null.shape[1]
                      - np.linalg.matrix_rank(np.hstack([R, null]), 1e-9)) if R.size else 0
            found[-1] -= common
    return max(found), 0 if atoms.pbc.any() else common


@pytest.mark.parametrize('seed', few_first(range(4, 64), 5))
def test_counts_of_drawn_bars(seed):
    atoms, bars, dim, _ = drawn(seed)
    stiffest = max(bar[3] for bar in bars)
    for spring in (0.0, 1e-15, 1e-9):  # of the stiffest bar: nothing, nothing, and a stiffness
        structure = net(atoms, [(i, j, shift, Spring(k, L)) for i, j, shift, k, L in bars], dim=dim,
                        foundation=spring * stiffest)
        judged = verdict(structure)
        found, (count, rigid) = judged.case.inside.free, motions(atoms, bars, dim, spring * stiffest)
        assert (found.count, found.rigid) == (count, rigid)
        assert judged.stable == (count == 0)
        assert judged.fine == judged.stable
        words = judged.finding('buckling').words
        assert ('mechanism' in words, f'{count} motion' in words) == (count > 0, count > 0)
        assert ('rigid motion' in words) == (rigid > 0)
    assert count == rigid == 0


@pytest.mark.parametrize('seed', few_first(range(4, 44), 4))
def test_slack_members_are_named_if_they_would_resist(seed):
    atoms, bars, dim, rng = drawn(seed)
    slack = rng.choice(len(bars), rng.integers(1, 4), replace=False)
    members = [(i, j, shift, Cable(k, 1.1 * L) if at in slack else Spring(k, L)) for at, (i, j, shift, k, L) in enumerate(bars)]
    judged = verdict(net(atoms, members, dim=dim))
    found, (count, rigid) = judged.case.inside.free, motions(atoms, bars, dim, without=slack)
    assert (found.count, found.rigid) == (count, rigid)
    taut, loose = (np.count_nonzero(np.linalg.eigvalsh(stiffness(atoms, bars, dim, found.q, 0.0, without)[0]) < 1e-11)
                   for without in ((), slack))
    assert bool(found.slack) == (count > 0 and taut < loose)
    assert ('slack members would resist' in judged.finding('buckling').words) == bool(found.slack)
