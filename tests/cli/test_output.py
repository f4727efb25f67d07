"""Results that are no numbers are not written, output that nobody can read, and a measurement that is given twice."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scene_files import ready_scene

from magphonon.cli.main import main
from magphonon.design.uncertainty import Spread
from magphonon.files import write_columns
from magphonon.response.frf import FrequencyResponse


@pytest.mark.parametrize('number', [np.nan, np.inf, complex(0, -np.inf)])
def test_results_that_are_no_numbers_are_not_written(number, tmp_path):
    response = FrequencyResponse(np.array([1.0, 2.0]), np.array([1 + 1j, number]))
    with pytest.raises(FloatingPointError, match=r'response would be .* in 1 of 2 entries of r.npz, so it is not written'):
        response.save(tmp_path / 'r.npz')
    with pytest.raises(FloatingPointError, match=r'b_m would be'):
        write_columns(tmp_path / 'r.csv', ['a_m', 'b_m'], [[1.0, 2.0], [3.0, abs(number)]])
    assert list(tmp_path.iterdir()) == []


def test_nan_where_it_means_no_value_is_written(tmp_path):
    """A frequency of zero has no slope; infinity has no such meaning."""
    spread = Spread(('force',), np.eye(1), np.zeros(2), np.full((1, 2), np.nan))
    spread.save(tmp_path / 'spread.npz')
    assert np.isnan(Spread.load(tmp_path / 'spread.npz').slopes).all()
    with pytest.raises(FloatingPointError, match='slopes would be inf'):
        replace(spread, slopes=np.full((1, 2), np.inf)).save(tmp_path / 'spread.npz')


def test_a_command_whose_result_overflows_writes_nothing(tmp_path, capsys, monkeypatch):
    from magphonon.response import frf

    def overflown(*arguments, **options):
        response = receptance(*arguments, **options)
        return replace(response, response=response.response * np.where(np.arange(len(response.omega)) < 3, np.inf, 1))

    receptance = frf.receptance
    file = tmp_path / 'my.toml'
    file.write_text(ready_scene('oscillator').read_text())
    with np.errstate(invalid='ignore'):
        monkeypatch.setattr(frf, 'receptance', overflown)
        assert main(['frf', '--verbose', str(file), '-o', str(tmp_path / 'out')]) == 2
    said = capsys.readouterr().err
    assert said.startswith('magphonon: response would be ')
    assert said.endswith(f'check units and exponents, first of all in the law, in {file}\n')
    assert list(tmp_path.iterdir()) == [file]


# --- output that nobody reads ----------------------------------------------------------------------------------------

def command(*arguments, **options):
    """The command in a process of its own, as a shell would start it."""
    return subprocess.run([sys.executable, '-m', 'magphonon', *map(str, arguments)], timeout=600, text=True,
                          **({'capture_output': True} | options))


@pytest.mark.slow
def test_letters_that_the_terminal_lacks(tmp_path):
    file = tmp_path / 'chain.toml'
    file.write_text(ready_scene('chain').read_text().replace('title = "', 'title = "größe 😀 '), encoding='utf-8')
    done = command('bands', file, '--verbose', '-o', tmp_path / 'out',
                   env={**os.environ, 'PYTHONIOENCODING': 'ascii', 'LC_ALL': 'C'})
    assert (done.returncode, done.stderr) == (0, '')
    assert 'gr\\xf6\\xdfe \\U0001f600' in done.stdout


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists('/dev/full'), reason='a system without such files')
def test_a_report_that_cannot_be_shown_has_a_status_of_its_own(tmp_path):
    (tmp_path / 'law.csv').write_text('r_mm,f_N\n' + '\n'.join(f'{r},{2e4 * r**-4}' for r in range(8, 18)) + '\n')
    fit = ('fit', tmp_path / 'law.csv', '-o', tmp_path / 'out')
    for arguments, written in ((('scene', 'ideal'), ''), (fit, '; the results are written')):
        with open('/dev/full', 'w') as full:
            done = command(*arguments, capture_output=False, stdout=full, stderr=subprocess.PIPE)
        assert done.returncode == 3
        assert done.stderr.strip() == f'magphonon: the report could not be shown (No space left on device){written}'


@pytest.mark.parametrize('given', [['prototype'], ['--bands', 'prototype']])
@pytest.mark.parametrize('again', ['ridges.csv', 'copy.csv', 'noted.csv', 'turned.csv', 'kHz.csv'])
def test_a_measurement_that_is_given_twice_is_refused(given, again, tmp_path, monkeypatch, capsys):
    """Its noise would count as independent, and intervals would come out too narrow by the root of two."""
    monkeypatch.chdir(tmp_path)
    header = 'xi_rad,sigma_xi_rad,frequency_Hz,sigma_frequency_Hz,q1,q2'
    rows = [(xi, 0.01, f, 0.1, 0.0, xi / 6) for xi, f in np.random.default_rng(0).uniform(1, 3, (5, 2)).tolist()]
    kilo = [(*row[:2], row[2] / 1e3, row[3] / 1e3, *row[4:]) for row in rows]
    for name, head, own in (('ridges', header, rows), ('copy', header, rows), ('noted', f'# again\n{header}', rows),
                            ('turned', header, rows[::-1]), ('kHz', header.replace('Hz', 'kHz'), kilo)):
        (tmp_path / f'{name}.csv').write_text('\n'.join([head, *(','.join(map(repr, row)) for row in own)]))
    assert main(['fit', *given, 'ridges.csv', again]) == 2
    assert f' and {again[:-4]}: of the whole table hold the same numbers' in capsys.readouterr().err
