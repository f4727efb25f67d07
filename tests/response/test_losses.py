"""Losses of each site in every linear tool, against the equations of motion of drawn structures written out densely."""

import re

import numpy as np
import pytest
from scipy.linalg import expm
from structures import structure

from magphonon import (
    InversePower,
    MagneticRepulsion,
    analytic_bands,
    frequency_response,
    lattices,
    propagate,
    read_scene,
    units as u,
)
from magphonon.bands import Bands, complex_bands
from magphonon.bands.bloch import bloch_modes, damped_modes
from magphonon.cli.main import main
from magphonon.response import first_order
from magphonon.response.frf import Dof, receptance
from magphonon.scenes.scene import Scene
from magphonon.stiffness.rest import LinearSystem

GAMMA_M = (0, 1, 0)
FORTY = 2 * np.pi * 40 * u.Hz
CUTOFF_Hz, EDGE_Hz = 26.550686524, 51.8276683282  # shear along Gamma-M: f^2 = cut-off^2 + (edge sin(xi/2))^2
EDGE_D0_Hz = np.sqrt(2 * 4.5824 * 0.236895178822 / (0.01 * 7.07e-4)) / (2 * np.pi)  # 2 a f/(L M), without D*
C = 4 / u.s


def closed(edge, c=C):
    """Shear wave of the prototype at 40 Hz with losses, `f^2 + i f c/2 pi` in place of f^2."""
    return 2 * np.arcsin(np.sqrt(40**2 + 1j * 40 * c * 1e3 / (2 * np.pi) - CUTOFF_Hz**2) / edge)


def stable_cases(count, **options):
    """Drawn structures that stand, with the stiffness and masses of what is free, its basis, and losses of each site."""
    seed = 0
    while count:
        case, seed = structure(seed, own=True, **options), seed + 1
        H, M, B = case.reduced(case.truth)
        if H.size and np.linalg.eigvalsh(H)[0] > 1e-3 * abs(H).max():
            gamma = np.random.default_rng([seed, 7]).uniform(0, 0.5, len(case.atoms)) * np.sqrt(abs(H).max())
            yield case, H, M, B, gamma, np.random.default_rng([seed, 8])
            count -= 1


@pytest.mark.parametrize(('model', 'edge'), [('complete', EDGE_Hz), ('conventional', EDGE_D0_Hz)])
def test_shear_wave_of_the_prototype_decays_as_the_closed_form(model, edge):
    xi = complex_bands(read_scene('prototype').atoms(), GAMMA_M, [FORTY], model, damping=C).xi[0]
    assert abs(xi - closed(edge)).min() < 1e-9  # the edges carry eleven digits
    assert closed(EDGE_Hz).imag == pytest.approx(0.0201104, abs=5e-8)
    assert closed(EDGE_D0_Hz).imag == pytest.approx(0.0102581, abs=5e-8)  # half of it: D0 alone is told from D0 + D*


def test_waves_with_losses_of_each_site_solve_the_equations_of_motion_and_none_is_missing():
    """The determinant winds round zero along |mu| = 1 - to the left of it - as often as the waves that decay, less its poles."""
    seen = 0
    for seed in range(400, 420):
        case = structure(seed, periodic=True, most=4, own=True, constrained=False)
        atoms, rng = case.atoms, np.random.default_rng(seed)
        if case.dim == 3 or (not atoms.pbc[:2].all() and len(atoms) > 3):
            continue
        direction, n = np.eye(3)[0], 2 * len(atoms)
        gamma, m = rng.uniform(0, 0.3, len(atoms)), case.truth.rows
        try:
            top = np.sqrt(abs(bloch_modes(atoms, rng.uniform(0, 1, (4, 3)) * atoms.pbc)[0]).max() ** 2)
            omega = top * rng.uniform(0.3, 1.1)
            found = complex_bands(atoms, direction, [omega], case.truth.model, gamma)
        except ValueError:  # at rest nowhere, or bonds along no such fraction
            continue
        seen += 1

        def equations(q, case=case, omega=omega, gamma=gamma, m=m, direction=direction):
            loss = np.repeat(omega**2 + 1j * omega * gamma, 2)
            return case.truth.waves(np.atleast_1d(q)[:, None] / (2 * np.pi) * direction) / np.sqrt(m * m[:, None]) - np.diag(loss)

        xi, v = found.xi[0], found.vectors[0].reshape(-1, n)
        finite = np.isfinite(xi) & (xi.imag < 5)
        A = equations(xi[finite])
        left = np.einsum('wab,wb->wa', A, v[finite])
        assert abs(left).max(initial=0) < 1e-8 * abs(A).max(initial=1)
        assert (xi.imag > 0).all()
        # waves that decay by less than 2.3 a step: those within the ring between |mu| = e^-2.3 and 1
        turns = []
        for decay in (0.0, 2.3):
            phases = np.linalg.det(equations(np.linspace(0, 2 * np.pi, 801) + 1j * decay))
            turns.append(np.round(np.diff(np.unwrap(np.angle(phases))).sum() / (2 * np.pi)))
        assert abs(turns[0] - turns[1]) == np.count_nonzero(xi.imag < 2.3), seed
    assert seen > 3


