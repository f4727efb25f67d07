"""The increment law against extended precision, and the layouts of the compiled engine."""

from unittest import mock

import numpy as np
import pytest
from scipy.integrate import quad

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
from magphonon.dynamics import memory_layout
from magphonon.dynamics.bond_increments import RANGES, TOLERANCE, Increments
from magphonon.dynamics.memory_layout import arrange
from magphonon.dynamics.splittings import SPLITTINGS
from magphonon.dynamics.verlet import threads_for
from magphonon.interactions import Tabulated

LAW = InversePower(b=8900.0, a=4.5)
MODELS = ['complete', 'conventional']


# --- the law of the increment ---------------------------------------------------------------------------------------


def extended(model, e, r0, b=8900, a=4.5):
    """H(e) of the inverse power b r^-a in extended precision, as a difference (64 bits of mantissa where there are any)."""
    e, r0, b, a = (np.longdouble(x) for x in (e, r0, b, a))
    r = r0 * (1 + e / 2) if model == 'conventional' else r0 * np.sqrt(1 + e)
    f, f0 = b * r**-a, b * r0**-a
    return f / r - f0 / r0 if model == 'complete' else (f - f0) / r0


@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason='no extended precision here')
@pytest.mark.parametrize('model', MODELS)
@pytest.mark.parametrize('reach', RANGES)
@pytest.mark.parametrize('tolerance', [TOLERANCE, 1e-4])
def test_polynomials_keep_their_error_bound(model, reach, tolerance):
    law = Increments(LAW, model, np.array([10.0, 13.0]))
    coefficients, stiffness = law.polynomial(reach, tolerance), law.slope(np.zeros(1))[0]
    np.testing.assert_allclose(coefficients[0], stiffness, rtol=1e-13)
    e = reach * np.linspace(-1, 1, 202)  # not zero
    for c, r0, k in zip(coefficients.T, law.r0, stiffness, strict=True):
        H, expected = e * np.polyval(c[::-1], e), extended(model, e, r0)
        # the slope is good to the bound, so is H relative to e; the difference in 64 bits adds 1e-19/e
        assert (abs(H - expected) < abs(k * e) * (tolerance + 1e-18 / abs(e))).all()


@pytest.mark.parametrize('model', MODELS)
def test_nothing_is_lost_near_rest(model):
    law = Increments(LAW, model, np.array([10.0]))
    c = law.polynomial(RANGES[0])[:, 0]
    e = np.array([1e-9, 1e-13, -1e-16])
    quotient = {'complete': -(4.5 + 1) / 2, 'conventional': -4.5 / 2}[model] * 8900 * 10.0**-5.5
    assert (abs(np.polyval(c[::-1], e) / quotient - 1) < 1e-13 + 10 * abs(e)).all()


@pytest.mark.parametrize('order', SPLITTINGS)
@pytest.mark.parametrize('gamma', [0.0, 0.4, 3.0])
def test_a_drift_is_flight_under_damping(order, gamma):
    method, dt = SPLITTINGS[order], 0.7
    ends = [quad(lambda t: np.exp(-gamma * t), 0, dt * drift)[0] for drift in method.drifts]
    distances, factors = method.flow(dt, gamma)
    np.testing.assert_allclose(distances, ends, rtol=1e-12)
    np.testing.assert_allclose(factors, 1 - gamma * np.array(ends), rtol=1e-12)  # v' = -gamma x'


def test_a_law_with_knots_or_an_end_within_reach_gets_no_polynomial():
    r = np.array([5.0, 7, 9, 9.9, 10.1, 11, 14, 18])
    bent = Tabulated(r, r**-4.5 * (1 + 0.1 * np.sin(3 * r)))
    law = Increments(bent, 'complete', np.array([10.0]))
    assert law.polynomial(RANGES[1]) is not None
    assert law.polynomial(RANGES[2]) is None  # past the knots at 9.9 and 10.1
    short = Increments(Tabulated(r, r**-4.5), 'complete', np.array([5.0]))
    assert short.polynomial(1 / 16) is not None
    assert short.polynomial(1 / 2) is None  # the table ends, and the tenth that it continues below its first point
    straight = Increments(Tabulated(r, r**-4.5), 'complete', np.array([10.0]))
    assert straight.polynomial(1 / 4) is not None  # an inverse power, whatever the knots


# --- layouts --------------------------------------------------------------------------------------------------------


def cells():
    return {'triangular': lattices.triangular(10.0, 0.7), 'square': lattices.square(10.0, 0.7),
            'honeycomb': lattices.honeycomb(10.0, 0.7), 'kagome': lattices.kagome(10.0, 0.7)}


def shapes(name):
    cell = cells()[name]
    yield 'parallelogram', lattices.parallelogram(cell, 6, 5)
    yield 'hexagon', lattices.hexagon(cell, 45.0)
    yield 'half hexagon', lattices.half_hexagon(cell, 65.0)
    yield 'rectangle', lattices.rectangle(cell, 80.0, 60.0)


