"""The longest stable time step of velocity Verlet, 2/omega_max."""

import numpy as np
from ase.constraints import FixAtoms

from .calculator import MagneticRepulsion
from .stiffness import bond_stiffness, condense, hessian


def refuse_unstable(atoms, dt):
    """Raise ValueError if `dt` (ms) is over the limit 2/omega_max about rest; other calculators are not judged."""
    if not isinstance(atoms.calc, MagneticRepulsion):
        return
    mobile = np.ones(len(atoms), bool)
    for constraint in atoms.constraints:
        if isinstance(constraint, FixAtoms):
            mobile[constraint.index] = False
    omega = highest_frequency(atoms.calc, atoms.get_masses(), mobile, dt)
    if omega * dt > 2:
        raise ValueError(f'the time step of {dt:.9g} ms is over the limit of stability 2/omega_max = {2 / omega:.9g} ms; '
                         'a tenth of the limit is accurate; allow_unstable=True runs all the same')


def highest_frequency(calc, masses, mobile, dt):
    """Highest angular frequency about rest in rad/ms, as exactly as judging the time step `dt` asks for.

    The bound of Gershgorin's kind, `|K_b| (1/m_i + 1/sqrt(m_i m_j))` summed over the bonds of particle i, costs
    nothing.  Only when it allows no verdict is the largest eigenvalue of the mass-weighted Hessian computed.

    Parameters
    ----------
    calc : MagneticRepulsion
    masses : ndarray, shape (particles,)
        In g.
    mobile : ndarray of bool, shape (particles,)
        Particles that are not held.
    dt : float
        Time step in ms.

    Returns
    -------
    float
        Not below the true value (but for round-off), and equal to it if above 2/dt.
    """
    bonds, k = calc.bonds, calc.parameters.foundation
    D0, Dstar = bond_stiffness(bonds.vectors[:, : calc.dim], calc.potential)
    K = D0 + Dstar if calc.parameters.model == 'complete' else D0
    norm = abs(np.linalg.eigvalsh(K)).max(axis=1)
    squares = k / masses
    for i, j in ((bonds.i, bonds.j), (bonds.j, bonds.i)):
        squares += np.bincount(i, norm * (1 / masses[i] + 1 / np.sqrt(masses[i] * masses[j])), len(masses))
    bound = np.sqrt(squares[mobile].max(initial=0.0))
    if bound * dt <= 2:
        return bound
    return _largest_root(condense(hessian(bonds, K, k), mobile), np.repeat(masses[mobile], calc.dim))


def _largest_root(H, masses):
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import eigsh

    root = diags_array(1 / np.sqrt(masses))
    D = root @ H @ root
    if D.shape[0] < 200:
        square = np.linalg.eigvalsh(D.toarray())[-1]
    else:
        start = np.random.default_rng(0).normal(size=D.shape[0])  # the same verdict every time
        square = eigsh(D, k=1, which='LA', v0=start, tol=1e-10, return_eigenvectors=False)[0]
    return np.sqrt(max(square, 0.0))
