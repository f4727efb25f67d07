"""Files as laboratories have them: each drawn export is read as meant, or refused with the mend.

What is drawn are the values, the order of columns, and the writing of numbers; what an export looks like is imitated from the
instruments that write it.  The oracle is the drawn array itself.
"""

import csv
import io
import string

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.io import savemat

from magphonon import readers, units as u
from magphonon.cli.fit import held
from magphonon.cli.main import main
from magphonon.interactions import read_forces
from magphonon.readers import READERS
from magphonon.response import read_transfer
from magphonon.tables import FORCE, LENGTH, read_table
from magphonon.waves import read_scan

GF = 9.80665e-3  # N


def text(rows, sign=',', decimal='.', head=''):
    """Rows as a text with this separator and decimal sign."""
    out = io.StringIO()
    writer = csv.writer(out, delimiter=sign, lineterminator='\r\n')
    for row in rows:
        writer.writerow([x if isinstance(x, str) else f'{x:.12g}'.replace('.', decimal) for x in row])
    return head + out.getvalue()


def grouped(x):
    """A number with commas between thousands, 1,234.5."""
    return f'{x:,.6f}'


def german(x):
    """1.234,5."""
    return grouped(x).translate(str.maketrans('.,', ',.'))


def forces(seed):
    """Distances in mm and forces in N of a drawn pair."""
    rng = np.random.default_rng(seed)
    r = np.sort(rng.uniform(8, 20, 12))
    return r, 0.24 * (r / 10) ** -rng.uniform(3, 6)


EXPORTS_OF_FORCES = {  # header, factors of r in mm and f in N, and how the text is written
    'brackets': lambda r, f: text([['r [mm]', 'F [N]'], *zip(r, f, strict=True)]),
    'round brackets': lambda r, f: text([['Distance (mm)', 'Force (mN)'], *zip(r, 1e3 * f, strict=True)]),
    'slashes': lambda r, f: text([['r / cm', 'F / N'], *zip(r / 10, f, strict=True)], ';'),
    'in': lambda r, f: text([['Abstand in mm', 'Kraft in N'], *zip(r, f, strict=True)], ';', ','),
    'German': lambda r, f: text([['Kraft [N]', 'Abstand [mm]'], *zip(f, r, strict=True)], ';', ','),
    'a line of units': lambda r, f: text([['Distance', 'Force'], ['mm', 'N'], *zip(r, f, strict=True)], '\t'),
    'a line of bracketed units': lambda r, f: text([['Distance', 'Force'], ['[mm]', '[mN]'], *zip(
        r, 1e3 * f, strict=True)], '\t'),
    'sep=': lambda r, f: text([['r [mm]', 'f [N]'], *zip(r, f, strict=True)], ';', ',', 'sep=;\r\n'),
    'balance in g': lambda r, f: text([['r_cm', 'f_g'], *zip(r / 10, f / GF, strict=True)]),
    'balance in gf': lambda r, f: text([['r_mm', 'f_gf'], *zip(r, f / GF, strict=True)]),
    'kgf': lambda r, f: text([['d [m]', 'load [kgf]'], *zip(r / 1e3, f / GF / 1e3, strict=True)]),
    'inches and pounds': lambda r, f: text([['Distance (in)', 'Load (lbf)'], *zip(r / 25.4, f / 4.4482216152605, strict=True)]),
    'Mark-10': lambda r, f: text([['Reading', 'Load [gF]', 'Distance [mm]'], *(
        [k, b / GF, a] for k, (a, b) in enumerate(zip(r, f, strict=True)))], '\t'),
    'Instron': lambda r, f: '"Specimen label","ring 3"\r\n"Rate","2.0","mm/min"\r\n\r\n"Time","Distance","Load"\r\n'
    '"(s)","(mm)","(N)"\r\n\r\n' + ''.join(f'"0.1","{a:.12g}","{b:.12g}"\r\n' for a, b in zip(r, f, strict=True)),
    'numpy.savetxt': lambda r, f: '# r_mm f_N\n' + ''.join(f'{a:.18e} {b:.18e}\n' for a, b in zip(r, f, strict=True)),
    'MATLAB': lambda r, f: '% r_mm, f_N\n' + ''.join(f'  {a:.12g}, {b:.12g}\n' for a, b in zip(r, f, strict=True)),
    'fixed width': lambda r, f: f'{"r[mm]":>14}{"F[N]":>16}\n' + ''.join(f'{a:14.8f}{b:16.10f}\n' for a, b in zip(
        r, f, strict=True)),
    'pandas': lambda r, f: text([['', 'r_mm', 'f_N'], *([k, *pair] for k, pair in enumerate(zip(r, f, strict=True)))]),
    'LabVIEW': lambda r, f: text([['X_Value', 'Distance [mm]', 'Force [N]', 'Comment'], *(
        [k, *pair, ''] for k, pair in enumerate(zip(r, f, strict=True)))], '\t', '.',
        'LabVIEW Measurement\t\r\nWriter_Version\t2\r\nSeparator\tTab\r\nDecimal_Separator\t.\r\nDate\t2026/11/23\r\n'
        '***End_of_Header***\t\r\n\t\r\nChannels\t2\r\nSamples\t12\t12\r\n***End_of_Header***\t\t\r\n'),
    'testing machine': lambda r, f: text([['Zeit', 'Weg', 'Kraft'], ['s', 'mm', 'N'], *(
        [0.1 * k, *pair] for k, pair in enumerate(zip(r, f, strict=True)))], ';', ',',
        'Prüfer:;Meier\r\nProbe:;Ring N42, 25 °C\r\nVorkraft [N];0,1\r\n\r\n'),
    'thousands': lambda r, f: text([['r [um]', 'f [uN]'], *((grouped(1e3 * a), grouped(1e6 * b)) for a, b in zip(
        r, f, strict=True))], ';'),
    'German thousands': lambda r, f: text([['r [um]', 'f [uN]'], *((german(1e3 * a), german(1e6 * b)) for a, b in zip(
        r, f, strict=True))], ';'),
    'Swiss thousands': lambda r, f: text([['r [um]', 'f [uN]'], *((grouped(1e3 * a).replace(',', "'"), grouped(1e6 * b).replace(
        ',', '\u2019')) for a, b in zip(r, f, strict=True))], ';'),
}
CODINGS = {'UTF-8': 'utf-8', 'with a mark': 'utf-8-sig', 'UTF-16': 'utf-16', 'UTF-16 without mark': 'utf-16-le',
           'Latin': 'latin-1', 'Windows': 'cp1252'}


