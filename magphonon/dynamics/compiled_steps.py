"""The steps of `magphonon.dynamics.kernels_numpy`, compiled by numba.

The slots are treated in runs that fit the first-level cache.  Each bond is evaluated once, with the run that holds
its lower slot; then the slots of the run gather the forces of their bonds and move on, in place: no later bond needs
their old displacements, because bonds lead upwards.

What the compiler must know to fill the vector units: indices are unsigned (a negative one would wrap), arrays do not
overlap, the coefficients of the polynomial are a tuple, and a maximum is one of integers.

All of it stands in one file: numba keeps what it has compiled until the file of the function changes, and would not notice a
change of another file from which this one takes functions.
"""

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.cpython.unsafe.tuple import tuple_setitem
from numba.extending import intrinsic, overload

from .law_pieces import BITS, DEGREE

EMPTY = 1
"""Flag of a run of empty slots."""


@intrinsic
def vectorise(typing_context):
    """Promise that the arguments of the calling function do not overlap (C's restrict), and ask for wide vectors."""

    def code(context, builder, signature, arguments):
        function = builder.function
        set.add(function.attributes, '"prefer-vector-width"="512"')  # a name of LLVM's; llvmlite's own `add` knows only some
        for argument in function.args:
            if isinstance(argument.type, ir.PointerType) and 'noalias' not in argument.attributes:
                argument.add_attribute('noalias')
        return context.get_dummy_value()

    return types.void(), code


OPTIONS = {'error_model': 'numpy', 'fastmath': {'contract'}}


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
    return b if not b <= a else a


@jit
def _polynomial(quads, e):
    """`c0 + c1 e + ...`, four terms at a time, which do not wait for each other."""
    e2 = e * e
    e4 = e2 * e2
    p = 0.0
    for n in range(len(quads) - 1, -1, -1):
        a, b, c, d = quads[n]
        p = p * e4 + ((a + b * e) + e2 * (c + d * e))
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


@jit
def _force(dx, dy, Rx, Ry, q, t, g, law):
    """Force on the far end of a bond, `H(e) R + (g + t H(e)) du`, and what is judged by the reach of the law."""
    e = (2 * Rx + q * dx) * dx + (2 * Ry + q * dy) * dy
    quotient, reached = _quotient(law, e)
    H = e * quotient
    G = g + t * H
    return H * Rx + G * dx, H * Ry + G * dy, reached


def _law(laws, kind, pattern):
    """The law of a kind of bonds, for r0^2 e: a tuple of coefficients in fours, as long as `pattern`, or its pieces."""


@overload(_law, jit_options=OPTIONS)
def _law_of(laws, kind, pattern):
    def quads(laws, kind, pattern):
        for n in range(len(pattern)):
            pattern = tuple_setitem(pattern, n, (laws[kind, 4 * n], laws[kind, 4 * n + 1], laws[kind, 4 * n + 2],
                                                 laws[kind, 4 * n + 3]))
        return pattern

    def pieces(laws, kind, pattern):
        numbers, places, child, centre, c = laws
        return (numbers[kind, 0], numbers[kind, 1], numbers[kind, 2], places[kind, 0], places[kind, 1], child, centre, c)

    return quads if isinstance(laws, types.Array) else pieces


def _spring(k, x, i):
    """The stiffness along x of the spring of slot i, where all have the same or each its own."""


@overload(_spring, jit_options=OPTIONS)
def _spring_of(k, x, i):
    return (lambda k, x, i: k[x, i]) if isinstance(k, types.Array) else (lambda k, x, i: k)


