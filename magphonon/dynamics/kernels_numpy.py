"""Blocks of driven, damped velocity Verlet steps on displacements from rest, in NumPy.

One step of DrivenVerlet is: half decay, half kick, velocity Verlet, half kick, half decay.  The halves on either side of the
border between two steps merge.  The decay d = exp(-(gamma + i g) dt/2) multiplies v_x + i v_y, and is real if nothing gyrates.
Inside a block a step is

    v <- d^2 v + (1 + d^2) dt/2 F/m          u <- u + dt v

with v half a step behind u; a block starts with `v <- d v + dt/2 a` and ends with `v <- d (v + dt/2 a)`.  A step of higher
order (`splittings`) consists of several such stages, each with its own kick and drift. There d = 1, and `rate` damps the drifts.

A state holds displacements u, velocities v and accelerations a of the slots of a `Layout`, shape (3, 2, slots).  The mobility
1/m is zero for held particles, so that forces on them have no effect.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

if TYPE_CHECKING:
    from ..stiffness.sites import Foundation
    from .bond_increments import Increments, Pieces
    from .memory_layout import Layout
    from .splittings import Splitting

Found = tuple[bool, float, float]
"""Whether any bond was beyond the reach of the law, and the largest components of displacement (mm) and velocity (mm/ms)."""
RUN = 8192  # number of slots processed at a time: large enough for NumPy's overhead, small enough for the second-level cache


@dataclass(frozen=True)
class Motion:
    """Everything that moves the particles besides the bonds.

    Attributes
    ----------
    dt : float
        Time step in ms.
    decay : ndarray, shape (slots,)
        d = exp(-(gamma + i g) dt/2), real where nothing gyrates; 1 where drifts are damped.
    splitting : Splitting
    rate : float
        gamma of the drifts in 1/ms.
    mobility : ndarray, shape (slots,)
        1/m in 1/g; zero for held particles and empty slots.
    foundation : float or ndarray, shape (2, slots)
        k in N/mm: one number for all particles, or one for each displacement.
    site : None
        Forces of the sites beyond these springs.
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
    foundation: Foundation
    site: Any
    static: np.ndarray | None
    driven: np.ndarray
    guided: np.ndarray
    barred: np.ndarray


