"""The backbone of a resonance: how the frequency of a vibration moves with its amplitude.

A free vibration of finite amplitude is periodic and symmetric in time.  In the modes of the linear problem, with the
nonlinear part N of the forces,

    q_m(t) = sum_h c_hm cos(h W t)      (w_m^2 - h^2 W^2) c_hm = N_hm

For the vibrating mode itself, whose c_1 = A is given, this is its frequency, W^2 = w^2 - N_1/A.  Solved by iteration it
is perturbation theory to all orders: the first round holds the closed form, W = w (1 + c (A/L0)^2).

A force F cos(W t) on the mode, with the damping gamma, holds the amplitude A = F/(gamma W) where the response lags by
90 degrees: the peak of a frequency response follows the backbone.
"""

from dataclasses import dataclass

import numpy as np

from .rest import at_rest

HARMONICS = 8
"""Kept in the vibration; the eighth of the oscillator at A = 0.1 L0 is 4e-7 of the first, at 0.2 L0 4e-5."""
ROUNDS = 60
"""Most iterations; where so many do not settle the vibration, it is far from linear."""
ALIKE = 1e-6
"""Modes whose squared frequencies differ by less than this share are held apart by symmetry and do not drive each other."""
SETTLED = 1e-9
"""Relative change of the frequency in the last round."""


@dataclass(frozen=True)
class Vibration:
    """A periodic free vibration of one mode at a finite amplitude.

    Attributes
    ----------
    omega : float
        Its angular frequency in rad/ms.
    harmonics : ndarray, shape (HARMONICS + 1, modes)
        Amplitudes c_hm in g^1/2 mm: the first row is the shift of the mean position.
    evaluations : int
        Forces on all particles that it took.
    """

    omega: float
    harmonics: np.ndarray
    evaluations: int


class FarFromLinear(ValueError):
    """The iteration does not settle.

    Attributes
    ----------
    evaluations : int
        Forces on all particles that it took all the same.
    """

    def __init__(self, reach, share, evaluations):
        super().__init__(f'no periodic vibration of {reach:.4g} mm, {100 * share:.3g} % of the shortest bond, was found by '
                         'starting from the linear mode: it is too far from linear; take a smaller amplitude or force, or step '
                         'it in time (DrivenVerlet)')
        self.evaluations = evaluations


def vibration(atoms, linear, mode, amplitude):
    """The periodic vibration of one mode at a finite amplitude.

    Parameters
    ----------
    atoms : ase.Atoms
        At rest, with MagneticRepulsion.
    linear : magphonon.linear.Modes
        All of them.
    mode : int
    amplitude : function
        From the frequency W in rad/ms to c_1 of the mode in g^1/2 mm: a constant, or `F/(gamma W)` at the peak of a response.

    Returns
    -------
    Vibration

    Raises
    ------
    FarFromLinear
        A ValueError: the amplitude is too large for the iteration.
    """
    calc, w = at_rest(atoms), linear.omega
    theta = np.pi * (np.arange(2 * HARMONICS) + 0.5) / (2 * HARMONICS)  # half a period: the other half mirrors it
    cosines = np.cos(np.multiply.outer(np.arange(HARMONICS + 1), theta))
    norm = np.where(np.arange(HARMONICS + 1) > 0, 2, 1)[:, None] / len(theta)
    h2 = np.arange(HARMONICS + 1)[:, None] ** 2
    W, c = w[mode], np.zeros((HARMONICS + 1, len(w)))
    reach = amplitude(W) * np.linalg.norm(linear.shapes[mode], axis=1).max()
    failed = FarFromLinear(reach, reach / calc.bonds.lengths.min(), ROUNDS * len(theta))
    for rounds in range(1, ROUNDS + 1):
        c[1, mode] = amplitude(W)
        q = cosines.T @ c
        N = w * abs(w) * q + np.einsum('tix,mix->tm', _forces(calc, np.einsum('tm,mix->tix', q, linear.shapes)), linear.shapes)
        if not np.isfinite(N).all():
            raise failed
        harmonics = norm * (cosines @ N)
        square = w[mode] ** 2 - harmonics[1, mode] / c[1, mode]
        if not square > 0:
            raise failed
        before, W = W, np.sqrt(square)
        gap = w * abs(w) - h2 * square
        gap[1, (abs(gap[1]) < ALIKE * square) | (np.arange(len(w)) == mode)] = np.inf
        A, c = c[1, mode], harmonics / gap
        c[1, mode] = A
        if abs(W - before) <= SETTLED * W:
            return Vibration(float(W), c, rounds * len(theta))
    raise failed


def _forces(calc, u):
    """Forces in N, counted from rest, at many displacements `u` at once; both of the shape (times, particles, dim)."""
    bonds, R = calc.bonds, calc.bonds.vectors[:, : calc.dim]
    bond = R + u[:, bonds.j] - u[:, bonds.i]
    r = np.linalg.norm(bond, axis=2, keepdims=True)
    with np.errstate(all='ignore'):  # of an iteration that goes astray
        pull = calc.potential.dphi(r) / r * bond - (calc.potential.dphi(bonds.lengths) / bonds.lengths)[:, None] * R
    flat = pull.swapaxes(0, 1).reshape(len(bonds), -1)
    return -(bonds.incidence.T @ flat).reshape(len(calc.reference), len(u), -1).swapaxes(0, 1) - calc.parameters.foundation * u
