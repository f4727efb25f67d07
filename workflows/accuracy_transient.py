"""The cost of a tone burst in a linear lattice: time steps, Lanczos vectors, a series in the stiffness matrix."""

from collections import Counter
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from ase import Atoms
from scipy.integrate import solve_ivp
from scipy.linalg import eigh_tridiagonal

from magphonon import DrivenVerlet, MagneticRepulsion, ToneBurst, analytic_bands, lattices, propagate, read_scene, units
from magphonon.response.propagation import forced_response, sampled
from magphonon.scenes import ready_scene
from magphonon.stiffness.rest import LinearSystem

from .accuracy import Candidate, Chart, cheapest, measure, panels_of, spoken
from .rows import Check

CARRIER = 40 * units.Hz        # within the lower branch of the prototype
FORCE = 3e-10 * units.N        # moves particles by 1e-9 L0: there the law bends by 5e-9, below what is compared
END = 200 * units.ms           # the burst ends at 125 ms
TARGET = 1e-6
VERLET = 'Verlet, compiled'
SERIES = 'Chebyshev series: propagate'
ENOUGH = 160                   # Lanczos vectors; 130 reach round-off


@dataclass(frozen=True)
class Burst:
    """A lattice with a driven row, as particles and as `y'' + K y = pattern course(t)`."""

    atoms: Atoms
    drive: ToneBurst
    limit: float

    @cached_property
    def scene(self):
        """The reduced structure."""
        return LinearSystem.of(self.atoms)

    @cached_property
    def exact(self):
        """Exact displacements at END, by Lanczos vectors."""
        return lanczos(self, ENOUGH, Counter())

    def problem(self):
        """K, the pattern, and the function from reduced coordinates to displacements."""
        scene = LinearSystem.of(self.atoms)
        push = np.zeros((len(self.atoms), 2))
        push[self.drive.particles] = self.drive.direction[:2]
        return scene.K, scene.shapes.T @ push.ravel(), lambda y: (scene.shapes @ y).reshape(-1, 2)

    def course(self, t):
        """The drive over time, N."""
        return self.drive(np.asarray(t))[..., 0, :] @ self.drive.direction

    def error(self, u):
        """Largest error of a displacement over the largest displacement."""
        return abs(u - self.exact).max() / abs(self.exact).max()


def chart(quick):
    """Error against time of every method, in patches with a held rim."""
    table, checks = [], []
    for count in (1024,) if quick else (1024, 10_000, 99_856):
        burst, panel = lattice(round(count**0.5)), f'N = {count}'
        runs = candidates(burst, panel, quick)
        own = measure(runs, burst.error, repeats=2 if quick else 5, patience=0.3 if quick else 1.0)
        table += own
        checks += judged(panel, own)
    return Chart('Tone burst in a linear lattice', table, reading(panels_of(table)), checks,
                 error='largest error / largest displacement')


def prototype():
    """The unit cell, and the longest stable time step of Verlet in the infinite lattice in ms."""
    cell = read_scene(ready_scene('prototype')).atoms()
    path = cell.cell.bandpath('GMKG', npoints=61, pbc=cell.pbc)
    return cell, 2 / analytic_bands(cell, path).omega.max()


def lattice(n):
    """`n x n` particles of the prototype; a row next to the lower rim is pushed along itself."""
    cell, limit = prototype()
    patch = lattices.parallelogram(cell, n, n)
    patch.calc = MagneticRepulsion(patch, cell.calc.laws, **cell.calc.parameters)
    y = np.where(patch.get_tags() == 0, patch.positions[:, 1], np.inf)
    row = np.flatnonzero(y < y.min() + 1e-6)
    return Burst(patch, ToneBurst(row, (1, 0), FORCE, 2 * np.pi * CARRIER), limit)


def candidates(burst, panel, quick):
    """Candidates: every method that can answer for a patch of this size in reasonable time."""
    count = len(burst.atoms)
    few = quick or count > 50_000
    steps = [0.5, 0.2, 0.1] if count > 50_000 else [0.5, 0.2, 0.1, 0.03]  # of the limit
    if count < 50_000:
        second = burst.error(verlet(burst, 0.1, 'compiled', Counter()))  # falls with the square of the step
        steps.append(0.1 * np.sqrt(0.9 * TARGET / second))
    runs = {(VERLET, f'dt = {s:.3g} of the limit'): partial(verlet, burst, s, 'compiled') for s in steps}
    if count < 5000:
        runs |= {("ASE's VelocityVerlet", f'dt = {s:g} of the limit'): partial(verlet, burst, s, 'ase')
                 for s in ([0.5] if few else [0.5, 0.2, 0.1])}
    if count < 50_000:
        runs |= {('DOP853', f'rtol = {r:.0e}'): partial(dop853, burst, r) for r in ([1e-4] if few else [1e-4, 1e-7])}
    runs |= {('Lanczos', f'{m} vectors'): partial(lanczos, burst, m) for m in ([90, 130] if few else [80, 90, 100, 115, 130])}
    runs |= {(SERIES, f'tolerance = {t:.0e}'): partial(series, burst, t) for t in (1e-1, 1e-6, 1e-9, 1e-12)}
    return [Candidate(*name, run, panel) for name, run in runs.items()]


