"""The report as a reader's browser sees it: links that lead somewhere, every row and picture, claims with sources, digits."""

import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import yaml

from magphonon.scenes.scene import reference as known
from workflows import neighbours
from workflows.chapters import CHAPTERS, CLAIMS, NAMES
from workflows.report import as_built, page, typeset
from workflows.rows import Check, Outcome, Picture, Reported, apart_in_words, number


@pytest.fixture
def outcomes(tmp_path):
    """Outcomes of all workflows, their rows at random, with the rows that the claims ask for."""
    rng, outcomes = np.random.default_rng(7), {}
    for chapter in CHAPTERS:
        signs, words = rng.choice(['<a>', 'a & b', "phi'", 'D0_xx', 'omega_y'], 3), rng.choice(['"x"', 'L0^2', '1e-09'], 3)
        names = [f'{sign} of row {k}, theta0 = {k} deg {word}' for k, (sign, word) in enumerate(zip(signs, words, strict=True))]
        checks = [Check(names[0], 1.0, 1.0 + 1e-6, 1e-3), Check(f'control: {names[1]}', 1.0, 2.0, 1e-3, control=True),
                  Reported(f'{names[2]}, alone', 1e-12)]
        for claim in CLAIMS:
            if claim.workflow == chapter.name:
                checks += [Check(name, 1.0, 1.0, 1e-9) for name in (claim.quantity, claim.without) if name]
        file = tmp_path / f'{chapter.name}.png'
        file.write_bytes(b'a picture')
        outcomes[chapter.name] = Outcome(checks, [Picture(file, f'A picture of {chapter.name} <b>. More of it.')])
    return outcomes


def plain(text):
    """Text as a reader sees it, without marks."""
    return unescape(re.sub('<[^>]*>', '', text))


def test_the_page_has_every_row_and_picture_and_its_links_lead_somewhere(tmp_path, outcomes):
    text = page(tmp_path / 'report.html', outcomes, ['today'])
    links = re.findall('<a [^>]*href="([^"]*)"', text)
    assert [link for link in links if link.startswith('#')] == [f'#{name}' for name in NAMES]
    assert {link for link in links if not link.startswith('#')} == {f'{name}.pdf' for name in NAMES}
    assert set(NAMES) <= set(re.findall(' id="([^"]*)"', text))
    rows = [plain(row) for row in re.findall('<tr[^>]*>\\s*<td[^>]*>(.*?)</td>', text, re.DOTALL)]
    expected = [plain(typeset(check.quantity)) for outcome in outcomes.values() for check in outcome.checks]
    assert len(rows) == len(expected) + len(CLAIMS)
    assert set(expected) <= set(rows)
    pictures = [unescape(alt) for alt in re.findall('<img [^>]*alt="([^"]*)"', text)]
    assert pictures == [f'A picture of {name} <b>' for name in NAMES]
    assert text.count('src="data:image/png;base64,') == len(NAMES)


def test_a_row_that_fails_is_marked_and_unfolds_its_table(tmp_path, outcomes):
    text = page(tmp_path / 'report.html', outcomes, ['today'])
    assert '<details open' not in text
    assert 'FAIL' not in text
    outcomes['walls'].checks.append(Check('wrong', 1.0, 2.0, 1e-3))
    text = page(tmp_path / 'report.html', outcomes, ['today'])
    assert text.count('<details open') == 1
    assert text.count('class="bad">FAIL') == 1


def test_every_claim_has_a_source_a_verdict_and_a_chapter(outcomes):
    told = [claim.judged(outcomes[claim.workflow]) for claim in CLAIMS]
    assert len(told) >= 12
    for words, here, reference, _, verdict, source in told:
        assert all((words, here, reference, source))
        assert verdict == ('consistent' if 'Fig. 8' in source else 'holds')  # its data are not published
    last = next(claim for claim in CLAIMS if claim.workflow == 'frf')
    checks = outcomes['frf'].checks
    checks[:] = [Check(last.quantity, 1.0, 3.0, 1e-3) if check.quantity == last.quantity else check for check in checks]
    assert last.judged(outcomes['frf'])[4] == 'fails'
    checks.clear()
    with pytest.raises(KeyError):
        last.judged(outcomes['frf'])


def test_the_lattice_as_built_shows_the_cancellation(tmp_path, outcomes):
    """The paper's model beside what it leaves out: shear at M nearly unchanged by all together, the cut-off and the rest not."""
    assert 'id="as-built"' not in page(tmp_path / 'report.html', outcomes, ['today'])
    outcomes['neighbours'].checks.extend(neighbours._as_built(known()['all_neighbours']))
    assert all(row.passed for row in outcomes['neighbours'].checks)
    told = {name: [float(re.search(r'\(([-+.0-9]+) %', cell)[1]) for cell in cells] for name, _, *cells in
            as_built(outcomes['neighbours'])}
    assert told['M, shear'] == [15.8, -11.5, 2.4]
    assert told['cut-off'] == [0.0, -11.2, -11.2]
    assert max(told['M, longitudinal'][2], told['K'][2]) < -8
    assert 'id="as-built"' in page(tmp_path / 'report.html', outcomes, ['today'])


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
