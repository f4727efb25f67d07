"""Lattices from transfer functions: the Cramer-Rao bound, lattices that are not the model, files, and a shaken bench."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from ase import Atoms
from numpy.testing import assert_allclose
from oracles import Pairs
from scipy.signal import fftconvolve

from magphonon import DrivenVerlet, modes, read_scene, units as u
from magphonon.cli.fit_report import frf_report
from magphonon.cli.main import main
from magphonon.design.sensitivities import hessian_changes
from magphonon.dynamics import Harmonic, Recorder
from magphonon.response import Dof, estimated, read_transfer, receptance
from magphonon.response.frf import base_force
from magphonon.response.stepped import lock_in
from magphonon.response.transfer_functions import TransferFunction
from magphonon.scenes import fit_frf
from magphonon.scenes.frf_fits import missing_magnet, responses_of, suspect_units, with_dofs
from magphonon.stiffness import LinearSystem

HEXAGON = '''title = "hexagon"
[lattice]
kind = "triangular"
spacing_m = 0.01
mass_kg = 0.0007
[law]
kind = "inverse_power"
b_N_m_a = 1.62093299e-10
a = 4.5824
shells = 1
[foundation]
stiffness_N_per_m = 19.6757
[patch]
kind = "hexagon"
side_m = 0.06
[frf]
from_Hz = 20.0
to_Hz = 160.0
points = 70
damping_per_s = 4.0
[frf.force]
at_m = [0.0, 0.0]
direction_deg = 40.0
[frf.response]
at_m = [0.01, 0.0]
direction_deg = 0.0
'''
RECEIVERS = [(0.01, 0.0), (-0.015, 0.00866), (0.005, -0.02598)]  # m, each along x and y
SHARE = 0.01  # noise of real and imaginary part, of the largest response
TRUTH = {'force': 0.2369, 'a': 4.5824, 'foundation': 19.6757, 'damping': 4.0}
NAMES = tuple(TRUTH)


def scene_of(folder, *changes, name='hexagon.toml'):
    text = HEXAGON
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / name).write_text(text)
    return read_scene(folder / name)


def dense(force=0.2369, a=4.5824, foundation=19.6757, damping=4.0, mass=7e-4, static=True):
    """Responses of the hexagon in m/N, shape (6, 70), by the energy of each pair and dense matrices: nothing of the package."""
    n = [(i, j) for i in range(-6, 7) for j in range(-6, 7) if abs(i + j) <= 6]
    x = 10.0 * np.array([(i + j / 2, j * np.sqrt(3) / 2, 0) for i, j in n])
    law = SimpleNamespace(phi=lambda r: 10 * force / (a - 1) * (10 / r) ** (a - 1))
    bonds = Pairs(Atoms(f'H{len(n)}', positions=x), law, 10.1, 'complete' if static else 'conventional')
    H = 1e3 * bonds.hessian(x) + foundation * np.eye(254)  # N/m
    free = [k for k, (i, j) in enumerate(n) if max(abs(i), abs(j), abs(i + j)) < 6]
    centre, *seen = (2 * free.index(int(np.linalg.norm(x[:, :2] - np.multiply(1e3, at), axis=1).argmin()))
                     for at in [(0, 0), *RECEIVERS])
    rows, push = np.ravel([[2 * k, 2 * k + 1] for k in free]), np.zeros(182)
    push[centre : centre + 2] = np.cos(np.deg2rad(40)), np.sin(np.deg2rad(40))
    H, w = H[np.ix_(rows, rows)], 2 * np.pi * np.linspace(20, 160, 70)
    u = [np.linalg.solve(H + (1j * one * damping - one**2) * mass * np.eye(182), push) for one in w]
    return np.array(u).T[[at + axis for at in seen for axis in (0, 1)]]


@pytest.fixture(scope='module')
def exact():
    return dense()


def measured(h, rng, share=SHARE, sigma=True):
    """TransferFunctions of these responses with noise."""
    noise = share * abs(h).max()
    h = h + noise * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))
    omega = 2 * np.pi * np.linspace(20, 160, h.shape[1]) * u.Hz
    places = [np.array([x * u.m, y * u.m, axis * np.pi / 2]) for x, y in RECEIVERS for axis in (0, 1)]
    return [TransferFunction(f'{k}', omega, row * u.m / u.N, noise * u.m / u.N if sigma else None, 0, place)
            for k, (row, place) in enumerate(zip(h, places, strict=True))]


def bound(share=SHARE):
    """Cramer-Rao's relative standard deviations of force, a, foundation, damping, and of the bond stiffness; by differences."""
    step, slopes = 1e-5, []
    for name, value in TRUTH.items():
        up, down = (dense(**{name: value * (1 + sign * step)}) for sign in (1, -1))
        slopes.append(((up - down) / (2 * step)).ravel())
    J = np.array(slopes) / (share * abs(dense()).max())
    C = np.linalg.inv((J @ J.conj().T).real)
    along = np.array([1, 1, 0, 0])  # a f/L
    return np.sqrt(np.append(np.diag(C), along @ C @ along))