@jit
def _move(ux, uy, vx, vy, i, fx, fy, carry, push, k, dt):
    """One step of slot i under the forces of its bonds."""
    vx[i] = carry[i] * vx[i] + push[i] * (fx - _spring(k, 0, i) * ux[i])
    vy[i] = carry[i] * vy[i] + push[i] * (fy - _spring(k, 1, i) * uy[i])
    ux[i] += dt * vx[i]
    uy[i] += dt * vy[i]


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
def _move_grid(ux, uy, vx, vy, bx, by, s, e, offsets, pad, stride, carry, push, k, dt):
    """One step of the slots s to e; b holds the forces of one group of bonds after another, `stride` apart."""
    vectorise()
    for i in range(s, e):
        fx = fy = 0.0
        for g in range(len(offsets)):
            b = i + pad + np.uint64(g) * stride
            fx += bx[b - offsets[g]] - bx[b]
            fy += by[b - offsets[g]] - by[b]
        _move(ux, uy, vx, vy, i, fx, fy, carry, push, k, dt)


@jit
def _clear(b, s, e):  # a loop: numba takes three seconds to compile the words with which a slice refuses another shape
    for x in range(2):
        for n in range(b.shape[1]):
            for i in range(s, e):
                b[x, n, i] = 0.0


@jit
def _bring_down(b, s, count):
    for x in range(2):
        for n in range(b.shape[1]):
            for i in range(count):
                b[x, n, i] = b[x, n, s + i]


@jit
def steps_grid(u, v, forces, carry, push, dt, k, corrected, bonds):
    """Steps of the slots of a grid, in place, one for each of the external forces; the largest increment on the way."""
    b, pad, runs, offsets, R, strength, q, t, g, r2, laws, pattern = bonds
    ux, uy, vx, vy, bx, by = u[0], u[1], v[0], v[1], b[0].ravel(), b[1].ravel()
    stride = np.uint64(b.shape[2])
    strain = 0.0
    for step in range(len(forces)):
        base = np.uint64(0)  # b is a window on the bonds: those of slot i stand at i + pad - base of their group
        _clear(b, np.uint64(0), pad)
        for r in range(len(runs)):
            s, e = runs[r, 0], runs[r, 1]
            if e - base > stride - pad:
                _bring_down(b, s - base, pad)
                base = s
            if runs[r, 2] == EMPTY:
                _clear(b, s + pad - base, e + pad - base)
                continue
            for n in range(len(offsets)):
                law = _law(laws, n, pattern)
                largest = _pull_group(ux, uy, bx, by, s, e, offsets[n], pad + np.uint64(n) * stride - base, R[n, 0], R[n, 1],
                                      q, t, g[n], law, strength, np.uint64(n))
                strain = _larger(strain, largest / r2[n])
            _move_grid(ux, uy, vx, vy, bx, by, s, e, offsets, pad - base, stride, carry, push, k, dt)
        _correct(u, v, push, dt, forces[step], corrected)
    return strain


@jit
def _pull_listed(ux, uy, bx, by, s, e, i, j, Rx, Ry, q, t, g, law, bonds):
    """Forces of the bonds s to e on their far ends, and `bonds` places later on their near ends; the largest |r0^2 e|."""
    vectorise()
    largest = np.int64(0)
    for b in range(s, e):
        x, y, strain = _force(ux[j[b]] - ux[i[b]], uy[j[b]] - uy[i[b]], Rx[b], Ry[b], q, t, g, law)
        bx[b] = x
        by[b] = y
        bx[b + bonds] = -x
        by[b + bonds] = -y
        largest = max(largest, _order(strain))
    return _magnitude(largest)


@jit
def _move_listed(ux, uy, vx, vy, bx, by, s, e, ends, columns, carry, push, k, dt):
    """One step of the slots s to e; `ends` lists the places in b of the forces on each slot, `columns` counts them."""
    vectorise()
    for i in range(s, e):
        fx = fy = 0.0
        for n in range(len(columns)):  # as many for all, filled up with a bond of no force: no branch to mispredict
            fx += bx[ends[n, i]]
            fy += by[ends[n, i]]
        _move(ux, uy, vx, vy, i, fx, fy, carry, push, k, dt)


