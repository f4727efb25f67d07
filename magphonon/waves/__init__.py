"""Tone bursts: sent through a patch, recorded along a row, analysed in wavenumber and frequency (Secs. IV B and C).

`wave_source` places the source and the row, `tone_burst` sends a burst, `vibrometer` records displacements as a scanning laser
does; `spectrum` transforms them and finds the ridge, `branches` compares it with the bands, `wave_analysis` does all of it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
