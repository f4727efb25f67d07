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
    ('r_m,f_N', ',', (1e-3, 1)), ('r_mm, f_mN', ', ', (1, 1e3)), ('# measured on Monday\n# r_um f_uN', ' ', (1e3, 1e6)),
    ('r_mm;f_N', ';', (1, 1)), ('"r_mm"\t"f_N"', '\t', (1, 1)), ('  r_mm   f_mN  ', '   ', (1, 1e3)),
])
def test_a_header_names_its_units(tmp_path, header, join, units):
    f = repulsion(LAW, R)
    forces = read_forces(write(tmp_path, table_of(R * units[0], f * units[1], header, join)))
    np.testing.assert_allclose(forces.r, R, rtol=1e-14)
    np.testing.assert_allclose(forces.f, f, rtol=1e-14)
    assert forces.sigma is None


def test_tables_that_would_be_read_wrongly_are_refused(tmp_path, capsys):
    f = repulsion(LAW, R)
    for text, message in [
            (table_of(R, f), 'the distances are 8 to 15 under the header r_m; if they are millimetres, head the column r_mm'),
            ('r_m,f_N\n0.008,"1\n.0"\n0.009,0.7\n', "line 2: '0.008,\"1' is not 2 numbers"),
            ('r_m,f_N\n0.008,' + '1' * 200_000 + '\n', 'is not 2 numbers'),
            ('r_m;f_N\n0,008;1,0\n', "line 2: '0,008;1,0' is not 2 numbers"),
            (table_of(R / 1e3, 0 * R + 0.3), 'the forces do not fall with the distance (a = '),
    ]:
        assert main(['fit', write(tmp_path, text)]) == 2
        assert message in capsys.readouterr().err
    noise = np.random.default_rng(0).normal(0.3, 0.01, len(R))
    with pytest.raises(ValueError, match='fall'):
        fit_laws(Forces(R, noise), L0)


def test_a_table_that_is_too_large_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr('magphonon.interactions.force_tables.MOST_BYTES', 50)
    assert main(['fit', write(tmp_path, table_of(R / 1e3, repulsion(LAW, R)))]) == 2
    assert 'more than the' in capsys.readouterr().err


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


@pytest.mark.parametrize(('text', 'refused'), [
    ('r_mm,f_N\n#r_mm,f_mN\n', True), ('r_m,f_N\nr_mm,f_mN\n', True), ('#r_mm,f_mN\nr_mm,f_N\n', True),
    ('# r_mm,f_N\nr_mm,f_N\n', False), ('r_mm,f_N\n# measured on Monday\n', False),
])
def test_a_second_header_with_other_units_is_refused(text, refused, tmp_path, capsys):
    assert main(['fit', write(tmp_path, text + '6,10\n7,5\n8,3\n9,2\n')]) == 2 * refused
    shown = capsys.readouterr()
    assert ('line 2: ' in shown.err and 'names other units than the header before it' in shown.err) == refused
    if not refused:
        assert read_forces(write(tmp_path, text + '6,10\n7,5\n8,3\n9,2\n')).f[2] == 3.0  # N, as its header says


def test_units_named_after_the_numbers_are_refused_too(tmp_path):
    with pytest.raises(ValueError, match=r'line 6: .*names other units'):
        read_forces(write(tmp_path, 'r_mm,f_N\n6,10\n7,5\n8,3\n9,2\n# r_mm f_mN\n10,1500\n'))
