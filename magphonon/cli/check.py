"""`magphonon check SCENE.toml`: will it stay, will it run, does a linear answer hold; before it runs.

The exit status is 1 if anything is at fault, such as a lattice that buckles, and 0 if nothing is.
"""




HELP = 'judge a scene before it runs: rest, stability, time step, supports, amplitude, supercell, cost'
JUDGED = 20_000
"""Particles up to which a patch is judged by itself, which takes some ten seconds and grows with the third power of its side."""


def add_arguments(parser):
    parser.add_argument('scene', metavar='SCENE.toml', help='scene file; "magphonon scene prototype" prints one to start from')


def run(options):
    """Print the verdicts; returns the exit status, 0 if all is fine and 1 if something is not."""
    from .. import units
    from ..bands.velocities import cut_off
    from ..planning.scene import neglected
    from ..scenes.scene import read_scene
    from ..stability.verdicts import verdict
    from .costs import SHARE, costs, free_memory, too_much

    scene = read_scene(options.scene)
    print(scene.title)
    expected, free = costs(scene), free_memory()
    faults = [too_much(scene, cost, free) for cost in expected if cost.bytes > SHARE * free]
    atoms = scene.atoms()
    if scene.single:
        print(f'A constant force of {atoms.calc.load[scene.lattice.free, 1] / units.N:.6g} N along its line is taken to balance '
              'the three magnets.')
    supercell = scene.supercell() if scene.bands is not None else None
    verdicts = {'The oscillator' if scene.single else 'The lattice': verdict(atoms, supercell=supercell)}
    patch = scene.patch_atoms() if scene.patch is not None and not scene.single else None
    if patch is not None and len(patch) <= JUDGED:
        verdicts['The patch'] = verdict(patch)
    for name, judged in verdicts.items():
        print(f'\n{name}: {judged}')
    at_rest = not scene.single and not verdicts['The lattice'].residual
    if at_rest and (cutoff := cut_off(atoms)) is not None:
        print(f'\nIts foundation gives it a cut-off frequency of {units.hertz(cutoff):.6g} Hz, the lowest of long waves (Gamma).')
    if patch is not None and 'The patch' not in verdicts:
        print(_large(len(patch)))
    for line in neglected(scene):
        print(f'\n{line}')
    if expected:
        print('\nWhat its tables will take, about:', *expected, sep='\n  ')
    for fault in faults:
        print(f'Not as it stands: {fault}.')
    return 0 if all(judged.fine for judged in verdicts.values()) and not faults else 1


def _large(particles):
    """What is said of a patch that is not judged by itself.

    The free particles of a patch have all their neighbours, so that its Hessian is a block of that of the lattice, and its
    eigenvalues lie between the lowest and the highest one of the lattice (Cauchy).
    """
    return (f'\nThe patch: of {particles} particles, more than {JUDGED}, it is not judged by itself. Each particle inside its '
            'rim has all of its neighbours: it holds if the lattice does, and at the same time steps. Its rim might hold it even '
            'where the lattice buckles.')
