"""
A tensegrity prism
==================

Three struts and nine cables.  Calladine (1978) counts 3 j - 6 - b + s = 1 mechanism: by D0 seven modes cost nothing.  Self-stress
stiffens it, and six are left, those of the whole body.
"""

import numpy as np
from ase import Atoms

from magphonon import Spring, modes
from magphonon.plotting import legend_above, new_figure
from magphonon.stiffness import net, self_stress

low = np.arange(3)
after, turns = np.roll(low, -1), 2 * np.pi * low / 3
rings = [np.stack([np.cos(turns + by), np.sin(turns + by), 0 * turns + z], axis=1) for by, z in ((0, 0), (np.pi / 6, 1.2))]
nodes = Atoms('H6', np.vstack(rings), masses=np.ones(6))
pairs = np.hstack([(low, after), (3 + low, 3 + after), (low, 3 + low), (low, 3 + after)]).T.tolist()
bare = net(nodes, [(i, j, Spring(k=10.0, L0=0.0)) for i, j in pairs])
tension = self_stress(bare)[0] / self_stress(bare)[0, 0]                        # of the rings, 1 N
rest = bare.calc.bonds.lengths - tension / 10.0
prism = net(nodes, [(i, j, Spring(10.0, L0)) for (i, j), L0 in zip(pairs, rest, strict=True)])
figure = new_figure(7.0, 2.8)
drawn, ax = figure.add_subplot(121, projection='3d'), figure.add_subplot(122)
for (i, j), t in zip(pairs, tension, strict=True):
    drawn.plot(*nodes.positions[[i, j]].T, color='C0' if t > 0 else 'C1', linewidth=1 if t > 0 else 4)
ax.plot(modes(prism).omega, 'o', label='$D^0 + D^*$')
ax.plot(abs(np.linalg.eigvalsh(prism.calc.rest_hessian('conventional').toarray())) ** 0.5, 'x', label='$D^0$ alone')
ax.set(xlabel='mode', ylabel=r'$\omega$ (rad/ms)')
legend_above(ax)
figure.savefig('prism.png')
