"""How the frequency of a free vibration changes with its amplitude, by perturbation theory, and how far a linear answer holds.

A mode e of frequency w moves as u = A e cos(w t), its largest displacement A.  The cubic terms of the energy make the
structure follow, statically and at 2 w; with them the mode feels, to second order in A,

    m w dw = A^2 [ Phi4/16 - (g D^-1 g + g (D - 4 w^2 M)^-1 g / 2) / 8 ]        m = e M e

with the contractions Phi4 = sum_b phi4(d, d, d, d) and g = C^T phi3(d, d, .) of each bond's third and fourth derivatives
over the relative displacements d = C e of their ends.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import sparse

from .constraints import free_directions
from .rest import at_rest
from .stiffness import bloch_matrix, hessian, model_stiffness
from .timestep import DENSE

ROUND_OFF = 1e-12
"""Of the highest squared frequency: what remains of a zero one."""

CIRCLE = np.exp(2j * np.pi * np.arange(8) / 8)[:, None]
RADIUS, STEEPEST = 1e-2, 20.0
"""The circle on which the law is sampled for its higher derivatives, to some 1e-11: its radius as a share of the bond, or
of 20 f/f' where the law is steeper, such as that of spheres in contact."""


@dataclass(frozen=True)
class Shifts:
    """Amplitude dependence of modes.

    Attributes
    ----------
    q : ndarray, shape (modes, 3)
        Wavevectors in fractions of the reciprocal vectors.
    omega : ndarray, shape (modes,)
        Linear angular frequencies in rad/ms.
    curvature : ndarray, shape (modes,)
        dw/w over the square of the largest displacement, 1/mm^2.
    """

    q: np.ndarray
    omega: np.ndarray
    curvature: np.ndarray

    def amplitude(self, error):
        """Displacement in mm up to which every frequency stays within `error` of the linear one; infinite without modes."""
        return float(np.sqrt(error / abs(self.curvature).max())) if self.curvature.any() else np.inf


def frequency_shifts(atoms):
    """Shifts of the modes that bound the spectrum of a structure; the complete model is meant, whatever that of `atoms` is.

    Of a periodic cell these are the standing waves with q = 0 or 1/2 along the reciprocal vectors, the edges of its bands;
    of a finite structure its softest and its stiffest mode.  Between them a mode may be in 2:1 resonance with
    another and exchange energy with it at any amplitude, which no shift describes.

    Parameters
    ----------
    atoms : ase.Atoms
        With their MagneticRepulsion, at rest.

    Returns
    -------
    Shifts
        Without modes of zero or imaginary frequency, which do not vibrate.
    """
    calc = at_rest(atoms)
    k = calc.parameters.foundation
    bonds, R = calc.bonds, calc.bonds.vectors[:, : calc.dim]
    K, P = model_stiffness(R, calc.potential), free_directions(atoms)
    M = sparse.diags_array(P.power(2).T @ np.repeat(atoms.get_masses(), calc.dim))
    zone = atoms.pbc.any() and P.shape[1] <= DENSE

    def stiffness(q):
        return P.T @ bloch_matrix(bonds, K, np.array([q]), k)[0].real @ P if zone else P.T @ hessian(bonds, K, k) @ P

    law, rest = _derivatives(calc.potential, bonds.lengths), stiffness((0.0, 0.0, 0.0))
    edges = product(*((0.0, 0.5) if zone and along else (0.0,) for along in atoms.pbc))
    rows = []
    for q in edges:
        C = bonds.incidence_at(q).real
        for w, e in _modes(stiffness(q) if zone else rest, M, whole=zone):
            rows.append((q, w, _curvature(R, law, (P @ e).reshape(len(atoms), -1), w, C, bonds.incidence, P, rest, M)))
    q, w, curvature = zip(*rows, strict=True) if rows else ((), (), ())
    return Shifts(np.reshape(q, (-1, 3)), np.array(w), np.array(curvature))


def _modes(D, M, whole):
    """Stable modes `(w, e)` of the stiffness D: all of them, or the softest and the stiffest."""
    root = sparse.diags_array(1 / np.sqrt(M.diagonal()))
    weighted = root @ D @ root
    if D.shape[0] <= DENSE:
        squares, modes = np.linalg.eigh(_full(weighted))
    else:
        start = np.random.default_rng(0).normal(size=D.shape[0])  # the same modes every time
        squares, modes = sparse.linalg.eigsh(weighted, k=2, which='BE', v0=start, tol=1e-6)
    picked = range(len(squares)) if whole else sorted({0, len(squares) - 1} if len(squares) else ())
    return [(np.sqrt(squares[n]), root @ modes[:, n]) for n in picked if squares[n] > ROUND_OFF * squares[-1]]


def _curvature(R, law, u, w, C, C0, P, D, M):
    """dw/w over A^2 of the mode `u`, shape (particles, dim): its bonds part by `C u`, those of what follows by `C0`."""
    psi2, psi3, psi4 = law
    u = u / np.linalg.norm(u, axis=1).max()
    d, e = C @ u, P.T @ u.ravel()
    dd, Rd = (d * d).sum(axis=1), (R * d).sum(axis=1)
    phi3 = 4 * psi2[:, None] * (dd[:, None] * R + 2 * Rd[:, None] * d) + 8 * (psi3 * Rd**2)[:, None] * R
    phi4 = 12 * psi2 * dd**2 + 48 * psi3 * dd * Rd**2 + 16 * psi4 * Rd**4
    g = P.T @ (C0.T @ phi3).ravel()
    follow = g @ _solve(D, g) + g @ _solve(D - 4 * w**2 * M, g) / 2
    return (phi4.sum() / 16 - follow / 8) / (w**2 * (e @ (M @ e)))


def _solve(D, g):
    if D.shape[0] > DENSE:
        return sparse.linalg.spsolve(sparse.csc_array(D), g)
    # least squares: what moves all particles alike costs nothing without a foundation, and nothing pushes it
    return np.linalg.lstsq(_full(D), g)[0]


def _full(D):
    return D.toarray() if sparse.issparse(D) else np.asarray(D)


def _derivatives(potential, r):
    """Second, third and fourth derivative of psi(s) = phi(r), s = r^2."""
    p1, p2, p3, p4 = potential.dphi(r), potential.d2phi(r), *higher_derivatives(potential, r)
    return ((p2 - p1 / r) / (4 * r**2),
            (p3 - 3 * p2 / r + 3 * p1 / r**2) / (8 * r**3),
            (p4 - 6 * p3 / r + 15 * p2 / r**2 - 15 * p1 / r**3) / (16 * r**4))


def higher_derivatives(potential, r):
    """Third and fourth derivative of phi at `r` (mm), from phi'' on a circle in the complex plane, by Cauchy's formula."""
    f, slope = abs(potential.dphi(r)), abs(potential.d2phi(r))
    radius = RADIUS * r * np.minimum(1, STEEPEST * f / np.maximum(r * slope, np.finfo(float).tiny)) if f.all() else RADIUS * r
    around = potential.d2phi(r + radius * CIRCLE)
    return tuple(n * (around * CIRCLE**-n).mean(axis=0).real / radius**n for n in (1, 2))
