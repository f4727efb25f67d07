"""Stages of time steps on displacements from rest, compiled by numba for what a structure has.

A stage is a kick and the drift that follows it.  It goes over the slots in runs.  On a grid it first keeps the forces of the
bonds that lead to higher slots in h, a buffer of the last of them; then each slot sums the forces of its bonds from there.  Where
neighbours are looked up, each slot computes the forces of all of its bonds.  A stage reads displacements u and writes those after
the drift into w; then u and w change places.  One thread on a grid takes u for both: no slot is read after it has moved.

    F = h - k u + sum_bonds s (H R + (g + t H) du)        H = e (c0 + c1 e + ...)        e = (2 R.du + t |du|^2)/r0^2
    v <- keep C v + kick P F        w <- u + drift v

C and P are the damping, the gyration and the mobility of each slot, and zero for held particles; t is one in the complete model,
else zero.  Runs have fixed borders, since what vector units leave over is rounded differently: results are the same bit by bit
for any number of threads, each of which has its own runs.

`piece` is written out as text for the types of its arguments, so that whatever a structure lacks is left out, and all loops over
bonds, coefficients and dimensions are unrolled.  It contains no literal numbers (`R + R` instead of `2 * R`), whose type would
convert all others to double precision.  Indices are unsigned, as numba checks signed ones for -1, which keeps loops out of vector
units.
"""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING, NamedTuple
from warnings import warn

import numpy as np
from numba import njit, types
from numba.core.options import DefaultOptions
from numba.extending import intrinsic, overload

if TYPE_CHECKING:
    from typing import Any

COUNTED = {'_nrt': False} if hasattr(DefaultOptions, '_nrt') else {}
"""An internal option of numba that switches off reference counts of arrays, which take longer than a short run of slots."""
OPTIONS = {'error_model': 'numpy', 'fastmath': {'contract'}, 'nogil': True, 'no_cfunc_wrapper': True, **COUNTED}
FAST = {'error_model': 'numpy', 'fastmath': {'contract', 'reassoc', 'nsz'}, 'forceinline': False, **COUNTED}


# --- compiling -----------------------------------------------------------------------------------------------------------


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


def written_out(text, name, **names):
    """The function `name` of a text, which is written out for what is known from types, such as a number of terms."""
    exec(text, names)  # noqa: S102  of nothing but numbers of terms
    return names[name]


@kept
def smallest(x):
    """The smallest kernel, by which it is tried whether kernels can be compiled."""
    return x


# --- the steps -----------------------------------------------------------------------------------------------------------


class Bonds(NamedTuple):
    """Bonds in columns, of which each slot has one bond.

    Attributes
    ----------
    near : tuple of uint64, or of ndarray of uint32, shape (slots,)
        For each column the offset of the higher neighbour of every slot, or the slot of any neighbour.
    R : tuple of ndarray
        Components of the rest vectors in mm: shape (columns,), or (columns, slots) if each bond has its own.
    unit, g : ndarray
        1/r0^2, and the static force by length where it turns with the bond, in the same shape.
    strength : ndarray, shape (columns, slots), or None
        Factors of the law of each bond; or if the bonds of a column are alike, 0 where one is missing and 1 elsewhere.
    complete : tuple of None, or empty
        Not empty for the complete model.
    """

    near: tuple
    R: tuple
    unit: np.ndarray
    g: np.ndarray
    strength: np.ndarray | None
    complete: tuple


class Sites(NamedTuple):
    """What acts on slots.

    Attributes
    ----------
    k : tuple of float, or of ndarray, shape (slots,)
        Springs along each axis in N/mm.
    load : tuple of ndarray, shape (slots,), or None
        Static forces in N.
    decay : ndarray, shape (3, slots), or None
        Factors of velocities in the first, the others and the last stage of a block; None if all slots have the same.
    push : ndarray, shape (3, slots), or (1, slots)
        Velocities of unit kicks in 1/g.
    turns : pair of ndarray, shape (3, slots), or None
        Imaginary parts of `decay` and `push`, where velocities v_x + i v_y turn.
    """

    k: tuple
    load: tuple | None
    decay: np.ndarray | None
    push: np.ndarray
    turns: tuple | None


