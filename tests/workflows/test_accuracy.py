"""The work-precision harness: errors, counts, times, the Pareto front, the table; and the chart that shows them."""

import csv
from itertools import count

import numpy as np
import pytest
from measurements import point

from workflows import accuracy
from workflows.accuracy import (
    FLOOR,
    Candidate,
    Chart,
    cheapest,
    machine,
    measure,
    panels_of,
    pareto_front,
    plot_work_precision,
    save_chart,
    work_precision,
    write_table,
)


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


def test_timed_runs_are_interleaved_after_one_that_is_not_timed(monkeypatch):
    clock, ran = count(), []
    monkeypatch.setattr(accuracy, 'perf_counter', lambda: next(clock))
    table = measure([Candidate(name, '', lambda cost, name=name: ran.append(name) or 0.0) for name in 'ab'], float, repeats=3,
                    patience=10)
    assert ran == list('ab' * 4)
    assert next(clock) == 12  # two looks at the clock for each of 2 x 3 runs, none for the first
    assert [(m.seconds, m.median) for m in table] == [(1, 1), (1, 1)]


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


def test_the_table_holds_every_run_and_the_machine(tmp_path):
    table = [point(1, 1e-2, panel='N = 10'), point(2, 1e-1, panel='N = 10'), point(7, np.inf, panel='N = 20, chain')]
    path = tmp_path / 'table.csv'
    write_table(path, table, notes=['what it says'])
    lines = path.read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith('#')))
    assert [row['panel'] for row in rows] == ['N = 10', 'N = 10', 'N = 20, chain']
    assert [float(row['error']) for row in rows] == [1e-2, 1e-1, np.inf]
    assert [float(row['least_s']) for row in rows] == [1, 2, 7]
    assert [row['front'] for row in rows] == ['1', '0', '0']
    assert lines[-3] == '# what it says'
    assert lines[-2:] == [f'# {line}' for line in machine()]
    assert np.__version__ in lines[-1]


def test_the_chart_shows_the_table():
    table = [point(1, 1e-2, 'a'), point(2, 1e-4, 'a'), point(3, 1e-3, 'b'), point(5, np.inf, 'b'), point(9, 0.0, 'c')]
    ax = plot_work_precision(table)
    lines = {line.get_label(): line for line in ax.lines}
    np.testing.assert_array_equal(lines['a'].get_xydata(), [(1, 1e-2), (2, 1e-4)])
    np.testing.assert_array_equal(lines['b'].get_xydata(), [(3, 1e-3)])
    np.testing.assert_array_equal(lines['c'].get_xydata(), [(9, FLOOR)])
    np.testing.assert_array_equal(lines['Pareto front'].get_xydata(), [(1, 1e-2), (2, 1e-4), (9, FLOOR)])
    assert len({lines[m].get_marker() for m in 'abc'}) == 3  # told apart in grey


def test_a_chart_is_saved_with_its_table_and_its_reading(tmp_path):
    table = [point(1, 1e-2, 'a', panel='small'), point(2, 1e-3, 'b', panel='small'), point(5, 1e-2, 'b', panel='large')]
    chart = Chart('Which one', table, 'b is better.', error='error of it')
    path, caption = save_chart(chart, tmp_path, 'which')
    assert path.read_bytes().startswith(b'\x89PNG')
    assert caption == 'Which one. b is better.'
    assert '# b is better.' in (tmp_path / 'which.csv').read_text()
    assert list(panels_of(chart.measurements)) == ['small', 'large']
    figure = work_precision(chart)
    assert [ax.get_title(loc='left') for ax in figure.axes] == ['(a) small', '(b) large']
    assert figure.axes[0].get_ylabel() == 'error of it'
    looks = [{line.get_label(): line.get_marker() for line in ax.lines} for ax in figure.axes]
    assert looks[0]['b'] == looks[1]['b'] != looks[0]['a']
