"""The rows of all workflows: a table on the terminal, `summary.json`, and `report.html`, one page that needs no other file."""

import base64
import json
import os
import re
from collections import Counter
from dataclasses import asdict
from html import escape
from pathlib import Path

from magphonon import __version__
from magphonon.files import whole_file

from .chapters import CHAPTERS, CLAIMS, PAPER, PARTS
from .neighbours import AS_BUILT, EFFECTS, PLACES
from .rows import DPI, SOURCES, number

FOLDER = Path(__file__).parent
HEAD = ('quantity', 'here', 'reference', 'reference by', 'difference', 'allowed', 'verdict')
BUILT_HEAD = ('of the prototype (Hz)', *EFFECTS.values())
CLAIM_HEAD = ('the paper claims', 'here', 'reference', 'without D*', 'verdict', 'source of the reference')
SCREEN = 120
"""Pixels of a screen for an inch of a picture, so that all have letters of one size."""
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


def text_table(outcomes):
    """All rows as one table in plain text."""
    rows = [HEAD, *(check.cells for outcome in outcomes.values() for check in outcome.checks)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return '\n'.join('  '.join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows)


def counts(outcomes):
    """Number of rows that pass, by kind, and of those that fail: {'printed': ..., 'control': ..., 'FAIL': ...}."""
    checks = [check for outcome in outcomes.values() for check in outcome.checks]
    return Counter(check.kind if check.passed else 'FAIL' for check in checks)


def counted(outcomes):
    """One sentence that says how many rows of each kind pass, and how many fail."""
    count = counts(outcomes)
    return (f'References: {", ".join(f"{count[source]} {source}" for source in SOURCES)}. {count["control"]} wrong models '
            f'differ, as they must; {count["reported"]} numbers are reported without a reference; {count["FAIL"]} rows fail')


def write_summary(path, outcomes):
    """Every row with its verdict, as JSON."""
    def entry(check):
        judged = {} if check.kind == 'reported' else {'difference': check.difference}
        return asdict(check) | judged | {'kind': check.kind, 'passed': check.passed}

    with whole_file(path) as file:
        json.dump({name: [entry(check) for check in outcome.checks] for name, outcome in outcomes.items()}, file, indent=1,
                  default=float)  # NumPy's numbers


def write_html(path, outcomes, provenance):
    """Claims, pictures and tables in one file; lines of `provenance` say when, with what and on which machine they were made."""
    with whole_file(path) as file:
        file.write(page(path, outcomes, provenance))


def page(path, outcomes, provenance):
    """The text of `report.html`, which will be at `path`: its links lead to the files beside it."""
    from jinja2 import Environment, FileSystemLoader

    engine = Environment(loader=FileSystemLoader(FOLDER), autoescape=True, trim_blocks=True, lstrip_blocks=True)
    engine.filters['typeset'] = typeset
    engine.filters['embedded'] = embedded
    figures = {}  # running numbers, over all chapters
    for chapter in CHAPTERS:
        for picture in outcomes[chapter.name].pictures if chapter.name in outcomes else ():
            if not picture.caption.startswith('Fig'):  # that has the number of the paper
                figures[picture.file] = len(figures) + 1
    claims = [claim.judged(outcomes[claim.workflow]) for claim in CLAIMS if claim.workflow in outcomes]
    parts = [(key, title, [chapter for chapter in CHAPTERS if chapter.part == key and chapter.name in outcomes])
             for key, title in PARTS.items()]
    sources = path.resolve().parent if path.resolve().is_relative_to(FOLDER.parent) else None
    return engine.get_template('report_page.html').render(
        version=__version__, paper=PAPER, provenance=provenance, counted=counted(outcomes), head=HEAD, claim_head=CLAIM_HEAD,
        claims=claims, built_head=BUILT_HEAD, built=as_built(outcomes.get('neighbours')),
        scripts={name: (FOLDER / f'{name}.py').read_text(encoding='utf-8') for name in outcomes},
        parts=parts, outcomes=outcomes, figures=figures, folder=path.parent,
        sources=sources and Path(os.path.relpath(FOLDER, sources)).as_posix())


def as_built(outcome):
    """Rows of texts: the paper's model, and each effect that it omits with the change due to this effect."""
    found = {row.quantity: row.here for row in outcome.checks} if outcome is not None else {}
    table = []
    for name, *_ in PLACES if AS_BUILT.format('K', 'all') in found else ():
        paper, *others = (found[AS_BUILT.format(name, effect)] for effect in EFFECTS)
        percent = [round(100 * (one / paper - 1), 1) + 0.0 for one in others]  # 0.0 makes -0.0 positive
        table.append((name, number(paper, 4),
                      *(f'{number(one, 4)} ({share:+.1f} %)' for one, share in zip(others, percent, strict=True))))
    return table


def typeset(text):
    """Text of a table as HTML, with its symbols printed as in a book."""
    from markupsafe import Markup

    text = escape(text)
    for pattern, symbol in SYMBOLS.items():
        text = re.sub(pattern, symbol, text)
    return Markup(text)  # noqa: S704  escaped above


def embedded(picture):
    """The width on a screen and the data of a picture, for an `img` that needs no file."""
    pixels = picture.file.read_bytes()
    inches = int.from_bytes(pixels[16:20], 'big') / DPI  # the width stands in the first chunk of a PNG
    return round(inches * SCREEN), base64.b64encode(pixels).decode()
