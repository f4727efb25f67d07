"""The report of `magphonon bands`: frequencies and speeds, decays, Chern numbers, stability."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from math import isinf, isnan
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import units
from ..bands.bands import Bands, cut_off, points_on, sound_speeds
from ..bands.bloch import bloch_modes
from ..bands.density import band_gaps
from ..bands.force_constants import foundation_recovered
from ..bands.topology import chern_numbers
from ..bands.zone import PLANAR
from ..findings import Finding, Findings
from ..interactions.pair_laws import repulsion
from ..scenes.laws import ALL
from ..stability.buckling import common_spring, common_support, critical_foundation, on_the_verge
from ..stability.verdicts import verdict
from ..stiffness.elastic import elastic_moduli
from ..stiffness.rest import freedom
from . import neighbours
from .neighbours import omitted, speeds

if TYPE_CHECKING:
    from ase.dft.kpoints import BandPath
    from phonopy import Phonopy

    from ..design.uncertainty import Spread
    from ..scenes.scene import Scene

ZERO_FRACTION = 1e-5
"""Fraction of the highest frequency below which a number is shown as zero: it is the square root of a rounded eigenvalue."""
DISAGREEMENT, DISAGREEMENT_OF_SQUARES = 1e-6, 1e-7
"""Differences of frequencies and of their squares, as fractions of the highest, above which phonopy and D0 + D* disagree. Both
must be exceeded: near zero frequency the square root magnifies the round-off of a square."""
LEAST_WRITTEN_N_per_mm = 1e-6
"""Smallest force constant that phonopy's files keep with enough digits: they have 15 decimals, too few for electrons."""


@dataclass(frozen=True)
class Case:
    """A scene with its bands, and the intermediate results that several findings share."""

    scene: Scene
    atoms: Any
    bands: dict[str, Bands]
    phonon: Phonopy | None = None  # None where it is not installed, and where forces depend on the velocity
    lossy: Bands | None = None
    spread: Spread | None = None

    @property
    def path(self) -> BandPath:
        return self.bands['complete'].path

    @property
    def turned(self) -> bool:
        """Whether particles gyrate."""
        return self.atoms.calc.turning > 0


REPORT = Findings()


def _in_words(value):
    """A number as text; a speed of sound may be infinite, if the force has a long range, or may not exist."""
    if isnan(value):
        return 'none'
    return f'{value:.7g}' if not isinf(value) else 'unbounded' if value > 0 else '-unbounded'


def _rows(label, columns, highest):
    """Lines of a table, with a row for each branch and a number for each model."""
    table = np.where(abs(np.transpose(columns)) < ZERO_FRACTION * highest, 0.0, np.transpose(columns))
    return [f'{f"  {label}branch {branch + 1}":18}' + ''.join(f'{_in_words(value):>14}' for value in row)
            for branch, row in enumerate(table)]


@REPORT.answer
def effect(case: Case) -> str:
    """The largest shift of a branch by D* at a special point, and whether the lattice is stable."""
    from ..plotting.bands import mode_names

    stands = verdict(case.atoms).finding('buckling') if case.turned else buckling(case)
    words = '' if stands is None or stands.fault else f' {stands.words}'
    complete = case.bands['complete'].frequencies_Hz
    if 'conventional' not in case.bands:
        return f'Bands from {complete.min():.4g} to {complete.max():.4g} Hz.{words}'
    other = case.bands['conventional'].frequencies_Hz
    at = {name: abs(case.path.kpts - point).max(axis=1).argmin() for name, point in points_on(case.path).items()}
    name, branch = max(((name, n) for name in at for n in range(complete.shape[1])),
                       key=lambda which: abs(complete[at[which[0]], which[1]] - other[at[which[0]], which[1]]))
    f, f0 = complete[at[name], branch], other[at[name], branch]
    if abs(f - f0) <= ZERO_FRACTION * complete.max():
        return f'D* changes no branch at {", ".join(at)}.{words}'
    to = (f'{units.in_words("Hz", f0, f)} ({100 * (f / f0 - 1):+.2g} %)' if f > 0 else
          f'{units.in_words("Hz", f0)} to below zero: the lattice buckles')
    kind = mode_names(case.bands['complete'])[at[name], branch]
    return f'D* shifts branch {branch + 1}{f" ({kind})" * (kind not in ("", "mixed"))} at {name} from {to}.{words}'


