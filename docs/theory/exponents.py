"""Shear and longitudinal branches from Gamma to M, with and without D*, for three exponents."""

import matplotlib.pyplot as plt
import numpy as np

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.bands import bloch_modes
from magphonon.plotting.axes import COLOURS

figure, panels = plt.subplots(1, 3, figsize=(9, 3.0), layout='constrained', sharey=True)
share = np.linspace(0, 1, 101)
for ax, a in zip(panels, (12.0, 4.5824, 3.0), strict=True):
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, a))
    for model, line in (('complete', '-'), ('conventional', '--')):
        omega, _ = bloch_modes(cell, share[:, None] * np.array([0, 0.5, 0]), model)
        ax.plot(share, omega[:, 0] / np.sqrt(6 * a), line, color=COLOURS[1])
        ax.plot(share, omega[:, 1] / np.sqrt(6 * a), line, color=COLOURS[0])
    ax.set_title(f'$f = b\\,r^{{-{a:g}}}$', fontsize=10)
    ax.set_xticks([0, 1], ['Γ', 'M'])
    ax.margins(x=0)
panels[0].set_ylabel('$\\omega\\,/\\,\\sqrt{6 a f/(m L_0)}$')
panels[0].text(0.08, 0.85, 'longitudinal', color=COLOURS[0])
panels[0].text(0.6, 0.26, 'shear', color=COLOURS[1])
panels[2].plot([], [], 'k-', label='D⁰ + D*')
panels[2].plot([], [], 'k--', label='D⁰')
panels[2].legend(frameon=False, fontsize=9)
