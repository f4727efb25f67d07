"""
Where D* matters
================

The map shows the frequency of the lowest branch (here the shear branch) with D*, divided by that without D*, in the whole zone.
"""

import numpy as np

from magphonon import read_scene
from magphonon.bands import bloch_modes
from magphonon.plotting import new_axes

cell = read_scene('prototype').atoms()
n = np.linspace(-0.7, 0.7, 85)
q = np.stack([*np.meshgrid(n, n), np.zeros((85, 85))], axis=-1)                # in reciprocal vectors
kx, ky = np.moveaxis(2 * np.pi * q @ cell.cell.reciprocal().array, -1, 0)[:2]  # rad/mm
complete, conventional = (bloch_modes(cell, q, model)[0][:, 0].reshape(85, 85) for model in ('complete', 'conventional'))
ax = new_axes(height=3.2)
drawn = ax.contourf(kx, ky, complete / conventional, levels=14, cmap='cividis')
ax.figure.colorbar(drawn, label='shear branch, with D* / without')
ax.set(aspect='equal', ylim=(-0.45, 0.45), xlabel='$k_x$ (rad/mm)', ylabel='$k_y$ (rad/mm)')
ax.figure.savefig('ratio.png')
