"""Forces of bonds, compiled: for each layout and each kind of law a function of its own, which a step calls by its address.

A function takes all bonds that start in a run of slots.  Its first argument is a table of the addresses of its arrays, in the
order that is given below.  In these arrays bonds are numbered as a law needs it: by their kinds where bonds of a kind share a
law, or else each by itself.  What the compiler must know to fill the vector units: arrays do not overlap, the number of
coefficients of a polynomial is a constant, and a maximum is one of integers.
"""

from functools import cache

from numba import types

from .intrinsics import bits_of, floats, higher, horner, indices, ints, magnitude, order, row, vectorise
from .law_pieces import DEGREE, SHIFT
from .machine_code import FLOATS, INTS, caller, compiled, part

PULL = types.float64(INTS, FLOATS, FLOATS, FLOATS, FLOATS, *[types.int64] * 6)
"""Signature: given, ux, uy, bx, by, first and last + 1 slot, first and last + 1 segment, place of slot 0, stride."""
pull_at = caller(PULL)
NUMBERS, SIZES, R, G, UNIT, OFFSETS, STRENGTH, SEGMENTS, NEAR, FAR, FACTORS, WHICH, LAW = range(13)
"""Places in the table of addresses.

NUMBERS    q, t, and the reach of the law
SIZES      number of slots of a grid, of bonds of a table; number of laws: of kinds, or of all bonds that have their own
R          rest vectors, (2, kinds) or (2, bonds)
G          static force over length
UNIT       1/r0^2, or 1 where the argument of a law, and what is compared with its reach, is r0^2 e
OFFSETS    of a grid, j - i of each group of bonds
STRENGTH   of a grid, (groups, slots), 1 where there is a bond
SEGMENTS   of a table, first and last + 1 bond and kind of each segment
NEAR, FAR  of a table, lower and upper slot of each bond
FACTORS    of bonds that have laws of their own, those of the common one
WHICH      the pieces of each bond that has laws of its own
LAW        coefficients of the kinds, (kinds, count), or of each bond, (count, bonds); or the five arrays of `Pieces`
"""
OUT = 2.0
"""What the law in pieces returns as its reach for a bond that is beyond all pieces; for any other bond it returns 1."""


# --- laws, two functions each: the first one reads the coefficients of a kind before the loop over its bonds; the second one
# returns H/e of bond or kind k at e, and a number that is compared with the reach of the law: e itself for a polynomial ----


@part
def _nothing(given, kind):
    return 0


@cache
def _polynomial(count):
    taken = row(count)

    @part
    def coefficients(given, kind):
        return taken(floats(given, LAW), kind * count, 1)

    @part
    def law(given, c, k, e):
        return horner(c, e), e

    return coefficients, law


@cache
def _common_polynomial(count):
    taken = row(count)

    @part
    def coefficients(given, kind):
        return taken(floats(given, LAW), 0, 1)

    @part
    def law(given, c, k, e):
        return floats(given, FACTORS)[k] * horner(c, e), e

    return coefficients, law


@cache
def _own_polynomial(count):
    taken = row(count)

    @part
    def law(given, c, k, e):
        return horner(taken(floats(given, LAW), k, ints(given, SIZES)[1]), e), e

    return _nothing, law


@cache
def _pieces(own, halved):
    """From the piece in which the length lies, which is found without a branch where no piece is halved."""
    taken = row(DEGREE + 1)

    @part
    def law(given, c, k, e):
        kind = ints(given, WHICH)[k] if own else k
        number, place, coefficients = floats(given, LAW), ints(given, LAW + 1), floats(given, LAW + 2)
        low, high = number[3 * kind + 1], number[3 * kind + 2]
        w = 1.0 + number[3 * kind] * e
        v = w if w > low else low
        v = v if v < high else high
        n = place[2 * kind + 1] + (bits_of(v) >> SHIFT) - place[2 * kind]
        middle = magnitude(bits_of(v) >> SHIFT << SHIFT | 1 << (SHIFT - 1))
        if halved:
            child, centre = ints(given, LAW + 3), floats(given, LAW + 4)
            while child[n] >= 0:
                n = place[2 * kind + 1] + child[n] + (1 if v >= centre[n] else 0)
            middle = centre[n]
        p = horner(taken(coefficients, (DEGREE + 1) * n, 1), v - middle)
        return floats(given, FACTORS)[k] * p if own else p, 1.0 if v == w else OUT

    return _nothing, law


