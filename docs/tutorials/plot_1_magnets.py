"""
From my magnets to my bands
===========================

You have magnets, a table of the forces between two of them, and a lattice in mind.  How fast does it vibrate, is it stable
without pillars, and which pillars does it need?
"""

# %%
# The table of forces
# -------------------
# The table has a header with units and one row for each distance between the centres.  Ideally it also has a column with the
# uncertainty of each force.  This one comes with the package; replace it with your own file.

from importlib.resources import files

from magphonon import units as u
from magphonon.interactions import SharedErrors, fit_forces, read_forces, scene_entry
from magphonon.plotting import plot_fit

forces = read_forces(files('magphonon.data') / 'synthetic_force.csv', contact=6.35 * u.mm)
print(f'{len(forces.r)} distances from {forces.r.min():g} to {forces.r.max():g} mm')

# %%
# The law
# -------
# The vibrations depend on only two numbers of the law, both at the working spacing: the force, which gives D*, and its slope,
# which gives D0.  Some errors are common to all rows of a table.  The most important is the zero of the distances: how far apart
# the centres are when the scale reads zero.  State how well you know it; here, to 0.05 mm.

SPACING = 10 * u.mm
fit = fit_forces(forces, SPACING, SharedErrors(distance=0.05 * u.mm))
for name, (low, high) in zip(('force (N)', '-slope (N/mm)', 'exponent'), fit.intervals, strict=True):
    print(f'{name:14} {low:.4g} to {high:.4g}')
for name, share in fit.shares.items():
    print(f'{share:4.0%} of the variance comes from: {name}')
figure = plot_fit(forces, fit)

# %%
# The zero of the distances matters most by far: measure it well before anything else.
#
# From the shell, ``magphonon fit forces.csv --spacing 10mm --sigma distance=0.05mm`` does the same.  It prints the tables
# ``[law]`` and ``[uncertainty]`` of a scene:

print(scene_entry(fit))

# %%
# The lattice
# -----------
# A calculator attaches the fitted law to an ASE ``Atoms`` object.  There is no foundation yet: is the lattice stable without
# one?

from magphonon import MagneticRepulsion, analytic_bands, critical_foundation, lattices

law = fit.law
cells = {'triangular': lattices.triangular(SPACING, 0.707 * u.g), 'square': lattices.square(SPACING, 0.707 * u.g)}
for name, cell in cells.items():
    cell.calc = MagneticRepulsion(cell, law)
    needed, softest = critical_foundation(cell)
    print(f'{name:11} needs {needed / (u.N / u.m):.4g} N/m; softest at q = ({softest[0]:g}, {softest[1]:g})')

# %%
# Without a foundation the square lattice buckles: its rows slide past each other.  In closed form it needs 4 f/L0, here 147 N/m.
# The triangular lattice is stable in its plane without support.

# %%
# Pillars
# -------
# A round cantilever of aluminium has the stiffness 3 E I/H^3.  How long may the pillars of the square lattice be, if they are to
# be 1.5 times as stiff as needed?

import numpy as np

needed, _ = critical_foundation(cells['square'])
radius, modulus = 0.79375 * u.mm, 71 * u.GPa
height = (3 * modulus * np.pi * radius**4 / 4 / (1.5 * needed)) ** (1 / 3)
print(f'at most {height:.1f} mm')

# %%
# Bands
# -----
# The bands on these pillars, with and without D*:

from magphonon import plot_bands

square = cells['square']
square.calc.set(foundation=1.5 * needed)
path = square.cell.bandpath('GXMG', npoints=200, pbc=square.pbc)
complete = analytic_bands(square, path)
ax = plot_bands(complete, label='D0 + D*')
ax = plot_bands(analytic_bands(square, path, 'conventional'), ax=ax, linestyle='--', label='D0 alone')
print(f'lowest frequency with D*: {complete.frequencies_Hz.min():.1f} Hz')

# %%
# The conventional model puts the lowest frequency at Γ.  In truth it is at X, where neighbouring rows slide past each other.  On
# pillars a third weaker this frequency would be zero, and the lattice would buckle.
#
# Before you build a lattice, ``magphonon check --verbose`` checks its scene as the next lines do.  It also prints the largest
# time step, the range of linear motion, and the stiffness that the pillars need so that the magnets stay in the plane.
# ``magphonon explore`` writes a page in which sliders for spacing, exponent and foundation move these bands.

from magphonon import verdict

print(verdict(square))

# %%
# The softest motion is at X, where the rows slide past each other:

from magphonon.plotting import plot_mode

ax = plot_mode(square, analytic_bands(square, path, vectors=True), 'X', 0)
