"""Where it holds and where it does not: maps of buckling, complete beside conventional, and the time step of integrators."""

import numpy as np
from ase.md.verlet import VelocityVerlet


class ExplicitDamping(VelocityVerlet):
    """The control: velocity Verlet with -m gamma v among the forces, from the latest velocity known."""

    def __init__(self, atoms, timestep, damping, push=0.0):
        super().__init__(atoms, timestep)
        self.damping, self.push = np.reshape(damping, (-1, 1)), push

    def step(self):
        atoms, p = self.atoms, self.atoms.get_momenta()
        p += self.dt / 2 * (atoms.get_forces() + self.push - self.damping * p)
        atoms.set_positions(atoms.get_positions() + self.dt * p / self.masses)
        p += self.dt / 2 * (atoms.get_forces() + self.push - self.damping * p)
        atoms.set_momenta(p)