@REPORT.remark
def lattice(case: Case) -> Iterator[str]:
    """The lattice whose bands are reported."""
    given, atoms = case.scene.lattice, case.atoms
    yield case.scene.title
    if given.kind == 'file':
        held = len(atoms) - int(freedom(atoms)[0].sum())
        yield f'{len(atoms)} particles from {given.file}, {given.spacing_m:g} m or more apart; {held} of them are held'
    else:
        force = repulsion(atoms.calc.law, given.spacing_m * units.m)
        yield (f'{given.kind} lattice, L0 = {units.in_words("m", given.spacing_m)}, M = {given.mass_kg:g} kg, '
               f'f(L0) = {units.in_words("N", force)}')
    if case.scene.defects:
        yield 'These are the bands of the perfect lattice; "magphonon modes" includes [defects].'


@REPORT.remark
def frequencies(case: Case) -> Iterator[str]:
    """The frequencies at the special points, and the lowest one."""
    yield f'\n{"frequency (Hz)":18}' + ''.join(f'{name:>14}' for name in case.bands)
    highest = max(result.frequencies_Hz.max() for result in case.bands.values())
    for name, point in points_on(case.path).items():
        at = abs(case.path.kpts - point).max(axis=1).argmin()
        yield from _rows(f'{name}, ', [result.frequencies_Hz[at] for result in case.bands.values()], highest)
    if (cutoff := cut_off(case.atoms)) is not None:
        lowest = case.bands['complete'].frequencies_Hz.min()
        but = f'; lowest on the path: {lowest:.7g} Hz' if lowest < (1 - ZERO_FRACTION) * units.hertz(cutoff) else ''
        yield f'cut-off frequency (lowest at Gamma): {units.hertz(cutoff):.7g} Hz{but}'


@REPORT.check
def tolerances(case: Case) -> Finding | None:
    """The standard deviations of the frequencies at special points; always printed, because the scene asks for them."""
    if case.spread is None:
        return None
    points, stds = points_on(case.path), {'all': case.spread.std, **case.spread.contributions}
    lines, within = ['standard deviations due to [uncertainty] (Hz): in all, and by each cause alone'], {}
    lines += [f'{"":18}' + ''.join(f'{name:>{max(len(name) + 2, 12)}}' for name in stds)]
    for name, point in points.items():
        at = abs(case.path.kpts - point).max(axis=1).argmin()
        for branch, (value, std) in enumerate(zip(case.spread.values[at], case.spread.std[at], strict=True), 1):
            lines.append(f'{f"  {name}, branch {branch}":18}' + ''.join(
                f'{units.hertz(each[at, branch - 1]):{max(len(cause) + 2, 12)}.3g}' for cause, each in stds.items()))
            within |= {(name, branch): 1.96 * float(std / value)} if value > 0 else {}
    few = neighbours.REPORT.find('not_enough', neighbours.Case(case.scene, points, within=within)).words
    return Finding(case.spread, '\n'.join([*lines, *filter(None, [few])]), fault=True)


