"""Laws of the site: forces, energies and stiffness against differences, linear tools, time steps, and the speed of a front."""

import numpy as np
import pytest
from ase.constraints import FixAtoms
from scipy.special import airy

from magphonon import (
    DrivenVerlet,
    InversePower,
    MagneticRepulsion,
    OnSite,
    complex_bands,
    frequency_response,
    lattices,
    modes,
    propagate,
    relaxed,
    verdict,
)
from magphonon.bands import bloch_modes
from magphonon.stiffness.site_laws import Springs

LAW = InversePower(1.0, 4.0)


def wells(rng, n, g=None):
    """A law with a cubic and a quartic term along some direction, on springs of each particle."""
    a, b, c = rng.uniform(0.5, 2, 3)
    return OnSite.along(rng.normal(size=2), lambda u: a * u**2 / 2 + b * u**3 + c * u**4,
                        lambda u: a * u + 3 * b * u**2 + 4 * c * u**3, lambda u: a + 6 * b * u + 12 * c * u**2,
                        k=rng.uniform(6, 9, (n, 2)), g=g)


def tensors(rng, n, g=None):
    A = rng.normal(size=(n, 2, 2))
    return OnSite.tensor(8 * np.eye(2) + (A + A.swapaxes(1, 2)), g)


def drawn(seed, g=None):
    rng = np.random.default_rng(seed)
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 2.0)
    patch.set_masses(rng.uniform(0.5, 2, len(patch)))
    patch.set_constraint(FixAtoms(rng.choice(len(patch), 2, replace=False)))
    law = (tensors if seed % 2 else wells)(rng, len(patch), g)
    anchors = patch.positions + rng.uniform(-0.05, 0.05, (len(patch), 1)) * [1, -1, 0]
    patch.calc = MagneticRepulsion(patch, LAW, foundation=law, anchors=anchors)
    return patch, rng


@pytest.mark.parametrize('seed', range(4))
def test_forces_and_stiffness_are_derivatives(seed):
    patch, rng = drawn(seed)
    patch.set_constraint()
    patch.positions[:, :2] += rng.uniform(-0.1, 0.1, (len(patch), 2))
    here, h = patch.positions.copy(), 1e-5
    direction = np.column_stack([rng.normal(size=(len(patch), 2)), np.zeros(len(patch))])

    def at(s):
        patch.positions = here + s * direction
        return patch.get_potential_energy(), patch.get_forces()

    (e1, f1), (e2, f2), (_, f) = at(h), at(-h), at(0.0)
    assert -(e1 - e2) / (2 * h) == pytest.approx((f * direction).sum(), rel=1e-7)
    H = patch.calc.get_hessian(patch)
    assert abs(-(f1 - f2) / (2 * h) - (H @ direction.ravel()).reshape(-1, 3)).max() < 1e-6 * abs(H).max()
    rest = patch.calc.get_hessian(patch, 'foundation')
    assert abs((H - rest) @ direction.ravel() - H @ direction.ravel()).max() > 0.1  # the control: without the sites


