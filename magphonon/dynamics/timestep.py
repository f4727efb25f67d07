"""The longest stable time step of velocity Verlet, 2/omega_max."""

import numpy as np
from scipy import sparse

from ..stiffness.calculator import MagneticRepulsion
from ..stiffness.constraints import free_directions
from ..stiffness.matrices import hessian
from ..stiffness.rest import nearest_rest

DENSE = 200
"""Matrices up to this size are diagonalised whole."""
ROUGH, FINE = 1e-3, 1e-7
"""Relative errors of the largest eigenvalue: near it others crowd, so the fine one takes long and is sought only at the limit."""


def refuse_unstable(atoms, dt):
    """Raise ValueError if `dt` (ms) is over the limit 2/omega_max about rest; other calculators are not judged."""
    if not isinstance(atoms.calc, MagneticRepulsion):
        return
    omega = highest_frequency(atoms, dt)
    if omega * dt > 2:
        raise ValueError(f'the time step of {dt:.9g} ms is over the limit of stability 2/omega_max = {2 / omega:.9g} ms; '
                         'a tenth of the limit is accurate; allow_unstable=True runs all the same')


def highest_frequency(atoms, dt=np.inf):
    """Highest angular frequency of what the constraints leave free, in rad/ms, about rest.

    Of a structure that is at rest nowhere, about the reference or where the atoms are, whichever is nearer to balance.

    Parameters
    ----------
    atoms : ase.Atoms
        With its MagneticRepulsion.
    dt : float
        Time step in ms to be judged: a cheap upper bound is returned instead if that is below 2/dt already.
    """
    calc, masses = nearest_rest(atoms)[0], atoms.get_masses()
    bonds, k = calc.bonds, calc.foundation
    K = calc.rest_stiffness(calc.linear_model)
    P = free_directions(atoms)
    mobile = np.zeros(len(atoms), bool)
    mobile[P.nonzero()[0] // calc.dim] = True
    bound = np.sqrt(_row_bound(bonds, K, k, masses)[mobile].max(initial=0.0))
    if not bound or bound * dt <= 2:
        return bound
    free = sparse.diags_array(1 / np.sqrt(np.repeat(masses, calc.dim))) @ P
    D = free.T @ hessian(bonds, K, k) @ free
    bounds = (lambda: abs(D).sum(axis=1).max(), lambda: (1 + ROUGH) * _largest_eigenvalue(D, ROUGH))  # the cheaper first
    for square in bounds if np.isfinite(dt) else ():
        bound = np.sqrt(square())
        if bound * dt <= 2:
            return bound
    return np.sqrt(max(_largest_eigenvalue(D, FINE), 0.0))


def _row_bound(bonds, K, k, masses):
    """Gershgorin's bound on the squared frequencies by particle: `k/m_i + sum_b |K_b| (1/m_i + 1/sqrt(m_i m_j))`."""
    norm = abs(np.linalg.eigvalsh(K)).max(axis=1)
    squares = k / masses
    for i, j in ((bonds.i, bonds.j), (bonds.j, bonds.i)):
        squares += np.bincount(i, norm * (1 / masses[i] + 1 / np.sqrt(masses[i] * masses[j])), len(masses))
    return squares


def _largest_eigenvalue(D, tolerance):
    if D.shape[0] < DENSE:
        return np.linalg.eigvalsh(D.toarray()).max(initial=0.0)
    start = np.random.default_rng(0).normal(size=D.shape[0])  # the same verdict every time
    return sparse.linalg.eigsh(D, k=1, which='LA', v0=start, tol=tolerance, return_eigenvectors=False)[0]
