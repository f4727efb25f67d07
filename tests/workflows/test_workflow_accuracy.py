"""The charts of the linear questions: every method answers alike, and the sentence under a chart reads its table."""

from collections import Counter

import numpy as np
import pytest

from workflows import accuracy_frf, accuracy_transient


@pytest.fixture(scope='module')
def burst():
    return accuracy_transient.lattice(10)


# dt and rtol are as in the charts
@pytest.mark.parametrize(('method', 'setting', 'counter', 'error'), [
    ('series', (1e-12,), 'products', 1e-11), ('lanczos', (130,), 'products', 1e-11), ('dop853', (1e-7,), 'products', 1e-5),
    ('verlet', (0.1, 'ase'), 'force evaluations', 1e-2),
])
def test_every_method_of_the_transient_answers_alike_and_counts(burst, method, setting, counter, error):
    cost = Counter()
    found = burst.error(getattr(accuracy_transient, method)(burst, *setting, cost))
    assert found < error
    assert cost[counter] >= 1


def test_steps_converge_with_their_order(burst):
    errors = [burst.error(accuracy_transient.verlet(burst, share, 'ase', Counter())) for share in (0.2, 0.1)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.3)


@pytest.mark.slow
def test_every_method_of_the_response_answers_alike():
    shaken = accuracy_frf.patch(10)
    cost = Counter()
    assert shaken.error(accuracy_frf.series(shaken, 1e-9, cost)) < 1e-9
    assert shaken.error(accuracy_frf.modal(shaken, cost)) < 1e-9
    assert shaken.error(accuracy_frf.direct(shaken, 100, cost)) < 1e-9
    assert shaken.error(accuracy_frf.stepped(shaken, 0.05 * shaken.limit, cost)) < 0.03
    assert shaken.error(accuracy_frf.struck(shaken, 0.05 * shaken.limit, cost)) < 0.1
    assert set(cost) == {'products', 'eigensolves', 'force evaluations'}