@pytest.mark.parametrize('seed', range(4))
def test_linear_tools_take_the_stiffness_at_rest(seed):
    patch, rng = drawn(seed)
    patch = relaxed(patch).atoms
    H = patch.calc.get_hessian(patch).toarray().reshape(len(patch), 3, len(patch), 3)[:, :2, :, :2].reshape(2 * len(patch), -1)
    m, free = np.repeat(patch.get_masses(), 2), np.repeat(np.isin(range(len(patch)), patch.constraints[0].index, invert=True), 2)
    K = (H / np.sqrt(np.outer(m, m)))[np.ix_(free, free)]
    assert modes(patch).omega**2 == pytest.approx(np.linalg.eigvalsh(K), rel=1e-9)
    force = np.zeros((len(patch), 3))
    force[np.flatnonzero(free)[0] // 2, 0] = 1.0
    w, c, f = 1.3, 0.2, force[:, :2].ravel()[free] / np.sqrt(m[free])
    answer = np.linalg.solve(K - w**2 * np.eye(len(K)) + 1j * c * w * np.eye(len(K)), f) / np.sqrt(m[free])
    found = frequency_response(patch, force, [w], c).response[0, :, :2].ravel()[free]
    assert abs(found - answer).max() < 1e-9 * abs(answer).max()
    for _ in range(2):
        patch.positions[np.flatnonzero(free)[::2] // 2, :2] += 1e-9 * rng.normal(size=(free.sum() // 2, 2))
    start = patch.copy()
    start.calc = patch.calc
    moved = propagate(start, [1.0]).displacements[-1]
    DrivenVerlet(patch, 1e-3).run(1000)
    assert abs(patch.calc.displacements(patch) - moved[:, :2]).max() < 1e-5 * abs(moved).max() + 1e-14


def test_bands_of_tensors():
    cell, K = lattices.triangular(1.0, 1.0), np.array([[9.0, 2.0], [2.0, 7.0]])
    q = np.random.default_rng(0).uniform(-0.5, 0.5, (5, 3)) * [1, 1, 0]
    cell.calc = MagneticRepulsion(cell, LAW, foundation=0.0)
    bare = cell.calc.bloch_matrix(q)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=OnSite.tensor(K))
    assert bloch_modes(cell, q)[0] ** 2 == pytest.approx(np.linalg.eigvalsh(bare + K), rel=1e-12)
    large = cell.repeat((2, 2, 1))
    large.calc = cell.calc.on(large)
    folded = [np.array([i, j, 0]) / 2 for i in range(2) for j in range(2)]
    assert np.sort(bloch_modes(cell, folded)[0], axis=None) == pytest.approx(bloch_modes(large, [[0, 0, 0]])[0][0], rel=1e-12)
    w = complex_bands(cell, (0, 1, 0), [3.0])
    assert np.isfinite(w.xi).any()


def test_a_tensor_is_symmetric():
    with pytest.raises(ValueError, match='symmetric'):
        OnSite.tensor([[1.0, 2.0], [0.0, 1.0]])


def test_the_speed_of_a_front():
    """Chain of k = m = L = 1 and losses c in V' = A u (u - u2)(u - 1): the front runs at q sqrt(k)/sqrt(c^2 + m q^2)."""
    speeds = {u2: front_speed(u2) for u2 in (0.3, 0.5)}
    q = np.sqrt(0.05 / 2) * (1 - 2 * 0.3)
    assert q / np.sqrt(0.5**2 + q**2) == pytest.approx(0.125491, abs=1e-6)
    assert speeds[0.3] == pytest.approx(0.1254, abs=1e-4)
    assert abs(speeds[0.5]) < 1e-3  # the control: wells of one depth


class Spring:
    """A bond of stiffness 1 that is slack at length 1."""

    def phi(self, r):
        return (r - 1) ** 2 / 2

    def dphi(self, r):
        return r - 1

    def d2phi(self, r):
        return np.ones_like(r)


def front_speed(u2, A=0.05, c=0.5):
    n = 120
    chain = lattices.chain(1.0, 1.0).repeat((n, 1, 1))
    chain.pbc = False
    law = OnSite.along((1, 0), lambda u: A * (u**4 / 4 - (1 + u2) * u**3 / 3 + u2 * u**2 / 2),
                       lambda u: A * u * (u - u2) * (u - 1), lambda u: A * (3 * u**2 - 2 * (1 + u2) * u + u2))
    chain.calc = MagneticRepulsion(chain, Spring(), foundation=law)
    x = np.arange(n)
    chain.positions[:, 0] += 1 / (1 + np.exp(np.sqrt(A / 2) * (x - 30)))
    dyn, places = DrivenVerlet(chain, 0.1, damping=c, engine='numpy'), []
    for _ in range(2):
        dyn.run(2000)
        places.append(dyn.displacements[:, 0].sum())  # how many have gone over, with the tails
    return (places[1] - places[0]) / 200


class Ramp(Springs):
    """Springs of a script: they stiffen with time, k(t) = k (1 + rate t)."""

    changes, known = True, 'time steps know it'

    def __init__(self, k, rate):
        super().__init__(k)
        self.rate = rate

    def beyond(self, d, t=None, anchors=None):
        return 0.0 if t is None else self.rate * t * self.k * d


@pytest.mark.parametrize('engine', ['ase', 'numpy'])
def test_a_law_of_a_script_that_changes_moves_in_time_steps_and_is_refused_elsewhere(engine):
    """All particles together feel the springs alone, u'' = -k/m (1 + rate t) u, which Airy functions solve."""
    k, rate, m, t = 9.0, 0.4, 1.3, 6.0
    scale = (k * rate / m) ** (1 / 3)
    before, after = (np.array(airy(-scale * (1 / rate + time))).reshape(2, 2) for time in (0.0, t))  # (Ai, Ai'), (Bi, Bi')
    weights = np.linalg.solve((before * [1, -scale]).T, [1e-4, 0.0])
    expected, slower = weights @ after[:, 0], 1e-4 * np.cos(np.sqrt(k / m) * t)
    errors = []
    for dt in 0.02, 0.01:
        atoms = lattices.square(1.0, m).repeat((3, 3, 1))
        atoms.calc = MagneticRepulsion(atoms, LAW, foundation=Ramp(k, rate))
        atoms.positions[:, 0] += 1e-4
        run = DrivenVerlet(atoms, dt, engine=engine)
        run.run(round(t / dt))
        errors.append(abs(run.displacements[:, 0] - expected).max())
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)
    assert errors[1] < 1e-6 < 1e-5 < abs(slower - expected)
    for tool in modes, verdict:
        with pytest.raises(ValueError, match='time steps know it'):
            tool(atoms)
    with pytest.raises(ValueError, match='compiled steps support springs only'):
        DrivenVerlet(atoms, 0.01, engine='compiled').run(1)
    assert atoms.calc.on(atoms.calc.reference).tie.rate == rate
