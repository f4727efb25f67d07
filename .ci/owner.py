"""Write what only the owners know, and the version, wherever others look: `python .ci/owner.py`, after `.ci/owner.toml`."""

import ast
import json
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def changed(name, *changes):
    """Replace each pattern by its text in a file; a pattern that is not there is an error, not a silence."""
    file = ROOT / name
    text = file.read_text(encoding='utf-8')
    for pattern, new in changes:
        text, count = re.subn(pattern, lambda _, new=new: new, text, count=1, flags=re.M | re.S)
        if not count:
            raise SystemExit(f'{name} has nothing like {pattern}')
    file.write_text(text, encoding='utf-8')


def full(author):
    """Name of an author."""
    return author.get('name') or f'{author["given-names"]} {author["family-names"]}'


def quoted(text):
    """As TOML and YAML quote."""
    return json.dumps(text, ensure_ascii=False)


def entries(authors, keys):
    """A list of YAML: of each author those keys that are known."""
    return ''.join(f'  {"- " if k == 0 else "  "}{key}: {quoted(author[key])}\n' for author in authors
                   for k, key in enumerate(key for key in keys if key in author))


def marked(name, text):
    """The change of what stands between the marks of this name in Markdown."""
    return rf'<!-- {name} -->.*?<!-- /{name} -->', f'<!-- {name} -->{text}<!-- /{name} -->'


def main():
    """Write all of them."""
    owner = tomllib.loads((ROOT / '.ci/owner.toml').read_text(encoding='utf-8'))
    authors, where, contact = owner['authors'], owner['repository'], owner['contact']
    version = next(ast.literal_eval(line.split('=')[1].strip()) for line in
                   (ROOT / 'magphonon/__init__.py').read_text(encoding='utf-8').splitlines() if line.startswith('__version__'))
    urls = {'Repository': where, 'Issues': where and f'{where}/issues', 'Documentation': owner['documentation']}
    links = ''.join(f'{key} = {quoted(url)}\n' for key, url in urls.items() if url)

    def json_file(name, **fields):
        file = ROOT / name
        known = json.loads(file.read_text(encoding='utf-8')) | fields
        file.write_text(json.dumps({key: value for key, value in known.items() if value}, indent=2, ensure_ascii=False) + '\n',
                        encoding='utf-8')

    json_file('codemeta.json', version=version, codeRepository=where,
              author=[{'@type': 'Organization', 'name': full(one)} if 'name' in one else
                      {'@type': 'Person', 'givenName': one['given-names'], 'familyName': one['family-names']}
                      | ({'@id': f'https://orcid.org/{one["orcid"]}'} if 'orcid' in one else {}) for one in authors])
    json_file('.zenodo.json', version=version,
              creators=[{'name': one.get('name') or f'{one["family-names"]}, {one["given-names"]}'}
                        | ({'orcid': one['orcid']} if 'orcid' in one else {}) for one in authors])
    people = [one | ({'orcid': f'https://orcid.org/{one["orcid"]}'} if 'orcid' in one else {}) for one in authors]
    changed('CITATION.cff', (r'^version: .*?$', f'version: {version}'),
            (r'^(doi: [^\n]*\n)?(repository-code: [^\n]*\n)?authors:\n.*?(?=^\S)',
             (f'doi: {owner["doi"]}\n' if owner['doi'] else '') + (f'repository-code: {quoted(where)}\n' if where else '')
             + 'authors:\n' + entries(people, ('name', 'family-names', 'given-names', 'orcid'))))
    changed('recipe.yaml', (r'^  version: .*?$', f'  version: {quoted(version)}'),
            (r'^about:\n(  repository: [^\n]*\n)?', 'about:\n' + (f'  repository: {where}\n' if where else '')))
    changed('pyproject.toml',
            (r'^authors = \[.*?\]$', 'authors = [' + ', '.join(f'{{ name = {quoted(full(one))} }}' for one in authors) + ']'),
            (r'(\[project\.urls\]\n.*?\n)?(?=\[project\.scripts\])', f'[project.urls]\n{links}\n' if links else ''))
    if all('name' not in one for one in authors):
        changed('paper/paper.md', (r'^authors:\n.*?(?=^date)', 'authors:\n' + ''.join(
            f'  - name: {full(one)}\n' + (f'    orcid: {one["orcid"]}\n' if 'orcid' in one else '')
            + f'    affiliation: {one["affiliation"]}\n' for one in authors) + 'affiliations:\n' + ''.join(
            f'  - name: {quoted(name)}\n    index: {k}\n' for k, name in enumerate(owner['affiliations'], 1))))
    changed('README.md', marked('sources', f'Clone [the sources]({where})' if where else 'Unpack or clone the sources'))
    changed('CONTRIBUTING.md', marked('tracker', f'[the tracker of issues]({where}/issues)' if where else
                                      'the tracker of issues where these sources are kept, or whoever gave them to you'))
    changed('CODE_OF_CONDUCT.md', marked('contact', f'to <{contact}>' if contact else 'to any maintainer'))


if __name__ == '__main__':
    main()