@pytest.mark.slow
def test_a_fit_reaches_the_bound_and_rejects_d0_alone(tmp_path, exact):
    """Started 8 % off, which is farther than the peaks are wide."""
    scene = scene_of(tmp_path, ('1.62093299e-10', '1.5053e-10'), ('19.6757', '21.2'), ('= 4.0\n', '= 6.0\n'))
    fits = fit_frf(scene, measured(exact, np.random.default_rng(1)), ['mass'], gain_sigma=0.0)
    fit, values = fits.fits['complete'], fits.values()
    sigmas = bound()
    assert_allclose([values[name][1] for name in (*NAMES, 'bond stiffness')], sigmas, rtol=0.03)  # at the fit, not at the truth
    off = [np.log(values[name][0] / TRUTH[name]) / sigma for name, sigma in zip(NAMES, sigmas, strict=False)]
    assert np.abs(off).max() < 3.5  # once in 500 draws of four
    assert not fit.site_scatter.any()
    assert 0.8 < fit.misfit < 1.2
    assert fits.fits['conventional'].misfit > 5  # the control
    assert not fits.fits['conventional'].follows
    assert fits.ratio > 5


@pytest.mark.slow
def test_gain_mass_and_what_is_fixed(tmp_path, exact):
    scene = scene_of(tmp_path)
    functions = measured(dense(mass=7.14e-4), np.random.default_rng(2))
    functions = [replace(one, response=1.03 * one.response) for one in functions]
    fits = fit_frf(scene, functions, ['foundation'], {'mass': (7e-4, 3e-5)}, gain_sigma=0.05)
    values = fits.values()
    assert fits.fits['complete'].names == ('force', 'a', 'damping', 'mass', 'gain')
    assert_allclose([values['gain'][0], values['mass'][0]], [1.03, 7.14e-4], rtol=5e-3)
    value, sigma = fit_frf(scene, functions, ['mass'], gain_sigma=0.0).values()['force']
    assert abs(np.log(value / TRUTH['force'])) > 20 * sigma  # the control: a gain that nobody allows for
    assert not fits.contradicted


@pytest.mark.slow
@pytest.mark.parametrize(('scale', 'known', 'off'), [
    (1.0, {}, set()), (1.1, {}, {'gain', 'mass'}), (1.0, {'mass': (7.7e-4, 7e-6)}, {'gain', 'mass'})])
def test_what_was_known_and_the_data_contradict_is_said(scale, known, off, tmp_path, exact):
    """A calibration of a percent that is ten percent off, and a mass."""
    functions = [replace(one, response=scale * one.response) for one in measured(exact, np.random.default_rng(2))]
    fits = fit_frf(scene_of(tmp_path), functions, [], known, gain_sigma=0.01)
    assert set(fits.contradicted) == off
    assert frf_report(fits, []).count('sigma from the') == len(off)


