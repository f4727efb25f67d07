"""Couplings of both signs: strengths and laws that attract, against energies written out, and what refuses them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, critical_foundation, lattices, relaxed, verdict
from magphonon.bands.bloch import bloch_modes
from magphonon.stiffness import AllNeighbours, substituted

LAW = InversePower(b=0.2 * 10.0**4, a=4.0)


class Springs:
    """Springs of stiffness 1 between neighbours and -1/2 between second neighbours, slack at rest."""

    def phi(self, r):
        near = np.real(r) < 1.5
        return np.where(near, 1.0, -0.5) * (r - np.where(near, 1.0, 2.0)) ** 2 / 2

    def dphi(self, r):
        near = np.real(r) < 1.5
        return np.where(near, 1.0, -0.5) * (r - np.where(near, 1.0, 2.0))

    def d2phi(self, r):
        return np.where(np.real(r) < 1.5, 1.0, -0.5) + 0 * r


@pytest.mark.parametrize('k', [0.0, 0.3, 0.499, 0.501])
def test_a_chain_of_both_signs_buckles_at_a_sixth_of_a_turn(k):
    chain = lattices.chain(1.0, 1.0)
    chain.calc = MagneticRepulsion(chain, Springs(), shells=2, foundation=k)
    needed, q = critical_foundation(chain)
    assert needed == pytest.approx(0.5, rel=1e-9)
    assert abs(q[0]) == pytest.approx(1 / 6, abs=1e-6)
    xi = np.linspace(0.05, 3.1, 40)
    along = bloch_modes(chain, np.stack([xi / (2 * np.pi), 0 * xi, 0 * xi], axis=1))[0]
    true = k - 2 * np.cos(xi) * (1 - np.cos(xi))
    expected = np.sort(np.stack([true, k + 0 * xi]), axis=0)  # across the chain nothing is strained
    assert_allclose((along * abs(along)).T, expected, atol=1e-12)
    assert ('OK' in str(verdict(chain))) == (k > 0.5)


def test_a_magnet_upside_down_comes_to_rest_nearer_to_its_neighbours():
    patch = lattices.hexagon(lattices.triangular(10.0, 0.7), 30.0)
    patch.calc = MagneticRepulsion(patch, LAW, foundation=0.5)
    middle = int(np.linalg.norm(patch.positions - patch.positions.mean(axis=0), axis=1).argmin())
    rest = relaxed(substituted(patch, middle, strength=-0.5)).atoms
    beside = np.sort(np.linalg.norm(rest.positions - rest.positions[middle], axis=1))[1:7]
    weaker = relaxed(substituted(patch, middle, strength=0.5)).atoms
    assert beside.max() < np.sort(np.linalg.norm(weaker.positions - weaker.positions[middle], axis=1))[1] < 10


def test_the_sum_over_all_neighbours_is_one_of_repulsion():
    two = lattices.chain(10.0, 1.0).repeat((2, 1, 1))
    with pytest.raises(ValueError, match=r'strengths\[1\] = -1: the sum over all neighbours supports repulsion only'):
        AllNeighbours(two, LAW, strengths=[1, -1])