@pytest.mark.parametrize('name', EXPORTS_OF_FORCES)
def test_tables_of_forces_are_read_as_meant(name, tmp_path):
    """In every coding that can write them; and another unit would be seen: factors of units are ten and more."""
    for seed, coding in enumerate(CODINGS.values()):
        r, f = forces(seed)
        written = EXPORTS_OF_FORCES[name](r, f)
        try:
            (tmp_path / 'f.csv').write_bytes(written.encode(coding))
        except UnicodeEncodeError:
            continue
        found = read_forces(tmp_path / 'f.csv')
        assert_allclose(found.r, r, rtol=1e-6)
        assert_allclose(found.f, f, rtol=2e-5)


def columns(r, f):
    return {'r_mm': r, 'f_N': f}


def as_hdf5(path, r, f):
    import h5py

    with h5py.File(path, 'w') as file:
        group = file.create_group('measurement')
        group.create_dataset('Distance', data=r / 1e3).attrs['units'] = 'm'
        group.create_dataset('Force', data=1e3 * f).attrs['unit'] = 'mN'
        group.create_dataset('temperature', data=25.0)


def as_nested_hdf5(path, r, f):
    import h5py

    with h5py.File(path, 'w') as file:
        group = file.create_group('run 1/raw')
        group.create_dataset('Distance', data=r).attrs['Units'] = 'mm'
        group.create_dataset('Force', data=f).attrs['Units'] = 'N'


def as_rows_of_hdf5(path, r, f):
    import h5py

    with h5py.File(path, 'w') as file:
        file.create_dataset('table', data=np.array(list(zip(r, f, strict=True)), [('r_mm', float), ('f_N', float)]))


def as_hdf5_of_matlab(path, r, f):
    """Of its version 7.3: a user block, and arrays of one row."""
    import h5py

    with h5py.File(path, 'w', userblock_size=512) as file:
        for name, values in columns(r, f).items():
            file.create_dataset(name, data=values[None]).attrs['MATLAB_class'] = np.bytes_('double')
    path.write_bytes(b'MATLAB 7.3 MAT-file, Platform: GLNXA64'.ljust(116) + bytes(8) + b'\x00\x02IM' + path.read_bytes()[128:])


def as_workbook(path, r, f):
    openpyxl = pytest.importorskip('openpyxl')
    book = openpyxl.Workbook()
    book.active.title = 'notes'
    sheet = book.create_sheet('data')
    for row in [['Protocol of the bench'], [], ['Kraft', 'Abstand', 'Bemerkung'], ['N', 'mm', None], *(
            [b, a, 'up\tand down'] for a, b in zip(r.tolist(), f.tolist(), strict=True))]:
        sheet.append(row)
    book.save(path)


def as_records(path, r, f):
    np.save(path, np.array(list(zip(r, f, strict=True)), [('r_mm', float), ('f_N', float)]))


