"""The rows of Figs. 2 and 6 that ASE's own class makes: its steps are counted."""

import pytest

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
from magphonon.scenes.scene import reference
from workflows import ase_loop


def patch():
    atoms = lattices.hexagon(lattices.triangular(1.0, 1.0), 4.0)
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), foundation=1.0)
    return atoms


@pytest.mark.parametrize(('engine', 'steps'), [
    ('ase', 120), ('auto', 120), pytest.param('compiled', 0, marks=pytest.mark.slow)])
def test_only_steps_of_the_class_count(engine, steps):
    """A short run is done by the class without anybody's asking."""
    before = ase_loop.VelocityVerlet.step
    with ase_loop.counted() as calls:
        DrivenVerlet(patch(), 0.05, engine=engine).run(120)
    assert calls == [steps]
    assert ase_loop.VelocityVerlet.step is before


@pytest.mark.slow
def test_the_oscillator_takes_more_than_ten_thousand_steps_of_the_class():
    rows = ase_loop.resonance(reference()['oscillator']['omega_y'][0], 12.0)
    assert all(row.passed for row in rows)
    assert rows[-1].here > 10_000
