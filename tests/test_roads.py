"""Roads that must lead to the same place, on structures drawn over all that the package allows.

One-, two- and three-dimensional lattices, oblique ones, several shells, holes, particles out of their places and in other images
of the cell, mixed masses, pillars out of place, constraints, dead loads; relaxed, or held where they are by a load.  Each road
of the package is compared with dense algebra about the present positions, whose stiffness comes from the energy phi(r) of a
bond alone (`oracles.Pairs`); and each comparison must fail where the oracle drops D*, looks at the anchors instead of the rest,
loses one bond or has one mass wrong.  Every structure is made of one number, its seed.

Thousands of comparisons, and structures of up to 150 particles: `python -m pytest -n 0 -m long tests/test_roads.py`.
"""

from collections import defaultdict
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixedLine, FixedPlane
from ase.dft.kpoints import BandPath
from oracles import Pairs, free_basis, lattice
from scipy.linalg import eigvalsh, expm

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
from magphonon.dynamics.timestep import frequency_bound, highest_frequency
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
MODELS = 'complete', 'complete', 'conventional'
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

    @property
    def displaced(self):
        """How far particles are from where they belong, mm."""
        return abs(self.x - self.perfect.positions).max()

    def pairs_of(self, perfect):
        pairs = Pairs(perfect, self.law, self.reach, self.model)
        return pairs if self.lost is None else pairs.without(self.lost % len(pairs.i))

    @cached_property
    def pairs(self):
        return self.pairs_of(self.perfect)

    @cached_property
    def scale(self):
        """Stiffness of the stiffest bond, N/mm."""
        return self.pairs.stiffest(self.x)

    def fastest(self, squares):
        """Highest angular frequency or rate, rad/ms; that of one bond where round-off is all there is."""
        return np.sqrt(max(abs(squares).max(), self.scale / self.masses.max()))

    @cached_property
    def stiffness(self):
        """Dense matrix of the structure, N/mm."""
        return self.pairs.hessian(self.x) + self.k * np.eye(self.pairs.n * self.pairs.dim)

    def waves(self, q):
        """Stiffness for the wavevectors q, shape (waves, rows, rows)."""
        return self.pairs.bloch(self.x, q) + self.k * np.eye(len(self.stiffness))

    def repeated(self, repeat):
        """Dense matrix of several cells with periodic borders, and the masses of its rows."""
        cells = self.perfect.repeat(repeat)
        count = len(cells) // len(self.x)
        H = self.pairs_of(cells).hessian(cells.positions + np.tile(self.x - self.perfect.positions, (count, 1)))
        return H + self.k * np.eye(len(H)), np.tile(self.rows, count)

    @property
    def rows(self):
        """The mass that belongs to each row of the matrix."""
        return np.repeat(self.masses, self.pairs.dim)


@dataclass(frozen=True)
class Case:
    """A structure, what is true of it, and the number that it and all that is asked about it were drawn from."""

    atoms: Atoms
    truth: Truth
    seed: int

    @property
    def dim(self):
        return self.atoms.calc.dim

    @property
    def rng(self):
        """The same draws each time: a wrong truth is asked the same."""
        return np.random.default_rng([self.seed, 1])

    def on_foundation(self, k):
        """The same structure at the same rest on springs of the stiffness k."""
        atoms = self.atoms.copy()
        atoms.calc = self.atoms.calc.about(self.atoms, foundation=k).balanced(np.arange(len(atoms)))
        return replace(self, atoms=atoms)

    def reduced(self, truth):
        """Stiffness within what the constraints leave free, its masses, and the basis."""
        B = free_basis(self.atoms, self.dim)
        return B.T @ truth.stiffness @ B, B.T @ (truth.rows[:, None] * B), B


def weighted(H, m):
    return H / np.sqrt(m * m[:, None])


def cell_and_reach(rng):
    """One cell, and a reach between two shells with their number, if it has a name."""
    name = str(rng.choice([*REACHES, 'oblique']))
    if name != 'oblique':
        shells = int(rng.integers(1, 4))
        return name, lattice(name, L0), REACHES[name][shells - 1] * L0, shells
    angle, side = np.deg2rad(rng.uniform(62, 88)), rng.uniform(0.85, 1.3)
    cell = Atoms('Nd', cell=L0 * np.array([[1, 0, 0], [side * np.cos(angle), side * np.sin(angle), 0], [0, 0, 2]]), pbc=(1, 1, 0))
    images = np.array(list(product(range(-4, 5), repeat=2))) @ cell.cell.array[:2]
    distances = np.sort(np.linalg.norm(images, axis=1))
    distances = distances[(distances > L0 * max(1, side) * 1.001) & (distances < 2.4 * L0)]
    widest = np.diff(distances).argmax()
    return name, cell, distances[widest : widest + 2].mean(), None


