"""Hundreds of small scenes whose true errors are found by methods independent of those that estimate them.

    peaks       the oscillator's motion at finite amplitude from one first integral and adaptive integration
    waveforms   velocity Verlet with short steps, extrapolated to zero step

Each has a `plan` for a tolerance, and the `truth` about a method: its error in the wanted quantity.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, Recorder, ToneBurst, Yukawa, lattices
from magphonon.bands.bloch import bloch_modes
from magphonon.dynamics.engine import highest_frequency
from magphonon.planning.peak import plan_peak
from magphonon.planning.waveform import as_model, difference, plan_waveform
from magphonon.response.frf import Dof
from magphonon.stiffness.all_neighbours import AllNeighbours
from magphonon.stiffness.bond import MODELS
from magphonon.waves.wave_source import burst_setup

TOLERANCES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
LAWS = InversePower(1.0, 3.0), InversePower(1.0, 4.0), InversePower(1.0, 4.58), Yukawa(1.0, 2.0)
"""Laws in units of the spacing, 1 mm."""
FRAMES = 60
"""Moments at which waveforms are compared."""
STEPS = 0.03
"""Time step of the true waveform, as a share of the limit 2/omega_max; a second run at twice this step extrapolates it."""


@dataclass(frozen=True)
class Peak:
    """The oscillator, driven along its line to about a given amplitude (in spacings) at its peak."""

    law: object
    angle: float
    amplitude: float
    damping: float = 0.01

    @cached_property
    def _atoms(self):
        from ase.constraints import FixedLine

        atoms = lattices.oscillator(np.deg2rad(self.angle), 1.0, 1.0)
        atoms.set_constraint([*atoms.constraints, FixedLine(3, (0, 1, 0))])
        atoms.calc = MagneticRepulsion(atoms, self.law, bonds=lattices.OSCILLATOR_BONDS).balanced([3])
        return atoms

    def plan(self, tolerance):
        w, where = self._linear('complete'), Dof(3, np.array([0.0, 1.0, 0.0]))
        return plan_peak(self._atoms, where, where, np.linspace(w / 2, 2 * w, 100), self.damping, tolerance, self._force)

    @property
    def _force(self):
        return self.amplitude * self.damping * self._linear('complete')

    def _pull(self, y):
        """Force along the line at the height y above rest, minus the static force; the magnets are three points."""
        s, c = np.sin(np.deg2rad(self.angle)), np.cos(np.deg2rad(self.angle))
        force = 0.0
        for x0, y0 in ((c, -s), (-c, -s), (0, -1)):
            r = np.sqrt(x0**2 + (y - y0) ** 2)
            force = force - self.law.dphi(r) * (y - y0) / r + self.law.dphi(1.0) * -y0
        return force

    def _linear(self, model):
        if model == 'complete':
            return float(np.sqrt(-(self._pull(1e-30j)).imag / 1e-30))  # complex step
        s = np.sin(np.deg2rad(self.angle))
        return float(np.sqrt(self.law.d2phi(1.0) * (2 * s**2 + 1)))

    @cached_property
    def _true(self):
        """Frequency at which the first harmonic lags the force by 90 degrees and has the amplitude A = F/(gamma W)."""
        from scipy.integrate import solve_ivp
        from scipy.optimize import brentq

        def vibration(top):
            done = lambda t, state: state[1]  # at the lower turning point  # noqa: E731
            done.terminal, done.direction = True, 1
            half = solve_ivp(lambda t, state: (state[1], self._pull(state[0])), (0, 1e4), (top, 0.0), 'DOP853', events=done,
                             rtol=1e-11, atol=1e-14, dense_output=True, first_step=1e-3)
            T = half.t_events[0][0]
            phase = (np.arange(64) + 0.5) / 64
            return np.pi / T, 2 * np.mean(half.sol(T * phase)[0] * np.cos(np.pi * phase))

        def excess(top):
            W, A = vibration(top)
            return A * self.damping * W / self._force - 1

        return vibration(brentq(excess, 0.5 * self.amplitude, 1.7 * self.amplitude, xtol=1e-12))[0]

    def truth(self, method):
        if method.dt is not None:
            x = self._true * method.dt / 2
            return float(np.arcsin(x) / x - 1)
        return abs(self._linear(method.model) / self._true - 1)


@dataclass(frozen=True)
class Waveform:
    """A burst that a row of particles sends through a strip; its force is given as a share of f(L0)."""

    kind: str
    law: object
    foundation: float
    direction: tuple
    carrier: float
    force: float
    rows: int = 20

    @cached_property
    def _atoms(self):
        return strip(getattr(lattices, self.kind)(1.0, 1.0), self.rows, self.law, self.foundation)

    @cached_property
    def _burst(self):
        """Drive, measured row, damping and duration."""
        atoms, low = self._atoms, np.sqrt(self.foundation)
        omega = low + self.carrier * (highest_frequency(atoms) - low)
        inside = np.flatnonzero(atoms.get_tags() == 0)
        y = atoms.positions[inside, 1]
        force = -self.force * self.law.dphi(1.0)
        drive = ToneBurst(inside[y < y.min() + 1e-6], self.direction, force, omega, cycles=5)
        return drive, inside[:: len(inside) // (self.rows - 2)], 0.01 * omega, 1.6 * drive.end

    def plan(self, tolerance):
        return plan_waveform(self._atoms, *self._burst, tolerance)

    def _verlet(self, dt, model='complete', share=1.0, order=2):
        """Displacements of the row at FRAMES equal times, with steps of at most dt."""
        drive, row, damping, duration = self._burst
        interval = int(np.ceil(duration / dt / FRAMES))
        dyn = DrivenVerlet(as_model(self._atoms, model), duration / interval / FRAMES,
                           [replace(drive, amplitude=share * drive.amplitude)], damping, engine='numpy', order=order)
        record = Recorder(dyn, row, interval)
        dyn.run(interval * FRAMES)
        return record.displacements[1:] / share, duration / interval / FRAMES

    def _limit(self, model='complete', share=1.0):
        dt = STEPS * 2 / highest_frequency(self._atoms)
        (coarse, h2), (fine, h1) = (self._verlet(h, model, share) for h in (2 * dt, dt))
        return fine + (fine - coarse) * h1**2 / (h2**2 - h1**2)

    @cached_property
    def _true(self):
        return self._limit()

    @cached_property
    def _linear(self):
        return {model: self._limit(model, share=1e-7) for model in MODELS}

    def truth(self, method):
        if method.dt is not None:
            return difference(self._verlet(method.dt, order=method.order)[0], self._true)
        return difference(self._linear[method.model], self._true)


@dataclass(frozen=True)
class Beam(Waveform):
    """A burst from a row of a patch; its force falls off to the sides."""

    rows: int = 14

    @cached_property
    def _cell(self):
        cell = getattr(lattices, self.kind)(1.0, 1.0)
        cell.calc = MagneticRepulsion(cell, self.law, foundation=self.foundation)
        return cell

    @cached_property
    def _atoms(self):
        return patch_with_law(self._cell, lattices.parallelogram(self._cell, self.rows, self.rows))

    @cached_property
    def _site(self):
        return burst_setup(self._cell, self._atoms, 'row')

    @cached_property
    def _burst(self):
        low = np.sqrt(self.foundation)
        omega = low + self.carrier * (highest_frequency(self._atoms) - low)
        drive = self._site.burst(self.direction, -self.force * self.law.dphi(1.0), omega)
        return drive, self._site.row, 0.01 * omega, 1.6 * drive.end


def strip(cell, rows, law, foundation=0.0):
    """A ribbon with a given law, in which a burst from a whole row of sources travels as in the lattice."""
    ribbon = lattices.ribbon(cell, rows)
    ribbon.calc = MagneticRepulsion(ribbon, law, foundation=foundation)
    return ribbon


def patch_with_law(cell, patch):
    """A patch of a cell with the law and foundation of the cell."""
    patch.calc = MagneticRepulsion(patch, cell.calc.laws, **cell.calc.parameters)
    return patch


def situations(quick=False):
    """The situations of the grid: all of them, or a few of each kind."""
    r3, r4, r458, yukawa = LAWS
    peaks = [Peak(law, angle, amplitude) for law in LAWS for angle in (0, 30, 45, 90) for amplitude in (1e-3, 0.01, 0.03, 0.08)]
    waves = [Waveform(kind, law, 0.2 if kind == 'triangular' else 8.0, direction, carrier, force)
             for kind, law in (('triangular', r4), ('triangular', yukawa), ('square', r458), ('honeycomb', r4), ('kagome', r3))
             for direction, carrier in (((1, 0), 0.3), ((0, 1), 0.6)) for force in (1e-4, 3e-3, 1e-1)]
    beams = [Beam(kind, r4, k, direction, carrier, force)
             for kind, k in (('triangular', 0.0), ('triangular', 0.2), ('square', 8.0))
             for direction, carrier in (((1, 0), 0.3), ((0, 1), 0.6)) for force in (1e-3, 3e-2)]
    return [*peaks[::5], *waves[1::15]] if quick else [*peaks, *waves, *beams]


def drawn(count, seed):
    """`count` random situations of each kind but beams, each with a tolerance; the planner was not tuned on them.

    The oscillator stays below 0.03 L0: farther up, steep laws push it out between the upper two magnets.
    """
    draw = np.random.default_rng(seed)
    for _ in range(count):
        laws = [InversePower(1.0, draw.uniform(2.5, 10)), Yukawa(1.0, draw.uniform(0.5, 4))]
        law = laws[draw.integers(2)]
        yield Peak(law, draw.uniform(0, 90), 10 ** draw.uniform(-3, -1.5)), 10 ** draw.uniform(-4, -1)
        kind, angle = str(draw.choice(['square', 'triangular', 'honeycomb', 'kagome'])), draw.uniform(0, 2 * np.pi)
        yield (Waveform(kind, law, held(kind, law, draw), (np.cos(angle), np.sin(angle)), draw.uniform(0.15, 0.8),
                        10 ** draw.uniform(-4, -1)), 10 ** draw.uniform(-4, -1))


def held(kind, law, draw):
    """A foundation in N/mm somewhat stiffer than the lattice needs to be stable."""
    cell = getattr(lattices, kind)(1.0, 1.0)
    cell.calc = AllNeighbours(cell, law)
    nearest = cell.copy()
    nearest.calc = MagneticRepulsion(nearest, law)
    q = np.stack(np.meshgrid(*2 * [np.arange(12) / 12], [0.0]), axis=-1).reshape(-1, 3)
    lowest = min((abs(w) * w).min() for w, _ in (bloch_modes(atoms, q) for atoms in (cell, nearest)))
    return float(max(-lowest, 0) * draw.uniform(1.1, 2) + draw.uniform(0.2, 1))
