"""Intervals of fitted transfer functions on patches of a laboratory that shares nothing with the package (all with -m long)."""

import re

import numpy as np
import pytest

from magphonon import read_scene
from magphonon.cli.fit_report import frf_report
from magphonon.response import Dof
from magphonon.response.transfer_functions import TransferFunction
from magphonon.scenes import band_fits, fit_frf
from workflows import bench_lattice as bench

L = 10e-3  # m
A, MASS, DAMPING = 4.2, 8e-4, 6.0
BENT = 3.2, 6.5  # the powers whose sum is a law that is none
DISC = 2.5e-3, 3e-3, 1.3  # m, m, T
PLACES = (0, 0), (0.01, 0), (-0.015, 0.017), (0, -0.017)  # m, of the drive and of three receivers
KINDS = {  # lattice and patch, force in N (each half of a bent law), springs along x and y in N/m, sites without a magnet
    'triangular': ('triangular', 'kind = "hexagon"\nside_m = 0.04', 0.28, (20.0, 22.0), []),
    'bent': ('file', '', 0.28, (26.0, 22.0), []),  # a rhombic patch, whose rim is not symmetric
    'kx unlike ky': ('triangular', 'kind = "hexagon"\nside_m = 0.04', 0.2, (16.0, 28.0), []),
    'holes': ('triangular', 'kind = "hexagon"\nside_m = 0.04', 0.12, (30.0, 30.0), [(0.015, 0.00866), (-0.02, 0.0)])}


def specimen(folder, kind, seed, points=70, places=PLACES, discs=False):
    """A scene that is some percent off, transfer functions of a patch, and the means of its free sites."""
    lattice, patch, force, springs, holes = KINDS[kind]
    rng = np.random.default_rng([seed, sum(map(ord, kind))])
    powers = BENT if kind == 'bent' else (A, A)
    off, a, mass = np.exp(rng.uniform(-0.1, 0.1, 4)), np.mean(powers), MASS * (1 + 0.01 * rng.standard_normal())
    where, nodes = f'spacing_m = {L}', bench.sites(L * np.array([[1, 0], [np.cos(1.2), np.sin(1.2)]]), 0.07, 0.07)
    if lattice == 'file':
        where = 'file = "sites.csv"\ncutoff_m = 0.12\npositions = "anchors"'
        np.savetxt(folder / 'sites.csv', np.c_[nodes, (abs(nodes) > 0.024).any(axis=1)], '%.17g', ',', header='x_m,y_m,held',
                   comments='')
    table = (f'kind = "inverse_power"\nb_N_m_a = {force * off[0] * L ** (a * off[1])}\na = {a * off[1]}' if not discs else
             f'kind = "magnets"\nring = {{outer_diameter_m = {2 * DISC[0]}, height_m = {DISC[1]}}}\n'
             f'remanence_T = {DISC[2] * off[0]}')
    shape = bench.disc_force(*DISC) if discs else lambda r: force / 2 * sum((L / r) ** power for power in powers)
    (folder / 'lab.toml').write_text(
        f'title = "lab"\n[lattice]\nkind = "{lattice}"\n{where}\nmass_kg = {MASS}\n[law]\n{table}\n' +
        'shells = "auto"\n' * bool(patch) +
        f'[foundation]\nstiffness_N_per_m = {springs[0] * off[2]}\nstiffness_y_N_per_m = {springs[1] * off[3]}\n' +
        f'[patch]\n{patch}\n' * bool(patch) + f'[defects]\nvacancies_m = {[list(one) for one in holes]}\n' * bool(holes) +
        f'[frf]\nfrom_Hz = 8\nto_Hz = 160\npoints = {points}\ndamping_per_s = {1.3 * DAMPING}\n'
        'force = {at_m = [0, 0], direction_deg = 40}\nresponse = {at_m = [0.01, 0], direction_deg = 0}\n')
    scene = read_scene(folder / 'lab.toml')
    atoms, push = scene.shaken()[0], np.array([np.cos(0.7), np.sin(0.7)])
    reach = 1.001e-3 * atoms.calc.bonds.lengths.max()  # pairs farther than those of the scene make another lattice
    law = bench.tabulated(shape, 0.62 * L, 1.1 * reach)
    sites, w = 1e-3 * atoms.calc.anchors[:, :2], 2 * np.pi * np.linspace(8, 160, points)
    held = np.isin(np.arange(len(atoms)), atoms.constraints[0].index)
    lab = bench.built(sites, law, reach, rng, mass=mass, springs=springs, damping=DAMPING, held=held)
    drive, *seen = (int(np.linalg.norm(sites - at, axis=1).argmin()) for at in places)
    u = 1e3 * bench.response(lab, bench.pushed(lab, drive, push), w)[:, seen]  # mm/N
    sigma = 0.01 * abs(u).max()
    u = u * (1 + 0.01 * rng.standard_normal()) + sigma * (rng.standard_normal(u.shape) + 1j * rng.standard_normal(u.shape))
    functions = [TransferFunction(f'{k}, {axis}', 1e-3 * w, u[:, k, axis], sigma, 0, Dof(seen[k], np.eye(3)[axis]),
                                  Dof(drive, [*push, 0])) for k in range(len(seen)) for axis in (0, 1)]
    free = ~lab.held
    true = float(law(L)[0]) * lab.strengths[free].mean() ** 2
    truth = dict(zip(('foundation_x', 'foundation_y'), lab.springs[free].mean(axis=0).tolist(), strict=True))
    return scene, functions, truth | {'force': true, 'damping': DAMPING} | ({} if discs else {'a': a})


