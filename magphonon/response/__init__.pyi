from .frf import (
    Dof as Dof,
    FrequencyResponse as FrequencyResponse,
    Transmissibility as Transmissibility,
    frequency_response as frequency_response,
    harmonic_response as harmonic_response,
    receptance as receptance,
    series_response as series_response,
)
from .normal_modes import (
    Localisation as Localisation,
    Modes as Modes,
    count_modes_below as count_modes_below,
    local_modes as local_modes,
    localisation as localisation,
    modes as modes,
    natural_frequencies as natural_frequencies,
)
from .propagation import Transient as Transient, propagate as propagate
from .spectral_density import density_of_states as density_of_states
from .stepped import (
    fourier as fourier,
    impulse_response as impulse_response,
    lock_in as lock_in,
    replicas as replicas,
    steady_amplitudes as steady_amplitudes,
    stepped_response as stepped_response,
)
from .transfer_functions import TransferFunction as TransferFunction, estimated as estimated, read_transfer as read_transfer
