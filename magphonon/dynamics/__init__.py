"""Time integration: ASE's velocity Verlet with drives and damping, and fast engines that compute the same states.

`verlet` is the integrator, `drives` and `recorder` what acts and what is kept; `engine` (with the limit 2/omega_max of the time
step) and the two `kernels_*` move blocks of steps, `lammps` writes the same run for LAMMPS.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
