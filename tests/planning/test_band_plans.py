"""Plans for bands over lattices, laws and tolerances: no method is worse than told, by the exact sums over all neighbours."""

import numpy as np
import pytest
from ase import Atoms

from magphonon import InversePower, MagneticRepulsion, Yukawa, read_scene, ready_scene
from magphonon.planning import bands as planner, plan_bands
from magphonon.planning.scene import scene_plans
from workflows.situations import EDGES, Bands

LAWS = {'2': InversePower(1.0, 2.0), '3': InversePower(1.0, 3.0), '4.58': InversePower(1.0, 4.58), 'Yukawa': Yukawa(1.0, 1.0)}
FOUNDATIONS = {'chain': 8.0, 'square': 30.0, 'triangular': 1.0, 'honeycomb': 16.0, 'kagome': 16.0}
"""About as large as hold these lattices, so that the softest frequencies show every error."""
TOLERANCES = 1e-1, 1e-2, 1e-3
ROUND_OFF = 1e-9
"""Of the highest frequency: what is left where truth and estimate are the same sum."""


def situations():
    for kind, k in FOUNDATIONS.items():
        for law in ('2', 'Yukawa'):
            yield Bands(kind, LAWS[law], k)
    for kind, points in EDGES.items():
        for law in ('3', '4.58'):
            for point in points:
                yield Bands(kind, LAWS[law], FOUNDATIONS[kind], point)


def understated(found):
    """The methods of the plans whose true error is larger than they say, how many methods there are, the largest excess.

    The excess is that of the true error over the estimate, relative to it.
    """
    wrong, count, excess = [], 0, 0.0
    for situation in found:
        for tolerance in TOLERANCES:
            plan = situation.plan(tolerance)
            count += len(plan.methods)
            excess = max([excess, *(situation.truth(m) / m.error - 1 for m in plan.methods if m.error > 1e-6)])
            wrong += [(situation, m.name, situation.truth(m), m.at_most) for m in plan.methods
                      if situation.truth(m) > m.at_most + ROUND_OFF]
    return wrong, count, excess


@pytest.mark.slow
def test_no_method_of_eighty_plans_is_worse_than_told():
    wrong, count, excess = understated(situations())
    assert wrong == []
    assert count > 1000
    assert excess > planner.DOUBT / 3  # which is not far more than need be


def test_the_continuum_is_the_sum_over_what_lies_beyond():
    """Against a sum far beyond the reach, as far as that goes itself: it falls as R f(R), which leaves 1 in 40^2."""
    cell, law, R, far = Bands('triangular', LAWS['3'], 0.0)._with(1), LAWS['3'], 6.3, 250.0
    i, j = np.mgrid[-400:401, -400:401]
    r = np.hypot(i + j / 2, j * np.sqrt(3) / 2)
    r = r[(r > R) & (r < far)]
    summed = np.sum(law.d2phi(r) + law.dphi(r) / r) / 2
    spring = planner._continuum(cell, R, np.array([[0.31, 0.17, 0]]))[0]
    # the sum has an edge of whole particles, which lie within half a spacing of R: 1/(2 R) of it at the most
    np.testing.assert_allclose(spring, summed * np.eye(2), rtol=0.5 / R, atol=1e-12)
    np.testing.assert_allclose(planner._continuum(cell, R, np.zeros((1, 3)))[0], 0, atol=1e-12)


def _made(cell, shells):
    try:
        return len(MagneticRepulsion(cell, cell.calc.law, shells=shells).bonds) > 0
    except ValueError:
        return False


@pytest.mark.parametrize('seed', range(6))
def test_every_method_of_a_plan_can_be_made(seed):
    """Of nearly rectangular and oblique cells, a quarter of whose numbers of shells are refused."""
    rng, counts = np.random.default_rng(seed), []
    while not counts:
        vectors = np.diag([10.0, rng.choice([rng.uniform(8, 14), 11.0]), 20.0])
        vectors[1, 0] = rng.choice([0.05, 0.2, 0.5, rng.uniform(0, 5)])
        cell = Atoms('Nd', cell=vectors, pbc=(True, True, False), masses=[0.7])
        law = InversePower(1e4, rng.uniform(2, 6))
        try:
            cell.calc = MagneticRepulsion(cell, law, foundation=5.0, shells=int(rng.integers(1, 4)))
        except ValueError:
            continue
        path = cell.cell.bandpath('GX', npoints=20, pbc=cell.pbc)
        plan = plan_bands(cell, path, 10 ** rng.uniform(-1.8, -1))
        counts = [method.settings.shells for method in plan.methods if method.settings.shells != 'all']
    assert all(_made(cell, shells) for shells in counts)


def test_some_of_so_many_shells_cannot_be_made():
    """The control: what a plan would offer without looking."""
    cell = Atoms('Nd', cell=[[10.0, 0, 0], [0.2, 11, 0], [0, 0, 20]], pbc=(True, True, False), masses=[0.7])
    cell.calc = MagneticRepulsion(cell, InversePower(1e4, 4.0), foundation=5.0)
    for shells, clear in ((1, True), (2, True), (100, False)):
        assert _made(cell, shells) == clear


def test_a_table_that_ends_at_the_nearest_neighbours_is_no_reason_to_fail():
    scene = read_scene(ready_scene('measured'))
    longer = scene.model_copy(update={'law': read_scene(ready_scene('rings')).law})
    with pytest.raises(ValueError, match=r'no model here gives bands .* the law is not known farther'):
        _ = next(scene_plans(scene, 1e-2)).plan.choice  # nothing is known of them that would bound the error
    assert 'not known' not in next(scene_plans(longer, 0.5)).plan.report()
