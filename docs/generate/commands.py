"""A page for each command: what it does, its options, and an example with what it printed and drew when this site was built."""

import argparse
import contextlib
import io
import re
import shlex
from importlib import import_module
from importlib.resources import files
from pathlib import Path

from magphonon.cli.main import COMMANDS, main

WAVE = {'carriers_Hz = [30, 40, 50, 60]': 'carriers_Hz = [40]', 'side_m = 0.3': 'side_m = 0.2'}
"""Lines of the scene "prototype" that make it a scene of one short burst."""
EXAMPLES = {
    'bands': ['magphonon bands prototype', 'magphonon bands prototype --verbose --force'],
    'burst': ['magphonon burst wave.toml'],
    'check': ['magphonon check square', 'magphonon check square --verbose'],
    'explore': ['magphonon explore prototype'],
    'fit': ['magphonon fit forces.csv --spacing 0.01 --contact 0.00635 -o out',
            'magphonon fit ridges.csv --bands prototype -o lattice'],
    'frf': ['magphonon frf oscillator'],
    'modes': ['magphonon modes prototype'],
    'reproduce': ['magphonon reproduce chain -o out'],
    'scene': ['magphonon scene'],
    'spectrum': ['magphonon spectrum scan.csv wave.toml'],
}
GIVEN = {
    'burst': '`wave.toml` is the scene `prototype` with one burst and a smaller patch: '
             + ', '.join(f'`{line}`' for line in WAVE.values()),
    'fit': '`forces.csv` is the table `synthetic_force.csv` that comes with the package, computed forces with noise; '
           '`ridges.csv` is its table `prototype_ridges.csv`, from simulated bursts under a vibrometer',
    'spectrum': '`scan.csv` is a table of displacements: here the one that `magphonon burst wave.toml` wrote',
}
MOST_PICTURES = 3


def write(folder):
    """One page per command and their list."""
    place = folder / 'work'
    rows = []
    for name in COMMANDS:
        module = import_module(f'magphonon.cli.{name}')
        rows.append(f'| [{name}]({name}.md) | {module.HELP} |')
        (folder / f'{name}.md').write_text(page(name, module, place / name, folder), encoding='utf-8')
    table = ['| command | what it does |', '|---|---|', *rows, '']
    contents = ['```{toctree}', ':hidden:', '', *COMMANDS, '```', '']
    (folder / 'index.md').write_text('\n'.join([HEAD, *table, *contents]), encoding='utf-8')


def page(name, module, place, folder):
    """Description, example and options of one command."""
    place.mkdir(parents=True)
    prepare(name, place)
    told = re.sub(r'docs/(\w+)\.md', r'[docs/\1.md](../../\1.md)', module.__doc__.partition(': ')[2].strip())
    parts = [f'# magphonon {name}\n\n{told[:1].upper()}{told[1:]}\n']
    if name in EXAMPLES:
        given = f'{GIVEN[name]}.\n\n' if name in GIVEN else ''
        shown = run(EXAMPLES[name], place)
        parts.append(f'## Example\n\n{given}```text\n{shown}\n```\n')
        pictures = sorted(place.rglob('*.png'), key=lambda file: file.stat().st_mtime_ns)[:MOST_PICTURES]
        parts += [f'![{picture.stem} of the example]({picture.relative_to(folder).as_posix()})\n' for picture in pictures]
    parts.append(f'## Options\n\n```text\n{usage(name, module)}```\n')
    return '\n'.join(parts)


def usage(name, module):
    """What `--help` prints after the description."""
    def wide(prog):
        return argparse.HelpFormatter(prog, width=86)

    parser = argparse.ArgumentParser(prog=f'magphonon {name}', formatter_class=wide)
    module.add_arguments(parser)
    return parser.format_help()


def run(lines, place):
    """What the lines of a shell print, each below itself."""
    shown = []
    with contextlib.chdir(place):
        for line in lines:
            words, _, target = line.partition(' > ')
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                status = main(shlex.split(words)[1:])
            if status:
                raise RuntimeError(f'{line}: exit status {status}')
            shown.append(f'$ {line}')
            if target:
                Path(target).write_text(out.getvalue(), encoding='utf-8')
            else:
                shown.append(out.getvalue().strip('\n'))
    return '\n'.join(shown)


def prepare(name, place):
    """Write the files that an example takes for granted."""
    data = files('magphonon.data')
    if name in ('fit', 'read'):
        for file, own in (('forces.csv', 'synthetic_force.csv'), ('ridges.csv', 'prototype_ridges.csv')):
            (place / file).write_text((data / own).read_text(encoding='utf-8'), encoding='utf-8')
    if name in ('burst', 'spectrum'):
        text = (data / 'prototype.toml').read_text(encoding='utf-8')
        for old, new in WAVE.items():
            if old not in text:
                raise RuntimeError(f'the scene prototype has no line {old!r}')
            text = text.replace(old, new)
        (place / 'wave.toml').write_text(text, encoding='utf-8')
    if name == 'spectrum':
        sent = place.parent / 'burst' / 'wave-burst' / '40Hz_90deg_complete.csv'
        (place / 'scan.csv').write_bytes(sent.read_bytes())


HEAD = """# Commands

Run commands on a ready scene, or print it, edit it, and run them on the file:

```sh
magphonon bands prototype
magphonon scene prototype > mine.toml
magphonon check mine.toml
magphonon scene prototype | sed 's/spacing_m = 0.01/spacing_m = 0.011/' | magphonon bands - -o wider
```

SCENE is a file or, if there is no file of this name, a ready scene; `-` reads it from the standard input, and the files that it
names, such as a table of forces, are then looked for in the current folder. Without `-o` the results go to a directory named
after the scene and the command, such as `prototype-bands`.

A command prints a line that answers, and what must not be missed; `--verbose` prints everything that it found.

The exit status is 0 when all is written, 1 when `check` finds a fault in what the scene describes, 2 for a mistake in the command
or the scene (one message, nothing written), and 130 when interrupted. A folder of results is written whole or not at all: see
[files](../../reference/files.md). The examples on these pages were run when the site was built.
"""
