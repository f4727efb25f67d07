"""No answer depends on the units: the same structure, ever so small or large, soft or stiff, light or heavy.

Lengths times L, stiffnesses times s, masses times m: then forces go with s L, frequencies with sqrt(s/m), and so on.  All
factors are powers of 4, by which floating numbers multiply exactly, so that only a number with a hidden unit makes a difference:
a tolerance in mm, a threshold in N.  Decisions must be the same too, so each is also asked just on either side of its limit.
"""

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine
from numpy.testing import assert_allclose
from structures import few_first

from magphonon import (
    DrivenVerlet,
    InversePower,
    MagneticRepulsion,
    critical_foundation,
    frequency_response,
    lattices,
    modes,
    propagate,
    relaxed,
    verdict,
)
from magphonon.dynamics import Diverged, Harmonic
from magphonon.dynamics.engine import highest_frequency
from magphonon.lattices import find_bonds
from magphonon.lattices.patches import RIM
from magphonon.stiffness import AllNeighbours
from magphonon.stiffness.rest import BALANCED, LinearSystem

# other units make other densities, at which SI numbers without units would be suspected
pytestmark = pytest.mark.filterwarnings('ignore::UserWarning')  # in units that nobody has, right numbers look like slips

UNITS = [[4.0**-9, 1.0, 1.0], [4.0**8, 1.0, 1.0], [1.0, 4.0**-9, 1.0], [1.0, 4.0**9, 1.0], [1.0, 1.0, 4.0**-9],
         [1.0, 1.0, 4.0**9], [4.0**-8, 4.0**7, 4.0**-10], [4.0**6, 4.0**-8, 4.0**9]]
POWER = 4


