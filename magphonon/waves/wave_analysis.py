"""Waves along a row of particles, simulated or measured: map and ridge of each polarisation, compared with the bands.

A row near a point source shows more than the waves that propagate along it. A point source sends waves in all directions, and
those whose group velocity points along the lattice vector R arrive along the row.  Let xi = k.R be the phase per step, and s a
shift of the wavevector across R, in units of the primitive reciprocal vector, that does not change xi.  The group velocity is
along the row if

    d omega(xi, s) / ds = 0

so that the row shows every extremum of omega over s. By symmetry the wave along the row, s = 0, is one of them.  The others are
oblique waves: only their energy runs along the row. Two waves closer together than the main lobe of the Hann window make one peak
on a map, somewhere between them.  The ridge is then shifted in the same direction at all frequencies, so that neither noise, nor
the halves of the row, nor jumps from line to line reveal it. `Wave.blur` is the largest possible shift.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from ..bands.bloch import bloch_modes
from ..errors import finite, one_of
from ..results import InHertz
from ..stiffness.matrices import MODELS, Model
from ..traits import LINEAR, takes
from .rows import Row, row_of
from .spectrum import LEAST_POWER, NORMAL, RESOLVED, Ridge, Spectrum, ridge, wavenumber_frequency, without_drift
from .wave_source import across_and_along, polarisations, wavevector

if TYPE_CHECKING:
    from ..dynamics.motion import Motion
    from .scans import Scan

BRANCH_POINTS = 2001
"""Number of samples of a branch; linear interpolation between them is accurate to 1e-6 of its highest frequency."""
BRANCHES = {'shear': 0, 'longitudinal': 1}
"""Index of each branch, counted from the lowest: repulsion makes shear the softer of the two acoustic branches."""
REST_FRACTION = 1e-6  # a motion weaker than this fraction of the other polarisation is round-off
SAME = 0.99
"""Cosine from which a measured component is the motion across or along the wavevector: less than -17 dB of the other is in it."""
SAMPLES = 96
"""Samples of xi from 0 to pi, and of s over its period, in a cell of one particle; the zone of larger cells is smaller."""
LOBE_bins = 2.0  # half width of the main lobe of a Hann window in wavenumber bins: waves that are nearer make one peak


@dataclass(frozen=True)
class Branch(InHertz):
    """One branch of the bands as a function of the phase per step.

    Attributes
    ----------
    xi : ndarray, shape (points,)
        In rad, ascending.
    omega : ndarray, shape (points,)
        In rad/ms.
    """

    xi: np.ndarray
    omega: np.ndarray


@takes(*LINEAR, 'all neighbours')
def branch(atoms: Atoms, direction: ArrayLike, mode: int, model: Model | None = None) -> Branch:
    """Branch of the analytic bands for the waves that a row of particles sees, from xi = 0 to pi.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator.
    direction : array_like, shape (3,)
        The wavevector at which xi = 2 pi, in fractions of the reciprocal vectors.  In the triangular lattice, along R2, it is
        (0, 1, 0) for plane waves from a row of sources along R1 (Gamma-M), and (1/2, 1, 0) for waves from a point source
        (Gamma-K).
    mode : int
        Number of the branch, counted from 0 by frequency; in the triangular lattice shear is 0 and longitudinal 1.
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import read_scene, units as u
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.waves import branch
    >>> shear = branch(read_scene(ready_scene('prototype')).atoms(), (0, 1, 0), 0)
    >>> round(float(u.hertz(shear.omega[-1])), 3)  # at M
    58.233
    """
    xi = np.linspace(0, np.pi, BRANCH_POINTS)
    omega, _ = bloch_modes(atoms, xi[:, None] / (2 * np.pi) * finite('direction', direction, (3,)), model)
    one_of('mode', mode, range(omega.shape[1]))
    return Branch(xi, omega[:, mode])


@dataclass(frozen=True)
class Misfit:
    """Distance of a ridge from a branch, root mean square over its points.

    Attributes
    ----------
    omega : float
        Distance along the frequency axis, at the wavenumber of each point, in rad/ms.
    sigma_omega : float
        The value of `omega` that the uncertainty of the points alone would cause.
    bins : float
        Distance along the wavenumber axis, at the frequency of each point, in bins of the record.
    within : float
        Share of the points within 1.96 of their uncertainties from the branch, along the frequency axis.
    points : int
    """

    omega: float
    sigma_omega: float
    bins: float
    within: float
    points: int

    @property
    def agrees(self) -> bool:
        """Whether the ridge may be a wave of this branch.

        At least half of its points must be within 1.96 of their uncertainties, and the root mean square distance within a bin:
        two waves a bin apart are resolved, however uncertain each is.
        """
        return self.within >= 0.5 and self.bins <= RESOLVED


def compare(ridge: Ridge, branch: Branch) -> Misfit:
    """Distance between a ridge and a branch along either axis.

    If a branch does not reach a frequency, its nearest point is used: the wave is evanescent there, and the real part of its
    wavenumber stays at that of the band edge.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.waves import compare, ridge, wavenumber_frequency
    >>> from magphonon.waves.wave_analysis import Branch
    >>> t, x = np.arange(0, 400, 0.5)[:, None], np.arange(24)
    >>> s = t - x / 0.6 - 100
    >>> crest = ridge(wavenumber_frequency(1e-3 * np.exp(-((s / 20) ** 2)) * np.cos(0.5 * s), 0.5))
    >>> xi = np.linspace(0, np.pi, 50)
    >>> bool(compare(crest, Branch(xi, 0.6 * xi)).bins < 0.1 < compare(crest, Branch(xi, 0.8 * xi)).bins)
    True
    """
    own = np.interp(ridge.xi, branch.xi, branch.omega)
    d_omega = ridge.omega - own
    d_xi = ridge.xi - np.array([_nearest_crossing(branch, omega, xi) for omega, xi in zip(ridge.omega, ridge.xi, strict=True)])
    sides = [np.interp(ridge.xi + side * ridge.sigma_xi, branch.xi, branch.omega) - own for side in (1, -1)]
    sigma = np.hypot(ridge.sigma_omega, np.abs(sides).max(axis=0))  # not by the slope, which vanishes at the edge of the zone
    within = float(np.mean(abs(d_omega) <= NORMAL * sigma))
    return Misfit(_rms(d_omega), _rms(sigma), _rms(d_xi) / ridge.bin_xi, within, len(d_xi))


def _nearest_crossing(branch, omega, xi):
    above = branch.omega - omega
    before = np.flatnonzero(above[:-1] * above[1:] <= 0)
    if not len(before):
        return branch.xi[abs(above).argmin()]
    run, rise = branch.xi[before + 1] - branch.xi[before], above[before + 1] - above[before]
    crossings = branch.xi[before] - above[before] * run / np.where(rise == 0, np.inf, rise)
    return crossings[abs(crossings - xi).argmin()]


def _rms(x):
    return float(np.sqrt(np.mean(x**2)))


@dataclass(frozen=True)
class Wave:
    """The wave of one polarisation along a row, with the branches to compare it with.

    Attributes
    ----------
    motion : str
        'transverse' or 'longitudinal', across or along the wavevector; or the name of a single measured component between them.
    spectrum : Spectrum
    branches : dict of Branch
        Branches by model and name, such as ('complete', 'shear').
    wavevector : ndarray, shape (3,)
        Wavevector of xi = 2 pi, in fractions of the reciprocal vectors.
    ridge : Ridge or None
        None if no wave rises above the background, because it decays or was not driven.
    source : {'row', 'point'}
        Kind of source that sent the wave.
    blur : ndarray, shape (points,), optional
        Possible error of its wavenumbers in rad, because oblique waves from a point source blend with it;
        None for a row of sources.
    """

    motion: str
    spectrum: Spectrum
    branches: dict[tuple[str, str], Branch]
    wavevector: np.ndarray
    ridge: Ridge | None
    source: str = 'point'
    blur: np.ndarray | None = None

    @property
    def sigma_xi(self) -> NDArray[np.float64]:
        """Standard uncertainty of the wavenumbers of the ridge in rad, its blur included, shape (points,)."""
        return np.zeros(0) if self.ridge is None else np.hypot(self.ridge.sigma_xi, 0 if self.blur is None else self.blur)

    @property
    def blurred(self) -> int:
        """Number of ridge points to whose uncertainty oblique waves contribute more than all other causes."""
        return 0 if self.ridge is None or self.blur is None else int((self.blur > self.ridge.sigma_xi).sum())

    @cached_property
    def misfits(self) -> dict[tuple[str, str], Misfit]:
        """Distance of the ridge from each branch, a dict of Misfit; empty without a ridge."""
        if self.ridge is None:
            return {}
        ridge = replace(self.ridge, sigma_xi=self.sigma_xi)
        return {name: compare(ridge, branch) for name, branch in self.branches.items()}

    @property
    def agrees_with(self) -> tuple[tuple[str, str], ...]:
        """Model and name of the branches that agree with the ridge within its uncertainties, the nearest first.

        D* hardly changes longitudinal waves, and an error of 10 % in the force moves the branches of both models past the ridge.
        So if the ridge agrees with one of the two, it also agrees with the other, unless that is more than a bin away.
        """
        misfits = self.misfits
        on = {name for name in misfits if misfits[name].agrees}
        if any(name == 'longitudinal' for _, name in on):
            on |= {name for name in misfits if name[1] == 'longitudinal' and misfits[name].bins <= RESOLVED}
        return tuple(sorted(on, key=lambda name: misfits[name].bins))


def waves(row: Motion, cell: Atoms, source: str) -> list[Wave]:
    """The waves along a row, the strongest polarisation first; a polarisation 20 dB weaker than the other is left out.

    Waves from a point source move the row both across and along its line, so the ridge of one polarisation may follow the branch
    of the other.  A branch that falls with the wavenumber, such as shear in a square lattice on springs, carries backward waves
    (phase and group velocity of opposite sign). No ridge is found for them, because the row is known to begin at the source.

    Parameters
    ----------
    row : Motion
        The motion of particles in equal steps of R2, away from the source.
    cell : ase.Atoms
        With its PairCalculator.
    source : {'row', 'point'}
    """
    motions = {name: row.along(direction) for name, direction in polarisations(cell, source).items()}
    return _analysed(motions, row.dt, None, cell, wavevector(cell, source), source)


def scan_waves(scan: Scan, cell: Atoms, source: str = 'point', row: Row | None = None) -> list[Wave]:
    """The waves along a scanned row, the strongest first, as `waves` finds them on a row without gaps.

    Parameters
    ----------
    scan : Scan
        A scan with places.
    cell : ase.Atoms
        With its PairCalculator.
    source : {'row', 'point'}
        'row' for fronts along R1, 'point' for fronts across the measured row.
    row : Row, optional
        By default the row of the lattice on which the points lie. It begins at the end from which the phases of the stronger
        waves come. For backward waves this is the far end, so that their ridge is found too.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
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
    """The motion across and along the wavevector; if only one direction was measured, the motion in that direction."""
    if {'x', 'y'} <= scan.motions.keys():
        return {name: x * scan.motions['x'] + y * scan.motions['y'] for name, (x, y) in directions.items()}
    part = next((part for part in ('x', 'y', '') if part in scan.motions), None)
    if part is None:
        raise ValueError('the scan holds motion along z alone, out of the plane in which the particles of the scene move; '
                         'measure x or y')
    named = [name for name, direction in directions.items() if part and abs(direction['xy'.index(part)]) > SAME]
    return {named[0] if named else part or 'measured': scan.motions[part]}


