"""What a linear scene can do without time steps: modes and frequency response; `magphonon.propagation` has the transient.

About rest, with what the constraints hold left out and masses absorbed, the motion of a structure is

    y'' + gamma y' + K y = g(t)        y = B^T M^{1/2} u        K = B^T M^{-1/2} H M^{-1/2} B

with the orthonormal directions B in which particles are free.  Each answer is a function of the matrix K: of a small one
by its modes, of a large one by a Chebyshev series (`magphonon.chebyshev`), whose products with K serve all times and all
frequencies at once.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from .chebyshev import BLOCK, Interval, Outside, chebyshev_blocks, stable_interval, whole_interval
from .constraints import free_motion, refuse_held
from .errors import finite, not_negative, positive, whole
from .files import Saved
from .frf import FrequencyResponse, harmonic_response
from .rest import at_rest
from .stiffness import hessian, model_stiffness, signed_root
from .timestep import linear_model

SMALL = 300
"""Degrees of freedom up to which a structure is diagonalised; above, products with its matrix are cheaper."""
FACTORISATION = 500
"""Products that take as long as one sparse factorisation: measured on patches of 1000 to 10 000 particles."""
ROUND_OFF = 1e-12
"""Of the highest squared frequency: what is left of one that is zero."""


@dataclass(frozen=True)
class Modes(Saved, kind='modes', units={
    'omega': ('rad/ms', 'modes'), 'shapes': ('g^-1/2', 'modes', 'particles', 'dim'),
}):
    """Natural frequencies and mode shapes of a structure.

    Attributes
    ----------
    omega : ndarray, shape (modes,)
        Ascending, in rad/ms; that of an unstable mode is minus its growth rate.
    shapes : ndarray, shape (modes, particles, dim)
        Displacements in g^-1/2, normalised so that `sum m u^2 = 1`.
    """

    omega: np.ndarray
    shapes: np.ndarray


@dataclass(frozen=True)
class Reduced:
    """A structure about rest, without what is held.

    Attributes
    ----------
    K : scipy.sparse.csr_array, shape (free, free)
        In rad^2/ms^2.
    shapes : scipy.sparse.csr_array, shape (particles * dim, free)
        M^{-1/2} B: displacements `u = shapes y`; forces enter as `shapes^T f`.
    dim : int
    """

    K: sparse.csr_array
    shapes: sparse.csr_array
    dim: int

    def rows(self, particles):
        """The free directions of some particles, and the part of `shapes` that belongs to both."""
        own = self.shapes[(particles[:, None] * self.dim + np.arange(self.dim)).ravel()]
        rows = np.unique(own.indices)
        return rows, own[:, rows]


def reduced(atoms):
    """Linearise a structure about its present positions, where the forces must balance.

    Parameters
    ----------
    atoms : ase.Atoms

    Returns
    -------
    Reduced

    Raises
    ------
    ValueError
        If there is another calculator, a constraint other than FixAtoms, FixedLine and FixedPlane, nothing is free, or the
        structure is not at rest.
    """
    return reduced_about(at_rest(atoms), atoms)


def reduced_about(calc, atoms):
    """The same about the reference of `calc`, whether or not the forces balance there."""
    B = free_motion(atoms)
    H = hessian(calc.bonds, model_stiffness(calc.bonds.vectors[:, : calc.dim], calc.potential, linear_model(calc)),
                calc.parameters.foundation)
    shapes = sparse.csr_array(sparse.diags_array(1 / np.sqrt(np.repeat(atoms.get_masses(), calc.dim))) @ B)
    return Reduced(sparse.csr_array(shapes.T @ H @ shapes), shapes, calc.dim)


def modes(atoms, count=None):
    """Natural frequencies and mode shapes about rest, within the constraints.

    Parameters
    ----------
    atoms : ase.Atoms
        With MagneticRepulsion.
    count : int, optional
        The lowest ones only, which a large structure finds without being diagonalised; all of them if not given.

    Returns
    -------
    Modes

    Raises
    ------
    ValueError
        If there are not as many modes, or the structure is not at rest.
    """
    scene = reduced(atoms)
    size = scene.K.shape[0]
    count = size if count is None else whole('count', count)
    if count > size:
        raise ValueError(f'the structure has {size} modes, not {count}')
    if size <= SMALL or count > size // 10:
        squares, vectors = np.linalg.eigh(scene.K.toarray())
    else:
        below = whole_interval(scene.K)
        squares, vectors = sparse.linalg.eigsh(scene.K, k=count, sigma=below.lowest - 1e-6 * below.highest,
                                               v0=np.random.default_rng(0).normal(size=size))
    order = np.argsort(squares)[:count]
    shapes = (scene.shapes @ vectors[:, order]).T.reshape(count, len(atoms), scene.dim)
    return Modes(signed_root(squares[order]), shapes)


def natural_frequencies(atoms):
    """Frequencies of all `modes` without their shapes, in a third of the time; ascending, in rad/ms, shape (modes,)."""
    return signed_root(np.linalg.eigvalsh(reduced(atoms).K.toarray()))


def frequency_response(atoms, force, omega, damping, particles=None, tolerance=1e-9):
    """Steady displacements under a harmonic force at many frequencies: what `frf.harmonic_response` solves one by one.

    A small structure by its modes; a large one by the Chebyshev series of `(K - omega^2 + i gamma omega)^-1`, whose length is
    about `omega_max/gamma` times the digits wanted; frequency by frequency where that would be dearer.

    Parameters
    ----------
    atoms : ase.Atoms
        At rest, with MagneticRepulsion; its FixAtoms, FixedLine and FixedPlane are respected.
    force : array_like of complex, shape (particles, 3)
        Amplitudes in N, of e^{i omega t}.
    omega : array_like, shape (frequencies,)
        In rad/ms.
    damping : float
        gamma in 1/ms.
    particles : array_like of int, optional
        Where the response is wanted; everywhere if not given.
    tolerance : float
        At each frequency, of the largest displacement there.

    Returns
    -------
    ndarray of complex, shape (frequencies, particles, 3)
        In mm.

    Raises
    ------
    ValueError
        For another shape, a negative damping, an undamped resonance, a structure that is not at rest, one that is
        unstable and has no steady state, or a force on held particles only.
    """
    scene = reduced(atoms)
    omega, gamma = finite('omega', np.atleast_1d(omega)), not_negative('damping', damping, '1/ms')
    force = np.asarray(force, dtype=complex)
    finite('force', abs(force), (len(atoms), 3))
    refuse_held(force, atoms, 'the force')
    positive('tolerance', tolerance)
    particles = recorded(particles, len(atoms))
    s = scene.shapes.T @ force[:, : scene.dim].ravel()
    s = s if s.imag.any() else s.real
    u = np.zeros((len(omega), len(particles), 3), complex)
    if scene.K.shape[0] <= SMALL:
        u[..., : scene.dim] = _by_modes(scene, s, omega, gamma, particles)
        return u
    try:
        if _series_length(scene.K, omega, gamma, tolerance) > FACTORISATION * len(omega):
            _refuse_unstable(whole_interval(scene.K))
            return harmonic_response(atoms, force, omega, gamma)[:, particles]
        u[..., : scene.dim] = series_response(scene, s, omega, gamma, particles, tolerance)[0]
    except Outside:
        _refuse_unstable(whole_interval(scene.K))
    return u


def receptance(atoms, source, answer, omega, damping):
    """Displacement of one particle per harmonic force on one, each along its own direction.

    Parameters
    ----------
    atoms, omega, damping
        As for `frequency_response`.
    source, answer : tuple of int and array_like, shape (3,)
        The particle and the unit vector of the direction: where the force acts, and where its effect is seen.

    Returns
    -------
    FrequencyResponse
        Of shape (frequencies,).
    """
    (driven, push), (seen, along) = source, answer
    force = np.zeros((len(atoms), 3))
    force[driven] = push
    omega = np.atleast_1d(omega)
    return FrequencyResponse(omega, frequency_response(atoms, force, omega, damping, np.array([seen]))[:, 0] @ along)


def _refuse_unstable(spectrum):
    if spectrum.lowest < -ROUND_OFF * spectrum.highest:
        raise ValueError(f'the structure is unstable (growth rate {np.sqrt(-spectrum.lowest):.4g} / ms) and has no steady state; '
                         'see magphonon.stability for what would hold it') from None


def _by_modes(scene, s, omega, gamma, particles):
    squares, vectors = np.linalg.eigh(scene.K.toarray())
    _refuse_unstable(Interval(squares[0], squares[-1]))
    dynamic = squares - omega[:, None] ** 2 + 1j * gamma * omega[:, None]
    for w in omega[abs(dynamic).min(axis=1) <= ROUND_OFF * squares[-1]]:
        raise ValueError(f'the undamped response at omega = {w:.9g} rad/ms is infinite; damp it or move the frequency')
    rows, shapes = scene.rows(particles)
    y = (vectors.T @ s / dynamic) @ vectors[rows].T
    return (shapes @ y.T).T.reshape(len(omega), len(particles), scene.dim)


def _inner(z):
    """`z - sqrt(z^2 - 1)` within the unit circle, without its cancellation at large z."""
    return 1 / (z + np.sqrt(z - 1) * np.sqrt(z + 1))  # the branch cut lies on the interval


def _scaled(K, omega, gamma):
    """The interval of the spectrum, and where `z = omega^2 - i gamma omega` lies when that is [-1, 1]."""
    interval = stable_interval(K)
    return interval, (omega**2 - 1j * gamma * omega - interval.centre) / interval.radius


def _series_length(K, omega, gamma, tolerance):
    """About how many terms the longest series has."""
    return np.log(tolerance) / np.log(abs(_inner(_scaled(K, omega, gamma)[1])).max()) if gamma else np.inf


def series_response(scene, s, omega, gamma, particles, tolerance):
    """Response of a large structure: `1/(z - x) = (1 + 2 sum_n w^n T_n(x))/root`, w = z - root, root = sqrt(z^2 - 1).

    Parameters
    ----------
    scene : Reduced
    s : ndarray, shape (free,)
        Reduced force.
    omega, gamma, particles, tolerance
        As for `frequency_response`.

    Returns
    -------
    u : ndarray of complex, shape (frequencies, particles, dim)
        In mm.
    products : int
        Matrix-vector products taken.

    Raises
    ------
    Outside
        If the structure is unstable.
    """
    interval, z = _scaled(scene.K, omega, gamma)
    rows, shapes = scene.rows(particles)
    w = _inner(z)
    root = z - w
    length, size = np.linalg.norm(s), sizes(shapes)
    y, open_ = np.zeros((len(z), len(rows)), complex), np.ones(len(z), bool)
    for n, block in enumerate(chebyshev_blocks(scene.K, interval, s, rows)):
        powers = 2 * w[open_, None] ** (n * BLOCK + np.arange(BLOCK))
        if n == 0:
            powers[:, 0] = 1
        y[open_] += powers @ block
        left = 2 * abs(w) ** ((n + 1) * BLOCK) / (1 - abs(w))
        largest = (abs(y) * size).max(axis=1, initial=0.0)
        open_ = (left * length * size.max(initial=0.0) > tolerance * largest) & (left > np.finfo(float).eps)
        if not open_.any():
            break
    y /= -root[:, None] * interval.radius
    return (shapes @ y.T).T.reshape(len(z), len(particles), scene.dim), (n + 1) * BLOCK


def sizes(shapes):
    """Displacement that one unit of each coordinate is, g^-1/2."""
    return np.sqrt(shapes.power(2).sum(axis=0))


def recorded(particles, count):
    """The particles wanted, as an array of indices."""
    if particles is None:
        return np.arange(count)
    particles = np.atleast_1d(particles)
    if not (np.issubdtype(particles.dtype, np.integer) and particles.min(initial=0) >= 0 and particles.max(initial=0) < count):
        raise ValueError(f'particles must be indices from 0 to {count - 1}, not {particles!r}')
    return particles
