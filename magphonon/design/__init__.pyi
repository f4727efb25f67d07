from .dispersion_fits import Shells as Shells, fit_dispersion as fit_dispersion
from .objectives import (
    BandEdge as BandEdge,
    Contrast as Contrast,
    Objective as Objective,
    band_gap as band_gap,
)
from .scatter import mode_scatter as mode_scatter
from .sensitivities import (
    StiffnessDerivative as StiffnessDerivative,
    exponent_change as exponent_change,
    force_change as force_change,
    frequency_sensitivities as frequency_sensitivities,
    spacing_change as spacing_change,
)
from .site_designs import (
    Errors as Errors,
    optimise as optimise,
    verify as verify,
    write_build_list as write_build_list,
)
from .site_unknowns import with_site_unknowns as with_site_unknowns
from .transfer_fits import (
    ParametricLattice as ParametricLattice,
    TransferFit as TransferFit,
    fit_transfer as fit_transfer,
)
from .trimming import trim as trim
from .uncertainty import Tolerances as Tolerances, frequency_spread as frequency_spread
