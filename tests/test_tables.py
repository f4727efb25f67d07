"""The one reader of tables: drawn tables come back as they were drawn, and what is no table is refused with file and line."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from magphonon.quantities import ANGLE, AREA, FORCE, FREQUENCY, LENGTH, MASS, PURE, SPEED, STIFFNESS, TEXT, TIME
from magphonon.tables import read_table

COLUMNS = {'time': TIME, 'x': LENGTH, 'v_x': SPEED, 'f': FORCE, 'name': TEXT, 'count': PURE}


def write(folder, text, **options):
    (folder / 't.csv').write_text(text, **options)
    return folder / 't.csv'


@pytest.mark.parametrize('seed', range(30))
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
        header.append(f'{name}_{units[name]}' if units[name] else name)
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
    (LENGTH, 'm', 6e3), (LENGTH, 'mm', 6), (LENGTH, 'um', 6e-3), (LENGTH, 'nm', 6e-6), (TIME, 's', 6e3), (TIME, 'ms', 6),
    (TIME, 'us', 6e-3), (FORCE, 'N', 6), (FORCE, 'mN', 6e-3), (FORCE, 'uN', 6e-6), (MASS, 'kg', 6e3), (MASS, 'g', 6),
    (MASS, 'mg', 6e-3), (SPEED, 'm_per_s', 6), (SPEED, 'mm_per_s', 6e-3), (SPEED, 'um_per_ms', 6e-3),
    (STIFFNESS, 'N_per_m', 6e-3), (STIFFNESS, 'mN_per_mm', 6e-3), (STIFFNESS, 'N_per_mm', 6),
    (FREQUENCY, 'Hz', 0.03769911184), (FREQUENCY, 'kHz', 37.69911184),
    (AREA, 'm2', 6e6), (AREA, 'mm2', 6), (ANGLE, 'rad', 6), (PURE, '', 6),
])
def test_units_by_the_header(units, name, inside, tmp_path):
    path = write(tmp_path, f'{f"q_{name}".rstrip("_")},x\n6,1\n')
    assert read_table(path, {'q': units}, ['q'])['q'][0] == pytest.approx(inside, rel=1e-9)


NEEDED = 'a table has time_s and x_m'


@pytest.mark.parametrize(('text', 'message'), [
    ('', 't.csv is empty'),
    ('time_s,x_m\n', 'holds no rows below its header; a table has'),
    ('0.1,2\n0.2,3\n', r"lacks the column time_s \(its header is '0.1,2'\); a table has"),
    ('time_s,y_m\n1,2\n', r"lacks the column x_m \(its header is 'time_s,y_m'\)"),
    ('time_s,x_m,x_mm\n1,2,3\n', "the columns 'x_m' and 'x_mm' say the same; keep one"),
    ('time_s,x_m,x_m\n1,2,2\n', "the columns 'x_m' and 'x_m' say the same"),
    ('time_s,x\n1,2\n', "the column 'x' has no known unit; write x_m, x_mm"),
    (f'time_s,x_\x1b{999 * "z"}\n1,2\n', r"the column 'x_\\x1bz{,400}\.\.\. \(1007 characters\) has no known unit"),
    ('time_min,x_m\n1,2\n', "the column 'time_min' has no known unit; write time_s, time_ms"),
    ('# time_s,x_mm\ntime_s,x_m\n1,2\n', "line 2 of .*t.csv: 'time_s,x_m' names other columns or units than the header"),
    ('time_s,x_mm\n1,2\n# time_s x_m\n3,4\n', 'line 3 of .*t.csv: .* names other columns or units than the header'),
    ('time_s,x_m\n1,2\n3\n', 'line 3 of .*t.csv: it has 1 values, not 2: it was cut off'),
    ('time_s,x_m\n1,2\n\n3,4,5\n', 'line 4 of .*t.csv: it has 3 values, not 2'),
    ('time_s,x_m\n1,2\n3,1_0\n', "line 3 of .*t.csv: x_m is '1_0', not a finite number"),
    ('time_s,x_m\n1,\uff12\n', "line 2 of .*t.csv: x_m is '.', not a finite number"),
    ('time_s,x_m\n1,0x10\n', "x_m is '0x10', not a finite number"),
    ('time_s,x_m\n1,nan\n', "x_m is 'nan', not a finite number"),
    ('time_s,x_m\n1,-inf\n', "x_m is '-inf', not a finite number"),
    ('time_s,x_m\n1,\n', "x_m is '', not a finite number"),
    ('time_s,x_m\n1,1e400\n', 'line 2 of .*t.csv: x_m must be a finite number'),
    ('time_s,x_m\n1,1e307\n', 'x_m must be a finite number'),
    ('time_s;x_m\n1,5;2.5\n', 'but other numbers use the other decimal sign'),
    ('time_s;x_m\n1;2.1745,5\n', "x_m is '2.1745,5', not a finite number"),
    ('time_s,x_m\n1,"1\n2"\n3,4\n', 'line 2 of .*t.csv: a quotation mark is not closed'),
    ('time_s,x_m\n1,2\n3,"4\n', 'line 3 of .*t.csv: unexpected end of data; complete or delete it'),
    ('time_s,x_m\n' + 200_000 * '1' + ',2\n', 'line 2 of .*t.csv: field larger than field limit'),
    ('time_s,x_m\n1,2\n3,' + 200_000 * '1' + '\n', 'line 3 of .*t.csv: field larger than field limit'),
    ('time_s,' + 200_000 * 'x' + '\n1,2\n', 't.csv is not a text table .field larger than field limit'),
])
def test_what_is_no_table_is_refused_with_the_place(text, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        read_table(write(tmp_path, text), COLUMNS, ['time', 'x'], layout=NEEDED)


def test_other_columns_are_refused_where_a_table_wants_none(tmp_path):
    with pytest.raises(ValueError, match=r"this kind of table has no column 'colour'; a table has"):
        read_table(write(tmp_path, 'x_m,colour\n1,2\n'), COLUMNS, ['x'], others=False, layout=NEEDED)
    with pytest.raises(ValueError, match=r"this kind of table has no column 'cont'; did you mean 'count'\?"):
        read_table(write(tmp_path, 'x_m,cont\n1,2\n'), COLUMNS, ['x'], others=False)
    with pytest.raises(ValueError, match=r"no column 'z{,400}\.\.\. \(1002 characters\); a table has"):
        read_table(write(tmp_path, f'x_m,{1000 * "z"}\n1,2\n'), COLUMNS, ['x'], others=False, layout=NEEDED)


def test_files_that_are_no_text_or_too_large_or_endless(tmp_path):
    (tmp_path / 'p.csv').write_bytes(bytes(range(256)))
    for path, most, message in ((tmp_path / 'p.csv', 1e6, 'is not a text file; export it as CSV'),
                                (write(tmp_path, 'x_m\n1\n'), 3, 'more than the'), ('/dev/zero', 1e6, 'may never end')):
        with pytest.raises(ValueError, match=message):
            read_table(path, COLUMNS, ['x'], most=int(most))


def test_long_tables_are_read_in_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr('magphonon.tables.BLOCK', 7)
    text = 'time_s;x_m\n' + ''.join(f'{k};{k * k}\n' for k in range(30))
    np.testing.assert_array_equal(read_table(write(tmp_path, text), COLUMNS, ['x'])['x'], 1e3 * np.arange(30) ** 2)
    for at, cell in ((3, 'x'), (8, 'x'), (24, 'x'), (24, '1;2')):
        with pytest.raises(ValueError, match=f'line {at + 2} of '):
            read_table(write(tmp_path, text.replace(f'\n{at};{at * at}\n', f'\n{at};{cell}\n')), COLUMNS, ['x'])


def test_blank_cells_are_read_where_they_may_be(tmp_path):
    path = write(tmp_path, 'time_s,x_m\n1,\n2,NaN\n3,4\n')
    np.testing.assert_array_equal(read_table(path, COLUMNS, ['time'], blank=['x'])['x'], [np.nan, np.nan, 4000])


@settings(max_examples=300, deadline=None)
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
