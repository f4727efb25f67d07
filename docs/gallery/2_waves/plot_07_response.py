"""
A frequency response
====================

One magnet of a hexagon is pushed, and its neighbour is measured: amplitude and phase, with D* and without.
"""

import numpy as np

from magphonon import MagneticRepulsion, lattices, read_scene, units as u
from magphonon.plotting import plot_response
from magphonon.response import Dof, receptance

cell = read_scene('prototype').atoms()
patch = lattices.hexagon(cell, side=40 * u.mm)
middle, up = len(patch) // 2, np.array([0, 1.0, 0])
omega = 2 * np.pi * np.linspace(20, 110, 600) * u.Hz
axes = None
for model, line in (('complete', '-'), ('conventional', '--')):
    patch.calc = MagneticRepulsion(patch, cell.calc.laws, foundation=cell.calc.foundation, model=model)
    answer = receptance(patch, Dof(middle, up), Dof(middle + 1, up), omega, damping=12 / u.s)
    axes = plot_response(answer, axes=axes, label=model, linestyle=line)
axes[0].figure.savefig('response.png')
