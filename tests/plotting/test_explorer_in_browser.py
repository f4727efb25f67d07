"""The page of the explorer in a real browser: its bands are those of the package, its modes move as the eigenvectors say.

Skipped without playwright or Chromium.  Every expectation is computed from a lattice made anew with the values of the sliders.
"""

import re
import shutil
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest
from scene_files import ready_scene

from magphonon import InversePower, MagneticRepulsion, analytic_bands, critical_foundation, lattices, read_scene, units as u
from magphonon.bands import band_path, bloch_modes
from magphonon.cli.explore import border
from magphonon.cli.main import main
from magphonon.interactions import Spring, Tabulated, Yukawa
from magphonon.plotting import explorer

playwright = pytest.importorskip('playwright.sync_api')
CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser') or shutil.which('google-chrome')
pytestmark = [pytest.mark.browser, pytest.mark.slow]
KEYS = {'spacing': 'spacing_m', 'exponent': 'exponent', 'foundation': 'foundation_N_per_m'}
FEW = 8
"""Values of a slider, or twice as many: each costs the foundation that it needs."""


class Made:
    """A lattice as a scene would make it, and the same with other values of the sliders."""

    def __init__(self, kind, law, spacing=10.0, shells=1, masses=None, foundation=20.0):
        self.kind, self.law, self.spacing, self.shells, self.foundation = kind, law, spacing, shells, foundation
        self.masses = masses or [0.7] * len(getattr(lattices, kind)(1.0, 1.0))
        self.force = -law.dphi(spacing)

    def cell(self, spacing_m=None, exponent=None, foundation_N_per_m=None):
        law = self.law if exponent is None else InversePower(self.force * self.spacing**exponent, exponent)
        cell = getattr(lattices, self.kind)(self.spacing if spacing_m is None else spacing_m * u.m, 1.0)
        cell.set_masses(self.masses)
        k = self.foundation if foundation_N_per_m is None else foundation_N_per_m
        cell.calc = MagneticRepulsion(cell, law, shells=self.shells, foundation=k * u.N / u.m)
        return cell

    @cached_property
    def page(self):
        cell = self.cell()
        shown = explorer.Explorer(cell, band_path(cell, None, 41))
        return shown.page(self.kind, 'title = "drawn"', 'title = "drawn"', border(shown))


MADE = {
    'triangular': Made('triangular', InversePower(0.237 * 10.0**4.58, 4.58)),
    'honeycomb': Made('honeycomb', InversePower(0.3 * 10.0**3.1, 3.1), masses=[0.7, 1.05], foundation=100.0),
    'kagome, two shells': Made('kagome', InversePower(0.2 * 10.0**5.0, 5.0), shells=2, foundation=150.0, masses=[0.6, 0.7, 0.9]),
    'square by Yukawa': Made('square', Yukawa(40.0, 0.2), shells=3, foundation=60.0),
    'honeycomb of taut springs': Made('honeycomb', Spring(0.5, 8.0), foundation=10.0),
    'chain by a table': Made('chain', Tabulated(np.linspace(7, 14, 9), 0.2 * np.linspace(0.7, 1.4, 9) ** -3.3), foundation=120.0),
}


@pytest.fixture(scope='module')
def browser():
    with playwright.sync_playwright() as driver:
        if CHROMIUM is None and not Path(driver.chromium.executable_path).exists():
            pytest.skip('no Chromium here; "playwright install chromium" brings one')
        found = driver.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox', '--disable-gpu'],
                                       timeout=300_000)  # ms
        yield found
        found.close()


@pytest.fixture
def opened(browser, tmp_path, monkeypatch):
    """A function that opens the page of a lattice, or of a ready scene by its name, without a network.

    Faults of the page and requests make the test fail.
    """
    monkeypatch.setattr(explorer, 'VALUES', FEW)
    context = browser.new_context(viewport={'width': 1100, 'height': 900}, offline=True, reduced_motion='reduce',
                                  permissions=['clipboard-read', 'clipboard-write'])
    context.set_default_timeout(60_000)  # ms, far longer than it takes on a busy machine
    faults, requests = [], []

    def visit(made):
        page = context.new_page()
        page.on('console', lambda message: faults.append(message.text))
        page.on('pageerror', lambda error: faults.append(str(error)))
        page.on('request', lambda request: requests.append(request.url))
        if isinstance(made, str):
            assert main(['explore', made, '-o', str(tmp_path / 'page.html')]) == 0
        else:
            (tmp_path / 'page.html').write_text(made.page, encoding='utf-8')
        page.goto((tmp_path / 'page.html').as_uri())
        return page

    yield visit
    context.close()
    assert not faults
    outside = [url for url in requests if not url.startswith(('data:', 'about:'))]
    assert {url.partition('#')[0].rpartition('/')[2] for url in outside} == {'page.html'}


