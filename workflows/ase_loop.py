"""Figs. 2 and 6 by ASE's own class: every step of these runs is a call of `ase.md.verlet.VelocityVerlet.step`, and is counted.

The other runs of these chapters are long, and go through the compiled steps of the package; here the same motion is computed both
ways.
"""

from contextlib import contextmanager

import numpy as np
from ase.constraints import FixedLine
from ase.md.verlet import VelocityVerlet

from magphonon import DrivenVerlet, units
from magphonon.dynamics import Harmonic, Recorder
from magphonon.response.stepped import replicas, steady_amplitudes
from magphonon.waves.wave_analysis import waves

from . import closed_forms
from .oscillator import oscillator
from .rows import Check, Reported

SHARES = 0.8, 1.0, 1.2  # of the natural frequency: below, at and above the resonance
DT = 0.15 * units.ms
FORCE = 0.7 * units.N  # moves the magnet by 4e-4 L0: ASE's constraints rebuild momenta from positions, which costs digits
SAME = 1e-6             # of the largest displacement: both loops do the same steps, up to round-off


@contextmanager
def counted():
    """Context with a list of one number, the calls of ASE's `VelocityVerlet.step` so far."""
    calls, step = [0], VelocityVerlet.step

    def count(self, *args, **options):
        calls[0] += 1
        return step(self, *args, **options)

    VelocityVerlet.step = count
    try:
        yield calls
    finally:
        VelocityVerlet.step = step


def resonance(omega_0, damping):
    """Rows for the driven oscillator at 0 degrees, at three frequencies; `omega_0` and `damping` in rad/s and 1/s."""
    omega, found = np.array(SHARES) * omega_0, {}
    with counted() as calls:
        for engine in ('ase', 'compiled'):
            atoms = replicas([oscillator(0.0) for _ in SHARES])
            magnets = 3 + 4 * np.arange(len(SHARES))
            atoms.set_constraint([*atoms.constraints, FixedLine(magnets, (0, 1, 0))])
            drive = Harmonic(magnets, (0, 1), FORCE, omega / units.s, phase=np.pi / 2)
            dyn = DrivenVerlet(atoms, DT, [drive], damping / units.s, engine=engine)
            recorder = Recorder(dyn, magnets, interval=10)
            amplitudes = steady_amplitudes(dyn, recorder, omega / units.s, axis=1, tolerance=3e-4)[0]
            found[engine] = amplitudes, recorder.displacements[..., 1], dyn.nsteps
    amplitudes, record, steps = found['ase']
    unit = units.mm / units.N
    rows = [Check(f"frf by ASE's VelocityVerlet, {share:g} of the natural frequency (mm/N)", abs(a) / FORCE / unit,
                  abs(closed_forms.receptance(0.0, w, damping)) * (units.m / units.mm), 1e-3)
            for share, w, a in zip(SHARES, omega, amplitudes, strict=True)]
    return [*rows, *_alike('frf', record, found['compiled'][1], steps, calls[0])]


def burst(scene, cell, patch, k, compiled, compared):
    """Rows for a burst of a scene in a patch, beside its compiled record; `compared(record, wave)` makes those of its ridge."""
    with counted() as calls:
        row = scene.burst.send(k, cell, patch, engine='ase')[1].row
    wave = waves(row, cell, scene.burst.source)[0]
    return [*compared("transverse burst by ASE's VelocityVerlet, complete simulation", wave),
            *_alike('transverse burst', row.displacements, compiled.displacements, None, calls[0])]


def _alike(name, record, other, steps, calls):
    off = abs(record - other).max() / abs(record).max()
    by_class = [] if steps is None else [Check(f"{name}: calls of ASE's VelocityVerlet.step, of as many steps", calls, steps, 0,
                                               by='two methods')]
    return [Check(f"{name}: compiled steps against ASE's VelocityVerlet, largest difference / largest displacement", off, 0, SAME,
                  by='two methods'),
            *by_class, Reported(f"{name}: steps done by ASE's VelocityVerlet", calls)]