def test_slopes_where_a_parameter_moves_the_rest(tmp_path, monkeypatch):
    """Two shells in a patch with a vacancy: differences of structures that have come to rest again."""
    shells = 'shells = 1', 'shells = 2'
    vacancy = '[frf.force]', '[defects]\nvacancies_m = [[0.02, 0.0]]\n[frf.force]'
    scene = scene_of(tmp_path, shells, vacancy, ('side_m = 0.06', 'side_m = 0.04'), ('points = 70', 'points = 5'),
                     ('= 4.0\n', '= 40.0\n'))
    omega = scene.frf.omega
    own = with_dofs(scene, [TransferFunction('one', omega, 0j * omega)])
    from magphonon.design.transfer_fits import response_slopes
    from magphonon.scenes.frf_fits import _built
    built = _built(scene, 'complete', {})
    h, slopes = response_slopes(built, own, NAMES)
    monkeypatch.setattr('magphonon.design.transfer_fits.DENSE', 0)  # as a large structure, by factors
    assert_allclose(h, responses_of(scene, 'complete', own)[0], rtol=1e-9)
    assert_allclose(response_slopes(built, own, NAMES)[1], slopes, rtol=0, atol=1e-9 * abs(slopes).max())
    for name, slope in zip(NAMES, slopes, strict=True):
        up, down = (responses_of(scene, 'complete', own, {name: np.exp(sign * 1e-4)})[0] for sign in (1, -1))
        assert_allclose(slope, (up - down) / 2e-4, rtol=0, atol=1e-5 * abs(slope).max(), err_msg=name)
    still = hessian_changes(built.system, [built.changes['force']])[0]
    from magphonon.design.sensitivities import _stiffness_change
    from magphonon.stiffness.matrices import hessian
    fixed = hessian(built.system.calc.bonds, _stiffness_change(built.system.calc, built.changes['force'], 'complete'), 0.0)
    assert abs(still - fixed).max() > 1e-2 * abs(fixed).max()  # the control: positions that stay


@pytest.mark.slow
def test_a_shaken_bench_in_time_steps(tmp_path):
    """All particles pushed by -m a in the frame of the bench; and by moving walls and anchors in that of the floor."""
    scene = scene_of(tmp_path, ('[frf.force]\nat_m = [0.0, 0.0]\ndirection_deg = 40.0\n', ''),
                     ('points', 'base_deg = 40.0\npoints'), ('side_m = 0.06', 'side_m = 0.03'), ('= 4.0\n', '= 60.0\n'))
    atoms, direction, answer = scene.shaken(bench=True)
    omega, damping = 2 * np.pi * 35 * u.Hz, scene.frf.damping
    expected = receptance(atoms, direction, answer, [omega], damping).response[0]
    force = base_force(LinearSystem.of(atoms), direction)
    moving = np.flatnonzero(force.any(axis=1))
    acceleration = 1e-4  # mm/ms^2: 0.2 % of the linear range
    dyn = DrivenVerlet(atoms, 0.05, [Harmonic(moving, direction, acceleration * atoms.get_masses()[moving], omega, np.pi / 2)],
                       damping)
    record = Recorder(dyn, [answer.particle])
    dyn.run(round(500 / 0.05))  # the free vibration has died to e^-15
    dt = 0.05 * record.interval
    last = round(4 * 2 * np.pi / omega / dt)
    w = lock_in(record.displacements[-last:, 0, 0], dt, omega, record.times[-last])
    bench = acceleration / omega**2  # u_b = bench cos: -m u_b'' = m acceleration cos
    assert_allclose(w / bench + direction[0], expected, rtol=2e-3)  # (omega dt)^2/24 at a resonance
    assert abs(direction[0] - expected) > 0.3 * abs(expected)  # the control: it does not move as the bench alone