def test_losses_bring_the_wave_of_a_crest_that_runs_backwards_a_negative_phase():
    chain = lattices.chain(1.0, 1.0)
    chain.calc = MagneticRepulsion(chain, InversePower(1.0, 4.0), foundation=2.0)
    transverse = np.sqrt([2 - 0.5])  # w^2 = 2 - 2 (1 - cos xi) f/L: the branch falls, its energy runs against its crests
    still, lossy = (complex_bands(chain, (1, 0, 0), transverse, damping=c).xi[0] for c in (0.0, 1e-3))
    assert still[0] == pytest.approx(np.arccos(0.75))
    assert min(abs(lossy - (-np.arccos(0.75) + 1j * 1e-3 * transverse[0] / (2 * np.sin(np.arccos(0.75)))))) < 1e-6


def test_responses_with_losses_of_each_site_are_the_dense_solution():
    for case, H, M, B, gamma, rng in stable_cases(6, most=10):
        atoms, n, dim = case.atoms, len(case.atoms), case.dim
        c = B.T @ (np.repeat(gamma * case.truth.masses, dim)[:, None] * B)
        force = np.zeros((n, 3), complex)
        force[:, :dim] = rng.normal(size=(n, dim)) + 1j * rng.normal(size=(n, dim))
        omega = np.sqrt(abs(H).max() / M.max()) * np.array([0.3, 0.9])
        some = rng.permutation(n)[:3]
        found = frequency_response(atoms, force, omega, gamma, some).response
        for w, own in zip(omega, found, strict=True):
            solved = (B @ np.linalg.solve(H - w**2 * M + 1j * w * c, B.T @ force[:, :dim].ravel())).reshape(n, dim)
            np.testing.assert_allclose(own[:, :dim], solved[some], rtol=0, atol=1e-9 * abs(solved).max())


@pytest.mark.parametrize('turning', [0.0, 1.0])
def test_motion_with_losses_and_gyration_of_each_site_is_the_matrix_exponential(turning):
    for case, H, M, B, gamma, rng in stable_cases(4, most=10, periodic=False):
        atoms, n, dim = case.atoms, len(case.atoms), case.dim
        gamma[rng.random(n) < 0.3] = 0
        if dim == 3 and turning:
            continue
        g = turning * rng.normal(size=n) * np.sqrt(abs(H).max())
        both = np.diag(np.repeat(gamma * case.truth.masses, dim))
        if turning:
            both -= np.kron(np.diag(g * case.truth.masses), [[0, 1], [-1, 0]])
        c = B.T @ both @ B
        zero = np.zeros_like(H)
        A = np.block([[zero, np.eye(len(H))], [-np.linalg.solve(M, H), -np.linalg.solve(M, c)]])
        x = rng.normal(size=2 * len(H))  # large beside what rest leaves of forces, and it is linear
        F = rng.normal(size=(n, 3)) * (np.arange(3) < dim)
        w = np.sqrt(abs(np.linalg.eigvals(A)).max())
        # F cos(wt) is the motion of a clock beside: exactly one more exponential
        push = np.concatenate([np.zeros(len(H)), np.linalg.solve(M, B.T @ F[:, :dim].ravel())])
        whole = np.zeros((len(A) + 2,) * 2)
        whole[:-2, :-2], whole[:-2, -2], whole[-2, -1], whole[-1, -2] = A, push, w, -w
        times = np.array([0.0, 3.0, 3.7, 40.0]) / np.sqrt(abs(H).max() / np.diag(M).min())
        moved = LinearSystem.of(atoms).atoms
        moved.calc.set(gyration=g if turning else 0.0)
        moved.positions[:, :dim] += (B @ x[: len(H)]).reshape(n, dim)
        moved.set_momenta(np.pad((B @ x[len(H):]).reshape(n, dim) * case.truth.masses[:, None], ((0, 0), (0, 3 - dim))),
                          apply_constraint=False)
        found = propagate(moved, times, [lambda t, F=F, w=w: F * np.cos(w * t)], gamma)
        for t, here in zip(times, found.displacements, strict=True):
            y = expm(whole * t) @ np.append(x, [1.0, 0.0])
            true = (B @ y[: len(H)]).reshape(n, dim)
            np.testing.assert_allclose(here, true, rtol=0, atol=1e-9 * abs(true).max())


