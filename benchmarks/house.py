"""How large the package is, and through how many files one question goes: `python benchmarks/house.py [REVISION ...]`.

A column for each revision of the repository, and one for HEAD.  A route is what runs from one call to its answer: the files of
the package that it enters and the lines of its functions are counted, apart from what importing runs.

With `--ratchet` HEAD is compared with the largest allowed numbers in benchmarks/house.toml; it fails where one is larger.
Whoever makes a number smaller writes the new one there.  With `--ratchet COMMAND ...` the command is run first, the fast tests
for example: its exit status counts, and the processor time that it took is one of the numbers.
"""

import ast
import json
import os
import resource
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from io import BytesIO
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMPLEX = 12
"""Complexity above which a function does several things."""
BRANCHES = ast.If, ast.IfExp, ast.For, ast.While, ast.ExceptHandler, ast.comprehension, ast.match_case
"""What adds one to the complexity of a function, as each further operand of `and` and `or` does, and each `if` in a list."""
CELL = """
from magphonon import InversePower, MagneticRepulsion, lattices
cell = lattices.triangular(10.0, 0.707)
law, foundation = InversePower(1.6209e-10 * 1e3**4.5824, 4.5824), 19.6757e-3
"""
COMMAND = 'from magphonon.cli.main import main as command\n'
ROUTES = {  # what is prepared, and what is followed
    'analytic_bands': (CELL + 'from magphonon import analytic_bands\n'
                       'cell.calc = MagneticRepulsion(cell, law, foundation=foundation)\n'
                       "path = cell.cell.bandpath('GMK', npoints=5, pbc=cell.pbc)", 'analytic_bands(cell, path)'),
    'propagate': (CELL + 'from magphonon import ToneBurst, propagate\n'
                  'patch = lattices.hexagon(cell, 60.0)\n'
                  'patch.calc = MagneticRepulsion(patch, law, foundation=foundation)\n'
                  'burst = ToneBurst(len(patch) // 2, (0, 1), 1e-4, omega=0.25)', 'propagate(patch, [0.0, 10.0], [burst])'),
    'magphonon check': (COMMAND, "command(['check', 'prototype'])"),
    'magphonon bands': (COMMAND, "command(['bands', 'prototype', '-o', 'b'])"),
    'magphonon fit': (COMMAND, "command(['fit', FORCES, '--spacing', '10mm', '-o', 'f'])"),
    'magphonon fit --bands': (COMMAND, "command(['fit', RIDGES, '--bands', 'prototype', '-o', 'f'])"),
}
FOLLOW = """
import json, os, sys, tempfile
os.chdir(tempfile.mkdtemp())
tree, RIDGES, FORCES = {tree!r}, {tree!r} + '/data/prototype_ridges.csv', {tree!r} + '/data/synthetic_force.csv'
{before}
entered, importing = set(), 0
def follow(frame, event, _):
    global importing
    code = frame.f_code
    if code.co_name == '<module>' and code.co_filename != '<string>':  # class bodies and decorators run within it
        importing += dict(call=1).get(event, -1 if event == 'return' else 0)
    elif event == 'call' and not importing and code.co_filename.startswith(tree + '/magphonon'):
        entered.add((code.co_filename, code.co_firstlineno))
sys.stdout = open(os.devnull, 'w')
sys.setprofile(follow)
try:
    {call}
finally:
    sys.setprofile(None)
print(json.dumps([*entered]), file=sys.__stdout__)
"""
FRONT = """
import argparse, json
import magphonon
from magphonon.cli.main import parser_of
from magphonon.scenes.scene import Scene
from magphonon.scenes import ready_scenes
commands = next(action for action in parser_of()._actions if isinstance(action, argparse._SubParsersAction)).choices
schema = Scene.model_json_schema()
print(json.dumps({
    'commands': len(commands),
    'arguments and flags of commands': sum('-h' not in word.option_strings for one in commands.values() for word in one._actions),
    'scene keys': sum(len(table.get('properties', ())) for table in (schema, *schema['$defs'].values())),
    'ready scenes': len(ready_scenes()),
    'top-level names': len(magphonon.__all__),
}))
"""


