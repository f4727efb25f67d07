"""Checkpoints: the complete state of a run in one file, which is written completely or not at all.

A checkpoint knows the run that it belongs to by fingerprints of everything that decides a bit of it (`run_parts`), its own
arrays by a checksum, and the frames in the files beside it by theirs.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import ase
import numpy as np

from ..files import whole_file
from ..interactions.bond_laws import laws_of
from ..stiffness.calculator import MagneticRepulsion
from .fingerprints import Unknowable, attributes, fingerprint

if TYPE_CHECKING:
    from collections.abc import Mapping
    from os import PathLike
    from typing import Any

    from .verlet import DrivenVerlet

PARTS = ('bonds', 'parameters', '_potential', '_law', '_strengths', '_anchors', '_load')
"""Attributes of a calculator that are parts of a run by themselves."""
OF_ASE = ('_directory', 'get_spin_polarized')
"""Attributes that every calculator of ASE has and that do not affect the forces; the second one refers to the calculator."""
SAMPLES = 2000
"""Number of distances at which a law is sampled, besides its parameters and code, from contact to broken bonds."""
CHANGING = ('atoms', 'results')
"""Attributes of a calculator that change in a run."""


def run_parts(dyn: DrivenVerlet, every: int) -> dict[str, str]:
    """Fingerprints of what decides the bits of a run, by the name of the part: dict of str.

    Parameters
    ----------
    dyn : DrivenVerlet
    every : int
        Steps between two checkpoints: blocks of steps end there, and where they end decides how sums are rounded.

    Raises
    ------
    ValueError
        If one of them cannot be known again in another process, or a drive is no function of the time.
    """
    atoms, calc = dyn.atoms, dyn.atoms.calc
    looks = sorted(interval for _, interval, *_ in dyn.observers)
    parts = {'structure': (atoms.cell.array, atoms.pbc, atoms.numbers), 'masses': atoms.get_masses(),
             'start': (dyn.nsteps, atoms.positions, atoms.get_momenta()), 'constraints': list(atoms.constraints),
             'time step': (dyn.dt, dyn.allow_unstable), 'damping': dyn.damping, 'engine': dyn.asked_engine,
             'drives': dyn._drive_list, 'forces of the drives': _pushes(dyn), 'calculator': _calculator(calc, atoms),
             'recorders': [(recorder.particles, recorder.interval) for recorder in dyn.recorders],
             'intervals of observers': looks, 'interval of checkpoints (every)': every,
             'versions of ASE, NumPy or magphonon': (ase.__version__, np.__version__, _version())}
    if isinstance(calc, MagneticRepulsion):
        parts |= {'law': (calc.potential, _sampled(calc)), 'bonds': calc.bonds, 'foundation or model': dict(calc.parameters),
                  'strengths': calc.strengths, 'anchors': calc.anchors, 'load': calc.load}
    return {name: _known(name, value) for name, value in parts.items()}


def _known(name, value):
    try:
        return fingerprint(value)
    except Unknowable as error:
        raise ValueError(f'a checkpoint cannot tell whether the {name} of a run are the same again: {error}; '
                         'take a class of magphonon, or a frozen dataclass of numbers and arrays with the methods '
                         '(a drive: __call__(t); a law: phi, dphi and d2phi), or run without a checkpoint') from None


def _version():
    from .. import __version__  # pyright: ignore[reportAttributeAccessIssue]  the stub beside it lists the exports only

    return __version__


def _calculator(calc, atoms):
    """The class and settings of a calculator; of one that is not of this package, its forces at the start, too."""
    if isinstance(calc, MagneticRepulsion):  # law, bonds, anchors and the like are parts by themselves
        own = {name: value for name, value in attributes(calc).items() if name not in (*CHANGING, *PARTS, *OF_ASE)}
        return type(calc), own
    return type(calc), dict(calc.parameters), calc.get_forces(atoms)


def _pushes(dyn):
    """Forces of the drives at some times.

    Raises
    ------
    ValueError
        If they are others when asked again: then a resumed run would not see what the first one saw.
    """
    times = dyn.dt * np.array([0.0, 0.7, 11.3, 157.9, 3101.1])
    forces = dyn.drives.forces(times)
    if not np.array_equal(forces[::-1], dyn.drives.forces(times[::-1])):
        raise ValueError('a drive gives other forces when it is asked twice for the same time; a run with a checkpoint needs '
                         'drives that depend on nothing but the time')
    return forces


def _sampled(calc):
    """Slope and curvature of the law from contact to where particles have left; NaN where it is not defined."""
    from .cages import BROKEN_BOND, CONTACT

    r0 = calc.bonds.lengths
    r = np.geomspace(CONTACT * r0.min(initial=np.inf), BROKEN_BOND * r0.max(initial=0.0), SAMPLES) if len(r0) else np.empty(0)
    with np.errstate(all='ignore'):
        return [_where_defined(slope, r) for law in laws_of(calc.potential) for slope in (law.dphi, law.d2phi)]


def _where_defined(slope, r):
    try:
        return np.asarray(slope(r))
    except ValueError:  # a table ends somewhere
        if len(r) == 1:
            return np.array([np.nan])
        return np.concatenate([_where_defined(slope, half) for half in np.array_split(r, 2)])


def save_checkpoint(path: str | PathLike[str], parts: Mapping[str, str], state: Mapping[str, Any]) -> None:
    """Write a state, a dict of arrays and numbers, whole or not at all."""
    state = {'run': json.dumps(parts), **state}
    with whole_file(path, 'wb') as file:
        np.savez(file, checksum=_checksum(state), **state)


def _checksum(state):
    return fingerprint({name: np.asarray(value) for name, value in state.items()})


def load_checkpoint(path: str | PathLike[str], parts: Mapping[str, str]) -> dict[str, Any] | None:
    """The state that `save_checkpoint` wrote, or None if there is no such file.

    Raises
    ------
    ValueError
        If the file is damaged, lacks an array, or belongs to another run; the message names what differs.
    """
    try:
        with open(path, 'rb') as file, np.load(file, allow_pickle=False) as data:
            state = dict(data)
            written = str(state.pop('checksum', 'missing'))
            if written != _checksum(state):
                raise ValueError('its checksum is not that of its arrays')
            own = json.loads(str(state.pop('run')))
    except FileNotFoundError:
        return None
    except Exception as error:
        raise ValueError(f'{path} is no complete checkpoint ({error}); delete it and start again') from error
    differing = [name for name in {**parts, **own} if parts.get(name) != own.get(name)]
    if differing:
        raise ValueError(f'the checkpoint {path} belongs to another run, these differ: {", ".join(differing)}; move it away '
                         'together with the frames beside it, or restore what was changed (a run that has moved already goes '
                         'on with atoms and dynamics prepared afresh)')
    return state
