"""The plan for the peak of a frequency response: does its frequency need D*, and does it depend on the amplitude?

Without D* modes mix and change their order, so a small structure is diagonalised once more.  Of a large one only the
pattern e is known in which it swings at its peak, of the frequency w and normalised to sum m e^2 = 1: D* has the share
e D* e of w^2, and if the pattern stays, the peak stands higher by about half of that over w^2 without it.

A force F cos(W t) drives a mode to the amplitude e.F/(gamma W), which moves the peak along its backbone
(`magphonon.stability.amplitude_shifts`).
"""

from dataclasses import dataclass

import numpy as np

from .. import units
from ..dynamics.timestep import highest_frequency
from ..errors import positive
from ..response.frf import frequency_response, harmonic_response
from ..response.normal_modes import SMALL, Modes, modes, refuse_growing
from ..response.stepped import HEADSTART, STEADY
from ..stability.amplitude_shifts import ALIKE, FarFromLinear, vibration
from ..stiffness.bond import bond_stiffness
from ..stiffness.linear_system import LinearSystem
from .plan import EIGENSOLVE, Method, Plan, Settings, force_cost, percent

LONGEST_STEP = 0.5
"""Time step of a run, at most, as a share of the limit 2/omega_max."""
SHARE = 0.6
"""Of the tolerance that time steps may use up."""
RIVAL = 0.9
"""Of the highest peak: modes whose peaks reach this share may be the highest too, as peaks add up a little."""
ROUND_OFF = 1e-12
"""Of a frequency: what is left of no difference."""
LARGE = 1000
"""Degrees of freedom above which a structure is not diagonalised, some 0.3 s."""
DOUBT_ALONE = 10.0
"""Of the shifts of a pattern that swings alone, without the others that follow it or mix: right in their order of magnitude."""


@dataclass(frozen=True)
class Peak:
    """The highest resonance of a response in its range.

    Attributes
    ----------
    linear : Modes
        All modes of a small structure; of a large one, only the pattern in which it swings at the peak.
    mode : int
        The mode that resonates.
    rivals : ndarray of int
        Modes whose peaks may be as high, itself among them.
    force : float
        The force on the mode for a unit force, g^-1/2.
    """

    linear: Modes
    mode: int
    rivals: np.ndarray
    force: float

    @property
    def omega(self):
        """In rad/ms."""
        return float(self.linear.omega[self.mode])


def highest_peak(atoms, source, answer, omega, damping):
    """The resonance that dominates the response in the range of frequencies, in the complete linear model.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
    source, answer : Place
        Where the force acts, and where the displacement is looked at.
    omega : array_like
        In rad/ms, ascending.
    damping : float
        gamma in 1/ms.

    Raises
    ------
    ValueError
        If the structure is unstable or does not resonate in the range, or nothing damps it: its peaks are infinite.
    """
    system, damping = LinearSystem.of(atoms), positive('damping', damping, '1/ms')
    if system.free.shape[1] > LARGE:
        return _peak_of_field(system, source, answer, omega, damping)
    linear = modes(system)
    w = linear.omega
    refuse_growing(w[0] * abs(w[0]), w[-1] ** 2)
    linear = _turned(linear, source)
    push, seen = (place.seen(linear.shapes) for place in (source, answer))
    resonant = (w >= omega[0]) & (w <= omega[-1]) & (w > 0) & (push * seen != 0)
    # the whole response at each of the frequencies: modes that lie close together add up
    height = np.zeros(len(w))
    height[resonant] = [abs((push * seen / (w * abs(w) - W**2 + 1j * damping * W)).sum()) for W in w[resonant]]
    if not height.any():
        raise ValueError('no mode resonates between the lowest and the highest frequency; widen the range of [frf]')
    mode = int(height.argmax())
    return Peak(linear, mode, np.flatnonzero(height >= RIVAL * height[mode]), float(abs(push[mode])))


def _peak_of_field(system, source, answer, omega, damping):
    """The peak of a large structure: its response at all frequencies, and all of its particles at the highest."""
    force = source.force(len(system))
    response = frequency_response(system, force, omega, damping, [answer.particle], tolerance=1e-4)[:, 0] @ answer.direction
    w = omega[abs(response).argmax()]
    e = harmonic_response(system, force, [w], damping)[0, :, : system.dim].imag
    e /= np.sqrt(np.einsum('i,ix,ix->', system.masses, e, e))
    return Peak(Modes(np.array([w]), e[None]), 0, np.array([0]), float(abs(source.seen(e))))


def _turned(linear, source):
    """The same modes, but of those with equal frequencies only the first answers to the force."""
    shapes = linear.shapes.copy()
    scale = ALIKE * linear.omega[-1]
    for group in np.split(np.arange(len(shapes)), np.flatnonzero(np.diff(linear.omega) > scale) + 1):
        push = source.seen(shapes[group])
        if len(group) > 1 and push.any():
            basis = np.linalg.qr(np.column_stack([push, np.eye(len(group))]))[0]
            shapes[group] = np.einsum('gh,gix->hix', basis, shapes[group])
    return Modes(linear.omega, shapes)


