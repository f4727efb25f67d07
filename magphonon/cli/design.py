"""`magphonon design SCENE`: the spacing and the foundation that give the frequencies wanted in [design]. With [[design.targets]]
it designs the strength and support of every site of a patch.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from .. import units as u
from .arguments import add_output, add_scene, add_style

HELP = 'find the spacing and foundation, or every magnet of a patch, for the frequencies that you want'
RESULTS = 'design.*', 'design_*.png', 'design_*.pdf', 'design_*.gif'
TOLERABLE = 0.01
"""Largest shift of a frequency by omitted neighbours that a design may have, as a fraction: magnets are placed to within half a
percent of the spacing, which moves a frequency by some percent."""


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, ' with [design]', 'design')
    parser.add_argument('--resume', action='store_true', help='with [[design.targets]]: continue from the design in the '
                                                              'directory of results')
    add_output(parser)
    add_style(parser)


def run(options: Namespace) -> None:
    from ..scenes.plans import HERTZ, tables
    from ..scenes.scene import read_scene

    scene = read_scene(options.scene).counted()
    plan = scene.wanted('design')
    if plan.targets:
        from .site_design import run as run_sites

        run_sites(options, scene)
        return
    k, designs = plan.solve(scene)
    present = scene.lattice.spacing_m * u.m
    best = min(designs, key=lambda design: abs(design.spacing - present))
    met = [] if plan.spacing_from is None else [f'{plan.spacing_from.name} at {best.value / HERTZ:.6g} Hz']
    met += [] if plan.cut_off_Hz is None else [f'cut-off {plan.cut_off_Hz:.6g} Hz']
    lines = [f'# a spacing of {best.spacing / u.m:.6g} m and a foundation of {k / (u.N / u.m):.6g} N/m: {", ".join(met)}',
             f'# in the scene "{scene.title}", replace the tables of the same names by these']
    if plan.spacing_from is not None:
        lines.append(f'# 1 % more spacing changes {plan.spacing_from.name} by {best.slope / HERTZ / 100:+.3g} Hz')
    given, needed = (stiffness / (u.N / u.m) for stiffness in (k, best.needed))
    lines.append(f'# stable: the foundation is {given:.6g} N/m, the static forces require {needed:.6g} N/m')
    others = ', '.join(f'{design.spacing / u.m:.6g}' for design in designs if design is not best)
    if others:
        lines.append(f'# this spacing is the nearest to that of the scene; other spacings that meet the target: {others} m')
    near = ' '.join(_left_out(scene, plan, best, k, options.verbose))
    shown = [*(lines if options.verbose else lines[:1]), *([f'# {near}'] if near else [])]
    print('\n'.join([*shown, '', tables(scene, best, k)]))


def _left_out(scene, plan, best, k, verbose):
    """Lines that say how the omitted neighbours would shift the frequencies of the lattice that was found."""
    from ..scenes.tolerances import varied
    from .neighbours import REPORT, Case

    edge = plan.edge
    points = None if edge is None else {edge.point: scene.special_points[edge.point]}
    within = None if edge is None else {(edge.point, edge.branch): TOLERABLE}
    cell = varied(scene, {'spacing': best.spacing / (scene.lattice.spacing_m * u.m)}).perfect_cell()
    cell.calc.set(foundation=k)
    return REPORT.told(Case(scene, points, cell, within, f'{100 * TOLERABLE:g} %'), verbose)
