"""First-order effect of independent scatter of every magnet and every pillar, including the change of the rest positions.

With the displacements x and y, and e = C x in the bonds, the stiffness H changes with the strength s_i of one magnet by

    x.(dH/d ln s_i) y = sum_b e^x_b.K_b e^y_b - sum_b phi'_b n_b.(C w)_b      over the bonds b of the magnet, where
    Phi w = C^T t       t_b = e^x_b.(dK_b/dR) e^y_b                           with the static stiffness Phi of the structure

The second sum comes from the new rest positions: a stronger magnet pushes its neighbours away until the forces balance again.
One solution w serves all magnets.  The derivative with respect to ln k_i is k_i x_i.y_i for the stiffness k_i of a pillar, plus a
term with the force of the pillar if it is bent at rest. It is -omega^2 m_i x_i.y_i with respect to ln m_i, for the mass m_i, and
with respect to positions k_i w_i for the foot of a pillar and (C^T t - Phi w)_i for a held magnet.

If the rest positions were measured, as in a photo, they are known: w = 0, and the derivative is (C^T t)_i for a position.

Any number J, at any frequency, wavevector or time, depends on the lattice through masses and stiffness of bonds and springs
(`Slope`). With G_b = dJ/dK_b in place of e^x (x) e^y, one solution w gives the derivatives of J by all of these quantities.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from scipy import linalg, sparse

from ..lattices.bonds import Bonds
from ..response.normal_modes import Modes, modes
from ..stiffness.bond import Model, model_stiffness, stiffness_change
from ..stiffness.defects import Scatter
from ..stiffness.factors import inverse
from ..stiffness.rest import LinearSystem
from ..traits import LIKE, takes
from .sensitivities import exponent_change, force_change

REGULAR = 1e-12
"""Stiffness added to every direction, as a fraction of the largest stiffness, because free translations have none."""
ROUND_OFF = 1e-13  # of forces that cancel
FULL = 0.1  # share of nonzero entries above which a matrix is treated as a full one
CROSSING = 1e-9
"""Difference of two squared frequencies, as a fraction of the highest, below which their modes are arbitrary."""


@dataclass(frozen=True)
class Slope:
    """Derivatives of a number by the properties of the bonds and sites of a structure.

    Attributes
    ----------
    bonds : ndarray, shape (bonds, dim, dim)
        Derivatives by the stiffness of each bond.
    springs : ndarray, shape (particles, dim)
        Derivatives by the springs of each site.
    masses : ndarray, shape (particles,)
        Derivatives by the mass of each site.
    strengths : float or ndarray, shape (bonds,)
        Derivatives by the logarithm of the strength of each bond, apart from its effect on stiffness; for large motion only.
    vectors : float or ndarray, shape (bonds, dim)
        Derivatives by the vector of each bond at rest, apart from its effect on stiffness.
    lengths : float
        Derivative by the logarithm of all lengths, apart from stiffness, such as for a group velocity, a length per time.
    statics : float or ndarray, shape (bonds, dim, dim)
        Derivatives by the stiffness of each bond in the complete model, on which statics depend whatever the model of the waves.
    """

    bonds: Any = 0.0
    springs: Any = 0.0
    masses: Any = 0.0
    strengths: Any = 0.0
    vectors: Any = 0.0
    lengths: float = 0.0
    statics: Any = 0.0

    def __add__(self, other: Slope) -> Slope:
        return Slope(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def __rmul__(self, c: float) -> Slope:
        return Slope(*(c * getattr(self, f.name) for f in fields(self)))

    @property
    def real(self) -> Slope:
        """Slope of the real part of the number."""
        return Slope(*(np.real(getattr(self, f.name)) for f in fields(self)))


def form(bonds: Bonds, x: NDArray[Any], y: NDArray[Any], inertia: Any, q: NDArray[np.float64] | None = None) -> Slope:
    """Slope of `sum x.(K + inertia M) y` over waves with the displacements x and y, shape (particles, dim, waves).

    For a Bloch wave at q, x is the complex conjugate of a mode.
    """
    ex, ey = elongations(bonds, x, None if q is None else -q), elongations(bonds, y, q)
    xy = x * y
    return Slope(ex @ ey.swapaxes(1, 2), xy.sum(2), (inertia * xy.sum(1)).sum(1))


def elongations(bonds: Bonds, x: NDArray[Any], q: NDArray[np.float64] | None = None) -> NDArray[Any]:
    """Relative displacements `C(q) x` in the bonds, shape (bonds, dim, waves), from x of shape (particles, dim, waves)."""
    ends = x[bonds.j]
    return (ends if q is None else np.exp(2j * np.pi * (bonds.shift @ q))[:, None, None] * ends) - x[bonds.i]


@dataclass(frozen=True, eq=False)
class SiteSlopes:
    """Converts derivatives by bonds, springs and masses (`Slope`) into derivatives by each site and by the whole lattice."""

    system: LinearSystem
    at_rest: bool = False

    @cached_property
    def _hessian(self):
        return self.system.calc.rest_hessian('complete')  # of the complete model, as all statics

    @cached_property
    def _statics(self):
        P = self.system.free
        Phi = sparse.csr_array(P.T @ self._hessian @ P)
        Phi = full_or_sparse(Phi + REGULAR * abs(Phi).max() * sparse.eye_array(P.shape[1]))
        if sparse.issparse(Phi):
            return inverse(Phi)
        factors = linalg.lu_factor(Phi)
        return lambda b: linalg.lu_solve(factors, b)

    def _changes(self, models):
        """Derivatives of the stiffness of each bond by its vector, shape (bonds, dim, dim, dim), in some models."""
        calc, R = self.system.calc, self.system.calc.bond_vectors
        for model in models:
            turns = [stiffness_change(R, np.broadcast_to(axis, R.shape), calc.interaction, model) for axis in np.eye(calc.dim)]
            yield np.stack(turns, axis=-1)

    def of(self, slope: Slope, kept: float | None = None) -> dict[str, Any]:
        """Derivatives by the logarithms of the `mass`, `strength` and `spring` of each site, and by its `foot` in mm.

        Further derivatives are by the logarithms of the `spacing` and of the `height` of all pillars. If `kept`, a length in mm,
        is given, there is also one by the `exponent` of an InversePower whose force at that length stays constant.  Derivatives
        by springs and feet have the shape (particles, dim).
        """
        calc, P = self.system.calc, self.system.free
        C, R, k = calc.bonds.incidence, calc.bond_vectors, np.broadcast_to(calc.foundation, (len(self.system), calc.dim))
        slopes: list[tuple[Any, Model]] = [(slope.bonds, calc.model), (slope.statics, 'complete')]
        kinds = [one for one in slopes if np.ndim(one[0])]
        pull, complete = calc.interaction.forces(R)[1], calc.rest_stiffness('complete')
        push, each = np.broadcast_to(slope.vectors, R.shape), np.broadcast_to(slope.strengths, len(R))
        for (G, model), turns in zip(kinds, self._changes(model for _, model in kinds), strict=True):
            push = push + np.einsum('bxy,bxyz->bz', G, turns)
            each = each + (G * calc.rest_stiffness(model)).sum((1, 2))
        on = C.T @ push
        w, foot, along = np.zeros_like(on), on, P.T @ on.ravel()
        if not self.at_rest and abs(along).max() > ROUND_OFF * abs(push).max():  # else nothing moves, by symmetry
            w = (P @ self._statics(along)).reshape(on.shape)
            left = on.ravel() - self._hessian @ w.ravel()
            foot = k * w + (left - P @ (P.T @ left)).reshape(on.shape)
        e = C @ w
        springs = k * slope.springs + calc.spring_forces * w
        stretched = (push * R).sum() - np.einsum('bx,bxy,by->', e, complete, R) + (calc.spring_forces * w).sum() + slope.lengths
        each = each - (pull * e).sum(1)  # of a bond between a particle and its own image, whose row of C is zero, both ends count
        strengths = np.zeros(len(on), each.dtype)  # of a response it is complex
        for end in (calc.bonds.i, calc.bonds.j):
            np.add.at(strengths, end, each)
        found = {'mass': self.system.masses * slope.masses, 'strength': strengths, 'spring': springs, 'foot': foot,
                 'spacing': stretched, 'height': -3 * springs.sum()}
        return found if kept is None else found | {'exponent': self._by_exponent(kinds, slope, e, kept)}

    def _by_exponent(self, kinds, slope, e, kept):
        if np.ndim(slope.strengths):
            raise ValueError('for large motion the derivative with respect to the exponent is not available; omit the exponent '
                             'or the amplitude')
        calc, R = self.system.calc, self.system.calc.bond_vectors
        strength = calc.strengths[calc.bonds.i] * calc.strengths[calc.bonds.j]
        change: Any = force_change(exponent_change(calc.laws, kept), strength)
        r = np.linalg.norm(R, axis=1)
        direct = [(G * model_stiffness(R, change, model)).sum() for G, model in kinds if np.ndim(G)]
        return sum(direct) - ((change.dphi(r) / r)[:, None] * R * e).sum()

    def __call__(self, x: NDArray[Any], y: NDArray[Any], inertia: Any) -> NDArray[np.complex128]:
        """Derivatives of `x.(H + inertia M) y` by logarithms of mass, strength and spring, and by the position, of each site.

        Their shape is (6, particles).  The displacements x and y respect the constraints; the inertia is
        `-omega^2 + i omega gamma`, in rad^2/ms^2.
        """
        found, places = self.of(form(self.system.calc.bonds, x[..., None], y[..., None], inertia)), np.zeros((3, len(x)), complex)
        places[: x.shape[1]] = found['foot'].T
        return np.array([found['mass'], found['strength'], found['spring'].sum(axis=1), *places])


def full_or_sparse(A: sparse.csr_array) -> Any:
    """The matrix, converted to a dense one if it has few zeros, because LAPACK is then faster than sparse factors."""
    return A.toarray() if A.nnz > FULL * A.shape[0] ** 2 else A


class ModeScatter(NamedTuple):
    """Natural frequencies of a structure and their standard deviations, in rad/ms.

    Attributes
    ----------
    omega, std : ndarray, shape (modes,)
        Frequencies, and their standard deviations to first order.  Modes of equal frequency, which the scatter splits, all get
        the root mean square of their group.  NaN for a frequency of zero.
    """

    omega: NDArray[np.float64]
    std: NDArray[np.float64]


@takes(*{*LIKE} - {'radii'})
def mode_scatter(atoms: Atoms | LinearSystem, scatter: Scatter, count: int | Modes | None = None,
                 at_rest: bool = False) -> ModeScatter:
    """Natural frequencies of a structure, and their standard deviations from one specimen to the next, to first order.

    For a periodic cell the modes are the waves whose displacements are equal in all cells. Band edges of a supercell of N
    particles scatter as 1/sqrt(N).

    Parameters
    ----------
    atoms : ase.Atoms
        At rest, with PairCalculator.
    scatter : magphonon.stiffness.Scatter
        Standard deviations of each site: of the logarithms of mass, strength and spring, and of the position of the foot of its
        pillar, or of the particle itself if it is held.
    count : int or Modes, optional
        Number of lowest modes to use, or a `Modes` object; by default all modes.
    at_rest : bool
        Whether the positions were measured at rest, as in a photo, so that they do not follow strengths and springs, and
        `scatter.position` is the standard deviation of these measurements.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import mode_scatter
    >>> from magphonon.stiffness import Scatter
    >>> cells = lattices.triangular(1.0, 1.0).repeat((3, 3, 1))
    >>> cells.calc = MagneticRepulsion(cells, InversePower(1.0, 4.0), foundation=1.0)
    >>> omega, std = mode_scatter(cells, Scatter(stiffness=0.06), count=1)  # of each of nine pillars
    >>> round(float(std[0] / omega[0]), 6)  # 0.06/2/sqrt(9)
    0.01
    """
    system = LinearSystem.of(atoms)
    found = count if isinstance(count, Modes) else modes(system, count)
    squares, slopes = found.omega * abs(found.omega), SiteSlopes(system, at_rest)
    std = np.array([scatter.mass, scatter.strength, scatter.stiffness, *3 * [scatter.position]])
    variance = np.empty(len(squares))
    ends = np.flatnonzero(np.diff(squares) > CROSSING * abs(squares).max()) + 1
    for alike in np.split(np.arange(len(squares)), ends):
        shapes = found.shapes[alike]
        W = [slopes(x, y, -squares[alike].mean()).real for x in shapes for y in shapes]
        variance[alike] = sum(std**2 @ (each**2).sum(axis=1) for each in W) / len(alike)
    with np.errstate(divide='ignore', invalid='ignore'):
        uncertain = np.sqrt(variance) / (2 * abs(found.omega))
    return ModeScatter(found.omega, np.where(abs(squares) <= CROSSING * abs(squares).max(), np.nan, uncertain))
