"""Properties that may differ between the sites of a structure: the stiffness of the foundation, the strength of the particle.

Where all sites are alike the foundation stays a single number, and the computation is as fast as with one spring for all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import finite, not_negative
from ..interactions.bond_laws import BondLaws, taken

if TYPE_CHECKING:
    from typing import Any

    from ase import Atoms
    from numpy.typing import ArrayLike, NDArray

    from ..interactions.pair_laws import PairLaw
    from ..lattices.bonds import Bonds
    from .repulsion import Repulsion

    Foundation = float | NDArray[np.float64]
    """Stiffness of the springs in N/mm: one number, or shape (particles, dim)."""


def displacement_components(reference: Atoms, foundation: Any) -> int:
    """Number of components of a displacement: 3 in space, and in a plane if the foundation has three components."""
    return 3 if reference.pbc.all() or np.shape(foundation)[1:] == (3,) else 2


def site_springs(foundation: Any, particles: int, dim: int, layer: bool = False) -> Foundation:
    """The foundation as one number if it is uniform, otherwise as an array, shape (particles, dim), read-only.

    For a `layer` it is always an array: its foundation has three components, so that the particles move out of their plane.

    Parameters
    ----------
    foundation : float or array_like, shape (particles,), (particles, 1), (1, dim) or (particles, dim)
        Stiffness in N/mm; in one dimension one number per particle.

    Raises
    ------
    ValueError
        For another shape, or a number that is negative or not finite.
    """
    if np.ndim(foundation) == 0 and not layer:
        return not_negative('foundation', foundation, 'N/mm')
    given = finite('foundation', foundation)
    for where in np.argwhere(given < 0)[:1]:
        not_negative(f'foundation{where.tolist()}', given[tuple(where)], 'N/mm')
    shapes = (particles,), (particles, 1), (1, dim), (particles, dim), *([()] if layer else [])
    if given.shape not in shapes:
        raise ValueError(f'the foundation must be one number, or have one of the shapes {", ".join(map(str, shapes))} for its '
                         f'{particles} particles in {dim} dimensions, not {given.shape}')
    springs = np.broadcast_to(given[:, None] if given.ndim == 1 else given, (particles, dim)).copy()
    if (springs == springs[0, 0]).all() and not layer:
        return float(springs[0, 0])
    springs.flags.writeable = False
    return springs


def site_strengths(strengths: ArrayLike, particles: int) -> NDArray[np.float64]:
    """The strengths of the particles, read-only; each a finite number, zero or above, or ValueError."""
    given = finite('strengths', strengths, (particles,)).copy()
    for k in np.flatnonzero(given < 0)[:1]:
        not_negative(f'strengths[{k}]', given[k])
    given.flags.writeable = False
    return given


def of_sites(values: Any, sites: NDArray[np.intp]) -> Any:
    """The `values` at some sites; they are given for each site, or as one number for all."""
    return values[sites] if np.ndim(values) else values


def range_of(values: Foundation) -> str:
    """The text for `repr`: the number if there is only one, otherwise the lowest and the highest value of all sites."""
    return repr(values) if np.ndim(values) == 0 else f'<{np.min(values):.4g} to {np.max(values):.4g}>'


def each_spring(foundation: Foundation, particles: int, dim: int) -> NDArray[np.float64]:
    """Stiffness of the foundation along each component of the displacements, shape (particles * dim,), in N/mm."""
    return np.broadcast_to(foundation, (particles, dim)).ravel()


def refuse_infinite(law: PairLaw, bonds: Bonds) -> None:
    """Refuse a law whose force or stiffness at the length of some bond is not a finite number."""
    r = bonds.lengths
    for what, unit, value in (('force', 'N', -np.asarray(law.dphi(r))), ('stiffness', 'N/mm', np.asarray(law.d2phi(r)))):
        for b in np.flatnonzero(~np.isfinite(value))[:1]:
            own = taken(law, b)
            raise ValueError(f'the potential {own.laws[0] if isinstance(own, BondLaws) else own!r} gives the {what} {value[b]} '
                             f'{unit} at the distance {r[b]:g} mm of the particles {bonds.i[b]} and {bonds.j[b]}; check its '
                             'parameters and their units (mm, N)')


def refuse_unlike(calc: Repulsion, tool: str, instead: str) -> None:
    """Refuse particles that differ in law, strength or foundation, for a `tool` that supposes them to be equal.

    Parameters
    ----------
    tool : str
        Name of the tool, as the subject of a sentence.
    instead : str
        What the user can do instead.
    """
    unlike = [what for what, differs in (('laws or strengths', isinstance(calc.law, BondLaws)),
                                         ('foundations', np.ndim(calc.foundation) > 0)) if differs]
    if unlike:
        raise ValueError(f'{tool} supposes one law and one foundation for all particles, but these have different '
                         f'{" and ".join(unlike)}; {instead}')
