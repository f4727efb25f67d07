"""The report of `magphonon bands`: frequencies and speeds, decays, Chern numbers, stability."""

from __future__ import annotations

from contextlib import suppress
from math import isinf, isnan
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import units
from ..bands.bands import Bands, cut_off, points_on, sound_speeds
from ..bands.bloch import PLANAR, bloch_modes
from ..bands.density import band_gaps
from ..bands.force_constants import foundation_recovered
from ..bands.topology import chern_numbers
from ..interactions.pair_laws import repulsion
from ..scenes.laws import ALL
from ..stability.buckling import common_spring, critical_foundation, on_the_verge
from ..stability.verdicts import verdict
from ..stiffness.elastic import elastic_moduli
from ..stiffness.rest import freedom
from .neighbours import chosen, omission, too_few

if TYPE_CHECKING:
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


def report(scene: Scene, atoms: Any, bands: dict[str, Bands], phonon: Phonopy | None, lossy: Bands | None,
           spread: Spread | None, verbose: bool) -> list[str]:
    """The lines that the command prints: the answer, the tolerances that the scene asks for, and whatever is wrong; if `verbose`,
    everything.

    Without phonopy, and for forces that depend on the velocity, `phonon` is None.
    """
    gyrates = atoms.calc.turning > 0
    stability, buckles = _stability(atoms)
    page = [_effect(bands) + chosen(scene) + ('' if buckles else f' {stability}')]
    page += ['These are the bands of the perfect lattice; "magphonon modes" includes [defects].'] if scene.defects else []
    if verbose:
        page += _lattice(scene, atoms)
        page += _frequencies(atoms, bands)
    page += _tolerances(scene, bands['complete'].path, spread)
    if verbose:
        page += _long_waves(scene, atoms, bands)
        page += _decays(lossy)
        page += _topology(atoms) if gyrates else _by_phonopy(scene, atoms, bands, phonon)
    page += disagreement(scene, bands)
    if scene.foundation:
        page += scene.foundation.doubts(bands['complete'].omega, not (gyrates or lossy or np.ptp(atoms.get_masses())))
    if not gyrates:
        page += [*omission(scene, verbose), *_out_of_plane(atoms, verbose)]
    return [*page, stability] if verbose or buckles else page


def _stability(atoms):
    """Whether the foundation or gyration holds the lattice, in words, and whether it buckles."""
    judged = verdict(atoms)
    if atoms.calc.turning or judged.case.inside.free.count:
        found = judged.finding('buckling')
        return found.words, found.fault and not judged.case.inside.free.count
    needed, softest = critical_foundation(atoms, 'complete')
    given, needed = _spring_in_plane(atoms), needed / (units.N / units.m)
    place = ' in the plane' if atoms.calc.layer or atoms.calc.dim == 2 else ''
    if on_the_verge(given, needed):
        return f'On the verge of buckling{place}: the foundation of {given:.6g} N/m is just what is needed.', False
    if given >= needed:
        why = f': it needs a foundation of {needed:.6g} N/m and has {given:.6g} N/m' if needed else ', even without a foundation'
        return f'Stable{place}{why}.', False
    where = ', '.join(f'{x:.3g}' for x in softest)
    return (f'\nUNSTABLE: the static forces buckle this lattice; the softest mode is at q = ({where}).\n'
            f'The lattice needs a foundation of {needed:.6g} N/m and has {given:.6g} N/m. Unstable modes are drawn and saved as\n'
            'negative frequencies. The conventional model does not show this.'), True


def _effect(bands):
    """The largest shift of a branch by D* at a special point."""
    from ..plotting.bands import mode_names

    complete = bands['complete'].frequencies_Hz
    if 'conventional' not in bands:
        return f'Bands from {complete.min():.4g} to {complete.max():.4g} Hz.'
    at = _special_points(bands['complete'].path)
    shifts = abs(complete - bands['conventional'].frequencies_Hz)[list(at.values())]
    point, branch = np.unravel_index(shifts.argmax(), shifts.shape)
    name, here = list(at.items())[point]
    f, f0 = complete[here, branch], bands['conventional'].frequencies_Hz[here, branch]
    if abs(f - f0) <= ZERO_FRACTION * complete.max():
        return f'D* changes no branch at {", ".join(at)}.'
    to = (f'{units.in_words("Hz", f0, f)} ({100 * (f / f0 - 1):+.2g} %)' if f > 0 else
          f'{units.in_words("Hz", f0)} to below zero: the lattice buckles')
    kind = mode_names(bands['complete'])[here, branch]
    return f'D* shifts branch {branch + 1}{f" ({kind})" * (kind not in ("", "mixed"))} at {name} from {to}.'


def _out_of_plane(atoms, verbose):
    return [verdict(atoms).finding('out_of_plane').words] if verbose and atoms.calc.layer else []


