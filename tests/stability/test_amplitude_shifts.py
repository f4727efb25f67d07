"""Amplitude dependence of frequencies: closed forms of the oscillator, and runs of lattices."""

import numpy as np
import pytest
from ase.constraints import FixedLine
from scipy.optimize import least_squares
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.bands import bloch_modes
from magphonon.errors import PhysicsError
from magphonon.interactions import Yukawa
from magphonon.stability import frequency_shifts

LAW = InversePower(1.0, 4.0)


def oscillator(theta0):
    atoms = lattices.oscillator(theta0, 1.0, 1.0)
    atoms.calc = MagneticRepulsion(atoms, LAW, bonds=lattices.OSCILLATOR_BONDS).balanced([3])
    atoms.set_constraint([*atoms.constraints, FixedLine(3, (0, 1, 0))])
    return atoms


def derivatives_of_energy(atoms, h=0.02):
    """k and beta of V = k y^2/2 + alpha y^3/3 + beta y^4/4 by differences of the energy, good to some h^2 of themselves."""
    home, energies = atoms.positions.copy(), []
    for step in (-2, -1, 0, 1, 2):
        atoms.positions[3] = home[3] + [0, step * h, 0]
        energies.append(atoms.get_potential_energy())
    V = np.array(energies)
    return V @ [-1, 16, -30, 16, -1] / (12 * h**2), V @ [1, -4, 6, -4, 1] / (6 * h**4)


@pytest.mark.parametrize(('theta0', 'curvature'), [(0.0, -275 / 48), (np.pi / 2, -35 / 48)])
def test_oscillator_softens_by_its_closed_form(theta0, curvature):
    # from V = k y^2/2 + alpha y^3/3 + beta y^4/4: dw/w = (3 beta/(8 k) - 5 alpha^2/(12 k^2)) A^2
    shifts = frequency_shifts(oscillator(theta0))
    assert shifts.curvature == pytest.approx([curvature], rel=1e-10)
    assert shifts.amplitude(0.01) == pytest.approx(np.sqrt(0.01 / abs(curvature)), rel=1e-10)
    # control: without the third derivative of the energy the frequency would rise
    k, beta = derivatives_of_energy(oscillator(theta0))
    assert 3 * beta / (8 * k) > 1 > 0 > shifts.curvature


@pytest.mark.parametrize('a', [4.0, 5.0])
def test_the_twist_of_kagome_stiffens_by_its_closed_form(a):
    # triangles turn rigidly, so that a particle moves by A and each bond of a cell's six grows to sqrt(1 + 3 A^2): its energy is
    # 3/2 (k - 6) A^2 + 27/4 (a + 1) A^4 with three particles of unit mass
    cell = lattices.kagome(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, a), foundation=6.06)
    shifts = frequency_shifts(cell)
    softest = shifts.omega.argmin()
    assert shifts.omega[softest] ** 2 == pytest.approx(0.06, rel=1e-9)
    assert shifts.curvature[softest] == pytest.approx(27 / 8 * (a + 1) / 0.06, rel=1e-6)  # circles in the plane: 1e-11/0.06
    # the control: the edges of the zone alone know nothing of it
    edges = shifts.q.any(axis=1)
    assert abs(shifts.curvature[edges]).max() < 0.1 * shifts.curvature[softest]


def test_an_unstable_mode_does_not_vibrate():
    chain = lattices.chain(1.0, 1.0)
    chain.calc = MagneticRepulsion(chain, LAW)
    shifts = frequency_shifts(chain)
    assert shifts.omega == pytest.approx([4.0])  # of the two waves at X, the longitudinal one: 4 a f/(L0 m)


def test_amplitude_shrinks_to_nothing_at_the_threshold():
    def amplitude(a):
        cell = lattices.triangular(1.0, 1.0)
        cell.calc = MagneticRepulsion(cell, InversePower(1.0, a))
        return frequency_shifts(cell).amplitude(0.01)

    # the shear stiffness at M goes as a - 3, so dw/w over A^2 as its inverse
    assert amplitude(3.0001) / amplitude(3.01) == pytest.approx(0.1, rel=0.02)


# --- any wavevector ---------------------------------------------------------------------------------------------------------


