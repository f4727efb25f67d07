"""
From a transfer function to a lattice
=====================================

Tap one magnet and measure three others: a fit then gives force, exponent, foundation and damping, both with D* and without; it
takes the mass as known to 1 %.  Here the patch is simulated, so that the truth is known.  Its magnets, feet and
pillars scatter, as in a real patch.

On the command line::

    magphonon frf mine.toml --measured f.csv
    magphonon fit f.csv --frf mine.toml
"""

# %%
# The scene
# ---------
# The scene describes the lattice as we believe it to be.  ``[frf]`` holds the frequency range, a guess of the damping, and where
# the hammer hits.

import tempfile
from pathlib import Path

import numpy as np

from magphonon import read_scene, relaxed, units as u
from magphonon.response import Dof, read_transfer, receptance
from magphonon.stiffness import Scatter, scattered

text = """title = "A tapped patch"
[lattice]
kind = "triangular"
spacing_m = 0.01
mass_kg = 7e-4

[law]
kind = "inverse_power"
b_N_m_a = {b}
a = {a}
shells = 3

[foundation]
stiffness_N_per_m = {foundation}

[patch]
kind = "hexagon"
side_m = 0.04

[frf]
from_Hz = 15.0
to_Hz = 170.0
points = 120
damping_per_s = {damping}
[frf.force]
at_m = [0.0, 0.0]
direction_deg = 40.0
[frf.response]
at_m = [0.01, 0.0]
direction_deg = 0.0
"""
folder = Path(tempfile.mkdtemp())


def scene_of(name, force, a, **values):
    b = force * 0.01**a
    (folder / name).write_text(text.format(b=b, a=a, **values), encoding='utf-8')
    return read_scene(folder / name)


scene = scene_of('mine.toml', force=0.22, a=4.4, foundation=21.0, damping=9.0)

# %%
# The measurement
# ---------------
# The true patch differs from this scene, and its sites differ from each other.  A vibrometer measures three magnets along x and
# y.  Its noise is one percent of the highest of all peaks; the column ``sigma_m_per_N`` states it.

truth = {'force': 0.2369, 'a': 4.58, 'foundation': 19.7, 'damping': 7.0}
built, source, _ = scene_of('truth.toml', **truth).shaken()
specimen = relaxed(scattered(built, Scatter(position=0.05 * u.mm, strength=0.01, stiffness=0.02), seed=3)).atoms
rng, omega = np.random.default_rng(0), scene.frf.omega
rows = ['frequency_Hz,re_m_per_N,im_m_per_N,sigma_m_per_N,x_m,y_m,direction_deg']
for x, y in (0.01, 0.0), (-0.005, 0.00866), (0.0, -0.01732):
    particle = np.linalg.norm(built.positions[:, :2] / u.m - (x, y), axis=1).argmin()
    for axis in (0, 1):
        h = receptance(specimen, source, Dof(particle, np.eye(3)[axis]), omega, truth['damping'] / u.s).response * u.N / u.m
        h = h + 5e-4 * (rng.normal(size=len(h)) + 1j * rng.normal(size=len(h)))
        rows += [f'{f:.6g},{z.real:.6g},{z.imag:.6g},5e-4,{x},{y},{90 * axis}' for f, z in zip(u.hertz(omega), h, strict=True)]
(folder / 'f.csv').write_text('\n'.join(rows), encoding='utf-8')
print('\n'.join(rows[:3]))

# %%
# Does the header tell the truth?
# -------------------------------
# ``magphonon frf --measured`` and ``magphonon fit --frf`` warn you if the numbers look like something other than the header says:
# mm instead of m, a velocity, or the opposite sign of the phase.  Here we test a table whose header says displacements, but whose
# numbers are velocities.

from dataclasses import replace

from magphonon.scenes import with_dofs, suspect_units

functions = with_dofs(scene, read_transfer(folder / 'f.csv'))
print('as it is:', suspect_units(scene, functions))
velocities = [replace(one, response=1j * one.omega * u.s * one.response) for one in functions]
print('velocities:', suspect_units(scene, velocities))

# %%
# The fit
# -------
# The residual is larger than the noise, because no perfect lattice reproduces one whose sites scatter.  The intervals of the fit
# include the effect of this scatter.

from magphonon.scenes import fit_frf

fits = fit_frf(scene, functions)
for name, (value, sigma) in fits.values().items():
    known = f', truth {truth[name]:g}' if name in truth else ''
    print(f'{name:15} {value:8.4g}, {value * np.exp(-1.96 * sigma):.4g} to {value * np.exp(1.96 * sigma):.4g}{known}')
print(f'scatter of the strengths: {100 * fits.better.site_scatter[0]:.2g} %')

# %%
# Which model?
# ------------
# The model with D0 alone has one parameter fewer, and cannot reproduce the data.

print(f'the residual without D* is {fits.ratio:.3g} times as large; the data speak for: {fits.verdict}')

from magphonon.plotting import plot_transfer

figure = plot_transfer(fits.functions[:2], {model: fits.curves(model)[:2] for model in fits.fits})
