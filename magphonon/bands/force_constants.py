"""Bands by the second method: force constants by phonopy, from finite displacements and the calculator's forces.

Nothing analytic enters here.  phonopy displaces the particles of a supercell one by one; the forces on all the
others, divided by the displacement, are its force constants FC = -(D0 + D*) between bonded particles.

The force constants are never symmetrised: phonopy imposes the acoustic sum rule in most of its default paths, which makes moving
the whole lattice cost nothing and so erases the foundation. Here the sum rule is a measurement instead: the row sums of the force
constants *are* the foundation stiffness.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms
from ase.dft.kpoints import BandPath
from ase.geometry import minkowski_reduce
from numpy.typing import ArrayLike, NDArray
from tqdm import tqdm

from .. import units
from ..errors import positive, whole
from ..stiffness.matrices import signed_root
from ..stiffness.rest import LinearSystem, freedom
from ..traits import LIKE, takes
from .bands import Bands, path_of

if TYPE_CHECKING:
    from phonopy import Phonopy

    from ..stiffness.repulsion import Repulsion

TO_HZ = units.hertz(1)  # phonopy's unit conversion factor: from the root of N/(mm g), rad/ms, to Hz
DISTANCE = 1e-5
"""Default displacement in shortest bonds.

The error of the bands, relative to the highest frequency, is (2 to 20) (distance/bond)^2 from the curvature of the law
and about 5e-17 bond/distance from round-off; they meet at 2e-6 with 5e-11.  The default lies on the safe side: the
first is a share of each frequency, the second does not vanish towards zero frequency.
"""
SHARES = 1.0, 0.1, 0.01, 1e-3, 1e-4
"""Fractions of `DISTANCE` that are tried, the largest first, for a law that changes over a shorter length than its bonds, such as
that of spheres in contact with a small overlap. Below the last one round-off takes more than 1e-7 of the highest frequency."""
STRAIGHT = 1e-7
"""Change of the stiffness over one displacement, as a fraction of the stiffest bond, below which the law counts as straight: the
second difference of phi''. An inverse power r^-30 passes with the first of the `SHARES`."""
ROUND_OFF = 1e-8
"""Fraction of the largest force constant below which force constants along z are round-off.  Forces that do not cancel at rest
are differences of large numbers over a displacement of 1e-5 bonds and leave up to 1e-11; for a lattice in space the fraction is
of the order of one."""
SAME_PLACE = 1e-6
"""Distance, as a fraction of the shortest bond, below which phonopy is told that two particles are one; its own default is 1e-5
of any unit of length."""


@takes(*LIKE, 'all neighbours')
def finite_displacements(atoms: Atoms, supercell: ArrayLike | None = None, distance: float | None = None) -> Phonopy:
    """Force constants from forces on displaced particles, as a phonopy.Phonopy that works in mm, g, N and Hz.

    phonopy can use the symmetry of the positions to save displacements. This is switched off, because the forces may have less
    symmetry (a chain in the plane does not act along z, bonds may be listed explicitly), and the search costs more than it saves.

    Particles held by FixAtoms are hidden from phonopy: its cell contains only the free ones, in the same order. The row sums of
    the force constants then contain the foundation and the springs to the held particles.

    Where phonopy multiplies by Planck's constant, it assumes that frequencies are in THz: multiply `unit_conversion_factor` by
    1e-12 before, and give a `cutoff_frequency` such as 1e-14. Its own `save` loses the unit: use `write_phonopy_params`.

    Parameters
    ----------
    atoms : ase.Atoms
        One periodic cell with its PairCalculator or AllNeighbours; displacements start from the calculator's reference.
    supercell : int, three ints or array_like of ints, shape (3, 3), optional
        Number of cells along each lattice vector, 1 along directions that are not periodic; one number counts for all others. A
        matrix is phonopy's, whose columns hold the vectors of the supercell. By default the smallest supercell in which no bond
        spans half of it. With AllNeighbours no supercell is large enough: the bands are then right at the wavevectors that fit
        the supercell, and interpolated between them.
    distance : float, optional
        Displacement in mm, to both sides, from 1e-12 to 0.1 of the shortest bond. By default 1e-5 of the shortest bond, or
        less if the stiffness changes over so short a length (`SHARES`), as between spheres that barely touch; for other laws
        this gives bands to 1e-9 of the highest frequency (see `DISTANCE`).

    Returns
    -------
    phonopy.Phonopy
        With force constants in N/mm and frequencies in Hz.  Nothing is read from a file or written to one.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, finite_displacements, lattices
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=2.0)
    >>> phonon = finite_displacements(cell, supercell=(3, 3, 1))
    >>> phonon.force_constants.shape
    (1, 9, 3, 3)
    """
    try:
        from phonopy import Phonopy
        from phonopy.structure.atoms import PhonopyAtoms
    except ModuleNotFoundError:
        raise ModuleNotFoundError('finite_displacements needs phonopy, which is not installed: pip install phonopy; '
                                  'analytic_bands gives the same bands without it') from None

    calc, free = _cell_calculator(atoms)
    rest = calc.reference
    matrix = np.diag(enough_cells(calc)) if supercell is None else checked_supercell(calc, supercell)
    distance = default_distance(calc) if distance is None else _checked_distance(distance, calc.bonds.lengths.min())

    moving, held = atoms[free], rest[~free]
    cell = PhonopyAtoms(symbols=moving.get_chemical_symbols(), masses=moving.get_masses(), cell=rest.cell.array,
                        positions=rest.positions[free])
    phonon = Phonopy(cell, matrix, primitive_matrix='P', is_symmetry=False,
                     symprec=SAME_PLACE * calc.bonds.lengths.min())
    phonon.unit_conversion_factor = TO_HZ
    phonon.generate_displacements(distance, is_plusminus=True, is_diagonal=False)

    displaced = _supercell_atoms(phonon, rest.pbc)
    if len(held):
        from ase.build import make_supercell  # late: it loads all readers of ASE

        displaced += make_supercell(held, matrix.T)
    displaced.calc = calc.on(displaced)  # phonopy's order of particles, not that of `repeat`
    forces = []
    for structure in tqdm(phonon.supercells_with_displacements, desc='displacements', delay=2, disable=None, leave=False):
        displaced.positions[: len(structure)] = structure.positions
        forces.append(displaced.get_forces(apply_constraint=False)[: len(structure)])
    phonon.forces = forces
    phonon.produce_force_constants(calculate_full_force_constants=False)
    return phonon


def _cell_calculator(atoms):
    """The calculator of a cell that phonopy can take, and which particles move, shape (particles,)."""
    if not atoms.pbc.any():
        raise ValueError('the structure is not periodic and has no bands; displace the unit cell from which it was made')
    calc: Any = LinearSystem.of(atoms).moving().atoms.calc
    for guide in atoms.constraints:
        if not isinstance(guide, FixAtoms):
            raise ValueError(f'phonopy moves particles in every direction, but the cell holds the constraint {guide}; remove it, '
                             'or use analytic_bands')
    calc.displacements(atoms)  # refuses atoms that are not those of the reference
    if 'X' in atoms.symbols:
        raise ValueError(f"phonopy refuses the symbol 'X' of particle {atoms.symbols.search('X')[0]}; "
                         "name an element, atoms.symbols = 'Nd', and set the masses again")
    if not calc.reference.cell.rank == 3:
        raise ValueError(f'phonopy needs three lattice vectors, not {calc.reference.cell.rank}; along each direction that is not '
                         'periodic, give the cell a vector of about two spacings, then make the calculator')
    return calc, freedom(atoms)[0]


def enough_cells(calc: Repulsion) -> NDArray[np.int_]:
    """Smallest numbers of cells that hold more than two bond lengths between lattice planes, 1 where not periodic."""
    planes = 1 / np.linalg.norm(calc.reference.cell.reciprocal(), axis=1)
    return np.where(calc.reference.pbc, np.floor(2 * calc.bonds.lengths.max() / planes * (1 + 1e-9)).astype(int) + 1, 1)


def checked_supercell(calc: Repulsion, supercell: Any) -> NDArray[np.int_]:
    """The `supercell` as a matrix of whole numbers, shape (3, 3), or ValueError if bonds could not be told apart in it."""
    pbc = calc.reference.pbc
    if np.ndim(supercell) == 0:
        supercell = np.where(pbc, whole('supercell', supercell), 1)
    if np.shape(supercell) not in ((3,), (3, 3)):
        raise ValueError('supercell must be one number of cells, three along the lattice vectors, as (3, 3, 1), or a matrix of '
                         f'three rows as phonopy takes it, not {supercell!r}')
    if np.ndim(supercell) == 1:
        supercell = np.diag([whole(f'supercell[{axis}]', n) for axis, n in enumerate(supercell)])
    told, still = _told(np.array(supercell)), np.eye(3, dtype=int)
    if not np.array_equal(supercell, np.rint(supercell)) or np.linalg.det(supercell) < 0.5:
        raise ValueError(f'the supercell {told} must consist of whole numbers and have a positive determinant')
    matrix = np.array(supercell, dtype=int)
    if (matrix != still)[~pbc].any() or (matrix != still)[:, ~pbc].any():
        raise ValueError(f'the supercell {told} repeats or mixes in a direction that is not periodic: there, row and column must '
                         f'be those of the unit matrix; give supercell={tuple(np.where(pbc, matrix.diagonal(), 1).tolist())}')
    if not calc.pairwise:
        return matrix
    # phonopy lays the force constant between two particles on their shortest connection: that is the bond only if
    # every other image of its end is farther away.
    reduced = minkowski_reduce(matrix.T @ calc.reference.cell.array, pbc)[0]  # pyright: ignore[reportArgumentType]  three pbc
    vectors = np.asarray(reduced)[pbc]
    narrowest, longest = np.linalg.norm(vectors, axis=1).min(), calc.bonds.lengths.max()
    if not narrowest > 2 * longest * (1 + 1e-9):
        raise ValueError(f'the supercell {told} repeats every {narrowest:g} mm, so a bond of {longest:g} mm reaches images of '
                         'the same particle on two sides, and their forces cannot be separated; '
                         f'give it {_told(np.diag(np.maximum(abs(matrix).max(axis=0), enough_cells(calc))))} cells')
    return matrix


def _told(matrix):
    along = matrix.diagonal()
    return str(matrix.tolist()) if (matrix != np.diag(along)).any() else ' x '.join(map(str, along))


def default_distance(calc: Repulsion) -> float:
    """Displacement in mm: the largest of the `SHARES` of 1e-5 shortest bonds over which the law is straight.

    The law itself decides, by the second difference of phi''. The static force does not: in a spring at its natural length it is
    round-off.
    """
    lengths = calc.bonds.lengths
    distances = DISTANCE * lengths.min() * np.array(SHARES)
    law = calc.interaction.central(calc.dim)
    if law is None:
        return float(distances[0])
    stiffness = law.d2phi(lengths)
    bends = [abs(law.d2phi(lengths - d) - 2 * stiffness + law.d2phi(lengths + d)).max() for d in distances]
    straight = np.array(bends) <= STRAIGHT * abs(stiffness).max()
    return float(distances[straight.argmax() if straight.any() else np.argmin(bends)])  # none at the kink of a slack cable


def _checked_distance(distance, shortest):
    distance = positive('distance', distance, 'mm')
    if not 1e-12 * shortest <= distance <= 0.1 * shortest:
        raise ValueError(f'the distance {distance:g} mm is {distance / shortest:.1e} of the shortest bond; outside 1e-12 to '
                         f'0.1, round-off or the curvature of the law spoils the force constants. The default is '
                         f'{DISTANCE * shortest:g} mm')
    return distance


def _supercell_atoms(phonon, pbc):
    s = phonon.supercell
    return Atoms(s.symbols, positions=s.positions, masses=s.masses, cell=s.cell, pbc=pbc)


def force_constants_of(phonon: Phonopy) -> NDArray[np.float64]:
    """Force constants from the particles of the cell to those of the supercell, in N/mm.

    Shape (particles, particles of the supercell, dim, dim), in the plane (dim = 2) where nothing acts along z.
    """
    FC = getattr(phonon, 'force_constants', None)
    if FC is None:
        raise ValueError(f'{type(phonon).__name__} holds no force constants; get a phonon from finite_displacements(atoms)')
    if FC.shape[0] == FC.shape[1]:
        FC = FC[phonon.primitive.p2s_map]
    planar = abs(FC[:, :, 2]).max() <= ROUND_OFF * abs(FC).max()
    return FC[:, :, :2, :2] if planar else FC


def phonopy_bands(phonon: Phonopy, path: BandPath | str, vectors: bool = False) -> Bands:
    """Bands along a path from phonopy's dynamical matrices; the same result as `analytic_bands`.

    For a planar lattice only the in-plane block is diagonalised, because z decouples exactly and would add zero frequencies.

    Parameters
    ----------
    phonon : phonopy.Phonopy
        From `finite_displacements`, or from `phonopy.load` of a file written by `write_phonopy_params`.
    path : ase.dft.kpoints.BandPath or str
        From `atoms.cell.bandpath('GMKG', npoints=300, pbc=atoms.pbc)`, or the names 'GMKG' of its special points alone.
    vectors : bool
        Keep the modes too.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, analytic_bands, finite_displacements, lattices, phonopy_bands
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=2.0)
    >>> path = cell.cell.bandpath('GMKG', npoints=8, pbc=cell.pbc)
    >>> numerical = phonopy_bands(finite_displacements(cell), path)
    >>> bool(abs(numerical.omega - analytic_bands(cell, path).omega).max() < 1e-7)
    True
    """
    dim, path = force_constants_of(phonon).shape[-1], path_on(phonon, path)
    n = len(phonon.unitcell)
    D = phonon.run_qpoints(path.kpts, with_dynamical_matrices=True).dynamical_matrices
    D = D.reshape(-1, n, 3, n, 3)[:, :, :dim, :, :dim].reshape(-1, n * dim, n * dim)
    squares, columns = np.linalg.eigh(D * (phonon.unit_conversion_factor / TO_HZ) ** 2)
    if not vectors:
        return Bands(path, signed_root(squares))
    # phonopy's phase is that of the particle, e^{2 pi i q.(shift + s)}, ours that of its cell, e^{2 pi i q.shift}
    phase = np.exp(2j * np.pi * path.kpts @ phonon.unitcell.scaled_positions.T)
    modes = columns.swapaxes(1, 2).reshape(len(path.kpts), -1, n, dim)
    return Bands(path, signed_root(squares), phase[:, None, :, None] * modes)


def path_on(phonon: Phonopy, path: BandPath | str) -> BandPath:
    """The same path on phonopy's unit cell, as `bands.path_of` makes it."""
    # ASE's path has vectors only where it is periodic; phonopy repeats the cell only there
    pbc = path.cell.mask() if isinstance(path, BandPath) else (phonon.supercell_matrix != np.eye(3)).any(axis=0)
    return path_of(Atoms(cell=phonon.unitcell.cell, pbc=pbc), path)


