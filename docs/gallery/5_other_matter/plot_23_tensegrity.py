"""
Tensegrity and a cable net
==========================

Three struts and nine cables: the scene `prism` lists them.  Calladine (1978) counts 3 j - 6 - b + s = 1 mechanism: by D0 seven
modes cost nothing.  Self-stress stiffens it, and six are left, those of the whole body.  A flat net of cables vibrates out of its
plane by D* alone.  Circles: omega^2 = 4 T/(m L) (sin^2 (i pi/2 N) + sin^2 (j pi/2 N)).
"""

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms

from magphonon import Cable, modes, read_scene, units as u
from magphonon.plotting import legend_above, new_figure
from magphonon.stiffness import net

k, L, T, N, m = 10.0, 100.0, 5.0, 10, 10.0                                      # N/mm, mm, N, cables across, g
x, y = np.meshgrid(np.arange(N + 1), np.arange(N + 1), indexing='ij')
rim, knots = np.flatnonzero((x % N == 0) | (y % N == 0)), L * np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
nodes = Atoms(f'H{len(knots)}', knots, masses=np.full(len(knots), m), constraint=FixAtoms(rim))
joined = [(i, i + step) for step, along in ((N + 1, x), (1, y)) for i in np.flatnonzero(along < N)]
cables = net(nodes, [(i, j, Cable(k, L - T / k)) for i, j in joined], dim=3)
figure = new_figure(7.0, 5.4)
for row, atoms in enumerate((read_scene('prism').atoms(), cables)):
    drawn, ax = figure.add_subplot(2, 2, 2 * row + 1, projection='3d'), figure.add_subplot(2, 2, 2 * row + 2)
    bonds, tensions = atoms.calc.bonds, atoms.calc.law.dphi(atoms.calc.bonds.lengths)
    for model, mark in (('complete', '.'), ('conventional', 'x')):
        atoms.calc = atoms.calc.about(atoms, model=model)
        found = modes(atoms)
        up = abs(found.shapes[:, :, 2]).max(axis=1) > 1e-6 if row else slice(None)
        ax.plot(abs(found.frequencies_Hz[up]), mark, label='$D^0 + D^*$' if model == 'complete' else '$D^0$ alone')
        if row and model == 'complete':
            places = atoms.positions + 400 * found.shapes[up][4] / abs(found.shapes[up][4]).max()
    for i, j, t in zip(bonds.i, bonds.j, tensions, strict=True):
        drawn.plot(*(places if row else atoms.positions)[[i, j]].T, color='C0' if t > 0 else 'C1', linewidth=1 if t > 0 else 4)
    drawn.set_axis_off()
    ax.set(xlabel='mode out of the plane' if row else 'mode', ylabel='frequency (Hz)')
squares = np.sin(np.arange(1, N) * np.pi / (2 * N)) ** 2
known = np.sqrt(4 * T / (m * L) * np.sort(np.add.outer(squares, squares).ravel()))
ax.plot(u.hertz(known), 'ko', fillstyle='none', label='closed form')
legend_above(ax)
figure.savefig('prism.png')
