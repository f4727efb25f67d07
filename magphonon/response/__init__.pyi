from .frf import (
    Dof as Dof,
    frequency_response as frequency_response,
    harmonic_response as harmonic_response,
    receptance as receptance,
    series_response as series_response,
)
from .normal_modes import (
    Modes as Modes,
    local_modes as local_modes,
    localisation as localisation,
    modes as modes,
    natural_frequencies as natural_frequencies,
)
from .propagation import propagate as propagate
from .spectral_density import density_of_states as density_of_states
from .stepped import (
    impulse_response as impulse_response,
    replicas as replicas,
)
from .transfer_functions import estimated as estimated, read_transfer as read_transfer
