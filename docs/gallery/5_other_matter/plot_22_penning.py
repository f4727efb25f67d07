"""
Ions in a Penning trap
======================

Nineteen ions are held by a trap (one anchor for all) and a magnetic field (gyration).  The dashed lines are two known frequencies
along the axis: omega^2 = kz if all ions move together, and kz - k if their plane tilts (Wang et al., arXiv:1211.2842).
"""

import numpy as np
from ase import Atoms

from magphonon import InversePower, lattices, modes, relaxed
from magphonon.plotting import legend_above, panels
from magphonon.stiffness import PairCalculator

k, kz, n = 1.0, 30.0, 19
ions = Atoms(f'H{n}', lattices.hexagon(lattices.triangular(1.2, 1.0), side=2.4).positions, masses=np.ones(n))
ions.calc = PairCalculator(ions, InversePower(b=1.0, a=2.0), cutoff=20.0, foundation=[[k, k, kz]],
                           anchors=np.zeros((n, 3)), gyration=5.0)
ions = relaxed(ions).atoms
figure, ((left, right),) = panels(1, 2, height=2.6)
left.plot(*ions.positions[:, :2].T, 'o')
left.set(xlabel='$x$', ylabel='$y$', aspect='equal')
for model, mark in (('complete', 'o'), ('conventional', 'x')):
    ions.calc = ions.calc.about(ions, model=model)
    found = modes(ions)
    drum = np.sort(found.omega[abs(found.shapes[:, :, 2]).max(axis=1) > 1e-6])
    right.plot(drum, mark, label=model)
right.hlines(np.sqrt([kz, kz - k]), 0, n - 1, color='0.6', linestyle='--', zorder=0)
right.set(xlabel='drumhead mode', ylabel=r'$\omega$')
legend_above(right)
figure.savefig('penning.png')
