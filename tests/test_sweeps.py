"""Sweeps: order and units of the grid, equal bits on processes and on Dask, failing points, and the code of its page."""

import doctest
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from structures import few_first

from magphonon import sweep

pytest.importorskip('xarray')
PAGE = Path(__file__).parents[1] / 'docs/reference/sweep.md'
GRID = {'x': [0.3, 0.1, 0.2], 'y': [0.0, 1.0]}


def formula(x, y):
    """Two answers with bits that another order of sums would change, an array among them."""
    matrix = np.sin(np.arange(1, 14401).reshape(120, 120) * x) + y
    return {'trace': np.trace(matrix @ matrix), 'row': np.cumsum((matrix @ matrix)[0])[::30]}


def test_answers_stand_where_the_axes_say():
    found = sweep(formula, GRID, units={'x': 'mm', 'trace': 'N'})
    assert found.row.dims == ('x', 'y', 'row_0')
    for i, x in enumerate(GRID['x']):
        for j, y in enumerate(GRID['y']):
            assert_allclose(found.trace[i, j], formula(x, y)['trace'], rtol=1e-12)
            assert_allclose(found.row.sel(x=x, y=y), formula(x, y)['row'], rtol=1e-9, atol=1e-9)
    assert_array_equal(found.x, GRID['x'])  # in the order that was given
    assert [found[name].attrs for name in ('x', 'y', 'trace', 'row')] == [{'units': 'mm'}, {}, {'units': 'N'}, {}]


def test_values_may_be_words_whole_numbers_and_complex():
    found = sweep(lambda kind, n: len(kind) * n * 1j, {'kind': ['chain', 'fcc'], 'n': np.arange(1, 3)})
    assert_array_equal(found.value, [[5j, 10j], [3j, 6j]])


def test_processes_compute_the_same_bits():
    assert sweep(formula, GRID, workers=2).identical(sweep(formula, GRID))


def failing(x, y):
    if x == 0.2:
        raise ZeroDivisionError('no answer')
    return x + y


@pytest.mark.parametrize('workers', few_first([None, 2], 1))
def test_an_error_names_the_point(workers):
    with pytest.raises(ZeroDivisionError) as caught:
        sweep(failing, GRID, workers=workers)
    first = GRID['y'] if workers else GRID['y'][:1]  # in one process the first point, else that of whichever worker comes first
    assert caught.value.__notes__ in [[f'at x = 0.2, y = {y}'] for y in first]


@pytest.mark.parametrize(('f', 'error', 'words'), [
    (lambda x: None, TypeError, 'returns a number'), (lambda x: {'x': x}, TypeError, 'names that are not those of the axes'),
    (lambda x: np.zeros(int(x)), ValueError, r'value has the shapes \[\(1,\), \(2,\)\] at different points')])
def test_answers_that_fit_into_no_dataset_are_refused(f, error, words):
    with pytest.raises(error, match=words):
        sweep(f, {'x': [1.0, 2.0]})


@pytest.mark.parametrize('grid', [{}, {'x': []}, {'x': [1.0, 1.0]}, {'x': [[1.0, 2.0]]}])
def test_grids_that_are_none_are_refused_before_anything_is_computed(grid):
    with pytest.raises(ValueError, match=r'no axis|different values'):
        sweep(pytest.fail, grid)


@pytest.mark.slow
@pytest.mark.filterwarnings('ignore::DeprecationWarning', 'ignore::ResourceWarning')
def test_the_code_of_the_page_runs_and_dask_computes_the_same_bits():
    pytest.importorskip('distributed')
    names = {'__name__': '__main__'}
    blocks = re.findall(r'```python\n(.*?)```', PAGE.read_text(encoding='utf-8'), re.S)
    assert len(blocks) == 3
    for block in blocks:
        exec(block, names)
    found = names['found']  # shear at M by the paper's formula, omega^2 = (k + (2a - 6) f/L)/m
    k, a = np.meshgrid(names['grid']['foundation'], names['grid']['a'])
    squared = (k + (2 * a - 6) * 0.2369 / 0.01) / 0.707e-3
    assert_array_equal(found.stable, squared > 0)
    assert_allclose(found.shear, np.sign(squared) * np.sqrt(abs(squared)) / (2 * np.pi), rtol=1e-9)
    assert names['again'].identical(found)
    assert 20 < names['of_scene'].value.max() < 40


def test_the_example_of_the_docstring():
    [test] = doctest.DocTestFinder(recurse=False).find(sweep, 'sweep', globs={})
    assert doctest.DocTestRunner().run(test) == (0, 5)
