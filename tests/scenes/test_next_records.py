"""The width foretold for one more record is that of a fit with both."""

import numpy as np
import pytest

from magphonon import read_scene
from magphonon.bands.bloch import bloch_modes
from magphonon.design.next_records import RANGES
from magphonon.scenes import fit_bands, fit_frf
from magphonon.waves import RidgePoints

from .test_frf_coverage import PLACES, specimen


def ridges(cell, xi, branch):
    """Points of a row source with noise of 0.3 %, which is drawn."""
    q, one = np.outer(xi / (2 * np.pi), [0, 1, 0]), np.ones(len(xi))
    omega = bloch_modes(cell, q)[0][np.arange(len(xi)), branch]
    noise = np.random.default_rng(len(xi)).standard_normal(len(xi))
    return RidgePoints(('1', '2'), ('transverse', 'longitudinal'), branch, q, xi, 0.01 * one, omega * (1 + 3e-3 * noise),
                       3e-3 * omega[0] * one, one, 0 * one, ('row', 'row'), 0.2 * one)


def test_one_more_burst():
    """Long waves of both branches, and then a burst of short ones."""
    scene = read_scene('prototype')
    cell, xi, branch = scene.perfect_cell(), np.tile(np.linspace(0.4, 1.5, 6), 2), np.repeat([0, 1], 6)
    found = fit_bands(scene, ridges(cell, xi, branch))
    told = [one for one in found.proposals if 'points of branch 1' in one.measurement]
    best = told[0]
    low, high = RANGES[-2:]
    at = bloch_modes(found.fitted().perfect_cell(), np.outer([low / (2 * np.pi), high / (2 * np.pi)], [0, 1, 0]))[0][:, 0]
    ends = 1e3 * np.sort(at) / (2 * np.pi)
    assert best.measurement == f'measure 4 points of branch 1 from {ends[0]:.3g} to {ends[1]:.3g} Hz'
    both = fit_bands(scene, ridges(cell, np.r_[xi, np.linspace(low, high, 4)], np.r_[branch, np.zeros(4, int)]))
    assert 1.96 * found.values()[best.quantity][1] == pytest.approx(best.now)
    assert 1.96 * both.values()[best.quantity][1] == pytest.approx(best.then, rel=0.1)
    assert best.then < 0.7 * best.now


@pytest.mark.slow
def test_one_more_receiver(tmp_path):
    """One receiver of a patch whose sites differ, and then the one that is proposed."""
    scene, functions, _ = specimen(tmp_path, 'triangular', 3, points=50)
    found = fit_frf(scene, functions[:2])
    best = next(one for one in found.proposals if one.measurement.startswith('measure along'))
    *_, axis, _, x, y, _ = best.measurement.replace('(', '').replace(')', '').replace(',', '').split()
    _, functions, _ = specimen(tmp_path, 'triangular', 3, points=50, places=(*PLACES, (float(x), float(y))))
    both = fit_frf(scene, [*functions[:2], functions[6 + 'xy'.index(axis)]])
    assert 1.96 * found.values()[best.quantity][1] == pytest.approx(best.now, rel=1e-3)
    assert 1.96 * both.values()[best.quantity][1] == pytest.approx(best.then, rel=0.25)  # the scatter is learned again
    assert best.then < 0.7 * best.now
