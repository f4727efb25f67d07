"""Repulsion of equal magnets side by side, from shape and remanence.

A magnet of the uniform magnetisation M = Br/mu0 normal to the plane carries the magnetic charges +M and -M per area on its two
end faces, and no other charges.  The energy of two such magnets is a sum over pairs of faces. Two faces at heights z apart have

    U = +- mu0 M M'/(4 pi) integral dA dA' g        g = 1/s,  s = sqrt(d^2 + z^2)

with the distance d in the plane.  Gauss's theorem, applied once to each face, leaves integrals over the rims,

    U = -+ mu0 M M'/(4 pi) integral dl dl' n.n' G   laplacian(G) = G_dd + G_d/d = g

and G = s - |z| log(s + |z|).  As faces do not overlap, any harmonic function of d may be added to G: it integrates to zero.
For two magnets at one height the sum over faces is, with s = sqrt(d^2 + h^2) and without cancellation of large terms,

    G = 2 (h asinh(h/d) - h^2/(s + d))

Integrals over rims use rules that converge exponentially with the number of points: equidistant points on a circle,
Gauss's points on an edge.  The field outside a sphere is exactly that of a point dipole, `InversePower.dipoles(moment)`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .. import units
from ..errors import not_negative, one_of, positive

GRADES_T = {'N30': (1.08, 1.13), 'N33': (1.13, 1.18), 'N35': (1.17, 1.22), 'N38': (1.21, 1.25), 'N40': (1.25, 1.28),
            'N42': (1.28, 1.32), 'N45': (1.32, 1.38), 'N48': (1.37, 1.42), 'N50': (1.39, 1.45), 'N52': (1.42, 1.48)}
"""Smallest and largest remanence of sintered NdFeB at 20 C in T: the widest of the ranges in manufacturers' tables."""


def grade_remanence(grade: str) -> float:
    """Remanence of an NdFeB grade such as 'N42', the middle of its range, in the units of the package, N/(A mm).

    Examples
    --------
    >>> from magphonon import units as u
    >>> from magphonon.interactions.magnets import grade_remanence
    >>> round(grade_remanence('N42') / u.T, 9)
    1.3
    """
    return float(np.mean(GRADES_T[one_of('grade', grade, tuple(GRADES_T))])) * units.T


