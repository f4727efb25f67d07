"""Gyration: particles whose velocities turn, against the matrix exponential and the quadratic eigenproblem written out here."""

from __future__ import annotations

import re

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine
from scene_files import ready_scene
from scipy.linalg import eigvals, expm, sqrtm
from scipy.optimize import brentq
from structures import few_first

from magphonon import (
    DrivenVerlet,
    InversePower,
    MagneticRepulsion,
    analytic_bands,
    lattices,
    modes,
    read_scene,
    verdict,
)
from magphonon.bands import (
    band_gaps,
    bloch_modes,
    chern_numbers,
    edge_flow,
    edge_weights,
    lattice_density,
)
from magphonon.cli.main import main
from magphonon.dynamics import Diverged, highest_frequency
from magphonon.scenes import write_scene
from magphonon.stiffness import LinearSystem
from magphonon.stiffness.matrices import lossless_modes
from magphonon.waves import burst_setup, run_burst

J = np.array([[0.0, 1.0], [-1.0, 0.0]])


def oracle(atoms, damping=0.0, gyration=True):
    """Matrices M, C and K of all directions by definition, and the free directions."""
    n, m = len(atoms), atoms.get_masses()
    K = atoms.calc.rest_hessian().toarray()
    g = np.broadcast_to(atoms.calc.gyration, n) * gyration
    C = np.zeros((2 * n, 2 * n))
    for k in range(n):
        C[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = m[k] * (np.broadcast_to(damping, n)[k] * np.eye(2) - g[k] * J)
    P = []
    lines = {k: c.dir[:2] / np.linalg.norm(c.dir[:2]) for c in atoms.constraints if isinstance(c, FixedLine) for k in c.index}
    held = {k for c in atoms.constraints if isinstance(c, FixAtoms) for k in c.index}
    for k in set(range(n)) - held:
        for d in [lines[k]] if k in lines else np.eye(2):
            P.append(np.zeros((n, 2)))
            P[-1][k] = d
    P = np.array(P).reshape(len(P), -1).T
    return np.diag(np.repeat(m, 2)), C, K, P


def flow(M, C, K, P):
    """Generator of (u, v) of the free directions."""
    M, C, K = (P.T @ X @ P for X in (M, C, K))
    return np.block([[np.zeros_like(M), np.eye(len(M))], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])


def test_orders_above_two_are_refused_when_anything_turns():
    patch = hill(1.0)
    with pytest.raises(ValueError, match='a step of order 4 or 6 does not support particles that gyrate'):
        DrivenVerlet(patch, 0.01, order=4)


@pytest.mark.parametrize(('asked', 'changed', 'later'), [
    ({'order': 4}, 'gyration', 'does not support particles that gyrate'), ({'order': 4}, 'damping', 'need one damping for all'),
    ({'tolerance': 1e-6}, 'gyration', 'take steps of at most'), ({'tolerance': 1e-6}, 'damping', 'take steps of at most')])
def test_what_no_order_above_two_can_do_is_judged_anew_when_it_comes_later(asked, changed, later):
    patch = hill(1.0)
    patch.calc.set(gyration=0.0, foundation=3.0)
    dyn = DrivenVerlet(patch, 0.1, **asked)
    dyn.run(1)
    assert dyn.splitting.order == 4

    def change():
        if changed == 'gyration':
            patch.calc.set(gyration=1.0)
        else:
            dyn.damping = np.linspace(0, 0.1, len(patch))
        dyn.run(1)

    with pytest.raises(ValueError, match=later):
        change()
    if 'tolerance' in asked:  # as soon as steps are short enough, those of order 2 go on
        dyn.dt = 1e-3
        dyn.run(1)
        assert dyn.splitting.order == 2


def test_a_tolerance_is_taken_where_nothing_vibrates():
    patch = hill(0.0)
    assert highest_frequency(patch) == 0
    assert DrivenVerlet(patch, 0.1, damping=np.linspace(0, 0.1, 9), tolerance=1e-6).run(1)


def honeycomb(g, k=6.0, rows=None):
    cell = lattices.honeycomb(1.0, 1.0)
    cell = cell if rows is None else lattices.ribbon(cell, rows)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=k, gyration=g)
    return cell


