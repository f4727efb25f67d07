"""The table on the terminal, `summary.json` and the self-contained `report.html`."""

import base64
import json
from collections import Counter
from dataclasses import asdict
from html import escape

from magphonon.files import whole_file

HEAD = ('quantity', 'here', 'reference', 'difference', 'tolerance', 'verdict')


def text_table(outcomes):
    """All checks as one table in plain text."""
    rows = [HEAD, *(check.cells for outcome in outcomes.values() for check in outcome.checks)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return '\n'.join('  '.join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows)


def write_summary(path, outcomes):
    """Every check with its verdict, as JSON."""
    summary = {name: [_row(check) for check in outcome.checks] for name, outcome in outcomes.items()}
    with whole_file(path) as file:
        json.dump(summary, file, indent=1, default=float)  # NumPy's numbers


def _row(check):
    judged = {} if check.kind == 'reported' else {'difference': check.difference}
    return asdict(check) | judged | {'kind': check.kind, 'passed': check.passed}


def counted(outcomes):
    """In words, how many rows of each kind pass, and how many fail."""
    checks = [check for outcome in outcomes.values() for check in outcome.checks]
    count = Counter(check.kind for check in checks if check.passed)
    failed = sum(not check.passed for check in checks)
    return (f'{count["reproduction"]} numbers agree with a reference from outside the package, {count["consistency"]} with '
            f'another road through it; {count["control"]} wrong models differ, as they must; {count["reported"]} numbers are '
            f'reported without a reference; {failed} rows fail')


def write_html(path, outcomes, titles):
    """Pictures and tables together in one file that needs no other."""
    parts = ['<!doctype html><meta charset="utf-8"><title>magphonon: the paper reproduced</title><style>'
             'body{font:16px/1.5 serif;max-width:60em;margin:2em auto}img{max-width:100%}'
             'table{border-collapse:collapse;font-size:13px}td,th{padding:.1em .7em;border-bottom:1px solid #ccc;text-align:left}'
             '.bad{background:#fdd;font-weight:bold}</style><h1>magphonon: the paper reproduced</h1>']
    parts.append(f'<p>{escape(counted(outcomes))}.</p>')
    for name, outcome in outcomes.items():
        parts.append(f'<h2>{escape(titles[name])}</h2>')
        for picture, caption in outcome.pictures:
            data = base64.b64encode(picture.read_bytes()).decode()
            parts.append(f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,{data}">'
                         f'<figcaption>{escape(caption)}</figcaption></figure>')
        parts.append('<table><tr>' + ''.join(f'<th>{h}</th>' for h in HEAD) + '</tr>')
        for check in outcome.checks:
            cells = ''.join(f'<td>{escape(cell)}</td>' for cell in check.cells)
            parts.append(f'<tr{"" if check.passed else " class=bad"}>{cells}</tr>')
        parts.append('</table>')
    with whole_file(path) as file:
        file.write('\n'.join(parts))
