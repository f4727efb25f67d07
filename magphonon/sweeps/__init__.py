"""Sweeps: questions about a scene, or a function, evaluated at many values of its parameters; the answers are an xarray Dataset.

`dataset` distributes the points to processes and keeps the journal; `questions` holds what can be asked about a scene.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