LAWS = {'polynomial': _polynomial, 'common polynomial': _common_polynomial, 'own polynomial': _own_polynomial,
        'pieces': lambda count: _pieces(False, False), 'halved pieces': lambda count: _pieces(False, True),
        'own pieces': lambda count: _pieces(True, False), 'own halved pieces': lambda count: _pieces(True, True)}


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
    of_kind, quotient = LAWS[law](count)

    @compiled(PULL, f'grid {law} {count}' + ' own' * own + ' partial' * partial)
    def pull(given, ux, uy, bx, by, s, e, first, last, pad, stride):
        vectorise()
        q, t, reach = floats(given, NUMBERS)[0], floats(given, NUMBERS)[1], floats(given, NUMBERS)[2]
        length, kinds = ints(given, SIZES)[0], ints(given, SIZES)[1]
        Rx, g, unit, strength, offsets = (floats(given, R), floats(given, G), floats(given, UNIT), floats(given, STRENGTH),
                                          ints(given, OFFSETS))
        strain = 0.0
        for group in range(first, last):
            offset, to, first_of_group, largest = offsets[group], pad + group * stride, group * length, 0
            c = of_kind(given, group)
            for i in range(s, e):
                dx, dy = ux[i + offset] - ux[i], uy[i + offset] - uy[i]
                if partial:
                    dx *= strength[first_of_group + i]  # a bond that is not strained pulls at nothing
                    dy *= strength[first_of_group + i]
                k = first_of_group + i if own else group
                x = _increment(dx, dy, Rx[k], Rx[kinds + k], q)
                if own:
                    x *= unit[k]
                p, reached = quotient(given, c, k, x)
                bx[i + to], by[i + to] = _force(dx, dy, Rx[k], Rx[kinds + k], t, g[k], x, p)
                largest = higher(largest, order(reached))
            strain = larger(strain, magnitude(largest) * (1.0 if own else unit[group]))
            if not strain <= reach:  # another law is needed
                break
        return strain

    return pull


@cache
def table_pull(law, count, own):
    """Forces of the bonds of a table on their far ends, and as many places later on their near ends; the largest |e|."""
    of_kind, quotient = LAWS[law](count)

    @compiled(PULL, f'table {law} {count}' + ' own' * own)
    def pull(given, ux, uy, bx, by, s, e, first, last, pad, stride):
        vectorise()
        q, t, reach = floats(given, NUMBERS)[0], floats(given, NUMBERS)[1], floats(given, NUMBERS)[2]
        bonds, Rx, g, unit = ints(given, SIZES)[0], floats(given, R), floats(given, G), floats(given, UNIT)
        segments, near, far = ints(given, SEGMENTS), indices(given, NEAR), indices(given, FAR)
        strain = 0.0
        for n in range(first, last):
            kind, largest = segments[3 * n + 2], 0
            c = of_kind(given, kind)
            for b in range(segments[3 * n], segments[3 * n + 1]):
                i, j, k = near[b], far[b], b if own else kind
                dx, dy = ux[j] - ux[i], uy[j] - uy[i]
                x = _increment(dx, dy, Rx[b], Rx[bonds + b], q)
                if own:
                    x *= unit[k]
                p, reached = quotient(given, c, k, x)
                fx, fy = _force(dx, dy, Rx[b], Rx[bonds + b], t, g[k], x, p)
                bx[b], by[b], bx[b + bonds], by[b + bonds] = fx, fy, -fx, -fy
                largest = higher(largest, order(reached))
            strain = larger(strain, magnitude(largest) * (1.0 if own else unit[kind]))
            if not strain <= reach:
                break
        return strain

    return pull


@cache
def law_in_reach():
    """Forces of the bonds of a run by the first law that reaches as far as these do; the largest increment as that law judges it.

    Its table of addresses holds the number of laws, and then the function and the table of each.  Few bonds are far, near a
    source, and most runs take the polynomial of small motion.  As the choice depends on the bonds of a run alone, it is the same
    for any number of threads.
    """
    @compiled(PULL, 'law in reach')
    def pull(given, ux, uy, bx, by, s, e, first, last, pad, stride):
        strain = 0.0
        for n in range(1, 1 + 2 * ints(given, 0)[0], 2):
            law = ints(given, n + 1)
            strain = pull_at(given[n], (law, ux, uy, bx, by, s, e, first, last, pad, stride))
            if strain <= floats(law, NUMBERS)[2]:
                break
        return strain

    return pull
