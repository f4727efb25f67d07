"""How small a displacement may be: the V-curve of numerical derivatives, and the range of amplitudes for runs in time."""

from dataclasses import dataclass
from functools import cached_property, partial
from importlib.util import find_spec

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms

from magphonon import DrivenVerlet, MagneticRepulsion, read_scene, ready_scene
from magphonon.dynamics.engine import highest_frequency
from magphonon.plotting.axes import letter_panels, panels
from magphonon.stiffness.matrices import signed_root

from .accuracy import Candidate, Chart, looks_of, measure, panels_of
from .accuracy_bands import closed_form, finite_differences
from .rows import Check

DISTANCES = np.logspace(-9, -1, 17)    # of the spacing
AMPLITUDES = np.logspace(-12, -1, 12)  # of the spacing
SIDES = {True: 'plus-minus', False: 'one-sided'}
LOOPS = {'held': "ASE's loop, FixAtoms", 'ase': "ASE's loop, no constraint", 'numpy': 'NumPy blocks',
         'compiled': 'compiled blocks'}
STEPS, SHARE = 400, 0.1                # time steps, and their length over the stability limit
DIGITS = 1e-10                         # what displacements from rest keep however small they are
COMPILED = 1e-3                        # largest amplitude at which --quick compiles: above it six more laws, seconds each
DERIVATIVE, WINDOW = 'finite displacements', f'{STEPS} time steps'


def chart(quick):
    """Errors over the displacement instead of over time, because the cost of a method hardly depends on the displacement."""
    amplitudes = np.append(AMPLITUDES[::2], AMPLITUDES[-1]) if quick else AMPLITUDES
    repeats = 1 if quick else 3
    table = displaced(repeats) + kicked(amplitudes, repeats, COMPILED if quick else np.inf)
    curves = {(panel, method): np.array([m.error for m in own if m.method == method])
              for panel, own in panels_of(table).items() for method in dict.fromkeys(m.method for m in own)}
    return Chart('How small a displacement may be', table, reading(curves, amplitudes), checks(curves, amplitudes),
                 draw=partial(draw, {DERIVATIVE: DISTANCES, WINDOW: amplitudes}))


# --- numerical derivative --------------------------------------------------------------------------------------------

def displaced(repeats):
    """Frequencies of the prototype from forces on displaced particles, against the closed form."""
    cell = read_scene(ready_scene('prototype')).atoms()
    kpts = cell.cell.bandpath('GMKG', npoints=60, pbc=cell.pbc).kpts
    exact, L0 = closed_form(cell, kpts, real=np.longdouble), cell.cell.lengths()[0]
    candidates = [Candidate(f'phonopy, {sides}', f'd = {d:.2e} L0',
                            partial(finite_differences, cell, kpts, (3, 3, 1), d * L0, both), DERIVATIVE)
                  for both, sides in SIDES.items() for d in DISTANCES]
    return measure(candidates, lambda omega: abs(omega - exact).max() / exact.max(), repeats)


# --- runs in time ----------------------------------------------------------------------------------------------------

@dataclass(frozen=True)
class Kick:
    """A periodic lattice at rest in which one particle receives a velocity; a row of others may be held."""

    atoms: Atoms
    held: bool

    def __post_init__(self):
        if self.held:
            self.atoms.set_constraint(FixAtoms(np.flatnonzero(~self.free)))

    @cached_property
    def free(self):
        """Whether a particle may move."""
        y = self.atoms.positions[:, 1]
        return (y > y.min() + 1e-6) | (not self.held)

    @cached_property
    def particle(self):
        """The particle that receives the velocity, in the middle."""
        return len(self.atoms) // 2 + round(len(self.atoms) ** 0.5) // 2

    @cached_property
    def dt(self):
        """Time step in ms."""
        return SHARE * 2 / highest_frequency(self.atoms)

    @cached_property
    def linear(self):
        """Linear answer of Verlet in closed form: displacements after the last step over the velocity of the kick (ms).

        A mode of the frequency w that starts from rest with the velocity v is after n steps at
        `v dt sin(n a)/sin(a)` with `cos a = 1 - (w dt)^2/2`; so time steps leave no difference.
        """
        n, mass = len(self.atoms), self.atoms.get_masses()[0]
        H = self.atoms.calc.get_hessian(self.atoms).tocsr()
        free = np.flatnonzero(np.repeat(self.free, 3) & np.tile([True, True, False], n))
        w2, modes = np.linalg.eigh(H[free][:, free].toarray() / mass)
        start = np.zeros((n, 2))
        start[self.particle] = self.direction
        a = 2 * np.arcsin(signed_root(w2) * self.dt / 2)
        u = np.zeros((n, 2))
        reached = modes @ (self.dt * np.sin(STEPS * a) / np.sin(a) * (modes.T @ start[self.free].ravel()))
        u[self.free] = reached.reshape(-1, 2)
        return u

    @property
    def direction(self):
        return np.array([np.cos(0.4), np.sin(0.4)])

    def run(self, amplitude, engine, cost):
        """Displacements after the last step, divided by the largest of the linear answer, which is `amplitude` spacings."""
        cost['force evaluations'] = STEPS
        atoms = self.atoms.copy()
        atoms.calc = self.atoms.calc
        size = amplitude * atoms.calc.bonds.lengths.min()
        momenta = np.zeros((len(atoms), 3))
        momenta[self.particle, :2] = size / abs(self.linear).max() * self.direction * atoms.get_masses()[0]
        atoms.set_momenta(momenta)
        dyn = DrivenVerlet(atoms, self.dt, engine=engine)
        dyn.run(STEPS)
        return dyn.displacements / size

    def departure(self, u):
        """Largest difference from the linear answer over its largest displacement."""
        return abs(u - self.linear / abs(self.linear).max()).max()


