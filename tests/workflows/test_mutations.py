"""What the chapters notice of wrong physics is what the documentation says, and is what they must notice."""

import re
from pathlib import Path

import pytest

from workflows.mutations import MUTATED, as_markdown, table

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / 'docs/mutations.md').read_text(encoding='utf-8')
ROWS = dict(re.findall(r'^\| `(\w+)` \| (.*) \|$', PAGE, re.M))
BLIND = {'frf', 'bursts', 'claims', 'signs'}  # time steps alone, or motion along a chain, where D* has no part
FIGURES = 'frf', 'bursts', 'vibrometer'  # 2, 6 and 8
LONGER = {'frf', 'bursts', 'vibrometer', 'claims', 'stability', 'gyration', 'oscillator', 'matter', 'other_fields'}


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


@pytest.mark.parametrize('name', sorted(set(MUTATED) - BLIND))
def test_every_chapter_with_an_analytic_stiffness_sees_a_dstar_that_is_two_percent_wrong(name):
    assert cells(name)[0][0] > 0


@pytest.mark.parametrize('name', [pytest.param(name, marks=pytest.mark.long if name in LONGER else pytest.mark.slow)
                                  for name in MUTATED])
def test_the_page_is_what_a_run_finds(name, tmp_path):
    assert ROWS[name] in as_markdown(table([name], tmp_path))
