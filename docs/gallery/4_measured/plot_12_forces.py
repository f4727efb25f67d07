"""
A law from measured forces
==========================

A law is fitted to a table of forces, as a load cell gives it. The picture also shows the interval of the force at 10 mm.
"""

from importlib.resources import files

from magphonon import units as u
from magphonon.interactions import SharedErrors, fit_forces, read_forces
from magphonon.plotting import plot_fit

forces = read_forces(files('magphonon.data') / 'synthetic_force.csv')           # your own table: columns r_mm,f_N
figure = plot_fit(forces, fit_forces(forces, 10 * u.mm, SharedErrors(distance=0.05 * u.mm)))
figure.savefig('forces.png')
