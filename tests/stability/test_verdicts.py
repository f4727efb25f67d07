"""How large a foundation the static forces ask for, and the verdict: on both sides of each of its limits."""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from numpy.testing import assert_allclose
from scipy.optimize import minimize_scalar
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, critical_foundation, lattices, read_scene, verdict
from magphonon.interactions import Spring, Yukawa
from magphonon.stability import frequency_shifts, verdicts
from magphonon.stability.buckling import critical_spacing, critical_support, softest_of
from magphonon.stiffness import LinearSystem, PairCalculator
from magphonon.stiffness.matrices import hessian

# --- the verdict -----------------------------------------------------------------------------------------------------

def judged(**options):
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, options.pop('a', 4.0)), foundation=options.pop('k', 0.0),
                                  model=options.pop('model', 'complete'))
    return verdict(cell, **options)


@pytest.mark.parametrize(('options', 'word'), [
    # each beside its nearest good neighbour
    ({'a': 2.0, 'k': 1.99}, 'buckles'), ({'a': 2.0, 'k': 2.01}, None),
    ({'a': 2.0, 'model': 'conventional'}, 'does not show this'), ({'a': 4.0, 'model': 'conventional'}, None),
])
def test_each_fault_is_found_and_its_neighbour_is_not(options, word):
    found = judged(**options)
    assert found.fine == (word is None)
    if word:
        assert any(word in fault for fault in found.faults)


def test_contact_is_seen_in_the_present_positions():
    pair = Atoms('Nd2', positions=[[0, 0, 0], [1, 0, 0]], masses=[0.01, 0.01])
    pair.calc = MagneticRepulsion(pair, InversePower(1.0, 4.0), foundation=10.0).balanced([0, 1])
    for distance, fine in ((0.34, True), (0.33, False)):  # a third of the distance at rest
        pair.positions[1, 0] = distance
        assert verdict(pair).fine == fine


def test_balanced_by_a_dead_load():
    atoms = lattices.oscillator(0.0, 1.0, 1.0)
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), bonds=lattices.OSCILLATOR_BONDS)
    found = verdict(atoms)
    assert (found['residual'], found.case.force) == pytest.approx((1.0, 1.0), rel=1e-12)  # the lower magnet: the outer two cancel
    assert 'as large as the force in a bond' in found.faults[0]
    atoms.calc = atoms.calc.balanced([3])
    assert verdict(atoms).fine


def test_linear_amplitude_is_that_of_the_softest_wave_or_none():
    def amplitude(name, k):
        cell = getattr(lattices, name)(1.0, 1.0)
        cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=k)
        return verdict(cell)['amplitude']

    # the twist of kagome stiffens by 27/8 (a + 1) A^2/(k - 6), see test_amplitude_shifts
    assert amplitude('kagome', 6.06) == pytest.approx(np.sqrt(0.01 * 0.06 * 8 / (27 * 5)), rel=1e-6)
    # the softest wave of honeycomb, at K, repeats every third cell, and no shift of it is known
    assert amplitude('honeycomb', 3.03) is None


def test_spacing_that_a_foundation_holds():
    # needed 4 f/L0 = 4 s^-(a+1)
    chain = lattices.chain(1.0, 1.0)
    for k in (2.0, 6.0):
        chain.calc = MagneticRepulsion(chain, InversePower(1.0, 4.0), foundation=k)
        assert critical_spacing(LinearSystem.of(chain)) == pytest.approx((4 / k) ** 0.2, rel=1e-8)
    chain.calc = MagneticRepulsion(chain, InversePower(1.0, 4.0))
    assert critical_spacing(LinearSystem.of(chain)) is None  # no spacing helps where there is no foundation


def test_members_that_balance_at_one_size_alone_have_no_critical_spacing():
    assert critical_spacing(LinearSystem.of(read_scene('prism').atoms())) is None  # of two rest lengths
    # all members are alike: the tension that holds them ends at their rest length
    tissue = lattices.honeycomb(1e-2, 1e-9)
    tissue.calc = PairCalculator(tissue, Spring(1e-3, 9e-3))
    slack = tissue.calc.law.L0 / tissue.calc.bonds.lengths[0]
    assert slack < 0.95
    assert critical_spacing(LinearSystem.of(tissue)) == pytest.approx(slack, rel=1e-6)


def test_what_holds_itself_at_every_spacing_never_begins_to_buckle():
    # an inverse power knows no length, so stable is stable at all spacings; translations have no stiffness, but for round-off
    for a in (3.2, 4.1, 5.7, 8.3):
        lattice = lattices.triangular(1.0, 1.0).repeat((2, 1, 1))
        lattice.calc = MagneticRepulsion(lattice, InversePower(1.0, a))
        assert critical_spacing(LinearSystem.of(lattice)) is None


