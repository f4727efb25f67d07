"""`magphonon check` on good and bad scenes: its words, its numbers from closed forms, its exit status."""

import re

import numpy as np
import pytest
from scene_files import ready_scene
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.bands.bloch import bloch_modes
from magphonon.cli.main import main
from magphonon.response.normal_modes import natural_frequencies

FINE, BAD = 0, 1

# scene, changes of its text, exit status, what it must say.  The ideal law has f(L0)/L0 = 10 kN/m.
SCENES = {
    'prototype': ('prototype', {}, FINE, [
        'Lattice: OK\n', 'Patch: OK\n', 'Stable in the plane, even without a foundation.',
        # 9 (a - 1) f/L0 at K, 6 (a - 1) f/L0 alone, 9 f/L0 for a central force, with a = 4.5824 and f/L0 = 23.6895 N/m
        'at least 763.8 N/m for upright magnets (509.2 N/m if only one of them can move). For particles whose forces are along '
        'the lines between them 213.2 N/m is enough.',
        'highest frequency of 149.5 Hz',
        'a cut-off frequency of 26.5507 Hz']),  # sqrt(19.6757 N/m / 0.70698 g)/2 pi
    'chain on springs': ('chain', {}, FINE, [
        'Stable in the plane: the foundation of 50 kN/m is 25 % more than the 40 kN/m needed.',
        'below a spacing of 0.9564 m']),  # 4 f/L0 = 4e4 s^-5 = 5e4
    'chain on too soft springs': ('chain', {'5e4': '3e4'}, BAD, [
        'Lattice: UNSTABLE (1 problem)', 'buckles in the plane, with the softest mode at q = (0.5, 0, 0)',
        'grows e-fold in 0.01 s',  # sqrt((4e4 - 3e4)/1 kg) = 100/s
        'needs a foundation of 40 kN/m and has 30 kN/m', 'A spacing above 1.059 m would also make it stable']),  # (4/3)^(1/5)
    'triangular, a = 2.9': ('ideal', {'a = 4.0': 'a = 2.9'}, BAD, [
        'needs a foundation of 2000 N/m and has 0 N/m']),  # 2 (3 - a) f/L0
    'triangular, a = 3.1': ('ideal', {'a = 4.0': 'a = 3.1'}, FINE, [
        'Stable in the plane, even without a foundation', 'The linear theory holds for small motion']),
    'square on nothing': ('ideal', {'kind = "triangular"': 'kind = "square"', 'GMKG': 'GXM'}, BAD, [
        'needs a foundation of 40 kN/m and has 0 N/m']),
    'kagome just held': ('ideal', {'kind = "triangular"': 'kind = "kagome"',
                                   '[bands]': '[foundation]\nstiffness_N_per_m = 6.06e4\n\n[bands]'}, FINE, [
        '1 % more than the 60 kN/m needed']),  # 6 f/L0
    'oscillator at 60 degrees': ('oscillator', {'theta0_deg = 30.0': 'theta0_deg = 60.0'}, FINE, [
        'A constant force of -27320.5 N']),  # (1 + 2 sin 60) f
    'oscillator flat and of a long reach': ('oscillator', {'theta0_deg = 30.0': 'theta0_deg = 5.0', 'a = 4.0': 'a = 1.5'}, BAD, [
        'needs a foundation of 4620 N/m']),  # along its guide: D_yy = 2 (a + 1) sin^2 5 deg + a - 2 = -0.46202 f/L0
    'dust': ('dust', {}, FINE, ['Stable in the plane']),  # all neighbours hold what the nearest ones cannot
    'dust, nearest neighbours only': ('dust', {'shells = "all"': 'shells = 1'}, BAD, [
        'buckles in the plane', 'has 0 N/m', 'A spacing above 0.001294 m would also make',  # kappa L0 at the golden ratio
        'an out-of-plane stiffness of at least 426.8 pN/m.']),  # 9 f/L0 at K of a central force, f = 2 c/(e L0^2)
    'a patch too large for a verdict of its own': ('bench', {'side_m = 0.3 ': 'side_m = 1.3 '}, FINE, [
        'Lattice: OK\n', 'particles, more than 20000, and is not checked separately']),
    'steel balls': ('steel', {}, FINE, [
        # 9 f/L0 at K, f = A (D - r)^1.5 = 55.45 N; no word of other spacings, at which balls are not in contact
        'Stable in the plane, even without a foundation.\n', 'an out-of-plane stiffness of at least 24.96 kN/m.']),
}


