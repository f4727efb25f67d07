from . import (
    bands as bands,
    cli as cli,
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
    Bands as Bands,
    analytic_bands as analytic_bands,
    chern_numbers as chern_numbers,
    complex_bands as complex_bands,
    edge_flow as edge_flow,
    finite_displacements as finite_displacements,
    group_velocities as group_velocities,
    phonopy_bands as phonopy_bands,
    sound_speeds as sound_speeds,
)
from .dynamics import (
    Constant as Constant,
    DrivenVerlet as DrivenVerlet,
    Harmonic as Harmonic,
    PrescribedMotion as PrescribedMotion,
    Recorder as Recorder,
    ToneBurst as ToneBurst,
)
from .errors import Diverged as Diverged, NotAtRest as NotAtRest, PhysicsError as PhysicsError, Unstable as Unstable
from .interactions import (
    Cable as Cable,
    Cuboid as Cuboid,
    Hertz as Hertz,
    InversePower as InversePower,
    Ring as Ring,
    Sphere as Sphere,
    Spring as Spring,
    Tabulated as Tabulated,
    Yukawa as Yukawa,
    magnet_law as magnet_law,
)
from .lattices import explicit_bonds as explicit_bonds, find_bonds as find_bonds
from .plotting import plot_bands as plot_bands, plot_mode as plot_mode, plot_wave as plot_wave
from .response import frequency_response as frequency_response, modes as modes, propagate as propagate
from .scenes import read_scene as read_scene, ready_scene as ready_scene, write_scene as write_scene
from .stability import critical_foundation as critical_foundation, verdict as verdict
from .stiffness import (
    AllNeighbours as AllNeighbours,
    MagneticRepulsion as MagneticRepulsion,
    PairCalculator as PairCalculator,
    for_ase_tools as for_ase_tools,
    relaxed as relaxed,
    restored as restored,
)
from .sweeps import sweep as sweep

__version__: str
