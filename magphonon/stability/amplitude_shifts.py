"""Amplitude dependence of frequencies: perturbation theory for small amplitudes, and harmonic balance beyond it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from scipy import sparse

from .. import units
from ..errors import PhysicsError
from ..interactions.pair_laws import higher_derivatives
from ..stiffness.lowest import DENSE, lowest_mode
from ..stiffness.rest import LinearSystem

ROUND_OFF = 1e-12  # fraction of the highest squared frequency below which a squared frequency is zero
HARMONICS = 8
"""Number of harmonics of the vibration; the eighth of the oscillator at A = 0.1 L0 is 4e-7 of the first, at 0.2 L0 4e-5."""
ROUNDS = 60  # largest number of iterations; a vibration that has not converged by then is far from linear
DEGENERACY = 1e-6
"""Relative difference of squared frequencies below which two modes are degenerate by symmetry and do not drive each other."""
CONVERGENCE = 1e-9  # relative change of the frequency in the last iteration at which the vibration has converged


@dataclass(frozen=True)
class Shifts(units.InHertz):
    """Amplitude dependence of modes.

    Attributes
    ----------
    q : ndarray, shape (modes, 3)
        Wavevectors in fractions of the reciprocal vectors.
    omega : ndarray, shape (modes,)
        Linear angular frequencies in rad/ms.
    curvature : ndarray, shape (modes,)
        dw/w divided by the square of the largest displacement, 1/mm^2.
    """

    q: np.ndarray
    omega: np.ndarray
    curvature: np.ndarray

    def amplitude(self, error: float) -> float:
        """Displacement in mm up to which every frequency stays within `error` of the linear one; infinite without modes."""
        return float(np.sqrt(error / abs(self.curvature).max())) if self.curvature.any() else np.inf


def frequency_shifts(atoms: Atoms | LinearSystem) -> Shifts:
    """Shifts of the modes that bound the spectrum of a structure; always by the complete model.

    For a periodic cell these are the standing waves with q = 0 or 1/2 along the reciprocal vectors, the band edges; for a finite
    structure its softest and its stiffest mode.  Other modes may be in 2:1 resonance with each other and exchange energy at
    any amplitude, which a frequency shift cannot describe.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        With their MagneticRepulsion, at rest.

    Returns
    -------
    Shifts
        Modes of zero or imaginary frequency are omitted, because they do not vibrate.

    Examples
    --------
    >>> from magphonon import read_scene, ready_scene
    >>> from magphonon.stability import frequency_shifts
    >>> shifts = frequency_shifts(read_scene(ready_scene('prototype')).atoms())
    >>> shifts.q.shape[1], shifts.curvature.shape == shifts.omega.shape
    (3, True)
    """
    system = LinearSystem.of(atoms)
    calc, P, pbc = system.calc, system.free, system.atoms.pbc
    bonds, R = calc.bonds, calc.bond_vectors
    M = sparse.diags_array(P.power(2).T @ np.repeat(system.masses, calc.dim))
    zone = pbc.any() and P.shape[1] <= DENSE

    def stiffness(q):
        return P.T @ calc.bloch_matrix(np.array([q]))[0].real @ P if zone else P.T @ calc.rest_hessian() @ P

    law = calc.central('shifts of frequencies')
    rest = stiffness((0.0, 0.0, 0.0))
    shifts = _SecondOrder(R, *law_derivatives(law, bonds.lengths), bonds.incidence, P, rest, M)
    rows = []
    for q in product(*((0.0, 0.5) if zone and along else (0.0,) for along in pbc)):
        C = bonds.incidence_at(q).real
        for w, e in _modes(stiffness(q) if zone else rest, M, whole=zone):
            rows.append((q, w, shifts.curvature((P @ e).reshape(len(system), -1), w, C)))
    q, w, curvature = zip(*rows, strict=True) if rows else ((), (), ())
    return Shifts(np.reshape(q, (-1, 3)), np.array(w), np.array(curvature))


def _modes(D, M, whole):
    """Stable modes `(w, e)` of the stiffness D: all of them, or the softest and the stiffest."""
    root = sparse.diags_array(1 / np.sqrt(M.diagonal()))
    weighted = root @ D @ root
    if D.shape[0] <= DENSE:
        squares, modes = np.linalg.eigh(_full(weighted))
    else:
        (lowest, _, softest), (highest, _, stiffest) = lowest_mode(weighted), lowest_mode(-weighted)
        squares, modes = np.array([lowest, -highest]), np.column_stack([softest, stiffest])
    picked = range(len(squares)) if whole else sorted({0, len(squares) - 1} if len(squares) else ())
    return [(np.sqrt(squares[n]), root @ modes[:, n]) for n in picked if squares[n] > ROUND_OFF * squares[-1]]


@dataclass(frozen=True)
class _SecondOrder:
    """The quantities of a structure from which frequencies follow to second order in the amplitude.

    Bond vectors R at rest, derivatives psi of the law by the square of the distance; and of the uniform motion that follows the
    mode its incidence matrix, free directions P, stiffness D and masses M.
    """

    R: NDArray[np.float64]
    psi2: NDArray[np.float64]
    psi3: NDArray[np.float64]
    psi4: NDArray[np.float64]
    incidence: sparse.csr_array
    P: sparse.csr_array
    D: Any
    M: Any

    def curvature(self, u, w, C):
        """dw/w divided by A^2 for the mode `u`, shape (particles, dim), at frequency `w`; `C u` are its bond changes."""
        R, P, psi2, psi3, psi4 = self.R, self.P, self.psi2, self.psi3, self.psi4
        u = u / np.linalg.norm(u, axis=1).max()
        d, e = C @ u, P.T @ u.ravel()
        dd, Rd = (d * d).sum(axis=1), (R * d).sum(axis=1)
        phi3 = 4 * psi2[:, None] * (dd[:, None] * R + 2 * Rd[:, None] * d) + 8 * (psi3 * Rd**2)[:, None] * R
        phi4 = 12 * psi2 * dd**2 + 48 * psi3 * dd * Rd**2 + 16 * psi4 * Rd**4
        g = P.T @ (self.incidence.T @ phi3).ravel()
        follow = g @ _solve(self.D, g) + g @ _solve(self.D - 4 * w**2 * self.M, g) / 2
        return (phi4.sum() / 16 - follow / 8) / (w**2 * (e @ (self.M @ e)))


def _solve(D, g):
    if D.shape[0] > DENSE:
        # pivots off the diagonal would fill the factors; one step of refinement recovers the accuracy that diagonal pivots cost
        factors = sparse.linalg.splu(sparse.csc_array(D), 'MMD_AT_PLUS_A', diag_pivot_thresh=0.0, options={'SymmetricMode': True})
        found = factors.solve(g)
        return found + factors.solve(g - D @ found)
    # least squares: without a foundation uniform translations have neither stiffness nor force
    return np.linalg.lstsq(_full(D), g)[0]


def _full(D):
    return D.toarray() if sparse.issparse(D) else np.asarray(D)


def law_derivatives(law: Any, r: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Second, third and fourth derivative of psi(s) = phi(r), s = r^2, at distances r in mm."""
    p1, p2, p3, p4 = law.dphi(r), law.d2phi(r), *higher_derivatives(law, r)
    return ((p2 - p1 / r) / (4 * r**2),
            (p3 - 3 * p2 / r + 3 * p1 / r**2) / (8 * r**3),
            (p4 - 6 * p3 / r + 15 * p2 / r**2 - 15 * p1 / r**3) / (16 * r**4))


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
        Number of evaluations of the forces on all particles.
    """

    omega: float
    harmonics: np.ndarray
    evaluations: int


class FarFromLinear(PhysicsError):
    """The iteration does not converge.

    Attributes
    ----------
    evaluations : int
        Number of evaluations of the forces on all particles.
    """

    def __init__(self, reach: float, share: float, evaluations: int) -> None:
        super().__init__(f'no periodic vibration of {reach:.4g} mm, {100 * share:.3g} % of the shortest bond, was found by '
                         'starting from the linear mode: the motion is too far from linear; use a smaller amplitude or force, '
                         'or time steps (DrivenVerlet)')
        self.evaluations = evaluations


def vibration(atoms: Atoms | LinearSystem, linear: Any, mode: int, amplitude: Callable[[float], float]) -> Vibration:
    """The periodic vibration of one mode at a finite amplitude.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        At rest, with MagneticRepulsion.
    linear : magphonon.response.normal_modes.Modes
        All modes of the structure.
    mode : int
    amplitude : function
        Gives c_1 of the mode in g^1/2 mm as a function of the frequency W in rad/ms: a constant, or `F/(gamma W)` at the peak of
        a response.

    Raises
    ------
    FarFromLinear
        A ValueError: the amplitude is too large for the iteration.
    """
    calc, w = LinearSystem.of(atoms).calc, linear.omega
    theta = np.pi * (np.arange(2 * HARMONICS) + 0.5) / (2 * HARMONICS)  # half a period; the other half is its mirror image
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
        gap[1, (abs(gap[1]) < DEGENERACY * square) | (np.arange(len(w)) == mode)] = np.inf
        A, c = c[1, mode], harmonics / gap
        c[1, mode] = A
        if abs(W - before) <= CONVERGENCE * W:
            return Vibration(float(W), c, rounds * len(theta))
    raise failed


def _forces(calc, u):
    """Forces in N relative to rest, at many displacements `u` at once; both of the shape (times, particles, dim)."""
    bonds, R = calc.bonds, calc.bond_vectors
    bond = R + u[:, bonds.j] - u[:, bonds.i]
    r = np.linalg.norm(bond, axis=2, keepdims=True)
    with np.errstate(all='ignore'):  # overflow in an iteration that diverges
        slope = calc.law.dphi(r.swapaxes(0, 1)).swapaxes(0, 1)
        pull = slope / r * bond - (calc.law.dphi(bonds.lengths) / bonds.lengths)[:, None] * R
    flat = pull.swapaxes(0, 1).reshape(len(bonds), -1)
    return -(bonds.incidence.T @ flat).reshape(len(calc.reference), len(u), -1).swapaxes(0, 1) - calc.foundation * u
