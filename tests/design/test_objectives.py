"""Slopes of every objective by every parameter in both models, against differences of structures that come to rest again."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from ridge_lattices import shaken_on_rods
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed
from magphonon.bands import bloch_modes
from magphonon.design import BandEdge, Contrast, Errors, band_gap, optimise
from magphonon.design.scatter import Rest, site_slopes
from magphonon.design.site_designs import Parts, Structure, Variables
from magphonon.response import Dof

LAW = InversePower(b=6200.0, a=4.5824)
OVER = {'strength': (0.85, 1.15), 'magnet': (0.85, 1.15), 'spring': (0.8, 1.25), 'rod': (0.9, 1.1), 'mass': (0.5, 2.0),
        'foot': (-1.0, 1.0)}
ROD = 0.1  # moving mass of a rod in g
SHORT = 2.5e-5  # step of logarithms; of feet in mm it is ten times as long, of rods, whose fourth power counts, a third as long
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
    q = rng.uniform(-0.5, 0.5, (4, 3)) * [1, 1, 0]
    return {
        'level': (finite, Contrast(source, left, (), 0.5, 0.03) - 2.0 * Contrast([source, left], right, (), 0.55, 0.03)),
        'contrast': (finite, Contrast([source, left], at[3:5], at[5:], 0.5, 0.03)),
        'gap': (cell(seed), band_gap(q, 9, 60.0)),
    }


def slopes_and_differences(variables, objective, model, rng, x, draw=None, of_each=2):
    """Our slope by so many parameters of each kind, and differences of fourth order; by kind, shapes (of_each,)."""
    def rest(x):
        parts = variables.parts(x)
        return variables.structure.rest(parts if draw is None else parts * draw, model=model)

    here, found, start = rest(x), {}, 0
    ours = variables.gradient(x, site_slopes(here, objective.value_and_slope(here)[1]), here.masses)
    for kind in variables.over:
        size = len(variables.sites) * (2 if kind == 'foot' else 1)
        h = SHORT * {'foot': 10, 'rod': 1 / 3}.get(kind, 1) / variables.half[start]
        for k in start + rng.choice(size, of_each, replace=False):
            e = np.eye(len(x))[k]
            near, far = ([objective.value(rest(x + sign * s * h * e)) for sign in (1, -1)] for s in (1, 2))
            found.setdefault(kind, []).append((ours[k], (8 * (near[0] - near[1]) - (far[0] - far[1])) / (12 * h)))
        start += size
    return {kind: np.array(pairs).T for kind, pairs in found.items()}


NAMES = 'level', 'contrast', 'gap'


@pytest.mark.parametrize(('name', 'model'), [('level', 'conventional'), ('contrast', 'complete'), ('gap', 'complete')])
def test_slopes_are_those_of_differences(name, model):
    compared(name, model, 11, of_each=1)


def compared(name, model, seed, of_each=2):
    """In a copy with errors, whose slopes are those by the parameters of the design."""
    atoms, objective = tasks(seed)[name]
    rng = np.random.default_rng(seed)
    variables = Variables(Structure(atoms, ROD), OVER)
    x = 0.1 * rng.normal(size=len(variables))
    errors = Errors(force_percent=2.0, stiffness_percent=3.0, mass_percent=1.0, each_strength_percent=1.0, each_mass_percent=2.0,
                    each_stiffness_percent=2.0, each_foot_mm=0.1)
    draw = errors.draw(rng, *variables.structure.shape)
    for kind, (ours, theirs) in slopes_and_differences(variables, objective, model, rng, x, draw, of_each).items():
        assert abs(ours - theirs).max() < DIGITS * abs(theirs).max(), kind


@pytest.mark.slow
@pytest.mark.parametrize(('model', 'seed'), [*product(['complete'], range(1, 6)), ('complete', 11), ('conventional', 11)])
@pytest.mark.parametrize('name', NAMES)
def test_slopes_of_other_structures(name, model, seed):
    compared(name, model, seed)


@pytest.mark.parametrize('seed', range(3))
def test_bonds_to_own_images_count_at_both_ends(seed):
    """In a cell one row wide some of a magnet's bonds lead to images of itself; both ends of these grow with its strength."""
    rng = np.random.default_rng(seed)
    atoms = drawn(lattices.triangular(10.0, 0.7).repeat((int(rng.integers(2, 5)), 1, 1)), rng)
    own = atoms.calc.bonds.i == atoms.calc.bonds.j
    assert own.any()
    variables = Variables(Structure(atoms), {'strength': OVER['strength']})
    x = 0.1 * rng.normal(size=len(variables))
    edge = BandEdge(rng.uniform(-0.5, 0.5, (2, 3)), len(atoms), 'top', 30.0)
    ours, theirs = slopes_and_differences(variables, edge, 'complete', rng, x)['strength']
    assert abs(ours - theirs).max() < DIGITS * abs(theirs).max()


