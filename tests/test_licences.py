"""The table of licences knows every dependency."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_every_dependency_has_its_licence_in_the_table():
    project = tomllib.loads((ROOT / 'pyproject.toml').read_text())['project']
    declared = [*project['dependencies'], *(line for extra in project['optional-dependencies'].values() for line in extra)]
    rows = [line.split(' | ') for line in (ROOT / 'docs' / 'licences.md').read_text().splitlines() if line.startswith('| ')][1:]
    known = {name.removeprefix('| '): licence for name, licence, _ in rows}
    for line in declared:
        if line.startswith('magphonon['):  # the extra of other extras
            continue
        name = re.match(r'[\w-]+', line)[0].lower().replace('_', '-')
        assert known[name] not in ('', 'not stated'), f'{name}: run .ci/licences.py with all extras installed'
    assert 'LGPL' in known['ase']
    assert 'MPL' in known['tqdm']
