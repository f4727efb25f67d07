"""`magphonon check SCENE`: checks a scene without running it: equilibrium, stability, time step, supports, linear range.

The exit status is 1 if there is a problem, such as a lattice that buckles, and 0 otherwise.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import units
from ..findings import Finding, Findings
from .arguments import add_scene, add_verbose

if TYPE_CHECKING:
    from ase import Atoms

    from ..scenes.scene import Scene
    from ..stability.verdicts import Verdict

HELP = 'is the structure stable, what must its supports hold, up to which amplitude is it linear?'
JUDGED = 20_000
"""Largest number of particles of a patch that gets a verdict of its own.  This takes about ten seconds at this size, and the time
grows with the third power of the side: sparse factorisations in the plane fill up as N log N and take N^(3/2) operations."""
TOOLS = {'bands': 'bands.bands.analytic_bands', 'modes': 'response.normal_modes.modes', 'frf': 'response.frf.receptance',
         'burst': 'response.propagation.propagate', 'explore': 'stability.buckling.critical_foundation'}
"""The tool that each command calls first: a command supports what this tool declares."""


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    add_verbose(parser)


def run(options: Namespace) -> int:
    """Print the findings and return the exit status: 0 if no problem was found, 1 otherwise."""
    from ..scenes.scene import read_scene
    from .neighbours import omission

    case = Case(read_scene(options.scene))
    try:
        case.relaxation  # noqa: B018  all that follows is about the structure at rest
    except ValueError as error:
        print(f'Defects: {error}.')
        return 1
    found = REPORT.asked(case, options.verbose)
    print(*(('\n' if options.verbose else '') + one.words for name, one in found.items()
            if one.words and (options.verbose or one.fault or name == REPORT.first)),
          *([] if options.verbose else omission(case.scene, False)), sep='\n')
    return int(any(one.fault for one in found.values()))


@dataclass(frozen=True, eq=False)
class Case:
    """A scene, and the intermediate results that several findings share."""

    scene: Scene

    @cached_property
    def relaxation(self) -> Any:
        """The relaxed structure with its defects; None if the scene has none."""
        return self.scene.relaxation()

    @cached_property
    def atoms(self) -> Atoms:
        """The lattice, or the finite structure at its rest."""
        return self.relaxation.atoms if self.relaxation is not None and self.scene.finite else self.scene.perfect_cell()

    @cached_property
    def patch(self) -> Atoms | None:
        """The patch at its rest; None if the scene has none."""
        if self.scene.finite or self.scene.single or self.scene.patch is None:
            return None
        return self.scene.patch_atoms() if self.relaxation is None else self.relaxation.atoms

    @cached_property
    def damping(self) -> Any:
        losses = self.scene.bands is not None and self.scene.bands.damping_per_s is not None
        return self.scene.bands.damping_of(self.atoms) if losses else 0.0

    @cached_property
    def judged(self) -> Verdict:
        """The verdict on the lattice or the finite structure."""
        from ..stability.verdicts import verdict

        supercell = self.scene.supercell() if self.scene.bands is not None else None
        return verdict(self.atoms, supercell=supercell, damping=self.damping)

    @cached_property
    def of_patch(self) -> Verdict | None:
        """The verdict on the patch; None if there is no patch, or if it is too large."""
        from ..stability.verdicts import verdict

        return None if self.patch is None or len(self.patch) > JUDGED else verdict(self.patch, damping=self.damping)


REPORT = Findings()


@REPORT.answer
def verdict_in_short(case: Case) -> str:
    """Whether the structure is stable, which supports it needs, and up to which amplitude it is linear; without the faults."""
    judged = [one for one in (case.judged, case.of_patch) if one is not None]
    if any(one.faults for one in judged):
        return f'{case.scene.title}: {sum(len(one.faults) for one in judged)} problem(s)'
    said = [case.judged.finding('buckling').words]
    if (supports := case.judged.supports) is not None and supports.central:
        needed = units.in_words('N/m', max(filter(None, supports)) / (units.N / units.m))
        said.append(f'The supports need a stiffness of {needed} out of the plane.')
    if (amplitude := case.judged.amplitude) is not None and np.isfinite(amplitude):
        said.append(f'Linear to 1 % up to an amplitude of {units.in_words("m", amplitude / units.m, digits=2)}.')
    return ' '.join(said)


@REPORT.check
def guided(case: Case) -> str | None:
    """The force that an oscillator is assumed to carry."""
    from ..scenes.lattices import Oscillator

    if not case.scene.single:
        return None
    calc: Any = case.atoms.calc
    return (f'A constant force of {calc.load[Oscillator.free, 1] / units.N:.6g} N along the guide is assumed to balance the '
            'repulsion of the three magnets.')


@REPORT.check
def defects(case: Case) -> str | None:
    """How far a structure with defects moved to its rest."""
    return case.relaxation and f'Defects: {case.relaxation} This equilibrium is stable.'


@REPORT.check
def structure(case: Case) -> Finding:
    """The verdict on the lattice, the finite structure or the oscillator."""
    name = 'Oscillator' if case.scene.single else 'Structure' if case.scene.finite else 'Lattice'
    return Finding(case.judged, f'{name}: {case.judged}', fault=not case.judged.fine)


@REPORT.check
def patch(case: Case) -> Finding | str | None:
    """The verdict on the patch; for a large patch, the verdict on its lattice is used."""
    if case.patch is None:
        return None
    if case.of_patch is None:
        return _large(case.patch, case.relaxation is None)
    return Finding(case.of_patch, f'Patch: {case.of_patch}', fault=not case.of_patch.fine)


@REPORT.check
def cut_off(case: Case) -> str | None:
    """The cut-off frequency, the lowest at Gamma, if a foundation or held particles cause one."""
    from ..bands import bands

    if not case.atoms.pbc.any() or case.judged.residual or (lowest := bands.cut_off(case.atoms)) is None:
        return None
    holds = 'The held particles and the foundation give' if case.atoms.constraints else 'The foundation gives'
    return f'{holds} a cut-off frequency of {units.hertz(lowest):.6g} Hz at Gamma: below it no long waves propagate.'


@REPORT.check
def others(case: Case) -> list[str]:
    """How the omitted neighbours would change the frequencies."""
    from .neighbours import neighbours

    return neighbours(case.scene)


@REPORT.remark
def commands(case: Case) -> str | None:
    """The commands that refuse the structure, by what their tools declare (`magphonon.traits`)."""
    from ..traits import TOOLS as DECLARED, refuse

    refused = {}
    for command, place in TOOLS.items():
        module, _, name = place.rpartition('.')
        import_module(f'magphonon.{module}')
        try:
            refuse(case.atoms, DECLARED[name])
        except ValueError as error:
            why = str(error).partition(' does not support ')[2].partition(' (')[0].partition(';')[0]
            refused.setdefault(why, []).append(f'"magphonon {command}"')
    return '\n'.join(f'Commands that do not support {why}: {", ".join(named)}.' for why, named in refused.items()) or None


def _large(patch, perfect):
    """The finding for a patch that is too large for a verdict of its own.

    The free particles of a perfect patch have all their neighbours, so that its Hessian is a block of that of the lattice, in the
    plane, out of it and at every spacing.  Its eigenvalues lie between the lowest and the highest one of the lattice (Cauchy).
    """
    from ..dynamics.engine import highest_frequency

    many = f'\nPatch: it has {len(patch)} particles, more than {JUDGED}, and is not checked separately. '
    if perfect:
        return (many + 'Every particle inside its rim has all of its neighbours, so the results for the lattice are valid for '
                'the patch: foundation, spacing, supports and time steps. The fixed rim may make the patch stable even where the '
                'lattice buckles. The linear amplitude is given for waves far from the rim.')
    return (many + f'Time steps up to {2 / highest_frequency(patch) / units.s:.4g} s are stable (2/omega_max). The spacing, the '
            'supports and the linear amplitude of the patch are not checked: give a smaller patch with as many defects.')