def at_rest(atoms):
    """The atoms at rest, by the solver of designs."""
    structure = Structure(atoms)
    return structure.at(structure.rest(), Parts())


def test_edges_are_those_of_bands():
    periodic = at_rest(cell(3))
    q = np.array([[0.1, 0.2, 0], [0.3, -0.4, 0]])
    omega = bloch_modes(periodic, q)[0]
    sharp = BandEdge(q, 5, 'bottom', 1e5).value(periodic), BandEdge(q, 5, 'top', 1e5).value(periodic)
    assert sharp == pytest.approx((omega[:, 5:].min(), omega[:, :5].max()), abs=1e-4)
    edge = BandEdge(q, 5)
    for x, softer in ((3.0, 0), (30.0, 1)):  # 3 m omega^2/k of rods that count as springs here
        periodic.set_array('rod_masses', 33 / 140 * x * periodic.calc.foundation.min(axis=1) / (3 * edge.value(periodic) ** 2))
        assert len(edge.doubts(Rest.of(periodic))) == softer


@pytest.mark.parametrize('seed', few_first(range(8), 2))
def test_rods_are_cantilevers(seed):
    """Drawn rods too heavy for springs, beside others that are not; the control: springs with Rayleigh's mass are off."""
    rng, atoms = np.random.default_rng(seed), patch(seed)
    x = np.where(rng.random(len(atoms)) < 0.5, rng.uniform(0.1, 4.5, len(atoms)), rng.uniform(6.0, 60.0, len(atoms)))
    rods = 33 / 140 * x * atoms.calc.foundation[:, 0] / (3 * 0.5**2)
    atoms.set_masses(atoms.get_masses() + rods)
    k, *seen = rng.choice(free_of(atoms), 4, replace=False)
    source = Dof(k, np.append(rng.normal(size=2), 0))
    contrast = Contrast(source, seen[:1], seen[1:], 0.5, 0.02)
    springs = contrast.value(at_rest(atoms))
    atoms.set_array('rod_masses', rods)
    u = shaken_on_rods(relaxed(atoms).atoms, source.force(len(atoms)), 0.5, 0.02, rods)
    ours, one, others = at_rest(atoms), *(10 * np.log10((abs(u[some]) ** 2).sum()) for some in (seen[:1], seen[1:]))
    assert contrast.value(ours) == pytest.approx(one - others, abs=1e-6)
    level = replace(contrast, loud=Dof(seen[0], [0.6, 0.8, 0]), quiet=())
    assert level.value(ours) == pytest.approx(20 * np.log10(abs(u[seen[0]] @ [0.6, 0.8])), abs=1e-6)
    assert abs(springs - one + others) > 0.1


def test_what_is_refused():
    atoms = at_rest(tasks(2)['level'][0])
    held, free = (Dof(int(k), np.array([1.0, 0, 0])) for k in (atoms.constraints[0].index[0], free_of(atoms)[0]))
    plain = lattices.triangular(10.0, 0.7)
    plain.calc = MagneticRepulsion(plain, LAW, foundation=0.1)
    for objective, structure, words in (
            (Contrast(free, held, [1], 0.5, 0.01), atoms, 'it is held'),
            (Contrast(held, free, [1], 0.5, 0.01), atoms, 'it is held'),
            (BandEdge(np.zeros((1, 3)), 2, 'bottom'), plain, 'the cell has 2 branches'),
            (BandEdge([(0.1, 0.2, 0)], 2), atoms, 'this structure is finite'),
            (Contrast(Dof(999, np.ones(3)), free, (), 0.5, 0.01), atoms, 'there is no particle 999'),
            (Contrast(free, [free.particle], [999], 0.5, 0.01), atoms, 'must be indices from 0'),
            (Contrast([], [0], [1], 0.5, 0.01), atoms, 'no source'), (Contrast(free, [], [1], 0.5, 0.01), atoms, 'no source'),
            (Contrast(7, [0], [1], 0.5, 0.01), atoms, 'the source must be Dof')):
        with pytest.raises(ValueError, match=words):
            objective.value(structure)
    for rod in (-0.1, np.nan):
        atoms.arrays['rod_masses'] = rod * atoms.get_masses()
        with pytest.raises(ValueError, match='the moving mass of the rod of each site'):
            Contrast(free, [free.particle], [1], 0.5, 0.01).value(atoms)


