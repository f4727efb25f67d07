"""
Wave fronts
===========

The two panels show the same push at the same time: with springs alone (conventional), and with the static forces (complete). No
time steps are needed.
"""

import numpy as np

from magphonon import MagneticRepulsion, propagate, read_scene, units as u
from magphonon.lattices import half_hexagon
from magphonon.plotting import panels, plot_snapshot
from magphonon.waves import burst_setup

cell = read_scene('prototype').atoms()
patch = half_hexagon(cell, side=300 * u.mm)
where = burst_setup(cell, patch, 'point')
burst = where.burst((0, 1), 2.5e-4 * u.N, 2 * np.pi * 40 * u.Hz, 5)
times = np.linspace(0, 150, 4) * u.ms

figure, axes = panels(2, 1, width=4.5, height=2.2)
for ax, model in zip(axes[:, 0], ('conventional', 'complete'), strict=True):
    patch.calc = MagneticRepulsion(patch, cell.calc.laws, foundation=cell.calc.foundation, model=model)
    motion = propagate(patch, times, [burst], damping=4 / u.s)
    plot_snapshot(patch, motion, 3, where, ax=ax)
figure.savefig('fronts.png')
