"""Where a lattice is stable: maps of buckling for the complete and the conventional model, and stable time steps of
integrators.
"""

import warnings

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms, FixedLine
from ase.md.verlet import VelocityVerlet
from scipy.optimize import brentq

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, critical_foundation, lattices
from magphonon.dynamics import Constant, Recorder
from magphonon.lattices.crystals import SYMBOL
from magphonon.plotting.axes import COLOURS, UNSTABLE, legend_of_set, letter_panels, panels
from magphonon.scenes.scene import reference
from magphonon.stiffness.matrices import MODELS, model_stiffness

from .rows import Check, Outcome, save_picture

# Spacing, mass and static force are 1 here, so that stiffness is in f/L0 and rates in sqrt(f/(L0 m)).
EXPONENTS = np.linspace(1, 8, 15)  # with the corner at a = 3
FOUNDATIONS = np.linspace(0, 7.5, 61)
KINDS = {  # foundation needed in closed form, and a cell in which the softest wave fits
    'chain': (lambda a: 4.0 + 0 * a, (2, 1, 1)),
    'square': (lambda a: 4.0 + 0 * a, (2, 1, 1)),
    'triangular': (lambda a: np.maximum(0, 2 * (3 - a)), (2, 1, 1)),
    'honeycomb': (lambda a: 3.0 + 0 * a, (3, 3, 1)),
    'kagome': (lambda a: 6.0 + 0 * a, (1, 1, 1)),
}
HATCHES = '///', '...'  # sideways, along the vertical
RATES = np.arange(0, 2.6, 0.5)  # of growth, steps of the map
RUNS = 1.5, 2.5, 6.0  # exponents at which runs on both sides of the border tell whether it is one
ANGLES = np.deg2rad(np.linspace(0, 90, 61))
STEPS = np.concatenate([np.linspace(0.05, 0.95, 19), np.linspace(1.0, 2.2, 25)])  # omega dt
ZETAS = 0.0, 0.5, 5.0
MOST_GROWTH = 3.0  # of a step, beyond which a run is not linear for long
GREW = 0.02  # logarithm in one step; the slowest growth that is judged, one of STEPS above a limit, is five times as fast


def main(out):
    """Stability boundaries from bands and runs against closed forms; angles of the oscillator; growth per step of integrators."""
    needed = {model: {name: np.array([needed_by(name, model, a) for a in EXPONENTS]) for name in KINDS}
              for model in MODELS}
    fates = {(name, model): runs(name, model) for name in KINDS for model in MODELS}
    checks = []
    for name, (closed, _) in KINDS.items():
        misfit = {model: abs(needed[model][name] - closed(EXPONENTS)).max() for model in MODELS}
        grown = {model: fates[name, model] for model in MODELS}
        checks += [
            Check(f'{name}: foundation needed, largest misfit over a from 1 to 8 (f/L0)', misfit['complete'], 0, 1e-9),
            Check(f'control: {name}, D0 alone (f/L0)', misfit['conventional'], 0, 0.5, control='D0'),
            Check(f'{name}: number of runs 5 % from the border with the wrong outcome', wrong(grown['complete']), 0, 0),
            Check(f'control: {name}, D0 alone, number of runs with the wrong outcome',
                  wrong(grown['conventional']), 0, 0, control='D0'),
            Check(f'{name}: growth rates of runs, largest misfit', misfit_of_rates(grown['complete']), 0, 1e-3),
        ]
    checks += _angles()
    measured, laws = {z: integrators(z) for z in ZETAS}, {z: (exact_split(STEPS, z), explicit(STEPS, z)) for z in ZETAS}
    checks += _steps(measured, laws)
    return Outcome(checks, [_draw_maps(out, needed, fates), _draw_oscillator(out), _draw_steps(out, measured, laws)])


# --- lattices --------------------------------------------------------------------------------------------------------

def cell(name, a, foundation=0.0, model='complete', repeat=(1, 1, 1)):
    """A supercell of a lattice with unit spacing, mass and static force."""
    atoms = getattr(lattices, name)(1.0, 1.0).repeat(repeat)
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, a), foundation=foundation, model=model)
    return atoms


