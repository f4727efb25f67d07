"""The site tells everything: each room, each command, each threshold; `.ci/run` builds it and runs its tutorials."""

import ast
import doctest
import re
import shlex
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

from magphonon.cli.main import parser_of

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope='module')
def generate():
    pytest.importorskip('sphinx')  # the extra [docs]
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / 'docs'))
        import generate
        yield generate
    for name in [name for name in sys.modules if name.partition('.')[0] == 'generate']:
        del sys.modules[name]


def test_every_room_and_every_command_has_its_page(generate):
    assert set(generate.api.rooms()) == set(generate.api.TITLES)
    assert set(generate.commands.EXAMPLES) == set(generate.commands.COMMANDS)


def test_every_public_name_has_its_page_and_stands_in_the_list_of_its_room(generate):
    import magphonon.bands

    room = generate.api.page('bands')
    for name in magphonon.bands.__all__:
        assert f'   {name} <bands.{name}>\n' in room
        assert f':: magphonon.bands.{name}\n' in generate.api.page_of('bands', name)


def test_links_to_names_lead_to_their_pages(generate):
    """Sphinx says nothing of a link to a name that no page describes."""
    known = {f'magphonon.{room}.{name}' for room in generate.api.rooms() for name in generate.api.public(room)}
    known |= {f'magphonon.{room}' for room in generate.api.rooms()}
    pages = {page: page.read_text(encoding='utf-8') for page in (ROOT / 'docs').glob('[rt]*/*.md')}
    links = {(page.name, name) for page, text in pages.items() for name in re.findall(r'\{py:\w+\}`~?(magphonon[\w.]+)`', text)}
    assert len(links) > 20
    assert {(page, name) for page, name in links if name not in known} == set()


def test_every_tool_has_a_row_and_every_trait_a_column(generate):
    from magphonon.traits import TOOLS, TRAITS

    rows = re.findall(r'^\| `(\w+)` \|(.*)\|$', generate.traits.page(generate.traits.loaded()), re.MULTILINE)
    found = {name: {trait for trait, cell in zip(TRAITS, cells.split('|'), strict=True) if cell.strip()} for name, cells in rows}
    assert found == {tool.name: tool.takes for tool in TOOLS.values()}
    assert len(rows) > 45


def test_thresholds_are_those_of_the_source(generate):
    tree = ast.parse('MOST = 2**53\n"""Largest count."""\nNAMES = ("a", "b")\n"""No number."""\nHALF = 0.5  # not described\n')
    assert list(generate.thresholds.constants(tree)) == [('MOST', '2 ** 53', 'Largest count.')]


def test_drawings_and_tutorials_are_those_of_the_pages():
    pages = ''.join(page.read_text(encoding='utf-8') for page in (ROOT / 'docs/theory').glob('*.md'))
    drawn = set(re.findall(r'plot:: theory/(\w+)\.py', pages))
    assert drawn == {file.stem for file in (ROOT / 'docs/theory').glob('*.py')}
    assert len(list((ROOT / 'docs/tutorials').glob('plot_*.py'))) == 9


def test_pages_name_files_that_exist():
    named = {(page, name) for page in (ROOT / 'docs').rglob('*.md') if 'generated' not in page.parts
             for name in re.findall(r'`((?:\w+/)+\w+\.py)`', page.read_text(encoding='utf-8'))}
    assert len(named) > 50
    roots = ROOT, ROOT / 'magphonon'
    assert {(page, name) for page, name in named if not any((root / name).is_file() for root in roots)} == set()


def test_what_replaces_what_left_is_there():
    """Moved names are in their modules, other names in a subpackage, and commands are understood."""
    moving, changes = ((ROOT / name).read_text(encoding='utf-8') for name in ('docs/reference/moving.md', 'CHANGELOG.md'))
    rows = re.findall(r'^\| `magphonon\.\w+` \| `(magphonon\.\w+\.\w+)`: (.*) \|$', moving, re.M)
    moved = [(module, name) for module, names in rows for name in re.findall(r'`(\w+)`', names)]
    told = [row.split('|')[-2] for row in re.findall(r'^\|.*\|$', moving + changes.split('### Added')[0], re.M)]
    named = [name.rsplit('.', 1) for row in told for name in re.findall(r'`(magphonon(?:\.\w+)+)[`(]', row)]
    assert len(moved) > 50
    assert len(named) > 5
    for module, name in [*moved, *named]:
        assert hasattr(import_module(module), name) or find_spec(f'{module}.{name}'), f'{module}.{name}'
    commands = [words for row in told for words in re.findall(r'`magphonon (\w+ [^`]*)`', row)]
    assert len(commands) > 5
    for words in commands:
        parser_of().parse_args(shlex.split(words))  # fails at a word that it does not know