def quadratic(K, g, masses):
    """All w of det(K - w^2 M + i w M g J) = 0 by the generalised problem of twice the size, written for displacements."""
    n = len(K)
    M, G = np.diag(np.repeat(masses, 2)), np.kron(np.diag(masses * np.broadcast_to(g, len(masses))), J)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [K, 1j * G]])
    return np.sort(eigvals(A, np.block([[np.eye(n), np.zeros((n, n))], [np.zeros((n, n)), M]])))


def test_waves_that_grow_have_minus_their_rate_on_drawn_cells_that_stiffness_does_not_hold():
    rng = np.random.default_rng(7)
    growing = 0
    for _ in range(6):
        g = rng.uniform(0, 4, 2) * [1, rng.integers(2)]
        cell = honeycomb(g, k=rng.uniform(0.5, 2.9))
        q = np.append(rng.uniform(-1, 1, (4, 2)), np.zeros((4, 1)), axis=1)
        for K, found in zip(cell.calc.bloch_matrix(q), bloch_modes(cell, q)[0], strict=True):
            w = quadratic(K, g, np.ones(2))
            rates = np.sort(w.imag[w.imag > 1e-6])
            assert np.allclose(np.sort(-found[found < 0]), rates, atol=1e-7)
            above = np.sort(w.real[(abs(w.imag) < 1e-6) & (w.real > 0)])[::-1]
            rest = np.sort(found[found >= 0])[::-1]
            both = min(len(above), len(rest))
            assert np.allclose(rest[:both], above[:both], atol=1e-6)
            growing += len(rates)
    assert growing > 5


def test_the_middle_gap_closes_at_gamma_at_the_g_of_the_formula_and_d0_is_wrong():
    for model, D in ('complete', 9.0), ('conventional', 12.0):
        g = D / np.sqrt(24 + 2 * D)
        gap = [np.diff(bloch_modes(honeycomb(x), np.zeros((1, 3)), model)[0][0])[1] for x in (g, 0.98 * g)]
        assert gap[0] < 1e-12 < 1e-3 < gap[1]
        numbers = [chern_numbers(honeycomb(x), model).tolist() for x in (0.98 * g, 1.02 * g, -1.02 * g)]
        assert numbers == [[1, 0, 0, -1], [1, -1, 1, -1], [-1, 1, -1, 1]]
    swapped = honeycomb(1.55)  # vectors in the other order: the zone is seen from behind, the numbers are those of the lattice
    swapped.set_cell(swapped.cell.array[[1, 0, 2]])
    swapped.calc = MagneticRepulsion(swapped, InversePower(1.0, 4.0), foundation=6.0, gyration=1.55)
    assert chern_numbers(swapped).tolist() == [1, -1, 1, -1]
    with pytest.raises(ValueError, match='touch'):
        chern_numbers(honeycomb(9 / np.sqrt(42)))
    with pytest.raises(ValueError, match='stiffness alone'):
        chern_numbers(honeycomb(3.0, k=1.0))


