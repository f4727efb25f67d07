"""Energy, force and pair law of two magnets, from the charges on their faces."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.polynomial import Chebyshev
from numpy.polynomial.chebyshev import chebinterpolate
from numpy.typing import ArrayLike, NDArray

from .. import units
from ..errors import finite, positive
from .law_cards import Card, Kind, Parameter
from .magnets import Cuboid, Ring, _side_by_side, moment
from .pair_laws import repulsion

CLEARANCE = 0.1
"""Smallest gap between two prisms, as a fraction of their width, for which the law is computed; closer to contact the
series converges too slowly."""
FAR_GAP = 4.0
"""Gap in widths above which energies are summed over faces, because the sum over edges loses accuracy by cancellation in
proportion to r^3."""
TOLERANCE = 1e-13  # relative accuracy of the energy: size of the last term of its series, and accuracy of the sum over edges
LONG_SERIES_TOLERANCE = 1e-10  # that of a long series, of which more terms cost more than they add


def pair_energy(magnet: Cuboid | Ring, r: Any) -> float:
    """Energy in mJ of two equal prisms side by side, their centres `r` > contact (mm) apart, zero at infinity."""
    if not r > magnet.contact:
        raise ValueError(f'two magnets {magnet!r} {r:g} mm apart touch or overlap; keep them more than {magnet.contact:g} mm '
                         'apart')
    h, gap = magnet.height, (r - magnet.contact) / magnet.width
    # the nearest singularity of the integrand is where the rims would meet; its distance from the real rim is about the gap
    # divided by half the width, and the error falls exponentially with it
    n = int(np.ceil(8 - np.log(TOLERANCE) / np.arcsinh(2 * gap)))  # points on a circle or edge, for an error below TOLERANCE
    points, normals = magnet.rim(n)
    if gap < FAR_GAP:
        d = np.linalg.norm(points + np.array([r, 0]) - points[:, None], axis=-1)
        terms = -2 * (h * np.arcsinh(h / d) - h**2 / (np.hypot(d, h) + d)) * (normals @ normals.T)
    else:
        node, weight = np.polynomial.legendre.leggauss(n // 2)  # on each ray from the centre of a face to a point of its rim
        ray = (node + 1) / 2
        areas = np.outer(ray * weight / 2, np.sum(points * normals, axis=1)).ravel()
        points = (ray[:, None, None] * points).reshape(-1, 2)
        d = np.linalg.norm(points + np.array([r, 0]) - points[:, None], axis=-1)
        s = np.hypot(d, h)
        terms = 2 * h**2 / (d * s * (d + s)) * np.outer(areas, areas)  # 2 (1/d - 1/s)
    return _charge_coupling(magnet, magnet) * np.sum(terms)


def pair_force(first: Ring | Cuboid, second: Ring | Cuboid, offset: ArrayLike, n: int = 96) -> NDArray[np.float64]:
    """Force on a prism whose centre is displaced by `offset` from that of another; the magnets stay parallel.

    Parameters
    ----------
    first, second : Ring or Cuboid
        Two magnets that do not touch.
    offset : sequence of 3 floats
        In mm; the third is along the magnetisation.
    n : int
        Number of points on a circle, or on an edge; for magnets side by side the error falls as exp(-n asinh(2 gap/width)).

    Returns
    -------
    ndarray, shape (3,)
        In N.

    Examples
    --------
    >>> from magphonon import units as u
    >>> from magphonon.interactions import Ring
    >>> from magphonon.interactions import pair_force
    >>> magnet = Ring(6.35, 1.5875, 3.175, remanence=1.3 * u.T)
    >>> (pair_force(magnet, magnet, [10.0, 0, 0]) + 0).round(3)  # N, beside: they repel
    array([0.377, 0.   , 0.   ])
    >>> (pair_force(magnet, magnet, [0, 0, 10.0]) + 0).round(3)  # above: they attract
    array([ 0.   ,  0.   , -0.404])
    """
    offset = finite('offset', offset, (3,))
    between = abs(offset[2]) - (first.height + second.height) / 2
    if not (between > 0 or _side_by_side(first, second, offset[:2])):
        raise ValueError(f'{first!r} and {second!r}, displaced by {offset.tolist()} mm, touch or overlap, where the force is not '
                         f'defined; move their centres apart, by more than {first.height / 2 + second.height / 2:g} mm along '
                         'the magnetisation or until they are clear of each other across it')
    (points, normals), (others, outward) = first.rim(n), second.rim(n)
    d = others + np.asarray(offset)[:2] - points[:, None]
    force = np.zeros(3)
    for face in (1, -1):
        for other in (1, -1):
            z = offset[2] + (other * second.height - face * first.height) / 2
            s = np.sqrt((d**2).sum(axis=-1) + z**2)
            # gradient of G = s - |z| log(s + |z|), along d and along z
            slope = np.dstack([d / (s + abs(z))[..., None], -np.sign(z) * np.log(s + abs(z))])
            force += face * other * np.einsum('ijk,ij->k', slope, normals @ outward.T)
    return _charge_coupling(first, second) * force


def _charge_coupling(first, second):
    """The constant `mu0 M M'/(4 pi)` of two magnets in N/mm^2."""
    return first.remanence * second.remanence / (4 * np.pi * units.mu0)


@dataclass(frozen=True)
class MagnetLaw:
    """Law of two equal prisms: that of point dipoles, times a series in the inverse square of the distance.

        phi = strength r^-3 P(t),   t = (nearest/r)^2

    Because of the mirror planes of these magnets the energy has no other powers of r, so one polynomial P describes it from
    `nearest` to infinity, where P = 1.  For the prototype 32 terms give ten digits of the force and of its slope (seven of
    the slope at `nearest`); a table of 400 points (`Tabulated`) gives nine digits of the force and six of the slope.

    Attributes
    ----------
    strength : float
        The value `mu0 m^2/(4 pi)` for the moments m, in mJ mm^3.
    nearest : float
        Smallest distance in mm at which the law is known.
    series : ndarray
        Coefficients of P in Chebyshev polynomials on 0 <= t <= 1.

    Raises
    ------
    ValueError
        When the law is asked for a distance below `nearest`.
    """

    strength: float
    nearest: float
    series: np.ndarray = field(repr=False)

    card: ClassVar[Card] = Card(magnets=True, kinds=(Kind('magnets', parameters={
        'remanence': Parameter('remanence_T', power=2)}),))

    @cached_property
    def _factors(self):
        """The factor P of the energy, and the factors in its place in the force and its slope, from r d/dr = -2 t d/dt."""
        P, t = Chebyshev(self.series, [0, 1]), Chebyshev([0.5, 0.5], [0, 1])
        force = 3 * P + 2 * t * P.deriv()
        return P, force, 4 * force + 2 * t * force.deriv()

    def _t(self, r):
        return (self.nearest / _apart(r, self.nearest)) ** 2

    def phi(self, r: Any) -> Any:
        """Energy in mJ, zero at infinity."""
        return self.strength * r**-3.0 * self._factors[0](self._t(r))

    def dphi(self, r: Any) -> Any:
        return -self.strength * r**-4.0 * self._factors[1](self._t(r))

    def d2phi(self, r: Any) -> Any:
        return self.strength * r**-5.0 * self._factors[2](self._t(r))


def _apart(r, nearest):
    """Return the distances; refuse those below `nearest`."""
    if not np.all(np.real(r) >= nearest):
        raise ValueError(f'two such magnets {np.min(np.real(r)):g} mm apart are too close: their law starts at {nearest:g} mm; '
                         'give them more room')
    return r


@lru_cache
def magnet_law(magnet: Ring | Cuboid) -> MagnetLaw:
    """Law of repulsion of two equal magnets side by side, magnetised normal to the plane.

    Raises
    ------
    ValueError
        For rods longer than about 30 diameters, for which the series does not converge.

    Examples
    --------
    >>> from magphonon import magnet_law, units as u
    >>> from magphonon.interactions import Ring
    >>> law = magnet_law(Ring(6.35, 1.5875, 3.175, remanence=1.3 * u.T))
    >>> round(float(-law.dphi(10.0)), 3)  # N
    0.377
    """
    nearest = magnet.contact + CLEARANCE * magnet.width
    return MagnetLaw(_strength(magnet), float(nearest), _series(replace(magnet, remanence=1.0), nearest))


def _strength(magnet):
    return float(units.mu0 * moment(magnet) ** 2 / (4 * np.pi))


@lru_cache(maxsize=64)
def _series(magnet, nearest):
    """Chebyshev coefficients of P, which do not depend on the remanence; most of the time of `magnet_law` is spent here."""
    def P(x):
        r = nearest / np.sqrt((x + 1) / 2)
        return np.array([pair_energy(magnet, d) for d in r]) * r**3 / _strength(magnet)

    for degree in (31, 63, 127, 255):  # long rods need most terms, because their faces act as single poles
        series = chebinterpolate(P, degree)
        if abs(series[-3:]).max() < (TOLERANCE if degree < 127 else LONG_SERIES_TOLERANCE) * abs(series).max():
            return series
    raise ValueError(f'the law of {magnet} needs more than {degree} terms; such slender rods act as single poles: '
                     'use an inverse power with a = 2')


def calibrated(magnet: Cuboid | Ring, r: Any, f: float) -> Cuboid | Ring:
    """The magnet with the remanence that gives the measured force `f` (N) at the distance `r` (mm).

    Examples
    --------
    >>> from magphonon import units as u
    >>> from magphonon.interactions import Ring
    >>> from magphonon.interactions import calibrated, magnet_law
    >>> magnet = calibrated(Ring(6.35, 1.5875, 3.175, remanence=1.3 * u.T), 10.0, 0.2369)
    >>> round(float(-magnet_law(magnet).dphi(10.0)), 6)  # the measured force
    0.2369
    """
    positive('r', r, 'mm')
    positive('f', f, 'N')
    return replace(magnet, remanence=float(magnet.remanence * np.sqrt(f / repulsion(magnet_law(magnet), r))))
