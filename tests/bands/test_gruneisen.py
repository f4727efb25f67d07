"""Grueneisen parameters against differences of relaxed lattices, closed forms of inverse powers, and phonopy's."""

import numpy as np
import pytest
from ase.constraints import FixAtoms
from oracles import lattice
from phonopy import PhonopyGruneisen

from magphonon import InversePower, MagneticRepulsion, Yukawa, finite_displacements, lattices, relaxed
from magphonon.bands import bloch_modes, gruneisen_parameters

POINTS = [[0.31, 0.17, 0], [0.5, 0, 0], [1 / 3, 2 / 3, 0], [0, 0, 0]]
STEP = 1e-3


def strained(name, law, foundation):
    """A cell of little symmetry, relaxed before a foundation is put under it."""
    cell = lattice(name)
    cell.set_cell(cell.cell.array @ [[1.06, 0.03, 0], [-0.02, 0.97, 0], [0, 0, 1]], scale_atoms=True)
    strengths = np.linspace(1.1, 0.9, len(cell))
    cell.calc = MagneticRepulsion(cell, law, cutoff=18.5, strengths=strengths)
    rest = relaxed(cell).atoms
    rest.calc = MagneticRepulsion(rest, law, foundation=foundation, bonds=rest.calc.bonds, strengths=strengths)
    return rest


def scaled(atoms, factor, model, inner=True):
    """Squared frequencies with the spacing times `factor`, in balance, or with the particles at their fractions."""
    wide = atoms.copy()
    wide.set_cell(np.where(atoms.pbc[:, None], factor, 1) * atoms.cell.array, scale_atoms=True)
    bonds = atoms.calc.bonds
    pairs = list(zip(bonds.i, bonds.j, bonds.shift, strict=True))
    wide.calc = MagneticRepulsion(wide, atoms.calc.laws, bonds=pairs, foundation=atoms.calc.foundation,
                                  strengths=atoms.calc.strengths)
    if inner:
        wide = relaxed(wide).atoms
        omega = bloch_modes(wide, POINTS, model)[0]
        return omega * abs(omega)
    D = wide.calc.bloch_matrix(np.array(POINTS), model)
    return np.linalg.eigvalsh(D) / wide.get_masses()[0]


@pytest.mark.parametrize('model', ['complete', 'conventional'])
@pytest.mark.parametrize(('name', 'k'), [('triangular', 0.0), ('honeycomb', 0.05), ('kagome', 0.05)])
def test_differences_of_relaxed_lattices(name, k, model):
    atoms = strained(name, Yukawa(c=20.0, kappa=0.3), k)
    omega, gamma = gruneisen_parameters(atoms, POINTS, model)
    squares = omega * abs(omega)

    def slope(**how):
        ends = [scaled(atoms, np.exp(x), model, **how) for x in (-2 * STEP, -STEP, STEP, 2 * STEP)]
        return np.array([1, -8, 8, -1]) @ np.array(ends).reshape(4, -1) / (12 * STEP)

    known = ~np.isnan(gamma)
    found = (-4 * gamma * squares)[known]  # d = 2: the change of the square by ln L
    # 1e-8: the fourth power of the step times higher derivatives, some thousands of the first
    np.testing.assert_allclose(found, slope().reshape(omega.shape)[known], rtol=0, atol=1e-8 * abs(squares).max())
    if name == 'honeycomb':  # the control: particles that stay at their fractions
        assert abs(found - slope(inner=False).reshape(omega.shape)[known]).max() > 1e-4 * abs(squares).max()
    assert known.sum() == known.size - 2 * (k == 0)  # translations


@pytest.mark.parametrize(('name', 'd'), [('chain', 1), ('triangular', 2), ('kagome', 2), ('fcc', 3)])
def test_inverse_powers(name, d):
    a, k = 4.5824, 0.02
    atoms = lattice(name)
    atoms.calc = MagneticRepulsion(atoms, InversePower(b=4000.0, a=a), shells=2)
    q = np.array([[0.31, 0.17, 0.08], [0.5, 0.1, 0]]) * atoms.pbc
    gamma = gruneisen_parameters(atoms, q)[1]
    np.testing.assert_allclose(gamma, (a + 1) / (2 * d), rtol=1e-9)  # every frequency goes with L^-(a+1)/2
    atoms.calc.set(foundation=k)
    omega, held = gruneisen_parameters(atoms, q)
    share = 1 - k / atoms.get_masses()[0] / (omega * abs(omega))  # of the square that is not the foundation's
    np.testing.assert_allclose(held, (a + 1) / (2 * d) * share, rtol=1e-9)
    assert abs(held - gamma).max() > 0.05  # the control


def test_phonopy():
    factors, law = (1.0, 1.002, 0.998), Yukawa(c=20.0, kappa=0.3)
    cells = [lattices.triangular(10.0 * factor, 0.7) for factor in factors]
    for cell in cells:
        cell.cell[2, 2] = 20.0
        cell.calc = MagneticRepulsion(cell, law, shells=2)
    phonons = [finite_displacements(cell, (5, 5, 1)) for cell in cells]
    peer = PhonopyGruneisen(*phonons)
    path = np.array([[0.1, 0.05, 0], [0.2, 0.1, 0], [0.45, 0.02, 0]])
    with np.errstate(divide='ignore', invalid='ignore'):  # nothing acts out of the plane, and phonopy divides by that frequency
        peer.set_band_structure([path])
    theirs = peer.get_band_structure()[4][0][:, -2:]  # the lowest branch is that out of the plane
    ours = gruneisen_parameters(cells[0], path)[1]
    # 1e-3: third order in the 0.4 % between phonopy's cells, and the round-off of its displacements
    np.testing.assert_allclose(np.sort(ours), np.sort(theirs), rtol=1e-3)
    assert abs(np.sort(ours) / np.sort(theirs[::-1]) - 1).max() > 1e-2  # the control: of other wavevectors


def test_walls_follow_the_spacing():
    atoms = lattice('triangular').repeat((1, 6, 1))
    atoms.pbc = (True, False, False)
    atoms.set_constraint(FixAtoms([0, 5]))
    a = 6.0
    atoms.calc = MagneticRepulsion(atoms, InversePower(b=4e5, a=a))
    gamma = gruneisen_parameters(atoms, [[0.3, 0, 0], [0.5, 0, 0]])[1]
    np.testing.assert_allclose(gamma, (a + 1) / 2, rtol=1e-9)


def test_refusals():
    atoms = lattice('triangular')
    atoms.calc = MagneticRepulsion(atoms, InversePower(b=4000.0, a=4.0), foundation=0.1, anchors=[[0.1, 0, 0]],
                                   load=[[-0.01, 0, 0]])
    with pytest.raises(ValueError, match='how these forces change with the spacing is not known'):
        gruneisen_parameters(atoms, POINTS)
