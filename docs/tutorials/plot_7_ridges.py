"""
From the ridges of several scans to a lattice
=============================================

This tutorial goes from measured branches to force, exponent and foundation.  It shows how to use tables of ridges, from
``magphonon spectrum`` or from any other analysis, how to add what you know beforehand, and how the source of the waves affects
the intervals.  The commands take about ten seconds for each scan, and about as long for a fit.

On the command line::

    magphonon spectrum shear.csv longitudinal.csv my.toml --source row -o ridges
    magphonon fit ridges/spectrum_*_ridges.csv --bands my.toml --prior force_N=0.24+-5%
"""

# %%
# A table of your own
# -------------------
# The table may come from any analysis.  It has a row for each point of a ridge: the phase per step with its uncertainty, the
# frequency, and the wavevector in fractions of the reciprocal vectors.  The columns `record` and `motion` distinguish the
# ridges.  The column `source` says what sent the waves; without it, a point source is assumed.  Here the table that comes with
# the package is split in two, one for each motion.

import tempfile
from importlib.resources import files
from pathlib import Path

import numpy as np

lines = (files('magphonon.data') / 'prototype_ridges.csv').read_text().splitlines()
header, *rows = [line for line in lines if not line.startswith('#')]
folder = Path(tempfile.mkdtemp())
tables = []
for motion in ('transverse', 'longitudinal'):
    table = folder / f'{motion}.csv'
    table.write_text('\n'.join([header, *(row for row in rows if f',{motion},' in row)]))
    tables.append(table)
print(header)
print(rows[0])

# %%
# The fit
# -------
# The two tables are fitted together, as one measurement.  The scene gives the spacing, the mass and the starting values of the
# fit.  Real magnets repel all others; these simulated ones repel nearest neighbours only.  The fit does not need to be told: it
# is made for both, and each answer counts with the weight that the points give it.

from magphonon import read_scene
from magphonon.scenes import fit_bands
from magphonon.waves import read_ridges

scene, points = read_scene('prototype'), read_ridges(*tables)


def told(fits):
    for name, (value, sigma) in fits.values().items():
        print(f'{name:15} {value:9.4g}, {value * np.exp(-1.96 * sigma):.4g} to {value * np.exp(1.96 * sigma):.4g}')


fits = fit_bands(scene, points)
told(fits)
print(fits.weights())

# %%
# What the source does
# --------------------
# A point source shifts all ridges of a branch together by about a fifth of a bin.  Because the shift is common to all of them,
# the residuals do not show it.  If these ridges came from a point source, the honest intervals would therefore be wider:

from dataclasses import replace

from_a_point = replace(points, sources=('point',) * len(points.names))
alone = fit_bands(scene, from_a_point)
told(alone)
print('biased:', alone.biased)

# %%
# Prior knowledge narrows the intervals.  Here it is an exponent from measured forces, and the stiffness of pillars that were
# bent with known weights.  A prior is a value and a standard uncertainty, in SI.

known = fit_bands(scene, from_a_point, priors={'a': (4.5, 0.2), 'foundation': (20.0, 1.0)})
told(known)
print('biased:', known.biased)

# %%
# If a ridge does not fit, first ask why: are neighbours missing in the scene, is the mass right, what sent the wave?  If you
# omit a ridge, by `without=[...]` or ``--without``, all intervals become wider accordingly.

from magphonon.plotting import plot_band_fits

figure = plot_band_fits(known.points, {model: (known.fitted(model).atoms(), fit) for model, fit in known.fits.items()})
