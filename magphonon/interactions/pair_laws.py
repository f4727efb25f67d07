"""Pair laws of repulsion: `phi(r)`, its slope `dphi` and its curvature `d2phi`.

`PairLaw` defines a law and says how to write your own.  The force with which two particles repel each other is
`f(r) = -phi'(r)`.  (The paper writes `f = phi_r`; with the usual sign of an energy it is the negative slope, and the bond
stiffness is `phi'' nn + (phi'/r)(I - nn)`.)  What depends on more than the distance is a `PairInteraction`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from math import lgamma
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from .. import units
from ..errors import finite, positive
from .law_cards import Card, Kind, Parameter, card_of, exponent_change, screening_change

DEEPEST = 0.5
"""Largest overlap of two spheres as a fraction of their diameter.  Hertz' law is for contacts small beside the sphere, and some
percent off at a tenth; beyond a half spheres are no longer pressed but lie in one another."""
# Gauss-Legendre on [0, 1]: the energy between two table points to round-off, also for a law as steep as r^-12
# sampled twice per octave.
_NODES, _WEIGHTS = (0.5 * (x + shift) for x, shift in zip(np.polynomial.legendre.leggauss(16), (1, 0), strict=True))
CIRCLE = np.exp(2j * np.pi * np.arange(8) / 8)[:, None]
RADIUS, STEEPEST = 1e-2, 20.0
"""Radius of the circle in the complex plane on which the law is sampled for its higher derivatives, to about 1e-11, as a fraction
of the bond length, or of 20 f/f' for a steeper law such as that of spheres in contact."""
APART = 3e-4  # relative step of the differences where a law takes no complex distances


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

        atoms.calc = MagneticRepulsion(atoms, Exponential(5.0, 3.0), shells=3)

    Requirements on the methods:

    - They take an array of distances in mm of any shape and return an array of that shape, element by element.
    - A law repels where `dphi < 0`.  Only differences of `phi` matter, so its zero may be anywhere.
    - They had better accept complex distances, because higher derivatives are then exact.  Any analytic formula in r does so.
      In a law by parts compare real parts, `np.real(r) < 5`.
    - Where the law is not known, such as beyond the ends of a table, they raise ValueError.
    - The law is immutable: make it a frozen dataclass, so that calculators can be copied, compared and pickled.

    What else is known of a law stands on its `card` (`magphonon.interactions.law_cards`).  A law without one is that of a force
    along the line between two particles, as between charges; that of magnets is told by `UprightMagnets(law)`.

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