def _begun_at_the_source(scan, row):
    """The row, with its beginning at the end from which the stronger waves come."""
    u = max(scan.motions.values(), key=lambda u: np.var(without_drift(u), axis=0).sum())[:, row.order]
    spectrum = wavenumber_frequency(u, scan.dt, row.steps)
    forward, backward = (spectrum.power[:, side].max() for side in (spectrum.xi > 0, spectrum.xi < 0))
    return row if forward >= backward else row.reversed


def _analysed(motions, dt, steps, cell, q, source):
    """The waves in each of the `motions`, shape (frames, points) by name; q is their wavevector at xi = 2 pi."""
    largest = {name: abs(without_drift(u)).max() for name, u in motions.items()}
    moving = [name for name in motions if largest[name] > REST_FRACTION * max(largest.values())]
    maps = {name: wavenumber_frequency(motions[name], dt, steps) for name in moving or motions}  # which refuses a row at rest
    least = LEAST_POWER * max(found.peak for found in maps.values())
    branches = {(model, name): branch(cell, q, mode, model) for model in MODELS for name, mode in BRANCHES.items()}
    strongest_first = sorted((name for name in maps if maps[name].peak > least), key=lambda name: -maps[name].peak)
    found = [Wave(name, maps[name], branches, q, _crest(maps[name]), source) for name in strongest_first]
    return _blurred(found, cell, q)


