"""The first Brillouin zone against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from magphonon.bands import bloch
from magphonon.bands.bloch import first_zone


def area(corners):
    x, y = corners.T
    return 0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()


@given(x=st.floats(-30, 30), y=st.floats(2, 30))
@settings(max_examples=15, deadline=None)
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
