"""The exact linear transient: `u(t) = int G(t - t') f(t') dt'` without time steps.

The flow of `y'' + gamma y' + K y = g(t)` from t' to t is a function of K.  A drive is a sum of products of a time course and a
pattern of forces s. The response to each is `sum_n c_n(t) T_n(X) s` at every time t, where the c_n(t) follow from single
oscillators at the Chebyshev points.  Free motion adds two such sums, for initial displacements and velocities.

Single oscillators, `y'' + gamma y' + w2 y = f(t)`, are solved exactly for many w2 at once.  With W^2 = w2 - gamma^2/4, the free
motion over a time t is made of

    c = e^{-gamma t/2} cos(W t)        s = e^{-gamma t/2} sin(W t)/W

    y(t) = (c + gamma/2 s) y(0) + s y'(0) + int_0^t s(t - t') f(t') dt'

which are smooth in w2 through critical damping (W = 0), overdamped and unstable oscillators (W imaginary).  The integral uses
Gauss's rule on panels short enough for the fastest oscillator and for the force.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from ..dynamics.drives import Constant, PrescribedMotion, ToneBurst, check_drives, constant_push, forces_and_walls
from ..dynamics.motion import MOTION_UNITS, Motion
from ..errors import Unstable, finite, positive, refuse_memory
from ..stiffness.plausibility import site_damping, warn_of_amplitude, warn_of_speed, warn_of_times
from ..stiffness.rest import LinearSystem, components, static_forces
from ..stiffness.sites import refuse_motion_out_of_the_plane
from ..traits import LINEAR, takes
from .chebyshev import BLOCK, Outside, chebyshev_blocks, coefficients, products_of, sizes, stable_interval, whole_interval
from .first_order import NODES, POINTS, WEIGHTS, FirstOrder

TURN = 8.0  # longest panel in rad of the fastest oscillation, whose motion there is a polynomial of degree 16 up to round-off
PANELS = 20_000  # largest number of panels; a force that needs more is not a smooth function of time
_x, _w = np.polynomial.legendre.leggauss(NODES)
_TOP = (np.polynomial.legendre.legvander(_x, NODES - 1) * _w[:, None] * (np.arange(NODES) + 0.5))[:, -2:].T
"""The last two Legendre coefficients of a function on a panel, from its values at the points."""
SPAN = 2000.0
"""Longest part of a propagation in rad of the fastest oscillation: the tables of single oscillators grow with its square."""
LARGEST = 2**22  # largest number of coefficients of a part, the product of times and terms
OVERFLOW = 600.0  # largest exponent of exponential growth
RESOLVED = 1e-14  # round-off of the kinks of a drive, as a fraction of its impulse
UNRESOLVED = 1e-11  # size of the last coefficients, as a fraction of the largest one, above which the series is too short
MOST = 8  # largest ratio of the number of terms to that of an oscillation of the known length; a longer series does not converge
IN_PLACE = 1e-14
"""Displacement, as a fraction of the largest coordinate, below which it is round-off, as for a particle in another image of its
cell."""
EPS = np.finfo(float).eps


def free_motion(w2: NDArray[np.float64], gamma: float, t: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The functions c and s of a free oscillator; `w2` (rad^2/ms^2) and `t` (ms) broadcast, `gamma` is in 1/ms."""
    W2 = w2 - gamma**2 / 4
    W, decay = np.sqrt(abs(W2)), np.exp(-gamma * t / 2)
    c, s = decay * np.cos(W * t), decay * t * np.sinc(W * t / np.pi)
    if (W2 < 0).any():
        W = np.where(W2 < 0, W, 1.0)
        slow = np.exp(np.where(W2 < 0, -w2 / (W + gamma / 2), 0) * t)  # W - gamma/2 without its cancellation
        c = np.where(W2 < 0, slow * (1 + np.exp(-2 * W * t)) / 2, c)
        s = np.where(W2 < 0, slow * -np.expm1(-2 * W * t) / (2 * W), s)
    return c, s


def free_response(w2: NDArray[np.float64], gamma: float, t: Any) -> NDArray[np.float64]:
    """Matrix that takes (y, y') of a free oscillator at time zero to (y, y') at t, shape (2, 2, ...)."""
    c, s = free_motion(w2, gamma, t)
    return np.array([[c + gamma / 2 * s, s], [-w2 * s, c - gamma / 2 * s]])


