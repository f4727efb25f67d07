"""Designs: better by exact slopes, repeatable, stable, robust, of parts; and hostile questions answered in words."""

import csv

import numpy as np
import pytest
from ase.constraints import FixAtoms
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed
from magphonon.design import (
    BandEdge,
    Level,
    Margin,
    Robust,
    Variables,
    Worst,
    of_parts,
    optimise,
    orbits,
    write_build_list,
)
from magphonon.errors import Unstable
from magphonon.response import Dof, harmonic_response
from magphonon.stability import critical_foundation
from magphonon.stiffness import Scatter

LAW = InversePower(b=6200.0, a=4.5824)
X = np.array([1.0, 0, 0])
OVER = {'strength': (0.85, 1.15), 'spring': (0.8, 1.25)}


def patch(radius=30.0, foundation=0.02):
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.7), radius)
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=foundation)
    return atoms


def places(atoms):
    """The middle, a site on its right and one on its left."""
    x = atoms.positions - atoms.positions.mean(0)
    return [Dof(int(np.hypot(*(x[:, :2] - at).T).argmin()), X) for at in ([0, 0], [20, 0], [-20, 0])]


def contrast(atoms, omega=0.4, floor=1e-2):
    middle, right, left = places(atoms)
    return Level(middle, right, omega, 0.02, floor) - Level(middle, left, omega, 0.02, floor)


def test_a_design_is_better_stable_at_rest_and_repeats():
    atoms = patch()
    design, again = (optimise(atoms, contrast(atoms), OVER, steps=15, seed=3) for _ in range(2))
    assert abs(design.before) < 1e-6  # by symmetry
    assert design.value > 20
    assert design.value == again.value
    np.testing.assert_array_equal(design.x, again.x)
    # by the package's other minimiser and its own responses
    rest = relaxed(design.atoms)
    assert rest.shift < 1e-6
    assert rest.lowest > 0
    middle, right, left = places(atoms)
    h = harmonic_response(design.atoms, middle.force(len(atoms)), [0.4], 0.02).response[0]
    levels = [10 * np.log10(abs(place.seen(h)) ** 2 + 1e-4) for place in (right, left)]
    assert levels[0] - levels[1] == pytest.approx(design.value, abs=1e-6)
    low, high = (design.values['strength'][places(atoms)[0].particle] for _ in range(2))
    assert 0.85 <= low <= high <= 1.15
    assert (design.values['strength'][atoms.constraints[0].index] == 1).all()
    assert list(design.history) == sorted(design.history)


def test_what_d0_alone_would_have_promised():
    atoms = patch()
    design = optimise(atoms, contrast(atoms), OVER, steps=12, compare=True)
    other = design.conventional
    assert other.model == 'conventional'
    assert other.given < other.value - 3  # it does not keep what it promises
    assert other.given < design.value - 3
    assert any('D0 alone' in words for words in design.words)


def test_one_number_of_the_whole_lattice_is_the_simplest_case():
    """The spacing for a wanted band edge, in closed form: omega^2 = 2 (a - 3) L^-(a + 1)."""
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    edge = BandEdge([0.5, 0, 0], below=1, sharp=np.inf)
    design = optimise(cell, edge.near(1.0, 0.01), {'spacing': (0.5, 2.0)}, steps=50)
    assert design.values['spacing'] == pytest.approx(2 ** (1 / 5), rel=1e-6)
    assert design.atoms.cell.lengths()[0] == pytest.approx(2 ** (1 / 5), rel=1e-6)


