from .bands import (
    Edge as Edge,
    plan_bands as plan_bands,
)
from .peak import (
    plan_peak as plan_peak,
)
from .plan import (
    Method as Method,
    Plan as Plan,
    Settings as Settings,
)
from .scene import (
    Wanted as Wanted,
    scene_plans as scene_plans,
)
from .waveform import (
    plan_waveform as plan_waveform,
)
