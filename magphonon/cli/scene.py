"""`magphonon scene [NAME]`: print a ready scene, or list them."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

HELP = 'print a ready scene, or list them'


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument('name', metavar='NAME', nargs='?', help='without it: the names and titles')


def run(options: Namespace) -> None:
    from ..scenes.scene import read_scene, ready_scene, ready_scenes

    if options.name is None:
        for name, file in ready_scenes().items():
            print(f'{name:12}{read_scene(str(file)).title}')
    else:
        print(ready_scene(options.name).read_text(encoding='utf-8'), end='')