def test_files(tmp_path, exact):
    """A table in mobility and one in accelerance, amplitude and phase, say the same as the universal file."""
    pyuff = pytest.importorskip('pyuff')
    f = np.linspace(20, 160, 70)
    w, h = 2 * np.pi * f, exact[0]
    (tmp_path / 're.csv').write_text('frequency_Hz,re_mm_per_s_per_N,im_mm_per_s_per_N\n' + '\n'.join(
        f'{a!r},{z.real!r},{z.imag!r}' for a, z in zip(f.tolist(), (1e3j * w * h).tolist(), strict=True)))
    z = -(w**2) * h
    (tmp_path / 'amplitude.csv').write_text('frequency_Hz;amplitude_m_per_s2_per_N;phase_deg\n' + '\n'.join(
        f'{a!r};{b!r};{c!r}' for a, b, c in zip(f.tolist(), abs(z).tolist(), np.degrees(np.angle(z)).tolist(), strict=True)))
    common = {'binary': 0, 'id1': 'x', 'rsp_node': 7, 'rsp_dir': -2, 'ref_node': 1, 'ref_dir': 1, 'orddenom_spec_data_type': 13,
              'ordinate_spec_data_type': 12, 'abscissa_spec_data_type': 18}
    one = pyuff.prepare_58(func_type=4, x=f, data=z, abscissa_inc=f[1] - f[0], **common)
    nodes = pyuff.prepare_15(node_nums=[1, 7], def_cs=[0, 0], disp_cs=[0, 0], color=[0, 0], x=[0.0, 0.01], y=[0.0, 0.0],
                             z=[0.0, 0.0])
    pyuff.UFF(str(tmp_path / 'f.uff')).write_sets([nodes, one], 'overwrite')
    for name, order in (('re.csv', 1), ('amplitude.csv', 2), ('f.uff', 2)):
        (found,) = read_transfer(tmp_path / name)
        assert_allclose(found.response, h * u.m / u.N, rtol=1e-4)  # single precision of the universal file in text
        assert found.order == order
    assert_allclose(found.answer, [10.0, 0.0, np.pi / 2 + np.pi])
    for text, told in (('frequency_Hz,re_m_per_N\n1,2\n', 'holds neither transfer functions nor records'),
                       ('frequency_Hz,re_m_per_N,im_mm_per_N\n1,2,3\n', 'must have the same unit'),
                       ('frequency_Hz,re_m_per_N,im_m_per_N\n1,2,3\n1,2,3\n', 'each only once')):
        (tmp_path / 'bad.csv').write_text(text)
        with pytest.raises(ValueError, match=told):
            read_transfer(tmp_path / 'bad.csv')


@pytest.mark.parametrize('hits', [1, 40])
def test_records(hits, tmp_path):
    """An oscillator of 1 kg at 10 Hz, damped, driven by noise or by hits: H1, its coherence and its uncertainty."""
    rng, dt, n = np.random.default_rng(0), 2e-3, 2**16 // hits
    t = dt * np.arange(n)
    w0, gamma = 2 * np.pi * 10, 8.0
    free = np.sqrt(w0**2 - gamma**2 / 4)
    kernel = np.exp(-gamma * t / 2) * np.sin(free * t) / free * dt
    x = rng.standard_normal((hits, n)) if hits == 1 else np.exp(-((t - 0.02) ** 2) / 2 / 0.006**2) * rng.uniform(1, 2, (hits, 1))
    y = fftconvolve(x, kernel[None], axes=1)[:, :n]
    y += 0.1 * y.std() * rng.standard_normal(y.shape)
    omega, H, coherence, sigma = estimated(x, y, 1e3 * dt, segment=4096 if hits == 1 else None)
    near = (omega * 1e3 > 0.7 * w0) & (omega * 1e3 < 1.4 * w0)
    w = omega[near] * 1e3
    z = (H[near] - 1 / (w0**2 - w**2 + 1j * w * gamma)) / sigma[near]
    scatter = np.sqrt(np.mean(abs(z) ** 2) / 2)
    assert 0.6 < scatter < 1.6  # one if the uncertainty holds
    assert (coherence[near] > 0.5).all()
    swapped = estimated(x, y, 1e3 * dt, 'H2', segment=4096 if hits == 1 else None)[1]
    assert (abs(swapped[near]) >= abs(H[near])).all()  # H2/H1 = 1/coherence
    rows = [f'{k},{a!r},{b!r},{c!r}' for k in range(hits)
            for a, b, c in zip(t.tolist(), x[k].tolist(), y[k].tolist(), strict=True)]
    (tmp_path / 'raw.csv').write_text('record,time_s,drive_N,answer_m\n' + '\n'.join(rows))
    (found,) = read_transfer(tmp_path / 'raw.csv')
    assert found.coherence is not None