def functions_of(tree):
    """(lines of the body without the docstring, node) of each function of a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            yield (body[-1].end_lineno - body[0].lineno + 2 if body else 1), node


def docstring_lines(tree):
    """Lines of all docstrings, those beside constants included."""
    return sum(node.end_lineno - node.lineno + 1 for node in ast.walk(tree)
               if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str))


def imported(package, file, tree):
    """Files of the package that a file imports when it runs."""
    never_run = {inner for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == 'TYPE_CHECKING'
                 for inner in ast.walk(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level and node not in never_run:
            base = file.parents[node.level - 1].joinpath(*(node.module or '').split('.'))
            for alias in node.names:
                target = next((path for path in (base / f'{alias.name}.py', base.with_suffix('.py')) if path.exists()), None)
                if target and target.is_relative_to(package):
                    yield target


def complexity(function):
    """One more than the number of places at which a function takes one of two ways, those within expressions included."""
    return 1 + sum(isinstance(node, BRANCHES) + len(getattr(node, 'ifs', ()))
                   + (len(node.values) - 1 if isinstance(node, ast.BoolOp) else 0) for node in ast.walk(function))


def lines_in(folder, *endings):
    """Lines of all files of a folder with one of these endings."""
    return sum(len(file.read_text(encoding='utf-8').splitlines()) for file in folder.rglob('*') if file.suffix in endings)


def longest_chain(graph):
    """Number of files in the longest chain of imports."""
    known = {}

    def length(file):
        if file not in known:
            known[file] = 1  # a circle ends here; the tests refuse one
            known[file] = 1 + max((length(target) for target in graph[file]), default=0)
        return known[file]

    return max(map(length, graph))


def measured(root):
    """The figures of a tree, by name."""
    package = root / 'magphonon'
    trees = {file: ast.parse(file.read_text(encoding='utf-8')) for file in sorted(package.rglob('*.py'))}
    texts = {file: file.read_text(encoding='utf-8').splitlines() for file in trees}
    files = [file for file in trees if file.name != '__init__.py']
    lengths = [length for tree in trees.values() for length, _ in functions_of(tree)]
    graph = {file: set(imported(package, file, trees[file])) & set(files) - {file} for file in files}
    exported = [alias for stub in package.rglob('*/__init__.pyi') for node in ast.parse(stub.read_text(encoding='utf-8')).body
                if isinstance(node, ast.ImportFrom) for alias in node.names]
    blank = sum(not line.strip() for lines in texts.values() for line in lines)
    comments = sum(line.lstrip().startswith('#') for lines in texts.values() for line in lines)
    docs, lines = sum(map(docstring_lines, trees.values())), sum(map(len, texts.values()))
    (package / 'data').symlink_to(root / 'data')  # where an installed package has it
    return {
        'lines': lines, 'of code': lines - docs - blank - comments, 'of docstrings': docs, 'files': len(files),
        'functions': len(lengths), 'mean lines of a function': round(sum(lengths) / len(lengths), 1),
        'longest function': max(lengths),
        f'functions above complexity {COMPLEX}': sum(complexity(node) > COMPLEX for tree in trees.values()
                                                     for _, node in functions_of(tree)),
        'exported names of rooms': len(exported), 'arrows between files': sum(map(len, graph.values())),
        'longest chain of files': longest_chain(graph),
        'lines of JavaScript, HTML and CSS': lines_in(package, '.js', '.html', '.css'),
        'lines of tests': lines_in(root / 'tests', '.py'),
        'lines of workflows and benchmarks': lines_in(root / 'workflows', '.py') + lines_in(root / 'benchmarks', '.py'),
    } | front(root) | {line: value for name, calls in ROUTES.items() for line, value in route(root, name, *calls)}


def front(root):
    """What a user faces: commands, their flags, keys of scenes, ready scenes, names."""
    done = subprocess.run([sys.executable, '-W', 'ignore', '-c', FRONT], capture_output=True, text=True, cwd=root,  # noqa: S603
                          env=os.environ | {'PYTHONPATH': str(root)})
    return json.loads(done.stdout) if not done.returncode else {'commands': done.stderr.splitlines()[-1][:60]}


def route(root, name, before, call):
    """Numbers of files that a call enters, and for a call in Python of lines of the functions, in a process of its own."""
    code = FOLLOW.format(tree=str(root), before=before, call=call)
    done = subprocess.run([sys.executable, '-W', 'ignore', '-c', code], capture_output=True, text=True,  # noqa: S603
                          env=os.environ | {'PYTHONPATH': str(root), 'MPLBACKEND': 'Agg'})
    if done.returncode:
        yield f'files entered by {name}', done.stderr.splitlines()[-1][:60]
        return
    entered = {tuple(place) for place in json.loads(done.stdout) if not place[0].endswith('__init__.py')}
    files = {file for file, _ in entered}
    yield f'files entered by {name}', len(files)
    if before.startswith(CELL):
        lengths = {(file, min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])): length
                   for file in files for length, node in functions_of(ast.parse(Path(file).read_text(encoding='utf-8')))}
        yield f'lines of code in {name}', sum(lengths.get(place, 0) for place in entered)


def at(revision, folder):
    """The tree of a revision in a folder, its data where the package looks for them."""
    archive = subprocess.run(['git', '-C', str(ROOT), 'archive', revision], capture_output=True, check=True).stdout  # noqa: S603, S607
    tree = Path(folder, revision).resolve()
    with tarfile.open(fileobj=BytesIO(archive)) as tar:
        tar.extractall(tree, filter='data')
    return tree


def exceeded(found, most):
    """A line for each number that is larger than allowed, or that could not be measured."""
    return [f'{name}: {found.get(name)}, at most {limit} allowed' for name, limit in most.items()
            if not isinstance(found.get(name), (int, float)) or found[name] > limit]


def processor_seconds(command):
    """Run a command, here and with all its output; the processor time in s that it and its children took."""
    status = subprocess.run(command, cwd=ROOT).returncode  # noqa: S603
    if status:
        sys.exit(status)
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return round(spent.ru_utime + spent.ru_stime)


def main():
    """Print the table, or with --ratchet what has grown."""
    revisions, ratchet, command = sys.argv[1:], '--ratchet' in sys.argv, []
    if ratchet:
        place = revisions.index('--ratchet')
        revisions, command = revisions[:place], revisions[place + 1:]
    timed = {'processor seconds of the fast tests': processor_seconds(command)} if command else {}
    with tempfile.TemporaryDirectory() as folder:
        columns = {revision: measured(at(revision, folder)) for revision in dict.fromkeys([*revisions, 'HEAD'])}
    columns['HEAD'] |= timed
    names = dict.fromkeys(name for column in columns.values() for name in column)
    print(f'{"":44}', *(f'{revision:>12}' for revision in columns))
    for name in names:
        print(f'{name:44}', *(f'{column.get(name, ""):>12}' for column in columns.values()))
    most = tomllib.loads((ROOT / 'benchmarks/house.toml').read_text(encoding='utf-8'))
    if not command:
        most.pop('processor seconds of the fast tests')
    if ratchet and (grown := exceeded(columns['HEAD'], most)):
        sys.exit('\n'.join(['What may only become smaller has grown:', *grown]))


if __name__ == '__main__':
    main()