def test_the_strip_has_no_wave_in_the_gap_where_d0_alone_has_one_that_runs_one_way():
    cell, strip = honeycomb(1.55), honeycomb(1.55, rows=16)
    gaps = [band_gaps(cell, 60, model)[1] for model in ('complete', 'conventional')]
    assert np.allclose(gaps, [[3.174763, 3.344168], [3.344168, 3.537844]], atol=1e-6)
    assert edge_flow(strip, np.mean(gaps[0]))[:2] == (0, 0)
    found = edge_flow(strip, np.mean(gaps[1]), 'conventional')
    assert found[:2] == (1, -1)
    assert edge_flow(honeycomb(-1.55, rows=16), np.mean(gaps[1]), 'conventional')[:2] == (-1, 1)
    h = 1e-4  # the same wave among the bands, as the quadratic problem has them
    for q, v, at_right in zip(found.q, found.velocity, found.at_right, strict=True):
        w = []
        for x in (q - h, q + h):
            K = strip.calc.bloch_matrix(np.array([[x, 0, 0]]), 'conventional')[0]
            keep = np.repeat(LinearSystem.of(strip, 'gyration').mobile, 2)
            roots = quadratic(K[np.ix_(keep, keep)], 1.55, np.ones(keep.sum() // 2)).real
            w.append(roots[abs(roots - np.mean(gaps[1])).argmin()])
        assert abs((w[1] - w[0]) / (2 * h) * np.sqrt(3) / (2 * np.pi) - v) < 1e-4
        bands = analytic_bands(strip, strip.cell.bandpath([[q, 0, 0]], npoints=1, pbc=strip.pbc), 'conventional', vectors=True)
        one = abs(bands.omega[0] - np.mean(gaps[1])).argmin()
        assert edge_weights(strip, bands, 3.0)[0, one, 0 if at_right else 1] > 0.7
    with pytest.raises(ValueError, match='neither edge'):
        edge_flow(strip, 4.0)


def test_densities_count_waves_of_both_directions():
    rng = np.random.default_rng(8)
    strip = honeycomb(2 * rng.normal(size=6), rows=3)
    strip.set_constraint(FixAtoms([0]))
    strip.calc = strip.calc.balanced(range(len(strip)))
    edges = np.linspace(0, 8, 41)
    density = lattice_density(strip, (edges[1:] + edges[:-1]) / 2, steps=60).density
    q = (np.arange(60) / 60)[:, None] * [1, 0, 0]
    K, masses, keep = strip.calc.bloch_matrix(q), np.ones(5), slice(2, None)
    every = np.array([quadratic(one[keep, keep], strip.calc.gyration[1:], masses).real[10:] for one in K])
    counted = np.cumsum(np.histogram(every, edges)[0]) / 60
    assert abs(np.cumsum(density) * 0.2 - counted).max() < 0.15  # of ten branches, each counted on a mesh
    half = np.cumsum(np.histogram(every[:31], edges)[0]) / 31  # control: those of -q are others
    assert abs(half - counted).max() > 0.15


def hill(g):
    """One free particle among four held ones whose sideways push exceeds their slope: 2 (a - 1) = -1, plus its spring."""
    atoms = lattices.square(1.0, 1.0).repeat((3, 3, 1))
    atoms.pbc = False
    atoms.set_constraint(FixAtoms([n for n in range(9) if n != 4]))
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 0.5), foundation=0.5, gyration=g)
    return atoms


@pytest.mark.parametrize(('g', 'stable'), [(1.41, False), (1.42, True)])
def test_gyration_holds_a_hill_from_the_root_of_two_on(g, stable):
    atoms = hill(g)
    K = LinearSystem.of(atoms, 'gyration').K.toarray()
    assert np.allclose(K, -0.5 * np.eye(2))
    judged = verdict(atoms)
    assert judged.stable is stable
    assert judged['buckling'].stable is stable
    assert abs(judged['buckling'].needed - 1.0) < 1e-9
    assert ('any damping lets it fall' in str(judged)) is stable
    assert ('too slow' in str(judged)) is not stable
    rates = np.roots([1, -1j * g, -0.5])  # s^2 + i g s - 1/2 of z = x + i y, by hand
    assert abs(judged['buckling'].growth - max(abs(rates.real)) * (not stable)) < 1e-9
    system = LinearSystem.of(atoms, 'gyration')
    assert (system.growth() == 0) is stable
    assert system.growth(0.01) > 0  # losses undo it (Kelvin, Tait, Chetaev)


