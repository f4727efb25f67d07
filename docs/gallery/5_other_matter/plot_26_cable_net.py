"""
A cable net
===========

D* alone makes a cable net stiff out of its plane.  Circles show omega^2 = 4 T/(m L) (sin^2 (i pi/2 N) + sin^2 (j pi/2 N)).
"""

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms

from magphonon import modes, units as u
from magphonon.interactions import Cable
from magphonon.plotting import legend_above, new_figure
from magphonon.stiffness import net

k, L, T, N, m = 10.0, 100.0, 5.0, 10, 10.0                                      # N/mm, mm, N, cables across, g
x, y = np.meshgrid(np.arange(N + 1), np.arange(N + 1), indexing='ij')
rim, knots = np.flatnonzero((x % N == 0) | (y % N == 0)), L * np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
nodes = Atoms(f'H{len(knots)}', knots, masses=np.full(len(knots), m), constraint=FixAtoms(rim))
joined = [(i, i + step) for step, along in ((N + 1, x), (1, y)) for i in np.flatnonzero(along < N)]
cables = net(nodes, [(i, j, Cable(k, L - T / k)) for i, j in joined], dim=3)
half, figure = np.sin(np.arange(1, N) * np.pi / (2 * N)) ** 2, new_figure(7.0, 2.8)
drawn, ax = figure.add_subplot(121, projection='3d'), figure.add_subplot(122)
for model, mark, name in (('conventional', 'x', '$D^0$ alone'), ('complete', '.', '$D^0 + D^{*}$')):
    cables.calc = cables.calc.about(cables, model=model)
    ax.plot((found := modes(cables)).frequencies_Hz[:81], mark, label=name)     # the others are in its plane
ax.plot(u.hertz(np.sqrt(4 * T / (m * L) * np.sort(np.add.outer(half, half), None))), 'ko', fillstyle='none', label='closed form')
ax.set(xlabel='mode out of the plane', ylabel='frequency (Hz)')
drawn.set_axis_off()
drawn.plot_wireframe(L * x, L * y, found.shapes[4, :, 2].reshape(x.shape))
legend_above(ax)
figure.savefig('cables.png')