def needed_by(name, model, a):
    """Foundation that a lattice needs, in f/L0."""
    return critical_foundation(cell(name, a), model, steps=12)[0]


def runs(name, model):
    """Runs on both sides of the boundary, one row each: exponent, foundation, expected rate (zero if stable) and rate found."""
    closed, repeat = KINDS[name]
    rows = []
    for a in RUNS:
        for share in (0.95, 1.05):
            k = share * closed(a) if closed(a) else 0.05 * (share > 1)
            expected = np.sqrt(max(closed(a) - k, 0.0))
            rows.append((a, k, expected, growth(cell(name, a, k, model, repeat), expected or 0.5)))
    return np.array(rows)


def growth(atoms, rate, dt=0.2):
    """Rate at which a tiny random start grows over the last third of a run in which `rate` would give e^15; zero if it stays.

    In ASE's loop: each lattice would be a kernel of its own, whose compilation takes longer than all of its runs.
    """
    atoms.positions[:, :2] += 1e-10 * np.random.default_rng(0).normal(size=(len(atoms), 2))
    steps = round(5 / rate / dt)
    dyn = DrivenVerlet(atoms, dt, engine='ase', allow_unstable=True)
    size = []
    for _ in range(3):
        dyn.run(steps)
        size.append(np.linalg.norm(dyn.displacements))
    return np.log(size[2] / size[1]) / (steps * dt) if size[2] > 1e-8 else 0.0


def wrong(rows):
    """Number of runs whose motion grew where it should stay small, or the other way round."""
    return int(np.sum((rows[:, 2] > 0) != (rows[:, 3] > 0)))


def misfit_of_rates(rows):
    """Largest difference between the growth rates found and expected."""
    return abs(rows[:, 3] - rows[:, 2]).max()


def _draw_maps(out, needed, fates):
    figure, axes = panels(2, len(KINDS), height=1.6)
    letter_panels(axes, [*KINDS, *KINDS])
    squares = RATES[1:] ** 2
    for row, model in zip(axes, MODELS, strict=True):
        for ax, (name, (closed, _)) in zip(row, KINDS.items(), strict=True):
            # the square, negative beyond the border: between points of the map it is linear, as its root is not
            square = needed[model][name] - FOUNDATIONS[:, None]
            shades = ax.contourf(EXPONENTS, FOUNDATIONS, square, levels=[1e-9, *squares], cmap='YlOrBr', extend='max')
            ax.plot(EXPONENTS, closed(EXPONENTS), color='black', linestyle='-' if model == 'complete' else ':')
            found = fates[name, model]
            grew = found[:, 3] > 0
            grown, = ax.plot(*found[grew, :2].T, 'x', color='black', markersize=4)
            stayed, = ax.plot(*found[~grew, :2].T, 'o', color='black', fillstyle='none', markersize=3.5)
            ax.set(xticks=(1, 3, 5, 7), xlim=(1, 8), ylim=(0, FOUNDATIONS[-1]))
            ax.label_outer()
    for ax in axes[1]:
        ax.set_xlabel('exponent $a$')
    for ax, short in zip(axes[:, 0], ('$D^0+D^{*}$', '$D^0$ alone'), strict=True):
        ax.set_ylabel(f'{short}\nfoundation ($f/L_0$)')
    bar = figure.colorbar(shades, ax=axes, label=r'growth rate ($\sqrt{f/(L_0M)}$)', ticks=squares, pad=0.02)
    bar.ax.set_yticklabels([f'{rate:g}' for rate in RATES[1:]])
    names = 'closed form of the border', 'run that grew', 'run that stayed'
    legend_of_set(figure, handles=[axes[0, 0].lines[0], grown, stayed], labels=names)
    return save_picture(figure, out / 'stability_map.png',
                        'Foundation that each lattice needs. Only the triangular one needs none, for a > 3; in the shaded region '
                        'below the border motion grows. With D0 alone every point is stable: that model shows none of this.')


