"""Functions and densities of a large symmetric matrix K by products with the matrix alone.

Each linear answer is a function of K, the mass-weighted stiffness of the directions that the constraints leave free
(`magphonon.stiffness.rest`).  A small K is diagonalised. For a large K, a function that is smooth on an interval around all
eigenvalues is expanded in a Chebyshev series,

    f(K) s = sum_n c_n T_n(X) s        X = (K - centre)/radius        T_{n+1} = 2 X T_n - T_{n-1}

The vectors T_n(X) s do not depend on f: one sequence of products serves every time of a transient, every frequency of a response.

The kernel polynomial method gives the density of the squared frequencies.  For a start vector s, the Chebyshev moments `mu_n =
s.T_n(X) s` describe how its energy is spread over the spectrum.  A product gives two of them,

    mu_2n = 2 t_n.t_n - mu_0        mu_2n+1 = 2 t_n+1.t_n - mu_1        t_n = T_n(X) s

With squares = centre + radius cos(theta) their sum is a density over the angle,

    rho(theta) = (g_0 mu_0 + 2 sum_n g_n mu_n cos(n theta)) / pi

in which Jackson's factors g_n turn each mode into a positive peak, nearly a Gaussian of the standard deviation pi/count (Weisse
et al., Rev. Mod. Phys. 78, 275 (2006)).  If the interval begins at zero, omega = top cos(theta/2): the peak is then
pi/(2 count) sqrt(top^2 - omega^2) wide in frequency, and equally wide at all low ones.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import fft, sparse
from scipy.sparse.linalg import LinearOperator, eigsh
from tqdm import tqdm

from ..stiffness.lowest import CERTAIN, lowest_mode
from ..stiffness.matrices import signed_root

if TYPE_CHECKING:
    from ..stiffness.rest import LinearSystem
    from .stencil import Stencil

    Products: TypeAlias = 'sparse.csr_array | Matrix | Stencil'

BLOCK = 16  # number of vectors yielded at a time
LARGEST_GROWTH = 2.0
"""Largest ratio |T_n s|/|s|: it is at most one if the spectrum lies in the interval, and grows exponentially with n outside."""
MARGIN = 1e-3  # relative amount by which a negative end of the spectrum is moved outwards, because it is known only to round-off
COLUMNS = 8  # number of start vectors that are multiplied at once, so that a product reads the matrix only once for all of them
ROWS = 2**14  # number of rows of the matrix in one piece, so that the product is still in the processor's cache when it is used
LARGE = 8000
"""Number of free directions from which a stencil repays the 0.4 s that it takes to load: a response at 100 frequencies does from
5000 on, a density of states from 20 000 on.  Once it is loaded it is 3 to 7 times as fast as a sparse matrix for any of them."""
BATCH = 2**22  # number of cosines computed at a time
CHANCE = 1e-9  # probability that a random vector does not show a negative eigenvalue, or one that was missed
RISE, ROUGH, PASSES, LOOSE, MISSED = 6.0, 3, 20, 10.0, 6
"""Logarithm by which a filter lifts the lowest eigenvalue above those that it holds down: 4 to 12 take as many products.  Number
of eigenvalues by whose distances filters are chosen.  Restarts of Lanczos iterations, of which 2 to 7 suffice.  A tolerance that
their first pass meets.  Number of modes they may miss."""
TOP, ABOVE = 0.01, 1.02
"""Accuracy of the highest eigenvalue, and how far above it filters end: the largest row sum is 37 % above it in a triangular
lattice.  If an eigenvalue lay beyond, a filter would find that one, and random vectors would show it."""
LONGEST = 1000
"""If a filter needs more products than this, the eigenvalues count as crowded and sparse factors are faster.  Above 200 000
directions the limit grows as the width of the patch, because the lowest eigenvalues lie closer together."""


class Outside(ArithmeticError):
    """The vectors T_n(X) s grow, because s contains modes outside the interval."""


@dataclass(frozen=True)
class Interval:
    """Interval that holds the spectrum."""

    lowest: float
    highest: float

    @property
    def centre(self) -> float:
        return (self.highest + self.lowest) / 2

    @property
    def radius(self) -> float:
        return (self.highest - self.lowest) / 2

    def nodes(self, count: int) -> NDArray[np.float64]:
        """Chebyshev points of the interval, shape (count,)."""
        return self.centre + self.radius * np.cos(np.pi * (np.arange(count) + 0.5) / count)


class Matrix:
    """Products of a sparse symmetric matrix with vectors, shape (size, columns); `stencil.Stencil` is its peer on grids."""

    def __init__(self, K: sparse.csr_array) -> None:
        self._K = K

    @cached_property
    def row_sum(self) -> float:
        """The largest sum of the moduli in a row, which is an upper bound of the highest eigenvalue."""
        return float(abs(self._K).sum(axis=1).max())

    def scaled(self, factor: float, shift: float) -> Matrix:
        """The matrix `factor * (K - shift)`, in the same form."""
        return Matrix(sparse.csr_array((self._K - shift * sparse.eye_array(self._K.shape[0])) * factor))

    def enter(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """A copy of vectors, shape (free, columns), in the form that `advance` takes."""
        return s.copy()

    def leave(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Vectors of coordinates again, the inverse of `enter`."""
        return x

    @cached_property
    def _parts(self):
        return [(np.s_[k : k + ROWS], self._K[k : k + ROWS]) for k in range(0, self._K.shape[0], ROWS)]

    def advance(self, x: NDArray[np.float64], y: NDArray[np.float64], count: int = 1, rows: Any = (),
                taken: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Put K x - y into y, then K y - x into x, and so on; see `Stencil.advance`."""
        sums = np.zeros((2, count, x.shape[1]))
        for n in range(count):
            if taken is not None:
                taken[n] = x[rows].T
            for some, part in self._parts:
                own = y[some]
                np.subtract(part @ x, own, out=own)
                sums[:, n] += np.einsum('ik,ik->k', own, own), np.einsum('ik,ik->k', own, x[some])
            x, y = y, x
        return sums


def products_of(system: LinearSystem) -> Matrix | Stencil:
    """Products with K of a structure: by a stencil if its bonds lie on a grid, and it is large or a stencil is already loaded."""
    loaded = f'{__package__}.stencil' in sys.modules
    if loaded or system.directions >= LARGE:
        from .stencil import stencil_of

        if (stencil := stencil_of(system)) is not None:
            return stencil
    return Matrix(system.K)


def stable_interval(K: Products) -> Interval:
    """Interval from zero to a bound of the highest eigenvalue (the largest row sum), which holds the spectrum of a stable K."""
    return Interval(0.0, _products(K).row_sum or 1.0)


def _products(K: Products) -> Matrix | Stencil:
    return Matrix(K) if isinstance(K, sparse.csr_array) else K


def whole_interval(K: sparse.csr_array) -> Interval:
    """Interval of the eigenvalues of a K that may be unstable; to find the lowest eigenvalue takes two factorisations."""
    return Interval(min(0.0, (1 + MARGIN) * lowest_mode(K)[0]), stable_interval(K).highest)


def coefficients(values: NDArray[Any]) -> NDArray[Any]:
    """Chebyshev coefficients of functions given at the `nodes`, which are the last axis of `values`."""
    c = fft.dct(values, type=2, axis=-1) / values.shape[-1]
    c[..., 0] /= 2
    return c


def sizes(shapes: sparse.csr_array) -> NDArray[np.float64]:
    """Displacement for one unit of each coordinate, in g^-1/2."""
    return np.sqrt(shapes.power(2).sum(axis=0))


def chebyshev_blocks(K: Products, interval: Interval, s: NDArray[np.float64], rows: Any,
                     terms: int | None = None) -> Iterator[NDArray[np.float64]]:
    """Yield the vectors T_n(X) s at the entries `rows`, n = 0, 1 ..., in arrays (BLOCK, columns, rows); `Outside` if they grow.

    All blocks use the same array, which the next block overwrites: a new array would cost time to clear its pages.  On a
    terminal a bar shows progress towards about `terms` vectors.
    """
    X2 = _products(K).scaled(2 / interval.radius, interval.centre)
    length = (s**2).sum(axis=0)
    now, before = X2.enter(s), X2.enter(np.zeros_like(s))
    X2.advance(now, before)
    before /= 2  # T_{-1} = T_1
    block = np.empty((BLOCK, *s[rows].T.shape))
    with tqdm(total=terms, desc='products', delay=2, disable=None, leave=False) as progress:
        while True:
            squared = X2.advance(now, before, BLOCK, rows, block)[0, -1]
            if not (squared <= LARGEST_GROWTH**2 * length).all():
                raise Outside
            progress.update(BLOCK)
            yield block


def spectrum_of(system: LinearSystem, starts: Callable[[], Iterable[NDArray[np.float64]]], count: int,
                progress: tqdm | None = None) -> SpectralMoments:
    """The first `count` moments of start vectors, on the interval from zero or, if it is negative, from the lowest eigenvalue.

    `starts` returns the start vectors, in arrays of the shape (size, columns); `progress` counts them.
    """
    K = products_of(system)
    try:
        return _moments_on(stable_interval(K), K, starts(), count, progress)
    except Outside:  # the structure is unstable
        return _moments_on(whole_interval(system.K), K, starts(), count, progress)


def _moments_on(interval, K, starts, count, progress):
    X2, found = K.scaled(2 / interval.radius, interval.centre), []
    for s in starts:
        found.append(moments(X2, s, count))
        if progress is not None:
            progress.update(s.shape[1])
    return SpectralMoments(interval, np.concatenate(found, axis=1))


def moments(X2: Matrix | Stencil, s: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Moments `s.T_n(X) s` of each column s separately, shape (count, columns); `Outside` if the vectors grow.

    `count` must be even, and count/2 products suffice. X2 is twice the matrix X, whose spectrum lies between -1 and 1.
    """
    before, now, terms = X2.enter(s), X2.enter(np.zeros_like(s)), count // 2
    first = X2.advance(before, now) / np.array([4.0, 2.0])[:, None, None]
    now /= 2
    sums = [np.stack([(s**2).sum(axis=0), 0 * first[1, 0]])[:, None], first]  # t_n.t_n and t_n.t_n-1
    for n in range(2, terms + 1, BLOCK):
        sums.append(X2.advance(now, before, min(BLOCK, terms + 1 - n + (terms + 1 - n) % 2)))
        if not (sums[-1][0] <= LARGEST_GROWTH**2 * sums[0][0]).all():
            raise Outside
    squared, crossed = np.concatenate(sums, axis=1)
    mu = np.empty((count, s.shape[1]))
    mu[::2], mu[1::2] = 2 * squared[:terms] - squared[0], 2 * crossed[1 : terms + 1] - crossed[1]
    return mu


def none_negative(K: Products, size: int, most: int) -> bool:
    """Whether at most `most` products of K with one random vector s show that no eigenvalue is negative.

    If all eigenvalues lay between `low` > 0 and the top, no T_n(X) s would be longer than s.  The part of s along the mode of a
    negative one grows at least as cosh(n arccosh(1 + 2 low/(top - low))), from above CHANCE except with this probability, so
    that enough products show it.  If s grows, `low` was too high, or K is not positive: False if too few products are left to
    tell, which leaves it to a factorisation.
    """
    s, top = np.random.default_rng(0).normal(size=(size, 1)), _products(K).row_sum
    low, enough = top / 32, np.arccosh(LARGEST_GROWTH * np.linalg.norm(s) / CHANCE)
    while top and (count := int(enough / np.arccosh(1 + 2 * low / (top - low))) + 1) <= most:
        with suppress(Outside):
            _moments_on(Interval(low, top), _products(K), [s], 2 * count, None)
            return True
        low /= 2
    return False


class Crowded(ArithmeticError):
    """The lowest eigenvalues are too close together for products to separate them."""


def lowest_by_products(K: Products, size: int, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The lowest eigenvalues of K, ascending, and their eigenvectors, shape (size, count), without factors of K.

    A filter T_d(X), where X is K with the interval from a bound to the top put between -1 and 1, is at most 1 there and rises
    steeply below the bound: the lowest eigenvalues of K, which are crowded, become the few large ones of the filter, and Lanczos
    iterations find them at once.  The top and the first bound follow from both ends of the spectrum, found to a hundredth; the
    next bounds from the distances of ROUGH eigenvalues, by longer and longer filters.

    Then a random vector orthogonal to all modes found is filtered again and again.  It cannot grow, unless a mode was missed: its
    part along one of the `count` lowest would rise from above CHANCE, except with this probability.  What grows is added to the
    modes, as the partners of modes with equal frequencies are.  `Crowded` if this does not end, or if round-off of modes far
    below the others would grow as well.
    """
    if (more := count + count // 2 + 2) >= size:  # so far above the wanted ones nothing may grow
        raise Crowded
    K, random = _products(K), np.random.default_rng(0)
    start = random.normal(size=size)
    top = ABOVE * _highest(lambda v: _times(K, v), start)
    low = top - _highest(lambda v: top * v - _times(K, v), start)
    bound = low + (top - low) / 16
    while True:
        values, vectors, left = _lowest_filtered(_Filter(K, size, low, bound, top), ROUGH, start, LOOSE)
        start, low, width = vectors.sum(axis=1), values[0], values[-1] - values[0]
        if left.max() < width:
            break
        bound = low + ROUGH * width
    bound, start = low + 3 * width * more / ROUGH, random.normal(size=size)
    values, vectors, left = _lowest_filtered(_Filter(K, size, low, bound, top), more, start, CERTAIN)
    for _ in range(MISSED if len(values) > count else 0):
        grown = _orthogonal(random.normal(size=size), vectors)
        filtered, longest = _Filter(K, size, values[count - 1], values[-1], top), np.linalg.norm(grown)
        for _ in range(int(np.log(longest / CHANCE) / np.log(np.cosh(RISE))) + 1):
            with np.errstate(all='ignore'):
                grown = _orthogonal(filtered(grown), vectors)
            if not abs(grown).max() < longest / CHANCE**2:
                raise Crowded
        if np.linalg.norm(grown) <= longest and left[:count].max() <= CERTAIN * K.row_sum:
            return values[:count], vectors[:, :count]
        values, vectors, left = _eigenpairs(K, np.column_stack([vectors, grown / np.linalg.norm(grown)]))
    raise Crowded


def _orthogonal(s, vectors):
    return s - vectors @ (vectors.T @ s)


class _Filter:
    """The function v -> T_d(X) v that is about e^RISE/2 at the eigenvalue `low`, and at most 1 from the `bound` to the top."""

    def __init__(self, K, size, low, bound, top):
        bound = min(bound, (low + top) / 2)  # the wanted modes of a small structure may lie far apart
        self.K, radius, above = K, (top - bound) / 2, bound - low
        with np.errstate(divide='ignore'):
            degree = RISE / np.arccosh(1 + max(above, 0.0) / radius)
        if degree > LONGEST * max(1.0, np.sqrt(size / 2e5)):
            raise Crowded
        self.degree, self.X2 = 2 * int(degree / 2) + 2, K.scaled(2 / radius, bound + radius)

    def __call__(self, v):
        now, before = self.X2.enter(v[:, None]), self.X2.enter(np.zeros((len(v), 1)))
        self.X2.advance(now, before)
        before /= 2  # T_{-1} = T_1
        self.X2.advance(now, before, self.degree)
        return self.X2.leave(now)[:, 0]


def _lowest_filtered(filtered, count, start, tolerance):
    """Eigenvalues of K, its eigenvectors and their residuals, by Lanczos iterations with a filter."""
    operator = LinearOperator((len(start), len(start)), filtered, dtype=float)  # pyright: ignore[reportCallIssue]  its stubs
    try:
        V = eigsh(operator, count, which='LA', v0=start, ncv=count + 10, tol=tolerance, maxiter=PASSES)[1]
    except sparse.linalg.ArpackNoConvergence as error:  # often of the last one, whose neighbour is close or equal
        V = error.eigenvectors
        if not V.size:
            raise Crowded from error
    return _eigenpairs(filtered.K, V)


def _highest(function, start, tolerance: Any = TOP):
    """The highest eigenvalue of a symmetric matrix, given as a function that multiplies it with a vector."""
    operator = LinearOperator((len(start), len(start)), function, dtype=float)  # pyright: ignore[reportCallIssue]  its stubs
    return eigsh(operator, 1, which='LA', v0=start, tol=tolerance, return_eigenvectors=False)[0]


def _times(K, V):
    """K V of vectors, shape (size, columns), or of one, shape (size,)."""
    x = K.enter(V.reshape(len(V), -1))
    y = 0 * x
    K.advance(x, y)
    return K.leave(y).reshape(V.shape)


def _eigenpairs(K, V):
    """Eigenvalues of K between orthonormal vectors, ascending, with eigenvectors and residuals."""
    KV = _times(K, V)
    values, turn = np.linalg.eigh(V.T @ KV)
    V = V @ turn
    return values, V, np.linalg.norm(KV @ turn - V * values, axis=0)


def jackson(count: int) -> NDArray[np.float64]:
    """Jackson's factors g_n, shape (count,)."""
    n, step = np.arange(count), np.pi / (count + 1)
    return ((count - n + 1) * np.cos(n * step) + np.sin(n * step) / np.tan(step)) / (count + 1)


@dataclass(frozen=True, eq=False)
class SpectralMoments:
    """Chebyshev moments of start vectors, from which densities follow at any frequency."""

    interval: Interval  # that contains all squared frequencies, rad^2/ms^2
    moments: NDArray[np.float64]  # shape (count, columns)

    @property
    def grid(self) -> NDArray[np.float64]:
        """Angular frequencies in rad/ms in steps of half the resolved width, and zero. On this grid the trapezoidal rule counts
        every mode, even at an end of the interval, where peaks are narrow.
        """
        count = 2 * len(self.moments)
        return np.union1d(self._frequency(np.pi * (np.arange(count) + 0.5) / count), 0.0)

    def density(self, omega: NDArray[np.float64]) -> NDArray[np.float64]:
        """Density per angular frequency, in ms/rad; its integral is the square of the start vector.

        Parameters
        ----------
        omega : ndarray, shape (frequencies,)
            In rad/ms; negative values stand for imaginary frequencies.

        Returns
        -------
        ndarray, shape (frequencies, columns)
        """
        count = len(self.moments)
        weights = jackson(count)[:, None] * self.moments * np.where(np.arange(count) > 0, 2, 1)[:, None] / np.pi
        theta, n, slope = self._angle(omega), np.arange(count), self._slope(omega)
        parts = [np.cos(np.outer(part, n)) @ weights for part in np.array_split(theta, 1 + theta.size * count // BATCH)]
        return slope[:, None] * np.concatenate(parts)

    def width(self, omega: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standard deviation in rad/ms of the peak that a single mode makes, shape (frequencies,)."""
        theta, sigma = self._angle(omega), np.pi / len(self.moments)
        ends = self._frequency((theta - sigma).clip(0, np.pi)), self._frequency((theta + sigma).clip(0, np.pi))
        return (ends[0] - ends[1]) / 2

    def _angle(self, omega):
        squares = np.sign(omega) * omega**2
        return np.arccos(((squares - self.interval.centre) / self.interval.radius).clip(-1, 1))

    def _frequency(self, theta):
        return signed_root(self.interval.centre + self.interval.radius * np.cos(theta))

    def _slope(self, omega):
        """Derivative |d theta/d omega| = 2 |omega| / sqrt((square - lowest) (highest - square)); zero outside the interval."""
        squares = np.sign(omega) * omega**2
        above, below = squares - self.interval.lowest, self.interval.highest - squares
        lower = np.divide(abs(omega), np.sqrt(abs(above)), out=np.ones(len(omega)), where=above > 0)  # 1 at the end at zero
        return np.divide(2 * lower, np.sqrt(abs(below)), out=np.zeros(len(omega)), where=(above >= 0) & (below > 0))
