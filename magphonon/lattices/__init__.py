"""Positions of the particles, and the pairs that repel each other.

`crystals` are the unit cells (chain, triangular, honeycomb, ...) and the paper's oscillator (Sec. III), all as `ase.Atoms`;
`patches` cuts finite patches with a held rim, and strips, from a lattice; `bonds` finds the interacting pairs, within a distance
or within shells of neighbours.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