def _lattice(scene, atoms):
    """The lattice whose bands are reported."""
    given = scene.lattice
    if given.kind == 'file':
        held = len(atoms) - int(freedom(atoms)[0].sum())
        line = f'{len(atoms)} particles from {given.file}, {given.spacing_m:g} m or more apart; {held} of them are held'
    else:
        line = (f'{given.kind} lattice, L0 = {units.in_words("m", given.spacing_m)}, M = {given.mass_kg:g} kg, '
                f'f(L0) = {units.in_words("N", repulsion(atoms.calc.law, given.spacing_m * units.m))}')
    return [scene.title, line]


def _frequencies(atoms, bands):
    """The frequencies at the special points, and the lowest one."""
    lines = [f'\n{"frequency (Hz)":18}' + ''.join(f'{name:>14}' for name in bands)]
    highest = max(result.frequencies_Hz.max() for result in bands.values())
    for name, at in _special_points(bands['complete'].path).items():
        lines += _rows(f'{name}, ', [result.frequencies_Hz[at] for result in bands.values()], highest)
    if (cutoff := cut_off(atoms)) is not None:
        lowest = bands['complete'].frequencies_Hz.min()
        but = f'; lowest on the path: {lowest:.7g} Hz' if lowest < (1 - ZERO_FRACTION) * units.hertz(cutoff) else ''
        lines.append(f'cut-off frequency (lowest at Gamma): {units.hertz(cutoff):.7g} Hz{but}')
    return lines


def _tolerances(scene, path, spread):
    """The standard deviations of the frequencies at special points, and the shifts by omitted neighbours that exceed them."""
    if spread is None:
        return []
    round_off, within = 1e-9 * abs(spread.values).max(), {}
    stds = {cause: np.where(std > round_off, std, 0.0) for cause, std in {'all': spread.std, **spread.contributions}.items()}
    wide = {cause: max(len(cause) + 2, 12) for cause in stds}
    lines = ['standard deviations due to [uncertainty] (Hz): in all, and by each cause alone',
             f'{"":18}' + ''.join(f'{cause:>{wide[cause]}}' for cause in stds)]
    for name, at in _special_points(path).items():
        for branch, (value, std) in enumerate(zip(spread.values[at], spread.std[at], strict=True), 1):
            lines.append(f'{f"  {name}, branch {branch}":18}' + ''.join(
                f'{units.hertz(each[at, branch - 1]):{wide[cause]}.3g}' for cause, each in stds.items()))
            if value > 0:
                within[name, branch] = 1.96 * float(std / value)
    return [*lines, *too_few(scene, points_on(path), within)]


def _long_waves(scene, atoms, bands):
    """Speeds of sound and moduli, with the foundation removed."""
    lines = [] if 'conventional' in bands else [
        '\nno conventional model: the sums of D0 and D* diverge separately and converge only together']
    if atoms.constraints or atoms.calc.turning:
        return lines
    found = [sound_speeds(atoms, model=model) for model in atoms.calc.bloch_models]
    lines.append('long-wave speeds along x with the foundation removed (m/s; negative = imaginary: unstable without the '
                 'foundation)')
    lines += _rows('', found, bands['complete'].omega.max() * scene.lattice.spacing_m * units.m)
    if np.isnan(found).any():
        lines.append('  none: a zero-stiffness mode of the unit cell (a mechanism) couples to the acoustic branch')
    with suppress(ValueError):  # such as for a law that needs a neutralising background
        lines.append(f'with the foundation removed: {elastic_moduli(atoms)}')
    return lines


def _decays(lossy):
    """The bands with damping at the special points: frequency, decay, and damping ratio."""
    if lossy is None:
        return []
    lines = [f'\n{"with the damping":18}{"frequency (Hz)":>16}{"decay (1/s)":>14}{"damping ratio":>16}']
    for name, at in _special_points(lossy.path).items():
        for branch, (w, decay) in enumerate(zip(lossy.omega[at], lossy.decay[at], strict=True)):
            said = (f'{decay / np.hypot(w, decay):16.4g}' if w > 0 else f'{"overdamped" if decay >= 0 else "grows":>16}')
            lines.append(f'{f"  {name}, branch {branch + 1}":18}{units.hertz(max(w, 0.0)):16.7g}{decay * units.s:14.6g}{said}')
    return lines


