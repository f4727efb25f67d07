"""Linear answers about the rest that was found: structures that others have asked about, against an energy of the test's own.

The oracle knows nothing of the package but the law: it takes the bonded pairs as a list and the energy from absolute positions,

    E(x) = sum_pairs phi(|x_j - x_i|) + k/2 sum |x - anchor|^2 - load.x

and takes its forces, their derivatives by complex steps, and all modes of the dense matrix.
"""

import numpy as np
import pytest
from ase.constraints import FixAtoms
from numpy.testing import assert_allclose

from magphonon import (
    InversePower,
    MagneticRepulsion,
    lattices,
    modes,
    relaxed,
    units as u,
    verdict,
)
from magphonon.errors import Unstable
from magphonon.lattices.patches import RIM
from magphonon.response.normal_modes import natural_frequencies

LAW = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
HZ = 1e3 / (2 * np.pi)


class Oracle:
    """Forces of a planar structure at any positions, and its stiffness by complex steps."""

    def __init__(self, pairs, law, k, anchors, load):
        self.i, self.j = np.array(pairs).T
        self.law, self.k, self.anchors, self.load = law, k, anchors[:, :2], load[:, :2]

    def forces(self, x):
        """In N, at complex positions, shape (particles, 2)."""
        d = x[self.j] - x[self.i]
        r = np.sqrt((d * d).sum(axis=-1))
        pull = -(self.law.dphi(r) / r)[..., None] * d
        total = self.load - self.k * (x - self.anchors)
        np.add.at(total, self.j, pull)
        np.add.at(total, self.i, -pull)
        return total

    def hessian(self, x):
        n, step = x.size, 1e-20
        H = np.empty((n, n))
        for a in range(n):
            shift = np.zeros(n, complex)
            shift[a] = 1j * step
            H[:, a] = -self.forces(x + shift.reshape(x.shape)).imag.ravel() / step
        return (H + H.T) / 2

    def squares(self, x, masses, basis):
        """Squared frequencies within the directions of `basis`, ascending."""
        M = basis.T @ np.repeat(masses, 2)
        return np.linalg.eigvalsh(basis.T @ self.hessian(x) @ basis / np.sqrt(M * M[:, None]))


def basis_of(atoms):
    """Unit vectors of what is free: FixAtoms and one FixedLine along y are all that is used here."""
    free = np.ones((len(atoms), 2), bool)
    for constraint in atoms.constraints:
        free[constraint.index, 0] = False
        if isinstance(constraint, FixAtoms):
            free[constraint.index, 1] = False
    return np.eye(2 * len(atoms))[:, np.flatnonzero(free)]


def oracle_of(atoms):
    calc = atoms.calc
    pairs = list(zip(calc.bonds.i.tolist(), calc.bonds.j.tolist(), strict=True))
    return Oracle(pairs, LAW, calc.parameters.foundation, calc.anchors, calc.load)


def hexagon(side, k, shells=1, hole=False):
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.707), side)
    if hole:
        del atoms[int(np.linalg.norm(atoms.positions, axis=1).argmin())]
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=k, **({'shells': shells} if shells > 1 else {'cutoff': 12.0}))
    return atoms


def test_local_modes_of_a_missing_magnet_lie_in_the_gap():
    """Honeycomb of two masses, 10 x 10 cells, periodic; frequencies found independently by others, printed digits."""
    cell = lattices.honeycomb(10.0, 0.707)
    cell.set_masses([0.707, 1.5 * 0.707])
    atoms = cell.repeat((10, 10, 1))
    del atoms[0]
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=0.08)
    rest = relaxed(atoms)
    assert rest.shift == pytest.approx(2.85, abs=0.005)
    f = natural_frequencies(rest.atoms) * HZ
    assert_allclose(f[(f > 71) & (f < 86)], [78.83, 78.83, 80.27], atol=0.005)
    assert_allclose(f[[0, -1]], [17.533, 109.847], atol=5e-4)
    with pytest.raises(ValueError, match=r'net static force of 0.2369 N acts on particle \d+ \(the largest force in a bond is '
                                         r'0.2369 N\).* 3 of 199 .*relaxed'):
        modes(atoms)


def test_a_vacancy_on_pillars_stays_or_buckles_as_its_stiffness_says():
    """The symmetric rest is a saddle below some 48 N/m: `relaxed` leaves it; on weak pillars there is no place to go."""
    stiff = relaxed(hexagon(60.0, 0.050, hole=True))
    assert stiff.saddles == 0
    assert verdict(stiff.atoms).stable
    soft = relaxed(hexagon(60.0, 0.047, hole=True))
    assert soft.saddles == 1
    assert soft.lowest > 0
    assert verdict(soft.atoms).stable
    for found in (stiff, soft):
        squares = oracle_of(found.atoms).squares(found.atoms.positions[:, :2], found.atoms.get_masses(), basis_of(found.atoms))
        assert found.lowest == pytest.approx(squares[0], rel=1e-8)
    with pytest.raises(Unstable, match='the structure buckles or slides'):  # round-off says in which way
        relaxed(hexagon(60.0, 0.0196757, hole=True))


def test_the_verdict_on_a_saddle_is_that_it_buckles():
    """The symmetric rest of the vacancy on the prototype's pillars, found by Newton's steps of the oracle alone."""
    atoms = hexagon(60.0, 0.0196757, hole=True)
    oracle, basis, x = oracle_of(atoms), basis_of(atoms), atoms.positions[:, :2].copy()
    for _ in range(12):
        x += (basis @ np.linalg.solve(basis.T @ oracle.hessian(x) @ basis, basis.T @ oracle.forces(x).ravel())).reshape(-1, 2)
    squares = oracle.squares(x, atoms.get_masses(), basis)
    assert (squares < 0).sum() == 3
    assert -np.sqrt(-squares[0]) * HZ == pytest.approx(-35.74, abs=0.005)
    atoms.positions[:, :2] = x
    assert modes(atoms).omega[0] * HZ == pytest.approx(-35.74, abs=0.005)
    judged = verdict(atoms)
    assert judged['residual'] == 0
    assert not judged.stable
    assert judged['buckling'].growth == pytest.approx(np.sqrt(-squares[0]), rel=1e-8)


def test_magnets_placed_by_hand_assemble_themselves():
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.707), 60.0)
    free = atoms.get_tags() != RIM
    atoms.positions[free, :2] += 0.8 * np.random.default_rng(0).normal(size=(free.sum(), 2))
    atoms.calc = MagneticRepulsion(atoms, LAW, cutoff=14.5)
    f = natural_frequencies(relaxed(atoms).atoms) * HZ
    assert_allclose(f[[0, -1]], [16.34, 145.0], rtol=5e-4)
