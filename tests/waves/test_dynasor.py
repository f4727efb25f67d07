"""dynasor (Fransson and others, 2021) finds our bands in our trajectories: thermal motion of a periodic patch."""

import numpy as np
import pytest
from ase.io import Trajectory, read

from magphonon import DrivenVerlet, read_scene
from magphonon.bands.bloch import bloch_modes

BIN_Hz = 1.0


@pytest.mark.slow
@pytest.mark.filterwarnings('ignore')  # of dynasor and of what it imports
def test_spectral_energy_density_of_a_trajectory_peaks_at_the_bands(tmp_path):
    dynasor = pytest.importorskip('dynasor')
    cell = read_scene('prototype').atoms()
    patch = cell.repeat((8, 8, 1))
    patch.calc = cell.calc.on(patch)
    rest = patch.copy()
    velocities = 1e-5 * np.random.default_rng(0).normal(size=(len(patch), 3)) * [1, 1, 0]
    patch.set_velocities(velocities - velocities.mean(axis=0))
    steps = DrivenVerlet(patch, 0.25)
    with Trajectory(tmp_path / 'motion.traj', 'w') as file:
        steps.attach(lambda: file.write(patch.copy()), interval=8)
        steps.run(int(4000 / BIN_Hz))
    # millimetres are taken for Angstrom and milliseconds for femtoseconds, so that its rad/fs are our rad/ms
    frames = dynasor.Trajectory(str(tmp_path / 'motion.traj'), trajectory_format='ase', length_unit='Angstrom', time_unit='fs')
    q = np.array([[0, 0.5, 0], [0.25, 0.25, 0]])
    k = 2 * np.pi * q @ cell.cell.reciprocal().array
    omega, density = dynasor.compute_spectral_energy_density(frames, rest, cell, k, dt=2.0)
    top, found = np.pi / 2.0, bloch_modes(cell, q)[0]
    half = (omega > 0.05) & (omega < top)
    for at, expected in enumerate(found):
        peak = omega[half][density[at][half].argmax()]
        assert abs(peak - expected).min() < 2 * np.pi * 1e-3 * BIN_Hz
        assert abs(peak - bloch_modes(cell, q[at : at + 1], 'conventional')[0][0]).min() > 4 * 2 * np.pi * 1e-3 * BIN_Hz
    assert len(read(tmp_path / 'motion.traj')) == len(patch)
