"""The oscillator of the paper: how it is built, and its two stiffnesses over the angle of the outer magnets."""

import matplotlib.pyplot as plt
import numpy as np

from magphonon import InversePower, MagneticRepulsion, lattices, units as u
from magphonon.plotting.axes import COLOURS, UNSTABLE

LAW = InversePower(1e4 * u.N * u.m**4, 4.0)


def stiffness(degrees, model):
    """Horizontal and vertical stiffness of the free magnet in kN/m."""
    atoms = lattices.oscillator(degrees * u.deg, 1 * u.m, 1 * u.kg)
    atoms.calc = MagneticRepulsion(atoms, LAW, model=model)
    return atoms.calc.get_hessian(atoms).diagonal()[9:11] / (1e3 * u.N / u.m)


figure, (left, right) = plt.subplots(1, 2, figsize=(8.5, 3.3), layout='constrained', width_ratios=[1, 1.3])
atoms = lattices.oscillator(30 * u.deg, 1.0, 1.0)
places = atoms.positions[:, :2]
for i, j in lattices.OSCILLATOR_BONDS:
    left.plot(*places[[i, j]].T, color=COLOURS[0], linewidth=2)
left.plot(*places[:3].T, 's', color='0.4', markersize=12, label='fixed')
left.plot(*places[3:].T, 'o', color='k', markersize=12, label='free')
left.plot([places[3, 0], places[3, 0] - 1.1], [places[3, 1]] * 2, ':', color='0.6')
left.text(places[3, 0] - 0.62, places[3, 1] - 0.16, r'$\theta_0$')
left.legend(frameon=False, loc='upper center', bbox_to_anchor=(0.5, 0), ncols=2, fontsize=9)
left.set_aspect('equal')
left.margins(0.15)
left.axis('off')

degrees = np.linspace(0, 90, 91)
for model, line in (('complete', '-'), ('conventional', '--')):
    across, along = np.array([stiffness(angle, model) for angle in degrees]).T
    right.plot(degrees, along, line, color=COLOURS[0], label=f'vertical, {model}')
    right.plot(degrees, across, line, color=COLOURS[1], label=f'horizontal, {model}')
right.axvspan(56.789, 90, **UNSTABLE)
right.axhline(0, color='k', linewidth=0.6)
right.set(xlabel=r'$\theta_0$ (degrees)', ylabel='stiffness (kN/m)', xlim=(0, 90), ylim=(-40, 175))
right.set_xticks([0, 30, 45, 56.8, 90])
right.legend(fontsize=8, frameon=False)