def _topology(atoms):
    """For particles that gyrate: Chern numbers of the bands, the gaps, and the one-way edge waves in each gap."""
    lines = [f'\nParticles gyrate at up to {atoms.calc.turning * units.s:.4g} rad/s; phonopy sees only forces and would miss it.']
    for model in atoms.calc.bloch_models if tuple(atoms.pbc) == PLANAR else ():
        try:
            numbers = chern_numbers(atoms, model)
        except ValueError as error:
            lines.append(f'{model}: {error}')
            continue
        lines.append(f'{model}: the Chern numbers of the bands are {", ".join(map(str, numbers))}')
        at = bloch_modes(atoms, np.zeros((1, 3)), model)[0][0]
        for low, high in band_gaps(atoms, model=model):
            net = int(numbers[at <= (low + high) / 2].sum())  # of the bands below
            side = (f'{abs(net)} more edge wave{"s run" if abs(net) > 1 else " runs"} with the rim on '
                    f'{"the right" if net > 0 else "the left"} than the opposite way')
            lines.append(f'  gap from {units.hertz(low):.6g} to {units.hertz(high):.6g} Hz: '
                         f'{side if net else "as many edge waves run one way as the other"}')
    return lines


def _by_phonopy(scene, atoms, bands, phonon):
    """The foundation found in the sums of phonopy's force constants, and the difference of its bands from the exact ones."""
    if phonon is None:
        return ['\nphonopy is not installed, so its bands are omitted: pip install phonopy']
    k = np.asarray(phonon.force_constants)
    sums = np.einsum('ixx->x', foundation_recovered(phonon)) / len(phonon.unitcell) / (units.N / units.m)
    along_z = ''
    if atoms.calc.layer:
        along_z = f'; along z: {common_spring(atoms, upwards=True) / (units.N / units.m):.6g} and {sums[2]:.6g} N/m'
    held = ' (these sums contain the bonds to the held particles)' if atoms.constraints else ''
    found = sums[: 2 if along_z else atoms.calc.dim].mean()
    _, squares, fits = _differences(scene, bands)
    line = f'squared frequencies by phonopy and of the complete model differ by at most {squares.max():.1e} of the highest one'
    if scene.law.shells == ALL:
        line += (f', and by {squares[fits].max(initial=0):.1e}\n  at wavevectors commensurate with the supercell; phonopy '
                 'interpolates between these, because no finite supercell holds all neighbours')
    lines = [f"\nfoundation: {_spring_in_plane(atoms):.6g} N/m in the scene; phonopy's force constants sum to {found:.6g} N/m"
             f'{held}{along_z}', line]
    if abs(k).max() <= LEAST_WRITTEN_N_per_mm:
        lines.append('phonopy_params.yaml is not written: its 15 decimals are too few for force constants of '
                     f'{abs(k).max():.0e} N/mm')
    return lines


def disagreement(scene: Scene, bands: dict[str, Bands]) -> list[str]:
    """A line, if phonopy and D0 + D* disagree at the wavevectors where phonopy does not interpolate."""
    if 'phonopy' not in bands:
        return []
    off, squares, fits = _differences(scene, bands)
    apart = (off > DISAGREEMENT) & (squares > DISAGREEMENT_OF_SQUARES)
    return [f'phonopy and D0 + D* disagree: their frequencies differ by up to {off[fits].max():.2g} of the highest one. Trust '
            'neither of them before you know why. The stiffness may jump at the length of a bond, as that of a cable about to go '
            'slack.'] if apart[fits].any() else []


def _differences(scene, bands):
    """Differences between phonopy and the complete model: of frequencies and of their squares, as fractions of the highest, shape
    (wavevectors, branches); and a mask of the wavevectors where phonopy is exact.
    """
    complete, found = (bands[name].omega for name in ('complete', 'phonopy'))
    top = abs(complete).max()
    off = abs(found - complete) / top, abs(found * abs(found) - complete * abs(complete)) / top**2
    waves = bands['complete'].path.kpts * (scene.supercell() if scene.law.shells == ALL else 0)  # of few shells, all fit
    return *off, abs(waves - waves.round()).max(axis=1) < 1e-9


def _spring_in_plane(atoms):
    """The stiffness in N/m that all particles have in the plane."""
    flat = atoms.copy()
    flat.calc = atoms.calc.in_plane() if atoms.calc.layer else atoms.calc
    return common_spring(flat) / (units.N / units.m)


def _special_points(path):
    """The indices of the special points on a path of wavevectors, by name."""
    return {name: int(abs(path.kpts - point).max(axis=1).argmin()) for name, point in points_on(path).items()}


def _rows(label, columns, highest):
    """Lines of a table, with a row for each branch and a number for each model."""
    table = np.where(abs(np.transpose(columns)) < ZERO_FRACTION * highest, 0.0, np.transpose(columns))
    return [f'{f"  {label}branch {branch + 1}":18}' + ''.join(f'{_in_words(value):>14}' for value in row)
            for branch, row in enumerate(table)]


def _in_words(value):
    """A number as text; a speed of sound may be infinite, if the force has a long range, or may not exist."""
    if isnan(value):
        return 'none'
    return f'{value:.7g}' if not isinf(value) else 'unbounded' if value > 0 else '-unbounded'
