"""Draw the rooms of the package and their imports: `python docs/draw_architecture.py [SOURCE] [PICTURE]`.

Each room stands above all that it imports.  An arrow is left out where a chain of other arrows says the same: the rooms may
import from every floor below.  SOURCE is a folder of Python modules, the package itself if it is not given.
"""

import ast
import sys
from collections import defaultdict
from pathlib import Path

from matplotlib.figure import Figure

HERE = Path(__file__).parent


def imports(source):
    """For each room, a package or a single module, the rooms that it imports."""
    rooms = {path.stem for path in source.iterdir() if (path / '__init__.py').exists() or path.suffix == '.py'}
    rooms = {room for room in rooms if not room.startswith('__')}
    graph = {room: set() for room in rooms}
    for file in source.rglob('*.py'):
        parts = file.relative_to(source).with_suffix('').parts
        if parts[0] not in rooms:
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            if isinstance(node, ast.ImportFrom) and node.level == len(parts):  # relative to the package itself
                targets = [node.module.split('.')[0]] if node.module else [alias.name for alias in node.names]
                graph[parts[0]] |= {target for target in targets if target in rooms} - {parts[0]}
    return graph


def floors(graph):
    """Height of each room above the ground: one more than the highest that it imports."""
    height = {}

    def climb(room):
        if room not in height:
            height[room] = 1 + max((climb(target) for target in graph[room]), default=-1)
        return height[room]

    for room in graph:
        climb(room)
    return height


def reduced(graph):
    """The imports that no chain of other imports implies."""
    below = {}
    for room in sorted(graph, key=floors(graph).get):
        below[room] = graph[room].union(*(below[target] for target in graph[room]))
    return {room: {target for target in targets if not any(target in below[other] for other in targets)}
            for room, targets in graph.items()}


def draw(graph, path):
    """Boxes floor by floor, an arrow for each import that is not implied."""
    height, rows = floors(graph), defaultdict(list)
    for room in sorted(graph):
        rows[height[room]].append(room)
    width = max(map(len, rows.values()))
    figure = Figure((max(7, 1.35 * width), 0.9 * len(rows) + 0.5))
    ax = figure.add_axes((0, 0, 1, 1))
    at = {room: ((k + 0.5) * width / len(row), floor) for floor, row in rows.items() for k, room in enumerate(row)}
    for room, targets in reduced(graph).items():
        for target in targets:
            ax.annotate('', at[target], at[room], zorder=1,
                        arrowprops={'arrowstyle': '-|>', 'color': '0.6', 'linewidth': 0.6, 'shrinkA': 9, 'shrinkB': 9})
    for room, (x, y) in at.items():
        ax.text(x, y, room, ha='center', va='center', fontsize=9, zorder=2,
                bbox={'boxstyle': 'round,pad=0.35', 'facecolor': 'white', 'edgecolor': '#0072B2'})
    ax.set(xlim=(-0.1, width + 0.1), ylim=(-0.6, len(rows) - 0.4))
    ax.axis('off')
    figure.savefig(path, dpi=min(150, 1600 / figure.get_figwidth()))


if __name__ == '__main__':
    source = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE.parent / 'magphonon'
    draw(imports(source), sys.argv[2] if len(sys.argv) > 2 else HERE / 'architecture.png')
