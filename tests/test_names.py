"""One notion has one name on all results."""

from dataclasses import fields

import numpy as np
import pytest
from motion import patch

from magphonon import DrivenVerlet, propagate
from magphonon.bands import Bands
from magphonon.bands.density import DensityOfStates
from magphonon.bands.evanescent import ComplexBands
from magphonon.dynamics import Motion, Recorder
from magphonon.response import Modes
from magphonon.response.frf import FrequencyResponse
from magphonon.response.normal_modes import Localisation
from magphonon.stability.amplitude_shifts import Shifts
from magphonon.waves.spectrum import Ridge, Spectrum
from magphonon.waves.wave_analysis import Branch

RESULTS = [Bands, ComplexBands, Modes, FrequencyResponse, Shifts, Spectrum, Branch, Ridge, DensityOfStates, Localisation]


@pytest.mark.parametrize('result', RESULTS, ids=lambda result: result.__name__)
def test_every_result_with_angular_frequencies_has_them_in_hertz(result):
    omega = np.array([[0.0, 2 * np.pi], [-np.pi, 1.0]])  # rad/ms
    values = {field.name: omega if field.name == 'omega' else None for field in fields(result)}
    np.testing.assert_allclose(result(**values).frequencies_Hz, [[0.0, 1000.0], [-500.0, 500 / np.pi]], rtol=1e-15)


@pytest.mark.filterwarnings('ignore:times up to')
def test_every_record_of_motion_has_the_same_names():
    atoms = patch()
    dyn = DrivenVerlet(atoms, 0.01)
    recorder = Recorder(dyn, [12, 13], interval=2)
    dyn.run(4)
    transient = propagate(patch(), [0.0, 0.02, 0.04], particles=[12, 13])
    for record in (recorder.motion, transient):
        assert isinstance(record, Motion)
        np.testing.assert_allclose(record.times, [0.0, 0.02, 0.04], rtol=1e-12)
        np.testing.assert_array_equal(record.particles, [12, 13])
        assert record.displacements.shape == (3, 2, 2)
