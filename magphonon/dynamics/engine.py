"""Blocks of time steps: between two reads of the atoms, a kernel advances displacements and velocities in full precision.

A step that is longer than 2/omega_max, the limit of velocity Verlet, is refused beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import expm

from ..interactions.bond_laws import labels, taken
from ..lattices.bonds import lengths_of
from ..stiffness.calculator import PairCalculator
from ..stiffness.matrices import GROWS, hermitian_eigenvalues, upper_part
from ..stiffness.rest import LinearSystem, components, freedom, static_forces
from ..stiffness.sites import out_of_plane, refuse_motion_out_of_the_plane
from ..traits import LINEAR, takes
from .bond_increments import RANGES, TOLERANCE, Increments
from .cages import Cages
from .drives import Constant, constant_push, forces_and_walls
from .memory_layout import LINE, RUN, aligned_zeros, arrange, runs_of
from .splittings import SPLITTINGS, Splitting

LAW_SHARE = 0.1
"""Largest error of the slopes of the law, as a fraction of the relative error of stiffness that a run may make."""
SINGLE = 1e-7
"""Relative error of stiffness, for the whole of a run, from which on single precision serves: masses and stiffness are rounded to
3e-8, which is a drift of every phase."""
FINE = 1e-7
"""Relative error of the largest eigenvalue.  It lies close to others, so this takes long, and is done only near the limit."""
STEPS_TRIED = 24  # number of time steps at which motion held by gyration alone is tested
SAME_VECTOR = 1e-11
"""Largest difference, in shortest bonds, of rest vectors that count as one: far above the round-off of positions."""
SAME_KIND = 1e-12  # relative difference of lengths up to which bonds that are not alike share coefficients


def refuse_long_step(atoms: Atoms, dt: float, limit: float = 2.0) -> float:
    """Raise ValueError if `dt` (ms) exceeds limit/omega_max about rest; otherwise return a bound of omega_max in rad/ms.

    Calculators other than PairCalculator are not checked; the bound is then 0.
    """
    if not isinstance(atoms.calc, PairCalculator):
        return 0.0
    omega = frequency_bound(atoms, dt * 2 / limit)
    if omega * dt > limit:
        raise ValueError(f'the time step of {dt:.9g} ms exceeds the stability limit {limit:g}/omega_max = {limit / omega:.9g} '
                         'ms; a tenth of the limit is accurate; allow_unstable=True runs anyway')
    return omega


def refuse_long_decay(damping: NDArray[np.float64], dt: float, splitting: Splitting) -> None:
    """Raise ValueError if the damping within a step of `dt` (ms) is so large that overdamped motion would be off by percents."""
    gamma = float(damping.max(initial=0.0))
    if gamma * dt > splitting.damped:
        raise ValueError(f'damping {gamma:.6g} 1/ms times the time step {dt:.6g} ms is {gamma * dt:.3g}; beyond '
                         f'{splitting.damped:g} overdamped motion is wrong by 2 % or more; take a time step of at most '
                         f'{splitting.damped / gamma:.6g} ms{", order=4 or 6" if splitting.stages == 1 else ""}, or '
                         'magphonon.propagate; allow_unstable=True runs anyway')


@takes(*LINEAR)
def highest_frequency(atoms: Atoms | LinearSystem) -> float:
    """Highest angular frequency about rest that the constraints allow, in rad/ms; zero if nothing vibrates.

    If the forces balance nowhere, the frequency is taken about the reference or the present positions, whichever is closer to
    balance. Gyration is ignored, because the limit of the time step does not depend on it; if only gyration holds the structure,
    the result is 2 divided by the longest stable step.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        With its PairCalculator.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.dynamics import highest_frequency
    >>> patch = read_scene(ready_scene('prototype')).patch_atoms()
    >>> round(float(2 / highest_frequency(patch)), 2)  # the largest stable time step in ms
    2.13
    """
    from ..stiffness.lowest import DENSE

    system = LinearSystem.nearest(atoms)
    if _held_by_gyration(system):
        bound = fastest(max(_largest_eigenvalue(sign * system.K) for sign in (1, -1)), system.turning)
        if system.directions > DENSE or system.growth():
            return bound
        return 2 / _longest_step(system.K.toarray(), system.B().toarray(), 2 / bound)
    return np.sqrt(max(_largest_eigenvalue(system.K), 0.0)) if particle_bound(system) else 0.0


def fastest(square: float, turning: float) -> float:
    """Upper bound of |s| for motion e^{st}, if squared frequencies are within +-`square`: `g/2 + sqrt(g^2/4 + square)`."""
    return float(turning / 2 + np.sqrt(turning**2 / 4 + square))


def _longest_step(K, B, bound):
    """The time step in ms, at most `bound`, above which Verlet steps make a structure grow that only gyration holds.

    Steps of dt act like exact motion with the masses m - dt^2 K/4 and the gyration (2/dt) tan(g dt/2).  If K is positive, this
    motion stays bounded as long as these masses are positive.  If not, frequencies of opposite energy may meet at any dt.
    """
    one, none = np.eye(len(K)), np.zeros(K.shape)

    def grows(dt):
        turn = np.block([[one, none], [none, expm(-B * dt / 2)]])
        kick, drift = np.block([[one, none], [-K * dt / 2, one]]), np.block([[one, dt * one], [none, one]])
        return abs(np.linalg.eigvals(turn @ kick @ drift @ kick @ turn)).max() > 1 + GROWS

    high = next((dt for dt in bound * np.arange(1, STEPS_TRIED + 1) / STEPS_TRIED if grows(dt)), None)
    if high is None:
        return bound
    low = high - bound / STEPS_TRIED
    while high - low > 1e-3 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if grows(middle) else (middle, high)
    return low


def _held_by_gyration(system):
    """Whether particles gyrate and stiffness alone does not hold them, so that Verlet steps conserve no positive energy."""
    return system.turning and not system.stable


@takes(*LINEAR)
def frequency_bound(atoms: Atoms, dt: float) -> float:
    """Upper bound of the highest frequency in rad/ms, as sharp as a decision on the time step `dt` (ms) requires.

    Gyration is ignored if stiffness alone holds the structure: rotations conserve the positive form that Verlet steps conserve,
    and do not change the limit.  `particle_bound` is enough for most steps; if it is above 2/dt, the highest frequency itself is
    returned.
    """
    system = LinearSystem.nearest(atoms)
    if _held_by_gyration(system):
        return highest_frequency(system)
    omega = particle_bound(system)
    return omega if omega * dt <= 2 else highest_frequency(system)


def particle_bound(system: LinearSystem, u: NDArray[np.float64] | None = None) -> float:
    """Upper bound of the frequencies at displacements u, computed without the Hessian: `w^2 <= k/m + 2/m sum_b K_b`.

    Negative eigenvalues of K_b are set to zero. The bound follows from `(u_i - u_j).K (u_i - u_j) <= 2 u_i.K u_i + 2 u_j.K u_j`.
    In a triangular lattice it is 4 % too high.
    """
    calc, masses = system.calc, system.masses
    k = np.broadcast_to(calc.foundation, (len(masses), calc.dim)).max(axis=1)
    vectors = calc.bond_vectors if u is None else calc.displaced(u)[0]
    own = calc.bonds.total(upper_part(vectors, calc.interaction, calc.model))
    squares = (k + 2 * hermitian_eigenvalues(own)[:, -1]) / masses
    return np.sqrt(squares[system.mobile].max(initial=0.0))


def _largest_eigenvalue(D):
    from ..stiffness.lowest import DENSE

    if D.shape[0] < DENSE:
        return np.linalg.eigvalsh(D.toarray()).max(initial=0.0)
    start = np.random.default_rng(0).normal(size=D.shape[0])  # a fixed start vector makes the result reproducible
    return sparse.linalg.eigsh(D, k=1, which='LA', v0=start, tol=FINE, return_eigenvectors=False)[0]


def half_step(damping: NDArray[np.float64], rate: Any, guided: NDArray[np.int_], barred: NDArray[np.float64],
              dt: float) -> NDArray[Any]:
    """Factor E by which damping and gyration (in `rate`) change velocities in half a step, shape (particles,).

    In the plane, `E = e^{-(c + i g) dt/2}` multiplies v_x + i v_y, and is real if g = 0; in space it is a matrix for each
    particle.  Particles guided by a line do not gyrate; those guided by a plane gyrate within it.
    """
    if not np.any(rate):
        return np.exp(-damping * dt / 2)
    if rate.shape[-1] == 3:
        rate, free = np.broadcast_to(rate, (len(damping), 3, 3)).copy(), np.eye(3) - barred
        rate[guided] = free @ rate[guided] @ free
        return np.exp(-damping * dt / 2)[:, None, None] * expm(-rate * dt / 2)
    g = np.broadcast_to(-rate[:, 0, 1], len(damping)).copy()
    g[guided] = 0.0
    return np.exp(-(damping + 1j * g) * dt / 2)


def refusal(atoms: Atoms) -> str | None:
    """Why compiled steps cannot integrate `atoms`, or None if they can.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.dynamics import refusal
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> refusal(patch) is None  # compiled steps can run it
    True
    """
    if type(atoms.calc) is not PairCalculator:
        return f'the calculator is {atoms.calc!r}, not PairCalculator'
    if atoms.calc.dim == 3 and np.any(atoms.calc.rate):
        return 'particles gyrate in space'
    if atoms.calc.interaction.central(atoms.calc.dim) is None:
        return 'the forces are not along the bonds'
    if atoms.calc.sites.radii is not None:
        return 'the laws are functions of the distance over the sum of both radii'
    if atoms.calc.dim == 2 and out_of_plane(atoms).any():
        return 'particles move out of the plane'
    if (atoms.calc.bonds.i == atoms.calc.bonds.j).all():
        return 'every bond joins a particle to its own image, and never changes'
    try:
        freedom(atoms)
    except ValueError as error:
        return str(error)
    return None


class Blocks:
    """Displacements and velocities, with digits that absolute positions would lose, which move by blocks of steps.

    Parameters
    ----------
    atoms : ase.Atoms
        With its PairCalculator; `refusal(atoms)` is None.
    dt : float
        Time step in ms.
    drives : sequence of drives
    damping : ndarray, shape (particles,)
        gamma in 1/ms; the gyration comes from the calculator.
    splitting : Splitting
    threads : int
        Number of threads; the bits of the results do not depend on it.
    """

    def __init__(self, atoms: Atoms, dt: float, drives: Sequence[Any], damping: NDArray[np.float64],
                 splitting: Splitting = SPLITTINGS[2], threads: int = 1) -> None:
        calc: PairCalculator = atoms.calc  # pyright: ignore[reportAssignmentType]  of which `refusal` has made sure
        self.atoms, self.calc, self.dt, self._splitting = atoms, calc, dt, splitting
        self._varying, self._walls = forces_and_walls([d for d in drives if not isinstance(d, Constant)], len(atoms))
        self._masses, (mobile, self._guided, self._barred) = atoms.get_masses(), freedom(atoms)
        self._mobile = mobile[:, None]
        self._follows = self._mobile | np.isin(np.arange(len(atoms)), self._walls.particles)[:, None]
        static = self._mobile * static_forces(calc, constant_push(drives, len(atoms)))
        self._load = static if static.any() else None

        self.layout = layout = arrange(calc.reference, calc.bonds, calc.dim)
        self._at, self._wide = layout.slot, layout.length + 3 * LINE
        self._runs = runs_of(self._at).astype(np.uint64)
        borders = np.linspace(0, len(self._runs), max(1, min(threads, len(self._runs))) + 1).astype(int)
        highest = np.uint64(0 if layout.offset is None else layout.offset[-1])
        from_where = np.searchsorted(self._runs[:, 1] + highest, self._runs[borders[:-1], 0], side='right')
        self._parts = list(zip(from_where.tolist(), borders[:-1].tolist(), borders[1:].tolist(), strict=True))
        size, directions = np.linalg.eigh(self._barred)
        away = size > 0.5  # a projector has the eigenvalues 0 and 1
        self._normals = np.repeat(self._guided, away.sum(axis=1)), directions.transpose(0, 2, 1)[away][None]
        self._rate = damping.max() if splitting.stages > 1 else 0.0  # the same for all particles: it acts in the drifts
        self._half = half_step(damping - self._rate, calc.rate, self._guided, self._barred, dt)
        self._sort_bonds()
        self._level, self._rough, self._dtype, self._law, self._pool = 0, -1.0, np.float64, None, None
        self.cages = Cages(atoms)
        self._read()

    # --- arrays of slots --------------------------------------------------------------------------------------------------

    def _put(self, values):
        """Values of the slots, shape (..., slots), zero in empty ones, from those of the particles, shape (particles, ...)."""
        slots = aligned_zeros((*values.shape[1:], self._wide), self._dtype)
        slots[..., self._at] = np.moveaxis(values, 0, -1)
        return slots

    def _sort_bonds(self):
        """Find out whether the bonds of a column are alike; if not, how their laws differ."""
        layout, calc = self.layout, self.calc
        r0, label = lengths_of(layout.R), labels(calc.law, len(calc.bonds))[layout.bond]
        self._alike = layout.offset is not None
        if layout.offset is not None:
            first = np.array([(layout.column == n).argmax() for n in range(len(layout.offset))])
            kind = layout.column
            off = abs(layout.R - layout.R[first][kind]).max() > SAME_VECTOR * r0.min()
            self._alike = not off and bool((label == label[first][kind]).all())
        if not self._alike:
            key = label * 2.0**40 + np.round(np.log(r0) / SAME_KIND)
            _, first, kind = np.unique(key, return_index=True, return_inverse=True)
        example = np.arange(len(calc.bonds))[layout.bond][first]
        self._first, self._kind = first, kind.ravel()
        self._increments = Increments(taken(calc.law, example), calc.model, r0[first])
        self._factors = None if self._alike else self._increments.factors

    def _each(self, values):
        """Values of the bonds, shape (..., bonds), at their slots, shape (..., columns, slots)."""
        column, i = self.layout.column, self.layout.i
        rows = aligned_zeros((*values.shape[:-1], int(column.max()) + 1, self._wide), self._dtype)
        rows[..., column, i] = values
        return rows

    def _bonds(self):
        """The bonds for the kernel, without their law."""
        from .kernel import Bonds

        layout, law, kind, offset = self.layout, self._increments, self._kind, self.layout.offset
        S, q, g = 2 * layout.R.T / law.r0[kind] ** 2, (self.calc.model == 'complete') / law.r0**2, law.g
        there = self._each(np.ones(len(kind)))
        if offset is None:
            near = np.tile(np.arange(self._wide, dtype=np.uint32), (len(there), 1))  # a missing bond leads to its own slot
            near[layout.column, layout.i] = layout.j
        else:
            near = offset.astype(np.uint64)
        if not self._alike:
            factors = 1 if self._factors is None else (self._factors * (law.r0 / law.r0[0]) ** 2)[kind]
            return Bonds(near, self._each(S), self._each(q[kind]), self._each(g[kind]), self._each(factors * np.ones(len(kind))))
        mine = self._at[self._mobile[:, 0]]
        whole = all(row[mine].all() and row[mine - o].all() for row, o in zip(there, offset, strict=True))  # pyright: ignore
        S, q, g = (np.ascontiguousarray(x, self._dtype) for x in (S[:, self._first], q, g))
        return Bonds(near, S, q, g, None if whole else there)

    def _sites(self):
        """What acts on the slots, for the kernel."""
        from .kernel import Sites

        d, mobility = self._half[:, None], self._mobile / self._masses[:, None]
        decay, self._push = np.hstack([d, d * d, d]), np.hstack([1 + 0 * d, (1 + d * d) / 2, d]) * mobility
        turns = self._put(np.imag(np.stack([decay, self._push], axis=1))) if np.iscomplexobj(d) else None
        springs = np.broadcast_to(self.calc.foundation, (len(d), self.calc.dim))
        load = None if self._load is None else self._put(self._load)
        return Sites(self._put(springs), load, self._put(np.real(decay)), self._put(np.real(self._push)), turns)

    def _flow_of(self, stages):
        """Factors (keep, kick, drift) of the stages of a block, in which the last kick of a step and the next share one."""
        if stages not in self._flows:
            h, one = self.dt, self._splitting
            drifts, damped = one.flow(h, self._rate)
            kicks = h * np.array([*one.kicks[1:-1], one.kicks[-1] + one.kicks[0]])
            between = np.tile(np.column_stack([damped, kicks, np.roll(drifts, -1)]), (stages // len(drifts), 1))
            first, last = [1.0, h * one.kicks[0], drifts[0]], [damped[-1], h * one.kicks[-1], 0.0]
            self._flows[stages] = np.vstack([first, between[: stages - 2], last]).astype(self._dtype)
        return self._flows[stages]

    def use(self, rough: float = 0.0) -> None:
        """Make the kernel ready, whose stiffness has a relative error of at most `rough`.

        The law gets only as many coefficients as this error requires, and steps may be in single precision.
        """
        if rough != self._rough:
            self._rough, self._dtype = rough, np.float32 if rough >= SINGLE else np.float64
            self._given, self._flows = (self._bonds(), self._sites()), {}
            self._pulls = [[tuple(aligned_zeros((self.calc.dim, n), self._dtype)) for n in (self._wide, RUN)]
                           for _ in self._parts]
            nothing = np.zeros(0, int), np.zeros((1, 0, self.calc.dim))
            self._special = [self._some(*of) for of in (nothing, self._normals, nothing)]
            if self._state.dtype != self._dtype:
                before, (self._state, self._spare) = self._state, aligned_zeros((2, *self._state.shape), self._dtype)
                self._state[:] = before
                self.write()  # otherwise the atoms would seem to have been changed
            self._fit(self._level)

    def _fit(self, level):
        """Take the law for increments up to RANGES[level]; returns whether there is one."""
        law, self._level, self._law = self._increments, level, None
        if self._factors is not None:
            law = Increments(taken(law.potential, np.zeros(1, int)), law.model, law.r0[:1])
        with np.errstate(over='ignore', invalid='ignore'):
            c = law.polynomial(RANGES[level], max(TOLERANCE, LAW_SHARE * self._rough)) if level < len(RANGES) else None
        if c is not None:
            c *= law.r0**2 / 2
            if self._factors is not None:
                c = np.repeat(c, len(self._given[0].near), axis=1)
            elif not self._alike:
                c = self._each(c[:, self._kind])
            self._law = tuple(c.astype(self._dtype))
        return self._law is not None

    # --- steps ------------------------------------------------------------------------------------------------------------

    def steps_to_next_look(self, most: int) -> int:
        """Number of steps of the next block, at most `most`; fewer if particles are fast."""
        largest, speed = self._extent
        return self.cages.steps_between_looks(speed, largest, self.dt, most)

    def advance(self, first: int, steps: int) -> bool:
        """Move on by a block of `steps`, from the step number `first`; if this raises Diverged, nothing has moved.

        Returns False, and nothing has moved either, if a bond goes beyond all of the law that could be fitted.
        """
        kicks = (np.arange(first, first + steps)[:, None] + self._splitting.times).ravel()
        times = self.dt * np.append(first, kicks)
        while self._law is None or self._run(times):
            if self._law is None or not self._fit(self._level + 1):
                return False
        u, v, _ = self._spare
        extent = [np.sqrt(len(u)) * largest(x) for x in (u, v)]
        if not self.cages.still(extent[0]):
            u = u[:, self._at]
            if not self.cages.clear(u):
                u = np.where(self._follows, u.T, self.displacements)  # forces on held particles have no meaning
                self.cages.look(u, times[-1], bonded=False)
        self._state, self._spare, self._extent = self._spare, self._state, extent
        return True

    def _some(self, particles, values):
        """Slots of some particles, and their values, shape (stages, particles, dim), for the kernel."""
        return self._at[particles].astype(np.uint64), np.ascontiguousarray(values, self._dtype)

    def _pushes(self, times):
        """Changes of the velocities of driven particles by unit kicks, shape (stages, particles, dim)."""
        forces = components(self._varying.forces(times), self.calc.dim)
        push = self._push[self._varying.particles].T[[0, *[1] * (len(times) - 2), 2], :, None]
        pushed = push.real * forces
        return pushed + push.imag * forces[..., ::-1] * (-1, 1) if np.iscomplexobj(push) else pushed

    def _run(self, times):
        """Fill the spare state with the state at the end of the block; returns whether a bond was beyond the law."""
        from .kernel import stages

        pushed, guided, led = self._special
        if self._varying:
            pushed = self._some(self._varying.particles, self._pushes(times))
        if self._walls:
            course = self._walls.forces(np.append(times[1:], times[-1]))
            led = self._some(self._walls.particles, components(course, self.calc.dim))
        self._spare[:2] = self._state[:2]
        (u, v, w), (bonds, sites), parts = map(tuple, self._spare), self._given, self._parts
        bonds = bonds._replace(c=self._law)
        if alone := len(parts) == 1 and self.layout.offset is not None:
            w = u  # no slot is read after it has moved
        flow, reach = self._flow_of(len(times)), self._dtype(RANGES[self._level])

        def work(pulls, part, some):
            return stages(u, w, v, pulls[0], pulls[1], bonds, sites, flow, reach, self._runs, part, pushed, guided, led, some)

        if len(parts) == 1:
            beyond = work(self._pulls[0], parts[0], (0, len(times)))
        else:
            self._pool = self._pool or ThreadPoolExecutor(len(parts))
            together = [list(self._pool.map(work, self._pulls, parts, [(n, n + 1)] * len(parts))) for n in range(len(times))]
            beyond = any(map(any, together))
        if len(times) % 2 and not alone:
            self._spare[0] = self._spare[2]
        return beyond

    def place_walls(self, time: float) -> None:
        """Move the walls to their positions at `time` in ms."""
        walls = self._walls.particles
        self._state[0][:, self._at[walls]] = components(self._walls.forces(np.array([time])), self.calc.dim)[0].T
        self.write()

    # --- the atoms --------------------------------------------------------------------------------------------------------

    @property
    def displacements(self) -> NDArray[np.float64]:
        """Displacements from rest in mm, shape (particles, dim)."""
        return self._state[0][:, self._at].T.astype(float)

    @property
    def velocities(self) -> NDArray[np.float64]:
        """Velocities in mm/ms, shape (particles, dim)."""
        return self._state[1][:, self._at].T.astype(float)

    @property
    def current(self) -> bool:
        """Whether the atoms are still as `write` left them; observers may have changed them."""
        arrays, dim = self.atoms.arrays, self.calc.dim
        return all(np.array_equal(arrays[name][:, :dim], values) for name, values in self._written())

    def follow(self) -> None:
        """Read the state from the atoms if they have been changed since `write`; refuse a motion that no block would follow."""
        if self.calc.dim == 2:
            refuse_motion_out_of_the_plane(self.calc, self.atoms)
        if not self.current:
            self._read()

    def write(self) -> None:
        """Write the state into the atoms, rounded as absolute positions are."""
        for name, values in self._written():
            self.atoms.arrays[name][:, : self.calc.dim] = values

    def _written(self):
        u, v = self._state[:2, :, self._at]
        return ('positions', (self._anchors + u).T), ('momenta', (self._masses * v).T)

    def _read(self):
        dim, u = self.calc.dim, self.calc.displacements(self.atoms)
        self._anchors = np.subtract(self.atoms.positions.T[:dim], u.T, order='C')
        v = self._mobile * self.atoms.get_momenta()[:, :dim] / self._masses[:, None]
        v[self._guided] -= np.einsum('gxy,gy->gx', self._barred, v[self._guided])
        self._state, self._spare = aligned_zeros((2, 3, dim, self._wide), self._dtype)
        self._state[0][:, self._at], self._state[1][:, self._at] = u.T, v.T
        self._spare[:] = self._state  # displacements, velocities, and room for other displacements
        self._extent = [np.sqrt(dim) * largest(x) for x in (u, v)]  # bounds of the largest displacement and speed
        level = int(np.searchsorted(RANGES, self._strain(u)))  # no kernel is made for less, as compiling takes its time
        if self._rough < 0:
            self._level = level
        elif level > self._level or self._law is None:
            self._fit(level)

    def _strain(self, u):
        """The largest increment |e| at the displacements u."""
        du, R, complete = self.calc.bonds.relative(u), self.calc.bond_vectors, self.calc.model == 'complete'
        e = sum((2 * x + complete * dx) * dx for x, dx in zip(R.T, du.T, strict=True)) / self.calc.bonds.lengths**2
        return abs(e).max()


def largest(x: NDArray[Any]) -> float:
    """The largest absolute value; NaN if one is NaN."""
    return max(float(x.max()), -float(x.min()))
