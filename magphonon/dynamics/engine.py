"""Blocks of time steps: between two reads of the atoms, a kernel advances displacements and velocities in full precision.

A step that is longer than 2/omega_max, the limit of velocity Verlet, is refused beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import expm

from ..interactions.bond_laws import labels, taken
from ..lattices.bonds import stretches
from ..stiffness.bond import upper_part
from ..stiffness.calculator import PairCalculator
from ..stiffness.matrices import GROWS, hermitian_eigenvalues, own_stiffness
from ..stiffness.rest import LinearSystem, components, freedom, static_forces
from ..stiffness.sites import out_of_plane, refuse_motion_out_of_the_plane
from ..traits import LINEAR, all_but, refuse, takes
from .bond_increments import RANGES, TOLERANCE, Increments, Pieces, pieces
from .cages import BROKEN_BOND, CONTACT, Cages
from .drives import Constant, constant_push, forces_and_walls
from .memory_layout import aligned_zeros, arrange, same
from .splittings import SPLITTINGS, Splitting

LAW_SHARE = 0.1
"""Largest error of the slopes of the law, as a fraction of the relative error of stiffness that a run may make."""
SINGLE = 1e-7
"""Relative error of stiffness, for the whole of a run, from which on single precision serves: masses and stiffness are rounded to
3e-8, which is a drift of every phase."""
ROUGH, FINE = 1e-3, 1e-7
"""Relative errors of the largest eigenvalue.  It lies close to others, so the fine accuracy takes long and is used only near the
stability limit."""
STEPS_TRIED = 24  # number of time steps at which motion held by gyration alone is tested
MANY_LOADED = 1 / 8
"""Share of the particles with a static force left on them above which that force is stored for every particle, as in a patch
whose particles are displaced at random; below it, for these particles only."""
MOST_LAWS = 64  # number of laws up to which each is cut into pieces although bonds have their own
INERT = 1e-30
"""Mobility of a wall in 1/g: no force between particles moves a wall, and the force that leads it does not overflow."""
ANY_DIRECTION = 2**0.5  # largest ratio of the length of a vector in the plane to its larger component
PIECES = len(RANGES)  # level of the piecewise law, from contact to broken bonds; what is beyond it is left to ASE's loop


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
        bound = fastest(max(_largest_eigenvalue(sign * system.K, FINE) for sign in (1, -1)), system.turning)
        if system.directions > DENSE or system.growth():
            return bound
        return 2 / _longest_step(system.K.toarray(), system.B().toarray(), 2 / bound)
    return np.sqrt(max(_largest_eigenvalue(system.K, FINE), 0.0)) if _particle_bound(system) else 0.0


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
    while high - low > ROUGH * high:
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
    and do not change the limit.  Three bounds are tried, the cheapest first, until one is below 2/dt.  If none is, the highest
    frequency itself is returned.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.dynamics.engine import frequency_bound, highest_frequency
    >>> patch = read_scene(ready_scene('prototype')).patch_atoms()
    >>> bool(frequency_bound(patch, 1e-3) >= highest_frequency(patch))
    True
    """
    system = LinearSystem.nearest(atoms)
    if _held_by_gyration(system):
        return highest_frequency(system)
    bounds = (lambda: _particle_bound(system),
              lambda: np.sqrt(abs(system.K).sum(axis=1).max()),
              lambda: np.sqrt((1 + ROUGH) * _largest_eigenvalue(system.K, ROUGH)))
    for bound in bounds:
        if (omega := bound()) * dt <= 2:
            return omega
    return highest_frequency(system)


def _particle_bound(system):
    """Upper bound of the frequencies, computed without the Hessian: `w^2 <= k/m + 2/m sum_b K_b`.

    Negative eigenvalues of K_b are set to zero. The bound follows from `(u_i - u_j).K (u_i - u_j) <= 2 u_i.K u_i + 2 u_j.K u_j`.
    In a triangular lattice it is 4 % too high.
    """
    calc, masses = system.calc, system.masses
    k = np.broadcast_to(calc.foundation, (len(masses), calc.dim)).max(axis=1)
    own = own_stiffness(calc.bonds, upper_part(calc.bond_vectors, calc.interaction, calc.model))
    squares = (k + 2 * hermitian_eigenvalues(own)[:, -1]) / masses
    return np.sqrt(squares[system.mobile].max(initial=0.0))


def _largest_eigenvalue(D, tolerance):
    from ..stiffness.lowest import DENSE

    if D.shape[0] < DENSE:
        return np.linalg.eigvalsh(D.toarray()).max(initial=0.0)
    start = np.random.default_rng(0).normal(size=D.shape[0])  # a fixed start vector makes the result reproducible
    return sparse.linalg.eigsh(D, k=1, which='LA', v0=start, tol=tolerance, return_eigenvectors=False)[0]


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


