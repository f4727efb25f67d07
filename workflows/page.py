"""The report as one page of HTML that needs no other file: claims, contents, chapters."""

import base64
import os
import re
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from magphonon import __version__

from .chapters import CHAPTERS, PARTS
from .checks import DPI
from .paper import judged

SOURCES = Path(__file__).parent
HEAD = ('quantity', 'here', 'reference', 'difference', 'allowed', 'verdict')
SCREEN = 120
"""Pixels of a screen for an inch of a picture, so that all have letters of one size."""
CLAIM_HEAD = ('the paper claims', 'here', 'reference', 'without D*', 'verdict', 'source of the reference')
LOOKS = {'holds': 'good', 'fails': 'bad', 'FAIL': 'bad', 'not reproduced': 'open'}
"""Style of a verdict; those that are missing have none."""
SYMBOLS = {  # as they are in the tables of the terminal: as they are printed
    r'Gamma-([MK])\b': r'Γ&ndash;\1', r'\bGamma\b': 'Γ', r'theta0': 'θ₀', r'\btheta\b': 'θ', r'\bomega': 'ω',
    r'\bkappa\b': 'κ', r'\bzeta\b': 'ζ', r'\bsigma\b': '&sigma;', r'\bxi\b': 'ξ', r'\bpi\b': 'π', r'\bchi2\b': 'χ²',
    r'\bphi&#x27;': 'φ&prime;', r'\bphi&quot;': 'φ&Prime;', r'\bD0_(\w+)': r'D⁰<sub>\1</sub>', r'\bD0': 'D⁰', r'\bL0\b': 'L₀',
    r'\bsqrt\b': '√', r'\bum\b': 'µm', r'\bcm3\b': 'cm³', r'(?<=\d) deg\b': '°',
    r'\b([cDKMSω])_(\w+)': r'\1<sub>\2</sub>', r'\^(-?\d+|[a-z]\b)': r'<sup>\1</sup>',
    r'\b([\d.]+)e\+?(-?)0*(\d+)\b': r'\1&thinsp;&times;&thinsp;10<sup>\2\3</sup>',
    r'(?<![\w-])-(?=\d)': '&minus;',
}
"""Regular expressions, for text that is escaped already."""


@dataclass
class Numbers:
    """Running numbers of the chapters and of the pictures."""

    chapter: int = 0
    figure: int = 0
    contents: list = field(default_factory=list)


def typeset(text):
    """Text of a table as HTML, with its symbols printed as in a book."""
    text = escape(text)
    for pattern, symbol in SYMBOLS.items():
        text = re.sub(pattern, symbol, text)
    return text


def page(out, outcomes, counted, provenance):
    """The whole page.

    Parameters
    ----------
    out : Path
        Where it will be, for links to files beside it.
    outcomes : dict of str to Outcome
    counted : str
        How many rows pass, in words.
    provenance : list of str
        When, with what, on which machine.
    """
    numbers = Numbers()
    parts = [part(out, key, outcomes, numbers) for key in PARTS]
    return Template((files(__package__) / 'report_page.html').read_text(encoding='utf-8')).substitute(
        version=escape(__version__), provenance='<br>'.join(map(escape, provenance)), counted=escape(counted),
        claims=table(CLAIM_HEAD, judged(outcomes), 4), contents='\n'.join(numbers.contents), parts='\n'.join(parts))


def part(out, key, outcomes, numbers):
    """A part of the report: its chapters that were run."""
    own = [chapter for chapter in CHAPTERS if chapter.part == key and chapter.name in outcomes]
    if not own:
        return ''
    numbers.contents.append(f'<strong>{PARTS[key]}</strong>\n<ul>')
    sections = [section(out, chapter, outcomes[chapter.name], numbers) for chapter in own]
    numbers.contents.append('</ul>')
    return f'<h2 id="{key}">{PARTS[key]}</h2>\n' + '\n'.join(sections)