def slide(page, **places):
    """Move sliders by the keyboard to their n-th value; what they say then, in SI."""
    for name, n in places.items():
        page.focus(f'#{name}')
        page.keyboard.press('Home')
        for _ in range(n):
            page.keyboard.press('ArrowRight')
    return state_of(page)


def state_of(page):
    """The values of the sliders in SI."""
    state = page.evaluate('view.state')
    return {key: state[key] for key in KEYS.values() if key in state}


def count(page, name):
    return page.evaluate('name => data.sliders[name]?.values.length ?? 0', name)


def signed_squares(f):
    return np.sign(f) * np.asarray(f) ** 2


@pytest.mark.parametrize('name', MADE)
def test_bands_of_both_models_are_those_of_the_package_wherever_the_sliders_are(name, opened):
    rng, page = np.random.default_rng(list(MADE).index(name)), opened(MADE[name])
    for _ in range(2):
        names = [slider for slider in KEYS if count(page, slider)]
        cell = MADE[name].cell(**slide(page, **{slider: int(rng.integers(count(page, slider))) for slider in names}))
        path, bands = band_path(cell, None, 41), page.evaluate('view.bands')
        exact = {model: signed_squares(analytic_bands(cell, path, model).frequencies_Hz) for model in cell.calc.bloch_models}
        top = exact['conventional'].max()
        for model in exact:  # both diagonalise matrices that round-off changes by some 1e-15 of their norm
            np.testing.assert_allclose(signed_squares(bands[model]), exact[model], rtol=0, atol=1e-12 * top)
        without = signed_squares(bands['conventional'])  # what a page without D* would show
        assert abs(without - exact['complete']).max() > 1e-3 * top
        assert_drawn(page, path, np.array(bands['complete']))


def assert_drawn(page, path, f):
    """The lines of the chart go through all points of the bands, and between two of them where squares go, not roots."""
    axis = path.get_linear_kpoint_axis()[0]
    lines = page.eval_on_selector_all('#bands path.complete', 'all => all.map(p => p.getAttribute("d"))')
    drawn = [np.array(re.findall(r'[ML](\S+) (\S+?)(?=[ML]|$)', d), dtype=float) for d in lines]
    left, right = drawn[0][[0, -1], 0]
    places = left + (right - left) * axis / axis[-1]
    heights = [[line[abs(line[:, 0] - place).argmin(), 1] for place in places] for line in drawn]
    slope, zero = np.polyfit(f.ravel(), np.transpose(heights).ravel(), 1)
    assert slope < 0
    assert abs(np.transpose(heights) - zero - slope * f).max() < 2e-3  # three decimals are written
    assert all(len(line) == len(axis) + 5 * (np.diff(branch < 0).sum()) for line, branch in zip(drawn, f.T, strict=True))


def test_eigenvalues_and_vectors_of_the_page_are_those_of_lapack(opened):
    rng, page = np.random.default_rng(7), opened(MADE['triangular'])
    for size in (1, 2, 3, 5, 8):
        Q = np.linalg.qr(rng.normal(size=(size, size)) + 1j * rng.normal(size=(size, size)))[0]
        values = np.sort(rng.integers(-2, 3, size) * 10.0 ** rng.integers(-3, 4))  # some of them equal
        A = (Q * values) @ Q.conj().T
        A = (A + A.conj().T) / 2
        found = page.evaluate('''([re, im]) => {const {values, re: x, im: y} = hermitian({re, im});
            return {values, re: x.map(row => [...row]), im: y.map(row => [...row])}}''', [A.real.tolist(), A.imag.tolist()])
        V, norm = np.array(found['re']) + 1j * np.array(found['im']), np.linalg.norm(A)
        np.testing.assert_allclose(found['values'], np.linalg.eigvalsh(A), rtol=0, atol=1e-13 * norm)
        np.testing.assert_allclose(A @ V, V * found['values'], rtol=0, atol=1e-13 * norm)
        np.testing.assert_allclose(V.conj().T @ V, np.eye(size), rtol=0, atol=1e-13)


