"""Nets, ions and clusters, drawn: forces, Hessian, modes and stability beside sums written out here."""

from itertools import combinations, combinations_with_replacement, product

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from numpy.testing import assert_allclose

from magphonon import InversePower, analytic_bands, lattices, modes, relaxed, verdict
from magphonon.errors import NotAtRest
from magphonon.interactions import Cable, Spring, Yukawa
from magphonon.lattices.bonds import pairs_within
from magphonon.stiffness import elastic_moduli, net, self_stress

OWN = {  # slope and curvature of each law, written again
    Spring: lambda law, r: (law.k * (r - law.L0), law.k),
    Cable: lambda law, r: (law.k * max(r - law.L0, 0.0), law.k * (r > law.L0)),
    InversePower: lambda law, r: (-law.b * r**-law.a, law.a * law.b * r ** (-law.a - 1)),
    Yukawa: lambda law, r: (-law.c * np.exp(-law.kappa * r) * (law.kappa / r + 1 / r**2),
                            law.c * np.exp(-law.kappa * r) * (law.kappa**2 / r + 2 * law.kappa / r**2 + 2 / r**3)),
}


def oracle(atoms, members, springs, anchors, dim, static=True, q=(0, 0, 0)):
    """Forces and stiffness of members between particles, their images and a trap, of one wavevector q in reciprocal vectors or
    of many: loops over pairs, blocks of three by three.
    """
    n = len(atoms)
    F, K = np.zeros((n, 3)), np.zeros((*np.shape(q)[:-1], n, 3, n, 3), complex if np.any(q) else float)
    for i, j, shift, law in members:
        R = atoms.positions[j] + np.array(shift) @ atoms.cell.array - atoms.positions[i]
        r = np.sqrt(R @ R)
        slope, curvature = OWN[type(law)](law, r)
        nn = np.outer(R, R) / r**2
        block = curvature * nn + static * slope / r * (np.eye(3) - nn)
        F[i] += slope * R / r
        F[j] -= slope * R / r
        phase = np.multiply.outer(np.exp(2j * np.pi * np.dot(q, shift)), np.eye(3)) if np.any(q) else np.eye(3)
        for a, b, factor in ((i, i, np.eye(3)), (j, j, np.eye(3)), (i, j, -phase), (j, i, -np.conj(phase))):
            K[..., a, :, b, :] += factor @ block
    F -= springs * (atoms.positions - anchors)
    for i in range(n):
        K[..., i, :, i, :] += np.diag(springs)
    return F[:, :dim], K[..., :dim, :, :dim].reshape(*np.shape(q)[:-1], n * dim, n * dim)


def drawn_law(rng, r):
    """A law of either sign for members about as long as r."""
    laws = [Spring(rng.uniform(1, 4), r * rng.uniform(0.8, 1.2)), Cable(rng.uniform(1, 4), r * rng.uniform(0.8, 1.2)),
            InversePower(rng.uniform(0.1, 1), rng.uniform(1.5, 5)), Yukawa(rng.uniform(0.1, 1), rng.uniform(0.3, 2))]
    return laws[rng.integers(len(laws))]


def drawn(seed):
    """A structure in one, two or three dimensions, finite or periodic, with laws of both signs, in a trap or on springs."""
    rng = np.random.default_rng(seed)
    dim, n = int(rng.choice([2, 3])), int(rng.integers(4, 8))
    line = rng.random() < 0.25
    scatter = [0.2, 0.0, 0.0] if line else [0.2, 1.0, dim == 3]
    atoms = Atoms(f'H{n}', rng.uniform(0, 3, (n, 3)) * scatter + np.arange(n)[:, None] * [1.3, 0, 0],
                  masses=rng.uniform(0.5, 2, n), cell=[14.0, 12.0, 11.0], pbc=[rng.random() < 0.5, False, False])
    pairs = [pair for pair in combinations(range(n), 2) if rng.random() < 0.7 or pair[1] == pair[0] + 1]
    members = []
    for i, j in pairs:
        r = np.linalg.norm(atoms.positions[j] - atoms.positions[i])
        members.append((i, j, (0, 0, 0), drawn_law(rng, r)))
    if atoms.pbc[0]:
        members.append((0, n - 1, (-1, 0, 0), Spring(2.0, 5.0)))
        members = [member for k, member in enumerate(members) if member[:2] != (0, n - 1) or k == len(members) - 1]
    trapped = rng.random() < 0.5
    springs = np.array([*rng.uniform(0.5, 3, 3)]) * ([1, 1, dim == 3])
    anchors = np.broadcast_to(atoms.positions.mean(axis=0), (n, 3)) if trapped and not atoms.pbc[0] else atoms.positions
    return atoms, members, springs, np.array(anchors), dim


