"""The cost of a frequency response: steady motion in time, one impulse, modes, factorisations, and one series for all
frequencies.
"""

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from ase import Atoms

from magphonon import DrivenVerlet, MagneticRepulsion, lattices, units
from magphonon.dynamics import Harmonic, Recorder
from magphonon.response.frf import harmonic_response, series_response
from magphonon.response.normal_modes import modes
from magphonon.response.stepped import impulse_response, steady_amplitudes
from magphonon.stiffness.rest import LinearSystem

from .accuracy import Candidate, Chart, cheapest, measure, panels_of, spoken
from .accuracy_transient import prototype
from .rows import Check

FREQUENCIES = np.linspace(20, 160, 400) * units.Hz  # from below the cut-off of 26.55 Hz to above the highest mode
GAMMA = 10 / units.s         # 1.6 % of critical at 50 Hz
FORCE = 1e-10 * units.N      # moves particles by 1e-9 L0: a linear response
IMPULSE = 1e-9 * units.N * units.ms
TIGHT = 1e-6
SAMPLE = 100                 # the dearest methods answer at every so many frequencies
FRAMES = 1.5 * units.ms      # four to the shortest period; the Fourier integral of an impulse wants twelve
STEPPED, IMPULSIVE = 'time steps to the steady state', 'time steps after one impulse'
SERIES = 'Chebyshev series'
DIRECT = 'factorisation at each frequency'


@dataclass(frozen=True)
class Shaken:
    """Particles that are shaken along y, and their exact response."""

    atoms: Atoms
    particle: int
    omega: np.ndarray
    gamma: float
    limit: float
    exact: np.ndarray = None

    @property
    def push(self):
        """A unit force."""
        force = np.zeros((len(self.atoms), 3))
        force[self.particle, 1] = 1
        return force

    def error(self, response):
        """Largest relative error at the frequencies of the answer: every SAMPLE-th one, or all."""
        exact = self.exact[::SAMPLE] if len(response) < len(self.exact) else self.exact
        return abs(response / exact - 1).max()


def chart(quick):
    """Error against time for patches."""
    budget = {'repeats': 2 if quick else 5, 'patience': 0.3 if quick else 1.0}
    table, checks = [], []
    for n in [32] if quick else [32, 100]:
        panel = f'N = {n * n}, {len(FREQUENCIES)} frequencies'
        shaken = patch(n)
        own = measure(candidates(shaken, panel, quick), shaken.error, **budget)
        own = [whole(m) if m.method == STEPPED or (m.method == DIRECT and (quick or n > 50)) else m for m in own]
        table += own
        checks += [Check(f'frf, {panel}: {m.method}, difference from the series', m.error, 0.0, 1e-8, by='two methods')
                   for m in own if m.method in ('modal sum', DIRECT)]
        steps = min((m for m in own if m.method == STEPPED), key=lambda m: m.error)
        products = min(m.cost['products'] for m in own if m.method == SERIES and m.error <= steps.error)
        checks.append(Check(f'frf, {panel}: products of the series / time steps for the same error',
                            products / steps.cost['force evaluations'], 0.0, 1e-3, by='two methods'))
    return Chart('Frequency response at the driven magnet', table, reading(panels_of(table)), checks,
                 error='largest relative error of the response')


def whole(m):
    """The cost at all frequencies of methods that were run at every SAMPLE-th: each frequency is a run of its own."""
    return replace(m, setting=f'{m.setting}, {SAMPLE} x a sample', seconds=SAMPLE * m.seconds, median=SAMPLE * m.median,
                   cost={name: SAMPLE * count for name, count in m.cost.items()})


def patch(n):
    """`n x n` particles of the prototype, of which one near the middle is shaken; the series gives its response to 1e-12."""
    cell, limit = prototype()
    atoms = lattices.parallelogram(cell, n, n)
    atoms.calc = MagneticRepulsion(atoms, cell.calc.laws, **cell.calc.parameters)
    particle = int(np.linalg.norm(atoms.positions, axis=1).argmin())
    shaken = Shaken(atoms, particle, 2 * np.pi * FREQUENCIES, GAMMA, limit)
    return replace(shaken, exact=series(shaken, 1e-12, Counter()))


