"""
A map over two parameters
=========================

The map shows the shear frequency at M as a function of the exponent of the law and the stiffness of the pillars. The
force between neighbours is kept the same.
"""

import numpy as np

from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices, sweep, units as u
from magphonon.plotting import new_axes


def shear(a, foundation):
    cell = lattices.triangular(spacing=10 * u.mm, mass=0.707 * u.g)
    law = InversePower(b=0.2369 * u.N * (10 * u.mm)**a, a=a)
    cell.calc = MagneticRepulsion(cell, law, foundation=foundation * u.N / u.m)
    return analytic_bands(cell, [[0.5, 0, 0]]).frequencies_Hz[0, 0]


grid = {'a': np.linspace(3, 6, 13), 'foundation': np.linspace(5, 80, 11)}
ax = new_axes()
sweep(shear, grid, units={'foundation': 'N/m', 'value': 'Hz'}).value.plot(ax=ax)
ax.figure.savefig('sweep.png')
