"""Scene files: what stands in one, in SI with the unit in every key, and what is wanted of it.

`scene` reads a file, `lattices`, `laws` and `supports` build what its tables describe, `plans` and `design` hold what is asked,
`tolerances` the uncertainty of its numbers, `fields` the numbers and texts that tables are made of.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
