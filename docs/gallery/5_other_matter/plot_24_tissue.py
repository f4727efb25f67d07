"""
A net stiff by its tension
==========================

A honeycomb of springs has three bonds at each node, fewer than the four that make a plane structure stiff.  With D0 alone its
shear modulus is zero, as in issue 4 of RigidPy on GitHub.  When it is stretched, D* makes it stiff.  Circles show the closed
form, in which the two sublattices may shift against each other until their forces balance.
"""

import numpy as np

from magphonon import lattices
from magphonon.bands import sound_speeds
from magphonon.interactions import Spring
from magphonon.plotting import legend_above, new_axes
from magphonon.stiffness import PairCalculator

cell, stretch = lattices.honeycomb(spacing=1.0, mass=1.0), np.linspace(0.01, 0.6, 30)
ax = new_axes()
for model, line in (('complete', '-'), ('conventional', '--')):
    speeds = []
    for e in stretch:
        cell.calc = PairCalculator(cell, Spring(k=1.0, L0=1.0 - e))
        speeds.append(sound_speeds(cell, model=model))
    name = '$D^0 + D^{*}$' if model == 'complete' else '$D^0$ alone'
    ax.plot(stretch, np.array(speeds)[:, 0], line, label=f'shear, {name}')
    ax.plot(stretch, np.array(speeds)[:, 1], line, label=f'longitudinal, {name}')
t = stretch[2::3]                                                               # stiffness across a bond, tension over length
ax.plot(t, np.sqrt(3 / 4 * t + 3 / 8 * t * (1 - t) / (1 + t)), 'ko', fillstyle='none', label='closed form')
ax.set(xlabel='stretch of the bonds', ylabel='speed of sound', xlim=(0, 0.6), ylim=0)
legend_above(ax)
ax.figure.savefig('tissue.png')
