"""
How far a lattice is linear
===========================

Frequencies stay within 1 % of the linear ones up to an amplitude that depends on the exponent of the force.
"""

import numpy as np

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.plotting import legend_above, new_axes
from magphonon.stability import frequency_shifts

exponents = np.linspace(3.2, 8, 20)
ax = new_axes()
for name, q, line in (('shear and longitudinal at M', (0.5, 0, 0), '-'), ('rotating at K', (2 / 3, 1 / 3, 0), '--')):
    far = []
    for a in exponents:
        cell = lattices.triangular(spacing=1.0, mass=1.0)
        cell.calc = MagneticRepulsion(cell, InversePower(b=1.0, a=a))
        far.append(frequency_shifts(cell, q).amplitude(0.01))
    ax.plot(exponents, 100 * np.array(far), line, label=name)
ax.set(xlabel='exponent of the force', ylabel='amplitude (% of the spacing)', ylim=0)
legend_above(ax, ncols=1)
ax.figure.savefig('amplitude.png')
