"""Consistency of the tables of a scene with each other; `Scene` calls `check` when all its tables are read.

A check that fails raises ValueError, which names the key and its value and says how to correct it.
"""

from __future__ import annotations

import warnings
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from ase.dft.kpoints import parse_path_string

from .. import units as u
from ..stiffness.plausibility import FREQUENCIES_Hz, frequency_scale
from .fields import fault, raise_all
from .lattices import Supercell
from .laws import ALL, MagnetsLaw, SavedLaw
from .structures import FileLattice

if TYPE_CHECKING:
    from ..interactions.pair_laws import PairLaw
    from ..stiffness.repulsion import Repulsion
    from .scene import Scene

DENSITIES_kg_per_m3 = 500, 5e5
"""Range of the moving mass divided by the volume of its magnet: from less than any magnet to more than a magnet with a heavy
holder."""
DENSEST_kg_per_m3 = 5e4
"""Mass of a particle divided by the cube of the spacing above which a unit is probably wrong; osmium has 2.3e4."""
LEAST_SHARE = 1e-12
"""Smallest stiffness of the repulsion, as a fraction of the foundation; a smaller one is lost in the round-off of the
foundation."""
HIGHEST_ON_POSTS_Hz = 1e6  # above it, not the spacing but the foundation is of another size
SENSIBLE_SHARE = 1e-6
"""Stiffness of the repulsion, as a fraction of the foundation, above which a structure behaves as a lattice."""
SPECTRUM_END = 1.4
"""Upper end of the spectrum of a Hann-windowed burst of five cycles, as a multiple of its carrier."""
MOST_SHELLS = 300
"""Largest number of shells, about 4000 neighbours of each particle; beyond it the sum over all neighbours is used."""
MOST_LEGS = 100
"""Largest number of points along a path; a picture has no room for more names."""

IN_PLANE = 'frf', 'burst', 'vibrometer', 'uncertainty'
"""Tables of computations that do not support motion out of the plane."""


def check(scene: Scene) -> None:
    """Raise an error with all contradictions between the tables of a scene."""
    if scene.single:
        _oscillator(scene)
    if isinstance(scene.lattice, FileLattice) or isinstance(scene.law, SavedLaw):
        _file(scene)
    if bool(scene.members) != (scene.law.kind == 'members'):
        raise ValueError('[[members]] and law.kind = "members" belong together; give both or neither')
    if scene.laws_of_kinds:
        _kinds(scene)
    if isinstance(scene.law.shells, int) and scene.law.shells > MOST_SHELLS:
        raise ValueError(f"law.shells must be at most {MOST_SHELLS}, not {scene.law.shells}; for a force of longer range "
                         f"use '{ALL}', the sum over all neighbours")
    _supports(scene)
    if scene.turns and scene.law.shells == ALL:
        raise ValueError("lattice.gyration_rad_per_s: the sum over all neighbours, law.shells = "
                         f"'{getattr(scene.law, 'asked', ALL)}', does not support gyration; choose a number of shells")
    calc: Any = scene.perfect_cell().calc
    if scene.members:
        _frequencies(scene, calc)
    elif scene.law.kind != 'saved':  # a calculator has warned already
        _scale(scene, calc)
    faults = []
    for table, checked in (('title', _title), ('defects', _imperfect), ('disorder', _imperfect), ('law', _mass),
                           ('bands', _bands), ('frf', _frf), ('burst', _burst), ('vibrometer', _vibrometer),
                           ('foundation', _pillar), ('foundation', _two_springs), ('foundation', _out_of_plane),
                           ('uncertainty', lambda scene: scene.uncertainty.tolerances(scene))):
        try:
            if getattr(scene, table) is not None:
                checked(scene)
        except ValueError as error:
            faults.append(fault(scene, error))
    raise_all(faults)


def _supports(scene: Scene) -> None:
    if scene.trap is not None and (not scene.finite or scene.foundation is not None or scene.law.kind == 'saved'):
        raise ValueError('trap: a trap needs a finite structure from a file, a law given in the scene, and no [foundation]; '
                         'remove [trap] or what contradicts it')


def _title(scene: Scene) -> None:
    if scene.title.count('$') < 2:
        return
    from matplotlib.mathtext import MathTextParser  # late: it takes half a second

    try:
        MathTextParser('path').parse(scene.title)
    except ValueError as error:
        fault = str(error).splitlines()[-1].partition(': ')[2]  # behind the name of matplotlib's exception
        raise ValueError(f'title holds a formula that cannot be drawn: {fault}; correct the text between the $, or write '
                         '\\$ for a dollar sign') from None