@takes('conventional', 'oblique')
def extracted_dstar(phonon: Phonopy, atoms: Atoms) -> NDArray[np.float64]:
    """The stiffness that the static forces add to each bond, taken from phonopy's force constants: `D* = -FC - D0`.

    Parameters
    ----------
    phonon : phonopy.Phonopy
        From `finite_displacements(atoms)`.
    atoms : ase.Atoms
        The same cell with its PairCalculator, from which D0 = phi'' n(x)n is taken.

    Returns
    -------
    ndarray, shape (bonds, dim, dim)
        In N/mm, in the order of `atoms.calc.bonds`; to be compared with `bond_stiffness(...)[1]`.

    Examples
    --------
    >>> from magphonon import finite_displacements, read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands import extracted_dstar
    >>> cell = read_scene(ready_scene('prototype')).atoms()
    >>> Dstar = extracted_dstar(finite_displacements(cell), cell)
    >>> Dstar.shape  # one matrix for each bond
    (3, 2, 2)
    """
    calc = LinearSystem.of(atoms).calc
    FC = force_constants_of(phonon)
    home = phonon.primitive.p2s_map
    supercell = calc.on(_supercell_atoms(phonon, calc.reference.pbc))
    of_cell = np.isin(supercell.bonds.i, home)  # of the images of each bond, the one that starts in the cell
    i, j = supercell.bonds.i[of_cell], supercell.bonds.j[of_cell]
    D0 = supercell.rest_stiffness('conventional')[of_cell]
    return -FC[np.searchsorted(home, i), j] - D0


def foundation_recovered(phonon: Phonopy) -> NDArray[np.float64]:
    """Stiffness that resists moving the whole lattice: the row sums of the force constants.

    Returns
    -------
    ndarray, shape (particles, dim, dim)
        In N/mm; the foundation stiffness times the identity, zero for a lattice without foundation.

    Examples
    --------
    >>> from magphonon import finite_displacements, read_scene, units as u
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands import foundation_recovered
    >>> phonon = finite_displacements(read_scene(ready_scene('prototype')).atoms())
    >>> round(float(foundation_recovered(phonon)[0, 0, 0]) / (u.N / u.m), 4)
    19.6757
    """
    return force_constants_of(phonon).sum(axis=1)
