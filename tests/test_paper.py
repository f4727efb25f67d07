"""The numbers of arXiv:1911.10410, Secs. III and IV and Supplement, from `data/reference.toml`."""

import numpy as np
import pytest
from scipy.optimize import brentq

from magphonon import InversePower, MagneticRepulsion, lattices, units as u
from magphonon.bands import sound_speeds
from magphonon.bands.bloch import bloch_modes
from magphonon.interactions.pair_laws import repulsion
from magphonon.scenes.lattices import Pillar

# The numbers are given to ten digits or more.
PRINTED = 1e-9


def special(cell, name, model='complete'):
    """Angular frequencies at a special point of the zone, in rad/ms."""
    return bloch_modes(cell, cell.cell.bandpath(name, pbc=cell.pbc, npoints=1).kpts[:1], model)[0][0]


def degenerate(omega):
    return omega[1] - omega[0] < 1e-12 * omega[1]


# Sec. III: the oscillator

def oscillator(theta0, model='complete'):
    atoms = lattices.oscillator(theta0, 1 * u.m, 1 * u.kg)
    law = InversePower(b=1e4 * u.N * u.m**4, a=4.0)
    atoms.calc = MagneticRepulsion(atoms, law, model=model, bonds=lattices.OSCILLATOR_BONDS)
    return atoms


def oscillator_stiffness(theta0, part='all'):
    """Stiffness of the free particle in its plane, N/m."""
    atoms = oscillator(theta0)
    return atoms.calc.get_hessian(atoms, part).toarray()[9:11, 9:11] / (u.N / u.m)


@pytest.mark.parametrize('k', range(4))
def test_oscillator_stiffness(paper, k):
    numbers = paper['oscillator']
    theta0 = np.pi * numbers['theta0_over_pi'][k]
    complete = np.diag([numbers['D_xx'][k], numbers['D_yy'][k]])
    conventional = np.diag([numbers['D0_xx'][k], numbers['D0_yy'][k]])
    # an entry may be zero: relative to the largest; cos(pi/2) is 6e-17, not 0
    tolerance = {'rtol': 0, 'atol': PRINTED * 120000}
    np.testing.assert_allclose(oscillator_stiffness(theta0), complete, **tolerance)
    np.testing.assert_allclose(oscillator_stiffness(theta0, 'D0'), conventional, **tolerance)
    np.testing.assert_allclose(oscillator_stiffness(theta0, 'Dstar'), complete - conventional, **tolerance)
    # the control: the conventional stiffness is not the complete one, at any theta0
    assert abs(complete - conventional).max() > 0.05 * 120000


@pytest.mark.parametrize('k', range(4))
def test_oscillator_balancing_force(paper, k):
    numbers = paper['oscillator']
    atoms = oscillator(np.pi * numbers['theta0_over_pi'][k])
    pushed = atoms.get_forces(apply_constraint=False)[3] / u.N
    assert -pushed[1] == pytest.approx(numbers['balancing_force_y'][k], rel=PRINTED)
    assert abs(pushed[[0, 2]]).max() < 1e-12 * abs(pushed[1])  # the two side magnets cancel but for round-off
    assert not atoms.get_forces()[:3].any()  # the fixed ones are held


def test_oscillator_critical_angle(paper):
    critical = brentq(lambda theta0: oscillator_stiffness(theta0)[0, 0], 0.1, 1.5, xtol=1e-14, rtol=1e-14)
    assert critical / u.deg == pytest.approx(paper['oscillator']['theta_critical_deg'], rel=PRINTED)
    assert np.cos(critical) ** 2 == pytest.approx(3 / (2 * (4 + 1)), rel=1e-12)


# Sec. IV: the triangular lattice

@pytest.mark.parametrize('model', ['complete', 'conventional'])
def test_triangular_at_the_special_points(paper, ideal, model):
    numbers = paper['triangular']
    np.testing.assert_allclose(special(ideal, 'M', model) / (u.rad / u.s), numbers[f'M_{model}'], rtol=PRINTED)
    K = special(ideal, 'K', model)
    np.testing.assert_allclose(K / (u.rad / u.s), numbers[f'K_{model}'], rtol=PRINTED)
    assert degenerate(K)
    # the control: K of the paper's basis, (2/3, 1/3); what is K in a 120 degree cell is none here
    assert not degenerate(bloch_modes(ideal, [1 / 3, 1 / 3, 0], model)[0][0])


@pytest.mark.parametrize('angle', [0.0, 0.3, 1.0, 2.5])
@pytest.mark.parametrize(('model', 'suffix'), [('complete', ''), ('conventional', '_conventional')])
def test_triangular_sound_is_isotropic(paper, ideal, angle, model, suffix):
    expected = [paper['triangular'][name + suffix] for name in ('c_T', 'c_L')]
    speeds = sound_speeds(ideal, (np.cos(angle), np.sin(angle)), model)
    np.testing.assert_allclose(speeds / (u.m / u.s), expected, rtol=PRINTED)


# Supplement: the prototype

def test_prototype_law(paper, prototype):
    numbers = paper['prototype']
    r = numbers['spacing'] * u.m
    law = prototype.calc.laws
    assert repulsion(law, r) / u.N == pytest.approx(numbers['f_at_spacing'], rel=PRINTED)
    assert -law.d2phi(r) / (u.N / u.m) == pytest.approx(numbers['df_dr_at_spacing'], rel=PRINTED)


def test_prototype_pillar(paper):
    numbers = paper['prototype']
    of_paper = {'youngs_modulus_Pa': numbers['youngs_modulus'], 'height_m': numbers['pillar_height']}
    pillar = Pillar(radius_m=numbers['pillar_radius'], **of_paper)
    assert pillar.stiffness_N_per_m == pytest.approx(numbers['k_eq'], rel=PRINTED)
    # control: with the printed number taken for a diameter the pillar would be sixteen times softer
    assert Pillar(radius_m=numbers['pillar_radius'] / 2, **of_paper).stiffness_N_per_m < numbers['k_eq'] / 10


@pytest.mark.parametrize('model', ['complete', 'conventional'])
def test_prototype_at_the_special_points(paper, prototype, model):
    numbers = paper['prototype']
    np.testing.assert_allclose(special(prototype, 'M', model) / (2 * np.pi) / u.Hz, numbers[f'M_{model}_Hz'], rtol=PRINTED)
    K = special(prototype, 'K', model)
    np.testing.assert_allclose(K / (2 * np.pi) / u.Hz, numbers[f'K_{model}_Hz'], rtol=PRINTED)
    assert degenerate(K)


def test_prototype_without_its_pillars(paper, prototype):
    prototype.calc.set(foundation=0.0)
    M = special(prototype, 'M') / (2 * np.pi) / u.Hz
    np.testing.assert_allclose(M, paper['prototype']['M_no_foundation_Hz'], rtol=PRINTED)
    assert abs(special(prototype, 'G')).max() / (2 * np.pi) / u.Hz < 1e-6 * M.max()  # the root of round-off
