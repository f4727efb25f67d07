"""
When an ion chain turns zigzag
==============================

The curves show transverse waves of a chain of charges with spacing a, in a trap of stiffness k.  According to
Fishman et al. (arXiv:0710.1831) the chain turns zigzag where k falls below 7 zeta(3)/2 = 4.207, in units of Q^2/a^3.  This is due
to D* alone: with D0 only, the transverse motions of the ions are not coupled.
"""

import numpy as np

from magphonon import InversePower, analytic_bands, critical_foundation, lattices
from magphonon.plotting import legend_above, new_axes
from magphonon.stiffness import AllNeighbours

chain = lattices.chain(spacing=1.0, mass=1.0)
q = np.linspace(0, 0.5, 101)[:, None] * [1, 0, 0]
ax = new_axes()
for k, line in ((6.0, '-'), (7 * 1.2020569 / 2, '--')):
    chain.calc = AllNeighbours(chain, InversePower(b=1.0, a=2.0), foundation=k)      # Coulomb's law
    across = analytic_bands(chain, q).omega[:, 0]
    ax.plot(2 * q[:, 0], across, line, label=f'$D^0 + D^{{*}}$, k = {k:.3f}')
    ax.plot(2 * q[:, 0], np.full(len(q), np.sqrt(k)), line, label=f'$D^0$ alone, k = {k:.3f}')
print(f'the chain is straight above k = {critical_foundation(chain).k:.6f}')
ax.set(xlabel=r'$q a/\pi$', ylabel=r'$\omega$ across the axis', xlim=(0, 1), ylim=0)
legend_above(ax)
ax.figure.savefig('zigzag.png')
