"""phonopy's thermal properties against the closed form of harmonic oscillators, and files that others read."""

import numpy as np
import phonopy
import pytest
from oracles import LAWS, lattice
from scipy.constants import N_A, e, h, k

from magphonon import InversePower, MagneticRepulsion, finite_displacements, lattices
from magphonon.bands import bloch_modes, thermal_properties, write_phonopy_params
from magphonon.stiffness.other_tools import GRAM

MESH = (6, 6, 1)


@pytest.fixture(scope='module', params=['triangular', 'honeycomb'])
def cell(request):
    atoms = lattice(request.param)
    atoms.set_masses(np.linspace(0.7, 1.1, len(atoms)))
    atoms.calc = MagneticRepulsion(atoms, LAWS['magnets'], foundation=0.2)
    return atoms


@pytest.fixture(scope='module')
def phonon(cell):
    return finite_displacements(cell)


def oscillators(cell, T):
    """Heat capacity per mole of cells in J/K/mol: k x^2 e^x/(e^x - 1)^2 for each mode, x = h f/(k T), over the mesh."""
    n1, n2, _ = MESH
    q = np.stack(np.meshgrid(np.arange(n1) / n1, np.arange(n2) / n2, 0, indexing='ij'), axis=-1).reshape(-1, 3)
    f = bloch_modes(cell, q)[0] * 1e3 / (2 * np.pi)  # rad/ms to Hz
    x = h * f / (k * T)
    return N_A * k * np.mean(np.sum((x / 2 / np.sinh(x / 2)) ** 2, axis=1))


# From deep in the quantum limit to the classical one of magnets between 27 and 155 Hz: k T/h is 21 Hz at 1e-9 K.
TEMPERATURES = [2e-10, 1e-9, 5e-9, 1e-7]


def test_heat_capacity_is_that_of_oscillators(cell, phonon):
    found = thermal_properties(phonon, TEMPERATURES, MESH)
    expected = [oscillators(cell, T) for T in TEMPERATURES]
    # phonopy's h and k are older than SciPy's by 1e-6, which x = h f/k T, 20 to 40 at the lowest temperature, multiplies
    np.testing.assert_allclose(found.heat_capacity, expected, rtol=4e-5)


def test_at_room_temperature_magnets_are_classical(cell, phonon):
    expected = 2 * len(cell) * k * N_A  # two directions: what does not move along z holds no heat
    # e^x - 1 at x = 4e-12 keeps five digits of round-off, which is how phonopy may compute it
    assert thermal_properties(phonon, 300, MESH).heat_capacity[0] == pytest.approx(expected, rel=1e-3)
    # control: Hz taken for THz; modes along z are half of what is left, or nothing where round-off makes their squares negative
    phonon.run_mesh(MESH)
    assert abs(phonon.run_thermal_properties(temperatures=[300]).heat_capacity[0] / expected - 1) > 0.2


def test_an_unstable_lattice_has_no_thermal_properties():
    cell = lattice('honeycomb')
    cell.calc = MagneticRepulsion(cell, LAWS['magnets'])
    with pytest.raises(ValueError, match='the lattice is unstable, with frequencies down to -'):
        thermal_properties(finite_displacements(cell), 300, MESH)


Q = np.array([[0.0, 0, 0], [0.5, 0, 0], [2 / 3, 1 / 3, 0], [0.13, 0.31, 0]])


def squares(phonon, q):
    """Squared frequencies, in which round-off is a share of the highest, and not its root."""
    f = phonon.run_qpoints(q).frequencies
    return f * abs(f)


def test_a_phonon_that_was_loaded_has_the_same_thermal_properties_and_is_written_again(phonon, tmp_path):
    write_phonopy_params(phonon, tmp_path / 'first.yaml')
    loaded = phonopy.load(tmp_path / 'first.yaml')
    first, second = (thermal_properties(one, TEMPERATURES, MESH).heat_capacity for one in (phonon, loaded))
    np.testing.assert_allclose(second, first, rtol=4e-9)  # of the digits of the file, which x = h f/k T, up to 40, multiplies
    write_phonopy_params(loaded, tmp_path / 'second.yaml')
    again = phonopy.load(tmp_path / 'second.yaml')
    np.testing.assert_allclose(squares(again, Q), squares(phonon, Q), rtol=0, atol=1e-12 * squares(phonon, Q).max())


@pytest.mark.peer
@pytest.mark.filterwarnings('ignore:More than one OpenMP library')  # Euphonic then runs serially, which is all that is wanted
def test_euphonic_reads_them_as_they_are(cell, phonon, tmp_path):
    euphonic = pytest.importorskip('euphonic')
    write_phonopy_params(phonon, tmp_path / 'ours.yaml')
    phonon.save(tmp_path / 'grams.yaml', settings={'force_constants': True})

    def frequencies_THz(file):
        """Of the motion in the plane, which lies above that along z, at zero."""
        theirs = euphonic.ForceConstants.from_phonopy(path=tmp_path, summary_name=file).calculate_qpoint_phonon_modes(Q)
        return theirs.frequencies.to('meV').magnitude[:, len(cell):] * e / 1e15 / h

    expected = bloch_modes(cell, Q)[0] * 1e3 / (2 * np.pi)  # Hz
    # phonopy's atomic mass and elementary charge are older than those of Euphonic by 1e-7
    np.testing.assert_allclose(frequencies_THz('ours.yaml'), expected, rtol=1e-6)
    # control: the masses in g
    np.testing.assert_allclose(frequencies_THz('grams.yaml'), expected * np.sqrt(GRAM), rtol=1e-6)


def test_thermal_properties_of_atoms_on_a_foundation_are_silent():
    """Frequencies of THz at Gamma are no fault of the force constants; phonopy would advise to symmetrise the foundation away."""
    cell = lattices.triangular(3e-7, 1e-22)
    cell.calc = MagneticRepulsion(cell, InversePower(1e-9 * (3e-7) ** 4, 4.0), foundation=0.02)
    phonon = finite_displacements(cell)
    crystal = phonon.replicate()
    crystal.force_constants = phonon.force_constants
    crystal.unit_conversion_factor = 1e-12 * phonon.unit_conversion_factor
    crystal.run_mesh([3, 3, 1], is_gamma_center=True)
    with pytest.warns(UserWarning, match='acoustic') as told:  # the control: of phonopy alone
        crystal.run_thermal_properties(temperatures=[300.0], cutoff_frequency=1e-3)
    assert any('Symmetrize them' in str(one.message) for one in told)
    assert thermal_properties(phonon, [300.0], [3, 3, 1]).heat_capacity[0] > 0
