"""Tone bursts: sent through a patch, recorded along a row, analysed in wavenumber and frequency (Secs. IV B and C).

`wave_source` places the source and the row and sends a burst; `sampled` gives the record a scanning laser's rate and noise.
`scan_tables` reads measured scans, `scans` makes one record of them, `rows` finds which row of the lattice was measured.
`spectrum` transforms a record and finds the ridge, `wave_analysis` does so for each polarisation and compares the ridges with the
bands; `ridge_tables` writes and reads ridges. `fields` does all of this for points that cover the plane.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
