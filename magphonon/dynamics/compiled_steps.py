"""The steps of `magphonon.dynamics.kernels_numpy`, compiled by numba.

A block of steps is taken level by level: the start of the block is level 0, each step a level, and the last one computes the
accelerations.  The slots are treated in runs that fit the first-level cache.  Each bond is evaluated once, with the run that
holds its lower slot; then the slots of the run gather the forces of their bonds and move on, in place: no later bond needs
their old displacements, because bonds lead upwards.

For the same reason a level may follow the one before it at a distance: it may take a run as soon as the one before is past all
slots to which the bonds of this run reach.  So some levels, a chunk, go over the slots together, one behind the other, while
these are in the cache, and chunks of levels go to threads, each of which follows the one before it.  Whatever the chunks and
threads, the same operations act on a slot in the same order: the bits are the same.

What the compiler must know to fill the vector units: indices are unsigned (a negative one would wrap), arrays do not
overlap, the coefficients of the polynomial are a tuple, and a maximum is one of integers.

All of it stands in one file: numba keeps what it has compiled until the file of the function changes, and would not notice a
change of another file from which this one takes functions.
"""

import os
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.cpython.unsafe.tuple import tuple_setitem
from numba.extending import intrinsic, overload

from .law_pieces import BITS, DEGREE

EMPTY = 1
"""Flag of a run of empty slots."""
SPINS = 1000
"""Looks at another thread's progress after which a waiting thread leaves its core to others."""
FAR = 16
"""Integers from one counter to the next: in two cache lines, which processors fetch together, there is one counter."""


@intrinsic
def vectorise(typing_context):
    """Promise that the arguments of the calling function do not overlap (C's restrict), and ask for wide vectors."""

    def code(context, builder, signature, arguments):
        function = builder.function
        set.add(function.attributes, '"prefer-vector-width"="512"')  # a name of LLVM's; llvmlite's own `add` knows only some
        function.attributes.add('noinline')  # neither would hold within another function
        for argument in function.args:
            if isinstance(argument.type, ir.PointerType) and 'noalias' not in argument.attributes:
                argument.add_attribute('noalias')
        return context.get_dummy_value()

    return types.void(), code


