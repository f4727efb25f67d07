"""
A gap between two masses
========================

In a honeycomb of light and heavy magnets there are frequencies at which no wave travels.
"""

import numpy as np

from magphonon import analytic_bands, plot_bands, read_scene, units as u
from magphonon.bands import band_gaps

cell = read_scene('vacancy').perfect_cell()
bands = analytic_bands(cell, cell.cell.bandpath('GMKG', npoints=200, pbc=cell.pbc))
ax = plot_bands(bands)
for gap in band_gaps(cell):                            # in rad/ms
    ax.axhspan(*gap / (2 * np.pi * u.Hz), color='0.9')
ax.figure.savefig('gap.png')
