"""The table on the terminal, `summary.json` and the self-contained `report.html`."""

import json
from collections import Counter
from dataclasses import asdict

from magphonon.files import whole_file

from .page import HEAD, page


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
            f'another method of it; {count["control"]} wrong models differ, as they must; {count["reported"]} numbers are '
            f'reported without a reference; {failed} rows fail')


def write_html(path, outcomes, provenance):
    """Claims, pictures and tables together in one file that needs no other."""
    text = page(path, outcomes, counted(outcomes), provenance)
    with whole_file(path) as file:
        file.write(text)
