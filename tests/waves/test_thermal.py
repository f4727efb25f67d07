"""Thermal noise and the stiffness that it shows: runs against each other, records drawn from exact distributions, a potential."""

from functools import partial

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine
from scipy.integrate import quad
from structures import structure

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, Recorder, lattices, read_scene, ready_scene
from magphonon.bands import bloch_modes
from magphonon.cli.arguments import lattice_and_patch
from magphonon.cli.main import main
from magphonon.stiffness import LinearSystem
from magphonon.waves import thermal_bands, thermal_run

LAW = InversePower(1.0, 4.0)


def states(case, engine, parts, gyration=0.0):
    atoms = case.atoms.copy()
    atoms.calc = case.atoms.calc
    if gyration:
        atoms.calc = atoms.calc.about(atoms, gyration=gyration)
    damping = np.linspace(0.0, 0.3, len(atoms) + 1)[1:]
    dyn = DrivenVerlet(atoms, 0.1, damping=damping, engine=engine, temperature_mJ=1e-3, seed=3, allow_unstable=True)
    record = Recorder(dyn, interval=7)
    for steps in parts:
        dyn.run(steps)
    return record.displacements, dyn.velocities


@pytest.mark.slow
@pytest.mark.parametrize('seed', [6, 16])
def test_every_engine_has_the_same_noise(seed):
    """Of drawn structures, with guided and held particles, turning ones, and in runs that are cut elsewhere."""
    case, gyration = structure(seed), 0.5 * (seed == 16)
    expected, last = states(case, 'ase', [70], gyration)
    assert abs(expected).max() > 0.05  # mm
    for engine, parts in ('numpy', [33, 37]), ('compiled', [70]):
        found, velocities = states(case, engine, parts, gyration)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)  # ASE's constraints leave 1e-12
        np.testing.assert_allclose(velocities, last, rtol=0, atol=1e-11)


def test_other_seeds_and_times_have_other_noise():
    case = structure(7)
    first, _ = states(case, 'numpy', [70])
    atoms = case.atoms.copy()
    atoms.calc = case.atoms.calc
    dyn = DrivenVerlet(atoms, 0.1, damping=0.3, temperature_mJ=1e-3, seed=4, allow_unstable=True)
    record = Recorder(dyn, interval=7)
    dyn.run(70)
    assert abs(record.displacements[-1] - first[-1]).max() > 1e-3
    assert abs(np.diff(record.displacements, 2, axis=0)).min() > 0


def test_a_temperature_without_damping_is_refused():
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 2.0)
    patch.calc = MagneticRepulsion(patch, LAW, foundation=5.0)
    for wrong in ({}, {'damping': 0.1, 'order': 4}):
        with pytest.raises(ValueError, match='needs damping'):
            DrivenVerlet(patch, 0.01, temperature_mJ=1e-3, **wrong)
    with pytest.raises(ValueError, match='temperature_mJ'):
        DrivenVerlet(patch, 0.01, damping=0.1, temperature_mJ=-1.0)


def test_equipartition_at_any_time_step():
    """Independent particles on springs, turning or not: <m v^2> = kT exactly, <k u^2> = kT/(1 - (w dt)^2/4) without turns."""
    rng = np.random.default_rng(0)
    atoms = lattices.square(10.0, 1.0).repeat((20, 20, 1))
    atoms.pbc = False
    atoms.set_masses(rng.uniform(0.5, 2, 400))
    k, kT, dt = 2.0, 1e-12, 0.9
    for gyration in (0.0, 0.7):
        atoms.calc = MagneticRepulsion(atoms, InversePower(1e-9, 4.0), foundation=k, gyration=gyration)
        dyn = DrivenVerlet(atoms, dt, damping=1.0, temperature_mJ=kT, engine='numpy', allow_unstable=True)
        dyn.run(30)
        u2, v2 = [], []
        for _ in range(150):
            dyn.run(3)
            u2.append((dyn.displacements**2).mean(axis=1))
            v2.append((dyn.velocities**2).mean(axis=1))
        m = atoms.get_masses()
        kinetic = (np.mean(v2, axis=0) * m).mean() / kT
        potential = (np.mean(u2, axis=0) * k * (1 - k / m * dt**2 / 4)).mean() / kT
        assert kinetic == pytest.approx(1, abs=0.02)  # 120 000 numbers, a few of which depend on each other
        assert potential == pytest.approx(1, abs=0.02)
        assert abs((np.mean(u2, axis=0) * k).mean() / kT - 1) > 0.1  # the control: without what the step adds


