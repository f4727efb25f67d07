from .all_neighbours import (
    AllNeighbours as AllNeighbours,
    missing_stiffness as missing_stiffness,
    reach as reach,
)
from .bond import (
    bond_stiffness as bond_stiffness,
    model_stiffness as model_stiffness,
)
from .calculator import (
    MagneticRepulsion as MagneticRepulsion,
    bond_virial as bond_virial,
    carried as carried,
    measure as measure,
    same_cell as same_cell,
)
from .defects import (
    Scatter as Scatter,
    scattered as scattered,
    substituted as substituted,
    with_interstitial as with_interstitial,
    without as without,
)
from .elastic import (
    Moduli as Moduli,
    cauchy_stress as cauchy_stress,
    elastic_moduli as elastic_moduli,
)
from .ewald import (
    EwaldSums as EwaldSums,
    lattice_sum as lattice_sum,
    points_within as points_within,
)
from .lowest import (
    count_below as count_below,
    eigenpairs_between as eigenpairs_between,
    inverse_below as inverse_below,
    inverse_pays as inverse_pays,
    lowest_eigenpairs as lowest_eigenpairs,
    lowest_mode as lowest_mode,
    none_negative as none_negative,
)
from .matrices import (
    bloch_gradient as bloch_gradient,
    bloch_matrix as bloch_matrix,
    bloch_series as bloch_series,
    condense as condense,
    hessian as hessian,
    mass_weighted as mass_weighted,
    signed_root as signed_root,
)
from .relaxation import (
    Relaxation as Relaxation,
    relaxed as relaxed,
)
from .repulsion import (
    Repulsion as Repulsion,
    masses_of as masses_of,
    repulsion_of as repulsion_of,
)
from .rest import (
    LinearSystem as LinearSystem,
)
from .restart import (
    restored as restored,
)
