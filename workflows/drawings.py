"""A drawing made from the structure itself: the oscillator with its static forces."""

import numpy as np

from magphonon.plotting.axes import COLOURS

FORCE = 0.55  # length of the longest arrow of a force, in spacings


def draw_oscillator(ax, atoms, named=True):
    """The free magnet on its fixed ones with the static forces on it, lengths in spacings; `named` with angle and names."""
    bonds = atoms.calc.bonds
    L0, n = bonds.lengths[0], np.array([-1, 1])[(bonds.i == 3).astype(int)][:, None] * bonds.vectors[:, :2]  # from the free one
    places = n / L0
    for x, y in places:
        ax.plot([0, x], [0, y], color='0.6', zorder=1)
    size = 5 if named else 3
    ax.plot(*places.T, 's', color='0.4', markersize=size)
    ax.plot(0, 0, 'o', color=COLOURS[0], markersize=1.4 * size, zorder=4)
    ax.set(aspect='equal', xlim=(-1.35, 1.35), ylim=(-1.5, 0.4))
    ax.set_axis_off()
    if not named:
        return
    for (x, y), length in zip(places, bonds.lengths, strict=True):
        push = atoms.calc.potential.dphi(length) / atoms.calc.potential.dphi(L0) * FORCE
        ax.annotate('', xy=(-push * x, -push * y), xytext=(0, 0), arrowprops={'arrowstyle': '->', 'color': COLOURS[1]}, zorder=3)
    theta0 = -np.arctan2(*places[np.argmax(places[:, 0])][::-1])
    arc = np.linspace(0, -theta0, 30)
    ax.plot([0, 1], [0, 0], ':', color='0.4', linewidth=0.8)
    ax.plot(0.45 * np.cos(arc), 0.45 * np.sin(arc), color='0.2', linewidth=0.8)
    ax.text(0.55 * np.cos(theta0 / 2), -0.55 * np.sin(theta0 / 2), r'$\theta_0$', ha='left', va='center')
    ax.text(0.06, -0.6, '$L_0$')
    ax.text(-0.16, 0, 'free', ha='right', va='center')
    ax.text(0.12, -1.02, 'fixed', va='center')
    ax.text(0.08, 0.45, 'static forces', color=COLOURS[1], va='top')
    ax.set_ylim(-1.15, 0.62)
