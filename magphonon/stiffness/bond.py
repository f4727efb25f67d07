"""Stiffness of one bond against stretching and rotation, D0 + D* (Eq. 4), in the complete and the conventional model.

For motion out of its plane a flat lattice has only D*: phi'/r for a force along the bond, or that of upright magnets.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import one_of
from ..interactions.bond_laws import UprightMagnets

if TYPE_CHECKING:
    from typing import TypeGuard

    from numpy.typing import NDArray

    from ..interactions.pair_laws import PairLaw
    from ..lattices.bonds import Bonds

MODELS = ('complete', 'conventional')


def bond_stiffness(vectors: NDArray[np.float64], law: PairLaw) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Stiffness of each bond, split as in Eq. 4 of the paper.

    Parameters
    ----------
    vectors : ndarray, shape (bonds, dim)
        Bond vectors in mm.
    law : PairLaw
        One law for all bonds, or the laws of the bonds (`magphonon.interactions.BondLaws`), as `calc.law`.

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
    if leaves_the_plane(law, vectors):
        return _upright_stiffness(vectors, law)
    r, nn = _lengths_and_axes(vectors)
    D0 = law.d2phi(r) * nn
    Dstar = law.dphi(r) / r * (np.eye(vectors.shape[1]) - nn)
    return D0, Dstar


def displaced(bonds: Bonds, rest: tuple[NDArray[np.float64], ...], moved: NDArray[np.float64],
              model: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lengths of displaced bonds that enter the law, and the directions along which the force acts, in a model of the forces.

    Parameters
    ----------
    bonds : Bonds
    rest : three ndarrays, shapes (bonds, dim), (bonds,) and (bonds, dim)
        Vectors R and lengths r0 of the bonds at rest in mm, and their unit vectors n.
    moved : ndarray, shape (bonds, dim)
        Relative displacement of the ends of each bond in mm.
    model : {'complete', 'conventional', 'literal'}

    Returns
    -------
    lengths : ndarray, shape (bonds,)
        In mm.
    directions : ndarray, shape (bonds, dim)
        Unit vectors.

    Raises
    ------
    ValueError
        If two bonded particles coincide or have passed through each other.
    """
    R, r0, n = rest
    vectors = R + moved
    if model == 'conventional':
        lengths = r0 + np.einsum('bx,bx->b', n, moved)
    else:
        lengths = np.sqrt(np.einsum('bx,bx->b', vectors, vectors))
    if lengths.size and not lengths.min() > 0:
        b = lengths.argmin()
        raise ValueError(f'particles {bonds.i[b]} and {bonds.j[b]} coincide or have passed through each other '
                         f'(distance {lengths[b]:g} mm along their bond); start from smaller displacements')
    return lengths, vectors / lengths[:, None] if model == 'complete' else n


def leaves_the_plane(law: PairLaw, vectors: NDArray[np.float64]) -> TypeGuard[UprightMagnets]:
    """Whether bonds of these vectors move out of the plane by the law of `UprightMagnets`."""
    return isinstance(law, UprightMagnets) and vectors.shape[1] == 3


def refuse_upright(vectors: NDArray[np.float64], law: PairLaw, what: str) -> None:
    """Refuse upright magnets that leave the plane, because `what` supposes forces along the line between two particles."""
    if leaves_the_plane(law, vectors):
        raise ValueError(f'{what} of UprightMagnets that move out of the plane are not known; take the motion in the plane, '
                         'atoms.calc = atoms.calc.in_plane()')


def upright_forces(vectors: NDArray[np.float64], law: UprightMagnets) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Energy of upright magnets, `phi + g z^2/2`, and its gradient.

    Parameters
    ----------
    vectors : ndarray, shape (bonds, 3)
        In mm.
    law : UprightMagnets

    Returns
    -------
    energy : ndarray, shape (bonds,)
        In mJ.
    gradient : ndarray, shape (bonds, 3)
        In N.
    """
    z, rho = vectors[:, 2], np.hypot(vectors[:, 0], vectors[:, 1])
    g, slope = law.vertical(rho), law.vertical_derivatives(rho)[0]
    gradient = np.column_stack([((law.dphi(rho) + slope * z**2 / 2) / rho)[:, None] * vectors[:, :2], g * z])
    return law.phi(rho) + g * z**2 / 2, gradient


def _upright_stiffness(vectors, law):
    """D0 and the rest of the second derivatives of `phi + g z^2/2`."""
    e, z = np.array([0.0, 0.0, 1.0]), vectors[:, 2, None, None]
    flat = vectors * (1 - e)
    r, nn = _lengths_and_axes(flat)
    n, vertical = flat / r[:, 0], np.outer(e, e)
    g, (slope, curvature) = law.vertical(r), (f[:, None, None] for f in law.vertical_derivatives(r[:, 0, 0]))
    ne = n[:, :, None] * e
    D0 = law.d2phi(r) * nn
    Dstar = ((law.dphi(r) + slope * z**2 / 2) / r * (np.eye(3) - vertical - nn) + curvature * z**2 / 2 * nn
             + slope * z * (ne + ne.swapaxes(1, 2)) + g * vertical)
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
        r, nn = _lengths_and_axes(vectors * [1, 1, 0] if leaves_the_plane(law, vectors) else vectors)
        return law.d2phi(r) * nn
    D0, Dstar = bond_stiffness(vectors, law)
    return D0 + Dstar
