"""Bloch bands by two methods: the analytic Bloch matrix (Eq. 18) and phonopy's finite displacements.

`bloch` diagonalises the Bloch matrix at any wavevectors, `bands` along a path, with group velocities, speeds of sound and edge
waves; `force_constants` is the second method, whose files are in `phonopy_files`.  `evanescent` finds the decaying waves inside a
gap, `density` the density of states, `topology` Chern numbers.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