def _mass(scene: Scene) -> None:
    if not isinstance(scene.law, MagnetsLaw):
        return
    density = _mass_kg(scene) / (scene.law.magnet().volume / u.m**3)
    if not DENSITIES_kg_per_m3[0] <= density <= DENSITIES_kg_per_m3[1]:
        raise ValueError(f'lattice.mass_kg = {_mass_kg(scene)!r} would give the magnet {density:.3g} kg/m3, and magnets '
                         'have about 7500; check the unit of the mass, which is kg, and of the sizes, which is m')


def _mass_kg(scene: Scene) -> float:
    return scene.lattice.least_mass_kg if isinstance(scene.lattice, FileLattice) else scene.lattice.mass_kg


def _burst(scene: Scene) -> None:
    if isinstance(scene.patch, Supercell):
        raise ValueError('burst: a burst enters at the edge of a patch, and a supercell has no edge; choose another patch.kind')


def _vibrometer(scene: Scene) -> None:
    least = 2 * SPECTRUM_END * max(scene.burst.carriers_Hz) if scene.burst is not None else 0.0
    if scene.vibrometer.sampling_rate_Hz < least:
        raise ValueError(f'vibrometer.sampling_rate_Hz must be at least {least:.6g}, twice the end of the spectrum of the '
                         f'highest burst, not {scene.vibrometer.sampling_rate_Hz!r}')
    if scene.vibrometer.noise_m > scene.lattice.spacing_m:
        raise ValueError(f'vibrometer.noise_m must be less than the spacing of {scene.lattice.spacing_m!r} m, not '
                         f'{scene.vibrometer.noise_m!r}')


def _pillar(scene: Scene) -> None:
    if scene.foundation.moving_mass and scene.uncertainty:
        raise ValueError('foundation.pillar.density_kg_per_m3: [uncertainty] treats pillars as massless; '
                         'remove it, and add 33/140 of the mass of a pillar to lattice.mass_kg')


def _two_springs(scene: Scene) -> None:
    if scene.foundation.stiffness_y_N_per_m is None:
        return
    if scene.single or scene.lattice.cell().pbc.all():
        raise ValueError(f'foundation.stiffness_y_N_per_m: {scene.lattice.kind} has no plane; remove it')


def _out_of_plane(scene: Scene) -> None:
    if scene.foundation.out_of_plane is None:
        return
    if scene.single or scene.lattice.cell().pbc.all():
        raise ValueError(f'foundation.out_of_plane: the {scene.lattice.kind} lattice has no plane that its particles could '
                         'leave; remove the table')
    flat = [name for name in IN_PLANE if getattr(scene, name) is not None]
    if flat:
        raise ValueError(f'foundation.out_of_plane: [{"], [".join(flat)}] cannot be computed out of the plane; '
                         'remove it, or remove [foundation.out_of_plane], which only [bands], [patch], [defects] and [disorder] '
                         'support')


def _refuse(scene: Scene, tables: tuple[str, ...], why: str) -> None:
    """Raise ValueError if the scene has one of these tables; {0} in `why` stands for its name."""
    for name in tables:
        if getattr(scene, name) is not None:
            raise ValueError(f'{name}: ' + why.format(name))


def _oscillator(scene: Scene) -> None:
    if scene.law.shells != 1:
        raise ValueError(f'law.shells of the oscillator must be 1, not {scene.law.shells}: its bonds all have one length')
    _refuse(scene, ('bands',), 'the oscillator is one particle and has no bands; remove the table [bands]')


