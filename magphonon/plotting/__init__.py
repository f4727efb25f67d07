"""Results drawn on matplotlib axes; each function takes a result, and optionally the axes to draw on.

A figure that a function makes itself has the style of this package, like the pictures of the commands. Axes that you pass, such
as `ax=plt.figure().gca()`, keep your own style.

Each module is named after what it draws: `bands`, `zone`, `modes`, `response`, `waves`, `fits`,
`structures`. `animation` makes films, `explorer` the page with sliders; `axes` has what all pictures share.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
