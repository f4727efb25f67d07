"""Checks of positions: whether atoms match the reference of a calculator and stay in its plane; the minimum image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import NDArray

    from ..lattices.bonds import Bonds
    from .repulsion import Repulsion

OUT_OF_PLANE = 0.1
"""Largest displacement of a finite difference, as a fraction of the shortest bond; a larger one out of the plane is refused."""
ROUND_OFF = 1e-12
"""Fraction of the largest momentum below which a momentum along z is round-off of a direction in the plane."""

FLAT = 1e-9
"""Largest spread of z in a plane, as a fraction of the shortest bond; a larger one is no round-off of positions."""


def refuse_height(atoms: Atoms, bonds: Bonds, dim: int, upright: bool) -> None:
    """Refuse planar particles (`dim` 2), or `upright` magnets, whose z differ; periodic images count."""
    height = max(np.ptp(atoms.positions[:, 2]), abs(bonds.vectors[:, 2]).max())
    if height <= FLAT * bonds.lengths.min():
        return
    if dim == 2:
        raise ValueError(f'planar particles must share one z, but z ranges over {height:g} mm, periodic images included; '
                         'a structure in space is periodic along three vectors')
    if upright:
        raise ValueError(f'upright magnets stand on a plane, but z ranges over {height:g} mm; give them one z')


def refuse_load_along_z(load: NDArray[np.float64]) -> None:
    """Refuse a dead load (N, shape (particles, 3)) that pushes a particle of a planar structure along z."""
    if load[:, 2].any():
        raise ValueError(f'the load pushes particle {np.flatnonzero(load[:, 2])[0]} along z, but the structure is planar; give '
                         'it a direction in the plane')


def from_reference(calc: Repulsion, atoms: Atoms) -> NDArray[np.float64]:
    """Vectors from the reference of a calculator to the positions of `atoms` in mm, shape (particles, 3), in any image.

    Raises
    ------
    ValueError
        If the atoms differ from the reference in number, cell or periodicity, or a position is not finite.
    """
    reference = calc.reference
    if len(atoms) != len(reference):
        raise ValueError(f'the calculator was made for {len(reference)} particles, not {len(atoms)}; '
                         'make one for this structure, or use calculator.on(supercell)')
    if not (np.array_equal(atoms.cell.array, reference.cell.array) and np.array_equal(atoms.pbc, reference.pbc)):
        raise ValueError('the cell or its periodicity differs from the reference, to which the particles are anchored; make a '
                         'calculator for this cell, or, where neither foundation nor load holds them, atoms.calc.about(atoms)')
    u = atoms.positions - reference.positions
    if not np.isfinite(u).all():
        raise ValueError(f'the position of particle {np.argwhere(~np.isfinite(u))[0, 0]} is not a finite number')
    return u


def shortest_period(reference: Atoms) -> float:
    """Length of the shortest lattice vector in mm; infinite for a finite structure."""
    from ase.geometry import minkowski_reduce

    periodic = reference.pbc
    reduced = minkowski_reduce(reference.cell.array, periodic)[0]  # pyright: ignore[reportArgumentType]  three pbc
    return np.linalg.norm(np.asarray(reduced)[periodic], axis=1).min(initial=np.inf)


def minimum_image(u: NDArray[np.float64], reference: Atoms, shortest: float) -> NDArray[np.float64]:
    """The shortest of the vectors `u`, shape (particles, 3), in the periodic directions; `shortest` is the `shortest_period`."""
    if np.einsum('ix,ix->i', u, u).max(initial=0) > shortest**2 / 4:  # below it u is its own minimum image
        from ase.geometry import find_mic

        u = find_mic(u, reference.cell, reference.pbc)[0]  # pyright: ignore[reportArgumentType]  three pbc
    return u


def out_of_plane(atoms: Atoms) -> NDArray[np.bool_]:
    """Which particles move along z, shape (particles,)."""
    if 'momenta' not in atoms.arrays:
        return np.zeros(len(atoms), bool)
    momenta = abs(atoms.arrays['momenta'])
    return ~(momenta[:, 2] <= ROUND_OFF * momenta.max(initial=0.0))


def refuse_motion_out_of_the_plane(calc: Repulsion, atoms: Atoms) -> None:
    """Refuse particles of a planar structure that leave its plane.

    No force acts along z: particles that were rattled or heated along z would drift away, with a third of the heat.
    """
    height = abs(atoms.positions[:, 2] - calc.reference.positions[:, 2])
    away, moving = height > OUT_OF_PLANE * calc.bonds.lengths.min(initial=np.inf), out_of_plane(atoms)
    for k in np.flatnonzero(away | moving)[:1]:
        what = f'is {height[k]:g} mm out of the plane' if away[k] else 'moves out of the plane'
        raise ValueError(f'particle {k} {what}, but the structure is planar: nothing acts along z. Hold it there with '
                         'atoms.set_constraint([*atoms.constraints, FixedPlane(range(len(atoms)), (0, 0, 1))]), '
                         'before it is rattled or given velocities')
