"""What the parameters of a lattice do to its frequencies, forwards and backwards.

`sensitivities` are first derivatives of frequencies and responses; `uncertainty` follows from them and from tolerances that all
particles share, `scatter` from those of each particle by itself.  `inverse` finds the lattice for a wanted band,
`dispersion_fits` the lattice that has measured branches.
"""

import lazy_loader

from ..renamed import with_old

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_old(__name__, __all__, __getattr__)
