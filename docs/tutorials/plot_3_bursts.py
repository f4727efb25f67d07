"""
A burst three ways, and when linear is enough
=============================================

We send the same burst through the same patch in three ways: by time steps one at a time, by time steps in blocks, and by exact
propagation without time steps.  Then we ask up to which force the linear answer is good enough.
"""

# %%
# A patch and a burst
# -------------------

import numpy as np

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, ToneBurst, lattices, propagate, units as u
from magphonon.dynamics import Recorder

law = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
cell = lattices.triangular(spacing=10 * u.mm, mass=0.707 * u.g)


def at_rest():
    """A fresh hexagon of magnets, its rim held by ASE's FixAtoms."""
    patch = lattices.hexagon(cell, side=60 * u.mm)
    patch.calc = MagneticRepulsion(patch, law, foundation=19.6757 * u.N / u.m)
    return patch


def burst(force):
    """Five cycles of 40 Hz on the magnet in the middle, upwards."""
    return ToneBurst(len(at_rest()) // 2, (0, 1), force, omega=2 * np.pi * 40 * u.Hz, cycles=5)


times = np.arange(0, 151, 2) * u.ms
print(f'{len(at_rest())} magnets')

# %%
# Three ways
# ----------
# Linear motion needs no time steps: ``propagate`` sums a Chebyshev series to the accuracy that you request.  ``DrivenVerlet`` is
# ASE's velocity Verlet with drives added.  Its engine ``'ase'`` makes single steps in Python; the engine ``'compiled'``
# makes them in blocks.  All return the same record.


def stepped(force, engine='compiled', dt=0.1 * u.ms):
    """Record of a run by time steps, every 2 ms."""
    dyn = DrivenVerlet(at_rest(), dt, [burst(force)], damping=4 / u.s, engine=engine)
    recorder = Recorder(dyn, interval=round(2 * u.ms / dt))
    dyn.run(round(times[-1] / dt))
    return recorder.displacements


linear = propagate(at_rest(), times, [burst(1e-4 * u.N)], damping=4 / u.s)
largest = abs(linear.displacements).max()
print(f'exact: {linear.products} products with the stiffness matrix, largest displacement {1e3 * largest:.2f} um')
for engine in ('ase', 'compiled'):
    off = abs(stepped(1e-4 * u.N, engine) - linear.displacements).max() / largest
    print(f'{engine:8} 1500 time steps, off by {off:.1e}')

# %%
# The difference is the error of the time steps, which is of order (omega dt)^2.

from magphonon.plotting import new_axes

ax = new_axes(6, 3)
middle = len(at_rest()) // 2
ax.plot(times, 1e3 * linear.displacements[:, middle, 1])
ax.set(xlabel='time (ms)', ylabel='driven magnet (µm)')

# %%
# When is linear enough?
# ----------------------
# The force law is nonlinear, so frequencies shift with the square of the amplitude.  ``verdict`` says at which amplitude the
# shift reaches 1 %:

from magphonon import verdict

one = lattices.triangular(spacing=10 * u.mm, mass=0.707 * u.g)
one.calc = MagneticRepulsion(one, law, foundation=19.6757 * u.N / u.m)
print(f'linear to 1 % in frequency up to {verdict(one)["amplitude"]:.2f} mm')

# %%
# The waveform already deviates at smaller amplitudes: a nonlinear law adds a second harmonic and a drift, whose share of the
# motion is proportional to the amplitude.  How large is the error of the linear answer as the force grows?

forces = np.array([1e-3, 1e-2, 1e-1]) * u.N
errors = []
for force in forces:
    full = stepped(force)
    errors.append(abs(full - force / (1e-4 * u.N) * linear.displacements).max() / abs(full).max())
    print(f'{force:g} N: largest displacement {abs(full).max():.3f} mm, linear off by {errors[-1]:.1e}')

ax = new_axes(4.5, 3)
ax.loglog(forces, errors, 'o-')
ax.set(xlabel='force (N)', ylabel='error of the linear answer')

# %%
# Up to a hundredth of a newton the linear answer is good to a percent, and many times cheaper.
