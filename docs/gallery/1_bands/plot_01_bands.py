"""
Bands with and without D*
=========================

The picture shows the dispersion relation of the published prototype: from the complete model, from springs alone, and from
phonopy.
"""

from magphonon import analytic_bands, finite_displacements, phonopy_bands, plot_bands, read_scene

cell = read_scene('prototype').atoms()                # an ase.Atoms with its calculator; magphonon scene prototype prints it
path = cell.cell.bandpath('GMKG', npoints=300, pbc=cell.pbc)

complete = analytic_bands(cell, path)
conventional = analytic_bands(cell, path, model='conventional')
numerical = phonopy_bands(finite_displacements(cell, supercell=(3, 3, 1)), path)

ax = plot_bands(complete, label='complete')
plot_bands(conventional, ax=ax, linestyle='--', label='conventional')
plot_bands(numerical, ax=ax, linestyle='', marker='.', label='phonopy')
ax.figure.savefig('bands.png')
