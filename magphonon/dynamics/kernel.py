"""Stages of time steps on displacements from rest, compiled by numba for what a structure has.

A stage is a kick and the drift that follows it.  It goes over the slots in runs.  On a grid it first keeps the forces of the
bonds that lead to higher slots in h, a buffer of the last of them; then each slot sums the forces of its bonds from there.  Where
neighbours are looked up, each slot computes the forces of all of its bonds, and h is their sum.  A stage reads displacements u
and writes those after the drift into w; then u and w change places.  One thread on a grid takes u for both: no slot is read after
it has moved, and a second row would take a fifth of the time.

    F = load - k u + sum_bonds (W S + (g + 2 q W) du)     W = s e (c0 + c1 e + ...)      e = (S + q du).du
    v <- keep C v + kick P F        w <- u + drift v

This is the law of `bond_increments` with S = 2 R/r0^2, q = t/r0^2 and W = H r0^2/2, which take the fewest registers.  C and P are
the damping, the gyration and the mobility of each slot; P is zero for held particles.  Runs have
fixed borders, since what vector units leave over is rounded differently: results are the same bit by bit for any number of
threads, each of which has its own runs.

`piece` is written out as text for the types of its arguments: loops over the offsets of a grid, over coefficients and over
dimensions are unrolled, and what few structures have is left out of the code of the others.  Each of these types takes seconds to
compile, so they are few.  The text contains no literal numbers (`R + R` instead of `2 * R`), whose type would convert all others
to double precision.  Indices are unsigned, as numba checks signed ones for -1, which keeps loops out of vector units.
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
    """

    near: np.ndarray
    S: np.ndarray
    q: np.ndarray
    g: np.ndarray
    strength: np.ndarray | None


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


class Some(NamedTuple):
    """Some slots, and numbers of each.

    These are changes of velocities by unit kicks in mm/ms or places of walls in mm, shape (stages, slots, dim), or directions
    that are barred to guided particles, shape (1, slots, dim).
    """

    slots: np.ndarray
    values: np.ndarray


def bits(x):
    """The bits of x, which is not negative, as an integer: these sort like x, and vector units can compute their maximum."""


@overload(bits)
def _bits(x):
    if x == types.float32:
        return lambda x: np.float32(x).view(np.int32)
    return lambda x: np.float64(x).view(np.int64)


def piece(u, w, v, h, bonds, c, columns, terms, sites, row, keep, kick, drift, reach, lo, hi, base, own):
    """Do a stage for the slots from lo to hi, or only their bonds if they are not `own`; returns whether an increment is beyond
    the reach of the law.
    """


def there(kind):
    """Whether an argument of this type is not None."""
    return not isinstance(kind, types.NoneType)


def bond(axes, bonds, c, terms):
    """The lines of text that name what belongs to the column n, and those that compute the force p of its bond of the slot i."""
    near, S, *_, strength = bonds
    at, of_law = '[i]' * (S.ndim == 3), '[i]' * (c.ndim == 3)
    s = 's[i] * ' * there(strength)
    quotient = reduce(lambda higher, m: f'({higher} * e + c{m}{of_law})', reversed(range(terms - 1)), f'c{terms - 1}{of_law}')
    named = ['o, q, g = near[n], bonds.q[n], bonds.g[n]', *['s = bonds.strength[n]'] * there(strength),
             *(f'S{x} = bonds.S[{x}, n]' for x in axes), 'm = min(n, len(c[zero]) - 1)',
             *(f'c{m} = c[{m}, m]' for m in range(terms))]
    return named, [f'j = {"i + o" if near.ndim == 1 else "o[i]"}', *(f'd{x} = {s * (not at)}(u{x}[j] - x{x})' for x in axes),
                   f'e = {" + ".join(f"(S{x}{at} + q{at} * d{x}) * d{x}" for x in axes)}', f'W = {s * bool(at)}e * {quotient}',
                   f'G = g{at} + (q{at} + q{at}) * W', *(f'p{x} = W * S{x}{at} + G * d{x}' for x in axes),
                   'top = max(top, bits(abs(e)))']


def kicked(axes, turns):
    """The lines of text that kick and drift."""
    lines = [f'a{x} = keep * C[row, i] * v{x}[i] + kick * P[row, i] * f{x}' for x in axes]
    if turns:
        lines = ['cr, ci, pr, pi = keep * C[row, i], keep * T[0, row, i], kick * P[row, i], kick * T[1, row, i]',
                 'a0 = cr * v0[i] - ci * v1[i] + (pr * f0 - pi * f1)', 'a1 = cr * v1[i] + ci * v0[i] + (pr * f1 + pi * f0)']
    return [*lines, *(f'v{x}[i] = a{x}; w{x}[i] = x{x} + drift * a{x}' for x in axes)]


def over_slots(*lines):
    """The loop of text that runs these lines for each slot i."""
    return ['for i in range(lo, hi):', *(f'    {line}' for line in lines)]


