"""What the chapters notice of wrong physics is what the documentation says, and is what they must notice."""

import ast
import re
from pathlib import Path

import pytest

from magphonon.interactions import UprightMagnets
from magphonon.stiffness import PairCalculator, all_neighbours
from magphonon.stiffness.matrices import Central
from workflows import other_fields
from workflows.mutations import MUTATED, as_markdown, no_d0, table, weak_dstar

ROOT = Path(__file__).parents[2]
WORKFLOWS = sorted((ROOT / 'workflows').glob('*.py'))
PAGE = (ROOT / 'docs/mutations.md').read_text(encoding='utf-8')
ROWS = dict(re.findall(r'^\| `(\w+)` \| (.*) \|$', PAGE, re.M))
FIGURES = 'frf', 'bursts', 'vibrometer'  # 2, 6 and 8
LONGER = {'frf', 'bursts', 'vibrometer', 'claims', 'stability', 'gyration', 'oscillator', 'matter', 'other_fields',
          'nonlinearity', 'ideal_bands'}


CHEAP = (other_fields._ions_of_two_masses, other_fields._tensegrities, other_fields._strings, other_fields._honeycombs,
         other_fields._stressed_lattice, other_fields._mixture)


@pytest.fixture
def mutated(monkeypatch):
    """Puts wrong physics into the package, which the end of the test takes out again."""
    for owner, name in ((Central, 'stiffness'), (UprightMagnets, 'stiffness'), (PairCalculator, 'set'),
                        *((all_neighbours.AllNeighbours, name) for name in ('bloch_matrix', 'bloch_series', 'singular'))):
        monkeypatch.setattr(owner, name, getattr(owner, name))
    monkeypatch.setitem(all_neighbours.PART, 'conventional', all_neighbours.PART['conventional'])
    return lambda mutation: (mutation(), [row.checks for field in CHEAP for row in field()])[1]


def test_controls_of_other_fields_fail_if_d0_is_the_complete_model(mutated):
    controls = [checks[1] for checks in mutated(no_d0) if len(checks) > 1]
    assert len(controls) >= 40
    assert [control.quantity for control in controls if control.passed] == []


def test_rows_of_other_fields_fail_with_a_dstar_that_is_two_percent_wrong_and_those_without_control_do_not(mutated):
    for own, *control in mutated(weak_dstar):
        assert own.passed is not bool(control), own.quantity


def test_no_control_is_a_typed_number():
    """What a control compares is computed: it is made of more than literals and constants of a module."""
    found = 0
    for file in WORKFLOWS:
        for call in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            name = getattr(call.func, 'attr', getattr(call.func, 'id', '')) if isinstance(call, ast.Call) else ''
            if name == 'against' or (name == 'Check' and any(word.arg == 'control' for word in call.keywords)):
                here = call.args[0 if name == 'against' else 1]
                names = [part.id for part in ast.walk(here) if isinstance(part, ast.Name)]
                assert not all(map(str.isupper, names)), f'{file.name}:{call.lineno}'
                found += 1
    assert found >= 40


def cells(name):
    """(failed, all) of the four columns of the page, None for an empty one."""
    found = [re.match(r'(\d+) of (\d+)', cell.strip()) for cell in ROWS[name].split('|')]
    return [tuple(map(int, one.groups())) if one else None for one in found]


def test_the_page_has_every_chapter_that_has_a_stiffness():
    assert set(ROWS) == set(MUTATED)


@pytest.mark.parametrize('name', MUTATED)
def test_every_control_with_d0_fails_if_d0_is_the_complete_model(name):
    failed, every = cells(name)[3] or (0, 0)
    assert failed == every


@pytest.mark.parametrize('name', FIGURES)
def test_a_force_that_is_ten_percent_wrong_fails_all_outside_references_of_the_figures(name):
    failed, every = cells(name)[2]
    assert failed == every > 0


@pytest.mark.parametrize('name', MUTATED)
def test_every_chapter_with_an_analytic_stiffness_sees_a_dstar_that_is_two_percent_wrong(name):
    assert cells(name)[0][0] > 0


@pytest.mark.parametrize('name', [pytest.param(name, marks=pytest.mark.long if name in LONGER else pytest.mark.slow)
                                  for name in MUTATED])
def test_the_page_is_what_a_run_finds(name, tmp_path):
    assert ROWS[name] in as_markdown(table([name], tmp_path))
