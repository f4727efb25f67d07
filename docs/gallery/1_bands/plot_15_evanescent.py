"""
Waves that die away
===================

Below the cut-off of a lattice on a foundation no wave travels. The picture shows how much each wave loses from one row to the
next.
"""

import numpy as np

from magphonon import read_scene, units as u
from magphonon.bands import complex_bands
from magphonon.plotting import legend_above, new_axes

cell = read_scene('prototype').atoms()
f = np.linspace(1, 170, 340)
ax = new_axes()
for model, line in (('complete', '-'), ('conventional', '--')):
    xi = complex_bands(cell, (0, 1, 0), 2 * np.pi * f * u.Hz, model).xi
    loss = np.sort(xi.imag, axis=1)[:, 0]                                        # of the slowest decay
    ax.plot(f, 20 * np.log10(np.e) * loss, line, label=model)
ax.set(xlabel='frequency (Hz)', ylabel='loss per row (dB)', ylim=0, xlim=(0, 170))
legend_above(ax)
ax.figure.savefig('evanescent.png')
