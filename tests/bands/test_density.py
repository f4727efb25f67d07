"""Density of states of a lattice: chain and square lattice in closed form, van Hove's singularities, phonopy's tetrahedra."""


import numpy as np
import pytest
from ase import Atoms
from numpy.testing import assert_allclose
from oracles import LAWS, lattice
from scipy.special import ellipk

from magphonon import InversePower, MagneticRepulsion, finite_displacements, lattices, units as u
from magphonon.bands import band_gaps, lattice_density
from magphonon.bands.density import simplices

LAW = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
L0, M, K0 = 10.0, 0.707, 0.12  # mm, g, N/mm: stiffer pillars than the prototype's, on which all lattices are stable
STIFF, PUSH = LAW.d2phi(L0) / M, -LAW.dphi(L0) / L0 / M  # of D0 and of -D*, rad^2/ms^2


def cell(kind, k=K0, masses=None):
    atoms = getattr(lattices, kind)(L0, M)
    if masses is not None:
        atoms.set_masses(masses)
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=k)
    return atoms


def counted(found):
    """Number of modes below the upper edge of each bin."""
    return np.cumsum(found.density * 2 * found.width)


@pytest.mark.parametrize('model', ['complete', 'conventional'])
def test_chain_is_its_closed_form(model):
    """Of `omega^2 = start + span sin^2(k a/2)` the share (2/pi) arcsin sqrt(x), x = (omega^2 - start)/span, lies below omega."""
    found = lattice_density(cell('chain'), np.linspace(0.15, 0.9, 300), model=model)
    edges = np.append(found.omega - found.width, found.omega[-1] + found.width[-1])

    along = 2 / np.pi * np.arcsin(np.sqrt(((edges**2 - K0 / M) / (4 * STIFF)).clip(0, 1)))
    across = 1 - 2 / np.pi * np.arcsin(np.sqrt(((K0 / M - edges**2) / (4 * PUSH)).clip(0, 1)))  # it softens
    flat = (edges**2 >= K0 / M).astype(float)  # nothing but the foundation resists
    share = {'complete': along + across, 'conventional': along + flat}
    assert_allclose(counted(found), share[model][1:], atol=2e-4)  # of 2000 steps, the root of the last one at the edge
    other = share['conventional' if model == 'complete' else 'complete'][1:]
    assert abs(counted(found) - other).max() > 0.2


def test_square_lattice_is_its_elliptic_integral():
    """Both branches are `omega^2 = c + a cos x - b cos y`: a density of two steps and two logarithmic peaks, at c -+ (a - b)."""
    a, b = 2 * STIFF, 2 * PUSH
    c = K0 / M + a - b
    middles = np.sqrt(np.linspace((c - a - b) * 1.0001, (c + a + b) * 0.9999, 2000))
    found = lattice_density(cell('square'), middles)
    E = abs(found.omega**2 - c)
    wide = ((a + b) ** 2 - E**2).clip(1e-300)
    inner = 2 / np.sqrt(wide) * ellipk((4 * a * b / wide).clip(0, 1 - 1e-15))
    outer = ellipk((wide / (4 * a * b)).clip(0, 1 - 1e-15)) / np.sqrt(a * b)
    expected = np.where(a - b > E, inner, outer) / np.pi**2 * 2 * found.omega * 2  # two branches
    away = (abs(E - (a - b)) > 0.02 * a) & (a + b - E > 0.01 * a)
    assert away.sum() > 1800
    assert_allclose(found.density[away], expected[away], rtol=0.02)
    for lower, peak in ((True, c - a + b), (False, c + a - b)):
        half = (found.omega**2 < c) == lower
        assert found.omega[half][found.density[half].argmax()] == pytest.approx(np.sqrt(peak), rel=2e-3)
    conventional = lattice_density(cell('square'), middles, model='conventional')
    assert abs(conventional.density[away] / expected[away] - 1).max() > 0.3


@pytest.mark.slow
@pytest.mark.parametrize(('kind', 'steps', 'masses'), [('honeycomb', 12, [M, 1.5 * M]), ('fcc', 6, None)])
def test_phonopy_finds_the_same_number_of_modes_below_each_frequency(kind, steps, masses):
    atoms = lattice(kind, L0, M)
    if masses:
        atoms.set_masses(masses)
    atoms.calc = MagneticRepulsion(atoms, LAWS['magnets'], foundation=0.5)
    found = lattice_density(atoms, np.linspace(0.5, 3.5, 3001), steps)
    phonon = finite_displacements(atoms, (3, 3, 3 if kind == 'fcc' else 1))
    phonon.unit_conversion_factor = 1.0
    phonon.run_mesh([steps if along else 1 for along in atoms.pbc], is_gamma_center=True, is_mesh_symmetry=False)
    phonon.run_total_dos(freq_min=0.5, freq_max=3.5, freq_pitch=1e-3, use_tetrahedron_method=True)
    told = phonon.total_dos
    assert_allclose(told.frequency_points, found.omega, rtol=1e-12)
    # it interpolates frequencies and not their squares, takes other diagonals, and samples a density with peaks, of which it
    # misses 0.8 %
    assert_allclose(counted(found), np.cumsum(told.dos) * 1e-3, atol=0.015 * found.modes)
    conventional = lattice_density(atoms, found.omega, steps, model='conventional')
    assert abs(counted(conventional) - counted(found)).max() > 0.1 * found.modes


