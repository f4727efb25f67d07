"""Blocks of driven, damped velocity Verlet steps on displacements from rest, in NumPy.

One step of DrivenVerlet is: half decay, half kick, velocity Verlet, half kick, half decay.  Between two steps the
neighbouring halves merge, so that inside a block a step is, with the decay d = exp(-gamma dt/2),

    v <- d^2 v + (1 + d^2) dt/2 F/m          u <- u + dt v

for v half a step behind u; a block starts with `v <- d v + dt/2 a` and ends with `v <- d (v + dt/2 a)`.

Displacements u and velocities v have the shape (2, slots) of a `Layout`.  The mobility 1/m is zero for particles
that are held, so that F may be anything there.
"""

from dataclasses import dataclass

import numpy as np

RUN = 4096
"""Slots treated at a time: the temporaries of three groups of bonds stay in the second-level cache."""


@dataclass(frozen=True)
class Motion:
    """What moves the particles, besides the bonds.

    Attributes
    ----------
    dt : float
        Time step in ms.
    decay : ndarray, shape (slots,)
        exp(-gamma dt/2).
    mobility : ndarray, shape (slots,)
        1/m in 1/g; zero for held particles and empty slots.
    foundation : float
        N/mm.
    driven : ndarray of int
        Slots with external forces.
    guided : ndarray of int
        Slots that a line or plane guides.
    barred : ndarray, shape (guided, 2, 2)
        Projector on the directions that are barred to each of them.
    """

    dt: float
    decay: np.ndarray
    mobility: np.ndarray
    foundation: float
    driven: np.ndarray
    guided: np.ndarray
    barred: np.ndarray

    def barred_part(self, x):
        """The part of a vector field, shape (2, slots), along barred directions, shape (2, guided)."""
        return np.einsum('gxy,yg->xg', self.barred, x[:, self.guided])


class Kernel:
    """Advances the displacements by blocks of steps.

    Parameters
    ----------
    layout : Layout
    increments : Increments
        Laws of the kinds of bonds.
    motion : Motion
    coefficients : ndarray, shape (kinds, coefficients), or None
        Of the polynomials in the increment; None to evaluate the law itself.
    """

    engine = 'numpy'

    def __init__(self, layout, increments, motion, coefficients):
        self.layout, self.increments, self.motion = layout, increments, motion
        d, h = motion.decay, motion.dt / 2
        self.carry, self.push = d**2, (1 + d**2) * h * motion.mobility
        self.forces = (TableForces if layout.offset is None else GridForces)(layout, increments, coefficients)
        self.f = np.zeros((2, layout.length))

    def accelerations(self, u, force):
        """Accelerations at the displacements `u`, with the external `force` on the driven slots, shape (driven, 2)."""
        m = self.motion
        a = np.zeros_like(u)
        for s, e in self.forces.fill(self.f, u):
            a[:, s:e] = m.mobility[s:e] * (self.f[:, s:e] - m.foundation * u[:, s:e])
        a[:, m.driven] += m.mobility[m.driven] * force.T
        a[:, m.guided] -= m.barred_part(a)
        return a

    def advance(self, u, v, a, forces):
        """Displacements, velocities and accelerations after a block of steps; the given ones are left as they are.

        Parameters
        ----------
        u, v, a : ndarray, shape (2, slots)
        forces : ndarray, shape (steps, driven, 2)
            External forces at the end of each step.
        """
        m = self.motion
        h = m.dt / 2
        v = m.decay * v + h * a
        u = u + m.dt * v
        for force in forces[:-1]:
            self._step(u, v, force)
        a = self.accelerations(u, forces[-1])
        v = m.decay * (v + h * a)
        return u, v, a

    def _step(self, u, v, force):
        m = self.motion
        for s, e in self.forces.fill(self.f, u):
            us, vs, fs, t = u[:, s:e], v[:, s:e], self.f[:, s:e], self.forces.scratch[:2, : e - s]
            fs -= np.multiply(m.foundation, us, out=t)
            fs *= self.push[s:e]
            vs *= self.carry[s:e]
            vs += fs
            us += np.multiply(m.dt, vs, out=t)
        kick = self.push[m.driven] * force.T
        v[:, m.driven] += kick
        u[:, m.driven] += m.dt * kick
        barred = m.barred_part(v)
        v[:, m.guided] -= barred
        u[:, m.guided] -= m.dt * barred

    def extremes(self, u):
        """Least and largest increment e of any bond."""
        b, r2 = self.layout, self.layout.r0[self.layout.kind] ** 2
        du = u[:, b.j] - u[:, b.i]
        e = (2 * np.einsum('bx,xb->b', b.R, du) + self.increments.q * np.einsum('xb,xb->b', du, du)) / r2
        return e.min(initial=0.0), e.max(initial=0.0)


