"""An independent code against the force constants: matscipy's exact Hessian."""

import numpy as np
import pytest
from ase import Atoms
from ase.build import bulk

from magphonon import InversePower, MagneticRepulsion, finite_displacements, lattices, units as u

A, B = 4.5824, 1.6209e-10 * u.N * u.m**4.5824
PILLAR = 19.675721234 * u.N / u.m
LATTICES = 'chain', 'square', 'triangular', 'honeycomb', 'kagome', 'fcc'

# phonopy displaces by d = 1e-5 L0; the curvature of the law gives a relative error of 2 to 20 times (d/L0)^2.
FINITE_DIFFERENCE = 1e-8
"""Tolerance in units of the highest frequency, or of the largest force constant."""


def prototype(lattice='triangular'):
    if lattice == 'fcc':
        cell = bulk('Nd', 'fcc', a=10 * np.sqrt(2))
        cell.set_masses([0.707])
    else:
        cell = getattr(lattices, lattice)(spacing=10 * u.mm, mass=0.707 * u.g)
    cell.calc = MagneticRepulsion(cell, InversePower(b=B, a=A), foundation=PILLAR)
    return cell


@pytest.mark.peer
@pytest.mark.parametrize('lattice', LATTICES)
def test_matscipys_exact_hessian_agrees(lattice):
    pair = pytest.importorskip('matscipy.calculators.pair_potential')

    class Repulsion(pair.calculator.CutoffInteraction):
        def __call__(self, r, *args):
            return B / (A - 1) * r ** (1 - A)

        def first_derivative(self, r, *args):
            return -B * r**-A

        def second_derivative(self, r, *args):
            return A * B * r ** (-A - 1)

    cell = prototype(lattice)
    phonon = finite_displacements(cell)
    s, home = phonon.supercell, phonon.primitive.p2s_map
    supercell = Atoms(s.symbols, positions=s.positions, cell=s.cell, pbc=cell.pbc)
    peer = pair.PairPotential({(60, 60): Repulsion(cutoff=12 * u.mm)})
    n = len(supercell)
    H = peer.get_hessian(supercell).toarray().reshape(n, 3, n, 3).swapaxes(1, 2)[home]

    dim = 3 if lattice == 'fcc' else 2
    FC = phonon.force_constants.copy()
    for i, own in enumerate(home):
        FC[i, own, :dim, :dim] -= PILLAR * np.eye(dim)  # matscipy has no foundation
    difference = abs(FC - H)[:, :, :dim, :dim]  # and lets planar particles move along z
    assert difference.max() < FINITE_DIFFERENCE * abs(H).max()
