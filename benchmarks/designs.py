"""What a design of every magnet costs: value reached against CPU time by four methods, slopes in forward solves, 900 magnets.

    python benchmarks/designs.py [--seconds 20] [--chart designs.png]

The task is the demultiplexer of the paper's magnets, nearest neighbours, 91 free magnets and as many pillars.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from time import process_time

os.environ.setdefault('OMP_NUM_THREADS', '1')

import numpy as np

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, ToneBurst, Unstable, lattices, units as u
from magphonon.design import BurstEnergy, Level, Variables, Worst, band_gap, optimise
from magphonon.design.scatter import SiteSlopes
from magphonon.plotting import new_axes, print_style
from magphonon.response import Dof

HZ, OVER = 2 * np.pi * u.Hz, {'strength': (0.85, 1.15), 'spring': (0.8, 1.25)}
LAW, PILLAR = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824), 19.6757 * u.N / u.m
METHODS = 'gradient', 'finite differences', 'Nelder-Mead', 'random search'
REPEATS = 7


class ConvergedShells(Exception):
    """The time is over."""


def task(side=60.0):
    """The patch, and the weaker of its two contrasts in dB; the places grow with the patch."""
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.707), side)
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=PILLAR)
    X = (atoms.positions - atoms.positions.mean(0))[:, :2] * 60 / side
    source, a, b = (Dof(int(np.hypot(*(X - at).T).argmin()), np.array([1.0, 0, 0]))
                    for at in ((-40, 0), (30, 34.64), (30, -34.64)))

    def level(port, f):
        return Level(source, port, f * HZ, 4 / u.s, 1e-3)

    return atoms, Worst((level(a, 60) - level(b, 60), level(b, 80) - level(a, 80)), 2.0)


def race(method, seconds, seed=0):
    """The CPU times at which a better design was found, and its value."""
    from scipy.optimize import minimize

    (atoms, objective), found, start = task(), [], process_time()
    variables, rng = Variables(atoms, OVER), np.random.default_rng(seed)

    def better(x, value):
        if process_time() - start > seconds:
            raise ConvergedShells
        if not found or value > found[-1][1]:
            found.append((process_time() - start, value))

    def down(x):
        try:
            value = objective.value(variables.rest(np.clip(x, -1, 1)))
        except Unstable:
            value = -100.0
        better(x, value)
        return -value

    x, bounds = variables.present + 0.05 * rng.normal(size=len(variables)), [(-1, 1)] * len(variables)
    try:
        if method == 'gradient':
            optimise(atoms, objective, OVER, steps=1000, seed=seed, report=better)
        elif method == 'finite differences':
            minimize(down, x, method='L-BFGS-B', bounds=bounds, options={'maxfun': 10**6})
        elif method == 'Nelder-Mead':
            minimize(down, x, method='Nelder-Mead', bounds=bounds, options={'maxfev': 10**6, 'maxiter': 10**6, 'adaptive': True})
        else:
            while True:
                down(rng.uniform(-1, 1, len(variables)))
    except ConvergedShells:
        pass
    return [*found, (seconds, found[-1][1])]


def least(work):
    """The least CPU time of several runs, in s."""
    times = []
    for _ in range(REPEATS):
        start = process_time()
        work()
        times.append(process_time() - start)
    return min(times)


def costs():
    """Of each objective: CPU ms of a forward solve, which is the rest and the value, and of value and slopes over it."""
    (atoms, contrast), cell = task(), lattices.triangular(10.0, 0.707).repeat((3, 3, 1))
    cell.calc = MagneticRepulsion(cell, LAW, foundation=PILLAR)
    q = [(a / 6, b / 6, 0) for a in range(6) for b in range(4)]
    source = contrast.of[0].parts[0][1].source
    burst = BurstEnergy(source, tuple(range(60, 70)), (100.0, 160.0), 70 * HZ, 6, 4 / u.s)
    large = replace(burst, amplitude=0.05)
    everything = OVER | {'mass': (0.5, 2.0), 'foot': (-1.0, 1.0)}
    for name, structure, objective in (('contrast, 91 free magnets', atoms, contrast),
                                       ('gap, 9 magnets', cell, band_gap(q, 9, 60.0)),
                                       ('burst, small motion', atoms, burst), ('burst, 50 mN, by time steps', atoms, large)):
        v = Variables(structure, everything)
        x = 0.1 * np.random.default_rng(0).normal(size=len(v))

        def both(v=v, x=x, objective=objective):
            rest = v.rest(x)
            v.gradient(x, SiteSlopes(rest.system).of(objective.value_and_slope(rest)[1]))

        forward = least(lambda v=v, x=x, objective=objective: forward_solve(objective, v.rest(x)))
        yield name, len(v), 1e3 * forward, least(both) / forward


def forward_solve(objective, rest):
    """What the value alone takes: responses from the source, Bloch waves, the modes and velocities of a burst, its time steps."""
    if isinstance(objective, Worst):
        for level in (part for one in objective.of for _, part in one.parts):
            rest.response(level.source, level.omega, level.damping)
    elif not isinstance(objective, BurstEnergy):
        rest.waves(objective.parts[0][1].q)
    elif objective.amplitude:
        source = objective.source
        burst = ToneBurst(source.particle, source.direction, objective.amplitude, objective.omega, objective.cycles)
        dyn = DrivenVerlet(rest.system.atoms, objective.dt, [burst], damping=objective.damping, engine='numpy')
        dyn.run(int(objective.window[1] / objective.dt))
    else:
        squares, X = rest.spectrum
        t = objective.dt * np.arange(objective.window[0] / objective.dt, objective.window[1] / objective.dt)
        _ = (objective._oscillators(squares, t) * X[0]) @ X.T


def many(steps=40):
    """900 free magnets and as many pillars: their number, CPU-s, evaluations, and the value before and after."""
    atoms, objective = task(180.0)
    start = process_time()
    design = optimise(atoms, objective, OVER, steps=steps)
    return len(design.x), process_time() - start, len(design.history), design.before, design.value


def chart(path, seconds):
    """All four methods from three starts, in one picture."""
    runs = [(method, seed) for method in METHODS for seed in range(3)]
    with ProcessPoolExecutor() as pool:
        found = list(pool.map(race, *zip(*((method, seconds, seed) for method, seed in runs), strict=True)))
    with print_style():
        ax = new_axes(height=2.8)
        for (method, seed), steps in zip(runs, found, strict=True):
            ax.step(*np.array(steps).T, where='post', color=f'C{METHODS.index(method)}', label=method if not seed else None)
            print(f'{method:20} start {seed}: {steps[-1][1]:6.1f} dB')
        ax.set(xscale='log', xlabel='CPU time (s)', ylabel='weaker contrast (dB)')
        ax.legend(frameon=False)
        ax.figure.savefig(path, dpi=220)


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=20.0)
    parser.add_argument('--chart', default='designs.png')
    options = parser.parse_args()
    for name, parameters, forward, ratio in costs():
        print(f'{name:28} {parameters:4} parameters: forward {forward:6.1f} ms, value and all slopes {ratio:.2f} times that')
    parameters, seconds, evaluations, before, after = many()
    print(f'{parameters} parameters: {seconds:.0f} CPU-s, {evaluations} evaluations, {before:.1f} dB before, {after:.1f} after')
    chart(options.chart, options.seconds)
