"""Roads that must lead to the same place, on structures drawn over all that the package allows.

One-, two- and three-dimensional lattices, oblique ones, several shells, holes, particles out of their places and in other images
of the cell, mixed masses, pillars out of place, constraints, dead loads; relaxed, or held where they are by a load.  Each road
of the package is compared with dense algebra about the present positions, whose stiffness comes from the energy phi(r) of a
bond alone (`oracles.Pairs`); and each comparison must fail where the oracle drops D*, looks at the anchors instead of the rest,
loses one bond or mixes up two masses.

Thousands of cases: `python -m pytest -n 0 -m long tests/test_roads.py`.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixedLine, FixedPlane
from ase.dft.kpoints import BandPath
from hypothesis import HealthCheck, given, settings, strategies as st
from oracles import Pairs, free_basis, lattice
from scipy.linalg import expm

from magphonon import (
    Harmonic,
    InversePower,
    MagneticRepulsion,
    Yukawa,
    finite_displacements,
    foundation_needed,
    frequency_response,
    lattices,
    modes,
    phonopy_bands,
    propagate,
    relaxed,
    verdict,
)
from magphonon.bands.bloch import bloch_modes
from magphonon.dynamics.timestep import highest_frequency
from magphonon.response.frf import harmonic_response
from magphonon.response.normal_modes import natural_frequencies

L0 = 10.0
REACHES = {
    'chain': (1.5, 2.5, 3.5), 'square': (1.2, 1.7, 2.1), 'triangular': (1.3, 1.9, 2.2), 'honeycomb': (1.3, 1.85, 2.1),
    'kagome': (1.3, 1.85, 2.1), 'fcc': (1.2, 1.55, 1.85), 'bcc': (1.07, 1.3, 1.8),
}
"""Between the shells of neighbours, in spacings."""
LAWS = [InversePower(b=0.2 * L0**a, a=a) for a in (2.0, 4.5824, 9.0)] + [Yukawa(c=20.0, kappa=0.3)]
"""About 0.2 N at the spacing, so that D* is of the order of 0.02 N/mm."""
EXACT = 1e-10
"""Of the highest squared frequency: round-off of matrices of a hundred rows, times the bonds that cancel in them."""
STATES = 'perfect', 'relaxed', 'held', 'held elsewhere', 'held'
PATCHES = ['parallelogram', 'rectangle', 'hexagon', 'half_hexagon']


@dataclass(frozen=True)
class Truth:
    """A structure as the oracle sees it: where its particles belong, where they are, what they weigh and what holds them."""

    perfect: Atoms
    x: np.ndarray
    law: object
    reach: float
    model: str
    masses: np.ndarray
    k: float
    lost: int | None = None

    def pairs(self, repeat=(1, 1, 1)):
        pairs = Pairs(self.perfect.repeat(repeat), self.law, self.reach, self.model)
        return pairs if self.lost is None else pairs.without(self.lost % len(pairs.i))

    @cached_property
    def scale(self):
        """Stiffness of the stiffest bond, N/mm."""
        return self.pairs().stiffest(self.x)

    def stiffness(self, repeat=(1, 1, 1)):
        """Dense matrix of the structure, or of several cells of it, and the masses of its rows."""
        cells = self.perfect.repeat(repeat)
        count = len(cells) // len(self.x)
        x = cells.positions + np.tile(self.x - self.perfect.positions, (count, 1))
        H = self.pairs(repeat).hessian(x)
        dim = len(H) // len(cells)
        return H + self.k * np.eye(len(H)), np.repeat(np.tile(self.masses, count), dim)


@dataclass(frozen=True)
class Case:
    atoms: Atoms
    truth: Truth
    rng: np.random.Generator

    @property
    def dim(self):
        return self.atoms.calc.dim

    def reduced(self, truth):
        """Stiffness within what the constraints leave free, its masses, and the basis."""
        H, m = truth.stiffness()
        B = free_basis(self.atoms, self.dim)
        return B.T @ H @ B, B.T @ (m[:, None] * B), B


def weighted(H, m):
    return H / np.sqrt(m * m[:, None])


def planar_or_cubic(draw, rng):
    """One cell, and a reach between two shells with their number, if it has a name."""
    name = draw(st.sampled_from([*REACHES, 'oblique']))
    if name != 'oblique':
        shells = draw(st.integers(1, 3))
        return name, lattice(name, L0), REACHES[name][shells - 1] * L0, shells
    angle, side = np.deg2rad(rng.uniform(62, 88)), rng.uniform(0.85, 1.3)
    cell = Atoms('Nd', cell=L0 * np.array([[1, 0, 0], [side * np.cos(angle), side * np.sin(angle), 0], [0, 0, 2]]), pbc=(1, 1, 0))
    images = np.array(list(product(range(-4, 5), repeat=2))) @ cell.cell.array[:2]
    distances = np.sort(np.linalg.norm(images, axis=1))
    distances = distances[(distances > L0 * max(1, side) * 1.001) & (distances < 2.4 * L0)]
    widest = np.diff(distances).argmax()
    return name, cell, distances[widest : widest + 2].mean(), None


def patch(draw, rng, name, cell, most):
    shape = 'line' if name == 'chain' else draw(st.sampled_from(PATCHES))
    side = np.sqrt(most * abs(np.linalg.det(cell.cell.array[:2, :2])) / len(cell)) if name != 'chain' else 0
    if shape == 'line':
        atoms = cell.repeat((draw(st.integers(4, most)), 1, 1))
        atoms.pbc = False
        return atoms
    if shape == 'parallelogram':
        n = np.maximum(np.round(side / cell.cell.lengths()[:2]).astype(int), 4)
        return lattices.parallelogram(cell, *n)
    if shape == 'rectangle':
        long = side * rng.uniform(0.9, 1.2)
        return lattices.rectangle(cell, max(long, 4 * L0), max(side**2 / long, 4 * L0))
    return getattr(lattices, shape)(cell, max(side / (1.6 if shape == 'hexagon' else 1.1), 3.2 * L0))


@st.composite
def structures(draw, periodic=None, most=24, states=STATES, constrained=True):
    """A structure at rest with its calculator, and the truth about it."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    name, cell, reach, shells = planar_or_cubic(draw, rng)
    periodic = draw(st.booleans()) if periodic is None else periodic
    if periodic or cell.pbc.all():
        counts = np.where(cell.pbc, [draw(st.integers(1, 3)) for _ in range(3)], 1)
        while np.prod(counts) * len(cell) > most:
            counts[counts.argmax()] -= 1
        perfect = cell.repeat(counts)
    else:
        perfect = patch(draw, rng, name, cell, most)
        if draw(st.booleans()):
            perfect.set_constraint()  # free edges
    held = perfect.constraints[0].index if perfect.constraints else np.array([], int)
    inner = rng.permutation(np.setdiff1d(np.arange(len(perfect)), held))
    holes = len(inner) > 4 and draw(st.booleans())
    if holes:
        del perfect[inner[: draw(st.integers(1, 2))].tolist()]
    n, dim = len(perfect), 3 if perfect.pbc.all() else 2
    masses = rng.uniform(0.5, 1.5, n) if draw(st.booleans()) else np.full(n, 0.7)
    perfect.set_masses(masses)
    guides = []
    if constrained:
        free = rng.permutation(np.setdiff1d(np.arange(n), perfect.constraints[0].index if perfect.constraints else []))
        angle = rng.uniform(0, 2 * np.pi)
        guides = [FixAtoms(free[:1])]
        if dim == 2:
            guides += [FixedLine(free[1:2], (np.cos(angle), np.sin(angle), 0)), FixedPlane(free[2:4], (0.6, 0.8, 0))]
        guides = [c for c in guides if len(c.index) and len(free) > 4 and draw(st.booleans())]
    perfect.set_constraint([*perfect.constraints, *guides])

    law, model = draw(st.sampled_from(LAWS)), draw(st.sampled_from(['complete', 'complete', 'conventional']))
    state = draw(st.sampled_from(states))
    k = 0.3 if state == 'relaxed' else draw(st.sampled_from([0.0, 0.03, 0.3]))
    scatter, moved = np.zeros((2, n, 3))
    if state != 'perfect':
        scatter[:, :dim] = draw(st.sampled_from([0.0, 0.4])) * rng.uniform(-1, 1, (n, dim))
        moved[:, :dim] = draw(st.sampled_from([0.01, 0.6])) * rng.uniform(-1, 1, (n, dim))
    named = shells and not holes and draw(st.booleans())  # a hole may empty a shell
    calc = MagneticRepulsion(perfect, law, foundation=k, model=model, anchors=perfect.positions + scatter,
                             **({'shells': shells} if named else {'cutoff': reach}))
    atoms = perfect.copy()
    if state == 'relaxed':
        atoms.calc = calc
        atoms = relaxed(atoms).atoms
    else:
        atoms.positions += moved
        atoms.calc = calc.about(atoms).balanced(np.arange(n))
        if state == 'held elsewhere':
            atoms.calc = atoms.calc.about(perfect)
    x = atoms.get_positions()
    if draw(st.booleans()):  # in another image of the cell
        atoms.positions += np.where(perfect.pbc, rng.integers(-1, 2, (n, 3)), 0) @ perfect.cell.array
    return Case(atoms, Truth(perfect, x, law, reach, model, masses, k), rng)


