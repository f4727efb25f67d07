"""A nonlinear transient: a plucked lattice step by step, and where the linear answer stops being good enough."""

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from ase import Atoms
from scipy.integrate import solve_ivp

from magphonon import DrivenVerlet, MagneticRepulsion, lattices, read_scene, units
from magphonon.dynamics.engine import highest_frequency
from magphonon.dynamics.splittings import SPLITTINGS
from magphonon.scenes import ready_scene

from .accuracy import Candidate, Chart, cheapest, measure, panels_of
from .rows import Check

AMPLITUDES = (1e-4, 1e-2, 1e-1)  # of the spacing
WIDTH = 1.5                      # of the plucked shape, in spacings
END = 60 * units.ms              # nine periods of the highest frequency
TARGET = 1e-6
GOOD = 0.01                      # error at which the linear answer is called no longer good enough
METHODS = {
    "ASE's VelocityVerlet": ('ase', 2, (0.4, 0.1)),
    'Verlet, compiled': ('compiled', 2, (0.4, 0.1, 0.025, 0.00625, 0.0009)),
    'order 4, compiled': ('compiled', 4, (0.2, 0.1, 0.05, 0.025)),
    'order 6, compiled': ('compiled', 6, (0.14, 0.07, 0.035)),
}
"""Engine, order, and time step for each evaluation of the forces, in units of Verlet's limit: equal values cost the same."""


@dataclass(frozen=True)
class Pluck:
    """A patch with a held rim, released from a displaced shape of a given amplitude."""

    patch: Atoms
    amplitude: float

    @cached_property
    def start(self):
        """Displacements at the start in mm, shape (particles, 2): a bump in the middle, oblique to the lattice."""
        L0 = self.patch.calc.bonds.lengths.min()
        r2 = (self.patch.positions[:, :2] ** 2).sum(axis=1)
        bump = np.exp(-r2 / (2 * (WIDTH * L0) ** 2)) * self.free
        return self.amplitude * L0 * bump[:, None] * [np.cos(0.4), np.sin(0.4)]

    @cached_property
    def free(self):
        """Whether a particle is inside the rim."""
        return self.patch.get_tags() == 0

    @cached_property
    def limit(self):
        """Longest stable time step of Verlet at small amplitude, ms."""
        return 2 / highest_frequency(self.patch)

    @cached_property
    def acceleration(self):
        """Function from displacements of the free particles, shape (free, 2), to their accelerations."""
        calc, mass = self.patch.calc, self.patch.get_masses()[0]
        C, R = calc.bonds.incidence[:, np.flatnonzero(self.free)].tocsr(), calc.bonds.vectors[:, :2]
        CT, dphi, k = C.T.tocsr(), calc.laws.dphi, calc.parameters.foundation

        def acceleration(u):
            bond = R + C @ u
            r = np.sqrt(bond[:, 0] ** 2 + bond[:, 1] ** 2)
            return -(CT @ ((dphi(r) / r)[:, None] * bond) + k * u) / mass

        return acceleration

    @cached_property
    def exact(self):
        """Displacements of the free particles at END, to 1e-11 of the largest: forces from positions have no more digits."""
        return dop853(self, 1e-12, {})

    def error(self, u):
        """Largest error of a displacement over the largest displacement."""
        return abs(u - self.exact).max() / abs(self.exact).max()


def chart(quick):
    """Error against time at three amplitudes, of the linear answer too."""
    patch, table = patch_of(12 if quick else 24), []
    for amplitude in AMPLITUDES[:2] if quick else AMPLITUDES:  # each is a kernel of its own
        pluck = Pluck(patch, amplitude)
        table += measure(candidates(pluck, f'Amplitude {amplitude:g} L0'), pluck.error, repeats=1 if quick else 5)
    amplitudes = np.logspace(-4, -1, 4)
    linear = np.array([pluck.error(linear_answer(pluck, {})) for pluck in (Pluck(patch, a) for a in amplitudes)])
    enough = float(np.exp(np.interp(np.log(GOOD), np.log(linear), np.log(amplitudes))))
    return Chart('Plucked lattice, nonlinear', table, reading(panels_of(table), enough), checks(table, amplitudes, linear),
                 'largest error / largest displacement')


def patch_of(n):
    """`n x n` particles of the prototype with their rim held."""
    cell = read_scene(ready_scene('prototype')).atoms()
    patch = lattices.parallelogram(cell, n, n)
    patch.calc = MagneticRepulsion(patch, cell.calc.laws, **cell.calc.parameters)
    return patch


