"""Stages of time steps on displacements from rest, compiled by numba for what a structure has.

A stage is a kick and the drift that follows it.  It goes over the slots in runs, and in a run over the columns of bonds.  On a
grid the bonds of a column lead to slots at a constant offset above: each is evaluated once, and its force is added to h at both
ends, at the far end in a second loop, because two slots must not write to one place in vector units.  Where neighbours are looked
up, each slot evaluates all of its bonds.  Then all forces on the slots of the run are known, and it moves.  A stage reads
displacements u and writes those after the drift into w; then u and w change places.  One thread on a grid takes u for both: no
slot is read after it has moved, and a second row would take a fifth of the time.

    F = load - k u + sum_bonds (W S + (g + 2 q W) du)     W = s e (c0 + c1 e + ...)      e = (S + q du).du
    v <- keep C v + kick P F        w <- u + drift v

This is the law of `bond_increments` with S = 2 R/r0^2, q = t/r0^2 and W = H r0^2/2, which take the fewest registers.  C and P are
the damping, the gyration and the mobility of each slot; P is zero for held particles.  Runs have
fixed borders, since what vector units leave over is rounded differently: results are the same bit by bit for any number of
threads, each of which has its own runs, and evaluates the bonds that lead into them from the runs before.

`piece` is written out as text for the types of its arguments: loops over coefficients and dimensions are unrolled, and what few
structures have is left out of the code of the others.  Each of these types takes seconds to compile, so they are few.  The text
contains no literal numbers (`R + R` instead of `2 * R`), whose type would convert all others to double precision.  Indices are
unsigned, as numba checks signed ones for -1, which keeps loops out of vector units.
"""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple
from warnings import warn

import numpy as np

try:
    from numba import config, njit, types
    from numba.core.options import DefaultOptions
    from numba.extending import intrinsic, overload

    from ..lattices.cells import kept

    if config.DISABLE_JIT:  # pyright: ignore[reportAttributeAccessIssue]  numba sets it from the environment
        raise ImportError('NUMBA_DISABLE_JIT is set')
except ImportError as lack:
    raise ImportError(f"{lack}, but long runs and large structures need compiled code; mend this, or use engine='ase'") from lack
COUNTED = {'_nrt': False} if hasattr(DefaultOptions, '_nrt') else {}
"""An internal option of numba that switches off reference counts of arrays, which take longer than a short run of slots."""
OPTIONS = {'error_model': 'numpy', 'fastmath': {'contract'}, 'nogil': True, 'no_cfunc_wrapper': True, **COUNTED}
FAST = {'error_model': 'numpy', 'fastmath': {'contract', 'reassoc', 'nsz'}, 'no_cpython_wrapper': True, 'no_cfunc_wrapper': True,
        **COUNTED}


# --- compiling -----------------------------------------------------------------------------------------------------------


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


# --- the steps -----------------------------------------------------------------------------------------------------------


class Bonds(NamedTuple):
    """Bonds in columns, of which each slot has one bond.

    Attributes
    ----------
    near : ndarray of uint64, shape (columns,), or of uint32, shape (columns, slots)
        For each column the offset of the higher neighbour of every slot, or the slot of any neighbour.
    S : ndarray, shape (dim, columns)
        Rest vectors times 2/r0^2; (dim, columns, slots) if each bond has its own.
    q, g : ndarray, shape (columns,)
        1/r0^2 and the static force by length, both zero where bonds do not turn; (columns, slots) if each bond has its own.
    strength : ndarray, shape (columns, slots), or None
        Factors of the law of each bond; or if the bonds of a column are alike, 0 where one is missing and 1 elsewhere.
    c : tuple of ndarray, shape (columns,)
        Coefficients of the law; (columns, slots) if each bond has its own.
    """

    near: np.ndarray
    S: np.ndarray
    q: np.ndarray
    g: np.ndarray
    strength: np.ndarray | None
    c: tuple[np.ndarray, ...] = ()


class Sites(NamedTuple):
    """What acts on slots.

    Attributes
    ----------
    k : ndarray, shape (dim, slots)
        Springs along each axis in N/mm.
    load : ndarray, shape (dim, slots), or None
        Static forces in N.
    decay, push : ndarray, shape (3, slots)
        Factors of velocities, and velocities of unit kicks in 1/g, in the first, the others and the last stage of a block.
    turns : ndarray, shape (2, 3, slots), or None
        Imaginary parts of `decay` and `push`, where velocities v_x + i v_y turn.
    """

    k: np.ndarray
    load: np.ndarray | None
    decay: np.ndarray
    push: np.ndarray
    turns: np.ndarray | None


def bits(x):
    """The bits of x, which is not negative, as an integer: these sort like x, and vector units can compute their maximum."""


@overload(bits)
def _bits(x):
    if x == types.float32:
        return lambda x: np.float32(x).view(np.int32)
    return lambda x: np.float64(x).view(np.int64)


def piece(u, w, v, h, r, bonds, sites, flow, row, reach, lo, hi, own):
    """Evaluate the bonds of the slots from lo to hi, and move these slots if they are `own`; returns whether an increment is
    beyond the reach of the law.
    """


def there(kind):
    """Whether an argument of this type is not None."""
    return not isinstance(kind, types.NoneType)


def over_slots(*lines):
    """The loop of text that runs these lines for each slot i."""
    return ['for i in range(lo, hi):', *(f'    {line}' for line in lines)]