def compare(found, expected, scale=0.0):
    """The largest difference as a share of the largest value, or of what cancels in it."""
    return abs(found - expected).max() / max(abs(expected).max(), scale)


# --- the roads: each returns how far the package is off, as a share of what its tolerance refers to ---------------------


def bloch_matrix_against_periodic_lattice(case, truth):
    """All waves that fit n x m cells against the spectrum of those cells with periodic borders."""
    n = len(case.atoms)
    repeat = np.where(case.atoms.pbc, case.rng.integers(1, 4, 3), 1)
    while np.prod(repeat) * n > 40:
        repeat[repeat.argmax()] -= 1
    q = np.array(list(product(*(np.arange(c) for c in repeat)))) / repeat
    omega = bloch_modes(case.atoms, q, case.truth.model)[0].ravel()
    expected = np.linalg.eigvalsh(weighted(*truth.stiffness(repeat)))
    return compare(np.sort(omega * abs(omega)), expected, truth.scale / truth.masses.max())


def force_constants_against_bloch(case, truth):
    """phonopy's bands from forces on displaced particles against the oracle's waves, at random wavevectors."""
    q = np.where(case.atoms.pbc, case.rng.uniform(-1, 1, (4, 3)), 0)
    path = BandPath(case.atoms.cell, q, {}, '')
    omega = phonopy_bands(finite_displacements(case.atoms), path).omega
    pairs, m = truth.pairs(), np.repeat(truth.masses, case.dim)
    D = [pairs.bloch(truth.x, wave) + truth.k * np.eye(len(m)) for wave in q]
    return compare(omega * abs(omega), np.linalg.eigvalsh([weighted(d, m) for d in D]), truth.scale / truth.masses.max())