@pytest.mark.parametrize('seed', range(24))
def test_forces_hessian_modes_and_stability_are_those_of_sums_over_members(seed):
    atoms, members, springs, anchors, dim = drawn(seed)
    F, K = oracle(atoms, members, springs, anchors, dim)
    built = net(atoms, members, foundation=[springs[:dim]], anchors=anchors, dim=dim)
    assert_allclose(built.get_forces()[:, :dim], F, rtol=0, atol=1e-12 * abs(K).max() * 10)
    H = built.calc.get_hessian(built).toarray().reshape(len(atoms), 3, len(atoms), 3)[:, :dim, :, :dim].reshape(K.shape)
    assert_allclose(H, K, rtol=0, atol=1e-12 * abs(K).max())
    with pytest.raises(NotAtRest):
        modes(built)
    built.calc = built.calc.about(built, load=np.pad(-F, [(0, 0), (0, 3 - dim)]))  # what holds it
    m = np.repeat(atoms.get_masses(), dim)
    squares = np.linalg.eigvalsh(K / np.sqrt(np.outer(m, m)))
    found = modes(built).omega
    assert_allclose(found * abs(found), squares, rtol=0, atol=1e-11 * abs(squares).max())
    blind = oracle(atoms, members, springs, anchors, dim, static=False)[1]
    assert abs(K - blind).max() > 1e-3 * abs(K).max()  # the control: D0 alone is visibly another matrix
    if abs(squares[0]) > 1e-6 * squares[-1] and not atoms.pbc.any():
        assert verdict(built).stable == (squares[0] > 0)
    if dim == 2:
        g = 0.7
        built.calc.set(gyration=g)
        J = np.kron(np.eye(len(atoms)), [[0, 1], [-1, 0]])  # m u'' = -K u + m g J u'
        zero, one = np.zeros_like(K), np.eye(len(K))
        poles = np.linalg.eigvals(np.block([[zero, one], [-K / m[:, None], g * J]]))
        if squares[0] > 0:
            assert_allclose(np.sort(modes(built).omega), np.sort(poles.imag)[len(K):], rtol=0, atol=1e-8 * abs(poles).max())


def drawn_net(seed, dim, periods):
    """A net that repeats along some directions of a skew cell: one law for each two nodes, whatever the images that it joins."""
    rng = np.random.default_rng([seed, dim, periods])
    n = int(rng.integers(2, 4))
    cell = 1.5 * (np.eye(3) + 0.2 * rng.uniform(-1, 1, (3, 3)) * np.pad(np.ones((dim, dim)), (0, 3 - dim)))
    cell[periods:dim] *= 4
    atoms = Atoms(f'H{n}', rng.uniform(0, 0.5, (n, 3)) * (np.arange(3) < dim) @ cell + np.arange(n)[:, None] * 0.4 * cell[0],
                  cell=cell, pbc=np.arange(3) < periods, masses=rng.uniform(0.5, 2, n))
    shifts = [shift for shift in product((-1, 0, 1), repeat=3) if not any(shift[periods:])]
    members = []
    for i, j in combinations_with_replacement(range(n), 2):
        law = drawn_law(rng, 1.5) if j else Spring(rng.uniform(1, 4), 1.0)  # taut, whatever the others are
        apart = np.linalg.norm(atoms.positions[j] - atoms.positions[i] + shifts @ cell, axis=1)
        members += [(i, j, shift, law) for shift, r in zip(shifts, apart, strict=True)
                    if (i < j or shift > (0, 0, 0)) and 0.3 < r < 3.5 and (i == j or rng.random() < 0.7)]
    return atoms, members, rng


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize(('dim', 'periods'), [(2, 1), (2, 2), (3, 1), (3, 2), (3, 3)])
def test_bands_with_gyration_and_stability_of_periodic_nets_are_those_of_sums_over_members(dim, periods, seed):
    atoms, members, rng = drawn_net(seed, dim, periods)
    springs = rng.choice([0.3, 6.0]) * rng.uniform(1, 2, 3) * (np.arange(3) < dim)
    q = rng.uniform(0.1, 0.5, 3) * (np.arange(3) < periods)
    F, K = oracle(atoms, members, springs, atoms.positions, dim, q=q)
    built = net(atoms, members, foundation=[springs[:dim]], dim=dim)
    scale = abs(K).max()
    assert_allclose(built.get_forces()[:, :dim], F, rtol=0, atol=1e-11 * scale)
    built.calc = built.calc.about(built, load=np.pad(-F, [(0, 0), (0, 3 - dim)]))  # what holds it
    m = np.repeat(atoms.get_masses(), dim)

    def squares(q, static=True):
        return np.linalg.eigvalsh(oracle(atoms, members, springs, atoms.positions, dim, static, q)[1] / np.sqrt(np.outer(m, m)))

    found = analytic_bands(built, [q]).omega[0]
    assert_allclose(found * abs(found), squares(q), rtol=0, atol=1e-11 * scale / m.min())
    assert abs(squares(q) - squares(q, static=False)).max() > 1e-3 * abs(squares(q)).max()  # the control
    mesh = [np.linspace(-0.5, 0.5, 17 if periods < 3 else 9)] * periods + [[0.0]] * (3 - periods)
    least = squares(np.array([*product(*mesh)])).min()
    if abs(least) > 0.02 * scale / m.max():  # what lies between the points of the mesh is less
        assert verdict(built).stable == (least > 0)
    if squares(q)[0] > 0:
        g = rng.normal(size=3) if dim == 3 else np.array([0, 0, rng.normal()])
        built.calc.set(gyration=g[None] if dim == 3 else g[2])
        turns = np.kron(np.eye(len(atoms)), np.array([[0, g[2], -g[1]], [-g[2], 0, g[0]], [g[1], -g[0], 0]])[:dim, :dim])
        poles = np.linalg.eigvals(np.block([[np.zeros_like(K), np.eye(len(K))], [-K / m[:, None], turns]]))
        assert_allclose(analytic_bands(built, [-q]).omega[0], np.sort(poles.imag)[len(K):], rtol=0, atol=1e-7 * abs(poles).max())


