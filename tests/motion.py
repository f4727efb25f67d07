"""What the tests of motion set in motion: the prototype's patch, the paper's oscillator."""

import numpy as np

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices, units as u
from magphonon.dynamics import Recorder

LAW = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
L0, MASS = 10.0, 0.707  # mm, g: the paper's prototype
DT = 0.1  # ms, a twentieth of the limit


def patch(n=7, model='complete', speed=0.0, held=True, law=LAW):
    atoms = lattices.parallelogram(lattices.triangular(L0, MASS), n, n)
    if not held:
        atoms.set_constraint()
    atoms.calc = MagneticRepulsion(atoms, law, foundation=0.0196757, model=model)
    return stirred(atoms, speed)


def stirred(atoms, speed):
    v = np.zeros((len(atoms), 3))
    v[:, :2] = np.random.default_rng(1).normal(scale=speed, size=(len(atoms), 2))
    atoms.set_momenta(MASS * v)
    return atoms


def oscillator(theta0=0.0):
    """The paper's oscillator, held at rest by a dead load."""
    atoms = lattices.oscillator(theta0, 1 * u.m, 1 * u.kg)
    law = InversePower(b=1e4 * u.N * u.m**4, a=4.0)
    load = np.zeros((4, 3))
    load[3, 1] = -(1 + 2 * np.sin(theta0)) * 1e4 * u.N
    atoms.calc = MagneticRepulsion(atoms, law, bonds=lattices.OSCILLATOR_BONDS, load=load)
    return atoms


def states_of(atoms, steps, interval=1, dt=DT, **kwargs):
    dyn = DrivenVerlet(atoms, dt, **kwargs)
    recorder = Recorder(dyn, interval=interval)
    dyn.run(steps)
    return recorder.displacements


def apart(a, b):
    return abs(a - b).max() / abs(b).max()