class Some(NamedTuple):
    """Slots in ascending order, of which each thread has those from first[me] on, and numbers of each slot.

    These are changes of velocities by unit kicks in mm/ms or places of walls in mm, shape (stages, slots, dim), or directions
    that are barred to guided particles, shape (1, slots, dim).
    """

    slots: np.ndarray
    first: np.ndarray
    values: np.ndarray


def bits(x):
    """The bits of x, which is not negative, as an integer: these sort like x, and vector units can compute their maximum."""


@overload(bits)
def _bits(x):
    if x == types.float32:
        return lambda x: np.float32(x).view(np.int32)
    return lambda x: np.float64(x).view(np.int64)


def piece(u, w, v, h, bonds, c, sites, row, keep, kick, drift, reach, lo, hi, base, own):
    """Do a stage for the slots from lo to hi, or only their bonds if they are not `own`; returns whether an increment is beyond
    the reach of the law.
    """


def there(kind):
    """Whether an argument of this type is not None."""
    return not isinstance(kind, types.NoneType)


def bond(n, axes, bonds, c):
    """The lines of text that compute the force p of the bond of column n, for these types of arguments."""
    near, R, _, _, strength, complete = bonds
    each, listed = R[0].ndim == 2, isinstance(near[0], types.Array)
    place = f'[{n}, i]'
    at = place if each else f'[{n}]'
    s = f's{place} * ' * there(strength)
    law = [f'c{q}' + at * isinstance(one, types.Array) for q, one in enumerate(c)]
    quotient = reduce(lambda higher, one: f'({higher} * e + {one})', law[::-1])
    squares = [f'(R{x}{at} + R{x}{at}{f" + d{x}" * len(complete)}) * d{x}' for x in axes]
    return [f'j = near[{n}][i]' if listed else f'j = i + near[{n}]', *(f'd{x} = {s * (not each)}(u{x}[j] - x{x})' for x in axes),
            f'e = unit{at} * ({" + ".join(squares)})', f'H = {s * each}e * {quotient}',
            *(f'p{x} = H * R{x}{at}{f" + (g{at} + H) * d{x}" * len(complete)}' for x in axes)]


def kicked(axes, sites):
    """The lines of text that kick and drift, for these types of arguments."""
    *_, decay, _, turns = sites
    if there(turns):
        lines = ['cr, ci, pr, pi = keep * C[row, i], keep * T[0][row, i], kick * P[row, i], kick * T[1][row, i]',
                 'a0 = cr * v0[i] - ci * v1[i] + (pr * f0 - pi * f1)', 'a1 = cr * v1[i] + ci * v0[i] + (pr * f1 + pi * f0)']
    else:
        damping = 'keep * C[row, i]' if there(decay) else 'keep'
        lines = [f'a{x} = {damping} * v{x}[i] + kick * P[row, i] * f{x}' for x in axes]
    return [*lines, *(f'v{x}[i] = a{x}; w{x}[i] = x{x} + drift * a{x}' for x in axes)]


def named(axes, c, sites):
    """The lines of text that name the parts of the arguments, for these types of arguments."""
    def parts(letter, numbers):
        return f'{"".join(f"{letter}{x}, " for x in numbers)} = {letter}'

    return ['near, R, unit, g, s, _ = bonds', 'k, l, C, P, T = sites', parts('c', range(len(c))),
            *(parts(letter, axes) for letter in 'uwvRk' + 'l' * there(sites[1])), 'none = drift - drift', 'top = bits(none)']


def over_slots(lines):
    """The loop of text that runs these lines for each slot i."""
    return ['for i in range(lo, hi):', *(f'    {line}' for line in lines)]


def looked_up(columns, axes, bonds, c):
    """The lines of text that add the forces of all bonds of a slot, whose neighbours are looked up."""
    pulled = [f'f{x} -= p{x}' for x in axes]
    each = [line for n in columns for line in (*bond(n, axes, bonds, c), 'far = max(far, abs(e))', *pulled)]
    return ['far = none', *each, 'top = max(top, bits(far))']


