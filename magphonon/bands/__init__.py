"""Bloch bands by two methods: the analytic Bloch matrix (Eq. 18) and phonopy's finite displacements.

`bands` and `bloch` are the analytic method, `force_constants` the numerical one, with its files in `phonopy_files`; `velocities`
are group velocities and speeds of sound, `evanescent` the decaying waves inside a gap, `zone` maps over the Brillouin zone.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
