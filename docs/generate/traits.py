"""The page of what each tool takes, from the declarations that refuse the rest."""

from importlib import import_module

from magphonon.traits import TOOLS, TRAITS, caller

from . import api

HEAD = """# Which tool takes what

A structure may have more than masses, bonds and springs. Each tool declares which of these it supports, and refuses
the rest: its message names the trait, the tools that support it, and what to do instead. The tables are made from these
declarations (`magphonon/traits.py`). If a tool of your own calls `LinearSystem.of(atoms)`, structures with {refused} raise
an error there, unless the tool declares these traits with `magphonon.traits.takes`.

| trait | a structure with it has |
|---|---|
"""
LEFT_OUT = """
ASE's own dynamics and optimisers cannot be refused, and see forces alone: they ignore gyration.
"""


def loaded():
    """All tools by room: those of rooms that nobody has asked for are declared as soon as these are."""
    for room in api.rooms():
        for name in api.public(room):
            getattr(import_module(f'magphonon.{room}'), name)
    rooms = {}
    for tool in sorted(TOOLS.values(), key=lambda one: one.name.lower()):
        rooms.setdefault(tool.module.split('.')[1], []).append(tool)
    return dict(sorted(rooms.items()))


def write(folder):
    """One page, with a table for each room."""
    (folder / 'tools.md').write_text(page(loaded()), encoding='utf-8')


def page(rooms):
    """The page for tools by room."""
    parts = [HEAD.format(refused=' and '.join(name for name in TRAITS if name not in caller().takes))]
    parts += [f'| {one.name} | {one.words} |\n' for one in TRAITS.values()]
    for room, tools in rooms.items():
        parts += [f'\n## {room}\n\n| tool | {" | ".join(TRAITS)} |\n|---|{"---|" * len(TRAITS)}\n']
        parts += [f'| `{tool.name}` | {" | ".join("yes" if name in tool.takes else "" for name in TRAITS)} |\n' for tool in tools]
    return ''.join([*parts, LEFT_OUT])
