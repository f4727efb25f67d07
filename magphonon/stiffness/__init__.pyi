from .all_neighbours import AllNeighbours as AllNeighbours
from .bond import bond_stiffness as bond_stiffness
from .calculator import MagneticRepulsion as MagneticRepulsion, PairCalculator as PairCalculator
from .defects import (
    Scatter as Scatter,
    scattered as scattered,
    substituted as substituted,
    with_interstitial as with_interstitial,
    with_vacancies as with_vacancies,
)
from .elastic import Moduli as Moduli, cauchy_stress as cauchy_stress, elastic_moduli as elastic_moduli
from .ewald import lattice_sum as lattice_sum
from .nets import net as net, self_stress as self_stress
from .other_tools import for_ase_tools as for_ase_tools
from .packings import Following as Following, Packing as Packing, packing as packing
from .pair_splitting import split as split
from .relaxation import Relaxation as Relaxation, relaxed as relaxed
from .repulsion import Repulsion as Repulsion
from .rest import LinearSystem as LinearSystem
from .restart import restored as restored
