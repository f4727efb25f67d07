"""First derivatives of frequencies and responses with respect to the parameters of a lattice, all analytic.

The derivative of a pair law with respect to a parameter is itself a pair law, and bond stiffness is linear in the law. So
`bond_stiffness(vectors, change)` gives the derivatives of both D0 and D*.  For the relative change dp/p of

    the force           d phi' = phi'                      d phi'' = phi''
    the spacing         d phi' = r phi'' - phi'            d phi'' = r phi'''         (r grows, n stays)
    a of f = b r^-a     d phi' = -a ln(r/1 m) phi'         d phi'' = (1 - a ln(r/1 m)) phi''
    l of Yukawa's law   d phi' = (phi + r phi')/l          d phi'' = (2 phi' + r phi'')/l

Then, with the Bloch matrix D and a mode v of frequency w, `2 w dw = v^+ (dD - w^2 dM) v`, and with the resolvent
G = (H - w^2 M + i w gamma M)^-1, `dG = -G (dH - w^2 dM + i w gamma dM) G`.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from ..bands.bloch import bloch_modes
from ..interactions.law_cards import LawDerivative, exponent_change as exponent_change, screening_change as screening_change
from ..interactions.pair_laws import PairLaw, higher_derivatives
from ..stiffness.factors import inverse
from ..stiffness.matrices import Model, bloch_matrix, hessian, mass_weighted, model_stiffness, stiffness_change
from ..stiffness.rest import BALANCED, LinearSystem
from ..traits import LIKE, takes

CROSSING = 1e-9
"""Difference of two branches, as a fraction of the highest frequency, below which they cross."""
ZERO_FRACTION = 1e-6
"""Fraction of the highest frequency below which a frequency is the square root of a rounded eigenvalue."""


@dataclass(frozen=True)
class StiffnessDerivative:
    """Changes of a lattice that are proportional to the relative change dp/p of one parameter p.

    Attributes
    ----------
    law : LawDerivative, optional
        Derivative of the pair law with respect to ln p.
    foundation : float or ndarray, shape (particles, dim)
        Derivative of the foundation stiffness with respect to ln p, N/mm.
    mass : float
        Derivative of the logarithm of every mass with respect to ln p.

    Examples
    --------
    >>> from magphonon.design import StiffnessDerivative
    >>> heavier = StiffnessDerivative(mass=1.0)  # by d ln m
    >>> heavier.mass
    1.0
    """

    law: LawDerivative | None = None
    foundation: float | NDArray[np.float64] = 0.0
    mass: float = 0.0


def force_change(law: PairLaw | LawDerivative, power: ArrayLike = 1) -> LawDerivative:
    """Derivative of a law, or of the laws of all bonds, with respect to ln p, if the force is proportional to p^power.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.design import StiffnessDerivative, force_change, frequency_sensitivities
    >>> cell = read_scene(ready_scene('ideal')).atoms()
    >>> omega, slopes = frequency_sensitivities(cell, [[0.5, 0, 0]], [StiffnessDerivative(law=force_change(cell.calc.laws))])
    >>> (slopes[0] / omega).round(6)  # omega goes as the root of the force
    array([[0.5, 0.5]])
    """
    return LawDerivative(lambda r: power * law.dphi(r), lambda r: power * law.d2phi(r))


def steeper(law: PairLaw | LawDerivative, exponent: float, length: float) -> PairLaw | LawDerivative:
    """A law whose exponent -d ln f/d ln r is larger, with the same force at a distance `length`."""
    if not exponent:
        return law

    def less(r):
        return (r / length) ** -exponent

    return LawDerivative(lambda r: less(r) * law.dphi(r), lambda r: less(r) * (law.d2phi(r) - exponent / r * law.dphi(r)))


def spacing_change(law: PairLaw) -> LawDerivative:
    """Derivative of the law of the bonds with respect to the logarithm of the spacing: all distances grow in proportion.

    Examples
    --------
    >>> from magphonon import InversePower, read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.design import StiffnessDerivative, frequency_sensitivities, spacing_change
    >>> cell = read_scene(ready_scene('ideal')).atoms()
    >>> omega, slopes = frequency_sensitivities(cell, [[0.5, 0, 0]], [StiffnessDerivative(law=spacing_change(cell.calc.laws))])
    >>> (slopes[0] / omega).round(6)  # -(a + 1)/2 with a = 4
    array([[-2.5, -2.5]])
    """
    return LawDerivative(lambda r: r * law.d2phi(r) - law.dphi(r), lambda r: r * higher_derivatives(law, r)[0])


@takes(*{*LIKE} - {'radii'})
def frequency_sensitivities(atoms: Atoms, q: ArrayLike, changes: Collection[StiffnessDerivative],
                            model: Model | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Derivatives of the frequencies with respect to the logarithms of parameters.

    Where branches cross, degenerate perturbation theory is used: among modes of equal frequency it takes those for which the
    changes are diagonal, which are the modes of the crossing branches. Such modes exist because a parameter that all particles
    share keeps the symmetry of the lattice. Branches that are degenerate by symmetry, as at Gamma and K, stay degenerate.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator.
    q : array_like, shape (wavevectors, 3)
        In fractions of the reciprocal vectors.
    changes : sequence of StiffnessDerivative
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.

    Returns
    -------
    omega : ndarray, shape (wavevectors, modes)
        In rad/ms; negative for unstable modes.
    slopes : ndarray, shape (changes, wavevectors, modes)
        `d omega/d ln p` in rad/ms.  Zero for translations without a foundation; NaN for another mode of zero
        frequency, on the verge of instability, where the derivative is infinite.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.design import StiffnessDerivative, frequency_sensitivities
    >>> cell = read_scene(ready_scene('ideal')).atoms()
    >>> omega, slopes = frequency_sensitivities(cell, [[0.5, 0, 0]], [StiffnessDerivative(mass=1.0)])
    >>> (slopes[0] / omega).round(9)  # d ln omega/d ln m
    array([[-0.5, -0.5]])
    """
    omega, vectors = bloch_modes(atoms, q, model, vectors=True)
    q = np.reshape(q, (-1, 3))
    v = vectors.reshape(*omega.shape, -1)
    squares = np.sign(omega) * omega**2
    highest = abs(omega).max()
    system = LinearSystem.of(atoms)
    calc, masses = system.calc, system.masses
    for change, moves in zip(changes, _pushes(system, changes)[1], strict=True):
        if moves:
            raise ValueError(f'{change} moves the particles of the cell, and derivatives at fixed positions would be wrong; take '
                             'differences of relaxed cells')
    W = np.empty((len(changes), *omega.shape, omega.shape[1]), dtype=complex)
    for p, change in enumerate(changes):
        dD = bloch_matrix(calc.bonds, _stiffness_change(calc, change, model), q, change.foundation)
        W[p] = v.conj() @ mass_weighted(dD, masses) @ v.swapaxes(1, 2)
        W[p] -= change.mass * squares[..., None] * np.eye(omega.shape[1])
    dsquares = np.einsum('pqmm->pqm', W).real.copy()
    for k in np.flatnonzero((np.diff(omega) <= CROSSING * highest).any(axis=1)):
        for branches in np.split(np.arange(omega.shape[1]), np.flatnonzero(np.diff(omega[k]) > CROSSING * highest) + 1):
            block = W[:, k, branches[0] : branches[-1] + 1, branches[0] : branches[-1] + 1]
            generic = np.tensordot(np.cos(1 + np.arange(len(changes))), block, axes=1)  # weights in no special ratio
            modes = np.linalg.eigh(generic)[1]
            dsquares[:, k, branches] = np.einsum('ma,pmn,na->pa', modes.conj(), block, modes).real
    still = abs(omega) <= ZERO_FRACTION * highest
    with np.errstate(divide='ignore', invalid='ignore'):
        slopes = dsquares / (2 * abs(omega))
    slopes[:, still] = np.where(abs(dsquares[:, still]) <= ZERO_FRACTION**2 * highest**2, 0.0, np.nan)
    return omega, slopes