@pytest.mark.parametrize(('lattice', 'wave', 'alone'), [
    ('chain', 4, 2), ('square', 8, 4), ('triangular', 9, 6), ('honeycomb', 6, 3)])
def test_supports_out_of_the_plane(lattice, wave, alone):
    """Magnets: (a - 1) f/r a bond, by Laplace's equation; the worst wave is at X, M, K and between the two sublattices."""
    atoms = getattr(lattices, lattice)(1.0, 1.0)
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0))
    assert_allclose(critical_support(LinearSystem.of(atoms), magnets=True), (3 * wave, 3 * alone), rtol=1e-12)
    assert_allclose(critical_support(LinearSystem.of(atoms), magnets=False), (wave, alone), rtol=1e-12)
    found = verdict(atoms)
    assert_allclose(found['supports'], (3 * wave, 3 * alone, wave), rtol=1e-12)
    atoms.calc = MagneticRepulsion(atoms, Yukawa(c=1.0, kappa=0.5))  # particles that are no magnets
    found = verdict(atoms)
    assert found['supports'].wave is found['supports'].alone is None
    assert_allclose(found['supports'].central, wave * 1.5 * np.exp(-0.5), rtol=1e-12)  # f = c (1/r + kappa) e^{-kappa r}/r


@pytest.mark.parametrize('steps', [None, 12, 5])
def test_a_softest_wave_between_the_points_of_the_mesh_is_found(steps):
    """Two shells of the triangular lattice at a = 2.5 buckle in a shear wave along a row, at no special point."""
    angle = np.pi / 6 * np.arange(12)
    R = np.stack([np.cos(angle), np.sin(angle)], axis=1) * np.where(np.arange(12) % 2, np.sqrt(3), 1)[:, None]
    r, a = np.linalg.norm(R, axis=1), 2.5
    across = r ** (-a - 1) * ((a + 1) * (R[:, 1] / r) ** 2 - 1)  # the yy part of a nn - (I - nn), times f/r
    softest = minimize_scalar(lambda k: across @ (1 - np.cos(k * R[:, 0])), (1.0, 1.3, 1.6), tol=1e-10)
    atoms = lattices.triangular(1.0, 1.0)
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, a), shells=2)
    needed, q = critical_foundation(atoms, steps=steps)
    assert needed == pytest.approx(-softest.fun, rel=1e-8)
    k = 2 * np.pi * q @ atoms.cell.reciprocal()
    assert min(abs(np.linalg.norm(k - 2 * np.pi * np.array(G) @ atoms.cell.reciprocal()) - softest.x)
               for G in np.ndindex(2, 2, 1)) < 1e-3  # flat there, as the square root of what is left of the minimum


@pytest.mark.parametrize(('name', 'repeats', 'needed'), few_first([
    ('square', 1, 4.0), ('square', 11, 4.0), ('triangular', 1, None), ('triangular', 11, None), ('triangular', 12, None)], 2))
def test_a_large_periodic_cell_says_which_waves_are_judged(name, repeats, needed):
    """The square lattice buckles at q = (1/2, 0) and (0, 1/2), the edge of its zone, which is that of 11 x 11 cells too.

    Their own motion, q = 0, contains 5/11 at most, which needs 4 sin^2(5 pi/11) f/L = 3.92 f/L.  In the triangular lattice
    of a soft law the edge is met likewise, at M; of 12 x 12 cells it is at q = 0.
    """
    atoms = getattr(lattices, name)(1.0, 1.0)
    a = 4.0 if name == 'square' else 2.0
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, a))
    needed = needed or critical_foundation(atoms)[0]
    atoms = atoms.repeat((repeats, repeats, 1))
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, a), foundation=0.999 * needed)
    found = verdict(atoms)
    assert_allclose(found['buckling'].needed, needed, rtol=1e-9)  # round-off
    assert not found.stable
    assert ('fit into one or two' in str(found)) == (repeats > 1)
    assert found['buckling'].softest.any() == (repeats != 12)
    H = hessian(atoms.calc.bonds, atoms.calc.rest_stiffness(), 0.0)
    alone = -np.linalg.eigvalsh(H.toarray())[0]  # the control: q = 0 of the large cell
    assert (alone < 0.99 * needed) == (repeats != 12)
    if repeats == 11:
        # what a run of such a cell does repeats from cell to cell
        highest = np.sqrt(np.linalg.eigvalsh(H.toarray())[-1] + 0.999 * needed)
        assert 2 / found['timestep_limit'] == pytest.approx(highest, rel=1e-6)
    if name == 'square' and repeats == 11:
        assert alone == pytest.approx(4 * np.sin(5 * np.pi / 11) ** 2, rel=1e-9)


