"""
Where D* matters
================

The lowest branch, here the shear branch: the ratio of its frequencies with and without D*, over the whole zone.
"""

from magphonon import read_scene
from magphonon.bands import zone_map
from magphonon.plotting import plot_ratio

cell = read_scene('prototype').atoms()
complete = zone_map(cell, 60)
conventional = zone_map(cell, 60, model='conventional')
ax = plot_ratio(complete, conventional, branch=0)
ax.figure.savefig('ratio.png')
