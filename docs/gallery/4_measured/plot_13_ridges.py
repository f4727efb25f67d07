"""
A lattice from measured ridges
==============================

Points of the bands, as a laser vibrometer finds them, are fitted with D* and without.  The residuals say which model is right.
"""

from importlib.resources import files

from magphonon import read_scene
from magphonon.plotting import plot_band_fits
from magphonon.scenes import fit_bands
from magphonon.waves import read_ridges

ridges = read_ridges(files('magphonon.data') / 'prototype_ridges.csv')
found = fit_bands(read_scene('prototype'), ridges)
figure = plot_band_fits(found.points, {model: (found.fitted(model).atoms(), fit) for model, fit in found.fits.items()})
figure.savefig('ridges.png')
