"""How the parameters of a lattice determine its frequencies, and which parameters give wanted or measured frequencies.

`sensitivities` has first derivatives of frequencies and responses. `uncertainty` applies them to tolerances that all particles
share, and `scatter` to the individual deviations of each particle. `site_designs` makes an objective as large as possible,
`dispersion_fits` finds the lattice for measured branches.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
