"""
A demultiplexer in ten minutes
==============================

We design a patch of magnets that sends 60 Hz to one port and 80 Hz to another, by choosing the strength of every magnet and the
pillar under it.  We also see what a design without the static forces would have promised, and how that device would behave.

On the command line, with scatter, parts to buy, pictures and films::

    magphonon design demultiplexer
"""

# %%
# What is wanted
# --------------
# The ready scene describes the patch and where it is driven.  It has a table for each target: a frequency, a place that should
# be loud, and a place that should be quiet.  All magnets within 45 mm of each other repel each other: a device designed with
# nearest neighbours alone would not work.

from magphonon import read_scene
from magphonon.design import optimise

scene = read_scene('demultiplexer')
patch, source, weakest, robust = scene.design.sites(scene)
over = scene.design.over.bounds()
for name, (low, high) in over.items():
    print(f'each {name} within {low:g} to {high:g} of its value')

# %%
# The design
# ----------
# The objective is the weaker of the two contrasts in dB.  Its derivatives with respect to every magnet and every pillar include
# the shift of the rest positions.  All derivatives together cost about as much as the responses themselves.  With
# ``compare=True`` a second design is made with D0 alone.

design = optimise(patch, weakest, over, steps=30, compare=True)
print(f'before: {design.before:.1f} dB; with D0 + D*: {design.value:.1f} dB')
other = design.conventional
print(f'with D0 alone: {other.value:.1f} dB promised, {other.given:.1f} dB in truth')

# %%
# Is it true?
# -----------
# ``verify`` tests the design by means that were not used to make it: time steps of the particles, neighbours that were omitted,
# and specimens whose magnets and pillars scatter by 1 %.  A design made for perfect parts does not survive this scatter.

from dataclasses import replace

from magphonon.design import verify

found = verify(design, replace(robust, draws=12))
print(found.table('dB', goal=30.0))

# %%
# A design to be built
# --------------------
# ``optimise(..., robust=robust)`` maximises the objective of the worst of many specimens.  ``of_parts`` rounds a few magnets and
# pillars at a time to parts that can be bought, and optimises the others again.  That takes some minutes, so here is a finished
# design, of magnets of five strengths and pillars of four kinds.  Its build list is a table of particles, which every command
# reads as ``[lattice] kind = "file"``.

from magphonon import units as u
from magphonon.design import Rest
from magphonon.plotting import plot_design, plot_levels
from magphonon.stiffness import LinearSystem

built = read_scene('demux')
atoms, source, weakest, _ = built.design.sites(built)
print(f'the weaker contrast: {weakest.value(LinearSystem.of(atoms)):.1f} dB')

ports = {name: target.loud.of(atoms) for name, target in zip('AB', built.design.targets, strict=True)}
axes = plot_design(atoms, {'source': source, **ports})

# %%
# The levels at both ports as functions of frequency, for equal magnets and for the designed ones:

equal = read_scene('demultiplexer').patch_atoms()
levels = {}
for when, structure in (('equal magnets', equal), ('designed', atoms)):
    rest, dofs = Rest(LinearSystem.of(structure)), [target.loud.of(structure) for target in built.design.targets]
    push, omega, damping = built.frf.force.of(structure), built.frf.omega, built.frf.damping
    levels[when] = {name: [abs(dof.seen(rest.response(push, w, damping))) for w in omega]
                    for name, dof in zip('AB', dofs, strict=True)}
axes = plot_levels(u.hertz(omega), levels, marks=[60, 80])
