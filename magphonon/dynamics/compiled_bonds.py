"""Forces of bonds, compiled: for each layout and each kind of law a function of its own, which a step calls by its address.

A function takes all bonds that start in a run of slots.  Its first argument is a table of the addresses of its arrays; GIVEN
says what stands where.  In them bonds are numbered as a law needs it: by their kinds where bonds of a kind share a law, or else
each by itself.  What the compiler must know to fill the vector units: arrays do not overlap, the number of coefficients of a
polynomial is a constant, and a maximum is one of integers.
"""

from functools import cache

from numba import types

from .intrinsics import bits_of, floats, higher, indices, ints, magnitude, order, vectorise
from .law_pieces import BITS, DEGREE
from .machine_code import FLOATS, INTS, caller, compiled, part

PULL = types.float64(INTS, FLOATS, FLOATS, FLOATS, FLOATS, *[types.int64] * 6)
"""Signature: given, ux, uy, bx, by, first and last + 1 slot, first and last + 1 segment, place of slot 0, stride."""
pull_at = caller(PULL)
NUMBERS, SIZES, R, G, UNIT, OFFSETS, STRENGTH, SEGMENTS, NEAR, FAR, FACTORS, WHICH, LAW = range(13)
"""Places in the table of addresses.

NUMBERS    q and t
SIZES      number of slots of a grid, of bonds of a table; number of all bonds that have laws of their own
R          rest vectors, (2, kinds) or (2, bonds)
G          static force over length
UNIT       1/r0^2, or 1 where a law is given for r0^2 e and judged so
OFFSETS    of a grid, j - i of each group of bonds
STRENGTH   of a grid, (groups, slots), 1 where there is a bond
SEGMENTS   of a table, first and last + 1 bond and kind of each segment
NEAR, FAR  of a table, lower and upper slot of each bond
FACTORS    of bonds that have laws of their own, those of the common one
WHICH      the pieces of each bond that has laws of its own
LAW        coefficients of the kinds, (kinds, count), or of each bond, (count, bonds); or the five arrays of `Pieces`
"""


# --- laws: H/e of bond or kind k at e, and what is judged by the reach of the law ---------------------------------------


@cache
def _polynomial(count):
    @part
    def law(given, k, e):
        c, at = floats(given, LAW), k * count
        p = c[at + count - 1]
        for n in range(count - 2, -1, -1):
            p = p * e + c[at + n]
        return p, e

    return law


@cache
def _common_polynomial(count):
    polynomial = _polynomial(count)

    @part
    def law(given, k, e):
        p, reached = polynomial(given, 0, e)
        return floats(given, FACTORS)[k] * p, reached

    return law


@cache
def _own_polynomial(count):
    @part
    def law(given, k, e):
        c, bonds = floats(given, LAW), ints(given, SIZES)[1]
        p = c[(count - 1) * bonds + k]
        for n in range(count - 2, -1, -1):
            p = p * e + c[n * bonds + k]
        return p, e

    return law


@part
def _piece(given, k, e):
    """From the piece in which the length lies, and how far that goes: beyond 1 out of all pieces."""
    number, place = floats(given, LAW), ints(given, LAW + 1)
    child, centre, c = ints(given, LAW + 2), floats(given, LAW + 3), floats(given, LAW + 4)
    low, high, root = number[3 * k + 1], number[3 * k + 2], place[2 * k + 1]
    w = 1.0 + number[3 * k] * e
    reached = w / high
    if not w > low:
        w, reached = low, 2.0
    if w > high:
        w = high
    n = root + (bits_of(w) >> (52 - BITS)) - place[2 * k]
    while child[n] >= 0:
        n = root + child[n] + (1 if w >= centre[n] else 0)
    x = w - centre[n]
    p = c[(DEGREE + 1) * n + DEGREE]
    for m in range(DEGREE - 1, -1, -1):
        p = p * x + c[(DEGREE + 1) * n + m]
    return p, reached


@part
def _own_piece(given, k, e):
    p, reached = _piece(given, ints(given, WHICH)[k], e)
    return floats(given, FACTORS)[k] * p, reached