@pytest.mark.slow
def test_commands(tmp_path, exact, capsys):
    scene_of(tmp_path)
    rows = ['frequency_Hz,re_m_per_N,im_m_per_N,sigma_m_per_N,x_m,y_m,direction_deg']
    for one, (k, axis) in zip(measured(exact, np.random.default_rng(3)), [(k, axis) for k in range(3) for axis in (0, 90)],
                              strict=True):
        x, y = RECEIVERS[k]
        rows += [f'{f!r},{h.real!r},{h.imag!r},{float(one.sigma) * u.N / u.m!r},{x},{y},{axis}' for f, h in zip(
            u.hertz(one.omega).tolist(), (one.response * u.N / u.m).tolist(), strict=True)]
    (tmp_path / 'f.csv').write_text('\n'.join(rows))
    scene, table, out = (str(tmp_path / name) for name in ('hexagon.toml', 'f.csv', 'out'))
    assert main(['fit', '--verbose', table, '--frf', scene, '-o', out]) == 0
    told = capsys.readouterr().out
    assert 'the data speak for D0 + D*' in told
    assert '6 transfer functions, 420 points' in told
    assert {'frf_fit.png', 'frf_fit.txt'} <= {file.name for file in (tmp_path / 'out').iterdir()}
    assert main(['frf', '--verbose', scene, '--measured', table, '-o', str(tmp_path / 'frf')]) == 0
    told = capsys.readouterr().out
    shares = [line.split() for line in told.splitlines() if 'f.csv, (' in line]
    assert all(float(words[1].strip(',')) < 0.03 < 0.1 < float(words[3]) for words in shares)
    assert (tmp_path / 'frf' / 'frf_measured.png').exists()
    assert main(['fit', table, '--frf', scene, '--sigma', 'pair=0.1']) != 0
    assert '--sigma pair belongs to a fit of forces' in capsys.readouterr().err


@pytest.mark.long
def test_sixty_fits_scatter_as_the_bound(tmp_path, exact):
    scene, sigmas, rng = scene_of(tmp_path), bound()[:4], np.random.default_rng(4)
    off = []
    for _ in range(60):
        values = fit_frf(scene, measured(exact, rng), ['mass'], gain_sigma=0.0).values()
        off.append([np.log(values[name][0] / TRUTH[name]) for name in NAMES])
    off = np.array(off) / sigmas
    print('bound (%)', 100 * sigmas, 'scatter over it', off.std(axis=0), 'mean in its error', off.mean(axis=0) * np.sqrt(60))
    assert ((off.std(axis=0) > 0.75) & (off.std(axis=0) < 1.27)).all()  # of 60 draws, 3 standard errors
    assert (abs(off.mean(axis=0)) * np.sqrt(60) < 3.5).all()


def test_sdypy_finds_the_same_poles(tmp_path):
    """All answers of a small patch, by sdypy-EMA's least-squares complex frequency method: the modes that the force excites."""
    ema = pytest.importorskip('sdypy.EMA')
    scene = scene_of(tmp_path, ('side_m = 0.06', 'side_m = 0.02'), ('points = 70', 'points = 4000'),
                     ('from_Hz = 20.0', 'from_Hz = 1.0'), ('to_Hz = 160.0', 'to_Hz = 200.0'))
    system, conventional = (LinearSystem.of(scene.shaken(model)[0]) for model in ('complete', 'conventional'))
    source, omega = scene.shaken()[1], scene.frf.omega
    answers = [Dof(k, np.eye(3)[axis]) for k in np.flatnonzero(system.mobile) for axis in (0, 1)]
    h = np.array([receptance(system, source, answer, omega, scene.frf.damping).response for answer in answers])
    model = ema.Model(h * u.N / u.m, u.hertz(omega), lower=20, upper=180, pol_order_high=6)  # a higher one adds false poles
    model.get_poles(show_progress=False)
    poles = np.array([p for p in np.ravel(model.all_poles[-1]) if p.imag > 0])
    theirs = abs(poles) / (2 * np.pi)

    def excited(system):
        found = modes(system)
        driven = abs(source.seen(found.shapes))
        return u.hertz(found.omega[driven > 1e-6 * driven.max()])

    ours = excited(system)
    assert len(ours) == 6  # three pairs that symmetry unites
    nearest = abs(theirs / ours[:, None] - 1).argmin(axis=1)
    assert_allclose(theirs[nearest], ours, rtol=1e-3)
    assert_allclose(-2 * poles.real[nearest], 4.0, rtol=2e-3)  # damping, 1/s
    assert (abs(theirs / excited(conventional)[:, None] - 1).min(axis=1) > 0.02).all()  # the control


