"""The memory that each command needs, estimated before it starts, and the key that it grows with.

The estimates count the largest arrays.  The constants below are fitted to the peak resident memory of the commands, at two to
four sizes each (`tests/cli/test_costs.py` lists them); those marked "counted" were not.  The estimates are accurate enough
to distinguish a typing error, such as 1e12 points, from work that fits.  Names end in the unit, bytes.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from functools import wraps

import numpy as np

from ..bands.bloch import bloch_modes
from ..errors import free_memory
from ..findings import Finding, Findings
from ..response.frf import FACTORISATION
from ..response.normal_modes import SMALL
from ..scenes.scene import Scene, read_scene
from ..stiffness.bond import MODELS
from .arguments import LOWEST, MOST_DIRECTIONS

USABLE_FRACTION = 0.5
"""Fraction of the free memory that a command may use; the rest is kept for the system and for errors of the estimates."""
GIGABYTE = 2**30
PICTURES_bytes = 60e6  # fonts, figures and imports, for every command
POINT_bytes, MATRIX_bytes = 1500, 3200
"""Bytes of one wavevector of bands by both models and phonopy: a part for any cell, and the matrices of a cell of one particle,
which grow with the square of the number of particles.  Measured between 20 000 and 60 000 wavevectors of cells of one, two and
three particles."""
PHASE_bytes = 33  # bands: the phase of one bond at one wavevector; counted
PAIR_bytes = 20  # bands by phonopy: one pair of particles of the supercell, whose distances phonopy keeps
SERIES_bytes, PROOF_bytes = 3000, 13e3
"""One particle of a patch with its bonds; for a response this includes its share of the factorisation that proves stability,
measured between 7000 and 60 000 particles."""
FACTOR_bytes = 17e3  # response: one factorisation of the matrix at one frequency, per particle
COLUMNS_bytes = 2900  # density of states: one particle with its share of the matrix and of the random vectors
SHAPES_bytes = 40  # modes: all of a structure with their shapes, divided by the square of its free directions
SAMPLE_bytes = 1800  # burst: one particle of the row at one time, with its share of the map and its line of text


COSTS = Findings()
"""For each command, by name: the bytes that it needs for a scene, or None if the scene lacks its table."""


def amount(size: float) -> str:
    """A number of bytes in words; all sizes below 0.1 GB look the same."""
    return 'less than 0.1 GB' if size < 0.1 * GIGABYTE else f'about {size / GIGABYTE:.2g} GB'


def estimate(memory: Callable[[Scene], dict[str, float] | None]) -> None:
    """Decorator that adds a command to the list of costs; its function returns bytes for each key with which they grow."""
    @wraps(memory)
    def judge(scene):
        if (needed := memory(scene)) is None:
            return None
        needed = {'title': 0.0} | needed
        size, free, value = PICTURES_bytes + sum(needed.values()), free_memory(), scene
        if size <= USABLE_FRACTION * free:
            return Finding(size, f'[{memory.__name__}] {amount(size)} of memory')
        largest = max(needed, key=lambda key: needed[key])
        for key in largest.split('.'):
            value = scene.supercell() if key == 'supercell' else scene.wanted('bands') if key == 'bands' else getattr(value, key)
        return Finding(size, f'{largest} = {list(value) if isinstance(value, tuple) else value!r} makes [{memory.__name__}] need '
                       f'{amount(size)} of memory, more than {USABLE_FRACTION:.0%} of the {free / GIGABYTE:.3g} GB that are '
                       f'free; lower {largest}', fault=True)

    COSTS.check(judge)


def refuse_costly(scene: Scene, *commands: str) -> None:
    """Raise ValueError if a command needs more memory than is available; the message names the key."""
    for name in commands:
        if (found := COSTS.find(name, scene)).fault:
            raise ValueError(found.words)


def read_affordable(options: Namespace) -> Scene:
    """The scene of a command, or ValueError if the command needs more memory for it than is available."""
    scene = read_scene(options.scene)
    refuse_costly(scene, options.command)
    return scene


@estimate
def bands(scene: Scene) -> dict[str, float] | None:
    if scene.single or scene.finite:
        return None
    points, particles, bonds = scene.wanted('bands').points, len(scene.cell()), len(scene.perfect_cell().calc.bonds)
    return {'bands.points': points * (POINT_bytes + MATRIX_bytes * particles**2 + PHASE_bytes * bonds),
            'bands.supercell': PAIR_bytes * (particles * np.prod(scene.supercell(), dtype=float)) ** 2}


@estimate
def frf(scene: Scene) -> dict[str, float] | None:
    if scene.frf is None:
        return None
    plan, particles = scene.frf, particles_of(scene)
    size = 2 * particles
    if size <= SMALL:
        return {'frf.points': 48.0 * plan.points * size}
    terms = 21 * _top(scene) / plan.damping  # of the longest series; 21 = -log(1e-9)
    factorised = terms > FACTORISATION * np.sqrt(size) * plan.points or scene.cell().has('relative_damping')
    return {'frf.points': plan.points * (48.0 * particles if factorised else 2000.0),
            size_key(scene): (FACTOR_bytes if factorised else PROOF_bytes) * particles}


@estimate
def uncertainty(scene: Scene) -> dict[str, float] | None:
    if scene.uncertainty is None:
        return None
    memory, parameters = {}, len(scene.uncertainty.model_fields_set)
    plan = scene.bands if scene.frf is not None or scene.single or scene.finite else scene.wanted('bands')
    if plan is not None:
        bonds = len(scene.perfect_cell().calc.bonds)
        memory['bands.points'] = plan.points * len(scene.cell()) ** 2 * (MATRIX_bytes + PHASE_bytes * bonds * parameters)
    if scene.frf is not None:
        particles = particles_of(scene)
        memory['frf.points'] = 72.0 * scene.frf.points * particles * (2 + parameters) + FACTOR_bytes * particles
    return memory


@estimate
def burst(scene: Scene) -> dict[str, float] | None:
    # here, because the import includes time steps, which other commands do not need
    from ..waves.wave_source import SAMPLES, SNAPSHOTS

    if scene.burst is None or scene.patch is None:
        return None
    plan, particles = scene.burst, particles_of(scene)
    row, frames = particles**0.5, plan.duration_s * max(plan.carriers_Hz) * SAMPLES
    memory = {'burst.duration_s': SAMPLE_bytes * frames * row,
              scene.patch.size_key: particles * (SNAPSHOTS * 16 * 6 + SERIES_bytes)}
    if scene.vibrometer is not None:
        memory['vibrometer.sampling_rate_Hz'] = SAMPLE_bytes * plan.duration_s * scene.vibrometer.sampling_rate_Hz * row
    return memory


@estimate
def dos(scene: Scene) -> dict[str, float] | None:
    return None if scene.single else {size_key(scene): COLUMNS_bytes * particles_of(scene)}


@estimate
def modes(scene: Scene) -> dict[str, float] | None:
    size = 2 * particles_of(scene)
    most = SHAPES_bytes * size**2 * 8**scene.turns if size <= MOST_DIRECTIONS else (FACTOR_bytes + 16 * LOWEST) * size / 2
    return None if scene.single else {size_key(scene): most}


def size_key(scene: Scene) -> str:
    """The key of the scene with which the number of particles grows."""
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
