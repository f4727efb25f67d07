"""Linear response without time steps: normal modes, frequency response, exact propagation.

`normal_modes` linearises a structure about its rest state; `frf` is its steady response to a harmonic force (Fig. 2 of the
paper), `propagation` the exact transient by `chebyshev` series; `stepped` measures the same responses from time steps.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
