"""
When a lattice buckles
======================

The triangular, the square and the kagome lattice need a foundation whose stiffness depends on the exponent of the force between
the magnets.
"""

import numpy as np

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.plotting import legend_above, new_axes
from magphonon.stability import stability_boundary_of_exponents

ax = new_axes()
for kind, line in (('kagome', '-'), ('square', '--'), ('triangular', ':')):
    cell = getattr(lattices, kind)(spacing=1.0, mass=1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(b=1.0, a=4.0))     # the force f = 1 at the spacing L = 1
    border = stability_boundary_of_exponents(cell, np.linspace(1, 6, 21))
    ax.plot(border.at, border.needed, line, label=kind)
ax.set(xlabel='exponent of the force', ylabel='foundation needed ($f/L$)', ylim=0)
legend_above(ax)
ax.figure.savefig('buckling.png')