def test_the_place_of_a_measurement(tmp_path):
    scene = scene_of(tmp_path)
    omega = np.array([0.1, 0.2])
    outside = TransferFunction('f.csv', omega, omega + 0j, None, 0, np.array([500.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match=r'f\.csv, answer\.at_m = \[0\.5, 0\.0\] is outside the structure'):
        with_dofs(scene, [outside])
    shaken = TransferFunction('f.csv', omega, omega + 0j, shaken=True)
    with pytest.raises(ValueError, match='is a response to the motion of the bench, and the scene has'):
        with_dofs(scene, [shaken])
    assert isinstance(with_dofs(scene, [TransferFunction('f', omega, omega + 0j)])[0].drive, Dof)


@pytest.mark.parametrize(('header', 'row', 'words'), [
    ('frequency_Hz,re_m_per_N,im_m_per_N,direction_deg', '{f},1,1,90', 'has only direction_deg;'),
    ('frequency_Hz,re_m_per_N,im_m_per_N,drive_deg', '{f},1,1,90', 'has only drive_deg;'),
    ('time_s,drive_N,answer_m,x_m,y_m', '{f},1,1,0,0', 'has only x_m, y_m;'),
    ('frequency_Hz,amplitude_m_per_N,phase_deg', '{f},-90,1', 'exchanged with the phase'),
    ('frequency_Hz,re_m_per_N,im_m_per_N', '{f},0,0', 'is zero at every frequency'),
])
def test_tables_that_say_half_a_place_or_nothing(tmp_path, header, row, words):
    file = tmp_path / 'f.csv'
    file.write_text('\n'.join([header, *(row.format(f=f) for f in (20, 21))]))
    with pytest.raises(ValueError, match=words):
        read_transfer(file)


def test_records_of_several_points_and_of_other_times(tmp_path):
    rng, t = np.random.default_rng(0), 1e-3 * np.arange(64)
    drive = rng.normal(size=(4, 64))
    gain, file = np.array([1.0, 1.0, 3.0, 3.0]), tmp_path / 'hits.csv'

    def read(rate=(1, 1, 1, 1), frames=64):
        rows = [(k, r * s, a, g * a, g, 0, 90) for k, (r, g) in enumerate(zip(rate, gain, strict=True))
                for s, a in list(zip(t, drive[k], strict=True))[: frames if k == 3 else 64]]
        np.savetxt(file, rows, delimiter=',', comments='', header='record,time_s,drive_N,answer_m,x_mm,y_mm,direction_deg')
        return read_transfer(file)

    for one, expected in zip(read(), (1.0, 3.0), strict=True):  # a gain of its own at each point: places are not mixed
        assert one.answer[0] == expected
        assert_allclose(one.response, expected * u.m / u.N)
    with pytest.raises(ValueError, match='the same equal steps'):
        read((1, 0.5, 1, 1))
    with pytest.raises(ValueError, match='from 30 to 64 frames'):
        read(frames=30)


def test_the_direction_of_a_bench_is_that_of_the_scene(tmp_path):
    scene = scene_of(tmp_path, ('[frf.force]\nat_m = [0.0, 0.0]\ndirection_deg = 40.0\n', ''),
                     ('points', 'base_deg = 40.0\npoints'))
    file = tmp_path / 'f.csv'
    for angle in (40.0, 400.0, 220.0, 0.0):
        file.write_text(f'frequency_Hz,re,im,drive_deg\n20,1,0,{angle}\n21,1,0,{angle}')
        if angle % 360 == 40:
            assert_allclose(with_dofs(scene, read_transfer(file))[0].drive, scene.shaken(bench=True)[1])
        else:
            with pytest.raises(ValueError, match=f'shaken along {angle:g} degrees, but frf.base_deg is 40'):
                with_dofs(scene, read_transfer(file))


def test_the_same_curve_twice_is_refused(tmp_path):
    """Its noise would count as averaged: intervals too narrow by the root of two."""
    scene, omega = scene_of(tmp_path), np.array([0.1, 0.2])
    twice = [TransferFunction(name, omega, omega + 0j) for name in ('a.csv', 'b.csv')]
    with pytest.raises(ValueError, match=r'a\.csv and b\.csv hold the same numbers'):
        fit_frf(scene, twice)


@pytest.mark.slow
@pytest.mark.parametrize('static', [False, True])
@pytest.mark.parametrize('stated', [False, True])
def test_the_verdict_on_both_kinds_of_lattice(tmp_path, static, stated):
    """D0 alone follows a lattice of slack springs and D0 + D* does not, whether or not the noise is known; and the other way."""
    scene = scene_of(tmp_path, ('1.62093299e-10', '1.5737e-10'))
    fits = fit_frf(scene, measured(dense(static=static), np.random.default_rng(5), sigma=stated))
    told = frf_report(fits, [])
    assert fits.verdict == ('complete' if static else 'conventional')
    assert ('D0 alone follows the data and D0 + D* does not' in told) != static
    assert 'not this model' not in told


MISTAKES = {
    'numbers 1000 times too large, mm': lambda w, h: 1e3 * h,
    'numbers 1e+06 times too large, um': lambda w, h: 1e6 * h,
    'numbers 1000 times too small, m ': lambda w, h: 1e-3 * h,
    'a velocity that is called a displacement': lambda w, h: 1j * w * h,
    'an acceleration that is called a displacement': lambda w, h: -(w**2) * h,
    'a displacement that is called a velocity': lambda w, h: h / (1j * w),
    'phases of the opposite sign': lambda w, h: h.conj(),
    'real and imaginary part exchanged': lambda w, h: 1j * h.conj(),
    'phases in rad': lambda w, h: abs(h) * np.exp(1j * np.angle(h) * np.pi / 180),
    'frequencies in rad/s': None,
}


@pytest.mark.slow
def test_what_a_file_may_say_wrongly(tmp_path, exact):
    """Ten mistakes, drawn lattices that are known to ten percent; and right files, of which nothing is said."""
    rng = np.random.default_rng(6)
    for _ in range(4):
        force, a, foundation = (1 + rng.uniform(-0.1, 0.1, 3)).tolist()
        scene = scene_of(tmp_path, ('1.62093299e-10', f'{0.2369 * force * 0.01 ** (4.5824 * a)}'), ('4.5824', f'{4.5824 * a}'),
                         ('19.6757', f'{19.6757 * foundation}'), ('= 4.0\n', f'= {rng.uniform(3, 8)}\n'))
        chosen = with_dofs(scene, measured(exact, rng)[: rng.integers(1, 7)])
        assert suspect_units(scene, chosen) is None
        for words, spoil in MISTAKES.items():
            if spoil is None:
                spoilt = [replace(one, omega=2 * np.pi * one.omega) for one in chosen]
            else:
                spoilt = [replace(one, response=spoil(one.omega * 1e3, one.response)) for one in chosen]
            assert str(suspect_units(scene, spoilt)).startswith(words), ((force, a, foundation), words)


def test_far_below_all_peaks_a_phase_tells_nothing():
    """A static response is real: its conjugate is as near as itself, and only its size can be wrong."""
    scene = read_scene('oscillator')
    omega = np.linspace(0.01, 0.05, 30)
    h = receptance(*scene.shaken(), omega, scene.frf.damping).response
    assert suspect_units(scene, with_dofs(scene, [TransferFunction('p', omega, 1.05 * h)])) is None
    assert suspect_units(scene, with_dofs(scene, [TransferFunction('p', omega, h.conj())])) is None
    assert suspect_units(scene, with_dofs(scene, [TransferFunction('p', omega, 1e3 * h)])).startswith('numbers 1000 times')


@pytest.mark.parametrize('seed', range(3))
def test_two_places_next_to_one_magnet_are_no_two_points(seed, tmp_path):
    """As with metres under a header in mm, where all magnets are the one in the middle."""
    rng, scene = np.random.default_rng(seed), scene_of(tmp_path)
    at = {tuple(rng.integers(-2, 3, 2)) for _ in range(4)} | {(0, 0)}
    places = 0.01 * np.array([(i + j / 2, j * np.sqrt(3) / 2) for i, j in at])
    directions = rng.uniform(0, np.pi, len(places))
    functions = [TransferFunction(f'{k}', np.arange(1.0, 5.0), rng.random(4), None, 0, np.array([*(u.m * place), angle]))
                 for k, (place, angle) in enumerate(zip(places, directions, strict=True))]
    again = [replace(one, answer=one.answer + np.array([0, 0, 1])) for one in functions]
    assert len({one.answer.particle for one in with_dofs(scene, [*functions, *again])}) == len(places)
    with pytest.raises(ValueError, match='1 and 0 name different places next to the same magnet; correct their unit'):
        with_dofs(scene, [replace(one, answer=one.answer * [1e-3, 1e-3, 1]) for one in functions])


@pytest.mark.slow
def test_what_no_lattice_answers_has_no_verdict(tmp_path):
    """A response and its opposite at one magnet, which differ by much more than their noise."""
    rng, scene = np.random.default_rng(0), scene_of(tmp_path, ('side_m = 0.06', 'side_m = 0.04'))
    omega = 2 * np.pi * np.linspace(20, 160, 40) * u.Hz
    h = responses_of(scene, 'complete', with_dofs(scene, [TransferFunction('h', omega, 0j * omega)]))[0]
    noise = SHARE * abs(h).max()
    both = [TransferFunction(f'{sign}', omega, sign * h + noise * (rng.standard_normal(40) + 1j * rng.standard_normal(40)), noise)
            for sign in (1, -1)]
    fits = fit_frf(scene, both)
    assert fits.verdict is None
    assert not fits.better.follows
    assert 'does not follow this model: the residual is' in frf_report(fits, [], verbose=False)
    assert 'with 95 % intervals in brackets' in frf_report(fit_frf(scene, both[:1]), [], verbose=False)  # the control


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(2))
def test_a_magnet_that_nobody_told_is_missing_is_named(seed, tmp_path):
    """One of the free magnets of a small patch, away from the points; the control has another mass and all its magnets."""
    rng = np.random.default_rng([47, seed])
    k, small = rng.uniform(60, 100), ('side_m = 0.06', 'side_m = 0.03')
    start = scene_of(tmp_path, small, ('19.6757', str(1.07 * k)), ('1.62093299e-10', '1.5053e-10'))
    lattice = scene_of(tmp_path, small, ('19.6757', str(k)), name='true.toml')
    x = start.shaken()[0].positions[:, :2] / u.m
    away = np.linalg.norm(x[:, None] - [[0, 0], *RECEIVERS[:2]], axis=-1).min(axis=1) > 0.005
    hole = rng.choice(x[away & (np.linalg.norm(x, axis=1) < 0.019)])
    text = (tmp_path / 'true.toml').read_text()
    (tmp_path / 'hole.toml').write_text(f'{text}\n[defects]\nvacancies_m = [{hole.tolist()}]\n')
    omega = 2 * np.pi * np.linspace(20, 160, 140) * u.Hz
    places = [np.array([*np.multiply(place, u.m), axis * np.pi / 2]) for place in RECEIVERS[:2] for axis in (0, 1)]
    bare = [TransferFunction(str(k), omega, 0j * omega, None, 0, place) for k, place in enumerate(places)]
    heavier = lattice.model_copy(update={'lattice': lattice.lattice.model_copy(update={'mass_kg': 8.4e-4, 'spacing_m': 0.0099})})
    for true, expected in ((read_scene(tmp_path / 'hole.toml'), hole), (heavier, None), (lattice, 'nothing')):
        h = np.array(responses_of(true, 'complete', with_dofs(true, bare)))
        noise = 0.01 * abs(h).max()
        h = h + noise * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))
        measured = [replace(one, response=own, sigma=noise) for one, own in zip(bare, h, strict=True)]
        found = fit_frf(start, measured, gain_sigma=0.0, stated=())
        if true is lattice:
            assert '1 Hz apart, farther than the peaks are wide (0.6' in frf_report(found, [])
            assert 'before: mass (kg) 0.0007 +- 7e-06' in frf_report(found, [])
            continue
        place = missing_magnet(found)
        assert place is None if expected is None else np.linalg.norm(place - expected) < 1e-3
