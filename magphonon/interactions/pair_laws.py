"""Pair laws of repulsion: `phi(r)`, its slope `dphi` and its curvature `d2phi`.

`PairLaw` defines a law and says how to write your own.  The force with which two particles repel each other is
`f(r) = -phi'(r)`.  (The paper writes `f = phi_r`; with the usual sign of an energy it is the negative slope, and the bond
stiffness is `phi'' nn + (phi'/r)(I - nn)`.)  An interaction that depends on more than the distance is a `PairInteraction`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from math import lgamma
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .. import units
from ..errors import finite, not_negative, positive
from .law_cards import Card, Kind, Parameter, exponent_change, screening_change

DEEPEST = 0.5
"""Largest overlap of two spheres as a fraction of their diameter.  Hertz' law holds for contacts small compared with the sphere,
and is a few percent off at a tenth; beyond a half, spheres are no longer pressed together but lie inside one another."""
# Gauss-Legendre on [0, 1]: the energy between two knots to round-off
_NODES, _WEIGHTS = (0.5 * (x + shift) for x, shift in zip(np.polynomial.legendre.leggauss(16), (1, 0), strict=True))
PIECE = 0.03
"""Largest distance of two knots, relative: also where noise bends the spline in a gap the rule is exact to round-off."""
APART = 1e-9  # least relative distance of two readings; closer ones are one, up to the round-off of positions
MARGIN, BEND, FAR = 1.1, 2.0, 1e4
"""Factors beyond the ends of a table up to which it is continued: below, for particles that move about their places; above, until
it falls as the force of dipoles if it fell more slowly, and to its last distance."""
DIPOLES = 4.0  # exponent of the force between magnets far apart
ASTRAY = 1.5
"""Factor by which a table may deviate from the inverse power through two neighbouring readings.  A law whose exponent changes
from 1 to 4 over an octave deviates by 1.3. Of 200 evenly spaced tables with 10 % noise none exceeded the limit; with one distant
reading and 2 % noise most did."""
NARROW, STEEPER = 0.03, 1.0
"""An interval is narrow if it has less than the first share of a neighbour's width; its exponent counts as noise if it differs
from those of both neighbours by more than the second number.  Where readings are dense and right, neighbours agree."""
CIRCLE = np.exp(2j * np.pi * np.arange(8) / 8)[:, None]
RADIUS, STEEPEST = 1e-2, 20.0
"""Radius of the circle in the complex plane on which the law is sampled for its higher derivatives, to about 1e-11, as a fraction
of the bond length, or of 20 f/f' for a steeper law such as that of spheres in contact."""
BESIDE = 3e-4  # relative step of the differences where a law takes no complex distances


@runtime_checkable
class PairLaw(Protocol):
    """A pair law: the energy of two particles as a function of their distance, with its slope and its curvature.

    Every object with these three methods is a law; no base class or registration is needed.  A law of your own::

        @dataclass(frozen=True)
        class Exponential:
            strength: float  # mJ
            length: float  # mm

            def phi(self, r):
                return self.strength * np.exp(-r / self.length)

            def dphi(self, r):
                return -self.phi(r) / self.length

            def d2phi(self, r):
                return self.phi(r) / self.length**2

        atoms.calc = PairCalculator(atoms, Exponential(5.0, 3.0), shells=3)

    Requirements on the methods:

    - They take an array of distances in mm of any shape and return an array of that shape, element by element.
    - A law repels where `dphi < 0`.  Only differences of `phi` matter, so its zero may be anywhere.
    - They should accept complex distances, because higher derivatives are then exact. Any analytic formula in r does so. In a
      piecewise law compare real parts, `np.real(r) < 5`.
    - Where the law is not known, such as beyond the ends of a table, they raise ValueError.
    - The law is immutable: make it a frozen dataclass, so that calculators can be copied, compared and pickled.

    Further properties of a law are on its `card` (`magphonon.interactions.law_cards`). A law without a card describes a force
    along the line between two particles, as between charges; for magnets wrap it in `UprightMagnets(law)`.

    A law that is also a `GaussianMixture` can be summed over all neighbours of an infinite lattice.
    """

    def phi(self, r: Any) -> Any:
        """Energy in mJ of two particles at the distances `r` in mm."""
        ...

    def dphi(self, r: Any) -> Any:
        """Slope of the energy in N, the negative of the force with which the particles repel each other."""
        ...

    def d2phi(self, r: Any) -> Any:
        """Curvature of the energy in N/mm, the stiffness D0 of a bond."""
        ...


