"""Lattices drawn at random, a thousandth on either side of where they begin to buckle, against sums over pairs of their own.

    python -m pytest -n 0 -m long tests/stability/test_soft_waves.py     # 200 of them, eight minutes

Spacing and mass are about 1 (mm, g), f = r^-a (N, mm).
"""

from functools import cache
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from ase import Atoms
from oracles import Pairs
from planewaves import PlaneWaves, depth, margin
from scipy.optimize import brentq, minimize
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, critical_foundation, lattices, verdict
from magphonon.stability.buckling import highest_squared, softest_of
from magphonon.stability.soft_waves import softest_wave
from magphonon.stiffness.all_neighbours import AllNeighbours
from magphonon.stiffness.rest import LinearSystem

pytestmark = pytest.mark.filterwarnings('ignore:no particles interact across')  # of drawn lattices

NEAR = 1e-3
"""Of the critical parameter: how far off the verdict is asked."""

KINDS = 'oblique', 'several', 'space', 'line', 'oblique', 'oblique', 'several', 'space', 'oblique', 'everything'


def drawn(kind, rng):
    """Lattice vectors in rows, sites and a cut-off well between two shells."""
    while True:
        if kind == 'line':
            periods, sites = np.array([[1.0, 0.0]]), np.zeros((1, 2))
        elif kind == 'space':  # between simple, body-centred and face-centred cubic ones
            ideal = [np.eye(3), (np.ones((3, 3)) - 2 * np.eye(3)) / np.sqrt(3), (np.ones((3, 3)) - np.eye(3)) / np.sqrt(2)]
            periods = ideal[rng.integers(3)] + rng.uniform(-0.06, 0.06, (3, 3))
            sites = np.zeros((1, 3))
        else:
            angle = np.deg2rad(rng.uniform(58, 92))
            periods = np.array([[1, 0], rng.uniform(0.8, 1.25) * np.array([np.cos(angle), np.sin(angle)])])
            sites = np.zeros((1, 2))
        if kind == 'several':  # every site a centre of inversion, so that the forces balance
            periods = 2 * periods
            sites = np.array([[0, 0], [1, 0], [0, 1]]) / 2 @ periods
        reach = np.sort(np.unique(np.linalg.norm(PlaneWaves(periods, sites, 4.0, 8.0).x, axis=1).round(9)))
        shells = rng.integers(2, 7)
        if (reach[1 : shells + 1] / reach[:shells]).min() > 1.05 and reach[0] > 0.7:
            return periods, sites, (reach[shells - 1] + reach[shells]) / 2