def modes_against_dense_algebra(case, truth):
    H, M, _ = case.reduced(truth)
    squares = np.linalg.eigvalsh(weighted(H, np.diag(M)))
    found = modes(case.atoms)
    scale = truth.scale / truth.masses.max()
    off = [compare(w * abs(w), squares, scale) for w in (found.omega, natural_frequencies(case.atoms))]
    off.append(compare(modes(case.atoms, 1).omega[0] * abs(found.omega[0]), squares[0], abs(squares[-1]) + scale))
    u = found.shapes.reshape(len(squares), -1)
    off.append(compare(u @ truth.stiffness()[0] @ u.T, np.diag(squares), scale))
    return max(off)


def response_against_dense_solution(case, truth):
    H, M, B = case.reduced(truth)
    squares = np.linalg.eigvalsh(weighted(H, np.diag(M)))
    omega = np.sqrt(abs(squares).max()) * case.rng.uniform(0.02, 1.1, 3)
    gamma, push = 0.02 * np.sqrt(abs(squares).max()), np.zeros((len(case.atoms), 3), complex)
    push[:, : case.dim] = case.rng.normal(size=(len(case.atoms), case.dim, 2)) @ [1, 1j]
    if squares[0] < -EXACT * squares[-1]:
        with pytest.raises(ValueError, match='unstable'):
            frequency_response(case.atoms, push, omega, gamma)
        return None
    roads = harmonic_response, lambda *scene: frequency_response(*scene, tolerance=1e-12)
    exact = np.array([B @ np.linalg.solve(H - (w**2 - 1j * gamma * w) * M, B.T @ push[:, : case.dim].ravel()) for w in omega])
    return max(compare(road(case.atoms, push, omega, gamma)[..., : case.dim].reshape(3, -1), exact) for road in roads)


