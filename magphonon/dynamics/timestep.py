"""The longest stable time step of velocity Verlet, 2/omega_max."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from ..stiffness.calculator import MagneticRepulsion
from ..stiffness.linear_system import LinearSystem
from ..stiffness.lowest import DENSE

if TYPE_CHECKING:
    from ase import Atoms

ROUGH, FINE = 1e-3, 1e-7
"""Relative errors of the largest eigenvalue.  It lies close to others, so the fine accuracy takes long and is used only near the
stability limit."""


def refuse_long_step(atoms: Atoms, dt: float) -> None:
    """Raise ValueError if `dt` (ms) exceeds the limit 2/omega_max about rest; other calculators are not checked."""
    if not isinstance(atoms.calc, MagneticRepulsion):
        return
    omega = frequency_bound(atoms, dt)
    if omega * dt > 2:
        raise ValueError(f'the time step of {dt:.9g} ms exceeds the stability limit 2/omega_max = {2 / omega:.9g} ms; '
                         'a tenth of the limit is accurate; allow_unstable=True runs anyway')


def highest_frequency(atoms: Atoms | LinearSystem) -> float:
    """Highest angular frequency of what the constraints leave free, in rad/ms, about rest; zero if nothing vibrates.

    Of a structure that is at rest nowhere, about the reference or where the atoms are, whichever is nearer to balance.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        With its MagneticRepulsion.

    Examples
    --------
    >>> from magphonon import read_scene, ready_scene
    >>> from magphonon.dynamics import highest_frequency
    >>> patch = read_scene(ready_scene('prototype')).patch_atoms()
    >>> round(float(2 / highest_frequency(patch)), 2)  # the largest stable time step in ms
    2.13
    """
    system = LinearSystem.nearest(atoms)
    return np.sqrt(max(_largest_eigenvalue(system.K, FINE), 0.0)) if _particle_bound(system) else 0.0


def frequency_bound(atoms: Atoms, dt: float) -> float:
    """Upper bound of the highest frequency, at no higher cost than a verdict on the time step `dt` (ms) needs; in rad/ms.

    Three bounds are tried, the cheapest first, until one is below 2/dt.  If none is, it is the highest frequency itself.

    Examples
    --------
    >>> from magphonon import read_scene, ready_scene
    >>> from magphonon.dynamics import frequency_bound, highest_frequency
    >>> patch = read_scene(ready_scene('prototype')).patch_atoms()
    >>> bool(frequency_bound(patch, 1e-3) >= highest_frequency(patch))
    True
    """
    system = LinearSystem.nearest(atoms)
    bounds = (lambda: _particle_bound(system),
              lambda: np.sqrt(abs(system.K).sum(axis=1).max()),
              lambda: np.sqrt((1 + ROUGH) * _largest_eigenvalue(system.K, ROUGH)))
    for bound in bounds:
        if (omega := bound()) * dt <= 2:
            return omega
    return highest_frequency(system)


def _particle_bound(system):
    """Gershgorin's bound by particle, without the Hessian: `w^2 <= k/m_i + sum_b |K_b| (1/m_i + 1/sqrt(m_i m_j))`."""
    calc, masses = system.calc, system.masses
    mobile = np.zeros(len(masses), bool)
    mobile[system.free.nonzero()[0] // calc.dim] = True
    bonds, K = calc.bonds, calc.rest_stiffness(calc.linear_model)
    k = np.broadcast_to(calc.foundation, (len(masses), calc.dim)).max(axis=1)
    norm = abs(np.linalg.eigvalsh(K)).max(axis=1)
    squares = k / masses
    for i, j in ((bonds.i, bonds.j), (bonds.j, bonds.i)):
        squares += np.bincount(i, norm * (1 / masses[i] + 1 / np.sqrt(masses[i] * masses[j])), len(masses))
    return np.sqrt(squares[mobile].max(initial=0.0))


def _largest_eigenvalue(D, tolerance):
    if D.shape[0] < DENSE:
        return np.linalg.eigvalsh(D.toarray()).max(initial=0.0)
    start = np.random.default_rng(0).normal(size=D.shape[0])  # a fixed start vector makes the result reproducible
    return sparse.linalg.eigsh(D, k=1, which='LA', v0=start, tol=tolerance, return_eigenvectors=False)[0]