@pytest.mark.parametrize(('share', 'stable'), [(0.995, False), (1.005, True)])
def test_gyration_holds_a_lattice_that_is_all_hill(share, stable):
    """A force that falls slower than 1/r, no foundation: both eigenvalues at K are 9 (a - 1)/2, and g^2 = 4 |k| holds them."""
    cell = lattices.triangular(1.0, 1.0)
    a, g = 0.2, 2 * np.sqrt(9 * 0.8 / 2) * share
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, a), gyration=g)
    judged = verdict(cell)
    assert judged.stable is stable
    assert abs(judged['buckling'].needed - 2 * (3 - a)) < 1e-9
    assert abs(judged['timestep_limit'] - 2 / (g / 2 + np.sqrt(g**2 / 4 + 2 * (3 - a)))) < 1e-9


def bounded(atoms, dt):
    """Whether a run of the free particles stays where it began."""
    run = atoms.copy()
    run.calc = atoms.calc
    free = LinearSystem.of(run, 'gyration').mobile
    run.positions[free, :2] += 1e-9 * np.random.default_rng(0).normal(size=(free.sum(), 2))
    dyn = DrivenVerlet(run, dt, engine='compiled', allow_unstable=True)
    try:
        dyn.run(6000)
    except Diverged:
        return False
    return bool(abs(dyn.displacements).max() < 1e-7)


@pytest.mark.slow
def test_a_step_loses_a_hill_where_theory_says():
    """A particle on a hill h: steps multiply it by e^{-ig dt/2} mu, mu + 1/mu = (2 + h dt^2) cos(g dt/2)."""
    atoms = hill(2.0)
    limit = brentq(lambda dt: (1 + 0.5 * dt**2 / 2) * np.cos(dt) + 1, 2.0, 2.3)
    assert bounded(atoms, 0.998 * limit)
    assert not bounded(atoms, 1.002 * limit)
    assert not bounded(atoms, 2 / np.sqrt(0.5))  # the control: the limit by the size of the stiffness alone
    assert verdict(atoms)['timestep_limit'] == 2 / highest_frequency(atoms) < limit


@pytest.mark.slow
def test_where_gyration_alone_holds_it_limits_the_time_step():
    """One limit, of verdict and driver: no step up to it loses a drawn structure.  Rates alone would allow some that do."""
    held, lost = 0, []
    for seed in range(70):
        rng, atoms = np.random.default_rng(seed), lattices.square(1.0, 1.0).repeat((5, 3, 1))
        atoms.pbc = False
        atoms.positions[:, :2] += 0.03 * rng.normal(size=(15, 2))
        atoms.set_masses(rng.uniform(0.5, 2.0, 15))
        atoms.set_constraint(FixAtoms([k for k in range(15) if k not in (4, 10)]))
        atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 0.5), cutoff=2.1, foundation=rng.uniform(0, 4, (15, 1)) * [1, 1],
                                       gyration=rng.uniform(1, 6, 15)).balanced(range(15))
        M, C, K, P = oracle(atoms)
        if eigvals(flow(M, C, K, P)).real.max() > 1e-6 or np.linalg.eigvalsh(P.T @ K @ P)[0] > 0:
            continue
        held += 1
        B, D = (np.linalg.solve(P.T @ M @ P, P.T @ X @ P) for X in (C, K))
        one, none = np.eye(len(D)), np.zeros_like(D)

        def growth(dt, B=B, D=D, one=one, none=none):
            turn, kick = np.block([[one, none], [none, expm(-B * dt / 2)]]), np.block([[one, none], [-D * dt / 2, one]])
            return abs(eigvals(turn @ kick @ np.block([[one, dt * one], [none, one]]) @ kick @ turn)).max() - 1

        limit = verdict(atoms)['timestep_limit']
        assert limit == 2 / highest_frequency(atoms)
        assert max(growth(share * limit) for share in np.linspace(0.05, 0.998, 20)) < 1e-7
        DrivenVerlet(atoms, 0.9999 * limit)
        with pytest.raises(ValueError, match='exceeds the stability limit'):
            DrivenVerlet(atoms, 1.0001 * limit)
        size, g = abs(np.linalg.eigvals(D)).max(), abs(atoms.calc.gyration).max()
        if limit < 0.99 * 2 / (g / 2 + np.sqrt(g**2 / 4 + size)):
            lost.append(limit * (g / 2 + np.sqrt(g**2 / 4 + size)) / 2)
            assert [bounded(atoms, x * limit) for x in (0.995, 1.02)] == [True, False]
    assert held > 15
    assert len(lost) == 2
    assert min(lost) < 0.8  # the control: the bound lets both grow


