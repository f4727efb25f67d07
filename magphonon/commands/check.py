"""`magphonon check SCENE.toml`: will it stay, will it run, does a linear answer hold; before it runs."""

HELP = 'judge a scene before it runs: rest, stability, time step, supports, amplitude, supercell'


def add_arguments(parser):
    parser.add_argument('scene', metavar='SCENE.toml', help='scene file; "magphonon scene prototype" prints one to start from')


def run(options):
    """Print the verdicts; returns the exit status, 0 if all is fine and 1 if something is not."""
    from ..scenes import read_scene
    from ..stability import verdict

    scene = read_scene(options.scene)
    print(scene.title)
    atoms = scene.atoms()
    supercell = scene.supercell() if scene.bands is not None else None
    verdicts = {'The oscillator' if scene.single else 'The lattice': verdict(atoms, _balance(scene, atoms), supercell=supercell)}
    if scene.patch is not None and not scene.single:
        verdicts['The patch'] = verdict(scene.patch_atoms())
    for name, judged in verdicts.items():
        print(f'\n{name}: {judged}')
    return 0 if all(judged.fine for judged in verdicts.values()) else 1


def _balance(scene, atoms):
    """The constant force that the oscillator of Sec. III is held by against its three magnets; it belongs to the scene."""
    from .. import units
    from ..drives import Constant

    if not scene.single:
        return []
    balance = -atoms.get_forces(apply_constraint=False)[scene.lattice.free, 1]
    print(f'A constant force of {balance / units.N:.6g} N along its line is taken to balance the three magnets.')
    return [Constant(scene.lattice.free, (0, 1), balance)]
