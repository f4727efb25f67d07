"""The calculator as a part of ASE: results, copies, files, optimisers, units."""

import copy
import pickle

import numpy as np
import pytest
from cells import LAW, triangular_patch
from oracles import LAWS, lattice
from scipy import sparse

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.stiffness.plausibility import UnitWarning

# As a part of ASE


class Counting(InversePower):
    """Counts the evaluations of the force."""

    calls = 0

    def dphi(self, r):
        type(self).calls += 1
        return super().dphi(r)


def test_one_calculation_answers_all_questions():
    rest = lattice('triangular').repeat((2, 2, 1))
    rest.calc = MagneticRepulsion(rest, Counting(b=1.0, a=4.0))
    rest.get_forces()
    calls = Counting.calls
    for question in (rest.get_forces, rest.get_potential_energy, rest.get_potential_energies):
        question()
    assert Counting.calls == calls
    rest.positions[0, 0] += 0.1
    rest.get_potential_energy()
    assert Counting.calls == calls + 1


def test_the_smallest_move_is_seen():
    # ASE's own comparison overlooks moves below 1e-15, and a foundation alone would let them pass unnoticed
    atoms = lattice('triangular')
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=2.0)
    assert not atoms.get_forces().any()
    for move in (1e-17, 5e-324):
        atoms.positions[0, 0] = move
        assert atoms.get_forces()[0, 0] == -2.0 * move
    atoms.positions[0, 0] = 0.0
    assert not atoms.get_forces().any()


def test_changed_arrays_are_seen_and_returned_arrays_are_copies():
    atoms = triangular_patch()
    forces = atoms.get_forces()
    forces[:] = 0
    assert atoms.get_forces().any()


def test_setting_a_parameter_forgets_the_results():
    atoms = triangular_patch(foundation=0.02)
    with_springs = atoms.get_forces()
    atoms.calc.set(foundation=0.0)
    assert abs(atoms.get_forces() - with_springs).max() > 1e-4
    conventional = triangular_patch(model='conventional').get_forces()
    atoms.calc.set(model='conventional')
    np.testing.assert_array_equal(atoms.get_forces(), conventional)


@pytest.mark.parametrize('copied', [copy.deepcopy, lambda calc: pickle.loads(pickle.dumps(calc))], ids=['deepcopy', 'pickle'])
@pytest.mark.parametrize('law', LAWS.values(), ids=LAWS)
def test_copies(copied, law):
    atoms = triangular_patch(foundation=0.02)
    atoms.calc = MagneticRepulsion(atoms.calc.reference, law, foundation=0.02)
    forces = atoms.get_forces()  # fills what the calculator remembers
    other = atoms.copy()
    other.calc = copied(atoms.calc)
    np.testing.assert_array_equal(other.get_forces(), forces)
    other.calc.set(foundation=1.0)
    assert atoms.calc.parameters.foundation == 0.02
    np.testing.assert_array_equal(atoms.get_forces(), forces)


def test_hessian_is_a_property_that_no_file_sees():
    atoms = triangular_patch(foundation=0.02)
    H = atoms.calc.get_property('hessian', atoms)
    assert sparse.issparse(H)
    assert H.shape == (36, 36)
    assert 'hessian' not in atoms.calc.results
    assert atoms.calc.get_property('hessian', atoms, allow_calculation=False) is None
    parts = [atoms.calc.get_hessian(atoms, part) for part in ('D0', 'Dstar', 'foundation')]
    assert abs(sum(parts) - H).max() < 1e-15 * abs(H).max() * 12


@pytest.mark.parametrize('name', ['a.traj', 'a.extxyz'])
def test_written_and_read_again(tmp_path, name):
    import ase.io

    atoms = triangular_patch(foundation=0.02)
    forces, energy = atoms.get_forces(), atoms.get_potential_energy()
    ase.io.write(tmp_path / name, atoms)
    back = ase.io.read(tmp_path / name)
    # extxyz keeps eight decimals; a trajectory keeps all
    tolerance = {'rtol': 0, 'atol': 1e-8 if name.endswith('xyz') else 0}
    np.testing.assert_allclose(back.positions, atoms.positions, **tolerance)
    np.testing.assert_allclose(back.get_forces(), forces, **tolerance)
    assert back.get_potential_energy() == pytest.approx(energy, rel=1e-8)


def test_a_calculator_made_of_another_does_not_warn_again():
    cell = lattices.triangular(10.0, 0.7)
    with pytest.warns(UserWarning, match='mm, g, ms and N') as told:
        calc = MagneticRepulsion(cell, InversePower(b=1.6209e-10, a=4.5824))
    [warning] = [one for one in told if one.category is UnitWarning]
    assert warning.filename == __file__  # the line that made it, not one of the package
    calc.about(cell, foundation=0.0)
    calc.on(cell.repeat((2, 2, 1)))