def test_waves_of_the_triangular_lattice_are_shifted_by_their_closed_forms():
    """At M the shear wave stands; at K each wave rotates, a particle in the Henon-Heiles potential of C3 symmetry."""
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, LAW)
    shifts = frequency_shifts(cell, [(0.5, 0, 0), (2 / 3, 1 / 3, 0), (1 / 3, 2 / 3, 0), (0.1, 0.2, 0)])
    assert shifts.motion == (*['standing'] * 2, *['rotating'] * 4, *['travelling'] * 2)
    assert shifts.curvature[[0, 2, 3, 4, 5]] == pytest.approx([-285 / 16, *[475 / 36] * 4], rel=1e-9)


def drawn_cell(rng):
    """Along the rows of a square lattice of one shell D0 alone would be right, so none of these."""
    cell = getattr(lattices, rng.choice(['triangular', 'honeycomb']))(1.0, 1.0)
    cell.set_cell(cell.cell.array @ np.diag([1, rng.uniform(0.95, 1.2), 1]), scale_atoms=True)
    cell.set_masses(rng.uniform(0.7, 1.4, len(cell)))
    law = InversePower(1.0, rng.uniform(3, 6)) if rng.random() < 0.7 else Yukawa(1.0, rng.uniform(1, 3))
    cell.calc = MagneticRepulsion(cell, law, cutoff=1.5, foundation=rng.uniform(8, 12)).balanced(np.arange(len(cell)))
    return cell, int(rng.integers(3, 6))


def travelling_wave(cell, n, wave, A, model):
    """Frequencies, linear and at the amplitude A, of a wave with a period of n cells, by Newton on its Fourier series.

    The forces are those on the first of n cells, whose phases differ by 2 pi/n; nothing of perturbation theory is used.
    """
    ring = cell.repeat((n, 1, 1))
    ring.calc = cell.calc.on(ring)
    ring.calc.set(model=model)
    w, shapes = bloch_modes(cell, [[1 / n, 0, 0]], model, vectors=True)
    masses = cell.get_masses()[:, None]
    w, e = w[0, wave], shapes[0, wave] / np.sqrt(masses)
    e = e / np.sqrt(((abs(e) ** 2).sum(axis=1) + abs((e * e).sum(axis=1))) / 2).max()
    h, theta = np.arange(4), 2 * np.pi * np.arange(8) / 8
    home, size, norm = ring.positions.copy(), e.size, (abs(e) ** 2 * masses).sum()

    def parts(x):
        real, imag = x[: 4 * size].reshape(4, *e.shape), np.concatenate([np.zeros(size), x[4 * size : -1]]).reshape(4, *e.shape)
        return real + 1j * imag, x[-1]

    def residual(x):
        U, W = parts(x)
        forces = []
        for at in theta:
            u = np.concatenate([np.einsum('h,hix->ix', np.exp(1j * h * (2 * np.pi * k / n - at)), U).real for k in range(n)])
            ring.positions[:, :2] = home[:, :2] + u
            forces.append(ring.get_forces()[: len(cell), :2])
        F = np.einsum('ht,tix->hix', np.exp(1j * np.outer(h, theta)), forces) / 4
        F[0] /= 2
        left = F + (h * W)[:, None, None] ** 2 * masses * U
        pinned = (e.conj() * masses * U[1]).sum() / norm - A
        return np.concatenate([left.real.ravel(), left[1:].imag.ravel(), [pinned.real, pinned.imag]])

    start = np.zeros((4, *e.shape), complex)
    start[1] = A * e
    found = least_squares(residual, np.concatenate([start.real.ravel(), start[1:].imag.ravel(), [w]]), xtol=1e-13, ftol=1e-15,
                          gtol=1e-15)
    return w, found.x[-1]


