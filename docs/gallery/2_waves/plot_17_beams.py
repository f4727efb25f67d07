"""
Where energy goes
=================

The lines are contours of equal frequency of the shear branch. Energy flows at right angles to them, so where they are flat, it
flows in beams.
"""

from magphonon import read_scene, units as u
from magphonon.bands import zone_map
from magphonon.plotting import letter_panels, panels

cell = read_scene('square').atoms()
figure, axes = panels(1, 2, height=3.0)
for ax, model in zip(axes[0], ('complete', 'conventional'), strict=True):
    found = zone_map(cell, 60, model)
    k = found.wavevectors * 10 * u.mm                     # per spacing
    drawn = ax.contour(k[..., 0], k[..., 1], found.frequencies_Hz[..., 0], levels=7, cmap='cividis')
    ax.clabel(drawn, fmt='%.0f Hz', fontsize=8)
    ax.set(aspect='equal', xlabel='$k_x L$', ylabel='$k_y L$')
letter_panels(axes, ['with D*', 'without D*'])
figure.savefig('beams.png')