def _file(scene: Scene) -> None:
    lattice, saved = scene.lattice, scene.law.kind == 'saved'
    if not isinstance(lattice, FileLattice):
        does = 'takes the law from the file of the particles' if saved else 'joins the numbered nodes of a file'
        raise ValueError(f'law.kind = "{scene.law.kind}" {does}; it belongs to lattice.kind = "file"')
    if scene.members and lattice.cutoff_m is not None:
        raise ValueError('lattice.cutoff_m: members are listed one by one, not found by their distance; remove cutoff_m')
    if lattice.finite:
        _refuse(scene, ('patch', 'bands', 'burst', 'vibrometer'), 'the file of the lattice holds a finite structure without '
                'periods, and [{0}] needs a lattice; remove the table, or give the file a cell')
    if scene.patch is not None and (lattice.cell().constraints or np.ptp(lattice.cell().get_tags())):
        raise ValueError(f'patch: the cell in {lattice.file} has held particles or several kinds of particles, but a patch needs '
                         f'constraints and tags to mark its rim; cut the patch in Python, and save it with magphonon.write_scene')
    for name, given in (('foundation', scene.foundation is not None), ('lattice.mass_kg', lattice.mass_kg is not None),
                        ('lattice.cutoff_m', lattice.cutoff_m is not None), ('patch', scene.patch is not None)) if saved else ():
        if given:
            raise ValueError(f'{name} and law.kind = "saved" exclude each other: law, bonds, masses and foundation are in '
                             f'{lattice.file}; remove {name}')
    if lattice.cell().has('stiffness') and scene.foundation is not None:
        raise ValueError(f'foundation: {lattice.file} gives the stiffness of each particle; remove [foundation] or this column')
    if lattice.cell().has('relative_damping'):
        _refuse(scene, ('burst', 'uncertainty'), f'it supports only one damping for all particles, but {lattice.file} '
                'has the column relative_damping; remove one of the two')
    if lattice.relaxed and lattice.positions == 'rest':
        raise ValueError('lattice.relaxed moves the particles, but positions = "rest" says that they are at rest; remove relaxed')
    key = 'relaxed' if lattice.relaxed else 'positions' if lattice.positions else None
    if key and scene.law.shells == ALL:
        raise ValueError(f"lattice.{key} and law.shells = '{ALL}': a structure can come to rest only with a number of shells; "
                         'remove one of the two')


def _imperfect(scene: Scene) -> None:
    name = 'defects' if scene.defects is not None else 'disorder'
    if scene.single or (scene.patch is None and not scene.finite):
        raise ValueError(f'{name}: there is no structure to put them in; add a table [patch], such as kind = "supercell" with '
                         'cells_1 and cells_2')
    if scene.uncertainty is not None and (scene.disorder is not None or scene.uncertainty.tolerances(scene).changes):
        raise ValueError(f'{name} and uncertainty: tolerances that all particles share are for the perfect lattice; keep only '
                         'those of each site (each_strength_percent and so on) beside [defects], or remove one of the tables')


def _kinds(scene: Scene) -> None:
    pairs = [other.kinds for other in scene.laws_of_kinds]
    for a, b in {pair for pair in pairs if pairs.count(pair) > 1}:
        raise ValueError(f'laws_of_kinds has two laws for the kinds {a} and {b}; keep one of them')
    guests = scene.defects.guests if scene.defects is not None else ()
    there = {int(kind) for kind in scene.lattice.cell().get_tags()} | {guest.kind for guest in guests}
    for kind in sorted(set(chain.from_iterable(pairs)) - there):
        raise ValueError(f'laws_of_kinds names the kind {kind}, which no particle has; a kind comes from the column kind of a '
                         'file, or from [[defects.substitutions]]')
    for other in scene.laws_of_kinds:
        if isinstance(other.law, SavedLaw) or isinstance(scene.law, SavedLaw):
            raise ValueError('laws_of_kinds and kind = "saved" or "members" exclude each other: the laws are in the file of the '
                             'particles, or in [[members]]')
        if other.law.shells != scene.law.shells or scene.law.shells == ALL:
            raise ValueError(f'laws_of_kinds: shells must be one number, the same in every law, not {other.law.shells!r} beside '
                             f'{scene.law.shells!r} in [law]')
    _refuse(scene, ('uncertainty',), 'it supports only one law for all particles; remove [{0}] or '
                                                  '[[laws_of_kinds]]')
    if scene.patch is not None and not isinstance(scene.patch, Supercell):
        raise ValueError('laws_of_kinds: the tags of particles are their kinds, but this patch uses tags to mark its rim; choose '
                         'patch.kind = "supercell", or cut the patch in Python and save it with magphonon.write_scene')


def _bands(scene: Scene) -> None:
    kind, wanted, periodic = scene.lattice.kind, scene.bands.supercell, int(scene.lattice.cell().pbc.sum())
    if wanted is not None and len(wanted) != periodic:
        raise ValueError(f'bands.supercell of the {kind} lattice must hold {periodic} whole numbers, not {list(wanted)}')
    if scene.bands.damping_per_s is not None:
        _refuse(scene, ('uncertainty',), 'it supports only bands without damping; remove [{0}] or bands.damping_per_s')
    if scene.bands.path is None:
        return
    known = scene.special_points
    if len(scene.bands.path) > MOST_LEGS:
        raise ValueError(f'bands.path must join at most {MOST_LEGS} points, not {len(scene.bands.path)}')
    legs = parse_path_string(scene.bands.path)
    if not all(len(leg) > 1 and set(leg) <= set(known) for leg in legs):
        raise ValueError(f'bands.path of the {kind} lattice must join some of the points {", ".join(known)}, '
                         f'not {scene.bands.path!r}')
    for a, b in chain.from_iterable(map(pairwise, legs)):
        if a == b:
            raise ValueError(f'bands.path goes from {a} to {a} in {scene.bands.path!r}; do not name a point twice in a row')


