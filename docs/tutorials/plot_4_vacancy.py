"""
A lattice with a missing magnet
===============================

Remove one magnet.  The others push its neighbours into the hole, the bonds change, and vibrations appear at frequencies outside
all branches.  The order of the steps matters: first find the new positions at rest, then apply linear tools there.
"""

# %%
# The hole
# --------

import numpy as np

from magphonon import InversePower, MagneticRepulsion, lattices, modes, relaxed, units as u

law = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
FOUNDATION = 80 * u.N / u.m
cell = lattices.triangular(spacing=10 * u.mm, mass=0.707 * u.g)
perfect = cell.repeat((10, 10, 1))
perfect.calc = MagneticRepulsion(perfect, law, foundation=FOUNDATION)

holed = cell.repeat((10, 10, 1))
del holed[55]
holed.calc = MagneticRepulsion(holed, law, foundation=FOUNDATION)
print(f'largest force that nothing balances: {abs(holed.get_forces()).max():.3f} N')

# %%
# A linear tool refuses such a structure, and says how to correct it:

try:
    modes(holed)
except ValueError as error:
    print(error)

# %%
# Relax
# -----
# The pillars stay where they were, so their springs carry a part of the forces.  (With the prototype's 20 N/m the lattice would
# collapse into the hole; ``relaxed`` says so.)

rest = relaxed(holed)
print(f'moved by up to {rest.shift:.2f} mm; force left: {rest.after:.1e} N')

from magphonon.plotting import new_axes
from magphonon.plotting.axes import COLOURS

ax = new_axes(5, 3)
moved = rest.atoms.positions - holed.positions
ax.plot(*rest.atoms.positions[:, :2].T, 'o', color='0.7', markersize=5)
ax.quiver(*holed.positions[:, :2].T, *5 * moved[:, :2].T, angles='xy', scale_units='xy', scale=1, color=COLOURS[1])
ax.set(aspect='equal', xlabel='x (mm)', ylabel='y (mm)', title='displacements, five times enlarged')

# %%
# Modes
# -----
# Most of the 198 modes lie where the bands of the perfect lattice are.  A mode of the defect moves few magnets: its
# participation ratio, (sum u²)² / (N sum u⁴), is small.


def participation(found):
    """Share of the magnets that take part in each mode."""
    size = (found.shapes**2).sum(axis=2)
    return size.sum(axis=1) ** 2 / (size**2).sum(axis=1) / size.shape[1]


whole, local = modes(perfect), modes(rest.atoms)
share = participation(local)
order = np.argsort(share)[:4]
for k in order:
    print(f'{local.frequencies_Hz[k]:8.3f} Hz moves {100 * share[k]:.0f} % of the magnets')

ax = new_axes(6, 3)
ax.plot(whole.frequencies_Hz, participation(whole), '.', color='0.7', label='perfect')
ax.plot(local.frequencies_Hz, share, '.', color=COLOURS[0], label='one magnet missing')
ax.set(xlabel='frequency (Hz)', ylabel='participation ratio')
ax.legend(frameon=False)

# %%
# Three of these modes lie below all bands of the perfect lattice, and one lies above.  In the softest mode the neighbours move
# into the hole and out of it, because nothing there pushes back.

k = order[0]
ax = new_axes(5, 3)
ax.plot(*rest.atoms.positions[:, :2].T, 'o', color='0.7', markersize=5)
arrows = local.shapes[k] / abs(local.shapes[k]).max() * 8
ax.quiver(*rest.atoms.positions[:, :2].T, *arrows[:, :2].T, angles='xy', scale_units='xy', scale=1, color=COLOURS[0])
ax.set(aspect='equal', xlabel='x (mm)', ylabel='y (mm)', title=f'{local.frequencies_Hz[k]:.2f} Hz')
