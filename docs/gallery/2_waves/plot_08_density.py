"""
Density of states
=================

The curves show how many modes there are at each frequency: in the infinite lattice, and in a patch of 6000 magnets, estimated
from random vectors.
"""

from magphonon import MagneticRepulsion, lattices, read_scene, units as u
from magphonon.bands import lattice_density
from magphonon.plotting import plot_density
from magphonon.response import density_of_states

cell = read_scene('vacancy').perfect_cell()
patch = lattices.hexagon(cell, side=500 * u.mm)
patch.calc = MagneticRepulsion(patch, cell.calc.laws, foundation=cell.calc.foundation)
ax = plot_density(lattice_density(cell), label='lattice')
plot_density(density_of_states(patch, moments=256, vectors=4), ax=ax, label=f'patch of {len(patch)} magnets', linestyle='--')
ax.figure.savefig('density.png')
