"""The report as a reader's browser sees it: links that lead somewhere, every row and picture, claims with sources, digits."""

import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import yaml

from workflows.chapters import CHAPTERS, CLAIMS, NAMES
from workflows.report import page, typeset
from workflows.rows import Check, Outcome, Picture, Reported, apart_in_words, number

PIXEL = (b'\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR\x00\x00\x00\x01\x00\x00\x00\x01\x08\x00\x00\x00\x00:~\x9bU\x00\x00\x00\nIDATx\x9cc'
         b'\xf8\x0f\x00\x01\x01\x01\x00\x1b\xb6\xeeV\x00\x00\x00\x00IEND\xaeB`\x82')


class Page(HTMLParser):
    """Ids, links, rows of tables, pictures and what is folded."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.links, self.rows, self.pictures, self.open, self.folded = set(), [], [], [], [], set()
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.ids |= {attrs['id']} if 'id' in attrs else set()
        self.open += [tag] if tag in ('details', 'section') else []
        if tag == 'a':
            self.links.append(attrs['href'])
        elif tag == 'img':
            self.pictures.append(attrs)
        elif tag == 'tr':
            self.rows.append([])
        elif tag == 'td':
            self.rows[-1].append('')
            if 'details' in self.open:
                self.folded.add(len(self.rows) - 1)

    def handle_endtag(self, tag):
        if tag in ('details', 'section'):
            assert self.open.pop() == tag

    def handle_data(self, data):
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] += data.strip('\n')

    @property
    def broken(self):
        return [link for link in self.links if link.startswith('#') and link[1:] not in self.ids]


def drawn(rng, folder):
    """Outcomes of some workflows, their rows at random, with the rows that the claims ask for."""
    outcomes = {}
    for chapter in CHAPTERS:
        signs, words = rng.choice(['<a>', 'a & b', "phi'", 'D0_xx', 'omega_y'], 5), rng.choice(['"x"', 'L0^2', '1e-09'], 5)
        names = [f'{sign} of row {k}, theta0 = {k} deg {word}' for k, (sign, word) in enumerate(zip(signs, words, strict=True))]
        here = rng.normal(size=5) * 10.0 ** rng.integers(-12, 6, 5)
        checks = [Check(name, x, x * (1 + 1e-6 * rng.normal()), 1e-3) for name, x in zip(names, here, strict=True)]
        checks.append(Check(f'control: {names[0]}', here[0], 2 * here[0], 1e-3, control=True))
        checks.append(Reported(f'{names[1]}, alone', here[1]))
        for claim in CLAIMS:
            if claim.workflow == chapter.name:
                checks += [Check(name, 1.0, 1.0, 1e-9) for name in (claim.quantity, claim.without) if name]
        file = folder / f'{chapter.name}.png'
        file.write_bytes(PIXEL)
        outcomes[chapter.name] = Outcome(checks, [Picture(file, f'A picture of {chapter.name} <b>. More of it.')])
    return outcomes


@pytest.fixture
def outcomes(tmp_path):
    return drawn(np.random.default_rng(7), tmp_path)


def plain(text):
    """Text as a reader sees it, without marks."""
    return unescape(re.sub('<[^>]*>', '', typeset(text)))


def test_links_lead_somewhere_and_every_chapter_is_in_the_contents(tmp_path, outcomes):
    text = page(tmp_path / 'report.html', outcomes, ['today'])
    read = Page(text)
    assert read.broken == []
    assert [link[1:] for link in read.links if link.startswith('#')] == list(NAMES)
    assert {link for link in read.links if not link.startswith('#')} == {f'{name}.pdf' for name in NAMES}
    assert Page(text.replace('id="frf"', 'id="frg"')).broken == ['#frf']  # the control


def test_every_row_and_every_picture_appears_once(tmp_path, outcomes):
    read = Page(page(tmp_path / 'report.html', outcomes, ['today']))
    shown = [row[0] for row in read.rows if row]
    for outcome in outcomes.values():
        for check in outcome.checks:
            assert shown.count(plain(check.quantity)) >= 1, check.quantity
    rows = sum(len(outcome.checks) for outcome in outcomes.values()) + len(CLAIMS)
    assert len(shown) == rows
    assert [picture['alt'] for picture in read.pictures] == [f'A picture of {name} <b>' for name in NAMES]
    assert all(picture['src'].startswith('data:image/png;base64,') for picture in read.pictures)


def test_wrong_models_and_tests_of_the_package_are_folded(tmp_path, outcomes):
    read = Page(page(tmp_path / 'report.html', outcomes, ['today']))
    folded = {row[0] for k, row in enumerate(read.rows) if k in read.folded}
    for chapter in CHAPTERS:
        for check in outcomes[chapter.name].checks:
            if check.kind == 'control' or chapter.part == 'tests':
                assert plain(check.quantity) in folded
    assert not any(plain(claim.words) in folded for claim in CLAIMS)


def test_a_row_that_fails_is_marked_and_unfolds_its_table(tmp_path, outcomes):
    text = page(tmp_path / 'report.html', outcomes, ['today'])
    assert '<details open' not in text
    assert 'FAIL' not in text
    outcomes['design'].checks.append(Check('wrong', 1.0, 2.0, 1e-3))
    text = page(tmp_path / 'report.html', outcomes, ['today'])
    assert text.count('<details open') == 1
    assert text.count('class="bad">FAIL') == 1


def test_every_claim_has_a_source_a_verdict_and_a_chapter(outcomes):
    told = [claim.judged(outcomes[claim.workflow]) for claim in CLAIMS]
    assert len(told) >= 12
    for words, here, reference, _, verdict, source in told:
        assert all((words, here, reference, source))
        assert verdict == 'holds'
    last = next(claim for claim in CLAIMS if claim.workflow == 'frf')
    checks = outcomes['frf'].checks
    checks[:] = [Check(last.quantity, 1.0, 3.0, 1e-3) if check.quantity == last.quantity else check for check in checks]
    assert last.judged(outcomes['frf'])[4] == 'fails'
    checks.clear()
    with pytest.raises(KeyError):
        last.judged(outcomes['frf'])


def test_the_paper_is_cited_as_in_the_citation_file(tmp_path, outcomes):
    """Its authors were once cited by a wrong first name."""
    cited = yaml.safe_load((Path(__file__).parents[2] / 'CITATION.cff').read_text(encoding='utf-8'))['references'][0]
    authors = ' and '.join(f'{author["given-names"]} {author["family-names"]}' for author in cited['authors'])
    here = f'{authors}, <cite>{cited["title"]}</cite>, {cited["identifiers"][0]["value"]}'
    assert here in page(tmp_path / 'report.html', outcomes, ['today'])


@pytest.mark.parametrize('seed', range(3))
def test_digits_say_no_more_and_no_less_than_the_number(seed):
    rng = np.random.default_rng(seed)
    for x in rng.normal(size=50) * 10.0 ** rng.integers(-30, 12, 50):
        mantissa = re.sub(r'e.*|[-.]', '', number(x)).lstrip('0')
        assert len(mantissa) <= (1 if abs(x) < 1e-9 else 6) or float(number(x)) == int(float(number(x)))
        assert float(number(x)) == pytest.approx(x, rel=0.51 if abs(x) < 1e-9 else 5e-6)
        apart = abs(rng.normal()) * 10.0 ** rng.integers(-15, -3)
        digits = int(re.search(r'\d+', apart_in_words(apart))[0]) if apart < 1e-3 else 0
        assert 10.0 ** -(digits + 1) < apart <= 10.0 ** -digits or digits == 15