def candidates(pluck, panel):
    """Candidates: every method at several steps or tolerances."""
    runs = {}
    for name, (engine, order, shares) in METHODS.items():
        runs |= {(name, f'dt = {s:g} of the limit for each force'): partial(stepped, pluck, s, engine, order) for s in shares}
    runs |= {('DOP853', f'rtol = {r:.0e}'): partial(dop853, pluck, r) for r in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)}
    runs['linear answer, by modes', ''] = partial(linear_answer, pluck)
    return [Candidate(*name, run, panel) for name, run in runs.items()]


def stepped(pluck, share, engine, order, cost):
    """Time steps of the package. Each is `share` of Verlet's limit for each of its evaluations of the forces."""
    stages = SPLITTINGS[order].stages
    steps = int(np.ceil(END / (stages * share * pluck.limit)))
    cost['force evaluations'] = steps * stages
    atoms = pluck.patch.copy()
    atoms.calc = pluck.patch.calc
    atoms.positions[:, :2] += pluck.start
    dyn = DrivenVerlet(atoms, END / steps, engine=engine, order=order)
    dyn.run(steps)
    return dyn.displacements[pluck.free]


def dop853(pluck, rtol, cost):
    """SciPy's adaptive integrator of eighth order."""
    u0, a = pluck.start[pluck.free].ravel(), pluck.acceleration
    size = len(u0)

    def slope(t, state):
        return np.append(state[size:], a(state[:size].reshape(-1, 2)))

    run = solve_ivp(slope, (0, END), np.append(u0, 0 * u0), 'DOP853', rtol=rtol, atol=rtol * abs(u0).max(), t_eval=[END])
    cost['force evaluations'] = run.nfev
    return run.y[:size, 0].reshape(-1, 2)


def linear_answer(pluck, cost):
    """The linear answer, exact in time, from modes of the stiffness at rest: right in the limit of small amplitude."""
    patch = pluck.patch
    H = patch.calc.get_hessian(patch).tocsr()
    free = np.flatnonzero(np.repeat(pluck.free, 3) & np.tile([True, True, False], len(patch)))
    cost['eigensolves'] = 1
    w2, modes = np.linalg.eigh(H[free][:, free].toarray() / patch.get_masses()[0])
    return (modes @ (np.cos(np.sqrt(w2) * END) * (modes.T @ pluck.start[pluck.free].ravel()))).reshape(-1, 2)


def checks(table, amplitudes, linear):
    """Checks of orders against theory, from the two shortest steps at the middle amplitude, and of the linear answer."""
    def order(method):
        own = [m for m in table if m.method == method and m.panel == f'Amplitude {AMPLITUDES[1]:g} L0']
        e, n = (np.log([getter(m) for m in own[-2:]]) for getter in (lambda m: m.error, lambda m: m.cost['force evaluations']))
        return (e[0] - e[1]) / (n[1] - n[0])

    slope = np.polyfit(np.log(amplitudes[:3]), np.log(linear[:3]), 1)[0]
    return [
        Check('nonlinear: order of Verlet', order('Verlet, compiled'), 2, 0.05),  # next term: (w dt)^2, 3e-3
        Check('nonlinear: order of steps of order 4', order('order 4, compiled'), 4, 0.1),
        Check('nonlinear: order of steps of order 6', order('order 6, compiled'), 6, 0.3),  # next term larger, as steps are long
        Check('control: fourth order by Verlet', order('Verlet, compiled'), 4, 0.1, control='Verlet'),
        Check('nonlinear: power of the amplitude with which the error of the linear answer grows', slope, 1, 0.05),
        Check(f'control: error of the linear answer at {amplitudes[-1]:g} L0', linear[-1], 0, GOOD, control='the linear answer'),
    ]


def reading(panels, enough):
    """The conclusion of the chart in words."""
    words, names = [], [name for name, (_, order, _) in METHODS.items() if order == 2]
    for panel, table in panels.items():
        steps = [m for m in table if not m.method.startswith('linear')]
        best = cheapest(steps, TARGET)
        linear = next(m for m in table if m.method.startswith('linear'))
        verlet = cheapest([m for m in steps if m.method in names], TARGET)
        beside = f', {verlet.method} in {verlet.seconds:.2g} s' if verlet else ', Verlet at no step charted'
        words.append(f'{panel}: {best.method} reaches {TARGET:.0e} in {best.seconds:.2g} s{beside}; the linear answer is off by '
                     f'{linear.error:.1g}.')
    rough = cheapest([m for m in table if m.method in METHODS], 1e-3)
    return (' '.join(words) + f' For an error of 1e-3, {rough.method} is cheapest. '
            f'The linear answer is good to {GOOD:.0%} up to {enough:.1g} L0.')
