"""
From my magnets to my bands
===========================

You have magnets, a table of the forces between two of them, and a lattice in mind.  How fast does it vibrate, is it stable
without pillars, and which pillars does it need?
"""

# %%
# The table of forces
# -------------------
# A table has a header with units, one row per distance of the centres, and best of all a column with the uncertainty of each
# force.  This one comes with the package; put your own file in its place.

from importlib.resources import files

from magphonon import units as u
from magphonon.interactions import SharedErrors, fit_forces, read_forces, scene_entry
from magphonon.plotting import plot_fit

forces = read_forces(files('magphonon.data') / 'synthetic_force.csv', contact=6.35 * u.mm)
print(f'{len(forces.r)} distances from {forces.r.min():g} to {forces.r.max():g} mm')

# %%
# The law
# -------
# What the vibrations need of the law is two numbers at the working spacing: the force, for D*, and its slope, for D0.  All rows
# of a table share errors, above all the zero of the distances: how far apart the centres are when the scale reads zero.  Say how
# well you know it; here, to 0.05 mm.

SPACING = 10 * u.mm
fit = fit_forces(forces, SPACING, SharedErrors(distance=0.05 * u.mm))
for name, (low, high) in zip(('force (N)', '-slope (N/mm)', 'exponent'), fit.intervals, strict=True):
    print(f'{name:14} {low:.4g} to {high:.4g}')
for name, share in fit.shares.items():
    print(f'{share:4.0%} of the variance comes from: {name}')
figure = plot_fit(forces, fit)

# %%
# The zero of the distances matters most by far: with it known to 0.02 mm the slope would be known to

print(f'{fit.with_care:.1%}')

# %%
# The same from the shell is ``magphonon fit forces.csv --spacing 10mm --distance-sigma 0.05mm``; it prints the tables ``[law]``
# and ``[uncertainty]`` of a scene:

print(scene_entry(fit))

# %%
# The lattice
# -----------
# The fitted law goes into ASE's atoms by a calculator.  No foundation yet: is the lattice stable without one?

from magphonon import MagneticRepulsion, analytic_bands, critical_foundation, lattices

law = fit.law
cells = {'triangular': lattices.triangular(SPACING, 0.707 * u.g), 'square': lattices.square(SPACING, 0.707 * u.g)}
for name, cell in cells.items():
    cell.calc = MagneticRepulsion(cell, law)
    needed, softest = critical_foundation(cell)
    print(f'{name:11} needs {needed / (u.N / u.m):.4g} N/m; softest at q = ({softest[0]:g}, {softest[1]:g})')

# %%
# The square lattice buckles: its rows slide past each other.  In closed form it needs 4 f/L0, here 147 N/m.  The triangular
# one stands by itself, in its plane.

# %%
# Pillars
# -------
# A round cantilever of aluminium has the stiffness 3 E I/H^3.  How long may it be under the square lattice, with half as much
# again as a margin?

import numpy as np

needed, _ = critical_foundation(cells['square'])
radius, modulus = 0.79375 * u.mm, 71 * u.GPa
height = (3 * modulus * np.pi * radius**4 / 4 / (1.5 * needed)) ** (1 / 3)
print(f'at most {height:.1f} mm')

# %%
# Bands
# -----
# With and without D*, on these pillars.

from magphonon import plot_bands

square = cells['square']
square.calc.set(foundation=1.5 * needed)
path = square.cell.bandpath('GXMG', npoints=200, pbc=square.pbc)
complete = analytic_bands(square, path)
ax = plot_bands(complete, label='D0 + D*')
ax = plot_bands(analytic_bands(square, path, 'conventional'), ax=ax, linestyle='--', label='D0 alone')
print(f'lowest frequency with D*: {complete.frequencies_Hz.min():.1f} Hz')

# %%
# The conventional model puts the lowest frequency at Γ.  In truth it is at X, where neighbouring rows slide; on pillars a
# third weaker it would be zero, and the lattice would lie down.
#
# Before building it: ``magphonon check --verbose`` says the same of a scene, and adds the largest time step, the range of linear
# motion, and the stiffness that the pillars need against tilting out of the plane.
# ``magphonon explore`` writes a page in which sliders for spacing, exponent and foundation move these bands.

from magphonon import verdict

print(verdict(square))

# %%
# Its softest motion at X, the rows that slide past each other:

from magphonon import plot_mode

ax = plot_mode(square, analytic_bands(square, path, vectors=True), 'X', 0)
