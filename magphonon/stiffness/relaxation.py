"""Relaxation of a structure that is not in equilibrium, and the stability of the equilibrium found.

In a perfect infinite lattice every particle is in balance by symmetry.  This fails beside a vacancy, at irregular positions, and
at the rim of a patch with forces beyond nearest neighbours.  The linear theory is valid about the relaxed positions, from which
the returned calculator measures displacements; the anchors of the foundation do not move.

Energy is minimised by SciPy's trust-region Newton method, in units of the shortest bond and of the largest bond force; further
Newton steps then reach round-off.  By symmetry the result may be a saddle: the structure is then displaced along its softest mode
and relaxed again.
"""

from dataclasses import dataclass

import numpy as np
from ase import Atoms
from scipy import sparse
from scipy.optimize import minimize

from ..errors import Unstable, whole
from ..interactions.bond_laws import laws_of
from ..interactions.pair_laws import Spring
from ..lattices.bonds import Bonds, pairs_within
from ..traits import LINEAR, takes
from ..units import hertz
from .factors import inverse
from .lowest import lowest_mode
from .matrices import BROKEN_BOND, hessian, model_stiffness, signed_root
from .repulsion import repulsion_of
from .rest import LinearSystem, freedom

RESIDUAL = 1e-9  # largest force left on a particle, as a fraction of the largest bond force
SLACK = 1e-3  # least scale of the bond force, in stiffness times length, for bonds that are slack, such as springs
HANDED_OVER = 1e-6
"""Gradient, as a fraction of the largest bond force, below which plain Newton steps replace the minimisation, because energies
are no longer accurate enough; on springs much stiffer than a bond the minimisation itself ends there, earlier."""
TRUST = 0.1, 0.5  # first and longest step in shortest bonds, over all particles together
POLISHES = 6  # largest number of plain Newton steps
REGULAR = 1e-10  # stiffness added to every direction, as a fraction of the largest stiffness, because free translations have none
SADDLE = 1e-10  # fraction of the highest squared frequency below which a negative one is round-off
PUSH = 0.05  # displacement of the particle that moves most when a saddle is left, as a fraction of the shortest bond
VERGE = 1e-6  # fraction of the highest squared frequency below which round-off hides the direction of descent
SADDLES = 20  # largest number of saddles that are left in succession
STEP, LEAST = 1.25, 0.1
"""Factor between two foundations that are tried where one is too weak, and the first one of particles without, as a share of the
largest force in a bond over its length."""
MEND = 'hold its rim or give it a foundation (magphonon.critical_foundation)'


@dataclass(frozen=True)
class Relaxation:
    """A relaxed structure, and how far it moved.

    Attributes
    ----------
    atoms : ase.Atoms
        The structure at rest, whose positions are the reference of its calculator.  The anchors of the foundation do not move
        (pillars); its springs balance the remaining forces between the particles.
    before, after : float
        Largest force on a free particle in N, before and after relaxation.
    shift, rms : float
        Largest and root mean square displacement of the free particles in mm.
    steps : int
        Number of steps of the minimiser and of Newton's method; 0 if the structure was already at a stable equilibrium.
    saddles : int
        Number of unstable equilibria (saddles) that were passed.
    lowest : float
        Lowest squared angular frequency at rest in rad^2/ms^2, of the complete model; zero, up to round-off, for
        motion without stiffness.
    """

    atoms: Atoms
    before: float
    after: float
    shift: float
    rms: float
    steps: int
    saddles: int
    lowest: float

    @property
    def needed(self) -> bool:
        """Whether relaxation was needed: the forces did not balance, or the equilibrium was unstable."""
        return self.steps > 0

    def __str__(self) -> str:
        far = f'moved by up to {self.shift:.4g} mm (rms {self.rms:.4g} mm) in {self.steps} steps'
        moved = far if self.needed else 'was at rest already'
        off = f' (unstable equilibria passed on the way: {self.saddles})' if self.saddles else ''
        lowest = hertz(float(signed_root(np.array(self.lowest))))
        calc = self.atoms.calc
        nothing = RESIDUAL * abs(calc.law.dphi(calc.bonds.lengths)).max()
        if self.before <= nothing:
            force = 'No force is left on any particle'
        else:
            left = f'it is {self.after:.3g} N' if self.after > nothing else 'all forces balance'
            force = f'The largest force on a particle was {self.before:.3g} N before; now {left}'
        return f'The structure {moved}{off}. {force}. The lowest frequency is {lowest:.4g} Hz.'