class BondForces:
    """Forces of bonds from the relative displacements dx, dy of their ends; arrays end in the shape of dx."""

    def __init__(self, increments, coefficients, R, r0, g, kind=slice(None), columns=()):
        column = (Ellipsis, *columns)
        self.increments, self.r0 = increments, r0[column]
        self.Rx, self.Ry = R[..., 0][column], R[..., 1][column]
        self.ax, self.ay = 2 * self.Rx / self.r0**2, 2 * self.Ry / self.r0**2
        self.q, self.g = increments.q / self.r0**2, g[column]
        if coefficients is not None and len(coefficients) > 1:
            coefficients = coefficients[kind]
        self.c = None if coefficients is None else coefficients.T[column]

    def pull(self, dx, dy, e, H, t):
        """Replace dx, dy by the force `H(e) R + (g + t H(e)) du` on the far end; e, H and t are scratch."""
        np.multiply(self.q, dx, out=e)
        e += self.ax
        e *= dx
        np.multiply(self.q, dy, out=t)
        t += self.ay
        t *= dy
        e += t
        if self.c is None:
            H[:] = self.increments.exact(e, np.broadcast_to(self.r0, e.shape))
        else:
            np.multiply(self.c[-1], e, out=H)
            for c in self.c[-2::-1]:
                H += c
                H *= e
        if self.increments.t:
            np.add(self.g, H, out=e)
            for d, R in ((dx, self.Rx), (dy, self.Ry)):
                d *= e
                d += np.multiply(H, R, out=t)
        else:
            np.multiply(H, self.Rx, out=dx)
            np.multiply(H, self.Ry, out=dy)


class GridForces(BondForces):
    """Bonds in groups of constant offset: shifted slices."""

    def __init__(self, layout, increments, coefficients):
        super().__init__(increments, coefficients, layout.kind_R, layout.r0, increments.g, columns=(None,))
        self.offsets, self.strength = layout.offset.tolist(), layout.strength
        self.runs = layout.runs(gap=RUN // 4, longest=RUN).tolist()
        self.scratch = np.empty((max(2, len(self.offsets)), RUN))
        self.work = np.empty((5, len(self.offsets), RUN))

    def fill(self, f, u):
        """Write the forces at `u` into `f`, run by run: each run that is yielded has received all of its forces."""
        f[:] = 0
        for s, e in self.runs:
            dx, dy, *work = self.work[..., : e - s]
            for g, o in enumerate(self.offsets):
                np.subtract(u[0, s + o : e + o], u[0, s:e], out=dx[g])
                np.subtract(u[1, s + o : e + o], u[1, s:e], out=dy[g])
            self.pull(dx, dy, *work)
            if self.strength is not None:
                dx *= self.strength[:, s:e]
                dy *= self.strength[:, s:e]
            for g, o in enumerate(self.offsets):
                f[0, s:e] -= dx[g]
                f[1, s:e] -= dy[g]
                f[0, s + o : e + o] += dx[g]
                f[1, s + o : e + o] += dy[g]
            yield s, e


class TableForces(BondForces):
    """Bonds in any order: gathered and summed through the incidence matrix."""

    def __init__(self, layout, increments, coefficients):
        from scipy.sparse import csr_array

        super().__init__(increments, coefficients, layout.R, layout.r0[layout.kind], increments.g[layout.kind], layout.kind)
        self.i, self.j, bonds = layout.i, layout.j, len(layout.i)
        ends = np.append(np.full(bonds, -1.0), np.ones(bonds)), (np.append(self.i, self.j), np.tile(np.arange(bonds), 2))
        self.sum = csr_array(ends, shape=(layout.length, bonds))
        self.scratch = np.empty((2, layout.length))
        self.work = np.empty((5, bonds))

    def fill(self, f, u):
        """Write the forces at `u` into `f`; one run of all slots."""
        dx, dy, *work = self.work
        for x, d in zip(u, (dx, dy), strict=True):
            np.subtract(x[self.j], x[self.i], out=d)
        self.pull(dx, dy, *work)
        f[0] = self.sum @ dx
        f[1] = self.sum @ dy
        yield 0, f.shape[1]