def kicked(amplitudes, repeats, compiled):
    """Departure of every loop from the linear response after some hundred steps; compiled blocks only up to an amplitude."""
    cell, table = read_scene(ready_scene('prototype')).atoms(), []
    for name, method in LOOPS.items():
        if name == 'compiled' and not find_spec('numba'):
            continue
        lattice = cell.repeat((6, 6, 1))
        lattice.calc = MagneticRepulsion(lattice, cell.calc.laws, **cell.calc.parameters)
        kick = Kick(lattice, held=name == 'held')
        engine = 'ase' if name == 'held' else name
        table += measure([Candidate(method, f'amplitude {a:.0e} L0', partial(kick.run, a, engine), WINDOW)
                          for a in amplitudes if name != 'compiled' or a <= compiled], kick.departure, repeats)
    return table


# --- what they show --------------------------------------------------------------------------------------------------

def slope(x, y, low, high):
    """Exponent of y as a power of x between two values of x."""
    inside = (x > 0.9 * low) & (x < 1.1 * high)
    return np.polyfit(np.log(x[inside]), np.log(y[inside]), 1)[0]


def checks(curves, amplitudes):
    """Checks of the slopes on both sides against theory, and of the digits that are left at the smallest amplitude."""
    both, one = (curves[DERIVATIVE, f'phonopy, {sides}'] for sides in SIDES.values())
    first_order = slope(DISTANCES, one, 1e-6, 1e-3)
    tests = [
        Check('derivative, both sides: order of the error above round-off', slope(DISTANCES, both, 1e-4, 1e-2), 2, 0.05),
        Check('derivative, both sides: order of the error by round-off',
              slope(DISTANCES, both, 1e-9, 1e-7), -1, 0.2),  # round-off scatters
        Check('derivative, one side: order of the error above round-off', first_order, 1, 0.05),
        Check('control: derivative, one side, against the order of both sides', first_order, 2, 0.3, control=True),
    ]
    for name in ('held', 'ase'):
        u = curves[WINDOW, LOOPS[name]]
        tests += [Check(f'amplitude window, {LOOPS[name]}: order of the error by round-off',
                        slope(amplitudes, u, 1e-12, 1e-8), -1, 0.2),
                  Check(f'control: {LOOPS[name]}, error at the smallest amplitude', u[0], 0, DIGITS, control=True)]
    for name in ('numpy', 'compiled'):
        if (WINDOW, LOOPS[name]) in curves:
            u = curves[WINDOW, LOOPS[name]]
            power = slope(amplitudes[:len(u)], u, 1e-7, 1e-3)
            tests += [Check(f'amplitude window, {LOOPS[name]}: order of the error above round-off', power, 1, 0.05),
                      Check(f'amplitude window, {LOOPS[name]}: error at the smallest amplitude', u[0], 0, DIGITS)]
    return tests


def reading(curves, amplitudes):
    """The conclusion of the chart in words."""
    both, one = (curves[DERIVATIVE, f'phonopy, {sides}'] for sides in SIDES.values())
    held, free, blocks = (curves[WINDOW, LOOPS[name]] for name in ('held', 'ase', 'numpy'))
    def best(x, errors):
        return f'{errors.min():.0e}, at {x[errors.argmin()]:.0e} L0'

    return (f'With displacements to both sides bands are good to {best(DISTANCES, both)}, to one side to {best(DISTANCES, one)}. '
            f"In time, the least departure from the linear response is {best(amplitudes, held)}, in ASE's loop with FixAtoms, "
            f'and {best(amplitudes, free)}, without a constraint; blocks, which carry displacements from rest, still follow it '
            f'to {blocks[0]:.0e} at {amplitudes[0]:.0e} L0.')


def draw(values, chart):
    """Error over displacement, a panel for each question."""
    figure, (axes,) = panels(1, 2, height=2.7)
    letter_panels(axes)
    titles = 'displacement of the numerical derivative / $L_0$', f'largest displacement after {STEPS} steps / $L_0$'
    for ax, title, (panel, table) in zip(axes, titles, panels_of(chart.measurements).items(), strict=True):
        looks = looks_of(table)
        widths = np.linspace(2.0, 0.8, len(looks))  # each thinner than those below it, as some coincide
        for (method, (colour, marker, line)), width in zip(looks.items(), widths, strict=True):
            errors = [m.error for m in table if m.method == method]
            ax.loglog(values[panel][:len(errors)], errors, color=colour, marker=marker, linestyle=line, fillstyle='none',
                      linewidth=width, markersize=2 * width + 1.5, label=method)
        ax.set(xlabel=title, ylim=(0.01 * min(m.error for m in chart.measurements), 10))
        ax.legend(loc='lower right')
    axes[0].set_ylabel('error of a frequency / highest frequency')
    axes[1].set_ylabel('departure from the linear response')
    return figure
