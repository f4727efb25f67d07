from .amplitude_shifts import (
    Shifts as Shifts,
    StronglyNonlinear as StronglyNonlinear,
    Vibration as Vibration,
    frequency_shifts as frequency_shifts,
    vibration as vibration,
)
from .backbones import NonlinearModes as NonlinearModes, nonlinear_modes as nonlinear_modes
from .buckling import (
    CriticalFoundation as CriticalFoundation,
    CriticalSupport as CriticalSupport,
    SoftMode as SoftMode,
    StabilityBoundary as StabilityBoundary,
    critical_foundation as critical_foundation,
    critical_spacing as critical_spacing,
    critical_support as critical_support,
    stability_boundary as stability_boundary,
    stability_boundary_of_exponents as stability_boundary_of_exponents,
)
from .verdicts import Buckling as Buckling, Finding as Finding, Verdict as Verdict, verdict as verdict
