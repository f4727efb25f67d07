"""
Vibrations of a patch from its photo
====================================

No patch is perfect: the feet of the pillars are drilled a tenth of a millimetre off, and magnets and pillars differ from each
other.  A photo shows where the magnets stand.  That is enough to compute the local modes.  Here the patch is simulated, so that
the truth is known.
"""

# %%
# A patch and its photo
# ---------------------
# The rim is held, and one magnet is missing.  ``scattered`` draws the positions of the feet, the strengths of the magnets and
# the stiffnesses of the pillars at random; ``relaxed`` moves the magnets to where all forces balance.

import tempfile
from pathlib import Path

import numpy as np

from magphonon import InversePower, MagneticRepulsion, lattices, modes, read_scene, relaxed, units as u
from magphonon.plotting import new_axes
from magphonon.plotting.axes import COLOURS
from magphonon.stiffness import Scatter, scattered

law = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
patch = lattices.hexagon(lattices.triangular(spacing=10 * u.mm, mass=0.707 * u.g), side=50 * u.mm)
del patch[len(patch) // 2]
patch.calc = MagneticRepulsion(patch, law, foundation=60 * u.N / u.m, cutoff=45 * u.mm)
feet = scattered(patch, Scatter(position=0.1 * u.mm, strength=0.025, stiffness=0.05), seed=1)
true = relaxed(feet).atoms
truth = modes(true)

# %%
# The camera is turned by 20 degrees; a pixel is 0.04 mm, and y runs downwards in a photo.  Two marks on the frame, far apart,
# are at known places.  For each magnet we note its pixel and whether it is held.


def pixels(places):
    """Where places in mm appear in the photo."""
    z = np.exp(1j * np.radians(20)) * (places[:, :2] @ [1, 1j]) / 0.04
    return np.stack([z.real, -z.imag], axis=1) + 2000


seen = pixels(true.positions) + 0.5 * np.random.default_rng(2).normal(size=(len(true), 2))  # half a pixel of noise
marks = np.array([[-60.0, -50.0], [60.0, -50.0]])
held = np.isin(np.arange(len(true)), true.constraints[0].index)
folder = Path(tempfile.mkdtemp())
rows = [f'{x:.1f},{y:.1f},{h:d}' for (x, y), h in zip(seen, held, strict=True)]
(folder / 'photo.csv').write_text('\n'.join(['x_px,y_px,held', *rows]), encoding='utf-8')
print('\n'.join(['x_px,y_px,held', *rows[:3]]))

# %%
# Two marks do not reveal a mirrored photo.  If ``x_px`` and ``y_px`` are exchanged, or if y is counted upwards, the lattice
# comes out mirrored: the frequencies are the same, but the modes are in other places.  So check the picture that ``magphonon
# modes photo.toml`` draws of the patch: is the missing magnet, or a corner that you recognise, where you see it on the bench?
#
# Nor do two marks reveal a perspective or a lens that distorts.  Forces fall so steeply that distances which are 1 % off move
# frequencies by about 3 %.  Take the photo from far away with a long lens, and measure the distances of further marks in it.

# %%
# The scene
# ---------
# ``positions = "rest"`` says that the table gives the positions of the magnets at rest.  The command line for this scene is
# ``magphonon modes photo.toml``.

text = f"""title = "From a photo"
[lattice]
kind = "file"
file = "photo.csv"
mass_kg = 7.07e-4
cutoff_m = 0.045
positions = "rest"
points_px = {pixels(marks).round(1).tolist()}
points_m = {(marks / u.m).tolist()}

[law]
kind = "inverse_power"
b_N_m_a = 1.6209e-10
a = 4.5824
shells = 1

[foundation]
stiffness_N_per_m = 60
"""
(folder / 'photo.toml').write_text(text, encoding='utf-8')
scene = read_scene(folder / 'photo.toml')
found = modes(scene.atoms())

# %%
# How well?
# ---------
# ``mode_scatter`` computes the standard deviations of the frequencies, to first order in the deviations of the sites.  The
# position is that measured in the photo.

from magphonon.design import mode_scatter

scatter = Scatter(position=0.02 * u.mm, strength=0.025, stiffness=0.05)
std = u.hertz(mode_scatter(scene.atoms(), scatter, found, at_rest=True).std)
for k in range(4):
    print(f'mode {k + 1}: {found.frequencies_Hz[k]:.2f} +- {std[k]:.2f} Hz, truth {truth.frequencies_Hz[k]:.2f} Hz')

# %%
# If the photo were taken as the positions of the feet, the magnets would be relaxed twice.  The errors of the lowest modes,
# which lie beside the hole, would then exceed these standard deviations:
for k in range(4):
    print(f'mode {k + 1}: {found.frequencies_Hz[k]:.2f} Hz, truth {truth.frequencies_Hz[k]:.2f} Hz')

(folder / 'feet.toml').write_text(text.replace('"rest"', '"anchors"'), encoding='utf-8')
twice = modes(read_scene(folder / 'feet.toml').atoms())

ax = new_axes(6, 3)
first, count = truth.frequencies_Hz[:20], np.arange(1, 21)
ax.plot(count, 100 * (found.frequencies_Hz[:20] / first - 1), 'o', color=COLOURS[0], label='positions at rest')
ax.plot(count, 100 * (twice.frequencies_Hz[:20] / first - 1), 's', color=COLOURS[1], fillstyle='none', label='read as feet')
ax.axhline(0, color='0.5', linewidth=0.8)
ax.set(xlabel='mode', ylabel='off the truth (%)', xticks=count[::3])
ax.legend(frameon=False)
