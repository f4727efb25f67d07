"""Many copies of a small structure in one Atoms, each at a frequency of its own: a response at finite amplitude in one run."""

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms

from .calculator import MagneticRepulsion
from .drives import Constant, Harmonic
from .dynamics import DrivenVerlet
from .frf import FrequencyResponse, steady_amplitudes
from .recorder import Recorder

STEADY = 1e-3
"""What the transient may leave of an amplitude; harmonics of a nonlinear motion disturb the lock-in by less."""
FRAMES = 12
"""Of a record, to a period."""


def stepped_response(atoms, source, answer, omega, damping, force, dt):
    """The response at a finite force, in time: a replica of the structure for each frequency, run until it is steady.

    Parameters
    ----------
    atoms : ase.Atoms
    source, answer : tuple of int and array_like, shape (3,)
        Particle and direction of the force and of the displacement, which must be along x or y.
    omega : array_like, shape (frequencies,)
        In rad/ms.
    damping : float
        gamma in 1/ms.
    force : float
        In N.
    dt : float
        In ms.

    Returns
    -------
    FrequencyResponse
    """
    axis = int(abs(np.asarray(answer[1])).argmax())
    if abs(abs(answer[1][axis]) - 1) > 1e-9:
        raise ValueError(f'a response in time steps is seen along x or y, not along {answer[1]}; turn [frf.response]')
    many = replicas(atoms, len(omega))
    first = len(atoms) * np.arange(len(omega))
    static = atoms.get_forces()  # what holds the oscillator against its three magnets
    sizes = np.linalg.norm(static, axis=1)
    balance = [Constant(first + k, -static[k], sizes[k]) for k in np.flatnonzero(sizes > 1e-9 * sizes.max(initial=1e-300))]
    drive = Harmonic(first + source[0], source[1], force, omega, phase=np.pi / 2)
    dyn = DrivenVerlet(many, dt, [*balance, drive], damping)
    recorder = Recorder(dyn, first + answer[0], interval=max(1, int(2 * np.pi / np.max(omega) / FRAMES / dt)))
    amplitudes, left = steady_amplitudes(dyn, recorder, omega, axis, STEADY)
    return FrequencyResponse(np.asarray(omega), amplitudes * answer[1][axis] / force, left)


def replicas(atoms, count):
    """Many copies of a structure in one Atoms, which do not feel each other."""
    shift = len(atoms) * np.arange(count)[:, None]
    many = Atoms(np.tile(atoms.numbers, count), np.tile(atoms.positions, (count, 1)), masses=np.tile(atoms.get_masses(), count))
    own = [(type(c), (c.index + shift).ravel(), () if isinstance(c, FixAtoms) else (c.dir,)) for c in atoms.constraints]
    many.set_constraint([kind(particles, *direction) for kind, particles, direction in own])
    bonds = [(int(i + s), int(j + s)) for s in shift[:, 0] for i, j in zip(atoms.calc.bonds.i, atoms.calc.bonds.j, strict=True)]
    many.calc = MagneticRepulsion(many, atoms.calc.potential, bonds=bonds, **atoms.calc.parameters)
    return many
