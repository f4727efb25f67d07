"""The cheapest method that answers a question within a tolerance: each has a predicted cost and error.  Experimental.

`plan` is the choice itself, `bands`, `peak` and `waveform` know the methods for bands, for the highest peak of a frequency
response and for a waveform; `scene` plans all that a scene file asks for.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
