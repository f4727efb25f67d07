"""Plans: which is the simplest method that answers a question within a tolerance?  Experimental.

`plan` makes the choice; `peak` and `waveform` have the methods for the highest peak of a frequency response and for a waveform;
`scene` plans both for a scene file.  Bands need no plan: `shells = "auto"` counts as many neighbours as matter.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
