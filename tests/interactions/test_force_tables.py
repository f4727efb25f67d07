"""Tables of measured forces: headers with units, sizes, and what is refused."""

import numpy as np
import pytest
from measured_forces import L0, LAW, R, rings, table_of, without_sigma, write

from magphonon.cli.main import main
from magphonon.interactions.force_tables import Forces, read_forces, synthetic_forces
from magphonon.interactions.law_choice import fit_laws
from magphonon.interactions.pair_laws import repulsion
from magphonon.interactions.smooth_laws import fit_spline


@pytest.mark.parametrize(('header', 'join', 'units'), [
    ('r_m,f_N', ',', (1e-3, 1)), ('# measured on Monday\n# r_um f_uN', ' ', (1e3, 1e6)), ('r_mm;f_N', ';', (1, 1)),
])
def test_a_header_names_its_units(tmp_path, header, join, units):
    f = repulsion(LAW, R)
    forces = read_forces(write(tmp_path, table_of(R * units[0], f * units[1], header, join)))
    np.testing.assert_allclose(forces.r, R, rtol=1e-14)
    np.testing.assert_allclose(forces.f, f, rtol=1e-14)
    assert forces.sigma is None


def test_rows_up_and_down_repeated_and_in_any_order_are_read_as_they_are(tmp_path):
    """The normal form of such a table: the machine goes down and up again, with decimal commas."""
    noise = 1 + 0.01 * np.random.default_rng(4).normal(size=2 * len(R))
    r, f = np.concatenate([R, R[::-1]]), np.concatenate([repulsion(LAW, R), repulsion(LAW, R[::-1])]) * noise
    down_and_up = read_forces(write(tmp_path, table_of(r, 1e3 * f, 'r_mm;f_mN', ';').replace('.', ',')))
    order = np.random.default_rng(5).permutation(len(r))
    shuffled = read_forces(write(tmp_path, table_of(r[order], f[order], 'r_mm,f_N')))
    np.testing.assert_array_equal(down_and_up.r, np.repeat(R, 2))
    fits = [fit_laws(forces, L0).fits['curve'] for forces in (down_and_up, shuffled)]
    np.testing.assert_allclose(fits[0].at_spacing, fits[1].at_spacing, rtol=1e-9)
    assert (abs(fits[0].at_spacing - [repulsion(LAW, L0), -LAW.d2phi(L0)]) < 1.5 * fits[0].half_width).all()
    once = fit_laws(Forces(R, f[:len(R)]), L0).fits['curve']
    assert (fits[0].half_width < once.half_width).all()  # each row counts


def test_all_faults_of_a_table_are_said_in_one_go(tmp_path, capsys):
    text = 'r_mm,f_N,sigma_N\n8,1,0.1\n9,-0.5,0.1\n10,0.2,0\n-11,0.1,0.1\n12,-0.1,0.1\n'
    assert main(['fit', write(tmp_path, text)]) == 2
    said = capsys.readouterr().err
    for words in ('r_mm must lie between 1e-12 and 1e+06 m, and is -0.011 m in line 5',
                  'f_N must lie between 1e-30 and 1e+12 N, and is -0.5 N in line 3, -0.1 N in line 6', 'sigma_N must', 'line 4'):
        assert words in said
    assert main(['fit', write(tmp_path, 'r_mm,f_N\n' + ''.join(f'{r},-1\n' for r in range(8, 40)))]) == 2
    assert 'in line 6 and 27 more' in capsys.readouterr().err


def test_tables_that_would_be_read_wrongly_are_refused(tmp_path, capsys):
    f = repulsion(LAW, R)
    for text, message in [
            (table_of(R, f), 'the distances are 8 to 15 under the header r_m; if they are millimetres, head the column r_mm'),
            (table_of(R / 1e3, 0 * R + 0.3), 'the forces do not fall with the distance (a = '),
            ('r_mm,f_N\n9,2\n9,2.1\n9,2.2\n10,1\n', 'an inverse power needs at least 3 distances, not 2'),
    ]:
        assert main(['fit', write(tmp_path, text)]) == 2
        assert message in capsys.readouterr().err
    noise = np.random.default_rng(0).normal(0.3, 0.01, len(R))
    with pytest.raises(ValueError, match='fall'):
        fit_laws(Forces(R, noise), L0)


@pytest.mark.parametrize('known', [True, False])
def test_many_points_are_averaged_and_answer_as_all_of_them(known):
    """60 000 points took 27 GiB once.  The truth is known to the digits that so many points give."""
    r = np.linspace(8, 15, 60_000)
    forces = synthetic_forces(rings(), r, 5e-3, 1)
    bins, counts = forces.binned(500)
    assert len(bins.r) == 500
    assert counts.sum() == len(r)
    np.testing.assert_allclose(bins.sigma, 5e-3 / np.sqrt(counts), rtol=1e-10)
    fit = fit_spline(forces if known else without_sigma(forces), L0)
    truth = np.array([repulsion(rings(), L0), -rings().d2phi(L0)])
    assert (abs(fit.at_spacing - truth) < 1.5 * fit.half_width).all()  # one seed: three standard uncertainties
    assert (fit.half_width < 1e-3 * abs(truth)).all()  # 200 times less than one point says


def test_the_law_of_averaged_points_reaches_from_the_first_force_to_the_last(tmp_path, capsys):
    """Averages lie inside the data: a table that ended at the outermost of them could not be drawn over all of it."""
    r = np.linspace(8, 15, 3000)
    forces = synthetic_forces(rings(), r, 5e-3, 1)
    law = fit_spline(forces, L0).law
    assert (law.r[0], law.r[-1]) == (r[0], r[-1])
    assert forces.binned(500)[0].r[0] > r[0] * (1 + 1e-4)  # the control
    assert main(['fit', write(tmp_path, table_of(r / 1e3, forces.f)), '--spacing', '0.01', '-o', str(tmp_path / 'out')]) == 0
    assert 'forces from 0.008 to 0.015 m' in capsys.readouterr().out
