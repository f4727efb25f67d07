from .amplitude_shifts import frequency_shifts as frequency_shifts
from .buckling import critical_foundation as critical_foundation, prestress_reserve as prestress_reserve
from .verdicts import verdict as verdict