@cache
def near_its_limit(seed):
    """A drawn lattice with the parameter at which it begins to buckle: its exponent, its foundation or, of dipoles, its angle."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    while True:
        periods, sites, cutoff = drawn(kind, rng)
        if kind == 'everything':
            side = rng.uniform(0.8, 1.25)

            def waves(angle, side=side):
                x = np.deg2rad(angle)
                return PlaneWaves([[1, 0], [side * np.cos(x), side * np.sin(x)]], np.zeros((1, 2)), 4.0)

            between, cutoff = np.linspace(58, 92, 7), None
        else:
            def waves(a, periods=periods, sites=sites, cutoff=cutoff):
                return PlaneWaves(periods, sites, a, cutoff)

            between = np.linspace(1.5, 9, 7)
        signs = np.sign([margin(waves(x), polish=False)[0] for x in between])
        changes = np.flatnonzero(np.diff(signs))
        if len(changes):
            at = rng.choice(changes)
            low, high = between[at : at + 2]
            limit = brentq(lambda x: margin(waves(x), polish=False)[0], low, high, xtol=1e-3)
            for _ in range(2):  # the wave that buckles first, and where it does
                k = margin(waves(limit))[1]
                limit = brentq(lambda x, k=k: margin(waves(x), at=k)[0], limit - 0.2, limit + 0.2, xtol=1e-9)
            return SimpleNamespace(kind=kind, waves=waves, cutoff=cutoff, sites=sites, limit=limit, foundation=None)
        if kind in ('line', 'several', 'space'):  # unstable whatever the exponent: the foundation that holds it
            a = rng.uniform(2, 8)
            return SimpleNamespace(kind=kind, waves=waves, cutoff=cutoff, sites=sites, limit=a,
                                   foundation=depth(waves(a), margin(waves(a))[1]))


def cell_of(case, x, foundation=0.0):
    """The same lattice as a cell of the package."""
    waves = case.waves(x)
    dim = waves.x.shape[1]
    cell = 7 * np.eye(3)
    cell[: len(waves.periods), :dim] = waves.periods
    sites = np.pad(case.sites, ((0, 0), (0, 3 - dim)))
    rng = np.random.default_rng(0)
    atoms = Atoms(['Nd'] * len(sites), sites, cell=cell, pbc=np.arange(3) < len(waves.periods),
                  masses=rng.uniform(0.5, 2, len(sites)))
    law = InversePower(1.0, waves.a)
    atoms.calc = (AllNeighbours(atoms, law, foundation=foundation) if case.cutoff is None else
                  MagneticRepulsion(atoms, law, cutoff=case.cutoff, foundation=foundation))
    return atoms


def misjudged(seed):
    """What is wrong about one drawn lattice a thousandth on either side of its limit, a list of str."""
    case = near_its_limit(seed)
    wrong = []
    for side in (1 - NEAR, 1 + NEAR):
        if case.foundation is None:
            x, k, waves = case.limit * side, 0.0, case.waves(case.limit * side)
            least, at = margin(waves)
            expected = depth(waves, at) if least < 0 else 0.0
        else:
            x, k, expected = case.limit, case.foundation * side, case.foundation
        atoms = cell_of(case, x, k)
        needed = critical_foundation(atoms)[0]
        if verdict(atoms).stable != (expected <= k):
            wrong.append(f'{case.kind} {seed} at {x:.6g}, {k:.6g}: the verdict')
        if not abs(needed - expected) <= 1e-3 * expected:  # the bottom of a pocket 1e-6 of the stiffness deep, as NEAR^2
            wrong.append(f'{case.kind} {seed} at {x:.6g}: needs {expected:.6g}, not {needed:.6g}')
    return wrong


@pytest.mark.parametrize('seed', few_first([1, 3, 6, 0, 2, 4, 7], 3))  # without the dipoles, whose sums are dear
def test_drawn_lattices_beside_their_limits(seed):
    assert not misjudged(seed)


@pytest.mark.long
@pytest.mark.parametrize('seed', range(200))
def test_two_hundred_lattices_beside_their_limits(seed):
    """`python -m pytest -n 0 -m long tests/stability/test_soft_waves.py`"""
    assert not misjudged(seed)


@pytest.mark.slow
def test_rhombic_dipoles_buckle_in_long_waves():
    """At 73 degrees no point of the mesh is unstable: the control."""
    angle = np.deg2rad(73)
    waves = PlaneWaves([[1, 0], [np.cos(angle), np.sin(angle)]], np.zeros((1, 2)), 4.0)
    atoms = cell_of(SimpleNamespace(waves=lambda x: waves, sites=np.zeros((1, 2)), cutoff=None), None)
    needed, q = critical_foundation(atoms)
    k = (2 * np.pi * np.linalg.pinv(waves.periods).T).T @ q[:2]
    assert needed == pytest.approx(depth(waves, k), rel=1e-5)  # the oracle's splines and its soft edge
    assert not verdict(atoms).stable
    mesh = np.stack(np.meshgrid(*[np.arange(16) / 24] * 2), axis=-1).reshape(-1, 2)
    lowest = np.linalg.eigvalsh(atoms.calc.bloch_matrix(np.pad(mesh, ((0, 0), (0, 1)))))[:, 0]
    assert lowest.min() > -1e-12


# --- saddles: wavevectors with 2 q whole, where every slope is zero by symmetry ---------------------------------------------

def skewed(seed):
    """A lattice in space or, of every third seed, in the plane; its bonds, and its stiffness by a plain sum over them."""
    rng = np.random.default_rng(seed)
    dim = 2 if seed % 3 == 0 else 3
    while True:
        a, cell = rng.uniform(2, 6), 20 * np.eye(3)
        cell[:dim, :dim] = np.diag(rng.uniform(8, 13, dim)) + rng.normal(0, 2, (dim, dim))
        shifts = np.array(list(product(range(-5, 6), repeat=dim)))
        R = shifts @ cell[:dim, :dim]
        r = np.linalg.norm(R, axis=1)
        cutoff = rng.uniform(12, 18)
        near = (r > 0) & (r < cutoff)
        if near.any() and r[near].min() > 5 and abs(r - cutoff).min() > 0.01:
            break
    n, f = R[near] / r[near, None], r[near] ** -a
    nn = n[:, :, None] * n[:, None]
    K = (f / r[near])[:, None, None] * ((a + 1) * nn - np.eye(dim))
    atoms = Atoms('Nd', cell=cell, pbc=np.arange(3) < dim, masses=[1.0])
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, a), cutoff=cutoff)
    return atoms, dim, lambda q: np.linalg.eigvalsh(np.tensordot(1 - np.cos(2 * np.pi * q @ shifts[near].T), K, 1))


def missed(seed):
    """How far off the foundation needed is, as a share of itself."""
    atoms, dim, spectrum = skewed(seed)
    q = mesh(dim, 25 if dim == 3 else 61)  # odd, so that no point but 0 is stationary
    values = spectrum(q)[:, 0]
    settings = {'xatol': 1e-7, 'fatol': 1e-14 * values.max()}
    least = min(minimize(lambda q: spectrum(q)[0], start, method='Nelder-Mead', options=settings).fun
                for start in q[np.argsort(values)[:6:2]])
    needed = critical_foundation(atoms)[0]
    return abs(least + needed) / -least if least < -1e-12 * values.max() else needed


@pytest.mark.slow
@pytest.mark.parametrize('seeds', [range(16), pytest.param(range(1000), marks=pytest.mark.long)], ids=['few', 'many'])
def test_a_search_that_starts_on_a_saddle_leaves_it(seeds):
    """python -m pytest tests/stability/test_soft_waves.py -k saddle -m long     # a thousand, a minute"""
    for seed in seeds:
        assert missed(seed) < 1e-9, seed  # round-off of the largest eigenvalue, and where the simplex ends


