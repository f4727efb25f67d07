"""Tables of measured forces: headers with units, sizes, and what is refused."""

import numpy as np
import pytest
from measured_forces import L0, LAW, R, rings, synthetic_forces, table_of, write

from magphonon.cli.main import main
from magphonon.interactions.fits import SharedErrors, fit_forces
from magphonon.interactions.force_tables import read_forces
from magphonon.interactions.pair_laws import repulsion


@pytest.mark.parametrize(('header', 'join', 'units'), [
    ('r_m,f_N', ',', (1e-3, 1)), ('# measured on Monday\n# r_um f_uN', ' ', (1e3, 1e6)), ('r_mm;f_N', ';', (1, 1)),
])
def test_a_header_names_its_units(tmp_path, header, join, units):
    f = repulsion(LAW, R)
    forces = read_forces(write(tmp_path, table_of(R * units[0], f * units[1], header, join)))
    np.testing.assert_allclose(forces.r, R, rtol=1e-14)
    np.testing.assert_allclose(forces.f, f, rtol=1e-14)
    assert forces.sigma is None


def test_errors_of_distances_and_the_zero_of_a_balance(tmp_path):
    """Each row may have an uncertainty of its distance; a column in grams is that of a balance, whose zero is known."""
    f = repulsion(LAW, R)
    forces = read_forces(write(tmp_path, table_of(R, f, 'r_mm,f_N').replace('f_N\n', 'f_N,sigma_r_um\n').replace('\n', ',150\n')
                               .replace('sigma_r_um,150', 'sigma_r_um')))
    np.testing.assert_allclose(forces.sigma_r, 0.15)
    assert not forces.balance
    weighed = read_forces(write(tmp_path, table_of(R, 1e3 * f / 9.80665, 'r_mm,f_g')))
    assert weighed.balance
    zeros = [SharedErrors().sizes(one)[0] / one.f.max() for one in (forces, weighed)]
    np.testing.assert_allclose(zeros, [0.1, 1e-3])


def test_rows_up_and_down_repeated_and_in_any_order_are_read_as_they_are(tmp_path):
    """The normal form of such a table: the machine goes down and up again, with decimal commas."""
    noise = 1 + 0.01 * np.random.default_rng(4).normal(size=2 * len(R))
    r, f = np.concatenate([R, R[::-1]]), np.concatenate([repulsion(LAW, R), repulsion(LAW, R[::-1])]) * noise
    down_and_up = read_forces(write(tmp_path, table_of(r, 1e3 * f, 'r_mm;f_mN', ';').replace('.', ',')))
    order = np.random.default_rng(5).permutation(len(r))
    shuffled = read_forces(write(tmp_path, table_of(r[order], f[order], 'r_mm,f_N')))
    np.testing.assert_allclose(down_and_up.r, r, rtol=1e-14)
    np.testing.assert_allclose(shuffled.f, f[order], rtol=1e-14)
    assert not down_and_up.direction.any()
    told = table_of(r, f, 'r_mm,f_N').replace('f_N', 'f_N,direction').splitlines()
    told = [told[0], *(f'{row},{"approach" if k < len(R) else "return"}' for k, row in enumerate(told[1:]))]
    np.testing.assert_array_equal(read_forces(write(tmp_path, '\n'.join(told))).direction, np.repeat([-1, 1], len(R)))


def test_all_faults_of_a_table_are_said_in_one_go(tmp_path, capsys):
    text = 'r_mm,f_N,sigma_N\n8,1,0.1\n9,-1e13,0.1\n10,0.2,0\n-11,0.1,0.1\n'
    assert main(['fit', write(tmp_path, text)]) == 2
    said = capsys.readouterr().err
    for words in ('r_mm must lie between 1e-12 and 1e+06 m, but is -0.011 m in line 5', 'f_N must', 'line 3', 'sigma_N must',
                  'line 4'):
        assert words in said


def test_lengths_that_look_like_millimetres_are_refused(tmp_path, capsys):
    assert main(['fit', write(tmp_path, table_of(R, repulsion(LAW, R)))]) == 2
    assert 'the distances are 8 to 15 under the header r_m; if they are millimetres, head' in capsys.readouterr().err


def test_of_many_rows_every_nth_is_fitted():
    """What all rows share is no better known from more of them; 60 000 rows took 27 GiB once."""
    forces = synthetic_forces(rings(), np.linspace(8, 15, 60_000), 5e-3, 1)
    few = forces.thinned(2000)
    assert len(few.r) == 2000
    assert (few.r[0], few.r[-1]) == (8.0, pytest.approx(15.0, rel=1e-3))
    fit = fit_forces(forces, L0, SharedErrors(distance=0.05))
    assert abs(np.log(fit.force / repulsion(rings(), L0))) < fit.half_widths[0]
