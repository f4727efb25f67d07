"""`magphonon scene [NAME]`: print a ready scene, or list them; with --keys the keys that a scene may have."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..scenes.keys import Key

HELP = 'ready scenes to start from, and every key that a scene may have'
WIDEST = 100  # longest line of the list of keys, in letters


def add_arguments(parser: ArgumentParser) -> None:
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument('name', metavar='NAME', nargs='?', help='ready scene to print; without it: the list of all')
    chosen.add_argument('--keys', metavar='TABLE or KEY', nargs='?', const='',
                        help='type, unit, default, range, meaning and example of every key, or only of one table, such as law, '
                             'or of one key, such as spacing_m')


def run(options: Namespace) -> None:
    import re
    import sys
    import tomllib
    from pathlib import Path
    from shutil import get_terminal_size

    from ..scenes.sources import ready_scene, ready_scenes  # without what reads scenes

    if options.keys is not None:
        from ..scenes.keys import scene_keys

        width, last = min(WIDEST, get_terminal_size().columns) if sys.stdout.isatty() else WIDEST, ''
        for key in scene_keys(options.keys or None):
            if key.table != last:
                print(f'\n[{key.table}]')
                last = key.table
            print(_described(key, width))
    elif options.name is None:
        for name, file in ready_scenes().items():
            print(f'{name:15}{tomllib.loads(file.read_text(encoding="utf-8"))["title"]}')
    else:
        path = Path(str(ready_scene(options.name)))
        beside = re.compile('^(file = )"(.*?)"', re.MULTILINE)  # a copy of the scene stands elsewhere
        print(beside.sub(lambda found: f'{found[1]}"{path.parent / found[2]}"', path.read_text(encoding='utf-8')), end='')


def _described(key: Key, width: int) -> str:
    from textwrap import fill

    default, *others = key.default.replace('none', 'optional').split('; ')
    default += ' if omitted' * (default not in ('optional', 'required')) + f' ({"; ".join(others)})' * bool(others)
    kinds = f'only for kind = {" or ".join(key.kinds)}' if key.kinds else ''
    facts = [f'{key.type}, {key.unit}' if key.unit else key.type, default,
             *filter(None, (key.allowed * (key.allowed != key.type), kinds))]
    lines = ['; '.join(facts), key.description, f'e.g. {key.example}' if key.example else '']
    margin = 28 * ' '
    text = '\n'.join(fill(line, width, initial_indent=margin, subsequent_indent=margin) for line in lines if line)
    return f'  {key.name:25} {text.lstrip()}'
