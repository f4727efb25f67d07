"""The cost of a command, estimated before it starts: memory, number of files, and the key that the memory grows with.

The estimates count the largest arrays.  The constants below are fitted to the peak resident memory of the commands, at two to
four sizes each (`tests/cli/test_costs.py` lists them); one marked "counted" was not measured.  The estimates are accurate enough
to distinguish a typing error, such as 1e12 points, from work that fits.  Names end in the unit, bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..bands.bloch import bloch_modes
from ..errors import free_memory
from ..response.frf import FACTORISATION
from ..response.normal_modes import SMALL
from ..stiffness.bond import MODELS

if TYPE_CHECKING:
    from ..scenes.scene import Scene

USABLE_FRACTION = 0.5
"""Fraction of the free memory that a command may use; the rest is kept for the system and for errors of the estimates."""
GIGABYTE = 2**30
PICTURES_bytes = 60e6  # fonts, figures and imports, for every command
POINT_bytes, MATRIX_bytes = 1500, 3200
"""Bands: a wavevector by both models and phonopy, for any cell; its matrices for a cell of one particle, which grow with the
square of the number of particles.  Measured between 20 000 and 60 000 wavevectors of cells of one, two and three particles."""
PHASE_bytes = 33  # bands: the phase of one bond at one wavevector; counted
PAIR_bytes = 20  # bands by phonopy: one pair of particles of the supercell, whose distances phonopy keeps
SERIES_bytes, PROOF_bytes = 3000, 13e3
"""One particle of a patch with its bonds; response: with its part of the factorisation that proves stability, measured between
7000 and 60 000 particles."""
FACTOR_bytes = 17e3  # response: one factorisation of the matrix at one frequency, per particle
SAMPLE_bytes = 1800  # burst: one particle of the row at one time, with its share of the map and its line of text


@dataclass(frozen=True)
class Cost:
    """Cost of a command for one table of a scene: bytes by the key that they grow with, number of files."""

    table: str
    memory: dict[str, float]
    files: int

    @property
    def bytes(self) -> float:
        """Total memory in bytes."""
        return sum(self.memory.values())

    @property
    def key(self) -> str:
        """The key that needs most of the memory."""
        return max(self.memory, key=lambda key: self.memory[key])

    def __str__(self) -> str:
        return f'[{self.table}] {amount(self.bytes)} of memory, {self.files} files'


def amount(size: float) -> str:
    """A number of bytes in words; what every process needs is not resolved."""
    return 'less than 0.1 GB' if size < 0.1 * GIGABYTE else f'about {size / GIGABYTE:.2g} GB'


def bands_cost(scene: Scene) -> Cost:
    """Cost of `magphonon bands`."""
    points, particles, bonds = scene.wanted('bands').points, len(scene.cell()), len(scene.perfect_cell().calc.bonds)
    memory = {'bands.points': PICTURES_bytes + points * (POINT_bytes + MATRIX_bytes * particles**2 + PHASE_bytes * bonds),
              'bands.supercell': PAIR_bytes * (particles * np.prod(scene.supercell(), dtype=float)) ** 2}
    return Cost('bands', memory, 8)


def frf_cost(scene: Scene) -> Cost:
    """Cost of `magphonon frf`."""
    plan, particles = scene.frf, particles_of(scene)
    size = 2 * particles
    if size <= SMALL:
        return Cost('frf', {'frf.points': PICTURES_bytes + 48.0 * plan.points * size}, 4)
    terms = 21 * _top(scene) / plan.damping  # of the longest series; 21 = -log(1e-9)
    factorised = terms > FACTORISATION * np.sqrt(size) * plan.points or scene.cell().has('relative_damping')
    memory = {'frf.points': PICTURES_bytes + plan.points * (48.0 * particles if factorised else 2000.0),
              size_key(scene): (FACTOR_bytes if factorised else PROOF_bytes) * particles}
    return Cost('frf', memory, 4)


def uncertainty_cost(scene: Scene) -> Cost:
    """Cost of `magphonon uncertainty`."""
    memory, files = {'title': PICTURES_bytes}, 0
    parameters = len(scene.uncertainty.model_fields_set)
    plan = scene.bands if scene.frf is not None or scene.single or scene.finite else scene.wanted('bands')
    if plan is not None:
        bonds = len(scene.perfect_cell().calc.bonds)
        memory['bands.points'] = plan.points * len(scene.cell()) ** 2 * (MATRIX_bytes + PHASE_bytes * bonds * parameters)
        files += 4
    if scene.frf is not None:
        particles = particles_of(scene)
        memory['frf.points'] = 72.0 * scene.frf.points * particles * (2 + parameters) + FACTOR_bytes * particles
        files += 3
    return Cost('uncertainty', memory, files)


def burst_cost(scene: Scene) -> Cost:
    """Cost of `magphonon burst`; without a patch, which the command refuses, the cost of its start."""
    # here, because the import includes time steps, which other commands do not need
    from ..waves.wave_source import SAMPLES, SNAPSHOTS

    if scene.patch is None:
        return Cost('burst', {'burst.duration_s': PICTURES_bytes}, 0)
    plan, particles = scene.burst, particles_of(scene)
    row, frames = particles**0.5, plan.duration_s * max(plan.carriers_Hz) * SAMPLES
    memory = {'burst.duration_s': PICTURES_bytes + SAMPLE_bytes * frames * row,
              scene.patch.size_key: particles * (SNAPSHOTS * 16 * 6 + SERIES_bytes)}
    if scene.vibrometer is not None:
        memory['vibrometer.sampling_rate_Hz'] = SAMPLE_bytes * plan.duration_s * scene.vibrometer.sampling_rate_Hz * row
    return Cost('burst', memory, 8 * len(plan.carriers_Hz) + 3)


def size_key(scene: Scene) -> str:
    """The key that the number of particles grows with."""
    return 'lattice.file' if scene.finite else scene.patch.size_key if scene.patch is not None else 'title'


def particles_of(scene: Scene) -> float:
    """Number of particles of the patch, from its area, or of the finite structure; one for the oscillator."""
    if scene.single:
        return 1
    cell = scene.cell()
    if scene.finite:
        return len(cell)
    return max(1, len(cell) * scene.patch.cells(cell)) if scene.patch is not None else 1


def _top(scene):
    """Highest angular frequency of the lattice in rad/ms, on a coarse grid of the zone."""
    q = np.stack(np.meshgrid(*3 * [np.arange(6) / 6]), axis=-1).reshape(-1, 3)
    atoms = scene.perfect_cell()
    return max(abs(bloch_modes(atoms, np.where(atoms.pbc, q, 0), model)[0]).max() for model in MODELS)


COSTS = {'bands': bands_cost, 'frf': frf_cost, 'burst': burst_cost, 'uncertainty': uncertainty_cost}


def costs(scene: Scene) -> tuple[Cost, ...]:
    """The cost of every table of a scene that a command works on, a tuple of Cost."""
    return tuple(estimate(scene) for name, estimate in COSTS.items() if getattr(scene, name) is not None)


def refuse_costly(scene: Scene, *tables: str) -> None:
    """Raise ValueError if a table needs more memory than is available; the message names the key.

    Tables that the scene does not have are ignored.
    """
    for cost in costs(scene):
        if cost.table in tables:
            refuse_cost(scene, cost)


def refuse_cost(scene: Scene, cost: Cost) -> None:
    """Raise ValueError if a command needs more memory than is available; the message names the key."""
    if fault := too_much(scene, cost):
        raise ValueError(fault)


def too_much(scene: Scene, cost: Cost) -> str:
    """What is said of a cost that is too high: the key, its value and what to do; nothing if the memory suffices."""
    free, value = free_memory(), scene
    if cost.bytes <= USABLE_FRACTION * free:
        return ''
    for key in cost.key.split('.'):
        value = scene.supercell() if key == 'supercell' else scene.wanted('bands') if key == 'bands' else getattr(value, key)
    return (f'{cost.key} = {list(value) if isinstance(value, tuple) else value!r} makes [{cost.table}] need '
            f'{amount(cost.bytes)} of memory, more than {USABLE_FRACTION:.0%} of the {free / GIGABYTE:.3g} GB that are free; '
            'lower it')
