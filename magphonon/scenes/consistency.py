"""Consistency of the tables of a scene with each other; `Scene` calls `check` when all its tables are read.

A check that fails raises ValueError, which names the key and its value and says how to correct it.  What a computation does not
support is not checked here: the function that computes it refuses the atoms by their traits.
"""

from __future__ import annotations

import warnings
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from ase.dft.kpoints import parse_path_string

from .. import units as u
from ..stiffness.plausibility import FREQUENCIES_Hz, frequency_scale
from .fields import fault, raise_all
from .lattices import Supercell
from .laws import ALL
from .structures import FileLattice

if TYPE_CHECKING:
    from ..stiffness.repulsion import Repulsion
    from .scene import Scene

DENSEST_kg_per_m3 = 5e4
"""Mass of a particle divided by the cube of the spacing above which a unit is probably wrong; osmium has 2.3e4."""
GRAVITY_m_per_s2 = 9.81
LEAST_SHARE = 1e-12
"""Smallest stiffness of the repulsion, as a fraction of the foundation, that is not lost in the round-off of the foundation."""


def check(scene: Scene) -> None:
    """Raise an error with all contradictions between the tables of a scene."""
    _lattice(scene)
    calc: Any = scene.perfect_cell().calc
    if scene.law.kind != 'saved':  # a calculator has warned already
        _sizes(scene, calc)
    faults = []
    for checked in (_tables, _bands, _frf):
        try:
            checked(scene)
        except ValueError as error:
            faults.append(fault(scene, error))
    raise_all(faults)


def _refuse(scene: Scene, keys: str, why: str) -> None:
    """Raise ValueError for the first of these keys that the scene has; {} in `why` is the key."""
    for key in keys.split():
        value: Any = scene
        for name in key.split('.'):
            value = getattr(value, name, None)
        if value is not None:
            raise ValueError(f'{key}: {why.format(key)}')


def _lattice(scene: Scene) -> None:
    lattice, law = scene.lattice, scene.law
    if bool(scene.members) != (law.kind == 'members'):
        raise ValueError('[[members]] and law.kind = "members" belong together; give both or neither')
    if isinstance(lattice, FileLattice):
        _file(scene, lattice)
    elif law.kind in ('saved', 'members'):
        raise ValueError(f'law.kind = "{law.kind}" takes the particles from a file; it belongs to lattice.kind = "file"')
    _sites(scene)
    if scene.single and law.shells != 1:
        raise ValueError(f'law.shells of the oscillator must be 1, not {law.shells}: its bonds all have one length')
    if scene.turns and law.shells == ALL:
        raise ValueError(f"lattice.gyration_rad_per_s: the sum over all neighbours, law.shells = '{law.asked}', does not support "
                         'gyration; choose a number of shells')


def _sites(scene: Scene) -> None:
    """What particles without periods or without a plane cannot have."""
    if scene.single or scene.finite:
        _refuse(scene, 'patch bands burst', 'the particles have no periods; remove the table, or give their file a cell')
    if scene.foundation is not None and scene.foundation.out_of_plane is not None:
        _refuse(scene, 'burst uncertainty', 'it cannot be computed out of the plane; remove it, or [foundation.out_of_plane]')
    if scene.single or scene.lattice.cell().pbc.all():
        _refuse(scene, 'foundation.out_of_plane foundation.stiffness_y_N_per_m', f'{scene.lattice.kind} has no plane; remove it')


def _file(scene: Scene, lattice: FileLattice) -> None:
    cell = lattice.cell()
    if scene.law.kind in ('saved', 'members'):
        _refuse(scene, 'lattice.cutoff_m', 'the file or [[members]] says which particles interact; remove it')
    if scene.law.kind == 'saved':
        _refuse(scene, 'foundation lattice.mass_kg patch',
                'law.kind = "saved" takes law, bonds, masses and foundation from the file of the lattice; remove {}')
    if cell.constraints or np.ptp(cell.get_tags()):
        _refuse(scene, 'patch', 'it needs constraints and tags to mark its rim, but the file has some; cut the patch in Python, '
                'and save it with magphonon.scenes.write_scene')
    if cell.has('stiffness'):
        _refuse(scene, 'foundation', 'the file has a column with the stiffness; remove one of the two')
    if cell.has('relative_damping'):
        _refuse(scene, 'burst', 'it has one damping for all particles; remove it or the column relative_damping')


