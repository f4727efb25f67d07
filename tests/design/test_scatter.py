"""What each site changes by itself, against differences of structures that have come to rest again."""

import numpy as np
import pytest
from ase.constraints import FixAtoms
from oracles import lattice

from magphonon import InversePower, MagneticRepulsion, lattices, modes, relaxed
from magphonon.design.scatter import Rest, form, mode_scatter, site_slopes
from magphonon.stiffness import Scatter

LAW = InversePower(b=6200.0, a=4.5824)
STEP = 1e-4


def patch(mass=1.0, strength=1.0, stiffness=1.0):
    """A relaxed honeycomb patch of drawn magnets between held ones, a pillar under each; factors of shape (particles,)."""
    atoms = lattice('honeycomb').repeat((3, 3, 1))
    atoms.pbc, n, rng = False, 18, np.random.default_rng(4)
    atoms.set_masses(rng.uniform(0.5, 1.0, n) * mass)
    strengths, springs = rng.uniform(0.9, 1.1, n) * strength, rng.uniform(0.05, 0.1, n) * stiffness
    atoms.set_constraint(FixAtoms([0, 1, 4, 12, 17]))
    atoms.calc = MagneticRepulsion(atoms, LAW, shells=2, foundation=springs, strengths=strengths)
    return relaxed(atoms).atoms


def differences(value, site):
    """Derivatives of `value(atoms)` by the logarithms of mass, strength and spring of one site, shape (3, ...)."""
    found = []
    for name in ('mass', 'strength', 'stiffness'):
        ends = []
        for sign in (1, -1):
            factor = np.ones(18)
            factor[site] = np.exp(sign * STEP)
            ends.append(value(patch(**{name: factor})))
        found.append((ends[0] - ends[1]) / (2 * STEP))
    return np.array(found)


def slopes_of(rest, shapes, squares, at_rest=False):
    """Derivatives of the squared frequencies of modes by logarithms of mass, strength and spring, and by places, of each site."""
    found = [site_slopes(rest, form(rest.frame.bonds, x[..., None], x[..., None], -s), at_rest)
             for x, s in zip(shapes, squares, strict=True)]
    sites = [np.array([rest.masses * one['mass'], one['strength'], one['spring'].sum(1)]).T for one in found]
    return np.array(sites), np.array([one['foot'] for one in found])


@pytest.mark.parametrize('site', [2, 7, 17])  # the last one is held
def test_natural_frequencies(site):
    atoms = patch()
    found, rest = modes(atoms), Rest.of(atoms)
    squares = found.omega**2
    ours = slopes_of(rest, found.shapes, squares)[0][:, site].T
    theirs = differences(lambda atoms: modes(atoms).omega ** 2, site)
    # 1e-6: the square of the step, times third derivatives of some hundreds
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6 * squares.max())
    at_rest, bonds = rest.K('complete'), rest.frame.bonds  # the control: without the rest that follows
    ends = (bonds.i == site) | (bonds.j == site)
    e = np.array([bonds.incidence @ x for x in found.shapes])
    fixed = np.einsum('mbx,bxy,mby->m', e[:, ends], at_rest[ends], e[:, ends])
    assert abs(fixed - theirs[1]).max() > 1e-2 * squares.max()


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
    ours, other = (slopes_of(rest, found.shapes, 0 * found.omega, which)[1][:, site] for which in (at_rest, not at_rest))
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
