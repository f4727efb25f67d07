"""Stability: buckling, the range of linear motion, and the verdict on a structure before it runs.

`soft_waves` finds the wave of a lattice that costs least energy, and `buckling` the foundation or spacing that stabilises it.
`amplitude_shifts` computes how frequencies change with amplitude, and `verdicts` checks a structure by all of these methods.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