def buckles(cell, steps=12):
    """Whether a mode of the lattice grows, on a mesh that holds all special points of these lattices."""
    mesh = np.stack(np.meshgrid(np.arange(steps), np.arange(steps) if cell.pbc[1] else [0], [0]), axis=-1).reshape(-1, 3) / steps
    omega = bloch_modes(cell, mesh)[0]
    return omega.min() < -1e-6 * omega.max()


@pytest.mark.parametrize(('name', 'slider'), [
    ('triangular', 'exponent'), ('honeycomb', 'spacing'), ('kagome, two shells', 'foundation'), ('chain by a table', 'spacing')])
def test_words_and_marks_tell_on_which_side_of_the_border_the_lattice_is(name, slider, opened):
    made, page = MADE[name], opened(MADE[name])
    said, true = [], []
    cell = made.cell(**slide(page, **{slider: 0}))
    for n in range(count(page, slider)):
        words = page.inner_text('#stability')
        said.append(words.startswith('Buckles.'))
        true.append(buckles(cell))
        if n % 4 == 0:
            told = float((re.search(r'needs a foundation of ([\d.]+)', words) or [0, 0])[1])
            assert told == pytest.approx(critical_foundation(cell)[0] / (u.N / u.m), rel=1e-3)  # four digits
        page.keyboard.press('ArrowRight')
        cell = made.cell(**state_of(page))
    assert said == true
    assert 0 < sum(said) < len(said)  # both sides were seen
    first = said.index(False)
    values = page.evaluate('name => data.sliders[name].values.map(v => v * data.sliders[name].per_SI)', slider)
    border = float(re.search(r'buckles below ([\d.]+)', page.inner_text(f'#{slider}-border'))[1])
    assert values[first - 1] * (1 - 1e-3) <= border <= values[first] * (1 + 1e-3)
    place = page.eval_on_selector(f'#{slider}-scale .border', 'mark => parseFloat(mark.style.left)') / 100 * (len(values) - 1)
    assert first - 1 - 1e-9 <= place <= first + 1e-9
    key = KEYS[slider]
    found = critical_foundation(made.cell(**{key: border / page.evaluate('name => data.sliders[name].per_SI', slider)}))[0]
    held = border if slider == 'foundation' else made.foundation
    assert found / (u.N / u.m) == pytest.approx(held, rel=0.03)  # straight lines between few values; the law goes with r**-4.3


MOTION = '''() => [...document.querySelectorAll('#lattice-complete .particle')].map((circle, n) => {
  const rest = document.querySelectorAll('#lattice-complete .rest')[n], of = (dot, x) => Number(dot.getAttribute(x));
  return [...circle.dataset.cell.split(',').map(Number), Number(circle.dataset.particle), of(circle, 'cx') - of(rest, 'cx'),
    of(rest, 'cy') - of(circle, 'cy'), Number(circle.closest('svg').dataset.theta), Number(circle.closest('svg').dataset.gain)];
})'''


def displacements(page):
    """Cells, particles, displacements in pixels, phase and gain of the picture at one moment."""
    rows = np.array(page.evaluate(MOTION))
    return rows[:, :2], rows[:, 2].astype(int), rows[:, 3:5], rows[0, 5], rows[0, 6]


def likeness(a, b):
    return abs(np.vdot(a, b)) / (np.linalg.norm(a) * np.linalg.norm(b))


