"""Pair laws phi(r), from closed forms, from the shapes of magnets, or from measured forces.

`pair_laws` holds inverse powers (the paper's f = b r^-a), Yukawa, contacts of spheres and tables; `magnets` the shapes and grades
of magnets, `magnet_pairs` the law of two magnets, `upright` their interaction out of the plane.  `bond_laws` says which bond has
which law, and `law_cards` describes the laws for scenes and fits. `force_tables` reads measured forces, `fits` turns them into a
law with its uncertainty.  Any object with the methods phi, dphi and d2phi is a law (`PairLaw`), any with forces, stiffness and
central an interaction that depends on more than the distance (`PairInteraction`).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