def _crest(spectrum):
    """The ridge of a map; None, which is a result too, where the wave decays."""
    with suppress(ValueError):
        return ridge(spectrum)
    return None


def _blurred(waves, cell, q):
    """The waves; those of a point source with the distance at which oblique waves may blend with each ridge."""
    if not any(wave.ridge and wave.source != 'row' for wave in waves):
        return waves
    stationary = [stationary_waves(cell, q, model) for model in MODELS]
    return [replace(wave, blur=np.max([blur(*one, wave.ridge) for one in stationary], axis=0)) if wave.ridge else wave
            for wave in waves]


@dataclass(frozen=True)
class Stationary:
    """Waves whose energy runs along a row, on a grid of the zone: their phases per step, frequencies and slopes."""

    xi: np.ndarray  # in rad, shape (waves,), as the others
    omega: np.ndarray  # in rad/ms
    slope: np.ndarray  # d omega/d xi along the row
    step: float  # distance of the grid in xi

    def phases(self, omega: ArrayLike) -> NDArray[np.float64]:
        """Phases per step in rad of the waves that run away from the source, at these frequencies, shape (frequencies, waves).

        NaN where a wave does not have this frequency.
        """
        with np.errstate(divide='ignore', invalid='ignore'):
            found = self.xi + (np.reshape(omega, (-1, 1)) - self.omega) / self.slope
        return np.where((abs(found - self.xi) <= self.step) & (self.slope > 0), found, np.nan)


