"""What the workflows find and draw, each with its pictures, its numbers beside their references, and its script."""

import contextlib
import io
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))
from workflows.chapters import CHAPTERS, NAMES, run  # noqa: E402

QUICK = ('oscillator', 'chain', 'ideal_bands', 'prototype_bands', 'phonopy_comparison', 'matter')
"""Those that take a second or two each."""
HEAD = """# Figures with numbers

What the workflows compute: the figures of the paper, and what goes beyond it. Each picture leads to a page with all pictures, the
numbers beside their references, and the script that made them. `magphonon reproduce NAME` runs one, `magphonon reproduce` all of
them. Short scripts for your own work are in the [gallery](../gallery/index.rst).
"""
TILE = """:::{{container}} tile
[![{title}]({picture})]({name}.md)

[{title}]({name}.md)
:::
"""
LONGER = """
## Longer ones

Run when the site is built with `-t all`.

| workflow | what it shows |
|---|---|
"""


def write(folder, every=False):
    """A page of thumbnails and a page for each workflow; `every` runs the longer ones too."""
    titles = {chapter.name: chapter.title for chapter in CHAPTERS}
    outcomes = computed(folder / 'pictures', NAMES if every else QUICK)
    for name, title in titles.items():
        (folder / f'{name}.md').write_text(page(name, title, outcomes.get(name), folder), encoding='utf-8')
    drawn = [name for name in NAMES if name in outcomes and outcomes[name].pictures]
    tiles = ''.join(TILE.format(name=name, title=titles[name], picture=picture(outcomes[name])) for name in drawn)
    rest = ''.join(f'| [{name}]({name}.md) | {titles[name]} |\n' for name in NAMES if name not in drawn)
    contents = '```{toctree}\n:hidden:\n\n' + '\n'.join(NAMES) + '\n```\n'
    text = f'{HEAD}\n::::{{container}} tiles\n{tiles}::::\n{LONGER + rest if rest else ""}\n{contents}'
    (folder / 'index.md').write_text(text, encoding='utf-8')


def picture(outcome):
    """Where the page finds the first picture of a workflow."""
    return f'pictures/{outcome.pictures[0][0].name}'


def computed(place, names):
    """Outcomes by name, their pictures in `place`."""
    place.mkdir()
    with contextlib.redirect_stdout(io.StringIO()):
        return {name: run(name, place, quick=False) for name in names}


def escaped(text):
    """Text within a table: a bar would end the cell, a star begin emphasis."""
    return text.replace('|', '\\|').replace('*', '\\*')


def page(name, title, outcome, folder):
    """Pictures with captions, numbers, script."""
    parts = [f'# {title}\n', f'`magphonon reproduce {name}`\n']
    if outcome is not None:
        parts += [f'![{caption}](pictures/{file.name})\n\n{caption}\n' for file, caption in outcome.pictures]
        parts += ['## Numbers\n', '| quantity | here | reference | difference | allowed | verdict |', f'|{6 * "---|"}']
        parts += [f'| {" | ".join(map(escaped, check.cells))} |' for check in outcome.checks]
    parts += ['\n## Script\n', f'```{{literalinclude}} ../../../workflows/{name}.py\n:language: python\n```\n']
    return '\n'.join(parts)
