"""Slopes of every objective by every parameter in both models, against differences of structures that come to rest again."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from magphonon import InversePower, MagneticRepulsion, lattices, modes, relaxed
from magphonon.bands import bloch_modes
from magphonon.design import (
    BandEdge,
    BurstEnergy,
    Crossing,
    GroupVelocity,
    Level,
    LocalMode,
    Margin,
    Rest,
    Variables,
    Worst,
    band_gap,
)
from magphonon.design.scatter import SiteSlopes
from magphonon.response import Dof, harmonic_response
from magphonon.stiffness import LinearSystem

LAW = InversePower(b=6200.0, a=4.5824)
OVER = {'strength': (0.85, 1.15), 'spring': (0.8, 1.25), 'spring_x': (0.8, 1.25), 'spring_y': (0.8, 1.25), 'mass': (0.5, 2.0),
        'foot': (-1.0, 1.0), 'spacing': (0.95, 1.05), 'exponent': (0.9, 1.1), 'height': (0.9, 1.1)}
SHORT = 1e-4  # step of logarithms; of feet in mm it is ten times as long, of the spacing half as long
DIGITS = 1e-6  # of the largest slope of a kind: differences of fourth order are ten times better, or more


def drawn(atoms, rng, cutoff=14.0, held=()):
    """The atoms with magnets, springs, masses and places drawn at random, feet under all of them."""
    n = len(atoms)
    atoms.positions[:, :2] += rng.normal(scale=0.2, size=(n, 2))
    atoms.set_masses(rng.uniform(0.5, 1.0, n))
    atoms.calc = MagneticRepulsion(atoms, LAW, cutoff=cutoff, foundation=rng.uniform(0.06, 0.1, (n, 2)),
                                   strengths=rng.uniform(0.9, 1.1, n))
    return atoms


def patch(seed, cutoff=14.0):
    """A drawn hexagon with a hole, held at its rim."""
    rng = np.random.default_rng(seed)
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.7), 30.0)
    del atoms[int(rng.choice(free_of(atoms)))]
    return drawn(atoms, rng, cutoff)


def cell(seed, n=3):
    return drawn(lattices.triangular(10.0, 0.7).repeat((n, n, 1)), np.random.default_rng(seed))


def free_of(atoms):
    return np.setdiff1d(np.arange(len(atoms)), atoms.constraints[0].index)


def tasks(seed):
    """Objectives by name, each with a drawn structure."""
    rng = np.random.default_rng(seed)
    finite = patch(seed, rng.choice([12.0, 14.0, 21.0]))
    at = rng.choice(free_of(finite), 8, replace=False)
    source, left, right = (Dof(int(k), np.append(rng.normal(size=2), 0)) for k in at[:3])
    burst = BurstEnergy(source, tuple(at[3:]), (20.0, 40.0), 0.5, 3, 0.01)
    q = rng.uniform(-0.5, 0.5, (4, 3)) * [1, 1, 0]
    return {
        'level': (finite, Level(source, left, 0.5, 0.03, 1e-3) - Level(source, right, 0.55, 0.03)),
        'worst': (finite, Worst((Level(source, left, 0.5, 0.03), 2.0 * Level(source, right, 0.6, 0.03)), 3.0)),
        'target': (finite, Level(source, left, 0.5, 0.03).near(-10.0, 5.0)),
        'gap': (cell(seed), band_gap(q, 9, 60.0)),
        'group velocity': (cell(seed, 2), GroupVelocity(q[0], 2, np.array([0.8, 0.6]))),
        'frequency': (finite, LocalMode(int(at[0]))),
        'extent': (finite, LocalMode(int(at[0]), 'extent')),
        'margin': (finite, Margin(30.0)),
        'burst': (finite, burst),
        'share': (finite, burst - replace(burst, region=tuple(range(len(finite))))),
        'large burst': (finite, replace(burst, amplitude=0.3)),
    }


def slopes_and_differences(variables, objective, model, rng, x, of_each=2):
    """Our slope by so many parameters of each kind, and differences of fourth order; by kind, shapes (of_each,)."""
    rest = variables.rest(x, model)
    kept = variables.kept if 'exponent' in variables.over else None
    ours = variables.gradient(x, SiteSlopes(rest.system).of(objective.value_and_slope(rest)[1], kept))
    found = {}
    for kind in variables.over:
        part = variables.slice_of(kind)
        h = SHORT * {'foot': 10, 'spacing': 0.5}.get(kind, 1) / variables.half[part][0]
        for k in rng.choice(np.arange(part.start, part.stop), min(of_each, part.stop - part.start), replace=False):
            e = np.eye(len(x))[k]
            near, far = ([objective.value(variables.rest(x + sign * s * h * e, model)) for sign in (1, -1)] for s in (1, 2))
            found.setdefault(kind, []).append((ours[k], (8 * (near[0] - near[1]) - (far[0] - far[1])) / (12 * h)))
    return {kind: np.array(pairs).T for kind, pairs in found.items()}


NAMES = tuple(tasks(0))


@pytest.mark.parametrize('name', [name for name in NAMES if name not in ('share', 'large burst')])
def test_slopes_are_those_of_differences(name):
    compared(name, 'conventional' if name in ('target', 'frequency', 'group velocity') else 'complete', 11, of_each=1)


def compared(name, model, seed, of_each=2):
    atoms, objective = tasks(seed)[name]
    rng = np.random.default_rng(seed)
    kinds = {kind: OVER[kind] for kind in OVER if name != 'large burst' or kind in ('strength', 'spring_y', 'mass', 'foot')}
    variables = Variables(atoms, kinds)
    x = 0.1 * rng.normal(size=len(variables))
    for kind, (ours, theirs) in slopes_and_differences(variables, objective, model, rng, x, of_each).items():
        assert abs(ours - theirs).max() < DIGITS * abs(theirs).max(), kind


@pytest.mark.slow
@pytest.mark.parametrize(('model', 'seed'), [*product(['complete'], range(1, 6)), ('complete', 11), ('conventional', 11)])
@pytest.mark.parametrize('name', NAMES)
def test_slopes_of_other_structures(name, model, seed):
    compared(name, model if name != 'large burst' else 'complete', seed)


@pytest.mark.parametrize('seed', range(3))
def test_bonds_to_own_images_count_at_both_ends(seed):
    """In a cell one row wide some of a magnet's bonds lead to images of itself; both ends of these grow with its strength."""
    rng = np.random.default_rng(seed)
    atoms = drawn(lattices.triangular(10.0, 0.7).repeat((int(rng.integers(2, 5)), 1, 1)), rng)
    own = atoms.calc.bonds.i == atoms.calc.bonds.j
    assert own.any()
    variables = Variables(atoms, {'strength': OVER['strength']})
    x = 0.1 * rng.normal(size=len(variables))
    edge = BandEdge(rng.uniform(-0.5, 0.5, (2, 3)), len(atoms), 'top', 30.0)
    for objective in (edge, GroupVelocity((0.1, 0.2, 0), 1, (1.0, 0))):
        ours, theirs = slopes_and_differences(variables, objective, 'complete', rng, x)['strength']
        assert abs(ours - theirs).max() < DIGITS * abs(theirs).max()