def series(burst, tolerance, cost):
    """The Chebyshev series of the package, `propagate`."""
    found = propagate(burst.atoms, [END], [burst.drive], tolerance=tolerance)
    cost['products'] = found.products
    return found.displacements[0]


def verlet(burst, share, engine, cost):
    """Velocity Verlet with a time step of `share` of its limit."""
    steps = int(np.ceil(END / (share * burst.limit)))
    cost['force evaluations'] = steps
    atoms = burst.atoms.copy()
    atoms.calc = burst.atoms.calc
    dyn = DrivenVerlet(atoms, END / steps, drives=[burst.drive], engine=engine)
    dyn.run(steps)
    return dyn.displacements


def dop853(burst, rtol, cost):
    """SciPy's adaptive integrator of eighth order."""
    K, pattern, displaced = burst.problem()
    size = len(pattern)

    def slope(t, state):
        cost['products'] += 1
        return np.append(state[size:], burst.course(t) * pattern - K @ state[:size])

    state = np.zeros(2 * size)
    for start, end in ((0.0, burst.drive.end), (burst.drive.end, END)):  # the kink at the end of the burst
        state = solve_ivp(slope, (start, end), state, 'DOP853', rtol=rtol, atol=rtol * FORCE, t_eval=[end]).y[:, -1]
    return displaced(state[:size])


def oscillators(burst, w2):
    """Displacements at END of oscillators with these squared frequencies, driven by the burst."""
    ends, rate = np.array([0.0, burst.drive.end, END]), np.sqrt(w2.max())
    edges, courses = sampled(lambda t: burst.course(t)[:, None], ends, rate, 1e-14)
    return forced_response(w2, 0.0, edges, courses, [len(edges) - 1])[0, 0, 0]


def lanczos(burst, count, cost):
    """Sum over the modes of the Krylov space of the pattern."""
    K, pattern, displaced = burst.problem()
    cost['products'] = count
    basis, diagonal, beside = np.zeros((count, len(pattern))), np.zeros(count), np.zeros(count)
    v, before = pattern / np.linalg.norm(pattern), 0.0
    for k in range(count):
        basis[k] = v
        w = K @ v - (beside[k - 1] * before if k else 0.0)
        diagonal[k] = w @ v
        w -= diagonal[k] * v
        beside[k] = np.linalg.norm(w)
        before, v = v, w / beside[k]
    w2, vectors = eigh_tridiagonal(diagonal, beside[:-1])
    return displaced(basis.T @ (vectors @ (oscillators(burst, w2) * vectors[0])) * np.linalg.norm(pattern))


def judged(panel, table):
    """Checks of errors and counts, which are the same on all machines."""
    series = {m.setting: m for m in table if m.method == SERIES}
    checks = [Check(f'transient, {panel}: error of the series at tolerance 1e-09', series['tolerance = 1e-09'].error, 0.0, 1e-9,
                    by='two methods')]
    steps = cheapest([m for m in table if m.method == VERLET], TARGET)
    if steps:
        share = series['tolerance = 1e-06'].cost['products'] / steps.cost['force evaluations']
        checks.append(Check(f'transient, {panel}: products of the series / steps of Verlet, both at 1e-6', share, 0.0, 1e-2,
                            by='two methods'))
    return checks


def reading(panels):
    """The conclusion in words, for the largest lattice in which Verlet has reached the target error."""
    panel, table = [(name, t) for name, t in panels.items() if cheapest([m for m in t if m.method == VERLET], TARGET)][-1]
    best, steps, own = (cheapest([m for m in table if m.method == name or not name], TARGET) for name in ('', VERLET, SERIES))
    rough = [m.error for m in table if m.method == VERLET and m.seconds < best.seconds]
    alone = f'only where an error of {min(rough):.1g} will do' if rough else 'at no error charted here'
    longer, longest = (spoken(steps.seconds / m.seconds) for m in (own, best))
    return (f'At {panel}, {best.method} reaches an error of {TARGET:.0e} in {spoken(best.seconds)} s and propagate (which keeps '
            f'to a tolerance, in the memory of a few vectors) in {spoken(own.seconds)} s. {steps.method} takes '
            f'{spoken(steps.seconds)} s, {longest} and {longer} times as long; it is faster {alone}.')
