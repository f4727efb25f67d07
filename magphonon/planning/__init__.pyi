from .peak import plan_peak as plan_peak
from .plan import Method as Method, Plan as Plan
from .waveform import plan_waveform as plan_waveform
