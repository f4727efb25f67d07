"""Checkpoints: the whole state of a run in one file, which is complete or not there."""

from hashlib import sha256

import numpy as np

from .calculator import MagneticRepulsion
from .drives import Constant, Harmonic, ToneBurst
from .files import whole_file


def scene_digest(dyn):
    """Fingerprint of everything that decides what a run computes, the state it starts from included."""
    atoms, calc = dyn.atoms, dyn.atoms.calc
    times = dyn.dt * np.array([0.0, 0.7, 11.3, 157.9, 3101.1])  # a function is known by what it does
    parts = [dyn.nsteps, dyn.dt, dyn.damping, dyn.drives.particles, dyn.drives.forces(times), dyn.asked_engine,
             *(atoms.arrays[name] for name in ('positions', 'momenta')), atoms.get_masses(), atoms.cell.array, atoms.pbc,
             *(repr(constraint.todict()) for constraint in atoms.constraints),
             *(part for drive in dyn._drive_list if isinstance(drive, Constant | Harmonic | ToneBurst)
               for part in vars(drive).values()),
             *(part for recorder in dyn.recorders for part in (recorder.particles, recorder.interval)), type(calc).__name__]
    if isinstance(calc, MagneticRepulsion):
        r0 = calc.bonds.lengths
        parts += [calc.reference.positions, calc.bonds.i, calc.bonds.j, calc.bonds.vectors, repr(sorted(calc.parameters.items())),
                  calc.potential.dphi(r0), calc.potential.d2phi(r0)]
    digest = sha256()
    for part in parts:
        digest.update(repr(part).encode() if not isinstance(part, np.ndarray) else np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()


def save_checkpoint(path, digest, state):
    """Write a state, a dict of arrays and numbers, whole or not at all."""
    with whole_file(path, 'wb') as file:
        np.savez(file, scene=digest, **state)


def load_checkpoint(path, digest):
    """The state that `save_checkpoint` wrote, or None if there is no such file.

    Raises
    ------
    ValueError
        If the file is damaged or belongs to another run.
    """
    try:
        with open(path, 'rb') as file, np.load(file) as data:
            state = dict(data)
            scene = str(state.pop('scene'))
    except FileNotFoundError:
        return None
    except Exception as error:
        raise ValueError(f'{path} is no complete checkpoint ({error}); delete it and start again') from error
    if scene != digest:
        raise ValueError(f'the checkpoint {path} belongs to another run: structure, law, drives, time step, start or '
                         'recorders differ; move it away, or restore what was changed (a run that has moved already goes on '
                         'with atoms and dynamics prepared afresh)')
    return state
