from .bands import (
    Edge as Edge,
    bloch_cost as bloch_cost,
    neighbour_shells as neighbour_shells,
    plan_bands as plan_bands,
)
from .peak import (
    Peak as Peak,
    highest_peak as highest_peak,
    plan_peak as plan_peak,
    turning as turning,
)
from .plan import (
    Method as Method,
    Plan as Plan,
    Settings as Settings,
    force_cost as force_cost,
    percent as percent,
    times as times,
)
from .scene import (
    Wanted as Wanted,
    neglected as neglected,
    scene_plans as scene_plans,
)
from .waveform import (
    StandIn as StandIn,
    as_model as as_model,
    difference as difference,
    plan_beam as plan_beam,
    plan_waveform as plan_waveform,
    steepness as steepness,
    strip as strip,
)
