"""phonopy's thermal properties against the closed form of harmonic oscillators, and files that others read."""

import numpy as np
import phonopy
import pytest
from oracles import LAWS, lattice
from scipy.constants import N_A, e, h, k

from magphonon import InversePower, MagneticRepulsion, finite_displacements, lattices
from magphonon.bands import in_phonopy_units, thermal_properties
from magphonon.bands.bloch import bloch_modes

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
    # control: Hz taken for THz
    phonon.run_mesh(MESH)
    assert phonon.run_thermal_properties(temperatures=[300]).heat_capacity[0] < 0.6 * expected


def test_an_unstable_lattice_has_no_thermal_properties():
    cell = lattice('honeycomb')
    cell.calc = MagneticRepulsion(cell, LAWS['magnets'])
    with pytest.raises(ValueError, match='the lattice is unstable, with frequencies down to -'):
        thermal_properties(finite_displacements(cell), 300, MESH)


def squares(phonon, q):
    """Squared frequencies, in which round-off is a share of the highest, and not its root."""
    f = phonon.run_qpoints(q).frequencies
    return f * abs(f)


def test_frequencies_are_the_same_in_THz(phonon):
    q = [[0.0, 0, 0], [0.5, 0, 0], [0.21, 0.37, 0]]
    ours, theirs = (squares(p, q) for p in (phonon, in_phonopy_units(phonon)))
    np.testing.assert_allclose(theirs * 1e24, ours, rtol=0, atol=1e-12 * ours.max())


def test_files_of_it_are_read_as_they_are(phonon, tmp_path):
    crystal = in_phonopy_units(phonon)
    crystal.save(tmp_path / 'phonopy.yaml', settings={'force_constants': True})
    text = (tmp_path / 'phonopy.yaml').read_text()
    assert 'atomic_mass: "AMU"' in text
    assert 'length: "angstrom"' in text
    again = phonopy.load(tmp_path / 'phonopy.yaml', symmetrize_fc=False, is_symmetry=False, is_nac=False)
    q = [[0.0, 0, 0], [0.21, 0.37, 0]]
    ours, theirs = (squares(p, q) for p in (crystal, again))
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-12 * ours.max())


def test_a_phonon_in_other_units_is_refused(phonon):
    with pytest.raises(ValueError, match='not in mm, g and N'):
        in_phonopy_units(in_phonopy_units(phonon))


@pytest.mark.peer
@pytest.mark.filterwarnings('ignore:More than one OpenMP library')  # Euphonic then runs serially, which is all that is wanted
def test_euphonic_reads_them_as_they_are(cell, phonon, tmp_path):
    euphonic = pytest.importorskip('euphonic')
    in_phonopy_units(phonon).save(tmp_path / 'THz.yaml', settings={'force_constants': True})
    phonon.save(tmp_path / 'Hz.yaml', settings={'force_constants': True})
    q = np.array([[0.0, 0, 0], [0.5, 0, 0], [2 / 3, 1 / 3, 0], [0.13, 0.31, 0]])

    def frequencies_Hz(file):
        """Of the motion in the plane, which lies above that along z, at zero."""
        theirs = euphonic.ForceConstants.from_phonopy(path=tmp_path, summary_name=file).calculate_qpoint_phonon_modes(q)
        return theirs.frequencies.to('meV').magnitude[:, len(cell):] * e / 1e3 / h

    expected = bloch_modes(cell, q)[0] * 1e3 / (2 * np.pi)
    # phonopy's atomic mass and elementary charge are older than those of Euphonic by 1e-7
    np.testing.assert_allclose(frequencies_Hz('THz.yaml'), expected, rtol=1e-6)
    # control: the file in mm, g and N, taken for Angstrom, u and eV
    assert np.all(frequencies_Hz('Hz.yaml') > 1e9 * expected)


def test_thermal_properties_of_atoms_on_a_foundation_are_silent():
    """Frequencies of THz at Gamma are no fault of the force constants; phonopy would advise to symmetrise the foundation away."""
    cell = lattices.triangular(3e-7, 1e-22)
    cell.calc = MagneticRepulsion(cell, InversePower(1e-9 * (3e-7) ** 4, 4.0), foundation=0.02)
    phonon = finite_displacements(cell)
    crystal = in_phonopy_units(phonon)
    crystal.run_mesh([3, 3, 1], is_gamma_center=True)
    with pytest.warns(UserWarning, match='acoustic') as told:  # the control: of phonopy alone
        crystal.run_thermal_properties(temperatures=[300.0])
    assert any('Symmetrize them' in str(one.message) for one in told)
    assert thermal_properties(phonon, [300.0], [3, 3, 1]).heat_capacity[0] > 0
