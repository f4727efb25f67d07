"""Linear response without time steps: normal modes, frequency response, exact propagation, densities of states.

`normal_modes` computes the vibrations of a structure about its rest, `frf` its steady response to a harmonic force (Fig. 2 of the
paper), `propagation` its exact motion under any force, `spectral_density` its density of states. For large structures the last
three use the series of `chebyshev`.  `stepped` measures the frequency response from time steps instead.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
