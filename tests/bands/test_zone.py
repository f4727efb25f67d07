"""The first Brillouin zone against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from magphonon import lattices
from magphonon.bands import bloch
from magphonon.bands.bloch import first_zone


def area(corners):
    x, y = corners.T
    return 0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()


@pytest.mark.parametrize(('name', 'constant'), [('triangular', 1), ('honeycomb', np.sqrt(3)), ('kagome', 2)])
def test_hexagonal_zone_has_six_corners_at_K(name, constant):
    corners = first_zone(getattr(lattices, name)(10.0, 1.0).cell)
    K = 4 * np.pi / (3 * constant * 10.0)
    assert corners.shape == (6, 2)
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), K, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(np.roll(corners, 1, axis=0) - corners, axis=1), K, rtol=1e-12)


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
    monkeypatch.setattr(bloch, 'minkowski_reduce', lambda basis, pbc: (basis, None))
    assert area(first_zone(cell)) > 1.1 * (2 * np.pi) ** 2 / 90