def test_bands_with_losses_of_each_site_are_the_poles_of_a_cell():
    for case, *_ in stable_cases(6, periodic=True, most=6, constrained=False):
        atoms, m = case.atoms, case.truth.rows
        rng = np.random.default_rng(case.seed)
        gamma = rng.uniform(0, 1.5, len(atoms)) * rng.choice([0.1, 3.0]) * np.sqrt(case.truth.scale / m.max())
        q = rng.uniform(-0.5, 0.5, (2, 3)) * atoms.pbc
        omega, decay, shapes = damped_modes(atoms, q, gamma, case.truth.model, vectors=True)
        K = case.truth.waves(q) / np.sqrt(m * m[:, None])
        for found, falls, own, matrix in zip(omega, decay, shapes, K, strict=True):
            n = len(matrix)
            A = np.block([[np.zeros((n, n)), np.eye(n)], [-matrix, -np.diag(np.repeat(gamma, case.dim))]])
            poles, s = np.linalg.eigvals(A), -falls - 1j * np.where(falls < 0, 0, found)
            assert len(found) == n
            assert (np.diff(found) >= 0).all()
            assert max(abs(poles - one).min() for one in s) < 1e-6 * abs(poles).max()
            # of each pair one: together with their conjugates and the faster halves of overdamped ones these are all
            swinging = poles[poles.imag > 1e-6 * abs(poles).max()]
            assert np.count_nonzero(found > 0) == len(swinging)
            v = own.reshape(n, -1)
            left = np.einsum('mab,mb->ma', s[:, None, None] ** 2 * np.eye(n) + s[:, None, None] * np.diag(
                np.repeat(gamma, case.dim)) + matrix, v)
            assert abs(left).max() < 1e-6 * abs(matrix).max()


def test_losses_alike_take_the_fast_road_to_the_same_answer():
    cell = lattices.honeycomb(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=1.0)
    q = [[0.1, 0.2, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 0.0]]
    for c in (0.0, 0.3, 2.5, 9.0):  # up to where all modes are overdamped
        alike, each = damped_modes(cell, q, c), damped_modes(cell, q, [c, c * (1 + 1e-12) + 1e-13])
        for one, other in zip(alike[:2], each[:2], strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-5)
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    patch.set_momenta(np.where(np.arange(len(patch))[:, None] == 18, [1e-3, 0, 0], 0))
    times, gamma = [1.0, 30.0, 90.0], np.full(len(patch), 0.2)
    gamma[0] += 1e-15
    one, other = (propagate(patch, times, damping=c).displacements for c in (0.2, gamma))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-9 * abs(one).max())
    answers = [receptance(patch, Dof(18, (1, 0, 0)), Dof(3, (0, 1, 0)), [1.0], c).response for c in (0.2, gamma)]
    assert answers[0] == pytest.approx(answers[1], rel=1e-9)


def test_forces_of_many_courses_are_taken_in_parts(monkeypatch):
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    rng, n = np.random.default_rng(0), len(patch)
    w, phase = rng.uniform(0.5, 2, n), rng.uniform(0, 6, n)

    def answer():
        return propagate(patch, [5.0, 20.0], [lambda t: np.outer(np.sin(w * t + phase), [1e-3, 0, 0])], rng_losses).displacements

    rng_losses = rng.uniform(0.1, 0.2, n)
    whole = answer()
    monkeypatch.setattr(first_order, 'LARGEST', 50)
    assert np.allclose(answer(), whole, rtol=0, atol=1e-12 * abs(whole).max())


