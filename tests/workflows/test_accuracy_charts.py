"""What the charts of speed against accuracy compare with: their references, by other means."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from magphonon import MagneticRepulsion, read_scene, units
from magphonon.scenes import ready_scene
from magphonon.scenes.scene import reference
from workflows import accuracy_bands, accuracy_nonlinear


@pytest.fixture
def prototype():
    return read_scene(ready_scene('prototype')).atoms()


def test_closed_form_has_the_papers_frequencies(prototype):
    numbers = reference()['prototype']
    q = np.array([[0, 0, 0], [1 / 2, 0, 0], [2 / 3, 1 / 3, 0]])
    found = accuracy_bands.closed_form(prototype, q) / (2 * np.pi) / units.Hz
    # the reference has ten digits; the double root at K splits by the root of the round-off of 1/3
    assert_allclose(found, [[numbers['gamma_Hz']] * 2, numbers['M_complete_Hz'], [numbers['K_complete_Hz']] * 2], rtol=1e-9)
    assert abs(found[1] / numbers['M_conventional_Hz'] - 1).max() > 0.3


def test_folded_bands_are_those_of_the_large_cell(prototype):
    q = np.array([[0.21, 0.13, 0]])
    large = prototype.repeat((3, 3, 1))
    large.calc = MagneticRepulsion(large, prototype.calc.laws, **prototype.calc.parameters)
    found = accuracy_bands.folded(prototype, q, 3)
    assert_allclose(found, accuracy_bands.dense(large, q, {'eigensolves': 0}), rtol=1e-12)
    assert abs(found / accuracy_bands.folded(prototype, q + 0.1, 3) - 1).max() > 0.01


def test_acceleration_of_the_pluck_is_the_calculators():
    pluck = accuracy_nonlinear.Pluck(accuracy_nonlinear.patch_of(7), 0.05)
    atoms = pluck.patch.copy()
    atoms.calc = pluck.patch.calc
    atoms.positions[:, :2] += pluck.start
    expected = atoms.get_forces()[pluck.free, :2] / atoms.get_masses()[0]
    found = pluck.acceleration(pluck.start[pluck.free])
    assert_allclose(found, expected, atol=1e-13 * abs(expected).max())
    assert abs(found + pluck.acceleration(-pluck.start[pluck.free])).max() > 0.01 * abs(found).max()  # it is not linear
