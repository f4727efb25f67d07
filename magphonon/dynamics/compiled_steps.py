"""The steps of `magphonon.dynamics.kernels_numpy`, compiled.

A block of steps is taken level by level: the start of the block is level 0, each step a level, and the last one computes the
accelerations.  The slots are treated in runs that fit the first-level cache.  Each bond is evaluated once, with the run that
holds its lower slot; then the slots of the run gather the forces of their bonds and move on, in place: no later bond needs
their old displacements, because bonds lead upwards.

For the same reason a level may follow the one before it at a distance: it may take a run as soon as the one before is past all
slots to which the bonds of this run reach.  So some levels, a chunk, go over the slots together, one behind the other, while
these are in the cache, and chunks of levels go to threads, each of which follows the one before it.  Whatever the chunks and
threads, the same operations act on a slot in the same order: the bits are the same.
"""

from functools import cache

from numba import types

from .compiled_bonds import larger, pull_at
from .intrinsics import floats, higher, indices, ints, leave_core, magnitude, order, past, seen, show, vectorise
from .machine_code import FLOATS, INTS, caller, compiled, part

SPINS = 1000
"""Looks at another thread's progress after which a waiting thread leaves its core to others."""
FAR = 16
"""Integers from one counter to the next: in two cache lines, which processors fetch together, there is one counter."""

# --- what moves the slots of a run ------------------------------------------------------------------------------------

MOVE = types.void(INTS, *[FLOATS] * 8, *[types.int64] * 4, types.float64)
"""Signature: given, ux, uy, vx, vy, bx, by, carry, push, first and last + 1 slot, place of slot 0, stride, dt."""
move_at = caller(MOVE)
SIZES, SPRINGS, STATIC, PLACES = range(4)
"""Places in the table of addresses that is given to the motion.

SIZES      number of slots
SPRINGS    the stiffness of the foundation, or of each slot, (2, slots)
STATIC     static forces, (2, slots)
PLACES     of a grid, j - i of each group of bonds; of a table, places in b of the forces on each slot, (columns, slots)
"""


@cache
def _outer_force(springs, loaded):
    """The static force on slot i, less that of its spring."""

    @part
    def outer_force(given, ux, uy, i):
        k, static, length = floats(given, SPRINGS), floats(given, STATIC), ints(given, SIZES)[0]
        kx, ky = (k[i], k[length + i]) if springs else (k[0], k[0])
        sx, sy = (static[i], static[length + i]) if loaded else (0.0, 0.0)
        return sx, sy, kx * ux[i], ky * uy[i]

    return outer_force


@part
def _move_slot(ux, uy, vx, vy, i, fx, fy, carry, push, dt):
    vx[i] = carry[i] * vx[i] + push[i] * fx
    vy[i] = carry[i] * vy[i] + push[i] * fy
    ux[i] += dt * vx[i]
    uy[i] += dt * vy[i]


@cache
def grid_move(groups, springs, loaded):
    """One step of slots on a grid of so many groups of bonds.

    Parameters
    ----------
    groups : int
    springs, loaded : bool
        Whether slots have springs of their own, and static forces.
    """
    outer_force = _outer_force(springs, loaded)

    @compiled(MOVE, f'move grid {groups}' + ' springs' * springs + ' loaded' * loaded)
    def move(given, ux, uy, vx, vy, bx, by, carry, push, s, e, pad, stride, dt):
        vectorise()
        offsets = ints(given, PLACES)
        for i in range(s, e):
            fx, fy, kux, kuy = outer_force(given, ux, uy, i)
            for n in range(groups):
                b = i + pad + n * stride
                fx += bx[b - offsets[n]] - bx[b]
                fy += by[b - offsets[n]] - by[b]
            _move_slot(ux, uy, vx, vy, i, fx - kux, fy - kuy, carry, push, dt)

    return move


