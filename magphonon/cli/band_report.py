"""What `magphonon bands` says of bands: frequencies and speeds, decays, thermal motion, Chern numbers, stability."""

from __future__ import annotations

from math import isinf, isnan

import numpy as np

from .. import units
from ..bands.bands import cut_off, points_on, sound_speeds
from ..bands.bloch import bloch_modes
from ..bands.density import band_gaps
from ..bands.force_constants import foundation_recovered
from ..bands.topology import chern_numbers
from ..bands.zone import PLANAR
from ..interactions.pair_laws import repulsion
from ..scenes.laws import ALL
from ..stability.buckling import common_spring, common_support, foundation_needed, on_the_verge
from ..stability.verdicts import verdict
from ..stiffness.elastic import elastic_moduli
from ..stiffness.rest import freedom
from .neighbours import neighbours

ZERO_FRACTION = 1e-5
"""Fraction of the highest frequency below which a number is shown as zero: it is the square root of a rounded eigenvalue."""
LEAST_WRITTEN_N_per_mm = 1e-6
"""Smallest force constant that phonopy's files keep with enough digits: they have 15 decimals, too few for electrons."""


def report(scene, atoms, bands, phonon, lossy, hot) -> str:
    """All of it; `phonon` is None for particles that gyrate, `lossy` and `hot` are None where they are not asked for."""
    return '\n'.join([*_frequencies(scene, atoms, bands), *_decays(lossy), *_thermal(hot, bands['complete'].path), '',
                      *(_topology(atoms) if phonon is None else _stability(scene, atoms, bands, phonon))])


def floquet_report(bands, x) -> str:
    """Which waves grow, of Floquet bands over the distances `x` along a path, in rad/mm."""
    lines = [f'Floquet bands, of waves along the path and back, with {bands["complete"].harmonics} harmonics on either side.']
    for model, found in bands.items():
        k, rate = found.growth.argmax(), found.growth.max() * units.s
        grows = found.growth.max() > 1e-9 * abs(found.omega).max()
        what = f'a wave grows by {rate:.4g} per s at {x[k] * units.m:.4g} rad/m' if grows else 'no wave grows'
        lines.append(f'{model}: {what}')
    lines.append(f'Of these {len(x)} wavevectors alone: ranges of growth are narrow; "magphonon check" follows them everywhere.')
    return '\n'.join(lines)


def _in_words(value):
    """A number for the terminal; a speed of sound may be infinite, if the range of the force is too long, or not exist."""
    if isnan(value):
        return 'none'
    return f'{value:.7g}' if not isinf(value) else 'unbounded' if value > 0 else '-unbounded'


def _frequencies(scene, atoms, bands):
    def rows(label, columns, highest):
        table = np.where(abs(np.transpose(columns)) < ZERO_FRACTION * highest, 0.0, np.transpose(columns))
        return [f'{f"  {label}branch {branch + 1}":18}' + ''.join(f'{_in_words(value):>14}' for value in row)
                for branch, row in enumerate(table)]

    path, cutoff = bands['complete'].path, cut_off(atoms)
    highest = max(result.frequencies_Hz.max() for result in bands.values())
    lines = [scene.title, _lattice(scene, atoms), '',
             f'{"frequency (Hz)":18}' + ''.join(f'{name:>14}' for name in bands)]
    if scene.defects or scene.disorder:
        lines.insert(2, 'bands of the perfect lattice; [defects] and [disorder] belong to its patch, see "magphonon modes"')
    for name, point in points_on(path).items():
        at = abs(path.kpts - point).max(axis=1).argmin()
        lines += rows(f'{name}, ', [result.frequencies_Hz[at] for result in bands.values()], highest)
    if cutoff is not None:
        lowest = bands['complete'].frequencies_Hz.min()
        but = f'; lowest on the path: {lowest:.7g} Hz' if lowest < (1 - ZERO_FRACTION) * units.hertz(cutoff) else ''
        lines.append(f'cut-off frequency (lowest at Gamma): {units.hertz(cutoff):.7g} Hz{but}')
    if not (atoms.constraints or np.any(atoms.calc.gyration)):
        lines += _speeds([sound_speeds(atoms, model=model) for model in atoms.calc.bloch_models], rows) + _moduli(atoms)
    if 'conventional' not in bands:
        lines += ['', 'no conventional model: the sums of D0 and D* diverge separately and converge only together']
    return lines


def _topology(atoms):
    """Chern numbers of bands, gaps, and the waves that run one way along an edge in each."""
    judged = verdict(atoms)
    lines = [judged.finding('buckling').words, judged.finding('gyration').words]
    if tuple(atoms.pbc) != PLANAR:
        return lines
    for model in atoms.calc.bloch_models:
        try:
            numbers = chern_numbers(atoms, model)
        except ValueError as error:
            lines.append(f'{model}: {error}')
            continue
        lines.append(f'{model}: the Chern numbers of the bands are {", ".join(map(str, numbers))}')
        at = bloch_modes(atoms, np.zeros((1, 3)), model)[0][0]
        for low, high in band_gaps(atoms, model=model):
            net = int(numbers[at <= (low + high) / 2].sum())  # of the bands below
            side = f'{abs(net)} more along an edge with the rim on {"the right" if net > 0 else "the left"} than back'
            lines.append(f'  gap from {units.hertz(low):.6g} to {units.hertz(high):.6g} Hz; waves: '
                         f'{side if net else "none that runs one way along an edge"}')
    return lines


