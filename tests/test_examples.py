"""Examples in docstrings and on pages of the site run and print what they say."""

import doctest
import inspect
from importlib import import_module
from pathlib import Path

import pytest

import magphonon

ROOT = Path(__file__).parents[1]
ROOMS = sorted(file.parent.name for file in Path(magphonon.__file__).parent.glob('*/__init__.pyi'))
FINDER = doctest.DocTestFinder(recurse=False)


def public(room):
    """Public callables of a room by name; plain values have no docstring of their own."""
    module = import_module(f'magphonon.{room}')
    return callables({name: getattr(module, name) for name in module.__all__})


def callables(found):
    """Functions and classes among named things; of what a cache wraps, the function."""
    found = {name: inspect.unwrap(thing) for name, thing in found.items()}
    return {name: thing for name, thing in found.items() if inspect.isfunction(thing) or inspect.isclass(thing)}


def run(test):
    told = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    runner.run(test, out=told.append)
    return ''.join(told)


@pytest.mark.parametrize('room', ROOMS)
def test_examples_of_docstrings(room):
    failures = ''
    for name, thing in public(room).items():
        for test in FINDER.find(thing, name, globs={}):
            failures += run(test)
    assert failures == ''


def test_the_example_of_the_front_door():
    [test] = FINDER.find(magphonon, 'magphonon', globs={})
    assert len(test.examples) > 4
    assert run(test) == ''


def test_every_name_of_the_front_door_has_an_example():
    named = callables({name: getattr(magphonon, name) for name in magphonon.__all__})
    assert len(named) > 15
    assert [name for name, thing in named.items() if '>>>' not in (inspect.getdoc(thing) or '')] == []


@pytest.mark.parametrize('page', sorted(file for file in (ROOT / 'docs').rglob('*.md')
                                        if not {'generated', '_build'} & set(file.parts) and '>>>' in file.read_text('utf-8')),
                         ids=lambda file: file.stem)
def test_examples_of_pages(page):
    test = doctest.DocTestParser().get_doctest(page.read_text(encoding='utf-8'), {}, page.name, str(page), 0)
    assert run(test) == ''


def test_a_wrong_example_fails():
    test = doctest.DocTestParser().get_doctest('>>> 1 + 1\n3\n', {}, 'wrong', None, 0)
    assert 'Got:\n    2' in run(test)