def propagation_against_dense_exponential(case, truth):
    """From displacements and velocities, under a harmonic force, damped: exp(A t) of y, v and the two quadratures."""
    H, M, B = case.reduced(truth)
    free, omega_max = B.shape[1], np.sqrt(abs(np.linalg.eigvalsh(weighted(H, np.diag(M)))).max())
    w, gamma, t = omega_max * case.rng.uniform(0.1, 0.9), omega_max * case.rng.choice([0.0, 0.02]), 20 / omega_max
    driven, along = int(case.rng.integers(len(case.atoms))), case.rng.normal(size=case.dim)
    y, v = 1e-5 * case.rng.normal(size=(2, free))  # mm; so near that this rest, and no other, is meant
    v *= omega_max
    atoms = case.atoms.copy()
    atoms.calc = case.atoms.calc
    if abs(atoms.calc.displacements(atoms)).max() > 1e-6:  # its positions are the rest
        y = 0 * y
    atoms.positions[:, : case.dim] += (B @ y).reshape(-1, case.dim)
    momenta = np.zeros((len(atoms), 3))
    momenta[:, : case.dim] = atoms.get_masses()[:, None] * (B @ v).reshape(-1, case.dim)
    atoms.set_momenta(momenta, apply_constraint=False)
    amplitude = 1e-5 * np.linalg.eigvalsh(H)[-1]
    drive = Harmonic(driven, np.pad(along, (0, 3 - case.dim)), amplitude, w, 0.3)
    found = propagate(atoms, [t / 3, t], [drive], gamma, tolerance=1e-12).displacements.reshape(2, -1)

    F = np.zeros((len(atoms), case.dim))
    F[driven] = amplitude * along / np.linalg.norm(along)
    A = np.zeros((2 * free + 2, 2 * free + 2))
    A[:free, free:-2] = np.eye(free)
    A[free:-2, :free] = -np.linalg.solve(M, H)
    A[free:-2, free:-2] = -gamma * np.eye(free)
    A[free:-2, -2] = np.linalg.solve(M, B.T @ F.ravel())  # times sin(w t + 0.3)
    A[-2:, -2:] = [[0, w], [-w, 0]]
    start = np.concatenate([y, v, [np.sin(0.3), np.cos(0.3)]])
    return compare(found, np.array([B @ (expm(A * s) @ start)[:free] for s in (t / 3, t)]))


def support_against_lowest_eigenvalue(case, truth):
    """The foundation needed: of a finite structure that of its matrix; of a lattice as much at one wave, and no less at any."""
    highest = truth.scale
    needed, q = foundation_needed(case.atoms)
    complete = replace(truth, model='complete', k=0.0)
    if truth.model != 'complete':
        complete = replace(complete, model='conventional')
        needed, q = foundation_needed(case.atoms, 'conventional')
    if not case.atoms.pbc.any():
        H, _, _ = case.reduced(complete)
        lowest = np.linalg.eigvalsh(H)[0]
        return compare(needed, max(-lowest, 0.0), highest)
    _, _, B = case.reduced(complete)
    pairs, waves = complete.pairs(), [q, *np.where(case.atoms.pbc, case.rng.uniform(-1, 1, (8, 3)), 0)]
    lowest = [np.linalg.eigvalsh(B.T @ pairs.bloch(complete.x, wave) @ B)[0] for wave in waves]
    return max(compare(needed, max(-lowest[0], 0.0), highest), (-needed - min(lowest)) / highest)


def verdict_against_sign(case, truth):
    """On a foundation a thousandth softer or stiffer than needed, or on none: 1 if the verdict is wrong, 0 if it is right."""
    q = foundation_needed(case.atoms)[1]
    _, _, B = case.reduced(truth)
    lowest = np.linalg.eigvalsh(B.T @ truth.pairs().bloch(truth.x, q) @ B)
    wrong = 0
    for share in (0.999, 1.001) if lowest[0] < -EXACT * lowest[-1] else (1.0,):
        atoms = case.atoms.copy()
        k = -share * min(lowest[0], 0.0)
        atoms.calc = case.atoms.calc.about(case.atoms, foundation=k).balanced(np.arange(len(atoms)))
        wrong |= verdict(atoms).stable != (share >= 1)
    return float(wrong)


