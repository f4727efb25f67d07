"""The page of all keys of a scene, from the models that check them."""

import re
from itertools import groupby

from magphonon.scenes import scene_keys

HEAD = """# Keys of a scene

A scene is a TOML file with a title and tables. All numbers are in SI, with the unit in the name of the key. Unknown
keys and missing keys are refused; the message suggests the name that was probably meant, and lists all errors of the
scene at once. `magphonon scene --keys` prints this list, `magphonon scene --keys law` prints one table of it, and
`magphonon scene --keys spacing_m` one key. `magphonon scene prototype` prints a scene to start from. The examples are
taken from the ready scenes. Each table has a page of its own:

"""
ROW = '| {} | {} | {} | {} | {} |\n'
CHOICE = re.compile(r'(?:^|; (?:or )?)(\w+(?: or \w+)*): ')
"""The kinds that a description goes through, each before what it means."""


def write(folder):
    """A page for each table of a scene, and one that leads to them."""
    pages = {}
    for table, keys in groupby(scene_keys(), lambda key: key.table):
        keys = list(keys)
        pages[table] = ', '.join(f'`{key.name}`' for key in keys)
        text = [f'# {f"[{table}]" if table else "The scene itself"}\n\nKeys of {f"`[{table}]` in" if table else ""} a scene, the '
                f'file that describes a lattice; [all tables](keys.md).\n\n:::{{container}} keys\n\n',
                ROW.format('key', 'meaning and example', 'type', 'default', 'allowed'), ROW.format(*5 * ['---']),
                *map(row, keys), ':::\n']
        (folder / f'{name(table)}.md').write_text(''.join(text), encoding='utf-8')
    tour = '\n'.join(['', '```{toctree}', ':hidden:', '', *map(name, pages), '```', ''])
    rows = (f'- [{f"`[{table}]`" if table else "the scene itself"}]({name(table)}.md): {keys}\n' for table, keys in pages.items())
    (folder / 'keys.md').write_text(HEAD + ''.join(rows) + tour, encoding='utf-8')


def name(table):
    """The page of a table."""
    return f'keys_{table.replace(".", "_") or "scene"}'


def row(key):
    """One key."""
    told = [key.description[:1].upper() + key.description[1:]]
    if len(CHOICE.findall(key.description)) > 1:  # one below the other
        told = [CHOICE.sub(lambda kinds: f'<br>`{kinds[1].replace(" or ", "`, `")}`: ', key.description).removeprefix('<br>')]
    if key.kinds:
        told.append(f'Kind: {", ".join(key.kinds)}')
    text = '. '.join(part.rstrip('.') for part in told if part) + '.'
    kind = f'{key.type}, {key.unit}' if key.unit else key.type
    return ROW.format(f'`{key.name}`', cell(text) + (f' `{key.example}`' if key.example else ''), cell(kind), key.default,
                      cell(key.allowed))


def cell(text):
    """Text within a table: a bar would end the cell, a star begin emphasis, a bracket a link."""
    for sign in '|*[]':
        text = text.replace(sign, f'\\{sign}')
    return text