def drawn_record(system, kT, frames, rng):
    """Independent frames of the exact distribution of harmonic forces, by the one symmetric root K^-1/2."""
    squares, modes = np.linalg.eigh(system.stiffness.toarray())
    y = rng.normal(size=(frames, len(squares))) * np.sqrt(kT)
    return (y @ (modes / np.sqrt(squares)) @ (system.free @ modes).T).reshape(frames, len(system), -1)


def misses(seed, kT=1e-3, partial=False, model='complete'):
    """(found - true)/error of drawn cells in supercells, or of hexagons and parts of them; (wavevectors, branches)."""
    rng = np.random.default_rng([seed, 7])
    cell = getattr(lattices, ['triangular', 'honeycomb', 'square', 'kagome'][seed % 4])(1.0, 1.0)
    cell.set_masses(rng.uniform(0.5, 2, len(cell)))
    cell.calc = MagneticRepulsion(cell, LAW, foundation=rng.uniform(7, 10))
    if partial:
        atoms, q = lattices.hexagon(cell, 4.0), [(0.21, 0.1, 0), (0.5, 0, 0)]
        atoms.calc = MagneticRepulsion(atoms, LAW, foundation=cell.calc.foundation).balanced(np.arange(len(atoms)))
    else:
        atoms, q = cell.repeat((4, 3, 1)), [(0.25, 0, 0), (0.5, 1 / 3, 0), (0, 0, 0)]
        atoms.calc = cell.calc.on(atoms)
    drawn = atoms.copy()
    drawn.calc = atoms.calc.about(atoms, model=model) if model != 'complete' else atoms.calc
    u = drawn_record(LinearSystem.of(drawn), kT, 200, rng)
    found = thermal_bands(atoms, u, kT, cell, q)
    np.testing.assert_allclose(found.linear, bloch_modes(cell, q)[0])
    return (found.omega - found.linear) / found.error, found


@pytest.mark.parametrize('partial', [False, True])
def test_the_error_covers_what_is_true(partial):
    z = np.concatenate([misses(seed, partial=partial)[0].ravel() for seed in range(8)])
    # of about 100 numbers, of 19 degrees of freedom each; the control, a record of D0 alone, fails the same
    assert abs(z.mean()) < 0.4
    assert 0.8 < z.std() < 1.35
    wrong = np.concatenate([misses(seed, partial=partial, model='conventional')[0].ravel() for seed in range(4)])
    assert wrong.mean() > 2 * 0.4


def test_few_frames_and_a_window_are_taken_off():
    _, found = misses(1)
    assert (found.bias > 0).all()  # of the inverse of a mean
    z, found = misses(4, partial=True)
    assert abs(found.bias / found.error).max() > 1  # a narrow window at a curved branch
    assert abs(z).max() < 4


def test_particles_between_held_ones_have_the_distribution_of_their_potential():
    """A row in which every other particle is held and the others move along it: <u^2> by quadrature of the energy."""
    row = lattices.chain(1.0, 1.0).repeat((401, 1, 1))
    row.pbc = False
    row.set_constraint([FixAtoms(range(0, 401, 2)), *(FixedLine(k, (1, 0, 0)) for k in range(1, 401, 2))])
    row.calc = MagneticRepulsion(row, LAW, foundation=2.0)
    kT = 0.2
    dyn = DrivenVerlet(row, 0.05, damping=3.0, temperature_mJ=kT, engine='numpy')
    dyn.run(100)
    u2 = []
    for _ in range(60):
        dyn.run(16)
        u2.append((dyn.displacements[1::2, 0] ** 2).mean())

    def energy(x):
        return ((1 + x) ** -3 + (1 - x) ** -3) / 3 - 2 / 3 + x**2

    weight, moment = (quad(lambda x, n=n: x**n * np.exp(-energy(x) / kT), -0.95, 0.95)[0] for n in (0, 2))
    # 12 000 numbers, of which some three in a row are alike
    assert np.mean(u2) == pytest.approx(moment / weight, rel=0.04)
    assert moment / weight < 0.9 * kT / 10  # the control: what harmonic forces would do