def _frf(scene: Scene) -> None:
    driven = [key for key, given in (('base_deg', scene.frf.base_deg), ('[frf.wall]', scene.frf.wall),
                                     ('[frf.force]', scene.frf.force)) if given is not None]
    if len(driven) > 1:
        raise ValueError(f'frf has both {" and ".join(driven)}; keep one: shake the bench, move a wall or push a particle')
    if scene.frf.wall is not None and (scene.single or isinstance(scene.patch, Supercell)):
        raise ValueError('frf.wall: a wall is a side of the held rim of a patch or finite structure, and the scene has none; '
                         'remove [frf.wall]')
    for name in ('response',) if driven and driven != ['[frf.force]'] else ('force', 'response'):
        given = getattr(scene.frf, name) is not None
        if given and scene.single:
            raise ValueError(f'frf.{name}: the oscillator is driven and measured along its guide; remove [frf.{name}]')
        if not given and not scene.single:
            raise ValueError(f'frf lacks the table {name!r}; add [frf.{name}] with at_m and direction_deg')
    if not (scene.single or scene.finite) and scene.patch is None:
        raise ValueError('frf: there is no patch to drive; add a table [patch]')


def _frequencies(scene: Scene, calc: Repulsion) -> None:
    f = frequency_scale(calc)
    if not FREQUENCIES_Hz[0] <= f <= FREQUENCIES_Hz[1]:
        raise ValueError(f'law, foundation and lattice.mass_kg give frequencies of about {f:.1g} Hz; '
                         f'check their units and exponents ({_numbers(scene)})')


def _scale(scene: Scene, calc: Repulsion) -> None:
    lengths = calc.bonds.lengths
    if not (calc.law.dphi(lengths).any() or calc.law.d2phi(lengths).any()):  # a spring may have its natural length
        mend = '' if scene.law.kind != 'hertz' else (
            f' than law.diameter_m = {scene.law.diameter_m!r}; spheres repel where they touch')
        raise ValueError(f'{scene.lattice.spacing_given} is so large, or the law of so short a range ({_numbers(scene)}), that '
                         f'no force acts; give a smaller spacing{mend}')
    pillar = scene.foundation and scene.foundation.pillar
    if pillar and 2 * pillar.radius_m > scene.lattice.spacing_m:
        raise ValueError(f'foundation.pillar.radius_m = {pillar.radius_m!r}: such pillars would overlap, since '
                         f'{scene.lattice.spacing_given}; radii are in metres')
    density = _mass_kg(scene) / scene.lattice.spacing_m**3
    if density > DENSEST_kg_per_m3:
        warnings.warn(f'lattice.mass_kg = {_mass_kg(scene)!r} and {scene.lattice.spacing_given} make {density / 1e3:.2g} g/cm3, '
                      'denser than any metal; check their units, which are kg and m', stacklevel=2)
    repulsion, k = abs(calc.law.d2phi(calc.bonds.lengths)).max(), np.max(calc.foundation)
    _frequencies(scene, calc)
    if not LEAST_SHARE * k <= repulsion:
        given, lost = (stiffness / (u.N / u.m) for stiffness in (k, repulsion))
        meant = _millimetres(scene, scene.law.potential(), k) if frequency_scale(calc) < HIGHEST_ON_POSTS_Hz else ''
        raise ValueError(f'the stiffness of the bonds, {lost:.1g} N/m at {scene.lattice.spacing_given}, is lost in the '
                         f'round-off of [foundation], {given:.3g} N/m{meant}; check their units and exponents')


def _numbers(scene: Scene) -> str:
    return ', '.join(f'law.{key} = {value!r}' for key, value in scene.law if isinstance(value, float))


def _millimetres(scene: Scene, law: PairLaw, k: float) -> str:
    """A question for the user that is added to a message if the spacing would make sense in mm."""
    meant = scene.lattice.spacing_m / 1000
    try:
        sensible = law.d2phi(meant * u.m) >= SENSIBLE_SHARE * k
    except (ValueError, ArithmeticError):
        sensible = False
    return f'; it is in metres: did you mean {meant:g}?' if sensible else ''