def candidates(shaken, panel, quick):
    """Candidates: every method that can answer for a patch of this size."""
    large = len(shaken.atoms) > 2000
    runs = {(STEPPED, f'dt = {s:g} of the limit'): partial(stepped, shaken, s * shaken.limit)
            for s in ([0.1] if quick else [0.1, 0.03])}
    runs |= {(IMPULSIVE, f'dt = {s:g} of the limit'): partial(struck, shaken, s * shaken.limit)
             for s in ([0.05] if quick else [0.2, 0.1, 0.05, 0.02][: 3 if large else 4])}
    runs[DIRECT, 'SuperLU'] = partial(direct, shaken, SAMPLE if quick or large else 1)
    if not quick and not large:
        runs['modal sum', 'all modes'] = partial(modal, shaken)
    runs |= {(SERIES, f'tolerance = {t:.0e}'): partial(series, shaken, t)
             for t in ((1.0, 1e-2, 1e-6) if quick else (1.0, 1e-1, 1e-3, 1e-6, 1e-9))}
    return [Candidate(*name, run, panel) for name, run in runs.items()]


def series(shaken, tolerance, cost):
    """The series that frequency_response chooses for patches."""
    scene = LinearSystem.of(shaken.atoms)
    s = scene.shapes.T @ shaken.push[:, :2].ravel()
    u, _, products = series_response(scene, s, shaken.omega, shaken.gamma, np.array([shaken.particle]), tolerance)
    cost['products'] = products
    return u[:, 0, 1]


def direct(shaken, every, cost):
    """A sparse factorisation for each frequency."""
    return harmonic_response(shaken.atoms, shaken.push, shaken.omega[::every], shaken.gamma).response[:, shaken.particle, 1]


def modal(shaken, cost):
    """Sum over all modes, which frequency_response chooses for small structures."""
    cost['eigensolves'] = 1
    found = modes(shaken.atoms)
    weight = found.shapes[:, shaken.particle, 1] ** 2
    return (weight / (found.omega**2 - shaken.omega[:, None] ** 2 + 1j * shaken.gamma * shaken.omega[:, None])).sum(axis=1)


def stepped(shaken, dt, cost):
    """Response from time steps, driven at one frequency after the other until the motion is steady."""
    response = []
    for omega in shaken.omega[::SAMPLE]:
        atoms = shaken.atoms.copy()
        atoms.calc = shaken.atoms.calc
        drive = Harmonic(shaken.particle, (0, 1), FORCE, omega, phase=np.pi / 2)
        dyn = DrivenVerlet(atoms, dt, drives=[drive], damping=shaken.gamma, engine='compiled')
        recorder = Recorder(dyn, [shaken.particle], interval=max(1, int(FRAMES / dt)))
        response.append(steady_amplitudes(dyn, recorder, [omega], axis=1, tolerance=1e-3)[0][0] / FORCE)
        cost['force evaluations'] += dyn.nsteps
    return np.array(response)


def struck(shaken, dt, cost):
    """The Fourier integral of the motion after one impulse, until e^-9 of it is left."""
    atoms = shaken.atoms.copy()
    atoms.calc = shaken.atoms.calc
    momenta = np.zeros((len(atoms), 3))
    momenta[shaken.particle, 1] = IMPULSE
    atoms.set_momenta(momenta)
    dyn = DrivenVerlet(atoms, dt, damping=shaken.gamma, engine='compiled')
    recorder = Recorder(dyn, [shaken.particle], interval=max(1, int(FRAMES / 3 / dt)))
    steps = int(18 / shaken.gamma / dt)
    dyn.run(steps)
    cost['force evaluations'] = steps
    signal = recorder.displacements[:, 0, 1]
    return impulse_response(signal, recorder.interval * dt, IMPULSE, shaken.omega).response


def reading(panels):
    """The conclusion of the chart for the largest patch, in words."""
    panel, table = list(panels.items())[-1]
    steps, struck = (min((m for m in table if m.method == name), key=lambda m: m.error) for name in (STEPPED, IMPULSIVE))
    best, tight = cheapest(table, steps.error), cheapest([m for m in table if m.method == SERIES], TIGHT)
    factors = next(m.seconds for m in table if m.method == DIRECT)
    return (f'At {panel}, time steps to the steady state take {spoken(steps.seconds)} s for an error of {steps.error:.0e}, and '
            f'time steps after one impulse {spoken(struck.seconds)} s for {struck.error:.0e}. With {best.method} it takes '
            f'{spoken(best.seconds)} s, {spoken(steps.seconds / best.seconds)} times less; an error of {tight.error:.0e} takes '
            f'{spoken(tight.seconds)} s (by factorisations {spoken(factors)} s).')
