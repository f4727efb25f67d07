"""What ties particles to their places other than springs that stay the same: springs that a wave modulates, laws of the site.

A foundation is a number, an array of spring constants, or a `SiteLaw`.  A calculator, which does not know the time, answers for
the law that stays the same; time steps add what is `pumped`.  What supposes constant springs asks `calc.foundation`, which
refuses here in words; what takes any site asks `calc.site_stiffness`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import finite, positive
from .sites import of_sites, range_of, site_blocks, site_springs


class SiteLaw:
    """Base of `Travelling` and `OnSite`: the energy V of each particle by its displacement d from its anchor.

    A law that `changes` depends on time.
    """

    changes: bool | ClassVar[bool]
    known: ClassVar[str]  # what knows such a law, for a message

    def energies(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        """V in mJ, shape (particles,), at `d` in mm, shape (particles, dim)."""
        raise NotImplementedError

    def gradient(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        """V' in N, shape (particles, dim)."""
        raise NotImplementedError

    def stiffness(self, d: NDArray[np.float64]) -> Any:
        """V'' in N/mm: one number, shape (particles, dim), or (particles, dim, dim)."""
        raise NotImplementedError

    def pumped(self, d: NDArray[np.float64], t: float, anchors: NDArray[np.float64]) -> NDArray[np.float64]:
        """What the time `t` in ms adds to the force -V' in N, shape (particles, dim); anchors in mm, shape (particles, 3)."""
        raise NotImplementedError

    @property
    def stiffest(self) -> Any:
        """A foundation that stays the same and is as stiff as this one ever is, as far as that is known."""
        return self

    def of(self, particles: int, dim: int) -> Self:
        """The same law, checked for so many particles."""
        raise NotImplementedError

    def on(self, image: NDArray[np.intp]) -> Self:
        """The same law on other sites, of which `image` tells which one each was."""
        raise NotImplementedError


def springs_of(foundation: Any, what: str = 'this') -> Any:
    """A foundation of constant springs, or ValueError for another one, of which `what` knows nothing."""
    if isinstance(foundation, SiteLaw):
        raise ValueError(f'{what} supposes that constant springs tie the particles to their places, but {foundation!r} does: '
                         f'{foundation.known}')
    return foundation


def refuse_changes(calc: Any, what: str) -> None:
    """Refuse a foundation that changes with time, of which `what` sees nothing."""
    law = calc.sites.foundation
    if isinstance(law, SiteLaw) and law.changes:
        raise ValueError(f'{what} know no time, but {law!r} changes with it: {law.known}')


