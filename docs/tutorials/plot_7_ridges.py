"""
Ridges of several scans to a lattice
====================================

From measured branches to force, exponent and foundation: tables of ridges, of ``magphonon spectrum`` or of any other analysis,
what is known beforehand, and what the source of the waves does to the intervals.  The commands take some ten seconds a scan and
as long for a fit.

On the command line::

    magphonon spectrum shear.csv longitudinal.csv my.toml --source row -o ridges
    magphonon fit ridges/spectrum_*_ridges.csv --bands my.toml --prior force_N=0.24+-5%
"""

# %%
# A table of your own
# -------------------
# Any analysis will do: a row for each point, its phase per step with its uncertainty, its frequency, and the wavevector
# in fractions of the reciprocal vectors.  `record` and `motion` tell ridges apart; `source` says what sent the waves,
# and a table without it is treated as that of a point source.  Here the table that comes with the package is cut in
# two, one for each motion.

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
# Both tables are one measurement.  The scene gives spacing and mass, and where the fit starts; these simulated magnets
# repel nearest neighbours only; real ones repel all others: omit `shells` in a scene of your own.

from magphonon import read_scene
from magphonon.scenes import fit_bands
from magphonon.waves import read_ridges

scene, points = read_scene('prototype'), read_ridges(*tables)


def told(fits):
    for name, (value, sigma) in fits.values().items():
        print(f'{name:15} {value:9.4g}, {value * np.exp(-1.96 * sigma):.4g} to {value * np.exp(1.96 * sigma):.4g}')


told(fit_bands(scene, points))

# %%
# What the source does
# --------------------
# A point source shifts all ridges of a branch together by about a fifth of a bin, so that no residual shows it.  If these ridges
# came from a point source, the honest intervals would be wider:

from dataclasses import replace

from_a_point = replace(points, sources=('point',) * len(points.names))
alone = fit_bands(scene, from_a_point)
told(alone)
print('biased:', alone.biased)

# %%
# What is known from elsewhere narrows them: here an exponent from measured forces, and pillars that were weighed and
# bent.  A prior is a value and a standard uncertainty in SI.

known = fit_bands(scene, from_a_point, priors={'a': (4.5, 0.2), 'foundation': (20.0, 1.0)})
told(known)
print('biased:', known.biased)

# %%
# A ridge that does not fit is first a question: are neighbours missing in the scene, is the mass right, what sent the
# wave?  A ridge that you omit, by `without=[...]` or ``--without``, widens all intervals accordingly.

from magphonon.plotting import plot_band_fits

figure = plot_band_fits(known.points, {model: (known.fitted(model).atoms(), fit) for model, fit in known.fits.items()})
