"""
A lens of magnets
=================

Strengths and rods are chosen so that a wave that a whole row of magnets sends out meets at one magnet.  The design takes rods as
cantilevers, the map as springs with 33/140 of their mass.
"""

import numpy as np

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed, units as u
from magphonon.design import Contrast, optimise
from magphonon.plotting import panels
from magphonon.response import Dof, harmonic_response

patch = lattices.hexagon(lattices.triangular(10 * u.mm, 0.896 * u.g), 50 * u.mm)
law = InversePower(1.6209e-10 * u.N * u.m**4.5824, 4.5824)
patch.calc = MagneticRepulsion(patch, law, cutoff=45 * u.mm, foundation=19.7 * u.N / u.m)
x, y, _ = (patch.positions - patch.positions.mean(axis=0)).T
free = np.setdiff1d(np.arange(len(x)), patch.constraints[0].index)
row = [Dof(k, (0, 1, 0)) for k in free[y[free] < y[free].min() + 1]]
far = free[y[free] > y[free].max() - 1]
focus = far[abs(x[far]).argmin()]
lens = Contrast(row, [focus], np.setdiff1d(far, focus), omega=2 * np.pi * 70 * u.Hz, damping=4 / u.s)
design = optimise(patch, lens, {'strength': (0.86, 1.14), 'rod': (0.84, 1.19)}, rod_mass=0.189 * u.g, steps=40)
figure, axes = panels(1, 2, height=2.4)
for ax, atoms, words in zip(axes[0], (relaxed(patch).atoms, design.atoms), ('equal magnets', 'the lens'), strict=True):
    push = sum(one.force(len(x)) for one in row)
    h = harmonic_response(atoms, push, [lens.omega], lens.damping).response[0]
    ax.scatter(x, y, 60, (abs(h[:, :2])**2).sum(axis=1))
    ax.set(aspect='equal', title=words, xlabel='x (mm)')
figure.savefig('lens.png')
