"""
A demultiplexer
===============

Every magnet and every pillar chosen from a list, so that 60 Hz arrives at A and 80 Hz at B.
"""

from importlib.resources import as_file, files

import numpy as np

from magphonon import MagneticRepulsion, read_scene, relaxed, units as u
from magphonon.plotting import plot_design

scene = read_scene('demultiplexer')
patch, source, *_ = scene.design.sites(scene)
ports = {name: target.loud.of(patch) for name, target in zip('AB', scene.design.targets, strict=True)}
with as_file(files('magphonon.data').joinpath('demultiplexer.csv')) as path:
    x, y, strengths, stiffness, held = np.loadtxt(path, delimiter=',', skiprows=1).T
patch.calc = MagneticRepulsion(patch, patch.calc.laws, bonds=patch.calc.bonds, strengths=strengths,
                               foundation=stiffness * u.N / u.m)
axes = plot_design(relaxed(patch).atoms, {'source': source, **ports})
axes[0].figure.savefig('demultiplexer.png')
