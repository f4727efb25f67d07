"""The largest impact on a particle that keeps the list of bonds, made at rest, valid (`magphonon.dynamics.cages`).

Two speeds enclose this limit:

    safe      Energy is conserved, so no bond is lost if the energy of the impact is below the lowest energy barrier to such a
              state: two particles without a bond as close as the shortest bond, or a bond at CONTACT or BROKEN_BOND times its
              length.  Two particles are moved there slowly while all others relax.  It is not proved that no lower barrier
              exists.
    leaves    The lowest speed at which a particle with this initial speed leaves its cage.  Runs in many directions are made;
              the neighbours relax only in part, so this speed is larger.

Particles farther away are held, because their motion comes too late to matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms

from ..dynamics.cages import APART, BROKEN_BOND, CONTACT, SURVEYED, Diverged, pairs_without_bond
from ..dynamics.verlet import DrivenVerlet
from ..lattices.bonds import Bonds
from ..stiffness.calculator import MagneticRepulsion
from ..stiffness.rest import LinearSystem, freedom
from ..stiffness.sites import refuse_attraction, refuse_gyration, refuse_unlike

YIELDING, WATCHED = 4.0, {2: 3.0, 3: 2.5}
"""Distances in shortest bonds up to which particles around the moving one are free: in the search for the least energy, and (in
the plane and in space) in a shot."""
NEIGHBOURS = 18
"""Largest number of bonds of a particle, three shells of the triangular lattice or two of fcc: with more the search takes
seconds, and with many shells minutes."""
TRIED = 12  # number of places examined closely: those with the lowest energy along a straight line
SIDEWAYS = 0.01
"""Sideways displacement of particles at each stage, as a fraction of the shortest bond, because by symmetry the straight path may
be a ridge."""
STAGES = 8  # number of distances on the path to a place
NEAR, REPEATS = 5e-4, 10
"""How near to a place a drag ends, in shortest bonds, and how often its last stage is repeated for that at most."""
STIFF = 10.0  # stiffness of the spring that enforces a distance, relative to that of a bond of this length
SHOTS = {2: 13, 3: 5}
"""Number of directions in which a particle is shot, in the plane and in space (where more particles move); prime numbers, so that
no two directions are equivalent by the symmetry of a lattice."""
GOLDEN = (np.sqrt(5) - 1) / 2
PASSAGE = 4.0  # path of a free particle during a run (shot), in shortest bonds; it sets the duration
STEP_PHASE = 0.3  # time step times the frequency at the shortest distance that the energy allows
FINE = 1.05  # ratio of two speeds at which the search for the lowest escape speed ends
FACTOR = 1.3  # ratio of successive speeds while no particle leaves its cage
FASTEST = 40.0  # largest speed tried, in multiples of the safe speed


@dataclass(frozen=True)
class Escape:
    """Speeds in mm/ms of one particle that is hit at rest.

    Attributes
    ----------
    safe : float
        Below this speed no bond is lost, for an impact on any particle in any direction.
    leaves : float or None
        Speed at which the `particle` leaves its cage in the `direction`; None if no run showed that.
    particle : int
    direction : ndarray, shape (dim,)
    """

    safe: float
    leaves: float | None
    particle: int
    direction: np.ndarray


@dataclass(frozen=True, eq=False)
class Place:
    """A state with a lost bond: particles i and j, at rest separated by `vector`, are at the `distance`, in mm."""

    i: int
    j: int
    vector: np.ndarray
    distance: float


def escape_speeds(atoms: Atoms) -> Escape | None:
    """Enclose the speed of an impact that takes a particle out of its cage.

    Parameters
    ----------
    atoms : ase.Atoms
        At a stable rest, which is the reference of their MagneticRepulsion; all of one law, strength and foundation.

    Returns
    -------
    Escape or None
        None if the force has no energy, constraints are not supported, no particle is free, the law is not known at the
        distances reached, or a particle has more than `NEIGHBOURS` bonds.
    """
    refuse_gyration(atoms.calc, 'searches for the speed of an impact that breaks a bond')  # pyright: ignore[reportArgumentType]
    refuse_attraction(atoms.calc, 'impacts')  # pyright: ignore[reportArgumentType]  of which `LinearSystem` makes sure
    refuse_unlike(atoms.calc, 'the search for the speed of an impact that breaks a bond',  # pyright: ignore[reportArgumentType]
                  'shoot a particle in a run of DrivenVerlet, which stops where it loses its cage')
    try:
        mobile = freedom(atoms)[0]
    except ValueError:
        return None
    if atoms.calc.bonds.coordination.max() > NEIGHBOURS:
        return None
    with np.errstate(all='ignore'):  # overflow in a search that diverges
        cheapest, least = None, np.inf
        for place in _places(atoms):
            energy = _Drag(surroundings(atoms, place.i, YIELDING), place).dearest(least)
            if energy < least:
                cheapest, least = place, energy
        if cheapest is None or not least:
            return None
        heaviest = int((atoms.get_masses() * mobile).argmax())
        safe = float(np.sqrt(2 * least / atoms.get_masses()[heaviest]))
        shot = [particle for particle in dict.fromkeys((cheapest.i, cheapest.j, heaviest)) if mobile[particle]]
        try:
            left = _first_to_leave(atoms, shot, safe)
        except ValueError:  # beyond the range of the law
            left = None
        return Escape(safe, *left) if left else Escape(safe, None, cheapest.i, np.zeros(atoms.calc.dim))


def surroundings(atoms: Atoms, particle: int, radius: float) -> Atoms:
    """Particles within `radius` shortest bonds of one, and those bonded to them, which are held; this particle comes first."""
    calc, nearest = atoms.calc, atoms.calc.bonds.lengths.min()
    reach = radius * nearest * (1 + 1e-9)
    spans = np.linalg.norm(np.linalg.pinv(atoms.cell.array[atoms.pbc]), axis=0) if atoms.pbc.any() else []
    repeats, half = np.ones(3, int), reach + calc.bonds.lengths.max()
    repeats[atoms.pbc] = 2 * np.ceil(half * np.asarray(spans)).astype(int) + 1
    big = atoms.repeat(repeats)
    big.calc = calc.on(big) if atoms.pbc.any() else calc
    middle = len(atoms) * np.ravel_multi_index(repeats // 2, repeats) + particle
    away = np.linalg.norm(big.positions - big.positions[middle], axis=1)
    bonds, inner = big.calc.bonds, away <= reach
    inside = ~bonds.shift.any(axis=1) & (inner[bonds.i] | inner[bonds.j])
    members = np.unique([middle, *np.flatnonzero(inner), *bonds.i[inside], *bonds.j[inside]])
    members = np.append(middle, members[members != middle])
    place = np.full(len(big), -1)
    place[members] = np.arange(len(members))
    near = big[members]
    near.set_constraint([*near.constraints, FixAtoms(np.flatnonzero(~inner[members]))])
    near.set_cell(np.full(3, 10 * (half + np.ptp(near.positions))))
    near.pbc = calc.dim == 3
    listed = Bonds(place[bonds.i[inside]], place[bonds.j[inside]], 0 * bonds.shift[inside], bonds.vectors[inside], len(near))
    load = np.zeros((len(near), 3))
    load[:, : calc.dim] = big.calc.offset[members]  # the springs are slack here, because their anchors move with the particles
    near.calc = MagneticRepulsion(near, calc.interaction, bonds=listed, load=load, **calc.parameters)
    return near


def _places(atoms):
    """States with a lost bond that have the lowest energies along straight lines, without symmetric copies."""
    calc, bonds, mobile = atoms.calc, atoms.calc.bonds, freedom(atoms)[0]
    nearest, lengths = bonds.lengths.min(), bonds.lengths
    other = pairs_without_bond(bonds, calc.reference, SURVEYED * nearest)
    ways = [(bonds, b, CONTACT * lengths[b]) for b in range(len(bonds))]
    ways += [(bonds, b, BROKEN_BOND * lengths[b]) for b in range(len(bonds))]
    if (other.lengths >= APART * nearest).all():
        ways += [(other, b, nearest) for b in range(len(other))]
    places = {}
    for listed, b, distance in ways:
        i, j, vector = listed.i[b], listed.j[b], listed.vectors[b]
        if not mobile[i]:
            i, j, vector = j, i, -vector
        if mobile[i]:
            place = Place(int(i), int(j), vector[: calc.dim], float(distance))
            cost = _straight(calc, place, 0.5 if mobile[j] else 1.0, bonded=listed is bonds)
            places.setdefault(float(f'{cost:.6g}'), place)
    return [places[cost] for cost in sorted(places) if 0 < cost < np.inf][:TRIED]


def _straight(calc, place, share, bonded):
    """Energy in mJ of such a state if i moves straight to j by a `share` of the way, j by the rest, and all others stay."""
    law, dim, bonds = calc.law, calc.dim, calc.bonds
    apart = np.linalg.norm(place.vector)
    way = place.vector * (1 - place.distance / apart)
    total = 0.0
    try:
        for end, other, u in ((place.i, place.vector, share * way), (place.j, -place.vector, (share - 1) * way)):
            R = np.concatenate([bonds.vectors[bonds.i == end], -bonds.vectors[bonds.j == end]])[:, :dim]
            R = R[np.linalg.norm(R - other, axis=1) > 1e-9 * apart]  # except the bond between the two, if there is one
            total += (law.phi(np.linalg.norm(R - u, axis=1)) - law.phi(np.linalg.norm(R, axis=1))).sum()
            total += calc.parameters.foundation * u @ u / 2 - calc.offset[end] @ u
        return total + (law.phi(place.distance) - law.phi(apart) if bonded else 0.0)
    except ValueError:  # the law does not reach so far
        return np.inf


class _Drag:
    """The energy barrier for moving two particles slowly to a place while all particles around them relax.

    At each of a number of distances d' the energy E is least under the constraint d = d', by an augmented Lagrangian,
    `E + F (d - d') + K (d - d')^2/2` with the force F between the two, which is the start value for the next distance.  All
    other pairs without a bond repel when they come closer than a bond, so that no other bond is lost on the way.
    """

    def __init__(self, near, place):
        self.calc, self.place = near.calc, place
        self.P = LinearSystem(near).free
        self.R = near.calc.bonds.vectors[:, : near.calc.dim]
        self.r0 = near.calc.bonds.lengths
        self.length = self.r0.min()
        apart = near.positions[:, : near.calc.dim] - near.positions[0, : near.calc.dim]
        self.other = int(np.linalg.norm(apart - place.vector, axis=1).argmin())
        others = pairs_without_bond(near.calc.bonds, near, YIELDING * self.length)
        free = freedom(near)[0]
        keep = (others.lengths >= APART * self.length) & (free[others.i] | free[others.j])
        keep &= ~((np.minimum(others.i, others.j) == 0) & (np.maximum(others.i, others.j) == self.other))
        self.i, self.j, self.vectors = others.i[keep], others.j[keep], others.vectors[keep, : near.calc.dim]
        self.stiffness = 10 * abs(near.calc.law.d2phi(self.length))

    def energy(self, u):
        """Energy in mJ and its gradient in N, at the displacements u."""
        calc, bonds = self.calc, self.calc.bonds
        bond = self.R + u[bonds.j] - u[bonds.i]
        r = np.sqrt(np.einsum('bx,bx->b', bond, bond))
        n = bond / r[:, None]
        if calc.parameters.model == 'conventional':
            n = self.R / self.r0[:, None]
            r = np.einsum('bx,bx->b', bond, n)
        k, h = calc.parameters.foundation, calc.offset
        total = (calc.law.phi(r) - self.at_rest).sum() + ((k / 2 * u - h) * u).sum()
        gradient = k * u - h + bonds.incidence.T @ (calc.law.dphi(r)[:, None] * n)
        meet = self.vectors + u[self.j] - u[self.i]
        d = np.sqrt(np.einsum('bx,bx->b', meet, meet))
        for b in np.flatnonzero(d < self.length):
            total += self.stiffness * (d[b] - self.length) ** 2 / 2
            push = self.stiffness * (d[b] - self.length) * meet[b] / d[b]
            gradient[self.j[b]] += push
            gradient[self.i[b]] -= push
        return total, gradient

    def distance(self, u):
        """Distance in mm and its gradient."""
        apart = self.place.vector + u[self.other] - u[0]
        d = np.linalg.norm(apart)
        gradient = np.zeros_like(u)
        gradient[self.other], gradient[0] = apart / d, -apart / d
        return d, gradient

    def dearest(self, most):
        """The largest energy on the way in mJ, within the range of the law; the search ends above `most`."""
        from scipy.optimize import minimize

        law, shape, rng = self.calc.law, (len(self.calc.reference), self.calc.dim), np.random.default_rng(0)
        start, end = np.linalg.norm(self.place.vector), self.place.distance
        force, highest, y = 0.0, 0.0, np.zeros(self.P.shape[1])

        def objective(y):
            u = self.length * (self.P @ y).reshape(shape)
            (E, slope), (d, along) = self.energy(u), self.distance(u)
            off = d - wanted
            value, gradient = E + force * off + K * off**2 / 2, slope + (force + K * off) * along
            return value / unit, self.length / unit * (self.P.T @ gradient.ravel())

        try:
            self.at_rest = law.phi(self.r0)
            unit = self.stiffness * self.length**2
            for stage, wanted in enumerate([*np.linspace(start, end, STAGES + 1)[1:], *REPEATS * [end]]):
                K = self.stiffness + STIFF * abs(law.d2phi(min(wanted, self.length))) + STIFF * self.calc.parameters.foundation
                K *= 2.0 ** max(0, stage - STAGES)  # stiffer and stiffer, where others than these two resist
                y = y + SIDEWAYS * rng.normal(size=len(y))
                y = minimize(objective, y, jac=True, method='L-BFGS-B', options={'maxiter': 60}).x
                u = self.length * (self.P @ y).reshape(shape)
                off = self.distance(u)[0] - wanted
                force += K * off
                highest = max(highest, float(self.energy(u)[0]))
                if highest > most or (wanted == end and abs(off) <= NEAR * self.length):
                    break
        except ValueError:  # the law does not reach so far
            pass
        return highest


def _first_to_leave(atoms, shot, held):
    """The lowest speed at which one of the particles `shot` leaves its cage, which, and where; at `held` (mm/ms) none leaves."""
    dim, left = atoms.calc.dim, None
    volleys = {particle: _Volley(surroundings(atoms, particle, WATCHED[dim]), SHOTS[dim]) for particle in shot}
    speed, fastest = 1.5 * held, FASTEST * held
    while speed < fastest and not (left and left[0] <= FINE * held):
        gone = next(((particle, direction) for particle, volley in volleys.items()
                     if (direction := volley.leaving(speed)) is not None), None)
        if gone is None:
            held = speed
        else:
            left = speed, *gone
        speed = np.sqrt(held * left[0]) if left else FACTOR * held
    return (float(left[0]), *left[1:]) if left else None


class _Volley:
    """Many copies of one particle in its surroundings, each with a different initial direction, in one run."""

    def __init__(self, near, count):
        self.near, n = near, len(near)
        P = LinearSystem(near).free.toarray().reshape(n, near.calc.dim, -1)[0]
        self.directions = _directions(P[:, P.any(axis=0)], count)
        self.all = near.repeat((1, len(self.directions), 1))
        self.all.calc = near.calc.on(self.all)
        self.first = n * np.arange(len(self.directions))

    def leaving(self, speed):
        """A direction in which the particle leaves its cage at this speed; None if there is none."""
        atoms = self.all.copy()
        atoms.calc = self.all.calc
        v = np.zeros((len(atoms), 3))
        v[self.first, : atoms.calc.dim] = speed * self.directions
        atoms.set_momenta(atoms.get_masses()[:, None] * v)
        dt = self._step(speed)
        engine = 'numpy' if atoms.calc.dim == 2 else 'ase'
        run = DrivenVerlet(atoms, dt, engine=engine, allow_unstable=True)
        try:
            run.run(int(PASSAGE * atoms.calc.bonds.lengths.min() / speed / dt))
        except Diverged as error:
            return self.directions[error.particle // len(self.near)]
        return None

    def _step(self, speed):
        """Time step in ms: short compared with the vibration of a bond that has taken up all energy of the impact."""
        calc, masses = self.near.calc, self.near.get_masses()
        r0 = calc.bonds.lengths.min()
        r = r0 * np.linspace(1, CONTACT, 181)
        try:
            spent = calc.law.phi(r) - calc.law.phi(r0)
        except ValueError:
            spent = np.zeros(1)
        turn = r[np.flatnonzero(spent <= masses[0] * speed**2 / 2)[-1]] if len(spent) > 1 else r0
        stiffness = 2 * abs(calc.law.d2phi(turn)) + calc.parameters.foundation
        return min(STEP_PHASE / np.sqrt(2 * stiffness / masses.min()), 0.03 * r0 / speed)


def _directions(axes, count):
    """Unit vectors distributed over the space of the given axes, shape (count, dim); two for a line."""
    if axes.shape[1] == 1:
        return np.array([axes[:, 0], -axes[:, 0]])
    n = np.arange(count) + 0.5
    angle = 2 * np.pi * (n / count if axes.shape[1] == 2 else GOLDEN * n)
    if axes.shape[1] == 2:
        angle += 0.1  # along no axis of symmetry
        return np.stack([np.cos(angle), np.sin(angle)], axis=1) @ axes.T
    height = 1 - 2 * n / count
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=1) @ axes.T
