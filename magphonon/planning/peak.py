"""The plan for the peak of a frequency response: does its frequency need D*, and does it depend on the amplitude?

Without D* modes mix and change their order, so a small structure is diagonalised a second time.  For a large structure only the
displacement pattern e at the peak is known, normalised to sum m e^2 = 1, with the frequency w.  D* contributes e D* e to w^2.  If
the pattern does not change, first-order perturbation theory gives the shift of the frequency without D*, -e D* e/(2 w).

A force F cos(W t) drives a mode to the amplitude e.F/(gamma W), which moves the peak along its backbone curve
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
from ..response.frf import Place, frequency_response, harmonic_response
from ..response.normal_modes import SMALL, Modes, modes, refuse_growing
from ..response.stepped import HEADSTART, TRANSIENT_FRACTION
from ..stability.amplitude_shifts import DEGENERACY, FarFromLinear, vibration
from ..stiffness.bond import bond_stiffness
from ..stiffness.calculator import MagneticRepulsion
from ..stiffness.rest import LinearSystem
from .plan import EIGENSOLVE, LONGEST_STEP, STEP_ERROR_FRACTION, Method, Plan, Settings, force_cost, percent

RIVAL_RATIO = 0.9
"""Ratio to the highest peak above which another peak may be the highest too, because D* and overlap can change the order."""
ROUND_OFF = 1e-12  # relative difference of two frequencies that is round-off
DECOUPLED = 1e-10
"""Force on a mode times what is seen of it, as a fraction of the largest such values of all modes, below which it is round-off:
without D*, the rows and columns of a square lattice are chains that do not move each other."""
MOST_DIRECTIONS = 1000
"""Largest number of degrees of freedom of a structure that is diagonalised, which takes about 0.3 s; the time grows with the
third power."""
DOUBT_ONE_PATTERN = 10.0
"""Relative uncertainty of a shift that is estimated from one displacement pattern, without its mixing with others: only the order
of magnitude is known.  Of 240 patches with unequal masses the shift exceeded the estimate by factors up to 11.4, in 22 of them by
more than 2."""


@dataclass(frozen=True)
class Peak:
    """The highest resonance of a response in its range."""

    linear: Modes  # all modes of a small structure; for a large structure, only the displacement pattern at the peak
    mode: int  # the mode that resonates
    rivals: np.ndarray  # modes whose peaks may be as high, including the mode itself
    force: float  # the force on the mode for a unit force, g^-1/2

    @property
    def omega(self) -> float:
        """In rad/ms."""
        return float(self.linear.omega[self.mode])


def highest_peak(atoms: Atoms | LinearSystem, source: Place, answer: Place, omega: NDArray[np.float64], damping: float) -> Peak:
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
    return Peak(linear, mode, np.flatnonzero(height >= RIVAL_RATIO * height[mode]), float(abs(push[mode])))


def _peak_of_field(system, source, answer, omega, damping):
    """The peak of a large structure, from the response at all frequencies; its pattern is the response of all particles there."""
    force = source.force(len(system))
    found = frequency_response(system, force, omega, damping, [answer.particle], tolerance=1e-4)
    response = found.response[:, 0] @ answer.direction
    w = omega[abs(response).argmax()]
    e = np.imag(harmonic_response(system, force, [w], damping).response[0, :, : system.dim])
    e /= np.sqrt(np.einsum('i,ix,ix->', system.masses, e, e))
    return Peak(Modes(np.array([w]), e[None]), 0, np.array([0]), float(abs(source.seen(e))))


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


def plan_peak(atoms: Atoms | LinearSystem, source: Place, answer: Place, omega: NDArray[np.float64], damping: float,
              tolerance: float, force: float = 0.0) -> Plan:
    """Plan for the frequency of the highest peak of a response.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        At rest, with MagneticRepulsion.
    source, answer, omega, damping
        As for `highest_peak`.
    tolerance : float
        Relative error allowed in the frequency.
    force : float
        Amplitude in N; zero for the small-amplitude response.

    Returns
    -------
    Plan
        The settings of its methods are `model` and, where time is stepped, `dt` in ms.
    """
    system = LinearSystem.of(atoms)
    calc, peak = system.calc, highest_peak(system, source, answer, omega, damping)
    w = peak.omega
    frozen, most = _without_dstar(system, peak, source, answer, omega, damping)
    where = f'the peak is at {units.hertz(w):.6g} Hz'
    evidence = [f'{where}; without D* there is none in the range' if frozen == np.inf else
                f'{where}; D* shifts it by {percent(frozen)}' if frozen else
                f'{where}; no bond rotates in this mode, so D* does not change it']
    shift, evaluations = 0.0, 0
    if force:
        try:
            swing = vibration(system, peak.linear, peak.mode, lambda W: force * peak.force / (damping * W))
            shift, evaluations = abs(swing.omega / w - 1), swing.evaluations
            moves = f'which shifts the peak {"up" if swing.omega > w else "down"} by {percent(shift)}'
        except FarFromLinear as error:
            shift, evaluations, moves = np.inf, error.evaluations, 'at which no periodic vibration exists'
        reach = force * peak.force / (damping * w) * abs(peak.linear.shapes[peak.mode]).max() / calc.bonds.lengths.min()
        evidence.append(f'a force of {force:g} N gives an amplitude of {percent(reach)} of the spacing, {moves}')

    points, nearest, free = len(omega), len(calc.bonds), system.free.shape[1]
    top, shift_doubt = highest_frequency(system), 0.0 if free <= MOST_DIRECTIONS else DOUBT_ONE_PATTERN
    if free <= SMALL:
        algorithm, cost = f'a sum over {free} modes' if free > 1 else 'its closed form', EIGENSOLVE * free**3 + points * free
    else:
        products = np.log(1e9) * top**2 / (2 * damping * omega[0])
        algorithm = f'a Chebyshev series of about {products:.0f} products with the stiffness matrix'
        cost = products * system.K.nnz
    off = frozen + shift
    doubt = (most + shift * (1 + shift_doubt)) / off - 1 if 0 < off < np.inf else 0.0
    methods = [Method('conventional linear', algorithm, cost, off, doubt, Settings('conventional')),
               Method('complete linear', algorithm, cost, shift, shift_doubt, Settings('complete'))]
    if force:
        dt = min(np.sqrt(24 * STEP_ERROR_FRACTION * tolerance) / w, LONGEST_STEP * 2 / top)
        steps = int(np.ceil(2 * np.log(HEADSTART / TRANSIENT_FRACTION) / damping / dt))
        methods.append(Method('nonlinear', f'velocity Verlet to the steady state at {points} frequencies, {steps} steps each',
                              points * steps * nearest * force_cost(calc.dim), float((w * dt) ** 2 / 24), 0.0,
                              Settings('complete', dt=float(dt))))
    return Plan('Frequency of the highest peak', 'itself', tolerance, tuple(methods), tuple(evidence),
                cost + evaluations * nearest * force_cost(calc.dim) + (EIGENSOLVE * free**3 if free <= MOST_DIRECTIONS else 0))


def _without_dstar(system, peak, source, answer, omega, damping):
    """Relative shift of the peak without D*, and its upper bound."""
    stiffening = turning(system.calc, peak)
    if system.free.shape[1] > MOST_DIRECTIONS:
        frozen = float(abs(np.sqrt(1 - stiffening) - 1).max())
        return frozen, (1 + DOUBT_ONE_PATTERN) * frozen
    other = LinearSystem.about(system.calc.about(system.atoms, model='conventional'), system.atoms)
    try:
        there = highest_peak(other, source, answer, omega, damping)
    except ValueError:  # the peak has left the range
        return np.inf, np.inf
    frozen = float(abs(there.omega / peak.omega - 1))
    if frozen < ROUND_OFF and not stiffening.any():
        return 0.0, 0.0
    between = there.linear.omega[there.rivals] / peak.linear.omega[peak.rivals][:, None]
    return frozen, float(abs(between - 1).max())


def turning(calc: MagneticRepulsion, peak: Peak) -> NDArray[np.float64]:
    """Contribution e D* e/w^2 of the static forces to the squared frequency of each rival of the peak, relative."""
    bonds, R = calc.bonds, calc.bond_vectors
    n = R / bonds.lengths[:, None]
    e = peak.linear.shapes[peak.rivals]
    apart = e[:, bonds.j] - e[:, bonds.i]
    sideways = apart - np.einsum('mbx,bx->mb', apart, n)[..., None] * n
    if abs(sideways).max() <= 1e-12 * abs(e).max():
        return np.zeros(len(e))
    Dstar = bond_stiffness(R, calc.interaction)[1]
    return np.einsum('mbx,bxy,mby->m', sideways, Dstar, sideways) / peak.linear.omega[peak.rivals] ** 2
