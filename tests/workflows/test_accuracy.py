"""The work-precision harness: errors, counts, times, the Pareto front, the table; and the chart that shows them."""


import numpy as np
import pytest
from measurements import point

from workflows.accuracy import Candidate, cheapest, measure, pareto_front


def trapezoid(n, cost):
    """Integral of sin from 0 to pi, which is 2."""
    cost['products'] += n
    x = np.linspace(0, np.pi, n + 1)
    return np.trapezoid(np.sin(x), x)


def test_errors_and_counts_are_those_of_one_run():
    steps = (10, 20, 40)
    table = measure([Candidate('trapezoid', f'{n} steps', lambda cost, n=n: trapezoid(n, cost)) for n in steps],
                    error=lambda answer: abs(answer - 2), repeats=3)
    errors = [m.error for m in table]
    # h^2/12 [f'(pi) - f'(0)] = -(pi/n)^2/6; the next term is (pi/n)^2/60 of it
    np.testing.assert_allclose(errors, [(np.pi / n) ** 2 / 6 for n in steps], rtol=2e-3)
    assert [m.cost for m in table] == [{'force evaluations': 0, 'products': n, 'eigensolves': 0} for n in steps]
    assert [m.setting for m in table] == ['10 steps', '20 steps', '40 steps']


@pytest.mark.parametrize('answer', [np.nan, np.inf])
def test_a_run_that_went_astray_has_an_infinite_error(answer):
    (lost,) = measure([Candidate('lost', '', lambda cost: answer)], float, repeats=1)
    assert lost.error == np.inf
    assert cheapest([lost], 1e9) is None
    assert pareto_front([lost]) == []


def test_the_front_holds_what_no_other_beats():
    table = [point(1, 1e-2), point(2, 1e-2), point(2, 1e-4), point(3, 1e-3), point(4, 1e-9), point(0.5, 1), point(1, 1e-1)]
    assert [(m.seconds, m.error) for m in pareto_front(table)] == [(0.5, 1), (1, 1e-2), (2, 1e-4), (4, 1e-9)]
    beaten = [m for m in table if m not in pareto_front(table)]
    for m in beaten:  # by definition: another one is no slower and no worse, and better in one of them
        assert any(o.seconds <= m.seconds and o.error <= m.error and o != m for o in table)
