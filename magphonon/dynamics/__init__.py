"""Time integration: ASE's velocity Verlet with drives and damping, and a compiled engine that computes the same states.

`verlet` is the integrator, `drives` has external forces and moving walls, `recorder` and `motion` keep records.  `engine` knows
the limit 2/omega_max of the time step, and computes blocks of steps with the compiled `kernel`, for which `bond_increments`
prepares the law and `memory_layout` the particles; `cages` detects when particles change their neighbours. `lammps` computes the
same motion with LAMMPS.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
