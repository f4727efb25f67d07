"""
A gap that is designed
======================

Masses, springs and strengths of four magnets in a cell are chosen so that the gap between their bands is as wide as possible.
"""

import numpy as np

from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices, plot_bands, units as u
from magphonon.bands import band_gaps
from magphonon.design import band_gap, optimise

cell = lattices.triangular(10 * u.mm, 0.896 * u.g).repeat((2, 2, 1))
law = InversePower(1.6209e-10 * u.N * u.m**4.5824, 4.5824)
cell.calc = MagneticRepulsion(cell, law, cutoff=45 * u.mm, foundation=19.7 * u.N / u.m)
zone = [(a / 6, b / 6, 0) for a in range(6) for b in range(4)]           # q and -q are alike
over = {'mass': (0.5, 2.0), 'strength': (0.8, 1.2), 'spring': (0.5, 2.0)}  # short springs: at 130 Hz long rods are none
design = optimise(cell, band_gap(zone, below=6), over, steps=60)
print('gap (Hz):', np.divide(band_gaps(design.atoms), 2 * np.pi * u.Hz).round(1))

ax = plot_bands(analytic_bands(design.atoms, cell.cell.bandpath('GMKG', npoints=200, pbc=cell.pbc)))
for gap in band_gaps(design.atoms):
    ax.axhspan(*gap / (2 * np.pi * u.Hz), color='0.9')
ax.figure.savefig('designed_gap.png')
