"""The cheapest method that answers a question within a tolerance: each has a predicted cost and error.  Experimental.

`plan` is the choice itself, `peak` and `waveform` know the methods for the highest peak of a frequency response and for a
waveform; `scene` plans both for a scene file.  Bands need no plan: `shells = "auto"` counts as many neighbours as matter.
"""

import lazy_loader

from ..renamed import with_old

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_old(__name__, __all__, __getattr__)
