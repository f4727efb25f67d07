"""Time steps on a foundation that changes: every engine against an integrator of the test's own."""

from dataclasses import replace

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine
from scipy.integrate import solve_ivp

from magphonon import DrivenVerlet, Harmonic, InversePower, MagneticRepulsion, OnSite, Travelling, floquet_bands, lattices
from magphonon.bands.bloch import bloch_modes

DT, STEPS = 0.02, 150


def drawn(seed, slack=False):
    """A patch of masses and springs of their own that starts out of rest, with held and guided particles."""
    rng = np.random.default_rng(seed)
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0) if seed % 2 else lattices.square(1.0, 1.0).repeat((5, 4, 1))
    n = len(patch)
    patch.set_masses(rng.uniform(0.5, 2, n))
    patch.set_constraint([FixAtoms(rng.choice(n, 3, replace=False))] + [FixedLine(0, (1, 1, 0))] * (seed % 3 == 0))
    k = rng.uniform(8, 12, (n, 2)) if seed % 3 else 9.0
    law = Travelling(k, rng.uniform(0.3, 0.9), rng.uniform(2, 6), rng.normal(size=2))
    anchors = patch.positions + slack * rng.uniform(-0.02, 0.02, (n, 1)) * [1, 1, 0]
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=law, anchors=anchors)
    free = np.delete(np.arange(n), patch.constraints[0].index)
    patch.positions[free[free > 0], :2] += rng.uniform(-0.02, 0.02, (len(free[free > 0]), 2))
    return patch, [Harmonic(int(free[-1]), (1, 0.3), 0.5, 3.0)], rng.uniform(0, 0.3, n)


def pumped(law):
    """What a modulation adds to the slope of the mean springs, at displacements from the anchors and a time."""
    return lambda d, time, anchors: law.eps * np.cos(law.W * time - anchors[:, :2] @ law.kap[:2])[:, None] * law.k * d


def integrated(atoms, drives, damping, t, more=None):
    """Positions after the time t, by the equation of motion: forces of the mean springs, and the rest by hand."""
    law, calc = atoms.calc.parameters.foundation, atoms.calc
    mean, more = calc.about(calc.reference, foundation=law.k), more or pumped(law)
    m, n = atoms.get_masses()[:, None], len(atoms)
    at = atoms.copy()
    at.calc = mean

    def motion(time, y):
        x, v = y.reshape(2, n, 2)
        at.set_positions(np.column_stack([x, atoms.positions[:, 2]]), apply_constraint=False)
        f = mean.get_forces(at)
        f[:, :2] -= more(x - calc.anchors[:, :2], time, calc.anchors)
        f[drives[0].particles] += drives[0](time)
        for constraint in atoms.constraints:
            constraint.adjust_forces(at, f)
        return np.stack([v, f[:, :2] / m - damping[:, None] * v]).ravel()

    start = np.stack([atoms.positions[:, :2], 0 * atoms.positions[:, :2]])
    return solve_ivp(motion, (0, t), start.ravel(), 'DOP853', rtol=1e-9, atol=1e-11).y[: 2 * n, -1].reshape(n, 2)


@pytest.mark.slow
@pytest.mark.parametrize(('seed', 'slack'), [(0, False), (1, False), (3, True)])
def test_every_engine_moves_with_the_modulation(seed, slack):
    atoms, drives, damping = drawn(seed, slack)
    true = integrated(atoms, drives, damping, DT * STEPS)
    errors, ends = [], []
    for engine, order, fine in [('ase', 2, 1), ('numpy', 2, 1), ('compiled', 2, 1), ('numpy', 2, 2), ('ase', 2, 2)]:
        if engine == 'compiled' and slack:
            with pytest.raises(ValueError, match='not slack at rest'):
                DrivenVerlet(_again(atoms), DT, engine='compiled')
            continue
        moved = _again(atoms)
        DrivenVerlet(moved, DT / fine, drives, damping, engine=engine, order=order).run(fine * STEPS)
        ends.append(moved.positions[:, :2])
        errors.append(abs(ends[-1] - true).max())
    assert np.ptp(ends[: len(ends) - 2], axis=0).max() < 1e-11  # the engines agree
    assert errors[0] / errors[-1] == pytest.approx(4, rel=0.15)  # and are of second order
    assert errors[0] < 2e-3
    law = atoms.calc.parameters.foundation
    still = _again(atoms, law.k)
    DrivenVerlet(still, DT, drives, damping).run(STEPS)
    assert abs(still.positions[:, :2] - true).max() > 10 * errors[0]