def pair_of_particles(seed):
    """A planar cell of two particles, and its squared frequencies by complex steps of the energy."""
    rng, law = np.random.default_rng(seed), InversePower(1.0, 4.6)
    cell = np.diag([*rng.uniform(1.2, 1.8, 2), 3.0])
    cell[1, 0] = rng.uniform(-0.5, 0.5)
    atoms = Atoms('Nd2', [[0, 0, 0], np.append(rng.uniform(0.35, 0.65, 2), 0) @ cell], cell=cell, pbc=(True, True, False),
                  masses=rng.uniform(0.5, 2, 2))
    atoms.calc = MagneticRepulsion(atoms, law, foundation=rng.uniform(0, 1), cutoff=2.1).balanced([0, 1])
    pairs, root = Pairs(atoms, law, 2.1), np.repeat(atoms.get_masses(), 2) ** -0.5

    def spectrum(q):
        D = pairs.bloch(atoms.positions, np.pad(q, ((0, 0), (0, 1)))) + atoms.calc.foundation * np.eye(4)
        return np.linalg.eigvalsh(D * root * root[:, None])
    return atoms, spectrum


@pytest.mark.slow
def test_the_highest_frequency_is_that_of_the_whole_zone():
    """Not that of a mesh, by which time steps would be judged too kindly: the control."""
    short = []
    for seed in range(4, 8):
        atoms, spectrum = pair_of_particles(seed)
        q = mesh(2, 31)
        values = spectrum(q)[:, -1]
        settings = {'xatol': 1e-7, 'fatol': 1e-14 * values.max()}
        highest = -min(minimize(lambda q, f=spectrum: -f(q[None])[0, -1], start, method='Nelder-Mead', options=settings).fun
                       for start in q[np.argsort(values)[-6::2]])
        assert highest_squared(LinearSystem.of(atoms)) == pytest.approx(highest, rel=1e-9)
        short.append(1 - spectrum(mesh(2, 36))[:, -1].max() / highest)
    assert max(short) > 1e-5