def sampled(force: Callable[..., Any], edges: NDArray[np.float64], rate: float,
            tolerance: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Split the time between the first and last of the `edges` into panels that resolve oscillators and force.

    Parameters
    ----------
    force : function
        Maps times, shape (times,), to forces, shape (times, components).
    edges : ndarray
        Increasing times in ms at which panels must end.
    rate : float
        Angular frequency of the fastest oscillator in rad/ms.
    tolerance : float
        Share of the impulse that may be missed at a kink of the force.

    Returns
    -------
    edges : ndarray, shape (panels + 1,)
    values : ndarray, shape (panels, NODES, components)
    """
    pieces = np.ceil(np.diff(edges) * rate / TURN).astype(int)
    if pieces.sum() > PANELS:
        raise ValueError(f'{edges[-1] - edges[0]:g} ms of motion at up to {rate:g} rad/ms need {pieces.sum()} panels of '
                         f'integration, more than {PANELS}; ask for a shorter time or less damping')
    if len(edges) == 1:
        return edges, np.repeat(force(edges[:0])[:, None], NODES, axis=1)
    starts = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in zip(edges[:-1], edges[1:], pieces, strict=True)])
    pending, kept, impulse = np.stack([starts, np.append(starts[1:], edges[-1])]), [], None
    while pending.shape[1]:
        a, h = pending[0], np.diff(pending, axis=0)[0]
        values = force((a[:, None] + h[:, None] * POINTS).ravel())
        values = values.reshape(len(a), NODES, values.shape[1])
        if impulse is None:
            impulse = (h[:, None] * abs(values).max(axis=2, initial=0.0) * WEIGHTS).sum()
        left = h * abs(np.tensordot(_TOP, values, (1, 1))).max(axis=(0, 2), initial=0.0)
        rough = left > tolerance * impulse
        kept.append((a[~rough], pending[1][~rough], values[~rough]))
        middle = pending.mean(axis=0)[rough]
        pending = np.stack([np.append(a[rough], middle), np.append(middle, pending[1][rough])])
        if sum(len(k[0]) for k in kept) + pending.shape[1] > PANELS:
            raise ValueError(f'the drive cannot be resolved near {middle[0]:.9g} ms; it must be a function of the time that is '
                             'smooth except for a few kinks and steps')
    a, b, values = (np.concatenate(parts) for parts in zip(*kept, strict=True))
    order = np.argsort(a)
    return np.append(a[order], b[order[-1]]), values[order]


def separated(values: NDArray[np.float64], tolerance: float = 1e-15) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Forces, shape (times, components), as a sum of a time course times a pattern, `values = sum_r course_r pattern_r`.

    Cross approximation with full pivots: exact after as many terms as there are independent time courses.
    """
    rest, courses, patterns = values.copy(), [], []
    largest = abs(values).max(initial=0.0)
    while rest.size and len(courses) < min(values.shape):
        t, x = np.unravel_index(abs(rest).argmax(), rest.shape)
        if abs(rest[t, x]) <= tolerance * len(values) ** 0.5 * largest:
            break
        courses.append(rest[:, x] / rest[t, x])
        patterns.append(rest[t].copy())
        rest -= np.outer(courses[-1], patterns[-1])
    return np.array(courses).reshape(len(courses), len(values)).T, np.array(patterns).reshape(len(patterns), values.shape[1])


def forced_response(w2: NDArray[np.float64], gamma: float, edges: NDArray[np.float64], courses: NDArray[np.float64],
                    outputs: NDArray[np.int_]) -> NDArray[np.float64]:
    """Motion from rest at the first edge under forces given at the points of the panels: y and y' at the `outputs`.

    Shapes: w2 (oscillators,), edges (panels + 1,), courses (panels, NODES, terms); the answer (outputs, 2, terms, oscillators).
    """
    lengths = np.diff(edges)
    kind = np.unique(np.round(lengths / (64 * np.finfo(float).eps * edges[-1])), return_inverse=True)[1]
    lengths = np.bincount(kind, lengths) / np.bincount(kind)  # those that differ by round-off share their tables
    tables = []
    for h in lengths:
        c, s = free_motion(w2, gamma, h * (1 - POINTS)[:, None])
        tables.append((free_response(w2, gamma, h), h * np.stack([s, c - gamma / 2 * s]) * WEIGHTS[:, None]))
    wanted = np.zeros(len(edges), bool)
    wanted[outputs] = True
    y, found = np.zeros((2, courses.shape[2], len(w2))), []
    for k in range(len(edges)):
        if wanted[k]:
            found.append(y)
        if k < len(kind):
            flow, push = tables[kind[k]]
            y = (flow[:, :, None] * y).sum(axis=1) + courses[k].T @ push
    return np.array(found)


@dataclass(frozen=True)
class Transient(Motion, kind='transients', units=MOTION_UNITS | {'error': ('mm',), 'products': ('',)}):
    """Motion at chosen times, with `velocities`, an estimate of its error and the cost.

    Attributes
    ----------
    error : float
        Estimated error of any displacement in mm, rather too high, due to truncation of the series and round-off.
    products : int
        Matrix-vector products taken.
    """

    error: float = 0.0
    products: int = 0


@takes(*LINEAR)
def propagate(atoms: Atoms, times: ArrayLike, drives: Sequence[Any] = (), damping: ArrayLike = 0.0,
              particles: ArrayLike | None = None, tolerance: float = 1e-9) -> Transient:
    """Motion of the linearised structure from its present state at t = 0, at any later times.

    It costs about `omega_max t/2` products with the stiffness matrix; velocity Verlet takes ten times as many for an error of a
    percent. An unstable structure follows its linear equations: its modes grow.

    Parameters
    ----------
    atoms : ase.Atoms
        With PairCalculator; displacements from rest and momenta are the initial state.  The atoms rest at the reference of the
        calculator if the forces balance there, including Constant drives, or else at their present positions, if these are
        another equilibrium (`magphonon.stiffness.rest`).  FixAtoms, FixCartesian, FixedLine and FixedPlane are respected.
    times : array_like, shape (times,)
        Increasing, in ms.
    drives : sequence of drives
        See `magphonon.dynamics.drives`; a plain function of the time returns the forces on all particles, shape (particles, 3).
        It should be smooth except for kinks and steps, and have no pulse shorter than the shortest period. The same holds for the
        course of a PrescribedMotion; its velocity is reported as zero, as for all held particles.
    damping : float or array_like, shape (particles,)
        gamma in 1/ms. If it differs from particle to particle, or particles are gyroscopes, the motion takes four times
        as many products.
    particles : array_like of int, optional
        The particles whose motion is returned; all if not given.
    tolerance : float
        Largest error of a displacement, as a fraction of the largest one in the answer.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, ToneBurst, lattices, propagate
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 4.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> burst = ToneBurst(len(patch) // 2, (0, 1), 1e-3, omega=2.0)
    >>> moved = propagate(patch, np.arange(21.0), [burst], damping=0.1)
    >>> moved.displacements.shape  # times, particles, x and y
    (21, 61, 2)
    """
    times = _increasing(times)
    rates, tolerance = site_damping(damping, len(atoms), atoms.calc), positive('tolerance', tolerance)
    drives = list(drives)
    check_drives(drives, atoms)
    push = constant_push(drives, len(atoms))
    system = LinearSystem.nearest(atoms).moving()
    if system.dim == 2:
        refuse_motion_out_of_the_plane(system.calc, atoms)
    if system.left.any():  # constant drives may be part of the balance; on a structure at rest without them they are a step
        system, push = LinearSystem.nearest(atoms, push).balanced(), 0.0
    warn_of_times(system.calc, times[-1])
    warn_of_speed(system.calc, atoms.get_velocities())
    particles = system.recorded(particles)
    refuse_memory(f'the motion of {len(particles)} particles at {len(times)} times',
                  32 * len(times) * len(particles) * system.dim, 'ask for fewer')
    rows, shapes = system.rows(particles)
    load = _Load(system, drives, push, tolerance)
    state = _initial_state(atoms, system, load.walls.particles)
    turning = system.turning
    alike = not (np.ptp(rates) or turning)
    K = products_of(system) if alike else system.K

    def moved(interval):
        first_order = None if alike else FirstOrder(system.K, system.B(rates), interval, rates.max(), turning)
        asked = _Asked(K, interval, float(rates[0]), first_order, load, rows, sizes(shapes), tolerance)
        y, error, products = _propagate(asked, state, times)
        motion = (y.reshape(2 * len(times), len(rows)) @ shapes.T).reshape(len(times), 2, len(particles), system.dim)
        _, seen, led = np.intersect1d(particles, load.walls.particles, return_indices=True)
        motion[:, 0, seen] = components(load.walls.forces(times), system.dim)[:, led]
        return Transient(times, particles, motion[:, 0], motion[:, 1], error, products)

    try:
        if alike or system.stable:
            answer = moved(stable_interval(K))
            warn_of_amplitude(system.calc, answer.displacements)
            return answer
    except Outside:
        pass
    interval = whole_interval(system.K)
    growth = np.sqrt(-interval.lowest) * times[-1]
    if growth > OVERFLOW:
        raise Unstable(f'the structure is unstable: its motion grows by e^{growth:.0f} in {times[-1]:g} ms; ask for a shorter '
                         'time, or ask magphonon.verdict what would hold the structure')
    return moved(interval)


def _increasing(times):
    times = finite('times', np.atleast_1d(times))
    if times.ndim != 1 or not len(times) or times[0] < 0 or (np.diff(times) <= 0).any():
        raise ValueError('times must be one or more increasing numbers in ms, zero or above')
    return times


def _initial_state(atoms, system, walls):
    """Initial displacements and velocities in reduced coordinates, shape (free, 2); displacements of walls count as zero."""
    u = system.calc.displacements(atoms)
    u[walls] = 0.0
    u = u.ravel()
    momenta = atoms.get_momenta()[:, : system.dim].ravel()
    y = system.shapes.T @ (np.repeat(system.masses, system.dim) * u)
    outside = abs(system.shapes @ y - u)
    if outside.max() > 1e-9 * abs(u).max() + IN_PLACE * abs(atoms.positions).max():
        raise ValueError(f'particle {outside.argmax() // system.dim} is {outside.max():g} mm away from rest in a direction in '
                         'which it is held; start without this displacement')
    return np.stack([y, system.shapes.T @ momenta], axis=1)


class _Load:
    """Forces on a structure, as time courses times patterns; walls push their neighbours by F = -H_fh u_h."""

    def __init__(self, system, drives, push, tolerance):
        varying = [drive for drive in drives if not isinstance(drive, Constant)]
        self.static = system.shapes.T @ (static_forces(system.calc, push) if np.any(push) else system.static).ravel()
        (self._varying, self.walls), self._dim = forces_and_walls(varying, len(system)), system.dim
        self._tolerance = tolerance
        driven, led = ((those.particles[:, None] * system.dim + np.arange(system.dim)).ravel()
                       for those in (self._varying, self.walls))
        pull = -system.hessian[led].T if len(led) else sparse.csr_array((len(system) * system.dim, 0))
        beside = np.unique(pull.nonzero()[0])
        self._shapes, self._pull = sparse.vstack([system.shapes[driven], system.shapes[beside]]), pull[beside].T
        courses = [d.course if isinstance(d, PrescribedMotion) else d for d in varying]
        self._kinks = np.array([t for d in courses if isinstance(d, ToneBurst) for t in (d.start, d.end)])

    def _forces(self, times):
        pushes, walls = (components(those.forces(times), self._dim).reshape(len(times), -1)
                         for those in (self._varying, self.walls))
        return np.concatenate([pushes, walls @ self._pull], axis=1)

    def between(self, start, stops, rate):
        """Panels from `start` to the last of the `stops`: edges, courses (panels, nodes, terms), patterns (free, terms)."""
        kinks = self._kinks[(self._kinks > start) & (self._kinks < stops[-1])]
        edges = np.unique(np.concatenate([[start], stops, kinks]))
        edges, values = sampled(self._forces, edges, rate, max(1e-2 * self._tolerance, RESOLVED))
        panels, nodes, components = values.shape
        courses, patterns = separated(values.reshape(panels * nodes, components))
        courses, patterns = np.column_stack([courses, np.ones(panels * nodes)]), self._shapes.T @ patterns.T
        patterns = np.column_stack([patterns, self.static])
        acting = patterns.any(axis=0)
        return edges, courses[:, acting].reshape(panels, nodes, acting.sum()), patterns[:, acting]


@dataclass(frozen=True)
class _Asked:
    """The quantities that are the same in all parts of a motion."""

    K: Any
    interval: Any
    gamma: float
    first_order: FirstOrder | None  # in place of K where gamma is not that of all particles
    load: _Load
    rows: NDArray[np.int_]  # of K, whose motion is returned
    size: NDArray[np.float64]  # displacement for each of these coordinates
    tolerance: float


def _propagate(asked, state, times):
    """The motion, computed in sufficiently short parts: y of shape (times, 2, rows), and error and products of Transient."""
    interval, road = asked.interval, asked.first_order
    rate = np.sqrt(interval.highest - interval.lowest) if road is None else 2 * road.rate
    parts = int(np.ceil(max(rate * times[-1] / SPAN, len(times) * rate * times[-1] / 2 / LARGEST, 1)))
    parts = parts if road is None else max(parts, int(np.ceil(times[-1] / road.longest)))
    ends = times[-1] * np.arange(1, parts + 1) / parts
    part = np.searchsorted(ends[:-1], times)
    found, error, products, start = [], 0.0, 0, 0.0
    for k, end in enumerate(ends):
        wanted = times[part == k]
        stops = wanted if end in wanted[-1:] else np.append(wanted, end)
        if road is None:
            y, state, missed, taken = _part(asked, state, start, stops, last=k + 1 == parts)
        else:
            panels = asked.load.between(start, stops, road.rate)
            y, state, missed, taken = road.moved(state, panels, np.searchsorted(panels[0], stops), asked.rows)
            missed *= asked.size.max(initial=0.0)
        found.append(y[: len(wanted)])
        growth = np.exp(np.sqrt(-interval.lowest) * (end - start))
        error, products, start = growth * error + missed, products + taken, end
    return np.concatenate(found), error, products


def _resolved(motions, interval, terms):
    """Chebyshev coefficients of a motion, (stops, 2, columns, terms); `terms` grows until the coefficients have decayed."""
    c = coefficients(motions(interval.nodes(terms)))
    while abs(c[..., -8:]).max() > UNRESOLVED * abs(c).max():
        if c.shape[-1] > MOST * terms:
            raise ArithmeticError(f'the Chebyshev series of the response needs over {c.shape[-1]} terms, where {terms} should '
                                  'do; check that the drive is a smooth function of time between its kinks')
        c = coefficients(motions(interval.nodes(2 * c.shape[-1])))
    return c


def _part(asked, state, start, stops, last):
    """Motion at the `stops` after the `state` at `start`, shape (stops, 2, rows); the state at the last stop, unless this is the
    `last` part; and error and products of Transient. All parts but the last are computed to round-off.
    """
    K, interval, gamma, rows, size = asked.K, asked.interval, asked.gamma, asked.rows, asked.size
    rate = np.sqrt(interval.highest - interval.lowest)
    edges, courses, patterns = asked.load.between(start, stops, max(rate, gamma))
    outputs = np.searchsorted(edges, stops)
    moving = np.flatnonzero(state.any(axis=0))

    def free(w2):
        return np.moveaxis(free_response(w2, gamma, (stops - start)[:, None]), 2, 0)[:, :, moving]

    z = rate * (stops[-1] - start)
    terms = int(z / 2 + 6 * np.cbrt(z)) + 20
    sources = [(state[:, moving], free)] if len(moving) else []
    width = max(1, LARGEST // (len(stops) * terms))  # patterns at a time
    for k in range(0, patterns.shape[1], width):
        own = np.ascontiguousarray(courses[..., k : k + width])
        sources.append((patterns[:, k : k + width], lambda w2, own=own: forced_response(w2, gamma, edges, own, outputs)))

    y, end = np.zeros((len(stops), 2, len(rows))), np.zeros((2, len(state)))
    error, products = 0.0, 0
    for s, motions in sources:
        c = _resolved(motions, interval, terms)
        weight = (abs(c) / np.array([1.0, rate])[:, None, None]).max(axis=(0, 1)) * np.linalg.norm(s, axis=0)[:, None]
        left = np.cumsum(weight.sum(axis=0)[::-1])[::-1] * size.max(initial=0.0)
        left = np.append(left, np.zeros(BLOCK))
        for n, block in enumerate(chebyshev_blocks(K, interval, s, rows if last else slice(None), c.shape[-1])):
            used = (n + 1) * BLOCK
            own = c[..., used - BLOCK : used]
            block = block[: own.shape[-1]]
            if not last:
                end += np.tensordot(own[-1], block, ((2, 1), (0, 1)))
                block = block[..., rows]
            y += np.tensordot(own, block, ((3, 2), (0, 1)))
            enough = asked.tolerance * (abs(y[:, 0]) * size).max(initial=0.0) / len(sources) if last else 0.0
            if used >= c.shape[-1] or left[used] <= enough:
                break
        error, products = error + left[used] + EPS * (1 + z) * left[0], products + used * s.shape[1]
    return y, end.T, error, products
