"""Design of every magnet: what D0 promises for four devices, what they really do, and the same devices designed with D0 + D*."""

import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from importlib.resources import files
from multiprocessing import get_context
from time import process_time

import numpy as np

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed, units
from magphonon.design import (
    BurstEnergy,
    GroupVelocity,
    Level,
    Rest,
    Robust,
    Worst,
    band_gap,
    by_time_steps,
    of_parts,
    optimise,
    write_build_list,
)
from magphonon.plotting.axes import COLOURS, panels
from magphonon.plotting.designs import plot_design
from magphonon.response import Dof
from magphonon.stiffness import LinearSystem, Scatter

from . import bench_magnets as bench
from .rows import Check, Outcome, Reported, save_picture

HZ = 2 * np.pi * units.Hz
LAW, PILLAR = InversePower(bench.B * units.N * units.m**bench.EXPONENT, bench.EXPONENT), 19.6757 * units.N / units.m
GAMMA, REACH = bench.DAMPING / units.s, bench.REACH * units.m
SIDE, SPACING, MASS = 60 * units.mm, 10 * units.mm, bench.MASS * units.kg
STRENGTHS = 0.86, 0.93, 1.0, 1.07, 1.14
PILLARS = tuple(np.array([0.95, 0.983, 1.017, 1.05]) ** 4)  # stiffness goes with the fourth power of the diameter
PARTS = {'strength': STRENGTHS, 'spring': PILLARS}
OVER = {name: (min(parts), max(parts)) for name, parts in PARTS.items()}
WIDER = {'strength': (0.85, 1.15), 'spring': (0.8, 1.25)}
ALL = WIDER | {'mass': (0.5, 2.0), 'foot': (-1.0, 1.0)}
ONE_PERCENT = Scatter(strength=0.01, stiffness=0.01)
FLOOR = 0.005  # of the loudest port: quieter than that is no better
GOAL, SHARE, DRAWS = 30.0, 0.9, 60  # dB each way, the share of draws that must keep it, and draws by which it is judged
CHOOSING, CHOSEN = 7, 0.95  # seed of the draws by which a start is chosen, and the share from which no other is tried
STARTS = 6  # of D0's designs
KEPT = 1e-6  # relative: two solvers of one lattice
SHARPNESSES = 40.0, 160.0, 600.0  # ms, of the edges of the gap, in turn
BRANCHES, MESHES = 9, (6, 24)  # below the gap; wavevectors along each vector to design by and to judge by
CORNER, BURST_Hz = (0, 40), 70.0
SLOW, WAVE = 1.2, np.array([0.23, 0.0, 0.0])  # m/s, and the wave that is to travel so fast


def ready():
    """The demultiplexer that was designed, as it comes with the package."""
    return files('magphonon.data').joinpath('demultiplexer.csv')


def main(out, quick=False):
    """All four devices, designed here; `quick`: a wave is slowed, and the demultiplexer of the package is tested."""
    table = out / 'demultiplexer.csv'
    if quick:
        table.write_bytes(ready().read_bytes())
        rows = [*promises_of_d0(1), *slow_wave()]
    else:
        with ProcessPoolExecutor(os.cpu_count(), get_context('spawn')) as pool:
            found = [pool.submit(demultiplexer, table), *map(pool.submit, (gap, corner, promises_of_d0, slow_wave))]
            rows = [row for one in found for row in one.result()]
    return Outcome([*judged(table), *rows], [draw(out, table)])


# ------------------------------------------------------------------------------------------------------------- demultiplexer
def patch():
    """A hexagon of the paper's magnets, held at its rim, with all pairs within 45 mm, and a function that finds a magnet."""
    atoms = lattices.hexagon(lattices.triangular(SPACING, MASS), SIDE)
    springs = np.full(len(atoms), PILLAR)
    springs[atoms.constraints[0].index] *= PILLARS[2]  # what is held has one of the four pillars, too
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=springs, cutoff=REACH)
    X = (atoms.positions - atoms.positions.mean(0))[:, :2]
    return atoms, lambda x, y: Dof(int(np.hypot(*(X - [x, y]).T).argmin()), np.array([1.0, 0, 0]))


