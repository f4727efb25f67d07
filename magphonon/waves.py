"""The waves that a row of particles tells of, simulated or measured: map and ridge of each motion, beside the bands."""

from dataclasses import dataclass

import numpy as np

from . import units
from .files import whole_file
from .sites import polarisations, wavevector
from .spectrum import LEAST_POWER, Branch, Ridge, Spectrum, branch, compare, ridge, wavenumber_frequency

MODELS = ('complete', 'conventional')
BRANCHES = {'shear': 0, 'longitudinal': 1}
"""The lowest two, from below: repulsion makes shear the softer of the two sounds."""

FAR = 3
"""Bins; a record of which no ridge is nearer to any branch was not taken in this lattice, or in other units."""

RIDGE_COLUMNS = ('record', 'motion', 'xi_rad', 'sigma_xi_rad', 'frequency_Hz', 'sigma_frequency_Hz', 'power_m2')


@dataclass(frozen=True)
class Wave:
    """What a row tells of one polarisation.

    Attributes
    ----------
    motion : {'transverse', 'longitudinal'}
        Across or along the wavevector.
    spectrum : Spectrum
    branches : dict of Branch
        By model and name, such as ('complete', 'shear').
    ridge : Ridge or None
        None if no wave rises above the background: it decays, or was not driven.
    """

    motion: str
    spectrum: Spectrum
    branches: dict[tuple, Branch]
    ridge: Ridge | None

    @property
    def misfits(self):
        """Distance of the ridge from each branch, a dict of Misfit; empty without a ridge."""
        return {name: compare(self.ridge, branch) for name, branch in self.branches.items()} if self.ridge else {}


def waves(row, cell, source):
    """The waves along a row, the strongest motion first; one 20 dB weaker than the other is left out.

    Waves that spread move the row across and along its line: a ridge of one motion may follow the branch of the other.
    Where a branch falls with the wavenumber, as shear in a square lattice on springs, phases run backwards: no ridge.

    Parameters
    ----------
    row : Displacements
        Of particles in equal steps of R2, away from the source.
    cell : ase.Atoms
        With its MagneticRepulsion.
    source : {'row', 'point'}

    Returns
    -------
    list of Wave

    Raises
    ------
    ValueError
        If the row is at rest, or the record too short.
    """
    motions = {name: row.along(direction) for name, direction in polarisations(cell, source).items()}
    moving = {name: u for name, u in motions.items() if u.any()} or motions  # of a row at rest, the map says so
    maps = {name: wavenumber_frequency(u, row.dt) for name, u in moving.items()}
    strongest_first = sorted(maps, key=lambda name: -maps[name].power.max())
    least = LEAST_POWER * maps[strongest_first[0]].power.max()
    q = wavevector(cell, source)
    branches = {(model, name): branch(cell, q, mode, model) for model in MODELS for name, mode in BRANCHES.items()}
    return [Wave(name, maps[name], branches, _ridge_of(maps[name]))
            for name in strongest_first if maps[name].power.max() > least]


def _ridge_of(spectrum):
    try:  # a decaying wave is a finding too
        return ridge(spectrum)
    except ValueError:
        return None


def report(records):
    """Distances of the ridges from the branches, as a table in words.

    Parameters
    ----------
    records : dict
        From the name of a record to its waves.

    Returns
    -------
    str
    """
    rows = [('record', 'motion', 'power', 'points', *(f'{name}{mark}' for mark in ('', "'") for name in BRANCHES))]
    for record, found in records.items():
        strongest = found[0].spectrum.power.max()
        for wave in found:
            dB = 10 * np.log10(wave.spectrum.power.max() / strongest)
            bins = [f'{misfit.bins:.2f}' for misfit in wave.misfits.values()] or 4 * ['-']
            rows.append((record, wave.motion, f'{dB:.1f} dB', str(len(wave.ridge.xi) if wave.ridge else 0), *bins))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ['  '.join(f'{cell:{"<" if k < 2 else ">"}{widths[k]}}' for k, cell in enumerate(row)) for row in rows]
    if any(wave.ridge is None for found in records.values() for wave in found):
        lines += ['', 'Without points: nothing runs along the row above its background; it decays, drowns in noise, or its',
                  'phases run backwards.']
    far = [misfit.bins > FAR for found in records.values() for wave in found for misfit in wave.misfits.values()]
    if far and all(far):
        lines += ['', f'No ridge comes within {FAR} bins of a branch: are times in seconds, row and lattice those of the scene?']
    resolution = next(iter(records.values()))[0].spectrum.bin_xi
    return '\n'.join(["The ridge of each motion, and its rms distance from the branches, complete and conventional ('), in bins",
                      f'of the wavenumber; one, 2 pi by the points of the row, is {resolution:.4g} rad per step:', '', *lines])


def write_ridges(path, records):
    """Table of ridge points in SI, whole or not at all.

    Parameters
    ----------
    path : path
    records : dict
        From the name of a record to its waves.
    """
    with whole_file(path) as file:
        print(*RIDGE_COLUMNS, sep=',', file=file)
        for name, found in records.items():
            for wave in found:
                if wave.ridge:
                    r = wave.ridge
                    columns = r.xi, r.sigma_xi, units.hertz(r.omega), units.hertz(r.sigma_omega), r.power / units.m**2
                    for point in np.transpose(columns).tolist():
                        print(name, wave.motion, *point, sep=',', file=file)
