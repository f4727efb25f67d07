"""A page for each public name, a list of them for each room of the package, and one for the names of `magphonon` itself.

A result that no room exports is shown on the page of the function that returns it.
"""

import inspect
import re
import sys
from importlib import import_module
from pathlib import Path

import magphonon

TITLES = {
    'interactions': 'Pair laws, magnets, fits of measured forces',
    'lattices': 'Cells, patches, bonds',
    'stiffness': 'Stiffness D⁰ + D*, calculators, relaxation',
    'bands': 'Bands, velocities, evanescent waves, phonopy',
    'dynamics': 'Time steps: drives, engines, recorder',
    'response': 'Linear answers without time steps',
    'waves': 'Tone bursts, spectra, ridges',
    'stability': 'Buckling, range of linear motion',
    'plotting': 'Pictures',
    'design': 'Sensitivities, uncertainty, fits, designs',
    'scenes': 'Scene files',
}
"""Rooms in the order of the page, from the ground up; a room that is not named here comes last."""


def rooms():
    """Names of all rooms that export something."""
    found = {file.parent.name for file in Path(magphonon.__file__).parent.glob('*/__init__.pyi')}
    return [*(name for name in TITLES if name in found), *sorted(found - TITLES.keys())]


def write(folder):
    """The pages in reStructuredText."""
    contents = '\n   '.join(rooms())
    (folder / 'index.rst').write_text(INDEX.format(contents=contents, front=front_door()), encoding='utf-8')
    for room in rooms():
        (folder / f'{room}.rst').write_text(page(room), encoding='utf-8')
        for name in public(room):
            (folder / f'{room}.{name}.rst').write_text(page_of(room, name), encoding='utf-8')


def heading(text, line='='):
    """A heading of reStructuredText."""
    return f'{text}\n{len(text) * line}\n'


def front_door():
    """The names of `magphonon` itself, each with a link to the page of its room."""
    where = {name: room for room in rooms() for name in import_module(f'magphonon.{room}').__all__}
    lines = []
    for name in magphonon.__all__:
        if name in where and not inspect.ismodule(getattr(magphonon, name)):
            told = summary(getattr(magphonon, name))
            lines.append(f'* :py:obj:`~magphonon.{where[name]}.{name}`: {told}')
    return '\n'.join(lines)


def summary(thing):
    """First sentence of a docstring, its code marked for reStructuredText."""
    told = inspect.getdoc(thing) if callable(thing) else None  # a plain value shows the docstring of its type
    first = ' '.join((told or '').partition('\n\n')[0].split())
    pieces = first.split('`')  # every second one is code, within which nothing needs an escape
    return '``'.join(piece if k % 2 else escaped(piece.replace('*', r'\*')) for k, piece in enumerate(pieces))


def escaped(text):
    """Bars escaped, which stand for absolute values here and not for substitutions of reStructuredText."""
    return text.replace('|', '\\|')


def escape_docstring(app, what, name, thing, options, lines):
    """For Sphinx's event: the same in every docstring, but for what stands as code."""
    lines[:] = [line if '``' in line or '>>>' in line else escaped(line) for line in lines]


def public(room):
    """The names that a room exports, without its modules."""
    module = import_module(f'magphonon.{room}')
    return [name for name in module.__all__ if not inspect.ismodule(getattr(module, name))]


def page(room):
    """One room: its docstring and a list of its names, each of which has a page of its own."""
    module, names = import_module(f'magphonon.{room}'), public(room)
    contents = '\n   '.join(f'{name} <{room}.{name}>' for name in names)
    return '\n'.join([
        heading(f'magphonon.{room}'), TITLES.get(room, '') + '.' * (room in TITLES), '',
        f'.. automodule:: magphonon.{room}', '   :no-members:', '',
        *(f'* :py:obj:`~magphonon.{room}.{name}`: {summary(getattr(module, name))}' for name in names), '',
        '.. toctree::', '   :hidden:', '', f'   {contents}', ''])


def results_of(function):
    """The classes of the results of a function that no room exports, and those that their docstrings name in brackets."""
    known, said = vars(sys.modules[function.__module__]), str(function.__annotations__.get('return'))
    words = re.findall(r'\w+', said)
    words += [inner for word in words for inner in re.findall(r'\((\w+)\)', getattr(known.get(word), '__doc__', None) or '')]
    found = [known[word] for word in dict.fromkeys(words) if inspect.isclass(known.get(word))]
    exported = {name for room in rooms() for name in public(room)}
    return [one for one in found if one.__module__.startswith('magphonon.') and one.__name__ not in exported]


def page_of(room, name):
    """One name in full, the classes of its results, and the tutorials and examples of the gallery that use it."""
    thing = getattr(import_module(f'magphonon.{room}'), name)
    results = results_of(thing) if inspect.isfunction(thing) else []
    kind = 'autoclass' if inspect.isclass(thing) else 'autofunction' if callable(thing) else 'autodata'
    examples = f'magphonon.{name}' if name in magphonon.__all__ else f'magphonon.{room}.{name}'  # as sphinx-gallery lists them
    shown = ''.join(f'\n.. autoclass:: {one.__module__}.{one.__name__}\n   :members:\n   :no-index:\n' for one in results)
    return (f'{heading(name)}\n.. {kind}:: magphonon.{room}.{name}\n' + '   :members:\n' * (kind == 'autoclass') + shown
            + f'\n.. minigallery:: {examples}\n   :add-heading: Examples\n   :heading-level: -\n')


INDEX = """
API
===

Scripts import what they need from ``magphonon``; every other name is imported from its own package, such as
``magphonon.bands.band_gaps``.  Names are loaded when they are first used, so that ``import magphonon`` takes a moment only.
Lengths, masses and times are in mm, g and ms: see :doc:`/reference/units`.

.. toctree::
   :maxdepth: 1

   {contents}

Names in ``magphonon``
----------------------

{front}
"""