def contrast(atoms, at, width=2.0):
    """Soft minimum of the two contrasts in dB: the level at the right port over that at the wrong port."""
    source, *ports = (at(*(np.array(place) * units.m)) for place in (bench.SOURCE, *bench.PORTS))
    loud = abs(ports[0].seen(Rest(LinearSystem.about(atoms.calc, atoms)).response(source, bench.HERTZ[0] * HZ, GAMMA)))

    def level(port, f):
        return Level(source, port, f * HZ, GAMMA, FLOOR * loud)

    each = zip(bench.HERTZ, (ports, ports[::-1]), strict=True)
    return Worst(tuple(level(right, f) - level(wrong, f) for f, (right, wrong) in each), width)


def demultiplexer(table):
    """Design the demultiplexer and write it: without scatter, then with more and more draws, then with real parts."""
    atoms, at = patch()

    def robust(draws, width, own=0):
        return Robust(ONE_PERCENT, draws, width, seed=100 * seed + own)

    best, start = None, process_time()
    for seed in (1, 2):
        design = optimise(atoms, contrast(atoms, at), OVER, steps=60, seed=seed)
        design = optimise(atoms, contrast(atoms, at), OVER, steps=60, robust=robust(8, 2.0), start=design.x)
        design = optimise(atoms, contrast(atoms, at, 1.0), OVER, steps=60, robust=robust(24, 1.0), start=design.x)
        design = optimise(atoms, contrast(atoms, at, 1.0), OVER, steps=40, robust=robust(32, 1.0, 50), start=design.x)
        design = of_parts(design, PARTS, robust(32, 1.0, 50), steps=15, exchanges=60)
        held = (design.drawn(robust(DRAWS, 1.0), CHOOSING) > GOAL).mean()
        if best is None or held > best[0]:
            best = held, design
        if held >= CHOSEN:
            break
    write_build_list(table, best[1])
    write_build_list(table.with_name('demultiplexer_parts.csv'), best[1], best[1].tolerances(robust(8, 1.0)), PARTS)
    steps = by_time_steps(best[1].objective, best[1].atoms)
    return [Check('demultiplexer: soft minimum of both contrasts, by time steps (dB)', steps, best[1].value, 0.05),
            Reported('demultiplexer: designed in (CPU-s)', process_time() - start)]


def judged(table):
    """The levels of a table, by a solver that shares no code with the package, and by the package."""
    told = bench.judge(table, DRAWS)
    rows = [Check(f'demultiplexer: draws of {DRAWS} at 1 % scatter that fail {GOAL:g} dB, by another solver',
                  told['draws'] - told['kept'], 0, (1 - SHARE) * DRAWS),
            Reported('demultiplexer: number of grades of magnets used, and of those available',
                     told['strengths'], len(STRENGTHS)),
            Reported('demultiplexer: number of kinds of pillars used, and of those available', told['springs'], len(PILLARS))]
    for port, f, here, there in zip('AB', bench.HERTZ, own_decibels(bench.read(table)), told['dB'], strict=True):
        rows.append(Check(f'demultiplexer: {f:g} Hz to port {port} (dB), and by another solver', here, there, KEPT))
    return [*rows, Reported('demultiplexer: worst tenth of the draws (dB)', told['tenth'])]


def built(read):
    """The patch with the strengths and springs of a table, at rest."""
    atoms, _ = patch()
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=read[2] * units.N / units.m, strengths=read[1], cutoff=REACH)
    return Rest(LinearSystem.of(relaxed(atoms).atoms))


