"""
Force between ring magnets
==========================

The force is computed from the size and the remanence in a datasheet. At large distances it approaches the law of dipoles.
"""

import numpy as np

from magphonon import magnet_law, units as u
from magphonon.interactions import Ring
from magphonon.plotting import legend_above, new_axes

ring = Ring(6.35 * u.mm, 1.5875 * u.mm, 3.175 * u.mm, remanence=1.3 * u.T)
r = np.geomspace(7, 60, 200) * u.mm
force = -magnet_law(ring).dphi(r)
ax = new_axes()
ax.loglog(r, force, label='ring magnets')
ax.loglog(r, force[-1] * (r / r[-1])**-4.0, '--', label='dipoles, $r^{-4}$')
ax.set(xlabel='distance (mm)', ylabel='force (N)')
ax.set_xticks([10, 20, 40], ['10', '20', '40'])
ax.minorticks_off()
legend_above(ax)
ax.figure.savefig('magnets.png')