# --- the oscillator --------------------------------------------------------------------------------------------------

def stiffness(theta0, a, model='complete'):
    """Horizontal and vertical stiffness of the oscillator in f/L0."""
    return _stiffnesses(theta0, [a], model)[0]


def _stiffnesses(theta0, exponents, model):
    positions = lattices.oscillator(float(theta0), 1.0, 1.0).positions[:, :2]
    bonds = positions[3] - positions[:3]
    return np.array([model_stiffness(bonds, InversePower(1.0, a), model).sum(axis=0).diagonal() for a in exponents])


def critical(a):
    """Angle above which the oscillator is unstable sideways: D_xx = 2 (a + 1) cos^2 - 3 = 0."""
    return np.arccos(np.sqrt(3 / (2 * (a + 1))))


def critical_upwards(a):
    """Angle below which the oscillator is unstable vertically: D_yy = 2 (a + 1) sin^2 - (2 - a) = 0, for a < 2."""
    return np.arcsin(np.sqrt(np.maximum(2 - a, 0) / (2 * (a + 1))))


def _angles():
    checks = [Check(f'oscillator: critical angle at a = {a:g} (deg)',
                    np.rad2deg(brentq(lambda t, a=a: stiffness(t, a)[0], 0.1, 1.5, xtol=1e-13)), np.rad2deg(critical(a)), 1e-9)
              for a in (2.0, 4.0, 8.0)]
    checks += [Check(f'oscillator: angle below which it is unstable along the vertical at a = {a:g} (deg)',
                     np.rad2deg(brentq(lambda t, a=a: stiffness(t, a)[1], 0.01, 1.5, xtol=1e-13)),
                     np.rad2deg(critical_upwards(a)), 1e-9)
               for a in (1.0, 1.5, 1.9)]
    paper = reference()['oscillator']['theta_critical_deg']
    lowest, upright = (min(stiffness(t, a, 'conventional')[axis] for t in ANGLES for a in (1.0, 4.0)) for axis in (0, 1))
    return [*checks, Check('critical sideways angle at a = 4, from the references (deg)', np.rad2deg(critical(4.0)), paper, 1e-9),
            Check('vertical stiffness at a = 2 and 0 degrees, where that instability ends (f/L0)',
                  stiffness(0, 2.0)[1], 0, 1e-12),
            Check('control: least horizontal stiffness at a = 4 and 90 degrees, D0 alone (f/L0)', lowest, -3, 0.9, control='D0'),
            Check('control: least vertical stiffness, at a = 1 and 0 degrees, D0 alone (f/L0)', upright, -1, 0.9, control='D0')]


def _draw_oscillator(out):
    from matplotlib.colors import TwoSlopeNorm
    from matplotlib.patches import Patch

    figure, (axes,) = panels(1, 2, height=2.6)
    letter_panels(axes, ['$D^0+D^{*}$', '$D^0$ alone'])
    exponents, finer, degrees = np.linspace(1, 8, 36), np.linspace(1, 8, 561), np.rad2deg(ANGLES)
    for ax, model in zip(axes, MODELS, strict=True):
        D = np.array([_stiffnesses(t, exponents, model) for t in ANGLES])
        shades = ax.contourf(exponents, degrees, D[..., 0], levels=np.arange(-3, 16.6, 1.5), cmap='PuOr',
                             norm=TwoSlopeNorm(0, -3, 16.5))
        for axis, hatch in enumerate(HATCHES):
            if (D[..., axis] < -1e-9).any():
                region = ax.contourf(exponents, degrees, D[..., axis], [-9, 0], colors='none', hatches=[hatch])
                region.set(edgecolor='0.25', linewidth=0)
        line = '-' if model == 'complete' else ':'
        ax.plot(finer, np.rad2deg(critical(finer)), line, color='black', linewidth=1.6)
        below = finer[finer <= 2]
        ax.plot(below, np.rad2deg(critical_upwards(below)), line, color=COLOURS[0], linewidth=1.6)
        ax.set(xlabel='exponent $a$', ylabel=r'angle $\theta_0$ (deg)', xlim=(1, 8), ylim=(0, 90))
        ax.label_outer()
    figure.colorbar(shades, ax=axes, label='horizontal stiffness $D_{xx}$ ($f/L_0$)', ticks=range(-3, 16, 3), pad=0.02)
    look = {'facecolor': 'w', 'edgecolor': '0.25', 'linewidth': 0.4}
    handles = [*axes[0].lines, *(Patch(hatch=hatch, **look) for hatch in HATCHES)]
    names = [r'$\cos^2\theta_0 = 3/(2(a+1))$', r'$\sin^2\theta_0 = (2-a)/(2(a+1))$', 'runs away sideways',
             'runs away along the vertical']
    legend_of_set(figure, handles=handles, labels=names, ncols=2)
    return save_picture(figure, out / 'stability_oscillator.png',
                        'The oscillator runs away sideways above the black line (closed form), and vertically below the blue '
                        'line, at exponents below 2. With D0 alone (dotted) it never does.')


