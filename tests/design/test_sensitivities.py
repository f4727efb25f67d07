"""Derivatives of frequencies and responses, against central differences of lattices built anew and closed forms."""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed, units
from magphonon.bands.bloch import bloch_modes
from magphonon.design import sensitivities
from magphonon.design.sensitivities import (
    StiffnessDerivative,
    exponent_change,
    force_change,
    frequency_sensitivities,
    hessian_changes,
    screening_change,
    spacing_change,
)
from magphonon.interactions import Yukawa
from magphonon.interactions.pair_laws import Tabulated
from magphonon.stiffness.rest import LinearSystem

STEP = 1e-5  # of central differences: STEP^2 times a third derivative of some 100 is 1e-8
Q = np.array([[0, 0, 0], [0.11, 0.07, 0], [0.5, 0, 0], [1 / 3, 1 / 3, 0], [0.3, -0.2, 0]])  # Gamma, M, K, and between
R_MM = np.geomspace(5, 40, 12)

LAWS = {
    'inverse power': lambda p: InversePower(p['b'] * units.m ** p['a'], p['a']),
    'Yukawa': lambda p: Yukawa(p['b'] * 1e10, 1 / (20 * p['l'])),
    'table': lambda p: Tabulated(R_MM, p['b'] * 1e12 * R_MM**-3.0 * (1 + 0.1 * np.sin(R_MM / 9))),
}
START = {'spacing': 10.0, 'mass': 0.7, 'b': 1.6e-10, 'a': 4.58, 'l': 1.0, 'k': 0.02}


def lattice(law='inverse power', kind='triangular', shells=2, **factors):
    """A cell whose parameters are START times the factors."""
    p = {name: value * factors.get(name, 1) for name, value in START.items()}
    atoms = getattr(lattices, kind)(p['spacing'], p['mass'])
    atoms.calc = MagneticRepulsion(atoms, LAWS[law](p), foundation=p['k'], shells=shells)
    return atoms


def changes_of(law='inverse power'):
    potential = LAWS[law](START)
    changes = {'spacing': StiffnessDerivative(law=spacing_change(potential)), 'mass': StiffnessDerivative(mass=1.0),
               'k': StiffnessDerivative(foundation=START['k']),
               'b': StiffnessDerivative(law=force_change(potential))}
    if law == 'inverse power':
        changes['a'] = StiffnessDerivative(law=exponent_change(potential))
    if law == 'Yukawa':
        changes['l'] = StiffnessDerivative(law=screening_change(potential))
    return changes


@pytest.mark.parametrize('model', ['complete', 'conventional'])
@pytest.mark.parametrize(('law', 'kind'), [('inverse power', 'triangular'), ('Yukawa', 'triangular'), ('table', 'triangular'),
                                           ('inverse power', 'honeycomb'), ('Yukawa', 'kagome')])
def test_frequency_slopes_are_those_of_lattices_built_anew(law, kind, model):
    changes = changes_of(law)
    omega, slopes = frequency_sensitivities(lattice(law, kind), Q, changes.values(), model)
    for name, slope in zip(changes, slopes, strict=True):
        up, down = (bloch_modes(lattice(law, kind, **{name: 1 + e}), Q, model)[0] for e in (STEP, -STEP))
        assert_allclose(slope, (up - down) / (2 * STEP), atol=1e-7 * abs(omega).max(), err_msg=name)
    wrong = {'complete': 'conventional', 'conventional': 'complete'}[model]
    other = frequency_sensitivities(lattice(law, kind), Q, changes.values(), wrong)[1]
    assert abs(other - slopes)[0].max() > 1e-2 * abs(omega).max()  # by the spacing; the control