FORMATS = {'f.npz': lambda path, r, f: np.savez(path, **columns(r, f)), 'f.npy': as_records,
           'f.mat': lambda path, r, f: savemat(path, columns(r, f)), '73.mat': as_hdf5_of_matlab,
           'structure.mat': lambda path, r, f: savemat(path, {'data': columns(r, f)}), 'rows.h5': as_rows_of_hdf5,
           'nested.h5': as_nested_hdf5, 'f.h5': as_hdf5, 'f.hdf5': as_hdf5, 'f.xlsx': as_workbook}


@pytest.mark.parametrize('name', FORMATS)
def test_other_formats_are_read_through_their_libraries(name, tmp_path):
    r, f = forces(len(name))
    FORMATS[name](tmp_path / name, r, f)
    found = read_forces(tmp_path / name)
    assert_allclose(found.r, r, rtol=1e-12)
    assert_allclose(found.f, f, rtol=1e-12)


@pytest.mark.parametrize('name', [*FORMATS, 'f.uff', 'f.svd', 'f.csv'])
def test_noise_is_refused_and_never_reaches_the_terminal(name, tmp_path):
    noise = np.random.default_rng(0).bytes(4000)
    for start in (b'', b'PK\x03\x04', b'\x93NUMPY', b'MATLAB 5.0'):
        (tmp_path / name).write_bytes(start + noise)
        with pytest.raises((ValueError, OSError)) as error:
            read_forces(tmp_path / name)
        words = str(error.value)
        assert len(words) < 700
        assert all(letter.isprintable() for letter in words)


def test_gaps_need_the_size_of_the_magnets(tmp_path):
    r, f = forces(0)
    (tmp_path / 'f.csv').write_text(text([['gap_mm', 'f_N'], *zip(r - 6.35, f, strict=True)]))
    assert_allclose(read_forces(tmp_path / 'f.csv', contact=6.35).r, r)
    with pytest.raises(ValueError, match=r'gap_mm holds gaps.*--contact'):
        read_forces(tmp_path / 'f.csv')
    (tmp_path / 'f.csv').write_text(text([['gap_mm', 'r_mm', 'f_N'], *zip(r - 6.35, r, f, strict=True)]))
    with pytest.raises(ValueError, match='r_mm and gap_mm say the same'):
        read_forces(tmp_path / 'f.csv', contact=6.35)
    (tmp_path / 'f.csv').write_text(text([['Spalt [mm]', 'Kraft [N]'], *zip(r - 9.5, f, strict=True)]))
    with pytest.raises(ValueError, match=r'Spalt \[mm\] must not be negative'):
        read_forces(tmp_path / 'f.csv', contact=6.35)


@pytest.mark.parametrize(('written', 'mend'), [
    ('r [mm],F [N]\n8,0.6\n9,NaN\n', r"line 3 of .*F .N. is 'NaN', not a finite number"),
    ('r [mm],F [N]\n8,OL\n9,0.4\n', r"line 2 of .*F .N. is 'OL', not a finite number"),
    ('r [mm],F [N]\n8,0.6\nMean,0.6\n', r"line 3 of .*r .mm. is 'Mean', not a finite number"),
    ('r,F\n8 mm,0.6 N\n', "the column 'r' has no known unit; write r_m, r_mm"),
    ('r [mm],F [dyn]\n8,6e4\n', r"'F \[dyn\]' has no known unit; write f_N"),
    ('Extension [mm],Load [N]\n8,0.6\n', 'lacks the column r_m .its header is .Extension'),  # from where, only its owner knows
    ('r [ft],F [N]\n1,2\n', r"'r \[ft\]' has no known unit; write r_m, r_mm"),
    ('r,F\n1,2\n', "the column 'r' has no known unit; write r_m, r_mm"),
    ('Distance,Force\n1,2\n', 'lacks the column r_m.*r_m,f_N .*as r .mm.'),
    ('8.0,0.6\n9,0.5\nr [mm],F [N]\n10,0.4\n', 'line 1 of .* holds numbers above the header in line 3; put the header first'),
    ("r [um];F [uN]\n8'000.0;600'000\nr [um];F [uN]\n9;8\n", "line 3 of .*r .um. is 'r .um.', not a finite number"),
    ("8'000.0;600'000\nr [um];F [uN]\n9;8\n", 'line 1 of .* holds numbers above the header in line 2'),
    ('r [mm],F [N]\nN,mm\n8.0,0.6\n', "line 2 of .*r .mm. is 'N', not a finite number"),  # no row is passed over in silence
    ('r [mm],F [N]\nmm,N\n8.0,0.6\n', "line 2 of .*r .mm. is 'mm', not a finite number"),
    ('Distance,Force\nmm,eV\n8.0,0.6\n', 'lacks the column r_m'),
    ('r [mm],F [N]\n8.0,0.6\n9.0\n', 'line 3 of .* it has 1 values, not 2'),
    ('r [mm],Distance [mm],F [N]\n8,8,0.6\n', r"columns 'r \[mm\]' and 'Distance \[mm\]' say the same"),
    ('r [mm];F [N]\n1,234;0.5\n', 'other numbers use the other decimal sign'),  # a thousand, or one and a bit: nobody knows
    ('r [mm];F [N]\n1.234,5;0,5\n12.34,5;0,4\n', "line 3 of .*r .mm. is '12.34,5', not a finite number"),
])
def test_what_cannot_be_known_is_refused_with_the_mend(written, mend, tmp_path):
    (tmp_path / 'f.csv').write_text(written)
    with pytest.raises(ValueError, match=mend):
        read_forces(tmp_path / 'f.csv')