@pytest.mark.parametrize('seed', range(3))
def test_wells_of_each_site_follow_their_current(seed):
    """g(t) V(d), times a share of each site, from anchors away from rest; the control: all shares are one, or there is no g."""
    atoms, drives, damping = drawn(seed, slack=True)
    rng, n = np.random.default_rng(seed), len(atoms)
    along, share, (a, b, c) = rng.normal(size=2), rng.uniform(0.3, 3, n), rng.uniform(1, 3, 3) * [1, 20, 400]
    along /= np.linalg.norm(along)

    def wells(share, g):
        return OnSite.along(along, lambda u: a * u**2 / 2 + b * u**3 + c * u**4, lambda u: a * u + 3 * b * u**2 + 4 * c * u**3,
                            lambda u: a + 6 * b * u + 12 * c * u**2, rng.uniform(6, 9), g).of(n, 2).times(share)

    def slopes(d, time, anchors):
        u = d @ along
        return (share * (1 + 0.8 * np.cos(3 * time)) * (a * u + 3 * b * u**2 + 4 * c * u**3))[:, None] * along

    def end(engine, fine, law):
        moved = _again(atoms, law)
        DrivenVerlet(moved, DT / fine, drives, damping, engine=engine).run(fine * STEPS)
        return moved.positions[:, :2]

    law = wells(share, lambda t: 1 + 0.8 * np.cos(3 * t))
    true = integrated(_again(atoms, law), drives, damping, DT * STEPS, slopes)
    coarse, fine, ases = (end(*how, law) for how in (('numpy', 1), ('numpy', 2), ('ase', 1)))
    errors = [abs(x - true).max() for x in (coarse, fine)]
    assert abs(ases - coarse).max() < 1e-11
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.15)
    assert errors[0] < 2e-3
    for wrong in replace(law, share=np.ones(n)), replace(law, g=None):
        assert abs(end('numpy', 1, wrong) - true).max() > 4 * errors[0]
    with pytest.raises(ValueError, match=r"engine='compiled'.*OnSite"):
        DrivenVerlet(_again(atoms, law), DT, engine='compiled')


def _again(atoms, foundation=None):
    again = atoms.copy()
    again.calc = atoms.calc if foundation is None else atoms.calc.about(atoms.calc.reference, foundation=foundation)
    return again


@pytest.mark.parametrize('engines', [('ase',), pytest.param(('ase', 'compiled'), marks=pytest.mark.slow)], ids=len)
@pytest.mark.parametrize('order', [4, 6])
def test_higher_orders(order, engines):
    atoms, drives, _ = drawn(1)
    ends = {}
    for engine, dt in [*((engine, 0.1) for engine in engines), ('numpy', 0.1), ('numpy', 0.05)]:
        moved = _again(atoms)
        DrivenVerlet(moved, dt, drives, 0.1, engine=engine, order=order).run(round(DT * STEPS / dt))
        ends[engine, dt] = moved.positions
    assert np.ptp([end for (_, dt), end in ends.items() if dt == 0.1], axis=0).max() < 1e-11
    true = integrated(atoms, drives, np.full(len(atoms), 0.1), DT * STEPS)
    coarse, fine = (abs(ends['numpy', dt][:, :2] - true).max() for dt in (0.1, 0.05))
    assert coarse / fine > 0.7 * 2**order
    assert coarse < 1e-4


def test_a_wave_grows_as_its_floquet_exponent_says():
    cell = lattices.triangular(1.0, 1.0)
    springs = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=8.0)
    cell.calc = springs
    w = bloch_modes(cell, [[0, 0.25, 0]])[0][0, 0]
    cell.calc = springs.about(cell, foundation=Travelling(8.0, 0.2, 2 * w, (0, 0)))
    rates = {c: floquet_bands(cell, [0, 0.25, 0], damping=c).growth[0] for c in (0.1, 0.4)}
    assert rates[0.1] > 0 > rates[0.4]
    for c, rate in rates.items():
        patch = cell.repeat((1, 4, 1))
        patch.calc = cell.calc.on(patch)
        shape = np.cos(2 * np.pi * 0.25 * np.arange(4) + 0.3)
        patch.positions[:, 0] += 1e-6 * shape  # shear
        dyn = DrivenVerlet(patch, 0.02, damping=c, engine='numpy')
        sizes, period = [], round(2 * np.pi / w / 0.02)
        for _ in range(8):
            dyn.run(5 * period)
            sizes.append(np.linalg.norm(dyn.displacements) ** 2 + np.linalg.norm(dyn.velocities / w) ** 2)
        slope = np.polyfit(0.02 * 5 * period * np.arange(4), np.log(sizes[-4:]) / 2, 1)[0]
        assert slope == pytest.approx(rate, abs=0.01)
