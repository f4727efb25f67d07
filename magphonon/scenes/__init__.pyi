from .band_fits import fit_bands as fit_bands
from .frf_fits import fit_frf as fit_frf, suspect_units as suspect_units, with_dofs as with_dofs
from .scene import Scene as Scene, read_scene as read_scene, reference as reference, write_scene as write_scene
from .sources import ready_scene as ready_scene, ready_scenes as ready_scenes
