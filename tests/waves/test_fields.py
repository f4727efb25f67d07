"""Records of points of the plane, of a lattice that the package did not simulate: bands, ridges, and lattices fitted to them."""

from functools import cache

import numpy as np
import pytest

from magphonon import read_scene
from magphonon.bands import band_path
from magphonon.cli.main import main
from magphonon.scenes import fit_bands
from magphonon.waves import Scan, field_at, field_map, field_of, field_ridges, read_ridges, write_points
from workflows import bench_lattice as bench

SPACING, REACH = 10e-3, 45e-3  # m
VECTORS = bench.triangular(SPACING)
MOTIONS = 'transverse', 'longitudinal'


def scene_of(folder, shells=9, force=0.26, springs=23.0):
    """The lattice as its owner knows it: some ten percent off."""
    (file := folder / f'lattice_{shells}.toml').write_text(
        f'title = "field"\n[lattice]\nkind = "triangular"\nspacing_m = {SPACING}\nmass_kg = 8e-4\n[law]\nkind = "inverse_power"\n'
        f'b_N_m_a = {force * SPACING**4}\na = 4.0\nshells = {shells}\n[foundation]\nstiffness_N_per_m = {springs}\n', encoding='utf-8')
    return read_scene(file)


@cache
def law():
    return bench.tabulated(bench.disc_force(2.5e-3, 5e-3, 1.32), 7e-3, REACH + 5e-3)


@cache
def specimen(seed, width=0.24, height=0.24):
    """A patch, its modes, and the lattice vectors of its inner part."""
    lab = bench.built(bench.sites(VECTORS, width, height), law(), REACH, np.random.default_rng(seed))
    return lab, bench.modes(lab), bench.mean_vectors(lab, VECTORS, 6 * SPACING)


def moved(lab, modes, kind, seconds, rng, rate=1000.0):
    """Displacements, shape (frames, magnets, 2), over so many s after a burst or amid noise, in any unit."""
    omega, shapes = modes
    frames = int(2 * seconds * rate)  # the half that is thrown away ends the beginnings
    w = 2 * np.pi * np.fft.rfftfreq(frames, 1 / rate)
    band = w < 2 * np.pi * 250
    if kind in ('row', 'point'):
        y, x = lab.anchors[:, 1], lab.anchors[:, 0]
        inside = np.flatnonzero(~lab.held)
        source = inside[y[inside] < y[inside].min() + SPACING / 2] if kind == 'row' else [int(np.hypot(x, y).argmin())]
        force = np.einsum('nxm,x->m', shapes[source], [0.6, 0.8])[:, None] * np.fft.rfft(bench.burst(60, 3)(np.arange(frames) / rate))
    elif kind == 'base':
        force = np.einsum('nxm,n,xf->mf', shapes, lab.masses, rng.normal(size=(2, len(w), 2)).view(complex)[..., 0] * band)
    else:
        force = rng.normal(size=(len(omega), len(w), 2)).view(complex)[..., 0] * band
    modal = np.fft.irfft(force / (omega[:, None] ** 2 + 1j * lab.damping * w - w**2), frames)[:, : frames // 2]
    return np.einsum('nxm,mt->tnx', shapes, modal, optimize=True)


def scan_of(lab, u, rng, missing=0.05, shift=(30.0, -40.0), axes='xy'):
    """As an instrument gives it: from an origin of its own, with noise, drift and jitter, and without some of the magnets."""
    kept = np.flatnonzero(~lab.held & (rng.random(len(u[0])) > missing))
    shown = bench.measured(u[:, kept], 1000.0, rng, noise=0.01, jitter=1e-4, drift=0.01)
    places = 1e3 * lab.rest[kept] + shift + 0.05 * rng.normal(size=(len(kept), 2))
    scale = 1e-3 / abs(u).max()
    return Scan(np.arange(len(u)) * 1.0, tuple(map(str, kept)), places,
                {axis: scale * shown[..., 'xy'.index(axis)] for axis in axes})


def truth(lab, vectors, points):
    """Frequencies in Hz of the branch of each point, in the lattice of the specimen."""
    k = 2 * np.pi * points.q[:, :2] @ np.linalg.inv(VECTORS).T
    both = bench.bloch(lab.law, vectors, REACH, k @ np.linalg.inv(vectors @ np.linalg.inv(VECTORS)).T) / (2 * np.pi)
    return both[np.arange(len(k)), [MOTIONS.index(points.motions[one]) for one in points.ridge]]


def share(points, expected):
    return np.mean(abs(points.frequencies_Hz - expected) < 1.96 * points.sigma_omega * 1e3 / (2 * np.pi))


def test_noise_alone_gives_bands_and_the_control_without_static_forces_misses(tmp_path):
    rng, scene = np.random.default_rng(1), scene_of(tmp_path)
    lab, modes, vectors = specimen(1, 0.2, 0.2)
    field = field_of(scan_of(lab, moved(lab, modes, 'thermal', 2.0, rng), rng), scene.perfect_cell())
    points = field_ridges(field, scene.perfect_cell(), band_path(scene.perfect_cell(), 'GMKG'))
    expected = truth(lab, vectors, points)
    assert len(points) > 15
    assert {*points.motions} == {*MOTIONS}
    assert share(points, expected) >= 0.85
    shear = np.array([points.motions[one] == 'transverse' for one in points.ridge])
    without = bench.bloch(lab.law, vectors, REACH, 2 * np.pi * points.q[:, :2] @ np.linalg.inv(VECTORS).T, static=False)[:, 0] / (2 * np.pi)
    assert np.mean(abs(points.frequencies_Hz - without)[shear] < 1.96 * points.sigma_omega[shear] * 1e3 / (2 * np.pi)) < 0.1