@jit
def steps_table(u, v, forces, carry, push, dt, k, corrected, bonds):
    """The same of the slots of a table."""
    b, runs, segments, i, j, Rx, Ry, ends, columns, q, t, g, r2, laws, pattern = bonds
    ux, uy, vx, vy, bx, by = u[0], u[1], v[0], v[1], b[0], b[1]
    strain = 0.0
    for step in range(len(forces)):
        for r in range(len(runs)):
            s, e = runs[r, 0], runs[r, 1]
            for n in range(runs[r, 2], runs[r, 3]):
                kind = segments[n, 2]
                law = _law(laws, kind, pattern)
                largest = _pull_listed(ux, uy, bx, by, segments[n, 0], segments[n, 1], i, j, Rx, Ry, q, t, g[kind], law,
                                       np.uint64(len(i)))
                strain = _larger(strain, largest / r2[kind])
            _move_listed(ux, uy, vx, vy, bx, by, s, e, ends, columns, carry, push, k, dt)
        _correct(u, v, push, dt, forces[step], corrected)
    return strain


@jit
def _correct(u, v, push, dt, force, corrected):
    """Add external forces, and take away what lines and planes bar."""
    driven, guided, barred = corrected
    for n in range(len(driven)):
        s = driven[n]
        for x in range(2):
            kick = push[s] * force[n, x]
            v[x, s] += kick
            u[x, s] += dt * kick
    for n in range(len(guided)):
        s = guided[n]
        vx, vy = v[0, s], v[1, s]
        for x in range(2):
            away = barred[n, x, 0] * vx + barred[n, x, 1] * vy
            v[x, s] -= away
            u[x, s] -= dt * away


@jit
def _start(u0, v0, a0, u, v, decay, dt):
    for x in range(2):
        for i in range(len(decay)):
            v[x, i] = decay[i] * v0[x, i] + dt / 2 * a0[x, i]
            u[x, i] = u0[x, i] + dt * v[x, i]


@jit
def _finish(v, a, decay, dt):
    for x in range(2):
        for i in range(len(decay)):
            v[x, i] = decay[i] * (v[x, i] + dt / 2 * a[x, i])


@jit
def advance_grid(state, out, forces, coefficients, decay, mobility, forget, corrected, bonds):
    """A block on a grid, from `state` to `out`, as `Kernel.advance` takes it; the largest increment on the way."""
    (u0, v0, a0), (u, v, a), (carry, push, dt, k) = state, out, coefficients
    _start(u0, v0, a0, u, v, decay, dt)
    strain = steps_grid(u, v, forces[:-1], carry, push, dt, k, corrected, bonds)
    a[:] = 0
    strain = _larger(strain, steps_grid(u, a, forces[-1:], forget, mobility, 0.0, k, corrected, bonds))
    _finish(v, a, decay, dt)
    return strain


@jit
def advance_table(state, out, forces, coefficients, decay, mobility, forget, corrected, bonds):
    """The same of a table."""
    (u0, v0, a0), (u, v, a), (carry, push, dt, k) = state, out, coefficients
    _start(u0, v0, a0, u, v, decay, dt)
    strain = steps_table(u, v, forces[:-1], carry, push, dt, k, corrected, bonds)
    a[:] = 0
    strain = _larger(strain, steps_table(u, a, forces[-1:], forget, mobility, 0.0, k, corrected, bonds))
    _finish(v, a, decay, dt)
    return strain


@jit
def write(slot, u, v, anchors, masses, positions, momenta):
    """Set positions and momenta, shape (particles, 3), to anchors + u and m v."""
    vectorise()
    for i in range(len(slot)):
        for x in range(2):
            positions[i, x] = anchors[x, i] + u[x, slot[i]]
    for i in range(len(slot)):
        for x in range(2):
            momenta[i, x] = masses[i] * v[x, slot[i]]


@jit
def written(slot, u, v, anchors, masses, positions, momenta):
    """Whether they are what `write` has left."""
    for i in range(len(slot)):
        for x in range(2):
            if positions[i, x] != anchors[x, i] + u[x, slot[i]] or momenta[i, x] != masses[i] * v[x, slot[i]]:
                return False
    return True
