"""`magphonon plan SCENE.toml --tolerance 1e-3 [--run -o DIR]`: the least model that a scene needs, and its run."""




HELP = 'the least model that a scene needs for a tolerance, and its run'
FINEST = 1e-7
"""Tolerance: at Gamma the root of the round-off in a square is a few 1e-8 of the highest frequency."""


def add_arguments(parser):
    parser.add_argument('scene', metavar='SCENE.toml', help='scene file with [bands], [frf] or [burst], and [plan] for details')
    parser.add_argument('--tolerance', metavar='X', type=float, default=1e-3,
                        help='relative error allowed in what the scene asks for (default: 1e-3)')
    parser.add_argument('--run', dest='answer', action='store_true', help='run what was chosen')
    parser.add_argument('-o', '--output', metavar='DIR', help='directory for the data of --run')


def run(options):
    from ..errors import positive
    from ..planning.scene import scene_plans
    from ..scenes.scene import read_scene
    from .costs import refuse_costly
    from .results import results

    tolerance = positive('--tolerance', options.tolerance)
    if not FINEST <= tolerance < 1:
        raise ValueError(f'--tolerance must lie between {FINEST:g} and 1, not {tolerance:g}; '
                         'a frequency, the root of a square, is good for no more digits where it is low')
    if options.answer != (options.output is not None):
        raise ValueError('--run and -o DIR belong together: say where to write what is run')
    scene = read_scene(options.scene)
    refuse_costly(scene, 'bands', 'frf', 'burst')
    print(scene.title)
    if not options.answer:
        for wanted in scene_plans(scene, tolerance):
            print(f'\n{wanted.report()}')
        return
    with results(options, scene) as folder:
        for wanted in scene_plans(scene, tolerance):
            print(f'\n{wanted.report()}')
            wanted.run(folder)
    print(f'\ndata are in {options.output}')
