"""Sentences that count the evidence say what a run of `magphonon reproduce` counts."""

import json
import re
from collections import Counter
from pathlib import Path

import pytest

from workflows.__main__ import main

ROOT = Path(__file__).parents[2]
SENTENCE = re.compile(
    r'(\d+) are printed in a publication, (\d+) come from open code or data, (\d+) are closed forms derived here, '
    r'(\d+) come from another method of the package, and (\d+) are quoted from memory; (\d+) wrong models differ')
KINDS = 'printed', 'open code or data', 'closed form', 'two methods', 'memory', 'control'
COUNTING = re.compile(r'\b\d+ (?:of \d+ )?(?:\w+ )?(?:numbers|references|controls|wrong models|publications)\b')


def text(file):
    """The words of a page; of the changelog, those of the newest version."""
    words = (ROOT / file).read_text(encoding='utf-8')
    if file == 'CHANGELOG.md':
        words = words[:words.index('\n## ', words.index('\n## ') + 1)]
    return ' '.join(words.split())


@pytest.mark.parametrize('file', ['README.md', 'CHANGELOG.md', 'paper/paper.md', 'docs/index.md', 'docs/measured.md',
                                  'docs/paper.md', 'docs/theory/dstar.md'])
def test_no_other_sentence_counts_evidence(file):
    assert COUNTING.findall(SENTENCE.sub('', text(file))) == []


@pytest.mark.long
def test_the_sentences_have_the_numbers_of_a_run(tmp_path):
    assert main(['-o', str(tmp_path)]) == 0
    rows = [row for found in json.loads((tmp_path / 'summary.json').read_text()).values() for row in found]
    counted = Counter(row['kind'] for row in rows)
    assert counted['printed'] + counted['open code or data'] >= 40
    for file in ('paper/paper.md', 'docs/measured.md'):
        (said,) = SENTENCE.findall(text(file))
        assert [int(number) for number in said] == [counted[kind] for kind in KINDS]
