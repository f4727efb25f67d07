"""The page of every threshold: the named numbers of all modules, what they mean, and the functions that they guard."""

import ast
from pathlib import Path

import magphonon

SOURCE = Path(magphonon.__file__).parent
HEAD = """# Every threshold

The named numbers of the code: limits, tolerances and choices, with what they mean and the functions that use them. A function
in bold refuses what lies beyond: it raises an error that says why. The numbers are read from the source, so they are always
those in use. For their consequences see [validity](../../reference/validity.md).
"""


def write(folder):
    """One page, with a table for each room."""
    parts = [HEAD]
    rooms = sorted({file.parent for file in SOURCE.rglob('*.py')} - {SOURCE})
    for room in rooms:
        rows = [row for file in sorted(room.glob('*.py')) for row in rows_of(file)]
        if rows:
            parts += [f'\n## {room.name}\n\n', '| name | value | meaning | used in |\n|---|---|---|---|\n', *rows]
    (folder / 'thresholds.md').write_text(''.join(parts), encoding='utf-8')


def rows_of(file):
    """Rows of the numbers that one module names and describes."""
    tree = ast.parse(file.read_text(encoding='utf-8'))
    for name, value, told in constants(tree):
        users = {function.name: any(isinstance(node, ast.Raise) for node in ast.walk(function))
                 for function in ast.walk(tree) if isinstance(function, ast.FunctionDef)
                 and any(isinstance(node, ast.Name) and node.id == name for node in ast.walk(function))}
        used = ', '.join(f'**`{user}`**' if refuses else f'`{user}`' for user, refuses in users.items())
        where = f'{file.parent.name}/{file.name}'
        meaning = told.replace('|', '\\|').replace('*', '\\*').replace('[', '\\[')
        yield f'| `{name}` | {value} | {meaning} | `{where}`{": " if used else ""}{used} |\n'


def constants(tree):
    """Name, value as it is written, and docstring of every number, or few numbers, that a module names in capitals."""
    for node, after in zip(tree.body, tree.body[1:], strict=False):
        if (isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id.isupper()
                and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and numbers(node.value)):
            yield node.targets[0].id, ast.unparse(node.value), ' '.join(str(after.value.value).split())


def numbers(value):
    """Whether an expression consists of numbers alone."""
    inner = [node for node in ast.walk(value) if isinstance(node, ast.expr)]
    return any(isinstance(node, ast.Constant) for node in inner) and all(
        isinstance(node, ast.Constant | ast.Tuple | ast.UnaryOp | ast.BinOp | ast.Name) for node in inner) and not any(
        isinstance(node, ast.Constant) and isinstance(node.value, str) for node in inner)
