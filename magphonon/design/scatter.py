"""Effect of independent scatter of every magnet and every pillar, to first order, with the magnets relaxed again.

With the displacements x and y, and e = C x in the bonds, the stiffness H changes with the strength s_i of one magnet by

    x.(dH/d ln s_i) y = sum_b e^x_b.K_b e^y_b - sum_b phi'_b n_b.(C w)_b      over the bonds b of the magnet, where
    Phi w = C^T t       t_b = e^x_b.(dK_b/dR) e^y_b                           in the statics of the structure, Phi

The second sum comes from the new rest positions: a stronger magnet pushes its neighbours away until the forces balance again.
One solution w serves all magnets.  The derivative by the logarithm of the stiffness k_i of a pillar is k_i x_i.y_i, plus a term
of the force of the pillar if it is bent at rest; that by the logarithm of a mass is -omega^2 m_i x_i.y_i.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import sparse

from ..errors import not_negative
from ..response.frf import resolvents
from ..response.normal_modes import modes
from ..stiffness.bond import stiffness_change
from ..stiffness.matrices import hessian
from ..stiffness.rest import LinearSystem

if TYPE_CHECKING:
    from typing import Any

    from ase import Atoms
    from numpy.typing import ArrayLike, NDArray

    from ..response.frf import Place

SITES = ('mass', 'strength', 'stiffness')  # the quantities that scatter from site to site
REGULAR = 1e-12
"""Stiffness added to every direction, as a fraction of the largest stiffness, because free translations have none."""
CROSSING = 1e-9
"""Difference of two squared frequencies, as a fraction of the highest, below which their modes are arbitrary."""


@dataclass(frozen=True)
class SiteScatter:
    """Relative standard deviations of the quantities of each site; all of them scatter independently.

    Attributes
    ----------
    mass : float
        Standard deviation of the mass of each particle.
    strength : float
        Standard deviation of the strength of each magnet; the force between two magnets is proportional to the product of theirs.
    stiffness : float
        Standard deviation of the stiffness of the foundation under each particle.
    """

    mass: float = 0.0
    strength: float = 0.0
    stiffness: float = 0.0

    def __post_init__(self) -> None:
        for name, value in zip(SITES, self.std, strict=True):
            not_negative(f'scatter of the {name}', value)

    @property
    def std(self) -> NDArray[np.float64]:
        """The three together, shape (3,)."""
        return np.array([self.mass, self.strength, self.stiffness])


NO_SCATTER = SiteScatter()


@dataclass(frozen=True, eq=False)
class SiteSlopes:
    """Derivatives of bilinear forms of the stiffness with respect to the mass, strength and foundation of each site."""

    system: LinearSystem

    @cached_property
    def _bonds(self):
        """Stiffness K, its derivative with respect to the bond vector, and the gradient phi' n of each bond."""
        calc, dim = self.system.calc, self.system.dim
        R = calc.bond_vectors
        turns = [stiffness_change(R, np.broadcast_to(axis, R.shape), calc.interaction, calc.model) for axis in np.eye(dim)]
        return calc.rest_stiffness(calc.model), np.stack(turns, axis=-1), calc.interaction.forces(R)[1]

    @cached_property
    def _statics(self):
        calc, P = self.system.calc, self.system.free
        Phi = P.T @ hessian(calc.bonds, calc.rest_stiffness(), calc.foundation) @ P
        return sparse.linalg.splu(sparse.csc_array(Phi + REGULAR * abs(Phi).max() * sparse.eye_array(P.shape[1])))

    def __call__(self, x: NDArray[Any], y: NDArray[Any], inertia: Any) -> NDArray[np.complex128]:
        """Derivatives of `x.(H + inertia M) y` by the logarithms of masses, strengths and springs, shape (3, particles).

        The displacements x and y respect the constraints; the inertia is `-omega^2 + i omega gamma`, in rad^2/ms^2.
        """
        calc, P = self.system.calc, self.system.free
        C = calc.bonds.incidence
        K, turns, pull = self._bonds
        ex, ey = C @ x, C @ y
        push = P.T @ (C.T @ np.einsum('bx,bxyz,by->bz', ex, turns, ey)).ravel()
        w = self._statics.solve(push.real) + 1j * self._statics.solve(push.imag)
        w = (P @ w).reshape(x.shape)
        each = np.einsum('bx,bxy,by->b', ex, K, ey) - np.einsum('bx,bx->b', pull, C @ w)
        strength = abs(C).T @ each
        spring = (calc.foundation * x * y + calc.spring_forces * w).sum(axis=1)
        return np.array([inertia * self.system.masses * (x * y).sum(axis=1), strength, spring])


