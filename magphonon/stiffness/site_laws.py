"""The ties of particles to their places: springs, springs modulated by a wave, and other laws of the site.

A foundation is a number, an array of spring constants, or a law. `tie_of` turns each into a law, of `Springs` or a derived class.
A calculator does not know the time, so it uses the constant part of the law; time steps add the forces that are `pumped`. Code
that assumes constant springs uses `calc.foundation`, which refuses other laws with a message; code that accepts any site uses
`calc.site_stiffness`.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import finite, not_negative, positive

Foundation = float | NDArray[np.float64]
"""Stiffness of the springs in N/mm: one number, or shape (particles, dim)."""


class Modulation(NamedTuple):
    """Springs `k(t) = k + 2 Re A e^{iWt}`: the frequency W in rad/ms, the wavevector kap in rad/mm along which A goes as
    e^{-i kap.R} where sites are alike, and A in N/mm, shape (particles, dim).
    """

    W: float
    kap: NDArray[np.float64]
    A: NDArray[np.complex128]


class Springs:
    """Constant springs, and the base of all laws of the sites: the energy V of a particle by its displacement d from its anchor.

    Displacements d and u are in mm, shape (particles, dim).  A law that depends on time overrides `beyond` and sets `changes`.
    A nonlinear law also overrides `gain`, `pull` and `stiffness`.

    Parameters
    ----------
    k : float or array_like
        In N/mm.
    """

    k: Any
    changes: bool | ClassVar[bool] = False
    modulated: ClassVar[bool] = False  # whether `modulation` is its only dependence on time
    known: ClassVar[str] = ''  # which tools support such a law, for a message; empty if all do
    saved: ClassVar[tuple[str, ...]] = ()  # attributes that files hold; empty if they cannot hold the law

    def __init__(self, k: Any) -> None:
        self.k = k

    def stiffness(self, d: NDArray[np.float64]) -> Any:
        """V'' in N/mm: one number, shape (particles, dim), or (particles, dim, dim)."""
        return self.k

    def beyond(self, d: NDArray[np.float64], t: float | None = None, anchors: Any = None) -> Any:
        """The part of V' that exceeds k d, in N, shape (particles, dim), at the time t in ms.

        Without t it is that of the constant part of the law. Anchors are in mm, shape (particles, 3).
        """
        return 0.0

    def gradient(self, d: NDArray[np.float64]) -> NDArray[np.float64]:
        """V' in N, shape (particles, dim)."""
        return self.beyond(d) + self.k * d

    def gain(self, slack: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Change of V by displacements u from rest, where d = slack, in mJ, shape (particles,)."""
        return np.einsum('ix,ix->i', self.k * (0.5 * u + slack), u)

    def pull(self, slack: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Change of V' by displacements u from rest, where d = slack, in N, shape (particles, dim)."""
        return self.k * u

    def pumped(self, d: NDArray[np.float64], t: float, anchors: NDArray[np.float64]) -> Any:
        """Part of the force -V' that depends on the time t, in N, shape (particles, dim)."""
        return self.beyond(d) - self.beyond(d, t, anchors)

    def modulation(self, anchors: NDArray[np.float64]) -> Modulation | None:
        """The modulation of the springs, if they depend on time in this way only; otherwise None."""
        return None

    @property
    def stiffest(self) -> Any:
        """A constant foundation as stiff as this one ever becomes, as far as that is known."""
        return self.k if self.changes else self

    def springs(self, what: str = 'this') -> Any:
        """The constant springs, or ValueError for another law, which the tool `what` does not support."""
        if self.known:
            raise ValueError(f'{what} needs a foundation of constant springs, not {self!r}: {self.known}')
        return self.k

    def of(self, particles: int, dim: int) -> Self:
        """The same law, checked for a structure of `particles` particles."""
        return self._on(site_springs(self.k, particles, dim))

    def on(self, image: NDArray[np.intp]) -> Self:
        """The same law on other sites; `image` gives the original index of each."""
        return self._on(of_sites(self.k, image))

    def times(self, factors: NDArray[np.float64]) -> Self:
        """The law of each site multiplied by a number of its own, shape (particles,)."""
        return self._on(factors[:, None] * self.k)

    def _on(self, k):
        other = copy(self)
        vars(other)['k'] = k  # the laws derived from this one are frozen
        return other


def tie_of(foundation: Any) -> Springs:
    """The law of a foundation: the foundation itself if it is a law, or `Springs` with these constants in N/mm."""
    return foundation if isinstance(foundation, Springs) else Springs(foundation)


def kept(law: Springs) -> Any:
    """The form in which sites store a law: springs as their constants, other laws as they are."""
    return law if law.known else law.k


def site_springs(foundation: Any, particles: int, dim: int) -> Foundation:
    """The foundation in N/mm as one number if it is uniform, otherwise as an array, shape (particles, dim), read-only."""
    if np.ndim(foundation) == 0:
        return not_negative('foundation', foundation, 'N/mm')
    given = finite('foundation', foundation)
    for where in np.argwhere(given < 0)[:1]:
        not_negative(f'foundation{where.tolist()}', given[tuple(where)], 'N/mm')
    shapes = (particles,), (particles, 1), (1, dim), (particles, dim)
    if given.shape not in shapes:
        raise ValueError(f'the foundation must be one number, or have one of the shapes {", ".join(map(str, shapes))} for its '
                         f'{particles} particles in {dim} dimensions, not {given.shape}')
    springs = np.broadcast_to(given[:, None] if given.ndim == 1 else given, (particles, dim)).copy()
    if (springs == springs[0, 0]).all():
        return float(springs[0, 0])
    springs.flags.writeable = False
    return springs


def of_sites(values: Any, sites: NDArray[np.intp] | slice) -> Any:
    """The `values` at some sites; they are given for each site, or as one number for all."""
    return values[sites] if np.ndim(values) else values


def range_of(values: Foundation) -> str:
    """The text for `repr`: the number if there is only one, otherwise the lowest and the highest value of all sites."""
    return repr(values) if np.ndim(values) == 0 else f'<{np.min(values):.4g} to {np.max(values):.4g}>'


def each_spring(foundation: Foundation, particles: int, dim: int) -> NDArray[np.float64]:
    """Stiffness of the foundation along each component of the displacements, shape (particles * dim,), in N/mm."""
    return np.broadcast_to(foundation, (particles, dim)).ravel()


def site_blocks(stiffness: Any, particles: int, dim: int) -> NDArray[np.float64]:
    """Stiffness of each site as a tensor, shape (particles, dim, dim), from tensors or from springs along the components."""
    if np.ndim(stiffness) == 3:
        return np.broadcast_to(stiffness, (particles, dim, dim))
    return each_spring(stiffness, particles, dim).reshape(particles, dim, 1) * np.eye(dim)


@dataclass(frozen=True, eq=False, repr=False)
class Travelling(Springs):
    """Springs modulated by a wave: `k_i(t) = k [1 + eps cos(W t - kap.R_i)]`, with R_i the anchor of particle i.

    Waves that run with the modulation and against it couple to different waves, so that gaps open on one side only [1]_. Where
    the frequencies of two waves add up to W, both waves grow. `floquet_bands` finds gaps and growth; time steps follow the
    modulation.

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
    >>> cell.calc.site_stiffness  # tools without a time use the mean
    5.0
    """

    k: Any
    eps: float
    W: float
    kap: Any
    changes: ClassVar[bool] = True
    modulated: ClassVar[bool] = True
    saved: ClassVar[tuple[str, ...]] = ('k', 'eps', 'W', 'kap')
    known: ClassVar[str] = 'use floquet_bands or time steps (DrivenVerlet), or take its mean springs, foundation=k'

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

    @property
    def stiffest(self) -> Any:
        return (1 + self.eps) * self.k

    def beyond(self, d: NDArray[np.float64], t: float | None = None, anchors: Any = None) -> Any:
        return 0.0 if t is None else self.eps * np.cos(self.W * t - anchors @ self.kap)[:, None] * self.k * d

    def modulation(self, anchors: NDArray[np.float64]) -> Modulation:
        return Modulation(self.W, np.array(self.kap), self.eps / 2 * np.exp(-1j * (anchors @ self.kap))[:, None] * self.k)


@dataclass(frozen=True, eq=False, repr=False)
class OnSite(Springs):
    """Energy V(d) of each particle as a function of its displacement d from its anchor: a potential with several wells, a
    stiffness tensor or a magnet below.

    Linear tools use V'' at rest, time steps the whole law. With a function of the time g, as for electromagnets, the energy is
    `g(t) V(d)`.

    Parameters
    ----------
    energy, slope, curvature : callable
        V in mJ, V' in N and V'' in N/mm, of shapes (particles,), (particles, dim) and (particles, dim, dim), of displacements in
        mm, shape (particles, dim).  `OnSite.along` and `OnSite.tensor` make them.
    k : float or array_like
        Additional springs, given like a foundation.
    g : callable, optional
        Function of the time in ms that returns one number, or one for each particle. A calculator, which does not know the time,
        uses g = 1; linear tools refuse such a law.

    K : array_like, optional
        The matrix of `OnSite.tensor`.
    share : float or array_like, shape (particles,)
        Factor of V at each site.

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
    share: Any = 1.0
    known: ClassVar[str] = 'use bands, modes, responses or time steps (DrivenVerlet)'

    @classmethod
    def along(cls, direction: ArrayLike, V: Callable[[Any], Any], dV: Callable[[Any], Any], d2V: Callable[[Any], Any],
              k: Any = 0.0, g: Callable[[float], Any] | None = None) -> Self:
        """A law from V(u), V'(u) and V''(u) of the displacement u along a direction, functions of arrays in mJ, N and N/mm."""
        n = finite('direction', direction)
        n = n / np.linalg.norm(n)
        nn = np.outer(n, n)
        return cls(lambda d: V(d @ n), lambda d: dV(d @ n)[:, None] * n, lambda d: d2V(d @ n)[:, None, None] * nn, k, g)

    @classmethod
    def tensor(cls, K: ArrayLike, g: Callable[[float], Any] | None = None) -> Self:
        """A law V = d.K.d/2 with a symmetric K for all or each particle, shape (dim, dim) or (particles, dim, dim), in N/mm."""
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
        return self.share * self.energy(d) + (self.k * d**2).sum(axis=1) / 2

    def gain(self, slack: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.energies(slack + u) - self.energies(slack)

    def pull(self, slack: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.gradient(slack + u) - self.gradient(slack)

    def stiffness(self, d: NDArray[np.float64]) -> Any:
        return (self.share * self.curvature(d).T).T + site_blocks(self.k, *d.shape)

    def beyond(self, d: NDArray[np.float64], t: float | None = None, anchors: Any = None) -> Any:
        return (self.share * (1.0 if t is None or self.g is None else self.g(t)) * self.slope(d).T).T

    def of(self, particles: int, dim: int) -> Self:
        zero = np.zeros((particles, dim))
        try:
            for name, shape in (('energy', (particles,)), ('slope', (particles, dim)), ('curvature', (particles, dim, dim))):
                finite(f'{name} of the law of the sites at their anchors', getattr(self, name)(zero), shape)
        except (IndexError, TypeError) as error:
            raise ValueError(f'the law of the sites does not accept displacements of shape {zero.shape}: {error}') from None
        return super().of(particles, dim)

    def on(self, image: NDArray[np.intp]) -> Self:
        law = type(self).tensor(self.K[image], self.g) if np.ndim(self.K) == 3 else self
        return replace(law, k=of_sites(self.k, image), share=of_sites(self.share, image))

    def times(self, factors: NDArray[np.float64]) -> Self:
        return replace(super().times(factors), share=factors * self.share)


def foundation_to_dict(given: Any) -> Any:
    """A foundation in the form that files of ASE can hold; for a law made of functions, only its name."""
    law: Any = tie_of(given)
    if getattr(law, 'K', None) is not None and not law.changes:  # a tensor
        return {'kind': 'tensor', 'K': law.K, 'k': law.k, 'share': law.share}
    return {'kind': type(law).__name__} | {name: getattr(law, name) for name in law.saved} if law.known else law.k


def foundation_from_dict(given: Any) -> Any:
    """The foundation that `foundation_to_dict` wrote."""
    if not isinstance(given, dict):
        return given
    if given.get('kind') == 'tensor' and given.keys() >= {'K', 'k', 'share'}:
        return replace(OnSite.tensor(given['K']), k=given['k'], share=given['share'])
    law = {law.__name__: law for law in Springs.__subclasses__() if law.saved}.get(given.get('kind', Travelling.__name__))
    if law is None:
        raise ValueError('the law of the sites is made of functions in Python, which no file holds; make the calculator again')
    try:
        return law(*(given[name] for name in law.saved))
    except KeyError as missing:
        raise ValueError(f'the saved foundation lacks {missing}; write the calculator again') from None
