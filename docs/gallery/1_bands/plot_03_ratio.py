"""
Where D* matters
================

The map shows the frequency of the lowest branch (here the shear branch) with D*, divided by that without D*, in the whole zone.
"""

from magphonon import read_scene
from magphonon.bands import zone_map
from magphonon.plotting import plot_ratio

cell = read_scene('prototype').atoms()
complete = zone_map(cell, 60)
conventional = zone_map(cell, 60, model='conventional')
ax = plot_ratio(complete, conventional, branch=0)
ax.figure.savefig('ratio.png')