@takes(*LINEAR)
def relaxed(atoms: Atoms, steps: int = 1000) -> Relaxation:
    """Move the free particles of a structure to a stable equilibrium.

    Parameters
    ----------
    atoms : ase.Atoms
        With its PairCalculator of either model, because static forces are the same in both. Constraints remain in force.
    steps : int
        Largest number of steps of the minimiser for each equilibrium.

    Raises
    ------
    ValueError
        If the forces do not vanish within this number of steps, if particles leave their neighbours, or if every equilibrium
        found is unstable, because the structure buckles or slides.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, relaxed
    >>> atoms = lattices.triangular(1.0, 1.0).repeat((6, 6, 1))
    >>> del atoms[14]  # a vacancy
    >>> atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), foundation=4.0)
    >>> rest = relaxed(atoms)
    >>> round(rest.shift, 2), bool(rest.after < 1e-9 * rest.before)
    (0.09, True)
    """
    calc, steps = repulsion_of(atoms), whole('steps', steps)
    descent = _Descent(atoms, calc)
    y, taken = np.zeros(descent.P.shape[1]), 0
    before, lowest, highest = descent.residual(y), 0.0, 0.0
    for saddles in range(SADDLES + 1):
        if descent.residual(y) > descent.balanced:
            y, used = descent.to_rest(y, steps)
            taken += used
        if not descent.residual(y) <= descent.balanced:
            _refuse_verge(lowest, highest, atoms)
            raise Unstable(f'after {taken} steps {descent.residual(y):.3g} N still act on a particle, {before:.3g} N at first: '
                             f'the structure buckles or slides; {MEND}')
        lowest, highest, mode = descent.softest(y)
        if lowest >= -SADDLE * highest:
            return descent.result(y, before, taken, saddles, lowest)
        y = y + PUSH * mode
        taken += 1
    _refuse_verge(lowest, highest, atoms)
    raise Unstable(f'the structure came to rest {SADDLES + 1} times, each time on a saddle, where it is unstable: from the '
                     f'last one it would run away at the rate {np.sqrt(-lowest):.4g} / ms; {MEND}')


def enough_foundation(atoms: Atoms) -> tuple[float, float]:
    """Foundation in N/mm of the stiffest site with which a structure buckles or slides as it relaxes, and the one, stiffer by
    `STEP`, with which it stays in place.
    """
    calc = repulsion_of(atoms)
    force, _ = calc.bond_sizes
    weak = calc.foundation if np.any(calc.foundation) else LEAST * force.max() / calc.bonds.shortest
    while True:  # infinitely stiff springs hold every structure
        stiffer = atoms.copy()
        stiffer.calc = calc.about(atoms, foundation=STEP * weak)
        try:
            relaxed(stiffer)
        except Unstable:
            weak = STEP * weak
        else:
            return float(np.max(weak)), float(STEP * np.max(weak))


def _refuse_verge(lowest, highest, atoms):
    """Refuse a foundation so close to the buckling limit that the buckled rest cannot be distinguished from the saddle."""
    if -VERGE * highest < lowest < 0:
        raise Unstable(f'the structure is on the verge of buckling, with a lowest squared frequency of {lowest:.3g} rad^2/ms^2: '
                         'its buckled state is so close to the present positions that round-off hides it; '
                         f'{-2 * lowest * atoms.get_masses().max():.3g} N/mm more foundation would hold it at these positions')


