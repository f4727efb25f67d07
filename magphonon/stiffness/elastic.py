"""Stress and elastic moduli of a lattice under static forces.

With the bond vectors R, g = phi'/r and the Lagrangian strain eta, `r^2 -> R.(1 + 2 eta).R`, the energy E of a cell of the
measure V (length, area or volume) gives

    Cauchy stress     sigma_ij  = 1/V dE/d eta_ij           = 1/V sum g R_i R_j
    moduli, clamped   C_ijkl    = 1/V d2E/d eta_ij d eta_kl = 1/V sum (phi'' - g)/r^2 R_i R_j R_k R_l

The particles of a basis follow the strain by -Phi^-1 Lambda, with Lambda = d2E/du d eta and the Hessian Phi of the cell. This
softens the lattice: C -> C - Lambda^T Phi^-1 Lambda/V.  Under static stress three tensors must be distinguished:

    C        the curvature of the energy in the Lagrangian strain
    B        the change of the stress with a small strain, d sigma_ij = B_ijkl d epsilon_kl (Birch, Wallace):
             B = C + (sigma_ik d_jl + sigma_il d_jk + sigma_jk d_il + sigma_jl d_ik - 2 sigma_ij d_kl)/2
    A(n)     the matrix for sound along n, rho c^2 u = A u:  A_ik = C_ijkl n_j n_l + (n.sigma.n) d_ik

Under hydrostatic pressure A_ik is also B_ijkl n_j n_l.  Under another stress B lacks the symmetry B_ijkl = B_klij, and under any
stress the tensor of sound, C_ijkl + sigma_jl d_ik, lacks the minor one, of i and j: a rotation costs energy under stress.
D. C. Wallace, Thermodynamics of Crystals (1972), chapter 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .. import units
from ..errors import finite, one_of
from ..results import Saved
from ..traits import takes
from .calculator import PairCalculator, measure
from .factors import inverse
from .matrices import MODELS, Model, hessian, signed_root
from .repulsion import masses_of
from .rest import LinearSystem

FLOPPY = 1e-12
"""Stiffness added to every direction, as a fraction of the largest one, because translations and floppy motions have none; strain
does not push them, and refinement takes it out of all others."""
REFINEMENTS = 3  # each divides the error of a motion by its stiffness over FLOPPY of the largest
ISOTROPIC = 1e-6  # difference between directions, as a fraction of the largest modulus, that counts as zero
UNIT = 'N in a chain, N/mm in the plane, N/mm^2 in space'


@dataclass(frozen=True)
class Moduli(Saved, kind='elastic moduli', units={
    'along': ('', 'dim', 'dim'), 'density': ('g/mm, g/mm^2 or g/mm^3',), 'stress': (UNIT, 'dim', 'dim'),
    'clamped': (UNIT, 'dim', 'dim', 'dim', 'dim'), 'constants': (UNIT, 'dim', 'dim', 'dim', 'dim'),
}):
    """Stress and elastic moduli of a lattice, in N in a chain, N/mm in the plane, N/mm^2 in space.

    Attributes
    ----------
    along : ndarray, shape (dim, dim)
        Projector on the periodic directions, in which the lattice can be strained.
    density : float
        Mass per length, area or volume in g/mm, g/mm^2 or g/mm^3.
    stress : ndarray, shape (dim, dim)
        Cauchy stress; negative if the particles repel each other.
    clamped : ndarray, shape (dim, dim, dim, dim)
        C if the particles of a basis keep their fractional coordinates.
    constants : ndarray, shape (dim, dim, dim, dim)
        C if the particles of a basis move to where the forces balance again.
    """

    along: np.ndarray
    density: float
    stress: np.ndarray
    clamped: np.ndarray
    constants: np.ndarray

    @property
    def periodic(self) -> int:
        """Number of periodic directions: 1, 2 or 3."""
        return round(np.trace(self.along))

    @property
    def pressure(self) -> float:
        """Mean pressure `-tr sigma/d`."""
        return float(-np.trace(self.stress) / self.periodic)

    @property
    def birch(self) -> NDArray[np.float64]:
        """Change B of the stress under a small strain, shape (dim, dim, dim, dim).  It lacks the symmetry B_ijkl = B_klij if
        the stress is not a hydrostatic pressure.
        """
        turned = sum(np.einsum(f'{pair},{rest}->ijkl', self.stress, self.along)
                     for pair, rest in (('ik', 'jl'), ('il', 'jk'), ('jk', 'il'), ('jl', 'ik')))
        return self.constants + turned / 2 - np.einsum('ij,kl->ijkl', self.stress, self.along)

    @property
    def bulk(self) -> float:
        """Bulk modulus `-V dp/dV = B_iikk/d^2`; in the plane V is the area."""
        return float(np.einsum('iikk', self.birch) / self.periodic**2)

    @property
    def shear(self) -> float:
        """Shear modulus; for a lattice that is not isotropic the mean over all directions (Voigt's mean), for a chain NaN."""
        d, B = self.periodic, self.birch
        if d == 1:
            return np.nan
        return float((np.einsum('ikik', B) - np.einsum('iikk', B) / d) / (d**2 + d - 2))

    @property
    def isotropic(self) -> bool:
        """Whether B is that of an isotropic body, `(K - 2 G/d) d_ij d_kl + G (d_ik d_jl + d_il d_jk)`; True for a chain."""
        d, G, B, P = self.periodic, self.shear, self.birch, self.along
        if d == 1:
            return True
        turned = sum(np.einsum(f'{pair},{rest}->ijkl', P, P) for pair, rest in (('ik', 'jl'), ('il', 'jk')))
        alike = (self.bulk - 2 * G / d) * np.einsum('ij,kl->ijkl', P, P) + G * turned
        return bool(abs(B - alike).max() <= ISOTROPIC * abs(B).max())

    @property
    def poisson(self) -> float:
        """Poisson's ratio of a small strain on top of the static one; NaN for a chain, for a lattice that is not isotropic and
        for one that shear makes unstable.  In the plane it is at most 1, where the shear modulus vanishes.
        """
        d, K, G = self.periodic, self.bulk, self.shear
        return float((d * K - 2 * G) / (d * (d - 1) * K + 2 * G)) if d > 1 and self.isotropic and G > 0 else np.nan

    def speeds(self, direction: ArrayLike) -> NDArray[np.float64]:
        """Speeds of sound along a direction in mm/ms = m/s, shape (dim,), ascending; negative for an unstable branch.

        Parameters
        ----------
        direction : array_like, shape (dim,)
            Direction of propagation, along which the lattice is periodic.
        """
        dim = len(self.stress)
        n = finite('direction', direction, (dim,))
        if not n.any():
            raise ValueError(f'the direction must not be zero, not {n}')
        n = n / np.linalg.norm(n)
        A = np.einsum('ijkl,j,l->ik', self.constants, n, n) + n @ self.stress @ n * np.eye(dim)
        return np.sort(signed_root(np.linalg.eigvalsh(A) / self.density))

    def __str__(self) -> str:
        unit, name = {1: (units.N, 'N'), 2: (units.N / units.m, 'N/m'), 3: (units.Pa, 'Pa')}[self.periodic]
        words = [f'pressure {self.pressure / unit:.6g} {name}', f'bulk modulus {self.bulk / unit:.6g} {name}']
        if self.periodic > 1:
            mean = '' if self.isotropic else ' (mean over all directions)'
            words.append(f'shear modulus {self.shear / unit:.6g} {name}{mean}')
        if not np.isnan(self.poisson):
            words.append(f"Poisson's ratio {self.poisson:.4g}")
        lost = abs(self.birch - self.birch.transpose(2, 3, 0, 1)).max()
        if lost > ISOTROPIC * abs(self.birch).max():
            words.append(f'B_ijkl differs from B_klij by up to {lost / unit:.3g} {name}, because the stress is no hydrostatic '
                         'pressure')
        return ', '.join(words)


@takes('radii')
def elastic_moduli(atoms: Atoms, model: Model = 'complete') -> Moduli:
    """Stress and elastic moduli of a lattice at rest, without its foundation.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator.
    model : {'complete', 'conventional'}
        D0 + D*, or D0 alone: bonds as springs at their natural length, which have no stress.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.stiffness import elastic_moduli
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> moduli = elastic_moduli(cell)
    >>> moduli.stress.shape
    (2, 2)
    """
    if not atoms.pbc.any():
        raise ValueError('the structure is not periodic and has no stress or moduli; use the unit cell from which it was made')
    atoms = LinearSystem.of(atoms).atoms
    calc: Any = atoms.calc
    if calc.load.any() or calc.spring_forces.any():
        raise ValueError('a dead load or stretched springs of the foundation hold the particles here, so the lattice has '
                         'no moduli of its own; relax it without them')
    stress, clamped, Lambda = _of_bonds(calc, model)
    V, dim = measure(atoms), calc.dim
    push = _pushes(Lambda)
    following = (push.T @ _motion(hessian(calc.bonds, calc.rest_stiffness(model), 0.0), push)).reshape((dim,) * 4)
    density = float(masses_of(atoms).sum() / V)
    return Moduli(_along_periods(atoms, dim), density, stress / V, clamped / V, (clamped - following) / V)


def internal_strain(atoms: Atoms) -> NDArray[np.float64]:
    """How the particles of a cell at rest follow a strain, beyond the strain itself, in the complete model.

    Returns
    -------
    ndarray, shape (particles, dim, dim * dim)
        Displacement in mm for each component of a small symmetric strain: a bond vector becomes `R + eta R + u_j - u_i`.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.stiffness.elastic import internal_strain
    >>> cell = lattices.honeycomb(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> bool(abs(internal_strain(cell)).max() > 0.1)
    True
    """
    calc: Any = LinearSystem.of(atoms).calc
    push = _pushes(_of_bonds(calc, 'complete')[2])
    return -_motion(hessian(calc.bonds, calc.rest_stiffness('complete'), 0.0), push).reshape(len(atoms), calc.dim, -1)


def _pushes(Lambda):
    """Lambda as a matrix, shape (particles * dim, strains), without what would push the lattice as a whole."""
    push = Lambda.reshape(len(Lambda) // Lambda.shape[1], -1)
    return (push - push.mean(axis=0)).reshape(len(Lambda), -1)


def _motion(Phi, push):
    """What the pushes move, `Phi^-1 push`, shape (particles * dim, strains)."""
    largest = abs(Phi).sum(axis=1).max() or 1.0  # a cell of one particle has no internal motion
    solve = inverse(Phi + FLOPPY * largest * sparse.eye_array(len(push)))
    y = solve(push)
    for _ in range(REFINEMENTS):
        y = y + solve(push - Phi @ y)
    return y


def _along_periods(atoms, dim):
    """Projector on the directions in which the lattice can be strained, shape (dim, dim)."""
    periods = atoms.cell.array[atoms.pbc][:, :dim]
    return np.linalg.pinv(periods) @ periods


def _of_bonds(calc: PairCalculator, model: Model) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """First and second strain derivative of the energy in mJ, and Lambda in N, shape (particles * dim, dim, dim).

    Lambda is valid only at rest, where the terms with the forces on a particle cancel.
    """
    bonds, R, dim, law = calc.bonds, calc.bond_vectors, calc.dim, calc.law
    S = R @ _along_periods(calc.reference, dim)
    r = np.linalg.norm(R, axis=1)
    g = law.dphi(r) / r if one_of('model', model, MODELS) == 'complete' else 0 * r
    curvature = (law.d2phi(r) - g) / r**2
    first = np.einsum('b,bi,bj->ij', g, S, S)
    second = np.einsum('b,bi,bj,bk,bl->ijkl', curvature, S, S, S, S, optimize=True)
    pulls = np.einsum('b,bx,bi,bj->bxij', curvature, R, S, S).reshape(len(bonds), -1)
    return first, second, (bonds.incidence.T @ pulls).reshape(bonds.particles * dim, dim, dim)