def test_branches_that_symmetry_unites_have_one_slope():
    """At (1/2, 1/2) of the square lattice both modes have the stiffness 4 (phi'' + phi'/r)."""
    law = InversePower(1.0, 4.0)
    square = lattices.square(1.0, 1.0)
    square.calc = MagneticRepulsion(square, law, foundation=5.0)
    omega, (slope,) = frequency_sensitivities(square, [[0.5, 0.5, 0]], [StiffnessDerivative(law=spacing_change(law))])
    stiffness = 4 * (4 - 1)  # f = L0 = 1
    assert_allclose(omega**2, [[5.0 + stiffness] * 2], rtol=1e-13)
    assert_allclose(slope * 2 * omega, [[-5.0 * stiffness] * 2], rtol=1e-12)  # -(a + 1) of it


@pytest.mark.parametrize('mixed', [False, True])
def test_branches_that_cross_keep_their_own_slopes(mixed, monkeypatch):
    """Between Gamma and K two branches of the kagome lattice cross; the modes there may come mixed at will."""
    atoms, changes, m = lattice(kind='kagome'), list(changes_of().values()), 2

    def modes(s, **options):
        return bloch_modes(atoms, [[2 * s, s, 0]], **options)

    crossing = 0.2573306  # refined by straight lines through the gaps on both sides
    for step in (1e-4, 1e-4, 1e-7):
        left, right = (np.diff(modes(crossing + sign * step)[0][0])[m] for sign in (-1, 1))
        crossing += step * (left - right) / (left + right)
    sides = [frequency_sensitivities(atoms, [[2 * s, s, 0]], changes)[1][:, 0, m : m + 2]
             for s in (crossing - 1e-4, crossing + 1e-4)]
    smooth = (sides[0] + sides[1][:, ::-1]) / 2  # to second order in 1e-4; the branches have changed places
    omega, vectors = modes(crossing, vectors=True)
    if mixed:
        vectors[0, m : m + 2] = np.tensordot([[1, 1j], [1j, 1]], vectors[0, m : m + 2], 1) / np.sqrt(2)
        monkeypatch.setattr(sensitivities, 'bloch_modes', lambda *_, **__: (omega, vectors))
    found = frequency_sensitivities(atoms, [[2 * crossing, crossing, 0]], changes)[1][:, 0, m : m + 2]
    order = [0, 1] if abs(found - smooth).max() < abs(found - smooth[:, ::-1]).max() else [1, 0]
    assert_allclose(found[:, order], smooth, atol=1e-5 * abs(smooth).max())
    assert abs(smooth[:, 0] - smooth[:, 1]).max() > 0.02 * abs(smooth).max()  # by the exponent: a mixture has neither's


@pytest.mark.parametrize('seed', range(4))
def test_a_dead_load_stays_when_the_magnets_become_stronger(seed):
    """Magnets between two held ones, each pushed along the row, against a row that was relaxed anew."""
    draw = np.random.default_rng(seed)
    size = int(draw.integers(3, 7))
    load = np.pad(draw.uniform(1, 4, (size - 2, 1)), ((1, 1), (0, 2)))

    def row(strength):
        atoms = Atoms(['H'] * size, np.arange(size)[:, None] * [1.0, 0, 0], masses=np.ones(size))
        atoms.set_constraint(FixAtoms([0, size - 1]))
        atoms.calc = MagneticRepulsion(atoms, InversePower(strength, 4.0), foundation=9.0, load=load)
        return relaxed(atoms).atoms

    here, change = row(1.0), StiffnessDerivative(law=force_change(InversePower(1.0, 4.0)))
    (slope,) = hessian_changes(LinearSystem.of(here), [change])
    up, down = (LinearSystem.of(row(np.exp(e))).calc.rest_hessian().toarray() for e in (1e-4, -1e-4))
    assert_allclose(slope.toarray(), (up - down) / 2e-4, atol=1e-6 * abs(up).max())
    (following,) = hessian_changes(LinearSystem.of(here), [change], measured=True)
    assert abs((following - slope).toarray()).max() > 0.1 * abs(slope).max()  # the control: a load that follows
    with pytest.raises(ValueError, match='moves the particles'):
        frequency_sensitivities(here, [[0, 0, 0]], [change])
