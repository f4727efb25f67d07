"""Complex bands: the complex wavenumbers at a given frequency, also inside band gaps.

Along a direction the Bloch matrix is a Laurent polynomial in mu = e^{i s xi}, with a term for each distance that
bonds bridge, all multiples of s.  At the frequency omega its mass-weighted modes v obey

    sum_p D_p mu^p v = omega^2 v        p = -P ... P

a polynomial eigenproblem of degree 2 P.  Where xi is real these are the bands; complex xi decay as e^{-Im xi} per step: below
the cut-off of a foundation, above the bands and between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import gcd, lcm
from typing import TYPE_CHECKING

import numpy as np

from .. import units
from ..errors import finite, one_of
from ..stiffness.linear_system import LinearSystem
from ..stiffness.matrices import mass_weighted
from ..stiffness.sites import each_spring
from .bloch import condensed
from .laurent import laurent_roots, polished

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import ArrayLike, NDArray

LARGEST_DENOMINATOR = 6
"""Largest denominator of the exponents along a direction.  The matrix pencil grows with it; symmetry directions need 1, 2 or
3."""
LEAST_DECAY = 1e-6
"""Smallest decay per step that is not round-off: at a band edge, a double root, round-off changes xi by its own square root."""
INFINITE_DECAY = 16
"""Decay per step above which a wave counts as infinitely evanescent (e^-16 = 1e-7)."""


@dataclass(frozen=True)
class ComplexBands(units.InHertz):
    """Waves along a direction at given frequencies, the slowest decay first.

    Attributes
    ----------
    omega : ndarray, shape (frequencies,)
        In rad/ms.
    xi : ndarray of complex, shape (frequencies, waves)
        Phase and decay per step, `e^{i xi}`, real and imaginary part zero or positive; each stands for its family xi,
        -xi and their conjugates.  Infinite where a wave ends at the particle that moves.
    vectors : ndarray of complex, shape (frequencies, waves, particles, dim)
        Modes, normalised to one and weighted with the square root of the mass: displacements are `vectors / sqrt(m)`.  Zero
        where the decay is infinite.
    """

    omega: np.ndarray
    xi: np.ndarray
    vectors: np.ndarray

    @property
    def decay_steps(self) -> NDArray[np.float64]:
        """Steps over which each wave falls to 1/e, shape (frequencies, waves); infinite where it propagates."""
        with np.errstate(divide='ignore'):
            return 1 / np.imag(self.xi)


def complex_bands(atoms: Atoms, direction: ArrayLike, omega: ArrayLike, model: str = 'complete') -> ComplexBands:
    """All waves along a direction at given frequencies, propagating and evanescent.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its MagneticRepulsion; held particles, such as the walls of a channel, do not move.
    direction : array_like, shape (3,)
        Wavevector of xi = 2 pi in fractions of the reciprocal vectors, as for `spectrum.branch`: in the triangular
        lattice along R2, (0, 1, 0) for a row of sources along R1 and (1/2, 1, 0) for a point source.
    omega : array_like, shape (frequencies,)
        In rad/ms; negative for the square root of -omega^2, as in `Bands`.
    model : {'complete', 'conventional'}

    Returns
    -------
    ComplexBands

    Raises
    ------
    ValueError
        If the bonds bridge no whole fractions of a step along the direction, or none of them leads along it, or a band
        is flat at one of the frequencies: there it holds every wavenumber.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, complex_bands, lattices
    >>> cell = lattices.chain(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=10.0)
    >>> below = complex_bands(cell, (1, 0, 0), [1.0])  # the cut-off is the root of 10
    >>> below.xi.real.tolist(), bool((below.xi.imag > 0).all())  # in phase, and decaying
    ([[0.0, 3.141592653589793]], True)
    """
    system = LinearSystem.of(atoms).moving()
    calc, free = system.calc, system.free.toarray()
    direction = finite('direction', direction, (3,))
    omega = finite('omega', np.atleast_1d(omega))
    exponents, unit = _exponents(_steps(system) @ direction)
    D = condensed(_laurent(calc, model, exponents, system.masses), free)
    _refuse_flat(condensed(_far_from_symmetry(calc, model, direction, system.masses), free), omega)
    waves = [_waves(D, w, unit) for w in omega]
    xi, v = (np.array(part) for part in zip(*waves, strict=True))
    return ComplexBands(omega, xi, (v @ free.T).reshape(*xi.shape, len(system), calc.dim))


def _steps(system):
    """Cells that each bond bridges, shape (bonds, 3); a bond to a held particle carries no wave and bridges none."""
    bonds, moves = system.calc.bonds, np.diff(system.free.indptr).reshape(len(system), -1).any(axis=1)
    return bonds.shift * (moves[bonds.i] & moves[bonds.j])[:, None]


def _exponents(steps):
    """The steps that bonds bridge as whole multiples of the largest possible unit, and that unit."""
    fractions = [Fraction(float(step)).limit_denominator(LARGEST_DENOMINATOR) for step in steps]
    for step, fraction in zip(steps, fractions, strict=True):
        if abs(step - fraction) > 1e-9:
            raise ValueError(f'a bond bridges {step:.6g} steps along the direction, no fraction with a denominator up to '
                             f'{LARGEST_DENOMINATOR}; choose a direction of symmetry, such as (0, 1, 0) or (1/2, 1, 0)')
    if not any(fractions):
        raise ValueError('no bond leads along the direction; its entries belong to the periodic lattice vectors')
    d = lcm(*(fraction.denominator for fraction in fractions))
    exponents = np.array([int(d * fraction) for fraction in fractions])
    common = gcd(*exponents.tolist())
    return exponents // common, common / d


def _laurent(calc, model, exponents, masses):
    """Coefficients D_p, p = -P ... P, of the Bloch matrix by powers of mu, bond by bond: what none couples is exactly zero."""
    K, i, j = calc.rest_stiffness(model), calc.bonds.i, calc.bonds.j
    n, P = calc.bonds.particles, abs(exponents).max()
    D = np.zeros((2 * P + 1, n, n, calc.dim, calc.dim))
    for end in (i, j):
        np.add.at(D, (P, end, end), K)
    np.subtract.at(D, (P + exponents, i, j), K)
    np.subtract.at(D, (P - exponents, j, i), K)
    D = D.swapaxes(2, 3).reshape(2 * P + 1, n * calc.dim, -1)
    D[P] += np.diag(each_spring(calc.foundation, n, calc.dim))
    return mass_weighted(D, masses)


def _far_from_symmetry(calc, model, direction, masses):
    """Bloch matrices at three phases: only a flat band has one frequency at all of them."""
    xi = np.array([0.7, 1.9, 2.6])
    return mass_weighted(calc.bloch_matrix(xi[:, None] / (2 * np.pi) * direction, model), masses)


def _refuse_flat(D, omega):
    bands = np.linalg.eigvalsh(D)
    hit = abs(bands - (omega * abs(omega))[:, None, None]) < 1e-10 * abs(bands).max()
    for k in np.flatnonzero(hit.any(axis=2).all(axis=1))[:1]:
        raise ValueError(f'a band is flat at omega = {omega[k]:.9g} rad/ms and holds every wavenumber; move the frequency')


def _waves(D, omega, unit):
    """One xi, with its mode, of each family at the frequency `omega`."""
    n, P = D.shape[1], len(D) // 2
    A = D.copy()
    A[P] -= omega * abs(omega) * np.eye(n)
    mu, v = laurent_roots(A)
    decay, phase = -np.log(abs(mu)), np.angle(mu)
    decay[abs(decay) < LEAST_DECAY * unit] = 0
    # xi and its conjugate, or xi and -xi if real: keep the half that decays or runs forwards
    half = np.lexsort((-phase, -decay))[: len(mu) // 2]
    mu, v = polished(A, mu[half], v[half])
    decay, phase = -np.log(abs(mu)) / unit, np.angle(mu) / unit
    decay[abs(decay) < LEAST_DECAY] = 0
    order = np.lexsort((abs(phase), decay))
    order = order[decay[order] < INFINITE_DECAY]
    xi, modes = np.zeros(P * n, complex), np.zeros((P * n, n), complex)
    xi.imag = np.inf
    xi[: len(order)] = abs(phase[order]) + 1j * decay[order]
    modes[: len(order)] = np.where(phase[order, None] < 0, v[order].conj(), v[order])
    return xi, modes


def measured_decay(amplitudes: ArrayLike, steps: ArrayLike, source: str) -> tuple[float, float]:
    """Decay per step, Im xi, from the amplitudes at one frequency along a row, by least squares.

    Behind a row of sources, |U| = A e^{-Im xi n}.  Around a point source the wave spreads as well:
    |U| = A e^{-Im xi n + c/n}/sqrt(n), the Hankel function of a decaying cylindrical wave with its first correction; it
    holds from a few decay lengths on, and for the wave of the slowest decay.

    Parameters
    ----------
    amplitudes : array_like, shape (points,)
        Complex or absolute, in any unit.
    steps : array_like, shape (points,)
        Distances from the source in steps, positive.
    source : {'row', 'point'}

    Returns
    -------
    decay, sigma : float
        Per step, and its standard uncertainty from the scatter about the fit.

    Raises
    ------
    ValueError
        For fewer points than the fit has unknowns and two more, an amplitude of zero, or a distance that is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.bands import measured_decay
    >>> decay, uncertainty = measured_decay(np.exp(-0.3 * np.arange(1, 7)), np.arange(1, 7), 'row')
    >>> round(decay, 9)
    0.3
    """
    amplitudes, n = finite('amplitudes', abs(np.asarray(amplitudes))), finite('steps', steps)
    one_of('source', source, ('row', 'point'))
    columns = [np.ones_like(n), -n] if source == 'row' else [np.ones_like(n), -n, 1 / n]
    if amplitudes.shape != n.shape or len(n) < len(columns) + 2:
        raise ValueError(f'the fit needs at least {len(columns) + 2} amplitudes, each with its distance, '
                         f'not {amplitudes.shape} and {n.shape}')
    if not (n.min() > 0 and amplitudes.min() > 0):
        raise ValueError(f'distances and amplitudes must be positive, not {n.min():g} steps and {amplitudes.min():g}; '
                         'leave out the source and particles at rest')
    spreading = 0 if source == 'row' else np.log(n) / 2
    B = np.stack(columns, axis=1)
    y = np.log(amplitudes) + spreading
    solution = np.linalg.lstsq(B, y)[0]
    scatter = ((y - B @ solution) ** 2).sum() / (len(n) - len(columns))
    return float(solution[1]), float(np.sqrt(scatter * np.linalg.inv(B.T @ B)[1, 1]))
