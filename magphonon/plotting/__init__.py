"""Results drawn on matplotlib axes; each function takes a result, and an axis if there is one.

A figure that a function makes itself has the style of the house, as pictures of the commands have; in axes that you pass, such as
`ax=plt.figure().gca()`, your style and matplotlib's own stay.

A file draws what is named like it: `bands`, `zone`, `modes`, `response`, `density`, `waves`, `records`, `fits`, `sweeps`,
`structures`.  `animation` makes films, `explorer` the page with sliders; `axes` is what all pictures share.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
