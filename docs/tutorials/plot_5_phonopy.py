"""
From phonopy, ASE and LAMMPS to here, and back
==============================================

Cells are ASE ``Atoms``, forces come from an ASE calculator, and force constants come from phonopy.  Only the units differ: mm, g
and ms instead of Å, u and fs.  :doc:`/reference/phonopy` has a table of them.
"""

# %%
# ASE
# ---
# Any dynamics or optimiser of ASE works with these atoms.  Times and energies are in ms and mJ, whatever units ASE prints beside
# them.

from ase.md.verlet import VelocityVerlet

from magphonon import InversePower, MagneticRepulsion, analytic_bands, finite_displacements, lattices, phonopy_bands, units as u

law = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
cell = lattices.triangular(spacing=10 * u.mm, mass=0.707 * u.g)
cell.calc = MagneticRepulsion(cell, law, foundation=19.6757 * u.N / u.m)

atoms = cell.repeat((4, 4, 1))
atoms.calc = MagneticRepulsion(atoms, law, foundation=19.6757 * u.N / u.m)
atoms.positions[5, 0] += 0.1 * u.mm
start = atoms.get_total_energy()
dyn = VelocityVerlet(atoms, timestep=0.05 * u.ms)
dyn.run(200)
print(f'{atoms.get_total_energy() - start:.1e} of {atoms.get_total_energy():.3f} mJ gained in 200 steps')

# %%
# You can also build the cell yourself.  Any ``ase.Atoms`` will do, with positions in mm, masses in g, and ``pbc`` set along the
# directions in which it repeats.

from ase import Atoms

own = Atoms('H2', positions=[[0, 0, 0], [10, 0, 0]], cell=[20, 0, 0], pbc=(True, False, False))
own.set_masses([1.0, 2.0])
own.calc = MagneticRepulsion(own, law, foundation=200 * u.N / u.m)  # without it the chain would buckle sideways
print('at the edge of the zone (Hz):',
      analytic_bands(own, own.cell.bandpath('X', npoints=1, pbc=own.pbc)).frequencies_Hz.round(3))

# %%
# phonopy
# -------
# ``finite_displacements`` returns a ``phonopy.Phonopy`` object: phonopy makes the displacements, and the calculator computes the
# forces.

import numpy as np

phonon = finite_displacements(cell, supercell=(3, 3, 1))
path = cell.cell.bandpath('GMKG', npoints=60, pbc=cell.pbc)
exact, numerical = analytic_bands(cell, path), phonopy_bands(phonon, path)
print(f'largest difference: {abs(numerical.frequencies_Hz - exact.frequencies_Hz).max():.1e} Hz')

from magphonon import plot_bands

ax = plot_bands(exact, label='analytic')
ax = plot_bands(numerical, ax=ax, linestyle='', marker='o', fillstyle='none', label='phonopy')

# %%
# The methods of this object work as usual and return Hz.  Its group velocities have the unit of a length times a frequency, here
# mm Hz, which is a thousandth of a metre per second.  This package returns mm/ms, which is m/s.

from magphonon.bands import group_velocities

q = [[0.1, 0.2, 0.0]]
found = phonon.run_qpoints(q, with_group_velocities=True)
speeds = np.linalg.norm(found.group_velocities[0], axis=1)[-2:]  # the first branch is the motion out of the plane, at zero
print('phonopy  ', found.frequencies[0].round(4), 'Hz,', (speeds / 1e3).round(4), 'm/s')
omega, velocity = group_velocities(cell, q)
print('magphonon', u.hertz(omega[0]).round(4), 'Hz,', np.linalg.norm(velocity[0], axis=1).round(4), 'm/s')

# %%
# Thermal properties are the exception: phonopy multiplies its frequencies by Planck's constant as if they were THz, so it must
# get them in THz.  The cutoff leaves out the motion along z.  At room temperature each of the two modes has the heat capacity k
# (Boltzmann's constant).

phonon.unit_conversion_factor *= 1e-12
phonon.run_mesh([8, 8, 1], is_gamma_center=True)
warm = phonon.run_thermal_properties(temperatures=[300.0], cutoff_frequency=1e-14)
phonon.unit_conversion_factor *= 1e12
print(f'heat capacity: {warm.heat_capacity[0]:.4f} J/K/mol; 2 R is {2 * 8.314462618:.4f}')

# %%
# ``magphonon bands`` writes files for phonopy, as the next lines do.  Where phonopy says THz, the numbers in these files are in
# Hz.

import tempfile

import phonopy

from magphonon.bands import write_phonopy_params

folder = tempfile.mkdtemp()
write_phonopy_params(phonon, f'{folder}/phonopy_params.yaml')
again = phonopy.load(f'{folder}/phonopy_params.yaml', log_level=0)
print(again.run_qpoints([[0, 0, 0], [1 / 2, 0, 0], [2 / 3, 1 / 3, 0]]).frequencies.round(3))

# %%
# LAMMPS
# ------
# ``write_lammps_input`` writes a patch, its force law as a table, its drives and its damping.  ``lmp -in in.lammps`` runs this
# input, and ``read_lammps_displacements`` reads the trajectory back.

from pathlib import Path

from magphonon import ToneBurst
from magphonon.dynamics import write_lammps_input

patch = lattices.hexagon(cell, side=50 * u.mm)
patch.calc = MagneticRepulsion(patch, law, foundation=19.6757 * u.N / u.m)
burst = ToneBurst(len(patch) // 2, (0, 1), 1e-4 * u.N, omega=2 * np.pi * 40 * u.Hz, cycles=5)
write_lammps_input(folder, patch, timestep=0.05 * u.ms, steps=2000, drives=[burst], damping=4 / u.s, interval=40)
print(Path(folder, 'in.lammps').read_text())

# %%
# This is the patch that LAMMPS receives; its rim is held fixed:

from magphonon.plotting import plot_patch

ax = plot_patch(patch)
