"""Blocks of driven, damped velocity Verlet steps on displacements from rest, compiled by numba.

One step of DrivenVerlet is: half decay, half kick, velocity Verlet, half kick, half decay.  The halves on either side of the
border between two steps merge.  The decay d = exp(-(gamma + i g) dt/2) multiplies v_x + i v_y, and is real if nothing gyrates.
Inside a block a step is

    v <- d^2 v + (1 + d^2) dt/2 F/m          u <- u + dt v

with v half a step behind u; a block starts with `v <- d v + dt/2 a` and ends with `v <- d (v + dt/2 a)`.  A step of higher
order (`splittings`) consists of several such stages, each with its own kick and drift. There d = 1, and `rate` damps the drifts.

A state holds displacements u, velocities v and accelerations a of the slots of a `Layout`, shape (3, 2, slots).  The mobility
1/m is zero for held particles, so that forces on them have no effect.

Slots are processed in runs that fit into the first cache.  Each bond is evaluated once per step, in the run of its lower slot.
Then each slot of the run sums the forces of its bonds and moves, in place: all later bonds lead to higher slots, so none needs
the old displacements.  For the same reason the next step may follow a few runs behind (`lag`), and a few steps go over the slots
together, while these are in the cache.

Threads follow each other over the slots: each takes the next few steps as soon as the thread before it is far enough ahead. Every
slot goes through the same operations in the same order, so that results are the same bit by bit for any number of threads.

A kernel computes in double precision, or in single precision if the requested error allows it. The loops therefore contain no
literal numbers (`Rx + Rx` instead of `2 * Rx`), whose type would convert all others to double precision.

Indices are unsigned, as numba checks signed ones for -1, which keeps loops out of vector units.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, NamedTuple
from warnings import warn

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core.options import DefaultOptions
from numba.extending import intrinsic, overload

from .bond_increments import SHIFT
from .memory_layout import LINE, aligned_zeros, same

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from .bond_increments import Increments, Pieces
    from .engine import Motion
    from .memory_layout import Layout

    Found = tuple[bool, float, float]

RUN = 2048
"""Number of slots processed at a time in double precision; twice as many in single."""
AT_ONCE = 12288
"""Number of slots up to which single precision takes all of them in one run, which the second cache holds: a stage of 1e4 magnets
takes a tenth less time than in runs, each of which has four calls."""
SPINS = 2000  # number of checks of the thread before, after which the core is left to another thread
GAP = 32
"""Largest number of holes in a run of slots that are cheaper to fill than to skip."""
TOGETHER = 3
"""Number of steps that go over the slots together; of a million slots they take 20 % less time than one by one."""
SAME_SHAPE = 1e-14
"""Relative difference of coefficients up to which laws differ by a factor only."""
PART = 512
"""Number of slots of a run whose bonds share one law, where some bonds need the polynomial pieces."""
FEW = np.uint64(16)
"""Number of bonds that test a law before the others of their part use it: in a hot patch they show that its range is too short.
"""
NEARER = 1 / 16, 1 / 2
"""Largest increments |e| of a part whose bonds use a polynomial although other parts need the pieces.  For magnets these
polynomials have 12 or 32 coefficients, and take half as long as the five that are looked up in the pieces."""
COUNTED = {'_nrt': False} if hasattr(DefaultOptions, '_nrt') else {}
"""An internal option of numba that switches off reference counts of arrays, which take longer than a short run of slots."""
OPTIONS = {'error_model': 'numpy', 'fastmath': {'contract'}, 'nogil': True, 'no_cfunc_wrapper': True, **COUNTED}
FORGET, MOBILITY, DECAY, CARRY, PUSH = range(5)
"""Rows of coefficients for each slot: `v <- keep carry v + kick push F`, with two numbers for each stage of a step; for
accelerations `v <- mobility F`."""
MAGNITUDE, MAGNITUDE_SINGLE = 2**63 - 1, 2**31 - 1
"""Bits of a number without its sign.  As integers they sort like |x|, nan last, and vector units can compute their maximum."""

WITHIN = {'error_model': 'numpy', 'fastmath': {'contract'}, 'forceinline': False, **COUNTED}
"""Options of functions that must not be inlined themselves, although their callers may be."""
part = njit(no_cpython_wrapper=True, **OPTIONS)


class Spare:
    """The disk cache of numba, made optional: code that cannot be read or written there is compiled again."""

    told = False  # whether the user has been warned

    def __init__(self, cache: Any) -> None:
        self._cache = cache

    def __getattr__(self, name):
        return getattr(self._cache, name)

    def load_overload(self, *arguments: Any) -> Any:
        return self._without(self._cache.load_overload, arguments)

    def save_overload(self, *arguments: Any) -> Any:
        return self._without(self._cache.save_overload, arguments)

    def _without(self, call, arguments):
        try:
            return call(*arguments)
        except Exception as error:  # a damaged file may raise anything, a full disk OSError
            if not Spare.told:
                Spare.told = True
                warn(f"numba's cache in {self._cache.cache_path} cannot be used ({error!r}): compiled steps are compiled again "
                     'in each process, which takes seconds; empty this folder, or set NUMBA_CACHE_DIR to another', stacklevel=2)
            return None


def kept(function):
    """Compile a function, and keep the result on disk if numba finds a folder that it may write to."""
    try:
        compiled = njit(cache=True, **OPTIONS)(function)
    except RuntimeError:
        return njit(**OPTIONS)(function)
    compiled._cache = Spare(compiled._cache)
    return compiled


@kept
def smallest(x):
    """The smallest kernel, by which it is tried whether kernels can be compiled."""
    return x


@intrinsic
def vectorise(typing_context):
    """Promise that arrays of the calling function do not overlap, and ask for wide vectors: worth a factor of 1.5."""
    def code(context, builder, signature, arguments):
        function = builder.function
        try:
            set.add(function.attributes, '"prefer-vector-width"="512"')  # a name of LLVM's; llvmlite's own `add` knows only some
            function.attributes.add('noinline')  # neither would hold within another function
            for argument in function.args:
                if argument.type.is_pointer and 'noalias' not in argument.attributes:
                    argument.add_attribute('noalias')
        except (AttributeError, TypeError, ValueError) as error:
            warn(f'this version of numba takes no hints for vector units ({error}): compiled steps are slower', stacklevel=2)
        return context.get_dummy_value()

    return types.void(), code


def unrolled(arguments, expression):
    """A function whose expression is written out for a number of terms that is known from a type."""
    names = {'at': at, 'times_at': times_at}
    exec(f'def unrolled({arguments}):\n    return {expression}', names)  # noqa: S102  of nothing but numbers of terms
    return names['unrolled']


def at(x, kind, i):
    """The value of x for a kind of bonds if x has the shape (kinds,), or for bond i if (1, bonds); 1 if x is None."""


@overload(at)
def _at(x, kind, i):
    if isinstance(x, types.NoneType):
        return lambda x, kind, i: 1.0
    return (lambda x, kind, i: x[kind]) if x.ndim == 1 else (lambda x, kind, i: x[0, i])


def times_at(value, x, kind, i):
    """`at(x, kind, i)` times a value; in the precision of the value if x is None."""


@overload(times_at)
def _times_at(value, x, kind, i):
    if isinstance(x, types.NoneType):
        return lambda value, x, kind, i: value
    return (lambda value, x, kind, i: x[kind] * value) if x.ndim == 1 else (lambda value, x, kind, i: x[0, i] * value)


def bits(x):
    """The bits of |x|, as an integer of the same width."""


@overload(bits)
def _bits(x):
    if x == types.float32:
        return lambda x: np.int32(np.float32(x).view(np.int32) & np.int32(MAGNITUDE_SINGLE))
    return lambda x: np.float64(x).view(np.int64) & MAGNITUDE


def of_bits(n):
    """The floating-point number that has these bits."""


@overload(of_bits)
def _of_bits(n):
    if n == types.int32:
        return lambda n: np.float64(np.int32(n).view(np.float32))
    return lambda n: np.int64(n).view(np.float64)


# --- laws: H/e at x, which is r0^2 e where bonds of a kind share a law in double precision, or e ---------------------------


class Polynomial(NamedTuple):
    """Coefficients of kinds, shape (kinds, count), or of bonds, shape (1, count, bonds), and the limit of their range.

    `count` is a tuple with one entry for each coefficient: numba compiles for each length.
    """

    count: tuple[float, ...]
    c: np.ndarray
    limit: np.ndarray
    factors: np.ndarray | None


class PiecesOfAll(NamedTuple):
    """The `Pieces` of all kinds one after the other; `child` is None if no piece is halved."""

    per_increment: np.ndarray
    low: np.ndarray
    high: np.ndarray
    start: np.ndarray
    c: np.ndarray
    child: np.ndarray | None
    centre: np.ndarray
    factors: np.ndarray | None


def constants(law, kind):
    """Coefficients of a kind.  Read before a loop, they all stay in registers; read inside it, only the first ones do."""


@overload(constants)
def _constants(law, kind):
    if law.instance_class is PiecesOfAll or law.types[1].ndim == 3:
        return lambda law, kind: 0
    return unrolled('law, kind', f'({", ".join(f"law.c[kind, {n}]" for n in range(len(law.types[0])))},)')


def quotient(law, c, kind, i, x):
    """The quotient H/e of bond i at the argument x of its law."""


@overload(quotient)
def _quotient(law, c, kind, i, x):
    if law.instance_class is PiecesOfAll:
        return _halved_piece if isinstance(law.types[5], types.Array) else _octave_piece
    *others, value = [('c[{}]' if law.types[1].ndim == 2 else 'law.c[0, {}, i]').format(n) for n in range(len(law.types[0]))]
    for c_n in reversed(others):
        value = f'({value}) * x + {c_n}'
    return unrolled('law, c, kind, i, x', f'times_at({value}, law.factors, kind, i)')


def _octave_piece(law, c, kind, i, x):
    a, low, high, n = at(law.per_increment, kind, i), at(law.low, kind, i), at(law.high, kind, i), at(law.start, kind, i)
    w = 1.0 + a * x
    v = w if w > low else low  # also catches NaN, which `max` would let through
    v = v if v < high else high
    piece = np.float64(v).view(np.int64) >> SHIFT
    k = np.uint64(n + piece)
    y = v - np.int64(piece << SHIFT | 1 << (SHIFT - 1)).view(np.float64)
    p = (((law.c[k, 4] * y + law.c[k, 3]) * y + law.c[k, 2]) * y + law.c[k, 1]) * y + law.c[k, 0]
    return at(law.factors, kind, i) * p


def _halved_piece(law, c, kind, i, x):
    w, low, high = 1.0 + at(law.per_increment, kind, i) * x, at(law.low, kind, i), at(law.high, kind, i)
    v = w if w > low else low
    v = v if v < high else high
    n = at(law.start, kind, i) + (np.float64(v).view(np.int64) >> SHIFT)
    while law.child[n] >= 0:
        n = law.child[n] + (v >= law.centre[n])
    y = v - law.centre[n]
    p = (((law.c[n, 4] * y + law.c[n, 3]) * y + law.c[n, 2]) * y + law.c[n, 1]) * y + law.c[n, 0]
    return at(law.factors, kind, i) * p


def beyond(law, kind, i, x):
    """Whether x is beyond the range of the law, or NaN."""


@overload(beyond)
def _beyond(law, kind, i, x):
    if law.instance_class is Polynomial:
        return lambda law, kind, i, x: not abs(x) <= law.limit[kind]

    def beyond_pieces(law, kind, i, x):
        w, low, high = 1.0 + at(law.per_increment, kind, i) * x, at(law.low, kind, i), at(law.high, kind, i)
        return not ((w >= low) & (w <= high))

    return beyond_pieces


# --- bonds: `H R + (g + t H) du` on their far ends ------------------------------------------------------------------------


class Bonds(NamedTuple):
    """Coefficients of the kinds of bonds, or of each bond (see `at`); on a grid, bond i of group n has number `n x slots + i`.

    `model` is (q, t); `unit` is 1/r0^2 if the argument of a law is e; `strength` is 0 where a grid has no bond.
    """

    model: tuple[float, float]
    Rx: np.ndarray
    Ry: np.ndarray
    g: np.ndarray
    unit: np.ndarray | None
    strength: np.ndarray | None


def pull(state, b, bonds, law, near, far, places, pad, kind, s, e):
    """Write the forces of the bonds of a segment into b; return whether a bond is beyond the range of the law.

    On a grid these are the bonds of a group that start in the slots s to e, stored `pad` places later.  In a table they are the
    bonds s to e: forces on their far ends come first in b, forces on their near ends after those of all bonds.
    """


@overload(pull, jit_options=WITHIN)
def _pull(state, b, bonds, law, near, far, places, pad, kind, s, e):
    def grid(state, b, bonds, law, near, far, places, pad, kind, s, e):
        vectorise()
        first, c, (q, t), wide, offset = kind * np.uint64(state.shape[2]), constants(law, kind), bonds.model, False, places[kind]
        X, Y, g, unit, strength = bonds.Rx, bonds.Ry, bonds.g, bonds.unit, bonds.strength
        for i in range(s, e):
            k = first + i
            Rx, Ry = at(X, kind, k), at(Y, kind, k)  # a missing bond has no strain and exerts no force
            dx = times_at(state[0, 0, i + offset] - state[0, 0, i], strength, kind, k)
            dy = times_at(state[0, 1, i + offset] - state[0, 1, i], strength, kind, k)
            x = times_at((Rx + Rx + q * dx) * dx + (Ry + Ry + q * dy) * dy, unit, kind, k)
            H = x * quotient(law, c, kind, k, x)
            G = at(g, kind, k) + t * H
            b[0, kind, i + pad], b[1, kind, i + pad] = H * Rx + G * dx, H * Ry + G * dy
            wide |= beyond(law, kind, k, x)
        return wide

    def table(state, b, bonds, law, near, far, places, pad, kind, s, e):
        vectorise()
        listed, c, (q, t), wide = np.uint64(len(near)), constants(law, kind), bonds.model, False
        X, Y, g, unit = bonds.Rx, bonds.Ry, bonds.g, bonds.unit
        for i in range(s, e):
            j, k, Rx, Ry = near[i], far[i], X[0, i], Y[0, i]
            dx, dy = state[0, 0, k] - state[0, 0, j], state[0, 1, k] - state[0, 1, j]
            x = times_at((Rx + Rx + q * dx) * dx + (Ry + Ry + q * dy) * dy, unit, kind, i)
            H = x * quotient(law, c, kind, i, x)
            G = at(g, kind, i) + t * H
            fx, fy = H * Rx + G * dx, H * Ry + G * dy
            b[0, 0, i], b[1, 0, i], b[0, 0, i + listed], b[1, 0, i + listed] = fx, fy, -fx, -fy
            wide |= beyond(law, kind, i, x)
        return wide

    return grid if isinstance(near, types.NoneType) else table


@njit(no_cpython_wrapper=True, forceinline=True, **OPTIONS)
def pull_by(law, wider, widest, work, b, bonds, near, far, places, pad, kind, s, e):
    """Like `pull`, but a second and a third law, which may be None, are used if a bond is beyond the range of the law before."""
    few = e if wider is None else min(s + FEW, e)
    out = pull(work, b, bonds, law, near, far, places, pad, kind, s, few)
    if wider is not None:
        if not out:  # numba leaves out what follows a test for None alone
            out = pull(work, b, bonds, law, near, far, places, pad, kind, few, e)
        if out:
            out = pull(work, b, bonds, wider, near, far, places, pad, kind, s, e)
    if widest is not None:
        if out:
            out = pull(work, b, bonds, widest, near, far, places, pad, kind, s, e)
    return out


def total(b, x, places, pad, i):
    """Sum of the forces of all bonds on slot i along x; `places` are the offsets of the groups, or columns of places in b."""


@overload(total)
def _total(b, x, places, pad, i):
    grid = isinstance(places.dtype, types.Integer)
    term = '(b[x, {0}, i + (pad - places[{0}])] - b[x, {0}, i + pad])' if grid else 'b[x, 0, places[{0}][i]]'
    return unrolled('b, x, places, pad, i', ' + '.join(term.format(n) for n in range(len(places))) or '0.0')


# --- slots --------------------------------------------------------------------------------------------------------------


class Outer(NamedTuple):
    """Forces other than bonds: springs and static forces (see `at`), and for each run the forces on driven and guided slots."""

    springs: np.ndarray
    static: np.ndarray
    driven: np.ndarray
    row: np.ndarray
    from_driven: np.ndarray
    guided: np.ndarray
    barred: np.ndarray
    from_guided: np.ndarray


def times(slots, turns, row, i, x, y):
    """The vector (x, y) times the coefficient of slot i in `slots`; with `turns`, x + i y times (slots + i turns)."""


@overload(times)
def _times(slots, turns, row, i, x, y):
    if isinstance(turns, types.NoneType):
        return lambda slots, turns, row, i, x, y: (slots[row, i] * x, slots[row, i] * y)
    return lambda slots, turns, row, i, x, y: (slots[row, i] * x - turns[row, i] * y, slots[row, i] * y + turns[row, i] * x)


def move(state, b, places, pad, slots, turns, k, static, v, row, s, e, keep, kick, drift):
    """Kick row v of the state by all forces except external ones, then let the slots drift."""


@overload(move, jit_options=WITHIN)
def _move(state, b, places, pad, slots, turns, k, static, v, row, s, e, keep, kick, drift):
    def straight(state, b, places, pad, slots, turns, k, static, v, row, s, e, keep, kick, drift):
        vectorise()
        for x in range(2):
            first = np.uint64(x) * np.uint64(state.shape[2])
            for i in range(s, e):
                f = at(static, 0, first + i) + total(b, x, places, pad, i) - at(k, 0, first + i) * state[0, x, i]
                state[v, x, i] = keep * slots[row, i] * state[v, x, i] + kick * slots[row + 1, i] * f
                state[0, x, i] += drift * state[v, x, i]

    def turning(state, b, places, pad, slots, turns, k, static, v, row, s, e, keep, kick, drift):
        vectorise()
        y = np.uint64(state.shape[2])
        for i in range(s, e):
            fx = at(static, 0, i) + total(b, 0, places, pad, i) - at(k, 0, i) * state[0, 0, i]
            fy = at(static, 0, y + i) + total(b, 1, places, pad, i) - at(k, 0, y + i) * state[0, 1, i]
            vx, vy = times(slots, turns, row, i, state[v, 0, i], state[v, 1, i])
            ax, ay = times(slots, turns, row + 1, i, fx, fy)
            state[v, 0, i], state[v, 1, i] = keep * vx + kick * ax, keep * vy + kick * ay
            state[0, 0, i] += drift * state[v, 0, i]
            state[0, 1, i] += drift * state[v, 1, i]

    return straight if isinstance(turns, types.NoneType) else turning


@part
def correct(state, slots, turns, outer, force, v, row, r, kick, drift):
    """Add external forces on the slots of run r, and remove the motion that lines and planes bar."""
    for n in range(outer.from_driven[r], outer.from_driven[r + 1]):
        i = outer.driven[n]
        kx, ky = times(slots, turns, row + 1, i, force[outer.row[n], 0], force[outer.row[n], 1])
        kx, ky = kick * kx, kick * ky
        state[v, 0, i] += kx
        state[v, 1, i] += ky
        state[0, 0, i] += drift * kx
        state[0, 1, i] += drift * ky
    for n in range(outer.from_guided[r], outer.from_guided[r + 1]):
        i = outer.guided[n]
        vx, vy = state[v, 0, i], state[v, 1, i]
        for x in range(2):
            away = outer.barred[n, x, 0] * vx + outer.barred[n, x, 1] * vy
            state[v, x, i] -= away
            state[0, x, i] -= drift * away


@part
def start(state, work, slots, turns, s, e, half, drift):
    """Copy displacements and velocities, with half a kick by the accelerations, and a drift."""
    vectorise()
    none = half - half
    for i in range(s, e):
        work[2, 0, i] = work[2, 1, i] = none  # zero times the old value might be NaN
        vx, vy = times(slots, turns, DECAY, i, state[1, 0, i], state[1, 1, i])
        vx, vy = vx + half * state[2, 0, i], vy + half * state[2, 1, i]
        work[1, 0, i], work[1, 1, i] = vx, vy
        work[0, 0, i], work[0, 1, i] = state[0, 0, i] + drift * vx, state[0, 1, i] + drift * vy


@part
def finish(work, slots, turns, s, e, half, before):
    """Apply half a kick; return the largest components of displacement and velocity after it."""
    vectorise()
    far = fast = bits(half - half)
    for i in range(s, e):
        vx, vy = before * work[1, 0, i] + half * work[2, 0, i], before * work[1, 1, i] + half * work[2, 1, i]
        work[1, 0, i], work[1, 1, i] = times(slots, turns, DECAY, i, vx, vy)
    for x in range(2):
        for i in range(s, e):
            p, q = bits(work[0, x, i]), bits(work[1, x, i])
            far, fast = p if p > far else far, q if q > fast else fast
    return of_bits(far), of_bits(fast)


# --- threads that follow each other -----------------------------------------------------------------------------------------


def _place(context, builder, array_type, array, index):
    return builder.gep(context.make_array(array_type)(context, builder, value=array).data, [index])


@intrinsic
def read(typing_context, array, index):
    """Read an entry written by another thread, so that all that it wrote before is visible too."""
    def code(context, builder, signature, arguments):
        return builder.load_atomic(_place(context, builder, array, *arguments), 'acquire', 8)

    return types.int64(array, types.intp), code


@intrinsic
def tell(typing_context, array, index, value):
    """Write an entry for another thread, which also sees all that was written before."""
    def code(context, builder, signature, arguments):
        builder.store_atomic(arguments[2], _place(context, builder, array, *arguments[:2]), 'release', 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.int64), code


@intrinsic
def leave_core(typing_context):
    """Let another thread have the core."""
    def code(context, builder, signature, arguments):
        kind = ir.FunctionType(ir.IntType(32), [])
        builder.call(builder.module.globals.get('sched_yield') or ir.Function(builder.module, kind, 'sched_yield'), [])
        return context.get_dummy_value()

    return types.void(), code


@njit(no_cpython_wrapper=True, **OPTIONS)
def wait(done, place, runs):
    """Wait until the counter at `place` says that `runs` runs are done."""
    tries = 0
    while read(done, place) < runs:
        tries += 1
        if tries > SPINS:
            leave_core()


# --- steps ----------------------------------------------------------------------------------------------------------------


@kept
def advance(state, work, b, runs, segments, within, lag, bonds, law, wider, widest, near, far, places, pad, slots, turns,
            outer, forces, half, before, drifts, keeps, kicks, kicked, together, done, me, threads):
    """Do the kicks of a block of steps, of which the last computes accelerations.

    A sweep does several kicks, as many as `together`; this thread, number `me`, does every `threads`-th sweep.  Kicks cycle
    through the stages of a step, each followed by its drift.  `done` counts the finished runs of each sweep, a cache line each.

    Returns
    -------
    wide : bool
        Whether a bond was beyond all laws.
    largest, fastest : float
        Largest components of displacement and velocity after the last step.
    """
    count, last, wide, largest, fastest = len(runs), len(forces), False, 0.0, 0.0
    none, one = drifts[0] - drifts[0], drifts[0] / drifts[0]  # in the precision of the others
    for sweep in range(me, (last + together - 1) // together, threads):
        lowest = 1 + sweep * together
        above, bottom = min(lowest + together, last + 1), lowest - (kicked and sweep == 0)
        behind = (above - bottom - 1) * lag
        for m in range(count + behind):
            if sweep > 0:
                wait(done, LINE * (sweep - 1), min(m + lag + 1, count))
            for n in range(bottom, above):
                r = m - (n - bottom) * lag
                if r < 0 or r >= count:
                    continue
                s, e, ends = runs[r, 0], runs[r, 1], n == last
                if n == 0:
                    start(state, work, slots, turns, s, e, half, drifts[0])
                    continue
                for j in range(within[r], within[r + 1]):
                    i, k, kind = segments[j, 0], segments[j, 1], segments[j, 2]
                    wide |= pull_by(law, wider, widest, work, b, bonds, near, far, places, pad, kind, i, k)
                stage = (n - 1) % len(keeps)
                v, row, keep, kick, drift = ((2, FORGET, one, one, none) if ends else
                                             (1, CARRY, keeps[stage], kicks[stage], drifts[1 + stage]))
                move(work, b, places, pad, slots, turns, outer.springs, outer.static, v, row, s, e, keep, kick, drift)
                correct(work, slots, turns, outer, forces[n - 1], v, row, r, kick, drift)
                if ends and kicked:
                    x, y = finish(work, slots, turns, s, e, half, before)
                    largest, fastest = max(largest, x), max(fastest, y)
            tell(done, LINE * sweep, m + 1 - behind)
    return wide, largest, fastest


# --- the order of bonds ------------------------------------------------------------------------------------------------------


class Order(NamedTuple):
    """The order in which bonds are evaluated.

    Attributes
    ----------
    runs : ndarray of int, shape (runs, 2)
        First and last + 1 slot of each run.
    segments, within : ndarray of int, shapes (segments, 3) and (runs + 1,)
        Segments of bonds evaluated together: first and last + 1 slot, and group; in a table, first and last + 1 bond, and kind.
        `within` holds the first segment of each run.
    reach : ndarray of int, shape (runs,)
        The highest slot at which a bond of the run ends, + 1.
    near, far : ndarray of int, or None
        In a table, lower and upper slot of each bond.
    places, pad : tuple, int
        See `total` and `grid_pull`.
    room : tuple of int
        Shape of the forces of bonds.
    along : callable
        Lays values of the bonds, shape (..., bonds), out in this order: (..., groups, slots) or (..., bonds).
    R : ndarray, shape (2, kinds) or (2, bonds)
        Rest vectors.
    """

    runs: np.ndarray
    segments: np.ndarray
    within: np.ndarray
    reach: np.ndarray
    near: np.ndarray | None
    far: np.ndarray | None
    places: tuple[Any, ...]
    pad: int
    room: tuple[int, ...]
    along: Any
    R: np.ndarray


class CompiledKernel:
    """Advances displacements and velocities by blocks of time steps, whose work is divided among `threads`.

    Parameters
    ----------
    layout : Layout
    increments : Increments
        Laws of the kinds of bonds.
    motion : Motion
    coefficients : ndarray, shape (kinds, coefficients), or list of Pieces
        Coefficients of the polynomials in the increment, or the pieces of the law of each kind.
    reach : float
        Largest increment |e| for which the polynomials are valid.
    threads, dtype : int, type
        It computes in single precision if `dtype` is np.float32.
    """

    def __init__(self, layout: Layout, increments: Increments, motion: Motion, coefficients: NDArray[np.float64] | list[Pieces],
                 reach: float, threads: int = 1, dtype: Any = np.float64) -> None:
        self.dtype = dtype
        self.layout, self.increments, self.motion, self.reach, self.threads = layout, increments, motion, reach, threads
        d, b, (drifts, damped) = motion.decay, motion.splitting.kicks, motion.splitting.flow(motion.dt, motion.rate)
        self.half, self.before, self.drifts = b[0] * motion.dt, damped[-1], np.roll(drifts, -1)  # the one that follows each kick
        self.first, merged = drifts[0], (*b[1:-1], b[-1] + b[0])
        self.keeps, self.kicks = damped, np.array(merged) * motion.dt
        self.carry, self.push, self.forget = d**2, (1 + d**2) / 2 * motion.mobility, np.zeros(len(d))
        self._prepare(coefficients)

    def _prepare(self, fitted):
        layout, m, law, dtype = self.layout, self.motion, self.increments, self.dtype
        run = RUN if dtype is np.float64 else layout.length if layout.length <= AT_ONCE else 2 * RUN
        part = run if isinstance(fitted, np.ndarray) else min(PART, run)
        order = (_grid if layout.offset is not None else _table)(layout, run, part)
        own = layout.own_laws
        if isinstance(fitted, np.ndarray):
            laws = [self._law(fitted, self.reach, order)]
        else:
            laws = [self._law(fit[0], reach, order) for reach in NEARER if (fit := law.polynomial(reach))]
            laws = [*laws[:1], *(x for x in laws[1:] if x.c.ndim == 2), self._law(fitted, np.inf, order)]
        g, unit = law.g, 1 / layout.r0**2
        if own:
            g, unit = (_flat(order.along(x[layout.kind])) for x in (g, unit))
        elif dtype is np.float64:
            unit = None
        strength = None if layout.each or layout.strength is None else _flat(layout.strength)
        R = [_flat(x) for x in order.R] if layout.offset is None or own else order.R
        bonds = Bonds((dtype(law.q), dtype(law.t)), *(x if x is None else same(x, dtype) for x in (*R, g, unit, strength)))
        known = np.array([self.forget, m.mobility, m.decay, self.carry, self.push])
        slots, turns = same(known.real, dtype), same(known.imag, dtype) if np.iscomplexobj(known) else None
        self._flow = dtype(self.half), dtype(self.before), *(x.astype(dtype) for x in (np.append(self.first, self.drifts),
                                                                                      self.keeps, self.kicks))
        springs, static = (np.atleast_1d(np.asarray(x, float)) for x in (m.foundation, 0.0 if m.static is None else m.static))
        springs, static = (x if x.ndim == 1 else _flat(x) for x in (springs, static))
        guided = _by_run(m.guided, order, m.barred)
        outer = Outer(same(springs, dtype), same(static, dtype), *_by_run(m.driven, order, np.arange(len(m.driven))), guided[0],
                      guided[1].astype(dtype), guided[2])
        self._runs, self._room = order.runs, order.room
        self._lag = max(1, int((np.searchsorted(order.runs[:, 0], order.reach) - 1 - np.arange(len(order.runs))).max()))
        unsigned = (x.astype(np.uint64) for x in (order.runs, order.segments))
        self._given = (*unsigned, order.within, self._lag, bonds, *laws, *[None] * (3 - len(laws)), order.near, order.far,
                       order.places, np.uint64(order.pad), slots, turns, outer)
        self._rooms, self._pool = [self._new_room()], None

    def _new_room(self):
        """Memory of a thread for the forces of bonds."""
        return aligned_zeros(self._room, self.dtype)

    def _law(self, fitted, reach, order):
        """The law in compiled form, polynomials or pieces: one for each kind, or for each bond if bonds have their own laws."""
        layout, own, kinds = self.layout, self.layout.own_laws, range(len(order.places) if self.layout.offset is not None else 1)
        if isinstance(fitted, np.ndarray):
            count = (0.0,) * fitted.shape[1]
            if not own:
                r0 = layout.r0 if self.dtype is np.float64 else layout.r0**0  # single might not hold its powers
                c = fitted / r0[:, None] ** (2 + 2 * np.arange(len(count)))
                return Polynomial(count, c.astype(self.dtype), (reach * r0**2).astype(self.dtype), None)
            limit = np.full(len(kinds), reach, self.dtype)
            with np.errstate(divide='ignore', invalid='ignore'):  # of a law that is zero there, as far as numbers go
                shapes = fitted / fitted[:, :1]
            if (abs(shapes - shapes[0]) <= SAME_SHAPE * abs(shapes[0])).all():
                return Polynomial(count, shapes[[0 for _ in kinds]].astype(self.dtype), limit,
                                  same(_flat(order.along(fitted[layout.kind, 0])), self.dtype))
            each = order.along(fitted.T[:, layout.kind]).reshape(1, len(count), -1)
            return Polynomial(count, same(each, self.dtype), limit, None)
        r0 = np.ones(len(fitted)) if own else layout.r0
        roots = np.cumsum([0, *(len(p.child) for p in fitted)])[:-1]
        numbers = np.array([(p.per_increment / r**2, p.low, np.nextafter(p.high, 0)) for p, r in zip(fitted, r0, strict=True)]).T
        start, factors = roots - [p.first for p in fitted], None
        if own:
            alone, which, strength = self.increments.shapes
            every = len(fitted) == len(alone.r0)  # the pieces are those of all laws at strength 1, or else of the first kind
            factors, which = (strength, which) if every else (self.increments.factors, 0 * which)
            which = order.along(which[layout.kind].astype(float)).astype(int).reshape(1, -1)
            numbers, start, factors = numbers[:, which], start[which], _flat(order.along(factors[layout.kind]))
        c = np.concatenate([p.coefficients / r**2 for p, r in zip(fitted, r0, strict=True)])
        child, centre = (np.concatenate(x) for x in zip(*((np.where(p.child < 0, -1, p.child + root), p.centre)
                                                          for p, root in zip(fitted, roots, strict=True)), strict=True))
        return PiecesOfAll(*numbers, start, c, child if (child >= 0).any() else None, centre, factors)

    def advance(self, state: NDArray[np.float64], forces: NDArray[np.float64], out: NDArray[np.float64]) -> Found:
        """Fill `out` with displacements, velocities and accelerations after a block of steps; `state` stays as it is.

        Returns whether any bond left the range of the law on the way, and the largest components of displacement and velocity.

        Parameters
        ----------
        state, out : ndarray, shape (3, 2, slots)
        forces : ndarray, shape (steps * stages, driven, 2)
            External forces at all kicks except the first.
        """
        forces = forces.astype(self.dtype, copy=False)
        threads = max(1, min(self.threads, len(self._runs) // (2 * self._lag)))
        together = max(1, min(TOGETHER, len(self._runs) // (threads * self._lag + 1))) if threads > 1 else TOGETHER
        while len(self._rooms) < threads:
            self._rooms.append(self._new_room())
        done = np.zeros((-(-len(forces) // together), LINE), np.int64).ravel()

        def sweeps(me):
            return advance(state, out, self._rooms[me], *self._given, forces, *self._flow, True, together, done, me, threads)

        found = self._shared(sweeps, range(threads))
        return tuple(max(x) for x in zip(*found, strict=True))  # pyright: ignore[reportReturnType]  three of them

    def accelerate(self, state: NDArray[np.float64], force: NDArray[np.float64]) -> bool:
        """Fill in the accelerations: the velocities that a kick over unit time would give to particles at rest.

        Returns whether any bond is beyond the range of the law.
        """
        state[2] = 0
        force, done = force[None].astype(self.dtype, copy=False), np.zeros(1, np.int64)
        return advance(state, state, self._rooms[0], *self._given, force, *self._flow, False, 1, done, 0, 1)[0]

    def _shared(self, function, tasks):
        """Results of the tasks, the first of which is done by this thread."""
        if len(tasks) > 1 and self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads - 1)
        others = [self._pool.submit(function, task) for task in tasks[1:]]
        return [function(tasks[0]), *(other.result() for other in others)]


def _flat(x):
    """Values of each bond or slot in the shape that `at` expects."""
    flat = aligned_zeros((1, x.size))
    flat[0] = x.ravel()
    return flat


def _by_run(slots, order, values):
    """Slots in order, their values, and the first of each run."""
    by_slot = np.argsort(slots)
    first = np.searchsorted(slots[by_slot], order.runs[:, 0])
    return slots[by_slot].astype(np.uint64), values[by_slot], np.append(first, len(slots))


def _grid(layout, run, part):
    runs, highest, groups = layout.runs(gap=GAP, longest=run), layout.offset.max(), len(layout.offset)
    parts = layout.runs(gap=GAP, longest=part)
    segments = np.column_stack([np.repeat(parts, groups, axis=0), np.tile(np.arange(groups), len(parts))])
    within = groups * np.searchsorted(parts[:, 0], np.append(runs[:, 0], layout.length))
    pad = int(highest + -highest % LINE)
    stride = pad + layout.length + 3 * LINE  # rows of powers of two would fall onto the same lines of a cache
    return Order(runs, segments, within, runs[:, 1] + highest, None, None,
                 tuple(layout.offset.astype(np.uint64)), pad, (2, groups, stride), layout.on_grid,
                 layout.on_grid(layout.R.T) if layout.each else np.ascontiguousarray(layout.R.T))


def _table(layout, longest, part):
    """The `Order` of a table: bonds sorted by the part of a run that holds their lower slot, then by kind if laws are shared."""
    upwards = layout.i < layout.j
    i, j = np.where(upwards, layout.i, layout.j), np.where(upwards, layout.j, layout.i)
    R = np.where(upwards[:, None], layout.R, -layout.R)
    group = np.zeros_like(layout.kind) if layout.own_laws else layout.kind
    order = np.lexsort((j, i, group, i // part))
    i, j, R, run, group = i[order], j[order], R[order], i[order] // longest, group[order]
    starts = np.flatnonzero(np.diff(i // part, prepend=-1) | np.diff(group, prepend=-1))
    segments = np.column_stack([starts, np.append(starts[1:], len(i)), group[starts]])
    s = np.arange(0, layout.length, longest)
    runs = np.column_stack([s, np.minimum(s + longest, layout.length)])
    reach = runs[:, 1].copy()
    np.maximum.at(reach, run, j + 1)
    slots = np.concatenate([j, i])
    by_slot = np.argsort(slots, kind='stable')
    place = np.arange(len(slots)) - np.searchsorted(slots[by_slot], slots[by_slot])  # among the bonds of its slot
    ends = np.full((place.max(initial=0) + 1, layout.length), len(slots))  # at first of a bond of no force
    ends[place, slots[by_slot]] = by_slot
    near, far, ends = (x.astype(np.uint32) for x in (i, j, ends))
    return Order(runs, segments, np.searchsorted(run[starts], np.arange(len(s) + 1)), reach, near, far, tuple(ends), 0,
                 (2, 1, 2 * len(i) + 1), lambda values: np.ascontiguousarray(values[..., order]), R.T)