@dataclass(frozen=True, eq=False, repr=False)
class Travelling(SiteLaw):
    """Springs modulated by a wave: `k_i(t) = k [1 + eps cos(W t - kap.R_i)]`, with R_i the anchor of particle i.

    Waves that run with the modulation and against it meet other partners, so that bands open gaps on one side only [1]_; where
    the frequencies of two waves add up to W, they grow together.  `floquet_bands` finds both; time steps move it.

    Parameters
    ----------
    k : float or array_like, shape (particles,), (1, dim) or (particles, dim)
        Mean stiffness in N/mm, as a foundation of springs.
    eps : float
        Depth of the modulation, from 0 to 1.
    W : float
        Its angular frequency in rad/ms.
    kap : array_like, shape (2,) or (3,)
        Its wavevector in rad/mm; zero for springs that all change together.

    References
    ----------
    .. [1] Y. Wang et al., Phys. Rev. Lett. 121, 194301 (2018), arXiv:1803.11503.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, Travelling, lattices
    >>> cell = lattices.chain(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=Travelling(5.0, 0.1, W=0.3, kap=(2.0, 0)))
    >>> cell.calc.site_stiffness  # what does not know the time sees the mean
    5.0
    """

    k: Any
    eps: float
    W: float
    kap: Any
    changes: ClassVar[bool] = True
    known: ClassVar[str] = 'floquet_bands and time steps (DrivenVerlet) know it; for the mean springs set foundation=k'

    def __post_init__(self) -> None:
        if not 0 <= finite('eps', self.eps, ()) <= 1:
            raise ValueError(f'the depth eps of a modulation must be between 0 and 1, not {self.eps!r}')
        positive('W', self.W, 'rad/ms')
        kap = finite('kap', self.kap)
        if kap.shape not in ((2,), (3,)):
            raise ValueError(f'kap must be a wavevector of 2 or 3 components in rad/mm, not {self.kap!r}')
        object.__setattr__(self, 'kap', tuple(np.append(kap, np.zeros(3 - len(kap))).tolist()))

    def __repr__(self) -> str:
        kap = ', '.join(f'{x:.6g}' for x in np.round(self.kap, 12))
        return f'Travelling({range_of(self.k)}, eps={self.eps:g}, W={self.W:g}, kap=({kap}))'

    def energies(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        return (self.k * d**2).sum(axis=1) / 2

    def gradient(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.k * d

    def stiffness(self, d: NDArray[np.float64]) -> Any:
        return self.k

    @property
    def stiffest(self) -> Any:
        return (1 + self.eps) * self.k

    def phases(self, anchors: NDArray[np.float64]) -> NDArray[np.float64]:
        """kap.R at each anchor, shape (particles,)."""
        return anchors @ self.kap

    def pumped(self, d: NDArray[np.float64], t: float, anchors: NDArray[np.float64]) -> NDArray[np.float64]:
        return -self.eps * np.cos(self.W * t - self.phases(anchors))[:, None] * self.k * d

    def of(self, particles: int, dim: int) -> Self:
        return replace(self, k=site_springs(self.k, particles, dim))

    def on(self, image: NDArray[np.intp]) -> Self:
        return replace(self, k=of_sites(self.k, image))


@dataclass(frozen=True, eq=False, repr=False)
class OnSite(SiteLaw):
    """Energy V(d) of each particle by its displacement d from its anchor: several wells, a tensor, a magnet below.

    Linear tools take V'' at rest, time steps the whole law.  A function of the time makes it `g(t) V(d)`: electromagnets.

    Parameters
    ----------
    energy, slope, curvature : callable
        V in mJ, V' in N and V'' in N/mm, of shapes (particles,), (particles, dim) and (particles, dim, dim), of displacements in
        mm, shape (particles, dim).  `OnSite.along` and `OnSite.tensor` make them.
    k : float or array_like
        Springs beside it, as a foundation.
    g : callable, optional
        One number, or one for each particle, by the time in ms.  A calculator, which knows no time, takes 1; linear tools refuse.

    K : array_like, optional
        Of `OnSite.tensor`.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, OnSite, analytic_bands, lattices
    >>> cell = lattices.chain(1.0, 1.0)
    >>> wells = OnSite.along((1, 0), lambda u: u**4 / 4 - u**2 / 2, lambda u: u**3 - u, lambda u: 3 * u**2 - 1, k=[[3.0, 5.0]])
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=wells)
    >>> (analytic_bands(cell, 'GX').omega[0] ** 2).round(9).tolist()  # 3 - 1 along the chain, 5 across it
    [2.0, 5.0]
    """

    energy: Callable[[Any], Any]
    slope: Callable[[Any], Any]
    curvature: Callable[[Any], Any]
    k: Any = 0.0
    g: Callable[[float], Any] | None = None
    K: Any = None
    known: ClassVar[str] = 'bands, modes, responses and time steps (DrivenVerlet) know it'

    @classmethod
    def along(cls, direction: ArrayLike, V: Callable[[Any], Any], dV: Callable[[Any], Any], d2V: Callable[[Any], Any],
              k: Any = 0.0, g: Callable[[float], Any] | None = None) -> Self:
        """V(u), V'(u) and V''(u) of the displacement u along a direction, functions of arrays in mJ, N and N/mm."""
        n = finite('direction', direction)
        n = n / np.linalg.norm(n)
        nn = np.outer(n, n)
        return cls(lambda d: V(d @ n), lambda d: dV(d @ n)[:, None] * n, lambda d: d2V(d @ n)[:, None, None] * nn, k, g)

    @classmethod
    def tensor(cls, K: ArrayLike, g: Callable[[float], Any] | None = None) -> Self:
        """V = d.K.d/2 with a symmetric K for all or for each particle, shape (dim, dim) or (particles, dim, dim), in N/mm."""
        K = finite('K', K)
        if K.ndim not in (2, 3) or K.shape[-1] != K.shape[-2] or abs(K - K.swapaxes(-1, -2)).max() > 1e-12 * abs(K).max():
            raise ValueError(f'K must be a symmetric matrix, shape (dim, dim), or one for each particle, not of shape {K.shape}')
        return cls(lambda d: np.einsum('...x,...xy,...y->...', d, K, d) / 2, lambda d: np.einsum('...xy,...y->...x', K, d),
                   lambda d: np.broadcast_to(K, (len(d), *K.shape[-2:])), 0.0, g, K)

    @property
    def changes(self) -> bool:
        return self.g is not None

    @property
    def stiffest(self) -> Any:
        return replace(self, g=None)

    def __repr__(self) -> str:
        what, when = 'V' if self.K is None else 'tensor', ', changing with time' if self.changes else ''
        return f'OnSite({what}, k={range_of(self.k)}{when})'

    def energies(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.energy(d) + (self.k * d**2).sum(axis=1) / 2

    def gradient(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.slope(d) + self.k * d

    def stiffness(self, d: NDArray[np.float64]) -> Any:
        return self.curvature(d) + site_blocks(self.k, *d.shape)

    def factor(self, t: float) -> Any:
        """The number, or one for each particle, by which V is multiplied at the time `t`."""
        return 1.0 if self.g is None else self.g(t)

    def pumped(self, d: NDArray[np.float64], t: float, anchors: NDArray[np.float64]) -> NDArray[np.float64]:
        return ((1 - self.factor(t)) * self.slope(d).T).T

    def of(self, particles: int, dim: int) -> Self:
        zero = np.zeros((particles, dim))
        try:
            for name, shape in (('energy', (particles,)), ('slope', (particles, dim)), ('curvature', (particles, dim, dim))):
                finite(f'{name} of the law of the sites at their anchors', getattr(self, name)(zero), shape)
        except (IndexError, TypeError) as error:
            raise ValueError(f'the law of the sites does not take displacements of shape {zero.shape}: {error}') from None
        return replace(self, k=site_springs(self.k, particles, dim))

    def on(self, image: NDArray[np.intp]) -> Self:
        if np.ndim(self.K) == 3:
            return type(self).tensor(self.K[image], self.g)
        return replace(self, k=of_sites(self.k, image))


def foundation_to_dict(given: Any) -> Any:
    """A foundation as files of ASE hold it."""
    if isinstance(given, Travelling):
        return {'kind': 'Travelling', 'k': given.k, 'eps': given.eps, 'W': given.W, 'kap': given.kap}
    return {'kind': 'OnSite'} if isinstance(given, OnSite) else given


def foundation_from_dict(given: Any) -> Any:
    """The foundation that `foundation_to_dict` wrote."""
    if not isinstance(given, dict):
        return given
    if given.get('kind') == 'OnSite':
        raise ValueError('the law of the sites is made of functions in Python, which no file holds; make the calculator again')
    try:
        return Travelling(*(given[name] for name in ('k', 'eps', 'W', 'kap')))
    except KeyError as missing:
        raise ValueError(f'the saved foundation lacks {missing}; write the calculator again') from None
