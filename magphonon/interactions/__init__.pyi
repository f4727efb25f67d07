from .fits import Fit as Fit, SharedErrors as SharedErrors, fit_forces as fit_forces, scene_entry as scene_entry
from .force_tables import Forces as Forces, read_forces as read_forces
from .magnet_pairs import (
    MagnetLaw as MagnetLaw,
    calibrated as calibrated,
    magnet_law as magnet_law,
    pair_force as pair_force,
)
from .magnets import Cuboid as Cuboid, Ring as Ring, moment as moment
from .pair_laws import (
    Cable as Cable,
    InversePower as InversePower,
    Overlap as Overlap,
    PairInteraction as PairInteraction,
    PairLaw as PairLaw,
    Spring as Spring,
    Tabulated as Tabulated,
    Yukawa as Yukawa,
    repulsion as repulsion,
)
from .upright import UprightMagnets as UprightMagnets