@runtime_checkable
class PairInteraction(Protocol):
    """An interaction of two particles that depends on the vector R from one to the other, not on its length alone.

    It serves wherever a `PairLaw` does: any object with these three methods is one.  Every `PairLaw` becomes one by itself
    (`magphonon.stiffness.bond.Central`).  An interaction of your own, dipoles in the plane that all point along x::

        @dataclass(frozen=True)
        class AlongX:
            strength: float  # mu0 m^2/(4 pi), mJ mm^3

            def forces(self, R): ...     # of (1 - 3 x^2/r^2)/r^3

            def stiffness(self, R): ...

            def central(self, dim):
                return None

    Vectors may be complex, because some derivatives are computed by complex steps.
    """

    def forces(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Energy in mJ, shape (bonds,), and its gradient by R in N, shape (bonds, dim), at the vectors R in mm."""
        ...

    def stiffness(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Second derivatives of the energy in N/mm, shapes (bonds, dim, dim): D0, what resists stretching along the bond,
        and D*, all else.
        """
        ...

    def central(self, dim: int) -> PairLaw | None:
        """The law of the distance, if forces in `dim` dimensions are along the bond; else None, and vectors are asked for."""
        ...


@runtime_checkable
class GaussianMixture(PairLaw, Protocol):
    """A pair law that is a mixture of Gaussians, `phi(r) = int_0^inf rho(t) exp(-t r^2) dt`.

    All neighbours of an infinite lattice can be summed for such a law (`magphonon.stiffness.ewald`).  It is either a power
    r^-s, or it falls as `exp(-kappa r)` at large distances; `decay` and `screening` say which.

    Examples
    --------
    >>> from magphonon import Hertz, InversePower, Yukawa
    >>> from magphonon.interactions import GaussianMixture
    >>> [isinstance(law, GaussianMixture) for law in (InversePower(1.0, 4.0), Yukawa(1.0, 1.0), Hertz(1.0, 1.0))]
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
        Kind('inverse_power', parameters={'b': Parameter('b_N_m_a', power=1), 'force': Parameter('force_N', power=1),
                                          'a': Parameter('a', change=exponent_change)}),
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
        """Energy in mJ, zero at infinity, or at 1 mm where a = 1."""
        if self.a == 1:
            return -self.b * np.log(r)
        return self.b * r ** (1 - self.a) / (self.a - 1)

    def dphi(self, r: Any) -> Any:
        """Slope of the energy in N."""
        return -self.b * r**-self.a

    def d2phi(self, r: Any) -> Any:
        """Curvature of the energy in N/mm."""
        return self.a * self.b * r ** (-self.a - 1)

    def gaussians(self, t: Any) -> Any:
        """Density rho of the Gaussians `exp(-t r^2)`."""
        return self.b * np.exp((self.a - 3) / 2 * np.log(t) - lgamma((self.a + 1) / 2)) / 2

    def gaussian_moment(self, t: Any) -> Any:
        """Integral of `t rho` from zero."""
        return t**2 * self.gaussians(t) * 2 / (self.a + 1)

    @property
    def decay(self) -> float:
        """Exponent s = a - 1 of the energy."""
        return self.a - 1

    @property
    def screening(self) -> float:
        """Zero."""
        return 0.0


@dataclass(frozen=True)
class Yukawa:
    """Screened Coulomb repulsion `phi(r) = c exp(-kappa r)/r`, of dust grains in a plasma.

    Parameters
    ----------
    c : float
        Strength in mJ mm, positive.
    kappa : float
        Inverse screening length in 1/mm, positive.

    Examples
    --------
    >>> from magphonon import Yukawa
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
        """Slope of the energy in N."""
        return -self.phi(r) * (self.kappa + 1 / r)

    def d2phi(self, r: Any) -> Any:
        """Curvature of the energy in N/mm."""
        return self.phi(r) * (self.kappa**2 + 2 * self.kappa / r + 2 / r**2)

    def gaussians(self, t: Any) -> Any:
        """Density rho of the Gaussians `exp(-t r^2)`."""
        return self.c / np.sqrt(np.pi * t) * np.exp(-(self.kappa**2) / (4 * t))

    def gaussian_moment(self, t: Any) -> Any:
        """Integral of `t rho` from zero."""
        from scipy.special import erfcx

        z = self.kappa / (2 * np.sqrt(t))
        return 2 / 3 * t**2 * self.gaussians(t) * (1 - 2 * z**2 * (1 - np.sqrt(np.pi) * z * erfcx(z)))

    @property
    def decay(self) -> float:
        """Infinite: it falls faster than every power."""
        return np.inf

    @property
    def screening(self) -> float:
        """Inverse screening length kappa in 1/mm."""
        return self.kappa


@dataclass(frozen=True)
class Hertz:
    """Contact of elastic spheres, `f(r) = A (d - r)^(3/2)` where they overlap and no force beyond the diameter d.

    Parameters
    ----------
    stiffness : float
        A in N mm^-3/2, positive.
    diameter : float
        Distance d at which two spheres touch in mm, positive.

    Raises
    ------
    ValueError
        If either is not a positive number; when the law is asked for spheres that overlap by more than half of their diameter.

    Examples
    --------
    >>> from magphonon import Hertz, units as u
    >>> balls = Hertz.spheres(20 * u.mm, 206 * u.GPa, 0.3)
    >>> round(float(-balls.dphi(19.997)))  # N, 3 um of overlap
    55
    >>> float(balls.dphi(20.001))  # no contact, no force
    -0.0
    """

    stiffness: float
    diameter: float

    card: ClassVar[Card] = Card(kinds=(Kind(
        'hertz', 'Contacts of elastic spheres, compressed where the spacing of the lattice is less than their diameter.',
        {'diameter': Parameter('diameter_m', units.m, 'the diameter of the spheres in m', quantity='length'),
         'youngs_modulus': Parameter('youngs_modulus_Pa', units.Pa, "Young's modulus of the spheres in Pa", quantity='pressure'),
         'poisson_ratio': Parameter('poisson_ratio', words="Poisson's ratio of the spheres", quantity='ratio')},
        lambda diameter, youngs_modulus, poisson_ratio: Hertz.spheres(diameter, youngs_modulus, poisson_ratio)),))

    def __post_init__(self) -> None:
        positive('stiffness', self.stiffness, 'N mm^-3/2')
        positive('diameter', self.diameter, 'mm')

    @classmethod
    def spheres(cls, diameter: float, youngs_modulus: float, poisson_ratio: float) -> Self:
        """Equal spheres of one material: `A = E sqrt(d)/(3 (1 - nu^2))`; diameter in mm, modulus in N/mm^2."""
        positive('diameter', diameter, 'mm')
        positive('youngs_modulus', youngs_modulus, 'N/mm^2')
        return cls(youngs_modulus * np.sqrt(diameter) / (3 * (1 - poisson_ratio**2)), diameter)

    def _overlap(self, r):
        nearest = np.min(np.real(r), initial=np.inf)
        if nearest < (1 - DEEPEST) * self.diameter:
            raise ValueError(f'spheres of the diameter {self.diameter:g} mm are {nearest:g} mm apart: the law of their contact '
                             f'holds for an overlap of some percent, and ends at {DEEPEST:.0%}; give them more room')
        return np.where(np.real(r) < self.diameter, self.diameter - r, 0.0)

    def phi(self, r: Any) -> Any:
        """Energy in mJ, zero out of contact."""
        return 2 / 5 * self.stiffness * self._overlap(r) ** 2.5

    def dphi(self, r: Any) -> Any:
        """Slope of the energy in N."""
        return -self.stiffness * self._overlap(r) ** 1.5

    def d2phi(self, r: Any) -> Any:
        """Curvature of the energy in N/mm."""
        return 3 / 2 * self.stiffness * self._overlap(r) ** 0.5


@dataclass(frozen=True)
class Tabulated:
    """A smooth law through measured force-distance data: cubic spline of `log f` over `log r`.

    On logarithmic axes an inverse power is a straight line, which the spline reproduces exactly; between
    measured points the force stays positive and has a continuous slope and curvature.  The energy is the
    integral of the force, zero at the last point.

    Parameters
    ----------
    r : array_like, shape (n,)
        Distances in mm, increasing, n >= 4.
    f : array_like, shape (n,)
        Repulsive forces in N, positive.

    Raises
    ------
    ValueError
        If the table is malformed, or when the law is asked for a distance outside it.

    Examples
    --------
    >>> from magphonon import Tabulated
    >>> law = Tabulated([8.0, 9.0, 10.0, 12.0], [0.66, 0.38, 0.24, 0.10])
    >>> round(float(-law.dphi(9.5)), 3)
    0.3
    """

    r: np.ndarray
    f: np.ndarray
    _slopes: np.ndarray = field(init=False, repr=False, compare=False)
    _energies: np.ndarray = field(init=False, repr=False, compare=False)

    card: ClassVar[Card] = Card(magnets=True, kinds=(Kind('table', parameters={'forces': Parameter('forces_N', power=1)}),))

    def __post_init__(self) -> None:
        from scipy.interpolate import CubicSpline

        r, f = finite('r', self.r).copy(), finite('f', self.f).copy()
        if r.ndim != 1 or r.shape != f.shape or len(r) < 4:
            raise ValueError(f'a table needs two columns of at least 4 points, not r {r.shape} and f {f.shape}')
        if not (r[0] > 0 and (np.diff(r) > 0).all()):
            raise ValueError(f'table distances must be positive and increasing, not {r}; sort them and drop repeats')
        if not (f > 0).all():
            raise ValueError(f'table forces must be positive (repulsive), not {f.min():g} N; drop the points at the noise floor')
        spline = CubicSpline(np.log(r), np.log(f))
        for name, value in (('r', r), ('f', f), ('_slopes', spline.c), ('_energies', np.zeros(len(r)))):
            object.__setattr__(self, name, value)
        # phi at each point from the integral over the interval beyond it
        steps = [self._force_integral(k, r[k + 1]) for k in range(len(r) - 1)]
        object.__setattr__(self, '_energies', np.append(np.cumsum(steps[::-1])[::-1], 0.0))

    def _interval(self, r):
        """Index k of the table interval that holds each distance."""
        real = np.real(r)
        if not ((real >= self.r[0]) & (real <= self.r[-1])).all():
            bad = np.asarray(real)[~((real >= self.r[0]) & (real <= self.r[-1]))].flat[0]
            raise ValueError(f'distance {bad:g} mm is outside the table ({self.r[0]:g} to {self.r[-1]:g} mm); '
                             'extend the measurement, or check the spacing and its unit: a table is not extrapolated')
        return np.clip(np.searchsorted(self.r, real, side='right') - 1, 0, len(self.r) - 2)

    def _force(self, k, r):
        """Force, and d log f/d log r, on the spline piece k."""
        x = np.log(r) - np.log(self.r[k])
        c3, c2, c1, c0 = self._slopes[:, k]
        return np.exp(c0 + x * (c1 + x * (c2 + x * c3))), c1 + x * (2 * c2 + x * 3 * c3)

    def _force_integral(self, k, r):
        """Integral of the force from the point k of the table to `r`."""
        start = self.r[k]
        span = r - start
        return span * sum(w * self._force(k, start + node * span)[0] for node, w in zip(_NODES, _WEIGHTS, strict=True))

    def phi(self, r: Any) -> Any:
        """Energy in mJ, zero at the last point of the table."""
        k = self._interval(r)
        return self._energies[k] - self._force_integral(k, r)

    def dphi(self, r: Any) -> Any:
        """Slope of the energy in N."""
        return -self._force(self._interval(r), r)[0]

    def d2phi(self, r: Any) -> Any:
        """Curvature of the energy in N/mm."""
        f, slope = self._force(self._interval(r), r)
        return -f * slope / r


@dataclass(frozen=True)
class Attraction:
    """The opposite of a law: particles that attract each other as strongly as others repel.

    Examples
    --------
    >>> from magphonon import InversePower
    >>> from magphonon.interactions import Attraction, repulsion
    >>> float(repulsion(Attraction(InversePower(16.0, 4.0)), 2.0))
    -1.0
    """

    repulsion: PairLaw

    @property
    def card(self) -> Card:
        """What is known of the law whose sign it turns; no law of scenes of its own."""
        return card_of(self.repulsion)

    def phi(self, r: Any) -> Any:
        """Energy in mJ."""
        return -self.repulsion.phi(r)

    def dphi(self, r: Any) -> Any:
        """Slope of the energy in N, positive."""
        return -self.repulsion.dphi(r)

    def d2phi(self, r: Any) -> Any:
        """Curvature of the energy in N/mm."""
        return -self.repulsion.d2phi(r)


def higher_derivatives(law: PairLaw, r: Any) -> tuple[Any, Any]:
    """Third and fourth derivative of phi at `r` (mm), from phi'' on a circle in the complex plane, by Cauchy's formula; to six
    digits, by differences, of a law that takes no complex distances, such as a spline of SciPy.
    """
    if not continues(law, r):
        below, here, above = (law.d2phi(r * (1 + step)) for step in (-APART, 0.0, APART))
        return (above - below) / (2 * APART * r), (above - 2 * here + below) / (APART * r) ** 2
    f, slope = abs(law.dphi(r)), abs(law.d2phi(r))
    radius = RADIUS * r * np.minimum(1, STEEPEST * f / np.maximum(r * slope, np.finfo(float).tiny)) if f.all() else RADIUS * r
    around = law.d2phi((r + radius * CIRCLE).T).T.copy()  # the first axis of a law along bonds is that of the bonds
    return tuple(n * (around * CIRCLE**-n).mean(axis=0).real / radius**n for n in (1, 2))


def continues(law: PairLaw, r: Any) -> bool:
    """Whether a law takes complex distances near `r` (mm) as an analytic formula does, and does not drop their imaginary part."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('error', np.exceptions.ComplexWarning)
            return np.iscomplexobj(law.d2phi(r + 0j))
    except (TypeError, ValueError, np.exceptions.ComplexWarning):
        return False


def local_exponent(law: PairLaw, r: Any) -> Any:
    """Exponent `-d ln f/d ln r` of the inverse power that touches the law at `r`."""
    return -r * law.d2phi(r) / law.dphi(r)