def refuse_order(atoms: Atoms, splitting: Splitting) -> None:
    """Raise ValueError for gyration with splittings of order 4 or 6, whose forces may depend on positions only."""
    if splitting.stages > 1:
        refuse(atoms, all_but('a step of order 4 or 6', 'gyration'))


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
    if atoms.calc.dim != 2:
        return 'the structure is not planar'
    if atoms.calc.interaction.central(2) is None:
        return 'the forces are not along the bonds'
    if atoms.calc.sites.radii is not None:
        return 'the laws are functions of the distance over the sum of both radii'
    if out_of_plane(atoms).any():
        return 'particles move out of the plane'
    try:
        freedom(atoms)
    except ValueError as error:
        return str(error)
    return None


@dataclass(frozen=True)
class Motion:
    """Everything that moves the particles besides the bonds.

    Attributes
    ----------
    dt : float
        Time step in ms.
    splitting : Splitting
    rate : float
        gamma of the drifts in 1/ms.
    decay : ndarray, shape (slots,)
        d = exp(-(gamma + i g) dt/2), real where nothing gyrates; 1 where drifts are damped.
    mobility : ndarray, shape (slots,)
        1/m in 1/g; zero for held particles and empty slots.
    foundation : float or ndarray, shape (2, slots)
        k in N/mm: one number for all particles, or one for each displacement.
    static : ndarray, shape (2, slots), or None
        Forces in N that do not change; None if they are zero, or included in the external forces on the driven slots.
    driven : ndarray of int
        Slots with external forces.
    guided : ndarray of int
        Slots that a line or plane guides.
    barred : ndarray, shape (guided, 2, 2)
        Projector on the direction that is barred to each guided slot.
    """

    dt: float
    splitting: Splitting
    rate: float
    decay: np.ndarray
    mobility: np.ndarray
    foundation: float | np.ndarray
    static: np.ndarray | None
    driven: np.ndarray
    guided: np.ndarray
    barred: np.ndarray


