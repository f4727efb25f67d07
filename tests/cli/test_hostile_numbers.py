"""Numbers that nobody writes on purpose: beyond all range, none at all, of magnitudes that no formula bears."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from refusals import refusal

from magphonon import InversePower
from magphonon.bands.zone import ZoneMap
from magphonon.cli.main import main
from magphonon.errors import finite, not_negative, number, positive, whole
from magphonon.files import write_columns
from magphonon.planning.plan import Plan
from magphonon.response.frf import FrequencyResponse
from magphonon.scenes.scene import read_scene, ready_scene
from magphonon.waves.scan_tables import read_scan

PROTOTYPE = ready_scene('prototype').read_text()

# --- numbers ---------------------------------------------------------------------------------------------------------

HUGE = [2**64, 10**25, 10**400, -(10**400), Fraction(10**400, 3), 10**5000]


@pytest.mark.parametrize('value', HUGE, ids=lambda value: f'{len(hex(int(value)))} digits')
def test_numbers_beyond_all_range_are_taken_or_refused_by_name(value):
    for check in (number, positive, not_negative, whole):
        try:
            assert check('b', value) == float(value)
        except ValueError as error:
            assert str(error).startswith('b must be a ')  # noqa: PT017  one of both may happen
            assert len(str(error)) < 400  # noqa: PT017
        else:
            assert abs(value) < 1e308
            assert check is not whole
    with pytest.raises(ValueError, match=r'b\[0\] is inf|b must hold numbers'):
        finite('b', [10**400])


def test_whole_numbers_end_where_floats_skip_some():
    assert whole('n', 2**53) == 2**53
    for value in (2**53 + 2, 1e300):
        with pytest.raises(ValueError, match='n must be a whole number of at least 1 and at most 9007199254740992, not'):
            whole('n', value)


def test_numbers_of_numpy_are_shown_as_numbers():
    for value in (np.float64(-2.5), np.float32(-2.5), np.int64(-3)):
        with pytest.raises(ValueError, match=f'b must be a positive number, not {value.item()}$'):
            positive('b', value)


@pytest.mark.parametrize('tolerance', [np.nan, 0.0, -1.0, np.inf])
def test_a_plan_has_a_tolerance(tolerance):
    with pytest.raises(ValueError, match='tolerance must be a positive number'):
        Plan('bands', 'the highest', tolerance, (), (), 0.0)


def test_laws_take_large_whole_numbers():
    assert InversePower(10**30, 4).dphi(2.0) == InversePower(1e30, 4.0).dphi(2.0)


@pytest.mark.parametrize('value', [2**64, 10**25])
@pytest.mark.parametrize(('key', 'line'), [
    ('law.a', 'a = 4.5824'), ('lattice.mass_kg', 'mass_kg = 7.07e-4'), ('bands.points', 'points = 300'),
    ('foundation.pillar.youngs_modulus_Pa', 'youngs_modulus_Pa = 71e9'), ('frf.to_Hz', 'to_Hz = 70.0'),
    ('burst.duration_s', 'duration_s = 0.5'), ('vibrometer.sampling_rate_Hz', 'sampling_rate_Hz = 1000'),
    ('patch.side_m', 'side_m = 0.3'), ('burst.cycles', 'cycles = 5  ')])
def test_huge_whole_number_in_a_scene_is_named(key, line, value, scene_file):
    said = refusal(scene_file({line: f'{line.split(" =")[0]} = {value}'}))
    assert said.startswith((key, 'its numbers are too large'))


@pytest.mark.parametrize(('key', 'value', 'bound'), [
    ('burst.cycles', '1e-300', '0.5'), ('burst.force_N', '5e-324', '1e-30'), ('burst.damping_ratio', '1e300', '1'),
    ('burst.duration_s', '1e300', '1e+09'), ('vibrometer.noise_m', '1e12', '1e+06'), ('lattice.mass_kg', '1e12', '1e+09'),
    ('frf.to_Hz', '1e300', '1e+12'), ('frf.from_Hz', '1e-300', '1e-09'), ('frf.damping_per_s', '1e-300', '1e-09'),
    ('patch.side_m', '1e300', '1e+06')])
def test_absurd_values_are_refused_with_their_range(key, value, bound, scene_file):
    table, name = key.split('.')
    after = PROTOTYPE.partition(f'[{table}]')[2]
    line = next(line for line in after.splitlines() if line.startswith(f'{name} = '))
    said = refusal(scene_file({line: f'{name} = {value}'}))
    assert said.startswith(f'{key} must lie between ')
    assert bound in said
    assert f'not {float(value)!r}' in said


def test_millimetres_in_place_of_metres(scene_file):
    """12 m between magnets that need 12 mm: the static forces would be 4e-17 of the foundation, below any round-off."""
    said = refusal(scene_file({'spacing_m = 0.01 ': 'spacing_m = 12 '}))
    assert said.startswith('lattice.spacing_m = 12.0: the repulsion then has a stiffness of ')
    assert 'did you mean 0.012?' in said
    assert read_scene(scene_file({'spacing_m = 0.01 ': 'spacing_m = 0.012 '})).lattice.spacing_m == 0.012


@pytest.mark.parametrize(('mass', 'fine'), [(1.13e-3, True), (1.13, False), (1.13e-6, False)])
def test_a_magnet_has_the_density_of_a_magnet(mass, fine, tmp_path):
    """A disc of 8 x 3 mm has 0.15 cm3: 1.13 g is NdFeB; 1.13 kg would be 7.5e6 kg/m3."""
    text = (f'title = "discs"\n[lattice]\nkind = "square"\nspacing_m = 0.012\nmass_kg = {mass}\n[law]\nkind = "magnets"\n'
            'grade = "N42"\nshells = 1\n[law.disc]\ndiameter_m = 8e-3\nheight_m = 3e-3\n')
    file = tmp_path / 'my.toml'
    file.write_text(text)
    if fine:
        read_scene(file)
    else:
        assert refusal(file).startswith(f'lattice.mass_kg = {mass!r} would give the magnet {mass / 1.508e-7:.3g} kg/m3')


# --- results that are no numbers -----------------------------------------------------------------------------------


@pytest.mark.parametrize('number', [np.nan, np.inf, complex(0, -np.inf)])
def test_results_that_are_no_numbers_are_not_written(number, tmp_path):
    response = FrequencyResponse(np.array([1.0, 2.0]), np.array([1 + 1j, number]))
    with pytest.raises(FloatingPointError, match=r'response would be .* in 1 of 2 entries of r.npz, so it is not written'):
        response.save(tmp_path / 'r.npz')
    with pytest.raises(FloatingPointError, match=r'b_m would be'):
        write_columns(tmp_path / 'r.csv', ['a_m', 'b_m'], [[1.0, 2.0], [3.0, abs(number)]])
    assert list(tmp_path.iterdir()) == []


def test_nan_where_it_means_no_value_is_written(tmp_path):
    """Group velocities have none at a frequency of zero; infinity has no such meaning."""
    mesh = ZoneMap(np.eye(3), np.zeros((1, 1, 3)), np.zeros((1, 1, 2)), np.full((1, 1, 2, 2), np.nan))
    mesh.save(tmp_path / 'zone.npz')
    assert np.isnan(ZoneMap.load(tmp_path / 'zone.npz').velocity).all()
    with pytest.raises(FloatingPointError, match='velocity would be inf'):
        replace(mesh, velocity=np.full((1, 1, 2, 2), np.inf)).save(tmp_path / 'zone.npz')


def test_a_command_whose_result_overflows_writes_nothing(tmp_path, capsys, monkeypatch):
    from magphonon.response import frf

    def overflown(*arguments):
        response = receptance(*arguments)
        return replace(response, response=response.response * np.where(np.arange(len(response.omega)) < 3, np.inf, 1))

    receptance = frf.receptance
    file = tmp_path / 'my.toml'
    file.write_text(ready_scene('oscillator').read_text())
    with np.errstate(invalid='ignore'):
        monkeypatch.setattr(frf, 'receptance', overflown)
        assert main(['frf', str(file), '-o', str(tmp_path / 'out')]) == 2
    said = capsys.readouterr().err
    assert said.startswith('magphonon: response would be ')
    assert said.endswith(f'check units and exponents in [lattice], [law] and [frf] of {file}\n')
    assert list(tmp_path.iterdir()) == [file]


# --- magnitudes that no formula bears ------------------------------------------------------------------------------


@pytest.mark.parametrize(('given', 'key'), [('a_percent = 450.0', 'a_percent = 450.0'), ('a = 20.6', 'a = 20.6'),
                                            ('a_percent = 51.0', 'a_percent = 51.0')])
def test_tolerances_in_which_nothing_is_linear(given, key, scene_file):
    with pytest.raises(ValueError, match=f'uncertainty.{key} is .* of a, more than the 0.5 within which a linear propagation'):
        read_scene(scene_file({'a_percent = 0.45': given}, 'tolerances'))


def test_half_is_still_a_tolerance(scene_file):
    scene = read_scene(scene_file({'a_percent = 0.45': 'a_percent = 50.0'}, 'tolerances'))
    assert scene.uncertainty.tolerances(scene).covariance.max() == pytest.approx(0.25)


@pytest.mark.parametrize(('u', 'fine'), [('1e300', False), ('1e-300', False), ('2e3', False), ('0', True), ('1e-12', True)])
def test_displacements_that_no_lattice_makes(u, fine, tmp_path):
    """Their squares, the power on a map, are infinite or zero."""
    file = tmp_path / 'scan.csv'
    file.write_text('time_s,particle,u_x_m,u_y_m\n' + ''.join(f'{0.001 * k},7,{u},0\n' for k in range(4)))
    if fine:
        assert read_scan(file).motions['x'].shape == (4, 1)
        return
    with pytest.raises(ValueError, match='which is none of a lattice; check the unit in the header and the exponents'):
        read_scan(file)