def test_groups_are_equal_and_sites_that_do_not_vary_stay():
    atoms = patch()
    groups = orbits(atoms, [[[1, 0], [0, -1]]])
    design = optimise(atoms, contrast(atoms), OVER, steps=5, groups=groups)
    for values in (design.values['strength'], design.values['spring']):
        for group in np.unique(groups):
            assert np.ptp(values[groups == group]) == 0
    np.testing.assert_allclose(design.atoms.positions[:, 1].mean(), atoms.positions[:, 1].mean(), atol=1e-9)
    one = int(places(atoms)[1].particle)
    few = optimise(atoms, contrast(atoms), OVER, steps=3, sites=[one])
    assert np.flatnonzero(few.values['strength'] != 1).tolist() == [one]
    with pytest.raises(ValueError, match='does not map the particles onto each other'):
        orbits(atoms, [[[0.8, 0.6], [-0.6, 0.8]]])


@pytest.mark.slow
def test_robust_and_of_parts():
    atoms, robust = patch(), Robust(Scatter(strength=0.02, stiffness=0.02), draws=6, width=1.0)
    plain = optimise(atoms, contrast(atoms), OVER, steps=12)
    design = optimise(atoms, contrast(atoms), OVER, steps=12, robust=robust, start=plain.x)
    assert np.quantile(design.drawn(robust, 100), 0.2) > np.quantile(plain.drawn(robust, 100), 0.2)
    grades, pillars = [0.86, 0.93, 1.0, 1.07, 1.14], [0.82, 0.94, 1.06, 1.2]
    bought = of_parts(design, {'strength': grades, 'spring': pillars}, robust, steps=4, exchanges=5)
    free = np.setdiff1d(np.arange(len(atoms)), atoms.constraints[0].index)
    for values, parts in ((bought.values['strength'], grades), (bought.values['spring'], pillars)):
        assert abs(values[free][:, None] - parts).min(1).max() < 1e-9
    assert bought.robust > design.robust - 15
    rounded = design.variables.rest(design.x).system.calc.strengths  # the control: the first design was not of parts
    assert abs(rounded[free][:, None] - grades).min(1).max() > 0.01


def test_a_build_list(tmp_path):
    atoms = patch()
    design = optimise(atoms, contrast(atoms), OVER, steps=2)
    tolerances = design.tolerances(Robust(Scatter(strength=0.01), draws=2))
    parts = {'strength': [0.5, design.values['strength'][places(atoms)[0].particle]]}
    write_build_list(tmp_path / 'list.csv', design, tolerances, parts)
    rows = list(csv.DictReader((tmp_path / 'list.csv').read_text().splitlines()))
    assert list(rows[0])[:5] == ['x_m', 'y_m', 'strength', 'stiffness_N_per_m', 'held']
    assert len(rows) == len(atoms)
    feet = np.array([[float(row['x_m']), float(row['y_m'])] for row in rows])
    np.testing.assert_allclose(feet * 1e3, (atoms.positions - atoms.positions.mean(0))[:, :2], atol=1e-6)
    springs = [float(row['stiffness_N_per_m']) for row in rows]
    np.testing.assert_allclose(springs, 20 * design.values['spring'], rtol=1e-8)
    assert [int(row['held']) for row in rows] == np.isin(np.arange(len(atoms)), atoms.constraints[0].index).astype(int).tolist()
    assert min(float(row['tolerance_strength']) for row in rows) > 0
    assert rows[places(atoms)[0].particle]['part_strength'] == '2'
    assert {row['part_strength'] for row in rows} == {'0', '2'}


def test_a_margin_is_kept():
    atoms, over = patch(), {'spring': (0.02, 1.2), 'strength': (0.9, 1.1)}
    variables = Variables(atoms, over)
    least = 0.9 * Margin().value(variables.rest(variables.present))
    soften = -1.0 * Margin()
    free = optimise(atoms, soften, over, steps=8)
    assert Margin().value(free.variables.rest(free.x)) < least  # the control, which is at half of it
    kept = optimise(atoms, soften, over, steps=8, constraints=[(Margin(), least)])
    assert Margin().value(kept.variables.rest(kept.x)) == pytest.approx(least, abs=2e-6)


