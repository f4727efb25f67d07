"""One question asked of a scene at many values of its parameters, on any executor; results as an xarray Dataset."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
