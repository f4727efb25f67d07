"""Waves in words: how far measured ridges are from the branches of both models, and what may be wrong with a record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from ase import Atoms

from .. import units
from ..bands.bloch import bloch_modes, branch_names
from ..tables import in_columns
from .ridge_tables import FIELD, RidgePoints
from .wave_analysis import BRANCHES, MODELS, Wave

FAR_bins = 3
"""Distance in wavenumber bins: if no ridge is nearer to a branch, the record comes from another lattice or has other units."""
SLOW_RATIO = 100  # ratio of the highest branch frequency to that of a record above which its waves are longer than any row


def report(records: Mapping[str, Sequence[Wave]]) -> str:
    """Distances of the ridges from the branches, as a table in words; `records` are the waves by the name of their record."""
    names = [f'{name}{mark}' for mark in ('', "'") for name in BRANCHES]
    rows: list[tuple[str, ...]] = [('record', 'motion', 'power', 'points', *names, 'sigma')]
    for record, found in records.items():
        strongest = found[0].spectrum.peak
        for wave in found:
            dB = 10 * np.log10(wave.spectrum.peak / strongest)
            bins = [misfit.bins for misfit in wave.misfits.values()]
            if wave.ridge:
                bins.append(np.median(wave.sigma_xi) / wave.ridge.bin_xi)
            cells = [f'{distance:.2f}' for distance in bins] or 5 * ['-']
            rows.append((record, wave.motion, f'{dB:.1f} dB', str(len(wave.ridge.xi) if wave.ridge else 0), *cells))
    resolution = next(iter(records.values()))[0].spectrum.bin_xi
    row = round(2 * np.pi / resolution)
    return '\n'.join(['RMS distance of the measured ridge from each branch, in wavenumber bins',
                      f'(1 bin = 2 pi/{row} = {resolution:.4g} rad per step; the row has {row} sites).',
                      'Plain columns: D0 + D*; primed: D0 only; sigma: standard uncertainty of a ridge point.',
                      '', *in_columns(rows, left=2), *_verdicts(records), *_doubts(records)])


def agreements(records: Mapping[str, Sequence[Wave]]) -> list[str]:
    """One line for each ridge, with the branches that it agrees with."""
    lines = []
    for record, found in records.items():
        for wave in found:
            misfits, on = wave.misfits, wave.agrees_with
            if on:
                both = ', and does not distinguish the models' if {model for model, _ in on} == {*MODELS} else ''
                off = {name: [f'{misfits[model, name].bins:.2f}' for model in MODELS if (model, name) in on] for _, name in on}
                branches = ', '.join(dict.fromkeys(
                    f'the {name} branch of both models ({" and ".join(off[name])} bins)' if len(off[name]) == len(MODELS)
                    else f'the {model} {name} branch ({off[name][0]} bins)' for model, name in on))
                lines.append(f'{record}, {wave.motion} motion: agrees with {branches}{both}')
            elif misfits:
                model, name = min(misfits, key=lambda name: misfits[name].bins)
                lines.append(f'{record}, {wave.motion} motion: agrees with no branch; the nearest is the {model} {name} one '
                             f'({misfits[model, name].bins:.2f} bins)')
    return lines


def _verdicts(records):
    """Lines with the branches that all ridges agree with, and remarks on what this does not prove."""
    lines, waves = agreements(records), [wave for found in records.values() for wave in found]
    if any(name == 'longitudinal' for wave in waves for _, name in wave.agrees_with):
        lines += ['', 'Longitudinal waves hardly feel D*: an error of a few percent in the law moves their branch as much as D*.',
                  'A longitudinal ridge is therefore no evidence for D* or against it.']
    if any(wave.misfits and not wave.agrees_with for wave in waves):
        lines += ['', 'A ridge that agrees with no branch may come from several waves, from an oblique wave of which only the',
                  'energy runs along the row (a point source in an anisotropic lattice), from the ends of a row of sources,',
                  'or from a lattice that differs from the scene.']
    return ['', *lines] if lines else []


def _doubts(records):
    """Lines with possible reasons why a record has no ridge, or no ridge near a branch."""
    waves, lines = [wave for found in records.values() for wave in found], []
    if any(wave.ridge is None for wave in waves):
        lines += ['', 'Where no ridge was found (0 points), the wave is evanescent, below the noise, or a backward wave.']
    beside = [f'{wave.blurred} of {len(wave.sigma_xi)} points of {record}, {wave.motion} motion'
              for record, found in records.items() for wave in found if wave.blurred]
    if beside:
        lines += ['', 'A point source also sends oblique waves, of which only the energy runs along the row. Such a wave',
                  'within two bins of a ridge merges with it into one peak. Their distance is then part of the uncertainty.',
                  f'It is the largest part for {"; ".join(beside)}.',
                  'A row of sources sends a single wave and leads to a smaller uncertainty.']
    return [*lines, *_units_in_doubt(records, waves)]


def _units_in_doubt(records, waves):
    """Lines on ridges so far from all branches that a unit is probably wrong."""
    lines, far = [], [misfit.bins > FAR_bins for wave in waves for misfit in wave.misfits.values()]
    if far and all(far):
        lines += ['', f'No ridge comes within {FAR_bins} bins of a branch: are the times in seconds, and do the row and the '
                      'lattice belong to the scene?']
    for record, found in records.items():
        top = max(branch.omega.max() for branch in found[0].branches.values())
        if found[0].spectrum.loudest < top / SLOW_RATIO:
            lines += ['', f'{record} moves at {units.hertz(found[0].spectrum.loudest):.3g} Hz and the branches reach up to '
                          f'{units.hertz(top):.3g} Hz: is its column time_s in milliseconds instead of seconds?']
    return lines


def field_report(points: RidgePoints, cell: Atoms) -> str:
    """Distances of the ridge points of a field from the bands of both models, as a table in words."""
    branch = np.array([branch_names(len(cell)).index(motion) for motion in points.motions])
    off = {model: units.hertz(points.omega - bloch_modes(cell, points.q, model)[0][np.arange(len(points)), branch[points.ridge]])
           for model in ('complete', 'conventional')}
    sigma = units.hertz(points.sigma_omega)
    waves = {'row': 'a row of sources', 'point': 'a point source (for a row: --source row, which makes a fit less uncertain)',
             FIELD: 'noise'}[points.sources[0]]
    rows: list[tuple[str, ...]] = [('ridge', 'points', 'D0 + D*', 'D0 only', 'sigma')]
    for k, name in enumerate(points.names):
        own = points.ridge == k
        rows.append((name, str(own.sum()), *(f'{np.sqrt(np.mean(one[own] ** 2)):.2f}' for one in off.values()),
                     f'{np.median(sigma[own]):.2f}'))
    return '\n'.join([f'Waves from {waves}.',
                      'RMS distance of the ridge points from the bands of the scene, and their standard uncertainty, in Hz.',
                      'Longitudinal waves hardly feel D*: an error of a few percent in the law shifts their branch as much as '
                      'D* does.', '',
                      *in_columns(rows, left=1)])
