"""
A mode
======

The picture shows how the magnets move in the shear mode at M, the middle of an edge of the zone.
"""

from magphonon import analytic_bands, read_scene
from magphonon.plotting import plot_mode

cell = read_scene('prototype').atoms()
path = cell.cell.bandpath('GMKG', npoints=50, pbc=cell.pbc)
bands = analytic_bands(cell, path, vectors=True)
ax = plot_mode(cell, bands, 'M', 0)
ax.figure.savefig('mode.png')
