"""A nonlinear transient: a plucked lattice step by step, and where the linear answer stops being good enough."""

from dataclasses import dataclass
from functools import cached_property, partial
from importlib.util import find_spec

import numpy as np
from ase import Atoms
from scipy.integrate import solve_ivp

from magphonon import DrivenVerlet, MagneticRepulsion, lattices, read_scene, ready_scene, units
from magphonon.dynamics.engine import highest_frequency
from magphonon.stiffness.matrices import condense

from .accuracy import Candidate, Chart, cheapest, measure, panels_of
from .rows import Check

AMPLITUDES = (1e-4, 1e-2, 1e-1)  # of the spacing
WIDTH = 1.5                      # of the plucked shape, in spacings
END = 60 * units.ms              # nine periods of the highest frequency
TARGET = 1e-6
GOOD = 0.01                      # error at which the linear answer is called no longer good enough
ENGINES = {'ase': "ASE's VelocityVerlet", 'numpy': 'Verlet, NumPy blocks', 'compiled': 'Verlet, compiled'}

# A splitting method is its coefficients: moves and kicks in turn, a move first, as shares of the time step.
_cube = 1 / (2 - 2 ** (1 / 3))
_move, _kick = (0.0, 0.245298957184271, 0.604872665711080), (0.0829844064174052, 0.396309801498368, -0.0390563049223486)
SPLITTINGS = {
    'Yoshida, 3 forces': ((_cube / 2, (1 - _cube) / 2, (1 - _cube) / 2, _cube / 2), (_cube, 1 - 2 * _cube, _cube)),
    # Blanes and Moan 2002, SRKN6b: the first force is the last one of the step before
    'Blanes-Moan, 6 forces': ((*_move, 1 / 2 - sum(_move), 1 / 2 - sum(_move), *_move[:0:-1], 0.0),
                              (*_kick, 1 - 2 * sum(_kick), *_kick[::-1])),
}


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
        """Displacements of the free particles at END, to some 1e-11 of the largest: forces of positions carry no more digits."""
        return dop853(self, 1e-12, {})

    def error(self, u):
        """Largest error of a displacement over the largest displacement."""
        return abs(u - self.exact).max() / abs(self.exact).max()


def chart(quick):
    """Error against time at three amplitudes; beside them, what the linear answer is worth."""
    patch, table = patch_of(12 if quick else 24), []
    for amplitude in AMPLITUDES:
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
    """Every method at several steps or tolerances."""
    runs = {}
    for engine, name in ENGINES.items():
        if engine == 'compiled' and not find_spec('numba'):
            continue
        shares = {'ase': (0.4, 0.1), 'numpy': (0.4, 0.1, 0.025), 'compiled': (0.4, 0.1, 0.025, 0.00625, 0.0009)}[engine]
        runs |= {(name, f'dt = {s:g} of the limit'): partial(verlet, pluck, s, engine) for s in shares}
    for name in SPLITTINGS:
        runs |= {(name, f'dt = {s:g} of the limit'): partial(splitting, pluck, s, name) for s in (0.2, 0.1, 0.05, 0.025)}
    runs |= {('DOP853', f'rtol = {r:.0e}'): partial(dop853, pluck, r) for r in (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)}
    runs['linear answer, by modes', ''] = partial(linear_answer, pluck)
    return [Candidate(*name, run, panel) for name, run in runs.items()]


def verlet(pluck, share, engine, cost):
    """Velocity Verlet with a time step of `share` of its limit."""
    steps = int(np.ceil(END / (share * pluck.limit)))
    cost['force evaluations'] = steps
    atoms = pluck.patch.copy()
    atoms.calc = pluck.patch.calc
    atoms.positions[:, :2] += pluck.start
    dyn = DrivenVerlet(atoms, END / steps, engine=engine)
    dyn.run(steps)
    return dyn.displacements[pluck.free]