@cache
def table_move(columns, springs, loaded):
    """The same in a table, in which a slot has at most so many bonds; fewer are filled up with a bond of no force."""
    outer_force = _outer_force(springs, loaded)

    @compiled(MOVE, f'move table {columns}' + ' springs' * springs + ' loaded' * loaded)
    def move(given, ux, uy, vx, vy, bx, by, carry, push, s, e, pad, stride, dt):
        vectorise()
        ends, length = indices(given, PLACES), ints(given, SIZES)[0]
        for i in range(s, e):
            fx, fy, kux, kuy = outer_force(given, ux, uy, i)
            for n in range(columns):  # as many for all: no branch to mispredict
                b = ends[n * length + i]
                fx += bx[b]
                fy += by[b]
            _move_slot(ux, uy, vx, vy, i, fx - kux, fy - kuy, carry, push, dt)

    return move


@part
def _start(u0, v0, a0, u, v, decay, dt, s, e):
    vectorise()
    for i in range(s, e):
        v[i] = decay[i] * v0[i] + dt / 2 * a0[i]
        u[i] = u0[i] + dt * v[i]


@part
def _finish(u, v, a, decay, dt, s, e, found):
    """Half a kick, and the largest components of displacement and velocity into `found`."""
    vectorise()
    far, fast = 0, 0
    for i in range(s, e):
        x = decay[i] * (v[i] + dt / 2 * a[i])
        v[i] = x
        far, fast = higher(far, order(u[i])), higher(fast, order(x))
    found[1], found[2] = larger(found[1], magnitude(far)), larger(found[2], magnitude(fast))


@part
def _correct(ux, uy, vx, vy, push, dt, force, r, given):
    """Add external forces on the slots of run r, and take away what lines and planes bar."""
    driven, row, from_driven = ints(given, DRIVEN), ints(given, ROW), ints(given, FROM_DRIVEN)
    guided, barred, from_guided = ints(given, GUIDED), floats(given, BARRED), ints(given, FROM_GUIDED)
    for n in range(from_driven[r], from_driven[r + 1]):
        s, f = driven[n], 2 * row[n]
        kx, ky = push[s] * force[f], push[s] * force[f + 1]
        vx[s] += kx
        vy[s] += ky
        ux[s] += dt * kx
        uy[s] += dt * ky
    for n in range(from_guided[r], from_guided[r + 1]):
        s, f = guided[n], 4 * n
        ax, ay = barred[f] * vx[s] + barred[f + 1] * vy[s], barred[f + 2] * vx[s] + barred[f + 3] * vy[s]
        vx[s] -= ax
        vy[s] -= ay
        ux[s] -= dt * ax
        uy[s] -= dt * ay


# --- the window b of a grid holds the bonds of the slots from base - pad on; what lies before all slots pulls at nothing ---


@part
def _zero(x, s, e):
    for i in range(s, e):
        x[i] = 0.0


@part
def _clear(bx, by, groups, stride, s, e):
    for n in range(groups):
        _zero(bx, n * stride + s, n * stride + e)
        _zero(by, n * stride + s, n * stride + e)


@part
def _bring_down(bx, by, groups, stride, s, count):
    for n in range(groups):
        for i in range(n * stride, n * stride + count):
            bx[i] = bx[i + s]
            by[i] = by[i + s]


@part
def _room(bx, by, groups, stride, base, s, e, low, pad, empty):
    """Make room for the bonds of the slots s to e, of what is needed from slot `low` on; the base then."""
    if s == 0:
        _clear(bx, by, groups, stride, s, pad)
    if e + pad - base > stride:
        _bring_down(bx, by, groups, stride, low - base, s + pad - low)
        base = low
    if empty:
        _clear(bx, by, groups, stride, s + pad - base, e + pad - base)
    return base


# --- a block of steps -------------------------------------------------------------------------------------------------


(RUNS, NEEDS, DECAY, CARRY, PUSH, FORGET, MOBILITY, DRIVEN, ROW, FROM_DRIVEN, GUIDED, FROM_GUIDED, BARRED, DT, LAYOUT, PULL,
 PULLED, MOVED_BY, MOVED) = range(19)
