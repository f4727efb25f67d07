"""The card of a law: scenes, fits and verdicts read it; a law of a script needs none and behaves as the built-in ones."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles import lattice
from scipy.interpolate import CubicSpline
from structures import few_first

import magphonon.interactions as room
from magphonon import InversePower, MagneticRepulsion, read_scene, units as u, verdict
from magphonon.bands.bloch import bloch_modes
from magphonon.interactions import Tabulated, UprightMagnets, Yukawa
from magphonon.interactions.bond_laws import law_from_dict, law_to_dict
from magphonon.interactions.law_cards import Card, Kind, Parameter, card_of, kinds_of_laws
from magphonon.interactions.pair_laws import higher_derivatives
from magphonon.stiffness.all_neighbours import AllNeighbours

BONDS = {'chain': 2, 'square': 4, 'triangular': 6}  # nearest neighbours of a particle


@dataclass(frozen=True)
class Exponential:
    """phi = strength exp(-r/length), of nobody's laboratory."""

    strength: float
    length: float

    def phi(self, r):
        return self.strength * np.exp(-r / self.length)

    def dphi(self, r):
        return -self.phi(r) / self.length

    def d2phi(self, r):
        return self.phi(r) / self.length**2


class Spline:
    """A law that takes no complex distances."""

    def __init__(self, law, r):
        self.force = CubicSpline(r, -law.dphi(r))

    def phi(self, r):
        return -self.force.antiderivative()(r)

    def dphi(self, r):
        return -self.force(r)

    def d2phi(self, r):
        return -self.force(r, 1)


def drawn(seed):
    """A lattice of nearest neighbours, a law of a script and that of charges."""
    rng = np.random.default_rng(seed)
    name = list(BONDS)[seed % len(BONDS)]
    own = Exponential(float(rng.uniform(1, 50)), float(rng.uniform(2, 6)))
    return name, lattice(name), own, InversePower.coulomb(float(rng.uniform(1, 5)) * 1e-3 * u.A * u.s)


def supports(atoms, law):
    atoms.calc = MagneticRepulsion(atoms, law)
    return verdict(atoms).finding('supports')


@pytest.mark.parametrize('seed', few_first(range(6), 2))
def test_supports_of_central_laws_and_of_upright_magnets_by_closed_forms(seed):
    """Out of the plane a central bond has phi'/r, that of upright magnets -(phi'' + phi'/r) by Laplace's equation.  The softest
    wave of a Bravais lattice moves each particle against some of its neighbours: twice their sum over bonds, weighed.
    """
    name, atoms, own, charges = drawn(seed)
    r = atoms.cell.lengths()[0]
    waves = {'chain': 4, 'square': 8, 'triangular': 9}[name]  # largest sum of 1 - cos(q.R) over the bonds of a particle
    for law in (own, Yukawa(20.0, 0.3), charges):
        finding = supports(atoms, law)
        assert finding.value.central == pytest.approx(-waves * law.dphi(r) / r, rel=1e-6)
        assert 'magnets' not in finding.words  # nobody said that these are magnets; of charges both stiffnesses are equal
    for law in (own, Yukawa(20.0, 0.3)):
        upright = supports(atoms, UprightMagnets(law))
        k_zz = -(law.d2phi(r) + law.dphi(r) / r)
        assert abs(k_zz + law.dphi(r) / r) > 0.5 * abs(law.dphi(r) / r)  # the other stiffness would be seen
        assert upright.value.alone == pytest.approx(max(-BONDS[name] * k_zz, 0), rel=1e-6)
        assert upright.value.wave == pytest.approx(max(-waves * k_zz, 0), rel=1e-6)
        assert 'upright magnets' in upright.words or not upright.value.wave
    magnets = supports(atoms, InversePower(6200.0, 4.5))
    assert 'upright magnets' in magnets.words
    assert magnets.value.wave / magnets.value.central == pytest.approx(3.5, rel=1e-6)


def test_a_law_of_a_script_is_saved_by_name():
    law = Exponential(5.0, 3.0)
    for one in (law, UprightMagnets(law)):
        assert law_from_dict(law_to_dict(one)) == one
    assert law_to_dict(law)['law'] == f'{__name__}:Exponential'
    with pytest.raises(ValueError, match='is in no module that is imported; import its module first'):
        law_from_dict({'law': 'nobody.knows:Exponential', 'strength': 1.0, 'length': 1.0})
    for name in ('os:system', 'builtins:eval', 'dataclasses:dataclass', 'pathlib:Path', f'{__name__}:Spline'):
        with pytest.raises(ValueError, match='is in no module that is imported'):
            law_from_dict({'law': name})

    @dataclass(frozen=True)
    class Inside(Exponential):
        """A law inside a function, which no file can name."""

    assert 'text' in law_to_dict(Inside(5.0, 3.0))


@pytest.mark.parametrize('seed', range(6))
def test_a_law_without_complex_distances_has_higher_derivatives(seed):
    law = InversePower(6200.0, float(np.random.default_rng(seed).uniform(2, 9)))
    r = np.array([9.0, 12.5])
    exact = law.a * law.b * r ** -(law.a + 1) * -(law.a + 1) / r
    assert_allclose(higher_derivatives(law, r)[0], exact, rtol=1e-9)
    found = higher_derivatives(Spline(law, np.geomspace(5, 20, 4000)), r)[0]
    assert_allclose(found, exact, rtol=1e-3)
    assert not np.allclose(found, higher_derivatives(replace(law, a=law.a + 0.1), r)[0], rtol=1e-2)


