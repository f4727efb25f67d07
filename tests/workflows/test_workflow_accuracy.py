"""The charts of the linear questions: every method answers alike, and the sentence under a chart reads its table."""

from collections import Counter

import numpy as np
import pytest
from measurements import point

from workflows import accuracy_frf, accuracy_transient
from workflows.accuracy_transient import SERIES, VERLET


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


def test_what_a_sample_costs_is_told_for_all():
    whole = accuracy_frf.whole(point(0.5, 0.1, setting='s'))
    assert (whole.seconds, whole.median, whole.error) == (50, 50, 0.1)
    assert '100 x a sample' in whole.setting


def test_the_sentence_under_the_transient_reads_the_table():
    table = [point(8.0, 5e-7, VERLET), point(1.0, 1e-2, VERLET, setting='coarse'), point(2.0, 1e-9, SERIES),
             point(1.6, 1e-8, 'Lanczos')]
    said = accuracy_transient.reading({'N = 5': table, 'N = 7': table[1:]})
    assert said.startswith('At N = 5, an error of 1e-06 takes Lanczos 1.6 s')
    assert '5 and 4 times as long; it is quicker only where an error of 0.01 will do' in said
    turned = [point(0.1, 1e-7, VERLET), *table[2:]]
    assert 'takes Verlet' in accuracy_transient.reading({'N = 5': turned})


def test_the_sentence_under_the_response_reads_the_table():
    magnet = [point(1e-5, 1e-15, 'closed form'), point(0.5, 1e-3, accuracy_frf.STEPPED)]
    patch = [point(200.0, 1e-2, accuracy_frf.STEPPED), point(0.1, 1e-3, accuracy_frf.SERIES),
             point(0.5, 1e-8, accuracy_frf.SERIES, setting='fine'), point(90.0, 1e-12, accuracy_frf.DIRECT),
             point(3.0, 5e-2, accuracy_frf.IMPULSIVE)]
    said = accuracy_frf.reading({'one magnet': magnet, 'N = 5': patch})
    assert '200 s for an error of 1e-02' in said
    assert '2000 times less' in said
    assert '0.5 s for 1e-08 (factorisations 90 s)' in said