def test_an_unstable_structure_with_losses_grows_as_its_pole_says():
    chain = lattices.chain(1.0, 1.0).repeat((4, 1, 1))
    chain.calc = MagneticRepulsion(chain, InversePower(1.0, 4.0), foundation=0.5)  # transverse: 0.5 - 2 (1 - cos xi), to -3.5
    chain.set_momenta([[0, (-1) ** k * 1e-6, 0] for k in range(4)])
    c = np.array([0.4, 0.8, 0.4, 0.8])  # of waves with xi = 0 and pi, (s^2 + 0.6 s + 0.5) (s^2 + 0.6 s - 3.5) = (0.2 s)^2
    true = np.roots(np.polysub(np.polymul([1, 0.6, 0.5], [1, 0.6, -3.5]), [0.04, 0, 0])).real.max()
    omega, decay, _ = damped_modes(chain, np.zeros((1, 3)), c)
    growth = -decay.min()
    assert growth == pytest.approx(true, rel=1e-9)
    assert omega.min() == -growth
    y = propagate(chain, [20.0, 21.0], damping=c).displacements[:, 0, 1]
    assert np.log(y[1] / y[0]) == pytest.approx(growth, rel=1e-6)


def test_bands_keep_their_decays_in_a_file(tmp_path):
    cell = read_scene('prototype').atoms()
    bands = analytic_bands(cell, cell.cell.bandpath('GM', npoints=5, pbc=cell.pbc), damping=C)
    assert (bands.decay == C / 2).all()
    bands.save(tmp_path / 'bands.npz')
    assert (Bands.load(tmp_path / 'bands.npz').decay == bands.decay).all()


PAIR = 'x_m,y_m,relative_damping\n0,0,1\n0.01,0,0\n'
LAW = {'kind': 'inverse_power', 'b_N_m_a': 1.6209e-10, 'a': 4.5824, 'shells': 1}
PLAIN = """title = "losses"
[lattice]
kind = "triangular"
spacing_m = 0.01
mass_kg = 7.07e-4
[law]
kind = "inverse_power"
b_N_m_a = 1.6209e-10
a = 4.5824
shells = 1
[foundation]
stiffness_N_per_m = 19.675721234
[bands]
path = "GM"
points = 3
damping_per_s = 100.0
"""
OF_A_FILE = {'title': 'two in a cell', 'law': LAW, 'foundation': {'stiffness_N_per_m': 19.7}, 'bands': {'damping_per_s': 40.0},
             'lattice': {'kind': 'file', 'file': 'p.csv', 'mass_kg': 7.07e-4, 'cell_m': [[0.02, 0.0], [0.005, 0.00866025]]}}


def test_losses_of_a_scene_reach_every_command_or_are_refused(tmp_path, capsys):
    (tmp_path / 'p.csv').write_text(PAIR)
    scene = Scene.model_validate(OF_A_FILE, context={'folder': tmp_path})
    gamma = scene.bands.damping_of(scene.atoms())
    assert gamma.tolist() == [0.04, 0.0]
    decay = analytic_bands(scene.atoms(), 'GX', damping=gamma).decay
    assert decay[-1] == pytest.approx([0.02, 0, 0.02, 0], abs=1e-5)  # at X the two particles move apart from each other
    command = tmp_path / 'scene.toml'
    command.write_text(PLAIN)
    main(['bands', '--verbose', str(command), '-o', str(tmp_path / 'out')])
    shear = np.sqrt(CUTOFF_Hz**2 + EDGE_Hz**2 - (50 / (2 * np.pi)) ** 2)
    assert re.search(rf'M, branch 1 +{shear:.3f}\d* +50 +0\.136', capsys.readouterr().out)
    saved = Bands.load(tmp_path / 'out/bands_damped.npz')
    assert np.allclose(saved.decay, 0.05)
    assert saved.frequencies_Hz[-1, 0] == pytest.approx(shear, rel=1e-9)
    with pytest.raises(ValueError, match='uncertainty: tolerances are those of the bands'):
        Scene.model_validate(OF_A_FILE | {'uncertainty': {'stiffness_percent': 1.0}}, context={'folder': tmp_path})
