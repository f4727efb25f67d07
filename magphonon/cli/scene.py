"""`magphonon scene [NAME]`: print a ready scene, or list them; with --schema the keys that a scene may have."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

HELP = 'ready scenes to start from, and every key that a scene may have'


def add_arguments(parser: ArgumentParser) -> None:
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument('name', metavar='NAME', nargs='?', help='ready scene to print; without it: the list of all')
    chosen.add_argument('--schema', action='store_true',
                        help='print tables and keys with their meaning and default as JSON schema, which editors read')


def run(options: Namespace) -> None:
    import json
    import re
    import tomllib
    from pathlib import Path

    from ..scenes.sources import ready_scene, ready_scenes  # without what reads scenes

    if options.schema:
        from ..scenes.scene import Scene

        print(json.dumps(Scene.model_json_schema(), indent=1, ensure_ascii=False))
    elif options.name is None:
        for name, file in ready_scenes().items():
            print(f'{name:15}{tomllib.loads(file.read_text(encoding="utf-8"))["title"]}')
    else:
        path = Path(str(ready_scene(options.name)))
        beside = re.compile('^(file = )"(.*?)"', re.MULTILINE)  # a copy of the scene stands elsewhere
        print(beside.sub(lambda found: f'{found[1]}"{path.parent / found[2]}"', path.read_text(encoding='utf-8')), end='')
