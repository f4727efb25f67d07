"""What ties particles to their places other than springs that stay the same: springs that a wave modulates, laws of the site.

A foundation is a number, an array of spring constants, or a `SiteLaw`.  Every answer of a calculator that does not know the time
is that of the law without its `factor`; time steps multiply the law by it.  What supposes constant springs asks
`calc.foundation`, which refuses here in words; what takes any site asks `calc.site_stiffness`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ..errors import finite, positive
from .sites import of_sites, range_of, site_springs

if TYPE_CHECKING:
    from typing import Any, Self

    from numpy.typing import NDArray


class SiteLaw:
    """Base of `Travelling` and `OnSite`: the energy V of each particle by its displacement d from its anchor.

    Attributes
    ----------
    changes : bool
        Whether the law is multiplied by a `factor` that depends on time.
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

    def factor(self, t: float, anchors: NDArray[np.float64]) -> Any:
        """By what the law is multiplied at the time `t` in ms, one number or one for each anchor (mm, shape (particles, 3))."""
        raise NotImplementedError

    def of(self, particles: int, dim: int) -> Self:
        """The same law, checked for so many particles."""
        raise NotImplementedError

    def on(self, image: NDArray[np.intp]) -> Self:
        """The same law on other sites, of which `image` tells which one each was."""
        raise NotImplementedError


def on_sites(foundation: Any, image: NDArray[np.intp]) -> Any:
    """A foundation of springs or a law on other sites, of which `image` tells which one each was."""
    return foundation.on(image) if isinstance(foundation, SiteLaw) else of_sites(foundation, image)


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
        return f'Travelling({range_of(self.k)}, eps={self.eps:g}, W={self.W:g}, kap={self.kap})'

    def energies(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        return (self.k * d**2).sum(axis=1) / 2

    def gradient(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.k * d

    def stiffness(self, d: NDArray[np.float64]) -> Any:
        return self.k

    def phases(self, anchors: NDArray[np.float64]) -> NDArray[np.float64]:
        """kap.R at each anchor, shape (particles,)."""
        return anchors @ self.kap

    def factor(self, t: float, anchors: NDArray[np.float64]) -> NDArray[np.float64]:
        return 1 + self.eps * np.cos(self.W * t - self.phases(anchors))

    def of(self, particles: int, dim: int) -> Self:
        return replace(self, k=site_springs(self.k, particles, dim))

    def on(self, image: NDArray[np.intp]) -> Self:
        return replace(self, k=of_sites(self.k, image))


def foundation_to_dict(given: Any) -> Any:
    """A foundation as files of ASE hold it."""
    if isinstance(given, Travelling):
        return {'kind': 'Travelling', 'k': given.k, 'eps': given.eps, 'W': given.W, 'kap': given.kap}
    return given


def foundation_from_dict(given: Any) -> Any:
    """The foundation that `foundation_to_dict` wrote."""
    if not isinstance(given, dict):
        return given
    try:
        return Travelling(*(given[name] for name in ('k', 'eps', 'W', 'kap')))
    except KeyError as missing:
        raise ValueError(f'the saved foundation lacks {missing}; write the calculator again') from None
