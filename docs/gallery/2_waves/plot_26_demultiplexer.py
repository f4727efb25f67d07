"""
A demultiplexer
===============

Every magnet and every pillar is chosen from a list, so that 60 Hz arrives at port A and 80 Hz at port B.
"""

from magphonon import read_scene
from magphonon.plotting import plot_design

scene = read_scene('demux')
atoms, source, *_ = scene.design.sites(scene)
ports = {name: target.loud.of(atoms) for name, target in zip('AB', scene.design.targets, strict=True)}
axes = plot_design(atoms, {'source': source, **ports})
axes[0].figure.savefig('demultiplexer.png')
