from . import (
    bands as bands,
    design as design,
    dynamics as dynamics,
    interactions as interactions,
    lattices as lattices,
    plotting as plotting,
    response as response,
    scenes as scenes,
    stability as stability,
    stiffness as stiffness,
    units as units,
    waves as waves,
)
from .bands import (
    analytic_bands as analytic_bands,
    finite_displacements as finite_displacements,
    phonopy_bands as phonopy_bands,
)
from .dynamics import DrivenVerlet as DrivenVerlet, ToneBurst as ToneBurst
from .interactions import InversePower as InversePower, magnet_law as magnet_law
from .plotting import plot_bands as plot_bands
from .response import frequency_response as frequency_response, modes as modes, propagate as propagate
from .scenes import read_scene as read_scene
from .stability import critical_foundation as critical_foundation, verdict as verdict
from .stiffness import MagneticRepulsion as MagneticRepulsion, relaxed as relaxed
from .sweeps import sweep as sweep

__version__: str