def test_a_click_on_a_branch_moves_the_lattice_as_its_eigenvector_says(opened):
    made, page = MADE['honeycomb'], opened(MADE['honeycomb'])
    cell, at = made.cell(), 9
    q = np.append(page.evaluate('at => data.path.q[at]', at), 0)
    assert min(abs(q - sign * band_path(cell, None, 41).kpts[at]).max() for sign in (1, -1)) < 1e-12
    omega, vectors = bloch_modes(cell, [q], vectors=True)
    assert np.diff(omega[0]).min() > 0.01 * omega.max()  # no two modes of one frequency, of which any mixture would be right
    page.click('#play')
    for branch in (0, 2):
        d = page.get_attribute(f'path.complete[data-branch="{branch}"]', 'd')
        x, y = (float(part) for part in re.findall(r'[ML](\S+) (\S+?)(?=[ML]|$)', d)[at])
        page.locator('#bands').click(position={'x': x, 'y': y})
        assert page.evaluate('view.chosen') == {'branch': branch, 'at': at}
        told = float(re.search(r'([\d.]+)\s*Hz', page.inner_text('#mode-complete'))[1])
        assert told == pytest.approx(omega[0, branch] / (2 * np.pi) * 1e3, rel=1e-3)
        cells, j, first, theta, _ = displacements(page)
        page.wait_for_function('theta => Math.abs(Math.sin(motions.complete.theta - theta)) > 0.3', arg=theta)
        _, _, later, then, gain = displacements(page)
        assert gain == 1
        # u = Re A exp(-i theta), seen at two phases
        turn = np.array([[np.cos(theta), np.sin(theta)], [np.cos(then), np.sin(then)]])
        A = np.tensordot([1, 1j], np.linalg.solve(turn, np.stack([first, later]).reshape(2, -1)), axes=1)
        phases = np.exp(2j * np.pi * cells @ q[:2])[:, None]
        expected = [(phases * vectors[0, k][j] / np.sqrt(np.array(made.masses)[j])[:, None]).ravel() for k in range(4)]
        assert likeness(expected[branch], A) > 1 - 1e-6  # positions are written to 1e-4 of a pixel
        assert max(likeness(expected[k], A) for k in range(4) if k != branch) < 0.99
        assert abs(later).max() > 1  # pixels: it can be seen


def test_an_unstable_mode_grows_and_a_stopped_one_rests(opened):
    page = opened(MADE['triangular'])
    assert page.inner_text('#play') == 'Play'  # nothing moves by itself for who asks the system for less motion
    slide(page, exponent=0)
    page.click('#play')
    assert page.inner_text('#mode-complete').startswith('grows e-fold in')
    assert page.inner_text('#mode-conventional').endswith('Hz, shear')
    _, _, _, _, before = displacements(page)
    page.wait_for_function('gain => motions.complete.gain > 1.05 * gain', arg=min(before, 0.5))
    page.click('#play')
    still = displacements(page)[2]
    page.wait_for_timeout(100)
    np.testing.assert_array_equal(displacements(page)[2], still)


def test_keys_choose_modes_and_a_button_leads_back_to_the_scene(opened):
    page = opened(MADE['triangular'])
    assert page.is_disabled('#reset')
    words = page.inner_text('#dstar')
    cell = MADE['triangular'].cell()
    at_M = [bloch_modes(cell, [[0.5, 0, 0]], model)[0][0, 0] for model in ('complete', 'conventional')]
    assert 'At M, D* lowers the shear branch from' in words
    lowered = float(re.search(r'by ([\d.]+)\s*%', words)[1])
    assert lowered == pytest.approx(100 * (1 - at_M[0] / at_M[1]), abs=0.0501)  # three digits
    slide(page, spacing=1)
    assert page.inner_text('#dstar') != words
    page.click('#reset')
    assert page.inner_text('#dstar') == words
    page.focus('#bands')
    page.keyboard.press('ArrowUp')
    assert page.inner_text('#mode') == 'Branch 2 at M'
    page.keyboard.press('ArrowLeft')
    assert 'at q = (' in page.inner_text('#mode')


@pytest.mark.parametrize(('name', 'width'), [('triangular', 1280), ('kagome, two shells', 390), ('square by Yukawa', 620)])
def test_nothing_moves_under_a_finger_on_a_slider(name, width, opened):
    page = opened(MADE[name])
    page.set_viewport_size({'width': width, 'height': 850})
    page.wait_for_timeout(200)
    seen = page.evaluate("""() => NAMES.flatMap(name => data.sliders[name].values.map((_, k) => {
      element(name).value = k;
      update();
      const boxes = [...NAMES, 'bands', 'lattice-complete'].map(id => element(id).getBoundingClientRect());
      if (k === data.sliders[name].values.length - 1) element(name).value = data.sliders[name].scene;
      return [element('stability').textContent.slice(0, 7), ...boxes.flatMap(box => [box.x, box.y, box.width, box.height])];
    }))""")
    assert {row[0] for row in seen} == {'Stable.', 'Buckles'}  # both texts were there
    boxes = np.array([row[1:] for row in seen], dtype=float)
    assert np.ptp(boxes, axis=0).max() < 0.1  # pixels; without room kept for the longest text it is 24 and more
    assert page.evaluate('document.documentElement.scrollWidth <= innerWidth')


