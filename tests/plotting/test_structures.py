"""The drawings of structures show the Atoms themselves, in the unit that suits them; the zone shows its irreducible part."""

from types import SimpleNamespace

import numpy as np
import pytest
from ase.constraints import FixAtoms
from cells import prototype
from figures import bands_of, drawn, ideal, legend_of, only, texts_of
from matplotlib.collections import EllipseCollection, PolyCollection
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.bands.bloch import first_zone
from magphonon.plotting.axes import prefix_power
from magphonon.plotting.structures import plot_lattice, plot_patch
from magphonon.plotting.zone import irreducible_zone, plot_zone


def area(corners):
    x, y = np.transpose(corners)
    return abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / 2


@pytest.fixture
def patch():
    """A patch whose rim and some particles within, drawn at random, are held."""
    rng = np.random.default_rng(8)
    patch = lattices.hexagon(lattices.triangular(10.0, 1.0), rng.uniform(30, 40))
    patch.set_constraint(FixAtoms(mask=(patch.get_tags() == lattices.RIM) | (rng.random(len(patch)) < 0.2)))
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    patch.positions[:, :2] += rng.normal(0, 0.3, (len(patch), 2))  # after its bonds are known
    return patch


def test_squares_stand_where_particles_are_held_and_circles_where_they_are_free(patch):
    ax = drawn(plot_patch(patch))
    held = patch.constraints[0].index
    circles = only(EllipseCollection, ax).get_offsets()
    squares = np.array([path.vertices[:4].mean(axis=0) for path in only(PolyCollection, ax).get_paths()])
    np.testing.assert_allclose(squares, patch.positions[held, :2] / 1000)  # mm in m
    np.testing.assert_allclose(circles, np.delete(patch.positions, held, axis=0)[:, :2] / 1000)
    assert legend_of(ax) == ['free', 'held']


def test_source_and_row_are_marked(patch):
    row, driven = np.array([3, 5, 8]), np.array([1])
    ax = drawn(plot_patch(patch, SimpleNamespace(row=row, driven=driven)))
    marked = [dots.get_offsets() for dots in ax.collections if isinstance(dots, EllipseCollection)][1:]
    for dots, particles in zip(marked, (row, driven), strict=True):
        np.testing.assert_allclose(dots, patch.positions[particles, :2] / 1000)
    assert legend_of(ax) == ['free', 'held', 'driven', 'measured']


def test_arrows_run_along_the_primitive_vectors():
    cell = prototype()
    ax = drawn(plot_lattice(cell))
    heads = [text.xy for text in ax.texts if text.arrow_patch is not None]
    np.testing.assert_allclose(heads, cell.cell.array[:2, :2] / 1000)
    assert {'$R_1$', '$R_2$'} <= texts_of(ax)


@pytest.mark.parametrize(('cell', 'unit'), few_first([(prototype, 'mm'), (ideal, 'm')], 1))  # 10 mm and 1 m apart
def test_places_are_printed_in_the_unit_of_the_spacing(cell, unit):
    ax = drawn(plot_lattice(cell()))
    assert (ax.get_xlabel(), ax.get_ylabel()) == (f'$x$ ({unit})', f'$y$ ({unit})')
    zone = drawn(plot_zone(bands_of(cell()).path))
    assert zone.get_xlabel() == f'$k_x$ (rad/{unit})'
    lengths = cell().cell.lengths()[0] * {'mm': 1, 'm': 1e-3}[unit]
    shown = [text.get_text() for text in ax.get_xticklabels() if abs(text.get_position()[0]) <= ax.get_xlim()[1]]
    largest = max(float(text.replace('\N{MINUS SIGN}', '-')) for text in shown)
    assert lengths <= largest <= 2.4 * lengths  # the window


def test_the_prefix_leaves_one_to_three_digits_also_of_a_rounded_metre():
    exact = {0.01: -3, 0.9999: -3, 1.0: 0, 1 - 1e-12: 0, 999.0: 0, 1e3: 3, 4e-7: -9, -5e6: 6, 0.0: 0}
    assert {value: prefix_power(value) for value in exact} == exact


@pytest.mark.parametrize(('lattice', 'copies'), [(lattices.triangular, 12), (lattices.honeycomb, 12), (lattices.square, 8)])
def test_copies_of_the_irreducible_part_fill_the_zone(lattice, copies):
    cell = lattice(np.random.default_rng(4).uniform(1, 20), 1.0)  # 12 and 8 are the orders of the groups 6mm and 4mm
    points = cell.cell.bandpath(npoints=0, pbc=cell.pbc).special_points
    part = irreducible_zone(points, cell.cell)
    assert area(part) * copies == pytest.approx(area(first_zone(cell.cell)), rel=1e-6)  # ASE's points carry eight digits