def patch(seed, L=1.0, s=1.0, m=1.0):
    """A patch of unequal masses with a hole, a held rim, a guide and pillars out of place; not at rest."""
    rng = np.random.default_rng(seed)
    shape, name = ('hexagon', 'rectangle', 'parallelogram')[seed % 3], ('triangular', 'square', 'honeycomb')[seed // 3 % 3]
    size = {'hexagon': (25.0 * L,), 'rectangle': (45.0 * L, 40.0 * L), 'parallelogram': (5, 5)}[shape]
    atoms = getattr(lattices, shape)(getattr(lattices, name)(10.0 * L, 0.7 * m), *size)
    bonds = find_bonds(atoms)
    inside = np.flatnonzero(atoms.get_tags() != RIM)
    hole, guided = rng.choice(inside, 2, replace=False)
    old = np.delete(np.arange(len(atoms)), hole)
    new = {int(k): n for n, k in enumerate(old)}
    pairs = [(new[i], new[j]) for i, j in zip(bonds.i.tolist(), bonds.j.tolist(), strict=True) if hole not in (i, j)]
    del atoms[int(hole)]
    atoms.set_masses(m * rng.uniform(0.5, 1.5, len(atoms)))
    atoms.set_constraint([FixAtoms(np.flatnonzero(atoms.get_tags() == RIM)), FixedLine(new[int(guided)], (0.6, 0.8, 0))])
    anchors = atoms.positions + L * np.column_stack([rng.uniform(-0.1, 0.1, (len(atoms), 2)), np.zeros(len(atoms))])
    atoms.calc = MagneticRepulsion(atoms, law(L, s), bonds=pairs, foundation=0.4 * s, anchors=anchors)
    return atoms


def law(L, s):
    """0.1 N at 10 mm."""
    return InversePower(b=0.1 * 10.0**POWER * s * L ** (POWER + 1), a=float(POWER))


def answers(seed, L, s, m):
    """What is asked of a structure, and with which powers of L, s and m it goes."""
    rest, tau = relaxed(patch(seed, L, s, m)), np.sqrt(m / s)
    atoms = rest.atoms
    free = int(np.setdiff1d(np.arange(len(atoms)), [k for c in atoms.constraints for k in c.index])[0])
    force = np.zeros((len(atoms), 3))
    force[free, :2] = 1e-3 * s * L, 2e-3 * s * L
    omega = np.linspace(0.1, 1.5, 7) / tau
    dt = 0.2 / highest_frequency(atoms)
    drive, gamma = Harmonic(free, (1, 2), 1e-3 * s * L, omega[2]), 0.05 / tau
    moved = propagate(atoms, dt * np.array([1.0, 30.0, 100.0]), [drive], damping=gamma)
    run = atoms.copy()
    run.calc = atoms.calc
    DrivenVerlet(run, dt, [drive], damping=gamma, engine='ase').run(100)
    told = verdict(atoms)
    return {
        'places': (atoms.positions - atoms.calc.anchors, (1, 0, 0)),
        'shift': (rest.shift, (1, 0, 0)),
        'forces before': (rest.before, (1, 1, 0)),
        'steps, saddles': ((rest.steps, rest.saddles), (0, 0, 0)),
        'lowest squared frequency': (rest.lowest, (0, 1, -1)),
        'energy': (atoms.get_potential_energy(), (2, 1, 0)),
        'modes': (modes(atoms).omega, (0, 0.5, -0.5)),
        'longest time step': (dt, (0, -0.5, 0.5)),
        'response': (abs(frequency_response(atoms, force, omega, gamma).response), (1, 0, 0)),
        'transient': (moved.displacements, (1, 0, 0)),
        'velocities of the transient': (moved.velocities, (1, 0.5, -0.5)),
        'run': (run.positions - atoms.positions, (1, 0, 0)),
        'needed': (told['buckling'].needed, (0, 1, 0)),
        'residual': (told['residual'], (1, 1, 0)),
        'support': (told['supports'], (0, 1, 0)),
        'linear amplitude': (told['amplitude'], (1, 0, 0)),
        'no fault': (told.fine, (0, 0, 0)),
        'held': (told['buckling'].spacing or np.nan, (1, 0, 0)),
    }


@pytest.mark.parametrize(('seed', 'several'), few_first([(4, UNITS[-2:]), (0, UNITS), (4, UNITS), (8, UNITS)], 1))
def test_no_answer_depends_on_the_units(seed, several):
    own = answers(seed, 1.0, 1.0, 1.0)
    for units in several:
        for name, (value, powers) in answers(seed, *units).items():
            known = np.asarray(own[name][0], float)
            found = np.asarray(value, float) / np.prod(np.power(units, powers))
            # factors are exact but in powers and roots, whose rounding conditions like 1e4 magnify
            assert_allclose(found, known, rtol=0, atol=1e-9 * np.nan_to_num(abs(known)).max(), err_msg=f'{name} {units}')


@pytest.mark.parametrize('units', few_first(UNITS, 3))
def test_balance_is_judged_alike_in_all_units(units):
    L, s, m = units
    for share, accepted in ((0.3, True), (3.0, False)):
        atoms = relaxed(patch(0, L, s, m)).atoms
        free = int(np.setdiff1d(np.arange(len(atoms)), [k for c in atoms.constraints for k in c.index])[0])
        largest = abs(atoms.calc.laws.dphi(atoms.calc.bonds.lengths)).max()
        load = atoms.calc.load.copy()
        load[free, 0] += share * BALANCED * largest
        atoms.calc = atoms.calc.about(atoms.calc.reference, load)
        assert bool(LinearSystem.about(atoms.calc, atoms).left.any()) is not accepted


@pytest.mark.parametrize('units', few_first(UNITS, 3))
def test_balance_of_all_neighbours_is_judged_alike_in_all_units(units):
    L, s, m = units

    def moved(way):
        cell = lattices.honeycomb(10.0 * L, 0.7 * m)
        cell.positions[1, 0] += way * L
        cell.calc = AllNeighbours(cell, law(L, s))
        return cell, np.linalg.norm(cell.get_forces(), axis=1).max() / abs(cell.calc.laws.dphi(10.0 * L))

    slope = moved(1e-3)[1] / 1e-3  # share of the force of a bond that nothing balances, per mm
    assert critical_foundation(moved(0.3 * BALANCED / slope)[0], steps=2)[0] >= 0
    with pytest.raises(ValueError, match='not at rest'):
        critical_foundation(moved(3 * BALANCED / slope)[0], steps=2)


@pytest.mark.parametrize('units', UNITS)
def test_a_plane_is_judged_alike_in_all_units(units):
    L, s, m = units
    for height, dim in ((1e-10, 2), (1e-8, 3)):
        atoms = lattices.hexagon(lattices.triangular(10.0 * L, 0.7 * m), 15.0 * L)
        atoms.positions[3, 2] += height * 10.0 * L
        assert MagneticRepulsion(atoms, law(L, s)).dim == dim
    with pytest.raises(ValueError, match='planar particles must share one z'):
        MagneticRepulsion(atoms, law(L, s), dim=2)


@pytest.mark.slow
@pytest.mark.parametrize('engine', ['ase', 'compiled'])
def test_a_particle_that_leaves_its_cage_ends_the_run_alike_in_all_units(engine):
    # the weak square lattice: along the diagonal nothing is in the way but the second neighbour
    ends = []
    for L, s, m in [(1.0, 1.0, 1.0), *UNITS]:
        atoms = lattices.hexagon(lattices.square(10.0 * L, 0.7 * m), 30.0 * L)
        atoms.calc = MagneticRepulsion(atoms, InversePower(b=1000.0 * s * L ** (POWER + 1), a=float(POWER)))
        middle, tau = np.linalg.norm(atoms.positions, axis=1).argmin(), np.sqrt(m / s)
        velocity = 3.0 * L / tau
        atoms.set_momenta(0.7 * m * velocity * np.outer(np.arange(len(atoms)) == middle, np.array([0.6, 0.8, 0])))
        with pytest.raises(Diverged) as caught:
            DrivenVerlet(atoms, 0.05 * tau, engine=engine).run(200)
        ends.append((caught.value.particle, caught.value.time / tau, caught.value.last_good / tau))
    assert_allclose(ends, np.tile(ends[0], (len(ends), 1)), rtol=1e-9)  # the same step, up to round-off


def test_a_wrong_unit_is_noticed():
    # the control: a foundation that does not go with the other stiffnesses
    own, other = (modes(relaxed(patch(0, s=s)).atoms).omega / np.sqrt(s) for s in (1.0, 4.0))
    assert_allclose(own, other, rtol=1e-9)
    stiff = patch(0, s=4.0)
    stiff.calc.set(foundation=0.4)
    assert abs(modes(relaxed(stiff).atoms).omega / 2 - own).max() > 0.01 * own.max()
