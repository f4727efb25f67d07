"""
A demultiplexer in ten minutes
==============================

We design a patch of magnets that sends 60 Hz to one port and 80 Hz to another, by choosing the strength of every magnet and the
pillar under it.  We also see what a design without the static forces would have promised, and how that device would behave.
"""

# %%
# What is wanted
# --------------
# The patch is a hexagon of the prototype's magnets.  All magnets within 45 mm of each other repel each other: a device designed
# with nearest neighbours alone would not work.  A force pushes a magnet on the left.  At 60 Hz port A, at the upper right, is to
# move much more than port B, at the lower right; at 80 Hz it is the other way round.

import numpy as np

from magphonon import InversePower, MagneticRepulsion, lattices, units as u
from magphonon.design import Level, Worst, optimise
from magphonon.response import Dof

patch = lattices.hexagon(lattices.triangular(10 * u.mm, 0.707 * u.g), 60 * u.mm)
law = InversePower(1.6209e-10 * u.N * u.m**4.5824, 4.5824)
patch.calc = MagneticRepulsion(patch, law, cutoff=45 * u.mm, foundation=19.6757 * u.N / u.m)


def place(x, y):
    """The magnet nearest to a place, seen from the middle of the patch, and the direction x."""
    away = patch.positions - patch.positions.mean(axis=0) - [x, y, 0]
    return Dof(int(np.linalg.norm(away, axis=1).argmin()), np.array([1.0, 0.0, 0.0]))


source, A, B = place(-40, 0), place(30, 34.64), place(30, -34.64)


def contrast(loud, quiet, frequency):
    """How much louder one port is than the other, in dB."""
    return (Level(source, loud, 2 * np.pi * frequency * u.Hz, 4 / u.s, floor=0.01)
            - Level(source, quiet, 2 * np.pi * frequency * u.Hz, 4 / u.s, floor=0.01))


weaker = Worst((contrast(A, B, 60), contrast(B, A, 80)))

# %%
# The design
# ----------
# The objective is the weaker of the two contrasts.  Its derivatives with respect to every magnet and every pillar include the
# shift of the rest positions.  All derivatives together cost about as much as the responses themselves.  With ``compare=True`` a
# second design is made with D0 alone.

over = {'strength': (0.86, 1.14), 'spring': (0.8145, 1.2156)}
design = optimise(patch, weaker, over, steps=30, compare=True)
print(f'before: {design.before:.1f} dB; with D0 + D*: {design.value:.1f} dB')
other = design.conventional
print(f'with D0 alone: {other.value:.1f} dB promised, {other.given:.1f} dB in truth')

# %%
# A design to be built
# --------------------
# A design made for perfect parts does not survive if magnets and pillars scatter by 1 %:

from magphonon.design import Robust
from magphonon.stiffness import Scatter

robust = Robust(Scatter(strength=0.01, stiffness=0.01), draws=12)
print(f'{(design.drawn(robust, seed=1) > 30).sum()} of 12 copies keep 30 dB')

# %%
# ``optimise(..., robust=robust)`` maximises the objective of the worst of many copies.  ``of_parts`` rounds a few magnets and
# pillars at a time to parts that can be bought, and optimises the others again.  That takes some minutes, so here is a finished
# design, of magnets of five strengths and pillars of four kinds.  Its build list, which ``write_build_list`` has written, is a
# table of particles, which every command reads as ``[lattice] kind = "file"``.

from magphonon import read_scene, relaxed
from magphonon.stiffness import LinearSystem

built = read_scene('demultiplexer').atoms()
print(f'the weaker contrast: {weaker.value(LinearSystem.of(built)):.1f} dB')

# %%
# The levels at both ports as functions of frequency, for equal magnets and for the designed ones:

from magphonon.plotting import letter_panels, panels
from magphonon.response import receptance

frequencies = np.linspace(40, 100, 241)
figure, axes = panels(1, 2, height=2.6)
for ax, atoms in zip(axes[0], (relaxed(patch).atoms, built), strict=True):
    for name, port in {'A': A, 'B': B}.items():
        h = receptance(atoms, source, port, 2 * np.pi * frequencies * u.Hz, 4 / u.s).response
        ax.semilogy(frequencies, abs(h), label=name)
    ax.set(xlabel='frequency (Hz)', ylabel='displacement per force (mm/N)', ylim=(1e-3, 100))
axes[0, 0].legend()
letter_panels(axes, ['equal magnets', 'designed'])