@intrinsic
def _seen(typing_context, counters, n):
    """The counter n as another thread has left it; what that thread wrote before is there as well."""

    def code(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        return builder.load_atomic(builder.gep(array.data, [arguments[1]]), 'acquire', 8)

    return types.int64(counters, types.intp), code


@intrinsic
def _show(typing_context, counters, n, value):
    """Set the counter n for other threads, after all that was written before."""

    def code(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        builder.store_atomic(arguments[2], builder.gep(array.data, [arguments[1]]), 'release', 8)
        return context.get_dummy_value()

    return types.void(counters, types.intp, types.int64), code


@intrinsic
def _leave_core(typing_context):
    """Let another thread run on this core."""

    def code(context, builder, signature, arguments):
        name = 'SwitchToThread' if os.name == 'nt' else 'sched_yield'
        builder.call(cgutils.get_or_insert_function(builder.module, ir.FunctionType(ir.IntType(32), []), name), [])
        return context.get_dummy_value()

    return types.void(), code


OPTIONS = {'error_model': 'numpy', 'fastmath': {'contract'}, 'nogil': True, '_nrt': False}
"""The last one: nothing is allocated here, and no references to arrays are counted, which would take as long as the steps."""


def jit(function):
    """Compile on the first call, and keep the result; a damaged file of an earlier one is written anew, not the end."""
    compiled = njit(cache=True, **OPTIONS)(function)
    cache, load = compiled._cache, compiled._cache.load_overload

    def load_or_forget(*arguments):
        try:
            return load(*arguments)
        except Exception:  # whatever a pickle of random bytes raises
            cache.flush()
            return None

    cache.load_overload = load_or_forget
    return compiled


# --- what the functions are given -------------------------------------------------------------------------------------


class Bonds(NamedTuple):
    """Bonds between slots, on a grid or in a table; what belongs to the other one is None.

    runs      first and last + 1 slot of each run; on a grid EMPTY or 0, in a table first and last + 1 of its segments
    needs     for each run the number of runs of which all slots must have moved in the level before
    pad, offsets, strength    of a grid: see `Layout`; bonds of slot i stand `pad` places later
    segments, i, j    of a table: first and last + 1 bond and kind of each segment, lower and upper slots
    ends, columns     of a table: places of the forces on each slot, as many as there are columns
    R         rest vectors of the groups, (groups, 2), or of the bonds, (groups, 2, length) and (2, bonds)
    """

    runs: Any
    needs: Any
    R: Any
    pad: Any = None
    offsets: Any = None
    strength: Any = None
    segments: Any = None
    i: Any = None
    j: Any = None
    ends: Any = None
    columns: Any = None


class Laws(NamedTuple):
    """The increment laws: of kinds of bonds, for r0^2 e, or of each bond, for e.

    g         (kinds,) or (groups, length), (1, bonds) if each bond has its own law
    r2        r0^2 of the kinds, 1/r0^2 of each bond
    factors   as g where bonds differ by these only, or None
    laws      coefficients of the kinds, (kinds, coefficients) as many as `pattern`, or their pieces; with factors, coefficients
              of the one kind, or pieces of several, of which `pattern` says for each bond which it has; if each bond has its own
              without factors, its coefficients, (groups, coefficients, length) or (1, coefficients, bonds)
    """

    q: Any
    t: Any
    g: Any
    r2: Any
    laws: Any
    pattern: Any
    factors: Any = None


class Moving(NamedTuple):
    """What moves the slots besides bonds; `driven` and `guided` are in order, and from_driven, from_guided the first of a run."""

    dt: Any
    k: Any
    static: Any
    decay: Any
    mobility: Any
    carry: Any
    push: Any
    forget: Any
    driven: Any
    row: Any
    from_driven: Any
    guided: Any
    barred: Any
    from_guided: Any


# --- the law ----------------------------------------------------------------------------------------------------------


NOT_BITS = 52 - BITS


@jit
def _order(x):
    """Bits of |x| as an integer: they have the order of |x|, nan above inf, and a maximum that vector units know."""
    return np.float64(x).view(np.int64) & np.int64(0x7FFFFFFFFFFFFFFF)


@jit
def _magnitude(bits):
    return np.int64(bits).view(np.float64)


@jit
def _larger(a, b):
    """The larger of two numbers, or the one that is none."""
    return b if not b <= a and a == a else a


@jit
def _polynomial(c, e):
    p = c[len(c) - 1]
    for n in range(len(c) - 2, -1, -1):
        p = p * e + c[n]
    return p


@jit
def _piece(pieces, e):
    """The quotient from the piece in which the length lies, and how far that goes: beyond 1 out of all pieces."""
    per_increment, low, high, first, root, child, centre, c = pieces
    w = 1.0 + per_increment * e
    reached = w / high
    if not w > low:
        w, reached = low, 2.0
    w = min(w, high)
    n = root + (np.float64(w).view(np.int64) >> NOT_BITS) - first
    while child[n] >= 0:
        n = root + child[n] + (w >= centre[n])
    x = w - centre[n]
    p = c[n, DEGREE]
    for k in range(DEGREE - 1, -1, -1):
        p = p * x + c[n, k]
    return p, reached


def _quotient(law, e):
    """H/(r0^2 e) at r0^2 e, and what is judged by the reach of the law."""


@overload(_quotient, jit_options=OPTIONS)
def _quotient_of(law, e):
    if isinstance(law, types.UniTuple):
        return lambda law, e: (_polynomial(law, e), e)
    return lambda law, e: _piece(law, e)


def _own_quotient(laws, pattern, factors, law, n, b, e):
    """H/e of the bond b of group n at e, and what is judged by the reach of the law; `law` is the one that factors multiply."""


@overload(_own_quotient, jit_options=OPTIONS)
def _own_quotient_of(laws, pattern, factors, law, n, b, e):
    def by_factor(laws, pattern, factors, law, n, b, e):
        quotient, reached = _quotient(law, e)
        return factors[n, b] * quotient, reached

    def by_pieces(laws, pattern, factors, law, n, b, e):
        quotient, reached = _quotient(_law(laws, pattern[n, b], None), e)
        return factors[n, b] * quotient, reached

    def by_coefficients(laws, pattern, factors, law, n, b, e):
        p = laws[n, len(pattern) - 1, b]
        for k in range(len(pattern) - 2, -1, -1):
            p = p * e + laws[n, k, b]
        return p, e

    if isinstance(factors, types.NoneType):
        return by_coefficients
    return by_factor if isinstance(laws, types.Array) else by_pieces


@jit
def _force(dx, dy, Rx, Ry, q, t, g, law):
    """Force on the far end of a bond, `H(e) R + (g + t H(e)) du`, and what is judged by the reach of the law."""
    e = (2 * Rx + q * dx) * dx + (2 * Ry + q * dy) * dy
    quotient, reached = _quotient(law, e)
    H = e * quotient
    G = g + t * H
    return H * Rx + G * dx, H * Ry + G * dy, reached


@jit
def _own_force(dx, dy, Rx, Ry, q, t, g, r2, laws, pattern, factors, law, n, b):
    """The same of the bond b of group n, with a law of its own."""
    e = ((2 * Rx + q * dx) * dx + (2 * Ry + q * dy) * dy) * r2[n, b]
    quotient, reached = _own_quotient(laws, pattern, factors, law, n, b, e)
    H = e * quotient
    G = g[n, b] + t * H
    return H * Rx + G * dx, H * Ry + G * dy, reached


def _law(laws, kind, pattern):
    """The law of a kind of bonds: a tuple of coefficients, as long as `pattern`, or its pieces."""


@overload(_law, jit_options=OPTIONS)
def _law_of(laws, kind, pattern):
    def coefficients(laws, kind, pattern):
        for n in range(len(pattern)):
            pattern = tuple_setitem(pattern, n, laws[kind, n])
        return pattern

    def pieces(laws, kind, pattern):
        numbers, places, child, centre, c = laws
        return (numbers[kind, 0], numbers[kind, 1], numbers[kind, 2], places[kind, 0], places[kind, 1], child, centre, c)

    return coefficients if isinstance(laws, types.Array) else pieces


# --- one run of slots in one level ------------------------------------------------------------------------------------


@jit
def _pull_group(ux, uy, bx, by, s, e, offset, to, Rx, Ry, q, t, g, law, strength, group):
    """Forces of the bonds of one group that start in the slots s to e, stored `to` places later; the largest |r0^2 e|."""
    vectorise()
    largest = np.int64(0)
    for i in range(s, e):
        dx, dy = ux[i + offset] - ux[i], uy[i + offset] - uy[i]
        if strength is not None:
            dx *= strength[group, i]  # a bond that is not strained pulls at nothing
            dy *= strength[group, i]
        bx[i + to], by[i + to], strain = _force(dx, dy, Rx, Ry, q, t, g, law)
        largest = max(largest, _order(strain))
    return _magnitude(largest)


@jit
def _pull_own_group(ux, uy, bx, by, s, e, offset, to, R, q, t, g, r2, laws, pattern, factors, law, n):
    """The same of bonds with laws of their own: the largest |e|; a bond that is not there has no g, factor or coefficients."""
    vectorise()
    largest = np.int64(0)
    for i in range(s, e):
        bx[i + to], by[i + to], strain = _own_force(ux[i + offset] - ux[i], uy[i + offset] - uy[i], R[n, 0, i], R[n, 1, i], q, t,
                                                    g, r2, laws, pattern, factors, law, n, i)
        largest = max(largest, _order(strain))
    return _magnitude(largest)


@jit
def _pull_listed(ux, uy, bx, by, s, e, i, j, R, q, t, g, law):
    """Forces of the bonds s to e on their far ends, and as many places later on their near ends; the largest |r0^2 e|."""
    vectorise()
    largest, bonds = np.int64(0), np.uint64(len(i))
    for b in range(s, e):
        x, y, strain = _force(ux[j[b]] - ux[i[b]], uy[j[b]] - uy[i[b]], R[0, b], R[1, b], q, t, g, law)
        bx[b] = x
        by[b] = y
        bx[b + bonds] = -x
        by[b + bonds] = -y
        largest = max(largest, _order(strain))
    return _magnitude(largest)


@jit
def _pull_own_listed(ux, uy, bx, by, s, e, i, j, R, q, t, g, r2, laws, pattern, factors, law, n):
    """The same of bonds with laws of their own; the largest |e|."""
    vectorise()
    largest, bonds = np.int64(0), np.uint64(len(i))
    for b in range(s, e):
        x, y, strain = _own_force(ux[j[b]] - ux[i[b]], uy[j[b]] - uy[i[b]], R[0, b], R[1, b], q, t, g, r2, laws, pattern,
                                  factors, law, n, b)
        bx[b] = x
        by[b] = y
        bx[b + bonds] = -x
        by[b + bonds] = -y
        largest = max(largest, _order(strain))
    return _magnitude(largest)


def _common_law(laws, pattern, factors):
    """The law that factors multiply; nothing where there are none."""


@overload(_common_law, jit_options=OPTIONS)
def _common_law_of(laws, pattern, factors):
    if isinstance(factors, types.NoneType) or not isinstance(laws, types.Array):
        return lambda laws, pattern, factors: None
    return lambda laws, pattern, factors: _law(laws, 0, pattern)


def _pull(ux, uy, bx, by, base, stride, r, runs, R, pad, offsets, strength, segments, i, j, q, t, g, r2, laws, pattern, factors):
    """Forces of the bonds of run r, into b; the largest increment.

    It is given all arrays by themselves: numba would count references to the members of a tuple at each call.
    """


@overload(_pull, jit_options=OPTIONS)
def _pull_of(ux, uy, bx, by, base, stride, r, runs, R, pad, offsets, strength, segments, i, j, q, t, g, r2, laws, pattern,
             factors):
    def grid(ux, uy, bx, by, base, stride, r, runs, R, pad, offsets, strength, segments, i, j, q, t, g, r2, laws, pattern,
             factors):
        strain = 0.0
        for n in range(len(offsets)):
            to = pad + np.uint64(n) * stride - base
            largest = _pull_group(ux, uy, bx, by, runs[r, 0], runs[r, 1], offsets[n], to, R[n, 0], R[n, 1], q, t, g[n],
                                  _law(laws, n, pattern), strength, np.uint64(n))
            strain = _larger(strain, largest / r2[n])
        return strain

    def own_grid(ux, uy, bx, by, base, stride, r, runs, R, pad, offsets, strength, segments, i, j, q, t, g, r2, laws, pattern,
                 factors):
        strain, law = 0.0, _common_law(laws, pattern, factors)
        for n in range(len(offsets)):
            to = pad + np.uint64(n) * stride - base
            strain = _larger(strain, _pull_own_group(ux, uy, bx, by, runs[r, 0], runs[r, 1], offsets[n], to, R, q, t, g, r2,
                                                     laws, pattern, factors, law, np.uint64(n)))
        return strain

    def table(ux, uy, bx, by, base, stride, r, runs, R, pad, offsets, strength, segments, i, j, q, t, g, r2, laws, pattern,
              factors):
        strain = 0.0
        for n in range(runs[r, 2], runs[r, 3]):
            kind = segments[n, 2]
            largest = _pull_listed(ux, uy, bx, by, segments[n, 0], segments[n, 1], i, j, R, q, t, g[kind],
                                   _law(laws, kind, pattern))
            strain = _larger(strain, largest / r2[kind])
        return strain

    def own_table(ux, uy, bx, by, base, stride, r, runs, R, pad, offsets, strength, segments, i, j, q, t, g, r2, laws, pattern,
                  factors):
        strain, law = 0.0, _common_law(laws, pattern, factors)
        for n in range(runs[r, 2], runs[r, 3]):
            strain = _larger(strain, _pull_own_listed(ux, uy, bx, by, segments[n, 0], segments[n, 1], i, j, R, q, t, g, r2,
                                                      laws, pattern, factors, law, np.uint64(0)))
        return strain

    if isinstance(offsets, types.NoneType):
        return own_table if g.ndim == 2 else table
    return own_grid if g.ndim == 2 else grid


def _spring(k, x, i):
    """The stiffness along x of the spring of slot i, where all have the same or each its own."""


@overload(_spring, jit_options=OPTIONS)
def _spring_of(k, x, i):
    return (lambda k, x, i: k[x, i]) if isinstance(k, types.Array) else (lambda k, x, i: k)


@jit
def _move_slot(ux, uy, vx, vy, i, fx, fy, carry, push, k, dt):
    """One step of slot i under the forces of its bonds."""
    vx[i] = carry[i] * vx[i] + push[i] * (fx - _spring(k, 0, i) * ux[i])
    vy[i] = carry[i] * vy[i] + push[i] * (fy - _spring(k, 1, i) * uy[i])
    ux[i] += dt * vx[i]
    uy[i] += dt * vy[i]


def _load(static, i):
    """The static force on a slot."""


@overload(_load, jit_options=OPTIONS)
def _load_of(static, i):
    if isinstance(static, types.NoneType):
        return lambda static, i: (0.0, 0.0)
    return lambda static, i: (static[0, i], static[1, i])


@jit
def _move_grid(ux, uy, vx, vy, bx, by, s, e, offsets, pad, stride, static, carry, push, k, dt):
    """One step of the slots s to e; b holds the forces of one group of bonds after another, `stride` apart."""
    vectorise()
    for i in range(s, e):
        fx, fy = _load(static, i)
        for g in range(len(offsets)):
            b = i + pad + np.uint64(g) * stride
            fx += bx[b - offsets[g]] - bx[b]
            fy += by[b - offsets[g]] - by[b]
        _move_slot(ux, uy, vx, vy, i, fx, fy, carry, push, k, dt)


@jit
def _move_listed(ux, uy, vx, vy, bx, by, s, e, ends, columns, static, carry, push, k, dt):
    """One step of the slots s to e; `ends` lists the places in b of the forces on each slot, `columns` counts them."""
    vectorise()
    for i in range(s, e):
        fx, fy = _load(static, i)
        for n in range(len(columns)):  # as many for all, filled up with a bond of no force: no branch to mispredict
            fx += bx[ends[n, i]]
            fy += by[ends[n, i]]
        _move_slot(ux, uy, vx, vy, i, fx, fy, carry, push, k, dt)


def _move(ux, uy, vx, vy, bx, by, s, e, base, stride, pad, offsets, ends, columns, static, carry, push, k, dt):
    """One step of the slots s to e."""


@overload(_move, jit_options=OPTIONS)
def _move_of(ux, uy, vx, vy, bx, by, s, e, base, stride, pad, offsets, ends, columns, static, carry, push, k, dt):
    def grid(ux, uy, vx, vy, bx, by, s, e, base, stride, pad, offsets, ends, columns, static, carry, push, k, dt):
        _move_grid(ux, uy, vx, vy, bx, by, s, e, offsets, pad - base, stride, static, carry, push, k, dt)

    def table(ux, uy, vx, vy, bx, by, s, e, base, stride, pad, offsets, ends, columns, static, carry, push, k, dt):
        _move_listed(ux, uy, vx, vy, bx, by, s, e, ends, columns, static, carry, push, k, dt)

    return table if isinstance(offsets, types.NoneType) else grid


@jit
def _correct(u, v, push, dt, forces, step, r, driven, row, from_driven, guided, barred, from_guided):
    """Add external forces on the slots of run r, and take away what lines and planes bar."""
    for n in range(from_driven[r], from_driven[r + 1]):
        s = driven[n]
        for x in range(2):
            kick = push[s] * forces[step, row[n], x]
            v[x, s] += kick
            u[x, s] += dt * kick
    for n in range(from_guided[r], from_guided[r + 1]):
        s = guided[n]
        vx, vy = v[0, s], v[1, s]
        for x in range(2):
            away = barred[n, x, 0] * vx + barred[n, x, 1] * vy
            v[x, s] -= away
            u[x, s] -= dt * away


@jit
def _start(u0, v0, a0, u, v, decay, dt, s, e):
    vectorise()
    for i in range(s, e):
        v[i] = decay[i] * v0[i] + dt / 2 * a0[i]
        u[i] = u0[i] + dt * v[i]


@jit
def _finish(v, a, decay, dt, s, e):
    vectorise()
    for i in range(s, e):
        v[i] = decay[i] * (v[i] + dt / 2 * a[i])


@jit
def _fill(x, s, e, value):  # a loop: numba takes three seconds to compile the words with which a slice refuses another shape
    for i in range(s, e):
        x[i] = value


@jit
def _largest(x, s, e):
    vectorise()
    largest = np.int64(0)
    for i in range(s, e):
        largest = max(largest, _order(x[i]))
    return _magnitude(largest)


# the window b of a grid holds the bonds of the slots from base - pad on; what lies before all slots pulls at nothing


@jit
def _clear(b, stride, s, e):
    for x in range(2):
        for group in range(0, b.shape[1], stride):
            for i in range(s, e):
                b[x, np.uint64(group) + i] = 0.0


@jit
def _bring_down(b, stride, s, count):
    for x in range(2):
        for group in range(0, b.shape[1], stride):
            for i in range(count):
                b[x, np.uint64(group) + i] = b[x, np.uint64(group) + s + i]


def _room(b, stride, base, r, tail, runs, pad):
    """Make room for the bonds of run r, of what is needed from run `tail` on; the base then, and whether the run is empty."""


@overload(_room, jit_options=OPTIONS)
def _room_of(b, stride, base, r, tail, runs, pad):
    def grid(b, stride, base, r, tail, runs, pad):
        s, e, low = runs[r, 0], runs[r, 1], runs[tail, 0]
        if r == 0:
            _clear(b, stride, np.uint64(0), pad)
        if e + pad - base > stride:
            _bring_down(b, stride, low - base, s + pad - low)
            base = low
        empty = runs[r, 2] == EMPTY
        if empty:
            _clear(b, stride, s + pad - base, e + pad - base)
        return base, empty

    def table(b, stride, base, r, tail, runs, pad):
        return base, False

    return table if isinstance(pad, types.NoneType) else grid


# --- a block of steps -------------------------------------------------------------------------------------------------


@jit
def _wait(done, chunk, runs):
    """Until a chunk is past that many runs."""
    looks = 0
    while _seen(done, FAR * chunk) < runs:
        looks += 1
        if looks > SPINS:
            _leave_core()


@jit
def _chunk(first, last, state, out, forces, moving, bonds, law, b, stride, done, chunk, ran, found):
    """The levels from `first` to before `last`, one behind the other over all runs, and all behind the chunk before."""
    (u0, v0, a0), (u, v, a) = state, out
    dt, k, static, decay, mobility, carry, push, forget, driven, row, from_driven, guided, barred, from_guided = moving
    runs, needs, R, pad, offsets, strength, segments, i, j, ends, columns = bonds
    q, t, g, r2, laws, pattern, factors = law
    u0x, u0y, v0x, v0y, a0x, a0y = u0[0], u0[1], v0[0], v0[1], a0[0], a0[1]
    ux, uy, vx, vy, ax, ay = u[0], u[1], v[0], v[1], a[0], a[1]
    bx, by = b[0], b[1]
    count, base = len(runs), np.uint64(0)
    _fill(ran, 0, last - first, 0)
    while ran[last - first - 1] < count:
        for n in range(last - first):
            r, level = ran[n], first + n
            if r == count or (n > 0 and ran[n - 1] < needs[r]):
                continue
            if n == 0 and chunk > 0:
                _wait(done, chunk - 1, needs[r])
            base, empty = _room(b, stride, base, r, ran[last - first - 1], runs, pad)
            ran[n] = r + 1
            if empty:
                continue
            s, e = runs[r, 0], runs[r, 1]
            if level == 0:
                _start(u0x, v0x, a0x, ux, vx, decay, dt, s, e)
                _start(u0y, v0y, a0y, uy, vy, decay, dt, s, e)
                continue
            found[0] = _larger(found[0], _pull(ux, uy, bx, by, base, stride, r, runs, R, pad, offsets, strength, segments, i, j,
                                               q, t, g, r2, laws, pattern, factors))
            if level < len(forces):
                _move(ux, uy, vx, vy, bx, by, s, e, base, stride, pad, offsets, ends, columns, static, carry, push, k, dt)
                _correct(u, v, push, dt, forces, level - 1, r, driven, row, from_driven, guided, barred, from_guided)
                continue
            _fill(ax, s, e, 0.0)
            _fill(ay, s, e, 0.0)
            _move(ux, uy, ax, ay, bx, by, s, e, base, stride, pad, offsets, ends, columns, static, forget, mobility, k, 0.0)
            _correct(u, a, mobility, 0.0, forces, level - 1, r, driven, row, from_driven, guided, barred, from_guided)
            _finish(vx, ax, decay, dt, s, e)
            _finish(vy, ay, decay, dt, s, e)
            found[1] = _larger(found[1], _larger(_largest(ux, s, e), _largest(uy, s, e)))
            found[2] = _larger(found[2], _larger(_largest(vx, s, e), _largest(vy, s, e)))
        _show(done, FAR * chunk, ran[last - first - 1])


@jit
def advance(state, out, forces, moving, bonds, law, b, stride, done, first, size, thread, threads, ran, found):
    """Levels from `first` on of a block, from `state` to `out`, as `Kernel.advance` takes it: the part of a thread.

    Returns the largest increment on the way, and the largest components of displacement and velocity in the end.

    Parameters
    ----------
    b : ndarray
        Room for the forces of bonds, of this thread alone, shape (2, groups x stride) on a grid.
    stride : int
        Length of the window on each group.
    done : ndarray of int
        Zeros, FAR for each chunk; for all threads.
    size : int
        Number of levels in a chunk.
    ran, found : ndarray, shape (size,) of int and (3,)
        Scratch of this thread.
    """
    end = len(forces) + 1
    _fill(found, 0, 3, 0.0)
    for chunk in range(thread, (end - first + size - 1) // size, threads):
        s = first + chunk * size
        _chunk(s, min(s + size, end), state, out, forces, moving, bonds, law, b, stride, done, chunk, ran, found)
    return found[0], found[1], found[2]


@jit
def write(slot, s, e, u, v, anchors, masses, positions, momenta):
    """Set positions and momenta, shape (particles, 3), of the particles s to e to anchors + u and m v."""
    vectorise()
    for i in range(s, e):
        for x in range(2):
            positions[i, x] = anchors[x, i] + u[x, slot[i]]
    for i in range(s, e):
        for x in range(2):
            momenta[i, x] = masses[i] * v[x, slot[i]]


@jit
def written(slot, s, e, u, v, anchors, masses, positions, momenta):
    """Whether they are what `write` has left."""
    for i in range(s, e):
        for x in range(2):
            if positions[i, x] != anchors[x, i] + u[x, slot[i]] or momenta[i, x] != masses[i] * v[x, slot[i]]:
                return False
    return True