class _Descent:
    """The energy of a structure and its derivatives, as functions of the free displacements `y` in shortest bond lengths."""

    def __init__(self, atoms, calc):
        self.calc = calc.about(atoms, model='complete')
        system = LinearSystem.about(self.calc, atoms)
        self.P = system.moving().free
        self.given, self.atoms = calc, self.calc.reference.copy()
        self.atoms.calc = self.calc
        self.masses = self.P.power(2).T @ np.repeat(atoms.get_masses(), calc.dim)  # guides may be oblique
        self.length = self.calc.bonds.shortest
        force, stiffness = self.calc.bond_sizes
        self.force = max(force.max(), SLACK * self.length * stiffness.max())
        if not self.force:
            raise ValueError('no force acts between the particles: at the lengths of all bonds the law has neither force nor '
                             'stiffness; check the strengths of the particles and the reach of the law')
        self.balanced = max(RESIDUAL * self.force, system.jitter)
        self.source = atoms
        self._at = None

    def displacements(self, y):
        """Displacements in mm, shape (particles, dim)."""
        return self.length * (self.P @ y).reshape(len(self.atoms), -1)

    def _move(self, y):
        self.atoms.positions[:, : self.calc.dim] = self.calc.reference.positions[:, : self.calc.dim] + self.displacements(y)

    def energy(self, y):
        try:
            self._move(y)
            return self.atoms.get_potential_energy() / (self.force * self.length)
        except ValueError:  # particles at one place, or beyond the end of the law
            return np.inf

    def slope(self, y):
        self._move(y)
        return -(self.P.T @ self.atoms.get_forces(apply_constraint=False)[:, : self.calc.dim].ravel()) / self.force

    def residual(self, y):
        """Largest force on a free particle in N."""
        return self.force * np.linalg.norm((self.P @ self.slope(y)).reshape(len(self.atoms), -1), axis=1).max()

    def stiffness(self, y):
        """Hessian of the free directions, in units of the largest bond force divided by the shortest bond."""
        if self._at is None or not np.array_equal(y, self._at[0]):
            u = self.displacements(y)
            R = self.calc.bond_vectors + self.calc.bonds.incidence @ u
            H = hessian(self.calc.bonds, model_stiffness(R, self.calc.interaction), self.calc.foundation)
            self._at = y.copy(), sparse.csr_array(self.P.T @ H @ self.P) * (self.length / self.force)
        return self._at[1]

    def to_rest(self, y, steps):
        """The nearest minimum reached from `y`, and the number of steps."""
        first, longest = TRUST
        options = {'initial_trust_radius': first, 'max_trust_radius': longest, 'gtol': HANDED_OVER, 'maxiter': steps}
        end = minimize(self.energy, y, jac=self.slope, hessp=lambda y, p: self.stiffness(y) @ p, method='trust-ncg',
                       options=options)
        self._refuse_strangers(end.x)
        y, polished = self._polished(end.x) if end.success or end.nit < steps else (end.x, 0)
        return y, end.nit + polished

    def _polished(self, y):
        """Newton steps, as long as they reduce the forces; also their number."""
        order = None  # of elimination, the same for all
        for taken in range(POLISHES):
            H = self.stiffness(y)
            regular = H + REGULAR * abs(H).sum(axis=1).max() * sparse.eye_array(len(y))
            solve = inverse(regular, order)
            order, better = solve.factors.order, y - solve(self.slope(y))
            del solve, regular  # the next factors take their memory
            if not self.residual(better) < self.residual(y):
                return y, taken
            y = better
        return y, POLISHES

    def _refuse_strangers(self, y):
        """Refuse positions where the list of bonds is wrong: neighbours have separated, or other particles are too close.

        Nodes of a net that no member joins may be anywhere.
        """
        bonds = self.calc.bonds
        now = np.linalg.norm(self.calc.bond_vectors + bonds.incidence @ self.displacements(y), axis=1)
        for b in np.flatnonzero(now > BROKEN_BOND * bonds.lengths)[:1]:
            raise Unstable(f'the particles {bonds.i[b]} and {bonds.j[b]}, {bonds.lengths[b]:.4g} mm apart at first, are '
                             f'{now[b]:.4g} mm apart and no longer neighbours: the structure buckles or slides; {MEND}')
        if all(isinstance(law, Spring) for law in laws_of(self.calc.laws)):
            return
        self._move(np.zeros_like(y))
        known = _near(self.atoms, self.length)
        self._move(y)
        short = bonds.among(now < self.length)  # others are not near: sets of all bonds would take more memory than factors
        for i, j, _ in sorted(_near(self.atoms, self.length) - known - _pairs(short)):
            raise Unstable(f'the particles {i} and {j}, between which no force acts here, are closer than the shortest bond, '
                             f'{self.length:.4g} mm: from its first positions the structure buckles or slides; {MEND}, or bond '
                             'more neighbours (shells= or cutoff=)')

    def softest(self, y):
        """Lowest squared frequency and a bound of the highest, rad^2/ms^2, and the softest mode, whose largest motion is 1."""
        root = sparse.diags_array(np.sqrt(self.force / self.length / self.masses))
        K = sparse.csr_array(root @ self.stiffness(y) @ root)
        self._at = None  # factors need its memory
        lowest, highest, v = lowest_mode(K)
        v = v / np.sqrt(self.masses)
        return lowest, highest, v / np.linalg.norm((self.P @ v).reshape(len(self.atoms), -1), axis=1).max()

    def result(self, y, before, steps, saddles, lowest):
        rest, u = self.source.copy(), self.displacements(y)
        rest.calc = self.given
        if steps:
            rest.positions[:, : self.calc.dim] += u
        rest.calc = LinearSystem.of(rest).calc  # statics are the same in both models
        moved = np.linalg.norm(u, axis=1) if steps else np.zeros(len(u))
        rms = np.sqrt((moved[freedom(self.source)[0]] ** 2).mean())
        return Relaxation(rest, before, self.residual(y), float(moved.max()), float(rms), steps, saddles, float(lowest))


def _near(atoms, reach):
    """Pairs (i, j, shift) nearer than `reach`."""
    return _pairs(Bonds(*pairs_within(atoms, reach * (1 - 1e-9))[:3], np.zeros((0, 3)), len(atoms)))


def _pairs(bonds):
    """The set of bonded pairs (i, j, shift), each with the lower index first."""
    backward = bonds.i > bonds.j
    i, j = np.where(backward, bonds.j, bonds.i), np.where(backward, bonds.i, bonds.j)
    shift = np.where(backward[:, None], -bonds.shift, bonds.shift)
    return set(zip(i.tolist(), j.tolist(), map(tuple, shift.tolist()), strict=True))