def _tables(scene: Scene) -> None:
    if scene.patch is None and not scene.finite:
        _refuse(scene, 'defects' if scene.single else 'defects frf', 'there is no structure for it; add a table [patch]')
    if isinstance(scene.patch, Supercell):
        _refuse(scene, 'burst', 'it enters at the edge of a patch, and a supercell has no edge; choose another patch.kind')
    if scene.uncertainty is not None:
        scene.uncertainty.tolerances(scene)


def _bands(scene: Scene) -> None:
    kind, bands, periodic = scene.lattice.kind, scene.bands, int(scene.lattice.cell().pbc.sum())
    if bands is not None and bands.supercell is not None and len(bands.supercell) != periodic:
        raise ValueError(f'bands.supercell of the {kind} lattice must hold {periodic} whole numbers, not {list(bands.supercell)}')
    if bands is not None and bands.path is not None:
        known, meant = scene.special_points, bands.path.upper().translate({ord('Γ'): 'G', ord('-'): None, ord(' '): None})
        if not _joins(bands.path, known):
            raise ValueError(f'bands.path of the {kind} lattice must join different ones of the points {", ".join(known)}, '
                             f'not {bands.path!r}' + f'; did you mean {meant!r}?' * _joins(meant, known))


def _joins(path, known):
    """Whether each leg of a path joins different special points."""
    return all(len(leg) > 1 and set(leg) <= set(known) and all(a != b for a, b in pairwise(leg))
               for leg in parse_path_string(path))


def _frf(scene: Scene) -> None:
    frf = scene.frf
    if scene.single:
        _refuse(scene, 'frf.force frf.response', 'the oscillator is driven and measured along its guide; remove [{}]')
    if frf is None or scene.single:
        return
    if frf.response is None or (frf.force is None) == (frf.base_deg is None):
        raise ValueError('frf needs [frf.response], and either [frf.force] or base_deg, for a shaken bench')


def _sizes(scene: Scene, calc: Repulsion) -> None:
    """Masses, stiffnesses and frequencies of a size that the units in the keys make likely."""
    numbers = ', '.join(f'law.{key} = {value!r}' for key, value in scene.law if isinstance(value, float))
    f = frequency_scale(calc)
    if f and not FREQUENCIES_Hz[0] <= f <= FREQUENCIES_Hz[1]:
        raise ValueError(f'law, foundation and lattice.mass_kg give frequencies of about {f:.1g} Hz; check their units and '
                         f'exponents ({numbers})')
    if scene.members:
        return
    lattice, k = scene.lattice, np.max(calc.foundation)
    if not abs(calc.law.d2phi(calc.bonds.lengths)).max() > LEAST_SHARE * k:
        raise ValueError(f'{lattice.spacing_given} is so large, or the law of so short a range ({numbers}), that no force acts '
                         f'beside [foundation], {k / (u.N / u.m):.3g} N/m; check their units and exponents (lengths in m)')
    pillar = scene.foundation and scene.foundation.pillar
    if pillar and 2 * pillar.radius_m > lattice.spacing_m:
        raise ValueError(f'foundation.pillar.radius_m = {pillar.radius_m!r}: such pillars would overlap, since '
                         f'{lattice.spacing_given}; radii are in metres')
    _weights(lattice, pillar)


def _weights(lattice, pillar):
    """Warn of masses denser than metals, and of pillars that buckle under theirs, by Euler at pi^2 E I/4 H^2."""
    mass = lattice.cell().get_masses().min() / u.kg
    if (density := mass / lattice.spacing_m**3) > DENSEST_kg_per_m3:
        warnings.warn(f'lattice.mass_kg = {mass:.6g} and {lattice.spacing_given} make {density / 1e3:.2g} g/cm3, denser than any '
                      'metal; check their units, which are kg and m'
                      + ' (g and mm in files that ASE reads)' * isinstance(lattice, FileLattice), stacklevel=2)
    elif pillar and (carried := np.pi**2 / 12 * pillar.stiffness_N_per_m * pillar.height_m) < GRAVITY_m_per_s2 * mass:
        warnings.warn(f'[foundation.pillar] would buckle under {carried:.2g} N, less than the weight of lattice.mass_kg = '
                      f'{mass:.6g}; check the units of its keys, unless it hangs', stacklevel=2)
