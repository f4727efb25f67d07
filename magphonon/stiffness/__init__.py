"""The stiffness D0 + D*, from one bond to the whole structure.

`bond` is Eq. 4 of the paper; `matrices` assembles bonds to the Hessian and the Bloch matrix (Eq. 18); `calculator` is the ASE
calculator with its foundation, `all_neighbours` the one without a cutoff, on the lattice sums of `ewald`; `rest` says
where the forces balance, `relaxation` finds that place, `constraints` are the free directions; `cells` are those that change,
and the stress on them, `elastic` the moduli;
`truncation` says what a finite number of neighbours leaves out.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
