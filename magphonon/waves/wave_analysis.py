"""Waves along a row of particles, simulated or measured: map and ridge of each polarisation, compared with the bands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .. import units
from .branches import Branch, branch, compare
from .oblique import LOBE_bins, blur
from .rows import row_of
from .spectrum import LEAST_POWER, Ridge, Spectrum, ridge, wavenumber_frequency, without_drift
from .wave_source import across_and_along, polarisations, wavevector

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ase import Atoms
    from numpy.typing import NDArray

    from .branches import Misfit
    from .rows import Row
    from .scans import Scan
    from .vibrometer import Displacements

MODELS = ('complete', 'conventional')
BRANCHES = {'shear': 0, 'longitudinal': 1}
"""Index of each branch, counted from the lowest: repulsion makes shear the softer of the two acoustic branches."""
FAR_bins = 3
"""Distance in wavenumber bins: if no ridge is nearer to a branch, the record comes from another lattice or has other units."""
REST_FRACTION = 1e-6
"""A motion weaker than this fraction of the other polarisation is round-off."""
SLOW_RATIO = 100
"""Ratio of the highest branch frequency to that of a record above which its waves are longer than any row."""
SAME = 0.99
"""Cosine from which a measured component is the motion across or along the wavevector: less than -17 dB of the other is in it."""


@dataclass(frozen=True)
class Wave:
    """The wave of one polarisation along a row, with the branches to compare it with.

    Attributes
    ----------
    motion : str
        'transverse' or 'longitudinal', across or along the wavevector; of a scan of one component between them its own name.
    spectrum : Spectrum
    branches : dict of Branch
        By model and name, such as ('complete', 'shear').
    wavevector : ndarray, shape (3,)
        That of xi = 2 pi, in fractions of the reciprocal vectors.
    ridge : Ridge or None
        None if no wave rises above the background, because it decays or was not driven.
    blur : ndarray, shape (points,), optional
        How far its wavenumbers may be off in rad, as oblique waves from a point source blend with it (`magphonon.waves.oblique`);
        None for a row of sources.
    """

    motion: str
    spectrum: Spectrum
    branches: dict[tuple[str, str], Branch]
    wavevector: np.ndarray
    ridge: Ridge | None
    blur: np.ndarray | None = None

    @property
    def sigma_xi(self) -> NDArray[np.float64]:
        """Standard uncertainty of the wavenumbers of the ridge in rad, its blur included, shape (points,)."""
        return np.zeros(0) if self.ridge is None else np.hypot(self.ridge.sigma_xi, 0 if self.blur is None else self.blur)

    @property
    def blurred(self) -> int:
        """Number of ridge points that are more uncertain by oblique waves than by all else."""
        return 0 if self.ridge is None or self.blur is None else int((self.blur > self.ridge.sigma_xi).sum())

    @property
    def misfits(self) -> dict[tuple[str, str], Misfit]:
        """Distance of the ridge from each branch, a dict of Misfit; empty without a ridge."""
        if self.ridge is None:
            return {}
        ridge = replace(self.ridge, sigma_xi=self.sigma_xi)
        return {name: compare(ridge, branch) for name, branch in self.branches.items()}

    @property
    def agrees_with(self) -> tuple[tuple[str, str], ...]:
        """Model and name of the branches that agree with the ridge within its uncertainties, the nearest first."""
        misfits = self.misfits
        return tuple(sorted((name for name in misfits if misfits[name].agrees), key=lambda name: misfits[name].bins))


def waves(row: Displacements, cell: Atoms, source: str) -> list[Wave]:
    """The waves along a row, the strongest polarisation first; one that is 20 dB weaker than the other is left out.

    Waves from a point source move the row both across and along its line: a ridge of one motion may follow the branch of the
    other.  A branch that falls with the wavenumber, such as shear in a square lattice on springs, carries backward waves (phase
    and group velocity of opposite sign), for which no ridge is found.

    Parameters
    ----------
    row : Displacements
        Displacements of particles in equal steps of R2, away from the source.
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
    return _analysed(motions, row.dt, None, cell, wavevector(cell, source), source)


