"""Cells out of balance have no bands; relaxed ones have those of their rest."""

import pytest
from motion import LAW
from numpy.testing import assert_allclose

from magphonon import MagneticRepulsion, analytic_bands, critical_foundation, finite_displacements, lattices
from magphonon.stiffness import AllNeighbours


def skewed_cell(calculator=MagneticRepulsion):
    """A cell of two whose second particle stands off its place of symmetry."""
    cell = lattices.honeycomb(10.0, 0.7)
    cell.positions[1, 0] += 0.2
    cell.calc = calculator(cell, LAW) if calculator is AllNeighbours else calculator(cell, LAW, cutoff=12.0)
    return cell


@pytest.mark.parametrize('calculator', [MagneticRepulsion, AllNeighbours])
def test_a_cell_out_of_balance_has_no_bands(calculator):
    cell = skewed_cell(calculator)
    path = cell.cell.bandpath('GMKG', npoints=5, pbc=cell.pbc)
    for ask in (lambda: analytic_bands(cell, path), lambda: finite_displacements(cell), lambda: critical_foundation(cell)):
        with pytest.raises(ValueError, match='not at rest, as linear theory requires'):
            ask()


def test_what_becomes_of_a_cell_of_one_magnet_is_noticed():
    cell = lattices.triangular(10.0, 0.7)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=0.1)
    path = cell.cell.bandpath('GMKG', npoints=5, pbc=cell.pbc)
    squares = analytic_bands(cell, path).omega ** 2
    cell.calc.set(foundation=0.3)
    assert_allclose(analytic_bands(cell, path).omega ** 2, squares + 0.2 / 0.7, rtol=1e-14)
    cell.set_masses([1.4])
    assert_allclose(analytic_bands(cell, path).omega ** 2, (squares + 0.2 / 0.7) / 2, rtol=1e-14)
    cell.positions += [0.01, 0.0, 0.0]  # its images push it from both sides alike, but its pillar pulls
    with pytest.raises(ValueError, match='not at rest'):
        analytic_bands(cell, path)
    cell.calc.set(foundation=0.0)
    assert_allclose(analytic_bands(cell, path).omega ** 2, (squares - 0.1 / 0.7) / 2, atol=1e-14 * squares.max())
    cell.calc = cell.calc.about(cell, load=[[0.01, 0.0, 0.0]])
    with pytest.raises(ValueError, match='not at rest'):
        analytic_bands(cell, path)
