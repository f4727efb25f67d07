"""Static forces in repulsive lattices: stiffness D0 + D*, bands, waves; on ASE and phonopy (arXiv:1911.10410)."""

import lazy_loader

__version__ = '0.1.0'

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
