"""Grueneisen parameters: how the frequencies of the bands change with the spacing.

As a lattice grows in all its d periodic directions, the bond vectors change by dR = R + C u per relative change d ln L of the
spacing.  The particles of a basis follow by the displacement u that balances the forces again, `Phi u = -C^T K R` with the
stiffness K of the bonds and the Hessian Phi of the cell.  With the change dK of the stiffness (`stiffness_change`) and the Bloch
matrix D, whose foundation does not change, `gamma = -d ln w/d ln V = -v^+ dD v/(2 d w^2)`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from ..stiffness.bond import Model, stiffness_change
from ..stiffness.calculator import PairCalculator
from ..stiffness.matrices import bloch_matrix, mass_weighted
from ..stiffness.rest import LinearSystem
from ..traits import LIKE, takes
from .bloch import bloch_modes, wavevectors

FLOPPY = 1e-12  # fraction of the largest stiffness below which a motion counts as one without stiffness, as a translation is
CROSSING = 1e-9  # difference of two branches, as a fraction of the highest frequency, below which they count as crossing
STILL = 1e-6  # fraction of the highest frequency below which a frequency counts as zero: it is the square root of a round-off


class Gruneisen(NamedTuple):
    """Frequencies, and Grueneisen parameters `-d ln w/d ln V` of the bands.

    Attributes
    ----------
    omega : ndarray, shape (wavevectors, modes)
        In rad/ms; negative for unstable modes.
    gamma : ndarray, shape (wavevectors, modes)
        Where branches cross, the parameters of the crossing branches in no particular order.  NaN where the frequency is zero.
    """

    omega: np.ndarray
    gamma: np.ndarray


@takes(*LIKE)
def gruneisen_parameters(atoms: Atoms, q: ArrayLike, model: Model | None = None) -> Gruneisen:
    """Grueneisen parameters `-d ln w/d ln V` of the bands; V is the length, area or volume of a cell.

    The foundation keeps its stiffness; its anchors and the held particles follow the spacing.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator.
    q, model
        As for `bloch_modes`.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.bands import gruneisen_parameters
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> found = gruneisen_parameters(cell, [[0.5, 0, 0]])
    >>> found.gamma.round(6).tolist()  # (a + 1)/4 for all modes, as omega^2 goes as r^-(a + 1) and an area as r^2
    [[1.25, 1.25]]
    """
    system = LinearSystem.of(atoms).moving()
    calc = system.calc
    if calc.load.any() or calc.spring_forces.any():
        raise ValueError('a dead load or stretched springs of the foundation hold the particles, and how these forces change '
                         'with the spacing is not known; relax the structure at two spacings and compare the frequencies')
    dK = stiffness_change(calc.bond_vectors, growth(calc, system.free.toarray()), calc.interaction, model or calc.model)
    omega, vectors = bloch_modes(system, q, model, vectors=True)
    v = np.asarray(vectors).reshape(*omega.shape, -1)
    dD = mass_weighted(bloch_matrix(calc.bonds, dK, wavevectors(q)), system.masses)
    W = v.conj() @ dD @ v.swapaxes(1, 2)
    slopes = np.einsum('qmm->qm', W).real.copy()
    highest = abs(omega).max()
    for k in np.flatnonzero((np.diff(omega) <= CROSSING * highest).any(axis=1)):
        for cross in np.split(np.arange(omega.shape[1]), np.flatnonzero(np.diff(omega[k]) > CROSSING * highest) + 1):
            slopes[k, cross] = np.linalg.eigvalsh(W[k][np.ix_(cross, cross)])
    with np.errstate(divide='ignore', invalid='ignore'):
        gamma = -slopes / (2 * atoms.pbc.sum() * omega * abs(omega))
    gamma[abs(omega) <= STILL * highest] = np.nan
    return Gruneisen(omega, gamma)


def growth(calc: PairCalculator, free: NDArray[np.float64]) -> NDArray[np.float64]:
    """Derivative `R + C u` of the bond vectors with respect to the logarithm of the spacing, in mm, shape (bonds, dim).

    The calculator is at rest; `free`, shape (particles * dim, free), are the orthonormal directions that constraints leave free.
    The rest positions follow from the static forces, so the complete model is used here whatever the model of the bands.
    """
    R, C = calc.bond_vectors, calc.bonds.incidence
    push = -(C.T @ np.einsum('bxy,by->bx', calc.rest_stiffness('complete'), R)).ravel()
    Phi = free.T @ calc.rest_hessian('complete') @ free
    u = free @ (np.linalg.pinv(Phi, FLOPPY, hermitian=True) @ (free.T @ push))
    return R + C @ u.reshape(-1, calc.dim)