def own_decibels(read):
    """The two contrasts of a table by the package, without the floor."""
    rest = built(read)
    return [sum(c * replace(part, floor=0.0).value(rest) for c, part in one.parts) for one in contrast(*patch()).of]


def promises_of_d0(starts=STARTS):
    """Designs with D0 alone within the same bounds, one start each: the contrast promised, and that found by another solver."""
    atoms, at = patch()
    design = optimise(atoms, contrast(atoms, at), OVER, steps=60, model='conventional', starts=starts)
    kept = [number for number in design.given_by_starts if number >= GOAL]
    return [Check(f'control: of {starts} designs with D0 alone, those that keep {GOAL:g} dB', len(kept), starts, 0, control=True),
            *(Reported(f'D0 alone, {which}: weaker contrast promised (dB), and true', promise, truth)
              for which, promise, truth in ends(design.starts, design.given_by_starts))]


def ends(promised, given):
    """The worst and the best result of several starts."""
    worst, *_, best = np.argsort(given)[[0, -1]]
    return [('worst start', promised[worst], given[worst]), ('best start', promised[best], given[best])][: len(given)]


# -------------------------------------------------------------------------------------------------------------- other devices
@dataclass(frozen=True)
class Four:
    """Four numbers for a device: promised and true value of the design with D0 alone, and those of the design with D0 + D*."""

    name: str
    promised_by_d0: float
    given_by_d0: float
    promised: float
    given: float  # by other means than the design was made
    tolerance: float

    @property
    def rows(self):
        return [Check(f"control: {self.name}: true value of D0's design, and its promise", self.given_by_d0, self.promised_by_d0,
                      0.2, control=True),
                Check(f'{self.name}: true value, and promise of D0 + D*', self.given, self.promised, self.tolerance)]


def mesh(n):
    """Wavevectors of half of a mesh that contains Gamma; the other half has the same frequencies."""
    g = np.arange(n) / n
    return np.array([(a, b, 0) for a in g for b in g if b <= 0.5])


def cell(n, **neighbours):
    """A cell of n x n of the paper's magnets."""
    atoms = lattices.triangular(SPACING, MASS).repeat((n, n, 1))
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=PILLAR, **neighbours)
    return atoms


def gap(starts=3):
    """A cell of nine magnets whose strengths, pillars, masses and feet are chosen to open a gap above branch 9."""
    def designed(model, seed):
        x, atoms = None, cell(3, cutoff=REACH)
        for sharp in SHARPNESSES:
            design = optimise(atoms, band_gap(mesh(MESHES[0]), BRANCHES, sharp), ALL, steps=40, model=model, seed=seed, start=x)
            x = design.x
        wide = band_gap(mesh(MESHES[1]), BRANCHES, np.inf)
        return [wide.value(design.variables.rest(x, m)) / HZ for m in (model, 'complete')], design

    alone = [designed('conventional', seed)[0] for seed in range(starts)]
    (promise, _), design = max((designed('complete', seed) for seed in range(starts)), key=lambda one: one[0][0])
    atoms = design.atoms
    omega = np.sqrt(bench.squares(
        atoms.positions[:, :2] / units.m, atoms.cell.array[:2, :2] / units.m, atoms.calc.strengths,
        np.asarray(atoms.calc.foundation)[:, 0] / (units.N / units.m), atoms.get_masses() / units.kg, mesh(MESHES[1])))
    omega = omega / (2 * np.pi)
    best = max(alone)
    return [*Four(f'gap above branch {BRANCHES} of a cell of nine (Hz)', *best, promise,
                  omega[:, BRANCHES:].min() - omega[:, :BRANCHES].max(), 1e-3).rows,
            *(Reported(f'gap with D0 alone, {which}: promised (Hz), and true', p, t)
              for which, p, t in ends(*zip(*alone, strict=True)))]


