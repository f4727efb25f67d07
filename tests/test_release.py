"""What archives, indexes and journals are told is what pyproject.toml, LICENSE and the package say; the paper keeps its form."""

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import magphonon

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / 'pyproject.toml').read_text(encoding='utf-8'))['project']
yaml = pytest.importorskip('yaml')  # comes with phonopy


def told(name):
    text = (ROOT / name).read_text(encoding='utf-8')
    return json.loads(text) if name.endswith('json') else yaml.safe_load(text)


def full_name(author):
    """Of a group, or of a person in any of the three forms."""
    names = author.get('given-names', author.get('givenName')), author.get('family-names', author.get('familyName'))
    return ' '.join(names) if all(names) else ' '.join(author['name'].split(', ')[::-1])


def test_one_version_licence_description_and_author():
    cff, zenodo, codemeta, recipe = map(told, ('CITATION.cff', '.zenodo.json', 'codemeta.json', 'recipe.yaml'))
    assert {cff['version'], zenodo['version'], codemeta['version'], recipe['context']['version']} == {magphonon.__version__}
    assert {cff['license'], zenodo['license'], codemeta['license'].rpartition('/')[2],
            recipe['about']['license']} == {PROJECT['license']}
    assert {codemeta['name'], recipe['package']['name']} == {PROJECT['name']}
    assert {zenodo['description'], codemeta['description'], recipe['about']['summary']} == {PROJECT['description']}
    headings = re.findall(r'^## (.*)$', (ROOT / 'CHANGELOG.md').read_text(encoding='utf-8'), re.M)
    assert re.fullmatch(rf'{re.escape(magphonon.__version__)} \(\d{{4}}-\d\d-\d\d\)', headings[0])  # with its date
    assert cff['title'] == zenodo['title']
    developers = [author['name'] for author in PROJECT['authors']]
    for authors in (cff['authors'], zenodo['creators'], codemeta['author']):
        assert [full_name(author) for author in authors] == developers
    assert re.search(r'^Copyright .* the magphonon developers$', (ROOT / 'LICENSE').read_text(encoding='utf-8'), re.M)
    assert zenodo['keywords'] == codemeta['keywords'] == PROJECT['keywords']
    assert codemeta['runtimePlatform'] == f'Python {PROJECT["requires-python"]}'


FILLED = """repository = "https://forge.example/magphonon"
documentation = "https://docs.example/magphonon"
contact = "conduct@example.org"
doi = "10.1234/one"
affiliations = ["Institute of Lattices: One"]
authors = [{ given-names = "Ada", family-names = "Lova", orcid = "0000-0001-2345-6789", affiliation = 1 },
           { given-names = "Émile", family-names = "du Pont", affiliation = 1 }]
"""


def test_one_file_of_the_owner_fills_all_places(tmp_path):
    files = ('pyproject.toml', 'CITATION.cff', 'codemeta.json', '.zenodo.json', 'recipe.yaml', 'README.md', 'CONTRIBUTING.md',
             'CODE_OF_CONDUCT.md', 'paper/paper.md', 'magphonon/__init__.py', '.ci/owner.py', '.ci/owner.toml')

    def written():
        subprocess.run([sys.executable, tmp_path / '.ci/owner.py'], check=True)
        return {name: (tmp_path / name).read_text(encoding='utf-8') for name in files}

    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    assert written() == {name: (ROOT / name).read_text(encoding='utf-8') for name in files}  # what stands here is what it writes
    (tmp_path / '.ci/owner.toml').write_text(FILLED, encoding='utf-8')
    texts = written()
    assert written() == texts
    project = tomllib.loads(texts['pyproject.toml'])['project']
    assert [one['name'] for one in project['authors']] == ['Ada Lova', 'Émile du Pont']
    assert project['urls']['Issues'] == 'https://forge.example/magphonon/issues'
    cff, head = yaml.safe_load(texts['CITATION.cff']), yaml.safe_load(texts['paper/paper.md'].split('---\n')[1])
    assert cff['authors'][0] == {'family-names': 'Lova', 'given-names': 'Ada', 'orcid': 'https://orcid.org/0000-0001-2345-6789'}
    assert (cff['doi'], cff['repository-code']) == ('10.1234/one', 'https://forge.example/magphonon')
    assert cff['references'][0]['year'] == 2020
    assert [one['name'] for one in head['authors']] == ['Ada Lova', 'Émile du Pont']
    assert head['affiliations'] == [{'name': 'Institute of Lattices: One', 'index': 1}]
    zenodo, codemeta = (json.loads(texts[name]) for name in ('.zenodo.json', 'codemeta.json'))
    assert codemeta['author'][1]['familyName'] == 'du Pont'
    assert zenodo['creators'][0] == {'name': 'Lova, Ada', 'orcid': '0000-0001-2345-6789'}
    for authors in (cff['authors'], zenodo['creators'], codemeta['author']):
        assert [full_name(one) for one in authors] == ['Ada Lova', 'Émile du Pont']
    assert yaml.safe_load(texts['recipe.yaml'])['about']['repository'] == 'https://forge.example/magphonon'
    assert 'https://forge.example/magphonon/issues' in texts['CONTRIBUTING.md']
    assert 'conduct@example.org' in texts['CODE_OF_CONDUCT.md']
    assert 'Clone [the sources](https://forge.example/magphonon)' in texts['README.md']


def test_conda_installs_what_pip_installs():
    wanted = [re.sub(r'^matplotlib>', 'matplotlib-base>', line) for line in PROJECT['dependencies']]  # without Qt
    runs = [line.replace(' ', '') for line in told('recipe.yaml')['requirements']['run']]
    assert sorted(runs) == sorted([f'python{PROJECT["requires-python"]}', *wanted])


def test_paper_has_the_form_of_the_journal():
    """The Journal of Open Source Software asks for these sections, and for 750 to 1750 words."""
    _, head, text = (ROOT / 'paper/paper.md').read_text(encoding='utf-8').split('---\n', 2)
    assert {'title', 'tags', 'authors', 'affiliations', 'date', 'bibliography'} <= yaml.safe_load(head).keys()
    assert re.findall(r'^# (.*)$', text, re.M) == [
        'Summary', 'Statement of need', 'State of the field', 'Software design', 'Research impact statement',
        'AI usage disclosure', 'Acknowledgements', 'References']
    assert 750 <= len(text.split()) <= 1750
    known = re.findall(r'^@\w+\{(\w+),', (ROOT / 'paper/paper.bib').read_text(encoding='utf-8'), re.M)
    assert set(re.findall(r'@(\w+)[;\]]', text)) == set(known)
    assert all((ROOT / 'paper' / picture).is_file() for picture in re.findall(r'\]\((.*?)\)', text))


def test_paper_states_what_the_package_finds():
    cell = magphonon.read_scene('prototype').atoms()
    true, blind = (magphonon.analytic_bands(cell, 'M', m).frequencies_Hz.min() for m in ('complete', 'conventional'))
    text = ' '.join((ROOT / 'paper/paper.md').read_text(encoding='utf-8').split())
    assert f'at {blind:.1f} Hz instead of {true:.1f} Hz: the static forces lower it by {100 * (1 - true / blind):.0f} %' in text
    square = magphonon.read_scene('square').atoms()
    needed = magphonon.critical_foundation(square)[0] / (magphonon.units.N / magphonon.units.m)
    assert f'$4f/L = {needed:.1f}$ N/m' in text