def test_gyration_does_not_hold_a_saddle():
    """At X of the square lattice K is a hill along one axis and a valley along the other: det K < 0, a real pole for every g."""
    cell = lattices.square(1.0, 1.0)
    for g, k in (5.0, 3.9), (0.5, 3.9), (5.0, 4.1):
        cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=k, gyration=g)
        judged = verdict(cell)
        assert judged.stable is (k > 4)
        if k < 4:
            K = cell.calc.bloch_matrix(np.array([[0, 0.5, 0]]))[0].real
            rates = np.linalg.eigvals(np.block([[np.zeros((2, 2)), np.eye(2)], [-K, g * J]])).real
            assert abs(judged['buckling'].growth - rates.max()) < 1e-9
            omega, found = lossless_modes(-g * J, K)
            s = np.where(omega < 0, -omega, -1j * omega)  # what grows, and what turns as e^{-iwt}
            assert abs(s**2 * found - g * J @ (s * found) + K @ found).max() < 1e-11
            assert np.allclose(np.linalg.norm(found, axis=0), 1, rtol=1e-12)


@pytest.mark.slow
def test_the_command_draws_modes_of_particles_that_gyrate(tmp_path, capsys, monkeypatch):
    text = ready_scene('gyro').read_text().replace('cells_1 = 24', 'cells_1 = 8').replace('cells_2 = 12', 'cells_2 = 7')
    (tmp_path / 'scene.toml').write_text(text)
    asked = ['modes', str(tmp_path / 'scene.toml'), '-o', str(tmp_path / 'out'), '--animate', '5']
    assert main(asked) == 0
    patch = read_scene(tmp_path / 'scene.toml').patch_atoms()
    table = np.genfromtxt(tmp_path / 'out' / 'modes.csv', delimiter=',', names=True)
    expected = np.sort(eigvals(flow(*oracle(patch))).imag)[len(table) :]
    np.testing.assert_allclose(table['frequency_Hz'], expected * 1e3 / (2 * np.pi), rtol=1e-9)
    assert 'outside the bands of the lattice: none' not in (words := capsys.readouterr().out)
    assert 'outside the bands of the lattice: ' in words
    assert (tmp_path / 'out' / 'mode_5.gif').exists()
    monkeypatch.setattr('magphonon.response.normal_modes.MOST_TURNING', 10)
    assert main([*asked, '--force']) == 2
    assert 'use a smaller patch' in capsys.readouterr().err


@pytest.mark.parametrize('turn', few_first([1.0, -1.0, 'each'], 1))
def test_bursts_reach_the_branches_above_all_stiffness(turn):
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=6.0, gyration=3.0)
    patch = lattices.half_hexagon(cell, 8.0)
    g = -3.0 + 1e-6 * np.arange(len(patch)) if turn == 'each' else 3.0 * turn
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=6.0, gyration=g)
    place, stiffest = burst_setup(cell, patch, 'point'), highest_frequency(patch)
    top = modes(patch).omega[-1]
    assert top > 1.1 * stiffest
    run_burst(patch, place, place.burst((0, 1), 1e-6, 0.99 * top, 3), 0.0, 10.0)
    with pytest.raises(ValueError, match='above the highest frequency'):
        run_burst(patch, place, place.burst((0, 1), 1e-6, 1.2 * top, 3), 0.0, 10.0)


