"""Files as laboratories have them: each is read as meant, or refused in one line.

What an export looks like is imitated from the instruments that write it, and from tables that people publish.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.io import savemat
from structures import few_first

from magphonon import readers
from magphonon.cli.fit import held
from magphonon.interactions import read_forces
from magphonon.response import read_transfer
from magphonon.waves import read_scan
from magphonon.waves.scans import integrated

R, F = np.array([8.0, 9.5, 11.25, 20.0]), np.array([0.625, 0.375, 0.1875, -0.0015])  # mm and N; a force is below its zero
GF = 9.80665e-3  # N
T = 0.5 * np.arange(40)  # ms
V = 1e-3 * np.sin(0.6 * T[:, None] + np.arange(4)) * np.array([1, 2, 0.5, 1.5])  # mm/ms, shape (frames, points)
HZ = np.linspace(20, 90, 8)
H = np.exp(1j * np.arange(8.0)) / (1 + np.arange(8))  # mm/N


def rows(*columns, sign=',', comma=False, end=''):
    """Lines of numbers with this separator, decimal commas or points, and words at their end."""
    lines = (sign.join(x if isinstance(x, str) else f'{x:.14g}' for x in row) for row in zip(*columns, strict=True))
    return '\n'.join((line.replace('.', ',') if comma else line) + end for line in lines) + '\n'


MACHINE = 'Prüfer:;Meier\nProbe:;Ring N42, 25 °C\nVorkraft [N];0,1\n\n'
LABVIEW = ('LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t.\nDate\t2026/11/23\n***End_of_Header***\t\n\t\n'
           'Channels\t2\nSamples\t4\t4\nX0\t0.0\t0.0\n***End_of_Header***\t\t\n')
TABLE = rows(R, F)
FORCES = {  # and R, or None where the file is refused
    'r [mm],F [N]\n' + TABLE: R,
    'Distance (mm),Force (mN)\n' + rows(R, 1e3 * F): R,
    '"Distance [mm]","Force [newton]"\n' + rows(R, F): R,  # Maxwell
    'd [mm],Force_x [newton],Force_z [newton]\n' + rows(R, F, F): None,  # which is along the line between the magnets?
    'r / cm;F / N\n' + rows(R / 10, F, sign=';'): R,
    'Abstand in mm;Kraft in N\n' + rows(R, F, sign=';', comma=True): R,
    'Mittenabstand (mm),weight [gf]\n' + rows(R, F / GF): R,
    'Kraft [N];Abstand [mm]\n' + rows(F, R, sign=';', comma=True): R,
    'Distance\tForce\nmm\tN\n' + rows(R, F, sign='\t'): R,
    'Distance\tForce\n[mm]\t[mN]\n' + rows(R, 1e3 * F, sign='\t'): R,
    'sep=;\nr [mm];f [N]\n' + rows(R, F, sign=';', comma=True): R,
    'r_cm,f_g\n' + rows(R / 10, F / GF): R,
    'r_mm,f_gf\n' + rows(R, F / GF): R,
    'd [m],load [kgf]\n' + rows(R / 1e3, F / GF / 1e3): R,
    'Distance (in),Load (lbf)\n' + rows(R / 25.4, F / 4.4482216152605): R,
    'Reading\tLoad [gF]\tDistance [mm]\n' + rows(range(4), F / GF, R, sign='\t'): R,
    '"Rate","2.0","mm/min"\n\n"Time","Distance","Load"\n"(s)","(mm)","(N)"\n\n' + rows(range(4), R, F): R,
    '# r_mm f_N\n' + rows(R, F, sign=' '): R,
    '% r_mm, f_N\n' + rows(R, F, sign=', '): R,
    '% Model: ring.mph\n% Distance (mm)         Force (N)\n' + rows(R, F, sign='        '): R,
    '        r[mm]     F[N]\n' + rows(R, F, sign='   '): R,
    ',r_mm,f_N\n' + rows(range(4), R, F): R,
    'd [cm], Mean [N], Standard deviation [N]\n' + rows(R / 10, F, [0.01] * 4, sign=', '): R,
    'dist_cm, force_gf\n' + rows(R / 10, F / GF, sign=', '): R,
    LABVIEW + 'X_Value\tDistance [mm]\tForce [N]\tComment\n' + rows(range(4), R, F, sign='\t'): R,
    LABVIEW + 'X_Value\tDistance [mm]\tForce [N]\tComment\n' + rows(range(4), R, F, sign='\t', end='\t'): R,
    MACHINE + 'Zeit;Abstand;Kraft\ns;mm;N\n' + rows(range(4), R, F, sign=';', comma=True): R,
    'r_mm;f_N;direction;pair\n' + rows(R, F, ['approach', 'return'] * 2, 'abab', sign=';'): R,
    LABVIEW + 'X_Value\tUntitled\tUntitled 1\tComment\n' + rows(range(4), R, F, sign='\t'): None,  # which is which?
    MACHINE + 'Zeit;Weg;Kraft\ns;mm;N\n' + rows(range(4), R, F, sign=';', comma=True): None,  # from where does it count?
    '"1 _ 1",,\nTime,Force,Stroke\nsec,N,mm\n' + rows(range(4), F, R): None,
    'Time,Displacement,Force\n(s),(mm),(N)\n' + rows(range(4), R, F): None,
    'Extension [mm],Load [N]\n' + TABLE: None,
    'r [um];f [uN]\n8,000.0;625,000\n9,500.0;375,000\n': None,  # marks between thousands
    "r [um];f [uN]\n8'000.0;625'000\n": None,
    'r [mm];F [N]\n1,234;0.5\n': None,  # a thousand, or one and a bit: nobody knows
    'r [mm];F [N]\n1.234,5;0,5\n12.34,5;0,4\n': None,
    'r [mm],F [N]\n8,0.6\n9,NaN\n': None,
    'r [mm],F [N]\n8,OL\n9,0.4\n': None,
    'r [mm],F [N]\n8,0.6\nMean,0.6\n': None,
    'r,F\n8 mm,0.6 N\n': None,
    'r [mm],F [dyn]\n8,6e4\n': None,
    'r [ft],F [N]\n1,2\n': None,
    'Distance,Force\n1,2\n': None,
    'Distance,Force\nmm,eV\n8.0,0.6\n': None,
    '8.0,0.6\n9,0.5\nr [mm],F [N]\n10,0.4\n': None,
    'r [mm],F [N]\n8,0.6\nr [mm],F [N]\n9,0.4\n': None,
    'r [mm],F [N]\nN,mm\n8.0,0.6\n': None,
    'r [mm],F [N]\n8.0,0.6\n9.0\n': None,
    'r [mm],Distance [mm],F [N]\n8,8,0.6\n': None,
    'r [mm],F [N],direction\n8,0.6,up\n': None,
    'r [m],F [N]\n' + TABLE: None,  # millimetres
    'r [mm],F [N]\n' + rows(R, -F): None,
    'r [mm],F [N],sigma [N]\n' + rows(R, F, [0.1, 0.1, 0.0, 0.1]): None,
    'gap_mm,f_N\n' + rows(R - 6.35, F): None,  # of which magnets?
    'gap_mm,r_mm,f_N\n' + rows(R - 6.35, R, F): None,
}


def refusal(read, path):
    with pytest.raises(ValueError, match=str(path)) as error:
        read(path)
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 900


@pytest.mark.parametrize('text', FORCES)
@pytest.mark.parametrize('coding', few_first(['utf-8', 'utf-8-sig', 'utf-16', 'cp1252'], 1))
def test_tables_of_forces(text, coding, tmp_path):
    """Another unit would be seen: factors of units are 2.5 and more."""
    (tmp_path / 'f.csv').write_bytes(text.encode(coding))
    if FORCES[text] is None:  # nor is it read as anything else
        for read in (read_forces, read_scan, read_transfer, held):
            refusal(read, str(tmp_path / 'f.csv'))
        return
    found = read_forces(tmp_path / 'f.csv')
    assert_allclose(found.r, R, rtol=1e-12)
    assert_allclose(found.f, F, rtol=1e-12)
    assert held(str(tmp_path / 'f.csv'))[0] == 'forces'


def test_gaps_need_the_size_of_the_magnets(tmp_path):
    for text in ('gap_mm,f_N\n' + rows(R - 6.35, F), 'Spalt [mm],F_g\n' + rows(R - 6.35, F / GF)):
        (tmp_path / 'f.csv').write_text(text)
        found = read_forces(tmp_path / 'f.csv', contact=6.35)
        assert_allclose(found.r, R)
        assert_allclose(found.f, F)
    (tmp_path / 'f.csv').write_text('gap_mm,f_N\n' + rows(R - 9.5, F))
    with pytest.raises(ValueError, match='gap_mm'):
        read_forces(tmp_path / 'f.csv', contact=6.35)


# --- other formats -------------------------------------------------------------------------------------------------------------

def hdf5(path, write, **options):
    import h5py

    with h5py.File(path, 'w', **options) as file:
        write(file)


def with_attributes(file):
    group = file.create_group('run 1/raw')
    group.create_dataset('Distance', data=R / 1e3).attrs['Units'] = 'm'
    group.create_dataset('Force', data=1e3 * F).attrs['unit'] = 'mN'
    group.create_dataset('temperature', data=25.0)


def matlab_73(path):
    """Of its version 7.3: a user block, and arrays of one row."""
    hdf5(path, lambda file: [file.create_dataset(name, data=x[None]) for name, x in (('r_mm', R), ('f_N', F))],
         userblock_size=512)
    path.write_bytes(b'MATLAB 7.3 MAT-file, Platform: GLNXA64'.ljust(116) + bytes(8) + b'\x00\x02IM' + path.read_bytes()[128:])


def workbook(path, sheets=1):
    openpyxl = pytest.importorskip('openpyxl')
    book = openpyxl.Workbook()
    for k in range(sheets):
        sheet = book.create_sheet(f'data {k}')
        for row in [['Protocol of the bench'], [], ['Kraft', 'Abstand', 'Bemerkung'], ['N', 'mm', None], *(
                [b, a, 'up\tand down'] for a, b in zip(R.tolist(), F.tolist(), strict=True))]:
            sheet.append(row)
    book.save(path)


FORMATS = {  # what is written, and whether it is read
    'f.npz': (lambda path: np.savez(path, r_mm=R, f_N=F, rate=7.0), True),
    'row.npz': (lambda path: np.savez(path, r_mm=R[None], f_N=F[:, None]), True),
    'unnamed.npz': (lambda path: np.savez(path, np.stack([R, F], axis=1)), False),
    'short.npz': (lambda path: np.savez(path, r_mm=R, f_N=F[1:]), False),
    'times.npz': (lambda path: np.savez(path, r_mm=R.astype('m8[us]'), f_N=F), False),
    'complex.npz': (lambda path: np.savez(path, r_mm=R + 0j, f_N=F), False),
    'f.mat': (lambda path: savemat(path, {'r_mm': R, 'f_N': F}), True),
    'structure.mat': (lambda path: savemat(path, {'data': {'r_mm': R, 'f_N': F}}), True),
    'same.mat': (lambda path: savemat(path, {name: {'r_mm': R, 'f_N': F} for name in 'ab'}), True),
    'other.mat': (lambda path: savemat(path, {'a': {'r_mm': R, 'f_N': F}, 'b': {'r_mm': R, 'f_N': 2 * F}}), False),
    'matrix.mat': (lambda path: savemat(path, {'data': np.stack([R, F], axis=1)}), False),
    '73.mat': (matlab_73, True),
    'f.h5': (lambda path: hdf5(path, with_attributes), True),
    'rows.h5': (lambda path: hdf5(path, lambda file: file.create_dataset('table', data=np.array(
        list(zip(R, F, strict=True)), [('r_mm', float), ('f_N', float)]))), True),
    'f.xlsx': (workbook, True),
    'two.xlsx': (lambda path: workbook(path, 2), False),
}


@pytest.mark.parametrize('name', FORMATS)
def test_other_formats_are_read_through_their_libraries(name, tmp_path):
    write, read = FORMATS[name]
    write(tmp_path / name)
    if not read:
        refusal(read_forces, tmp_path / name)
        return
    found = read_forces(tmp_path / name)
    assert_allclose(found.r, R, rtol=1e-15)
    assert_allclose(found.f, F, rtol=1e-15)


@pytest.mark.parametrize('name', [*FORMATS, 'f.uff', 'f.svd', 'f.csv'])
def test_noise_is_refused_and_never_reaches_the_terminal(name, tmp_path):
    for start in (b'', b'PK\x03\x04', b'\x93NUMPY', b'MATLAB 5.0'):
        (tmp_path / name).write_bytes(start + np.random.default_rng(0).bytes(4000))
        refusal(read_forces, tmp_path / name)


def test_a_reader_of_another_package_is_found_by_its_entry_point(tmp_path, monkeypatch):
    """What it takes is one function and one line of its project file; no file of this package."""
    class Point:
        def load(self):
            return lambda path: {'Abstand [mm]': R, 'Kraft [mN]': 1e3 * F}

    monkeypatch.setattr(readers, 'entry_points', lambda group, name: [Point()] * ((group, name) == ('magphonon.readers', 'svd')))
    (tmp_path / 'f.svd').write_bytes(bytes(range(256)))
    assert_allclose(read_forces(tmp_path / 'f.svd').f, F)
    (tmp_path / 'f.abc').write_bytes(bytes(range(256)))
    refusal(read_forces, tmp_path / 'f.abc')


# --- scans ---------------------------------------------------------------------------------------------------------------------

LONG = np.repeat(T, 4) / 1e3, np.tile([1, 2, 3, 4], 40), np.tile([0, 10, 20, 30], 40), V.ravel()  # s, names, mm, m/s
WIDE = [T / 1e3, *1e3 * V.T]
POLYTEC = 'Source File:\tScan_3.svd\nSignal:\tVib - Velocity\nDate: 11/23/2026\n\n'
SCANS = {  # and names of its points and its direction, or None
    'Time [s],Point,X [mm],v_y [m/s]\n' + rows(*LONG): ('1234', 'y'),
    POLYTEC + 'Time\tPoint Index\tX\tVelocity\ns\t\tmm\tm/s\n' + rows(*LONG, sign='\t'): ('1234', ''),
    'Zeit [s];Punkt;x [mm];Geschwindigkeit [m/s]\n' + rows(*LONG, sign=';', comma=True): ('1234', ''),
    'Time [s];Point 1 [mm/s];Point 2 [mm/s];Point 3 [mm/s];Point 4 [mm/s]\n' + rows(*WIDE, sign=';'): ('1234', ''),
    'Time [s]\tv_y 1 [mm/s]\tv_y 2 [mm/s]\tv_y 3 [mm/s]\tv_y 4 [mm/s]\n' + rows(*WIDE, sign='\t'): ('1234', 'y'),
    'Time,1,2,3,4\ns,mm/s,mm/s,mm/s,mm/s\n' + rows(*WIDE): ('1234', ''),
    'time_s,A1 [mm/s],A2 [mm/s],B1 [mm/s],B2 [mm/s]\n' + rows(*WIDE): (('A1', 'A2', 'B1', 'B2'), ''),
    'time_s,Ref 1 [mm/s],Point 1 [mm/s],Point 2 [mm/s],Point 3 [mm/s]\n' + rows(*WIDE): (
        ('Ref 1', 'Point 1', 'Point 2', 'Point 3'), ''),
    'time_s,Vy 1 [mm/s],Vy 2 [mm/s],y3 [mm/s],Point 4 Y [mm/s]\n' + rows(*WIDE): ('1234', 'y'),
    'time_s,17 [mm],u 17 [mm]\n0,1,2\n1,2,3\n': None,
    'time_s,P1,P2\n0,1,2\n1,2,3\n': None,
    'time_s,P1 [m/s],P2 [mm]\n0,1,2\n1,2,3\n': None,
    'time_s,v_x 1 [m/s],v_y 2 [m/s]\n0,1,2\n1,2,3\n': None,
    'time_s,point,v_y [m/s]\n0,1,1\n0.1,1,2\n0.3,1,1\n': None,
    'time_s,Stroke [mm]\n0,1\n1,2\n': None,  # one point is no scan
    'time_s,f_N,P1 [mm],P2 [mm]\n0,0.1,1,2\n1,0.2,2,3\n': None,
    **{f'{header}\n' + 3 * f'{",".join("1" * (1 + header.count(",")))}\n': None for header in (
        'time_s,point,u_y', 'time,point,u_y_m', 'time_s,point,v_y_mm', 'time_s,u_y_m,other', 'time_s,point,speed',
        'time_s,u_y_m,u_y_mm', 'particle,point,u_y_m,time_s', 'point,u_x_m,v_y_m_per_s,time_s', 'point,u_x_m,u_m,time_s')},
    **{'time_ms,point,u_x_m,u_y_m\n' + rows.replace('k', '1') + rows.replace('k', '2'): None  # columns without numbers
       for rows in ('k,1,nan,1e-6\n', 'k,1,,1e-6\n', 'k,1,1e-6,\nk.5,1,,1e-6\n')},
}


@pytest.mark.parametrize('text', SCANS)
@pytest.mark.parametrize('coding', few_first(['utf-8', 'utf-16'], 1))
def test_tables_of_scans(text, coding, tmp_path):
    (tmp_path / 's.csv').write_bytes(text.encode(coding))
    if SCANS[text] is None:
        refusal(read_scan, tmp_path / 's.csv')
        return
    scan, (names, axis) = read_scan(tmp_path / 's.csv'), SCANS[text]
    assert (scan.names, [*scan.motions]) == (tuple(names), [axis])
    assert_allclose(scan.times, T, atol=1e-9)
    assert_allclose(scan.motions[axis], integrated(V, 0.5), atol=1e-9)
    if scan.places is not None:
        assert_allclose(scan.places, [[0, 0], [10, 0], [20, 0], [30, 0]])


@pytest.mark.parametrize(('given', 'names'), [
    ({'time_ms': T, 'x_m': 1e-2 * np.arange(4), 'point': [7.0, 8.0, 9.0, 10.0], 'v_y_m_per_s': V}, ('7', '8', '9', '10')),
    ({'time_ms': T, 'x_m': 1e-2 * np.arange(4), 'point': [7.0, 8.0, 9.0, 10.0], 'v_y_m_per_s': V.T}, ('7', '8', '9', '10')),
    ({'time_ms': T, 'v_y_m_per_s': V, 'rate': 2000.0}, ('1', '2', '3', '4')),
    ({'time_ms': T, 'v_y_m_per_s': V, 'x_m': np.arange(3.0)}, None),
    ({'time_ms': T[:4], 'v_y_m_per_s': V[:4]}, None),  # which axis is which?
    ({'v_y_m_per_s': V}, None),
])
def test_arrays_of_frames_and_points_are_scans(given, names, tmp_path):
    for file, save in (('s.mat', savemat), ('s.npz', lambda path, arrays: np.savez(path, **arrays))):
        save(tmp_path / file, given)
        if names is None:
            refusal(read_scan, tmp_path / file)
            continue
        scan = read_scan(tmp_path / file)
        assert scan.names == names
        assert_allclose(scan.motions['y'], integrated(V, 0.5), atol=1e-9)
        assert scan.places is None or np.allclose(scan.places[:, 0], [0, 10, 20, 30])


# --- transfer functions --------------------------------------------------------------------------------------------------------

def polar(h, unit, sign=',', comma=False, head='Frequency [Hz],Amplitude [{}],Phase [°]'):
    head = head.format(unit).replace(',', sign)
    return f'{head}\n' + rows(HZ, abs(h), np.degrees(np.angle(h)), sign=sign, comma=comma)


def rate(order):
    """A receptance of H as a velocity or an acceleration, in m per N."""
    return 1e-3 * H * (2j * np.pi * HZ) ** order


RESPONSES = {  # and whether they are read as H
    polar(H, 'mm/N'): True,
    polar(1e-3 * H, 'm/N', ';', True): True,
    polar(rate(1), '(m/s)/N'): True,
    polar(rate(1), 'm/(N·s)'): True,
    polar(rate(1), 'm/s/N', head='Frequency (Hz),Amplitude ({}),Phase (deg)'): True,
    polar(rate(2), '(m/s²)/N', ';', True, 'Frequenz [Hz],Betrag [{}],Phase [deg]'): True,
    polar(rate(2), 'm/s^2/N'): True,
    polar(rate(2) / 9.80665, 'g/N'): True,
    'f_kHz\tReal [mm/N]\tImag [mm/N]\tCoherence\n' + rows(HZ / 1e3, H.real, H.imag, 0 * HZ + 1, sign='\t'): True,
    'Index,frequency_Hz,re_mm_per_N,im_mm_per_N\n' + rows(range(8), HZ, H.real, H.imag): True,
    'Signal:\tFRF Velocity / Force\n\nFrequency\tMagnitude\tPhase\nHz\t(m/s)/N\trad\n' + rows(
        HZ, abs(rate(1)), np.angle(rate(1)), sign='\t'): True,
    polar(20 * np.log10(abs(H)), 'dB re 1 mm/N'): False,  # export linear amplitudes
    polar(H, 'V/V'): False,
    'Frequency [Hz],Amplitude [mm/N],Phase [deg]\n20,-1,0\n21,1,0\n': False,
    'Frequency [Hz],Amplitude [mm/N]\n20,1\n21,1\n': False,
    'Frequency [Hz],Real [mm/N],Imag [m/N]\n20,1,2\n21,1,2\n': False,
    'Point,Value\n1,2\n': False,
}


@pytest.mark.parametrize('text', RESPONSES)
def test_tables_of_transfer_functions(text, tmp_path):
    for coding in ('utf-8', 'utf-16', 'cp1252'):
        (tmp_path / 'h.csv').write_bytes(text.encode(coding))
        if not RESPONSES[text]:
            refusal(read_transfer, tmp_path / 'h.csv')
            continue
        (found,) = read_transfer(tmp_path / 'h.csv')
        assert_allclose(found.omega, 2e-3 * np.pi * HZ, rtol=1e-12)
        assert_allclose(found.response, H, rtol=1e-12)


# --- universal files -----------------------------------------------------------------------------------------------------------

FUNCTION = {'type': 58, 'binary': 0, 'func_type': 4, 'rsp_node': 1, 'rsp_dir': 1, 'ref_node': 2, 'ref_dir': 1, 'x': HZ,
            'data': 1e-3 * H, 'abscissa_spec_data_type': 18, 'ordinate_spec_data_type': 8, 'orddenom_spec_data_type': 13}
RECORD = FUNCTION | {'func_type': 1, 'abscissa_spec_data_type': 17, 'orddenom_spec_data_type': 0, 'data': V[:, 0], 'x': T / 1e3}
PLACES = {'type': 15, 'node_nums': [1, 2], 'x': [0.0, 0.01], 'y': [0.0, 0.0], 'z': [0.0, 0.0], 'def_cs': [0, 0],
          'disp_cs': [0, 0], 'color': [0, 0]}
AXES = {'type': 18, 'cs_num': [1], 'ref_cs_num': [0], 'ref_o': [np.zeros(3)], 'x_point': [np.array([-1.0, 0, 0])],
        'xz_point': [np.array([0, 0, 1.0])]}


def universal(path, *sets):
    pyuff = pytest.importorskip('pyuff')
    pyuff.UFF(str(path)).write_sets([dict(one) for one in sets], 'overwrite')
    return path


@pytest.mark.parametrize('seed', range(12))
def test_the_labels_of_a_universal_file_are_its_units(seed, tmp_path):
    """With a dataset 164 that says otherwise, or with none; the quantity, its unit, and how it is written are drawn."""
    rng, order = np.random.default_rng(seed), seed % 3
    lengths = {'m': 1.0, 'mm': 1e-3, 'um': 1e-6, 'in': 0.0254} | ({'g': 9.80665} if order == 2 else {})
    forces, hertz = {'N': 1.0, 'kN': 1e3, 'lbf': 4.4482216}, {'Hz': 1.0, 'rad/s': 1 / (2 * np.pi)}
    length, force, per = (str(rng.choice([*units])) for units in (lengths, forces, hertz))
    over = length + ('', '/s', '/s^2')[order] * (length != 'g')
    in_one = bool(rng.integers(2))  # the label of the ordinate says all
    one = FUNCTION | {'ordinate_axis_units_lab': f'({over})/{force}' if in_one else over, 'abscissa_axis_units_lab': per,
                      'orddenom_axis_units_lab': 'NONE' if in_one else force, 'x': HZ / hertz[per],
                      'data': rate(order) / lengths[length] * forces[force], 'ordinate_spec_data_type': (8, 11, 12)[order]}
    other = {'type': 164, 'units_code': 1, 'units_description': 'x', 'temp_mode': 1, 'length': 7.0, 'force': 3.0, 'temp': 1.0,
             'temp_offset': 0.0}
    file = universal(tmp_path / 'f.uff', *[other] * int(rng.integers(2)), one)
    file.write_text(file.read_text('utf-8').replace('s^2', 's²'), 'utf-8')  # which pyuff reads, but does not write
    (found,) = read_transfer(file)
    assert_allclose(found.omega, 2e-3 * np.pi * HZ, rtol=1e-5)  # pyuff writes five digits
    assert_allclose(found.response, H, rtol=1e-4)


UNIVERSAL = {  # sets, and how many functions and records are read; None if it is refused
    'one function': ([FUNCTION], 1, None),
    'placed': ([PLACES, FUNCTION, FUNCTION | {'rsp_node': 2}], 2, None),
    'binary': ([PLACES, FUNCTION | {'binary': 1}], 1, None),  # an odd number of lines "    -1"
    'binary, three sets': ([PLACES, *(FUNCTION | {'binary': 1, 'rsp_node': k} for k in (1, 2))], 2, None),
    'records': ([PLACES, RECORD, RECORD | {'rsp_node': 2}], None, 2),
    'not placed': ([FUNCTION, FUNCTION | {'rsp_node': 2}], None, None),
    'a lost node': ([PLACES, FUNCTION | {'rsp_node': 9}], None, None),
    'records of a lost node': ([PLACES, RECORD, RECORD | {'rsp_node': 9}], None, None),
    'turned sensors': ([AXES, PLACES | {'disp_cs': [0, 1]}, FUNCTION], None, None),
    'all turned': ([AXES, PLACES | {'disp_cs': [1, 1]}, RECORD], None, None),
    'one system of axes': ([PLACES | {'disp_cs': [1, 1]}, FUNCTION], 1, None),
    'volts': ([FUNCTION | {'ordinate_axis_units_lab': 'V'}], None, None),
    'a speed called displacement': ([FUNCTION | {'ordinate_axis_units_lab': 'm/s'}], None, None),
    'no imaginary part': ([FUNCTION | {'data': np.ones(8)}], None, None),
    'a rotation': ([PLACES, FUNCTION | {'rsp_dir': 4}], None, None),
    'records of accelerations': ([PLACES, RECORD | {'ordinate_spec_data_type': 12}], None, None),
    'records of two kinds': ([PLACES, RECORD, RECORD | {'rsp_node': 2, 'ordinate_spec_data_type': 11}], None, None),
    'a record twice': ([PLACES, RECORD, RECORD], None, None),
    'a geometry alone': ([PLACES], None, None),
}


LEFT_OPEN = pytest.mark.filterwarnings('ignore::pytest.PytestUnraisableExceptionWarning')  # binary files, by pyuff as it writes


@LEFT_OPEN
@pytest.mark.parametrize('name', UNIVERSAL)
def test_universal_files(name, tmp_path):
    sets, functions, records = UNIVERSAL[name]
    file = universal(tmp_path / 'f.uff', *sets)
    for read, count in ((read_transfer, functions), (read_scan, records)):
        if count is None:
            refusal(read, file)
            continue
        found = read(file)
        assert count == len(found if read is read_transfer else found.names)
        if read is read_transfer:
            assert_allclose(found[0].response, H, rtol=1e-4)
        else:
            assert_allclose(found.motions['x'][:, 0], 1e3 * V[:, 0], rtol=1e-4, atol=1e-7)


@LEFT_OPEN
def test_universal_files_that_were_cut_or_hold_fewer_values_are_refused(tmp_path):
    for binary in (0, 1):
        whole = universal(tmp_path / 'f.uff', PLACES, FUNCTION | {'binary': binary}).read_bytes()
        for lost in (4, len(whole) // 2, len(whole) - 20):
            (tmp_path / 'cut.uff').write_bytes((whole + whole)[:-lost])
            refusal(read_transfer, tmp_path / 'cut.uff')
    lines = universal(tmp_path / 'f.uff', FUNCTION).read_text('utf-8').splitlines()
    (tmp_path / 'short.uff').write_text('\n'.join([*lines[:-2], lines[-1], '']), 'utf-8')  # without its last line of values
    refusal(read_transfer, tmp_path / 'short.uff')


CAUSES = {  # files without anything that is known, and what a refusal must say
    'voltages.lvm': (lambda path: path.write_text(LABVIEW + 'X_Value\tVoltage_0\tVoltage_1\tComment\n'
                                                  + rows(R, R, F, sign='\t')),
                     "its header is 'X_Value,Voltage_0,Voltage_1,Comment'"),
    'bare.csv': (lambda path: path.write_text(TABLE), "its header is '8,0.625'"),
    'one point.csv': (lambda path: path.write_text(f'time_s,Point 1 [mm/s]\n{TABLE}'), 'a scan of several points'),
    'accelerations.uff': (lambda path: universal(path, PLACES, RECORD | {'ordinate_spec_data_type': 12}),
                          'accelerations over time'),
    'geometry.uff': (lambda path: universal(path, PLACES), 'its functions are none'),
    'unknown.uff': (lambda path: universal(path, PLACES, FUNCTION | {'func_type': 1}),
                    r'displacements over frequency \(type 1\)'),
    'camera.svd': (lambda path: path.write_bytes(bytes(range(256))), 'is not a text file; export it as CSV'),
}


@LEFT_OPEN
@pytest.mark.parametrize('name', CAUSES)
def test_a_refusal_names_the_cause_in_one_line(name, tmp_path):
    write, cause = CAUSES[name]
    write(tmp_path / name)
    with pytest.raises(ValueError, match=cause) as refused:
        held(str(tmp_path / name))
    words = str(refused.value).replace(str(tmp_path), '')
    assert len(words) < 300
    assert '\n' not in words


def test_small_files_of_large_arrays_are_refused_before_they_are_unpacked(tmp_path, monkeypatch):
    """Zeros that packed take a hundredth of their size; in each format the sizes stand before the numbers."""
    openpyxl, zeros = pytest.importorskip('openpyxl'), np.zeros(4000)
    np.savez_compressed(tmp_path / 'f.npz', r_mm=zeros)
    savemat(tmp_path / 'f.mat', {'r_mm': zeros}, do_compression=True)
    hdf5(tmp_path / 'f.h5', lambda file: file.create_dataset('r_mm', data=zeros, compression='gzip'))
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet()
    for _ in range(300):  # cells of some 24 bytes
        sheet.append([0] * 4)
    book.save(tmp_path / 'f.xlsx')
    for most, refused in ((1000, True), (100_000, False)):
        monkeypatch.setattr(readers, 'MOST_NUMBERS', most)
        for file in tmp_path.iterdir():
            with pytest.raises(ValueError, match='lacks the column' if not refused else 'million numbers, more than the 0.001'):
                read_forces(file)