"""Places in the table of addresses.

RUNS       first and last + 1 slot of each run, first and last + 1 of its groups or segments; on a grid none if all is empty
NEEDS      for each run the number of runs of which all slots must have moved in the level before
DECAY ... MOBILITY    of `Motion` and `Kernel`, of each slot
DRIVEN, GUIDED    slots in order; FROM_DRIVEN, FROM_GUIDED the first of each run, ROW and BARRED their forces and projectors
DT         time step
LAYOUT     numbers of runs, slots, driven slots, groups, and the pad of a grid: bonds of slot i stand `pad` places later; -1 if
           bonds are listed
PULL, MOVED_BY    addresses of the functions of this kind of law and layout; PULLED, MOVED the tables that are given to them
"""
ADVANCE = types.void(INTS, INTS, FLOATS, *[types.int64] * 4, INTS, FLOATS, types.int64, FLOATS, types.int64)


@part
def _wait(done, chunk, runs):
    """Until a chunk is past that many runs."""
    looks = 0
    while seen(done, FAR * chunk) < runs:
        looks += 1
        if looks > SPINS:
            leave_core()


@part
def _take(level, last, r, given, state, force, bx, by, base, stride, found):
    """Level `level`, of which `last` is the last one, of run r."""
    runs, layout, dt, decay = ints(given, RUNS), ints(given, LAYOUT), floats(given, DT)[0], floats(given, DECAY)
    s, e, length, pad = runs[4 * r], runs[4 * r + 1], layout[1], layout[4]
    ux, vx, ax = floats(state, 3), floats(state, 4), floats(state, 5)
    uy, vy, ay = past(ux, length), past(vx, length), past(ax, length)
    if level == 0:
        u, v, a = floats(state, 0), floats(state, 1), floats(state, 2)
        _start(u, v, a, ux, vx, decay, dt, s, e)
        _start(past(u, length), past(v, length), past(a, length), uy, vy, decay, dt, s, e)
        return
    first, end = runs[4 * r + 2], runs[4 * r + 3]
    strain = pull_at(given[PULL], (ints(given, PULLED), ux, uy, bx, by, s, e, first, end, pad - base, stride))
    found[0] = larger(found[0], strain)
    carry, push = floats(given, CARRY), floats(given, PUSH)
    if level == last:
        _zero(ax, s, e)
        _zero(ay, s, e)
        vx, vy, ax, ay, dt = ax, ay, vx, vy, 0.0
        carry, push = floats(given, FORGET), floats(given, MOBILITY)
    move_at(given[MOVED_BY], (ints(given, MOVED), ux, uy, vx, vy, bx, by, carry, push, s, e, pad - base, stride, dt))
    _correct(ux, uy, vx, vy, push, dt, force, r, given)
    if level == last:
        _finish(ux, ax, vx, decay, floats(given, DT)[0], s, e, found)
        _finish(uy, ay, vy, decay, floats(given, DT)[0], s, e, found)