@pytest.mark.parametrize('foundation', few_first([0.05, 0.2], 1))
def test_a_design_that_buckles_is_never_returned(foundation):
    """A square lattice, which its foundation alone holds: 4 f/L = 0.065 N/mm or so are needed."""
    atoms = lattices.square(10.0, 0.7).repeat((3, 3, 1))
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=foundation)
    soften = -1.0 * BandEdge([[0.5, 0.5, 0], [0, 0, 0]], 18, 'top')
    if foundation < 0.06:
        with pytest.raises(Unstable, match='the bounds exclude stable structures'):
            optimise(atoms, soften, {'spring': (0.9, 1.0)}, steps=5)
        return
    design = optimise(atoms, soften, {'spring': (0.1, 1.0)}, steps=20)
    assert design.value > design.before
    atoms = design.atoms
    springs = np.asarray(atoms.calc.foundation)
    assert critical_foundation(atoms)[0] <= springs.min() + 1e-9


def test_hostile_questions():
    atoms = patch()
    middle, right, _ = places(atoms)
    held = Dof(int(atoms.constraints[0].index[0]), X)
    level = Level(middle, right, 0.4, 0.02)
    with pytest.raises(ValueError, match='nothing can vary'):
        optimise(atoms, level, {})
    with pytest.raises(ValueError, match='nothing can vary'):
        optimise(atoms, level, OVER, sites=[])
    with pytest.raises(ValueError, match='its parts cancel'):
        optimise(atoms, level - level, OVER)
    with pytest.raises(ValueError, match=r'particle \d+ is held'):
        optimise(atoms, Level(middle, held, 0.4, 0.02), OVER)
    with pytest.raises(ValueError, match=r'two increasing positive factors, not 1\.2 and 0\.8'):
        optimise(atoms, level, {'strength': (1.2, 0.8)})
    with pytest.raises(ValueError, match='parameter of a design'):
        optimise(atoms, level, {'colour': (0.8, 1.2)})
    frozen = atoms.copy()
    frozen.set_constraint(FixAtoms(range(len(atoms))))
    frozen.calc = MagneticRepulsion(frozen, LAW, foundation=0.02)
    with pytest.raises(ValueError, match='the constraints hold every particle'):
        optimise(frozen, level, OVER)
    bare = patch(foundation=0.0)
    with pytest.raises(ValueError, match='there is none; give a foundation'):
        optimise(bare, level, {'spring': (0.8, 1.2)})
    far = optimise(atoms, Level(middle, right, 3.0, 0.02), {'strength': (0.9, 1.1)}, steps=2)
    assert any('outside the natural frequencies' in words for words in far.words)
    torn = optimise(atoms, Worst((level, -1.0 * level)), {'strength': (0.9, 1.1)}, steps=2)
    assert any('targets 1 and 2 contradict each other' in words for words in torn.words)
    apart = optimise(atoms, Worst((level, Level(middle, right, 0.5, 0.02))), {'strength': (0.9, 1.1)}, steps=2)
    assert not any('contradict' in words for words in apart.words)


def test_sites_and_parameters_that_are_none():
    """A mask was once read as the sites 0 and 1, numbers that are none as a lattice without a rest."""
    atoms = patch()
    middle, right, _ = places(atoms)
    objective = Level(middle, right, 0.4, 0.02)
    mask = np.random.default_rng(5).random(len(atoms)) < 0.3
    over = {'strength': (0.9, 1.1)}
    np.testing.assert_array_equal(Variables(atoms, over, np.flatnonzero(mask)).sites, np.flatnonzero(mask))
    for wrong in ([1.5], [len(atoms)], [-1], mask, [np.nan]):
        with pytest.raises(ValueError, match=r'sites'):
            Variables(atoms, over, wrong)
    for wrong in ({'groups': [0, 1]}, {'start': [0.0, 0.0]}, {'steps': 0}, {'constraints': [(objective, np.nan)]},
                  {'robust': Robust(Scatter(strength=0.01), draws=2, width=-1.0)}):
        with pytest.raises(ValueError, match=r'shape|whole number|finite|soft minimum'):
            optimise(atoms, objective, over, **wrong)
