from .cages import Diverged as Diverged
from .drives import Constant as Constant, Harmonic as Harmonic, PrescribedMotion as PrescribedMotion, ToneBurst as ToneBurst
from .engine import highest_frequency as highest_frequency, refusal as refusal
from .lammps import (
    read_lammps_displacements as read_lammps_displacements,
    run_lammps as run_lammps,
    write_lammps_input as write_lammps_input,
)
from .motion import Motion as Motion
from .recorder import Recorder as Recorder
from .verlet import DrivenVerlet as DrivenVerlet
