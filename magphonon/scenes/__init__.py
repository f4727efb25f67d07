"""Scene files: a lattice and the computations wanted for it, in SI with the unit in every key.

`sources` finds the text of a scene, in a file, a ready scene or a stream; `scene` reads it and `consistency` compares its
tables; `lattices`, `structures` and `laws` build the objects that its tables describe; `plans` holds the computations,
`tolerances` the uncertainties of the parameters; `band_fits` fits a scene to measured branches; `fields` checks the numbers and
texts of the tables.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
