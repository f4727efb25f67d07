"""How the parameters of a lattice determine its frequencies, and which parameters give wanted or measured frequencies.

`sensitivities` has first derivatives of frequencies and responses. `uncertainty` follows from them for tolerances that all
particles share, `scatter` for each particle's own deviations. `inverse` finds the lattice for a wanted band, `dispersion_fits`
the lattice for measured branches.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