# --- integrators -----------------------------------------------------------------------------------------------------

class ExplicitDamping(VelocityVerlet):
    """The control: velocity Verlet with the force -m gamma v, from the latest known velocity."""

    def __init__(self, atoms, timestep, damping, push=0.0):
        super().__init__(atoms, timestep)
        self.damping, self.push = np.reshape(damping, (-1, 1)), push

    def step(self):
        atoms, p = self.atoms, self.atoms.get_momenta()
        p += self.dt / 2 * (atoms.get_forces() + self.push - self.damping * p)
        atoms.set_positions(atoms.get_positions() + self.dt * p / self.masses)
        p += self.dt / 2 * (atoms.get_forces() + self.push - self.damping * p)
        atoms.set_momenta(p)


def exact_split(w, zeta):
    """Trace and determinant of one step of DrivenVerlet at omega dt = w."""
    det = np.exp(-2 * zeta * w)
    return (1 + det) * (1 - w**2 / 2), det


def explicit(w, zeta):
    """Trace and determinant of one step of ExplicitDamping at omega dt = w."""
    left = 1 - zeta * w  # of the velocity after half a step
    return 1 + left**2 - w**2 / 2 * (1 + left), left**2


def growth_per_step(trace, det):
    """Logarithm of the larger root of `x^2 - trace x + det`."""
    root = np.sqrt(np.asarray(trace, complex) ** 2 / 4 - det)
    return np.log(np.maximum(abs(trace / 2 + root), abs(trace / 2 - root)))


def fitted_growth(y):
    """Growth per step of a record that obeys `y[n+1] = trace y[n] - det y[n-1]`."""
    fit, _, rank, _ = np.linalg.lstsq(np.stack([y[1:-1], -y[:-2]], axis=1), y[2:], rcond=1e-6)
    return growth_per_step(*fit) if rank == 2 else np.log(abs(y[-1] / y[-2]))  # of one root alone