WRONG = {'omega': np.nan, 'damping': -0.1, 'below': 99, 'sharp': -3.0, 'q': (0.1, np.nan, 0)}


@pytest.mark.parametrize('what', WRONG)
def test_wrong_numbers_are_refused(what):
    """Each was once an answer, or a design that "has no stable rest"; the control: with the right number there is one."""
    place = Dof(0, np.array([1.0, 0, 0]))
    objectives = [Contrast(place, place, (), 0.5, 0.01), Contrast(place, [1], [2], 0.5, 0.01),
                  BandEdge([(0.1, 0.2, 0.0)], 2)]
    atoms = at_rest(cell(3, 2))
    for one in objectives:
        if hasattr(one, what):
            assert np.isfinite(one.value(atoms))
            with pytest.raises(ValueError, match=r'not|longer than half a period|counted from 0|numbers|must'):
                replace(one, **{what: WRONG[what]}).value(atoms)


def test_sums_of_branches_are_smooth_where_they_cross():
    """At the uniform lattice branches of a repeated cell cross; the slope of the soft edge is still that of differences."""
    atoms = lattices.triangular(10.0, 0.7).repeat((2, 2, 1))
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=0.1)
    objective = BandEdge([[0.1, 0.2, 0], [0, 0, 0]], 8, 'top', 50.0)
    variables = Variables(Structure(atoms), {'strength': (0.9, 1.1), 'mass': (0.5, 2.0)})
    pairs = slopes_and_differences(variables, objective, 'complete', np.random.default_rng(1), variables.present)
    for ours, theirs in pairs.values():
        assert abs(ours - theirs).max() < DIGITS * abs(theirs).max()


def row(rng, off=0.0):
    """A straight row along a drawn direction, one of whose inner feet is that far off in mm, and both of its directions."""
    along, n = rng.uniform(0, 2 * np.pi), int(rng.integers(4, 8))
    axes = np.array([[np.cos(along), np.sin(along), 0], [-np.sin(along), np.cos(along), 0]])
    atoms = lattices.chain(10.0, 0.7).repeat((n, 1, 1))
    atoms.positions, atoms.pbc = atoms.positions[:, :1] * axes[0], False
    atoms.positions[1] += off * axes[1]
    atoms.calc = MagneticRepulsion(atoms, LAW, cutoff=11.0, foundation=rng.uniform(0.08, 0.15))
    return atoms, axes


@pytest.mark.parametrize('seed', few_first(range(12), 3))
def test_a_port_that_no_design_reaches_by_symmetry_is_named(seed):
    """Motion along a straight row and motion across it do not touch each other, except where a foot is off or may move."""
    rng = np.random.default_rng(seed)
    straight, axes = row(rng)
    k, over = int(rng.integers(2)), {'strength': (0.9, 1.1), 'rod': (0.95, 1.05)}
    across = Contrast(Dof(1, axes[k]), Dof(3, axes[1 - k]), (), rng.uniform(0.35, 0.45), 0.01)
    with pytest.raises(ValueError, match=r'particle 3 does not move along .* by symmetry'):
        across.value(at_rest(straight))
    with pytest.raises(ValueError, match=r'particle 3 does not move along .* by symmetry'):
        optimise(straight, across, over, steps=3)
    assert np.isfinite(replace(across, loud=Dof(3, axes[k])).value(at_rest(straight)))
    assert across.value(at_rest(row(np.random.default_rng(seed), 1e-4)[0])) < -30  # low, and a number
    reached = optimise(straight, across, over | {'foot': (-0.5, 0.5)}, steps=10)
    assert reached.value > 10
