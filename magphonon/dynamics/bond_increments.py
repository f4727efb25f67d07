"""Bond forces as differences from rest, so that a displacement of 1e-12 of the spacing keeps its digits.

A bond with the rest vector R and length r0, whose ends have moved apart by du, has the increment

    e = (2 R.du + q |du|^2) / r0^2

and pulls its far end j (and pushes its near end i) with the force, counted from rest,

    H(e) R + (g + t H(e)) du

    complete      q = 1, t = 1    H = f(r)/r - f(r0)/r0       r = r0 sqrt(1 + e)      g = f(r0)/r0
    conventional  q = 0, t = 0    H = (f(r) - f(r0))/r0       r = r0 (1 + e/2)        g = 0

H has no constant term, so no large numbers are ever subtracted.  It is fitted through its slope, in which nothing cancels.

For small motion one polynomial is enough.  For large motion, from contact to several spacings, the law is cut into pieces along
the measure of length w, which is `(r/r0)^2 = 1 + e` in the complete model and `r/r0 = 1 + e/2` in the conventional one.  In each
piece the quotient `H(e)/e` is a polynomial of degree 4.  Each octave of w is cut into 2^BITS equal pieces, so that the leading
bits of the floating-point number w are the number of its piece: no search is needed, and vector units look up several pieces at
once.  A piece that misses the tolerance, as at the edge of a contact, is halved until it meets it; the piece of a bond is then
found by a search.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from ..interactions.bond_laws import BondLaws, laid, taken
from ..interactions.pair_laws import PairLaw
from ..stiffness.bond import Model

TOLERANCE = 1e-13  # largest error of a fitted slope dH/de, as a fraction of the slope at rest
RANGES = (1 / 1024, 1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2)
"""Largest increments |e| of the fitted polynomials; beyond the last one the law itself is evaluated."""
NEAR = 1e-3  # largest increment for which H is computed as the integral of its slope; above it the difference keeps twelve digits
ROUND_OFF = 64 * np.finfo(float).eps
"""Round-off of a difference of forces, as a fraction of stiffness and static force.  If an integral is off by more, it missed
a jump of the slope, such as at a knot of a table."""
MOST_COEFFICIENTS = 40
ALIKE = 1e-14
"""Relative difference up to which the slopes of two laws differ by a factor only; a few times the round-off of a power."""
TOGETHER = 2048  # number of kinds that are fitted at a time, so that their samples stay within tens of megabytes
POWERS = np.array([np.pad(chebyshev.cheb2poly(row), (0, MOST_COEFFICIENTS - n - 1))
                   for n, row in enumerate(np.eye(MOST_COEFFICIENTS))]).T
"""Chebyshev polynomials in powers of x, one in each column."""
NODES, WEIGHTS = ((x + shift) / 2 for x, shift in zip(np.polynomial.legendre.leggauss(8), (1, 0), strict=True))
BITS = 8  # binary logarithm of the number of pieces per octave; all of a law together take 100 kB
SHIFT = 52 - BITS  # bits of w that do not number its piece
DEGREE = 4
PIECE_TOLERANCE = 5e-13
"""Largest error of a polynomial piece, as a fraction of |Q| on it and at rest; the round-off of the quotient is smaller."""
NARROWEST = 1e-9  # relative width of the smallest piece; a narrower feature, such as a jump of the force, is not resolved
MOST = 20_000  # largest number of pieces for one kind of bond; a law that needs more is noise
SMALL = 1 / 16
"""Increments below which Q is the mean slope; above, the difference of forces keeps its digits.  The limit is lower by
the factor `3 f/(r0 dH/de)` for bonds that are stiff relative to their force, such as contacts: there the difference is better,
and the mean might cross the edge of the contact."""
_PIECE_NODES = chebyshev.chebpts1(DEGREE + 5)
_PIECE_FIT = np.linalg.pinv(np.vander(_PIECE_NODES, DEGREE + 1, increasing=True))
_PIECE_CHECKS = np.linspace(-1, 1, 13)


@dataclass(frozen=True)
class Increments:
    """The increment law of bonds whose rest lengths and laws fall into a few kinds.

    Its methods take increments whose last axis is that of the kinds.
    """

    potential: PairLaw  # the law of all bonds, or the laws of the kinds of bonds
    model: Model
    r0: np.ndarray  # shape (kinds,): rest length of each kind of bond, mm

    @property
    def q(self) -> float:
        return 0.0 if self.model == 'conventional' else 1.0

    @property
    def t(self) -> float:
        return 1.0 if self.model == 'complete' else 0.0

    @property
    def g(self) -> NDArray[np.float64]:
        """Static force over length f(r0)/r0 where it turns with the bond, N/mm, shape (kinds,)."""
        return self.t * self.static / self.r0

    @property
    def static(self) -> NDArray[np.float64]:
        """Static force f(r0) of each kind in N."""
        return -self._along(self.potential.dphi, self.r0)

    def at(self, kinds: Any) -> Increments:
        """Increments of the bonds with these kinds; a single kind applies to increments of any shape."""
        return Increments(taken(self.potential, kinds), self.model, self.r0[kinds])

    def _along(self, law, r):
        """Values of a law at distances whose last axis is that of the kinds; laws of bonds expect this axis first."""
        return law(r) if np.ndim(r) < 2 else np.transpose(law(np.transpose(r)))

    @property
    def shapes(self) -> tuple[Increments, NDArray[np.intp], NDArray[np.float64]]:
        """The kinds that differ by more than strength, with strength 1; the index of each kind among them; and its strength."""
        if not isinstance(self.potential, BondLaws):
            return self, np.arange(len(self.r0)), np.ones(len(self.r0))
        laws, which, strength = self.potential.laws, self.potential.which, self.potential.strength
        _, first, shape = np.unique(np.column_stack([which, self.r0]), axis=0, return_index=True, return_inverse=True)
        alone = Increments(laid(laws, which[first], np.ones(len(first))), self.model, self.r0[first])
        return alone, shape.ravel(), strength

    def length(self, e: Any, r0: Any) -> Any:
        """Bond length in mm at which the law is evaluated."""
        return r0 * (1 + e / 2) if self.model == 'conventional' else r0 * np.sqrt(1 + e)

    def increment(self, length: Any) -> Any:
        """The increment of a bond that is `length` times as long as at rest."""
        return 2 * (length - 1) if self.model == 'conventional' else length**2 - 1

    def slope(self, e: Any, r0: Any) -> Any:
        """Slope dH/de in N/mm."""
        r = self.length(e, r0)
        if self.model == 'complete':
            return -(r0**2 / (2 * r**2)) * (self._along(self.potential.d2phi, r) - self._along(self.potential.dphi, r) / r)
        return -self._along(self.potential.d2phi, r) / 2

    def exact(self, e: NDArray[np.float64], r0: ArrayLike, near: float = NEAR) -> NDArray[np.float64]:
        """H(e) in N/mm from the law itself; below `near` it is the integral of the slope, unless the slope jumps."""
        r = self.length(e, r0)
        divisor = r if self.model == 'complete' else r0
        there, rest = (-self._along(self.potential.dphi, x) / y for x, y in ((r, divisor), (r0, r0)))
        H: Any = there - rest
        small = abs(e) < near
        if small.any():
            few = self.at(np.nonzero(small)[-1]) if isinstance(self.potential, BondLaws) else self
            e, r0, rest = e[small], *(np.broadcast_to(x, e.shape)[small] for x in (r0, rest))
            slopes = np.array([few.slope(x * e, r0) for x in NODES])
            mean = WEIGHTS @ slopes
            rounding = ROUND_OFF * (abs(slopes).max(axis=0) + abs(rest))
            H[small] = np.where(abs(e * mean - H[small]) <= rounding, e * mean, H[small])
        return H

    def alike(self, e: NDArray[np.float64]) -> bool:
        """Whether dH/de of all kinds differs only by a factor at the increments `e`, as it does for a power of the distance."""
        try:
            with np.errstate(divide='ignore', invalid='ignore'):  # of a law that is zero there, as far as numbers go
                at_rest = self.slope(0.0, self.r0)
                quotients = (self.slope(x, self.r0) / at_rest for x in e)
                return all((abs(quotient - quotient[0]) <= ALIKE * abs(quotient[0])).all() for quotient in quotients)
        except ValueError:  # the potential does not reach that far
            return False

    def polynomial(self, reach: float, tolerance: float = TOLERANCE) -> tuple[NDArray[np.float64], float] | None:
        """Coefficients of `H = e (c0 + c1 e + ...)` for |e| <= reach, shape (kinds, coefficients), and their error.

        Their number is the smallest even one for which the errors of slopes are below `tolerance` times the slope at rest.  If
        the kinds are `alike`, the coefficients of each are exactly those of the first kind times a factor.

        Returns
        -------
        (ndarray, float) or None
            None if the law is not smooth enough there: a table with a knot within reach, or its end.
        """
        kinds = len(self.r0)
        if kinds > 1 and self.alike(reach * chebyshev.chebpts2(13)):
            fit = self.at(np.zeros(1, int))._fitted(reach, tolerance)
            return fit and (self.factors[:, None] * fit[0], fit[1])
        alone, shape, strength = self.shapes
        fits = []
        for part in np.array_split(np.arange(len(alone.r0)), -(-len(alone.r0) // TOGETHER) or 1):
            fits.append(alone.at(part)._fitted(reach, tolerance))
            if fits[-1] is None:
                return None
        count = max(c.shape[1] for c, _ in fits)
        c = np.concatenate([np.hstack([c, np.zeros((len(c), count - c.shape[1]))]) for c, _ in fits])
        return strength[:, None] * c[shape], max(error for _, error in fits)

    @property
    def factors(self) -> NDArray[np.float64]:
        """Stiffness of each kind divided by that of the first."""
        stiffness = self.slope(0.0, self.r0)
        return stiffness / stiffness[0]

    def _fitted(self, reach, tolerance):
        """Coefficients and error of the polynomials, fitted for each kind on its own."""
        x = np.cos(np.linspace(0, np.pi, 301))[:, None]
        nodes = chebyshev.chebpts1(MOST_COEFFICIENTS)[:, None]
        try:
            exact, sampled, at_rest = (self.slope(reach * at, self.r0) for at in (x, nodes, np.zeros((1, 1))))
        except ValueError:  # the potential does not reach that far
            return None
        series = chebyshev.chebvander(nodes[:, 0], MOST_COEFFICIENTS - 1).T @ sampled * (2 / MOST_COEFFICIENTS)
        series[0] /= 2
        for count in range(4, MOST_COEFFICIENTS + 1, 2):
            powers = POWERS[:count, :count] @ series[:count]
            if tolerance > TOLERANCE:  # the slope at rest is kept: its error would be a drift of every phase
                columns = np.vander(nodes[:, 0], count, increasing=True)[:, 1:]
                powers = np.vstack([at_rest, np.linalg.lstsq(columns, sampled - at_rest)[0]])
            with np.errstate(divide='ignore', invalid='ignore'):  # of a law that is zero there, as far as numbers go
                error = abs((np.vander(x[:, 0], count, increasing=True) @ powers - exact) / at_rest).max()
            if error < tolerance:
                k = np.arange(count)[:, None]
                return (powers / reach**k / (k + 1)).T, float(error)
        return None


# --- the law in pieces --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pieces:
    """Polynomials of one kind of bond."""

    per_increment: float  # (w - 1)/e
    low: float  # low to high: between which w may lie, from the start of a piece of an octave to the end of one
    high: float
    first: int  # bits of the octave piece that starts at `low`
    # shape (pieces,): the lower half of a piece that was halved, the upper one follows it; -1 for others.  Those of the octaves
    # come first
    child: np.ndarray
    centre: np.ndarray  # shape (pieces,): where it is halved, or the middle
    coefficients: np.ndarray  # shape (pieces, DEGREE + 1): coefficients of Q in powers of w - centre, in N/mm


def octave_piece(w: ArrayLike) -> NDArray[np.int_]:
    """Number of the piece of an octave in which w lies: the leading bits of w."""
    return np.asarray(w, float).view(np.int64) >> SHIFT


def _next_piece(w: ArrayLike) -> Any:
    """Number of the first piece that begins at w or above."""
    return -(-np.asarray(w, float).view(np.int64) >> SHIFT)


def _start_of(piece: ArrayLike) -> Any:
    return (np.asarray(piece, np.int64) << SHIFT).view(float)


def pieces(increments: Increments, kind: int, shortest: float, longest: float) -> Pieces | None:
    """The law of one kind of bond from the length `shortest` to `longest`, in rest lengths.

    None if the law needs too many pieces, or ends within the piece next to rest.  A law that ends before these lengths gets only
    the pieces in which it is defined everywhere.
    """
    own, r0 = increments.at(kind), increments.r0[kind]
    per_increment, power = (0.5, 1) if increments.model == 'conventional' else (1.0, 2)

    with np.errstate(divide='ignore', invalid='ignore'):  # of a law that is zero there, as far as numbers go
        near = SMALL * min(1.0, 3 * abs(own.static / r0 / own.slope(0.0, r0)))

    def quotient(w):
        e = (w - 1) / per_increment
        e = np.where(e == 0, np.finfo(float).tiny, e)
        return own.exact(e, r0, near) / e

    scale = abs(quotient(np.ones(1)))[0]
    round_off = 2 * np.finfo(float).eps * per_increment * (scale + abs(own.static / r0))  # of forces, for the difference in Q
    first = _next_piece(_end_of(quotient, _start_of(octave_piece(shortest**power))))
    last: Any = octave_piece(_end_of(quotient, _start_of(_next_piece(longest**power))))
    if not first <= octave_piece(1.0) < last:
        return None
    edges = _start_of(np.arange(first, last + 1))
    a, b = edges[:-1], edges[1:]
    child, centre, rows = [], [], []
    count = 0
    while len(a):
        c, h = (a + b) / 2, np.maximum((b - a) / 2, NARROWEST / 4)
        powers = _PIECE_FIT @ quotient(c + h * _PIECE_NODES[:, None])
        checks = quotient(c + h * _PIECE_CHECKS[:, None])
        with np.errstate(invalid='ignore'):  # of a law that is zero there, as far as numbers go
            error = abs(np.vander(_PIECE_CHECKS, DEGREE + 1, increasing=True) @ powers - checks)
            allowed = PIECE_TOLERANCE * (abs(checks) + scale) + round_off / abs(c - 1)
        rough = (error > allowed).any(axis=0) & (2 * h > NARROWEST)
        count += len(a)
        if count > MOST or not np.isfinite(powers).all():
            return None
        child.append(np.where(rough, count + 2 * (np.cumsum(rough) - 1), -1))
        centre.append(c)
        rows.append((powers / h ** np.arange(DEGREE + 1)[:, None]).T)
        a, b = (np.stack(pair, axis=1)[rough].ravel() for pair in ((a, c), (c, b)))
    return Pieces(per_increment, float(edges[0]), float(edges[-1]), int(first), *map(np.concatenate, (child, centre, rows)))


def _end_of(quotient, wanted):
    """The w nearest to `wanted` at which the law is still defined, on the same side of rest."""
    def defined(w):
        try:
            return np.isfinite(quotient(np.array([w]))).all()
        except ValueError:
            return False

    if defined(wanted):
        return wanted
    inside, outside = 1.0, wanted
    while abs(inside - outside) > 1e-12:
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if defined(middle) else (inside, middle)
    return inside
