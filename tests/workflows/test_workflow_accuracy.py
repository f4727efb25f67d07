"""The charts of the linear questions: every method answers alike, and the sentence under a chart reads its table."""

from collections import Counter

import numpy as np
import pytest

from workflows import accuracy_frf, accuracy_transient


@pytest.fixture(scope='module')
def burst():
    return accuracy_transient.lattice(10, periodic=False)


# dt and rtol are as in the charts; the fourth order counts its longest stage
@pytest.mark.parametrize(('method', 'setting', 'counter', 'error'), [
    ('series', (1e-12,), 'products', 1e-11), ('modal', (), 'eigensolves', 1e-11), ('lanczos', (130,), 'products', 1e-11),
    ('exponential', (), 'products', 1e-8), ('dop853', (1e-7,), 'products', 1e-5), ('symplectic', (0.1,), 'products', 1e-4),
    ('verlet', (0.1, 'numpy'), 'force evaluations', 1e-2), ('verlet', (0.1, 'ase'), 'force evaluations', 1e-2),
])
def test_every_method_of_the_transient_answers_alike_and_counts(burst, method, setting, counter, error):
    cost = Counter()
    found = burst.error(getattr(accuracy_transient, method)(burst, *setting, cost))
    assert found < error
    assert cost[counter] >= 1


@pytest.mark.parametrize(('method', 'coarse', 'fine', 'order'), [('verlet', 0.1, 0.05, 2), ('symplectic', 0.2, 0.1, 4)])
def test_steps_converge_with_their_order(burst, method, coarse, fine, order):
    more = ('numpy',) if method == 'verlet' else ()
    errors = [burst.error(getattr(accuracy_transient, method)(burst, share, *more, Counter())) for share in (coarse, fine)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)


def test_a_periodic_lattice_is_a_sum_of_bloch_waves():
    periodic = accuracy_transient.lattice(10, periodic=True)
    assert periodic.error(accuracy_transient.fourier(periodic, Counter())) < 1e-11
    held = accuracy_transient.lattice(10, periodic=False)
    assert held.error(accuracy_transient.fourier(held, Counter())) > 0.1  # where it does not apply


def test_every_method_of_the_response_answers_alike():
    shaken = accuracy_frf.patch(10)
    cost = Counter()
    assert shaken.error(accuracy_frf.series(shaken, 1e-9, cost)) < 1e-9
    assert shaken.error(accuracy_frf.modal(shaken, cost)) < 1e-9
    assert shaken.error(accuracy_frf.direct(shaken, 100, cost)) < 1e-9
    assert shaken.error(accuracy_frf.stepped(shaken, 0.05 * shaken.limit, cost)) < 0.03
    assert shaken.error(accuracy_frf.struck(shaken, 0.05 * shaken.limit, cost)) < 0.1
    assert set(cost) == {'products', 'eigensolves', 'force evaluations'}