@pytest.mark.parametrize('seed', range(6))
def test_tensions_of_a_self_stress_balance_and_their_number_is_that_of_maxwell(seed):
    rng = np.random.default_rng(seed)
    dim, n = int(rng.choice([2, 3])), 7
    nodes = Atoms(f'H{n}', rng.uniform(0, 5, (n, 3)) * [1, 1, dim == 3], masses=np.ones(n),
                  constraint=FixAtoms([0]) if seed % 2 else None)
    pairs = [pair for pair in combinations(range(n), 2) if rng.random() < 0.9]
    held = net(nodes, [(*pair, Spring(1.0, 1.0)) for pair in pairs], dim=dim)
    states = self_stress(held)
    for tension in states:
        left = np.zeros((n, 3))
        for (i, j), t in zip(pairs, tension, strict=True):
            direction = nodes.positions[j] - nodes.positions[i]
            left[i] += t * direction / np.linalg.norm(direction)
            left[j] -= t * direction / np.linalg.norm(direction)
        assert abs(left[seed % 2:]).max() < 1e-12
    freedom = n * dim - {2: 3, 3: 6}[dim] if seed % 2 == 0 else (n - 1) * dim - {2: 1, 3: 3}[dim]  # a body, or one on a pivot
    assert len(states) == len(pairs) - freedom  # so many members make it stiff: no mechanism


@pytest.mark.parametrize('seed', range(3))
def test_a_slack_cable_does_not_spoil_the_verdict_of_a_net(seed):
    rng = np.random.default_rng(seed)
    nodes = Atoms('H3', [*rng.uniform(-1, 1, (2, 3)) * [1, 1, 0] + [[0, 0, 0], [4, 0, 0]], [2, 3, 0]], masses=[1, 1, 1])
    length = np.linalg.norm(nodes.positions[2] - nodes.positions[0])
    spring, slack = (0, 1, Spring(1.0, float(np.linalg.norm(nodes.positions[1] - nodes.positions[0])))), 1.2 * length
    with_slack, without = (verdict(net(nodes, [spring, *more])) for more in ([(0, 2, Cable(1.0, slack))], []))
    assert without.case.inside.free.count == with_slack.case.inside.free.count == 2  # the third node is loose in both
    assert (without.case.inside.free.slack, with_slack.case.inside.free.slack) == (0, 1)
    assert 'nan' not in str(with_slack)


@pytest.mark.parametrize('seed', [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 7))])
def test_nets_that_only_their_tension_holds_relax_and_have_no_stiffness_by_springs(seed):
    """A honeycomb of springs of several lengths; triangular nets without 40 % of their members, whose nodes come near others."""
    kind = 'diluted' if seed else 'honeycomb'
    rng = np.random.default_rng(seed)
    atoms = (lattices.honeycomb if kind == 'honeycomb' else lattices.triangular)(1.0, 1.0).repeat((8, 8, 1))
    i, j, shift, R = pairs_within(atoms, 1.1)
    kept = rng.permutation(len(i))[: len(i) if kind == 'honeycomb' else round(1.8 * len(atoms))]
    while (loose := np.bincount(np.r_[i[kept], j[kept]], minlength=len(atoms))[[i[kept], j[kept]]].min(axis=0) < 2).any():
        kept = kept[~loose]  # ends that hang down
    held, place = np.unique(np.r_[i[kept], j[kept]], return_inverse=True)
    atoms, ends = atoms[held], place.reshape(2, -1).tolist()
    atoms.set_cell(atoms.cell.array * [[1.1], [1.1], [1.0]], scale_atoms=True)
    springs = [Spring(1.0, L) for L in (np.linalg.norm(R[kept], axis=1) * rng.uniform(0.9, 1.1, len(kept))).tolist()]
    members = [*zip(*ends, map(tuple, shift[kept].tolist()), springs, strict=True)]
    rest = relaxed(net(atoms, members, dim=2)).atoms
    F, K = oracle(rest, members, np.zeros(3), rest.positions, 2)
    assert abs(F).max() < 1e-12
    assert_allclose(rest.calc.rest_hessian().toarray(), K, atol=1e-13)
    taut, alone = (elastic_moduli(rest, model).shear for model in ('complete', 'conventional'))
    assert abs(alone) < (1e-3 if kind == 'honeycomb' else 0.3) * taut
