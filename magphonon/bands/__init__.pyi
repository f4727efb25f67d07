from .bands import (
    Bands as Bands,
    analytic_bands as analytic_bands,
    band_path as band_path,
    edge_weights as edge_weights,
    group_velocities as group_velocities,
    sound_speeds as sound_speeds,
)
from .bloch import bloch_modes as bloch_modes
from .density import band_gaps as band_gaps, lattice_density as lattice_density
from .evanescent import complex_bands as complex_bands
from .force_constants import (
    extracted_dstar as extracted_dstar,
    finite_displacements as finite_displacements,
    foundation_recovered as foundation_recovered,
    phonopy_bands as phonopy_bands,
)
from .neighbours import converged_shells as converged_shells, neighbour_shifts as neighbour_shifts
from .phonopy_files import (
    write_band_yaml as write_band_yaml,
    write_phonopy_params as write_phonopy_params,
)
from .topology import chern_numbers as chern_numbers, edge_flow as edge_flow