@pytest.mark.parametrize('seed', few_first(range(3), 2))
def test_travelling_waves_of_drawn_cells(seed):
    rng = np.random.default_rng([seed, 24])
    cell, n = drawn_cell(rng)
    shifts = frequency_shifts(cell, (1 / n, 0, 0))
    wave, A = int(rng.integers(len(shifts.omega))), 0.004
    w, W = travelling_wave(cell, n, wave, A, 'complete')
    assert shifts.omega[wave] == pytest.approx(w, rel=1e-9)
    assert shifts.motion[wave] == 'travelling'
    tolerance = 5e-3 * abs(shifts.curvature[wave]) + 5e-4  # the next order is some (10 A)^2 of each part of this one
    assert (W / w - 1) / A**2 == pytest.approx(shifts.curvature[wave], abs=tolerance)
    w, W = travelling_wave(cell, n, wave, A, 'conventional')  # the control
    assert abs((W / w - 1) / A**2 - shifts.curvature[wave]) > 10 * tolerance


def test_what_has_no_shift_is_refused_in_words():
    cell = lattices.square(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=10.0)
    with pytest.raises(PhysicsError, match='2 waves at q'):  # along the diagonal both branches agree
        frequency_shifts(cell, (0.2, 0.2, 0))
    assert frequency_shifts(cell, (0.2, 0.21, 0)).omega.size == 2
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 2.0)
    patch.calc = MagneticRepulsion(patch, LAW, foundation=10.0)
    with pytest.raises(ValueError, match='periodic'):
        frequency_shifts(patch, (0.5, 0, 0))


@pytest.mark.slow
def test_the_conventional_model_has_its_own_shifts():
    """D0 and the cubic and quartic terms of lengths projected on the bonds, against Newton on the forces of that model."""
    for seed in range(2):
        rng = np.random.default_rng([seed, 31])
        cell, n = drawn_cell(rng)
        complete = frequency_shifts(cell, (1 / n, 0, 0))
        cell.calc.set(model='conventional')
        shifts, A = frequency_shifts(cell, (1 / n, 0, 0)), 0.004
        for wave in range(len(shifts.omega)):
            w, W = travelling_wave(cell, n, wave, A, 'conventional')
            assert shifts.omega[wave] == pytest.approx(w, rel=1e-9)
            tolerance = 5e-3 * abs(shifts.curvature[wave]) + 5e-4
            assert (W / w - 1) / A**2 == pytest.approx(shifts.curvature[wave], abs=tolerance)
        assert abs(shifts.curvature - complete.curvature).max() > 20 * tolerance  # the control


@pytest.mark.parametrize('beside', few_first([0.1, 0.03, 0.01], 1))
def test_the_second_harmonic_says_where_the_shift_is_trusted(beside):
    """A chain beside its 2:1 resonance, against Newton on the Fourier series: right to a tenth while it is small."""
    cell = lattices.chain(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=8.0 * (1 + beside))  # transverse at q = 1/4 meets longitudinal at 1/2
    shifts = frequency_shifts(cell, (0.25, 0, 0))
    wave = int(np.argmin(shifts.omega))  # across the chain

    def wrong(A):
        w, W = travelling_wave(cell, 4, wave, A, 'complete')
        return abs(shifts.curvature[wave] * A**2 / (W / w - 1) - 1)

    A = 0.05 / shifts.harmonic[wave]
    assert wrong(A / 3) < wrong(A) < 0.1
    assert wrong(6 * A) > 0.2  # the control
    assert shifts.amplitude(0.01) > (2 if beside < 0.02 else 0.0) * A  # where 1 % is predicted, it is not trusted beside the pole


def test_a_second_harmonic_that_is_a_wave_takes_all():
    """A chain on springs, waves across it: w^2 = k - 4 s at q, and along it w^2 = k + 16 s, with s = sin^2(pi q)."""
    cell, q = lattices.chain(1.0, 1.0), 0.1
    s, s2 = np.sin(np.pi * np.array([q, 2 * q])) ** 2
    resonant = 16 * (s + s2) / 3  # 2 w across at q = w along at 2 q

    def across(k):
        cell.calc = MagneticRepulsion(cell, LAW, foundation=k)
        return frequency_shifts(cell, (q, 0, 0)).curvature[0]

    assert across(resonant) == np.inf
    assert frequency_shifts(cell, (q, 0, 0)).harmonic[0] == np.inf
    below, above = across(0.999 * resonant), across(1.001 * resonant)
    assert below * above < 0  # the pole
    assert min(abs(below), abs(above)) > 30 * abs(across(2 * resonant))
