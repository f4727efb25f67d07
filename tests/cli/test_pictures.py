"""The options of pictures: every command that draws has them, and they do what they say or are refused in words."""

from types import SimpleNamespace

import pytest
from matplotlib.figure import Figure

from magphonon import analytic_bands, read_scene, ready_scene
from magphonon.cli.arguments import drawing
from magphonon.cli.bands import _draw
from magphonon.cli.main import main
from magphonon.plotting.axes import label_frequencies

DRAWING = ('bands', 'burst', 'fit', 'frf', 'modes', 'spectrum', 'uncertainty')
WITHOUT_FREQUENCIES = ('fit',)


@pytest.mark.parametrize('command', DRAWING)
def test_every_command_that_draws_lists_the_options_of_pictures(command, capsys):
    with pytest.raises(SystemExit):
        main([command, '--help'])
    told = capsys.readouterr().out
    assert all(option in told for option in ('--pdf', '--title TEXT', '--style FILE'))
    assert ('--fmax HZ' in told) == (command not in WITHOUT_FREQUENCIES)


def picture():
    """A figure over frequencies from 10 to 100 Hz, with a second axis that has none."""
    figure = Figure(layout='compressed')
    for ax in figure.subplots(1, 2):
        ax.plot([10, 100], [1, 2])
        ax.set(xlim=(10, 100), ylim=(0, 3))
    label_frequencies(figure.axes[0].xaxis)
    return figure


def saved(tmp_path, **options):
    figure = picture()
    given = {'pdf': False, 'title': None, 'fmax': None, 'style': None} | options
    with drawing(SimpleNamespace(**given), tmp_path, 'scene') as save:
        save(figure, 'picture')
    return figure


@pytest.mark.slow
def test_pictures_are_png_and_with_pdf_both(tmp_path):
    saved(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ['picture.png']
    saved(tmp_path, pdf=True)
    assert (tmp_path / 'picture.png').read_bytes()[:4] == b'\x89PNG'
    pdf = (tmp_path / 'picture.pdf').read_bytes()
    assert b'/FontFile2' in pdf  # TrueType fonts, as journals ask
    assert b'/Type3' not in pdf


@pytest.mark.parametrize(('title', 'shown'), [(None, 'scene'), ('mine', 'mine'), ('', '')])
def test_the_title_is_that_of_the_scene_or_the_one_given_or_none(tmp_path, title, shown):
    assert saved(tmp_path, title=title).get_suptitle() == shown


def test_fmax_ends_axes_of_frequencies_and_no_others(tmp_path):
    with_frequencies, without = saved(tmp_path, fmax=40.0).axes
    assert with_frequencies.get_xlim() == (10, 40)
    assert with_frequencies.get_ylim() == (0, 3)
    assert without.get_xlim() == (10, 100)


@pytest.mark.parametrize('highest', [80.0, 141.0])
def test_names_of_branches_stand_within_the_axes_that_end_at_fmax(highest):
    scene = read_scene(ready_scene('prototype'))
    atoms, path = scene.atoms(), scene.band_path()
    found = {model: analytic_bands(atoms, path, model, vectors=True) for model in ('complete', 'conventional')}
    figures = {}
    _draw(lambda figure, name: figures.update({name: figure}), scene, found | {'phonopy': found['complete']}, highest)
    (ax,) = figures['bands'].axes
    figures['bands'].draw_without_rendering()
    assert ax.get_ylim() == (0, highest)
    assert 'shear' in {text.get_text() for text in ax.texts}
    for text in ax.texts:
        assert ax.get_window_extent().y0 < text.get_window_extent().y0 < text.get_window_extent().y1 < ax.get_window_extent().y1


@pytest.mark.parametrize('highest', [0.0, -5.0, float('nan'), float('inf')])
def test_a_highest_frequency_that_is_none_is_refused_at_once(tmp_path, highest):
    with pytest.raises(ValueError, match='--fmax'):
        saved(tmp_path, fmax=highest)
    assert not list(tmp_path.iterdir())


def test_a_highest_frequency_below_the_lowest_is_refused_with_both(tmp_path):
    with pytest.raises(ValueError, match='--fmax 7: the frequencies in a picture begin at 10 Hz'):
        saved(tmp_path, fmax=7.0)


def test_a_command_obeys_the_options_and_names_a_style_sheet_that_is_not_there(tmp_path, capsys):
    told = ['frf', 'oscillator', '-o', str(tmp_path / 'out')]
    assert main([*told, '--pdf', '--fmax', '60']) == 0
    assert (tmp_path / 'out' / 'frf.pdf').exists()
    before = (tmp_path / 'out' / 'frf.png').read_bytes()
    assert main([*told, '--style', str(tmp_path / 'nowhere.mplstyle')]) == 2
    assert 'nowhere.mplstyle cannot be opened (No such file or directory)' in capsys.readouterr().err
    assert (tmp_path / 'out' / 'frf.png').read_bytes() == before


def test_options_of_a_picture_that_is_not_written_are_refused(tmp_path, capsys):
    (tmp_path / 'forces.csv').write_text('r_m,f_N\n0.01,1\n0.02,0.1\n0.03,0.03\n', encoding='utf-8')
    assert main(['fit', str(tmp_path / 'forces.csv'), '--pdf']) == 2
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
