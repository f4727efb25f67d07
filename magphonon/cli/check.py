"""`magphonon check SCENE`: checks a scene without running it: equilibrium, stability, time step, supports, linear range.

The exit status is 1 if there is a problem, such as a lattice that buckles, and 0 otherwise.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from .. import units
from .arguments import add_scene

HELP = 'check a scene before it runs: equilibrium, stability, time step, supports, linear range, supercell, cost'
JUDGED = 20_000
"""Largest number of particles of a patch that is judged separately.  This takes about ten seconds at this size, and the time
grows with the third power of the side: sparse factorisations in the plane fill up as N log N and take N^(3/2) operations."""


SEEN = 1e-3
"""Relative change of a frequency by leaning pillars that is mentioned: real lattices are hardly known better."""


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)


def run(options: Namespace) -> int:
    """Print the verdicts and return the exit status: 0 if no problem was found, 1 otherwise."""
    from psutil import virtual_memory

    from ..bands.bands import cut_off
    from ..scenes.lattices import Oscillator
    from ..scenes.scene import read_scene
    from ..stability.verdicts import verdict
    from .costs import USABLE_FRACTION, costs, too_much
    from .neighbours import neighbours

    scene = read_scene(options.scene)
    print(scene.title)
    expected, free = costs(scene), virtual_memory().available
    faults = [too_much(scene, cost, free) for cost in expected if cost.bytes > USABLE_FRACTION * free]
    atoms = scene.perfect_cell()
    if scene.single:
        print(f'A constant force of {atoms.calc.load[Oscillator.free, 1] / units.N:.6g} N along the guide is assumed to '
              'balance the repulsion of the three magnets.')
    supercell = scene.supercell() if scene.bands is not None else None
    name = 'Oscillator' if scene.single else 'Structure' if scene.finite else 'Lattice'
    try:
        relaxation = scene.relaxation()
    except ValueError as error:
        print(f'\nDefects and disorder: {error}.')
        return 1
    patch = scene.patch_atoms() if scene.patch is not None and not scene.single else None
    if relaxation is not None:
        patch = None if scene.finite else relaxation.atoms
        atoms = relaxation.atoms if scene.finite else atoms
        print(f'\nDefects and disorder: {relaxation} There it is stable.')
    modulated = scene.foundation is not None and scene.foundation.modulation is not None
    losses = scene.bands is not None and scene.bands.damping_per_s is not None
    damping = scene.bands.damping_of(atoms) if losses else 0.0
    verdicts = {name: verdict(atoms, supercell=None if modulated else supercell, damping=damping)}
    if patch is not None and len(patch) <= JUDGED:
        verdicts['Patch'] = verdict(patch, damping=damping)
    for name, judged in verdicts.items():
        print(f'\n{name}: {judged}')
    at_rest = atoms.pbc.any() and not verdicts[name].residual
    if at_rest and not modulated and (cutoff := cut_off(atoms)) is not None:
        holds = 'The held particles and the foundation give' if atoms.constraints else 'The foundation gives'
        print(f'\n{holds} a cut-off frequency of {units.hertz(cutoff):.6g} Hz, the lowest frequency at Gamma.')
    if patch is not None and 'Patch' not in verdicts:
        print(_large(patch, relaxation is None))
    for line in () if modulated else (*neighbours(scene), *_leaning(scene)):
        print(f'\n{line}')
    if expected:
        print('\nEstimated cost of each table:', *expected, sep='\n  ')
    for fault in faults:
        print(f'TOO COSTLY: {fault}.')
    return 0 if all(judged.fine for judged in verdicts.values()) and not faults else 1


def _leaning(scene):
    """What leaning pillars, which the scene leaves out, would do to the lowest branch, if anything."""
    from ..bands.bloch import bloch_modes

    leant = scene.with_lean(True)
    if scene.single or leant is scene or scene.foundation.leans:
        return []
    points = {'Gamma' if name == 'G' else name: q for name, q in scene.special_points.items()}
    try:
        here, there = (units.hertz(bloch_modes(one.perfect_cell(), [*points.values()])[0][:, 0]) for one in (scene, leant))
    except ValueError:  # no lattice of which leaning is known
        return []
    shifts = [f'at {name} from {a:.6g} to {b:.6g} Hz' for name, a, b in zip(points, here, there, strict=True)
              if abs(b - a) > SEEN * abs(a)]
    return shifts and [f'Pillars lean, and the magnets with them: this would shift the lowest branch {", ".join(shifts)}; '
                       'lean = true in [foundation.pillar] takes it in.']


def _large(patch, perfect):
    """What the terminal shows for a patch that is too large to be judged separately.

    The free particles of a perfect patch have all their neighbours, so that its Hessian is a block of that of the lattice, in
    the plane, out of it and at every spacing.  Its eigenvalues lie between the lowest and the highest one of the lattice
    (Cauchy).
    """
    from ..dynamics.engine import highest_frequency

    many = f'\nPatch: it has {len(patch)} particles, more than {JUDGED}, and is not judged separately. '
    if perfect:
        return (many + 'Every particle inside its rim has all of its neighbours, so the results for the lattice are valid for '
                'the patch: foundation, spacing, supports and time steps. The fixed rim may make it stable even where the '
                'lattice buckles. The linear amplitude is that of waves far from the rim.')
    return (many + f'Time steps up to {2 / highest_frequency(patch) / units.s:.4g} s are stable (2/omega_max). Its spacing, its '
            'supports and its linear amplitude are not judged: they need a smaller patch with as many defects.')
