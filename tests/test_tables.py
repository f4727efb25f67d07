"""The one reader of tables: drawn tables come back as they were drawn, and what is no table is refused in one line."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from structures import few_first

from magphonon.quantities import ANGLE, AREA, FORCE, FREQUENCY, LENGTH, MASS, PURE, SPEED, STIFFNESS, TEXT, TIME
from magphonon.tables import read_table

COLUMNS = {'time': TIME, 'x': LENGTH, 'v_x': SPEED, 'f': FORCE, 'name': TEXT, 'count': PURE}
FORMS = '{}_{}', '{} [{}]', '{} ({})', '{} / {}', '{}/{}', '{} in {}'


def write(folder, text, **options):
    (folder / 't.csv').write_text(text, **options)
    return folder / 't.csv'


@pytest.mark.parametrize('seed', few_first(range(30), 8))
def test_a_drawn_table_comes_back_as_it_was_drawn(seed, tmp_path):
    """Any order of columns, units, separator, decimal sign, quotes, line ends, comments, blank lines, columns of others."""
    rng = np.random.default_rng(seed)
    quantities = [str(name) for name in rng.permutation(list(COLUMNS))[:rng.integers(2, 7)]]
    rows, separator = int(rng.integers(1, 40)), str(rng.choice(['\t', ';', ',', ' ', '   ']))
    comma, quoted = bool(rng.integers(2)), bool(rng.integers(2))
    units = {name: str(rng.choice(list(COLUMNS[name]))) if COLUMNS[name] else '' for name in quantities}
    header, cells, truth = [], [], {}
    for name in quantities:
        if COLUMNS[name]:
            values = rng.normal(size=rows) * 10.0 ** rng.integers(-9, 9, rows)
            truth[name] = values * COLUMNS[name][units[name]]
            column = [str(rng.choice(['{!r}', '{:.17e}', '{:+.17g}'])).format(value) for value in values.tolist()]
            if comma and (separator != ',' or quoted):
                column = [cell.replace('.', ',') for cell in column]
        else:
            truth[name] = column = [f'P{k:03d}' for k in rng.permutation(rows)]
        form = str(rng.choice(FORMS[: 1 if ' ' in separator else None]))
        header.append(form.format(name, units[name]) if units[name] else name)
        cells.append([f'"{cell}"' for cell in column] if quoted else column)
    header.insert(place := int(rng.integers(len(header) + 1)), 'remark')
    cells.insert(place, ['fine'] * rows)
    lines = [separator.join(row) for row in zip(*cells, strict=True)]
    first = separator.join(header)
    top = [('# ' if rng.random() < 0.3 else '') + first]
    for at in rng.integers(len(lines) + 1, size=3):
        lines.insert(int(at), str(rng.choice(['', '# measured on Monday', separator * 2])))
    end = str(rng.choice(['\n', '\r\n']))
    text, encoding = end.join(['# by hand', *top, *lines]) + end, str(rng.choice(['utf-8', 'utf-8-sig']))
    path = write(tmp_path, text, encoding=encoding, newline='')
    table = read_table(path, COLUMNS, quantities)
    assert table.columns.keys() == truth.keys()
    for name, values in truth.items():
        if COLUMNS[name]:
            np.testing.assert_allclose(table[name], values, rtol=1e-15)  # read to the last bit, times the unit
        else:
            assert table[name].tolist() == values


@pytest.mark.parametrize(('units', 'name', 'inside'), [  # what 6 of the unit in the name are in mm, g, ms
    (LENGTH, 'm', 6e3), (LENGTH, 'mm', 6), (LENGTH, 'um', 6e-3), (LENGTH, 'nm', 6e-6), (LENGTH, 'cm', 60), (LENGTH, 'in', 152.4),
    (TIME, 's', 6e3), (TIME, 'ms', 6), (TIME, 'us', 6e-3), (FORCE, 'N', 6), (FORCE, 'mN', 6e-3), (FORCE, 'uN', 6e-6),
    (FORCE, 'kN', 6e3), (FORCE, 'g', 0.0588399), (FORCE, 'gf', 0.0588399), (FORCE, 'kgf', 58.8399), (FORCE, 'mgf', 5.88399e-5),
    (FORCE, 'lbf', 26.689329), (MASS, 'kg', 6e3), (MASS, 'g', 6), (MASS, 'mg', 6e-3), (SPEED, 'm_per_s', 6),
    (SPEED, 'mm_per_s', 6e-3), (SPEED, 'um_per_ms', 6e-3), (STIFFNESS, 'N_per_m', 6e-3), (STIFFNESS, 'mN_per_mm', 6e-3),
    (STIFFNESS, 'N_per_mm', 6), (FREQUENCY, 'Hz', 0.03769911184), (FREQUENCY, 'kHz', 37.69911184),
    (AREA, 'm2', 6e6), (AREA, 'mm2', 6), (ANGLE, 'rad', 6), (PURE, '', 6),
])
def test_units_by_the_header(units, name, inside, tmp_path):
    for form in FORMS if name else ('{}{}',):
        path = write(tmp_path, f'{form.format("q", name)};x\n6;1\n')
        assert read_table(path, {'q': units}, ['q'])['q'][0] == pytest.approx(inside, rel=1e-7)


LONG = 200_000 * '1'
TABLES = {  # and x in mm, or None if it is refused
    '': None,
    'time_s,x_m\n': None,
    '0.1,2\n0.2,3\n': None,
    'time_s,y_m\n1,2\n': None,
    'time_s,x_m,x_mm\n1,2,3\n': None,
    'time_s,x_m,x_m\n1,2,2\n': None,
    'time_s,x\n1,2\n': None,
    f'time_s,x_{999 * "z"}\n1,2\n': None,
    'time_min,x_m\n1,2\n': None,
    '# time_s,x_mm\ntime_s,x_m\n1,2\n': None,
    '# time_s,x_mm\ntime_s,x_mm\n1,2\n': None,
    'time_s,x_mm\n1,2\n# time_s x_m\n3,4\n': None,
    'time_s,x_mm\n1,2\n# time_s,x_mm\n3,4\n': [2, 4],
    'time_s,x_mm\n1,2\n# x after lunch\n3,4\n': [2, 4],
    '1,2\ntime_s,x_mm\n3,4\n': None,
    "1'000,2\ntime_s,x_mm\n3,4\n": None,
    'Date,23.11.2026\nSamples,2\ntime_s,x_mm\n3,4\n': [4],
    'time_s,x_mm\ns,mm\n3,4\n': [4],
    'time_s,x_mm\ns,m\n3,4\n': None,
    'time,x\ns,mm\n3,4\n': [4],
    'time,x\nmm,s\n3,4\n': None,
    'time_s,x_m\n1,2\n3\n': None,
    'time_s,x_m\n1,2\n\n3,4,5\n': None,
    'time_s,x_mm,comment\n1,2\n3,4,\n5,6,late\n': [2, 4, 6],
    'time_s,x_mm\n1,2,\n': [2],
    'time_s,x_m\n1,2\n3,1_0\n': None,
    'time_s,x_m\n1,\uff12\n': None,
    'time_s,x_m\n1,0x10\n': None,
    'time_s,x_m\n1,nan\n': None,
    'time_s,x_m\n1,-inf\n': None,
    'time_s,x_m\n1,\n': None,
    'time_s,x_m\n1,1e400\n': None,
    'time_s,x_m\n1,1e307\n': None,
    'time_s,x_mm\n1,-.5e1\n': [-5],
    'time_s;x_m\n1,5;2.5\n': None,
    'time_s;x_m\n1,5;2\n2;2.5\n': None,
    'time_s;x_mm\n1,5;2,25\n': [2.25],
    'time_s;x_m\n1;2.174,5\n': None,
    'time_s,x_m\n1,"1\n2"\n3,4\n': None,
    'time_s,x_m\n1,2\n3,"4\n': None,
    f'time_s,x_m\n{LONG},2\n': None,
    f'time_s,x_m\n1,2\n3,{LONG}\n': None,
    f'time_s,{200_000 * "x"}\n1,2\n': None,
    'time_s  x_mm\n 1      2\n30     4\n': [2, 4],
}


@pytest.mark.parametrize('text', TABLES)
def test_a_table_is_read_or_refused_in_one_line(text, tmp_path):
    path, x = write(tmp_path, text), TABLES[text]
    if x is not None:
        assert read_table(path, COLUMNS, ['time', 'x'])['x'].tolist() == x
        return
    with pytest.raises(ValueError, match=r't\.csv') as error:
        read_table(path, COLUMNS, ['time', 'x'])
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 700


@pytest.mark.parametrize(('text', 'line'), [
    ('time_s,x_m\n1,2\n\n3,x\n', 4), ('# a\ntime_s,x_m\n1\n', 3), ('x_m\ttime_s\n1\t"2\n', 2)])
def test_a_refusal_names_the_line(text, line, tmp_path):
    with pytest.raises(ValueError, match=rf'line {line} of .*t\.csv'):
        read_table(write(tmp_path, text), COLUMNS, ['time', 'x'])


def test_other_columns_are_refused_where_a_table_wants_none(tmp_path):
    path = write(tmp_path, 'x_m,cont\n1,2\n')
    with pytest.raises(ValueError, match="'cont'; did you mean 'count'"):
        read_table(path, COLUMNS, ['x'], others=False)
    assert read_table(path, COLUMNS, ['x']).columns.keys() == {'x'}
    path = write(tmp_path, ',x_m\n0,1\n')  # as pandas numbers its rows
    assert read_table(path, COLUMNS, ['x'], others=False).columns.keys() == {'x'}


def test_files_that_are_no_text_or_too_large_or_endless(tmp_path):
    (tmp_path / 'p.csv').write_bytes(bytes(range(256)))
    for path, most in ((tmp_path / 'p.csv', 1e6), (write(tmp_path, 'x_m\n1\n'), 3), ('/dev/zero', 1e6)):
        with pytest.raises(ValueError, match=str(path)):
            read_table(path, COLUMNS, ['x'], most=int(most))


def test_blank_cells_are_read_where_they_may_be(tmp_path):
    path = write(tmp_path, 'time_s,x_m\n1,\n2,NaN\n3,4\n')
    np.testing.assert_array_equal(read_table(path, COLUMNS, ['time'], blank=['x'])['x'], [np.nan, np.nan, 4000])


@settings(max_examples=60, deadline=None)
@given(st.lists(st.text('0123456789.,-+einfNaN"# \t;x_\uff12', max_size=30), max_size=12), st.sampled_from(['\n', '\r\n', '\r']))
def test_whatever_stands_below_the_header_is_read_or_refused_in_words(tmp_path_factory, rows, end):
    path = tmp_path_factory.getbasetemp() / 'fuzz.csv'
    path.write_text(end.join(['time_s,x_m,name', *rows]), newline='')
    try:
        table = read_table(path, COLUMNS, ['time', 'x', 'name'])
    except ValueError as error:
        assert str(path) in str(error)  # noqa: PT017  either outcome is right
    else:
        assert np.isfinite([table['time'], table['x']]).all()
