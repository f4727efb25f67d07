"""The properties of each site of a structure, `Sites`: the strength of its particle, its spring, its load, its gyration. Checks
refuse positions that do not belong to a calculator or lie out of its plane, numbers that are not finite, and missing units.

If all sites are alike the foundation stays a single number, and computations are as fast as with one spring for all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import finite, not_negative, one_of, positive

if TYPE_CHECKING:
    from ase import Atoms

    from ..lattices.bonds import Bonds
    from .repulsion import Repulsion

RAYLEIGH, HEAVY = 33 / 140, 5.0
"""Share of the mass m of a cantilever that moves with its tip while it bends as under a static force, and 3 m omega^2/k above
which this is off by more than a percent of the stiffness."""
Foundation = float | NDArray[np.float64]
"""Stiffness of the springs in N/mm: one number, or shape (particles, dim)."""
OUT_OF_PLANE = 0.1  # largest displacement of a finite difference, in shortest bonds; one beyond is refused out of the plane
ROUND_OFF = 1e-12  # fraction of the largest momentum below which a momentum along z is round-off of a direction in the plane
LIGHT = 1e-3  # 3 m omega^2/k of a cantilever below which Rayleigh's mass is exact, and other formulas are round-off
RODS = 'rod_masses'
"""Array of atoms with the moving mass in g of the rod under each particle, 33/140 of the whole, which the masses include."""
FLAT = 1e-9  # largest spread of z in a plane, as a fraction of the shortest bond; a larger one is no round-off of positions


def _by(checked: Callable[[Any, Atoms, int], Any], settable: bool = False, seldom: bool = False) -> dict[str, Any]:
    """How a property is checked, whether `calc.set` changes it, and whether files omit it where it is zero."""
    return {'checked': checked, 'settable': settable, 'seldom': seldom}


def cantilever_excess(x: Any) -> tuple[Any, Any]:
    """By how much the stiffness of a cantilever at its tip, in static ones, exceeds 1 - 33/420 x, and the slope of this by ln x.

    Its mass m makes x = 3 m omega^2/k.  With z^4 = x the stiffness is z^3/3 (1 + cos z cosh z)/(sin z cosh z - cos z sinh z):
    zero at the resonance of the cantilever alone, x = 12.4, and infinite where its tip is a node, x = 237.7.

    Examples
    --------
    >>> from magphonon.stiffness.sites import cantilever_excess
    >>> [round(float(cantilever_excess(x)[0]), 3) for x in (0.1, 5.0, 12.362)]  # Rayleigh's mass is right, nearly so, and off
    [-0.0, -0.005, -0.029]
    """
    x = np.maximum(x, LIGHT)
    z = x**0.25
    c, s, C, S = np.cos(z), np.sin(z), np.cosh(z), np.sinh(z)
    across = s * C - c * S
    stiffness = z**3 / 3 * (1 + c * C) / across
    by_z = 3 * stiffness - x / 3 - 2 * z * stiffness * s * S / across
    return stiffness - 1 + RAYLEIGH / 3 * x, by_z / 4 + RAYLEIGH / 3 * x


@dataclass(frozen=True, eq=False)
class Sites:
    """The individual properties of the sites of a structure, each as an array whose first axis is that of the sites.

    If all sites are alike a property may be one number.  A new property needs only a field here and a keyword of the calculator:
    supercells, defects, replicas, copies and files then carry it.  The masses are those of `ase.Atoms`.
    """

    strengths: Any = field(default=None, metadata=_by(lambda given, atoms, dim: site_strengths(given, len(atoms))))
    anchors: Any = field(default=None, metadata=_by(lambda given, atoms, dim: site_anchors(given, atoms)))
    load: Any = field(default=None, metadata=_by(lambda given, atoms, dim: site_load(given, len(atoms), dim)))
    foundation: Any = field(default=0.0, metadata=_by(lambda given, atoms, dim: site_springs(given, len(atoms), dim),
                                                      settable=True))
    gyration: Any = field(default=0.0, metadata=_by(lambda given, atoms, dim: site_gyration(given, len(atoms), dim),
                                                    settable=True, seldom=True))
    radii: Any = field(default=None, metadata=_by(lambda given, atoms, dim: site_radii(given, len(atoms)), seldom=True))

    @classmethod
    def names(cls, **wanted: bool) -> tuple[str, ...]:
        """The properties that are, or are not, `settable` or saved `seldom`."""
        return tuple(f.name for f in fields(cls) if all(f.metadata[what] == so for what, so in wanted.items()))

    def checked(self, reference: Atoms, dim: int) -> Self:
        """A copy with read-only arrays over the particles of a reference; raises ValueError where they do not fit."""
        return replace(self, **{f.name: f.metadata['checked'](getattr(self, f.name), reference, dim) for f in fields(self)})

    def has(self, name: str) -> bool:
        """Whether a property differs from zero at some site."""
        return bool(np.any(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.anchors)

    def __getitem__(self, image: Any) -> Self:
        """The properties at the sites that `image` (indices, mask or slice) selects from these."""
        return replace(self, **{name: of_sites(value, image) for name, value in vars(self).items()})

    def joined(self, others: Sequence[Sites]) -> Self:
        """The properties at these sites and then at those of others."""
        every = [self, *others]
        return replace(self, **{name: _joined([getattr(sites, name) for sites in every], [len(sites) for sites in every])
                                for name in self.names()})


def _joined(values, sizes):
    first = values[0]
    if np.ndim(first) == 0 and all(value is first for value in values):
        return first
    width = max((np.shape(value)[1:] for value in values), key=len)
    each = [np.reshape(value, (-1, *(np.shape(value)[1:] or (1,) * len(width)))) for value in values]
    return np.concatenate([np.broadcast_to(value, (size, *width)) for value, size in zip(each, sizes, strict=True)])


def site_anchors(anchors: ArrayLike | None, reference: Atoms) -> NDArray[np.float64]:
    """Where the springs are slack, shape (particles, 3), read-only: by default the positions of the reference themselves."""
    found = reference.positions if anchors is None else finite('anchors', anchors, (len(reference), 3)).copy()
    found.flags.writeable = False
    return found


def site_load(load: ArrayLike | None, particles: int, dim: int) -> NDArray[np.float64]:
    """The dead load in N, shape (particles, 3), read-only; ValueError if it pushes planar particles out of their plane."""
    if load is None:
        return np.broadcast_to(0.0, (particles, 3))
    given = finite('load', load, (particles, 3)).copy()
    for k in np.flatnonzero(given[:, 2])[:1] if dim == 2 else ():
        raise ValueError(f'the load pushes particle {k} along z, but the structure is planar; give it a direction in the plane')
    given.flags.writeable = False
    return given


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


def displacement_components(reference: Atoms, foundation: Any, dim: int | None = None, bonds: Bonds | None = None) -> int:
    """Number of components of a displacement, if not given: 3 in space, and in a plane if the foundation has three components.

    A structure is in space if it is periodic in three directions, or its particles stand at different heights.
    """
    if dim is not None:
        return one_of('dim', dim, (2, 3))
    high = bonds is not None and height(reference, bonds) > FLAT * bonds.shortest
    return 3 if high or reference.pbc.all() or np.shape(foundation)[1:] == (3,) else 2


def height(atoms: Atoms, bonds: Bonds) -> float:
    """Spread of z in mm, periodic images included."""
    return max(np.ptp(atoms.positions[:, 2]), abs(bonds.vectors[:, 2]).max(initial=0.0))


def site_strengths(strengths: ArrayLike | None, particles: int) -> NDArray[np.float64]:
    """The strengths of the particles, read-only, 1 by default; finite numbers of either sign, or ValueError."""
    if strengths is None:
        return np.broadcast_to(1.0, particles)
    given = finite('strengths', strengths, (particles,)).copy()
    given.flags.writeable = False
    return given


def site_radii(radii: ArrayLike | None, particles: int) -> NDArray[np.float64] | None:
    """The radii of the particles in mm, read-only; None where the law is one of the distance itself."""
    if radii is None:
        return None
    given = np.broadcast_to(finite('radii', radii), particles).copy()
    positive('the smallest of the radii', given.min(), 'mm')
    given.flags.writeable = False
    return given


def site_gyration(gyration: ArrayLike, particles: int, dim: int) -> Foundation:
    """The gyration along z in rad/ms as one number if it is uniform, otherwise as an array, shape (particles,), read-only.

    In space it may also be a vector, (3,) or (1, 3), or one for each particle: shape (particles, 3).
    """
    given = finite('gyration', gyration)
    vectors = ((3,), (1, 3), (particles, 3)) if dim == 3 else ()
    if given.shape not in ((), (particles,), *vectors) or (given.shape == (3,) and dim == particles == 3):
        raise ValueError(f'the gyration must be one number, or one for each of the {particles} particles, '
                         f'{"or a vector, shape (1, 3) for all or a row for each, " if dim == 3 else ""}not of the shape '
                         f'{given.shape}')
    if given.shape in vectors:
        given = np.broadcast_to(given, (particles, 3))
        if not given[:, :2].any():  # along z
            given = given[:, 2]
    if given.ndim < 2 and (given == given.ravel()[:1]).all():
        return float(given.ravel()[0])
    given = given.copy()
    given.flags.writeable = False
    return given


def gyration_blocks(gyration: Any, dim: int) -> NDArray[np.float64]:
    """Blocks of B for the force m u' x g with the gyration g of each site, shape (1 or particles, dim, dim), in 1/ms."""
    g = np.asarray(gyration)
    g = g if g.ndim == 2 else np.outer(g, [0.0, 0.0, 1.0])
    return -np.cross(np.eye(3), g[:, None]).swapaxes(1, 2)[:, :dim, :dim]