LAWS = {'polynomial': _polynomial, 'common polynomial': _common_polynomial, 'own polynomial': _own_polynomial,
        'pieces': lambda count: _piece, 'own pieces': lambda count: _own_piece}


# --- bonds ------------------------------------------------------------------------------------------------------------


@part
def _increment(dx, dy, Rx, Ry, q):
    """r0^2 e."""
    return (2 * Rx + q * dx) * dx + (2 * Ry + q * dy) * dy


@part
def _force(dx, dy, Rx, Ry, t, g, e, quotient):
    """On the far end of a bond, `H(e) R + (g + t H(e)) du`, counted from rest."""
    H = e * quotient
    G = g + t * H
    return H * Rx + G * dx, H * Ry + G * dy


@part
def larger(a, b):
    """The larger of two numbers, or the one that is none."""
    return b if not b <= a and a == a else a


@cache
def grid_pull(law, count, own, partial):
    """Forces of the bonds of a grid, which stand in b one group after another, `stride` apart; the largest increment |e|.

    Parameters
    ----------
    law : str
        Of LAWS.
    count : int
        Number of coefficients of a polynomial.
    own : bool
        Whether bonds have laws of their own; then one that is not there has no g, factor or coefficients.
    partial : bool
        Whether STRENGTH says which bonds there are.
    """
    quotient = LAWS[law](count)

    @compiled(PULL, f'grid {law} {count}' + ' own' * own + ' partial' * partial)
    def pull(given, ux, uy, bx, by, s, e, first, last, pad, stride):
        vectorise()
        q, t, length = floats(given, NUMBERS)[0], floats(given, NUMBERS)[1], ints(given, SIZES)[0]
        kinds = last * length if own else last
        Rx, g, unit, strength, offsets = (floats(given, R), floats(given, G), floats(given, UNIT), floats(given, STRENGTH),
                                          ints(given, OFFSETS))
        strain = 0.0
        for group in range(first, last):
            offset, to, row, largest = offsets[group], pad + group * stride, group * length, 0
            for i in range(s, e):
                dx, dy = ux[i + offset] - ux[i], uy[i + offset] - uy[i]
                if partial:
                    dx *= strength[row + i]  # a bond that is not strained pulls at nothing
                    dy *= strength[row + i]
                k = row + i if own else group
                x = _increment(dx, dy, Rx[k], Rx[kinds + k], q)
                if own:
                    x *= unit[k]
                p, reached = quotient(given, k, x)
                bx[i + to], by[i + to] = _force(dx, dy, Rx[k], Rx[kinds + k], t, g[k], x, p)
                largest = higher(largest, order(reached))
            strain = larger(strain, magnitude(largest) * (1.0 if own else unit[group]))
        return strain

    return pull


@cache
def table_pull(law, count, own):
    """Forces of the bonds of a table on their far ends, and as many places later on their near ends; the largest |e|."""
    quotient = LAWS[law](count)

    @compiled(PULL, f'table {law} {count}' + ' own' * own)
    def pull(given, ux, uy, bx, by, s, e, first, last, pad, stride):
        vectorise()
        q, t, bonds = floats(given, NUMBERS)[0], floats(given, NUMBERS)[1], ints(given, SIZES)[0]
        Rx, g, unit = floats(given, R), floats(given, G), floats(given, UNIT)
        segments, near, far = ints(given, SEGMENTS), indices(given, NEAR), indices(given, FAR)
        strain = 0.0
        for n in range(first, last):
            kind, largest = segments[3 * n + 2], 0
            for b in range(segments[3 * n], segments[3 * n + 1]):
                i, j, k = near[b], far[b], b if own else kind
                dx, dy = ux[j] - ux[i], uy[j] - uy[i]
                x = _increment(dx, dy, Rx[b], Rx[bonds + b], q)
                if own:
                    x *= unit[k]
                p, reached = quotient(given, k, x)
                fx, fy = _force(dx, dy, Rx[b], Rx[bonds + b], t, g[k], x, p)
                bx[b], by[b], bx[b + bonds], by[b + bonds] = fx, fy, -fx, -fy
                largest = higher(largest, order(reached))
            strain = larger(strain, magnitude(largest) * (1.0 if own else unit[kind]))
        return strain

    return pull
