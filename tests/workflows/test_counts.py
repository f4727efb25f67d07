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
    r'and (\d+) come from another method of the package; (\d+) wrong models differ')
KINDS = 'printed', 'open code or data', 'closed form', 'two methods', 'control'
NO_PART = ('oscillator D0_', 'oscillator D_yy',  # D0 itself, and along bonds in one line
           'ions in a trap: ', 'ions of two masses: five ions',  # along the axis, where all bonds lie
           'tensegrities: T-bar, frequency 8',  # stretches a bar and bends nothing
           'Wigner crystal, energy', 'Yukawa crystals change', 'oblique cuboids', 'ring: mass')  # energies, forces and a mass
"""Numbers of others that D0 alone gives as well."""
CITED = {'1911.10410': 'jiao2020', 'magcode': 'robertson2011', 'Akoun': 'akoun1984', 'magpylib': 'magpylib',
         'Phys. Rev. A 103': 'sosnova2021', 'Bonsall': 'bonsall1977', 'Hamaguchi': 'hamaguchi1997',
         'IonSim.jl': 'ionsim', 'TsgFEM': 'tsgfem', 'matscipy': 'matscipy', 'ASE': 'ase'}
"""Words in the names of sources: entries of the bibliography."""
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


def test_who_is_counted_is_cited():
    sources = [source for file in (ROOT / 'workflows').glob('*.py')
               for source in re.findall(r"f?'(?:printed|open code or data): ([^']+)'", file.read_text(encoding='utf-8'))]
    bibliography, paper = ((ROOT / 'paper' / name).read_text(encoding='utf-8') for name in ('paper.bib', 'paper.md'))
    assert len(sources) >= 10
    for source in sources:
        key = next(key for word, key in CITED.items() if word in source)
        assert f'{{{key},' in bibliography
        assert f'@{key}' in paper


@pytest.fixture(scope='module')
def rows(tmp_path_factory):
    """All rows of a run."""
    out = tmp_path_factory.mktemp('out')
    assert main(['-o', str(out)]) == 0
    return [row for found in json.loads((out / 'summary.json').read_text()).values() for row in found]


@pytest.mark.long
def test_every_number_of_others_has_its_control_unless_dstar_has_no_part_in_it(rows):
    of_others = [row['quantity'] for row in rows if row['kind'] in ('printed', 'open code or data')]
    controls = {row['quantity']: row['control'] for row in rows if row.get('control')}
    alone = [quantity for quantity in of_others if controls.get(f'control: D0 alone, {quantity}') == 'D0']
    forces = [quantity for quantity in of_others if f'control: point dipoles, {quantity}' in controls]
    assert len(alone) >= 40
    assert set(of_others) - {*alone, *forces} == {quantity for quantity in of_others if quantity.startswith(NO_PART)}


@pytest.mark.long
def test_the_sentences_have_the_numbers_of_a_run(rows):
    counted = Counter(row['kind'] for row in rows)
    for file in ('paper/paper.md', 'docs/measured.md'):
        (said,) = SENTENCE.findall(text(file))
        assert [int(number) for number in said] == [counted[kind] for kind in KINDS]


@pytest.mark.long
@pytest.mark.parametrize(('quantity', 'sentence'), [
    (r'\w+ burst, \w+ simulation: distance to its own branch \(bins\)', 'ridges of tone bursts.*?{} off the branch'),
    (r'control: transverse burst, .*: distance to the \w+ branch \(bins\)', 'shear ridges are {} off the branch'),
    (r'vibrometer \d+ Hz, .*: distance to its own shear branch', 'of the virtual vibrometer.*?{} off the branch of their own'),
    (r'control: vibrometer \d+ Hz, .*: distance to the \w+ shear branch', '{} off the branch of the other model \\|'),
    ('frf amplitude, error against the closed form', 'the amplitude differs by {} over'),
])
def test_measured_ranges_are_those_of_a_run(rows, quantity, sentence):
    found = [row['here'] for row in rows if re.match(quantity, row['quantity'])]
    told = re.findall(sentence.format(r'([\d.e-]+) to ([\d.e-]+)'), text('docs/measured.md'))[-1]
    assert list(map(float, told)) == pytest.approx([min(found), max(found)], rel=0.1)  # rounded to one or two digits
