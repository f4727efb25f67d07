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
    refusal as refusal,
)
from .lammps import (
    lammps_session as lammps_session,
    read_lammps_displacements as read_lammps_displacements,
    write_lammps_input as write_lammps_input,
)
from .lammps_runs import (
    LammpsRecord as LammpsRecord,
    run_lammps as run_lammps,
)
from .recorder import (
    Recorder as Recorder,
)
from .timestep import (
    frequency_bound as frequency_bound,
    highest_frequency as highest_frequency,
    refuse_long_step as refuse_long_step,
)
from .verlet import (
    DrivenVerlet as DrivenVerlet,
)
