"""Stiffness of one bond, D0 + D* (Eq. 4), against stretching and rotation, and the two models."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import one_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..interactions.pair_laws import PairLaw

MODELS = ('complete', 'conventional')


def bond_stiffness(vectors: NDArray[np.float64], law: PairLaw) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Stiffness of each bond, split as in Eq. 4 of the paper.

    Parameters
    ----------
    vectors : ndarray, shape (bonds, dim)
        Bond vectors in mm.
    law : PairLaw
        The one of all bonds, or laid along them (`magphonon.interactions.BondLaws`), as `calc.law`.

    Returns
    -------
    D0, Dstar : ndarray, shape (bonds, dim, dim)
        In N/mm.

    Raises
    ------
    ValueError
        If a vector has no length.

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
    r, nn = _lengths_and_axes(vectors)
    D0 = law.d2phi(r) * nn
    Dstar = law.dphi(r) / r * (np.eye(vectors.shape[1]) - nn)
    return D0, Dstar


def _lengths_and_axes(vectors):
    """Length r and n(x)n of each bond, shapes (bonds, 1, 1) and (bonds, dim, dim)."""
    r = np.linalg.norm(vectors, axis=1)[:, None, None]
    for k in np.flatnonzero(~((r > 0) & (r < np.inf)))[:1]:
        raise ValueError(f'bond {k} has the vector {vectors[k]} mm; a bond joins two particles at a finite distance')
    n = vectors / r[:, 0]
    return r, n[:, :, None] * n[:, None, :]


def model_stiffness(vectors: NDArray[np.float64], law: PairLaw, model: str = 'complete') -> NDArray[np.float64]:
    """Stiffness of each bond in the given model: `D0 + D*`, or `D0` alone; see `bond_stiffness`.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower
    >>> from magphonon.stiffness import model_stiffness
    >>> np.diag(model_stiffness(np.array([[1.0, 0.0]]), InversePower(1.0, 4.0))[0]).tolist()
    [4.0, -1.0]
    """
    if one_of('model', model, MODELS) == 'conventional':
        r, nn = _lengths_and_axes(vectors)
        return law.d2phi(r) * nn
    D0, Dstar = bond_stiffness(vectors, law)
    return D0 + Dstar
