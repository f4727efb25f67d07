"""Pair laws phi(r), from closed forms, from the shapes of magnets, or from measured forces.

`pair_laws` holds inverse powers (the paper's f = b r^-a), Yukawa, Hertzian contacts and tables; `magnets` the shapes and
grades of magnets and `magnet_pairs` the law of two of them; `force_tables` reads measured forces, and `fits`
finds the force and its exponent at a spacing with their covariance.
`PairLaw` defines a law: any object with the methods phi, dphi and d2phi.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
