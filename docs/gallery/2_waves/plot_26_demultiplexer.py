"""
A demultiplexer
===============

Every magnet and every pillar is chosen from a list, so that 60 Hz arrives at port A and 80 Hz at port B.
"""

from magphonon import read_scene, units as u
from magphonon.plotting import letter_panels, panels

atoms = read_scene('demultiplexer').atoms()
x, y, _ = atoms.positions.T / u.mm
places = {'source': (-40, 0), 'A': (30, 34.6), 'B': (30, -34.6)}
springs = atoms.calc.foundation[:, 0] / (u.N / u.m)

figure, axes = panels(1, 2, height=2.6)
for ax, values, label in zip(axes[0], (atoms.calc.strengths, springs), ('strength', 'pillar (N/m)'), strict=True):
    dots = ax.scatter(x, y, 40, values)
    figure.colorbar(dots, ax=ax, label=label, shrink=0.8)
    for name, place in places.items():
        ax.text(*place, name, ha='center', va='center', color='white', backgroundcolor='black', fontsize='x-small')
    ax.set(aspect='equal', xlabel='x (mm)', ylabel='y (mm)')
letter_panels(axes)
figure.savefig('demultiplexer.png')
