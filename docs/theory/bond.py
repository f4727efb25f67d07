"""One bond under compression: stretched, and turned."""

import matplotlib.pyplot as plt
import numpy as np

from magphonon.plotting.axes import COLOURS

INK, FORCE, GHOST = COLOURS[2], COLOURS[1], '0.75'


def particles(ax, places, colour):
    for place in places:
        ax.add_patch(plt.Circle(place, 0.09, color=colour, zorder=3))


def moved_by(place, x, y):
    """The place x and y further on."""
    return place[0] + x, place[1] + y


def arrow(ax, start, end, colour, text='', offset=(0, 0.12)):
    ax.annotate('', end, start, arrowprops={'arrowstyle': '-|>', 'color': colour, 'linewidth': 1.6, 'shrinkA': 0, 'shrinkB': 0})
    ax.text(end[0] + offset[0], end[1] + offset[1], text, color=colour, ha='center', va='center')


figure, panels = plt.subplots(1, 3, figsize=(9, 2.4), layout='constrained')
fixed, rest = np.zeros(2), np.array([1.0, 0.0])

particles(panels[0], [fixed, rest], INK)
arrow(panels[0], moved_by(rest, 0.12, 0), moved_by(rest, 0.72, 0), FORCE, '$f\\,\\mathbf{n}$')
panels[0].set_title('(a) at rest: it pushes already', fontsize=10)

moved = np.array([1.25, 0.0])
particles(panels[1], [rest], GHOST)
particles(panels[1], [fixed, moved], INK)
less = '$(f-\\phi^{\\prime\\prime}u)\\,\\mathbf{n}$'
arrow(panels[1], moved_by(moved, 0.12, 0), moved_by(moved, 0.42, 0), FORCE, less, (0, 0.16))
arrow(panels[1], moved_by(rest, 0, -0.22), moved_by(moved, 0, -0.22), INK, '$u$', (-0.12, -0.14))
panels[1].set_title('(b) stretched: it pushes less', fontsize=10)

moved = np.array([0.92, 0.42])
n = moved / np.linalg.norm(moved)
particles(panels[2], [rest], GHOST)
particles(panels[2], [fixed, moved], INK)
tip = moved + 0.12 * n + 0.6 * n
arrow(panels[2], moved + 0.12 * n, tip, FORCE, '$f\\,\\mathbf{n}^{\\prime}$', (0.12, 0.04))
corner = np.array([tip[0], moved[1] + 0.12 * n[1]])
panels[2].plot([corner[0], tip[0]], [corner[1], tip[1]], ':', color=FORCE)
panels[2].text(tip[0] + 0.04, corner[1] + 0.06, '$f u/r$', color=FORCE, va='center')
arrow(panels[2], moved_by(rest, -0.01, 0.1), moved_by(moved, 0.03, -0.1), INK, '$u$', (0.14, -0.1))
panels[2].set_title('(c) turned: it pushes sideways', fontsize=10)

for ax in panels:
    ax.plot([0, 1], [0, 0], color=GHOST, linewidth=1, zorder=0)
    ax.set(xlim=(-0.2, 1.95), ylim=(-0.55, 0.95), aspect='equal')
    ax.axis('off')
panels[2].plot([0, 0.92], [0, 0.42], color=GHOST, linewidth=1, zorder=0)
