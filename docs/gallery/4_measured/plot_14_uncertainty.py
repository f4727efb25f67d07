"""
Bands with their uncertainty
============================

Tolerances of force, exponent and mass turn each branch into a ribbon of plus and minus two standard deviations.
"""

import numpy as np

from magphonon import analytic_bands, read_scene, units as u
from magphonon.design import StiffnessDerivative, Tolerances, exponent_change, force_change, frequency_spread
from magphonon.plotting import plot_band_ribbons

cell = read_scene('prototype').atoms()
law = cell.calc.law
changes = {'force': StiffnessDerivative(law=force_change(law)),
           'exponent': StiffnessDerivative(law=exponent_change(law, 10 * u.mm)), 'mass': StiffnessDerivative(mass=1.0)}
tolerances = Tolerances(changes, np.diag([0.05, 0.03, 0.02])**2)                 # relative standard deviations
path = cell.cell.bandpath('GMKG', npoints=120, pbc=cell.pbc)
ax = None
for model, line in (('complete', '-'), ('conventional', '--')):
    spread = frequency_spread(cell, path.kpts, tolerances, model)
    ax = plot_band_ribbons(analytic_bands(cell, path, model), spread, ax=ax, label=model, linestyle=line)
ax.figure.savefig('uncertainty.png')