def test_what_does_not_serve_is_refused():
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=4.0)
    atoms = cell.repeat((4, 3, 1))
    atoms.calc = cell.calc.on(atoms)
    u = np.random.default_rng(0).normal(size=(200, 12, 2))
    with pytest.raises(ValueError, match='does not fit'):
        thermal_bands(atoms, u, 1e-3, cell, [(0.3, 0, 0)])
    with pytest.raises(ValueError, match='too few'):
        thermal_bands(atoms, u[:50], 1e-3, cell, [(0.25, 0, 0)])
    with pytest.raises(ValueError, match='shape'):
        thermal_bands(atoms, u[:, :5], 1e-3, cell, [(0.25, 0, 0)])


def weighed(a, k, kT, squares, rng, parts=20, draws=5000):
    """kT/<|u_q|^2> of the waves of a row without any time step: draws of the harmonic distribution, weighed by e^{-V/kT}.

    Over that of the same draws without weights, which is known: most of their chance goes.  And how many the weights leave.
    """
    n = 2 * (len(squares) - 1)
    waves = np.exp(2j * np.pi * np.outer(np.arange(n), np.arange(n)) / n) / np.sqrt(n)
    every = squares[[*range(n // 2 + 1), *range(n // 2 - 1, 0, -1)]]
    roots = [(waves * x**-0.5 @ waves.conj().T).real for x in every.T]
    sums, left = np.zeros((4, n // 2, 2)), np.zeros(2)
    for _ in range(parts):
        y = rng.normal(size=(2, draws, n))
        u = np.sqrt(kT) * np.stack([y[0] @ roots[0], y[1] @ roots[1]], axis=-1)
        r = np.linalg.norm(np.roll(u, -1, axis=1) - u + [1, 0], axis=2)
        V = (r ** (1 - a) - 1).sum(axis=1) / (a - 1) + (u**2 @ k).sum(axis=1) / 2
        w = np.exp((y**2).sum(axis=(0, 2)) / 2 - V / kT)
        uu = abs(waves[:, 1 : n // 2 + 1].conj().T @ u) ** 2
        sums += np.array([np.tensordot(w, uu, 1), np.full(uu.shape[1:], w.sum()), uu.sum(axis=0), np.full(uu.shape[1:], draws)])
        left += w.sum(), (w**2).sum()
    return squares[1:] * sums[2] / sums[3] * sums[1] / sums[0], left[0] ** 2 / left[1]


@pytest.mark.slow
def test_runs_of_drawn_rows_have_boltzmanns_distribution():
    z, control = [], []
    for seed in range(3):
        rng, n = np.random.default_rng([seed, 24]), 16
        a, k, kT = rng.uniform(2.5, 4), rng.uniform([0.5, 6], [2, 9]), rng.uniform(0.03, 0.035)
        row = lattices.chain(1.0, 1.0)
        row.calc = MagneticRepulsion(row, InversePower(1.0, a), foundation=[k])
        c = 2 - 2 * np.cos(2 * np.pi * np.arange(n // 2 + 1) / n)
        squares = np.array([k[0] + a * c, k[1] - c]).T
        exact, draws = weighed(a, k, kT, squares, rng)
        assert draws > 10_000
        found = thermal_run(row, (n, 1, 1), kT, np.outer(np.arange(1, n // 2 + 1) / n, [1, 0, 0]), steps=5000, seed=seed)
        order = squares[1:].argsort(axis=1)
        exact, linear = (np.sqrt(np.take_along_axis(x, order, 1)) for x in (exact, squares[1:]))
        np.testing.assert_allclose(found.linear, linear)
        z.append((found.omega - exact) / found.error)
        control.append((found.omega - linear) / found.error)
    # 48 numbers of 19 degrees of freedom each; the control is that nothing is anharmonic
    assert abs(np.mean(z)) < 0.7
    assert 0.75 < np.std(z) < 1.5
    assert np.mean(control) < -1.2  # -1.55 of these three


@pytest.mark.slow
def test_a_run_shows_what_is_anharmonic():
    """Prototype at kT = f L/100: the shear wave at M is 4.41 % softer (Laplace integral of its 6 x 6 cell, to second order)."""
    cell = read_scene(ready_scene('thermal')).perfect_cell()
    found = thermal_run(cell, (6, 6, 1), 0.02369, [(0, 0, 0), (0.5, 0, 0)], steps=3000)
    change, error = (found.omega / found.linear) ** 2 - 1, 2 * found.error / found.linear
    assert abs(change[0]).max() < 1e-9  # at Gamma the bonds do nothing
    assert error[1, 0] < 0.04  # without the run beside it, it would be 0.1
    assert abs(change[1, 0] + 0.0441) < 3.5 * error[1, 0]


def test_gyration_does_not_change_the_stiffness_of_waves():
    """<u u> = kT D^-1 whatever g is: the frequencies are the roots of the stiffness written here, not those of the bands."""
    cell, g = lattices.triangular(1.0, 1.0), 4.0
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=3.0, gyration=g)
    atoms, q, kT = cell.repeat((4, 4, 1)), [(0.5, 0, 0), (0.25, 0.25, 0)], 1e-9
    atoms.calc = cell.calc.on(atoms)
    n = np.array([[np.cos(t), np.sin(t)] for t in np.pi / 3 * np.arange(3)])
    phase = np.array([[1, 0], [0, 1], [-1, 1]]) @ np.array(q)[:, :2].T
    D = 3 * np.eye(2) + np.einsum('bq,bxy->qxy', 2 - 2 * np.cos(2 * np.pi * phase), 5 * n[:, :, None] * n[:, None] - np.eye(2))
    exact = np.sqrt(np.linalg.eigvalsh(D))
    dyn = DrivenVerlet(atoms, 0.2, damping=1.5, temperature_mJ=kT, engine='numpy')
    dyn.run(300)
    recorder = Recorder(dyn, interval=10)
    dyn.run(6000)
    found = thermal_bands(atoms, recorder.displacements, kT, cell, q, dt=0.2)
    np.testing.assert_allclose(found.linear, exact)
    assert abs((found.omega - exact) / found.error).max() < 4
    assert abs((found.omega - bloch_modes(cell, q)[0]) / found.error).max() > 8  # the control: frequencies with gyration
    cold = thermal_run(cell, (4, 4, 1), kT, q, steps=900)
    np.testing.assert_allclose(cold.omega, exact, rtol=1e-5)


def test_the_command_tells_it_and_refuses_what_it_cannot(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr('magphonon.waves.thermal.thermal_run', partial(thermal_run, steps=900))
    assert main(['bands', '--verbose', 'thermal', '-o', str(tmp_path / 'out')]) == 0
    assert 'in thermal motion' in capsys.readouterr().out
    assert (tmp_path / 'out' / 'bands_thermal.npz').exists()
    hot = ready_scene('thermal').read_text().replace('2.369e-5', '2.4e-3')
    (tmp_path / 'hot.toml').write_text(hot)
    assert main(['bands', '--verbose', str(tmp_path / 'hot.toml'), '-o', str(tmp_path / 'hot')]) == 2
    assert 'tears the lattice apart' in capsys.readouterr().err
    scene = ready_scene('thermal').read_text().replace('shells = 1', 'shells = "all"')
    (tmp_path / 'all.toml').write_text(scene)
    with pytest.raises(ValueError, match='temperature_J needs time steps, for planar lattices'):
        read_scene(tmp_path / 'all.toml')


def test_commands_without_heat_or_losses_refuse_them_or_say_so(tmp_path, capsys):
    text = ready_scene('thermal').read_text() + 'damping_per_s = 4.0\n'
    (tmp_path / 'hot.toml').write_text(text)
    said = lattice_and_patch(read_scene(tmp_path / 'hot.toml'))[2]  # of modes and dos
    assert said[0].startswith('bands.damping_per_s and bands.temperature_J ignored here')
    assert lattice_and_patch(read_scene(ready_scene('prototype')))[2] == []
    (tmp_path / 'hot.toml').write_text(ready_scene('thermal').read_text() + '\n[design]\ncut_off_Hz = 30.0\n')
    with pytest.raises(ValueError, match=r'remove \[design\] or bands.temperature_J'):
        read_scene(tmp_path / 'hot.toml')
