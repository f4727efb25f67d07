from .amplitude_shifts import Shifts as Shifts, frequency_shifts as frequency_shifts
from .buckling import (
    CriticalFoundation as CriticalFoundation,
    SoftMode as SoftMode,
    critical_foundation as critical_foundation,
)
from .prestress import PrestressReserve as PrestressReserve, prestress_reserve as prestress_reserve
from .verdicts import Buckling as Buckling, Finding as Finding, Verdict as Verdict, verdict as verdict