class ModeScatter(NamedTuple):
    """How natural frequencies scatter, all in rad/ms.

    Attributes
    ----------
    omega, std : ndarray, shape (modes,)
        Frequencies, and their standard deviations to first order.  Modes of equal frequency, which the scatter splits, all get
        the root mean square of their group.  NaN for a frequency of zero.
    """

    omega: NDArray[np.float64]
    std: NDArray[np.float64]


def mode_scatter(atoms: Atoms | LinearSystem, scatter: SiteScatter, count: int | None = None) -> ModeScatter:
    """Natural frequencies of a structure, and their standard deviation from one sample to the next.

    For a periodic cell these are the waves whose displacements are equal in all cells; band edges of a supercell of N particles
    scatter as 1/sqrt(N).

    Parameters
    ----------
    atoms : ase.Atoms
        At rest, with MagneticRepulsion.
    scatter : SiteScatter
    count : int, optional
        Number of modes, the lowest ones; all if not given.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import SiteScatter, mode_scatter
    >>> cells = lattices.triangular(1.0, 1.0).repeat((3, 3, 1))
    >>> cells.calc = MagneticRepulsion(cells, InversePower(1.0, 4.0), foundation=1.0)
    >>> omega, std = mode_scatter(cells, SiteScatter(stiffness=0.06), count=1)  # of each of nine pillars
    >>> round(float(std[0] / omega[0]), 6)  # 0.06/2/sqrt(9)
    0.01
    """
    system = LinearSystem.of(atoms)
    found = modes(system, count)
    squares, slopes = found.omega * abs(found.omega), SiteSlopes(system)
    variance = np.empty(len(squares))
    ends = np.flatnonzero(np.diff(squares) > CROSSING * abs(squares).max()) + 1
    for alike in np.split(np.arange(len(squares)), ends):
        shapes = found.shapes[alike]
        W = [slopes(x, y, -squares[alike].mean()).real for x in shapes for y in shapes]
        variance[alike] = np.einsum('p,wpi->', scatter.std**2, np.square(W)) / len(alike)
    with np.errstate(divide='ignore', invalid='ignore'):
        std = np.sqrt(variance) / (2 * abs(found.omega))
    return ModeScatter(found.omega, np.where(abs(squares) <= CROSSING * abs(squares).max(), np.nan, std))


def response_scatter(atoms: Atoms | LinearSystem, force: ArrayLike, answer: Place, omega: NDArray[np.float64],
                     damping: ArrayLike) -> NDArray[np.complex128]:
    """Derivatives of a frequency response by the logarithms of masses, strengths and springs of all sites.

    Parameters
    ----------
    atoms, force, omega, damping
        As for `magphonon.response.frf.harmonic_response`.
    answer : Place
        Where the response is seen.

    Returns
    -------
    ndarray of complex, shape (3, particles, frequencies)
        In mm.
    """
    system = LinearSystem.of(atoms)
    n, slopes, rate = len(system), SiteSlopes(system), np.asarray(damping)
    both = np.stack([answer.force(n).ravel(), np.asarray(force, dtype=complex).ravel()], axis=1)
    found = np.empty((len(SITES), n, len(omega)), dtype=complex)
    for k, G in enumerate(resolvents(system, omega, damping)):
        x, y = G(both).T.reshape(2, n, 3)[..., : system.dim]
        found[..., k] = -slopes(x, y, -(omega[k] ** 2) + 1j * omega[k] * rate)
    return found