class Composed:
    """A law made of other laws: `_part(name, r)` combines their function `name`: 'phi', 'dphi' or 'd2phi'."""

    def _part(self, name: str, r: Any) -> Any:
        raise NotImplementedError

    def phi(self, r: Any) -> Any:
        return self._part('phi', r)

    def dphi(self, r: Any) -> Any:
        return self._part('dphi', r)

    def d2phi(self, r: Any) -> Any:
        return self._part('d2phi', r)


@runtime_checkable
class PairInteraction(Protocol):
    """An interaction of two particles that depends on the vector R from one to the other, not on its length alone.

    It can be used wherever a `PairLaw` can: any object with these three methods is one. Every `PairLaw` is converted
    automatically (`stiffness.matrices.Central`).  An interaction of your own, dipoles in the plane that all point along x::

        @dataclass(frozen=True)
        class AlongX:
            strength: float  # mu0 m^2/(4 pi), mJ mm^3

            def forces(self, R): ...     # from (1 - 3 x^2/r^2)/r^3

            def stiffness(self, R): ...

            def central(self, dim):
                return None

    Vectors may be complex, because some derivatives are computed by complex steps.
    """

    def forces(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Energy in mJ, shape (bonds,), and its gradient in N, shape (bonds, dim), at the vectors R in mm."""
        ...

    def stiffness(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Second derivatives of the energy in N/mm, shapes (bonds, dim, dim): D0, the resistance to stretching along the bond,
        and D*, everything else.
        """
        ...

    def central(self, dim: int) -> PairLaw | None:
        """The law of the distance if forces in `dim` dimensions are along the bond; otherwise None, and the methods that take
        vectors are used.
        """
        ...


@runtime_checkable
class GaussianMixture(PairLaw, Protocol):
    """A pair law that is a mixture of Gaussians, `phi(r) = int_0^inf rho(t) exp(-t r^2) dt`.

    All neighbours of an infinite lattice can be summed for such a law (`magphonon.stiffness.ewald`).  It is either a power
    r^-s, or it falls as `exp(-kappa r)` at large distances; `decay` and `screening` say which.

    Examples
    --------
    >>> from magphonon import InversePower
    >>> from magphonon.interactions import Overlap, Yukawa
    >>> from magphonon.interactions.pair_laws import GaussianMixture
    >>> [isinstance(law, GaussianMixture) for law in (InversePower(1.0, 4.0), Yukawa(1.0, 1.0), Overlap(1.0))]
    [True, True, False]
    """

    def gaussians(self, t: Any) -> Any:
        """Density rho of the mixture at `t` in 1/mm^2, mJ mm^2."""
        ...

    def gaussian_moment(self, t: Any) -> Any:
        """Integral of `t rho(t)` from zero to `t`, mJ/mm^2."""
        ...

    @property
    def decay(self) -> float:
        """Exponent s of a law that falls as r^-s at large distances; infinite for a screened one."""
        ...

    @property
    def screening(self) -> float:
        """Inverse screening length kappa in 1/mm; zero for a law that falls as a power."""
        ...


def repulsion(law: PairLaw, r: Any) -> Any:
    """Repulsive force `f(r) = -phi'(r)` in N at the distances `r` in mm.

    Examples
    --------
    >>> from magphonon import InversePower
    >>> from magphonon.interactions import repulsion
    >>> float(repulsion(InversePower(16.0, 4.0), 2.0))
    1.0
    """
    return -law.dphi(r)


@dataclass(frozen=True)
class InversePower:
    """Inverse-power repulsion `f(r) = b r**-a`, the paper's law for magnets.

    Parameters
    ----------
    b : float
        Strength in N mm^a; write `b = 1.6209e-10 * N * m**a`.
    a : float
        Exponent of the force, positive.  Side-by-side dipoles have a = 4.

    Examples
    --------
    >>> from magphonon import InversePower, units as u
    >>> law = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
    >>> round(float(-law.dphi(10 * u.mm)), 4)  # repulsion in N
    0.2369
    >>> round(float(-law.d2phi(10 * u.mm) / law.dphi(10 * u.mm) * 10 * u.mm), 4)  # the exponent
    4.5824
    """

    b: float
    a: float

    card: ClassVar[Card] = Card(magnets=True, kinds=(
        Kind('inverse_power', 'Force `b r^-a`.',
             {'b': Parameter('b_N_m_a', 1.0, 'b of the force b r^-a in N m^a: the force times r^a', power=1),
              'a': Parameter('a', 1.0, 'the exponent a of the force b r^-a', change=exponent_change)},
             lambda b, a: InversePower(b * units.N * units.m**a, a)),
        Kind('dipoles', 'Point dipoles normal to the plane.',
             {'moment': Parameter('moment_A_m2', units.A * units.m**2, 'the magnetic moment of a particle in A m^2', power=2,
                                  examples=(0.01,))}, lambda moment: InversePower.dipoles(moment)),
        Kind('coulomb', 'Equal point charges.',
             {'charge': Parameter('charge_C', units.A * units.s, 'the charge of a particle in C', power=2)},
             lambda charge: InversePower.coulomb(charge))))

    def __post_init__(self) -> None:
        positive('b', self.b, 'N mm^a')
        positive('a', self.a)

    @classmethod
    def dipoles(cls, moment: float) -> Self:
        """Point dipoles `moment` (A mm^2), normal to the plane: `f = b r^-4`, `b = 3 mu0 m^2/(4 pi)`."""
        positive('moment', moment, 'A mm^2')
        return cls(b=3 * units.mu0 * moment**2 / (4 * np.pi), a=4.0)

    @classmethod
    def coulomb(cls, charge: float) -> Self:
        """Point charges, each `charge` (A ms): `f = b r^-2`, `b = mu0 c^2 Q^2/(4 pi)`."""
        positive('charge', charge, 'A ms')
        return cls(b=units.mu0 * units.c**2 * charge**2 / (4 * np.pi), a=2.0)

    def phi(self, r: Any) -> Any:
        """Energy in mJ, zero at infinity, or at 1 mm if a = 1."""
        if self.a == 1:
            return -self.b * np.log(r)
        return self.b * r ** (1 - self.a) / (self.a - 1)

    def dphi(self, r: Any) -> Any:
        return -self.b * r**-self.a

    def d2phi(self, r: Any) -> Any:
        return self.a * self.b * r ** (-self.a - 1)

    def gaussians(self, t: Any) -> Any:
        return self.b * np.exp((self.a - 3) / 2 * np.log(t) - lgamma((self.a + 1) / 2)) / 2

    def gaussian_moment(self, t: Any) -> Any:
        return t**2 * self.gaussians(t) * 2 / (self.a + 1)

    @property
    def decay(self) -> float:
        """Exponent s = a - 1 of the energy."""
        return self.a - 1

    @property
    def screening(self) -> float:
        return 0.0


@dataclass(frozen=True)
class Yukawa:
    """Screened Coulomb repulsion `phi(r) = c exp(-kappa r)/r`, such as between dust grains in a plasma.

    Parameters
    ----------
    c : float
        Strength in mJ mm, positive.
    kappa : float
        Inverse screening length in 1/mm, positive.

    Examples
    --------
    >>> from magphonon.interactions import Yukawa
    >>> law = Yukawa(c=1.0, kappa=2.0)
    >>> round(float(law.phi(1.0)), 6)  # exp(-2)
    0.135335
    """

    c: float
    kappa: float

    card: ClassVar[Card] = Card(kinds=(Kind(
        'yukawa', 'Energy `strength/r exp(-r/screening length)`.',
        {'strength': Parameter('strength_J_m', units.J * units.m, 'the strength c of the energy c/r exp(-r/l) in J m', power=1),
         'screening_length': Parameter('screening_length_m', units.m, 'the screening length l of the energy c/r exp(-r/l) in m',
                                       change=screening_change, quantity='length')},
        lambda strength, screening_length: Yukawa(strength, 1 / screening_length)),))

    def __post_init__(self) -> None:
        positive('c', self.c, 'mJ mm')
        positive('kappa', self.kappa, '1/mm')

    def phi(self, r: Any) -> Any:
        """Energy in mJ, zero at infinity."""
        return self.c * np.exp(-self.kappa * r) / r

    def dphi(self, r: Any) -> Any:
        return -self.phi(r) * (self.kappa + 1 / r)

    def d2phi(self, r: Any) -> Any:
        return self.phi(r) * (self.kappa**2 + 2 * self.kappa / r + 2 / r**2)

    def gaussians(self, t: Any) -> Any:
        return self.c / np.sqrt(np.pi * t) * np.exp(-(self.kappa**2) / (4 * t))

    def gaussian_moment(self, t: Any) -> Any:
        from scipy.special import erfcx

        z = self.kappa / (2 * np.sqrt(t))
        return 2 / 3 * t**2 * self.gaussians(t) * (1 - 2 * z**2 * (1 - np.sqrt(np.pi) * z * erfcx(z)))

    @property
    def decay(self) -> float:
        """Exponent of the decay, which is infinite: the law falls faster than every power."""
        return np.inf

    @property
    def screening(self) -> float:
        return self.kappa


@dataclass(frozen=True)
class Overlap:
    """Contact of soft spheres, `phi = energy/power (1 - r/d)^power` where they overlap, and no force beyond the distance d.

    Power 2 is a linear spring, 2.5 the contact of elastic spheres (Hertz).  For spheres of different sizes the calculator has the
    radii, `MagneticRepulsion(..., radii=R)`: r is then the distance over the sum of both radii, and d stays 1.

    Parameters
    ----------
    energy : float
        In mJ, positive.
    power : float
        Above 1, by default 2.
    diameter : float
        Distance d at which two spheres touch in mm, positive.
    elastic : bool
        Whether the energy depends on both radii as for elastic spheres of one material; `energy` is then that of two spheres with
        a radius of 1 mm, see `between`.

    Raises
    ------
    ValueError
        If a parameter is out of range; or when the law is evaluated for spheres that overlap by more than half their diameter,
        unless they are linear springs.

    Examples
    --------
    >>> from magphonon import units as u
    >>> from magphonon.interactions import Overlap
    >>> spring = Overlap(1.0)
    >>> round(float(-spring.dphi(0.9)), 9), float(spring.d2phi(0.9))  # of r/d
    (0.1, 1.0)
    >>> balls = Overlap.spheres(206 * u.GPa, 0.3, diameter=20 * u.mm)
    >>> round(float(-balls.dphi(19.997)))  # N, 3 um of overlap
    55
    >>> float(balls.dphi(20.001))  # no contact, no force
    -0.0
    """

    energy: float
    power: float = 2.0
    diameter: float = 1.0
    elastic: bool = False

    card: ClassVar[Card] = Card(kinds=(Kind(
        'hertz', 'Contacts of elastic spheres, compressed where the spacing of the lattice is less than their diameter.',
        {'diameter': Parameter('diameter_m', units.m, 'the diameter of the spheres in m', quantity='length'),
         'youngs_modulus': Parameter('youngs_modulus_Pa', units.Pa, "Young's modulus of the spheres in Pa", quantity='pressure'),
         'poisson_ratio': Parameter('poisson_ratio', words="Poisson's ratio of the spheres", quantity='ratio')},
        lambda diameter, youngs_modulus, poisson_ratio: Overlap.spheres(youngs_modulus, poisson_ratio, diameter)),))

    def __post_init__(self) -> None:
        positive('energy', self.energy, 'mJ')
        positive('power - 1', self.power - 1)
        positive('diameter', self.diameter, 'mm')

    @classmethod
    def spheres(cls, youngs_modulus: float, poisson_ratio: float, diameter: float | None = None) -> Self:
        """Elastic spheres of one material, `f = 4/3 E* sqrt(Ri Rj/(Ri + Rj)) (Ri + Rj - r)^(3/2)` with `E* = E/(2 (1 - nu^2))`:
        equal ones of a diameter in mm, or of the radii that the calculator has; the modulus is in N/mm^2.
        """
        modulus = positive('youngs_modulus', youngs_modulus, 'N/mm^2') / (2 * (1 - poisson_ratio**2))
        if diameter is None:
            return cls(16 / 3 * modulus, 2.5, elastic=True)
        return cls(2 / 3 * modulus * positive('diameter', diameter, 'mm') ** 3, 2.5, diameter)

    def between(self, Ri: Any, Rj: Any) -> Any:
        """Factor of the energy for two radii in mm: 1, or `sqrt(Ri Rj) (Ri + Rj)^2/4` for elastic spheres of one material."""
        return np.sqrt(Ri * Rj) * (Ri + Rj) ** 2 / 4 if self.elastic else np.ones(np.shape(Ri))

    def _part(self, r, order):
        nearest = np.min(np.real(r), initial=np.inf) / self.diameter
        if nearest < 1 - DEEPEST and self.power != 2:
            raise ValueError(f'spheres are only {nearest:.3g} of the distance apart at which they touch: the law of their '
                             f'contact holds for an overlap of a few percent, and ends at {DEEPEST:.0%}; give them more room')
        touching = np.real(r) < self.diameter
        return np.where(touching, np.where(touching, (self.diameter - r) / self.diameter, 1.0) ** (self.power - order), 0.0)

    def phi(self, r: Any) -> Any:
        """Energy in mJ, zero out of contact."""
        return self.energy / self.power * self._part(r, 0)

    def dphi(self, r: Any) -> Any:
        return -self.energy / self.diameter * self._part(r, 1)

    def d2phi(self, r: Any) -> Any:
        return self.energy * (self.power - 1) / self.diameter**2 * self._part(r, 2)


@dataclass(frozen=True)
class Tabulated:
    """A smooth law through measured force-distance data: cubic spline of `log f` over `log r`.

    On logarithmic axes an inverse power is a straight line, which the spline reproduces exactly; between
    measured points the force stays positive and has a continuous slope and curvature.  The energy is the
    integral of the force, zero at the last point.  Below the first point the table continues by a tenth (`MARGIN`), because
    particles move about their places.  Beyond the last point the force goes on as the inverse power that fits there; to cut it
    off would be an error of 7 to 20 % in the bands of a lattice whose table ends before the second neighbours.  If the end falls
    more slowly than the force of dipoles, as one in the noise may, it becomes as steep within an octave (`BEND`).

    Parameters
    ----------
    r : array_like, shape (n,)
        Distances in mm, increasing, n >= 4.
    f : array_like, shape (n,)
        Repulsive forces in N, positive.

    Raises
    ------
    ValueError
        If the table is malformed, or when the law is evaluated at a distance where it does not continue.

    Warns
    -----
    UserWarning
        If the spline strays between two readings, or if two readings are so close that their noise looks like an exponent.

    Examples
    --------
    >>> from magphonon.interactions import Tabulated
    >>> law = Tabulated([8.0, 9.0, 10.0, 12.0], [0.66, 0.38, 0.24, 0.10])
    >>> round(float(-law.dphi(9.5)), 3)
    0.3
    """

    r: np.ndarray
    f: np.ndarray
    _knots: np.ndarray = field(init=False, repr=False, compare=False)
    _slopes: np.ndarray = field(init=False, repr=False, compare=False)
    _energies: np.ndarray = field(init=False, repr=False, compare=False)

    card: ClassVar[Card] = Card(magnets=True, kinds=(Kind('table', parameters={'forces': Parameter('forces_N', power=1)}),))

    def __post_init__(self) -> None:
        from scipy.interpolate import CubicSpline

        r, f = finite('r', self.r).copy(), finite('f', self.f).copy()
        if r.ndim != 1 or r.shape != f.shape or len(r) < 4:
            raise ValueError(f'a table needs two columns of at least 4 points each, not the shapes {r.shape} and {f.shape}')
        if not (r[0] > 0 and (np.diff(r) > 0).all()):
            raise ValueError(f'table distances must be positive and increasing, not {r}; sort them and drop repeats')
        for k in np.flatnonzero(np.diff(r) < APART * r[1:])[:1]:
            raise ValueError(f'the table distances {r[k]:.12g} and {r[k + 1]:.12g} mm are equal; average their forces')
        if not (f > 0).all():
            raise ValueError(f'table forces must be positive (repulsive), not {f.min():g} N; drop the points at the noise floor')
        spline = CubicSpline(np.log(r), np.log(f))
        _warn_of_readings(r, f, spline)
        knots = np.union1d(r, np.geomspace(r[0], r[-1], int(np.ceil(np.log(r[-1] / r[0]) / PIECE))))
        slopes = [spline(np.log(knots[:-1]), n) / (1, 1, 2, 6)[n] for n in (3, 2, 1, 0)]
        (low, high), (a, b) = np.log(r[[0, -1]]), spline(np.log(r[[0, -1]]), 1)  # beyond them straight on logarithmic axes
        tail, octave = min(b, -DIPOLES), np.log(BEND)
        before, bent = [0, 0, a, spline(low) - a * np.log(MARGIN)], [0, (tail - b) / (2 * octave), b, spline(high)]
        behind = [0, 0, tail, spline(high) + (b + tail) / 2 * octave]
        knots = np.concatenate([[r[0] / MARGIN], knots, r[-1] * np.array([BEND, FAR])])
        slopes = np.column_stack([before, slopes, bent, behind])
        for name, value in (('r', r), ('f', f), ('_knots', knots), ('_slopes', slopes)):
            object.__setattr__(self, name, value)
        # phi at each knot from the integral over the interval beyond it
        steps = self._force_integral(np.arange(len(self._knots) - 1), self._knots[1:])
        object.__setattr__(self, '_energies', np.append(np.cumsum(steps[::-1])[::-1], 0.0) - steps[-2:].sum())

    def _interval(self, r):
        """Index k of the interval between two knots that holds each distance."""
        real = np.real(r)
        within = (real >= self._knots[0]) & (real <= self._knots[-1])
        if not within.all():
            bad = np.asarray(real)[~within].flat[0]
            raise ValueError(f'distance {bad:g} mm is outside the table ({self.r[0]:g} to {self.r[-1]:g} mm); '
                             'extend the measurement, or check the spacing and its unit: a table is not extrapolated')
        return np.clip(np.searchsorted(self._knots, real, side='right') - 1, 0, len(self._knots) - 2)

    def _force(self, k, r):
        """Force, and d log f/d log r, on piece k of the spline."""
        x = np.log(r) - np.log(self._knots[k])
        c3, c2, c1, c0 = self._slopes[:, k]
        return np.exp(c0 + x * (c1 + x * (c2 + x * c3))), c1 + x * (2 * c2 + x * 3 * c3)

    def _force_integral(self, k, r):
        """Integral of the force over the interval k, from its first knot to `r`."""
        k, r, first = np.broadcast_arrays(k, r, self._knots[k])
        c3, c2, c1, c0 = self._slopes[:, k]
        tail = (c3 == 0) & (c2 == 0) & (c1 < -1)
        with np.errstate(over='ignore'):  # of the others
            ends = [np.exp(c0) * first * (x / first) ** (1 + c1) for x in (r, first)]
        found = np.where(tail, (ends[0] - ends[1]) / np.where(tail, 1 + c1, 1.0), 0.0)
        if (curved := ~tail).any():
            k, first, span = k[curved], first[curved], (r - first)[curved]
            found[curved] = span * sum(w * self._force(k, first + node * span)[0]
                                       for node, w in zip(_NODES, _WEIGHTS, strict=True))
        return found[()]

    @property
    def farthest(self) -> float:
        """The last distance in mm at which the force was measured."""
        return float(self.r[-1])

    def phi(self, r: Any) -> Any:
        """Energy in mJ, zero at the last point of the table."""
        k = self._interval(r)
        return self._energies[k] - self._force_integral(k, r)

    def dphi(self, r: Any) -> Any:
        return -self._force(self._interval(r), r)[0]

    def d2phi(self, r: Any) -> Any:
        f, slope = self._force(self._interval(r), r)
        return -f * slope / r


@dataclass(frozen=True)
class Spring:
    """A spring or an elastic bar, `phi(r) = k (r - L0)^2/2`: it pulls where it is longer than `L0` and pushes where shorter.

    Parameters
    ----------
    k : float
        Stiffness in N/mm, positive.
    L0 : float
        Length without load in mm; 0 for a spring whose pull is proportional to its length.

    Examples
    --------
    >>> from magphonon.interactions import Spring
    >>> float(Spring(k=2.0, L0=10.0).dphi(10.5))  # it pulls with 1 N
    1.0
    """

    k: float
    L0: float

    def __post_init__(self) -> None:
        positive('k', self.k, 'N/mm')
        not_negative('L0', self.L0, 'mm')

    def phi(self, r: Any) -> Any:
        return self.k * (r - self.L0) ** 2 / 2

    def dphi(self, r: Any) -> Any:
        """Slope of the energy in N, the tension."""
        return self.k * (r - self.L0)

    def d2phi(self, r: Any) -> Any:
        return self.k + 0 * r


@dataclass(frozen=True)
class Cable(Composed, Spring):
    """A cable: a spring if it is longer than `L0`; if it is shorter it is slack and has neither force nor stiffness.

    Examples
    --------
    >>> from magphonon.interactions import Cable
    >>> cable = Cable(k=2.0, L0=10.0)
    >>> float(cable.dphi(10.5)), float(cable.d2phi(10.5)), float(cable.d2phi(9.5))
    (1.0, 2.0, 0.0)
    """

    def _part(self, name, r):
        return (np.real(r) > self.L0) * getattr(Spring, name)(self, r)


def _warn_of_readings(r, f, spline):
    """Warn of two readings so close that noise looks like an exponent, or of the gap in which the spline strays most."""
    x, y = np.log(r), np.log(f)
    h = np.diff(x)
    slopes = np.diff(y) / h
    beside = np.stack([np.append(slopes[1], slopes[:-1]), np.append(slopes[1:], slopes[-2])])
    wide = np.maximum(np.append(0, h[:-1]), np.append(h[1:], 0))
    beyond = np.maximum(slopes - beside.max(axis=0), beside.min(axis=0) - slopes)
    for k in np.flatnonzero((h < NARROW * wide) & (beyond > STEEPER))[:1]:
        warnings.warn(f'the readings at {r[k]:.6g} and {r[k + 1]:.6g} mm are close together, and their forces of {f[k]:.4g} and '
                      f'{f[k + 1]:.4g} N give an exponent of {-slopes[k]:.3g} between them, and {-beside[0, k]:.3g} and '
                      f'{-beside[1, k]:.3g} on either side; replace them by their mean', stacklevel=4)
        return
    part = np.linspace(0, 1, 17)[1:-1]
    line = y[:-1, None] + np.diff(y)[:, None] * part
    off = spline(x[:-1, None] + h[:, None] * part) - line
    k, at = np.unravel_index(abs(off).argmax(), off.shape)
    if abs(off[k, at]) > np.log(ASTRAY):
        where, power, table = np.exp((x[k] + part[at] * h[k], line[k, at], line[k, at] + off[k, at]))
        warnings.warn(f'between the readings at {r[k]:.4g} and {r[k + 1]:.4g} mm nothing constrains the table: at {where:.4g} '
                      'mm its '
                      f'spline has {table:.3g} N, the inverse power through these two {power:.3g} N; measure there, leave the '
                      'far reading out, or fit a law (magphonon.interactions.fit_forces)', stacklevel=4)


def higher_derivatives(law: PairLaw, r: Any) -> tuple[Any, Any]:
    """Third and fourth derivative of phi at `r` (mm), from phi'' on a circle in the complex plane, by Cauchy's formula.

    For a law that accepts no complex distances, such as a spline of SciPy, they come from differences, to six digits.
    """
    if not continues(law, r):
        below, here, above = (law.d2phi(r * (1 + step)) for step in (-BESIDE, 0.0, BESIDE))
        return (above - below) / (2 * BESIDE * r), (above - 2 * here + below) / (BESIDE * r) ** 2
    f, slope = abs(law.dphi(r)), abs(law.d2phi(r))
    radius = RADIUS * r * np.minimum(1, STEEPEST * f / np.maximum(r * slope, np.finfo(float).tiny)) if f.all() else RADIUS * r
    around = law.d2phi((r + radius * CIRCLE).T).T.copy()  # the first axis of a law along bonds is that of the bonds
    return tuple(n * (around * CIRCLE**-n).mean(axis=0).real / radius**n for n in (1, 2))


def continues(law: PairLaw, r: Any) -> bool:
    """Whether a law accepts complex distances near `r` (mm) as an analytic formula does, and keeps their imaginary part."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('error', np.exceptions.ComplexWarning)
            return np.iscomplexobj(law.d2phi(r + 0j))
    except (TypeError, ValueError, np.exceptions.ComplexWarning):
        return False


def local_exponent(law: PairLaw, r: Any) -> Any:
    """Exponent `-d ln f/d ln r` of the inverse power that touches the law at `r`."""
    return -r * law.d2phi(r) / law.dphi(r)
