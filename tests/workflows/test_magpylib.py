"""The forces that the workflow `magnets` quotes are those of magpylib."""

import numpy as np
import pytest

from workflows.magnets import BY_MAGPYLIB, MAGNETS

MU0 = 4e-7 * np.pi


def face(magnet, n):
    """Points in m and weights in m^2 of a horizontal face: rings of Gauss points, or a grid of them."""
    x, weight = np.polynomial.legendre.leggauss(n)
    if 'diameter_m' not in magnet:
        (a, b, _), (u, v) = magnet['sides_m'], np.meshgrid(x, x, indexing='ij')
        return np.stack([a / 2 * u, b / 2 * v], axis=-1).reshape(-1, 2), np.outer(weight, weight).ravel() * a * b / 4
    outer, inner = magnet['diameter_m'] / 2, magnet['bore_m'] / 2
    angle, half = 2 * np.pi * np.arange(4 * n) / (4 * n), (outer - inner) / 2
    radius = inner + half * (x + 1)
    area = np.repeat(half * weight * radius * 2 * np.pi / (4 * n), 4 * n)
    return np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))], axis=-1).reshape(-1, 2), area


@pytest.mark.peer
@pytest.mark.parametrize('name', BY_MAGPYLIB)
def test_quoted_forces_are_those_of_its_field_on_the_faces(name):
    magpylib, given = pytest.importorskip('magpylib', minversion='6'), MAGNETS[name]
    J = (0, 0, given['remanence_T'])
    if 'diameter_m' in given:
        shape = (given['bore_m'] / 2, given['diameter_m'] / 2, given['height_m'], 0, 360)
        source = magpylib.magnet.CylinderSegment(polarization=J, dimension=shape)
    else:
        source = magpylib.magnet.Cuboid(polarization=J, dimension=given['sides_m'])
    points, area = face(given, 40)
    height = given['height_m'] if 'diameter_m' in given else given['sides_m'][2]
    for r, quoted in BY_MAGPYLIB[name].items():
        at = points + np.array([1e-3 * r, 0])
        top, bottom = (source.getB(np.insert(at, 2, z, axis=1))[:, 0] for z in (height / 2, -height / 2))
        force = given['remanence_T'] / MU0 * area @ (top - bottom)
        assert force == pytest.approx(quoted, rel=1e-8)
        assert force != pytest.approx(1.001 * quoted, rel=1e-8)