def scan_waves(scan: Scan, cell: Atoms, source: str = 'point', row: Row | None = None) -> list[Wave]:
    """The waves along a scanned row, the strongest first, as `waves` finds them on a row without gaps.

    Parameters
    ----------
    scan : Scan
        With places.
    cell : ase.Atoms
        With its MagneticRepulsion.
    source : {'row', 'point'}
        Fronts along R1, or across the measured row.
    row : Row, optional
        By default the row of the lattice on which the points stand, begun at the end from which the stronger waves come.

    Returns
    -------
    list of Wave

    Raises
    ------
    ValueError
        If the points are no row of the lattice, are too far apart or at rest, or move out of its plane alone.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import read_scene, ready_scene
    >>> from magphonon.waves import Scan, scan_waves
    >>> cell = read_scene(ready_scene('prototype')).atoms()
    >>> t, n = np.arange(0, 400, 2.0), np.delete(np.arange(24), [3, 9])  # two points are missing
    >>> u = 1e-3 * np.sin(0.29 * t[:, None] - 1.3 * n) * np.sin(np.pi * t[:, None] / 400) ** 2
    >>> places = np.stack([10.0 * n, 0 * n], axis=1)
    >>> wave = scan_waves(Scan(t, tuple(map(str, n)), places, {'y': u}), cell)[0]
    >>> wave.motion, round(float(wave.ridge.xi.mean()), 2)
    ('transverse', 1.3)
    """
    if scan.places is None:
        raise ValueError('the scan does not say where its points are; give x_m and y_m of each, in the scan or with scan.placed')
    row = _begun_at_the_source(scan, row_of(scan.places, cell)) if row is None else row
    q = row.wavevector(cell, source)
    motions = {name: u[:, row.order] for name, u in _components(scan, across_and_along(cell, q)).items()}
    return _analysed(motions, scan.dt, row.steps, cell, q, source)


def _components(scan, directions):
    """The motion across and along the wavevector, or that in the one direction which was measured."""
    if {'x', 'y'} <= scan.motions.keys():
        return {name: x * scan.motions['x'] + y * scan.motions['y'] for name, (x, y) in directions.items()}
    part = next((part for part in ('x', 'y', '') if part in scan.motions), None)
    if part is None:
        raise ValueError('the scan holds motion along z alone, out of the plane in which the particles of the scene move; '
                         'measure x or y')
    named = [name for name, direction in directions.items() if part and abs(direction['xy'.index(part)]) > SAME]
    return {named[0] if named else part or 'measured': scan.motions[part]}


def _begun_at_the_source(scan, row):
    """The row from the end from which the stronger waves come."""
    u = max(scan.motions.values(), key=lambda u: np.var(without_drift(u), axis=0).sum())[:, row.order]
    spectrum = wavenumber_frequency(u, scan.dt, row.steps)
    forward, backward = (spectrum.power[:, side].max() for side in (spectrum.xi > 0, spectrum.xi < 0))
    return row if forward >= backward else row.reversed


def _analysed(motions, dt, steps, cell, q, source):
    """The waves of each of the `motions`, shape (frames, points) by name, of which the wavevector at xi = 2 pi is q."""
    largest = {name: abs(without_drift(u)).max() for name, u in motions.items()}
    moving = [name for name in motions if largest[name] > REST_FRACTION * max(largest.values())]
    moving = moving or motions  # a row at rest is refused by the map
    maps = {name: wavenumber_frequency(motions[name], dt, steps) for name in moving}
    strongest_first = sorted(maps, key=lambda name: -maps[name].peak)
    least = LEAST_POWER * maps[strongest_first[0]].peak
    branches = {(model, name): branch(cell, q, mode, model) for model in MODELS for name, mode in BRANCHES.items()}
    found = [Wave(name, maps[name], branches, q, _ridge_of(maps[name])) for name in strongest_first if maps[name].peak > least]
    return [_blurred(wave, cell) if source == 'point' and wave.ridge else wave for wave in found]