def errors_of(values, truth):
    """Error and half width of the interval of each parameter, in %; no interval where nothing is determined."""
    return {name: (100 * np.log(values[name][0] / true), 196 * values[name][1]) for name, true in truth.items()}


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['holes', 'bent'])
def test_sites_with_unknowns_hold_and_the_mean_lattice_does_not(kind, tmp_path):
    scene, functions, truth = specimen(tmp_path, kind, 1)
    fits = fit_frf(scene, functions)
    fit = fits.fits['complete']
    for name, (error, half) in errors_of(fits.values(), truth).items():
        assert abs(error) < 1.8 * half, name  # 3.5 standard deviations
        assert half < 6
    assert fit.misfit > 2
    assert fit.scatter == 1
    strengths, springs, anchors = fit.site_scatter
    assert 0.012 < strengths < 0.05  # 0.025
    assert 0.025 < springs < 0.1  # 0.05
    assert 0.007 < anchors < 0.03  # 0.015
    alone = fits.fits['conventional']
    assert not alone.follows or alone.square > 1.5 * fit.square


@pytest.mark.slow
def test_a_law_that_is_no_power_bends(tmp_path, monkeypatch):
    """The control is a power law between all neighbours, which puts what it lacks on the springs."""
    scene, functions, truth = specimen(tmp_path, 'bent', 1)
    monkeypatch.setattr(band_fits, 'of_any_law', lambda scene, names, priors, far: (names, priors))
    found = errors_of(fit_frf(scene, functions).values(), truth)
    assert max(abs(error) / half for error, half in found.values()) > 2


def of_one_spring(folder, kind, seed):
    """The fit of a specimen by a scene with one spring for x and y, and the logarithm of the ratio of its springs."""
    _, functions, truth = specimen(folder, kind, seed)
    (folder / 'one.toml').write_text(re.sub('stiffness_y.*\n', '', (folder / 'lab.toml').read_text()))
    fits = fit_frf(read_scene(folder / 'one.toml'), functions)
    return fits, np.log(truth['foundation_x'] / truth['foundation_y'])


@pytest.mark.slow
@pytest.mark.parametrize(('kind', 'stiff'), [
    pytest.param('kx unlike ky', 'y', marks=pytest.mark.long), ('holes', None)])
def test_two_springs_are_seen_by_a_fit_of_one(kind, stiff, tmp_path):
    # With discs as magnets the first ends with springs that scatter by 59 %, and with a ratio of -0.50 +- 0.15; -0.56 is true.
    fits, true = of_one_spring(tmp_path, kind, 30)
    ratio, sigma = fits.fits['complete'].unlike
    assert abs(ratio - true) < 3.5 * sigma < 0.3
    assert (f'the pillars are stiffer along {stiff} than' in frf_report(fits, [])) == (stiff is not None)
    assert ('the pillars are stiffer along' in frf_report(fits, [])) == (stiff is not None)


@pytest.mark.long
def test_coverage(tmp_path, capsys):
    """Shares of intervals that hold, of 24 specimens, six of discs; the control is a lattice of nearest neighbours."""
    found = {}
    for seed in range(10, 16):
        for kind in KINDS:
            scene, functions, truth = specimen(tmp_path, kind, seed, discs=kind == 'kx unlike ky')
            fits = fit_frf(scene, functions)
            values, fit = errors_of(fits.values(), truth), fits.fits['complete']
            assert not fits.contradicted
            for name, one in values.items():
                found.setdefault(name, []).append(one)
            with capsys.disabled():
                print(f'{kind} {seed}: scatter (%) {(100 * fit.site_scatter).round(1)}, left {fit.scatter:.2f} of the noise',
                      {name: f'{error:.2f} of {half:.2f}' for name, (error, half) in values.items()}, flush=True)
    shares = []
    with capsys.disabled():
        for name, pairs in found.items():
            error, half = np.transpose(pairs)
            shares.append(np.mean(abs(error) < half))
            print(f'{name}: {np.sum(abs(error) < half)} of {len(error)} hold, half width {np.median(half):.2f} %, 1.96 rms error '
                  f'{1.96 * np.sqrt(np.mean(error**2)):.2f} %')
    assert np.mean(shares) >= 0.9  # 106 of 114 hold; 41 of 48 of the springs, whose intervals are a quarter too narrow
    _, functions, truth = specimen(tmp_path, 'triangular', 10)
    (tmp_path / 'near.toml').write_text((tmp_path / 'lab.toml').read_text().replace('shells = "auto"', 'shells = 1'))
    control = fit_frf(read_scene(tmp_path / 'near.toml'), functions)
    assert not control.fits['complete'].follows or any(
        abs(error) > 2 * half for error, half in errors_of(control.values(), truth).values())
