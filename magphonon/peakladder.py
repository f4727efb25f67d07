"""The ladder for the peak of a frequency response: whether its frequency needs D*, or moves with the amplitude.

In a mode e of frequency w, normalised to sum m e^2 = 1, D* has the share e D* e of w^2: without it the peak stands
higher by about half of that over w^2.  A force F cos(W t) drives the mode to the amplitude e.F/(gamma W), which moves
the peak along its backbone (`magphonon.backbone`).
"""

from dataclasses import dataclass

import numpy as np

from .backbone import ALIKE, vibration
from .bands import repulsion_of
from .frf import HEADSTART
from .ladder import EIGENSOLVE, Plan, Rung, force_cost
from .linear import Modes, modes
from .stiffness import bond_stiffness

LONGEST_STEP = 0.5
"""Time step of a run, at most, as a share of the limit 2/omega_max."""
SHARE = 0.6
"""Of the tolerance that time steps may use up."""
SHARPNESS = 0.5
"""Modes whose peaks reach this share of the highest must agree that D* does not matter: it may exchange them."""
DOUBT_FIRST_ORDER = 1.0
"""Of the error without D*: first-order perturbation theory is right to a factor of two."""


@dataclass(frozen=True)
class Peak:
    """The highest resonance of a response in its range.

    Attributes
    ----------
    linear : Modes
    mode : int
        The mode that resonates.
    rivals : ndarray of int
        Modes with nearly as high a peak, itself among them.
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
    """The mode that dominates the response in the range of frequencies.

    Parameters
    ----------
    atoms : ase.Atoms
    source, answer : tuple of int and array_like, shape (3,)
        Particle and direction of the force, and of the displacement that is looked at.
    omega : array_like
        In rad/ms; the range from its least to its largest.
    damping : float
        gamma in 1/ms.

    Raises
    ------
    ValueError
        If the structure is unstable or does not resonate in the range.
    """
    linear = modes(atoms)
    w = linear.omega
    if w[0] < 0:
        raise ValueError(f'the structure is unstable (growth rate {-w[0]:.4g} / ms) and has no steady response; '
                         '"magphonon check" says what would hold it')
    linear = _turned(linear, source)
    push, seen = (_at(linear.shapes, place) for place in (source, answer))
    within = (w >= np.min(omega)) & (w <= np.max(omega))
    height = np.where(within, abs(push * seen), 0) / (damping * np.maximum(w, 1e-300))
    if not height.any():
        raise ValueError('no mode resonates between the lowest and the highest frequency; widen the range of [frf]')
    mode = int(height.argmax())
    return Peak(linear, mode, np.flatnonzero(height >= SHARPNESS * height[mode]), float(abs(push[mode])))


def _at(shapes, place):
    """Displacement of each mode at a particle along a direction, g^-1/2."""
    particle, direction = place
    return shapes[:, particle] @ np.asarray(direction)[: shapes.shape[2]]


def _turned(linear, source):
    """The same modes, but of those with equal frequencies only the first answers to the force."""
    shapes = linear.shapes.copy()
    scale = ALIKE * linear.omega[-1]
    for group in np.split(np.arange(len(shapes)), np.flatnonzero(np.diff(linear.omega) > scale) + 1):
        push = _at(shapes[group], source)
        if len(group) > 1 and push.any():
            basis = np.linalg.qr(np.column_stack([push, np.eye(len(group))]))[0]
            shapes[group] = np.einsum('gh,gix->hix', basis, shapes[group])
    return Modes(linear.omega, shapes)


def plan_peak(atoms, source, answer, omega, damping, tolerance, force=0.0):
    """Plan for the frequency of the highest peak of a response.

    Parameters
    ----------
    atoms : ase.Atoms
        At rest, with MagneticRepulsion; small enough to be diagonalised.
    source, answer, omega, damping
        As for `highest_peak`.
    tolerance : float
        Of the frequency, relative.
    force : float
        Amplitude in N; zero for the response to a vanishing force.

    Returns
    -------
    Plan
        The settings of its rungs are `model` and, where time is stepped, `dt` in ms.
    """
    calc = repulsion_of(atoms)
    peak = highest_peak(atoms, source, answer, omega, damping)
    w, size = peak.omega, len(peak.linear.omega)
    stiffening = turning(atoms, peak)
    frozen = float(abs(np.sqrt(1 - stiffening) - 1).max())
    evidence = [f'the peak at {w / (2 * np.pi) * 1e3:.6g} Hz; D* bends it by {frozen:.1e}, to first order' if frozen else
                f'the peak at {w / (2 * np.pi) * 1e3:.6g} Hz; nothing there turns a bond, so D* has no part in it']
    shift, evaluations = 0.0, 0
    if force:
        swing = vibration(atoms, peak.linear, peak.mode, lambda W: force * peak.force / (damping * W))
        shift, evaluations = abs(swing.omega / w - 1), swing.evaluations
        reach = force * peak.force / (damping * w) * abs(peak.linear.shapes[peak.mode]).max() / calc.bonds.lengths.min()
        moved = f'moves it by {swing.omega / w - 1:+.1e}' if np.isfinite(shift) else 'drives it beyond a periodic vibration'
        evidence.append(f'{force:g} N swings it to {reach:.1e} of the spacing, which {moved}')
        shift = shift if np.isfinite(shift) else np.inf

    points = len(omega)
    linear_cost = EIGENSOLVE * size**3 + points * size
    rungs = [Rung('conventional linear', f'sum over {size} mode{"s"[: size > 1]}', linear_cost, frozen + shift,
                  DOUBT_FIRST_ORDER if frozen else 0.0, {'model': 'conventional'}),
             Rung('complete linear', f'sum over {size} mode{"s"[: size > 1]}', linear_cost, shift, 0.0, {'model': 'complete'})]
    if force:
        dt = min(np.sqrt(24 * SHARE * tolerance) / w, LONGEST_STEP * 2 / peak.linear.omega[-1])
        steps = int(np.ceil(2 * np.log(HEADSTART / tolerance) / damping / dt))
        cost = points * steps * len(calc.bonds) * force_cost(calc.dim)
        rungs.append(Rung('nonlinear', f'velocity Verlet to the steady state at {points} frequencies, {steps} steps', cost,
                          float((w * dt) ** 2 / 24), 0.0, {'model': 'complete', 'dt': float(dt)}))
    spent = EIGENSOLVE * size**3 + evaluations * len(calc.bonds) * force_cost(calc.dim)
    return Plan('the frequency of the highest peak, relative', tolerance, tuple(rungs), tuple(evidence), spent)


def turning(atoms, peak):
    """Share e D* e/w^2 of the static forces in the squared frequency of each of the peak's rivals."""
    calc = repulsion_of(atoms)
    bonds, R = calc.bonds, calc.bonds.vectors[:, : calc.dim]
    n = R / bonds.lengths[:, None]
    e = peak.linear.shapes[peak.rivals]
    apart = e[:, bonds.j] - e[:, bonds.i]
    sideways = apart - np.einsum('mbx,bx->mb', apart, n)[..., None] * n
    if abs(sideways).max() <= 1e-12 * abs(e).max():
        return np.zeros(len(e))
    Dstar = bond_stiffness(R, calc.potential)[1]
    return np.einsum('mbx,bxy,mby->m', sideways, Dstar, sideways) / peak.linear.omega[peak.rivals] ** 2
