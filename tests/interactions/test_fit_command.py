"""The command that fits measured forces: what it writes and says, and what it refuses."""

import re

import numpy as np
import pytest
from measured_forces import L0, LAW, SYNTHETIC, R, rings, synthetic_forces, write

from magphonon import units as u
from magphonon.bands.bloch import bloch_modes
from magphonon.cli.main import main
from magphonon.interactions.fits import SharedErrors, fit_forces
from magphonon.interactions.force_tables import read_forces
from magphonon.interactions.pair_laws import local_exponent, repulsion
from magphonon.scenes.scene import read_scene, ready_scene


def test_the_synthetic_set_says_so_and_can_be_made_again():
    text = SYNTHETIC.read_text()
    assert text.startswith('# SYNTHETIC: computed, not measured.')
    assert "ready_scene('rings')" in text
    forces, again = read_forces(SYNTHETIC), synthetic_forces(rings(), np.linspace(8, 15, 15), 2e-3, seed=1911)
    np.testing.assert_allclose(forces.r, again.r, rtol=1e-12)
    np.testing.assert_allclose(forces.f, again.f, atol=6e-7)  # six decimals are printed
    np.testing.assert_allclose(forces.sigma, again.sigma, rtol=1e-12)


def test_the_tables_of_the_prototype_are_two_measurements_of_one_lattice(tmp_path, monkeypatch, capsys):
    """By their names from any folder; the force of both is that of the paper, 0.2369 N, and that of the rings is another."""
    forces = read_forces(SYNTHETIC.parent / 'prototype_force.csv')
    again = synthetic_forces(read_scene(ready_scene('prototype')).law.potential(), np.linspace(8, 15, 15), 2e-3, seed=1911)
    np.testing.assert_allclose(forces.f, again.f, atol=6e-7)
    monkeypatch.chdir(tmp_path)
    found = {}
    for name, words in (('prototype_force', ['--spacing', '10mm']), ('synthetic_force', ['--spacing', '10mm']),
                        ('prototype_ridges', ['--bands', str(ready_scene('prototype'))])):
        assert main(['fit', name, *words]) == 0
        printed = capsys.readouterr().out
        found[name] = [float(x) for x in re.search(r'force .*?([\d.]+) N \(([\d.]+) to ([\d.]+)\)', printed).groups()]
        assert 'scatter by more' not in printed
    assert all(found[name][1] < 0.2369 < found[name][2] for name in ('prototype_force', 'prototype_ridges'))
    assert not found['synthetic_force'][1] < 0.2369 < found['synthetic_force'][2]
    (tmp_path / 'prototype_force').write_text('r_m,f_N\n1,2\n')  # a file of the user comes first
    assert main(['fit', 'prototype_force']) == 2


def scene_with(entry, folder):
    text = ready_scene('rings').read_text()
    start, end = text.index('[law]'), text.index('[foundation.pillar]')
    (folder / 'pasted.toml').write_text(text[:start] + entry + '\n' + text[end:])
    return read_scene(folder / 'pasted.toml')


@pytest.mark.slow
def test_the_entry_is_a_law_with_its_uncertainty_for_a_scene(tmp_path, capsys):
    assert main(['fit', str(SYNTHETIC), '--spacing', '10mm', '--sigma', 'distance=0.05mm', '-o', str(tmp_path / 'out')]) == 0
    printed = capsys.readouterr().out
    assert sorted(path.name for path in (tmp_path / 'out').iterdir()) == ['fit.png', 'law.toml']
    entry = (tmp_path / 'out' / 'law.toml').read_text()
    assert entry in printed
    fit = fit_forces(read_forces(SYNTHETIC), L0, SharedErrors(distance=0.05))
    scene = scene_with(entry.replace('shells = "auto"', 'shells = 1'), tmp_path)  # as in the formula below
    law = scene.law.potential()
    assert repulsion(law, L0) == pytest.approx(fit.force, rel=1e-6)  # seven digits are printed
    assert local_exponent(law, L0) == pytest.approx(fit.exponent, rel=1e-3)
    assert main(['bands', str(tmp_path / 'pasted.toml'), '-o', str(tmp_path / 'u')]) == 0
    said = capsys.readouterr().out
    f, a = fit.covariance[0, 0] ** 0.5, fit.covariance[1, 1] ** 0.5
    assert scene.uncertainty.force_percent == pytest.approx(100 * f, rel=1e-4)
    assert scene.uncertainty.exponent == pytest.approx(a, rel=1e-4)
    shear = next(line for line in said.splitlines() if line.lstrip().startswith('M, branch 1')).split()
    # omega^2 of the shear branch at M is foundation/m + 2 (a - 3) f/(m r0) by the paper, with the covariance of ln f and a
    w2 = bloch_modes(scene.perfect_cell(), [[0.5, 0, 0]])[0][0, 0] ** 2 * 1e6
    c = 2 * fit.force / (scene.lattice.mass_kg * 0.01)
    slopes = np.array([c * (fit.exponent - 3), c]) / (2 * np.sqrt(w2)) / (2 * np.pi)
    assert float(shear[3]) == pytest.approx(np.sqrt(slopes @ fit.covariance @ slopes), rel=0.02)


