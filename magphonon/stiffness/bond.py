"""The interaction of two particles as a function of the vector R between them: energy, gradient, stiffness D0 + D* (Eq. 3).

`Central` is the force along the bond, from a law of the distance: its method `stiffness` is Eq. 3.  If forces depend on more than
the distance, as between upright magnets that leave their plane, the law itself is a function of the vector (`PairInteraction`).
`Mixed` holds the interactions of bonds that differ. Calling code uses one of these three, and need not know which.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import Diverged, one_of
from ..interactions.bond_laws import Law, Laws, laid, laws_along
from ..interactions.pair_laws import PairInteraction, PairLaw
from ..lattices.bonds import Bonds, lengths_of

Model = Literal['complete', 'conventional']
MODELS: tuple[Model, ...] = ('complete', 'conventional')
CONTACT, BROKEN_BOND = 1 / 3, 3.0
"""Ratios of a bond to its rest length outside which its law is not trusted. Below the first its particles have collided: the
repulsion of magnets is a hundred times that at rest. Above the second it is broken: two other particles fit between its ends, and
the repulsion of magnets has fallen below a hundredth."""
STEP = 1e-20  # relative size of a complex step: no difference is taken, so it may be as small as numbers allow


@dataclass(frozen=True, eq=False)
class Central:
    """The interaction of two particles with a force along the line between them, by phi, phi' and phi''."""

    law: PairLaw

    def forces(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Energy `phi` and its gradient `phi' n`."""
        r = _lengths(R)
        return self.law.phi(r), (self.law.dphi(r) / r)[:, None] * R

    def stiffness(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Eq. 3 of the paper: `D0 = phi'' n(x)n` and `D* = phi'/r (1 - n(x)n)`.

        The paper prints both with minus signs, because there phi_r is the repulsion f, which here is -phi'.
        """
        r = _lengths(R)
        n = np.ascontiguousarray(R.T) / r  # the bonds last in memory: loops over two or three components take five times as long
        nn = n[:, None] * n
        D0 = self.law.d2phi(r) * nn
        Dstar = self.law.dphi(r) / r * (np.eye(len(n))[..., None] - nn)
        return D0.T, Dstar.T

    def central(self, dim: int) -> PairLaw:
        """The pair law, a function of the distance."""
        return self.law


@dataclass(frozen=True, eq=False)
class Mixed:
    """Interactions that differ from bond to bond: `strength` times one of the `parts`, of the distance over `scale`.

    Attributes
    ----------
    parts : tuple of PairInteraction
    which : ndarray of int, shape (bonds,)
        Index of the part of each bond.
    strength : ndarray, shape (bonds,)
    scale : ndarray, shape (bonds,), or None for the distance itself
    """

    parts: tuple[PairInteraction, ...]
    which: NDArray[np.intp]
    strength: NDArray[np.float64]
    scale: NDArray[np.float64] | None

    def forces(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Energy and gradient of each bond."""
        return self._each('forces', R)

    def stiffness(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """D0 and D* of each bond."""
        return self._each('stiffness', R)

    def central(self, dim: int) -> PairLaw | None:
        """The law of each bond's length (`BondLaws`), if all parts have one."""
        laws = tuple(part.central(dim) for part in self.parts)
        return None if None in laws else laid(laws, self.which, self.strength, self.scale)  # pyright: ignore[reportArgumentType]

    def _each(self, method, R):
        found = []
        for k, part in enumerate(self.parts):
            own = np.flatnonzero(self.which == k)
            answers = getattr(part, method)(R[own])
            found = found or [np.empty((len(R), *answer.shape[1:]), answer.dtype) for answer in answers]
            for every, answer in zip(found, answers, strict=True):
                every[own] = (self.strength[own] * answer.T).T
        return found[0], found[1]


def interaction_of(law: Law, dim: int) -> PairInteraction:
    """The interaction for vectors of `dim` components: `Central` if the force is along the bond, else the law itself."""
    given: Any = law
    found = given.central(dim) if hasattr(given, 'central') else given
    return given if found is None else Central(found)


def interaction_along(laws: Laws, bonds: Bonds, kinds: NDArray[np.intp], strengths: NDArray[np.float64], dim: int,
                      radii: NDArray[np.float64] | None = None) -> PairInteraction:
    """The interaction of all bonds; see `laws_along`."""
    each, which, strength = laws_along(laws, bonds.i, bonds.j, kinds, strengths)
    scale = None if radii is None else radii[bonds.i] + radii[bonds.j]
    for k, law in enumerate(each):
        if radii is not None and hasattr(law, 'between'):
            own = which == k
            strength[own] *= law.between(radii[bonds.i[own]], radii[bonds.j[own]])
    acting = interaction_of(Mixed(tuple(interaction_of(law, dim) for law in each), which, strength, scale), dim)
    if scale is not None and acting.central(dim) is None:
        raise ValueError('a law of the distance over the sum of both radii acts along the line between two particles; leave out '
                         f'the radii, or take another law than {laws!r}')
    return acting


def bond_stiffness(vectors: NDArray[np.float64], law: Law) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Stiffness of each bond, split as in Eq. 3 of the paper, where the sign of phi is the opposite.

    Parameters
    ----------
    vectors : ndarray, shape (bonds, dim)
        Bond vectors in mm.
    law : PairLaw or PairInteraction
        One law for all bonds, or the interactions of the bonds of a calculator, `calc.interaction`.

    Returns
    -------
    D0, Dstar : ndarray, shape (bonds, dim, dim)
        In N/mm.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower
    >>> from magphonon.stiffness import bond_stiffness
    >>> D0, Dstar = bond_stiffness(np.array([[1.0, 0.0]]), InversePower(1.0, 4.0))
    >>> D0[0].tolist()  # phi'' along the bond
    [[4.0, 0.0], [0.0, 0.0]]
    >>> (Dstar[0] + 0).tolist()  # phi'/r across it
    [[0.0, 0.0], [0.0, -1.0]]
    """
    return interaction_of(law, vectors.shape[1]).stiffness(vectors)


def model_stiffness(vectors: NDArray[Any], law: Law, model: Model = 'complete') -> NDArray[Any]:
    """Stiffness of each bond in the given model: `D0 + D*`, or `D0` alone; see `bond_stiffness`."""
    D0, Dstar = bond_stiffness(vectors, law)
    return D0 if one_of('model', model, MODELS) == 'conventional' else D0 + Dstar


def stiffness_change(vectors: NDArray[np.float64], change: NDArray[np.float64], law: Law,
                     model: Model = 'complete') -> NDArray[np.float64]:
    """Derivative of the stiffness of bonds along a change of their vectors, by a complex step: exact to round-off.

    Parameters
    ----------
    vectors, change : ndarray, shape (bonds, dim)
        In mm.
    law, model
        As for `model_stiffness`.

    Returns
    -------
    ndarray, shape (bonds, dim, dim)
        In N/mm per unit of the change.
    """
    return np.imag(model_stiffness(vectors + 1j * STEP * change, law, model)) / STEP


def sizes(vectors: NDArray[np.float64], law: Law) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Size of the force of each bond in N and of its stiffness against stretching in N/mm; for a central law |phi'|, |phi''|."""
    acting = interaction_of(law, vectors.shape[1])
    if isinstance(acting, Central):
        r = _lengths(vectors)
        return abs(acting.law.dphi(r)), abs(acting.law.d2phi(r))
    return np.linalg.norm(acting.forces(vectors)[1], axis=1), abs(np.einsum('bxx->b', acting.stiffness(vectors)[0]))


def upper_part(vectors: NDArray[np.float64], law: Law, model: Model = 'complete') -> NDArray[np.float64]:
    """Upper bound of the stiffness of each bond in N/mm, shape (bonds, dim, dim): its negative eigenvalues are set to zero."""
    acting = interaction_of(law, vectors.shape[1])
    if not isinstance(acting, Central):
        values, n = np.linalg.eigh(model_stiffness(vectors, acting, model))
        return n * np.maximum(values, 0)[:, None] @ n.swapaxes(1, 2)
    r = _lengths(vectors)
    along, n = np.maximum(acting.law.d2phi(r), 0), (vectors.T / r).T
    across = 0 * r if model == 'conventional' else np.maximum(acting.law.dphi(r) / r, 0)
    K = np.einsum('b,bx,by->bxy', along - across, n, n)
    np.einsum('bxx->bx', K)[:] += across[:, None]
    return K


def displaced(bonds: Bonds, R: NDArray[np.float64], moved: NDArray[np.float64], interaction: PairInteraction,
              model: Model) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """The bond vectors at which an interaction is evaluated, and the directions of its gradient in the conventional model.

    In the complete model the vectors are `R + moved`, and the directions are None. In the conventional model the vectors are
    projected on the directions n at rest, and n is returned too.

    Raises Diverged for a bond that is squeezed below CONTACT or stretched beyond BROKEN_BOND times its rest length, unless it
    exerts no force there, as between spheres that have parted.
    """
    vectors = R + moved
    r0 = lengths_of(R) if model == 'conventional' else 1.0
    n = (R.T / r0).T if model == 'conventional' else None
    along = _product(vectors if n is None else n, vectors)
    nearest = along.min(initial=np.inf)
    if not nearest > 0:
        b = along.argmin()
        apart = along[b] if model == 'conventional' else np.sqrt(along[b])
        raise ValueError(f'particles {bonds.i[b]} and {bonds.j[b]} coincide or have passed through each other '
                         f'(distance {apart:g} mm along their bond); start from smaller displacements')
    if n is not None:
        vectors = (1 + _product(n, moved) / r0)[:, None] * R  # R itself at rest, to the last bit
    power = 2 if n is None else 1
    least, most = (CONTACT * bonds.longest) ** power, (BROKEN_BOND * bonds.shortest) ** power
    if not (least < nearest and along.max(initial=0.0) < most):  # some bond may be out of range, so look at each
        _refuse_far(bonds, along ** (1 / power), vectors, interaction)
    return vectors, n


def _refuse_far(bonds, r, vectors, interaction):
    """Raise Diverged for a bond whose length `r` is out of range and whose interaction acts at the `vectors`."""
    out = (r < CONTACT * bonds.lengths) | (r > BROKEN_BOND * bonds.lengths)
    if not out.any():
        return
    with suppress(ValueError):  # of a law that refuses one of the lengths
        out &= interaction.forces(vectors)[1].any(axis=1)
    for b in np.flatnonzero(out)[:1]:
        raise Diverged(bonds.i[b], None, f'is {r[b]:g} mm from its neighbour {bonds.j[b]} instead of {bonds.lengths[b]:g} mm')


def _product(a: Any, b: Any) -> Any:
    """Scalar products of vectors in rows, summed by columns: this is faster, and rounding does not depend on memory layout."""
    return sum(x * y for x, y in zip(a.T, b.T, strict=True))


def _lengths(R):
    """Lengths of vectors, which may be complex; ValueError if a length is zero or infinite."""
    r = np.sqrt(_product(R, R))
    for k in np.flatnonzero(~((r.real > 0) & (r.real < np.inf)))[:1]:
        raise ValueError(f'bond {k} has the vector {R[k]} mm; a bond joins two particles at a finite distance')
    return r
