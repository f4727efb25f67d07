"""D0 + D* against second derivatives of the energy, which the tests write themselves, by Cauchy's formula."""

import numpy as np
import pytest
from oracles import LATTICES, LAWS, Energy, displaced, in_plane, second_derivatives
from structures import few_first

from magphonon import MagneticRepulsion
from magphonon.lattices import Bonds
from magphonon.stiffness.matrices import bloch_gradient, bloch_matrix, bloch_series

# Of the largest entry: round-off of the energy over its curvature, see second_derivatives.
TOLERANCE = 1e-12


@pytest.mark.parametrize(('name', 'law'), few_first(
    [*((name, 'magnets') for name in LATTICES), *(('triangular', law) for law in LAWS)], 4))
def test_hessian_of_a_displaced_lattice(name, law):
    rest, atoms, u = displaced(name)
    k = 0.1 * abs(LAWS[law].d2phi(10.0))
    energy = Energy(rest, LAWS[law], k=k)
    calc = MagneticRepulsion(rest, LAWS[law], foundation=k)
    exact = {
        'all': second_derivatives(energy.complete, u),
        'D0': second_derivatives(lambda x: energy.frozen(x, about=u), u),
        'Dstar': second_derivatives(lambda x: energy.constant_force(x, about=u), u),
        'foundation': k * np.eye(len(u)),
    }
    largest = abs(exact['all']).max()
    for part, expected in exact.items():
        H = calc.get_hessian(atoms, part)
        assert abs(in_plane(H, energy.dim) - expected).max() < TOLERANCE * largest, part
        assert abs(H).sum() == pytest.approx(abs(in_plane(H, energy.dim)).sum(), rel=1e-15)  # nothing along z in a plane
    # the control: D0 and foundation alone are not the Hessian
    assert abs(exact['D0'] + exact['foundation'] - exact['all']).max() > 0.05 * largest


@pytest.mark.parametrize('name', few_first(LATTICES, 5))  # those of the plane first
def test_conventional_hessian_keeps_the_directions_of_rest(name):
    rest, atoms, u = displaced(name)
    law = LAWS['magnets']
    energy = Energy(rest, law)
    calc = MagneticRepulsion(rest, law, model='conventional')
    expected = second_derivatives(lambda x: energy.frozen(x, about=0 * u), u)
    assert abs(in_plane(calc.get_hessian(atoms), energy.dim) - expected).max() < TOLERANCE * abs(expected).max()
    assert not calc.get_hessian(atoms, 'Dstar').toarray().any()
    # the control: with the directions of the moment it is another matrix, by the angles of a few percent
    turned = second_derivatives(lambda x: energy.frozen(x, about=u), u)
    assert abs(turned - expected).max() > 1e-3 * abs(expected).max()


@pytest.mark.parametrize('seed', range(6))
def test_matrices_of_bonds_drawn_either_way_round(seed):
    rng = np.random.default_rng(seed)
    n, dim, count = rng.integers(1, 6), 2 + seed % 2, 40  # several bonds join the same two, from either end
    i, j, shift = rng.integers(n, size=count), rng.integers(n, size=count), rng.integers(-2, 3, (count, 3))
    K, springs, q, cell = (rng.normal(size=shape) for shape in ((count, dim, dim), (n, dim), (7, 3), (3, 3)))
    K, along = K + K.swapaxes(1, 2), rng.normal(size=count)
    bonds = Bonds(i, j, shift, np.zeros((count, 3)), n)

    def summed(factor, own=0.0, of=range(count)):
        D = np.zeros((n, dim, n, dim), dtype=complex)
        for b in of:
            D[i[b], :, i[b]] += own * K[b]
            D[j[b], :, j[b]] += own * K[b]
            D[i[b], :, j[b]] -= factor[b] * K[b]
            D[j[b], :, i[b]] -= np.conj(factor[b]) * K[b]
        return D.reshape(n * dim, n * dim)

    tolerance = 1e-15 * count * abs(K).max()  # of sums of as many terms
    phase, R = np.exp(2j * np.pi * q @ shift.T), shift @ cell
    D, gradient = bloch_matrix(bonds, K, q, springs), bloch_gradient(bonds, K, q, cell)
    for k, factor in enumerate(phase):
        expected = summed(factor, 1.0) + np.diag(springs.ravel())
        assert abs(D[k] - expected).max() < tolerance
        assert abs(summed(factor, 1.0, range(1, count)) - expected).max() > 1e3 * tolerance  # the control: without a bond
        for axis in range(dim):
            assert abs(gradient[axis, k] - summed(1j * R[:, axis] * factor)).max() < tolerance * abs(R).max()
    for term, factor, own in zip(bloch_series(bonds, K, along), (along**0, 1j * along, -(along**2) / 2), (1, 0, 0), strict=True):
        assert abs(term - summed(factor, own)).max() < tolerance * (1 + abs(along).max() ** 2)
