"""
A sheet of argon under strain
=============================

For one layer of argon, `split` turns ASE's Lennard-Jones calculator into D0 and D*.  D* makes the transverse wave at M slower in
compression and faster in tension, by 15 % at a strain of 6 %.  Circles use the forces of ASE's calculator in a frozen wave.
"""

import numpy as np
from ase import Atoms
from ase.calculators.lj import LennardJones

from magphonon import analytic_bands
from magphonon.plotting import legend_above, new_axes
from magphonon.stiffness import split

strain, found, frozen = np.linspace(-0.04, 0.06, 11), [], []
for e in strain:
    a = 3.78 * (1 + e)                                                          # Angstrom
    sheet = Atoms('Ar', cell=[[a, 0, 0], [a / 2, a * 3**0.5 / 2, 0], [0, 0, 20]], pbc=(True, True, False))
    sheet.calc = LennardJones(sigma=3.4, epsilon=0.0103, rc=8.0)
    here = split(sheet)
    found.append([analytic_bands(here, [[0, 0.5, 0]], model).frequencies_Hz[0] / 1e12 for model in ('complete', 'conventional')])
    wave = sheet.repeat((1, 2, 1))
    wave.calc, wave.positions[1, 0] = sheet.calc, wave.positions[1, 0] + 1e-3   # the rows move against each other along x
    frozen.append(np.sqrt(wave.get_forces()[0, 0] / 5e-4 / sheet.get_masses()[0]) * 98.2269 / (2 * np.pi))   # to rad/ps, to THz
ax = new_axes()
ax.set(xlabel='strain (%)', ylabel='frequency at M (THz)')
for k, (name, line) in enumerate((('$D^0 + D^{*}$', '-'), ('$D^0$ alone', '--'))):
    ax.plot(100 * strain, np.array(found)[:, k], line, label=[f'transverse, {name}', f'longitudinal, {name}'])
ax.plot(100 * strain, frozen, 'ko', fillstyle='none', label='forces of ASE')
legend_above(ax)
ax.figure.savefig('sheet.png')
