"""
Lattice, zone and path
======================

The picture shows a cell with its primitive vectors, and its first Brillouin zone with the path of the bands.
"""

from magphonon import read_scene
from magphonon.plotting import letter_panels, panels, plot_lattice, plot_zone

scene = read_scene('prototype')
figure, ((left, right),) = panels(1, 2, height=2.6)
plot_lattice(scene.atoms(), ax=left)
plot_zone(scene.band_path(), ax=right)
letter_panels([left, right])
figure.savefig('zone.png')