@pytest.mark.parametrize('name', few_first(SCENES, 7))
def test_verdict_says_what_theory_says(name, tmp_path, capsys):
    base, changes, status, words = SCENES[name]
    text = re.sub(r'(cells_\d) = 60', r'\1 = 16', ready_scene(base).read_text())  # the verdict is that of the lattice
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / 'my.toml'
    file.write_text(text)
    assert main(['check', '--verbose', str(file)]) == status
    said = capsys.readouterr().out
    for phrase in words:
        assert phrase in said
    assert ('(1 problem)' in said) == (status == BAD)


@pytest.mark.parametrize('seed', few_first(range(6), 3))
def test_a_patch_lies_within_the_spectrum_of_its_lattice(seed):
    """Why a large patch need not be judged by itself, on drawn lattices, foundations and shapes, also on some that buckle."""
    rng = np.random.default_rng(seed)
    kind, size = rng.choice(['square', 'triangular', 'honeycomb', 'kagome']), rng.integers(5, 9, 2)
    a, k = rng.uniform(1.5, 6), rng.uniform(0, 200)
    law = InversePower(b=1e4, a=a)
    cell = getattr(lattices, kind)(10.0, 1.0)
    cell.calc = MagneticRepulsion(cell, law, foundation=k * law.d2phi(10.0) / 100)
    patch = lattices.parallelogram(cell, *map(int, size))
    patch.calc = MagneticRepulsion(patch, law, foundation=cell.calc.parameters.foundation)
    q = np.stack(np.meshgrid(*2 * [np.arange(48) / 48], [0.0]), axis=-1).reshape(-1, 3)
    of_lattice, of_patch = bloch_modes(cell, q)[0], natural_frequencies(patch)
    assert of_lattice.min() - 1e-9 < of_patch.min()
    assert of_patch.max() < of_lattice.max() + 1e-9

    masses = patch.get_masses()
    masses[np.flatnonzero(patch.get_tags() == 0)[0]] /= 10  # control: a light particle sings above the bands
    patch.set_masses(masses)
    assert natural_frequencies(patch).max() > of_lattice.max() + 1e-9


def test_the_answer_is_one_line_and_everything_has_it_first(tmp_path, capsys):
    """And a line on neighbours, for who copies a ready scene that omits them."""
    assert main(['check', 'square']) == FINE
    short = capsys.readouterr().out
    assert short.startswith('Stable in the plane: the foundation of 157.4 N/m is 66 % more than the 94.76 N/m needed.')
    assert short.count('\n') == 1
    (tmp_path / 'my.toml').write_text(ready_scene('square').read_text())
    assert main(['check', str(tmp_path / 'my.toml')]) == FINE
    first, second = capsys.readouterr().out.splitlines()
    assert first == short.strip()
    assert second.startswith('Nearest neighbours only (shells = 1): farther ones would shift branch 1 at X by +39 %')
    assert main(['check', '--verbose', str(tmp_path / 'my.toml')]) == FINE
    assert capsys.readouterr().out.startswith(short)
    (tmp_path / 'soft.toml').write_text(ready_scene('chain').read_text().replace('5e4', '3e4'))
    assert main(['check', str(tmp_path / 'soft.toml')]) == BAD
    assert 'Lattice: UNSTABLE (1 problem)' in capsys.readouterr().out  # faults are told in short, too