SLACK = ''.join(['r_mm,f_N,direction\n', *(f'{r!r},{f + 0.016 * (way == "return")!r},{way}\n' for way in ('approach', 'return')
                                            for r, f in zip(R.tolist(), repulsion(LAW, R).tolist(), strict=True))])


@pytest.mark.parametrize(('text', 'options', 'words'), [
    ('', ['--verbose'], ['Assumed beforehand: the zero of the distances is known to 0.2 mm',
                         'Causes of the uncertainty of the slope, as shares of its variance: zero of distance',
                         '8 to 15 mm do not determine the kind of law']),
    ('', ['--verbose', '--sigma', 'pair=3%'], ['scatter about their mean by 3 % (one standard deviation, as stated)']),
    (SLACK, ['--sigma', 'hysteresis=1mN'], ['The hysteresis comes out as 0.00']),
    *(('', ['--spacing', spacing], ['At 10 mm the force is 0.']) for spacing in ('0.01', '10mm', '10 mm', '1e4um')),
])
def test_what_a_fit_of_forces_says(text, options, words, tmp_path, capsys):
    """Of the synthetic set, or of a `text`."""
    assert main(['fit', write(tmp_path, text) if text else str(SYNTHETIC), *options]) == 0
    said = capsys.readouterr().out
    assert [one for one in words if one not in said] == []


def test_a_scene_of_magnets_gives_the_law_its_shape(capsys):
    assert main(['fit', '--verbose', 'rings', str(SYNTHETIC)]) == 0
    assert 'rings, rather than a free curve, has the probability' in capsys.readouterr().out


GOOD = [f'{r / 1e3},{repulsion(LAW, r)}' for r in R[:8].tolist()]


TABLES = [
    (['r_m,f_N'], 'holds no rows below its header'),
    ([], 'is empty'),
    (['distance,force', *GOOD], "lacks the column r_m (its header is 'distance,force')"),
    (['\x89PNG\r', 'x'], 'a table of forces has the columns'),
    (['r_m,f_N', *GOOD[:2]], '2 rows are too few to determine the law and their noise: measure at least 6'),
    (['# a comment', 'r_m,f_N', *GOOD, '0.02'], 'line 11 of '),
    (['r_m,f_N', '0,1', *GOOD], 'is 0 m in line 2: the particles touch at 0.00635 m; give distances of the centres'),
    (['r_m,f_N,sigma_N', *(row + ',0' for row in GOOD)], '0 N in line 5, 0 N in line 6 and 3 more: leave the column out'),
    (['r_m,f_N', '0.005,2', *GOOD], 'between 0.00635 and 1e+06 m, but is 0.005 m in line 2: the particles touch at 0.00635 m; '
                                    'give distances of the centres'),
    (['r_m,f_N', *(f'{0.01 * k},{0.01 * k}' for k in range(1, 9))], 'the forces need not fall with the distance'),
    (['r_m,f_N', *(row.replace(',', ',-') for row in GOOD)], 'the forces are negative, but repulsion counts as positive'),
    (['r_m,f_N,direction', *(row + ',sideways' for row in GOOD)], "direction must be approach or return, not 'sideways'"),
]
"""Rows of tables that cannot be used, and what is said about them."""
OPTIONS = [
    (['--spacing', '-1'], '--spacing must be a positive number in mm, not -1000'),
    (['--spacing', '10 parsec'], 'not a number with one of the units m, mm'),
    (['--sigma', 'pair=3'], "--sigma: must be at least 0 and below 1, not '3'; write 3 percent as 0.03 or 3%"),
    (['--sigma', 'distance=-0.1mm'], 'distance must be a zero or positive number in mm, not -0.1'),
    (['--sigma', 'width=1mm'], "'width=1mm' must be one of distance, zero, hysteresis, backlash, gain, pair"),
    (['--spacing', '0.03'], 'the spacing 0.03 m is a factor 2 beyond the data, 0.008 to 0.015 m'),
    (['--spacing', '12'], 'did you mean 0.012 m?'),
    (['--bands', 'prototype', '--sigma', 'zero=1mN'], '--sigma belongs to a fit of forces'),
]
"""Options that do not fit the synthetic set, and what is said about them."""
FILES = [
    (['BINARY'], 'is not a text file'), (['none.csv'], 'none.csv is not there'), ([''], "'' is not there"),
    (['prototype.toml'], 'is a scene; name after it what was measured'),
    (['prototype.toml', 'ideal.toml'], 'ideal.toml is a scene and holds no measurements'),
    (['prototype_ridges'], 'prototype_ridges.csv holds ridges; name the scene of their lattice first: magphonon fit SCENE.toml'),
]
"""Files that hold no forces."""


