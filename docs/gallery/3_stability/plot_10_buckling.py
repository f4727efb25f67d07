"""
When a lattice buckles
======================

The triangular, the square and the kagome lattice need a foundation whose stiffness depends on the exponent of the force between
the magnets.
"""

import numpy as np

from magphonon import InversePower, MagneticRepulsion, critical_foundation, lattices
from magphonon.plotting import legend_above, new_axes

ax, exponents = new_axes(), np.linspace(1, 6, 41)
for kind, line in (('kagome', '-'), ('square', '--'), ('triangular', ':')):
    cell = getattr(lattices, kind)(spacing=1.0, mass=1.0)
    needed = []
    for a in exponents:
        cell.calc = MagneticRepulsion(cell, InversePower(b=1.0, a=a))   # the force f = 1 at the spacing L = 1
        needed.append(critical_foundation(cell).k)
    ax.plot(exponents, needed, line, label=kind)
ax.set(xlabel='exponent of the force', ylabel='foundation needed ($f/L$)', ylim=0)
legend_above(ax)
ax.figure.savefig('buckling.png')