class Kernel:
    """Advances displacements and velocities by blocks of time steps.

    Parameters
    ----------
    layout : Layout
    increments : Increments
        Laws of the kinds of bonds.
    motion : Motion
    coefficients : ndarray, shape (kinds, coefficients), or list of Pieces, or None
        Coefficients of the polynomials in the increment; Pieces, for `CompiledKernel` only; or None to evaluate the law itself.
    reach : float
        Largest increment |e| for which the polynomials are valid.
    threads, dtype : int, type
        For `CompiledKernel` only; it computes in single precision if `dtype` is np.float32.
    """

    engine = 'numpy'

    def __init__(self, layout: Layout, increments: Increments, motion: Motion,
                 coefficients: NDArray[np.float64] | list[Pieces] | None, reach: float, threads: int = 1,
                 dtype: Any = np.float64) -> None:
        self.dtype = dtype
        self.layout, self.increments, self.motion, self.reach, self.threads = layout, increments, motion, reach, threads
        d, b, (drifts, damped) = motion.decay, motion.splitting.kicks, motion.splitting.flow(motion.dt, motion.rate)
        self.half, self.before, self.drifts = b[0] * motion.dt, damped[-1], np.roll(drifts, -1)  # the one that follows each kick
        self.first, merged = drifts[0], (*b[1:-1], b[-1] + b[0])
        self.keeps, self.kicks = damped, np.array(merged) * motion.dt
        self.carry, self.push, self.forget = d**2, (1 + d**2) / 2 * motion.mobility, np.zeros(len(d))
        self._prepare(coefficients)

    def _prepare(self, coefficients):
        layout = self.layout
        self.forces = (TableForces if layout.offset is None or layout.each else GridForces)(layout, self.increments, coefficients)
        self.carries, self.pushes = [x * self.carry for x in self.keeps], [x * self.push for x in self.kicks]
        self.f = np.zeros((2, layout.length))
        self.scratch = np.empty((2, max(RUN, layout.length if self.forces.whole else 0)))

    @np.errstate(over='ignore', invalid='ignore')  # a run that fails is noticed at its end
    def advance(self, state: NDArray[np.float64], forces: NDArray[np.float64], times: NDArray[np.float64],
                out: NDArray[np.float64]) -> Found:
        """Fill `out` with displacements, velocities and accelerations after a block of steps; `state` stays as it is.

        Returns whether any bond left the range of the law on the way, and the largest components of displacement and velocity.

        Parameters
        ----------
        state, out : ndarray, shape (3, 2, slots)
        forces : ndarray, shape (steps * stages, driven, 2)
            External forces at all kicks except the first.
        times : ndarray, shape (steps * stages,)
            Times of these kicks in ms.
        """
        u, v, a = out
        (u0, v0, a0), d = state, self.motion.decay
        v[:] = v0
        turn(v, d)
        v += self.half * a0
        u[:] = u0 + self.first * v
        beyond = self._turns(u, v, forces[:-1], times, self.carries, self.pushes, self.drifts)
        beyond |= self.accelerate(out, forces[-1], times[-1])
        v *= self.before
        v += self.half * a
        turn(v, d)
        return beyond, largest(u), largest(v)

    def accelerate(self, state: NDArray[np.float64], force: NDArray[np.float64], time: float = 0.0) -> bool:
        """Fill in the accelerations: the velocities that a kick over unit time would give to particles at rest.

        Returns whether any bond is beyond the range of the law.
        """
        u, _, a = state
        a[:] = 0
        return self._turns(u, a, force[None], [time], [self.forget], [self.motion.mobility], [0.0])

    @np.errstate(over='ignore', invalid='ignore')
    def _turns(self, u, v, forces, times, carries, pushes, drifts):
        np.setbufsize(512)  # NumPy would copy shorter rows than its buffer to broadcast them; ends with errstate
        m, k = self.motion, np.asarray(self.motion.foundation)
        whole = not k.ndim
        self.forces.strain = 0.0
        for force, time, carry, push, dt in zip(forces, times, cycle(carries), cycle(pushes), cycle(drifts), strict=False):
            site = None if m.site is None else m.site(u, time)
            for s, e in self.forces.fill(self.f, u):
                us, vs, fs, t = u[:, s:e], v[:, s:e], self.f[:, s:e], self.scratch[:, : e - s]
                fs -= np.multiply(k if whole else k[:, s:e], us, out=t)
                if site is not None:
                    fs += site[:, s:e]
                if m.static is not None:
                    fs += m.static[:, s:e]
                turn(fs, push[s:e])
                turn(vs, carry[s:e])
                vs += fs
                us += np.multiply(dt, vs, out=t)
            if len(m.driven):
                kick = force.T.copy()
                turn(kick, push[m.driven])
                v[:, m.driven] += kick
                u[:, m.driven] += dt * kick
            if len(m.guided):
                away = np.einsum('gxy,yg->xg', m.barred, v[:, m.guided])
                v[:, m.guided] -= away
                u[:, m.guided] -= dt * away
        return not self.forces.strain <= self.reach

    def write(self, u: NDArray[np.float64], v: NDArray[np.float64], anchors: NDArray[np.float64], masses: NDArray[np.float64],
              positions: NDArray[np.float64], momenta: NDArray[np.float64]) -> None:
        """Set `positions` to anchors + u and `momenta` to m v; x, y is the last axis of the former, the first of the latter."""
        for x, (ux, vx) in enumerate(zip(self.layout.gather(u), self.layout.gather(v), strict=True)):
            np.add(anchors[x], ux, out=positions[:, x])
            np.multiply(masses, vx, out=momenta[:, x])

    def written(self, u: NDArray[np.float64], v: NDArray[np.float64], anchors: NDArray[np.float64], masses: NDArray[np.float64],
                positions: NDArray[np.float64], momenta: NDArray[np.float64]) -> bool:
        """Whether the positions and momenta are those that `write` left."""
        return all(np.array_equal(positions[:, x], anchors[x] + ux) and np.array_equal(momenta[:, x], masses * vx)
                   for x, (ux, vx) in enumerate(zip(self.layout.gather(u), self.layout.gather(v), strict=True)))


def turn(v: NDArray[np.float64], by: NDArray[Any]) -> None:
    """Vectors, shape (2, any), times real numbers, or v_x + i v_y times complex numbers, which also rotates them."""
    if np.isrealobj(by):
        v *= by
    else:
        turned = by * (v[0] + 1j * v[1])
        v[0], v[1] = turned.real, turned.imag


def largest(x: NDArray[np.float64]) -> float:
    """The largest absolute value of all components; NaN if one is NaN."""
    return max(x.max(), -x.min())


