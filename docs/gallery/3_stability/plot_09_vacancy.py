"""
Modes about a vacancy
=====================

Remove one magnet, let the others relax, and find the modes in which only a few magnets move.
"""

from magphonon import MagneticRepulsion, modes, read_scene, relaxed, units as u
from magphonon.plotting import plot_extents
from magphonon.response import localisation

cell = read_scene('prototype').atoms()
holed = cell.repeat((12, 12, 1))
del holed[78]
holed.calc = MagneticRepulsion(holed, cell.calc.laws, foundation=80 * u.N / u.m)
rest = relaxed(holed).atoms
ax = plot_extents(localisation(modes(rest), rest))
ax.figure.savefig('vacancy.png')