class Blocks:
    """Displacements, velocities and accelerations of a planar structure, with digits that absolute positions would lose.

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
        Number of threads of compiled blocks; the bits of the results do not depend on it.
    """

    def __init__(self, atoms: Atoms, dt: float, drives: Sequence[Any], damping: NDArray[np.float64],
                 splitting: Splitting = SPLITTINGS[2], threads: int = 1) -> None:
        calc: PairCalculator = atoms.calc  # pyright: ignore[reportAssignmentType]  of which `refusal` has made sure
        masses = atoms.get_masses()
        self.atoms, self.calc, self.dt, self.threads = atoms, calc, dt, threads
        self._varying, self._walls = forces_and_walls([d for d in drives if not isinstance(d, Constant)], len(atoms))
        led = self._walls.particles
        mobile, guided, barred = freedom(atoms)
        static = static_forces(calc, constant_push(drives, len(atoms)))
        loaded = np.flatnonzero(mobile & static.any(axis=1))
        everywhere = len(loaded) > MANY_LOADED * len(atoms)
        driven = loaded[: len(loaded) * (not everywhere)]
        driven = np.union1d(driven, self._varying.particles[mobile[self._varying.particles]])
        driven = self._driven = np.union1d(driven, led)
        self._led = np.searchsorted(driven, led)
        _, self._to, self._from = np.intersect1d(driven, self._varying.particles, return_indices=True)
        self._static = static[driven] * (not everywhere)

        self.layout = layout = arrange(calc.reference, calc.bonds, mobile, labels(calc.law, len(calc.bonds)))
        self._increments = Increments(taken(calc.law, layout.example), calc.parameters.model, layout.r0)
        self._splitting = splitting
        rate = damping.max() if splitting.stages > 1 else 0.0  # the same for all particles: it acts in the drifts
        E: Any = np.array(half_step(damping - rate, calc.rate, guided, barred, dt))
        mobility = mobile / masses
        E[led], mobility[led] = 1.0, INERT
        decay = layout.scatter(np.real(E))
        if np.iscomplexobj(E):
            decay = decay + 1j * layout.scatter(np.imag(E))
        k: Any = calc.foundation
        k = layout.scatter(k) if np.ndim(k) else k
        self._motion = Motion(dt, splitting, rate, decay, layout.scatter(mobility), k,
                              layout.scatter(static) if everywhere else None, layout.slot[driven], layout.slot[guided], barred)
        self._mobile, self._masses, self._guided = mobile[:, None], masses, guided
        self._follows = (mobile | np.isin(np.arange(len(atoms)), led))[:, None]
        self._level, self._kernel, self._rough = 0, None, 0.0
        self._dtype: Any = np.float64
        self.cages = Cages(atoms)
        self._read()

    @property
    def displacements(self) -> NDArray[np.float64]:
        """Displacements from rest in mm, shape (particles, 2)."""
        return self.layout.gather(self._state[0]).T.astype(float)

    @property
    def velocities(self) -> NDArray[np.float64]:
        """Velocities in mm/ms, shape (particles, 2)."""
        return self.layout.gather(self._state[1]).T.astype(float)

    def steps_to_next_look(self, most: int) -> int:
        """Number of steps of the next block, at most `most`; fewer if particles are fast."""
        largest, speed = self._extent
        return self.cages.steps_between_looks(speed, largest, self.dt, most)

    def use(self, rough: float = 0.0) -> None:
        """Make the kernel, whose stiffness has a relative error of at most `rough`.

        The law gets only as many coefficients as this error requires, and steps may be in single precision.
        """
        if rough != self._rough or self._kernel is None:
            self._rough = rough
            self._fit(self._level)

    def _fit(self, level):
        """Make the kernel for increments up to RANGES[level], or of the law in pieces; return whether it could be made."""
        from .kernels_numba import CompiledKernel

        tolerance = max(TOLERANCE, LAW_SHARE * self._rough)
        fit = self._increments.polynomial(RANGES[level], tolerance) if level < PIECES else None
        self._level, reach = (level, RANGES[level]) if fit else (max(level, PIECES), np.inf)
        fitted = fit and fit[0]
        if self._level == PIECES:
            fitted = self._in_pieces()
        if fitted is None:
            self._kernel = None
            return False
        self._dtype = np.float32 if self._level < PIECES and self._rough >= SINGLE else np.float64
        self._kernel = CompiledKernel(self.layout, self._increments, self._motion, fitted, reach, self.threads, self._dtype)
        if self._state.dtype != self._dtype:
            self._state, self._spare = (same(x, self._dtype) for x in (self._state, self._spare))
            self.write()  # otherwise the atoms would seem to have been changed
        return True

    def _in_pieces(self) -> list[Pieces] | None:
        """The pieces of the law for every kind of bond; None if a law needs too many."""
        law, own = self._increments, self.layout.own_laws
        alone, shape, strength = law.shapes
        if own and len(alone.r0) > MOST_LAWS:  # the first law is enough if all others are multiples of it
            alone = law.at(np.zeros(1, int)) if law.alike(law.increment(np.geomspace(CONTACT, BROKEN_BOND, 101))) else None
        if alone is None:
            return None
        found = [pieces(alone, kind, CONTACT, BROKEN_BOND) for kind in range(len(alone.r0))]
        if None in found or own:
            return None if None in found else found  # pyright: ignore[reportReturnType]  none of them is None
        return [replace(found[k], coefficients=s * found[k].coefficients)  # pyright: ignore[reportArgumentType]  none of them is None
                for k, s in zip(shape, strength, strict=True)]

    def advance(self, first: int, steps: int) -> bool:
        """Move on by a block of `steps`, from the step number `first`; if this raises Diverged, nothing has moved.

        Returns False, and nothing has moved either, if a bond goes beyond all of the law that could be fitted.
        """
        if self._kernel is None:
            return False
        kicks = (np.arange(first, first + steps)[:, None] + self._splitting.times).ravel()
        times = self.dt * np.append(first, kicks)
        forces = self._external(times)
        if self._walls:
            self._lead(times, forces)
        while True:
            beyond, *extent = self._try(forces)
            if not beyond:
                break
            self._stale = True
            with np.errstate(over='ignore', invalid='ignore'):
                if self._level == PIECES or not self._fit(self._level + 1):
                    return False
        extent = [ANY_DIRECTION * float(x) for x in extent]
        if not self.cages.still(extent[0]):
            u = self.layout.gather(self._spare[0])
            if not self.cages.clear(u):
                u = np.where(self._follows, u.T, self.displacements)  # forces on held particles have no meaning
                self.cages.look(u, times[-1], bonded=False)
        self._state, self._spare, self._extent = self._spare, self._state, extent
        self._state[1:, :, self.layout.slot[self._walls.particles]] = 0.0  # as for all held particles
        return True

    def place_walls(self, time: float) -> None:
        """Move the walls to their positions at `time` in ms."""
        slots = self.layout.slot[self._walls.particles]
        u = components(self._walls.forces(np.array([time])), 2)[0].T
        self._stale |= bool((self._state[0][:, slots] != u).any())
        self._state[0][:, slots] = u
        self.write()

    def _lead(self, times, forces):
        """Move walls to their positions at the first of the times, and fill in the forces that move them along their course.

        A wall is a particle with almost no mobility, which only these forces move: the drift after each kick must lead to the
        place of the wall at the next kick.
        """
        kernel, slots = self._kernel, self.layout.slot[self._walls.particles]
        u = components(self._walls.forces(times), 2)
        stage = np.arange(len(times) - 2) % len(kernel.keeps)
        drifts = np.append(kernel.first, np.asarray(kernel.drifts)[stage])
        v = np.diff(u, axis=0) / drifts[:, None, None]
        carry, push = (factors[stage, None, None] * np.real(row[slots, None])
                       for factors, row in ((kernel.keeps, kernel.carry), (kernel.kicks, kernel.push)))
        forces[1:-1, self._led] = (v[1:] - carry * v[:-1]) / push
        self._state[0][:, slots], self._state[1][:, slots], self._state[2][:, slots] = u[0].T, v[0].T, 0.0

    def _try(self, forces):
        """Fill the spare state with the state at the end of the block; returns the result of `CompiledKernel.advance`."""
        beyond = self._stale and self._kernel.accelerate(self._state, forces[0])
        self._stale = False
        found, far, fast = self._kernel.advance(self._state, forces[1:], out=self._spare)
        return beyond or found, far, fast

    def _external(self, times):
        """Static and external forces on the driven slots, shape (times, driven, 2)."""
        if not len(self._static):
            return np.zeros((len(times), 0, 2))
        varying = components(self._varying.forces(times), 2)
        total = np.repeat(self._static[None], len(times), axis=0)
        total[:, self._to] += varying[:, self._from]
        return total

    @property
    def current(self) -> bool:
        """Whether the atoms are still as `write` left them; observers may have changed them."""
        arrays = self.atoms.arrays
        return all(np.array_equal(arrays[name][:, :2], values) for name, values in self._written())

    def follow(self) -> None:
        """Read the state from the atoms if they have been changed since `write`; refuse a motion that no block would follow."""
        refuse_motion_out_of_the_plane(self.calc, self.atoms)
        if not self.current:
            self._read()

    def write(self) -> None:
        """Write the state into the atoms, rounded as absolute positions are."""
        for name, values in self._written():
            self.atoms.arrays[name][:, :2] = values

    def _written(self):
        u, v = (self.layout.gather(x) for x in self._state[:2])
        return ('positions', (self._anchors + u).T), ('momenta', (self._masses * v).T)

    def _read(self):
        u = self.calc.displacements(self.atoms)
        anchors = np.subtract(self.atoms.positions.T[:2], u.T, order='C')
        self._take(u, self.atoms.get_momenta()[:, :2] / self._masses[:, None], anchors)

    def _take(self, u, v, anchors):
        v = self._mobile * v
        v[self._guided] -= np.einsum('gxy,gy->gx', self._motion.barred, v[self._guided])
        self._state, self._spare = (aligned_zeros((3, 2, self.layout.length), self._dtype) for _ in range(2))
        self._state[0][:, self.layout.slot], self._state[1][:, self.layout.slot] = u.T, v.T
        self._anchors, self._stale = anchors, True
        self._extent = [ANY_DIRECTION * abs(x).max() for x in self._state[:2]]  # bounds of the largest displacement and speed
        level = int(np.searchsorted(RANGES, self._strain()))  # no kernel is made for less, as compiling takes its time
        if level > self._level:
            self._level = level
            if self._kernel is not None:
                self._fit(level)

    def _strain(self):
        """The largest increment |e| of the present state."""
        layout, u, found = self.layout, self._state[0], 0.0
        for some in stretches(len(layout.i)):
            du, R = u[:, layout.j[some]] - u[:, layout.i[some]], layout.vectors(some).T
            e = ((2 * R + self._increments.q * du) * du).sum(axis=0) / (R**2).sum(axis=0)
            found = np.maximum(found, abs(e).max())
        return found

    def adopt(self, old: Blocks) -> None:
        """Take over the state of other blocks on the same particles, to more digits than the positions have.

        Particles keep their momenta.  If the other blocks have another reference, their displacements do not apply, and the state
        of the atoms is used.
        """
        mine, other = self.calc.reference, old.calc.reference
        if not (np.array_equal(mine.positions, other.positions) and np.array_equal(mine.cell.array, other.cell.array)
                and np.array_equal(mine.pbc, other.pbc)):
            return
        self._take(old.displacements, old.velocities * (old._masses / self._masses)[:, None], old._anchors)
        self.write()