@overload(piece, jit_options=FAST)
def _piece(u, w, v, h, bonds, c, sites, row, keep, kick, drift, reach, lo, hi, base, own):
    bonds, sites = bonds.types, sites.types
    axes, columns = range(len(u)), range(len(bonds[0]))
    load, spring = 'l{0}[i] ' * there(sites[1]), '-k{0}' + '[i]' * isinstance(sites[0][0], types.Array)
    here, kept = '; '.join(f'x{x} = u{x}[i]' for x in axes), []
    pulled = looked_up(columns, axes, bonds, c)
    if not isinstance(bonds[0][0], types.Array):  # on a grid the force of a bond is kept for its far end
        for n in columns:
            kept += over_slots([here, *bond(n, axes, bonds, c), *(f'h[{n}, {x}, i - base] = p{x}' for x in axes),
                                'top = max(top, bits(abs(e)))'])
        kept += ['if not own:', '    return top > bits(reach)']
        pulled = [f'f{x} += h[{n}, {x}, i - base - near[{n}]] - h[{n}, {x}, i - base]' for n in columns for x in axes]
    body = [here, *(f'f{x} = {load.format(x)}{spring.format(x)} * x{x}' for x in axes), *pulled, *kicked(axes, sites)]
    text = '\n    '.join(['def piece(u, w, v, h, bonds, c, sites, row, keep, kick, drift, reach, lo, hi, base, own):',
                          'vectorise()', *named(axes, c, sites), *kept, *over_slots(body), 'return top > bits(reach)'])
    return written_out(text, 'piece', vectorise=vectorise, bits=bits)


@njit(no_cpython_wrapper=True, **OPTIONS)
def sweep(u, w, v, h, bonds, c, sites, row, keep, kick, drift, reach, runs, first, last, pad):
    """Do a stage for the runs from `first` to `last`; returns whether an increment was beyond the reach of the law."""
    beyond, start = False, first
    while start > 0 and runs[start - 1, 1] + pad > runs[first, 0]:  # bonds that come from slots before
        start -= 1
    base, end = runs[start, 0] - pad, runs[start, 0]
    h[:, :, :pad] = reach - reach
    for p in range(start, last):
        lo, hi = runs[p, 0], runs[p, 1]
        if lo > end or hi - base > h.shape[2]:  # the last forces move to the front; from a gap come none
            for k in range(len(h)):
                for x in range(len(u)):
                    for m in range(pad):
                        h[k, x, m] = h[k, x, m + lo - pad - base] if m + lo < end + pad else reach - reach
            base = lo - pad
        end = hi
        beyond |= piece(u, w, v, h, bonds, c, sites, row, keep, kick, drift, reach, lo, hi, base, p >= first)
    return beyond


@njit(no_cpython_wrapper=True, **OPTIONS)
def correct(u, w, v, kick, drift, n, pushed, guided, led, me):
    """Push driven particles in the stage n, take from guided ones what is barred, and move the walls."""
    for m in range(pushed.first[me], pushed.first[me + 1]):
        i = pushed.slots[m]
        for x in range(len(u)):
            change = kick * pushed.values[n, m, x]
            v[x][i] += change
            w[x][i] += drift * change
    for m in range(guided.first[me], guided.first[me + 1]):
        i, barred, along = guided.slots[m], guided.values[0, m], drift - drift
        for x in range(len(u)):
            along += barred[x] * v[x][i]
        for x in range(len(u)):
            v[x][i] -= along * barred[x]
            w[x][i] -= drift * (along * barred[x])
    for m in range(led.first[me], led.first[me + 1]):
        for x in range(len(u)):
            w[x][led.slots[m]] = led.values[n, m, x]


@kept
def stages(u, w, v, h, bonds, c, sites, flow, rows, reach, runs, parts, pad, pushed, guided, led, me, some):
    """Do some stages of a block, from some[0] to some[1], for the runs of a thread `me`.

    Returns whether an increment was beyond the reach of the law.  Stages of even numbers leave displacements in w, others in u.
    """
    beyond = False
    if some[0] % 2:
        u, w = w, u
    for n in range(some[0], some[1]):
        keep, kick, drift = flow[n, 0], flow[n, 1], flow[n, 2]
        beyond |= sweep(u, w, v, h, bonds, c, sites, rows[n], keep, kick, drift, reach, runs, parts[me], parts[me + 1], pad)
        correct(u, w, v, kick, drift, n, pushed, guided, led, me)
        u, w = w, u
    return beyond
