"""`magphonon design SCENE` with [[design.targets]]: every site of a patch designed, verified and drawn, and a build list."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import units as u
from .arguments import drawing

if TYPE_CHECKING:
    from ..scenes.scene import Scene

PARAMETERS = 'design.npy'
GOAL_dB = 30.0  # contrast above which a copy counts as good
JUDGES, SEED = 60, 1  # number of specimens for the test of a design, and their seed, which its own draws do not use
FRAMES = 24


def run(options: Namespace, scene: Scene) -> None:
    from ..design import of_parts, optimise, verify, write_build_list
    from .results import results

    plan = scene.wanted('design')
    patch, source, objective, robust = plan.sites(scene)
    over, best = plan.over.bounds(), {}
    if options.resume:
        best['x'] = _left(Path(options.output))

    def designed(steps, x, **more):
        return optimise(patch, objective, over, steps=steps, start=x, report=lambda x, value: best.update(x=x), **more)

    with results(options, 'design.*', 'design_*') as folder, drawing(options, folder, scene.title) as save:
        stopped = False
        try:
            design = designed(plan.steps, best.get('x'), starts=plan.starts, compare=True)
            if robust is not None:
                design = replace(designed(plan.steps, design.x, robust=robust), conventional=design.conventional)
            parts = {name: values for name, values in dict(plan.parts or ()).items() if values and name in over}
            if parts:
                design = of_parts(design, parts, robust)
        except KeyboardInterrupt:
            if 'x' not in best:
                raise
            design, parts, stopped = designed(1, best['x']), {}, True
        found = verify(design, None if robust is None else replace(robust, draws=JUDGES), SEED)
        tolerances = None if robust is None else design.tolerances(robust)
        np.save(folder / PARAMETERS, design.x)
        write_build_list(folder / 'design.csv', design, tolerances, parts)
        _draw(scene, design, patch, source, tolerances, folder, save)
    alone = replace(design, conventional=None)  # the table already says what D0 alone promises
    print('\n'.join([scene.title, found.table('dB', goal=GOAL_dB), *alone.words]))
    if stopped:
        print(f'stopped early: this is the best design so far, and "--resume -o {options.output}" continues from it')
    print(f'build list and pictures are in {options.output}')


def _left(folder):
    try:
        return np.load(folder / PARAMETERS)
    except (OSError, ValueError) as error:
        raise ValueError(f'--resume: {folder / PARAMETERS} cannot be read ({error}); run without it first') from None


def _draw(scene, design, patch, source, tolerances, folder, save):
    """Draw the parts, the levels before and after, the progress of the design, its tolerances, and a film for each frequency."""
    from ..design import Rest
    from ..plotting.animation import animate, mode_frames
    from ..plotting.designs import plot_convergence, plot_design, plot_levels, plot_sites
    from ..stiffness.relaxation import relaxed
    from ..stiffness.rest import LinearSystem

    plan, frf = scene.design, scene.frf
    places = {'source': source}
    for target in plan.targets:
        for pick in (target.loud, target.quiet):
            if pick is not None:
                place = pick.of(patch)
                known = next((name for name, other in places.items() if other.particle == place.particle), None)
                places |= {} if known else {'ABCDEFGH'[len(places) - 1] if len(places) < 9 else str(len(places)): place}
    save(plot_design(design.atoms, places)[0].figure, 'design')
    before, after = (Rest(LinearSystem.of(atoms)) for atoms in (relaxed(patch).atoms, design.atoms))
    levels = {when: {name: np.array([abs(place.seen(rest.response(source, omega, frf.damping))) for omega in frf.omega])
                     for name, place in places.items() if name != 'source'}
              for when, rest in (('before', before), ('designed', after))}
    marks = [target.frequency_Hz for target in plan.targets]
    save(plot_levels(u.hertz(frf.omega), levels, marks)[0].figure, 'design_levels')
    histories = {'D0 + D*': design.history}
    if design.conventional is not None:
        histories['D0 alone, by its own model'] = design.conventional.history
    save(plot_convergence(histories, 'weakest target (dB)').figure, 'design_convergence')
    if tolerances is not None:
        free = LinearSystem.of(design.atoms).mobile
        tolerable = np.where(free, 100 * tolerances['strength'], np.nan)
        save(plot_sites(design.atoms, tolerable, '% of strength for 1 dB', places, norm='log').figure, 'design_tolerances')
    for target in plan.targets:
        shape = after.response(source, 2 * np.pi * target.frequency_Hz * u.Hz, frf.damping)
        animate(folder / f'design_{target.name}.gif', design.atoms, mode_frames(shape, frames=FRAMES),
                title=f'{target.frequency_Hz:g} Hz')