def supercell(rng, cell, most):
    counts = np.where(cell.pbc, rng.integers(1, 4, 3), 1)
    while np.prod(counts) * len(cell) > most:
        counts[counts.argmax()] -= 1
    return cell.repeat(counts)


def patch(rng, name, cell, most):
    """A line, or a shape of roughly `most` particles; its edge is held or free."""
    if name == 'chain':
        atoms = cell.repeat((int(rng.integers(4, max(most, 4) + 1)), 1, 1))
        atoms.pbc = False
        return atoms
    side, shape = np.sqrt(most * abs(np.linalg.det(cell.cell.array[:2, :2])) / len(cell)), str(rng.choice(PATCHES))
    if shape == 'parallelogram':
        atoms = lattices.parallelogram(cell, *np.maximum(np.round(side / cell.cell.lengths()[:2]).astype(int), 4))
    elif shape == 'rectangle':
        long = side * rng.uniform(0.9, 1.2)
        atoms = lattices.rectangle(cell, max(long, 4 * L0), max(side**2 / long, 4 * L0))
    else:
        atoms = getattr(lattices, shape)(cell, max(side / (1.6 if shape == 'hexagon' else 1.1), 3.2 * L0))
    if rng.random() < 0.5:
        atoms.set_constraint()
    return atoms


def held_by(atoms):
    return atoms.constraints[0].index if atoms.constraints else np.array([], int)


def with_holes(rng, perfect):
    """Whether one or two inner particles were taken out."""
    inner = rng.permutation(np.setdiff1d(np.arange(len(perfect)), held_by(perfect)))
    if len(inner) < 5 or rng.random() < 0.5:
        return False
    del perfect[inner[: rng.integers(1, 3)].tolist()]
    return True


def guides(rng, perfect, dim):
    """Some of: a particle that is held, one on an oblique line, two on planes."""
    free = rng.permutation(np.setdiff1d(np.arange(len(perfect)), held_by(perfect)))
    if len(free) < 5:
        return []
    angle = rng.uniform(0, 2 * np.pi)
    chosen = [FixAtoms(free[:1])]
    if dim == 2:
        chosen += [FixedLine(free[1:2], (np.cos(angle), np.sin(angle), 0)), FixedPlane(free[2:4], (0.6, 0.8, 0))]
    return [guide for guide in chosen if rng.random() < 0.5]


def structure(seed, periodic=None, most=24, constrained=True):
    """A structure at rest with its calculator, and the truth about it."""
    rng = np.random.default_rng(seed)
    name, cell, reach, shells = cell_and_reach(rng)
    periodic = rng.random() < 0.5 if periodic is None else periodic
    perfect = supercell(rng, cell, most) if periodic or cell.pbc.all() else patch(rng, name, cell, most)
    holes = with_holes(rng, perfect)
    n, dim = len(perfect), 3 if perfect.pbc.all() else 2
    masses = rng.uniform(0.5, 1.5, n) if rng.random() < 0.5 else np.full(n, 0.7)
    perfect.set_masses(masses)
    if constrained:
        perfect.set_constraint([*perfect.constraints, *guides(rng, perfect, dim)])

    law, model, state = LAWS[rng.integers(len(LAWS))], MODELS[rng.integers(len(MODELS))], STATES[rng.integers(len(STATES))]
    k = 0.3 if state == 'relaxed' else float(rng.choice([0.0, 0.03, 0.3]))
    scatter, moved = np.zeros((2, n, 3))
    if state != 'perfect':
        scatter[:, :dim] = rng.choice([0.0, 0.4]) * rng.uniform(-1, 1, (n, dim))
        moved[:, :dim] = rng.choice([0.01, 0.6]) * rng.uniform(-1, 1, (n, dim))
    named = shells and not holes and rng.random() < 0.5  # a hole may empty a shell
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
    if rng.random() < 0.5:  # in another image of the cell
        atoms.positions += np.where(perfect.pbc, rng.integers(-1, 2, (n, 3)), 0) @ perfect.cell.array
    return Case(atoms, Truth(perfect, x, law, reach, model, masses, k), seed)


