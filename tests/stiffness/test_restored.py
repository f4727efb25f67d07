"""Calculators in ASE's files and databases, and from them again to the same bits."""

import ase.db
import ase.io
import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixedLine
from ase.io.jsonio import decode, encode

from magphonon import MagneticRepulsion, lattices, magnet_law, relaxed
from magphonon.interactions import UprightMagnets
from magphonon.interactions.magnets import Cuboid
from magphonon.stiffness import AllNeighbours, restored
from tests.oracles import LAWS, Gaussian

OWN = {name: law for name, law in LAWS.items() if name != 'foreign'}


def patch(seed):
    """A structure drawn at random: crystal, hole, masses, tags, a guide; at times relaxed, at times displaced."""
    rng = np.random.default_rng(seed)
    name = ('triangular', 'square', 'honeycomb')[seed % 3]
    cell = getattr(lattices, name)(10.0 + rng.uniform(), 0.7)
    atoms = cell.repeat((4, 4, 1)) if seed % 2 else lattices.parallelogram(cell, 5, 4)
    atoms.set_masses(rng.uniform(0.5, 1.5, len(atoms)))
    atoms.set_tags(rng.integers(0, 3, len(atoms)))
    law = list(OWN.values())[seed % len(OWN)]
    atoms.calc = MagneticRepulsion(atoms, law, foundation=rng.uniform(3, 4) * law.d2phi(10.5),
                                   model=('complete', 'conventional')[seed % 2],
                                   load=np.pad(-0.01 * law.dphi(10.5) * rng.normal(size=(len(atoms), 2)), ((0, 0), (0, 1))))
    guide = FixedLine([len(atoms) // 2], (0.6, 0.8, 0))  # of norm one: ASE normalises any other anew, in its last bit
    atoms.set_constraint([*atoms.constraints, guide, FixAtoms([0])])
    if seed % 4 > 1:
        atoms = relaxed(atoms).atoms
    atoms.positions[:, :2] += 0.05 * rng.normal(size=(len(atoms), 2))
    return atoms


def same(atoms, again):
    """Whether two structures give the same bits of everything."""
    assert np.array_equal(again.positions, atoms.positions)
    assert np.array_equal(again.get_masses(), atoms.get_masses())
    assert np.array_equal(again.get_tags(), atoms.get_tags())
    assert [c.todict() for c in again.constraints] == [c.todict() for c in atoms.constraints]
    assert repr(again.calc.laws) == repr(atoms.calc.laws)
    assert again.get_potential_energy() == atoms.get_potential_energy()
    assert np.array_equal(again.get_forces(), atoms.get_forces())
    assert np.array_equal(again.calc.rest_hessian().toarray(), atoms.calc.rest_hessian().toarray())
    assert np.array_equal(again.calc.anchors, atoms.calc.anchors)
    return True


@pytest.mark.parametrize('computed', [True, False])
@pytest.mark.parametrize('seed', range(7))
def test_a_trajectory_keeps_every_bit(seed, computed, tmp_path):
    atoms = patch(seed)
    if computed:
        atoms.get_forces()
    ase.io.write(tmp_path / 'a.traj', atoms)
    found = ase.io.read(tmp_path / 'a.traj')
    again = restored(found)
    assert same(atoms, again)
    # control: a calculator made anew at the positions in the file is another one
    anew = found.copy()
    anew.calc = MagneticRepulsion(found, atoms.calc.laws, foundation=atoms.calc.foundation, bonds=atoms.calc.bonds)
    assert not np.array_equal(anew.get_forces(), atoms.get_forces())


LAWS_OF_MAGNETS = [*OWN.values(), magnet_law(Cuboid(4.0, 6.0, 5.0, 1.1)),
                   UprightMagnets(OWN['table'])]


@pytest.mark.parametrize('law', LAWS_OF_MAGNETS, ids=lambda law: type(law).__name__)
def test_every_law_comes_back(law):
    cell = lattices.triangular(10.0, 0.7)
    cell.calc = MagneticRepulsion(cell, law)
    again = MagneticRepulsion.fromdict(decode(encode(cell.calc.todict())))
    r = np.linspace(9.5, 12, 7)
    for name in ('phi', 'dphi', 'd2phi'):
        assert np.array_equal(getattr(again.law, name)(r), getattr(cell.calc.law, name)(r))
    assert type(again.laws) is type(law)


def test_all_neighbours_come_back():
    cell = lattices.honeycomb(10.0, 0.7)
    cell.calc = AllNeighbours(cell, LAWS['yukawa'], foundation=0.1, split=1.3)
    bare = cell.copy()
    again = restored(bare, decode(encode(cell.calc.todict())))
    q = np.array([[0.2, 0.1, 0]])
    assert np.array_equal(again.calc.bloch_matrix(q), cell.calc.bloch_matrix(q))
    assert type(again.calc) is AllNeighbours


def test_a_law_of_ones_own_is_given_again():
    cell = lattices.triangular(10.0, 0.7)
    cell.calc = MagneticRepulsion(cell, Gaussian())
    parameters = decode(encode(cell.calc.todict()))
    with pytest.raises(ValueError, match=r'Gaussian.*is not one of .*InversePower.*Yukawa.*fromdict\(parameters, laws=law\)'):
        MagneticRepulsion.fromdict(parameters)
    again = MagneticRepulsion.fromdict(parameters, Gaussian())
    assert np.array_equal(again.rest_hessian().toarray(), cell.calc.rest_hessian().toarray())


def test_what_is_no_calculator_is_refused(tmp_path):
    cell = lattices.triangular(10.0, 0.7)
    calc = MagneticRepulsion(cell, OWN['yukawa'])
    with pytest.raises(ValueError, match=r'must be a dictionary from PairCalculator.todict\(\), not 3'):
        MagneticRepulsion.fromdict(3)
    with pytest.raises(ValueError, match='are parameters of PairCalculator, not of AllNeighbours'):
        AllNeighbours.fromdict(calc.todict())
    with pytest.raises(ValueError, match='lacks anchors'):
        MagneticRepulsion.fromdict({key: value for key, value in calc.todict().items() if key != 'anchors'})
    for i in ([-1, 0, 0], [0, 0, 1], [0]):
        with pytest.raises(ValueError, match='must have pairs i, j of the 1 particles'):
            MagneticRepulsion.fromdict(calc.todict() | {'bonds': calc.todict()['bonds'] | {'i': i}})
    ase.io.write(tmp_path / 'bare.traj', cell)
    for bare in (cell, ase.io.read(tmp_path / 'bare.traj'), Atoms('H')):
        with pytest.raises(ValueError, match='written without a calculator of magphonon'):
            restored(bare)
    with pytest.raises(ValueError, match='calculator must be one of'):
        restored(cell, {'calculator': 'EMT'})


def test_numbers_in_other_units_and_without_masses_are_refused():
    cell = lattices.honeycomb(10.0, 0.7)
    cell.calc = MagneticRepulsion(cell, LAWS['yukawa'])
    for change, words in (({'units': 'Angstrom, eV'}, 'not in mm, g, ms'), ({'reference': None}, 'table of numbers')):
        with pytest.raises(ValueError, match=words):
            restored(cell, cell.calc.todict() | change)
    saved = cell.calc.todict()
    del saved['reference']['masses']
    with pytest.raises(ValueError, match='reference lacks masses'):
        restored(cell, saved)