def splitting(pluck, share, name, cost):
    """A splitting method; its time step counts per force, so that equal shares cost the same."""
    (first, *moves), kicks = SPLITTINGS[name]
    steps = int(np.ceil(END / (len(kicks) * share * pluck.limit)))
    h, a = END / steps, pluck.acceleration
    u, v = pluck.start[pluck.free], 0.0
    force = a(u) if first == 0 else None
    for _ in range(steps):
        if first == 0:  # no move before the first kick: its force is known
            v = v + kicks[0] * h * force
        else:
            u = u + first * h * v
            v = v + kicks[0] * h * a(u)
        for move, kick in zip(moves, kicks[1:], strict=False):
            u = u + move * h * v
            force = a(u)
            v = v + kick * h * force
        u = u + moves[-1] * h * v
    cost['force evaluations'] = steps * (len(kicks) - (first == 0)) + (first == 0)
    return u


def dop853(pluck, rtol, cost):
    """SciPy's adaptive eighth order."""
    u0, a = pluck.start[pluck.free].ravel(), pluck.acceleration
    size = len(u0)

    def slope(t, state):
        return np.append(state[size:], a(state[:size].reshape(-1, 2)))

    run = solve_ivp(slope, (0, END), np.append(u0, 0 * u0), 'DOP853', rtol=rtol, atol=rtol * abs(u0).max(), t_eval=[END])
    cost['force evaluations'] = run.nfev
    return run.y[:size, 0].reshape(-1, 2)


def linear_answer(pluck, cost):
    """Exact in time, by modes of the stiffness at rest: right for an amplitude that vanishes."""
    patch = pluck.patch
    H = patch.calc.get_hessian(patch).tocsr()
    in_plane = np.flatnonzero(np.tile([True, True, False], len(patch)))
    H = condense(H[in_plane][:, in_plane], pluck.free)
    cost['eigensolves'] = 1
    w2, modes = np.linalg.eigh(H.toarray() / patch.get_masses()[0])
    return (modes @ (np.cos(np.sqrt(w2) * END) * (modes.T @ pluck.start[pluck.free].ravel()))).reshape(-1, 2)


def checks(table, amplitudes, linear):
    """Orders that theory gives, at the middle amplitude, from the two shortest steps; and how the linear answer fails."""
    def order(method):
        own = [m for m in table if m.method == method and m.panel == f'Amplitude {AMPLITUDES[1]:g} L0']
        e, n = (np.log([getter(m) for m in own[-2:]]) for getter in (lambda m: m.error, lambda m: m.cost['force evaluations']))
        return (e[0] - e[1]) / (n[1] - n[0])

    slope = np.polyfit(np.log(amplitudes[:3]), np.log(linear[:3]), 1)[0]
    return [
        Check('nonlinear: order of Verlet in blocks', order(ENGINES['numpy']), 2, 0.05),  # next term: (w dt)^2, 3e-3
        *(Check(f'nonlinear: order of {name}', order(name), 4, 0.1) for name in SPLITTINGS),
        Check('control: fourth order by Verlet', order(ENGINES['numpy']), 4, 0.1, control=True),
        Check('nonlinear: error of the linear answer grows with this power of the amplitude', slope, 1, 0.05),
        Check(f'control: the linear answer at {amplitudes[-1]:g} L0, error', linear[-1], 0, GOOD, control=True),
    ]


def reading(panels, enough):
    """What the chart says."""
    words, names = [], list(ENGINES.values())
    for panel, table in panels.items():
        steps = [m for m in table if not m.method.startswith('linear')]
        best = cheapest(steps, TARGET)
        linear = next(m for m in table if m.method.startswith('linear'))
        verlet = cheapest([m for m in steps if m.method in names], TARGET)
        beside = f', {verlet.method} in {verlet.seconds:.2g} s' if verlet else ', Verlet at no step charted'
        words.append(f'{panel}: {best.method} reaches {TARGET:.0e} in {best.seconds:.2g} s{beside}; the linear answer is off by '
                     f'{linear.error:.1g}.')
    rough = cheapest([m for m in table if m.method in (*names, *SPLITTINGS)], 1e-3)
    return (' '.join(words) + f' For an error of 1e-3, {rough.method} is cheapest. '
            f'The linear answer is good to {GOOD:.0%} up to {enough:.1g} L0.')
