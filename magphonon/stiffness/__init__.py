"""The stiffness D0 + D*, from one bond to the whole structure.

`bond` is what two particles do to each other, Eq. 4 of the paper; `matrices` assembles bonds to the Hessian and the Bloch
matrix (Eq. 18); `calculator` is the ASE calculator with its foundation, also of cells that change, and `all_neighbours` the one
without a cutoff, on the lattice sums of `ewald`.  `repulsion` and `restartable` are what both have in common.  `rest` holds the
linear system about positions where the forces balance, `relaxation` finds such positions.  `sites` holds properties of individual
particles, `defects` makes vacancies and disorder, `elastic` computes stress and moduli.  `restart` restores a calculator from a
file of ASE.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
