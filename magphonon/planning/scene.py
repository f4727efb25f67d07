"""Makes and runs plans for two tables of a scene: [frf] asks for a peak, [burst] for waveforms.

The table [plan] adds what these tables do not contain: the force of a response.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import units as u
from ..files import write_columns
from .plan import Method, Plan

if TYPE_CHECKING:
    from ..scenes.scene import Scene


@dataclass(frozen=True)
class Wanted:
    """One quantity that a scene asks for, with its plan and the function that computes it."""

    name: str  # name of its files
    plan: Plan
    answer: Callable[[Path, Method], None]  # takes a file and a Method, and writes the data to the file
    notes: tuple[str, ...] = ()  # effects that the plan leaves out

    def report(self) -> str:
        """The plan in words."""
        return '\n'.join([self.plan.report(), *(f'  {note}' for note in self.notes)])

    def run(self, folder: Path) -> None:
        """Run the recommended method and write its data into the folder as plan_NAME, apart from those of other commands."""
        self.answer(folder / f'plan_{self.name}', self.plan.choice)


def scene_plans(scene: Scene, tolerance: float) -> Iterator[Wanted]:
    """Plans for all quantities that a scene asks for, one after the other."""
    scene = scene.with_lean(False)  # which hardly changes what a method costs and how far it is off
    if scene.frf is None and scene.burst is None:
        raise ValueError(f'the scene {scene.title!r} has nothing to plan; add a table [frf] or [burst] (bands need no plan: '
                         'shells = "auto" counts as many shells of neighbours as matter)')
    if scene.frf is not None:
        yield _peak(scene, tolerance)
    if scene.burst is not None:
        cell, patch = scene.perfect_cell(), scene.patch_atoms()
        for k in range(len(scene.burst.carriers_Hz)):
            yield _burst(scene, cell, patch, tolerance, k)


def _peak(scene, tolerance):
    from .peak import plan_peak

    if scene.cell().has('relative_damping'):
        raise ValueError('lattice.file has the column relative_damping, but a plan of [frf] supports only one damping for all '
                         'particles; remove the column or [frf]')
    force = scene.plan.force_N * u.N if scene.plan is not None and scene.plan.force_N is not None else 0.0
    atoms, source, answer = scene.shaken()
    plan = plan_peak(atoms, source, answer, scene.frf.omega, scene.frf.damping, tolerance, force)
    notes = () if force else ('This is the small-amplitude response; set [plan] force_N for a finite force.',)
    return Wanted('frf', plan, lambda file, method: _write_response(scene, file, force, method), notes)


def _write_response(scene, file, force, method):
    from ..response.frf import receptance
    from ..response.stepped import stepped_response

    (atoms, source, answer), omega, damping = scene.shaken(method.model), scene.frf.omega, scene.frf.damping
    if method.dt is None:
        response = receptance(atoms, source, answer, omega, damping)
    else:
        response = stepped_response(atoms, source, answer, omega, damping, force, method.dt)
    response.save(file.with_suffix('.npz'))
    amplitude, phase = abs(response.response) / (u.m / u.N), np.degrees(np.angle(response.response))
    write_columns(file.with_suffix('.csv'), ['frequency_Hz', 'amplitude_m_per_N', 'phase_deg'],
                  [u.hertz(omega), amplitude, phase])


def _burst(scene, cell, patch, tolerance, k):
    from ..waves.wave_source import burst_setup
    from .waveform import plan_waveform

    plan, where = scene.burst, burst_setup(cell, patch, scene.burst.source)
    burst = plan.burst(k, where)
    found = plan_waveform(patch, burst.drive, where.row, burst.damping, burst.duration, tolerance)
    name = f'Waveform of the burst at {plan.carriers_Hz[k]:.4g} Hz, {plan.directions_deg[k]:g} degrees'
    found = replace(found, quantity=name)
    return Wanted(f'burst_{plan.names[k]}', found,
                  lambda file, method: _write_waveform(scene, file, where.row, burst, method))


def _write_waveform(scene, file, row, burst, method):
    from ..dynamics.recorder import Recorder
    from ..dynamics.verlet import DrivenVerlet
    from ..response.propagation import propagate
    from ..waves.scan_tables import write_scan
    from .waveform import FRAMES

    patch, dt = scene.patch_atoms(method.model), method.dt
    frame = 2 * np.pi / burst.drive.omega / FRAMES
    if dt is None:
        times = np.arange(0, burst.duration, frame)
        motion = propagate(patch, times, [burst.drive], burst.damping, row)
    else:
        dyn = DrivenVerlet(patch, dt, [burst.drive], burst.damping, order=method.order)
        recorder = Recorder(dyn, row, round(frame / dt))
        dyn.run(int(burst.duration / dt))
        motion = recorder.motion
    write_scan(file.with_name(file.name + '.csv'), motion)