def test_cards_say_what_scenes_fits_and_tolerances_know():
    kinds = kinds_of_laws()
    assert {name: (kind.strength, kind.shape) for name, kind in kinds.items()} == {
        'inverse_power': ('b', 'a'), 'dipoles': ('moment', ''), 'coulomb': ('charge', ''),
        'yukawa': ('strength', 'screening_length'),
        'hertz': ('', ''), 'table': ('forces', ''), 'magnets': ('remanence', '')}
    table = Tabulated([8.0, 9.0, 10.0, 12.0], [0.66, 0.38, 0.24, 0.10])
    assert [card_of(law).magnets for law in (table, Exponential(1, 1))] == [True, False]


def test_powers_of_strengths_are_those_of_the_forces():
    for kind in kinds_of_laws().values():
        if not kind.made:
            continue
        values = {name: 1e-3 * one.unit if name != 'poisson_ratio' else 0.3 for name, one in kind.parameters.items()}
        r = 0.9 * u.mm  # in contact
        for name, one in kind.parameters.items():
            more = kind.made(**values | {name: 1.01 * values[name]}).dphi(r) / kind.made(**values).dphi(r)
            assert not one.power or more == pytest.approx(1.01**one.power, rel=1e-9)
            if one.change:
                slope = one.change(kind.made(**values), u.m)
                assert slope.dphi(r) == pytest.approx((more - 1) / 0.01 * kind.made(**values).dphi(r), rel=0.02)


def test_a_new_law_is_a_class_with_its_card_and_a_line_in_the_room(monkeypatch):
    """What a new law takes: its class with a card, and its name among those of the room."""
    @dataclass(frozen=True)
    class Carded(Exponential):
        card: ClassVar = Card(kinds=(Kind('exponential', 'Energy `strength exp(-r/length)`.', {
            'energy': Parameter('energy_J', u.J, 'the strength in J', power=1),
            'decay_length': Parameter('decay_length_m', u.m, 'its length in m', quantity='length')},
            lambda energy, decay_length: Carded(energy, decay_length)),))

    monkeypatch.setattr(room, 'Carded', Carded, raising=False)
    monkeypatch.setattr(room, '__all__', [*room.__all__, 'Carded'])
    from magphonon.scenes import laws

    table = laws._of_card(kinds_of_laws()['exponential'])(kind='exponential', energy_J=5e-3, decay_length_m=3e-3)
    assert table.potential() == Carded(5e-3 * u.J, 3.0)
    with pytest.raises(ValueError, match='energy_J'):
        laws._of_card(kinds_of_laws()['exponential'])(kind='exponential', energy_J=-1.0, decay_length_m=3e-3)


def test_all_neighbours_take_any_mixture_of_gaussians():
    """A law of a script with the methods of one is summed over all neighbours as InversePower is."""
    law = InversePower(6200.0, 4.0)

    class Own:
        phi, dphi, d2phi = (lambda _, r, name=name: getattr(law, name)(r) for name in ('phi', 'dphi', 'd2phi'))
        gaussians, gaussian_moment = (lambda _, t, name=name: getattr(law, name)(t) for name in ('gaussians', 'gaussian_moment'))
        decay, screening = law.decay, law.screening

    cells = [lattice('triangular') for _ in range(2)]
    for cell, one in zip(cells, (law, Own()), strict=True):
        cell.calc = AllNeighbours(cell, one, foundation=0.1)
    assert_allclose(*(bloch_modes(cell, [[0.3, 0.1, 0]])[0] for cell in cells), rtol=1e-12)


@pytest.mark.parametrize('apart', [3e-6, 3e-5, 1e-4])
def test_readings_a_little_apart_are_two(apart):
    """Distances of a table that differ by more than round-off are two readings, however near: only equal ones are averaged."""
    r = np.array([8.0, 10.0, 10.0 * (1 + apart), 13.0, 17.0])
    assert_allclose(Tabulated(r, 2000.0 * r**-4.0).dphi(9.0), -2000.0 * 9.0**-4.0, rtol=1e-6)
    with pytest.raises(ValueError, match='are equal'):
        Tabulated(np.sort([8.0, 10.0, 10.0 * (1 + 1e-12), 13.0, 17.0]), 2000.0 * r**-4.0)


def test_a_law_with_parameters_of_no_tolerance_has_those_of_the_lattice(tmp_path):
    """Spheres in contact: neither their diameter nor their modulus is a tolerance, and the modulus is not that of a pillar."""
    (tmp_path / 'balls.toml').write_text('''title = "balls"
lattice = {kind = "square", spacing_m = 0.01999, mass_kg = 0.03}
law = {kind = "hertz", diameter_m = 0.02, youngs_modulus_Pa = 2e11, poisson_ratio = 0.3, shells = 1}
foundation = {stiffness_N_per_m = 1e7}
uncertainty = {spacing_percent = 0.001, mass_percent = 1.0}
''')
    scene = read_scene(tmp_path / 'balls.toml')
    assert set(scene.uncertainty.tolerances(scene).changes) == {'spacing', 'mass'}