def vacancies(patch, seed=5, share=0.1, shuffle=True, free=False):
    order = np.random.default_rng(seed).permutation(len(patch))[round(share * len(patch)) :]
    patch = patch[order if shuffle else np.sort(order)]
    if free:
        patch.set_constraint()
    return patch


@pytest.mark.parametrize('name', cells())
def test_patches_lie_on_a_grid_of_few_offsets(name):
    groups = {'triangular': 3, 'square': 2, 'honeycomb': 3, 'kagome': 6}[name]
    for shape, patch in shapes(name):
        for cut in (patch, vacancies(patch), vacancies(patch, share=0.35)):
            layout = arrange(cut, MagneticRepulsion(cut, LAW).bonds, 2)
            assert layout.offset is not None, shape
            assert len(layout.offset) <= groups
            assert len(set(zip(layout.column.tolist(), layout.i.tolist(), strict=True))) == len(layout.i)
            assert (layout.j - layout.i == layout.offset[layout.column]).all()


def in_table(name):
    """Patches that are called a table do not find their places on a grid."""
    return mock.patch.object(memory_layout, 'SPREAD', 0 if 'table' in name else memory_layout.SPREAD)


@pytest.mark.parametrize('name', cells())
def test_places_on_a_grid_are_found_in_any_order_and_with_scatter(name):
    groups = 2 if name == 'square' else 3  # honeycomb and kagome are triangular lattices with places left free
    rng = np.random.default_rng(8)
    for shape, patch in shapes(name):
        cut = vacancies(patch, share=0.05, free=True)
        cut.set_array('site', None)
        for scatter in (0.0, 0.5):  # mm
            cut.positions[:, :2] += scatter * rng.uniform(-1, 1, (len(cut), 2))
            angle = rng.uniform(0, 2 * np.pi)
            c, s = np.cos(angle), np.sin(angle)
            cut.positions[:, :2] = cut.positions[:, :2] @ [[c, s], [-s, c]]
            layout = arrange(cut, MagneticRepulsion(cut, LAW, cutoff=12.0).bonds, 2)
            assert layout.offset is not None, shape
            assert len(layout.offset) == groups
            assert set((layout.j - layout.i).tolist()) <= set(layout.offset.tolist())


def test_in_other_structures_neighbours_are_looked_up():
    patch = vacancies(lattices.parallelogram(cells()['triangular'], 8, 8))
    patch.set_array('site', None)
    strip = cells()['triangular'].repeat((1, 9, 1))  # bonds to images of oneself are left out
    for atoms in (patch, strip):
        bonds = MagneticRepulsion(atoms, LAW, cutoff=12.0).bonds
        with in_table('table'):
            layout = arrange(atoms, bonds, 2)
        assert layout.offset is None
        assert sorted(layout.slot) == list(range(len(atoms)))
        particle, i, j = np.argsort(layout.slot), bonds.i[bonds.i != bonds.j], bonds.j[bonds.i != bonds.j]
        ends = np.stack([particle[layout.i], particle[layout.j]])
        assert sorted(zip(*ends, strict=True)) == sorted([*zip(i, j, strict=True), *zip(j, i, strict=True)])
        assert (np.sort(ends, axis=0) == np.sort([bonds.i[layout.bond], bonds.j[layout.bond]], axis=0)).all()
        assert len(set(zip(layout.column.tolist(), layout.i.tolist(), strict=True))) == len(layout.i)
    twice = lattices.parallelogram(cells()['triangular'], 8, 8)
    twice += twice  # its sites are no places any more
    assert arrange(twice, MagneticRepulsion(twice, LAW, bonds=[(0, 1), (64, 65)]).bonds, 2).offset is None


# --- threads ----------------------------------------------------------------------------------------------------------


def test_threads_are_a_whole_number_and_one_by_default_in_small_patches(monkeypatch):
    atoms = lattices.parallelogram(cells()['triangular'], 6, 6)
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=0.02)
    assert DrivenVerlet(atoms, 0.1).threads == 1
    with pytest.raises(ValueError, match='threads must be a whole number of at least 1, not 0'):
        DrivenVerlet(atoms, 0.1, threads=0)
    monkeypatch.setenv('OMP_NUM_THREADS', '3')
    assert [threads_for(n) for n in (10, 199_999, 200_000, 1_000_000)] == [1, 1, 2, 3]
    monkeypatch.setenv('OMP_NUM_THREADS', '')
    monkeypatch.setattr('os.sched_getaffinity', lambda process: set(range(8)), raising=False)
    for load, threads in ((0.2, 8), (3.4, 5), (11.0, 1)):
        monkeypatch.setattr('os.getloadavg', lambda load=load: (load, 0.0, 0.0), raising=False)
        assert threads_for(1_000_000) == threads
