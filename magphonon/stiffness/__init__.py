"""The stiffness D0 + D*, from one bond to the whole structure.

`bond` is Eq. 4 of the paper; `matrices` assembles bonds to the Hessian and the Bloch matrix (Eq. 18); `calculator` is the ASE
calculator with its foundation, `all_neighbours` the one without a cutoff, on the lattice sums of `ewald`; `rest` says
where the forces balance, `relaxation` finds that place, and `constraints` holds the free directions.  `sites` is what each
particle has of its own, `defects` makes vacancies and disorder.  `cells` follows a cell that changes and computes the stress on
it, `elastic` the elastic moduli.  `truncation` computes the effect of the neighbours that are left out.  `restart` makes a
calculator again from a file of ASE.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