def compare(found, expected, scale=0.0):
    """The largest difference as a share of the largest value, or of what cancels in it."""
    return np.max(abs(found - expected)) / max(np.max(abs(expected)), scale)


# --- the roads: each returns how far the package is off, as a share of what its tolerance refers to ---------------------


def bloch_matrix_against_periodic_lattice(case, truth):
    """All waves that fit n x m cells against the spectrum of those cells with periodic borders."""
    n = len(case.atoms)
    repeat = np.where(case.atoms.pbc, case.rng.integers(1, 4, 3), 1)
    while np.prod(repeat) * n > 40:
        repeat[repeat.argmax()] -= 1
    q = np.array(list(product(*(np.arange(c) for c in repeat)))) / repeat
    omega = bloch_modes(case.atoms, q, case.truth.model)[0].ravel()
    expected = np.linalg.eigvalsh(weighted(*truth.repeated(repeat)))
    return compare(np.sort(omega * abs(omega)), expected, truth.scale / truth.masses.max())


def force_constants_against_bloch(case, truth):
    """phonopy's bands from forces on displaced particles against the oracle's waves, at random wavevectors."""
    q = np.where(case.atoms.pbc, case.rng.uniform(-1, 1, (4, 3)), 0)
    path = BandPath(case.atoms.cell, q, {}, '')
    omega = phonopy_bands(finite_displacements(case.atoms), path).omega
    expected = np.linalg.eigvalsh(weighted(truth.waves(q), truth.rows))
    return compare(omega * abs(omega), expected, truth.scale / truth.masses.max())


def modes_against_dense_algebra(case, truth):
    H, M, _ = case.reduced(truth)
    squares = eigvalsh(H, M)
    found = modes(case.atoms)
    scale = truth.scale / truth.masses.max()
    off = [compare(w * abs(w), squares, scale) for w in (found.omega, natural_frequencies(case.atoms))]
    off.append(compare(modes(case.atoms, 1).omega[0] * abs(found.omega[0]), squares[0], abs(squares[-1]) + scale))
    u = found.shapes.reshape(len(squares), -1)
    off.append(compare(u @ truth.stiffness @ u.T, np.diag(squares), scale))
    return max(off)


def response_against_dense_solution(case, truth):
    """Refused where the structure is unstable, which is then held by a foundation."""
    H, M, B = case.reduced(truth)
    squares, lowest = eigvalsh(H, M), np.linalg.eigvalsh(H)[0]
    rng, top = case.rng, truth.fastest(squares)
    omega, gamma, push = top * rng.uniform(0.02, 1.1, 3), 0.02 * top, np.zeros((len(case.atoms), 3), complex)
    push[:, : case.dim] = rng.normal(size=(len(case.atoms), case.dim, 2)) @ [1, 1j]
    if squares[0] < -EXACT * top**2:
        with pytest.raises(ValueError, match='unstable'):
            frequency_response(case.atoms, push, omega, gamma)
        case = case.on_foundation(truth.k - 2 * lowest)
        H = H - 2 * lowest * np.eye(len(H))
    roads = harmonic_response, lambda *scene: frequency_response(*scene, tolerance=1e-12)
    exact = np.array([B @ np.linalg.solve(H - (w**2 - 1j * gamma * w) * M, B.T @ push[:, : case.dim].ravel()) for w in omega])
    return max(compare(road(case.atoms, push, omega, gamma)[..., : case.dim].reshape(3, -1), exact) for road in roads)