def test_unstable_modes_count_at_negative_frequencies():
    found = lattice_density(cell('chain', 0.0))
    across = counted(found)[found.omega + found.width < 0][-1]
    assert across == pytest.approx(1, abs=0.1)  # one branch of two; the bin at zero holds the slowest ones
    assert found.omega[0] == pytest.approx(-2 * np.sqrt(PUSH), rel=0.01)


@pytest.mark.parametrize('dim', [1, 2, 3])
def test_simplices_fill_the_mesh(dim):
    """All orders of the axes but the opposite ones count every point of the mesh equally often."""
    values = np.random.default_rng(dim).normal(size=(4,) * dim + (2,))
    found = np.concatenate(list(simplices(values)))
    assert found.shape == (4**dim * 2 * [1, 1, 1, 3][dim], dim + 1)
    assert found.mean() == pytest.approx(values.mean(), rel=1e-12)
    assert (np.diff(found) >= 0).all()


@pytest.mark.parametrize(('dim', 'steps'), [(2, 6), (2, 7), (3, 4), (3, 5)])
def test_the_half_of_the_zone_that_is_computed_does_not_matter(dim, steps):
    """Of a cell without any symmetry, whose vectors change places; the control turns one of them round, which is another mesh."""
    rng = np.random.default_rng(10 * dim + steps)
    vectors = L0 * (np.eye(3) + rng.uniform(-0.3, 0.3, (3, 3)) * (np.arange(3) < dim) * (np.arange(3) < dim)[:, None])
    places = (rng.uniform(0, 0.3, (2, 3)) + np.array([[0], [0.5]])) * (np.arange(3) < dim)

    def counted_in(order):
        atoms = Atoms('Nd2', masses=[0.5, 0.9], scaled_positions=places, cell=vectors, pbc=np.arange(3) < dim)
        atoms.set_cell(vectors[order] if isinstance(order, list) else order @ vectors)
        atoms.calc = MagneticRepulsion(atoms, LAW, cutoff=1.3 * L0, foundation=K0).balanced(range(2))
        return counted(lattice_density(atoms, np.linspace(-3, 8, 200), steps=steps))

    first = counted_in([0, 1, 2])
    assert first[-1] == pytest.approx(2 * dim, rel=1e-12)
    assert_allclose(counted_in([1, 0, 2]), first, atol=1e-11)
    if dim == 3:
        assert_allclose(counted_in([1, 2, 0]), first, atol=1e-11)
    assert abs(counted_in(np.array([[1, 0, 0], [1, 1, 0], [0, 0, 1]])) - first).max() > 1e-4


@pytest.mark.parametrize('seed', range(24))
def test_gaps_of_chains_are_those_of_their_two_branches(seed):
    """Each branch in closed form: (k_x + 2 phi'' (1 - cos))/m rises, (k_y + 2 phi'/r (1 - cos))/m falls, and they may cross."""
    rng = np.random.default_rng(seed)
    a, push, m, kx = rng.uniform(1.5, 5), rng.uniform(0.5, 2), rng.uniform(0.5, 2), rng.uniform(1, 4)
    ky = kx + rng.uniform(1.05, 2) * 4 * push * max(1, a) if seed % 3 == 0 else kx + rng.uniform(0.05, 0.95) * 4 * push * (a + 1)
    ky = max(ky, 4.1 * push)
    atoms = lattices.chain(1.0, m)
    atoms.calc = MagneticRepulsion(atoms, InversePower(push, a), foundation=[[kx, ky]])
    along, across = np.sqrt(np.array([[kx, kx + 4 * a * push], [ky - 4 * push, ky]]) / m)
    (_, low), (high, _) = sorted([along, across], key=lambda ends: ends[0])
    found = band_gaps(atoms)
    if low < high:
        assert_allclose(found, [[low, high]], rtol=1e-9)  # its ends are at Gamma and X, on the mesh
    else:
        assert len(found) == 0


def test_a_narrow_gap_beside_the_mesh_is_found_with_its_width():
    """Chains of two masses: a gap at X between the roots of 2 K/m; with an odd number of steps X is not on the mesh."""
    atoms = lattices.chain(1.0, 1.0).repeat((2, 1, 1))
    atoms.set_masses([1.0, 1.001])
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), foundation=[[3.0, 400.0]])
    found = band_gaps(atoms, steps=301)
    assert_allclose(found[0], np.sqrt((3.0 + 8.0) / np.array([1.001, 1.0])), rtol=1e-7)


@pytest.mark.filterwarnings('ignore:the stiffest bond')
def test_no_bin_lies_below_zero_where_no_mode_does():
    atoms = lattices.chain(1.0, 1.0)
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), foundation=[[0.0, 1e16]])
    found = lattice_density(atoms, steps=60)
    assert found.omega[0] > 0
    assert counted(found)[-1] == pytest.approx(2, rel=1e-9)
