"""`magphonon check SCENE`: checks a scene without running it: equilibrium, stability, time step, supports, linear range.

The exit status is 1 if there is a problem, such as a lattice that buckles, and 0 otherwise.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

import numpy as np

from .. import units
from .arguments import add_scene, add_verbose

HELP = 'is the structure stable, how far from collapse, what must its supports hold, up to which amplitude is it linear?'
JUDGED = 20_000
"""Largest number of particles of a patch that gets a verdict of its own.  This takes about ten seconds at this size, and the time
grows with the third power of the side: sparse factorisations in the plane fill up as N log N and take N^(3/2) operations."""


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    add_verbose(parser)


def run(options: Namespace) -> int:
    """Print the report and return the exit status: 0 if no problem was found, 1 otherwise."""
    from ..scenes.scene import read_scene
    from .neighbours import omission

    scene = read_scene(options.scene)
    try:
        relaxation = scene.relaxation()  # all that follows is about the structure at rest
    except ValueError as error:
        print(f'Defects: {error}.')
        return 1
    atoms, patch = _structures(scene, relaxation)
    verdicts = _verdicts(scene, atoms, patch)
    said = [_in_short(scene, verdicts)]
    if options.verbose:
        said += _guide(scene, atoms)
        said += [f'Defects: {relaxation} This equilibrium is stable.'] if relaxation is not None else []
        said += [f'{name}: {judged}' for name, judged in verdicts.items()]
        said += _large(patch, relaxation is None) if patch is not None and 'Patch' not in verdicts else []
        said += _cut_off(atoms, next(iter(verdicts.values())))
        said += omission(scene, verbose=True)
    else:
        said += [f'{name}: {judged}' for name, judged in verdicts.items() if not judged.fine]
        said += omission(scene, verbose=False)
    print(*said, sep='\n\n' if options.verbose else '\n')
    return int(not all(judged.fine for judged in verdicts.values()))


def _structures(scene, relaxation):
    """The lattice or the finite structure at its rest, and the patch at its rest, or None if the scene has none."""
    if scene.finite or scene.single or scene.patch is None:
        return relaxation.atoms if relaxation is not None and scene.finite else scene.perfect_cell(), None
    return scene.perfect_cell(), scene.patch_atoms() if relaxation is None else relaxation.atoms


def _verdicts(scene, atoms, patch):
    """The verdicts on the lattice, the finite structure or the oscillator, and on the patch unless it is too large, by name."""
    from ..stability.verdicts import verdict

    damping = scene.bands.damping_of(atoms) if scene.bands is not None and scene.bands.damping_per_s is not None else 0.0
    name = 'Oscillator' if scene.single else 'Structure' if scene.finite else 'Lattice'
    verdicts = {name: verdict(atoms, damping=damping)}
    return verdicts | ({'Patch': verdict(patch, damping=damping)} if patch is not None and len(patch) <= JUDGED else {})


def _in_short(scene, verdicts):
    """Whether the structure is stable, which supports it needs, and up to which amplitude it is linear; without the faults."""
    if faults := [fault for judged in verdicts.values() for fault in judged.faults]:
        return f'{scene.title}: {len(faults)} problem(s)'
    judged = next(iter(verdicts.values()))
    said = [judged.finding('buckling').words]
    if (rigidity := judged['rigidity']) and rigidity.reserve:
        said.append(f'{rigidity.reserve}{"; D0 alone never says so" * (rigidity.factor > 1)}.')
    said += _across(judged, scene.foundation and scene.foundation.pillar)
    if (amplitude := judged['amplitude']) is not None and np.isfinite(amplitude):
        said.append(f'Linear to 1 % up to an amplitude of {units.in_words("m", amplitude / units.m, digits=2)}.')
    return ' '.join(said)


def _across(judged, pillar):
    """Which stiffness its supports need along z, and which a pillar has."""
    if (supports := judged['supports']) is None or not supports.central:
        return list(filter(None, [judged.finding('supports').words]))
    needed = units.in_words('N/m', max(filter(None, supports)) / (units.N / units.m))
    own = f' (a pillar has {units.in_words("N/m", pillar.along_N_per_m)})' if pillar else ''
    return [f'This assumes that it stays in its plane: each support must be stiffer than {needed} along z{own}.']


def _guide(scene, atoms):
    """The force that an oscillator is assumed to carry."""
    from ..scenes.lattices import Oscillator

    if not scene.single:
        return []
    force = atoms.calc.load[Oscillator.free, 1] / units.N
    return [f'A constant force of {force:.6g} N along the guide is assumed to balance the repulsion of the three magnets.']


def _cut_off(atoms, judged):
    """The cut-off frequency, the lowest at Gamma, if a foundation or held particles cause one."""
    from ..bands.bands import cut_off

    if not atoms.pbc.any() or judged['residual'] or (lowest := cut_off(atoms)) is None:
        return []
    holds = 'The held particles and the foundation give' if atoms.constraints else 'The foundation gives'
    return [f'{holds} a cut-off frequency of {units.hertz(lowest):.6g} Hz at Gamma: below it no long waves propagate.']


def _large(patch, perfect):
    """What is said of a patch that is too large for a verdict of its own.

    The free particles of a perfect patch have all their neighbours, so that its Hessian is a block of that of the lattice, in the
    plane, out of it and at every spacing.  Its eigenvalues lie between the lowest and the highest one of the lattice (Cauchy).
    """
    from ..dynamics.engine import highest_frequency

    many = f'Patch: it has {len(patch)} particles, more than {JUDGED}, and is not checked separately. '
    if perfect:
        return [many + 'Every particle inside its rim has all of its neighbours, so the results for the lattice are valid for '
                'the patch: foundation, spacing, supports and time steps. The fixed rim may make the patch stable even where the '
                'lattice buckles. The linear amplitude is given for waves far from the rim.']
    return [many + f'Time steps up to {2 / highest_frequency(patch) / units.s:.4g} s are stable (2/omega_max). The spacing, the '
            'supports and the linear amplitude of the patch are not checked: give a smaller patch with as many defects.']
