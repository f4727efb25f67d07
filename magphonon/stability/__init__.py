"""Stability: buckling, the range of linear motion, and the verdict on a structure before it runs.

`buckling` finds the softest mode and the foundation or the spacing that holds it, `amplitude_shifts` how frequencies move with
amplitude, `escapes` which impact takes a particle out of its cage; `verdicts` judges a structure by all of them, `verdict_text`
says it in words.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