@pytest.mark.parametrize(('rows', 'words', 'message'), [
    *((rows, ['table.csv', '--contact', '0.00635'], message) for rows, message in TABLES),
    *((None, [str(SYNTHETIC), *options], message) for options, message in OPTIONS),
    *((None, files, message) for files, message in FILES),
])
def test_what_cannot_be_fitted_is_refused(rows, words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'table.csv').write_text(''.join(f'{row}\n' for row in rows or []))
    (tmp_path / 'BINARY').write_bytes(bytes(range(128, 256)))
    for name in ('prototype', 'ideal'):
        (tmp_path / f'{name}.toml').write_text(ready_scene(name).read_text())
    try:
        status = main(['fit', *words, '-o', 'out'])
    except SystemExit as refused:  # by the parser
        status = refused.code
    assert status == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


def test_a_spacing_outside_the_data_has_wide_intervals():
    forces = read_forces(SYNTHETIC)
    inside, outside = (fit_forces(forces, r, SharedErrors(distance=0.0)) for r in (15 * u.mm, 20 * u.mm))
    assert (outside.half_widths > 1.5 * inside.half_widths).all()
    truth = np.array([np.log(repulsion(rings(), 20.0)), local_exponent(rings(), 20.0)])
    assert (abs(np.array([np.log(outside.force), outside.exponent]) - truth) < outside.half_widths[[0, 2]]).all()


def test_gaps_between_faces_are_refused_where_the_magnet_is_named(tmp_path, capsys):
    """Rings of 6.35 mm: the same forces over the distance of the centres pass."""
    for add, code in ((0.0, 2), (6.35, 0)):
        rows = [f'{gap + add},{(6.35 / (gap + 6.35)) ** 3}' for gap in (0.65, 1, 2, 3, 4, 5, 7, 9)]
        (tmp_path / 'gaps.csv').write_text('\n'.join(['r_mm,f_N', *rows]))
        assert main(['fit', str(ready_scene('rings')), str(tmp_path / 'gaps.csv'), '--spacing', '10mm']) == code
        assert ('give distances of the centres, not gaps' in capsys.readouterr().err) == (code == 2)


def test_the_scene_that_takes_the_law_is_named_and_has_a_table_for_it(tmp_path, capsys):
    """And a file that is there is replaced only on demand."""
    mine = tmp_path / 'mine.toml'
    assert main(['fit', str(SYNTHETIC), '-o', str(mine)]) == 2
    assert 'name first the scene' in capsys.readouterr().err
    mine.write_text('title = "x"\nlaw = {kind = "inverse_power", b_N_m_a = 2e-9, a = 4.0}\n'
                    'lattice = {kind = "square", spacing_m = 0.01, mass_kg = 7e-4}\n')
    for options, words in (([], 'exists; name another place'), (['--force'], 'write its law as such a table')):
        assert main(['fit', str(mine), str(SYNTHETIC), '-o', str(mine), *options]) == 2
        assert words in capsys.readouterr().err


def test_a_force_too_uncertain_for_a_scene_is_told_of_its_cause(tmp_path, capsys):
    """Six rows without noise are enough, whether or not they say so; the last table does not say where its distances begin."""
    def fitted(header, *options):
        r = np.linspace(8, 14, 6)
        lines = [f'{x:.6g},{0.2369 * (x / 10) ** -4.58:.5f},1e-4' for x in r]
        (tmp_path / 'f.csv').write_text('\n'.join([header, *lines]))
        status = main(['fit', str(ready_scene('prototype')), str(tmp_path / 'f.csv'), *options])
        return status, *capsys.readouterr()

    to_scene = '-o', str(tmp_path / 'x.toml'), '--force'
    for header in ('r_mm,f_N,other', 'r_mm,f_N,sigma_N'):
        assert fitted(header, *to_scene)[::2] == (0, '')
        assert 5 < read_scene(tmp_path / 'x.toml').uncertainty.force_percent < 12  # 9.5 by 0.2 mm of the distances
    (tmp_path / 'x.toml').unlink()
    status, _, told = fitted('r_mm,f_N,sigma_N', '--sigma', 'distance=3mm', *to_scene)
    assert (status, 'most of it comes from: zero of distance' in told, 'uncertainty.' in told) == (2, True, False)
    assert not (tmp_path / 'x.toml').exists()
    assert 'most of it comes from' in fitted('r_mm,f_N,other', '--sigma', 'distance=3mm')[1]  # printed with the answer