@pytest.mark.parametrize('sums', [False, True])
@pytest.mark.parametrize('weighted', [False, True])
def test_particles_of_unlike_mass(sums, weighted):
    """The softest wave by stiffness and by frequency, against D of a mesh divided by the masses here; control: equal masses."""
    atoms = lattices.honeycomb(1.0, 1.0)
    atoms.set_masses([0.6, 1.7])
    law = InversePower(1.0, 4.6)
    atoms.calc = AllNeighbours(atoms, law) if sums else MagneticRepulsion(atoms, law)
    found = softest_of(atoms, weighted=weighted)
    root = np.repeat(atoms.get_masses(), 2) ** -0.5 if weighted else np.ones(4)
    q = np.vstack([np.pad(mesh(2, 24), ((0, 0), (0, 1))), found.q])
    D = atoms.calc.bloch_matrix(q) if sums else Pairs(atoms, law, 1.1).bloch(atoms.positions, q)
    values = np.linalg.eigvalsh(D * root * root[:, None])[:, 0]
    assert found.lowest == pytest.approx(values[-1], rel=1e-9)
    assert found.lowest <= values.min() + 1e-12
    assert found.lowest < 0
    assert values.min() != pytest.approx(np.linalg.eigvalsh(D)[:, 0].min(), rel=1e-2) or not weighted


# --- the search itself -----------------------------------------------------------------------------------------------

def landscape(seed):
    """Cosines of up to three periods along each axis with random weights, even in q as Bloch matrices are; around zero or not."""
    rng, dim = np.random.default_rng(seed), 1 + seed % 2
    waves = np.stack(np.meshgrid(*[np.arange(-3, 4)] * dim, indexing='ij'), axis=-1).reshape(-1, dim)
    weights = rng.normal(size=len(waves))
    scale = abs(weights).sum()
    offset = scale * rng.integers(-1, 2)
    return lambda q: np.cos(2 * np.pi * q[..., :dim] @ waves.T) @ weights + offset, dim, scale


def mesh(dim, steps):
    return np.stack(np.meshgrid(*[np.arange(steps) / steps] * dim, indexing='ij'), axis=-1).reshape(-1, dim)


@pytest.mark.parametrize('seed', few_first(range(30), 8))
def test_the_lowest_point_of_any_landscape_is_found(seed):
    height, dim, scale = landscape(seed)
    found, _, q = softest_wave(lambda q: height(q)[:, None, None] + 0j, np.eye(3), np.arange(3) < dim, 24)
    fine = mesh(dim, 120)
    starts = fine[np.argsort(height(fine))[:3]]
    expected = min(minimize(height, start, tol=1e-14).fun for start in starts)
    assert abs(found - expected) < 1e-12 * scale  # round-off
    assert abs(height(q) - found) < 1e-12 * scale


def test_the_mesh_alone_misses_most_of_them():
    missed = 0
    for seed in range(30):
        height, dim, scale = landscape(seed)
        missed += height(mesh(dim, 24)).min() > height(mesh(dim, 120)).min() + 1e-4 * scale
    assert missed > 15


@pytest.mark.parametrize('seed', range(6))
def test_a_pocket_of_long_waves_is_found_beside_a_softer_point_of_the_mesh(seed):
    """f = s (s - s0) of s = sum of sin^2(pi q), lowest at s0/2 within the first step of the mesh, less low at the edge."""
    rng, dim = np.random.default_rng(seed), 1 + seed % 2
    s0 = np.sin(np.pi * rng.uniform(0.01, 0.035)) ** 2
    depth, edge = s0**2 / 4, 0.6 * s0**2 / 4

    def height(q):
        s = (np.sin(np.pi * q[..., :dim]) ** 2).sum(axis=-1)
        return s * (s - s0) - (dim * (dim - s0) + edge) * (s / dim) ** 40

    assert height(mesh(dim, 24)).min() == pytest.approx(-edge)  # the control: all that the mesh sees
    found, _, q = softest_wave(lambda q: height(q)[:, None, None] + 0j, np.eye(3), np.arange(3) < dim, 24)
    assert found == pytest.approx(-depth, rel=1e-6)
    assert abs(q).max() < 0.035
