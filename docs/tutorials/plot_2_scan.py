"""
From a measured scan to a ridge
===============================

A vibrometer has scanned a row of magnets while a burst ran along it.  Which dispersion does the scan show, how certain is it,
and does it need D*?  Here the scan is simulated, with the noise of an instrument, so that the truth is known.
"""

# %%
# A scan
# ------
# A burst of 40 Hz enters a half-hexagon of magnets on pillars at one magnet.  A row of 24 magnets is sampled at 1 kHz with 5 nm
# of noise.

import numpy as np

from magphonon import InversePower, MagneticRepulsion, lattices, units as u
from magphonon.waves import read_scan, sampled, run_burst, burst_setup, write_scan

law = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
cell = lattices.triangular(spacing=10 * u.mm, mass=0.707 * u.g)
cell.calc = MagneticRepulsion(cell, law, foundation=19.6757 * u.N / u.m)
patch = lattices.half_hexagon(cell, side=250 * u.mm)
patch.calc = MagneticRepulsion(patch, law, foundation=19.6757 * u.N / u.m)

where = burst_setup(cell, patch, 'point')
burst = where.burst((0, 1), 2.5e-4 * u.N, 2 * np.pi * 40 * u.Hz, 5)
passage = run_burst(patch, where, burst, damping=5 / u.s, duration=400 * u.ms)
measured = sampled(passage.row, 1 * u.kHz, noise=5 * u.mm / 1e6, seed=1)

# %%
# As a file
# ---------
# ``magphonon spectrum scan.csv scene.toml`` reads a table with the columns ``time_s, particle, u_x_m, u_y_m`` and one sample per
# row.  It also reads scans as instruments write them.  These may hold one component only, positions ``x_mm, y_mm`` of named
# points, velocities ``v_y_mm_per_s``, and missing or dead points; universal files work too.  In Python, use ``read_scan`` and
# ``scan_waves``.

import tempfile
from pathlib import Path

file = Path(tempfile.mkdtemp()) / 'scan.csv'
write_scan(file, measured)
print(''.join(file.open().readlines()[:4]))
scan = read_scan(file)
print(f'{len(scan.names)} points, {scan.names[0]} to {scan.names[-1]}')

# %%
# The map
# -------
# Motion across the row and motion along it belong to different waves.  The scan is therefore first projected onto each of the
# two directions, and each projection is then transformed in space and time.

from magphonon.plotting import plot_wave
from magphonon.waves import waves

found = waves(measured, cell, 'point')
for wave in found:
    branches = ' and '.join(f'the {model} {name} branch' for model, name in wave.agrees_with)
    print(f'{wave.motion:12} agrees with {branches or "no branch"}')
wave = next(wave for wave in found if wave.motion == 'transverse')
ax = plot_wave(wave)

# %%
# The ridge
# ---------
# At each frequency the crest of the map gives one point of the dispersion, with an uncertainty.  This uncertainty contains the
# noise, the difference between the two halves of the row, and the scatter of the points about a smooth branch.  The distance of
# the point from each branch is given in bins.  A bin is 2 pi divided by the number of points of the row: the resolution that the
# length of the row allows.

for (model, name), misfit in wave.misfits.items():
    print(f'{model:12} {name:12} {misfit.bins:5.2f} bins over {misfit.points} frequencies')

# %%
# The scan follows the shear branch with D*.  The conventional shear branch is two bins away, many times the ridge's uncertainty:

ridge = wave.ridge
print(f'sigma of a point: {np.median(ridge.sigma_xi) / ridge.bin_xi:.2f} bins')

# %%
# A real scan has gaps
# --------------------
# Suppose that seven of the points were not measured, that the row does not start at the origin of the lattice, and that only the
# motion across the row is known.  Plane waves are then fitted by least squares to the points that were measured, and the fit
# gives the wavenumbers.

from magphonon.waves import Scan, polarisations, scan_waves

