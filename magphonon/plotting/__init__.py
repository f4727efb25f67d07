"""Results drawn on matplotlib axes; each function takes a result, and an axis if there is one."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
