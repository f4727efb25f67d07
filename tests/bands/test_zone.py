"""The first Brillouin zone against closed forms, and frequencies over it against the paper's."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from magphonon import InversePower, MagneticRepulsion, lattices, units as u
from magphonon.bands import group_velocities, zone
from magphonon.bands.zone import first_zone, frequency_ratio, zone_map

STEPS = 24  # a multiple of 6: M and K lie on the mesh
HALF = STEPS // 2


def with_dipoles(cell, foundation=0.0, **bonds):
    """Sec. IV of the paper: f = 1e4 N m^4 r^-4 on particles of 1 kg, 1 m apart."""
    cell.calc = MagneticRepulsion(cell, InversePower(b=1e4 * u.N * u.m**4, a=4), foundation=foundation * u.N / u.m, **bonds)
    return cell


def ideal(lattice=lattices.triangular, foundation=0.0, **bonds):
    return with_dipoles(lattice(1 * u.m, 1 * u.kg), foundation, **bonds)


@pytest.fixture(scope='module')
def complete():
    return zone_map(ideal(), STEPS)


@pytest.fixture(scope='module')
def conventional():
    return zone_map(ideal(), STEPS, model='conventional')


def at(zone_map, values, i, j):
    """Values at the wavevector (i, j) / STEPS, in fractions of the reciprocal vectors."""
    n1, n2 = (size // 2 for size in zone_map.q.shape[:2])
    return values[n1 + i, n2 + j]


def area(corners):
    x, y = corners.T
    return 0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()


# ---- the polygon ----

@given(x=st.floats(-30, 30), y=st.floats(2, 30))
@settings(max_examples=50, deadline=None)
def test_any_cell_has_a_zone_of_the_right_area_with_every_corner_nearest_to_gamma(x, y):
    cell = np.array([[10.0, 0, 0], [x, y, 0], [0, 0, 20]])
    corners = first_zone(cell)
    assert area(corners) == pytest.approx((2 * np.pi) ** 2 / (10 * y), rel=1e-9)  # corners of acute angles are ill-conditioned
    G = np.stack(np.meshgrid(*2 * [np.arange(-20, 21)]), axis=-1).reshape(-1, 2) @ (2 * np.pi * np.linalg.inv(cell).T)[:2, :2]
    distances = np.linalg.norm(corners[:, None] - G, axis=-1)
    np.testing.assert_array_less(np.linalg.norm(corners, axis=1), distances.min(axis=1) * (1 + 1e-9))


def test_control_without_a_reduced_basis_the_zone_of_a_skew_cell_is_wrong(monkeypatch):
    cell = np.array([[10.0, 0, 0], [57, 9, 0], [0, 0, 20]])
    assert area(first_zone(cell)) == pytest.approx((2 * np.pi) ** 2 / 90, rel=1e-9)
    monkeypatch.setattr(zone, 'minkowski_reduce', lambda basis, pbc: (basis, None))
    assert area(first_zone(cell)) > 1.1 * (2 * np.pi) ** 2 / 90


# ---- the mesh ----

@pytest.mark.parametrize('lattice', [lattices.triangular, lattices.square, lattices.honeycomb])
def test_mesh_covers_the_zone_and_little_more(lattice):
    zone_of = zone_map(ideal(lattice, 1e6), STEPS)
    reach = abs(first_zone(zone_of.cell) @ zone_of.cell[:2, :2].T).max(axis=0) / (2 * np.pi)
    covered = zone_of.q.max(axis=(0, 1))[:2]
    assert (covered >= reach - 1e-9).all()
    assert (covered < reach + 1 / STEPS).all()
    assert (zone_of.q.min(axis=(0, 1))[:2] == -covered).all()
    omega, velocity = group_velocities(ideal(lattice, 1e6), zone_of.q[2, 5])  # each at its own wavevector
    np.testing.assert_allclose(zone_of.omega[2, 5], omega[0])
    np.testing.assert_allclose(zone_of.velocity[2, 5], velocity[0])


# The six M and K of the 60-degree basis, in units of 1/STEPS.
M = [(0, HALF), (HALF, 0), (HALF, HALF), (0, -HALF), (-HALF, 0), (-HALF, -HALF)]


# ---- complete over conventional ----

def test_ratio_at_M_and_its_limit_at_gamma(complete, conventional):
    ratio = frequency_ratio(complete, conventional)
    for point in M:
        np.testing.assert_allclose(at(complete, ratio, *point), [0.5, np.sqrt(22 / 24)], rtol=1e-11)  # of (2a-6)/2a, (6a-2)/6a
    # no foundation: 0/0 at Gamma and at no other point of this zone but its images
    assert np.isnan(at(complete, ratio, 0, 0)).all()
    assert np.isnan(ratio).sum() == 2 * (abs(complete.q - np.round(complete.q)).max(axis=-1) == 0).sum()
    # the limit, sound speeds in m/s from sqrt(3/8 (a - 3) f L/M) and the like; one step off Gamma (k L)^2 is 0.09
    limit = [61.237243569579 / 122.47448713916, 203.1009601159 / 212.13203435596]
    np.testing.assert_allclose(at(complete, ratio, 1, 0), limit, rtol=0.01)


def test_unstable_modes_have_a_negative_ratio_and_soft_conventional_ones_none():
    # Square lattice of nearest neighbours: along (q, 0) the conventional shear mode vanishes, the complete one grows.
    cell = ideal(lattices.square)
    complete, conventional = zone_map(cell, STEPS), zone_map(cell, STEPS, model='conventional')
    ratio = frequency_ratio(complete, conventional)
    on_axis = (complete.q == 0).sum(axis=-1) > 1  # the third component is zero everywhere
    assert (np.isnan(ratio[..., 0]) == on_axis).all()
    assert at(complete, ratio, HALF, 1)[0] < -1  # -4 f/(L M) against a conventional frequency near zero
    at_X = at(complete, complete.omega, HALF, 0) * u.s
    np.testing.assert_allclose(at_X, [-200, 400], rtol=1e-12)  # -sqrt(4 f/(L M)), sqrt(4 a f/(L M))


# ---- files and errors ----

def test_maps_of_lattices_of_a_micrometre_are_drawn():
    from magphonon.plotting import plot_ratio

    cell = lattices.triangular(1e-6 * u.m, 1e-12)
    cell.calc = MagneticRepulsion(cell, InversePower(b=1e-12, a=4.0), foundation=1e-3)
    maps = zone_map(cell, 12), zone_map(cell, 12, 'conventional')
    assert {'Γ', 'M', 'K'} <= {text.get_text() for text in plot_ratio(*maps, 0).texts}