def refuse_height(atoms: Atoms, bonds: Bonds, dim: int, central: bool) -> None:
    """Raise ValueError for particles at different z if they are planar (`dim` 2) or forces are not `central`; images count."""
    z = height(atoms, bonds)
    if z <= FLAT * bonds.shortest:
        return
    if dim == 2:
        raise ValueError(f'planar particles must share one z, but z ranges over {z:g} mm, periodic images included; give them '
                         'one z, or omit dim=2 in Python, so that they move in space')
    if not central:
        raise ValueError('particles whose forces are not along the line between them, such as upright magnets, stand on a plane, '
                         f'but z ranges over {z:g} mm; give them one z')


def same(a: NDArray[Any], b: NDArray[Any]) -> bool:
    """Whether small arrays are equal; to compare their bytes first takes a fifth of the time of `numpy.array_equal`."""
    return a.tobytes() == b.tobytes() or np.array_equal(a, b)


def from_reference(calc: Repulsion, atoms: Atoms, dim: int = 3) -> NDArray[np.float64]:
    """Vectors from the reference of a calculator to the positions of `atoms`, mm, shape (particles, dim), not by minimum image.

    The particles are last in memory: with the components last, sums over them take five times as long.
    """
    reference = calc.reference
    if len(atoms) != len(reference):
        raise ValueError(f'the calculator was made for {len(reference)} particles, not {len(atoms)}; make a calculator for this '
                         'structure, or use calculator.on(supercell)')
    if not (same(atoms.cell.array, reference.cell.array) and same(atoms.pbc, reference.pbc)):
        raise ValueError('the cell or its periodicity differs from the reference, to which the particles are anchored; make a '
                         'calculator for this cell, or, where neither foundation nor load holds them, atoms.calc.about(atoms)')
    if not (np.isfinite(atoms.positions.sum()) or np.isfinite(atoms.positions).all()):  # the sum takes a third of the time
        raise ValueError(f'the position of particle {np.argwhere(~np.isfinite(atoms.positions))[0, 0]} is not a finite number')
    return np.array([x - rest for x, rest in zip(atoms.positions.T[:dim], reference.positions.T, strict=False)]).T


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
    away, moving = height > OUT_OF_PLANE * calc.bonds.shortest, out_of_plane(atoms)
    for k in np.flatnonzero(away | moving)[:1]:
        what = f'is {height[k]:g} mm out of the plane' if away[k] else 'moves out of the plane'
        raise ValueError(f'particle {k} {what}, but the structure is planar: nothing acts along z. Hold it there with '
                         'atoms.set_constraint([*atoms.constraints, FixedPlane(range(len(atoms)), (0, 0, 1))]), '
                         'before it is rattled or given velocities')