@REPORT.remark
def long_waves(case: Case) -> Iterator[str]:
    """Speeds of sound and moduli, with the foundation removed."""
    if 'conventional' not in case.bands:
        yield '\nno conventional model: the sums of D0 and D* diverge separately and converge only together'
    if case.atoms.constraints or case.atoms.calc.turning:
        return
    speeds = [sound_speeds(case.atoms, model=model) for model in case.atoms.calc.bloch_models]
    yield 'long-wave speeds along x with the foundation removed (m/s; negative = imaginary: unstable without the foundation)'
    yield from _rows('', speeds, case.bands['complete'].omega.max() * case.scene.lattice.spacing_m * units.m)
    if np.isnan(speeds).any():
        yield '  none: a zero-stiffness mode of the unit cell (a mechanism) couples to the acoustic branch'
    with suppress(ValueError):  # such as for a law that needs a neutralising background
        yield f'with the foundation removed: {elastic_moduli(case.atoms)}'


@REPORT.remark
def decays(case: Case) -> Iterator[str]:
    """The bands with damping at the special points: frequency, decay, and damping ratio."""
    if (lossy := case.lossy) is None:
        return
    yield f'\n{"with the damping":18}{"frequency (Hz)":>16}{"decay (1/s)":>14}{"damping ratio":>16}'
    for name, point in points_on(lossy.path).items():
        at = abs(lossy.path.kpts - point).max(axis=1).argmin()
        for branch, (w, decay) in enumerate(zip(lossy.omega[at], lossy.decay[at], strict=True)):
            said = (f'{decay / np.hypot(w, decay):16.4g}' if w > 0 else f'{"overdamped" if decay >= 0 else "grows":>16}')
            yield f'{f"  {name}, branch {branch + 1}":18}{units.hertz(max(w, 0.0)):16.7g}{decay * units.s:14.6g}{said}'


@REPORT.remark
def topology(case: Case) -> Iterator[str]:
    """For particles that gyrate: Chern numbers of the bands, the gaps, and the one-way edge waves in each gap."""
    if not case.turned:
        return
    judged = verdict(case.atoms)
    yield '\n' + judged.finding('buckling').words
    yield judged.finding('gyration').words
    for model in case.atoms.calc.bloch_models if tuple(case.atoms.pbc) == PLANAR else ():
        try:
            numbers = chern_numbers(case.atoms, model)
        except ValueError as error:
            yield f'{model}: {error}'
            continue
        yield f'{model}: the Chern numbers of the bands are {", ".join(map(str, numbers))}'
        at = bloch_modes(case.atoms, np.zeros((1, 3)), model)[0][0]
        for low, high in band_gaps(case.atoms, model=model):
            net = int(numbers[at <= (low + high) / 2].sum())  # of the bands below
            side = (f'{abs(net)} more edge wave{"s run" if abs(net) > 1 else " runs"} with the rim on '
                    f'{"the right" if net > 0 else "the left"} than the opposite way')
            yield (f'  gap from {units.hertz(low):.6g} to {units.hertz(high):.6g} Hz: '
                   f'{side if net else "as many edge waves run one way as the other"}')


@REPORT.remark
def by_phonopy(case: Case) -> Iterator[str]:
    """The foundation found in the sums of phonopy's force constants, and the difference of its bands from the exact ones."""
    if case.phonon is None:
        if not case.turned:
            yield '\nphonopy is not installed, so its bands are omitted: pip install phonopy'
        return
    atoms, k = case.atoms, np.asarray(case.phonon.force_constants)
    sums = np.einsum('ixx->x', foundation_recovered(case.phonon)) / len(case.phonon.unitcell) / (units.N / units.m)
    along_z = f'; along z: {common_support(atoms) / (units.N / units.m):.6g} and {sums[2]:.6g} N/m' if atoms.calc.layer else ''
    held = ' (these sums contain the bonds to the held particles)' if atoms.constraints else ''
    yield (f"\nfoundation: {_spring_in_plane(atoms):.6g} N/m in the scene; phonopy's force constants sum to "
           f'{sums[: 2 if along_z else atoms.calc.dim].mean():.6g} N/m{held}{along_z}')
    _, squares, fits = _differences(case)
    line = f'squared frequencies by phonopy and of the complete model differ by at most {squares.max():.1e} of the highest one'
    if case.scene.law.shells == ALL:
        line += (f', and by {squares[fits].max(initial=0):.1e}\n  at wavevectors commensurate with the supercell; phonopy '
                 'interpolates between these, because no finite supercell holds all neighbours')
    yield line
    if abs(k).max() <= LEAST_WRITTEN_N_per_mm:
        yield f'phonopy_params.yaml is not written: its 15 decimals are too few for force constants of {abs(k).max():.0e} N/mm'