def test_the_rest_that_follows_matters():
    """The control: slopes at fixed positions are wrong."""
    atoms, objective = tasks(11)['level']
    variables = Variables(atoms, {'strength': (0.85, 1.15)})
    rest = variables.rest(variables.present)
    slope = objective.value_and_slope(rest)[1]
    moving, fixed = (SiteSlopes(rest.system, at_rest).of(slope)['strength'] for at_rest in (False, True))
    assert abs(moving - fixed).max() > 0.1 * abs(moving).max()


def test_values():
    """Levels, edges and modes are those of the tools that answer for them alone."""
    found = tasks(3)
    atoms, _ = found['level']
    system = Variables(atoms, {'strength': (0.9, 1.1)}).rest(np.zeros(18)).system
    source, seen = (Dof(int(k), np.array([0.6, 0.8, 0])) for k in free_of(atoms)[[2, 9]])
    h = seen.seen(harmonic_response(system, source.force(len(atoms)), [0.5], 0.02).response)[0]
    assert Level(source, seen, 0.5, 0.02).value(system) == pytest.approx(20 * np.log10(abs(h)), abs=1e-9)
    alone = modes(system)
    assert LocalMode(source.particle).value(system) == pytest.approx(alone.omega[abs(system.masses[source.particle] * (
        alone.shapes[:, source.particle] ** 2).sum(1)).argmax()], rel=1e-9)
    periodic = Variables(found['gap'][0], {'strength': (0.9, 1.1)}).rest(np.zeros(9)).system
    q = np.array([[0.1, 0.2, 0], [0.3, -0.4, 0]])
    omega = bloch_modes(periodic, q)[0]
    sharp = BandEdge(q, 5, 'bottom', 1e5).value(periodic), BandEdge(q, 5, 'top', 1e5).value(periodic)
    assert sharp == pytest.approx((omega[:, 5:].min(), omega[:, :5].max()), abs=1e-4)
    h, towards = 1e-5, periodic.atoms.cell.reciprocal()[:2, :2] @ [0.8, 0.6]  # of q by k times 2 pi
    step = h * (periodic.atoms.cell.array[:2, :2] @ [0.8, 0.6]) / (2 * np.pi)
    assert towards.shape == (2,)
    ends = bloch_modes(periodic, [q[0] + np.append(step, 0), q[0] - np.append(step, 0)])[0][:, 3]
    assert GroupVelocity(q[0], 3, np.array([0.8, 0.6])).value(periodic) == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-6)