# --- scans ---------------------------------------------------------------------------------------------------------------------

def waves(seed, points=4, frames=40):
    """Times in ms and velocities in mm/ms of some points, shape (frames, points)."""
    rng = np.random.default_rng(seed)
    t = 0.5 * np.arange(frames)
    return t, 1e-3 * np.sin(2 * np.pi * 0.1 * t[:, None] + rng.uniform(0, 6, points)) * rng.uniform(0.5, 2, points)


def scan_rows(t, v):
    return [(time / 1e3, k + 1, 10.0 * k, value) for time, row in zip(t, v, strict=True) for k, value in enumerate(row)]


EXPORTS_OF_SCANS = {  # v in mm/ms is v in m/s
    'brackets': lambda t, v: text([['Time [s]', 'Point', 'X [mm]', 'v_y [m/s]'], *scan_rows(t, v)]),
    'Polytec': lambda t, v: text([['Time', 'Point Index', 'X', 'Velocity'], ['s', '', 'mm', 'm/s'], *scan_rows(t, v)], '\t', '.',
                                 'Source File:\tScan_3.svd\r\nSignal:\tVib - Velocity\r\nDate: 11/23/2026\r\n\r\n'),
    'German': lambda t, v: text([['Zeit [s]', 'Punkt', 'x [mm]', 'Geschwindigkeit [m/s]'], *scan_rows(t, v)], ';', ','),
    'wide': lambda t, v: text([['Time [s]', *(f'Point {k + 1} [mm/s]' for k in range(v.shape[1]))], *(
        [time / 1e3, *1e3 * row] for time, row in zip(t, v, strict=True))], ';'),
    'wide with directions': lambda t, v: text([['Time [s]', *(f'v_y {k + 1} [m/s]' for k in range(v.shape[1]))], *(
        [time / 1e3, *row] for time, row in zip(t, v, strict=True))], '\t'),
    'wide, units below': lambda t, v: text([['Time', *map(str, range(1, 1 + v.shape[1]))], ['ms', *v.shape[1] * ['µm/s']], *(
        [time, *1e6 * row] for time, row in zip(t, v, strict=True))], ','),
}


def assert_scan(scan, t, v):
    from magphonon.waves.scans import integrated

    assert_allclose(scan.times, t, atol=1e-9)
    assert scan.names == tuple(str(k + 1) for k in range(v.shape[1]))
    (u,) = scan.motions.values()
    assert_allclose(u, integrated(v, t[1] - t[0]), atol=1e-6 * abs(u).max())


@pytest.mark.parametrize('name', EXPORTS_OF_SCANS)
def test_scans_are_read_as_meant(name, tmp_path):
    for seed, coding in enumerate(('utf-8', 'utf-16', 'latin-1')):
        t, v = waves(seed)
        (tmp_path / 's.csv').write_bytes(EXPORTS_OF_SCANS[name](t, v).encode(coding))
        scan = read_scan(tmp_path / 's.csv')
        assert_scan(scan, t, v)
        assert next(iter(scan.motions)) == ('y' if 'v_y' in EXPORTS_OF_SCANS[name](t, v) else '')
        if 'wide' not in name:
            assert_allclose(scan.places[:, 0], 10.0 * np.arange(v.shape[1]))


def test_arrays_of_frames_and_points_are_scans(tmp_path):
    t, v = waves(1)
    x = 1e-2 * np.arange(v.shape[1])
    for name, values in (('s.mat', v), ('s.npz', v), ('t.mat', v.T)):
        held = {'time_ms': t, 'x_m': x, 'point': 1.0 + np.arange(len(x)), 'v_y_m_per_s': values, 'rate': 2000.0}
        (savemat if name.endswith('mat') else lambda path, held: np.savez(path, **held))(tmp_path / name, held)
        scan = read_scan(tmp_path / name)
        assert_scan(scan, t, v)
        assert_allclose(scan.places[:, 0], 1e3 * x)
    np.savez(tmp_path / 'u.npz', time_ms=t, v_m_per_s=v)  # whose points have numbers only
    assert_scan(read_scan(tmp_path / 'u.npz'), t, v)
    np.savez(tmp_path / 'w.npz', time_ms=t, v_m_per_s=v, x_m=np.arange(3.0))
    with pytest.raises(ValueError, match=r'arrays of the shapes \(3,\), \(40,\), \(40, 4\)'):
        read_scan(tmp_path / 'w.npz')


