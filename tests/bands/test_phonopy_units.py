"""Files of force constants that phonopy and Euphonic read."""

import numpy as np
import phonopy
import pytest
from oracles import LAWS, lattice
from scipy.constants import e, h

from magphonon import MagneticRepulsion, finite_displacements
from magphonon.bands import bloch_modes, write_phonopy_params
from magphonon.stiffness.other_tools import GRAM


@pytest.fixture(scope='module', params=['triangular', 'honeycomb'])
def cell(request):
    atoms = lattice(request.param)
    atoms.set_masses(np.linspace(0.7, 1.1, len(atoms)))
    atoms.calc = MagneticRepulsion(atoms, LAWS['magnets'], foundation=0.2)
    return atoms


@pytest.fixture(scope='module')
def phonon(cell):
    return finite_displacements(cell)


Q = np.array([[0.0, 0, 0], [0.5, 0, 0], [2 / 3, 1 / 3, 0], [0.13, 0.31, 0]])


def squares(phonon, q):
    """Squared frequencies, in which round-off is a share of the highest, and not its root."""
    f = phonon.run_qpoints(q).frequencies
    return f * abs(f)


def test_a_phonon_that_was_loaded_is_written_again(phonon, tmp_path):
    write_phonopy_params(phonon, tmp_path / 'first.yaml')
    loaded = phonopy.load(tmp_path / 'first.yaml')
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
