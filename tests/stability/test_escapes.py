"""The two speeds that enclose the impact that costs a particle its cage: shots below and above, on lattices drawn at random.

`python -m pytest -m long tests/stability/test_escapes.py` draws forty.
"""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixedLine
from motion import L0, LAW, MASS

from magphonon import Diverged, DrivenVerlet, InversePower, MagneticRepulsion, Tabulated, foundation_needed, lattices, verdict
from magphonon.stability import escape_speeds, escapes


def prototype():
    cell = lattices.triangular(L0, MASS)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=0.0196757)
    return cell


def drawn(seed):
    """A lattice with a law, masses, shells and a foundation that holds it."""
    rng = np.random.default_rng(seed)
    cell, a = getattr(lattices, rng.choice(['triangular', 'square', 'honeycomb', 'kagome']))(L0, MASS), rng.uniform(2, 7)
    cell.set_masses(MASS * (rng.uniform(0.5, 2, len(cell)) if len(cell) > 1 else np.ones(1)))
    cell.calc = MagneticRepulsion(cell, InversePower(b=10.0**a, a=a), shells=int(rng.integers(1, 3)))
    cell.calc.set(foundation=foundation_needed(cell)[0] * rng.uniform(1.1, 4) + rng.choice([0, 0.3]) * rng.random())
    return cell


def lost(cell, speed, particle, angle):
    """Whether a particle of the periodic lattice, eight spacings wide, loses its cage when it is shot."""
    n = np.ceil(8 * L0 / cell.cell.lengths()[:2]).astype(int)
    atoms = cell.repeat((*n, 1))
    atoms.calc = cell.calc.on(atoms)
    shot = np.arange(len(atoms)) == len(cell) * (n[1] * (n[0] // 2) + n[1] // 2) + particle
    atoms.set_momenta(np.outer(shot * atoms.get_masses(), speed * np.array([np.cos(angle), np.sin(angle), 0])))
    # a fiftieth of a spacing, and a sixth of the limit where bonds are five times as stiff as at rest
    dt = min(0.02 * L0 / speed, 0.15 / np.sqrt(40 * cell.calc.laws.d2phi(L0) + cell.calc.parameters.foundation))
    try:
        DrivenVerlet(atoms, dt, engine='numpy', allow_unstable=True).run(int(5 * L0 / speed / dt))
    except Diverged:
        return True
    return False


def check_both_sides(cell, rng, shots):
    escape, masses = escape_speeds(cell), cell.get_masses()
    for particle in rng.integers(0, len(cell), shots):
        speed = 0.98 * escape.safe * np.sqrt(masses.max() / masses[particle])  # the same energy for a lighter one
        assert not lost(cell, speed, particle, rng.uniform(0, 2 * np.pi))
    angle = np.arctan2(*escape.direction[::-1])
    # the particles of the larger lattice yield more: up to 3 % are to be expected from 3 to 4 spacings around
    assert any(lost(cell, 1.03 * escape.leaves, escape.particle, angle + turn) for turn in (0, 0.03, -0.03))
    return escape


def test_the_prototype_loses_magnets_between_the_speeds_at_which_shots_stayed_and_left():
    escape = check_both_sides(prototype(), np.random.default_rng(0), 2)
    # shots in a hexagon turn back at 3.5 m/s and leave at 4 (test_cages); the cheapest place with all magnets of periodic
    # patches of 6 x 6 and 8 x 8 yielding, found before this was written, lies at 1.829 and 1.805 m/s
    assert 3.5 < escape.leaves < 4.0
    assert 1.78 < escape.safe < 1.83


def test_two_neighbours_by_themselves_say_nothing():
    # the control: 84.6 m/s brings two to a tenth of their distance; long before that a magnet leaves between its neighbours
    climbed = LAW.phi(0.1 * L0) - LAW.phi(L0)
    speed = np.sqrt(2 * climbed / MASS)
    assert speed == pytest.approx(84.6, abs=0.1)
    assert lost(prototype(), 0.1 * speed, 0, 0.4)


@pytest.mark.parametrize('seed', [2, 11])
def test_shots_below_stay_and_shots_above_leave(seed):
    check_both_sides(drawn(seed), np.random.default_rng(seed), 2)


@pytest.mark.long
@pytest.mark.parametrize('seed', range(40))
def test_shots_at_many_lattices(seed):
    check_both_sides(drawn(seed), np.random.default_rng(seed), 12)


@pytest.mark.parametrize(('foundation', 'energy'), [(0.0, 4 / 3), (10.0, 8.1 + 10 * 0.81 / 2)])
def test_one_particle_on_a_line_spends_all_its_energy_on_the_way(foundation, energy):
    """Charges, phi = 1/r, and a load of 1 that holds one of them at 1 from the other: away to 3, or near to a tenth.

    phi(3) - phi(1) + 2 = 4/3 without a foundation; with it this would be dearer than phi(0.1) - phi(1) - 0.9 + k 0.81/2.
    """
    pair = Atoms('Nd2', positions=[[0, 0, 0], [1, 0, 0]], masses=[2.0, 2.0])
    pair.set_constraint([FixAtoms([0]), FixedLine([1], (1, 0, 0))])
    pair.calc = MagneticRepulsion(pair, InversePower(1.0, 2.0), foundation=foundation).balanced([1])
    judged = verdict(pair)
    safe, leaves = judged.impacts.safe, judged.impacts.leaves
    assert safe == pytest.approx(np.sqrt(energy), rel=2e-3)  # the drag ends within 1e-3 of the distance
    assert safe <= leaves < 1.1 * safe  # two speeds tried are 5 % apart; runs are looked at by steps
    assert f'below {np.floor(safe * 100) / 100:g} m/s' in str(judged)


def test_what_has_many_bonds_or_a_law_that_ends_near_is_not_judged():
    cell = prototype()
    cell.calc = MagneticRepulsion(cell, LAW, shells=4, foundation=0.0196757)  # 30 bonds each
    assert escape_speeds(cell) is None
    r = np.linspace(0.7, 4, 100) * L0  # on the way through the gap two neighbours are at 0.58
    cell.calc = MagneticRepulsion(cell, Tabulated(r, -LAW.dphi(r)), foundation=0.0196757)
    assert escape_speeds(cell) is None


@pytest.mark.parametrize('spacing', [0.2, 20.0])
@pytest.mark.parametrize(('angle', 'judged'), [(66, False), (70, True)])
def test_unbonded_neighbours_count_only_where_they_rest_well_apart(spacing, angle, judged):
    """Two without a bond rest at 1.09 or 1.15 spacings: only from the latter may they come as near as bonded ones."""
    angle = np.deg2rad(angle)
    cell = Atoms('Nd', cell=spacing * np.array([[1, 0, 0], [np.cos(angle), np.sin(angle), 0], [0, 0, 2]]), pbc=(1, 1, 0),
                 masses=[1e-3 * spacing**3])
    atoms = cell.repeat((4, 4, 1))
    atoms.calc = MagneticRepulsion(atoms, InversePower(spacing**4, 4.0), foundation=1.0, cutoff=1.02 * spacing)
    with np.errstate(divide='ignore'):  # straight ways may lead through a particle
        places = escapes._places(atoms)
    nearer = [place for place in places if place.distance == pytest.approx(spacing)]
    assert bool(nearer) == judged
