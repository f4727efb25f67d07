from .amplitude_shifts import (
    FarFromLinear as FarFromLinear,
    Shifts as Shifts,
    Vibration as Vibration,
    frequency_shifts as frequency_shifts,
    vibration as vibration,
)
from .backbones import NonlinearModes as NonlinearModes, nonlinear_modes as nonlinear_modes
from .buckling import (
    Border as Border,
    FoundationNeeded as FoundationNeeded,
    Softest as Softest,
    SupportNeeded as SupportNeeded,
    border_over_exponents as border_over_exponents,
    border_over_spacings as border_over_spacings,
    foundation_needed as foundation_needed,
    spacing_held as spacing_held,
    support_needed as support_needed,
)
from .pumping import Growth as Growth, pumped_growth as pumped_growth
from .verdicts import Buckling as Buckling, Finding as Finding, Verdict as Verdict, verdict as verdict
