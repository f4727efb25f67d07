"""
Where energy goes
=================

The lines are contours of equal frequency of the shear branch. Energy flows at right angles to them, so where they are flat, it
flows in beams.
"""

import numpy as np

from magphonon import read_scene, units as u
from magphonon.bands import bloch_modes
from magphonon.plotting import letter_panels, panels

cell = read_scene('square').atoms()
n = np.linspace(-0.5, 0.5, 61)
q = np.stack([*np.meshgrid(n, n), np.zeros((61, 61))], axis=-1)  # in reciprocal vectors
figure, axes = panels(1, 2, height=3.0)
for ax, model in zip(axes[0], ('complete', 'conventional'), strict=True):
    shear = u.hertz(bloch_modes(cell, q, model)[0][:, 0]).reshape(61, 61)
    drawn = ax.contour(2 * np.pi * n, 2 * np.pi * n, shear, levels=7, cmap='cividis')
    ax.clabel(drawn, fmt='%.0f Hz', fontsize=8)
    ax.set(aspect='equal', xlabel='$k_x L$', ylabel='$k_y L$')
letter_panels(axes, ['with D*', 'without D*'])
figure.savefig('beams.png')
