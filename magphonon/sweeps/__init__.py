"""Sweeps evaluate a question about a scene, or a function, at many values of its parameters; the answers are an xarray Dataset.

`dataset` spreads the points over processes and keeps the journal; `questions` holds what can be asked of a scene.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
