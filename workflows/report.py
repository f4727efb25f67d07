"""The table on the terminal, `summary.json` and the self-contained `report.html`."""

import base64
import json
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
    summary = {name: [{'quantity': c.quantity, 'here': float(c.here), 'reference': float(c.reference), 'difference': c.difference,
                       'tolerance': c.tolerance, 'control': c.control, 'passed': c.passed} for c in outcome.checks]
               for name, outcome in outcomes.items()}
    with whole_file(path) as file:
        json.dump(summary, file, indent=1)


def write_html(path, outcomes, titles):
    """Pictures and tables together in one file that needs no other."""
    parts = ['<!doctype html><meta charset="utf-8"><title>magphonon: the paper reproduced</title><style>'
             'body{font:16px/1.5 serif;max-width:60em;margin:2em auto}img{max-width:100%}'
             'table{border-collapse:collapse;font-size:13px}td,th{padding:.1em .7em;border-bottom:1px solid #ccc;text-align:left}'
             '.bad{background:#fdd;font-weight:bold}</style><h1>magphonon: the paper reproduced</h1>']
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
