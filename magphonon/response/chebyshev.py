"""Functions of a large symmetric matrix, applied to vectors by products with the matrix alone.

On an interval that holds the spectrum of K, a smooth function is a Chebyshev series,

    f(K) s = sum_n c_n T_n(X) s        X = (K - centre)/radius        T_{n+1} = 2 X T_n - T_{n-1}

The vectors T_n(X) s do not depend on f: one sequence of products serves every time of a transient, every frequency of
a response.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import fft, sparse
from tqdm import tqdm

from ..stiffness.lowest import lowest_mode

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Any

    from numpy.typing import NDArray

BLOCK = 16
"""Number of vectors yielded at a time."""
LARGEST_GROWTH = 2.0
"""Largest ratio |T_n s|/|s|: it is at most one if the spectrum lies in the interval, and grows exponentially with n outside."""
MARGIN = 1e-3
"""Relative amount by which a negative end of the spectrum is moved outwards, because it is known only to round-off."""


class Outside(ArithmeticError):
    """The vectors grow: they hold modes outside the interval."""


@dataclass(frozen=True)
class Interval:
    """Interval that holds the spectrum."""

    lowest: float
    highest: float

    @property
    def centre(self) -> float:
        """Middle of the interval."""
        return (self.highest + self.lowest) / 2

    @property
    def radius(self) -> float:
        """Half its length."""
        return (self.highest - self.lowest) / 2

    def nodes(self, count: int) -> NDArray[np.float64]:
        """Chebyshev points of the interval, shape (count,)."""
        return self.centre + self.radius * np.cos(np.pi * (np.arange(count) + 0.5) / count)


def stable_interval(K: sparse.csr_array) -> Interval:
    """Interval from zero to a bound of the highest eigenvalue (the largest row sum), which holds the spectrum of a stable K."""
    return Interval(0.0, float(abs(K).sum(axis=1).max()) or 1.0)


def whole_interval(K: sparse.csr_array) -> Interval:
    """The same from the lowest eigenvalue of an unstable K, which takes two factorisations."""
    return Interval(min(0.0, (1 + MARGIN) * lowest_mode(K)[0]), stable_interval(K).highest)


def coefficients(values: NDArray[Any]) -> NDArray[Any]:
    """Chebyshev coefficients of functions given at the `nodes`, which are the last axis of `values`."""
    c = fft.dct(values, type=2, axis=-1) / values.shape[-1]
    c[..., 0] /= 2
    return c


def twice_scaled(K: sparse.csr_array, interval: Interval) -> sparse.csr_array:
    """2 X = 2 (K - centre)/radius, by which T_{n+1} follows from T_n and T_{n-1}."""
    return sparse.csr_array((K - interval.centre * sparse.eye_array(K.shape[0])) * (2 / interval.radius))


def chebyshev_blocks(K: sparse.csr_array, interval: Interval, s: NDArray[np.float64], rows: Any,
                     terms: int | None = None) -> Iterator[NDArray[Any]]:
    """The vectors T_n(X) s, n = 0, 1, 2 ..., without end; a bar shows how many there are on a terminal after two seconds.

    Parameters
    ----------
    K : sparse array, shape (size, size)
    interval : Interval
    s : ndarray, shape (size, ...)
    rows : index
        The entries that are wanted.
    terms : int, optional
        About how many vectors will be, for the bar.

    Yields
    ------
    ndarray, shape (BLOCK, rows, ...)
        One array for all blocks, which the next one overwrites: the operating system would clear the pages of each new one.

    Raises
    ------
    Outside
        If they grow.
    """
    X2 = twice_scaled(K, interval)
    length = np.linalg.norm(s, axis=0)
    before, now = X2 @ s / 2, s  # T_{-1} = T_1
    block = np.empty((BLOCK, *s[rows].shape), dtype=s.dtype)
    with tqdm(total=terms, desc='products', delay=2, disable=None, leave=False) as progress:
        while True:
            for k in range(BLOCK):
                block[k] = now[rows]
                after = X2 @ now
                after -= before
                before, now = now, after
            if not (np.linalg.norm(now, axis=0) <= LARGEST_GROWTH * length).all():
                raise Outside
            progress.update(BLOCK)
            yield block