def test_energy_of_a_burst():
    """Against Runge's and Kutta's steps of own forces: small motion exactly, large motion to the order of Verlet's steps."""
    atoms, burst = tasks(5)['burst']
    n = len(atoms)
    system = Variables(atoms, {'strength': (0.9, 1.1)}).rest(np.zeros(len(free_of(atoms)))).system
    calc, free, m = system.calc, free_of(atoms), system.masses
    i, j, R = calc.bonds.i, calc.bonds.j, calc.bond_vectors
    s = calc.strengths[i] * calc.strengths[j]
    T, along = 2 * np.pi * burst.cycles / burst.omega, burst.source.direction[:2]

    def pull(u):
        there = R + u[j] - u[i]
        r = np.linalg.norm(there, axis=1)
        each = (s * LAW.b * r ** (-LAW.a - 1))[:, None] * there
        found = np.zeros((n, 2))
        np.add.at(found, i, -each)
        np.add.at(found, j, each)
        return found

    still = pull(np.zeros((n, 2)))

    def rates(t, state, amplitude):
        u, v = np.zeros((2, n, 2))
        u[free], v[free] = state.reshape(2, -1, 2)
        force = pull(u) - still - calc.foundation * u
        if t < T:
            force[burst.source.particle] += amplitude * np.sin(burst.omega * t) * np.sin(np.pi * t / T) ** 2 * along
        return np.concatenate([v[free], (force / m[:, None] - burst.damping * v)[free]]).ravel()

    t = burst.dt * (np.arange(round(burst.window[1] / burst.dt)) + 0.5)
    t = t[t > burst.window[0]]
    for amplitude, close in ((1e-6, 1e-3), (0.3, 0.2)):
        v = solve_ivp(rates, (0, t[-1]), np.zeros(4 * len(free)), 'DOP853', t, args=(amplitude,), rtol=1e-7,
                      atol=1e-9 * amplitude).y.reshape(2, len(free), 2, -1)[1]
        inside = np.isin(free, burst.region)
        energy = burst.dt * (m[free][inside, None, None] / 2 * v[inside] ** 2).sum()
        one = burst if amplitude < 1e-3 else replace(burst, amplitude=amplitude)
        found = one.value(system) + (20 * np.log10(amplitude) if one is burst else 0)
        assert found == pytest.approx(10 * np.log10(energy), abs=close)
    large = replace(burst, amplitude=0.3).value(system) - 20 * np.log10(0.3)
    assert abs(large - burst.value(system)) > 0.4  # the control: it is large


def test_what_is_refused():
    atoms, _ = tasks(2)['level']
    system = Variables(atoms, {'strength': (0.9, 1.1)}).rest(np.zeros(18)).system
    held, free = (Dof(int(k), np.array([1.0, 0, 0])) for k in (atoms.constraints[0].index[0], free_of(atoms)[0]))
    with pytest.raises(ValueError, match=r'particle \d+ is held'):
        Level(free, held, 0.5, 0.01).value(system)
    plain = lattices.triangular(10.0, 0.7)
    plain.calc = MagneticRepulsion(plain, LAW, foundation=0.1)
    with pytest.raises(Crossing, match='has the same frequency as another one'):
        GroupVelocity(np.zeros(3), 0, np.array([1.0, 0])).value(LinearSystem.of(plain))
    with pytest.raises(ValueError, match='the cell has 2 branches'):
        BandEdge(np.zeros((1, 3)), 2, 'bottom').value(LinearSystem.of(plain))
    with pytest.raises(ValueError, match="leave out the amplitude for the conventional model"):
        BurstEnergy(free, (free.particle,), (0.0, 10.0), 0.5, 3, 0.01, amplitude=0.1).value(
            Variables(atoms, {'strength': (0.9, 1.1)}).rest(np.zeros(18), 'conventional'))