def test_pages_show_lines_of_the_code_that_are_there():
    shown = [(page, *found) for page in (ROOT / 'docs').glob('[rt]*/*.md') for found in re.findall(
        r'```\{literalinclude\} (\S+)\n(?:(?!```)[^\n]*\n)*?:start-at: (.*)\n:end-at: (.*)\n', page.read_text(encoding='utf-8'))]
    assert shown
    for page, file, first, last in shown:
        text = (page.parent / file).read_text(encoding='utf-8')
        assert last in text[text.index(first):]


def test_examples_of_the_gallery_are_short_and_import_what_is_public():
    scripts = sorted((ROOT / 'docs/gallery').rglob('plot_*.py'))
    assert len(scripts) == 29
    for file in scripts:
        text = file.read_text(encoding='utf-8')
        tree = ast.parse(text)
        title, line = ast.get_docstring(tree).splitlines()[:2]
        assert len(title.split()) <= 6  # it stands in the side bar
        assert line == '=' * len(title)
        assert len(text.splitlines()) <= 33
        assert re.search(r"figure\.savefig\('\w+\.png'\)$", text.strip())  # who runs it finds a picture
        froms = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        own = {name for name in froms if name.startswith('magphonon')}
        assert {name for name in own if name.count('.') > 1} == set()  # a room, not a file in it
        plain = {name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
        known = {'magphonon', 'numpy', 'scipy', 'importlib', 'itertools', 'ase'}
        assert {name.partition('.')[0] for name in froms | plain} <= known


@pytest.mark.parametrize('size', [(600, 200), (200, 600)])
def test_a_thumbnail_shows_the_first_panel_as_large_as_its_frame(size, tmp_path):
    pytest.importorskip('sphinx_gallery')
    from PIL import Image, ImageDraw

    with pytest.MonkeyPatch.context() as patch:  # importing it replaces the scaling of sphinx-gallery
        patch.syspath_prepend(str(ROOT / 'docs'))
        from generate import scraper
    across = size[0] > size[1]
    drawn = Image.new('RGB', size, 'white')
    pen = ImageDraw.Draw(drawn)
    for colour, first in (('red', 10), ('blue', 250)):  # in a frame of 400 x 280 the second would be cut
        pen.rectangle([first, 10, first + 200, 190] if across else [10, first, 190, first + 100], fill=colour)
    drawn.save(tmp_path / 'picture.png')
    scraper.thumbnail(tmp_path / 'picture.png', tmp_path / 'thumb.png', 400, 280)
    thumb = Image.open(tmp_path / 'thumb.png')
    colours = {colour: count for count, colour in thumb.getcolors(400 * 280)}
    assert thumb.size == (400, 280)
    assert colours[255, 0, 0] > 0.5 * 400 * 280
    assert not any(blue > 200 and red < 100 for red, _, blue in colours)


def test_the_scene_of_own_positions_on_its_page_is_stable(tmp_path):
    from magphonon import modes, read_scene

    page = (ROOT / 'docs/reference/structures.md').read_text(encoding='utf-8')
    for name, language in (('particles.csv', 'text'), ('mine.toml', 'toml')):
        (tmp_path / name).write_text(re.search(rf'```{language}\n(.*?)```', page, re.S)[1], encoding='utf-8')
    omega = modes(read_scene(tmp_path / 'mine.toml').atoms()).omega
    assert len(omega) == 8  # four free magnets in the plane
    assert (omega > 0).all()


def test_the_tour_of_twelve_functions_runs_and_is_short():
    page = ROOT / 'docs/reading.md'
    done = doctest.testfile(str(page), module_relative=False, optionflags=doctest.ELLIPSIS)
    assert done.attempted > 20
    assert not done.failed
    named = re.findall(r'^\*\*\d+\. `(?:\w+\.)?(\w+)`\*\* in `([\w/]+\.py)`', page.read_text(encoding='utf-8'), re.M)
    assert len(named) == 12
    lengths = []
    for name, file in named:
        tree = ast.parse((ROOT / 'magphonon' / file).read_text(encoding='utf-8'))
        [node] = [node for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and node.name == name][:1]
        told = [part for part in ast.walk(node) if isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant)]
        lengths.append(node.end_lineno - node.lineno + 1 - sum(part.end_lineno - part.lineno + 1 for part in told))
    assert sum(lengths) < 300, dict(zip(named, lengths, strict=True))
