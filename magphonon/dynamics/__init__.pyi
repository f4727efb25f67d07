from .cages import (
    Cages as Cages,
    Diverged as Diverged,
)
from .drives import (
    Constant as Constant,
    Drives as Drives,
    Harmonic as Harmonic,
    ToneBurst as ToneBurst,
    constant_push as constant_push,
    refuse_held_drives as refuse_held_drives,
)
from .engine import (
    Blocks as Blocks,
    frequency_bound as frequency_bound,
    highest_frequency as highest_frequency,
    refusal as refusal,
    refuse_long_step as refuse_long_step,
)
from .lammps import (
    lammps_session as lammps_session,
    read_lammps_displacements as read_lammps_displacements,
    run_lammps as run_lammps,
    write_lammps_input as write_lammps_input,
)
from .motion import (
    Motion as Motion,
)
from .recorder import (
    Recorder as Recorder,
)
from .verlet import (
    DrivenVerlet as DrivenVerlet,
)