@pytest.mark.parametrize('seed', range(3))
def test_groups_that_name_their_columns_alike_are_refused_where_one_would_replace_another(seed, tmp_path):
    h5py = pytest.importorskip('h5py')
    rng = np.random.default_rng(seed)
    r, f = np.linspace(8, 12, 9), rng.random((rng.integers(2, 5), 9))
    for name, kept in (('same', f[[0] * len(f)]), ('other', f)):
        groups = {f'pair{k}': columns(r, one) for k, one in enumerate(kept)}
        savemat(tmp_path / f'{name}.mat', groups)
        with h5py.File(tmp_path / f'{name}.h5', 'w') as file:
            for group, held in groups.items():
                for column, values in held.items():
                    file[f'{group}/{column}'] = values
                file[f'{group}/temperature'] = rng.random()
        for suffix in ('mat', 'h5'):
            if name == 'same':
                assert_allclose(read_forces(tmp_path / f'same.{suffix}').f, f[0])
            else:
                with pytest.raises(ValueError, match="holds 'f_N' several times, with different numbers; put each"):
                    read_forces(tmp_path / f'other.{suffix}')


WORDS_OF_POINTS = {  # how instruments name the column of a point, by row, column and direction
    'A1': lambda row, k, axis: f'{"ABC"[row]}{k}',
    'Ref 1': lambda row, k, axis: f'{("Ref", "Point", "Channel")[row]} {k}',
    'Vx 1': lambda row, k, axis: f'V{axis} {10 * row + k}',
    'x1': lambda row, k, axis: f'{axis}{10 * row + k}',
    'u_x1': lambda row, k, axis: f'u_{axis}{10 * row + k}',
    'Point 1 X': lambda row, k, axis: f'Point {10 * row + k} {axis.upper()}',
}


@pytest.mark.parametrize('name', WORDS_OF_POINTS)
def test_no_column_of_a_wide_table_is_taken_for_that_of_another_point(name, tmp_path):
    rng = np.random.default_rng(sum(map(ord, name)))
    axes = ('x', 'y') if name[-1] not in '1' or name[0] in 'Vxu' else ('',)
    columns = [(row, k, axis) for row in range(3) for k in (1, 2, 4) for axis in axes]
    t, u = 1e-3 * np.arange(30), rng.standard_normal((30, len(columns)))
    order = rng.permutation(len(columns))
    head = ['time [s]', *(f'{WORDS_OF_POINTS[name](*columns[k])} [mm]' for k in order)]
    (tmp_path / 's.csv').write_text(text([head, *([a, *row] for a, row in zip(t, u[:, order], strict=True))]))
    scan = read_scan(tmp_path / 's.csv')
    assert len(scan.names) == 9
    assert {*scan.motions} == {*axes}
    for (row, k, axis), values in zip(columns, u.T, strict=True):
        point = WORDS_OF_POINTS[name](row, k, axis) if axes == ('',) else str(10 * row + k)
        assert_allclose(scan.motions[axis][:, scan.names.index(point)], values, rtol=1e-9)


@pytest.mark.parametrize(('written', 'mend'), [
    ('time_s,17 [mm],u 17 [mm]\n0,1,2\n1,2,3\n', "'u 17' is a second column of the point '17'"),
    ('time_s,P1,P2\n0,1,2\n1,2,3\n', r'lacks the column particle or x_m,y_m; .*a column for each point with its unit'),
    ('time_s,P1 [m/s],P2 [mm]\n0,1,2\n1,2,3\n', 'columns of displacements and of velocities'),
    ('time_s,point,v_y [m/s]\n0,1,1\n0.1,1,2\n0.3,1,1\n', 'its samples are too far apart for motion at'),
    ('time_s,v_x 1 [m/s],v_y 2 [m/s]\n0,1,2\n1,2,3\n', 'node 2 was measured along y and others along x'),
])
def test_scans_that_cannot_be_known_are_refused_with_the_mend(written, mend, tmp_path):
    (tmp_path / 's.csv').write_text(written)
    with pytest.raises(ValueError, match=mend):
        read_scan(tmp_path / 's.csv')


@pytest.mark.parametrize('kind', ['m8[us]', 'M8[ms]', complex])
def test_arrays_that_are_no_real_numbers_are_refused(kind, tmp_path):
    """Numbers of microseconds under the name time_s, for one."""
    u = np.random.default_rng(0).standard_normal((20, 3))
    np.savez(tmp_path / 's.npz', time_s=(1000 * np.arange(20)).astype(kind), u_m=u)
    with pytest.raises(ValueError, match='time_s holds no real numbers'):
        read_scan(tmp_path / 's.npz')