@takes(*{*LIKE} - {'radii'})
def hessian_changes(system: LinearSystem, changes: Collection[StiffnessDerivative], *,
                    measured: bool = False) -> list[sparse.csr_array]:
    """Derivatives `dH/d ln p` of the Hessian by parameters in N/mm, including the change of the rest positions.

    A parameter that exerts the forces g moves the rest positions by `H^-1 g`, with H of the complete model as in all statics,
    and this changes the stiffness of each bond.  A dead load is constant.  Positions that were `measured` stay: the load that
    balances them stands for what nobody knows, and follows.
    """
    calc, P, found = system.calc, system.free, []
    C, R = calc.bonds.incidence, calc.bond_vectors
    pushes, moved = _pushes(system, changes)
    for change, push, moves in zip(changes, pushes, moved, strict=True):
        dK = _stiffness_change(calc, change, calc.model)
        if moves and not measured:
            motion = (P @ inverse(P.T @ calc.rest_hessian('complete') @ P)(P.T @ push.ravel())).reshape(push.shape)
            dK = dK + stiffness_change(R, C @ motion, calc.interaction, calc.model)
        found.append(hessian(calc.bonds, dK, change.foundation))
    return found


def _pushes(system, changes):
    """Force on each particle due to each change, shape (changes, particles, dim), and whether it moves the rest positions."""
    calc, P = system.calc, system.free
    C, R = calc.bonds.incidence, calc.bond_vectors
    r = np.linalg.norm(R, axis=1)
    springs = -calc.slack[:, : calc.dim]
    pushes, moved = [], []
    for change in changes:
        pull = np.zeros(len(r)) if change.law is None else -change.law.dphi(r)
        push = C.T @ ((pull / r)[:, None] * R) + change.foundation * springs
        largest = max(abs(pull).max(), abs(change.foundation * springs).max(), abs(calc.law.dphi(r)).max())
        pushes.append(push)
        moved.append(bool(abs(P.T @ push.ravel()).max(initial=0.0) > BALANCED * largest))
    return pushes, moved


def _stiffness_change(calc, change, model):
    if change.law is None:
        return np.zeros((len(calc.bonds), calc.dim, calc.dim))
    return model_stiffness(calc.bond_vectors, change.law, model or calc.model)