class BondForces:
    """Forces on the far ends of bonds, from the displacements of these relative to the near ends.

    R and the law broadcast against the relative displacements, whose first axis is x, y.  `strain` is the largest
    increment |e| seen.
    """

    def __init__(self, increments: Increments, coefficients: NDArray[np.float64] | None, R: NDArray[np.float64],
                 r0: NDArray[np.float64], kind: Any) -> None:
        self.increments, self.R, self.R2, self.r0 = increments.at(np.ravel(kind)), R, 2 * R, r0
        self.g = increments.g[kind]
        if coefficients is not None:
            scaled = coefficients / increments.r0[:, None] ** (2 + 2 * np.arange(coefficients.shape[1]))
            self.c = scaled[0] if len(scaled) == 1 or (scaled == scaled[0]).all() else np.moveaxis(scaled[kind], -1, 0)
        self.exact = coefficients is None
        self.rows = r0[:, 0] if r0.ndim == 2 else r0.min()  # rest length, or the least of it, of each row of bonds

    def pull(self, d: NDArray[np.float64], s: NDArray[np.float64], e: NDArray[np.float64], H: NDArray[np.float64]) -> None:
        """Replace the relative displacements `d` by the forces `H(e) R + (g + t H(e)) d`; the other arrays are scratch space."""
        if self.increments.q:
            np.add(self.R2, d, out=s)
            s *= d
        else:
            np.multiply(self.R2, d, out=s)
        np.add(s[0], s[1], out=e)  # e r0^2
        largest = np.maximum(e.max(axis=-1), -e.min(axis=-1))
        self.strain = np.maximum(self.strain, (largest / self.rows**2).max())
        if self.exact:
            e /= self.r0**2
            H[:] = self.increments.exact(e.T, np.broadcast_to(self.r0, e.shape).T).T
        else:
            np.multiply(self.c[-1], e, out=H)
            for c in self.c[-2::-1]:
                H += c
                H *= e
        if self.increments.t:
            np.add(self.g, H, out=e)
            d *= e
            d += np.multiply(self.R, H, out=s)
        else:
            np.multiply(self.R, H, out=d)


class GridForces(BondForces):
    """Forces of bonds in groups of constant offset, computed on shifted slices."""

    def __init__(self, layout: Layout, increments: Increments, coefficients: NDArray[np.float64] | None) -> None:
        kinds = np.arange(len(layout.offset))[:, None]  # pyright: ignore[reportArgumentType]  a grid has offsets
        super().__init__(increments, coefficients, layout.R.T[..., None], layout.r0[:, None], kinds)
        self.whole = False
        self.offsets, self.strength = layout.offset.tolist(), layout.strength
        self.runs = layout.runs(gap=RUN // 8, longest=RUN).tolist()
        self.work = [np.empty((*shape, len(self.offsets) * RUN)) for shape in ((2,), (2,), (), ())]

    def fill(self, f: NDArray[np.float64], u: NDArray[np.float64]) -> Iterator[tuple[int, int]]:
        """Write the forces at `u` into `f`, run by run, and yield each run as soon as all of its forces are there."""
        f[:] = 0
        for s, e in self.runs:
            groups, n = len(self.offsets), e - s
            d, *work = (w[..., : groups * n].reshape(*w.shape[:-1], groups, n) for w in self.work)
            for g, o in enumerate(self.offsets):
                np.subtract(u[:, s + o : e + o], u[:, s:e], out=d[:, g])
            if self.strength is not None:
                d *= self.strength[:, s:e]  # a bond without strain exerts no force
            self.pull(d, *work)
            for g, o in enumerate(self.offsets):
                f[:, s:e] -= d[:, g]
                f[:, s + o : e + o] += d[:, g]
            yield s, e


class TableForces(BondForces):
    """Forces of bonds in any order: displacements are gathered, and forces summed by the incidence matrix."""

    def __init__(self, layout: Layout, increments: Increments, coefficients: NDArray[np.float64] | None) -> None:
        super().__init__(increments, coefficients, layout.R.T.copy(), layout.r0[layout.kind], layout.kind)
        self.whole = True  # filled in one run
        self.i, self.j, bonds = layout.i, layout.j, len(layout.i)
        ends = np.append(np.full(bonds, -1.0), np.ones(bonds)), (np.append(self.i, self.j), np.tile(np.arange(bonds), 2))
        self.sum = csr_array(ends, shape=(layout.length, bonds))
        self.work = [np.empty((*shape, bonds)) for shape in ((2,), (2,), (), ())]

    def fill(self, f: NDArray[np.float64], u: NDArray[np.float64]) -> Iterator[tuple[int, int]]:
        """Write the forces at `u` into `f`, and yield one run that holds all slots."""
        d = self.work[0]
        for x in range(2):
            np.subtract(u[x, self.j], u[x, self.i], out=d[x])
        self.pull(*self.work)
        for x in range(2):
            f[x] = self.sum @ d[x]
        yield 0, f.shape[1]