def _blurred(wave, cell):
    """The wave of a point source, with what oblique waves of either model do to its ridge."""
    r, lobe = wave.ridge, LOBE_bins * wave.ridge.bin_xi
    return replace(wave, blur=np.max([blur(cell, wave.wavevector, r.xi, r.omega, lobe, model) for model in MODELS], axis=0))


def _ridge_of(spectrum):
    try:  # no ridge is a result too: the wave decays
        return ridge(spectrum)
    except ValueError:
        return None


def report(records: Mapping[str, Sequence[Wave]]) -> str:
    """Distances of the ridges from the branches, as a table in words.

    Parameters
    ----------
    records : dict
        From the name of a record to its waves.

    Returns
    -------
    str
    """
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
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ['  '.join(f'{cell:{"<" if k < 2 else ">"}{widths[k]}}' for k, cell in enumerate(row)) for row in rows]
    resolution = next(iter(records.values()))[0].spectrum.bin_xi
    row = round(2 * np.pi / resolution)
    return '\n'.join(['RMS distance of the measured ridge from each branch, in wavenumber bins',
                      f'(1 bin = 2 pi/{row} = {resolution:.4g} rad per step; the row has {row} places).',
                      'Plain columns: D0 + D*; primed: D0 only; sigma: standard uncertainty of a ridge point.',
                      '', *lines, *_verdicts(records), *_doubts(records)])


def _verdicts(records):
    """For each ridge, the branches that it agrees with, in words."""
    lines, astray = [], False
    for record, found in records.items():
        for wave in found:
            misfits, on = wave.misfits, wave.agrees_with
            if on:
                branches = ', '.join(f'{model} {name} ({misfits[model, name].bins:.2f} bins)' for model, name in on)
                lines.append(f'{record}, {wave.motion} motion: agrees with {branches}')
            elif misfits:
                astray = True
                model, name = min(misfits, key=lambda name: misfits[name].bins)
                lines.append(f'{record}, {wave.motion} motion: agrees with no branch; the nearest is {model} {name} '
                             f'({misfits[model, name].bins:.2f} bins)')
    if astray:
        lines += ['', 'A ridge that agrees with no branch may come from several waves, from an oblique wave of which only the',
                  'energy runs along the row (a point source in an anisotropic lattice), from the ends of a beam, or from',
                  'another lattice.']
    return ['', *lines] if lines else []


def _doubts(records):
    """Possible reasons why a record has no ridge, or none near a branch."""
    waves, lines = [wave for found in records.values() for wave in found], []
    if any(wave.ridge is None for wave in waves):
        lines += ['', 'No ridge found (0 points): the wave is evanescent, below the noise, or a backward wave.']
    beside = [f'{wave.blurred} of {len(wave.sigma_xi)} points of {record}, {wave.motion} motion'
              for record, found in records.items() for wave in found if wave.blurred]
    if beside:
        lines += ['', 'A point source also sends oblique waves, of which only the energy runs along the row. Such a wave',
                  'within two bins of a ridge merges with it into one peak. Their distance is then part of the uncertainty,',
                  f'and the largest part for {"; ".join(beside)}.',
                  'A row of sources sends a single wave and leads to a smaller uncertainty.']
    far = [misfit.bins > FAR_bins for wave in waves for misfit in wave.misfits.values()]
    if far and all(far):
        lines += ['', f'No ridge comes within {FAR_bins} bins of a branch: are times in seconds, and row and lattice those of '
                      'the scene?']
    for record, found in records.items():
        top = max(branch.omega.max() for branch in found[0].branches.values())
        if found[0].spectrum.loudest < top / SLOW_RATIO:
            lines += ['', f'{record} moves at {units.hertz(found[0].spectrum.loudest):.3g} Hz and the branches reach up to '
                          f'{units.hertz(top):.3g} Hz: are its times in milliseconds? time_s is in seconds.']
    return lines
