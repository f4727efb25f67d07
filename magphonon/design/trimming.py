"""Trim a device after it was built: measured responses say how its parts deviate, and which few magnets to exchange.

The unknowns are the deviations z of all parts in standard deviations of their errors, so that the likeliest copy minimises

    |(h - h(z))/sigma|^2 + |z|^2        dh = -x.(dH - omega^2 dM + i omega gamma dM) y

with the responses x and y to unit forces at the place that is seen and at the source.  There are far fewer responses than
unknowns, so that the steps are solved in the space of the responses (`site_unknowns.ManyUnknowns`).  From the device as it was
designed they end in a wrong minimum, because peaks are off by many widths. So the force of the batch, which shifts all of them
together, is scanned first, and then the noise is taken to be much larger than it is and falls.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike

from ..errors import Unstable, finite, positive, whole
from ..response.frf import Dof
from .least_squares import Before
from .objectives import Objective, soft_minimum, targets_of
from .scatter import Rest, Slope, site_slopes
from .site_designs import COMMON, Errors, Parts, Structure
from .site_unknowns import ManyUnknowns, Place

if TYPE_CHECKING:
    from ..response.transfer_functions import TransferFunction
    from ..stiffness.matrices import Model

DAMPING = 0.4  # standard deviation of the logarithm of the damping rate, which nobody knows well
SCAN = np.linspace(-3, 3, 25)  # deviations of the batch's force, in standard deviations, from which a search may start
STARTS, ROBUST = 3, 10.0  # the best of them that are tried; residuals far above this count only by their logarithm
NOISES = 100, 50, 30, 20, 10, 5, 3, 2, 1, 1, 1, 1  # by which factor the noise is taken to be larger, step by step
MOST_CHI = 2.0  # above which a copy is not explained: that of the right device is 1, give or take a tenth.  Of 182 small patches,
# identified by right and wrong models, those with 1.5 to 2 gained 5.6 dB in the median, as those below, and none below 5 lost any
SOURCES = 3**0.5 * np.array([-1, 0, 1])  # deviations of the source's frequency, in standard deviations: the nodes of a Gaussian
TAU = 3.0  # width of the soft minimum over targets and these frequencies, in the unit of the objective
TRIED = 60  # exchanges that are tried for each one that is chosen, by their effect to first order


@dataclass(frozen=True, eq=False)
class Trim:
    """Magnets to be exchanged in one copy of a device.

    Attributes
    ----------
    sites : tuple of int
    strengths : tuple of float
        Of the new magnets at these sites, as in the stock.
    built, expected : float
        The worst target of the copy as it was identified, for a source that may be off its frequency, before and after.
    chi : float
        Root of the minimum, `|(h - h(z))/sigma|^2 + |z|^2`, over the number of residuals: about 1 for the right device, whose
        deviations are as large as its errors say.
    damping : float
        Factor of the damping rate that was assumed.
    parts : Parts
        The deviations of the copy.
    """

    sites: tuple[int, ...]
    strengths: tuple[float, ...]
    built: float
    expected: float
    chi: float
    damping: float
    parts: Parts


def trim(atoms: Atoms, objective: Objective | Sequence[Objective], measured: Sequence[TransferFunction], *, parts: ArrayLike,
         errors: Errors, damping: float, exchanges: int = 3, model: Model = 'complete') -> Trim:
    """Which magnets of a copy to exchange for others from a stock, from measured responses of this copy.

    Parameters
    ----------
    atoms : ase.Atoms
        The device as it was designed, such as `SiteDesign.atoms`, not as it was built.  Its array 'rod_masses' makes rods
        cantilevers; a scene has none, and without it they are springs.
    objective : Objective or sequence of Objective
        What is to be made large, as in `optimise`; the source may be off its frequency as `errors` say.
    measured : sequence of TransferFunction
        Displacements per force of the copy with `drive`, `answer` and `sigma`; two ports at some twenty frequencies are enough.
    parts : array_like
        Strengths of the magnets in stock, in the unit of the strengths of the calculator.
    errors : Errors
        How well the device was built; those of the exponent are not identified.
    damping : float
        Damping rate that is expected, in 1/ms; it is fitted.
    exchanges : int
        Most magnets that are exchanged.
    model : {'complete', 'conventional'}
        Model of the waves.

    Raises
    ------
    ValueError
        If the device with these errors does not explain what was measured: then an exchange would do harm.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import Contrast, Errors, trim
    >>> from magphonon.response import Dof, receptance
    >>> from magphonon.response.transfer_functions import TransferFunction
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=4.0)
    >>> source, seen, omega = Dof(18, (1.0, 0, 0)), Dof(16, (1.0, 0, 0)), np.linspace(2, 4, 9)
    >>> built = patch.copy()  # of a stronger batch
    >>> built.calc = MagneticRepulsion(built, InversePower(1.02, 4.0), foundation=4.0)
    >>> h = receptance(built, source, seen, omega, 0.1).response
    >>> left = Contrast(source, loud=[16], quiet=[20], omega=3.0, damping=0.1)
    >>> found = trim(patch, left, [TransferFunction('16', omega, h, 1e-3, drive=source, answer=seen)], parts=[0.9, 1.0, 1.1],
    ...              errors=Errors(force_percent=2.0), damping=0.1, exchanges=1)
    >>> round(found.parts.force, 3), found.expected > found.built + 1
    (1.02, True)
    """
    targets, stock = targets_of(objective), np.unique(np.atleast_1d(finite('parts', parts)))
    _refuse_unplaced(measured, stock)
    structure, prior = Structure(atoms), Before.of(('damping',), {'damping': (1.0, DAMPING)})
    copy = _Copy(measured, prior, 1.0, structure, structure.rest(model=model), errors, positive('damping', damping, '1/ms'))
    place, chi = copy.identified()
    identified, factor = errors.parts(place.z, *structure.shape), float(np.exp(place.x[0]))
    sources = [one.tuned(float(np.exp(errors.frequency_percent / 100 * off)), factor) for one in targets
               for off in (SOURCES if errors.frequency_percent else [0.0])]
    now, chosen = _State.of(structure, identified, sources, copy.near), {}
    before = now.worst
    for _ in range(whole('exchanges', exchanges)):
        tried = [(now.exchanged(structure, site, strength, sources), site, strength)
                 for site, strength in now.promising(structure, sources, stock, chosen)]
        best, site, strength = max(tried, key=lambda one: one[0].worst, default=(now, 0, 0.0))
        if best.worst <= now.worst:
            break
        now, chosen[site] = best, strength
    return Trim(tuple(chosen), tuple(chosen.values()), before, now.worst, chi, factor, identified)


def _refuse_unplaced(measured, stock):
    if not measured:
        raise ValueError('measured holds no response; give those of a port or two')
    for one in measured:
        if not (isinstance(one.drive, Dof) and isinstance(one.answer, Dof)) or one.sigma is None or not np.all(one.sigma > 0):
            raise ValueError(f'{one.name}: a measured response needs drive and answer as Dof, and sigma, its noise, above zero')
    if not len(stock) or stock[0] <= 0:
        raise ValueError(f'parts must be the positive strengths of the magnets in stock, not {stock.tolist()}')


@dataclass(frozen=True, eq=False)
class _State:
    """A copy with some parts, at rest, and the worst of its targets."""

    parts: Parts
    rest: Any
    worst: float

    @classmethod
    def of(cls, structure, parts, sources, near):
        """The copy at rest; -inf if it buckles."""
        try:
            rest = structure.rest(parts, near, near.model)
        except Unstable:
            return cls(parts, None, -np.inf)
        return cls(parts, rest, min(one.value(rest) for one in sources))

    def exchanged(self, structure, site, strength, sources):
        """The copy with a magnet of exactly this strength at a site."""
        factors = np.array(np.broadcast_to(self.parts.strength, structure.shape[:1]))
        factors[site] = strength / structure.strengths[site]
        return self.of(structure, replace(self.parts, strength=factors), sources, self.rest)

    def promising(self, structure, sources, stock, chosen):
        """Sites and strengths of exchanges whose effect on the targets is largest to first order, of either sign."""
        found = [one.value_and_slope(self.rest) for one in sources]
        share = soft_minimum(np.array([value for value, _ in found]), TAU)[1]
        slope = site_slopes(self.rest, sum((c * one for c, (_, one) in zip(share, found, strict=True)), Slope()))['strength']
        change = slope[:, None] * np.log(stock / (structure.strengths * self.parts.strength)[:, None])
        change[~structure.system.mobile] = change[list(chosen)] = 0.0
        order = np.argsort(-abs(change), axis=None)[:TRIED]
        return [(int(k // len(stock)), float(stock[k % len(stock)])) for k in order if change.flat[k]]


@dataclass(frozen=True, eq=False)
class _Copy(ManyUnknowns):
    """One copy of a device whose responses were measured: x is the logarithm of the damping, z the deviations."""

    structure: Structure
    near: Rest
    errors: Errors
    damping: float

    def place(self, x, z):
        """Raises Unstable if the structure buckles."""
        (n, dim), gamma = self.structure.shape, self.damping * np.exp(x[0])
        rest = self.structure.rest(self.errors.parts(z, n, dim), self.near, self.near.model)
        return Place(x, z, np.array([(seen * rest.response(force, omega, gamma)).sum()
                                     for force, seen, omega in self._measured]), (rest, gamma))

    @cached_property
    def _measured(self):
        """Unit forces at the source and at the place that is seen, and the frequency, of each response."""
        n, dim = self.structure.shape
        ends: Any = [(one.drive, one.answer, one.omega) for one in self.functions]
        return [(drive.force(n)[:, :dim], answer.force(n)[:, :dim], omega) for drive, answer, each in ends for omega in each]

    def slopes(self, place):
        (rest, gamma), by_damping, by_parts = place.built, [], []
        feet = self.structure.feet * self.errors.parts(place.z, *self.structure.shape).spacing
        for force, seen, omega in self._measured:
            x, y = (rest.response(one, omega, gamma) for one in (seen, force))
            slope = rest.harmonic(x, y, omega, gamma)
            by_damping.append([1j * gamma / (1j * gamma - omega) * (rest.masses @ slope.masses)])
            by_parts.append(self.errors.slopes(rest, site_slopes(rest, slope), feet))
        return np.array(by_damping), np.array(by_parts)

    def identified(self) -> tuple[Place, float]:
        """The likeliest deviations, and chi."""
        n, dim = self.structure.shape
        starts, found = [], []
        for force in SCAN if self.errors.force_percent else [0.0]:
            with suppress(Unstable):
                place = self.place(np.zeros(1), np.append(force, np.zeros(COMMON - 1 + (3 + dim) * n)))
                starts.append((np.log1p((self.residuals(place) / ROBUST) ** 2).sum() + force**2, force, place))
        for *_, place in sorted(starts, key=lambda one: one[:2])[:STARTS]:
            for noise in NOISES:
                place = replace(self, noise=noise).descended(place, 1)
            found.append((float(np.sqrt(self.sum_of(place) / (2 * len(place.h)))), place))
            if found[-1][0] < MOST_CHI**0.5:
                break
        chi, place = min(found, key=lambda one: one[0])
        if chi > MOST_CHI:
            raise ValueError(f'the device with these errors does not explain the measured responses: chi = {chi:.2g} is their '
                             f'distance in units of noise and errors, and above {MOST_CHI:g} an exchange would do harm; check '
                             'errors, sigma, the places, and the model: it needs all neighbours, D*, and the mass of the pillars')
        return place, chi