def stationary_waves(cell: Atoms, q: ArrayLike, model: Model | None = None) -> tuple[Stationary, Stationary]:
    """The waves of a point source whose energy runs along a row: those along the row, and the oblique ones.

    `q` is the wavevector of xi = 2 pi along the row, in fractions of the reciprocal vectors, such as `wavevector(cell, 'point')`.
    """
    q = np.asarray(q, float)
    samples = int(np.ceil(SAMPLES / np.sqrt(len(cell))))
    xi, s = np.pi * (np.arange(samples) + 0.5) / samples, np.arange(samples) / samples
    at = xi[:, None, None] / (2 * np.pi) * q + s[:, None] * _across(cell, q)
    field = bloch_modes(cell, at.reshape(-1, 3), model)[0].reshape(samples, samples, -1)
    before, after = np.roll(field, 1, axis=1), np.roll(field, -1, axis=1)
    oblique = (field - before) * (field - after) > 0
    with np.errstate(divide='ignore', invalid='ignore'):  # the top of the parabola through three samples of s
        peak = field - np.where(oblique, (after - before) ** 2 / (8 * (after + before - 2 * field)), 0)
    along = np.zeros_like(oblique)
    along[:, 0] = True
    slope = np.asarray(np.gradient(field, xi, axis=0))
    step = xi[1] - xi[0]
    one, other = (Stationary(xi[some[0]], peak[some], slope[some], step) for some in map(np.nonzero, (along, oblique & ~along)))
    return one, other


def _across(cell, q):
    """The primitive reciprocal vector across the row, in fractions; zero in a chain, which has only one direction."""
    fractions = np.linalg.pinv(cell.cell.array)
    k = fractions @ q
    R = np.rint(k @ fractions / (k @ k))  # the step of the row, in lattice vectors
    return np.array([-R[1], R[0], 0]) * cell.pbc[:2].all()


def blur(along: Stationary, oblique: Stationary, ridge: Ridge) -> NDArray[np.float64]:
    """Possible distance of each ridge point from the wave along the row, because oblique waves blend with it, shape (points,).

    It is the distance in xi from the nearest wave along the row to the farthest oblique wave. Only oblique waves within a lobe of
    both this wave and the point count.
    """
    lobe, xi = LOBE_bins * ridge.bin_xi, ridge.xi[:, None]
    own, others = along.phases(ridge.omega), oblique.phases(ridge.omega)
    own = np.take_along_axis(own, np.where(np.isnan(own), np.inf, abs(own - xi)).argmin(axis=1)[:, None], axis=1)
    beside = (abs(others - xi) < lobe) & (abs(others - own) < lobe)
    return np.nanmax(np.where(beside, abs(others - own), 0), axis=1, initial=0)