@cache
def advance():
    """The compiled function that takes levels from `first` on of a block: the part of a thread.

    Parameters
    ----------
    given : addresses
        As above.
    state : addresses
        Of u, v and a at the start, and of those which are filled.
    forces : ndarray, shape (steps, driven, 2)
        External forces.
    steps, first, size, threads : int
        Number of levels but the start, first level, number of levels in a chunk, and number of threads.
    counters : ndarray of int
        Zeros, FAR for each level and then `size` for each thread.
    found : ndarray, shape (threads, FAR)
        Zeros; filled with the largest increment on the way, and the largest components of displacement and velocity in the end.
    thread : int
        Number of this thread.
    room : ndarray, shape (2, groups x stride)
        Room for the forces of bonds, of this thread alone.
    stride : int
        Length of the window on each group.
    """
    @compiled(ADVANCE, 'advance')
    def advance(given, state, forces, steps, first, size, threads, counters, found, thread, room, stride):
        runs, needs, layout = ints(given, RUNS), ints(given, NEEDS), ints(given, LAYOUT)
        count, driven, groups, pad = layout[0], layout[2], layout[3], layout[4]
        bx, by, done = room, past(room, groups * stride), counters
        ran, found = past(counters, FAR * (steps + 1 - first) + thread * size), past(found, FAR * thread)
        for chunk in range(thread, (steps + size - first) // size, threads):
            low = first + chunk * size
            high = min(low + size, steps + 1)
            for n in range(high - low):
                ran[n] = 0
            base, behind = runs[0], high - low - 1
            while ran[behind] < count:
                for n in range(high - low):
                    r = ran[n]
                    if r == count or (n > 0 and ran[n - 1] < needs[r]):
                        continue
                    if n == 0 and chunk > 0:
                        _wait(done, chunk - 1, needs[r])
                    s, e, needed, empty = runs[4 * r], runs[4 * r + 1], runs[4 * ran[behind]], runs[4 * r + 3] == 0
                    if pad >= 0:
                        base = _room(bx, by, groups, stride, base, s, e, needed, pad, empty)
                    ran[n] = r + 1
                    if pad < 0 or not empty:
                        force = past(forces, 2 * driven * (low + n - 1))
                        _take(low + n, steps, r, given, state, force, bx, by, base, stride, found)
                show(done, FAR * chunk, ran[behind])

    return advance


# --- the atoms --------------------------------------------------------------------------------------------------------

ATOMS = types.int64(INTS, *[types.int64] * 4)
"""Signature: addresses of slot, u, v, anchors, masses, positions, momenta; first and last + 1 particle; particles and slots."""
AT_A_TIME = 512
"""Particles after which a comparison may end."""


@cache
def write(whole):
    """The compiled function that sets positions and momenta, shape (particles, 3), to anchors + u and m v.

    Parameters
    ----------
    whole : bool
        Whether particles fill the slots in their own order.
    """
    @part
    def set_to(slot, ux, uy, vx, vy, x, y, masses, positions, momenta, s, e):
        vectorise()
        for i in range(s, e):
            n = i if whole else slot[i]
            positions[3 * i], positions[3 * i + 1] = x[i] + ux[n], y[i] + uy[n]
            momenta[3 * i], momenta[3 * i + 1] = masses[i] * vx[n], masses[i] * vy[n]

    @compiled(ATOMS, 'write' + ' whole' * whole)
    def write(given, s, e, particles, slots):
        slot, u, v, x, masses = ints(given, 0), floats(given, 1), floats(given, 2), floats(given, 3), floats(given, 4)
        uy, vy, y, positions, momenta = past(u, slots), past(v, slots), past(x, particles), floats(given, 5), floats(given, 6)
        set_to(slot, u, uy, v, vy, x, y, masses, positions, momenta, s, e)
        return 0

    return write


@part
def _other(given, i, n, particles, slots):
    """Whether particle i is not where slot n is."""
    u, v, x, masses = floats(given, 1), floats(given, 2), floats(given, 3), floats(given, 4)
    positions, momenta = floats(given, 5), floats(given, 6)
    return ((positions[3 * i] != x[i] + u[n]) | (positions[3 * i + 1] != x[particles + i] + u[slots + n])
            | (momenta[3 * i] != masses[i] * v[n]) | (momenta[3 * i + 1] != masses[i] * v[slots + n]))


@cache
def written(whole):
    """The compiled function that says whether they are what `write` has left."""
    @compiled(ATOMS, 'written' + ' whole' * whole)
    def written(given, s, e, particles, slots):
        if not whole:  # vector units are slow at looking up
            slot = ints(given, 0)
            for i in range(s, e):
                if _other(given, i, slot[i], particles, slots):
                    return 0
            return 1
        for low in range(s, e, AT_A_TIME):
            other = False
            for i in range(low, min(low + AT_A_TIME, e)):
                other |= _other(given, i, i, particles, slots)
            if other:
                return 0
        return 1

    return written