def integrators(zeta):
    """Measured growth per step of each oscillator of `STEPS` by DrivenVerlet and ExplicitDamping; NaN where it is too large.

    All oscillators are one structure: particles of different mass, each repelled along a line by its own fixed particle.
    """
    found = []
    for number, law in enumerate((exact_split, explicit)):
        w = STEPS[growth_per_step(*law(STEPS, zeta)) < np.log(MOST_GROWTH)]
        n, a = len(w), 4.0
        free = np.arange(n, 2 * n)
        atoms = Atoms([SYMBOL] * (2 * n), np.repeat([[0, 0, 0], [1, 0, 0]], n, axis=0), masses=[*np.ones(n), *(a / w**2)])
        atoms.positions[:, 1] = 3.0 * np.tile(np.arange(n), 2)
        with warnings.catch_warnings():
            warnings.filterwarnings('ignore', message='a mass of')  # the slowest oscillators are heavy, in no unit
            atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, a), bonds=[(r - n, r) for r in free])
        atoms.set_constraint([FixAtoms(range(n)), FixedLine(free, (1, 0, 0))])
        atoms.positions[free, 0] += 1e-9
        damping = np.append(np.zeros(n), 2 * zeta * w)
        if number:
            dyn = ExplicitDamping(atoms, 1.0, damping, push=np.outer(np.arange(2 * n) >= n, (-1.0, 0, 0)))
            frames = [1e-9 * np.ones(n)]
            for _ in range(8):
                dyn.run(1)
                frames.append(atoms.positions[free, 0] - 1)
        else:
            engine = 'compiled' if zeta else 'ase'  # damped motion falls below the round-off of positions
            dyn = DrivenVerlet(atoms, 1.0, [Constant(free, (-1, 0), 1.0)], damping, engine, allow_unstable=True)
            recorder = Recorder(dyn, interval=1)
            dyn.run(8)
            frames = recorder.displacements[:, free, 0]
        x = np.array(frames)[:9]
        measured = np.full(len(STEPS), np.nan)
        measured[np.isin(STEPS, w)] = [fitted_growth(y / abs(y).max()) for y in x.T]
        found.append(measured)
    return found


def _steps(measured, laws):
    checks = []
    for zeta in ZETAS:
        for number, name in enumerate(('exact split', 'explicit damping')):
            law = growth_per_step(*laws[zeta][number])
            checks.append(Check(f'growth factor of a step, {name}, zeta = {zeta:g}, largest misfit',
                                np.nanmax(abs(np.exp(measured[zeta][number]) - np.exp(law))), 0, 1e-4))
        split, damped = measured[zeta]
        checks.append(Check(f'exact split, zeta = {zeta:g}: number of runs on the wrong side of omega dt = 2',
                            misplaced(split, 2), 0, 0))
        if zeta > 1:
            checks += [Check(f'control: explicit damping, zeta = {zeta:g}: number of runs on the wrong side of omega dt = 2',
                             misplaced(damped, 2), 0, 0, control='explicit damping'),
                       Check(f'explicit damping, zeta = {zeta:g}: number of runs on the wrong side of omega dt = 2/zeta',
                             misplaced(damped, 2 / zeta), 0, 0)]
    return checks


def misplaced(growth, limit):
    """Number of runs that grow below a limit of omega dt or stay above it; those at the limit do not count."""
    grew = ~(growth < GREW)  # NaN grew too fast to be measured
    return np.sum((grew != (limit < STEPS))[abs(STEPS - limit) > 1e-9])


def _draw_steps(out, measured, laws):
    figure, (axes,) = panels(1, len(ZETAS), height=2.1)
    letter_panels(axes, [rf'$\zeta = {zeta:g}$' for zeta in ZETAS])
    for ax, zeta in zip(axes, ZETAS, strict=True):
        ax.axhspan(0, 2, zorder=0, **UNSTABLE)
        for number, (name, line, mark) in enumerate((('Verlet with exact decay', '-', 'o'), ('explicit damping', '--', 'x'))):
            colour = COLOURS[number]
            ax.plot(STEPS, growth_per_step(*laws[zeta][number]), line, color=colour, label=f'{name}, closed form')
            ax.plot(STEPS, measured[zeta][number], mark, color=colour, fillstyle='none', markersize=3, label='runs')
        ax.axvline(2, color='0.3', linewidth=0.8)
        ax.set(xlabel=r'$\omega\,\Delta t$', ylabel=r'growth in one step, $\ln|\lambda|$', ylim=(-1.5, 1.5), xlim=(0, 2.25))
        ax.label_outer()
    handles = axes[0].lines[:4]
    legend_of_set(figure, handles=handles, labels=[line.get_label() for line in handles], ncols=4)
    return save_picture(figure, out / 'stability_steps.png',
                        'Growth in one time step (hatched: unstable). The exact decay keeps the limit omega dt = 2 at every '
                        'damping; damping treated as a force fails beyond 2/zeta once zeta exceeds one.')
