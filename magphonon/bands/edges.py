"""Edge waves of a ribbon: how much of each mode lies in the rows at its two edges."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import positive
from ..stiffness.constraints import freedom
from .bands import _mean_over_crossings
from .bloch import cell_at_rest

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import NDArray

    from .bands import Bands

ROUND_OFF = 1e-9
"""Relative tolerance of the depth, so that a row exactly at this depth belongs to the edge."""


def edge_weights(atoms: Atoms, bands: Bands, depth: float | None = None) -> NDArray[np.float64]:
    """Share of the kinetic energy of each mode in the rows at the two edges of a ribbon, from 0 to 1.

    An edge wave has most of its energy there, however wide the ribbon is; the share of all other modes falls with the width.
    Where branches cross, as those of two equal edges do, each gets the mean share, because their modes are arbitrary there.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell of the ribbon, periodic in one direction, with the calculator that `bands` were computed with.
    bands : Bands
        Bands of these atoms, computed with vectors=True.
    depth : float, optional
        Distance in mm from the outermost free particle within which rows belong to the edge; by default the shortest bond.

    Returns
    -------
    ndarray, shape (wavevectors, modes, 2)
        The edge on the right of the periodic direction comes first, then that on the left: for a ribbon along x the lower edge
        comes first.

    Raises
    ------
    ValueError
        For atoms that are no ribbon, bands without modes or of other atoms, a depth that is not positive.
    """
    calc, _ = cell_at_rest(atoms)
    if atoms.pbc.sum() != 1:
        raise ValueError(f'only a ribbon has edges: it is periodic in one direction, not in {atoms.pbc.sum()} as these atoms; '
                         'lattices.ribbon cuts one out of a lattice')
    if bands.vectors is None:
        raise ValueError('these bands were computed without modes; ask for them with vectors=True')
    if bands.vectors.shape[2] != len(atoms):
        raise ValueError(f'the bands are those of {bands.vectors.shape[2]} particles, but the ribbon has {len(atoms)}; compute '
                         'them with analytic_bands(atoms, path, vectors=True)')
    depth = float(calc.bonds.lengths.min()) if depth is None else positive('depth', depth, 'mm')
    edges = edge_rows(atoms, depth)
    energy = (abs(bands.vectors) ** 2).sum(axis=3)  # the modes are weighted with the root of the mass
    return _mean_over_crossings(bands.omega, energy @ edges.T)


def edge_rows(atoms: Atoms, depth: float) -> NDArray[np.bool_]:
    """Which free particles lie within `depth` mm of the outermost one, on the right and on the left; shape (2, particles)."""
    along = atoms.cell.array[atoms.pbc][0, :2]
    left = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    across, free = atoms.positions[:, :2] @ left, freedom(atoms)[0]
    reach = depth * (1 + ROUND_OFF)
    return free & np.array([across <= across[free].min() + reach, across >= across[free].max() - reach])
