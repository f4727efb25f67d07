from .bonds import Bonds as Bonds, find_bonds as find_bonds
from .crystals import (
    OSCILLATOR_BONDS as OSCILLATOR_BONDS,
    bcc as bcc,
    chain as chain,
    fcc as fcc,
    honeycomb as honeycomb,
    kagome as kagome,
    oscillator as oscillator,
    square as square,
    triangular as triangular,
)
from .patches import (
    RIM as RIM,
    half_hexagon as half_hexagon,
    hexagon as hexagon,
    parallelogram as parallelogram,
    rectangle as rectangle,
    ribbon as ribbon,
)