kept = np.delete(np.arange(len(measured.particles)), [2, 3, 7, 11, 12, 16, 20])
places = patch.positions[measured.particles[kept], :2] + [120, 45]
x, y = polarisations(cell, 'point')['transverse']
across = measured.along((x, y))[:, kept]
gappy = Scan(measured.times, tuple(map(str, kept)), places, {'x': x * across, 'y': y * across})
(again,) = scan_waves(gappy, cell)
print(f'{len(kept)} points: {again.misfits["complete", "shear"].bins:.2f} bins off complete shear, '
      f'{again.misfits["conventional", "shear"].bins:.2f} off conventional shear')

# %%
# From ridges back to the lattice
# -------------------------------
# A row of sources drives both branches, and their ridges determine the force between neighbours, how fast it falls, and the
# foundation.  The table that comes with the package holds the ridges of such bursts, simulated with the noise of a vibrometer;
# the truth is 0.2369 N, 4.5824 and 19.676 N/m.  On the command line, ``magphonon spectrum scan.csv scene.toml`` writes such a
# table, and ``magphonon fit spectrum_scan_ridges.csv --bands scene.toml`` fits it.

from importlib.resources import files

from magphonon import read_scene
from magphonon.scenes import fit_bands
from magphonon.waves import read_ridges

fits = fit_bands(read_scene('prototype'), read_ridges(files('magphonon.data') / 'prototype_ridges.csv'))
for name, (value, sigma) in fits.values().items():
    print(f'{name:15} {value:9.4g}, {value * np.exp(-1.96 * sigma):.4g} to {value * np.exp(1.96 * sigma):.4g}')
print(f'evidence for D*: {fits.evidence:.0f} sigma')

# %%
# A single branch often cannot separate force and exponent.  Their intervals then reach beyond +-50 %, and the command calls them
# not determined.

# %%
# A record of the plane
# ---------------------
# If you measure all magnets of the plane, with a camera or point by point, use the same command.  Each row of the table then has
# a time, a position and a displacement::
#
#     time_ms, x_mm, y_mm, u_x_um, u_y_um
#     magphonon spectrum plane.csv scene.toml --at 40
#     magphonon fit scene-spectrum/spectrum_plane_ridges.csv --bands scene.toml
#
# The motion may be a burst, or noise alone: shake the base, or rely on its ambient vibration, and record for a few seconds.  The
# average over segments of the record then shows the bands and their ridges along the path of ``[bands]``, for example ``GMKG``.
# The example below is a wave of 60 Hz over 256 sites, some of which are missing.  It computes a map over the wavevectors at that
# frequency; the crest of the map lies at the wavevector of the wave.

from magphonon.waves import field_at, field_of

rng = np.random.default_rng(2)
n = np.array([(i, j) for i in range(16) for j in range(16)])[rng.random(256) > 0.1]
sites, t = n @ cell.cell.array[:2, :2], np.arange(0, 500.0)
u_y = 1e-3 * np.cos(2 * np.pi * 0.06 * t[:, None] - sites @ [0.1, 0.05]) + 1e-4 * rng.normal(size=(len(t), len(sites)))
field = field_of(Scan(t, tuple(map(str, range(len(n)))), sites, {'x': 0 * u_y, 'y': u_y}), cell)
print('\n'.join(field.notes))
k, power, shape = field_at(field, cell, 2 * np.pi * 0.06)
row, column = np.unravel_index(power.argmax(), power.shape)
print(f'crest at ({k[column]:.2f}, {k[row]:.2f}) rad/mm, resolution {field.bin_k:.2f}')

# %%
# Molecular dynamics can take the place of the camera: dynasor reads an ASE trajectory that ``DrivenVerlet`` has written.  It
# takes our millimetres for Angstrom and our milliseconds for femtoseconds, so read its rad/fs as rad/ms::
#
#     trajectory = dynasor.Trajectory('motion.traj', trajectory_format='ase', length_unit='Angstrom', time_unit='fs')
#     omega, density = dynasor.compute_spectral_energy_density(trajectory, rest, cell, k, dt=2.0)
#
# In one second of thermal motion of 64 magnets, the peaks lie within one bin of 1 Hz of the bands with D*, and four bins or more
# away from the bands without D* (``tests/waves/test_dynasor.py``).