def column(axes, bonds):
    """The lines of text that add the forces of the bonds of the column n to h, for these types of arrays."""
    near, S, _, _, strength, c = bonds
    at, of_law = '[i]' * (S.ndim == 3), '[i]' * (c[0].ndim == 2)
    s = 's[i] * ' * there(strength)
    quotient = reduce(lambda higher, m: f'({higher} * e + c{m}{of_law})', reversed(range(len(c) - 1)), f'c{len(c) - 1}{of_law}')
    named = ['o, q, g = near[n], bonds.q[n], bonds.g[n]', *['s = bonds.strength[n]'] * there(strength),
             *(f'S{x} = bonds.S[{x}, n]' for x in axes), *(f'c{m} = bonds.c[{m}][n]' for m in range(len(c)))]
    pull = [f'j = {"i + o" if near.ndim == 1 else "o[i]"}', *(f'd{x} = {s * (not at)}(u{x}[j] - u{x}[i])' for x in axes),
            f'e = {" + ".join(f"(S{x}{at} + q{at} * d{x}) * d{x}" for x in axes)}', f'W = {s * bool(at)}e * {quotient}',
            f'G = g{at} + (q{at} + q{at}) * W', 'top = max(top, bits(abs(e)))',
            *(f'p{x} = W * S{x}{at} + G * d{x}; h{x}[i] -= p{x}' for x in axes)]
    if near.ndim == 2:
        return named + over_slots(*pull)
    return [*named, *over_slots(*pull, *(f'r{x}[i - lo] = p{x}' for x in axes)),
            *over_slots(*(f'h{x}[i + o] += r{x}[i - lo]' for x in axes))]


def moved(axes, loaded, turns):
    """The lines of text that kick and drift, and leave no forces behind."""
    lines = [f'f{x} = h{x}[i] {f"+ l[{x}, i] " * loaded}- k[{x}, i] * u{x}[i]; h{x}[i] = none' for x in axes]
    if turns:
        lines += ['cr, ci, pr, pi = keep * C[row, i], keep * T[0, row, i], kick * P[row, i], kick * T[1, row, i]',
                  'a0 = cr * v0[i] - ci * v1[i] + (pr * f0 - pi * f1)', 'a1 = cr * v1[i] + ci * v0[i] + (pr * f1 + pi * f0)']
    else:
        lines += [f'a{x} = keep * C[row, i] * v{x}[i] + kick * P[row, i] * f{x}' for x in axes]
    return over_slots(*lines, *(f'v{x}[i] = a{x}; w{x}[i] = u{x}[i] + drift * a{x}' for x in axes))


@overload(piece, jit_options=FAST)
def _piece(u, w, v, h, r, bonds, sites, flow, row, reach, lo, hi, own):
    axes, (_, load, _, _, turns) = range(len(u)), sites.types
    lines = ['vectorise()', 'k, l, C, P, T = sites', 'keep, kick, drift = flow', 'near = bonds.near',
             *(f'{y}{x} = {y}[{x}]' for y in 'uwvhr' for x in axes), 'none = drift - drift', 'top = bits(none)',
             'for n in range(len(near)):', *(f'    {line}' for line in column(axes, bonds.types)),
             'if own:', *(f'    {line}' for line in moved(axes, there(load), there(turns))), 'return top > bits(reach)']
    text = '\n    '.join(['def piece(u, w, v, h, r, bonds, sites, flow, row, reach, lo, hi, own):', *lines])
    return written_out(text, 'piece', vectorise=vectorise, bits=bits)


@njit(no_cpython_wrapper=True, **OPTIONS)
def correct(u, w, v, kick, drift, n, lo, hi, pushed, guided, led):
    """Push driven particles in the stage n, take from guided ones what is barred, and move the walls, in the slots from lo to hi.

    Each are slots and numbers of theirs: changes of velocities by unit kicks in mm/ms and places of walls in mm, shape (stages,
    slots, dim), and barred directions, shape (1, slots, dim).
    """
    (slots, changes), (rails, barred), (walls, places) = pushed, guided, led
    for m in range(len(slots)):
        for x in range(len(u) * (lo <= slots[m] < hi)):
            change = kick * changes[n, m, x]
            v[x][slots[m]] += change
            w[x][slots[m]] += drift * change
    for m in range(len(rails)):
        if lo <= rails[m] < hi:
            along = drift - drift
            for x in range(len(u)):
                along += barred[0, m, x] * v[x][rails[m]]
            for x in range(len(u)):
                v[x][rails[m]] -= along * barred[0, m, x]
                w[x][rails[m]] -= drift * (along * barred[0, m, x])
    for m in range(len(walls)):
        for x in range(len(u) * (lo <= walls[m] < hi)):
            w[x][walls[m]] = places[n, m, x]


@kept(**OPTIONS)
def stages(u, w, v, h, r, bonds, sites, flow, reach, runs, part, pushed, guided, led, some):
    """Do the stages some[0] to some[1] of a block in the runs part[1] to part[2], into which bonds lead from part[0] on.

    Returns whether an increment was beyond the reach of the law.  Stages of even numbers leave displacements in w, others in u.
    """
    beyond = False
    if some[0] % 2:
        u, w = w, u
    for n in range(some[0], some[1]):
        now, row = (flow[n, 0], flow[n, 1], flow[n, 2]), np.uint64((n > 0) + (n == len(flow) - 1))
        for p in range(part[0], part[2]):
            beyond |= piece(u, w, v, h, r, bonds, sites, now, row, reach, runs[p, 0], runs[p, 1], p >= part[1])
        correct(u, w, v, now[1], now[2], n, runs[part[1], 0], runs[part[2] - 1, 1], pushed, guided, led)
        u, w = w, u
    return beyond
