"""Frequency responses from time steps, at finite amplitude: lock-in on a steady signal, or one impulse for all frequencies.

One Atoms object holds many copies of a small structure, `replicas`, each driven at its own frequency, so that one run gives the
whole response.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from ase.io.jsonio import encode
from numpy.typing import ArrayLike, NDArray

from ..errors import finite, positive
from ..interactions.bond_laws import laws_of, laws_to_dict, saved_by_name
from ..lattices.bonds import Bonds
from ..stiffness.repulsion import repulsion_of
from ..stiffness.rest import freedom
from .frf import FrequencyResponse

if TYPE_CHECKING:
    from ..dynamics.recorder import Recorder
    from ..dynamics.verlet import DrivenVerlet

LEAST_PERIODS = 3
"""Smallest number of periods in a lock-in window: a shorter Hann window would mix the frequency with zero and with its double."""
HEADSTART = 1e3
"""Largest initial ratio of the transient to the steady-state amplitude: far from resonance the transient is larger."""


def replicas(structures: Sequence[Atoms]) -> Atoms:
    """Put several structures with the same law and model into one Atoms, one after the other, without any interaction between
    them.

    Parameters
    ----------
    structures : sequence of ase.Atoms
        With their PairCalculator, and no constraints but those that `modes` takes.  They may be at the same place or be
        the same object, because only bonds within each structure act. Periodic structures must have the same cell.

    Returns
    -------
    ase.Atoms
        One structure with the positions, momenta and rest positions of all of them.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.response import replicas
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> len(replicas([patch, patch])) == 2 * len(patch)
    True
    """
    for which, atoms in enumerate(structures):
        repulsion_of(atoms).displacements(atoms)  # refuses atoms that are not those of their calculator
        freedom(atoms)
        for what in _differing(structures[0], atoms):
            raise ValueError(f'structure {which} differs from structure 0 in its {what}: all replicas must share one law, model '
                             'and cell; run this structure separately')
    calcs, first = [atoms.calc for atoms in structures], np.cumsum([0, *map(len, structures)])
    rest = Atoms(numbers=_each(calcs, 'reference.numbers'), positions=_each(calcs, 'reference.positions'),
                 masses=np.concatenate([atoms.get_masses() for atoms in structures]),
                 tags=np.concatenate([calc.reference.get_tags() for calc in calcs]), pbc=structures[0].pbc,
                 cell=structures[0].cell if structures[0].pbc.any() else None)
    before = np.repeat(first[:-1], [len(calc.bonds.i) for calc in calcs])  # particles before those of each bond
    bonds = Bonds(_each(calcs, 'bonds.i') + before, _each(calcs, 'bonds.j') + before, _each(calcs, 'bonds.shift'),
                  _each(calcs, 'bonds.vectors'), len(rest))
    many = rest.copy()
    many.positions = _each(structures, 'positions')
    many.set_momenta(np.concatenate([atoms.get_momenta() for atoms in structures]))
    many.set_constraint(_joined([atoms.constraints for atoms in structures], first))
    many.calc = calcs[0].changed(rest, bonds, calcs[0].sites.joined([calc.sites for calc in calcs[1:]]))
    return many


def _each(objects, name):
    """The attribute of all objects, one after the other."""
    return np.concatenate([attrgetter(name)(one) for one in objects])


def _differing(one, other):
    """The properties in which two structures differ although replicas must share them."""
    if one.calc is not other.calc:
        a, b = one.calc, other.calc
        known = all(map(saved_by_name, laws_of(a.laws)))  # of others only == can tell
        if a.laws is not b.laws and (encode(laws_to_dict(a.laws)) != encode(laws_to_dict(b.laws)) if known else a.laws != b.laws):
            yield f'law ({b.laws!r} instead of {a.laws!r})'
        if a.model != b.model:
            yield f'model ({b.model} instead of {a.model})'
    periodic = one.pbc.any() or other.pbc.any()
    if periodic and not (np.array_equal(one.pbc, other.pbc) and np.array_equal(one.cell.array, other.cell.array)):
        yield 'cell or periodicity'


def _joined(constraints, first):
    """Joint constraints of structures whose particles begin at the indices `first`: one for each kind and direction."""
    held = {}
    for shift, own in zip(first, constraints, strict=False):
        for c in own:
            held.setdefault((type(c), tuple(getattr(c, 'dir', getattr(c, 'mask', ())))), []).extend(c.index + shift)
    return [kind(particles, *([direction] if direction else ())) for (kind, direction), particles in held.items()]


def lock_in(signal: ArrayLike, dt: float, omega: ArrayLike, start: float = 0.0) -> NDArray[np.complex128]:
    """Complex amplitude of a recorded signal at a frequency, `signal = Re(U e^{i omega t})` plus a constant.

    It is a least-squares fit under a Hann window. The amplitude of a steady oscillation is exact even if the window ends within a
    period, and other frequencies are suppressed.

    Parameters
    ----------
    signal : array_like, shape (frames, ...)
        One window of the record.
    dt : float
        Time between frames in ms.
    omega : float or array_like, shape (...)
        In rad/ms, one for each signal.
    start : float
        Time of the first frame in ms, which sets the origin of the phase.

    Returns
    -------
    ndarray of complex, shape (...)
        In the unit of the signal.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.response.stepped import lock_in
    >>> t = np.arange(0, 20 * np.pi, 0.01)
    >>> bool(abs(abs(lock_in(0.3 * np.cos(2.0 * t), 0.01, 2.0)) - 0.3) < 1e-3)
    True
    """
    signal = finite('signal', signal)
    dt = positive('dt', dt, 'ms')
    frames = len(signal)
    omega = np.broadcast_to(finite('omega', omega), signal.shape[1:])
    if omega.size and not omega.min() * frames * dt >= LEAST_PERIODS * 2 * np.pi:
        raise ValueError(f'the window of {frames * dt:g} ms is shorter than {LEAST_PERIODS} periods of '
                         f'omega = {omega.min():g} rad/ms; record longer')
    if omega.size and not omega.max() * dt < np.pi:
        raise ValueError(f'dt = {dt:g} ms leaves less than two frames to a period of '
                         f'omega = {omega.max():g} rad/ms; record more often')
    phase = np.multiply.outer(start + dt * np.arange(frames), omega)
    basis = np.stack([np.ones_like(phase), np.cos(phase), np.sin(phase)])
    window = np.sin(np.pi * (np.arange(frames) + 0.5) / frames) ** 2
    normal = np.einsum('t,at...,bt...->...ab', window, basis, basis)
    moment = np.einsum('t,at...,t...->...a', window, basis, signal)
    _, c, s = np.moveaxis(np.linalg.solve(normal, moment[..., None])[..., 0], -1, 0)
    return c - 1j * s


def remaining_transient(amplitudes: ArrayLike, decay: float) -> NDArray[np.float64]:
    """The change that the transient will still make to the last of several successive lock-in amplitudes, as a share of it.

    From window to window a free vibration changes by a complex factor z of modulus `decay`, e^{-gamma T/2}.  The remaining change
    is the last step times z/(1 - z), at most |step| decay/(1 - decay), which is reached at resonance, where decay takes longest.
    Merely to compare two amplitudes would mistake slow change for none.  The windows, at least three, have equal length.
    """
    amplitudes = np.asarray(amplitudes)
    if len(amplitudes) < 3:
        raise ValueError(f'at least 3 windows are needed to recognise a steady state, not {len(amplitudes)}')
    if not 0 < decay < 1:
        raise ValueError(f'the decay per window must lie between 0 and 1, not {decay!r}; '
                         'without damping there is no steady state')
    before, last = abs(np.diff(amplitudes[-3:], axis=0))
    step = np.maximum(last, decay * before)  # two free vibrations may cancel in one step, hardly in two
    return step * decay / (1 - decay) / abs(amplitudes[-1])


def steady_amplitudes(dyn: DrivenVerlet, recorder: Recorder, omega: ArrayLike, axis: int,
                      tolerance: float = 1e-4) -> tuple[NDArray[np.complex128], float]:
    """Run harmonically driven particles until their motion is steady, and return their complex amplitudes by lock-in.

    It records windows of `LEAST_PERIODS` periods of the slowest drive until `remaining_transient` is small enough.

    Parameters
    ----------
    dyn : DrivenVerlet
        With its drives and with damping.
    recorder : Recorder
        Recorder attached to dyn; it records the particles whose amplitude is wanted.
    omega : array_like, shape (particles,)
        Angular frequency of the drive that each of these particles follows, in rad/ms.
    axis : {0, 1}
        The component that is recorded.
    tolerance : float
        Largest share of an amplitude that the transient may still have.

    Returns
    -------
    amplitudes : ndarray of complex, shape (particles,)
        In mm; their phase is that of cos(omega t).
    left : float
        The largest `remaining_transient`.
    """
    tolerance = positive('tolerance', tolerance)
    dt = recorder.interval * dyn.dt
    frames = int(np.ceil(LEAST_PERIODS * 2 * np.pi / (finite('omega', omega).min() * dt)))
    gamma = positive('the least damping', float(dyn.damping[recorder.particles].min()), '1/ms')
    decay = np.exp(-gamma * frames * dt / 2)
    amplitudes = []
    for _ in range(3 + int(np.log(tolerance / HEADSTART) / np.log(decay))):
        dyn.run(frames * recorder.interval)
        signal = recorder.displacements[-frames:, :, axis]
        amplitudes.append(lock_in(signal, dt, omega, recorder.times[-frames]))
        if len(amplitudes) >= 3 and (left := remaining_transient(amplitudes, decay).max()) < tolerance:
            return amplitudes[-1], float(left)
    raise ValueError(f'after {dyn.get_time():g} ms the motion is not steady, though linear vibrations have decayed by a factor '
                     f'of {HEADSTART / tolerance:.0e}: drive only at omega, and with less force')


def fourier(signal: ArrayLike, dt: float, omega: ArrayLike) -> NDArray[Any]:
    """Fourier integral of a record that starts and ends at rest, `integral of signal e^{-i omega t} dt`, t = 0 in frame 0.

    Parameters
    ----------
    signal : array_like, shape (frames, ...)
    dt : float
        Time between frames in ms.
    omega : array_like, shape (frequencies,)
        In rad/ms; any frequencies, not only those of the fast Fourier transform.

    Returns
    -------
    ndarray of complex, shape (frequencies, ...)
        In the unit of the signal times ms.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.response.stepped import fourier
    >>> t = np.arange(0, 50, 0.01)
    >>> bool(abs(fourier(np.exp(-t), 0.01, [2.0])[0] - 1 / (1 + 2j)) < 0.01)
    True
    """
    t = dt * np.arange(len(np.asarray(signal)))
    return np.array([dt * np.tensordot(np.exp(-1j * w * t), np.asarray(signal), 1) for w in np.atleast_1d(omega)])


def impulse_response(signal: ArrayLike, dt: float, impulse: float, omega: ArrayLike) -> FrequencyResponse:
    """Frequency response from the free decay after one impulse at t = 0.

    It is the Fourier integral of the record by the trapezoidal rule, with an end correction for the kink at t = 0, so that the
    error is of fourth order in omega dt. The vibration has not quite died out at the end of the record: a fraction e^{-gamma T/2}
    of a mode is left, which is the relative error at its peak and, to within a factor of about 2, elsewhere.

    Parameters
    ----------
    signal : array_like, shape (frames, ...)
        Displacements in mm, from rest; the first frame is that of the impulse.
    dt : float
        Time between frames in ms.
    impulse : float
        Momentum given to the driven particle, N ms.
    omega : array_like, shape (frequencies,)
        In rad/ms.

    Returns
    -------
    FrequencyResponse
        Its `transient` is the largest displacement in the last tenth of the record, divided by that in the first tenth.
    """
    u = finite('signal', signal)
    dt, impulse = positive('dt', dt, 'ms'), positive('impulse', impulse, 'N ms')
    omega = finite('omega', omega)
    if len(u) < 20:
        raise ValueError(f'the record holds {len(u)} frames; an impulse response needs at least 20')
    if u[0].any():
        raise ValueError(f'the record starts with a displacement of {abs(u[0]).max():g} mm; '
                         'it must start at the impulse, before the particle has moved')
    if not u.any():
        raise ValueError('the particle stays at rest throughout the record; look at another particle or direction')
    kink = dt * u[1] / 12  # Euler-Maclaurin: dt^2/12 times the initial velocity
    response = (fourier(u, dt, omega) + kink) / impulse
    tenth = len(u) // 10
    return FrequencyResponse(omega, response, float(abs(u[-tenth:]).max() / abs(u[:tenth]).max()))