def propagation_against_dense_exponential(case, truth):
    """From displacements and velocities, under a harmonic force, damped: exp(A t) of y, v and the two quadratures."""
    H, M, B = case.reduced(truth)
    rng, free, omega_max = case.rng, B.shape[1], truth.fastest(eigvalsh(H, M))
    w, gamma, t = omega_max * rng.uniform(0.1, 0.9), omega_max * rng.choice([0.0, 0.02]), 20 / omega_max
    y = 1e-5 * rng.normal(size=free)  # mm; so near that this rest, and no other, is meant
    v = 1e-2 * omega_max * rng.normal(size=free)  # so fast that the round-off of positions of 50 mm is nothing
    atoms = case.atoms.copy()
    atoms.calc = case.atoms.calc
    if abs(atoms.calc.displacements(atoms)).max() > 1e-6:  # its positions are the rest
        y = 0 * y
    atoms.positions[:, : case.dim] += (B @ y).reshape(-1, case.dim)
    momenta = np.zeros((len(atoms), 3))
    momenta[:, : case.dim] = atoms.get_masses()[:, None] * (B @ v).reshape(-1, case.dim)
    atoms.set_momenta(momenta, apply_constraint=False)
    allowed = (B @ B.T @ rng.normal(size=len(B))).reshape(-1, case.dim)  # a push on what is held is refused
    driven = int(np.linalg.norm(allowed, axis=1).argmax())
    along, amplitude = allowed[driven] / np.linalg.norm(allowed[driven]), 1e-2 * max(np.linalg.eigvalsh(H)[-1], truth.scale)
    drive = Harmonic(driven, np.pad(along, (0, 3 - case.dim)), amplitude, w, 0.3)
    found = propagate(atoms, [t / 3, t], [drive], gamma, tolerance=1e-12).displacements.reshape(2, -1)

    F = np.zeros((len(atoms), case.dim))
    F[driven] = amplitude * along
    A = np.zeros((2 * free + 2, 2 * free + 2))
    A[:free, free:-2] = np.eye(free)
    A[free:-2, :free] = -np.linalg.solve(M, H)
    A[free:-2, free:-2] = -gamma * np.eye(free)
    A[free:-2, -2] = np.linalg.solve(M, B.T @ F.ravel())  # times sin(w t + 0.3)
    A[-2:, -2:] = [[0, w], [-w, 0]]
    start = np.concatenate([y, v, [np.sin(0.3), np.cos(0.3)]])
    return compare(found, np.array([B @ (expm(A * s) @ start)[:free] for s in (t / 3, t)]))


def propagation_against_modes(case, truth):
    """A free motion is the sum of the package's modes, each at the frequency that the truth gives it; unstable ones grow."""
    u = modes(case.atoms).shapes.reshape(-1, len(truth.rows))
    squares = np.einsum('kx,xy,ky->k', u, truth.stiffness, u)
    share = 1e-2 * case.rng.normal(size=len(squares))
    atoms, momenta = case.atoms.copy(), np.zeros((len(case.atoms), 3))
    atoms.calc = case.atoms.calc
    momenta[:, : case.dim] = (truth.rows * (share @ u)).reshape(-1, case.dim)
    atoms.set_momenta(momenta, apply_constraint=False)
    t = 10 / truth.fastest(squares)
    swing = t * np.sinc(np.emath.sqrt(squares) * t / np.pi).real
    return compare(propagate(atoms, [t], tolerance=1e-12).displacements.ravel(), (share * swing) @ u)


def support_against_lowest_eigenvalue(case, truth):
    """The foundation needed: of a finite structure that of its matrix; of a lattice as much at one wave, and no less at any."""
    needed, q = foundation_needed(case.atoms, case.truth.model)
    _, _, B = case.reduced(truth)
    waves = np.concatenate([[q], np.where(case.atoms.pbc, case.rng.uniform(-1, 1, (8, 3)), 0)])
    lowest = np.linalg.eigvalsh(B.T @ truth.waves(waves) @ B)[:, 0] - truth.k
    return max(compare(needed, max(-lowest[0], 0.0), truth.scale), (-needed - lowest.min()) / truth.scale)


def verdict_against_sign(case, truth):
    """On a foundation a thousandth softer or stiffer than needed, or on none: 1 if the verdict is wrong, 0 if it is right."""
    if case.truth.model == 'conventional':  # a verdict is that of the complete model, whatever the calculator's
        truth = replace(truth, model='complete')
    _, _, B = case.reduced(truth)
    spectrum = np.linalg.eigvalsh(B.T @ truth.waves(foundation_needed(case.atoms)[1]) @ B) - truth.k
    shares = (0.999, 1.001) if spectrum[0] < -EXACT * spectrum[-1] else (1.0,)
    said = [verdict(case.on_foundation(-share * min(spectrum[0], 0.0)).atoms).stable for share in shares]
    return float(said != [share >= 1 for share in shares])


def limit_against_largest_eigenvalue(case, truth):
    """The limit itself; and no step above it passes for stable, and none below it for unstable, by a cheaper bound."""
    H, M, _ = case.reduced(truth)
    scale = truth.scale / truth.masses.max()
    highest = eigvalsh(H, M)[-1]
    if highest < EXACT * scale:  # one particle in a cell, without a foundation
        return highest_frequency(case.atoms) ** 2 / scale
    omega = np.sqrt(highest)
    for share in (0.6, 1 - 1e-6, 1 + 1e-6, 1.3, 2.0):
        if (frequency_bound(case.atoms, share * 2 / omega) / omega * share > 1) != (share > 1):
            return 1.0
    return compare(highest_frequency(case.atoms) ** 2, highest, scale)