def corner(starts=2):
    """A device that guides a burst round a corner: the share of its energy that arrives."""
    atoms, at = patch()
    X, free = (atoms.positions - atoms.positions.mean(0))[:, :2], LinearSystem.about(atoms.calc, atoms).mobile
    there = free & (np.hypot(*(X - np.array(CORNER) * units.mm).T) < 1.1 * SPACING)
    one = BurstEnergy(at(-40, 0), tuple(np.flatnonzero(there)), (100.0, 160.0), BURST_Hz * HZ, 6, GAMMA)
    share = one - replace(one, region=tuple(np.flatnonzero(free)))
    design = optimise(atoms, share, WIDER, steps=80, starts=starts, compare=True)
    other = design.conventional
    percent = [100 * 10 ** (value / 10) for value in (other.value, other.given, design.value,
                                                      by_time_steps(share, design.atoms), design.before)]
    return [*Four(f'share of a {BURST_Hz:g} Hz burst round a corner (%)', *percent[:4], 0.01).rows,
            Reported('share of this burst before the design (%)', percent[4])]


def slow_wave():
    """A cell of nine magnets in which a wave of one branch and wavelength travels at a wanted speed."""
    atoms, speed = cell(3, cutoff=REACH), GroupVelocity(WAVE, 0, np.array([1.0, 0.0]))
    design = optimise(atoms, speed.near(SLOW, 0.01), ALL, steps=60, compare=True)
    other = design.conventional
    promise, false = (speed.value(other.variables.rest(other.x, model)) for model in ('conventional', 'complete'))
    h, system = 1e-4, LinearSystem.of(design.atoms)
    q = WAVE + np.array([[h], [-h]]) * np.linalg.solve(system.calc.reference.cell.reciprocal().array.T, [1, 0, 0]) / (2 * np.pi)
    omega = np.sqrt([np.linalg.eigvalsh(system.bloch(one[None], 'complete')[0])[0] for one in q])
    return Four(f'speed of a wave in a cell of nine, {SLOW:g} m/s wanted', promise, false,
                speed.value(design.variables.rest(design.x)), (omega[0] - omega[1]) / (2 * h), 1e-5).rows


# ------------------------------------------------------------------------------------------------------------------- pictures
def draw(out, table):
    """Draw the demultiplexer: its parts, and both levels over frequency, before and after the design."""
    at, rest = patch()[1], built(bench.read(table))
    figure, axes = panels(2, 2, height=2.6)
    plot_design(rest.system.atoms, {'source': at(-40, 0), 'A': at(30, 34.64), 'B': at(30, -34.64)}, axes=axes[0])
    f = np.linspace(40, 100, 241)
    for ax, read, name in zip(axes[1], (uniform(table), bench.read(table)), ('before', 'designed'), strict=True):
        levels(ax, read, f)
        ax.set(ylim=(5e-3, 50), title=name)
    axes[1][0].set_ylabel('displacement per force (mm/N)')
    axes[1][1].tick_params(labelleft=False)
    axes[1][1].legend(['port A', 'port B'], frameon=False)
    return save_picture(figure, out / 'design_sites.png',
                        'A demultiplexer of magnets of five grades and pillars of four kinds: 60 Hz leaves at A, 80 Hz at B.')


def uniform(table):
    """The patch before the design: all magnets and pillars alike."""
    feet, strengths, springs, held = bench.read(table)
    return feet, np.ones_like(strengths), np.full_like(springs, PILLAR / (units.N / units.m)), held


def levels(ax, read, f):
    """Levels at both ports for each frequency."""
    at, rest = patch()[1], built(read)
    for place, colour in ((at(30, 34.64), COLOURS[0]), (at(30, -34.64), COLOURS[1])):
        h = np.array([abs(place.seen(rest.response(at(-40, 0), one * HZ, GAMMA))) for one in f])
        ax.semilogy(f, h, color=colour)
    for one in bench.HERTZ:
        ax.axvline(one, color='0.7', zorder=0, linewidth=0.8)
    ax.set(xlabel='frequency (Hz)')
