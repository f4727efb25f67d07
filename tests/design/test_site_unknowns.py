"""Sites with unknowns of their own: slopes and rest by differences, the evidence by its definition."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed
from magphonon.design import ParametricLattice, StiffnessDerivative, force_change
from magphonon.design.least_squares import Before
from magphonon.design.site_unknowns import SURE, Linear, Sites, _Problem, at_sites, scatter_factors, site_slopes
from magphonon.design.transfer_fits import solved
from magphonon.response import Dof
from magphonon.response.transfer_functions import TransferFunction
from magphonon.stiffness import LinearSystem
from magphonon.stiffness.defects import varied_sites

SCATTER = np.array([0.03, 0.05, 0.02])


@pytest.fixture(scope='module')
def built():
    """Two shells about a hole, a held rim, springs along x unlike those along y: its rest is none of the lattice."""
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.8), 30.0)
    del atoms[int(np.argmin(abs(np.linalg.norm(atoms.positions[:, :2], axis=1) - 10)))]
    law = InversePower(0.25 * 10.0**4.2, 4.2)
    atoms.calc = MagneticRepulsion(atoms, law, cutoff=18.0, foundation=[[0.02, 0.03]])
    changes = {'force': StiffnessDerivative(law=force_change(law)), 'kx': StiffnessDerivative(foundation=np.array([[0.02, 0]]))}
    return ParametricLattice(LinearSystem.of(relaxed(atoms).atoms), 0.02, changes)


def test_slopes_are_those_of_differences(built, monkeypatch):
    """Of a force and of a shaken bench, at sites that are off already; without the motion of the rest the check fails."""
    sites, omega = Sites.of(built.system), np.linspace(0.1, 0.7, 9)
    z = np.random.default_rng(2).standard_normal(sites.ends[2])  # of 0 two particles meet beside the hole
    free = np.flatnonzero(built.system.mobile)
    functions = [TransferFunction(f'{drive}', omega, 0j * omega, 1.0, 0, Dof(free[3], (0.6, 0.8, 0)), drive,
                                  shaken=not isinstance(drive, Dof))
                 for drive in (Dof(free[0], (1, 0, 0)), np.array([0.6, 0.8, 0]))]

    def h(z):
        return np.concatenate([one.h for one in solved(at_sites(built, sites, z, SCATTER), functions)[1]])

    here = at_sites(built, sites, z, SCATTER)
    slopes = site_slopes(here, *solved(here, functions), sites, SCATTER)
    picked = np.random.default_rng(1).choice(len(z), 12, replace=False)
    by_difference = np.transpose([(h(z + 1e-4 * one) - h(z - 1e-4 * one)) / 2e-4 for one in np.eye(len(z))[picked]])
    size = abs(by_difference).max()
    assert_allclose(slopes[:, picked], by_difference, rtol=0, atol=1e-5 * size)
    monkeypatch.setattr(Sites, 'moves', lambda sites, system: np.zeros((sites.tied.size, sites.ends[2])))
    assert abs(site_slopes(here, *solved(here, functions), sites, SCATTER)[:, picked] - by_difference).max() > 1e-2 * size


def test_no_site_is_out_of_all_proportion(built):
    """Steps of a fit to data of another structure end there; once they ended in an overflow of the exponential."""
    sites, rng = Sites.of(built.system), np.random.default_rng(3)
    for kind in (0, 1):
        z = np.zeros(sites.ends[2])
        z[rng.choice(np.flatnonzero(sites.kinds == kind))] = 1e5 * rng.choice([-1, 1])
        with pytest.raises(ValueError, match='a site is more than 10 times as strong'):
            at_sites(built, sites, z, SCATTER)


def test_the_rest_is_that_of_relaxed_sites(built):
    """Of strengths, springs, and places of pillars and walls, however large; to first order it would be off."""
    sites = Sites.of(built.system)
    z = np.random.default_rng(2).standard_normal(sites.ends[2])
    strengths, springs, anchors = sites.parts(z, SCATTER)
    assert sites.acting.all()
    other = varied_sites(built.system.atoms, mass=1.0, strength=np.exp(strengths), stiffness=np.ones(len(strengths)),
                         moved=np.pad(anchors, ((0, 0), (0, 1))))
    other.calc = other.calc.changed(sites=replace(other.calc.sites, foundation=np.array([0.02, 0.03]) * np.exp(springs)))
    expected, found = (x[:, :2] for x in (relaxed(other).atoms.positions,
                                          at_sites(built, sites, z, SCATTER).system.atoms.positions))
    assert_allclose(found, expected, rtol=0, atol=1e-8)
    first = built.system.atoms.positions[:, :2] + (sites.moves(built.system) @ (sites.size(SCATTER) * z)).reshape(-1, 2)
    assert abs(first - expected).max() > 0.02  # mm; the control


def test_the_scatter_with_the_largest_evidence():
    """That of |r|^2 under the covariance 1 + A t^2 A^T, with a parameter integrated out, on a grid; drawn with twice and half."""
    rng = np.random.default_rng(3)
    A, J = rng.standard_normal((150, 80)), rng.standard_normal((150, 1))
    kinds, true = np.repeat([0, 1], 40), np.array([2.0, 0.5])
    z0 = true[kinds] * rng.standard_normal(80)
    r = A @ z0 + rng.standard_normal(150) + 5 * J[:, 0]
    found, determined, gained = scatter_factors(Linear(r, J, A), np.zeros(80), kinds, np.zeros(2))

    def evidence(t):
        C = np.eye(150) + A * t[kinds] ** 2 @ A.T
        inside = J.T @ np.linalg.solve(C, J)
        left = r - J[:, 0] * (J[:, 0] @ np.linalg.solve(C, r) / inside[0, 0])
        before = np.sum((np.log(t) / SURE) ** 2)
        return -(np.linalg.slogdet(C)[1] + np.log(inside[0, 0]) + left @ np.linalg.solve(C, left) + before) / 2

    best = evidence(found)
    assert all(evidence(found * t) < best for t in np.exp(0.03 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])))
    assert abs(np.log(found / true)).max() < 0.6  # 40 of each tell it to 11 %
    assert 60 < determined < 80
    alone = evidence(np.full(2, 1e-9)) + np.sum((np.log(1e-9) / SURE) ** 2)  # without what is known of the scatter
    assert_allclose(gained, best + np.sum((np.log(found) / SURE) ** 2) / 2 - alone, rtol=1e-6)
    assert evidence(np.ones(2)) < best - 10


def test_a_step_after_which_magnets_touch_is_shortened(built):
    """The lattice of the first trial is refused, as that of a law which begins at a distance would be."""
    sites, omega, built_so_often = Sites.of(built.system), np.linspace(0.1, 0.7, 30), []
    free = np.flatnonzero(built.system.mobile)
    seen = TransferFunction('one', omega, 0j * omega, 1.0, 0, Dof(free[3], (0.6, 0.8, 0)), Dof(free[0], (1, 0, 0)))
    (there,) = solved(at_sites(built, sites, np.random.default_rng(4).standard_normal(sites.ends[2]), SCATTER), [seen])[1]
    measured = replace(seen, response=there.h, sigma=0.01 * abs(there.h).max())

    def build(_):
        built_so_often.append(1)
        if len(built_so_often) == 2:
            raise ValueError('two such magnets are too close')
        return built

    one = _Problem([measured], Before.of(('gain',), None), 1.0, build, ('gain',), sites, SCATTER)
    start = one.place(np.zeros(1), np.zeros(sites.ends[2]))
    r, before = (one.residuals(place) for place in (one.descended(start, 20, 1e-3), start))
    assert r @ r < 0.05 * before @ before