ROADS = {
    'bloch': (bloch_matrix_against_periodic_lattice, EXACT),
    # forces over a displacement of 1e-5 bonds: curvature, 20 (1e-5)^2, and round-off, times steep laws
    'phonopy': (force_constants_against_bloch, 2e-8),
    'modes': (modes_against_dense_algebra, EXACT),
    'response': (response_against_dense_solution, 1e-9),  # a quality up to 50 multiplies round-off
    'transient': (propagation_against_dense_exponential, EXACT),
    'swing': (propagation_against_modes, EXACT),
    'support': (support_against_lowest_eigenvalue, EXACT),
    'verdict': (verdict_against_sign, 0.05),  # right or wrong
    'limit': (limit_against_largest_eigenvalue, EXACT),
}
"""Comparisons, and how near both ends must be."""
FAMILIES = {
    'waves': (('bloch', 'phonopy', 'support', 'limit'), {'periodic': True, 'constrained': False, 'most': 4}, 10),
    'supercells': (('bloch', 'modes', 'support'), {'periodic': True, 'constrained': False, 'most': 12}, 6),
    'structures': (('modes', 'response', 'transient', 'swing', 'support', 'limit'), {'most': 16}, 13),
    'verdicts': (('verdict',), {'most': 3}, 6),
}
"""Roads that share structures, how these are drawn, and how many in CI."""
FAULTS = {
    'D*': lambda truth: replace(truth, model='conventional') if truth.model == 'complete' else None,
    'anchors': lambda truth: replace(truth, x=truth.perfect.positions) if truth.displaced > 1e-3 else None,
    'bond': lambda truth: replace(truth, lost=7),
    'mass': lambda truth: replace(truth, masses=np.where(np.arange(len(truth.x)) == len(truth.x) // 2, 1.1, 1) * truth.masses),
}
"""Truths with one fault, or None where it makes no difference."""
BLIND = {('support', 'mass'), ('verdict', 'mass')}
"""Faults that a road cannot see: masses do not matter for buckling."""


def notices(road, case, false, tolerance):
    """Whether a comparison with a wrong truth is off, or ends in an answer where a refusal was due, or the other way round."""
    try:
        return road(case, false) > tolerance
    except (ValueError, pytest.fail.Exception):
        return True


def follow(family, seeds, control=True, **drawn):
    """Compare all roads of a family, and with one fault in turn; how many comparisons, and which faults each road noticed."""
    roads, limits, _ = FAMILIES[family]
    compared, noticed = 0, defaultdict(list)
    for seed in seeds:
        case = structure(seed, **limits | drawn)
        faulty = {how: false for how, fault in FAULTS.items() if (false := fault(case.truth))}
        how = list(faulty)[seed % len(faulty)]
        for name in roads:
            road, tolerance = ROADS[name]
            off = road(case, case.truth)
            assert off < tolerance, f'{name}, seed {seed} of {family}: off by {off:.2g}'
            compared += 1
            if control and (name, how) not in BLIND:
                noticed[name, how].append(notices(road, case, faulty[how], 10 * tolerance))
    return compared, noticed


@pytest.mark.parametrize('family', FAMILIES)
def test_all_roads_lead_to_the_same_place_and_faults_lead_elsewhere(family):
    roads, _, many = FAMILIES[family]
    compared, noticed = follow(family, range(many))
    assert compared == many * len(roads)
    assert {name for name, _ in noticed} == set(roads)
    # not each time: a bond may be lost between particles that are held, and a lattice that needs no foundation needs none
    assert not [road for road, seen in noticed.items() if np.mean(seen) < 1 / 3]


@pytest.mark.long
@pytest.mark.parametrize('family', FAMILIES)
def test_thousands_of_structures(family):
    """`python -m pytest -n 0 -m long tests/test_roads.py`: forty times as many, and some of up to 150 particles."""
    roads, _, many = FAMILIES[family]
    compared, _ = follow(family, range(100, 100 + 40 * many), control=False)
    assert compared == 40 * many * len(roads)
    if family in ('structures', 'verdicts'):
        follow(family, range(many), control=False, most=150 if family == 'structures' else 9)
