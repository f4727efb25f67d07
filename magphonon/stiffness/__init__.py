"""The stiffness D0 + D*, from one bond to the whole structure.

`matrices` has the interaction of two particles, Eq. 3 of the paper, and assembles the Hessian and the Bloch matrix (Eq. 18) of
many; `lowest` finds their lowest eigenvalues. `calculator` is the ASE calculator with its foundation, also for cells that change;
`all_neighbours` is the calculator without a cutoff, based on the lattice sums of `ewald`; `repulsion` and `supercells`
hold what both calculators have in common.  `relaxation` finds positions where the forces balance, `rest` holds the
linear system about them.  `sites` holds properties of individual particles, `defects` makes vacancies and disorder, `elastic`
computes stress and moduli.  `restart` restores a calculator from a file of ASE.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
