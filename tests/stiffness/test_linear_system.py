"""The linear system of a structure: the equations of motion that its forces have, made once and handed on."""

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine, FixedPlane
from numpy.testing import assert_array_equal
from oracles import LAWS

from magphonon import InversePower, MagneticRepulsion, frequency_response, lattices, modes
from magphonon.dynamics.engine import frequency_bound, highest_frequency
from magphonon.response.frf import harmonic_response
from magphonon.response.normal_modes import natural_frequencies
from magphonon.stability.amplitude_shifts import frequency_shifts
from magphonon.stability.buckling import critical_foundation
from magphonon.stiffness.rest import LinearSystem

OMEGA = np.linspace(0.1, 2.0, 5)


def patch(seed, model='complete', law=LAWS['magnets'], foundation=2.0):
    """A held patch of unequal masses, in which some particles are guided; at rest by a dead load, away from its anchors."""
    rng = np.random.default_rng(seed)
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.5), 30.0)
    free = np.flatnonzero(atoms.get_tags() == 0)
    atoms.positions[free, :2] += rng.normal(scale=0.2, size=(len(free), 2))
    atoms.set_masses(rng.uniform(0.3, 2.0, len(atoms)))
    along, across = rng.normal(size=(2, 2))
    atoms.set_constraint([*atoms.constraints, FixedLine(free[:2].tolist(), (*along, 0)), FixedPlane([free[2]], (*across, 0))])
    atoms.calc = MagneticRepulsion(atoms, law, foundation=foundation, model=model, cutoff=14.0).balanced(free)
    return atoms


@pytest.mark.parametrize('tool', [
    modes, natural_frequencies, highest_frequency, frequency_shifts, critical_foundation,
    lambda x: frequency_bound(x, 0.3), lambda x: harmonic_response(x, push(), OMEGA, 0.1).response,
    lambda x: frequency_response(x, push(), OMEGA, 0.1, [18]).response,
], ids=lambda tool: tool.__name__)
def test_a_system_that_is_handed_on_gives_the_answer_of_its_atoms_to_the_bit(tool):
    soft = InversePower(3.0, 1.0)  # which needs its foundation
    atoms = patch(4, law=soft)
    direct, handed_on = tool(atoms), tool(LinearSystem.of(atoms))
    for a, b in zip(flat(direct), flat(handed_on), strict=True):
        assert_array_equal(a, b)
    other = tool(patch(5, law=InversePower(6.0, 1.5), foundation=3.0))  # the control: the answer is that of the structure
    assert any(not np.array_equal(a, b) for a, b in zip(flat(other), flat(direct), strict=True))


def push():
    force = np.zeros((len(patch(4)), 3))
    force[18, 0] = 1.0
    return force


def flat(result):
    if isinstance(result, tuple):
        return [np.asarray(part) for part in result]
    return [np.asarray(part) for part in vars(result).values()] if hasattr(result, '__dict__') else [np.asarray(result)]


def test_what_is_made_stays_when_the_atoms_move_on():
    atoms = patch(5)
    system, before = LinearSystem.of(atoms), modes(atoms).omega
    atoms.positions[:, :2] += 0.1
    atoms.set_constraint(FixAtoms([0]))
    assert_array_equal(modes(system).omega, before)
    with pytest.raises(ValueError, match='not at rest'):
        LinearSystem.of(atoms)


def test_what_is_held_everywhere_has_no_modes_but_a_verdict():
    atoms = patch(5)
    atoms.set_constraint(FixAtoms(range(len(atoms))))
    assert highest_frequency(atoms) == 0
    with pytest.raises(ValueError, match='hold every particle'):
        modes(atoms)
