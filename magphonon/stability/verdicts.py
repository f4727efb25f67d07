"""The verdict on a structure before a run: independent checks, each of which finds a number and reports it in words and SI units.

A new check is one function of a `Case`, the structure at its rest, that returns a `Finding`; the decorator `check` puts it on the
list.  A function whose finding is never a fault is decorated with `remark` and runs only when its result is asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from .. import units as u
from ..dynamics.cages import CONTACT
from ..dynamics.engine import fastest, highest_frequency
from ..dynamics.splittings import SPLITTINGS
from ..errors import one_of
from ..interactions.bond_laws import laws_of, taken
from ..interactions.law_cards import card_of
from ..interactions.pair_laws import Overlap, Spring
from ..stiffness.lowest import DENSE
from ..stiffness.plausibility import site_damping
from ..stiffness.repulsion import Repulsion, repulsion_of
from ..stiffness.rest import LinearSystem, freedom
from ..traits import LINEAR, all_but, refuse, takes
from .amplitude_shifts import frequency_shifts
from .buckling import (
    FEW,
    SUPPORTS,
    Buckling,
    critical_spacing,
    critical_support,
    flat_layer,
    highest_squared,
    lowest_across,
    prestress_reserve,
    softest_of,
    stability_of,
    stiffness_words,
    times_words,
)
from .mechanisms import self_stresses

LARGE = 0.1  # largest amplitude, as a fraction of the spacing, up to which perturbation theory is trusted
LINEAR_ERROR = 0.01  # relative error of a frequency up to which the linear theory is accepted
SPACED = 2000
"""Largest number of degrees of freedom of a finite structure for which a stable spacing is searched; it needs about thirty lowest
modes."""
SOLID = 30_000  # largest number of degrees of freedom for which self-stress and reserve are computed, in about a second
SAME = 1e-9  # relative difference of two stiffnesses that is round-off


@dataclass(frozen=True)
class Finding:
    """What one check found.

    Attributes
    ----------
    value : Any
        The result in mm, g, ms; None if it does not apply or was not computed.
    words : str
        A sentence or two, in SI units; empty if there is nothing to say.
    fault : bool
        Whether a run would fail, or its result be meaningless.
    unjudged : str
        What was omitted because it would take too long for so many particles.
    """

    value: Any = None
    words: str = ''
    fault: bool = False
    unjudged: str = ''


CHECKS: dict[str, Callable[[Case], Finding]] = {}  # by name, in the order in which their words are printed
REMARKS: set[str] = set()  # names of those that are never a fault


def check(judge: Callable[[Case], Finding]) -> Callable[[Case], Finding]:
    """Decorator that adds a function to the checks, under its name."""
    CHECKS[judge.__name__] = judge  # pyright: ignore[reportAttributeAccessIssue]  functions have one
    return judge


def remark(judge: Callable[[Case], Finding]) -> Callable[[Case], Finding]:
    """Decorator that adds a function whose finding is never a fault."""
    REMARKS.add(judge.__name__)  # pyright: ignore[reportAttributeAccessIssue]
    return check(judge)


@dataclass(frozen=True, eq=False, repr=False)
class Verdict:
    """What the checks find about a structure; `str(verdict)` is the whole report in words and SI units.

    `verdict[name]` is the result of one check in mm, g and ms, and `finding(name)` (Finding) says it in words: 'residual' (N),
    'buckling' and 'out_of_plane' (Buckling), 'timestep_limit' (ms), 'away' (mm), 'contact', 'supports'
    (Supports), 'rigidity' (Rigidity), 'amplitude' (mm).  The result is None if the check does not apply to the structure, or was
    not computed.  A check runs when it is first asked for.
    """

    case: Case
    _found: dict[str, Finding] = field(default_factory=dict)

    def finding(self, name: str) -> Finding:
        """What the check of this name found."""
        if name not in self._found:
            self._found[name] = CHECKS[one_of('the check', name, tuple(CHECKS))](self.case)
        return self._found[name]

    def __getitem__(self, name: str) -> Any:
        return self.finding(name).value

    @property
    def stable(self) -> bool:
        """Whether the foundation holds the structure, in its plane and out of it; False also if it is only just as
        stiff as the structure needs.
        """
        return self.case.stable

    @property
    def fine(self) -> bool:
        """Whether no fault was found."""
        return not self.faults

    @property
    def faults(self) -> tuple[str, ...]:
        """The faults that make a run fail or its result meaningless, each in a sentence or two; a tuple of str."""
        found = [self.finding(name) for name in CHECKS if name not in REMARKS]
        return tuple(each.words for each in found if each.fault)

    @property
    def notes(self) -> tuple[str, ...]:
        """Further facts about the structure; a tuple of str."""
        found = [self.finding(name) for name in CHECKS]
        said = [each.words for each in found if each.words and not each.fault]
        if self.unjudged:
            *others, last = self.unjudged
            named = f'{", ".join(others)} and {last}' if others else last
            said.append(f'Not computed for so many particles: {named}. Check a smaller patch, or the lattice without [patch].')
        return tuple(said)

    @property
    def unjudged(self) -> tuple[str, ...]:
        """What was not computed because it would take too long for so many particles; a tuple of str."""
        return tuple(left for name in CHECKS if (left := self.finding(name).unjudged))

    def __str__(self) -> str:
        faults = self.faults
        count = f'{len(faults)} problem{"s" * (len(faults) > 1)}'
        head = 'OK' if not faults else f'UNSTABLE ({count})' if self.case.unstable else f'NOT OK ({count})'
        return '\n'.join([head, *(f'  ! {text}' for text in faults), *(f'  - {text}' for text in self.notes)])

    __repr__ = __str__


@takes('all neighbours', *LINEAR)
def verdict(atoms: Atoms, damping: ArrayLike = 0.0) -> Verdict:
    """Check a structure before a run: whether it is at rest and stable, its time step, its supports and its linear range.

    A periodic cell is treated as an infinite lattice, and its whole zone is searched. In a cell of more than 200 degrees of
    freedom only waves that fit into one or two cells along each vector are examined; the notes say so.  A finite structure is
    checked as given.  Quantities that take too long are not computed, but listed in `Verdict.unjudged`: the spacing at buckling
    above 2000 degrees of freedom, and in a periodic cell above 200 also the supports and the linear amplitude.  With
    AllNeighbours this spacing, supports and linear amplitude are never computed.

    The structure is checked at rest: about the reference of its calculator, or about its present positions if they are another
    equilibrium.  If the forces balance at neither, this is the fault `residual`, and the positions with smaller forces are used.

    Parameters
    ----------
    atoms : ase.Atoms
        With their PairCalculator, or a cell with AllNeighbours.
    damping : float or array_like, shape (particles,)
        Damping rate in 1/ms, which may need shorter time steps.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, verdict
    >>> cell = lattices.square(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=3.0)
    >>> judged = verdict(cell)
    >>> judged.fine, round(judged['buckling'].needed, 9)  # it needs 4 f/L0
    (False, 4.0)
    """
    layer = atoms if flat_layer(atoms) else None
    if layer is not None:
        atoms = layer.copy()
        atoms.calc = layer.calc.in_plane()  # pyright: ignore[reportOptionalMemberAccess]
    refuse(atoms, all_but('a verdict of motion in the plane', 'oblique'))
    run: dict[str, Any] = {'layer': layer, 'damping': site_damping(damping, len(atoms), atoms.calc)}
    if isinstance(atoms.calc, Repulsion) and not atoms.calc.pairwise:  # without an edge
        refuse(atoms, all_but('a verdict with AllNeighbours', 'constraints'))
        system = LinearSystem.of(atoms)
        return Verdict(Case(system.atoms, system, np.zeros(1), **run))
    calc = repulsion_of(atoms)
    now = calc.bond_vectors + calc.bonds.incidence @ calc.displacements(atoms)
    closest = float((np.linalg.norm(now, axis=1) / calc.bonds.lengths).min())
    freedom(atoms)  # refuses constraints that are not supported
    system = LinearSystem.nearest(atoms).moving()
    if system.turning:
        run['gyrating'], system = system, system.without_B()
    away = float(np.linalg.norm(system.calc.displacements(atoms), axis=1).max())
    return Verdict(Case(system.atoms, system, system.left, away, closest, **run))


@dataclass(frozen=True, eq=False)
class Case:
    """A structure at its rest, or where the forces are closest to balance, with intermediate results that checks share."""

    atoms: Atoms  # the structure at this rest; of a flat layer its motion in the plane
    system: LinearSystem
    pushes: NDArray[np.float64]  # shape (particles,): unbalanced static force on each particle, N
    away: float = 0.0  # in mm, as the check `away`
    closest: float = 1.0  # as the check `contact`
    layer: Atoms | None = None  # the flat layer with its motion out of the plane
    gyrating: LinearSystem | None = None  # with the gyration that `system` leaves out
    damping: ArrayLike = 0.0  # as for `verdict`

    @property
    def calc(self) -> Any:
        return self.atoms.calc

    @cached_property
    def spacing(self) -> float:
        """Shortest bond, mm."""
        return float(self.calc.bonds.lengths.min())

    @cached_property
    def force(self) -> float:
        """Static force in the shortest bond, N."""
        law = taken(self.calc.law, self.calc.bonds.lengths.argmin())
        return float(abs(law.dphi(self.spacing)))

    @property
    def balanced(self) -> bool:
        """Whether the static forces balance."""
        return not self.pushes.any()

    @property
    def listed(self) -> bool:
        """Whether the repulsion is a list of bonds, and not a sum over all neighbours."""
        return self.calc.pairwise

    @property
    def finite(self) -> bool:
        return self.listed and not self.atoms.pbc.any()

    @cached_property
    def large(self) -> int:
        """Number of degrees of freedom, if there are too many for dense matrices; otherwise zero."""
        size = self.system.free.shape[1] if self.listed else 0
        return size if size > DENSE else 0

    @property
    def scalable(self) -> bool:
        """Whether stability is known at other spacings, at which particles in mechanical contact would lose it."""
        return self.balanced and self.listed and not any(isinstance(law, Overlap) for law in laws_of(self.calc.laws))

    @cached_property
    def inside(self) -> Buckling:
        """Stability in the plane, or in space; gyration may hold a structure that its foundation does not."""
        return stability_of(self.system, None if self.large else self.gyrating)

    @cached_property
    def across(self) -> LinearSystem | None:
        """A flat layer with its motion out of the plane, in which gyration turns nothing."""
        if self.layer is None:
            return None
        return (LinearSystem.nearest(self.layer, None, 'gyration').without_B() if self.listed else
                LinearSystem.about(self.layer.calc, self.layer))  # pyright: ignore[reportArgumentType]  a Repulsion

    @cached_property
    def above(self) -> Buckling | None:
        """Stability of a flat layer out of its plane."""
        return None if self.across is None else stability_of(self.across, upwards=True)

    @property
    def stable(self) -> bool:
        return self.inside.stable and (self.above is None or self.above.stable)

    @property
    def unstable(self) -> bool:
        """Whether some motion grows; on the verge of buckling a structure is neither stable nor unstable."""
        return bool(self.inside.growth or (self.above is not None and self.above.growth))


class Supports(NamedTuple):
    """Stiffness in N/mm that supports must have out of the plane."""

    wave: float | None  # of every wave, for magnets normal to the plane; None for other particles
    alone: float | None  # of one such magnet that moves alone
    central: float  # of every wave, if the force is central


class Rigidity(NamedTuple):
    """How bonds hold a structure, and how much more static force it bears."""

    self_stresses: int  # states of self-stress
    floppy: int  # motions that stretch no bond, motion as a whole included
    factor: float | None  # on D*, at which it collapses; infinite if D* only stiffens it, None if springs alone do not hold it

    @property
    def reserve(self) -> str:
        """How much more static force the structure bears, in words; empty if there is no such limit."""
        if self.factor is None or not np.isfinite(self.factor):
            return ''
        return (f'It would be stable if its static forces were less than {self.factor:.3g} of these' if self.factor <= 1 else
                f'It would collapse if its static forces were {times_words(self.factor)} what they are now')


# --- the checks ----------------------------------------------------------------------------------------------------------------

@check
def residual(case: Case) -> Finding:
    """Largest unbalanced static force on a free particle, in N."""
    if case.balanced:
        return Finding(0.0, 'The static forces balance on every free particle.')
    left, share, many = float(case.pushes.max()), case.pushes.max() / case.force, np.count_nonzero(case.pushes)
    size = 'as large as' if f'{share:.4g}' == '1' else f'{share:.4g} times'
    return Finding(left, f'Particle {case.pushes.argmax()} is not in equilibrium: a net static force of {left / u.N:.4g} N acts '
                   f'on it, {size} the force in a bond' + (f'; {many} particles are not in equilibrium' if many > 1 else '')
                   + '. Hold the edge, add the force that balances it, or relax the structure first (in a scene whose particles '
                   'are in a file: positions = "anchors", or "rest", in [lattice]).', fault=True)


@check
def buckling(case: Case) -> Finding:
    """Stability in the plane, or in space, by the complete model, because the conventional model does not show buckling."""
    many = case.scalable and case.large > (SPACED if case.finite else 0)  # for the spacing at which stability ends
    scale = 1.0 if case.inside.verge else critical_spacing(case.system) if case.scalable and not many else None
    found = replace(case.inside, spacing=scale and scale * case.spacing)
    words = found.words(' in the plane' * (case.calc.dim == 2), uneven=np.ndim(case.calc.foundation) > 0)
    words += _further(case, found)
    if case.large and case.atoms.pbc.any():
        words += (' The periodic cell is so large that only waves that fit into one or two cells were computed; another wave may '
                  'be softer. Check a smaller cell of the same lattice, or another number of repeats.')
    return Finding(found, words, not found.stable, 'the spacing at which the structure buckles' if many else '')


def _further(case, found):
    """At which spacing stability would change, and what the model or gyration do not do, in words."""
    at = found.spacing and f'{found.spacing / u.m:.4g} m'
    if found.stable or found.verge:
        return f' It would buckle below a spacing of {at}.' if at and found.held else ''
    words = f' A spacing above {at} would also make it stable.' if at else ''
    if case.calc.model != 'complete':
        words += f" The {case.calc.model} model does not show this, because it leaves out D*. Use model='complete'."
    if case.gyrating is None:
        return words
    return words + (' Whether gyration holds so many particles was not computed.' if case.large else
                    ' Gyration is too slow to hold it.')


@check
def out_of_plane(case: Case) -> Finding:
    """Stability of a flat layer, whose foundation has three components, against motion out of its plane."""
    if (found := case.above) is None or case.across is None:
        return Finding()
    layer = case.across.atoms
    supports = np.broadcast_to(layer.calc.foundation, (len(layer), 3))[case.across.mobile, 2]
    return Finding(found, found.words(' out of the plane', len(np.unique(supports)) > 1, SUPPORTS), not found.stable)


@check
def timestep_limit(case: Case) -> Finding:
    """Longest stable time step in ms: 2/omega_max of the structure, or of all waves of a lattice with a small cell, or less if
    the damping requires it; infinite if no mode vibrates.
    """
    if case.large or not case.atoms.pbc.any():
        highest = highest_frequency(case.gyrating or case.system)
    elif case.gyrating and not case.inside.held:  # then gyration counts, and so do the hills
        lowest = softest_of(case.system, foundation=case.inside.spring, weighted=True).lowest
        highest = fastest(max(highest_squared(case.system), -lowest), case.gyrating.turning)
    else:
        highest = np.sqrt(max(highest_squared(case.system), 0.0))
    if case.across is not None and case.above is not None:
        across = softest_of(case.across, 'complete', foundation=case.above.spring, weighted=True, upwards=True)
        highest = max(highest, np.sqrt(max(across.highest, 0.0)))
    if not highest:
        return Finding(np.inf)
    limit = float(2 / highest)
    losses = SPLITTINGS[2].damped / max(float(np.max(case.damping)), np.finfo(float).tiny)
    if losses < limit:
        return Finding(losses, f'Time steps up to {u.in_words("s", losses / u.s)} are accepted with this damping, and a third of '
                       f'that is accurate to 0.3 %. Steps up to {u.in_words("s", limit / u.s)} would still be stable.')
    of = u.in_words('Hz', u.hertz(highest)) + ' without gyration' * (case.gyrating is not None and case.inside.held)
    return Finding(limit, f'Time steps up to {u.in_words("s", limit / u.s)} are stable (2/omega_max, with the '
                   f'highest frequency of {of}); a tenth of that is accurate.')


@check
def away(case: Case) -> Finding:
    """Largest distance of a particle from its rest position, mm."""
    if case.away <= case.spacing:
        return Finding(case.away)
    return Finding(case.away, f'Particles are up to {case.away / u.m:.4g} m away from their rest positions, '
                   f'{case.away / case.spacing:.3g} times the spacing: they have moved, or their order differs from that '
                   'in the calculator. Make a calculator for these positions.', fault=True)


@check
def contact(case: Case) -> Finding:
    """Shortest present distance of bonded particles, as a fraction of that in the reference."""
    if case.closest >= CONTACT:
        return Finding(case.closest)
    return Finding(case.closest, f'Particles are in contact: the distance of two of them is {case.closest:.3g} times that at '
                   'rest. Start with a larger distance.', fault=True)


@remark
def supports(case: Case) -> Finding:
    """Stiffness that supports must have out of the plane."""
    if case.calc.dim != 2 or case.layer is not None or not (case.balanced and case.listed):
        return Finding()
    if case.large and not case.finite:
        return Finding(unjudged='the supports')
    magnets = all(card_of(law).magnets for law in laws_of(case.calc.laws))
    wave, alone = critical_support(case.system, magnets=True) if magnets else (None, None)
    found = Supports(wave, alone, critical_support(case.system, magnets=False)[0])
    return Finding(found, _support(found) if found.central else _across(case))


def _across(case):
    """What a flat net would do out of its plane, which its tension stiffens, in words."""
    members = [law for law in laws_of(case.calc.laws) if isinstance(law, Spring)]
    if not members:
        return ''
    lowest = lowest_across(case.system) if case.finite else 0.0
    would = '' if not case.finite else ', which would cost no energy'
    if lowest:
        would = f', whose lowest frequency would be {u.in_words("Hz", u.hertz(lowest), digits=6)}'
    return (f'Not modelled: motion along z{would}. It is included by dim=3 in Python, or in a scene by '
            '[foundation.out_of_plane] with stiffness_N_per_m = 0.')


def _support(found):
    """The stiffness that supports must have, in words."""
    need = 'Not modelled: motion out of the plane. Each support needs an out-of-plane stiffness of at least '
    if found.wave is None or np.isclose(found.wave, found.central, rtol=SAME):  # or charges, whose energy obeys Laplace too
        return f'{need}{stiffness_words(found.central)}.'
    wave, alone, central = map(stiffness_words, found)
    return (f'{need}{wave} for upright magnets ({alone} if only one of them can move). For particles whose forces are along the '
            f'lines between them {central} is enough.')


@remark
def rigidity(case: Case) -> Finding:
    """States of self-stress, floppy modes, and the factor on D* at which the structure collapses."""
    if case.layer is not None or case.gyrating is not None or not (case.balanced and case.listed):
        return Finding()
    if case.large > SOLID:
        return Finding(unjudged='states of self-stress and the reserve of static forces')
    try:
        factor = prestress_reserve(case.system).factor
    except ValueError:
        factor = None
    found = Rigidity(*self_stresses(case.system), factor)
    if not found.reserve:
        return Finding(found)
    cells = ' by motion that is equal in all cells' if case.atoms.pbc.any() and case.system.free.shape[1] > FEW else ''
    return Finding(found, f'{found.reserve}, with the same spring constants{cells}. States of self-stress: '
                   f'{found.self_stresses}; motions that stretch no bond: {found.floppy}.')


@remark
def amplitude(case: Case) -> Finding:
    """Displacement at which frequencies are 1 % off the linear ones, mm."""
    # a layer leaves its plane at large amplitudes
    if case.layer is not None or case.gyrating is not None or not (case.balanced and case.listed):
        return Finding()
    if case.large and not case.finite:
        return Finding(unjudged='the linear amplitude')
    soft = case.inside
    if not soft.held or (soft.needed and not np.allclose(2 * soft.softest, np.round(2 * soft.softest))):
        return Finding()  # `frequency_shifts` does not contain the softest wave
    found = frequency_shifts(case.system).amplitude(LINEAR_ERROR)
    share = found / case.spacing
    if not np.isfinite(found):
        return Finding(found)
    if share > LARGE:
        return Finding(found, f'Frequencies stay within 1 % of the linear ones up to an amplitude of {100 * LARGE:g} % of the '
                       'spacing.')
    return Finding(found, f'The linear theory holds for small motion: its frequencies are 1 % off at an amplitude of '
                   f'{u.in_words("m", found / u.m, digits=2)}, {100 * share:.2g} % of the spacing.')
