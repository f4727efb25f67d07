"""The options of pictures: every command that draws has them, and they do what they say or are refused in words."""

from types import SimpleNamespace

import pytest
from matplotlib.figure import Figure

from magphonon.cli.arguments import drawing
from magphonon.cli.main import main


def saved(tmp_path, title='scene', style=None):
    figure = Figure(layout='compressed')
    figure.subplots().plot([10, 100], [1, 2])
    with drawing(SimpleNamespace(style=style), tmp_path, title) as save:
        save(figure, 'picture')
    return figure


@pytest.mark.slow
def test_pictures_are_png_or_what_the_style_asks_for(tmp_path):
    (tmp_path / 'my.mplstyle').write_text('savefig.format: pdf\n')
    saved(tmp_path)
    saved(tmp_path, style=tmp_path / 'my.mplstyle')
    assert sorted(file.name for file in tmp_path.iterdir()) == ['my.mplstyle', 'picture.pdf', 'picture.png']
    assert (tmp_path / 'picture.png').read_bytes()[:4] == b'\x89PNG'
    pdf = (tmp_path / 'picture.pdf').read_bytes()
    assert b'/FontFile2' in pdf  # TrueType fonts, as journals ask
    assert b'/Type3' not in pdf


def test_a_command_obeys_the_options_and_names_a_style_sheet_that_is_not_there(tmp_path, capsys):
    told = ['frf', 'oscillator', '-o', str(tmp_path / 'out')]
    assert main(told) == 0
    before = (tmp_path / 'out' / 'frf.png').read_bytes()
    assert main([*told, '--force', '--style', str(tmp_path / 'nowhere.mplstyle')]) == 2
    assert 'nowhere.mplstyle cannot be opened (No such file or directory)' in capsys.readouterr().err
    assert (tmp_path / 'out' / 'frf.png').read_bytes() == before


def test_options_of_a_picture_that_is_not_written_are_refused(tmp_path, capsys):
    (tmp_path / 'forces.csv').write_text('r_m,f_N\n0.01,1\n0.02,0.1\n0.03,0.03\n', encoding='utf-8')
    assert main(['fit', str(tmp_path / 'forces.csv'), '--style', 'x']) == 2
    assert 'say with -o DIR where to write it' in capsys.readouterr().err


@pytest.mark.parametrize('title', [r'$\frac{$', r'a $\nosuch$'])
def test_a_title_with_a_formula_that_is_none_is_refused_in_words(tmp_path, title):
    with pytest.raises(ValueError, match=r'the picture picture cannot be drawn .* check its title'):
        saved(tmp_path, title=title)


def test_a_style_that_asks_for_latex_where_there_is_none_is_refused_at_once(tmp_path, monkeypatch):
    (tmp_path / 'my.mplstyle').write_text('text.usetex: True\n')
    monkeypatch.setenv('PATH', str(tmp_path))
    with pytest.raises(ValueError, match=r'my\.mplstyle asks for LaTeX'):
        saved(tmp_path, style=tmp_path / 'my.mplstyle')