def test_an_address_leads_to_the_same_state(opened):
    page = opened(MADE['triangular'])
    assert page.evaluate('linkOf(view.state, view.chosen)') == '#'  # as in the scene
    state = slide(page, spacing=3, exponent=5, foundation=7)
    page.evaluate('choose({branch: 1, at: 13})')
    page.wait_for_function('() => location.hash.includes("point=13")')  # the page writes its address a moment later
    link = page.url
    page.click('#reset')
    assert state_of(page) != state
    page.goto('about:blank')
    page.goto(link)
    assert state_of(page) == state
    assert page.evaluate('view.chosen') == {'branch': 1, 'at': 13}
    page.evaluate('location.hash = "#spacing=none&exponent=1e9&point=-4&branch=77"')  # typed by somebody
    page.wait_for_function('() => view.chosen.branch === 1 && view.chosen.at === 0')
    assert page.evaluate('view.state.positions.exponent') == count(page, 'exponent') - 1
    page.wait_for_timeout(400)  # until the page has written its own address, which no request shows


@pytest.mark.parametrize('name', ['prototype', 'square', 'rings', 'dust'])
def test_the_scene_that_is_copied_has_the_bands_that_are_shown(name, opened, tmp_path):
    scene = str(ready_scene(name))
    page = opened(scene)
    places = {slider: (k + 3) % count(page, slider) for k, slider in enumerate(KEYS) if count(page, slider)}
    slide(page, **places)
    page.click('#copy')
    page.wait_for_function('() => element("told").textContent')
    (tmp_path / 'copied.toml').write_text(page.evaluate('navigator.clipboard.readText()'), encoding='utf-8')
    shown = signed_squares(page.evaluate('view.bands.complete'))
    q = np.pad(page.evaluate('data.path.q'), ((0, 0), (0, 1)))
    exact, before = (signed_squares(bloch_modes(read_scene(one).counted().perfect_cell(), q)[0] * 1e3 / (2 * np.pi))
                     for one in (tmp_path / 'copied.toml', scene))
    np.testing.assert_allclose(shown, exact, rtol=0, atol=1e-9 * abs(exact).max())
    assert abs(before - exact).max() > 1e-3 * abs(exact).max()


def test_frames_of_the_first_page_have_the_height_of_their_pages_its_colours_and_waves_that_stand_still(browser, tmp_path):
    index = (Path(__file__).parents[2] / 'docs/index.md').read_text(encoding='utf-8')
    pieces = [*re.findall(r'<iframe.*?</iframe>', index, re.DOTALL), re.search(r'<script>.*?</script>', index, re.DOTALL)[0]]
    (tmp_path / 'index.html').write_text(f'<!DOCTYPE html><body>{"".join(pieces)}', encoding='utf-8')
    assert main(['explore', 'prototype', '-o', str(tmp_path / 'prototype-explore.html')]) == 0
    page = browser.new_page(viewport={'width': 740, 'height': 800}, reduced_motion='reduce', color_scheme='dark')
    page.goto((tmp_path / 'index.html').as_uri())
    parts = (('#burst canvas', '#bands'), ('#bands', '#burst'))
    for frame, (seen, hidden) in zip(page.query_selector_all('iframe'), parts, strict=True):
        frame.scroll_into_view_if_needed()
        inner = frame.content_frame()
        inner.wait_for_selector(seen)
        assert not inner.is_visible(hidden)
        page.wait_for_function('frame => frame.clientHeight !== 0 && !frame.style.height.endsWith("rem")', arg=frame)
        high = inner.evaluate('document.documentElement.scrollHeight')
        assert high <= frame.evaluate('frame => frame.clientHeight') < high + 20  # neither cut off nor half empty
    burst = page.frames[1]
    burst.wait_for_function('document.querySelector("canvas").dataset.time_ms > 0')
    assert burst.inner_text('[name=run]') == 'Play'
    dark, light = (f'rgb({colour})' for colour in ('20, 22, 26', '255, 255, 255'))
    for theme, paper in (('light', light), ('dark', dark), ('light', light), ('auto', dark)):  # the system is dark
        page.evaluate('theme => { document.body.dataset.theme = theme; }', theme)
        for frame in page.frames[1:]:
            frame.wait_for_function('paper => getComputedStyle(document.body).backgroundColor === paper', arg=paper)
    page.close()
