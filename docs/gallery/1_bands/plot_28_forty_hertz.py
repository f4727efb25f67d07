"""
I want 40 Hz at M
=================

The spacing, the exponent, or the height of the pillars that puts the shear branch there, with all neighbours or the nearest.
Pillars are cantilevers of aluminium; as springs with 33/140 of their mass they would seem to need 784 and 394 mm.
"""

import numpy as np
from scipy.optimize import brentq

from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices, read_scene, units as u
from magphonon.plotting import panels


def at_M(spacing=10.0, exponent=4.5824, height=150.0, reach=4.5):
    rod = read_scene('neighbours').foundation.pillar.model_copy(update={'height_m': height / 1e3})
    cell = lattices.triangular(spacing * u.mm, mass := 0.707 * u.g + rod.moving_mass_kg * u.kg)
    law = InversePower(0.2369 * u.N * (10 * u.mm)**exponent, exponent)   # 0.2369 N at 10 mm
    cell.calc = MagneticRepulsion(cell, law, cutoff=reach * spacing * u.mm, foundation=rod.stiffness_N_per_m * u.N / u.m)
    return u.hertz(rod.slowed(analytic_bands(cell, [[0.5, 0, 0]]).omega[0, 0], mass))


figure, axes = panels(1, 3, height=2.2, width=7.0)
for ax, (name, low, high) in zip(axes[0], (('spacing', 9, 15), ('exponent', 2.3, 6), ('height', 80, 400)), strict=True):
    for reach, line in ((4.5, '-'), (1.2, '--')):
        wanted = brentq(lambda one, name=name, reach=reach: at_M(reach=reach, **{name: one}) - 40, low, high)
        print(f'40 Hz at M: {name} {wanted:.4g}, neighbours within {reach} spacings')
        ax.plot(values := np.linspace(low, high, 21), [at_M(reach=reach, **{name: one}) for one in values], line)
    ax.axhline(40, color='0.7')
    ax.set(xlabel=name, ylabel='shear at M (Hz)')
figure.savefig('forty_hertz.png')