@pytest.mark.parametrize('seed', range(3))
def test_atoms_in_another_order_than_their_calculator_are_a_fault(seed):
    rng = np.random.default_rng(seed)
    cell = lattices.triangular(rng.uniform(5, 15), 0.7)
    patch = lattices.hexagon(cell, 2 * cell.cell.lengths()[0])
    patch.calc = MagneticRepulsion(patch, InversePower(b=3e3, a=4.6), foundation=0.5)
    moved = patch.copy()  # the control: a large amplitude is none
    moved.calc = patch.calc
    moved.positions[:, :2] += rng.uniform(-0.2, 0.2, (len(patch), 2)) * cell.cell.lengths()[0]
    assert verdict(moved).fine
    order = np.arange(len(patch))[::-1] if seed == 0 else rng.permutation(len(patch))
    other = patch[order]
    other.calc = patch.calc
    found = verdict(other)
    assert not found.fine
    assert 'their order differs from that' in str(found)
    assert found['away'] == pytest.approx(np.linalg.norm(patch.positions[order] - patch.positions, axis=1).max())


# --- the list of checks ------------------------------------------------------------------------------------------------------

def test_costly_checks_wait_until_they_are_asked_for(monkeypatch):
    asked = []
    for name in verdicts.REMARKS:
        monkeypatch.setitem(verdicts.CHECKS, name, lambda case, name=name: asked.append(name) or verdicts.Finding())
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    judged = verdict(cell)
    assert (judged.fine, judged.stable, judged['timestep_limit'] > 0, asked) == (True, True, True, [])
    assert judged['amplitude'] is judged['amplitude'] is None
    assert asked == ['amplitude']
    assert str(judged)
    assert sorted(asked) == sorted(verdicts.REMARKS)
    with pytest.raises(ValueError, match=r"the check must be one of 'residual', .* not 'speed'"):
        _ = judged['speed']


@pytest.mark.parametrize('seed', range(6))
def test_the_foundation_that_a_layer_needs_is_that_of_its_motion_in_the_plane(seed):
    """Whatever its supports along z: against the planar cell; supports softer than the springs would count otherwise."""
    rng = np.random.default_rng(seed)
    cell = getattr(lattices, rng.choice(['square', 'honeycomb', 'triangular', 'kagome']))(rng.uniform(5, 15), 0.7)
    law, springs = InversePower(1e4, rng.uniform(1.5, 2.9)), rng.uniform(0.1, 2, (len(cell), 2))
    cell.calc = MagneticRepulsion(cell, law, foundation=springs)
    planar = critical_foundation(cell)
    assert planar.k > 0
    for support in (30.0, 0.01):
        cell.calc = MagneticRepulsion(cell, law, foundation=np.column_stack([springs, np.full(len(cell), support)]))
        layer = critical_foundation(cell)
        assert layer.k == pytest.approx(planar.k, rel=1e-12)
        assert_allclose(layer.q, planar.q)
    assert softest_of(cell).needed != pytest.approx(planar.k, rel=1e-3)  # the control: of all three components


@pytest.mark.parametrize('tool', [critical_foundation, verdict, frequency_shifts])
@pytest.mark.parametrize('finite', [False, True])
def test_a_structure_of_which_nothing_can_move_is_refused_in_words(tool, finite):
    atoms = lattices.honeycomb(1.0, 1.0)
    atoms.pbc = not finite, not finite, False
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), foundation=20.0)
    atoms.set_constraint(FixAtoms([0, 1]))
    with pytest.raises(ValueError, match='the constraints hold every particle; free at least one'):
        tool(atoms)
    atoms.set_constraint(FixAtoms([0]))
    if not finite:
        tool(atoms)


class Slip(InversePower):
    """A law with a slip that complex distances alone meet, as differences for higher derivatives are complex."""

    def d2phi(self, r):
        return super().d2phi(r) if np.isrealobj(r) else self.scale * r


@pytest.mark.parametrize('read', [lambda judged: judged['amplitude'], str])
def test_an_error_in_a_law_is_raised_as_it_is(read):
    """An AttributeError within a check was once reported as a missing check."""
    cell = lattices.square(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, Slip(1.0, 4.0), foundation=5.0)
    with pytest.raises(AttributeError, match="'Slip' object has no attribute 'scale'"):
        read(verdict(cell))
