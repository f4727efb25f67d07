"""Waves in the plane: the motion of any points of a field, resolved by wavevector, frequency and branch.

With windows h over the points and g over time, the motion u_j of the point on the site R_j has the transform

    G(k, omega) = sum_j h_j e^{i k.R_j} sum_t g_t u_j(t) e^{-i omega t}

and each branch contributes its component e.G with the polarisation e(k), which on lines of symmetry is transverse or longitudinal
for every law. If a cell has several particles, each of them has its own sum, and e spans all sums.  The points need no grid: a
direct sum over a thousand of them takes a second.  The record is cut into segments whose powers are added (Welch 1967), so that
bands are visible even in noise of the base or thermal noise. Waves in both directions, k and -k, count.

A cell of the map collects power from its surroundings. The centre of gravity of this power is (Auger and Flandrin 1995)

    omega_centre = omega - Im(sum G_g' G^*)/sum |G|^2        k_centre = k + Im(sum G_h' G^*)/sum |G|^2

This centre lies on the branch if the branch is straight within the lobe of the windows. The shift due to curvature is computed
from the bands of the scene and subtracted; half of it is added to the uncertainty.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from ase.dft.kpoints import BandPath, parse_path_string
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree  # pyright: ignore[reportAttributeAccessIssue]  its stub hides the name
from scipy.special import stdtrit

from .. import units
from ..bands.bands import group_velocities
from ..bands.bloch import bloch_modes, branch_names, first_zone
from ..results import InHertz, Saved
from .ridge_tables import FIELD, RidgePoints
from .spectrum import FEWEST, FIRST, GHOST, LEAST_CONTRAST, LEAST_POWER, NORMAL, hann, without_drift

if TYPE_CHECKING:
    from .scans import Scan

PAD = 2  # zero padding in time
MAPPED = 61  # wavevectors along each axis at which the motion at one frequency is taken
MARGIN = 1.3  # highest frequency of a map, in those of the bands
ROWS = 3  # width in spacings from which points are no row
TURNED, STRETCHED = np.radians(2.0), 0.03  # of the measured lattice against that of the scene; as for rows
ASTRAY = 0.3  # distance of a point from its site, in spacings, from which it belongs to none
MOST_APART = 50  # spacings between neighbouring points from which their unit is wrong
APART = 2.0  # distance of ridge points along the path in bins, at which the windows share no noise
NEAR = 1.0  # distance in bins of the centre of gravity of a cell's power from which that power belongs to another wave
BENT = 0.25
"""Shift of a point by the curvature of its branch, in frequency bins, above which the record does not resolve the point: near
Gamma and where branches meet."""
DOUBT = 0.5  # share of this shift that is uncertain: so well are the bands of the scene and the powers within the lobe known
UNEVEN = 0.005
"""Relative unevenness of frequencies within a specimen: its rim lacks neighbours and widens the lattice by about 0.2 %, so that
a window sees neither the value of the middle nor the mean."""
PURE = 0.98  # share of a branch in the one component that was measured, from which that component shows this branch alone
UNCHECKED = 0.25
"""Possible shift of the wavevector of a point, in bins, by power that leaks from strong waves to weak ones, if no neighbours on
both sides of the point reveal it."""
OTHER = 1.25  # factor between a frequency and the bands of both models of the scene beyond which it is another branch
LASTS = 0.6  # share of the segments with power from which it is noise, not a burst
FOLDED = 0.8  # share of half the sampling rate up to which a branch may be expected and its waves are not folded
LOBE_bins, GRID = 2.5, 9  # how far the lobe of the windows reaches, and samples across it
NORMAL_MEDIAN = 0.455  # median of the square of a normal variable


@dataclass(frozen=True)
class Field:
    """Measured motion of points that cover the plane of a lattice.

    Attributes
    ----------
    sites : ndarray, shape (points, 2)
        Lattice sites of the points in mm, from any origin.
    motions : ndarray, shape (frames, points, 2)
        Displacements in mm; zero along an axis that was not measured.
    measured : tuple of bool
        Which of the axes x and y were measured.
    dt : float
        Time between frames in ms.
    frames : int
        Number of frames in one segment.
    member : ndarray of int, shape (points,)
        Index of each point within its cell.
    spacing : float
        Distance of neighbouring cells in mm.
    across : float
        Smallest width of the field in spacings.
    notes : tuple of str
        What was found about the points, in words.
    """

    sites: np.ndarray
    motions: np.ndarray
    measured: tuple[bool, bool]
    dt: float
    frames: int
    member: np.ndarray
    spacing: float
    across: float
    notes: tuple[str, ...] = ()

    @property
    def bin_k(self) -> float:
        """Resolution in wavenumber, in rad/mm."""
        return 2 * np.pi / (self.across * self.spacing)

    @property
    def bin_omega(self) -> float:
        """Resolution in angular frequency, in rad/ms."""
        return 2 * np.pi / (self.frames * self.dt)

    def window(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The `hull_window` of the points, and its gradient."""
        return hull_window(self.sites, self.spacing)

    def transforms(self, top: float) -> Iterator[tuple[NDArray[np.float64], list[NDArray[np.complex128]]]]:
        """Yield for each segment the angular frequencies up to `top`, and the transforms with a Hann window and its derivative.

        They are divided by half the sum of the window, so that a wave of the amplitude A has the peak A.
        """
        window, slope = hann(self.frames)
        omega: Any = 2 * np.pi * np.fft.rfftfreq(PAD * self.frames, self.dt)
        kept = omega <= top
        for first in range(0, len(self.motions) - self.frames + 1, self.frames // 2):
            u = without_drift(self.motions[first : first + self.frames].reshape(self.frames, -1))
            yield omega[kept], [2 / window.sum() * np.fft.rfft(u * g[:, None], PAD * self.frames, axis=0)[kept].reshape(
                -1, *self.motions.shape[1:]) for g in (window, slope / self.dt)]


@dataclass(frozen=True)
class FieldMap(InHertz, Saved, kind='field maps', units={
    'q': ('reciprocal vectors', 'wavevectors', 'vectors'), 'omega': ('rad/ms', 'frequencies'),
    'power': ('mm^2', 'branches', 'wavevectors', 'frequencies'),
}):
    """Power of each branch as a function of wavevector and frequency.

    Attributes
    ----------
    q : ndarray, shape (wavevectors, 3)
        In fractions of the reciprocal vectors.
    omega : ndarray, shape (frequencies,)
        In rad/ms.
    power : ndarray, shape (branches, wavevectors, frequencies)
        In mm^2, the mean over all segments and both directions: a plane wave of amplitude A all the time has the peak A^2/2.
    """

    q: np.ndarray
    omega: np.ndarray
    power: np.ndarray


def hull_window(sites: NDArray[np.float64], spacing: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A Hann window over the distance from the hull of points, shape (points,), and its gradient, shape (points, 2)."""
    faces = ConvexHull(sites).equations
    depths = spacing / 2 - sites @ faces[:, :2].T - faces[:, 2]
    depth, phase = depths.min(axis=1).max(), np.pi * depths.min(axis=1) / depths.min(axis=1).max()
    return (1 - np.cos(phase)) / 2, -(np.pi / (2 * depth) * np.sin(phase))[:, None] * faces[depths.argmin(axis=1), :2]


def is_field(places: NDArray[np.float64], cell: Atoms) -> bool:
    """Whether points, shape (points, 2) in mm, cover the plane of a lattice, rather than one or a few of its rows."""
    away = places - places.mean(axis=0)
    return bool(cell.pbc[:2].all()) and np.ptp(away @ np.linalg.svd(away, full_matrices=False)[2][1]) > ROWS * _spacing(cell)


def field_of(scan: Scan, cell: Atoms) -> Field:
    """Assign the points of a scan to the sites of a lattice, and cut the record into segments of matching resolution.

    Parameters
    ----------
    scan : Scan
        A scan with places, in the frame of the cell, from any origin.
    cell : ase.Atoms
        With its PairCalculator.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.waves import Scan, field_of
    >>> cell = read_scene(ready_scene('prototype')).atoms()
    >>> places = np.array([(i, j) for i in range(12) for j in range(12)]) @ cell.cell.array[:2, :2] + [3, 4]
    >>> u = np.random.default_rng(0).normal(size=(2, 400, 144))
    >>> field = field_of(Scan(np.arange(400.0), tuple(map(str, range(144))), places, {'x': u[0], 'y': u[1]}), cell)
    >>> round(field.across, 1), field.frames < 200
    (10.5, True)
    """
    if not {'x', 'y'} & scan.motions.keys():
        raise ValueError('the record holds no motion along x or y, in the plane; name its columns u_x_m and u_y_m')
    sites, member, notes = _sites(np.asarray(scan.places), cell)
    if len(lacking := np.setdiff1d(np.arange(len(cell)), member)):
        raise ValueError(f'no point lies on particle {lacking[0] + 1} of the {len(cell)} in a cell; measure points of every kind')
    faces, spacing = ConvexHull(sites).equations[:, :2], _spacing(cell)
    across = float(np.ptp(sites @ faces.T, axis=0).min() / spacing + 1)
    if across < FEWEST:
        raise ValueError(f'the points are {across:.2g} spacings wide at their narrowest, and a map of the plane needs {FEWEST}; '
                         'measure more rows, or only one row')
    top = bloch_modes(cell, _zone(12), 'complete')[0].max()
    frames, wanted = len(scan.times), int(np.ceil(across * 2 * np.pi / top / scan.dt))
    if frames < max(wanted, FEWEST):
        raise ValueError(f'the record lasts {scan.dt * frames / units.s:.3g} s; record '
                         f'{scan.dt * max(wanted, FEWEST) / units.s:.3g} s to resolve frequencies as well as the points '
                         'resolve wavenumbers')
    own = Field(sites, np.stack([scan.motions.get(axis, np.zeros((frames, len(sites)))) for axis in 'xy'], axis=2),
                ('x' in scan.motions, 'y' in scan.motions), scan.dt, max(min(wanted, frames // 2), FEWEST), member,
                spacing, across)
    _refuse_ghosts(own, cell)
    half = np.pi / own.dt
    notes += [_half_seen(own).removeprefix('. ')] * (not all(own.measured))
    notes += [f'{len(sites)} points, {across:.1f} spacings across, resolve wavenumbers to 2 pi/{across:.1f} per spacing; '
              f'{(frames - own.frames) // (own.frames // 2) + 1} segments of {own.frames * own.dt / units.s:.3g} s resolve '
              f'frequencies to {units.hertz(own.bin_omega):.3g} Hz']
    if half < top:
        notes.append(f'sampled at {units.hertz(2 * half):.4g} Hz: the bands of the scene reach {units.hertz(top):.4g} Hz, and '
                     f'waves above {units.hertz(half):.4g} Hz appear at wrong frequencies, unless the instrument has a filter')
    return replace(own, notes=tuple(notes))


def _sites(places, cell):
    """Lattice sites of points, shape (points, 2) in mm, the index of each within its cell, and a note on the lattice."""
    vectors, basis, near = cell.cell.array[:2, :2], _basis(cell), _nearest(cell)
    apart = np.median(cKDTree(places).query(places, 2)[0][:, 1]) / near
    if not 1 / MOST_APART < apart < MOST_APART:
        raise ValueError(f'the points are {apart:.2g} spacings of the lattice apart; check the unit of the positions, and the '
                         'spacing of the scene')
    n, member, own, off = min((_indexed(places, vectors, basis, first) for first in range(len(basis))),
                              key=lambda found: np.median(found[-1]))
    k = int(off.argmax())
    if off[k] > ASTRAY * near:
        raise ValueError(f'the point at ({places[k, 0]:.4g}, {places[k, 1]:.4g}) mm is {off[k]:.3g} mm off the nearest site of '
                         'the lattice; omit points that are not particles, and check the spacing of the scene and the frame of '
                         'the positions (R1 lies along x)')
    if len(np.unique(np.column_stack([n, member]), axis=0)) < len(n):
        raise ValueError('two points stand on one site of the lattice; keep one record of each particle')
    A = np.linalg.solve(vectors, own)  # places in rows
    turn, stretch = np.arctan2(A[0, 1] - A[1, 0], A[0, 0] + A[1, 1]), np.sqrt(abs(np.linalg.det(A)))
    if abs(turn) > TURNED or abs(stretch - 1) > STRETCHED:
        raise ValueError(f'the points stand on a lattice turned by {np.degrees(turn):.3g} degrees against that of the scene, '
                         f'with {stretch:.4g} times its spacing; give positions in its frame (R1 along x), and its spacing')
    return n @ vectors + basis[member], member, [
        f'the points say that the spacing is {stretch * near:.4g} mm (scene: {near:.4g} mm); they lie '
        f'{np.sqrt(np.mean(off**2)):.2g} mm off their sites (root mean square)']


def _indexed(places, vectors, basis, first):
    """Cell and particle of each point, the measured lattice vectors, and distances from sites; `first` is the middle particle."""
    order, own = np.argsort(np.linalg.norm(places - places.mean(axis=0), axis=1)), vectors.copy()
    within = basis @ np.linalg.inv(vectors)  # in fractions of the lattice vectors
    origin = places[order[0]] - basis[first]

    def nearest(points):
        apart = points[:, None] - origin - within @ own
        cells = np.rint(apart @ np.linalg.inv(own))
        off = np.linalg.norm(apart - cells @ own, axis=2)
        which = off.argmin(axis=1)
        return cells[np.arange(len(points)), which], which, off.min(axis=1)

    for count in (*(2 ** np.arange(3, int(np.log2(len(places))) + 1)), len(places)):  # so that small rotations do not add up
        near = order[:count]
        n, which, _ = nearest(places[near])
        if np.linalg.matrix_rank(n - n.mean(axis=0)) == 2:
            (*own, origin), *_ = np.linalg.lstsq(np.c_[n + within[which], np.ones(count)], places[near])
            own = np.array(own)
    n, member, off = nearest(places)
    return n, member, own, off


def _refuse_ghosts(field, cell):
    """Raise ValueError if waves of two wavevectors look alike at these points."""
    steps = int(2 * field.across)
    q = _zone(steps)
    k = _k(q, cell)
    h, _ = field.window()
    ghosts = abs(h @ np.exp(1j * field.sites @ k.T)) / h.sum()
    away = np.linalg.norm(_k(q - np.rint(q), cell), axis=1)  # within the cell of reciprocal vectors about zero
    ghosts[away < LOBE_bins * field.bin_k] = 0
    if ghosts.max() > GHOST:
        at = q[ghosts.argmax()] - np.rint(q[ghosts.argmax()])
        raise ValueError(f'{len(h)} points are so far apart that waves look the same when their wavevectors differ by '
                         f'({at[0]:.2g}, {at[1]:.2g}) of the reciprocal vectors (aliasing; the ghost has '
                         f'{100 * ghosts.max():.0f} % of the amplitude, at most {100 * GHOST:.0f} % are allowed); measure '
                         'particles in between, some of them next to each other')


def _zone(steps):
    n = np.arange(steps) / steps
    return np.stack([*np.meshgrid(n, n, indexing='ij'), np.zeros((steps, steps))], axis=-1).reshape(-1, 3)


def _polarisations(cell, q):
    """Polarisations of waves e^{i k.x} with the positions x of the particles, mass-weighted, (..., branches, 2 particles)."""
    shapes: Any = bloch_modes(cell, q.reshape(-1, 3), 'complete', vectors=True)[1]
    phases = np.exp(-1j * _k(q, cell).reshape(-1, 2) @ _basis(cell).T)
    shapes = shapes[..., :2] * phases[:, None, :, None]
    return shapes.reshape(*q.shape[:-1], shapes.shape[1], -1)


def _k(q, cell):
    return 2 * np.pi * (q @ cell.cell.reciprocal().array)[..., :2]


def _basis(cell):
    """Positions of the particles of a cell relative to the first one, shape (particles, 2)."""
    return (cell.positions - cell.positions[0])[:, :2]


def _nearest(cell):
    """Distance of nearest neighbours in mm."""
    return _spacing(cell) if len(cell) == 1 else cell.calc.bonds.lengths.min()


def _spacing(cell):
    return float(cell.cell.lengths()[:2].min())


def _collected(field, cell, q, centres=False):
    """Yield for each segment frequencies, power and moments of each branch: (1 or 4, wavevectors, branches, frequencies)."""
    shapes, roots = _polarisations(cell, q), np.sqrt(cell.get_masses() / cell.get_masses().mean())
    h, slope = field.window()
    kinds = [np.flatnonzero(field.member == one) for one in range(len(cell))]
    waves = np.exp(1j * field.sites @ _k(q, cell).T)

    def over(motions, weight, sign):
        W = (waves if sign > 0 else waves.conj()) * weight[:, None]
        G = np.concatenate([np.tensordot(W[own] * root / h[own].sum(), motions[:, own], (0, 1))
                            for own, root in zip(kinds, roots, strict=True)], axis=2)
        return np.einsum('kfx,kmx->kmf', G, shapes if sign > 0 else shapes.conj())

    for omega, (u, u_slope) in field.transforms(MARGIN * bloch_modes(cell, _zone(12), 'complete')[0].max()):
        sums = 0.0
        for sign in (1, -1):
            G = over(u, h, sign)
            parts = [abs(G) ** 2]
            if centres:
                parts += [-(over(u_slope, h, sign) * G.conj()).imag,
                          *(sign * (over(u, along, sign) * G.conj()).imag for along in slope.T)]
            sums = sums + np.stack(parts) / 2
        yield omega, sums


def field_map(field: Field, cell: Atoms, path: BandPath) -> FieldMap:
    """Power of each branch along a path through the zone.

    Parameters
    ----------
    field : Field
    cell : ase.Atoms
        With its PairCalculator.
    path : ase.dft.kpoints.BandPath
    """
    (omega, *_), powers = zip(*_collected(field, cell, path.kpts), strict=True)
    return FieldMap(path.kpts, omega, np.swapaxes(np.mean(powers, axis=0)[0], 0, 1))


def field_ridges(field: Field, cell: Atoms, path: BandPath, name: str = 'field', source: str | None = None) -> RidgePoints:
    """Ridge points along a path: the strongest frequency of each branch at wavevectors so far apart that they share no noise.

    A point is kept if its power exceeds the background and that of the other branch at its frequency, and is at most 20 dB below
    the strongest point, and if its frequency is at most a quarter beyond the branches of the two models of the scene. Its centre
    of gravity must lie within a bin, because power that leaks from elsewhere has its centre there. The variance is the sum of the
    squares of four parts: the scatter between segments (the jackknife), the excess scatter of neighbouring points about a smooth
    curve, half of the shift due to the curvature of the branch, and half a percent for the unevenness of a specimen.

    Parameters
    ----------
    field : Field
    cell : ase.Atoms
        With its PairCalculator; its bands give the curvature.
    path : ase.dft.kpoints.BandPath
    name : str
        Name of the record.
    source : {'row', 'point', 'field'}, optional
        The source of the waves, 'field' for noise; by default 'field' if the motion lasts for the whole record, else 'point'.
    """
    q, leg, legs = _apart(path, cell, field.bin_k)
    (omega, *_), parts = zip(*_collected(field, cell, q, centres=True), strict=True)
    parts = np.stack(parts)  # segments, power and its moments, wavevectors, branches, frequencies
    power = np.where(_seen(field, cell, q, omega, parts.sum(axis=0)), parts[:, 0].sum(axis=0), 0)
    peak, height = power.argmax(axis=-1), power.max(axis=-1)
    bent = _bent(field, cell, q, omega[peak])
    resolved = abs(bent) < BENT * field.bin_omega
    found = (height > LEAST_POWER * height.max(axis=0)) & resolved
    branch, at = np.nonzero(found.T)
    if not len(branch):
        raise ValueError('no wave near a branch of the scene rises above the noise; measure longer, drive harder, or correct '
                         f'the scene: crests are sought near its bands{_half_seen(field)}')
    crests = _Crests(cell, branch, omega[peak[at, branch]], _k(q[at], cell), parts[:, :, at, branch, peak[at, branch]])
    centre, at_q, off = crests.centred(crests.parts.sum(axis=0))
    bent, three = bent[at, branch], _neighbours(at, leg[at], branch)
    variance = crests.variance + (DOUBT * bent) ** 2 + (UNEVEN * centre) ** 2
    variance += _scatter(field, off - bent, crests.variance, three)
    if resolved[~found].any() and len(alone := np.setdiff1d(np.arange(len(at)), three)):
        velocity = np.nan_to_num(group_velocities(cell, at_q[alone], 'complete').velocity[np.arange(len(alone)), branch[alone]])
        variance[alone] += (UNCHECKED * field.bin_k) ** 2 * (velocity**2).sum(axis=1)
    ridges, ridge = np.unique(len(legs) * branch + leg[at], return_inverse=True)
    motions = tuple(branch_names(len(cell))[one // len(legs)] for one in ridges)
    names = tuple(f'{name} {legs[one % len(legs)]}, {motion}' for one, motion in zip(ridges, motions, strict=True))
    k = np.linalg.norm(_k(at_q, cell), axis=1) * field.spacing
    return RidgePoints(names, motions, ridge, at_q, xi=k, sigma_xi=0 * k, omega=centre - bent, sigma_omega=np.sqrt(variance),
                       power=crests.parts[:, 0].mean(axis=0), line=0 * k,
                       sources=(source or _source(parts[:, 0].sum(axis=(1, 2, 3))),) * len(ridges),
                       bin_xi=np.full(len(k), field.bin_k * field.spacing))


def _seen(field, cell, q, omega, parts):
    """Which cells of a map show a branch: power above the background, with its centre there, near the bands of the scene."""
    power, *moments = parts
    with np.errstate(divide='ignore', invalid='ignore'):
        d_omega, *d_k = moments / power
    background = np.median(power[..., FIRST * PAD :], axis=-1, keepdims=True) / np.log(2)
    seen = ((power > LEAST_CONTRAST * background) & (abs(d_omega) < field.bin_omega) & (np.hypot(*d_k) < NEAR * field.bin_k)
            & (np.hypot(*(_k(q, cell).T[:, :, None, None] + d_k)) > field.bin_k))  # else all moves as one
    seen[..., : FIRST * PAD] = False
    if all(field.measured):
        seen &= power == power.max(axis=1, keepdims=True)
    else:
        shapes = _polarisations(cell, q)[:, :, int(field.measured[1]) :: 2]
        seen &= (np.linalg.norm(shapes, axis=2) > PURE)[..., None]
    models = np.stack([bloch_modes(cell, q, model)[0] for model in ('complete', 'conventional')])
    low, high = models.min(axis=0) / OTHER, np.minimum(models.max(axis=0) * OTHER, FOLDED * np.pi / field.dt)
    return seen & (omega > low[..., None]) & (omega < high[..., None])


@dataclass(frozen=True)
class _Crests:
    """Cells of a map at the crests of branches: their frequencies and wavevectors, and in each segment their power and its
    moments, shape (segments, 4, crests).
    """

    cell: Atoms
    branch: np.ndarray
    omega: np.ndarray
    k: np.ndarray
    parts: np.ndarray

    def centred(self, sums):
        """Frequencies and wavevectors of the centres of gravity, and their distances in frequency from the scene's branches."""
        centre = self.omega + sums[..., 1, :] / sums[..., 0, :]
        k = self.k + np.moveaxis(sums[..., 2:, :] / sums[..., :1, :], -2, -1)
        q = np.concatenate([k, 0 * k[..., :1]], axis=-1) @ self.cell.cell.array.T / (2 * np.pi)
        bands = bloch_modes(self.cell, q, 'complete')[0].reshape(*k.shape[:-1], -1)
        own = np.take_along_axis(bands, np.broadcast_to(self.branch, centre.shape)[..., None], axis=-1)[..., 0]
        return centre, q, centre - own

    @cached_property
    def variance(self):
        """Variance of the frequencies by the jackknife over the segments."""
        whole = self.parts.sum(axis=0)
        freedom = np.maximum(whole[0] ** 2 / (self.parts[:, 0] ** 2).sum(axis=0), 1)  # so many segments share the power
        spread = self.centred(whole - self.parts)[2].var(axis=0)
        return (len(self.parts) - 1) * spread * (stdtrit(freedom, 0.975) / NORMAL) ** 2


def _neighbours(at, leg, branch):
    """Indices of each three neighbouring points of one branch on one leg of the path, shape (triples, 3)."""
    three = np.arange(max(len(at) - 2, 0))[:, None] + np.arange(3)
    along = (np.ptp(one[three], axis=1) == step for one, step in ((branch, 0), (leg, 0), (at, 2)))
    return three[np.logical_and.reduce(list(along))]


def _source(power):
    """The source of waves by the power of the segments: noise of the whole plane lasts, and a burst from a point does not."""
    lasts = len(power) >= FEWEST and power.sum() ** 2 > LASTS * len(power) * power @ power
    return FIELD if lasts else 'point'


def _apart(path, cell, bin_k):
    """Wavevectors along a path that share no noise, shape (wavevectors, 3), the leg of each, and the names of the legs."""
    q, leg, legs = [], [], []
    for names in parse_path_string(path.path):
        for one, other in pairwise(names):
            first, last = path.special_points[one], path.special_points[other]
            count = int(np.linalg.norm(_k(last - first, cell)) / (APART * bin_k))
            q.append(first + (np.arange(count)[:, None] + 0.5) / max(count, 1) * (last - first))
            leg += count * [len(legs)]
            legs.append(f'{one}-{other}')
    return np.concatenate(q), np.array(leg, int), legs


def _bent(field, cell, q, omega):
    """Shift in frequency of centres of gravity due to curvature of the branches, for uniform power; (wavevectors, branches)."""
    beside = LOBE_bins * field.bin_k * np.linspace(-1, 1, GRID)
    offset = np.stack(np.meshgrid(beside, beside), axis=-1).reshape(-1, 2)
    h, _ = field.window()
    lobe = abs(np.exp(1j * offset @ field.sites.T) @ h) ** 2
    in_fractions = offset @ cell.cell.array[:2, :2].T / (2 * np.pi)
    there = q[:, None] + np.pad(in_fractions, ((0, 0), (0, 1)))
    bands = bloch_modes(cell, there.reshape(-1, 3), 'complete')[0].reshape(*there.shape[:2], -1)
    shapes = _polarisations(cell, there)
    away = (bands[:, None] - omega[:, :, None, None]) / field.bin_omega  # wavevectors, branches, offsets, branches there
    with np.errstate(divide='ignore', invalid='ignore'):
        line = np.where(abs(away) < 2, np.sinc(away) / (1 - away**2), 0) ** 2  # of a Hann window
        share = abs(np.einsum('kmx,konx->kmon', _polarisations(cell, q).conj(), shapes)) ** 2
        weight = share * lobe[:, None] * np.nan_to_num(line, posinf=0.25)
        weight /= weight.sum(axis=(2, 3), keepdims=True)
    centre = q[:, None] + np.pad(weight.sum(axis=3) @ in_fractions, ((0, 0), (0, 0), (0, 1)))
    at_centre = bloch_modes(cell, np.nan_to_num(centre).reshape(-1, 3), 'complete')[0].reshape(*omega.shape, -1)
    return (weight * bands[:, None]).sum(axis=(2, 3)) - np.einsum('kmm->km', at_centre)


def _half_seen(field):
    """The end of a message about what a single measured component hides; '' if both were measured."""
    if all(field.measured):
        return ''
    axis = 'xy'[field.measured.index(True)]
    return (f'. The record has the motion along {axis} alone, which shows a branch only where its waves move along {axis}, '
            'on some lines of the path: measure the other component too, and put both into one record')


def _scatter(field, off, variance, three):
    """Excess variance of points about a smooth curve, from the second differences of each three neighbouring points.

    Only this reveals errors that are the same in all segments, such as those from uniform noise of the base.
    """
    if not len(three):
        raise ValueError('no three neighbouring points of a branch rise above the background; record longer, drive harder, '
                         f'or measure more particles{_half_seen(field)}')
    weights = np.array([1, -2, 1])
    squares, known = (off[three] @ weights) ** 2, variance[three] @ weights**2
    common = max(np.median(squares) / NORMAL_MEDIAN - np.median(known), 0) / 6 * (stdtrit(len(three), 0.975) / NORMAL) ** 2
    own = np.zeros(len(off))
    own[three[:, 1]] = (squares - known) / 6
    return np.maximum(common, own)


def field_at(field: Field, cell: Atoms,
             omega: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.complex128]]:
    """Motion at one frequency: its power at each wavevector (isofrequency contour) and its shape at the points.

    Parameters
    ----------
    field : Field
    cell : ase.Atoms
    omega : float
        In rad/ms.

    Returns
    -------
    k : ndarray, shape (wavevectors,)
        Both components of the wavevectors, in rad/mm, over the first zone.
    power : ndarray, shape (wavevectors, wavevectors)
        Power at (k_y, k_x), of both components of the motion, in mm^2.
    shape : ndarray of complex, shape (points, 2)
        In mm: the coherent motion with the largest share of the power of all segments; its phase is zero where it is largest.
    """
    half = np.pi / field.dt
    if not 0 < omega < half:
        raise ValueError(f'{units.hertz(omega):.4g} Hz is not between 0 and half the sampling rate, {units.hertz(half):.4g} Hz')
    k = np.linspace(-1, 1, MAPPED) * np.linalg.norm(first_zone(cell.cell.array), axis=1).max()
    h, _ = field.window()
    to_k = np.exp(1j * np.stack(np.meshgrid(k, k), axis=-1).reshape(-1, 2) @ field.sites.T) * (h / h.sum())
    frames = len(field.motions) // 2  # longer than segments: one frequency is wanted as sharply as the record has it
    wave = hann(frames)[0] * np.exp(-1j * omega * field.dt * np.arange(frames))
    motions = np.array([np.tensordot(2 * wave / abs(wave).sum(), field.motions[first : first + frames], 1)
                        for first in (0, frames // 2, frames)])  # segments, points, 2
    power = np.mean([np.sum(abs(to_k @ u) ** 2, axis=1) for u in motions], axis=0)
    _, sizes, shapes = np.linalg.svd(motions.reshape(len(motions), -1), full_matrices=False)
    shape = sizes[0] / np.sqrt(len(motions)) * shapes[0].reshape(-1, 2)
    largest = shape.ravel()[abs(shape).argmax()]
    return k, power.reshape(MAPPED, MAPPED), shape * abs(largest) / largest
