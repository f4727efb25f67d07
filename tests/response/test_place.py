"""A place: a particle and a direction."""

import numpy as np

from magphonon.response.frf import Dof


def test_a_force_at_a_place_and_what_is_seen_there():
    place = Dof(2, [0.6, 0.8, 0.0])
    np.testing.assert_array_equal(place.force(4), [[0, 0, 0], [0, 0, 0], [0.6, 0.8, 0], [0, 0, 0]])
    u = np.arange(24.0).reshape(2, 4, 3)
    np.testing.assert_allclose(place.seen(u), u[:, 2, 0] * 0.6 + u[:, 2, 1] * 0.8)
    np.testing.assert_allclose(place.seen(u[..., :2]), place.seen(u))  # planar displacements have two components
