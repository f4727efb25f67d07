"""
How many neighbours?
====================

Distant magnets change the bands, which are computed here with one, two and twelve shells of neighbours.
"""

from magphonon import MagneticRepulsion, analytic_bands, plot_bands, read_scene

cell = read_scene('prototype').atoms()
path = cell.cell.bandpath('GMKG', npoints=200, pbc=cell.pbc)
law, foundation, ax = cell.calc.law, cell.calc.foundation, None
for shells, line in ((1, ':'), (2, '--'), (12, '-')):
    cell.calc = MagneticRepulsion(cell, law, shells=shells, foundation=foundation)
    ax = plot_bands(analytic_bands(cell, path), ax=ax, linestyle=line, label=f'{shells} shell{"s" * (shells > 1)}')
ax.figure.savefig('neighbours.png')
