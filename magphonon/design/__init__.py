"""What the parameters of a lattice do to its frequencies, forwards and backwards.

`sensitivities` are first derivatives of frequencies and responses; `uncertainty` follows from them and from tolerances that all
particles share, `scatter` from those of each particle by itself.  `inverse` finds the lattice for a wanted band,
`dispersion_fits` the lattice that has measured branches.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
