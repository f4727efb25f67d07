"""Amplitude dependence of frequencies, by perturbation theory."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .. import units
from ..bands.bloch import wavevectors
from ..errors import PhysicsError
from ..interactions.pair_laws import higher_derivatives
from ..results import InHertz
from ..stiffness.factors import inverse
from ..stiffness.lowest import DENSE, lowest_mode
from ..stiffness.rest import LinearSystem
from ..traits import takes

ROUND_OFF = 1e-12  # fraction of the highest squared frequency below which a squared frequency is zero
STEADY = 1e-6  # share of a force below which it is round-off
DEGENERACY = 1e-6
"""Relative difference of squared frequencies below which two modes are degenerate by symmetry and do not drive each other."""


@dataclass(frozen=True)
class Shifts(InHertz):
    """Amplitude dependence of the frequencies of modes.

    Attributes
    ----------
    q : ndarray, shape (modes, 3)
        Wavevectors in fractions of the reciprocal vectors.
    omega : ndarray, shape (modes,)
        Linear angular frequencies in rad/ms.
    curvature : ndarray, shape (modes,)
        dw/w divided by the square of the largest displacement, 1/mm^2. It is infinite if the second harmonic is itself a free
        wave (2:1 resonance), because the wave then loses its energy to the second harmonic at any amplitude.
    harmonic : ndarray, shape (modes,)
        Largest displacement of the second harmonic divided by the square of that of the wave, 1/mm; infinite at a 2:1 resonance.
        Where the second harmonic is not small, as near such a resonance, true shifts are several times smaller than these.
    motion : tuple of str
        'standing' where q and -q are the same wavevector; 'rotating' for degenerate waves; 'travelling' otherwise.
    """

    q: np.ndarray
    omega: np.ndarray
    curvature: np.ndarray
    harmonic: np.ndarray
    motion: tuple[str, ...]

    def amplitude(self, error: float) -> float:
        """Displacement in mm up to which every frequency stays within `error` of the linear one; infinite if none shifts."""
        return float(np.sqrt(error / abs(self.curvature).max())) if self.curvature.any() else np.inf


@takes('constraints', 'conventional', 'radii')
def frequency_shifts(atoms: Atoms | LinearSystem, q: ArrayLike | None = None) -> Shifts:
    """Frequency shifts with amplitude, of waves of any wavevector or of the softest and stiffest mode of a finite structure.

    If q and -q are the same wavevector, the waves are standing; otherwise they travel.  (Standing waves at other wavevectors are
    sums of two travelling waves, which shift each other's frequency; this is not computed.)  Waves of equal frequency and
    wavevector, such as those of the triangular and the honeycomb lattice at K, are separated by their angular momentum: each
    particle then moves on a circle or an ellipse.  The mean strain of a periodic structure is held at zero.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        With their PairCalculator, at rest.
    q : array_like, shape (3,) or (wavevectors, 3), optional
        For a periodic cell, in fractions of the reciprocal vectors; by default the band edges, whose fractions are 0 or 1/2. For
        a finite structure it must be left out: the softest and the stiffest mode are taken.

    Returns
    -------
    Shifts
        Modes of zero or imaginary frequency are omitted, because they do not vibrate.

    Raises
    ------
    PhysicsError
        A ValueError: at a given wavevector, degenerate waves exchange energy, so that none has a frequency of its own.

    Notes
    -----
    For ``u = Re(U e^{-iwt})`` the second order moves the mean position by U0 and adds a harmonic U2 at 2w and 2q, and the third
    order of the force at w shifts the frequency::

        D(0) U0 = -phi3[U, U*]/4          (D(2q) - 4 w^2 M) U2 = -phi3[U, U]/4
        dw/w = Re U*.(phi3[U, U0] + phi3[U*, U2]/2 + phi4[U, U, U*]/8) / (2 w^2 U*.M U)

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.stability import frequency_shifts
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> shifts = frequency_shifts(cell, q=(2/3, 1/3, 0))  # K
    >>> shifts.motion, (36 * shifts.curvature).round(6)
    (('rotating', 'rotating'), array([475., 475.]))
    """
    system = LinearSystem.of(atoms).moving()
    calc, P, pbc = system.calc, system.free, system.atoms.pbc
    zone = bool(pbc.any()) and P.shape[1] <= DENSE
    if q is not None and not zone:
        raise ValueError('a wavevector needs a periodic cell' + f' of at most {DENSE} free directions' * bool(pbc.any()) +
                         '; leave q out to get the softest and the stiffest mode')
    edges = product(*((0.0, 0.5) if zone and along else (0.0,) for along in pbc))
    waves = _Waves(system, law_derivatives(calc.law, calc.bonds.lengths), zone)
    rows = []
    for k in edges if q is None else wavevectors(q):
        for group in waves.at(k):
            rows += [(k, *wave) for wave in waves.shifted(k, *group, refuse=q is not None)]
    every, w, curvature, harmonic, motion = zip(*rows, strict=True) if rows else ((), (), (), (), ())
    return Shifts(np.reshape(every, (-1, 3)), np.array(w), np.array(curvature), np.array(harmonic), motion)


@dataclass(frozen=True)
class _Waves:
    """The waves of a structure, with the derivatives psi2, psi3, psi4 of the law of each bond by the square of its length."""

    system: LinearSystem
    psi: tuple[NDArray[np.float64], ...]
    zone: bool

    def stiffness(self, q):
        """D(q) of the free directions; real if q and -q are the same wavevector, and sparse for a finite structure."""
        if not self.zone:
            return self.system.stiffness
        P, D = self.system.free, self.system.calc.bloch_matrix(np.array([q]))[0]
        return P.T @ (D.real if _edge(q) else D) @ P

    def at(self, q):
        """Frequency w and shapes e (columns) of each group of waves with equal frequency, without those that do not vibrate."""
        root = sparse.diags_array(1 / np.sqrt(self.masses))
        weighted = root @ self.stiffness(q) @ root
        if weighted.shape[0] <= DENSE:
            squares, modes = np.linalg.eigh(_full(weighted))
        else:
            (lowest, _, softest), (highest, _, stiffest) = lowest_mode(weighted), lowest_mode(-weighted)
            squares, modes = np.array([lowest, -highest]), np.column_stack([softest, stiffest])
        vibrates = squares > ROUND_OFF * squares.max(initial=0)
        squares, modes = squares[vibrates], root @ modes[:, vibrates]
        if not self.zone:
            return [(np.sqrt(squares[n]), modes[:, [n]]) for n in sorted({0, len(squares) - 1} if len(squares) else ())]
        apart = np.flatnonzero(np.diff(squares) > DEGENERACY * squares[1:]) + 1
        return [(np.sqrt(squares[n].mean()), modes[:, n]) for n in np.split(np.arange(len(squares)), apart) if len(n)]

    @property
    def masses(self):
        """Mass of each free direction in g."""
        return self.system.free.power(2).T @ np.repeat(self.system.masses, self.system.dim)

    def shifted(self, q, w, e, refuse):
        """Frequency, curvature, harmonic and kind of motion of the waves `e` of the frequency w, one row for each wave."""
        kinds, kind = [], 'standing' if _edge(q) else 'travelling'
        P, dim = self.system.free, self.system.dim
        if e.shape[1] > 1:  # angular momentum about the normal of the plane
            J = np.pad([[0.0, 1.0], [-1.0, 0.0]], (0, dim - 2))
            turning = P.T @ sparse.kron(sparse.diags_array(self.system.masses), J) @ P
            L, turns = np.linalg.eigh(1j * e.conj().T @ (turning @ e))
            if abs(L).max() > DEGENERACY:
                e, kinds = e @ turns, ['rotating' if abs(spin) > DEGENERACY else kind for spin in L]
        found = []
        for n, wave in enumerate(e.T):
            curvature, harmonic, leak = self.second_order(q, w, wave, np.delete(e, n, axis=1))
            if refuse and leak > STEADY * max(abs(curvature), self.system.calc.bonds.lengths.max() ** -2):
                raise PhysicsError(f'{e.shape[1]} waves at q = ({q[0]:.4g}, {q[1]:.4g}, {q[2]:.4g}) have the frequency '
                                   f'{units.hertz(w):.6g} Hz, and waves of equal angular momentum exchange energy at any '
                                   f'amplitude, so none has a frequency of its own; use the primitive cell, or a wavevector '
                                   f'close to this one')
            found.append((w, curvature, harmonic, (kinds or [kind] * e.shape[1])[n]))
        return found

    def second_order(self, q, w, e, others):
        """For the wave `e`, all divided by A^2: dw/w, the second harmonic, and the coupling by third-order forces to `others`."""
        system, M = self.system, sparse.diags_array(self.masses)
        P, bonds, R, twice = system.free, system.calc.bonds, system.calc.bond_vectors, 2 * np.asarray(q)
        u = (P @ e).reshape(len(system), -1)
        A = _largest(u)  # becomes one
        e, u, others = e / A, u / A, others / A
        C, C0, C2 = (bonds.incidence_at(k) for k in (q, (0, 0, 0), twice))
        if _edge(q):  # real arithmetic for real waves
            C, C0, C2 = C.real, C0.real, C2.real

        def changes(C, u):
            """Changes of the bond vectors; in the conventional model only along the bonds, where the law alone gives D0."""
            d = C @ u
            return d if system.calc.model == 'complete' else _dot(R, d) / _dot(R, R) * R

        d = changes(C, u)

        def follows(D, C, force):
            """Changes of bond vectors and displacements caused by forces of bonds, with the stiffness D."""
            g = P.T @ (C.conj().T @ force).ravel()
            x = _solve(D, g)
            resonant = np.linalg.norm(D @ x - g) > STEADY * np.linalg.norm(abs(C.T) @ abs(force))
            moved = (P @ (-x / 4)).reshape(u.shape)
            return changes(C, moved), moved, resonant

        D2 = self.stiffness(twice) - 4 * w**2 * M
        d0, _, _ = follows(self.stiffness((0, 0, 0)), C0, self.phi3(R, d, d.conj()).real)
        d2, U2, resonant = follows(D2, C2, self.phi3(R, d, d))
        T = self.phi3(R, d, d0) + self.phi3(R, d.conj(), d2) / 2 + self.phi4(R, d, d, d.conj()) / 8
        N = P.T @ (C.conj().T @ T).ravel()
        scale = 2 * w**2 * (e.conj() @ (M @ e)).real
        leak = np.linalg.norm(others.conj().T @ N) / scale
        return (np.inf, np.inf, leak) if resonant else ((e.conj() @ N).real / scale, _largest(U2), leak)

    def phi3(self, R, x, y):
        """Third derivative of the energy of each bond along x and y: a force, shape (bonds, dim)."""
        psi2, psi3, _ = (p[:, None] for p in self.psi)
        Rx, Ry = _dot(R, x), _dot(R, y)
        return 4 * psi2 * (_dot(x, y) * R + Rx * y + Ry * x) + 8 * psi3 * Rx * Ry * R

    def phi4(self, R, x, y, z):
        """Fourth derivative of the energy of each bond along x, y and z: a force, shape (bonds, dim)."""
        psi2, psi3, psi4 = (p[:, None] for p in self.psi)
        Rx, Ry, Rz, xy, xz, yz = _dot(R, x), _dot(R, y), _dot(R, z), _dot(x, y), _dot(x, z), _dot(y, z)
        return (4 * psi2 * (xy * z + xz * y + yz * x) + 16 * psi4 * Rx * Ry * Rz * R
                + 8 * psi3 * ((xy * Rz + xz * Ry + yz * Rx) * R + Rx * Ry * z + Rx * Rz * y + Ry * Rz * x))


def _largest(u):
    """The longest half-axis of the ellipses on which particles move with the amplitudes u."""
    return np.sqrt(((abs(u) ** 2).sum(axis=1) + abs((u * u).sum(axis=1))) / 2).max()


def _dot(x, y):
    return (x * y).sum(axis=1)[:, None]


def _edge(q):
    return np.allclose(2 * np.asarray(q), np.round(2 * np.asarray(q)), atol=1e-12)


def _solve(D, g):
    if D.shape[0] > DENSE:
        return inverse(D)(g)
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
