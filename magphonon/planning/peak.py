"""The plan for the peak of a frequency response: does its frequency need D*, and does it depend on the amplitude?

The peak is searched separately with and without D*, because D* mixes modes and changes their order.  A force F cos(W t) drives a
mode with the displacement pattern e, sum m e^2 = 1, to the amplitude e.F/(gamma W), which moves the peak along its backbone curve
(`magphonon.stability.amplitude_shifts`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from .. import units
from ..dynamics.engine import highest_frequency
from ..errors import positive
from ..response.frf import Dof, frequency_response, harmonic_response
from ..response.normal_modes import SMALL, Modes, modes, refuse_growing
from ..response.stepped import HEADSTART, TRANSIENT_FRACTION
from ..stability.amplitude_shifts import DEGENERACY, StronglyNonlinear, vibration
from ..stiffness.bond import MODELS
from ..stiffness.rest import LinearSystem
from ..traits import LIKE, takes
from .plan import LONGEST_STEP, STEP_ERROR_FRACTION, Method, Plan, percent

ROUND_OFF = 1e-12  # relative difference of two frequencies that is round-off
DECOUPLED = 1e-10
"""A mode contributes to a response by the force on it times its motion at the detector. Contributions below this fraction of the
largest are round-off: without D*, the rows and columns of a square lattice are chains that do not move each other."""
MOST_DIRECTIONS = 1000
"""Largest number of degrees of freedom of a structure that is diagonalised, which takes about 0.3 s; the time grows with the
third power."""
ONE_PATTERN = 10.0
"""Relative uncertainty of the shift by the amplitude in a large structure: at the peak other modes take part in its motion, so
only the order of magnitude is known."""


@dataclass(frozen=True)
class Peak:
    """The highest resonance of a response within a range of frequencies."""

    linear: Modes  # all modes of a small structure; for a large structure, only the displacement pattern at the peak
    mode: int  # the mode that resonates
    force: float  # the force on the mode for a unit force, g^-1/2

    @property
    def omega(self) -> float:
        """Angular frequency of the peak in rad/ms."""
        return float(self.linear.omega[self.mode])


def highest_peak(atoms: Atoms | LinearSystem, source: Dof, answer: Dof, omega: NDArray[np.float64], damping: float) -> Peak:
    """The resonance that dominates the response at `omega` (rad/ms, ascending), in the complete linear model."""
    system, damping = LinearSystem.of(atoms), positive('damping', damping, '1/ms')
    if system.free.shape[1] > MOST_DIRECTIONS:
        return _peak_of_field(system, source, answer, omega, damping)
    linear = modes(system)
    w = linear.omega
    refuse_growing(w[0] * abs(w[0]), w[-1] ** 2)
    linear = _turned(linear, source)
    push, seen = (place.seen(linear.shapes) for place in (source, answer))
    resonant = (w >= omega[0]) & (w <= omega[-1]) & (w > 0) & (abs(push * seen) > DECOUPLED * abs(push).max() * abs(seen).max())
    # The height is that of the whole response at each natural frequency, because close modes overlap.
    height = np.zeros(len(w))
    height[resonant] = [abs((push * seen / (w * abs(w) - W**2 + 1j * damping * W)).sum()) for W in w[resonant]]
    if not height.any():
        raise ValueError('no mode resonates between the lowest and the highest frequency; widen the range of [frf]')
    mode = int(height.argmax())
    return Peak(linear, mode, float(abs(push[mode])))


def _peak_of_field(system, source, answer, omega, damping):
    """The peak of a large structure, from its response at all frequencies; its mode is the motion of all particles there."""
    force = source.force(len(system))
    found = frequency_response(system, force, omega, damping, [answer.particle], tolerance=1e-4)
    response = found.response[:, 0] @ answer.direction
    w = omega[abs(response).argmax()]
    e = np.imag(harmonic_response(system, force, [w], damping).response[0, :, : system.dim])
    e /= np.sqrt(np.einsum('i,ix,ix->', system.masses, e, e))
    return Peak(Modes(np.array([w]), e[None]), 0, float(abs(source.seen(e))))


def _turned(linear, source):
    """The same modes, rotated so that only the first of those with equal frequencies couples to the force."""
    shapes = linear.shapes.copy()
    scale = DEGENERACY * linear.omega[-1]
    for group in np.split(np.arange(len(shapes)), np.flatnonzero(np.diff(linear.omega) > scale) + 1):
        push = source.seen(shapes[group])
        if len(group) > 1 and push.any():
            basis = np.linalg.qr(np.column_stack([push, np.eye(len(group))]))[0]
            shapes[group] = np.einsum('gh,gix->hix', basis, shapes[group])
    return Modes(linear.omega, shapes)


@takes(*LIKE)
def plan_peak(atoms: Atoms | LinearSystem, source: Dof, answer: Dof, omega: NDArray[np.float64], damping: float,
              tolerance: float, force: float = 0.0) -> Plan:
    """Plan for the frequency of the highest peak of a response.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        At rest, with PairCalculator.
    source, answer, omega, damping
        As for `highest_peak`.
    tolerance : float
        Relative error allowed in the frequency.
    force : float
        Amplitude in N; zero for the small-amplitude response.

    Returns
    -------
    Plan
    """
    system = LinearSystem.of(atoms)
    calc, peak = system.calc, highest_peak(system, source, answer, omega, damping)
    w = peak.omega
    frozen = _without_dstar(system, w, source, answer, omega, damping)
    where = f'the peak is at {units.hertz(w):.6g} Hz'
    evidence = [f'{where}; without D* no peak lies in the range' if frozen == np.inf else
                f'{where}; D* shifts it by {percent(frozen)}']
    shift = 0.0
    if force:
        try:
            swing = vibration(system, peak.linear, peak.mode, lambda W: force * peak.force / (damping * W))
            shift, moves = abs(swing.omega / w - 1), f'which shifts the peak {"up" if swing.omega > w else "down"} by '
            moves += percent(shift)
        except StronglyNonlinear:
            shift, moves = np.inf, 'at which no periodic vibration exists'
        reach = force * peak.force / (damping * w) * abs(peak.linear.shapes[peak.mode]).max() / calc.bonds.lengths.min()
        evidence.append(f'a force of {force:g} N gives an amplitude of {percent(reach)} of the spacing, {moves}')

    points, free = len(omega), system.free.shape[1]
    algorithm = 'a Chebyshev series' if free > SMALL else f'a sum over {free} modes' if free > 1 else 'a closed form'
    doubt = shift * (ONE_PATTERN if free > MOST_DIRECTIONS else 0.0)  # of the shift alone
    methods = [Method(f'{model} linear', algorithm, error, doubt / error if 0 < error < np.inf else 0.0, model)
               for model, error in zip(reversed(MODELS), (frozen + shift, shift), strict=True)]
    if force:
        dt = min(np.sqrt(24 * STEP_ERROR_FRACTION * tolerance) / w, LONGEST_STEP * 2 / highest_frequency(system))
        steps = int(np.ceil(2 * np.log(HEADSTART / TRANSIENT_FRACTION) / damping / dt))
        methods.append(Method('nonlinear', f'velocity Verlet to the steady state at {points} frequencies, {steps} steps each',
                              float((w * dt) ** 2 / 24), dt=float(dt)))
    return Plan('Frequency of the highest peak', '', tolerance, tuple(methods), tuple(evidence))


def _without_dstar(system, w, source, answer, omega, damping):
    """Relative shift of the peak without D*, for large structures an upper bound; infinite if the peak leaves the range."""
    other = LinearSystem.about(system.calc.about(system.atoms, model='conventional'), system.atoms)
    try:
        shift = float(abs(highest_peak(other, source, answer, omega, damping).omega / w - 1))
    except ValueError:  # the peak has left the range
        return np.inf
    if system.free.shape[1] > MOST_DIRECTIONS:  # both peaks are known to half a step of the frequencies
        return shift + float(np.diff(omega).max() / w)
    return shift if shift > ROUND_OFF else 0.0
