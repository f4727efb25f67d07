"""The page of the explorer holds everything that it needs, and its sliders stay where the law is known."""

import json
from html.parser import HTMLParser

import numpy as np
import pytest

from magphonon import InversePower, MagneticRepulsion, lattices, units as u
from magphonon.bands import band_path
from magphonon.interactions import Overlap, Tabulated
from magphonon.plotting import explorer
from magphonon.plotting.explorer import Explorer

POWER = InversePower(0.2 * 10.0**4.5, 4.5)


def explored(law=POWER, kind='triangular', spacing=10.0, shells=1, foundation=0.02):
    cell = getattr(lattices, kind)(spacing, 0.7)
    cell.calc = MagneticRepulsion(cell, law, shells=shells, foundation=foundation)
    return Explorer(cell, band_path(cell, None, 31))


class Seen(HTMLParser):
    """Tags with their attributes, and the text within each kind of them."""

    def __init__(self, page):
        super().__init__()
        self.attributes, self.text, self.open = [], {}, []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.attributes += [(tag, name, value) for name, value in attrs]
        if tag not in ('meta', 'input', 'line'):
            self.open.append(tag)

    def handle_endtag(self, tag):
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data):
        kind = self.open[-1] if self.open else ''
        self.text.setdefault(kind, []).append(data)


def written(title='A lattice', scene='title = "A lattice"'):
    lattice = explored()
    at = lattice.exponents.values
    return lattice, lattice.page(title, scene, scene, (at, np.maximum(0, 3 - at)))


def test_the_page_refers_to_nothing_outside_itself():
    _, page = written()
    seen = Seen(page)
    assert not [entry for entry in seen.attributes if entry[1] in ('src', 'href', 'xlink:href', 'srcset', 'action')]
    code = ''.join(seen.text['script'] + seen.text['style'])
    assert len(code) > 10_000  # the scripts were found
    for way_out in ('://', 'url(h', '@import', 'fetch(', 'XMLHttpRequest', 'WebSocket', 'import('):
        assert way_out not in code
    policy = [value for _, name, value in seen.attributes if name == 'content' and value.startswith('default-src')]
    assert policy == ["default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"]
    assert '{{' not in page


def test_data_of_the_page_are_those_of_the_lattice():
    lattice, page = written()
    data = json.loads(page.split('id="data">')[1].split('</script>')[0])
    assert data['sliders']['exponent']['values'] == lattice.exponents.values.tolist()  # bit for bit
    assert [slider['per_SI'] for slider in data['sliders'].values()] == [1e3, 1.0, 1.0]  # mm in a metre
    assert data['sliders']['foundation']['values'][lattice.foundations.scene] == pytest.approx(20.0, rel=1e-15)
    assert data['law'] == {'kind': 'power', 'force_N': pytest.approx(0.2, rel=1e-14), 'spacing_m': 0.01}


def test_a_path_that_jumps_names_the_points_on_both_sides():
    cell = explored(kind='square').atoms
    path = Explorer(cell, band_path(cell, 'GX,MG', 41))._path()
    [jump] = path['jumps']
    assert [path['named'][k] for k in (0, jump - 1, jump, 40)] == ['Γ', 'X', 'M', 'Γ']
    assert len(path['named']) == 4
    assert [tick['name'] for tick in path['ticks']] == ['Γ', 'X,M', 'Γ']
    assert path['point'] == {'name': 'X', 'at': jump - 1}
    assert path['axis'][jump - 1] == path['axis'][jump]


def test_titles_and_scenes_cannot_end_a_script_or_begin_a_tag():
    hostile = 'a </script><b id="x"> & {{data}} \u2028'
    _, page = written(hostile, hostile)
    seen = Seen(page)
    assert not [tag for tag, *_ in seen.attributes if tag == 'b']
    assert hostile in seen.text['h1'][0]
    assert hostile in ''.join(seen.text['pre'])


def test_sliders_have_round_values_and_the_one_of_the_scene():
    rng = np.random.default_rng(1)
    for _ in range(50):
        low, width = rng.uniform(0, 3), 10 ** rng.uniform(-4, 4)
        here = low + rng.uniform(0, 1) * width
        slider = explorer._slider(low, here, low + width)
        others = np.delete(slider.values, slider.scene)
        step = np.diff(others).min()
        assert slider.values[slider.scene] == here
        assert (np.diff(slider.values) > 0).all()
        assert 0.9 * explorer.VALUES <= len(slider.values) <= 2.6 * explorer.VALUES  # from a step of 2 to one of 5
        assert (slider.values >= low - 1e-6 * step).all()
        assert (slider.values <= low + width + 1e-6 * step).all()
        np.testing.assert_allclose(np.rint(others / step) * step, others, rtol=1e-9, atol=1e-9 * step)
        assert f'{step:e}'[0] in '1259'  # 9: 0.9999...


def test_the_slider_of_the_spacing_ends_at_a_tenth_of_the_force_and_ten_times_of_it():
    for a in np.random.default_rng(2).uniform(1.5, 9, 3):
        spacings = explored(InversePower(0.2 * 10.0**a, a)).scales
        assert spacings[0] ** -a == pytest.approx(10, rel=0.2)  # to a step of the slider
        assert spacings[-1] ** -a == pytest.approx(0.1, rel=0.2)


def test_the_slider_of_the_spacing_ends_with_the_table_of_a_law_and_with_contacts():
    r = np.linspace(8, 15, 8)
    table = explored(Tabulated(r, 0.2 * (r / 10) ** -3.0)).spacings.values
    # a table continues by a tenth below, and above towards dipoles: 3 ln(r/10) + ln(r/15)^2/(2 ln 2) = ln 10 at 21.13
    assert table[[0, -1]] == pytest.approx([0.008 / 1.1, 0.02113], rel=0.02)
    assert table[0] >= 0.008 / 1.1
    spheres = explored(Overlap.spheres(206 * u.GPa, 0.3, 20 * u.mm), spacing=19.997)
    assert spheres.spacings.values[-1] < 0.02  # a tenth of the force
    assert spheres.exponents is None


def test_two_shells_of_a_table_are_known_at_every_value_of_the_slider():
    r = np.linspace(6, 26, 30)
    lattice = explored(Tabulated(r, 0.2 * (r / 10) ** -0.8), kind='square', shells=2)
    assert np.isfinite(lattice._law()['stiffness_N_per_m']).all()
    # beyond its end it falls towards dipoles: 0.8 ln(r/10) + 3.2 ln(r/26)^2/(2 ln 2) = ln 10 at 50.4
    assert lattice.scales[-1] == pytest.approx(5.04, rel=0.01)


def test_what_the_page_cannot_show_is_refused():
    with pytest.raises(ValueError, match=r'at the spacing of 25 mm no force acts between nearest neighbours'):
        explored(Overlap(1.0, 2.5, 20.0), spacing=25.0)
    with pytest.raises(ValueError, match='the foundation differs from particle to particle'):
        explored(kind='honeycomb', foundation=[0.1, 0.2])