def bond_by_bond(axes, grid, here, on_site, pulls):
    """The lines of text that keep the forces of bonds in h: of each column on a grid; else their sum, with that of the site."""
    named, computed = pulls
    start = [] if grid else over_slots(here, *on_site, *(f'h[zero, {x}, i - base] = f{x}' for x in axes))
    named = named + [f'h{x} = h[{"n" if grid else "zero"}, {x}]' for x in axes]
    column = named + over_slots(here, *computed, *(f'h{x}[i - base] {"-" * (not grid)}= p{x}' for x in axes))
    end = ['if not own:', '    return top > bits(reach)'] * grid
    return [*start, 'for n in range(len(near)):', *(f'    {line}' for line in column), *end]


def summed(axes, columns, on_site):
    """The lines of text that sum the forces on a slot: on a grid each column leads to it and away from it."""
    if not columns:
        return [f'f{x} = h[zero, {x}, i - base]' for x in axes]
    kept_at = 'h[{0}, {1}, i - base - near[{0}]] - h[{0}, {1}, i - base]'.format
    return on_site + [f'f{x} += {kept_at(n, x)}' for n in range(columns) for x in axes]


@overload(piece, jit_options=FAST)
def _piece(u, w, v, h, bonds, c, columns, terms, sites, row, keep, kick, drift, reach, lo, hi, base, own):
    axes, grid, loaded, turns = range(len(u)), len(columns) > 0, there(sites.types[1]), there(sites.types[4])
    here = '; '.join(f'x{x} = u{x}[i]' for x in axes)
    on_site = [f'f{x} = {f"l[{x}, i] " * loaded}-k[{x}, i] * x{x}' for x in axes]
    names = ['near = bonds.near', 'k, l, C, P, T = sites', *(f'{y}{x} = {y}[{x}]' for y in 'uwv' for x in axes),
             'zero = lo - lo', 'none = drift - drift', 'top = bits(none)']
    forces = bond_by_bond(axes, grid, here, on_site, bond(axes, bonds.types, c, len(terms)))
    moved = over_slots(here, *summed(axes, len(columns), on_site), *kicked(axes, turns))
    arguments = 'u, w, v, h, bonds, c, columns, terms, sites, row, keep, kick, drift, reach, lo, hi, base, own'
    text = '\n    '.join([f'def piece({arguments}):', 'vectorise()', *names, *forces, *moved, 'return top > bits(reach)'])
    return written_out(text, 'piece', vectorise=vectorise, bits=bits)


@njit(no_cpython_wrapper=True, **OPTIONS)
def correct(u, w, v, kick, drift, n, pushed, guided, led):
    """Push driven particles in the stage n, take from guided ones what is barred, and move the walls."""
    for m in range(len(pushed.slots)):
        i = pushed.slots[m]
        for x in range(len(u)):
            change = kick * pushed.values[n, m, x]
            v[x][i] += change
            w[x][i] += drift * change
    for m in range(len(guided.slots)):
        i, barred, along = guided.slots[m], guided.values[0, m], drift - drift
        for x in range(len(u)):
            along += barred[x] * v[x][i]
        for x in range(len(u)):
            v[x][i] -= along * barred[x]
            w[x][i] -= drift * (along * barred[x])
    for m in range(len(led.slots)):
        for x in range(len(u)):
            w[x][led.slots[m]] = led.values[n, m, x]


@njit(no_cpython_wrapper=True, **OPTIONS)
def first_run(runs, part, pad):
    """The run from which on forces are needed for the runs from part[0] on: bonds come from slots up to `pad` before."""
    start = part[0]
    while 0 < start < part[1] and runs[start - 1, 1] + pad > runs[part[0], 0]:
        start -= 1
    return start


@njit(no_cpython_wrapper=True, **OPTIONS)
def to_the_front(h, pad, lo, end, base, zero):
    """Move the last forces before the slot `lo` to the front of h, which begins at `base`; from a gap after `end` come none."""
    for k in range(h.shape[0]):
        for x in range(h.shape[1]):
            for m in range(pad):
                h[k, x, m] = h[k, x, m + lo - pad - base] if m + lo < end + pad else zero
    return lo - pad


@kept(**OPTIONS)
def stages(u, w, v, h, bonds, c, columns, terms, sites, flow, reach, runs, part, pad, pushed, guided, led, some, whole):
    """Do the stages from some[0] to some[1] of a block, for the runs from part[0] to part[1]; then `correct` if these are all.

    Returns whether an increment was beyond the reach of the law.  Stages of even numbers leave displacements in w, others in u.
    """
    beyond, start = False, first_run(runs, part, pad)
    if some[0] % 2:
        u, w = w, u
    for n in range(some[0], some[1]):
        keep, kick, drift = flow[n, 0], flow[n, 1], flow[n, 2]
        row = np.uint64((n > 0) + (n == len(flow) - 1))
        base, end = runs[start, 0] - pad, runs[start, 0]
        h[:, :, :pad] = reach - reach
        for p in range(start, part[1]):
            lo, hi = runs[p, 0], runs[p, 1]
            if lo > end or hi - base > h.shape[2]:
                base = to_the_front(h, pad, lo, end, base, reach - reach)
            end = hi
            own = p >= part[0]
            beyond |= piece(u, w, v, h, bonds, c, columns, terms, sites, row, keep, kick, drift, reach, lo, hi, base, own)
        if whole:
            correct(u, w, v, kick, drift, n, pushed, guided, led)
        u, w = w, u
    return beyond
