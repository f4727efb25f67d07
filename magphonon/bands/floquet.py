"""Floquet bands: waves of a lattice whose foundation is modulated by a travelling wave, `Travelling`.

With k_i(t) = k [1 + eps cos(W t - kap.R_i)] a wave is a sum of harmonics, sum_n U_n e^{i(q + n kap).R - i(w + n W) t}, and the
modulation couples each harmonic to the next ones. With s = -i w,

    [(s - i n W)^2 + (s - i n W) B + K(q + n kap)] U_n + A U_{n+1} + A^+ U_{n-1} = 0        A = eps/2 k/m e^{-i kap.R}

Hill's method takes the eigenvalues for a finite number of harmonics, and adds harmonics until the eigenvalues no longer change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from ..errors import positive
from ..results import InHertz
from ..stiffness.bond import Model
from ..stiffness.matrices import companion
from ..stiffness.repulsion import repulsion_of
from ..stiffness.rest import LinearSystem, on_foundation
from ..stiffness.sites import site_damping
from ..traits import SPRUNG, takes
from .bloch import wavevectors

MOST = 3000  # largest size of Hill's matrix, whose eigenvalues take half a minute at each wavevector
NEAR = 0.75  # largest mean harmonic of a wave that belongs to its wavevector; it is 1/2 if two harmonics share the wave
STILL = -1e-9  # in W: real frequencies down to this value belong to pure growth, lower ones to the wave that runs backwards


@dataclass(frozen=True)
class FloquetBands(InHertz):
    """Waves of a modulated lattice at each wavevector: for each mode the two solutions in which the harmonic at q itself is
    strongest.

    Attributes
    ----------
    q : ndarray, shape (wavevectors, 3)
        In fractions of the reciprocal vectors.
    omega : ndarray of complex, shape (wavevectors, 2 * modes)
        Quasi-frequencies in rad/ms, ascending by their real part, which is not negative: motion goes as e^{-i omega t}, and grows
        where the imaginary part is positive.  Frequencies are defined up to multiples of W: omega + n W at the wavevector q + n
        kap is the same motion, for any integer n.
    weight : ndarray, shape (wavevectors, 2 * modes)
        Share of the harmonic at q itself in this motion, 0 to 1: it is 1 far from all resonances and 1/2 where two waves mix
        equally.
    harmonics : int
        Number of harmonics that were needed on either side of the one at q.
    """

    q: np.ndarray
    omega: np.ndarray
    weight: np.ndarray
    harmonics: int

    @property
    def growth(self) -> NDArray[np.float64]:
        """Rate of the fastest growth at each wavevector in 1/ms, shape (wavevectors,); negative where all waves die out."""
        return np.imag(self.omega).max(axis=1)


@takes('modulation', *SPRUNG)
def floquet_bands(atoms: Atoms, q: ArrayLike, model: Model | None = None, damping: ArrayLike = 0.0,
                  tolerance: float = 1e-8) -> FloquetBands:
    """Quasi-frequencies of a lattice on a `Travelling` foundation, by Hill's method.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator on a Travelling foundation.
    q : array_like, shape (wavevectors, 3)
        In fractions of the reciprocal vectors, as the `kpts` of a path.
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.
    damping : float or array_like, shape (particles,)
        Damping rate in 1/ms, the force divided by the momentum.
    tolerance : float
        Harmonics are added until no frequency changes by more than this fraction of the largest one.

    Raises
    ------
    ValueError
        If the foundation is not Travelling, or if the modulation is so slow and deep that too many harmonics would be needed.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, Travelling, floquet_bands, lattices
    >>> cell = lattices.chain(1.0, 1.0)
    >>> k = Travelling(5.0, 0.2, W=0.9, kap=(2.0, 0))
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=k)
    >>> bands = floquet_bands(cell, [[0.1, 0, 0], [-0.1, 0, 0]])
    >>> bands.omega.shape, bands.harmonics > 1
    ((2, 4), True)
    >>> bool(abs(bands.frequencies_Hz[0] - bands.frequencies_Hz[1]).max() > 1)  # a wave is not its mirror image
    True
    """
    if not atoms.pbc.any():
        raise ValueError('the structure is not periodic and has no bands; use the unit cell from which it was made')
    hill, q = Hill(atoms, model, damping), wavevectors(q)
    tolerance, harmonics = positive('tolerance', tolerance), 1
    omega, weight = hill.solved(q, harmonics)
    while True:
        harmonics += 1 + harmonics // 4  # slow and deep modulations take many
        if 2 * (2 * harmonics + 1) * hill.modes > MOST:
            raise ValueError(f'more than {harmonics} harmonics would be needed for an error of {tolerance:g} of the largest '
                             f'frequency, because the modulation is slow and deep; give a larger tolerance')
        before, (omega, weight) = _strongest(omega, weight, hill)[0], hill.solved(q, harmonics)
        away = abs(before[:, :, None] - omega[:, None, :]).min(axis=2)
        if away.max(initial=0.0) <= tolerance * abs(before).max(initial=0.0):
            return FloquetBands(q, *_strongest(omega, weight, hill), harmonics)


def _strongest(omega, weight, hill):
    """The waves, two for each mode, that are strongest at q itself, and their weights."""
    forward, weight = omega.real >= STILL * hill.W, weight[:, weight.shape[1] // 2]
    best = np.argsort(np.where(forward, -weight, 1.0), axis=1)[:, : 2 * hill.modes]
    omega, weight = np.take_along_axis(omega, best, axis=1), np.take_along_axis(weight, best, axis=1)
    order = np.argsort(np.real(omega), axis=1)
    return np.take_along_axis(omega, order, axis=1), np.take_along_axis(weight, order, axis=1)


class Hill:
    """The matrices of Hill's method for a cell on a Travelling foundation; the arguments are those of `floquet_bands`."""

    def __init__(self, atoms: Atoms, model: Model | None = None, damping: ArrayLike = 0.0) -> None:
        calc = repulsion_of(atoms)
        wave = calc.tie.modulation(calc.anchors)
        if wave is None:
            raise ValueError(f'floquet_bands needs a modulated foundation, not {calc!r}; give the '
                             'calculator foundation=Travelling(k, eps, W, kap)')
        mean = on_foundation(atoms, calc.tie.k)
        self.system, self.W = LinearSystem.of(mean).moving(), wave.W
        self.model: Model | None = model
        self.modes = self.system.directions
        self.kap = mean.cell.array @ wave.kap / (2 * np.pi) * mean.pbc  # in fractions of the reciprocal vectors
        n, dim = len(mean), self.system.dim
        self.A = self.system.reduced(np.diag(np.broadcast_to(wave.A, (n, dim)).ravel()))
        self.B = self.system.B(site_damping(damping, n)).toarray()

    def solved(self, q: NDArray[np.float64], harmonics: int) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
        """All quasi-frequencies, shape (wavevectors, all), and the weight of each harmonic in each of these solutions.

        `harmonics` is their number on either side of q. The weights have the shape (wavevectors, 2 * harmonics + 1, all).
        """
        found = [self._at(each, np.arange(-harmonics, harmonics + 1)) for each in q]
        omega, weight = zip(*found, strict=True) if found else ((), ())
        size = 2 * self.modes * (2 * harmonics + 1)
        return np.reshape(omega, (len(q), size)), np.reshape(weight, (len(q), 2 * harmonics + 1, size))

    def growth(self, q: NDArray[np.float64], harmonics: int) -> NDArray[np.float64]:
        """Rate of the fastest growth at each wavevector in 1/ms, shape (wavevectors,).

        Only waves with their main weight near q count: those at the last harmonics, where the series is cut off, are artefacts.
        """
        omega, weight = self.solved(q, harmonics)
        centre = np.einsum('n,qnw->qw', np.arange(-harmonics, harmonics + 1), weight)
        return np.where(abs(centre) <= NEAR, omega.imag, -np.inf).max(axis=1)

    def _at(self, q, n):
        count, size = len(n), self.modes
        nW, eye = 1j * n * self.W, np.eye(size)
        K = np.zeros((count, size, count, size), complex)
        K[range(count), :, range(count)] = (self.system.bloch(q + n[:, None] * self.kap, self.model)
                                            + nW[:, None, None] ** 2 * eye - nW[:, None, None] * self.B)
        K[range(count - 1), :, range(1, count)] = self.A
        K[range(1, count), :, range(count - 1)] = self.A.conj().T
        B = np.zeros((count, size, count, size), complex)
        B[range(count), :, range(count)] = self.B - 2 * nW[:, None, None] * eye
        K, B = (x.reshape(count * size, -1) for x in (K, B))
        s, y = np.linalg.eig(companion(B, K))
        share = (abs(y[: len(K)].reshape(count, size, -1)) ** 2).sum(axis=1)
        return 1j * s, share / share.sum(axis=0)
