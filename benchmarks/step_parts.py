"""Where the time of a particle-step goes, for `steps.py`.

There are the forces of bonds and the motion, measured in first-level cache; what the other levels of cache add, and the ends of
blocks; and the observers, for whom the state goes to ASE's Atoms and is compared with them afterwards.
"""

from time import thread_time

import numpy as np
from numba import types

from magphonon.dynamics.compiled_bonds import pull_at
from magphonon.dynamics.compiled_steps import move_at
from magphonon.dynamics.intrinsics import past
from magphonon.dynamics.machine_code import FLOATS, INTS, compiled

ROUNDS, REPEATS, BURST = 40, 9, 300
OFTEN, SELDOM = 10, 100
"""Steps between two calls of an observer."""
MULTIPLY_ADDS = 9
"""Of a bond, on the units that multiply, besides one for each coefficient of the polynomial but the first, and H = e Q; a
difference of displacements is taken on other units."""
MANY_TIMES = types.void(types.int64, INTS, *[FLOATS] * 4, *[types.int64] * 7)
"""Signature: address of the function; given, u, v, forces of bonds, ones; first and last + 1 slot, number of slots and of groups,
pad, stride, times."""


@compiled(MANY_TIMES, 'bonds of a run')
def bonds(function, given, u, v, room, ones, s, e, length, groups, pad, stride, times):
    """Forces of the bonds of one run of slots, many times."""
    for _ in range(times):
        pull_at(function, (given, u, past(u, length), room, past(room, groups * stride), s, e, 0, groups, pad, stride))


@compiled(MANY_TIMES, 'motion of a run')
def motion(function, given, u, v, room, ones, s, e, length, groups, pad, stride, times):
    """One step of a run of slots, many times."""
    uy, vy, by = past(u, length), past(v, length), past(room, groups * stride)
    for _ in range(times):
        move_at(function, (given, u, uy, v, vy, room, by, ones, ones, s, e, pad, stride, 0.0))



def in_cache(kernel):
    """Seconds per slot of the bonds and of the motion of one run of slots, which stays in first-level cache, and coefficients."""
    pull, pulled, move, moved = kernel._given.things[15:19]
    runs, length, groups = kernel._bonds.runs, kernel.layout.length, len(kernel._bonds.places)
    s, e = (int(end) for end in runs[len(runs) // 2, :2])
    u, v = 1e-2 * np.random.default_rng(0).standard_normal((2, 2, length))
    ones, (_, room, stride) = np.ones(length), kernel._room()
    best = {}
    for _ in range(ROUNDS):
        for call, (function, given) in ((bonds, (pull, pulled)), (motion, (move, moved))):
            start = thread_time()
            call.call(function.address, given.address, u.ctypes.data, v.ctypes.data, room, ones.ctypes.data, s, e, length, groups,
                      kernel._bonds.pad - s, stride, BURST)
            best[call] = min(best.get(call, np.inf), (thread_time() - start) / BURST / (e - s))
    return best[bonds], best[motion], pulled.things[12].shape[1]


def print_parts(dynamics, rate):
    """Measure the parts of one size and print them.

    Parameters
    ----------
    dynamics : function
        Of the steps between two calls of an observer: a DrivenVerlet on compiled blocks, after some steps.
    rate : float
        Multiplications and additions per second of one core.
    """
    runs = {every: dynamics(every) for every in (OFTEN, SELDOM)}
    count, kernel = len(runs[OFTEN].atoms), runs[OFTEN]._blocks._kernel
    steps = SELDOM * max(1, round(0.2 / (SELDOM * count * 5e-9)))
    seconds = dict.fromkeys(runs, np.inf)
    for _ in range(REPEATS):
        for every, dyn in runs.items():
            start = thread_time()
            dyn.run(steps)
            seconds[every] = min(seconds[every], (thread_time() - start) / steps / count)
    look = (seconds[OFTEN] - seconds[SELDOM]) / (1 / OFTEN - 1 / SELDOM)
    pull, move, coefficients = in_cache(kernel)
    groups, multiply_adds = len(kernel._bonds.places), MULTIPLY_ADDS + coefficients
    rest = seconds[SELDOM] - look / SELDOM - pull - move
    print(f'a step of each of {count} magnets: bonds {1e9 * pull:.2f} ns ({groups} x {multiply_adds} multiply-adds would take '
          f'{2e9 * groups * multiply_adds / rate:.2f} ns) + motion {1e9 * move:.2f} + '
          f'other levels of cache and ends of blocks {1e9 * rest:.2f}')
    for every in runs:
        print(f'    + an observer every {every:3d} steps {1e9 * look / every:.2f} ns = '
              f'{1e9 * seconds[every]:.2f} ns', flush=True)