def _differences(case):
    """Differences between phonopy and the complete model: of frequencies and of their squares, as fractions of the highest, shape
    (wavevectors, branches); and a mask of the wavevectors where phonopy is exact.
    """
    complete, found = (case.bands[name].omega for name in ('complete', 'phonopy'))
    top = abs(complete).max()
    off = abs(found - complete) / top, abs(found * abs(found) - complete * abs(complete)) / top**2
    waves = case.path.kpts * case.scene.supercell()
    fits = (case.scene.law.shells != ALL) | (abs(waves - waves.round()).max(axis=1) < 1e-9)
    return *off, fits


@REPORT.check
def two_roads(case: Case) -> Finding | None:
    """Whether phonopy and D0 + D* agree, at the wavevectors where phonopy does not interpolate."""
    if case.phonon is None:
        return None
    off, squares, fits = _differences(case)
    apart = (off > DISAGREEMENT) & (squares > DISAGREEMENT_OF_SQUARES)
    if not apart[fits].any():
        return Finding(off[fits].max(initial=0.0))
    most = off[fits].max()
    return Finding(most, f'phonopy and D0 + D* disagree: their frequencies differ by up to {most:.2g} of the highest '
                   'one. Trust neither of them before you know why. The stiffness may jump at the length of a bond, as '
                   'that of a cable about to go slack.', fault=True)


@REPORT.check
def others(case: Case) -> Finding | None:
    """How the omitted neighbours would change the frequencies."""
    return None if case.turned else omitted(case.scene)


@REPORT.remark
def far_ones(case: Case) -> str | None:
    """How the omitted neighbours would change the speeds of long waves."""
    return None if case.turned else speeds(case.scene)


@REPORT.remark
def out_of_plane(case: Case) -> str | None:
    """Whether a layer is stable against motion out of its plane."""
    return verdict(case.atoms).finding('out_of_plane').words if not case.turned and case.atoms.calc.layer else None


@REPORT.check
def buckling(case: Case) -> Finding | None:
    """Whether the foundation holds the lattice."""
    if case.turned:
        return None
    needed, softest = critical_foundation(case.atoms, 'complete')
    given, needed = _spring_in_plane(case.atoms), needed / (units.N / units.m)
    place = ' in the plane' if case.atoms.calc.layer or case.atoms.calc.dim == 2 else ''
    if on_the_verge(given, needed):
        return Finding(needed, f'On the verge of buckling{place}: the foundation of {given:.6g} N/m is just what is needed.')
    if given >= needed:
        why = f': it needs a foundation of {needed:.6g} N/m and has {given:.6g} N/m' if needed else ', even without a foundation'
        return Finding(needed, f'Stable{place}{why}.')
    where = ', '.join(f'{x:.3g}' for x in softest)
    return Finding(needed, f'\nUNSTABLE: the static forces buckle this lattice; the softest mode is at q = ({where}).\n'
                   f'The lattice needs a foundation of {needed:.6g} N/m and has {given:.6g} N/m. Unstable modes are drawn and '
                   'saved as\nnegative frequencies. The conventional model does not show this.', fault=True)


def _spring_in_plane(atoms):
    """The stiffness in N/m that all particles have in the plane."""
    flat = atoms.copy()
    flat.calc = atoms.calc.in_plane() if atoms.calc.layer else atoms.calc
    return common_spring(flat) / (units.N / units.m)
