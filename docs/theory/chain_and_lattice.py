"""Which bonds turn: none in a chain, most of them in the shear wave at M."""

import matplotlib.pyplot as plt
import numpy as np

from magphonon import lattices
from magphonon.lattices import find_bonds
from magphonon.plotting.axes import COLOURS

STRETCHED, TURNED, STILL = COLOURS[0], COLOURS[1], '0.8'

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout='constrained', width_ratios=[1.2, 1])

x = np.arange(8.0)
u = 0.25 * np.cos(np.pi * x / 3)
left.plot(x, 0 * x + 0.5, 'o', color=STILL, markersize=8)
left.plot(x + u, 0 * x, 'o', color='k', markersize=8, zorder=3)
for k in range(7):
    left.plot([x[k] + u[k], x[k + 1] + u[k + 1]], [0, 0], color=STRETCHED, linewidth=2)
left.set(xlim=(-0.8, 7.8), ylim=(-1.3, 1.3))
left.set_title('(a) chain: every bond is stretched, none turns', fontsize=10)

atoms = lattices.triangular(1.0, 1.0).repeat((5, 5, 1))
q = np.array([0.0, 0.5]) @ atoms.cell.reciprocal().array[:2] * 5  # M of one cell
bonds, places = find_bonds(atoms, 1), atoms.positions[:, :2]
k = q[:2] / np.linalg.norm(q[:2])
motion = 0.16 * np.cos(2 * np.pi * places @ q[:2])[:, None] * np.array([-k[1], k[0]])
inside = (abs(places[:, 0] - places[:, 0].mean()) < 1.9) & (abs(places[:, 1] - places[:, 1].mean()) < 1.5)
for i, j, shift, vector in zip(bonds.i, bonds.j, bonds.shift, bonds.vectors, strict=True):
    if shift.any() or not (inside[i] and inside[j]):
        continue
    change, n = motion[j] - motion[i], vector[:2] / np.linalg.norm(vector)
    turned = abs(change @ [-n[1], n[0]])
    colour = STILL if np.linalg.norm(change) < 1e-9 else TURNED if turned > abs(change @ n) else STRETCHED
    ends = np.array([places[i] + motion[i], places[j] + motion[j]])
    right.plot(*ends.T, color=colour, linewidth=2, zorder=1)
right.plot(*(places + motion)[inside].T, 'o', color='k', markersize=8, zorder=3)
right.quiver(*places[inside].T, *motion[inside].T, angles='xy', scale_units='xy', scale=0.45, width=0.006, color='0.4', zorder=4)
right.set_title('(b) shear wave at M', fontsize=10)
for colour, name in ((STRETCHED, 'mostly stretched'), (TURNED, 'mostly turned'), (STILL, 'neither')):
    right.plot([], [], color=colour, linewidth=2, label=name)
right.legend(fontsize=8, loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False)
for ax in (left, right):
    ax.set_aspect('equal')
    ax.axis('off')