def limit_against_largest_eigenvalue(case, truth):
    """The limit itself; and no step above it passes for stable, and none below it for unstable, by a cheaper bound."""
    H, M, _ = case.reduced(truth)
    omega = np.sqrt(max(np.linalg.eigvalsh(weighted(H, np.diag(M)))[-1], 0.0))
    if not omega:
        return highest_frequency(case.atoms)
    for share in (0.6, 1 - 1e-6, 1 + 1e-6, 1.3, 2.0):
        if (highest_frequency(case.atoms, share * 2 / omega) / omega * share > 1) != (share > 1):
            return 1.0
    return compare(highest_frequency(case.atoms) ** 2, omega**2, truth.scale)


ROADS = {
    'bloch': (bloch_matrix_against_periodic_lattice, EXACT),
    # forces over a displacement of 1e-5 bonds: curvature, 20 (1e-5)^2, and round-off, times steep laws
    'phonopy': (force_constants_against_bloch, 2e-8),
    'modes': (modes_against_dense_algebra, EXACT),
    'response': (response_against_dense_solution, 1e-9),  # a quality up to 50 multiplies round-off
    'transient': (propagation_against_dense_exponential, 1e-9),
    'support': (support_against_lowest_eigenvalue, 1e-9),
    'verdict': (verdict_against_sign, 0.5),
    'limit': (limit_against_largest_eigenvalue, EXACT),
}
"""Comparisons, and how near both ends must be."""
FAMILIES = {
    'waves': (('bloch', 'phonopy', 'support', 'limit'), {'periodic': True, 'constrained': False, 'most': 4}, 40),
    'supercells': (('bloch', 'modes', 'support'), {'periodic': True, 'constrained': False, 'most': 12}, 15),
    'structures': (('modes', 'response', 'transient', 'support', 'limit'), {'most': 20}, 60),
    'verdicts': (('verdict',), {'most': 9}, 12),
}
"""Roads that share structures, how these are drawn, and how many in CI."""
BLIND = {('support', 'masses'), ('verdict', 'masses'), ('verdict', 'bond')}
"""Faults that a road cannot see."""
MANY = settings(deadline=None, derandomize=True, suppress_health_check=list(HealthCheck), database=None)


def wrong(truth, how):
    """The truth with one fault, or None where it makes no difference."""
    if how == 'D*':
        return replace(truth, model='conventional') if truth.model == 'complete' else None
    if how == 'anchors':
        return replace(truth, x=truth.perfect.positions) if abs(truth.x - truth.perfect.positions).max() > 1e-3 else None
    if how == 'bond':
        return replace(truth, lost=7)
    return replace(truth, masses=truth.masses[::-1]) if np.ptp(truth.masses) else None


def follow(family, examples, control=True, **drawn):
    """Compare all roads of a family, and with one fault; how many comparisons, and for each fault the share that notices it."""
    roads, limits, _ = FAMILIES[family]
    right, noticed = [], {how: [] for how in ('D*', 'anchors', 'bond', 'masses')}

    @settings(MANY, max_examples=examples)
    @given(structures(**limits | drawn))
    def walk(case):
        how = str(case.rng.choice(list(noticed)))
        false = wrong(case.truth, how)
        for name in roads:
            road, tolerance = ROADS[name]
            off = road(case, case.truth)
            assert off is None or off < tolerance, f'{name}: off by {off:.2g}'
            right.append(off)
            if control and off is not None and false is not None and (name, how) not in BLIND:
                noticed[how].append((road(case, false) or 0.0) > 10 * tolerance)

    walk()
    return len(right), {how: np.mean(seen) for how, seen in noticed.items() if len(seen) > 3}


@pytest.mark.parametrize('family', FAMILIES)
def test_all_roads_lead_to_the_same_place_and_faults_lead_elsewhere(family):
    examples = FAMILIES[family][2]
    compared, noticed = follow(family, examples)
    assert compared >= examples
    assert noticed
    assert min(noticed.values()) > 0.7  # a bond may be lost between two particles that are held


@pytest.mark.long
@pytest.mark.parametrize('family', FAMILIES)
def test_thousands_of_structures(family):
    """`python -m pytest -n 0 -m long tests/test_roads.py`: forty times as many, and some of up to 150 particles."""
    examples = FAMILIES[family][2]
    follow(family, 40 * examples, control=False)
    if family == 'structures':
        follow(family, examples, control=False, most=150)
