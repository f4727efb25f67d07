"""Many small structures in one Atoms, each at a frequency of its own: a response at finite amplitude in one run."""

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms

from .calculator import MagneticRepulsion
from .drives import Harmonic
from .dynamics import DrivenVerlet
from .frf import FrequencyResponse, steady_amplitudes
from .recorder import Recorder
from .rest import settled

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
    many = replicas(len(omega) * [settled(atoms)])
    first = len(atoms) * np.arange(len(omega))
    drive = Harmonic(first + source[0], source[1], force, omega, phase=np.pi / 2)
    dyn = DrivenVerlet(many, dt, [drive], damping)
    recorder = Recorder(dyn, first + answer[0], interval=max(1, int(2 * np.pi / np.max(omega) / FRAMES / dt)))
    amplitudes, left = steady_amplitudes(dyn, recorder, omega, axis, STEADY)
    return FrequencyResponse(np.asarray(omega), amplitudes * answer[1][axis] / force, left)


def replicas(structures):
    """Structures of one law and model in one Atoms, one after the other, which do not feel each other.

    Parameters
    ----------
    structures : sequence of ase.Atoms
        With their MagneticRepulsion, and no constraints but FixAtoms, FixedLine and FixedPlane.  They may stand at one place
        and may be the same: only the bonds within each act.

    Returns
    -------
    ase.Atoms
    """
    first = np.cumsum([0, *(len(atoms) for atoms in structures)])
    many = Atoms(np.concatenate([atoms.numbers for atoms in structures]), np.concatenate([a.positions for a in structures]),
                 masses=np.concatenate([atoms.get_masses() for atoms in structures]))
    held, bonds = {}, []
    for shift, atoms in zip(first, structures, strict=False):
        for c in atoms.constraints:
            held.setdefault((type(c), () if isinstance(c, FixAtoms) else tuple(c.dir)), []).extend(c.index + shift)
        bonds += zip((atoms.calc.bonds.i + shift).tolist(), (atoms.calc.bonds.j + shift).tolist(), strict=True)
    many.set_constraint([kind(particles, *([direction] if direction else ())) for (kind, direction), particles in held.items()])
    calc = structures[0].calc
    anchors, load = (np.concatenate([getattr(atoms.calc, name) for atoms in structures]) for name in ('anchors', 'load'))
    many.calc = MagneticRepulsion(many, calc.potential, bonds=bonds, anchors=anchors, load=load, **calc.parameters)
    return many
