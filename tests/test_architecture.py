"""The house keeps its plan: imports run downwards from floor to floor, never in a circle, and names do not hide modules."""

import ast
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

import magphonon

PACKAGE = Path(magphonon.__file__).parent
FLOORS = [{'cli'}, {'scenes'}, {'design'}, {'plotting', 'waves', 'response', 'stability'},
          {'bands', 'dynamics'}, {'stiffness'}, {'lattices', 'interactions'}]
"""From the top down; rooms on one floor do not know each other.  Single modules such as `units` are the ground below all."""
CORE = {
    '': 'errors units results files traits',
    'interactions': 'law_cards pair_laws bond_laws',
    'lattices': 'bonds',
    'stiffness': 'matrices sites plausibility supercells repulsion calculator rest',
    'bands': 'bloch bands force_constants',
    'dynamics': 'drives cages memory_layout bond_increments splittings engine verlet',
}
"""The core shelf: Eq. 3, the calculator, bands by both roads and time steps.  Who has read it needs nothing else for these."""
FILES = sorted(file for file in PACKAGE.rglob('*.py') if file.parent != PACKAGE or not file.name.startswith('__'))


def name_of(file):
    """Dotted name within the package, as 'bands.bloch'; that of a room for its __init__."""
    return '.'.join(file.relative_to(PACKAGE).with_suffix('').parts).removesuffix('.__init__')


def imported(file, late=True):
    """Dotted names within the package that a file imports when it runs, at the top or, if `late`, in functions; not for types."""
    tree = ast.parse(file.read_text(encoding='utf-8'))
    blocks = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == 'TYPE_CHECKING']
    blocks += [] if late else [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    never_run = {inner for block in blocks for inner in ast.walk(block)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level and node not in never_run:
            base = ('magphonon', *file.relative_to(PACKAGE).parts[:-1])
            target = [*base[:len(base) - node.level + 1], *(node.module.split('.') if node.module else ())][1:]
            for alias in node.names:
                path = PACKAGE.joinpath(*target, alias.name)
                yield '.'.join([*target, alias.name] if path.is_dir() or path.with_suffix('.py').exists() else target)


TARGETS = {name_of(file): list(imported(file)) for file in FILES}


def floor(name):
    """Number of the floor, 0 at the top; the ground is below all."""
    room = name.split('.')[0]
    return next((k for k, rooms in enumerate(FLOORS) if room in rooms), len(FLOORS))


def test_imports_run_downwards():
    ground = len(FLOORS)  # whose modules may know each other
    for here in map(name_of, FILES):
        rooms = {target for target in TARGETS[here] if target and target.split('.')[0] != here.split('.')[0]}
        assert not {target for target in rooms if floor(target) <= floor(here) and floor(target) < ground}, here


def test_no_circle():
    graph = {name: set(targets) & TARGETS.keys() - {name} for name, targets in TARGETS.items()}
    assert list(TopologicalSorter(graph).static_order())


def test_the_core_shelf_imports_only_itself():
    """What is asked for seldom, such as the lowest of many modes, is imported where it is asked for."""
    core = {f'{room}.{name}'.lstrip('.') for room, names in CORE.items() for name in names.split()}
    files = {name_of(file): file for file in FILES}
    assert core <= set(files)
    leaving = {(name, target) for name in core for target in imported(files[name], late=False) if target and target not in core}
    assert not leaving
    assert {'bands.neighbours'} == set(imported(files['cli.neighbours'], late=False)) & {'bands.neighbours'}  # one is seen


def test_every_room_is_on_a_floor():
    assert {file.parent.name for file in PACKAGE.glob('*/__init__.py')} == set().union(*FLOORS)


@pytest.mark.parametrize('room', sorted(set().union(*FLOORS) - {'cli'}))
def test_no_exported_name_hides_a_module(room):
    stub = ast.parse((PACKAGE / room / '__init__.pyi').read_text(encoding='utf-8'))
    exported = {alias.name for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert exported
    assert not exported & {file.stem for file in (PACKAGE / room).glob('*.py')}


def test_the_front_door_opens_what_its_stub_lists():
    """For its time the list stands in the module once more: every name of the stub is found, from the room that it names."""
    stub = ast.parse((PACKAGE / '__init__.pyi').read_text(encoding='utf-8'))
    listed = {alias.name: node.module for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert set(dir(magphonon)) == set(listed)
    for name, room in listed.items():
        found = getattr(magphonon, name)
        assert found is (getattr(import_module(f'magphonon.{room}'), name) if room else import_module(f'magphonon.{name}'))
