"""External forces on chosen particles, as functions of time: harmonic, tone burst, constant, or any callable; and walls, held
particles that move as prescribed.

A drive is called with the time t in ms and returns the force in N on each of its `particles`, shape
(particles, 3).  The drives of this module also accept an array of times, shape (times,), and then return
(times, particles, 3).  A plain function of t acts on all particles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms
from numpy.typing import NDArray

from ..errors import finite, positive
from ..stiffness.plausibility import warn_of_hertz
from ..stiffness.repulsion import Repulsion
from ..stiffness.rest import refuse_held

Prepared = Any  # array_like as it is given, an array once the drive is made: `_prepare` sees to it


@dataclass(frozen=True)
class Constant:
    """Force that does not change with time.

    Parameters
    ----------
    particles : int or array_like of int
    direction : array_like, shape (2,) or (3,)
        Direction of the force; any length is accepted.
    force : float or array_like, shape (particles,)
        In N.

    Examples
    --------
    >>> from magphonon import units as u
    >>> from magphonon.dynamics import Constant
    >>> weight = Constant([0, 1], (0, -1), 0.7e-3 * 9.81 * u.N)
    >>> weight.particles
    array([0, 1])
    """

    particles: Prepared
    direction: Prepared
    force: Prepared

    def __post_init__(self) -> None:
        _prepare(self, 'force')

    def __call__(self, t: Any) -> NDArray[np.float64]:
        return _along(self.direction, self.force + np.zeros(np.shape(t))[..., None])


@dataclass(frozen=True)
class Harmonic:
    """Force `amplitude sin(omega t + phase)`.

    Amplitude, angular frequency and phase may differ from particle to particle, so that one run holds many
    replicas of a system at as many frequencies.

    Parameters
    ----------
    particles : int or array_like of int
    direction : array_like, shape (2,) or (3,)
        Direction of the force; any length is accepted.
    amplitude : float or array_like, shape (particles,)
        In N.
    omega : float or array_like, shape (particles,)
        In rad/ms.
    phase : float or array_like, shape (particles,)
        In rad.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import units as u
    >>> from magphonon.dynamics import Harmonic
    >>> push = Harmonic(3, (0, 1), 0.01 * u.N, omega=2 * np.pi * 40 * u.Hz)
    >>> push.omega / (2 * np.pi) / u.Hz
    array([40.])
    """

    particles: Prepared
    direction: Prepared
    amplitude: Prepared
    omega: Prepared
    phase: Prepared = 0.0

    def __post_init__(self) -> None:
        _prepare(self, 'amplitude', 'omega', 'phase')

    def __call__(self, t: Any) -> NDArray[np.float64]:
        t = np.asarray(t)[..., None]
        return _along(self.direction, self.amplitude * np.sin(self.omega * t + self.phase))


@dataclass(frozen=True)
class ToneBurst:
    """Sine of a few cycles under a Hann window, `amplitude sin(omega s) (1 - cos(omega s/cycles))/2`, s = t - start.

    Parameters
    ----------
    particles : int or array_like of int
    direction : array_like, shape (2,) or (3,)
        Direction of the force; any length is accepted.
    amplitude : float or array_like, shape (particles,)
        In N.
    omega : float
        Carrier in rad/ms.
    cycles : float
        Length of the window in periods of the carrier.
    start : float
        In ms.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import ToneBurst, units as u
    >>> burst = ToneBurst(7, (1, 0), 1e-4 * u.N, omega=2 * np.pi * 40 * u.Hz, cycles=5)
    >>> round(burst.end, 9)  # ms
    125.0
    """

    particles: Prepared
    direction: Prepared
    amplitude: Prepared
    omega: float
    cycles: float = 5
    start: float = 0.0

    def __post_init__(self) -> None:
        _prepare(self, 'amplitude')
        positive('omega', self.omega, 'rad/ms')
        positive('cycles', self.cycles)
        finite('start', self.start, ())

    @property
    def end(self) -> float:
        """Time in ms when the burst is over."""
        return self.start + 2 * np.pi * self.cycles / self.omega

    def __call__(self, t: Any) -> NDArray[np.float64]:
        t = np.asarray(t)[..., None]
        x = self.omega * (t - self.start)
        window = np.where((t >= self.start) & (t <= self.end), (1 - np.cos(x / self.cycles)) / 2, 0.0)
        return _along(self.direction, self.amplitude * window * np.sin(x))


@dataclass(frozen=True)
class PrescribedMotion:
    """Held particles that move as prescribed, such as a row on a shaker; a drive gives their displacement, in mm instead of N.

    Parameters
    ----------
    course : drive or function of the time
        Displacements from the reference in mm: a Harmonic, a ToneBurst, or a function of the time in ms that returns the shape
        (particles, 3).
    particles : array_like of int, optional
        The particles that move, if the course is a plain function. FixAtoms must hold them.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
    >>> from magphonon.dynamics import Harmonic, PrescribedMotion
    >>> row = lattices.chain(1.0, 1.0).repeat((20, 1, 1))
    >>> row.pbc = False
    >>> row.calc = MagneticRepulsion(row, InversePower(1.0, 4.0), foundation=1.0).balanced([0, 19])
    >>> from ase.constraints import FixAtoms
    >>> row.set_constraint(FixAtoms([0]))
    >>> DrivenVerlet(row, 0.05, [PrescribedMotion(Harmonic([0], (1, 0), 1e-3, omega=2.0))]).run(100)  # to t = 5 ms
    True
    >>> bool(np.isclose(row.positions[0, 0] - row.calc.reference.positions[0, 0], 1e-3 * np.sin(10)))
    True
    """

    course: Any
    particles: Prepared = None

    def __post_init__(self) -> None:
        own = getattr(self.course, 'particles', self.particles)
        if not callable(self.course) or own is None:
            raise ValueError('the course of a wall must be a drive, with amplitudes in mm, or a function of time together with '
                             f'particles=[...], not {self.course!r}')
        object.__setattr__(self, 'particles', np.atleast_1d(own))

    def __call__(self, t: Any) -> Any:
        """Displacements in mm at the time `t` in ms."""
        return self.course(t)


def _prepare(drive, *strengths):
    """Check and normalise the fields that the drives share; the fields named in `strengths` get a number for each particle."""
    try:
        particles = np.atleast_1d(np.asarray(drive.particles))
        whole = np.issubdtype(particles.dtype, np.integer) and particles.ndim == 1 and (particles >= 0).all()
    except ValueError:
        whole = False
    if not whole or len(np.unique(particles)) < len(particles) or not len(particles):
        raise ValueError(f'particles must be different indices, zero or above, not {drive.particles!r}')
    direction = finite('direction', drive.direction)
    if direction.shape not in ((2,), (3,)) or not direction.any():
        raise ValueError(f'direction must be a vector of 2 or 3 components, not all zero, not {drive.direction!r}')
    direction = np.append(direction, np.zeros(3 - len(direction)))
    object.__setattr__(drive, 'particles', particles)
    object.__setattr__(drive, 'direction', direction / np.linalg.norm(direction))
    for name in strengths:
        value = finite(name, getattr(drive, name))
        if value.shape not in ((), particles.shape):
            raise ValueError(f'{name} must be one number, or one for each of the {len(particles)} particles, not {value.shape}')
        object.__setattr__(drive, name, np.broadcast_to(value, particles.shape))


def _along(direction, strength):
    return strength[..., None] * direction


def constant_push(drives: Sequence[Any], count: int) -> NDArray[np.float64]:
    """Sum of the forces of all Constant drives on `count` particles, in N, shape (count, 3)."""
    push, constant = np.zeros((count, 3)), Drives([drive for drive in drives if isinstance(drive, Constant)], count)
    push[constant.particles] = constant.forces(np.zeros(1))[0]
    return push


def check_drives(drives: Sequence[Any], atoms: Atoms) -> None:
    """Raise ValueError if a drive pushes only in blocked directions, or if a wall consists of free particles.

    Plain functions are not checked, because their forces are not known. Frequencies that look like Hz cause a warning.
    """
    courses = [drive.course if isinstance(drive, PrescribedMotion) else drive for drive in drives]
    if isinstance(atoms.calc, Repulsion):
        found = [np.ravel(course.omega) for course in courses if isinstance(course, Harmonic | ToneBurst)]
        warn_of_hertz(atoms.calc, np.concatenate([np.zeros(0), *found]))
    for drive in drives:
        if isinstance(drive, PrescribedMotion):
            _refuse_free_wall(drive, atoms)
        if isinstance(drive, Constant | Harmonic | ToneBurst) and drive.particles.max() < len(atoms):
            force = np.zeros((len(atoms), 3))
            strength = drive.force if isinstance(drive, Constant) else drive.amplitude
            force[drive.particles] = _along(drive.direction, strength)
            refuse_held(force, atoms, f'the drive {type(drive).__name__}')


def _refuse_free_wall(wall, atoms):
    held = [constraint.index for constraint in atoms.constraints if isinstance(constraint, FixAtoms)]
    for free in np.setdiff1d(wall.particles[wall.particles < len(atoms)], np.concatenate([[], *held]))[:1]:
        raise ValueError(f'a wall moves held particles, and particle {free} is free; hold it, with '
                         'atoms.set_constraint([*atoms.constraints, FixAtoms([...])]), or push it with a drive')


def forces_and_walls(drives: Sequence[Any], count: int) -> tuple[Drives, Drives]:
    """Two sums: that of the drives that are forces, and that of the displacements of walls."""
    walls = [drive for drive in drives if isinstance(drive, PrescribedMotion)]
    return Drives([drive for drive in drives if not isinstance(drive, PrescribedMotion)], count), Drives(walls, count, walls=True)


class Drives:
    """Sum of several drives on a structure of `count` particles; for `walls` it is a sum of displacements in mm.

    Its `particles` are all driven particles.
    """

    def __init__(self, drives: Sequence[Any], count: int, walls: bool = False) -> None:
        self._parts = []
        for drive in drives:
            if isinstance(drive, PrescribedMotion) and not walls:
                raise ValueError('PrescribedMotion is for DrivenVerlet and propagate, and for frequency_response as walls=; '
                                 'only forces are accepted here')
            if not callable(drive):
                raise ValueError(f'a drive must be a Harmonic, ToneBurst, Constant or a function of the time, not {drive!r}')
            own = getattr(drive, 'particles', None)
            particles = np.arange(count) if own is None else np.atleast_1d(own)
            if particles.max(initial=-1) >= count:
                raise ValueError(f'a drive acts on particle {particles.max()}, but the structure has particles 0 to {count - 1}')
            self._parts.append((drive.course if isinstance(drive, PrescribedMotion) else drive, particles))
        found = [particles for _, particles in self._parts]
        self.particles = np.unique(np.concatenate(found)) if found else np.zeros(0, int)
        self._rows = [np.searchsorted(self.particles, particles) for particles in found]

    def __bool__(self):
        return len(self.particles) > 0

    def forces(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Forces in N at the `times` in ms, shape (times, particles, 3); ValueError unless all are finite and of this shape."""
        total = np.zeros((len(times), len(self.particles), 3))
        for (drive, particles), rows in zip(self._parts, self._rows, strict=True):
            shape = (len(times), len(particles), 3)
            if isinstance(drive, Constant | Harmonic | ToneBurst):
                total[:, rows] += drive(times)
            else:
                total[:, rows] += finite('force of a drive', [drive(t) for t in times], shape)
        return total