# --- transfer functions --------------------------------------------------------------------------------------------------------

SI = ({'m': 1.0, 'mm': 1e-3, 'um': 1e-6, 'in': 0.0254}, {'N': 1.0, 'kN': 1e3, 'lbf': 4.4482216},
      {'Hz': 1.0, 'rad/s': 1 / (2 * np.pi)})


@pytest.mark.parametrize('seed', range(12))
def test_the_labels_of_a_universal_file_are_its_units(seed, tmp_path):
    """With a dataset 164 that says otherwise, or with none; the quantity, its unit, and how it is written are drawn."""
    pyuff = pytest.importorskip('pyuff')
    rng = np.random.default_rng(seed)
    order, f = int(rng.integers(3)), np.linspace(20, 90, 8)
    h = rng.standard_normal(8) + 1j * rng.standard_normal(8)  # m/N, m/s/N or m/s^2/N
    lengths = SI[0] | ({'g': 9.80665} if order == 2 else {})
    length, force, per = (str(rng.choice([*units])) for units in (lengths, *SI[1:]))
    over = length + ('', '/s', '/s^2')[order] * (length != 'g')
    in_one = bool(rng.integers(2))  # the label of the ordinate says all
    told = {'ordinate_axis_units_lab': f'({over})/{force}' if in_one else over, 'abscissa_axis_units_lab': per,
            'orddenom_axis_units_lab': 'NONE' if in_one else force}
    one = {'type': 58, 'binary': 0, 'func_type': 4, 'rsp_node': 1, 'rsp_dir': 1, 'ref_node': 2, 'ref_dir': 1,
           'x': f / SI[2][per], 'data': h / lengths[length] * SI[1][force], 'abscissa_spec_data_type': 18,
           'ordinate_spec_data_type': (8, 11, 12)[order], 'orddenom_spec_data_type': 13} | told
    other = {'type': 164, 'units_code': 1, 'units_description': 'x', 'temp_mode': 1, 'length': 7.0, 'force': 3.0, 'temp': 1.0,
             'temp_offset': 0.0}
    pyuff.UFF(str(file := tmp_path / 'f.uff')).write_sets([other] * bool(rng.integers(2)) + [one], 'overwrite')
    if rng.integers(2):  # which pyuff before 2.5.4 reads, but does not write
        file.write_text(file.read_text('utf-8').replace('s^2', 's²'), 'utf-8')
    (found,) = read_transfer(file)
    assert_allclose(found.omega, 2e-3 * np.pi * f, rtol=1e-5)  # pyuff writes five digits
    assert_allclose(found.response, 1e3 * h / (2j * np.pi * f) ** order, rtol=1e-4)