def _decays(lossy):
    """The bands with damping at their special points: frequency, decay, and what of a mode is lost in a period."""
    if lossy is None:
        return []
    lines = ['', f'{"with the damping":18}{"frequency (Hz)":>16}{"decay (1/s)":>14}{"damping ratio":>16}']
    for name, point in points_on(lossy.path).items():
        at = abs(lossy.path.kpts - point).max(axis=1).argmin()
        for branch, (w, decay) in enumerate(zip(lossy.omega[at], lossy.decay[at], strict=True)):
            ratio = decay / np.hypot(w, decay) if w > 0 else np.nan
            said = f'{ratio:16.4g}' if w > 0 else f'{"overdamped" if decay >= 0 else "grows":>16}'
            lines.append(f'{f"  {name}, branch {branch + 1}":18}{units.hertz(max(w, 0.0)):16.7g}{decay * units.s:14.6g}{said}')
    return lines


def _thermal(hot, path):
    """Frequencies in thermal motion at the special points, beside the linear ones."""
    if hot is None:
        return []
    lines = ['', f'{"in thermal motion":18}{"frequency (Hz)":>16}{"+-":>10}{"linear (Hz)":>16}{"change of stiffness":>22}']
    for q, *rows in zip(hot.q, hot.omega, hot.error, hot.linear, strict=True):
        name = next(name for name, point in path.special_points.items() if np.allclose(point, q))
        for branch, (w, error, linear) in enumerate(zip(*rows, strict=True)):
            change = f'{100 * ((w / linear) ** 2 - 1):+.2g} %' if linear > 0 else ''
            lines.append(f'{f"  {name}, branch {branch + 1}":18}{units.hertz(w):16.6g}{units.hertz(error):10.2g}'
                         f'{units.hertz(linear):16.6g}{change:>22}')
    return lines


def _lattice(scene, atoms):
    lattice = scene.lattice
    if lattice.kind == 'file':
        held = len(atoms) - int(freedom(atoms)[0].sum())
        return f'{len(atoms)} particles from {lattice.file}, {held} of them held, the nearest {lattice.spacing_m:g} m apart'
    force = repulsion(atoms.calc.law, lattice.spacing_m * units.m)
    return f'{lattice.kind} lattice, L0 = {lattice.spacing_m:g} m, M = {lattice.mass_kg:g} kg, f(L0) = {force:.6g} N'


def _speeds(speeds, rows):
    lines = ['long-wave speeds along x with the foundation removed (m/s; negative = imaginary: unstable without the foundation)',
             *rows('', speeds, np.nanmax(np.where(np.isinf(speeds), 0, speeds), initial=0))]
    if np.isnan(speeds).any():
        lines.append('  none: a zero-stiffness mode of the unit cell (a mechanism) couples to the acoustic branch')
    return lines


def _moduli(atoms):
    try:
        return [f'with the foundation removed: {elastic_moduli(atoms)}']
    except ValueError:  # such as a law that needs a neutralising background
        return []


def _stability(scene, atoms, bands, phonon):
    needed, softest = foundation_needed(atoms, 'complete')
    flat = atoms.copy()
    flat.calc = atoms.calc.in_plane() if atoms.calc.layer else atoms.calc
    sums = np.einsum('ixx->x', foundation_recovered(phonon)) / len(phonon.unitcell)
    recovered = sums[: flat.calc.dim].mean()
    given, recovered, needed = (k / (units.N / units.m) for k in (common_spring(flat), recovered, needed))
    squares = [np.sign(bands[name].omega) * bands[name].omega ** 2 for name in ('complete', 'phonopy')]
    difference = abs(squares[1] - squares[0]).max(axis=1) / abs(squares[0]).max()
    lines = [f"foundation: {given:.6g} N/m in the scene, {recovered:.6g} N/m in the sums of phonopy's force constants",
             f'phonopy differs from complete by at most {difference.max():.1e} of the highest squared frequency']
    if atoms.constraints:
        lines[0] += ', which contain the bonds to the held particles'
    if atoms.calc.layer:
        lines[0] += f'; along z {common_support(atoms) / (units.N / units.m):.6g} and {sums[2] / (units.N / units.m):.6g} N/m'
    if scene.law.shells == ALL:
        waves = bands['complete'].path.kpts * scene.supercell()
        fits = abs(waves - waves.round()).max(axis=1) < 1e-9
        lines[-1] += f', and by {difference[fits].max(initial=0):.1e}'
        lines.append('  at wavevectors commensurate with the supercell; it interpolates between them, because no finite '
                     'supercell holds all neighbours')
    if abs(phonon.force_constants).max() <= LEAST_WRITTEN_N_per_mm:
        lines.append('phonopy_params.yaml is not written: its 15 decimals are too few for force constants of '
                     f'{abs(phonon.force_constants).max():.0e} N/mm')
    lines += neighbours(scene, speeds=True)
    if atoms.calc.layer:
        lines.append(verdict(atoms).finding('out_of_plane').words)
    place = ' in the plane' if flat.calc.dim == 2 else ''
    if on_the_verge(given, needed):
        return [*lines, f'On the verge of buckling{place}: the foundation of {given:.6g} N/m is just what it needs.']
    if given >= needed:
        why = f': it needs a foundation of {needed:.6g} N/m and has {given:.6g} N/m' if needed else '; no foundation needed'
        return [*lines, f'Stable{place}{why}.']
    where = ', '.join(f'{x:.3g}' for x in softest)
    return [*lines, '', f'UNSTABLE: the static forces buckle this lattice; the softest mode is at q = ({where}).',
            f'It needs a foundation of {needed:.6g} N/m and has {given:.6g} N/m. Unstable modes are drawn and saved as',
            'negative frequencies. The conventional model does not show this.']
