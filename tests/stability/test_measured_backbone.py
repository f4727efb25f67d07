"""The amplitude curve of one magnet, measured from its decay in a laboratory's simulation, against the computed curvature."""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from scipy.signal import hilbert

from magphonon import InversePower, MagneticRepulsion
from magphonon.response import modes
from magphonon.stability.amplitude_shifts import frequency_shifts
from workflows import bench_lattice as bench

REACH = 25e-3  # m
RATE, PERIODS = 4000.0, 4  # frames per second; periods of a window in which amplitude and frequency are read


def backbone(lab, centre, axis, force, rng):
    """Amplitude in mm and frequency in Hz in windows along the decay after a burst along an axis, by a vibrometer with noise."""
    f0 = np.sqrt(bench.stiffness(lab)[2 * centre + axis, 2 * centre + axis] / lab.masses[centre]) / (2 * np.pi)
    t, u = bench.motion(lab, [(bench.pushed(lab, [centre], force * np.eye(2)[axis]), bench.burst(f0, 8))], 0.9, [centre], RATE)
    u = 1e3 * u[t > 8 / f0, 0, axis]
    u = u + 0.003 * abs(u).max() * rng.standard_normal(len(u))
    z = hilbert(u)
    frames = round(PERIODS * RATE / f0)
    starts = range(2 * frames, len(u) - 3 * frames, frames)  # the transform blurs the ends
    windows = [np.s_[k : k + frames] for k in starts]
    amplitude = np.array([np.sqrt(np.mean(abs(z[one]) ** 2)) for one in windows])
    frequency = [np.polyfit(np.arange(frames) / RATE, np.unwrap(np.angle(z[one])), 1)[0] / (2 * np.pi) for one in windows]
    return amplitude, np.array(frequency)


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(3))
def test_the_measured_curvature_holds_the_computed_one(seed):
    """One magnet among held ones at drawn places: exponent, springs and force drawn; the interval is of a straight line."""
    rng = np.random.default_rng(seed)
    a, force, springs = rng.uniform(3, 5), rng.uniform(0.1, 0.3), rng.uniform(10, 30, 2)
    law = bench.tabulated(bench.power_law(force, a, 10e-3), 4e-3, 60e-3)
    places = bench.sites(bench.triangular(10e-3), 0.021, 0.018)
    lab = bench.built(places, law, REACH, rng, springs=tuple(springs), damping=4.0, scatter=(0, 0, 0, 0))
    (centre,) = np.flatnonzero(~lab.held)
    atoms = Atoms(['Nd'] * len(places), np.c_[1e3 * places, 0 * places[:, 0]], masses=[0.8] * len(places))
    atoms.set_constraint(FixAtoms(np.flatnonzero(lab.held)))
    atoms.calc = MagneticRepulsion(atoms, InversePower(force * 10.0**a, a), cutoff=1e3 * REACH, foundation=[list(1e-3 * springs)])
    found = modes(atoms)
    computed = frequency_shifts(atoms).curvature
    for mode in (0, 1):
        axis = int(abs(found.shapes[mode, centre]).argmax())
        A, f = backbone(lab, centre, axis, 0.014, rng)
        (slope, first), C = np.polyfit(A**2, f, 1, cov=True)
        kappa, sigma = slope / first, np.sqrt(C[0, 0]) / first
        assert sigma < 0.08 * abs(kappa)
        assert abs(kappa - computed[mode]) < 4 * sigma + 0.02 * abs(kappa)  # the next order, A^2 times five and more
        assert abs(kappa) > 10 * sigma  # the control: a linear magnet
