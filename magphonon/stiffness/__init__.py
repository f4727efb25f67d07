"""The stiffness D0 + D*, from one bond to the whole structure.

`bond` is Eq. 4 of the paper; `matrices` assembles bonds to the Hessian and the Bloch matrix (Eq. 18); `calculator` is the ASE
calculator with its foundation, `all_neighbours` the one without a cutoff, on the lattice sums of `ewald`; `rest` checks
where the forces balance, `relaxation` finds such positions, and `constraints` determines the free directions.  `sites` holds
properties of individual particles, `defects` makes vacancies and disorder.  `cells` handles cells that change and computes their
stress, `elastic` the elastic moduli.  `truncation` bounds the effect of neighbours beyond a cutoff.  `restart` restores a
calculator from a file of ASE.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
