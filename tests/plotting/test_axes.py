"""What holds for all drawings: pyplot is left alone, given axes are used, and axes have the units of their labels."""

import numpy as np
import pytest
from cells import prototype
from figures import bands_of, drawn

from magphonon import InversePower
from magphonon.interactions.fits import SharedErrors, fit_forces
from magphonon.interactions.force_tables import Forces
from magphonon.plotting.bands import plot_bands
from magphonon.plotting.fits import plot_fit
from magphonon.plotting.modes import plot_mode
from magphonon.plotting.response import plot_response
from magphonon.plotting.zone import plot_zone
from magphonon.response.frf import FrequencyResponse


@pytest.mark.slow
def test_pyplot_and_its_settings_are_left_alone():
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    before = dict(mpl.rcParams)
    cell = prototype()
    bands = bands_of(cell, vectors=True)
    for ax in (plot_bands(bands, label='complete'), plot_zone(bands.path), plot_mode(cell, bands, 'M', 0)):
        drawn(ax)
    assert dict(mpl.rcParams) == before
    assert plt.get_fignums() == []


# Units of the axes: 1 rad/ms is 1000/2 pi Hz, 1 mm/N is 1e-3 m/N, 1 mm is 1e-3 m


def test_responses_are_drawn_in_metres_per_newton_over_hertz():
    omega, response = np.array([0.1, 0.2, 0.3]), np.array([1.0, 4.0j, -2.0])
    amplitude, phase = (ax.lines[0] for ax in plot_response(FrequencyResponse(omega, response)))
    np.testing.assert_allclose(amplitude.get_xdata(), omega * 1e3 / (2 * np.pi))
    np.testing.assert_allclose(amplitude.get_ydata(), [1e-3, 4e-3, 2e-3])
    np.testing.assert_allclose(phase.get_ydata(), [0, 90, 180])


def test_measured_forces_stand_on_the_curve_in_metres_and_newtons():
    r = np.linspace(8.0, 14.0, 9)
    law = InversePower(b=2400.0, a=4.0)
    forces = Forces(r, law.b * r**-4 + 0.05, np.full(9, 1e-4))  # a zero of 50 mN
    upper, lower = plot_fit(forces, fit_forces(forces, 10.0, SharedErrors(distance=0.0, backlash=0.0))).axes
    points = next(line for line in upper.lines if line.get_label() == '_nolegend_')
    curve = next(line for line in upper.lines if line.get_label() == 'smooth curve')
    np.testing.assert_allclose(points.get_xdata(), r / 1e3, rtol=1e-6)
    np.testing.assert_allclose(points.get_ydata(), np.interp(r / 1e3, *curve.get_data()), rtol=2e-2)  # the zero is taken out
    assert abs(points.get_ydata()[-1] / forces.f[-1] - 1) > 0.2
    residuals = next(line for line in lower.lines if len(line.get_xdata()) == 9)
    assert abs(residuals.get_ydata()).max() < 3
