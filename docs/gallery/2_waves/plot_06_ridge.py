"""
The ridge of a burst
====================

A vibrometer measures a burst along a row. In the map of wavenumber and frequency the burst is a ridge on one of the branches.
"""

import numpy as np

from magphonon import MagneticRepulsion, read_scene, units as u
from magphonon.lattices import half_hexagon
from magphonon.plotting import plot_wave
from magphonon.waves import burst_setup, run_burst, waves

cell = read_scene('prototype').atoms()
patch = half_hexagon(cell, side=300 * u.mm)
patch.calc = MagneticRepulsion(patch, cell.calc.laws, foundation=cell.calc.foundation)
where = burst_setup(cell, patch, 'point')
burst = where.burst((1, 0), 2.5e-4 * u.N, 2 * np.pi * 40 * u.Hz, 5)
passage = run_burst(patch, where, burst, damping=4 / u.s, duration=500 * u.ms)
ax = plot_wave(waves(passage.row, cell, 'point')[0])
ax.figure.savefig('ridge.png')
