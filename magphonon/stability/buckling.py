"""Buckling: the softest mode of a lattice, and the foundation or the spacing that makes it stable.

Static repulsion favours the rotation of every bond.  A structure on springs k is stable if every eigenvalue of its stiffness
matrix, D(q) + k of a periodic cell or the condensed Hessian of a finite one, is positive; masses do not matter for that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.sparse.linalg import LinearOperator, eigsh

from .. import units as u
from ..errors import whole
from ..stiffness.factors import inverse
from ..stiffness.lowest import DENSE, lowest_mode
from ..stiffness.matrices import Model, bloch_matrix, growth, hessian, model_stiffness
from ..stiffness.repulsion import Repulsion
from ..stiffness.rest import BALANCED, LinearSystem, freedom
from ..traits import LIKE, all_but, refuse, takes
from .mechanisms import FreeMotions, free_motions
from .soft_waves import softest_wave

if TYPE_CHECKING:
    from ..lattices.bonds import Bonds
    from ..stiffness.sites import Foundation

ROUND_OFF = 1e-12  # fraction of the largest eigenvalue below which an eigenvalue is zero
VERGE = 1e-9  # distance from the foundation that is needed, as a fraction of it, within which round-off would decide
FLAT = 1e-9  # largest difference of heights, as a fraction of the shortest bond, up to which a layer is flat
SPACINGS = np.geomspace(0.1, 10, 21)  # multiples of the present spacing among which a stable one is searched for
STRETCH = 1e-4  # relative, at which forces must still balance
STEPS = 12  # number of wavevectors along each reciprocal vector; the softest wave between them is found too, see `softest`
FEW = 12  # degrees of freedom of a cell up to which all waves are searched for the one that collapses first
TURNED = 24  # wavevectors along each reciprocal vector at which B must hold what stiffness alone does not


@dataclass(frozen=True)
class SoftMode:
    """The ends of the spectrum of a stiffness matrix, or of squared frequencies.

    Attributes
    ----------
    lowest, highest : float
        Eigenvalues in N/mm, or squared frequencies in rad^2/ms^2.  For a large structure `highest` is an upper bound.
    q : ndarray, shape (3,)
        Wavevector of the lowest eigenvalue in fractions of the reciprocal vectors; zero for a finite structure.
    """

    lowest: float
    highest: float
    q: np.ndarray

    @property
    def needed(self) -> float:
        """The spring constant that must be added so that no eigenvalue is negative; zero if all are positive already."""
        return float(-self.lowest) if -self.lowest > ROUND_OFF * abs(self.highest) else 0.0


def softest(bonds: Bonds, K: NDArray[np.float64], free: sparse.csr_array, structure: Atoms, foundation: Foundation = 0.0,
            steps: int | None = None) -> SoftMode:
    """Softest mode over the zone of a periodic cell, or of a finite structure.

    For a periodic cell of more than 200 degrees of freedom only waves with q = 0 or 1/2 along each vector are examined; another
    wave may be softer. `K`, shape (bonds, components, components), is the stiffness of each bond and `foundation` that of the
    springs in N/mm; `free` are the directions that the constraints leave free (`LinearSystem.free`).  With `LinearSystem.shapes`
    in their place eigenvalues are squared frequencies. `steps` along each reciprocal vector that are multiples of 6 meet M and K
    of the hexagonal lattices; by default 48 for one particle per cell, 24 in space, and fewer for larger cells, whose zone is
    smaller. Minima between them are found too, see `softest_wave`.
    """
    pbc = structure.pbc
    if not pbc.any() or free.shape[1] > DENSE:
        edges = np.array(list(product(*((0.0, 0.5) if along else (0.0,) for along in pbc))))
        found = [lowest_mode(free.T @ hessian(bonds, K, foundation, q) @ free) for q in edges]
        softest = min(range(len(found)), key=lambda n: found[n][0])
        return SoftMode(found[softest][0], max(highest for _, highest, _ in found), edges[softest])
    P = free.toarray()
    return _over_zone(lambda q: P.T @ bloch_matrix(bonds, K, q, foundation) @ P, structure, steps)


def _over_zone(matrix, cell, steps):
    steps = whole('steps', steps) if steps is not None else 6 * int(np.ceil((4 if np.all(cell.pbc) else 8) / np.sqrt(len(cell))))
    return SoftMode(*softest_wave(matrix, cell.cell.array, cell.pbc, steps))


@takes('all neighbours', *LIKE)
def softest_of(atoms: Atoms | LinearSystem, model: Model | None = None, scale: float = 1.0, foundation: float = 0.0,
               weighted: bool = False, steps: int | None = None, upwards: bool = False) -> SoftMode:
    """Softest mode of `atoms` about the reference of their calculator, with all bonds stretched by the factor `scale`.

    The part of the foundation that is common to all particles, `common_spring`, is replaced by `foundation` in N/mm; the
    additional stiffness of stiffer springs is kept.  If `weighted`, eigenvalues are squared frequencies.  If `upwards`, only
    motion out of the plane of a flat layer counts, which is independent of that in the plane.
    """
    system: Any = LinearSystem.about(atoms.calc, atoms) if isinstance(atoms, Atoms) else atoms  # pyright: ignore[reportArgumentType]
    free, added = directions(system, weighted, upwards), foundation - common_spring(system, upwards)
    calc = system.atoms.calc
    if calc.pairwise:
        K = model_stiffness(scale * calc.bond_vectors, calc.interaction, model or calc.model)
        return softest(calc.bonds, K, free, system.atoms, calc.foundation + added, steps)
    P, springs = free.toarray(), added * np.eye(free.shape[0])  # sums are known at the present spacing only
    return _over_zone(lambda q: P.T @ (calc.bloch_matrix(q, model) + springs) @ P, system.atoms, steps or _steps(calc))


def directions(system: LinearSystem, weighted: bool = False, upwards: bool = False) -> sparse.csr_array:
    """The columns of `LinearSystem.free`, or of `shapes` if `weighted`; of a layer those along z if `upwards`."""
    free = system.shapes if weighted else system.free
    return free[:, np.unique(system.free[2::3].indices)] if upwards else free


def on_the_verge(spring: float, needed: float) -> bool:
    """Whether a foundation equals the `needed` one within round-off, both in N/mm, so that stability cannot be decided."""
    return needed > 0 and abs(spring - needed) <= VERGE * needed


def fastest_growth(system: LinearSystem) -> tuple[float, NDArray[np.float64]]:
    """Rate in 1/ms of the wave that grows fastest with velocity-dependent forces B, and its wavevector; zero if none grows.

    It is computed for the complete model on a mesh over the zone, to which the softest wave for B = 0 is added.
    """
    along = [np.arange(TURNED) / TURNED if periodic else np.zeros(1) for periodic in system.atoms.pbc]
    q = np.stack(np.meshgrid(*along, indexing='ij'), axis=-1).reshape(-1, 3)
    q = np.vstack([softest_of(system.without_B(), 'complete', weighted=True).q, q])
    rates = growth(system.B().toarray(), system.bloch(q, 'complete'))
    return float(rates.max()), q[rates.argmax()]


def common_spring(atoms: Atoms | LinearSystem, upwards: bool = False) -> float:
    """Stiffness of the softest spring of all free particles in N/mm; of a layer that of supports along z if `upwards`."""
    atoms = atoms if isinstance(atoms, Atoms) else atoms.atoms
    springs, mobile = np.broadcast_to(atoms.calc.foundation, (len(atoms), atoms.calc.dim)), freedom(atoms)[0]
    return float(springs[mobile if mobile.any() else ~mobile, 2 * upwards :].min())


def flat_layer(atoms: Atoms) -> bool:
    """Whether the atoms are a layer at rest in one plane, whose particles may move out of the plane independently of their motion
    in it, as they do unless the axis of a gyration is oblique.
    """
    calc: Any = atoms.calc
    if not (isinstance(calc, Repulsion) and calc.layer) or np.ndim(calc.gyration) == 2:
        return False
    if calc.pairwise and (calc.load[:, 2].any() or calc.slack[:, 2].any()):  # pyright: ignore[reportAttributeAccessIssue]
        return False
    heights = atoms.positions[:, 2], calc.reference.positions[:, 2]
    return max(np.ptp(z) for z in heights) <= FLAT * calc.bonds.lengths.min()


def highest_squared(system: LinearSystem) -> float:
    """Highest squared frequency in rad^2/ms^2 over the zone of a periodic cell, with the model of its calculator."""
    calc: Any = system.atoms.calc
    # the search for a minimum handles saddles and finds minima between mesh points, so the sign is changed
    return -_over_zone(lambda q: -system.bloch(q, calc.model), system.atoms, _steps(calc)).lowest


def _steps(calc):
    """Wavevectors along each reciprocal vector; fewer with AllNeighbours, whose matrices take long."""
    return None if calc.pairwise else 24 if calc.dim == 2 else 8


class CriticalFoundation(NamedTuple):
    """Foundation stiffness that a structure needs against its static forces, and the mode that needs it.

    Attributes
    ----------
    k : float
        Smallest stiffness of the foundation in N/mm; zero if the structure is stable without one.
    q : ndarray, shape (3,)
        Wavevector of the softest mode in fractions of the reciprocal vectors; zero for a finite structure.
    """

    k: float
    q: NDArray[np.float64]


@takes('all neighbours', *LIKE)
def critical_foundation(atoms: Atoms | LinearSystem, model: Model | None = None, steps: int | None = None) -> CriticalFoundation:
    """Smallest foundation stiffness that holds a lattice or a finite patch in its plane.

    For a flat layer only motion in the plane counts, whatever its supports along z; for these use `softest_of` with `upwards`.

    If springs differ, the result is the stiffness needed for the softest one, `common_spring`, while the
    differences between the springs are kept.

    In a periodic cell of more than 200 degrees of freedom only waves that fit into one or two cells are examined (`softest`).

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        One cell, or a finite structure, with its PairCalculator or AllNeighbours.  Only the differences between the springs of
        its foundation matter. Constraints remain in force, and the springs are assumed slack at the present positions.
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.
        The conventional model never needs a foundation, because it does not show buckling.
    steps : int, optional
        Wavevectors along each reciprocal vector, see `softest`.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, critical_foundation, lattices
    >>> cell = lattices.square(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> needed, q = critical_foundation(cell)
    >>> round(needed, 9), abs(q).round(3)  # 4 f/L0: rows slide
    (4.0, array([0. , 0.5, 0. ]))
    """
    if isinstance(atoms, Atoms) and flat_layer(atoms):
        layer, atoms = atoms, atoms.copy()
        atoms.calc = layer.calc.in_plane()
    if isinstance(atoms, Atoms) and isinstance(atoms.calc, Repulsion) and not atoms.calc.pairwise:
        refuse(atoms, all_but('critical_foundation with AllNeighbours', 'constraints'))
    found = softest_of(LinearSystem.of(atoms).moving(), model, steps=steps)
    return CriticalFoundation(found.needed, found.q)


def critical_spacing(system: LinearSystem) -> float | None:
    """Spacing at which the foundation no longer holds a structure, by the complete model, as a multiple of the present spacing.

    All bonds are stretched by the same factor.  The result is the nearest change between stable and unstable, between 0.1 and 10
    times the present spacing and within the range of the law.

    Returns
    -------
    float or None
        Below one for a stable structure (how far it may shrink), above one for an unstable one (how far it must grow).
        None if it is stable, or unstable, at every spacing. None also if the balance depends on the foundation, on loads or on
        rest lengths of members, so that a uniform stretch is not possible.
    """
    calc, pull = system.calc, np.linalg.norm(system.calc.spring_forces, axis=1)
    if pull.max() > BALANCED * abs(calc.law.dphi(calc.bonds.lengths)).max():  # the foundation carries static forces
        return None
    change = np.subtract(*(calc.interaction.forces(scale * calc.bond_vectors)[1] for scale in (1 - STRETCH, 1.0)))
    left = system.free.T @ (calc.bonds.incidence.T @ change).ravel()
    if abs(left).max() > BALANCED**0.5 * abs(change).max():  # at no other size is there a rest of this shape
        return None
    k = common_spring(system)

    def lacking(scale):
        found = softest_of(system, 'complete', scale, steps=STEPS)  # minima that are negative are refined
        return -found.lowest - k - (ROUND_OFF * found.highest if found.needed <= 0 else 0)

    buckles = lacking(1.0) > 0
    last = 1.0
    for scale in SPACINGS[SPACINGS > 1] if buckles else SPACINGS[SPACINGS < 1][::-1]:
        try:
            if (lacking(scale) > 0) != buckles:
                return brentq(lacking, last, scale, rtol=1e-9)  # pyright: ignore[reportReturnType, reportArgumentType]  a float, both
        except ValueError:  # the end of a tabulated law
            return None
        last = scale
    return None


def critical_support(system: LinearSystem, magnets: bool) -> tuple[float, float]:
    """Stiffness out of the plane, N/mm, that the supports of planar particles must provide: for every wave, and for a particle
    that moves alone, whose bonds have the largest sum.

    The energy of two rigid magnets obeys Laplace's equation.  For round magnets normal to the plane it reads
    `phi_zz + phi'' + phi'/r = 0`, so that each bond adds `k_zz = -(phi'' + phi'/r) = -(a - 1) f/r` to the stiffness out
    of the plane, with the local exponent `a = -dln f/dln r`; a central energy phi(r) would add only `phi'/r = -f/r`.
    """
    calc = system.calc
    r = calc.bonds.lengths
    per_bond = calc.law.dphi(r) / r
    if magnets:
        per_bond = -(calc.law.d2phi(r) + per_bond)
    alone = np.bincount(calc.bonds.i, -per_bond, len(system)) + np.bincount(calc.bonds.j, -per_bond, len(system))
    return _across(system, per_bond, np.ones(len(system))).needed, float(alone[system.mobile].max(initial=0.0))


def lowest_across(system: LinearSystem) -> float:
    """Lowest frequency of planar particles out of their plane without supports, by the tension of bonds, rad/ms."""
    r = system.calc.bonds.lengths
    found = _across(system, system.calc.law.dphi(r) / r, 1 / np.sqrt(system.masses))
    return float(np.sqrt(max(found.lowest, 0.0))) if found.lowest > ROUND_OFF * found.highest else 0.0


def _across(system, per_bond, moved):
    free = sparse.csr_array(sparse.diags_array(moved))[:, np.flatnonzero(system.mobile)]
    return softest(system.calc.bonds, per_bond[:, None, None], free, system.atoms)


@dataclass(frozen=True, eq=False)
class PrestressReserve:
    """The factor on D* that makes a structure collapse, and how it then moves.

    Attributes
    ----------
    factor : float
        Above 1 for a stable structure; infinite if static forces only stiffen it.
    mode : ndarray, shape (particles, dim)
        The motion without stiffness at this factor, complex for a wave; the largest displacement is 1.
    q : ndarray, shape (3,)
        Its wavevector in fractions of the reciprocal vectors; zero for a finite structure.
    """

    factor: float
    mode: np.ndarray
    q: np.ndarray


@takes(*LIKE)
def prestress_reserve(atoms: Atoms | LinearSystem) -> PrestressReserve:
    """The factor f at which a structure with the stiffness `D0 + f D*` collapses; its positions stay.

    The force of every bond is multiplied by f while its spring constant phi'' stays: in a packing or a lattice far from contact
    this is how far the pressure is from buckling the structure.  D0 alone says that there is no such factor.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        A structure that D0 holds, with its PairCalculator.  In a periodic cell of up to 12 degrees of freedom every wave counts,
        in a larger one only motion that is equal in all cells.

    Raises
    ------
    ValueError
        If springs alone do not hold the structure, as a net that is rigid by its tension only, or a free body.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.stability import prestress_reserve
    >>> row = lattices.chain(1.0, 1.0)
    >>> row.calc = MagneticRepulsion(row, InversePower(1.0, 4.0), foundation=6.0)
    >>> round(prestress_reserve(row).factor, 9)  # zigzag: k/(4 f/L0)
    1.5
    """
    system = LinearSystem.of(atoms)
    waves = system.atoms.pbc.any() and system.free.shape[1] <= FEW
    factor, y, q = _reserve_of_waves(system) if waves else _reserve_of_one_cell(system)
    if factor < VERGE:
        raise ValueError('springs alone, D0, do not hold this structure, so no factor on D* makes it collapse: hold its rim, '
                         'give it a foundation, or look at its modes')
    mode = y.reshape(len(system), system.dim)
    return PrestressReserve(factor, mode / (np.linalg.norm(mode, axis=1).max() or 1.0), q)


def _reserve_of_one_cell(system):
    """The factor on D* and the motion, equal in all cells, by an eigenvalue of -D* over D0; a factor 0 if D0 does not hold it."""
    calc, free = system.calc, system.free
    if system.atoms.pbc.any() and not calc.tied and system.mobile.all():
        free = free[:, calc.dim :]  # one particle stands for the lattice as a whole
    springs = free.T @ calc.rest_hessian('conventional') @ free
    turning = springs - free.T @ calc.rest_hessian('complete') @ free  # -D*
    lowest, highest, y = lowest_mode(springs)
    if lowest < ROUND_OFF * highest:
        return 0.0, free @ y, np.zeros(3)
    if springs.shape[0] <= DENSE:
        shares, y = eigh(turning.toarray(), springs.toarray())
    else:
        solve = LinearOperator(springs.shape, inverse(springs))
        shares, y = eigsh(turning, 1, springs, Minv=solve, which='LA', v0=np.cos(np.arange(springs.shape[0])))
    return float(1 / shares[-1]) if shares[-1] > ROUND_OFF else np.inf, free @ y[:, -1], np.zeros(3)


def _reserve_of_waves(system):
    """The factor on D*, the motion and the wavevector: the least of `u.D0.u/-(u.D*.u)` over all waves u.

    Each step takes the softest wave at the last factor, at which its own quotient is smaller (Dinkelbach).
    """
    calc, free = system.calc, system.free
    D0 = calc.rest_stiffness('conventional')
    Dstar, P = calc.rest_stiffness('complete') - D0, free.toarray()
    factor, y, q = np.inf, np.zeros(free.shape[1]), np.zeros(3)
    soft = softest(calc.bonds, Dstar, free, system.atoms, steps=STEPS)
    while soft.needed and factor > VERGE:
        q = soft.q
        springs = P.T @ bloch_matrix(calc.bonds, D0, q[None], calc.foundation)[0] @ P
        static = P.T @ bloch_matrix(calc.bonds, Dstar, q[None])[0] @ P
        y = np.linalg.eigh(static if factor == np.inf else springs + factor * static)[1][:, 0]
        last, factor = factor, float((y.conj() @ springs @ y).real / -(y.conj() @ static @ y).real)
        soft = softest(calc.bonds, D0 + factor * Dstar, free, system.atoms, calc.foundation, steps=STEPS)
        if not factor < (1 - VERGE) * last:
            break
    return factor, P @ y, q


FOUNDATION = 'the foundation of {} is', 'a foundation', 'a stiffer foundation', 'springs'
SUPPORTS = 'the supports of {} along z are', 'supports along z', 'stiffer supports', 'supports'
"""How a foundation, or supports out of the plane, are named where they hold, are needed, are too soft, and one by one."""


@dataclass(frozen=True)
class Buckling:
    """Whether a foundation holds a structure against its static forces.

    Attributes
    ----------
    spring, needed : float
        The present stiffness, and the smallest one that holds the structure without gyration, N/mm.  If springs differ, both are
        those of the softest one, with the differences between springs kept.
    softest : ndarray, shape (3,)
        Wavevector of the softest mode in fractions of the reciprocal vectors; zero for a finite structure.
    growth : float
        Rate of the fastest unstable mode, 1/ms; zero for a stable structure.
    free : FreeMotions
        Motions that cost no energy.
    spacing : float or None
        Length of the shortest bond at which the foundation begins or ceases to hold the structure, mm; None if there is no such
        length, or if it was not computed, such as for balls in contact.
    """

    spring: float
    needed: float
    softest: np.ndarray
    growth: float
    free: FreeMotions
    spacing: float | None = None

    @property
    def stable(self) -> bool:
        """Whether no motion grows; gyration may hold a structure that its foundation does not. False on the verge of buckling."""
        return not (self.verge or self.growth)

    @property
    def held(self) -> bool:
        """Whether the foundation holds the structure, without gyration."""
        return self.needed <= self.spring and not self.verge

    @property
    def verge(self) -> bool:
        """Whether the foundation equals the needed one to within a fraction of 1e-9, so that round-off would decide whether
        motion grows.
        """
        return self.free.count > 0 or on_the_verge(self.spring, self.needed)

    def words(self, where: str, uneven: bool = False, names: tuple[str, ...] = FOUNDATION) -> str:
        """Whether the foundation, or what `names` says, holds a structure `where` it moves, in a sentence or two in SI units; its
        springs differ if they are `uneven`.
        """
        holds, support, stiffer, springs = names
        spring, needed = stiffness_words(self.spring) + ' at its softest spring' * uneven, stiffness_words(self.needed)
        at = f', with the softest mode at q = ({", ".join(f"{x:.4g}" for x in self.softest)})' if self.softest.any() else ''
        if self.free.count:
            return self.free.words(where)
        if self.verge:
            return (f'It is on the verge of buckling{where}{at}: {holds.format(spring)} just what it needs, and round-off would '
                    f'decide. Take {stiffer}.')
        if self.growth:
            return (f'It buckles{where}{at}: the motion grows e-fold in {1 / self.growth / u.s:.3g} s. It needs {support} of '
                    f'{needed} and has {spring}.')
        if not self.held:
            return (f'Stable{where} only without losses: without gyration it would need {support} of {needed} and has {spring}; '
                    'with gyration any damping lets it fall, however slowly.')
        if self.needed:
            return f'Stable{where}: {holds.format(spring)} {times_words(self.spring / self.needed)} the {needed} needed.'
        if uneven:
            return (f'Stable{where}, and it would stay so if all {springs} were softer by '
                    f'{stiffness_words(self.spring)}, the stiffness of the softest one.')
        return f'Stable{where}, even without {support}{self.free.whole}.'


def stability_of(system: LinearSystem, gyrating: LinearSystem | None = None, upwards: bool = False) -> Buckling:
    """Whether the foundation holds a structure, or a layer out of its plane; a system with gyration may hold what it does not."""
    spring, soft = common_spring(system, upwards), softest_of(system, 'complete', upwards=upwards)
    stiff = soft.needed or soft.lowest + spring > VERGE * soft.highest or not system.atoms.calc.pairwise
    free = FreeMotions() if stiff else free_motions(system, directions(system, upwards=upwards), soft.q)
    found = Buckling(spring, soft.needed, soft.q, 0.0, free)
    if found.held or found.verge:
        return found
    if gyrating is not None:
        growth, q = fastest_growth(gyrating)
        return replace(found, growth=growth, softest=q)
    moving = softest_of(system, 'complete', foundation=spring, weighted=True, upwards=upwards)
    return replace(found, growth=float(np.sqrt(-moving.lowest)))


def times_words(ratio: float) -> str:
    """A ratio above 1, in words before what is compared."""
    return f'{100 * (ratio - 1):.2g} % more than' if ratio < 1.995 else f'{ratio:.3g} times'


def stiffness_words(k: float) -> str:
    """A stiffness in N/mm, in SI units."""
    value = k / (u.N / u.m)
    return f'{value:.4g} N/m' if 1e-3 <= value < 9999.5 or not value else u.in_words('N/m', value)