@pytest.mark.slow
def test_bursts_of_particles_that_gyrate_follow_their_branches(tmp_path, capsys):
    text = ready_scene('bench').read_text().replace('mass_kg = 7.07e-4 ', 'gyration_rad_per_s = 300.0\nmass_kg = 7.07e-4 ')
    for key, value in (('side_m', '0.24'), ('carriers_Hz', '[36]'), ('directions_deg', '[90]'), ('noise_m', '1e-9')):
        text = re.sub(rf'^{key} = .*', f'{key} = {value}', text, flags=re.MULTILINE)
    (tmp_path / 'scene.toml').write_text(text)
    assert main(['burst', str(tmp_path / 'scene.toml'), '-o', str(tmp_path / 'out'), '--verbose']) == 0
    said = capsys.readouterr().out
    assert '36Hz_90deg_complete, transverse motion: agrees with the complete shear branch' in said
    assert '36Hz_90deg_conventional, transverse motion: agrees with the conventional shear branch' in said
    cell = read_scene(tmp_path / 'scene.toml').perfect_cell()
    table = np.genfromtxt(tmp_path / 'out' / 'ridges.csv', delimiter=',', names=True, dtype=None, encoding='utf-8')
    table = table[(table['record'] == '36Hz_90deg_complete') & (table['motion'] == 'transverse')]
    q = np.stack([table['q1'], table['q2'], table['q3']], axis=1)

    def away(model='complete'):
        off = bloch_modes(cell, q, model)[0][:, 0] * 1e3 / (2 * np.pi) - table['frequency_Hz']
        return np.sqrt(np.mean(off**2)) / table['bin_Hz'][0]

    here, by_d0 = away(), away('conventional')
    cell.calc.set(gyration=0.0)
    assert here < 0.5
    assert min(by_d0, away()) > 2  # the controls: D0 alone, and nothing gyrates


@pytest.mark.slow
def test_the_command_tells_chern_numbers_and_leaves_phonopy_out(capsys, tmp_path):
    assert main(['bands', '--verbose', 'gyro', '-o', str(tmp_path / 'out')]) == 0
    words = capsys.readouterr().out
    assert 'complete: the Chern numbers of the bands are 1, -1, 1, -1' in words
    assert 'conventional: the Chern numbers of the bands are 1, 0, 0, -1' in words
    assert 'as many edge waves run one way as the other' in words
    assert not list((tmp_path / 'out').glob('*.yaml'))
    write_scene(honeycomb([1.55, 1.5]), tmp_path / 'own.toml')  # each particle its own
    assert main(['bands', '--verbose', str(tmp_path / 'own.toml'), '-o', str(tmp_path / 'own')]) == 0


@pytest.mark.slow
@pytest.mark.peer
def test_chern_numbers_are_those_of_pythtb():
    """Its fluxes of states by the root of K, which share nothing with ours but K; drawn masses, gyration and foundation."""
    pythtb = pytest.importorskip('pythtb')
    rng = np.random.default_rng(12)
    steps, found = 30, set()
    for _ in range(3):
        cell = honeycomb(rng.uniform(0.8, 2.5, 2), k=rng.uniform(5, 8))
        cell.set_masses(rng.uniform(0.8, 1.2, 2))
        g = np.kron(np.diag(np.broadcast_to(cell.calc.gyration, 2)), J)
        root_m = np.repeat(cell.get_masses(), 2) ** -0.5
        model = pythtb.tb_model(2, 2, np.eye(2), np.zeros((8, 2)))
        states = pythtb.wf_array(model, [steps + 1, steps + 1])
        for i in range(steps):
            for j in range(steps):
                K = cell.calc.bloch_matrix(np.array([[i, j, 0]]) / steps)[0] * np.outer(root_m, root_m)
                R = sqrtm(K)
                states[i, j] = np.linalg.eigh(np.block([[0 * K, 1j * R], [-1j * R, 1j * g]]))[1].T
        states.impose_pbc(0, 0)
        states.impose_pbc(1, 1)
        theirs = [states.berry_flux([n]) / (2 * np.pi) for n in range(4, 8)]
        ours = chern_numbers(cell).tolist()
        assert abs(abs(np.round(theirs)) - np.abs(theirs)).max() < 1e-9
        assert (-np.round(theirs)).tolist() == ours  # with i<u|du> for <u|du> of Fukui, Hatsugai and Suzuki
        found.add(tuple(ours))
    assert len(found) > 1
