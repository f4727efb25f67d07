"""Patches whose particles repel beyond their nearest neighbours: where they rest, and what the linear theory needs."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, critical_foundation, lattices, modes
from magphonon.interactions.pair_laws import repulsion
from magphonon.lattices.patches import RIM
from magphonon.stiffness import LinearSystem
from magphonon.stiffness.relaxation import relaxed

LAW = InversePower(b=6200.0, a=4.5824)


def patch(shells, foundation=0.02):
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.7), 50.0)
    atoms.calc = MagneticRepulsion(atoms, LAW, shells=shells, foundation=foundation)
    return atoms


@pytest.mark.parametrize('foundation', [0.0, 0.02])
def test_second_neighbours_push_the_row_inside_the_rim(foundation):
    atoms = patch(2, foundation)
    result = relaxed(atoms)
    f = repulsion(LAW, 10.0)
    assert result.before > 0.1 * f
    assert result.after < 1e-9 * f
    assert result.needed
    rim = atoms.get_tags() == RIM
    assert (result.atoms.positions[rim] == atoms.positions[rim]).all()
    assert 0.05 < result.shift < 0.5  # mm, of 10 mm
    # in balance, a small push answers by the Hessian at rest; at the lattice sites it would not
    for rest, holds in ((result.atoms, True), (atoms, False)):
        pushed = rest.copy()
        pushed.calc = rest.calc
        pushed.positions[~rim, :2] += 1e-5 * np.random.default_rng(1).normal(size=((~rim).sum(), 2))
        linear = -rest.calc.get_hessian(rest) @ (pushed.positions - rest.positions).ravel()
        error = abs(pushed.get_forces() - linear.reshape(-1, 3))[~rim].max() / abs(linear).max()
        assert (error < 1e-4) == holds


class Springs:
    """Linear springs, slack at their length r0."""

    def __init__(self, k, r0):
        self.k, self.r0 = k, r0

    def phi(self, r):
        return self.k / 2 * (r - self.r0) ** 2

    def dphi(self, r):
        return self.k * (r - self.r0)

    def d2phi(self, r):
        return self.k + 0 * r


@pytest.mark.parametrize('seed', range(6))
def test_springs_that_are_slack_are_at_rest(seed):
    """What round-off of the positions leaves of their forces is no force, wherever they stand."""
    rng = np.random.default_rng(seed)
    spacing, k = rng.uniform(1, 30), 10 ** rng.uniform(-3, 3)
    cell = lattices.triangular(spacing, 0.7)
    cell.rotate(rng.uniform(0, 360), 'z', rotate_cell=True)
    patch = lattices.parallelogram(cell, 6, 5)
    patch.positions[:, :2] += rng.uniform(-100, 100, 2) * spacing
    patch.set_masses(rng.uniform(0.5, 2, len(patch)))
    patch.calc = MagneticRepulsion(patch, Springs(k, spacing))
    n = (patch.positions - patch.positions[:, None])[..., :2]
    length = np.linalg.norm(n, axis=-1)
    K = -k * (n / spacing)[..., None] * (n / spacing)[..., None, :] * (abs(length - spacing) < 0.1 * spacing)[..., None, None]
    K[np.arange(30), np.arange(30)] = -K.sum(axis=1)
    free = np.flatnonzero(np.repeat(patch.get_tags() == 0, 2))
    root = np.repeat(patch.get_masses(), 2) ** -0.5
    D = (K.swapaxes(1, 2).reshape(60, 60) * root * root[:, None])[np.ix_(free, free)]
    assert_allclose(modes(patch).omega**2, np.linalg.eigvalsh(D), rtol=1e-9)
    assert not relaxed(patch).needed
    displaced = patch.copy()  # the control: a displacement that is none by round-off
    displaced.calc = patch.calc
    displaced.positions[free[0] // 2, 0] += 1e-6 * spacing
    with pytest.raises(ValueError, match='not at rest'):
        modes(displaced)


def beside_buckling(seed):
    """A patch a hundred-millionth or less below the foundation that holds it, and that foundation."""
    rng = np.random.default_rng(seed)
    cell = getattr(lattices, ('triangular', 'square', 'kagome')[seed % 3])(rng.uniform(5, 20), rng.uniform(0.1, 5))
    patch = lattices.hexagon(cell, 3 * cell.cell.lengths()[0] / (1 + (seed % 3 == 2)))
    patch.calc = MagneticRepulsion(patch, InversePower(b=1e3, a=2.0 if seed % 3 == 0 else 4.6))
    needed = critical_foundation(patch)[0]
    patch.calc.set(foundation=needed * (1 - 10 ** -rng.uniform(8, 9)))
    return patch, needed


def refusal(patch):
    """In words; empty if it relaxes."""
    try:
        relaxed(patch)
    except ValueError as error:
        return str(error)
    return ''


def test_on_the_verge_of_buckling_the_words_are_right_and_the_advice_holds():
    """No word of sliding, nor that a foundation is wanted: a little more of it is."""
    cases = [(patch, needed, said) for patch, needed in map(beside_buckling, range(6)) if (said := refusal(patch))]
    assert len(cases) >= 2
    for patch, needed, said in cases:
        assert 'on the verge of buckling' in said
        more = float(re.search(r'hides it; (\S+) N/mm more', said)[1])
        assert more < 1e-6 * needed
        patch.calc.set(foundation=patch.calc.foundation + more)
        assert not relaxed(patch).needed


@pytest.mark.parametrize('away', 10.0 ** np.arange(-9, -2))
def test_the_force_that_is_reported_acts_at_the_positions_that_are_returned(away):
    """Also from so near that the minimiser takes no step and Newton's method alone brings the structure to rest."""
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.7), 40.0)
    atoms.calc = MagneticRepulsion(atoms, InversePower(6200.0, 4.5824), foundation=0.05)
    atoms.positions[len(atoms) // 2, 0] += 10 * away
    before = abs(atoms.get_forces()).max()
    found = relaxed(atoms)
    left = np.linalg.norm(found.atoms.get_forces(), axis=1).max()
    assert left < 1e-6 * before + 1e-14
    assert found.after == pytest.approx(left, rel=0.5, abs=1e-15)
    assert found.needed


@pytest.mark.filterwarnings('ignore:the stiffest bond has')
@pytest.mark.parametrize('stiff', 10.0 ** np.arange(2, 11, 2))
def test_particles_on_stiff_springs_move_by_their_force_over_the_spring(stiff):
    """The rounded energy no longer sees the last steps, which Newton's method makes; it called these structures unstable."""
    rng = np.random.default_rng(int(stiff))
    for _ in range(8):
        atoms = lattices.triangular(1.0, 1.0).repeat((5, 5, 1))
        atoms.pbc = False
        atoms = atoms[rng.random(25) > 0.1]
        atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), cutoff=1.2, foundation=stiff)
        found, force = relaxed(atoms), atoms.get_forces()
        assert_allclose(found.atoms.positions - atoms.positions, force / stiff, atol=50 / stiff**2 + 1e-14)  # 4 N/mm
        assert found.after < max(1e-9, 1e-13 * stiff)  # positions are rounded to 1e-15 of 4 mm
        assert LinearSystem.of(found.atoms).stable