@dataclass(frozen=True)
class Ring:
    """Ring, or with `inner` = 0 a disc, magnetised along its axis.

    Attributes
    ----------
    outer, inner, height : float
        Diameters and height in mm.
    remanence : float
        In N/(A mm); write `1.3 * units.T`.

    Examples
    --------
    >>> from magphonon import units as u
    >>> from magphonon.interactions import Ring
    >>> from magphonon.interactions import pair_force
    >>> magnet = Ring(outer=6.35 * u.mm, inner=1.5875 * u.mm, height=3.175 * u.mm, remanence=1.3 * u.T)
    >>> round(magnet.volume * 7.5e-3, 4)  # g, at 7.5 g/cm3
    0.707
    >>> pair_force(magnet, magnet, [10.0, 0, 0]).round(3)  # N, at 10 mm side by side
    array([0.377, 0.   , 0.   ])
    """

    outer: float
    inner: float
    height: float
    remanence: float

    def __post_init__(self) -> None:
        _check_lengths(self, 'outer', 'height')
        if not_negative('inner', self.inner, 'mm') >= self.outer:
            raise ValueError(f'inner must be less than outer = {self.outer:g} mm, not {self.inner:g}; both are diameters')

    @property
    def contact(self) -> float:
        """Distance of the centres of two magnets that touch, mm."""
        return self.outer

    @property
    def width(self) -> float:
        """Size across the line that joins the centres, mm."""
        return self.outer

    @property
    def volume(self) -> float:
        """Volume in mm^3."""
        return np.pi * (self.outer**2 - self.inner**2) / 4 * self.height

    def rim(self, n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points on the rim of a face, shape (m, 2), and its outward normals times the length dl, in mm."""
        angle = 2 * np.pi * np.arange(n) / n
        normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        circles = [(self.outer / 2, 1)] + [(self.inner / 2, -1)] * (self.inner > 0)
        return (np.concatenate([radius * normal for radius, _ in circles]),
                np.concatenate([outward * radius * 2 * np.pi / n * normal for radius, outward in circles]))


@dataclass(frozen=True)
class Cuboid:
    """Cuboid magnetised along its height; `length` lies along the line that joins two of them.

    The pair law holds for two cuboids whose faces are parallel and opposite.  Their forces are not exactly central: for
    two cubes of 5 mm at 10 mm the stiffness against sideways displacement is 4 % smaller than the -f/r of the law, for plates
    of 4 x 10 mm 40 % smaller.

    Attributes
    ----------
    length, width, height : float
        In mm.
    remanence : float
        In N/(A mm).

    Examples
    --------
    >>> from magphonon import units as u
    >>> from magphonon.interactions import Cuboid
    >>> from magphonon.interactions import pair_force
    >>> block = Cuboid(5 * u.mm, 5 * u.mm, 3 * u.mm, remanence=1.3 * u.T)
    >>> pair_force(block, block, [10.0, 0, 0]).round(3)  # N, at 10 mm side by side
    array([0.216, 0.   , 0.   ])
    """

    length: float
    width: float
    height: float
    remanence: float

    def __post_init__(self) -> None:
        _check_lengths(self, 'length', 'width', 'height')

    @property
    def contact(self) -> float:
        """Distance of the centres of two magnets that touch, mm."""
        return self.length

    @property
    def volume(self) -> float:
        """Volume in mm^3."""
        return self.length * self.width * self.height

    def rim(self, n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points on the rim of a face, shape (4 n, 2), and its outward normals times the length dl, in mm."""
        node, weight = np.polynomial.legendre.leggauss(n)
        a, b, one = self.length / 2, self.width / 2, np.ones(n)
        points = [(a * one, b * node), (-a * one, b * node), (a * node, b * one), (a * node, -b * one)]
        normals = [(b * weight, 0 * one), (-b * weight, 0 * one), (0 * one, a * weight), (0 * one, -a * weight)]
        points, normals = (np.concatenate([np.stack(side, axis=-1) for side in sides]) for sides in (points, normals))
        return points, normals


def _check_lengths(magnet, *names):
    for name in names:
        positive(name, getattr(magnet, name), 'mm')
    positive('remanence', magnet.remanence, 'N/(A mm)')


def moment(magnet: Cuboid | Ring) -> float:
    """Magnetic moment M V in A mm^2.

    Examples
    --------
    >>> from magphonon import units as u
    >>> from magphonon.interactions import Ring
    >>> from magphonon.interactions import moment
    >>> round(moment(Ring(6.35, 1.5875, 3.175, remanence=1.3 * u.T)) / (u.A * u.m**2), 4)  # A m^2
    0.0975
    """
    return magnet.remanence / units.mu0 * magnet.volume


def _side_by_side(first, second, offset):
    """Whether the faces of two prisms, whose centres are `offset` apart in the plane, neither touch nor overlap."""
    if isinstance(first, Ring) and isinstance(second, Ring):
        nearest, farthest = np.linalg.norm(offset) - second.outer / 2, np.linalg.norm(offset) + second.outer / 2
        in_its_bore = np.linalg.norm(offset) + first.outer / 2 < second.inner / 2
        return nearest > first.outer / 2 or farthest < first.inner / 2 or in_its_bore
    if isinstance(second, Ring):
        return _side_by_side(second, first, offset)
    sides = np.array([second.length, second.width]) / 2
    if isinstance(first, Ring):
        nearest = np.linalg.norm(np.maximum(abs(offset) - sides, 0))
        return nearest > first.outer / 2 or np.linalg.norm(abs(offset) + sides) < first.inner / 2
    return (abs(offset) > sides + np.array([first.length, first.width]) / 2).any()
