"""Eigenvalues counted by the signs of pivots, against dense algebra, in structures drawn at random."""

import numpy as np
import pytest
from scipy import sparse

from magphonon import InversePower, MagneticRepulsion, lattices, modes
from magphonon.stiffness import LinearSystem
from magphonon.stiffness.lowest import count_below


def drawn(seed):
    """A patch with holes, masses drawn and a rim that is free or held; half of them buckle."""
    rng = np.random.default_rng(seed)
    cell = (lattices.honeycomb, lattices.kagome, lattices.triangular, lattices.square)[seed % 4](1.0, 1.0)
    patch = lattices.hexagon(cell, rng.uniform(6, 9))
    held = patch.constraints
    patch.set_constraint()
    keep = np.sort(rng.permutation(len(patch))[: int(0.9 * len(patch))])
    rim = np.isin(keep, held[0].index)
    patch = patch[keep]
    patch.set_masses(rng.uniform(0.5, 1.5, len(patch)))
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, rng.uniform(1.5, 6)), cutoff=1.2,
                                   foundation=rng.uniform(0, 3)).balanced(range(len(patch)))
    if seed % 2:
        patch.set_constraint(type(held[0])(mask=rim))
    return patch


@pytest.mark.parametrize('seed', range(8))
def test_modes_below_any_frequency(seed):
    """Between all neighbours of the spectrum in turn, where they are apart by more than round-off."""
    system = LinearSystem.of(drawn(seed))
    omega = modes(system).omega
    squares = np.sign(omega) * omega**2
    apart = np.flatnonzero(np.diff(squares) > 1e-9 * squares[-1])
    for k in np.random.default_rng(seed).choice(apart, 20):
        middle = (squares[k] + squares[k + 1]) / 2
        assert count_below(system.K, middle) == k + 1
    below, above = squares[0] - squares[-1], 2 * squares[-1]
    assert (count_below(system.K, below), count_below(system.K, above)) == (0, len(omega))
    # the control: the signs of the diagonal alone
    middle = (squares[apart[len(apart) // 2]] + squares[apart[len(apart) // 2] + 1]) / 2
    assert (system.K.diagonal() < middle).sum() != apart[len(apart) // 2] + 1


@pytest.mark.parametrize('size', [3, 40])
def test_a_number_that_is_an_eigenvalue_is_not_below_itself(size):
    """Zero is the eigenvalue of a free chain; without a step aside a pivot is zero."""
    chain = sparse.diags_array([np.r_[1, np.full(size - 2, 2), 1.0], -np.ones(size - 1), -np.ones(size - 1)], offsets=[0, 1, -1])
    assert count_below(sparse.csr_array(chain), 0.0) == 0
    assert count_below(sparse.csr_array(chain), 1e-9) == 1
    swapped = sparse.csr_array([[0.0, 1.0], [1.0, 0.0]])  # a pivot on the diagonal is zero, and no eigenvalue
    assert count_below(swapped, 0.0) == 1