WRONG = {'omega': np.nan, 'damping': -0.1, 'floor': -1.0, 'dt': 9.0, 'window': (8.0, 1.0), 'cycles': 0, 'amplitude': -1.0,
         'region': (2, 999), 'below': 99, 'sharp': -3.0, 'branch': 77, 'q': (0.1, np.nan, 0), 'direction': (0, 0, 0), 'site': 999,
         'of': (), 'wanted': np.nan, 'width': 0.0}


@pytest.mark.parametrize('what', WRONG)
def test_wrong_numbers_are_refused(what):
    """Each was once an answer, or a design that "has no stable rest"; the control: with the right number there is one."""
    place = Dof(0, np.array([1.0, 0, 0]))
    level, wave = Level(place, place, 0.5, 0.01), (0.1, 0.2, 0.0)
    objectives = [level, BurstEnergy(place, (1, 2), (0.0, 10.0), 0.5, 3, 0.01), BandEdge([wave], 2), Margin(), LocalMode(1),
                  GroupVelocity(wave, 1, (1.0, 0, 0)), level.near(3.0, 1.0), Worst((level, level))]
    system = LinearSystem.of(relaxed(cell(3, 2)).atoms)
    for one in objectives:
        if hasattr(one, what) and (what != 'of' or isinstance(one, Worst)):
            assert np.isfinite(one.value(system))
            with pytest.raises(ValueError, match=r'not|longer than half a period|counted from 0|numbers|must'):
                replace(one, **{what: WRONG[what]}).value(system)


def test_of_a_finite_structure_no_bands_and_of_held_sites_no_modes():
    atoms = relaxed(patch(4)).atoms
    held, system = int(atoms.constraints[0].index[0]), LinearSystem.of(atoms)
    for one, words in ((BandEdge([(0.1, 0.2, 0)], 2), 'this structure is finite'), (LocalMode(held), 'moves in no mode'),
                       (Level(Dof(999, np.ones(3)), Dof(999, np.ones(3)), 0.5, 0.01), 'there is no particle 999')):
        with pytest.raises(ValueError, match=words):
            one.value(system)


def test_sums_of_branches_are_smooth_where_they_cross():
    """At the uniform lattice branches of a repeated cell cross; the slope of the soft edge is still that of differences."""
    atoms = lattices.triangular(10.0, 0.7).repeat((2, 2, 1))
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=0.1)
    objective = BandEdge([[0.1, 0.2, 0], [0, 0, 0]], 8, 'top', 50.0)
    variables = Variables(atoms, {'strength': (0.9, 1.1), 'mass': (0.5, 2.0)})
    pairs = slopes_and_differences(variables, objective, 'complete', np.random.default_rng(1), variables.present)
    for ours, theirs in pairs.values():
        assert abs(ours - theirs).max() < DIGITS * abs(theirs).max()
    assert isinstance(variables.rest(variables.present), Rest)


@pytest.mark.parametrize('along', range(2))
def test_a_place_that_cannot_hear_the_source_is_named_and_a_floor_gives_it_a_level(along):
    """In a straight row, motion along it and motion across it do not touch each other."""
    row = lattices.chain(10.0, 0.7).repeat((5, 1, 1))
    row.pbc = False
    row.calc = MagneticRepulsion(row, LAW, foundation=0.1)
    row = relaxed(row).atoms
    across = Level(Dof(1, np.eye(3)[along]), Dof(3, np.eye(3)[1 - along]), 0.4, 0.01)
    with pytest.raises(ValueError, match=f'particle {across.seen.particle} does not move'):
        across.value(LinearSystem.of(row))
    assert replace(across, floor=1e-6).value(LinearSystem.of(row)) == pytest.approx(-120, abs=1e-9)  # 20 lg 1e-6
    heard = replace(across, seen=Dof(3, np.eye(3)[along]))
    assert np.isfinite(heard.value(LinearSystem.of(row)))
