"""A tool obeys the model of its calculator: of D0 it says what it says of D0 when asked for it by name."""

import numpy as np
import pytest
from oracles import LAWS, lattice
from structures import structure

from magphonon import InversePower, MagneticRepulsion, critical_foundation, lattices, verdict
from magphonon.bands import (
    band_gaps,
    chern_numbers,
    complex_bands,
    edge_flow,
    group_velocities,
    lattice_density,
    sound_speeds,
)
from magphonon.bands.bloch import bloch_modes, damped_modes
from magphonon.bands.density import band_ranges
from magphonon.design import StiffnessDerivative, Tolerances, frequency_sensitivities, frequency_spread
from magphonon.stiffness import LinearSystem

Q = np.random.default_rng(11).uniform(-0.5, 0.5, (3, 3))
LAW = InversePower(1.0, 4.0)
HARDER = [StiffnessDerivative(mass=0.3, foundation=0.01)]

CELLS = {  # of any cell at rest
    'bloch_modes': lambda a, *m: bloch_modes(a, Q * a.pbc, *m)[0],
    'damped_modes': lambda a, *m: damped_modes(a, Q * a.pbc, np.linspace(0.1, 0.2, len(a)), *m)[0],
    'group_velocities': lambda a, *m: np.nan_to_num(group_velocities(a, Q * a.pbc, *m).velocity),
    'lattice_density': lambda a, *m: lattice_density(a, None, 6, *m).omega,
    'band_ranges': lambda a, *m: band_ranges(a, 6, *m),
    'critical_foundation': lambda a, *m: critical_foundation(a, *m).k,
    'LinearSystem.bloch': lambda a, *m: LinearSystem.of(a).bloch(Q * a.pbc, *m),
    'rest_hessian': lambda a, *m: a.calc.rest_hessian(*m).toarray(),
}
PERFECT = {  # of perfect lattices
    'sound_speeds': lambda a, *m: sound_speeds(a, None, *m),
    'complex_bands': lambda a, *m: np.sort(abs(complex_bands(a, (0, 1, 0), [0.8], *m).xi[:, :2])),
    'frequency_sensitivities': lambda a, *m: frequency_sensitivities(a, Q * a.pbc, HARDER, *m)[1],
    'frequency_spread': lambda a, *m: frequency_spread(a, Q * a.pbc, Tolerances({'p': HARDER[0]}, np.eye(1)), *m).std,
}


def with_model(atoms, model):
    other = atoms.copy()
    other.calc = atoms.calc.about(atoms.calc.reference, model=model)
    return other


def obeys(ask, atoms):
    """Whether a question about D0 has one answer, and another one than that about D0 + D*."""
    complete, D0 = with_model(atoms, 'complete'), with_model(atoms, 'conventional')
    asked, own = ask(complete, 'conventional'), ask(D0)
    np.testing.assert_allclose(own, asked, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(ask(D0, 'complete'), ask(complete), rtol=1e-9, atol=1e-12)
    whole = ask(complete)
    return np.shape(whole) == np.shape(own) and np.allclose(whole, own, rtol=1e-3)


@pytest.mark.parametrize('tool', CELLS)
def test_of_drawn_cells(tool):
    alike = [obeys(CELLS[tool], structure(seed, periodic=True, most=6, strip=False, guided=tool != 'group_velocities').atoms)
             for seed in range(40, 44)]
    assert sum(alike) <= 2  # control: a chain along x, or one that needs no foundation either way


@pytest.mark.parametrize('tool', PERFECT)
def test_of_perfect_lattices(tool):
    alike = []
    for name in ('square', 'triangular', 'honeycomb'):
        atoms = lattice(name)
        atoms.calc = MagneticRepulsion(atoms, LAWS['magnets'], foundation=0.2)
        alike.append(obeys(PERFECT[tool], atoms))
    assert not all(alike)  # control; a triangular lattice holds itself at every spacing, by either model


def test_with_gyration():
    atoms = lattices.honeycomb(1.0, 1.0)
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=6.0, gyration=1.55)
    assert not obeys(chern_numbers, atoms)
    assert not obeys(lambda a, *m: band_gaps(a, 12, *m)[:1], atoms)
    strip = lattices.ribbon(atoms, 20)
    strip.calc = MagneticRepulsion(strip, atoms.calc.laws, foundation=6.0, gyration=1.55)
    assert edge_flow(with_model(strip, 'conventional'), 3.44)[:2] == (1, -1) != edge_flow(with_model(strip, 'complete'), 3.26)[:2]


@pytest.mark.parametrize('gyration', [0.0, 0.5])
def test_a_verdict_of_D0_never_calls_a_buckling_lattice_stable(gyration):
    """It is judged by the complete model, whatever the calculator computes."""
    for name, softest in (('square', 4.0), ('honeycomb', 3.0)):
        cell = getattr(lattices, name)(1.0, 1.0)
        cell.calc = MagneticRepulsion(cell, LAW, foundation=0.5, gyration=gyration)
        complete, D0 = (verdict(with_model(cell, model)) for model in ('complete', 'conventional'))
        assert not any(judged.fine for judged in (complete, D0))
        assert D0['buckling'].needed == pytest.approx(complete['buckling'].needed, rel=1e-9)
        assert D0['buckling'].growth == pytest.approx(complete['buckling'].growth, rel=1e-9)
        assert D0['buckling'].spacing == complete['buckling'].spacing
        cell.calc.set(gyration=0)
        alone = critical_foundation(with_model(cell, 'conventional')).k  # the control
        assert alone < 1e-9 < softest / 2 < complete['buckling'].needed
