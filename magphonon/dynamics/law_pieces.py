"""The piecewise increment law, from contact to several spacings, a range too wide for a single polynomial.

With the measure of length w, which is `(r/r0)^2 = 1 + e` where the full length counts and `r/r0 = 1 + e/2` where its
projection does, the quotient `Q(w) = H(e)/e` is cut into polynomials of degree 4.  The first cut is the one that a floating
number makes itself: each octave of w into 2^BITS equal pieces, found by a shift of the bits of w.  Of a smooth law they are
all, and vector units look up as many pieces at a time as they hold numbers; a low degree means few numbers to look up.  A piece
that misses the tolerance is halved until it does not, as the edge of a contact asks for; such a law is searched bond by bond.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import ArrayLike, NDArray

    from .bond_increments import Increments

BITS = 8
"""Binary logarithm of the number of pieces per octave; all of a law together take 100 kB."""
SHIFT = 52 - BITS
"""Bits of w that do not number its piece."""
DEGREE = 4
TOLERANCE = 5e-13
"""Largest error of a piece, as a fraction of |Q| there and at rest; the quotient itself has a smaller round-off."""
NARROWEST = 1e-9
"""Relative width of the smallest piece; a narrower feature, such as a jump of the force, is not resolved."""
MOST = 20_000
"""Largest number of pieces for one kind of bond; a law that needs more is noise."""
SMALL = 1 / 16
"""Increments below which Q is the mean slope; above it the difference of forces keeps its digits.  Less by the factor
`3 f/(r0 dH/de)` for bonds that are stiff for their force, as contacts: there the difference is better, and the mean might
cross the edge of the contact."""
_NODES = chebyshev.chebpts1(DEGREE + 5)
_FIT = np.linalg.pinv(np.vander(_NODES, DEGREE + 1, increasing=True))
_CHECKS = np.linspace(-1, 1, 13)


@dataclass(frozen=True)
class Pieces:
    """Polynomials of one kind of bond.

    Attributes
    ----------
    per_increment : float
        (w - 1)/e.
    low, high : float
        Between which w may lie, from the start of a piece of an octave to the end of one.
    first : int
        Bits of the octave piece that starts at `low`.
    child : ndarray of int, shape (pieces,)
        The lower half of a piece that was halved, the upper one follows it; -1 for others.  Those of the octaves come first.
    centre : ndarray, shape (pieces,)
        Where it is halved, or the middle.
    coefficients : ndarray, shape (pieces, DEGREE + 1)
        Coefficients of Q in powers of w - centre, in N/mm.
    """

    per_increment: float
    low: float
    high: float
    first: int
    child: np.ndarray
    centre: np.ndarray
    coefficients: np.ndarray


def octave_piece(w: ArrayLike) -> NDArray[np.int_]:
    """The bits of w that number its piece of an octave."""
    return np.asarray(w, float).view(np.int64) >> SHIFT


def _next_piece(w: ArrayLike) -> Any:
    """The first piece that does not begin below w."""
    return -(-np.asarray(w, float).view(np.int64) >> SHIFT)


def _start_of(piece: ArrayLike) -> Any:
    return (np.asarray(piece, np.int64) << SHIFT).view(float)


def pieces(increments: Increments, kind: int, shortest: float, longest: float) -> Pieces | None:
    """The law of one kind of bond from the length `shortest` to `longest`, in rest lengths.

    Parameters
    ----------
    increments : Increments
    kind : int

    Returns
    -------
    Pieces or None
        None for a law that needs too many, or that ends in the piece next to rest.  Where the law ends before, so do the pieces
        that lie in it as a whole.
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
        powers = _FIT @ quotient(c + h * _NODES[:, None])
        checks = quotient(c + h * _CHECKS[:, None])
        with np.errstate(invalid='ignore'):  # of a law that is zero there, as far as numbers go
            error = abs(np.vander(_CHECKS, DEGREE + 1, increasing=True) @ powers - checks)
            allowed = TOLERANCE * (abs(checks) + scale) + round_off / abs(c - 1)
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
    """The w nearest to `wanted`, on its side of rest, at which the law is still defined."""
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
