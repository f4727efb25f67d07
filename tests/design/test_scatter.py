"""What each site changes by itself, against differences of structures that have come to rest again."""

import numpy as np
import pytest
from ase.constraints import FixAtoms
from oracles import lattice

from magphonon import InversePower, MagneticRepulsion, lattices, modes, relaxed
from magphonon.design.scatter import Rest, form, mode_scatter, site_slopes
from magphonon.stiffness import Scatter

LAW = InversePower(b=6200.0, a=4.5824)


def patch():
    """A relaxed honeycomb patch of drawn magnets between held ones, a pillar under each."""
    atoms = lattice('honeycomb').repeat((3, 3, 1))
    atoms.pbc, n, rng = False, 18, np.random.default_rng(4)
    atoms.set_masses(rng.uniform(0.5, 1.0, n))
    strengths, springs = rng.uniform(0.9, 1.1, n), rng.uniform(0.05, 0.1, n)
    atoms.set_constraint(FixAtoms([0, 1, 4, 12, 17]))
    atoms.calc = MagneticRepulsion(atoms, LAW, shells=2, foundation=springs, strengths=strengths)
    return relaxed(atoms).atoms


def slopes_of(rest, shapes, at_rest):
    """Derivatives of the squared frequencies of modes by the places of each site."""
    return np.array([site_slopes(rest, form(rest.frame.bonds, x[..., None], x[..., None], 0), at_rest)['foot'] for x in shapes])


def shifted(atoms, site, shift, at_rest):
    """The patch with one site moved: its foot, and the magnet if it is held; or the magnet as it was measured at rest."""
    calc, reference, move = atoms.calc, atoms.copy(), np.zeros((18, 3))
    move[site] = shift
    held = np.isin(np.arange(18), atoms.constraints[0].index)[:, None]
    reference.positions += move if at_rest else move * held
    moved = reference.copy()
    moved.calc = MagneticRepulsion(reference, LAW, bonds=calc.bonds.at(reference), foundation=calc.foundation,
                                   strengths=calc.strengths, anchors=calc.anchors + move)
    if at_rest:
        moved.calc = moved.calc.balanced(np.flatnonzero(~held[:, 0]))
        return moved
    return relaxed(moved).atoms


@pytest.mark.parametrize('at_rest', [False, True])
@pytest.mark.parametrize('site', [2, 7, 17])  # the last one is held
def test_places(site, at_rest):
    """Feet of pillars push by their springs, held magnets directly; positions measured at rest stay."""
    atoms, step = patch(), 1e-3
    found, rest = modes(atoms), Rest.of(atoms)
    ours, other = (slopes_of(rest, found.shapes, which)[:, site] for which in (at_rest, not at_rest))
    scale = abs(ours).max()
    for axis in range(2):
        ends = [modes(shifted(atoms, site, sign * step * np.eye(3)[axis], at_rest)).omega ** 2 for sign in (1, -1)]
        theirs = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(ours[:, axis], theirs, rtol=0, atol=1e-5 * scale)  # the square of the step
    assert abs(other - ours).max() > 0.1 * scale  # the control


def test_waves_of_a_supercell():
    cell = lattices.triangular(10.0, 0.7)
    supercell = cell.repeat((3, 3, 1))
    supercell.calc = MagneticRepulsion(supercell, LAW, foundation=0.02)
    scatter = Scatter(mass=0.01)
    omega, std = mode_scatter(supercell, scatter)
    # waves of one frequency, two at Gamma: of the forms -w^2 m_i u_a.u_b the squares add up to w^4 (2/2)/9
    np.testing.assert_allclose(std[:2], 0.01 * omega[:2] / 2 / 3, rtol=1e-9)
    twice = cell.repeat((6, 6, 1))
    twice.calc = MagneticRepulsion(twice, LAW, foundation=0.02)
    np.testing.assert_allclose(mode_scatter(twice, scatter, 2)[1], std[:2] / 2, rtol=1e-9)
    supercell.calc = MagneticRepulsion(supercell, LAW)
    assert np.isnan(mode_scatter(supercell, scatter)[1][:2]).all()  # translations
