from .all_neighbours import AllNeighbours as AllNeighbours
from .calculator import MagneticRepulsion as MagneticRepulsion, PairCalculator as PairCalculator
from .defects import (
    Scatter as Scatter,
    scattered as scattered,
    substituted as substituted,
    with_vacancies as with_vacancies,
)
from .elastic import elastic_moduli as elastic_moduli
from .matrices import bond_stiffness as bond_stiffness
from .nets import net as net, self_stress as self_stress
from .other_tools import for_ase_tools as for_ase_tools
from .packings import Following as Following, packing as packing
from .pair_splitting import split as split
from .relaxation import relaxed as relaxed
from .rest import LinearSystem as LinearSystem
from .restart import restored as restored
