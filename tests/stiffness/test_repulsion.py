"""Both calculators are a Repulsion; what needs single bonds refuses the sum over all neighbours and the calculators of others."""

import pytest
from ase.calculators.lj import LennardJones
from oracles import lattice

from magphonon import InversePower
from magphonon.stiffness import AllNeighbours
from magphonon.stiffness.repulsion import Repulsion, repulsion_of


def test_what_knows_no_single_bonds_is_refused_where_they_are_needed():
    atoms = lattice('triangular')
    atoms.calc = AllNeighbours(atoms, InversePower(b=1e12, a=12.0))
    with pytest.raises(ValueError, match='AllNeighbours does not have'):
        repulsion_of(atoms)
    atoms.calc = LennardJones()
    assert not isinstance(atoms.calc, Repulsion)
    with pytest.raises(ValueError, match=r'attach atoms\.calc'):
        repulsion_of(atoms)