def section(out, chapter, outcome, numbers):
    """A chapter: pictures, then numbers; wrong models and cross-checks folded, and all of it in the tests of the package."""
    numbers.chapter += 1
    title = f'{numbers.chapter}. {typeset(chapter.title)}'
    numbers.contents.append(f'<li><a href="#{chapter.name}">{title}</a></li>')
    pictures = ''.join(figure(out, chapter, picture, numbers) for picture in outcome.pictures)
    shown = [check for check in outcome.checks if check.kind in ('reproduction', 'reported')]
    rest = [check for check in outcome.checks if check not in shown]
    body = pictures + rows_of(shown, folded=chapter.part != 'paper', what='numbers')
    body += rows_of(rest, folded=True, what='wrong models and cross-checks')
    if chapter.part == 'tests':
        passed = all(check.passed for check in outcome.checks)
        body = f'<details{"" if passed else " open"}><summary>pictures and numbers</summary>\n{body}</details>'
    paper = f'Reproduces {chapter.figures} of the paper. ' if chapter.figures else ''
    note = f'{paper}References: {chapter.references}. Script: {script(out, chapter.name)}; run it alone with ' \
           f'<code>magphonon reproduce {chapter.name}</code>.'
    return f'<section id="{chapter.name}">\n<h3>{title}</h3>\n<p class="note">{note}</p>\n{body}</section>'


def rows_of(checks, folded, what):
    """A table of checks, folded under a line that counts them; open where one fails."""
    if not checks:
        return ''
    rows = table(HEAD, [check.cells for check in checks], 5)
    if not folded:
        return rows
    failed = sum(not check.passed for check in checks)
    told = f'{failed} of {len(checks)} fail' if failed else f'all {len(checks)} pass' if len(checks) > 1 else 'it passes'
    return f'<details{" open" if failed else ""}><summary>{what}: {told}</summary>\n{rows}</details>'


def table(head, rows, verdict):
    """A table; `verdict` is the column whose words have a colour."""
    lines = ['<table><thead><tr>' + ''.join(f'<th>{typeset(name)}</th>' for name in head) + '</tr></thead><tbody>']
    for row in rows:
        cells = []
        for k, (name, cell) in enumerate(zip(head, row, strict=True)):
            look = f' class="{LOOKS.get(cell, "good")}"' if k == verdict else ' class="figure"' if 0 < k < verdict else ''
            cells.append(f'<td data-label="{escape(name)}"{look}>{typeset(cell)}</td>')
        lines.append(f'<tr>{"".join(cells)}</tr>')
    return '\n'.join([*lines, '</tbody></table>\n'])


def figure(out, chapter, picture, numbers):
    """A picture with its caption; the picture is within the page, the same for print is linked where it lies beside."""
    numbers.figure += 1
    pixels = picture.file.read_bytes()
    inches = int.from_bytes(pixels[16:20], 'big') / DPI  # the width stands in the first chunk of a PNG
    data = base64.b64encode(pixels).decode()
    words = escape(picture.caption.partition('. ')[0].rstrip('.'))
    drawn = picture.file.with_suffix('.pdf')
    print_file = f', <a href="{drawn.name}">{drawn.name}</a>' if drawn.parent == out.parent else ''
    image = f'<img alt="{words}" width="{inches * SCREEN:.0f}" src="data:image/png;base64,{data}">'
    return (f'<figure id="{picture.file.stem}">{image}'
            f'<figcaption><strong>Figure {numbers.figure}.</strong> {typeset(picture.caption)} '
            f'<span class="note">Drawn by {script(out, chapter.name)}{print_file}</span></figcaption></figure>\n')


def script(out, name):
    """The source file of a workflow: a link where the report lies in the sources, or its place in them."""
    file = SOURCES / f'{name}.py'
    place = f'workflows/{name}.py'
    if out.resolve().is_relative_to(SOURCES.parent):
        return f'<a href="{Path(os.path.relpath(file, out.resolve().parent)).as_posix()}">{place}</a>'
    return f'<code>{place}</code>'