@pytest.mark.parametrize(('wrong', 'mend'), [
    ({'ordinate_axis_units_lab': 'V'}, "node 1: 'V' is no known unit of such data"),
    ({'ordinate_axis_units_lab': 'm/s'}, "'m/s' is no known unit"),  # of a displacement
    ({'data': np.ones(8)}, 'node 1 has no imaginary part'),
    ({'rsp_node': 5}, 'does not say where its nodes are'),
])
def test_universal_files_that_cannot_be_known_are_refused_with_the_mend(wrong, mend, tmp_path):
    pyuff = pytest.importorskip('pyuff')
    one = {'type': 58, 'binary': 0, 'func_type': 4, 'rsp_node': 1, 'rsp_dir': 1, 'ref_node': 2, 'ref_dir': 1,
           'x': 20.0 + np.arange(8), 'data': np.exp(1j * np.arange(8)), 'abscissa_spec_data_type': 18,
           'ordinate_spec_data_type': 8, 'orddenom_spec_data_type': 13}
    pyuff.UFF(str(tmp_path / 'f.uff')).write_sets([one], 'overwrite')
    read_transfer(tmp_path / 'f.uff')  # the control
    whole = (tmp_path / 'f.uff').read_bytes()
    for lost in (4, len(whole) // 2, len(whole) - 20):
        (tmp_path / 'cut.uff').write_bytes((whole + whole)[:-lost])
        with pytest.raises(ValueError, match='ends within a dataset'):
            read_transfer(tmp_path / 'cut.uff')
    pyuff.UFF(str(tmp_path / 'f.uff')).write_sets([one, one | wrong] if 'rsp_node' in wrong else [one | wrong], 'overwrite')
    with pytest.raises(ValueError, match=mend):
        read_transfer(tmp_path / 'f.uff')


def response(seed):
    """Frequencies in Hz and a receptance in m/N."""
    rng = np.random.default_rng(seed)
    f = np.linspace(20, 120, 30)
    return f, 1e-3 / ((1 - (f / rng.uniform(40, 90)) ** 2) + 0.03j)


def polar(f, h, unit, sign=',', decimal='.', names=('Frequency [Hz]', 'Amplitude', 'Phase [°]'), head=''):
    return text([[names[0], f'{names[1]} [{unit}]', names[2]], *zip(f, abs(h), np.degrees(np.angle(h)), strict=True)],
                sign, decimal, head)


def rate(f, order):
    return (2j * np.pi * f) ** order


EXPORTS_OF_RESPONSES = {
    'brackets': lambda f, h: polar(f, h, 'm/N'),
    'mm/N': lambda f, h: polar(f, 1e3 * h, 'mm/N', ';', ','),
    'mobility': lambda f, h: polar(f, rate(f, 1) * h, '(m/s)/N'),
    'mobility, otherwise': lambda f, h: polar(f, rate(f, 1) * h, 'm/(N·s)'),
    'accelerance': lambda f, h: polar(f, rate(f, 2) * h, '(m/s²)/N', ';', ',', ('Frequenz [Hz]', 'Betrag', 'Phase [deg]')),
    'accelerance, otherwise': lambda f, h: polar(f, rate(f, 2) * h, 'm/s^2/N'),
    'g/N': lambda f, h: polar(f, rate(f, 2) * h / 9.80665, 'g/N'),
    'decibels': lambda f, h: text([['Frequency [Hz]', 'Magnitude [dB re 1 m/s/N]', 'Phase [rad]'], *zip(
        f, 20 * np.log10(abs(rate(f, 1) * h)), np.angle(rate(f, 1) * h), strict=True)]),
    'decibels of mm/N': lambda f, h: text([['Frequency (Hz)', 'Magnitude (dB mm/N)', 'Phase (deg)'], *zip(
        f, 20 * np.log10(abs(1e3 * h)), np.degrees(np.angle(h)), strict=True)]),
    'parts': lambda f, h: text([['Frequency [Hz]', 'Real [m/N]', 'Imaginary [m/N]', 'Coherence'], *zip(
        f, h.real, h.imag, 0 * f + 1, strict=True)], '\t'),
    'PULSE': lambda f, h: text([['Index', 'Frequency [Hz]', 'Real [m/N]', 'Imag [m/N]'], *(
        [k, *one] for k, one in enumerate(zip(f, h.real, h.imag, strict=True)))], '\t'),
    'OROS': lambda f, h: polar(f, rate(f, 2) * h, '(m/s2)/N', ';', '.', ('Frequency (Hz)', 'Amplitude', 'Phase (°)')),
    'Polytec': lambda f, h: text([['Frequency', 'Magnitude', 'Phase'], ['Hz', '(m/s)/N', '°'], *zip(
        f, abs(rate(f, 1) * h), np.degrees(np.angle(rate(f, 1) * h)), strict=True)], '\t', '.',
        'Source File:\tRing.svd\r\nPoint Index:\t3\r\nSignal:\tFRF Vib & Ref1 - H1 Velocity / Force\r\n\r\n'),
}


@pytest.mark.parametrize('name', EXPORTS_OF_RESPONSES)
def test_transfer_functions_are_read_as_meant(name, tmp_path):
    for seed, coding in enumerate(('utf-8', 'utf-16', 'latin-1')):
        f, h = response(seed)
        (tmp_path / 'h.csv').write_bytes(EXPORTS_OF_RESPONSES[name](f, h).encode(coding))
        (found,) = read_transfer(tmp_path / 'h.csv')
        assert_allclose(found.omega, 2 * np.pi * f * u.Hz, rtol=1e-9)
        assert_allclose(found.response, h * u.m / u.N, rtol=1e-6)


@pytest.mark.parametrize(('written', 'mend'), [
    ('Frequency [Hz],Magnitude [dB],Phase [deg]\n20,-60,0\n21,-61,0\n', r'for decibels give the reference, as \[dB re 1 m/s/N\]'),
    ('Frequency [Hz],Amplitude [V/V],Phase [deg]\n20,1,0\n21,1,0\n', r"'Amplitude \[V/V\]' has no known unit"),
    ('Frequency [Hz],Amplitude [mm/N]\n20,1\n21,1\n', 'holds neither transfer functions nor records'),
    ('Point,Value\n1,2\n', 'holds neither transfer functions nor records'),
])
def test_responses_that_cannot_be_known_are_refused_with_the_mend(written, mend, tmp_path):
    (tmp_path / 'h.csv').write_text(written)
    with pytest.raises(ValueError, match=mend):
        read_transfer(tmp_path / 'h.csv')


# --- the command read ----------------------------------------------------------------------------------------------------------

def as_text(written, coding='utf-8'):
    return lambda path: path.write_bytes(written.encode(coding))


def drawn_ridges(seed):
    rng = np.random.default_rng(seed)
    rows = zip(rng.uniform(0.5, 3, 6), rng.uniform(20, 90, 6), rng.uniform(0, 0.4, 6), rng.choice(['a', 'b'], 6), strict=True)
    return text([['xi_rad', 'sigma_xi_rad', 'frequency_kHz', 'sigma_frequency_Hz', 'q1', 'q2', 'record', 'bin_Hz'], *(
        [xi, 0.01, f / 1e3, 0.1, 0.0, q, record, 2.0] for xi, f, q, record in rows)], ';', ',')


EXPORTS = {  # in every way of writing above: what writes a file of this suffix
    **{f'forces, {name}': ('forces', '.csv', as_text(make(*forces(5)))) for name, make in EXPORTS_OF_FORCES.items()},
    **{f'forces, {name}': ('forces', name[name.index('.') :], lambda path, make=make: make(path, *forces(5)))
       for name, make in FORMATS.items()},
    **{f'scan, {name}': ('a scan', '.csv', as_text(make(*waves(5)))) for name, make in EXPORTS_OF_SCANS.items()},
    **{f'response, {name}': ('transfer functions', '.csv', as_text(make(*response(5)), 'utf-16'))
       for name, make in EXPORTS_OF_RESPONSES.items()},
    'ridges': ('ridges', '.csv', as_text(drawn_ridges(5))),
    'responses of points': ('transfer functions', '.csv', as_text(text([
        ['frequency_Hz', 're', 'im', 'sigma', 'x_mm', 'y_mm', 'direction_deg', 'drive_deg'], *(
            [20 + k, 0.1 * k, -0.2, 0.01, x, 5.0, 90.0, 0.0] for x in (1.0, 2.0) for k in range(3))]))),
}


@pytest.mark.parametrize('name', EXPORTS)
def test_a_file_is_recognised_by_what_it_holds(name, tmp_path):
    kind, suffix, write = EXPORTS[name]
    write(tmp_path / f'f{suffix}')
    assert held(tmp_path / f'f{suffix}')[0] == kind


def test_a_dry_run_says_what_was_understood(tmp_path, capsys):
    (tmp_path / 'gaps.csv').write_text('gap_mm,f_N\n1,0.5\n2,0.4\n')
    assert main(['fit', str(tmp_path / 'gaps.csv'), '--contact', '6mm', '--dry-run']) == 0
    assert capsys.readouterr().out.splitlines()[1] == '  distance of the centres (m): 2 values from 0.007 to 0.008'
    (tmp_path / 'none.csv').write_text('colour,size\nred,2\n')
    assert main(['fit', str(tmp_path / 'none.csv'), '--dry-run']) == 2
    assert 'as forces: ' in capsys.readouterr().err


# --- readers of others ---------------------------------------------------------------------------------------------------------

def test_a_reader_of_another_package_is_found_by_its_entry_point(tmp_path, monkeypatch):
    """What it takes is one function and one line of its project file; no file of this package."""
    class Point:
        def load(self):
            return lambda path: {'Abstand [mm]': np.array([8.0, 9.0]), 'Kraft [mN]': np.array([600.0, 400.0])}

    asked = []
    monkeypatch.setattr(readers, 'entry_points', lambda **which: asked.append(which) or [Point()] * (which['name'] == 'svd'))
    (tmp_path / 'f.svd').write_bytes(bytes(range(256)))
    assert read_forces(tmp_path / 'f.svd').f.tolist() == [0.6, 0.4]
    assert asked == [{'group': 'magphonon.readers', 'name': 'svd'}]
    (tmp_path / 'f.abc').write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match='is not a text file'):
        read_forces(tmp_path / 'f.abc')


def test_every_format_has_one_reader():
    assert len(READERS) == len({suffix.lower() for suffix in READERS})
    assert all(callable(reader) for reader in READERS.values())


@pytest.mark.parametrize('seed', range(5))
def test_units_in_brackets_say_what_units_in_names_say(seed, tmp_path):
    """Every unit of lengths and forces, in each way of writing; columns in any order."""
    rng = np.random.default_rng(seed)
    ways = ['{}_{}', '{} [{}]', '{} ({})', '{} / {}', '{} in {}']
    for length in LENGTH:
        for force in FORCE:
            way = ways[rng.integers(len(ways))]
            named = {way.format('x', length): 'x', way.format('f', force): 'f', 'other_' + ''.join(
                rng.choice(list(string.ascii_lowercase), 5)): ''}
            order = [list(named)[k] for k in rng.permutation(3)]
            (tmp_path / 't.csv').write_text(text([order, [2.0, 2.0, 2.0]], ';'))
            table = read_table(tmp_path / 't.csv', {'x': LENGTH, 'f': FORCE}, ['x', 'f'])
            assert table['x'][0] == pytest.approx(2 * LENGTH[length])
            assert table['f'][0] == pytest.approx(2 * FORCE[force])