def plan_peak(atoms, source, answer, omega, damping, tolerance, force=0.0):
    """Plan for the frequency of the highest peak of a response.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        At rest, with MagneticRepulsion.
    source, answer, omega, damping
        As for `highest_peak`.
    tolerance : float
        Of the frequency, relative.
    force : float
        Amplitude in N; zero for the response to a vanishing force.

    Returns
    -------
    Plan
        The settings of its methods are `model` and, where time is stepped, `dt` in ms.
    """
    system = LinearSystem.of(atoms)
    calc, peak = system.calc, highest_peak(system, source, answer, omega, damping)
    w = peak.omega
    frozen, most = _without_dstar(system, peak, source, answer, omega, damping)
    where = f'the peak stands at {units.hertz(w):.6g} Hz'
    evidence = [f'{where}; D* moves it by {percent(frozen)}' if frozen else
                f'{where}; nothing turns a bond there, so D* has no part in it']
    shift, evaluations = 0.0, 0
    if force:
        try:
            swing = vibration(system, peak.linear, peak.mode, lambda W: force * peak.force / (damping * W))
            shift, evaluations = abs(swing.omega / w - 1), swing.evaluations
            moves = f'which moves the peak by {percent(shift)} ' + ('up' if swing.omega > w else 'down')
        except FarFromLinear as error:
            shift, evaluations, moves = np.inf, error.evaluations, 'beyond a periodic vibration'
        reach = force * peak.force / (damping * w) * abs(peak.linear.shapes[peak.mode]).max() / calc.bonds.lengths.min()
        evidence.append(f'{force:g} N swings it by {percent(reach)} of the spacing, {moves}')

    points, nearest, free = len(omega), len(calc.bonds), system.free.shape[1]
    top, shift_doubt = highest_frequency(system), 0.0 if free <= LARGE else DOUBT_ALONE
    if free <= SMALL:
        algorithm, cost = f'a sum over {free} modes' if free > 1 else 'its closed form', EIGENSOLVE * free**3 + points * free
    else:
        products = np.log(1e9) * top**2 / (2 * damping * omega[0])
        algorithm = f'a Chebyshev series of some {products:.0f} products with the stiffness'
        cost = products * system.K.nnz
    off = frozen + shift
    doubt = (most + shift * (1 + shift_doubt)) / off - 1 if 0 < off < np.inf else 0.0
    methods = [Method('conventional linear', algorithm, cost, off, doubt, Settings('conventional')),
               Method('complete linear', algorithm, cost, shift, shift_doubt, Settings('complete'))]
    if force:
        dt = min(np.sqrt(24 * SHARE * tolerance) / w, LONGEST_STEP * 2 / top)
        steps = int(np.ceil(2 * np.log(HEADSTART / STEADY) / damping / dt))
        methods.append(Method('nonlinear', f'velocity Verlet to the steady state at {points} frequencies, {steps} steps each',
                              points * steps * nearest * force_cost(calc.dim), float((w * dt) ** 2 / 24), 0.0,
                              Settings('complete', dt=float(dt))))
    return Plan('Frequency of the highest peak', 'itself', tolerance, tuple(methods), tuple(evidence),
                cost + evaluations * nearest * force_cost(calc.dim) + (EIGENSOLVE * free**3 if free <= LARGE else 0))


def _without_dstar(system, peak, source, answer, omega, damping):
    """How far off the peak stands without D*, relatively, and at most."""
    stiffening = turning(system.calc, peak)
    if system.free.shape[1] > LARGE:
        frozen = float(abs(np.sqrt(1 - stiffening) - 1).max())
        return frozen, (1 + DOUBT_ALONE) * frozen
    other = LinearSystem.about(system.calc.about(system.atoms, model='conventional'), system.atoms)
    try:
        there = highest_peak(other, source, answer, omega, damping)
    except ValueError:  # it has left the range
        return np.inf, np.inf
    frozen = float(abs(there.omega / peak.omega - 1))
    if frozen < ROUND_OFF and not stiffening.any():
        return 0.0, 0.0
    between = there.linear.omega[there.rivals] / peak.linear.omega[peak.rivals][:, None]
    return frozen, float(abs(between - 1).max())


def turning(calc, peak):
    """Share e D* e/w^2 of the static forces in the squared frequency of each of the peak's rivals."""
    bonds, R = calc.bonds, calc.bond_vectors
    n = R / bonds.lengths[:, None]
    e = peak.linear.shapes[peak.rivals]
    apart = e[:, bonds.j] - e[:, bonds.i]
    sideways = apart - np.einsum('mbx,bx->mb', apart, n)[..., None] * n
    if abs(sideways).max() <= 1e-12 * abs(e).max():
        return np.zeros(len(e))
    Dstar = bond_stiffness(R, calc.potential)[1]
    return np.einsum('mbx,bxy,mby->m', sideways, Dstar, sideways) / peak.linear.omega[peak.rivals] ** 2
