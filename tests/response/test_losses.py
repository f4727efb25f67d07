"""Losses of each site in every linear tool, against the equations of motion of drawn structures written out densely."""

import re

import numpy as np
import pytest

from magphonon import (
    InversePower,
    MagneticRepulsion,
    analytic_bands,
    lattices,
    propagate,
)
from magphonon.bands import Bands, complex_bands
from magphonon.bands.bloch import damped_modes
from magphonon.cli.main import main
from magphonon.response import first_order
from magphonon.scenes.scene import Scene

CUTOFF_Hz, EDGE_Hz = 26.550686524, 51.8276683282  # shear along Gamma-M: f^2 = cut-off^2 + (edge sin(xi/2))^2


def test_losses_bring_the_wave_of_a_crest_that_runs_backwards_a_negative_phase():
    chain = lattices.chain(1.0, 1.0)
    chain.calc = MagneticRepulsion(chain, InversePower(1.0, 4.0), foundation=2.0)
    transverse = np.sqrt([2 - 0.5])  # w^2 = 2 - 2 (1 - cos xi) f/L: the branch falls, its energy runs against its crests
    still, lossy = (complex_bands(chain, (1, 0, 0), transverse, damping=c).xi[0] for c in (0.0, 1e-3))
    assert still[0] == pytest.approx(np.arccos(0.75))
    assert min(abs(lossy - (-np.arccos(0.75) + 1j * 1e-3 * transverse[0] / (2 * np.sin(np.arccos(0.75)))))) < 1e-6


def test_forces_of_many_courses_are_taken_in_parts(monkeypatch):
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    rng, n = np.random.default_rng(0), len(patch)
    w, phase = rng.uniform(0.5, 2, n), rng.uniform(0, 6, n)

    def answer():
        return propagate(patch, [5.0, 20.0], [lambda t: np.outer(np.sin(w * t + phase), [1e-3, 0, 0])], rng_losses).displacements

    rng_losses = rng.uniform(0.1, 0.2, n)
    whole = answer()
    monkeypatch.setattr(first_order, 'LARGEST', 50)
    assert np.allclose(answer(), whole, rtol=0, atol=1e-12 * abs(whole).max())


def test_an_unstable_structure_with_losses_grows_as_its_pole_says():
    chain = lattices.chain(1.0, 1.0).repeat((4, 1, 1))
    chain.calc = MagneticRepulsion(chain, InversePower(1.0, 4.0), foundation=0.5)  # transverse: 0.5 - 2 (1 - cos xi), to -3.5
    chain.set_momenta([[0, (-1) ** k * 1e-6, 0] for k in range(4)])
    c = np.array([0.4, 0.8, 0.4, 0.8])  # of waves with xi = 0 and pi, (s^2 + 0.6 s + 0.5) (s^2 + 0.6 s - 3.5) = (0.2 s)^2
    true = np.roots(np.polysub(np.polymul([1, 0.6, 0.5], [1, 0.6, -3.5]), [0.04, 0, 0])).real.max()
    omega, decay, _ = damped_modes(chain, np.zeros((1, 3)), c)
    growth = -decay.min()
    assert growth == pytest.approx(true, rel=1e-9)
    assert omega.min() == -growth
    y = propagate(chain, [20.0, 21.0], damping=c).displacements[:, 0, 1]
    assert np.log(y[1] / y[0]) == pytest.approx(growth, rel=1e-6)


PAIR = 'x_m,y_m,relative_damping\n0,0,1\n0.01,0,0\n'
LAW = {'kind': 'inverse_power', 'b_N_m_a': 1.6209e-10, 'a': 4.5824, 'shells': 1}
PLAIN = """title = "losses"
[lattice]
kind = "triangular"
spacing_m = 0.01
mass_kg = 7.07e-4
[law]
kind = "inverse_power"
b_N_m_a = 1.6209e-10
a = 4.5824
shells = 1
[foundation]
stiffness_N_per_m = 19.675721234
[bands]
path = "GM"
points = 3
damping_per_s = 100.0
"""
OF_A_FILE = {'title': 'two in a cell', 'law': LAW, 'foundation': {'stiffness_N_per_m': 19.7}, 'bands': {'damping_per_s': 40.0},
             'lattice': {'kind': 'file', 'file': 'p.csv', 'mass_kg': 7.07e-4, 'cell_m': [[0.02, 0.0], [0.005, 0.00866025]]}}


def test_losses_of_a_scene_reach_every_command_or_are_refused(tmp_path, capsys):
    (tmp_path / 'p.csv').write_text(PAIR)
    scene = Scene.model_validate(OF_A_FILE, context={'folder': tmp_path})
    gamma = scene.bands.damping_of(scene.atoms())
    assert gamma.tolist() == [0.04, 0.0]
    decay = analytic_bands(scene.atoms(), 'GX', damping=gamma).decay
    assert decay[-1] == pytest.approx([0.02, 0, 0.02, 0], abs=1e-5)  # at X the two particles move apart from each other
    command = tmp_path / 'scene.toml'
    command.write_text(PLAIN)
    main(['bands', '--verbose', str(command), '-o', str(tmp_path / 'out')])
    shear = np.sqrt(CUTOFF_Hz**2 + EDGE_Hz**2 - (50 / (2 * np.pi)) ** 2)
    assert re.search(rf'M, branch 1 +{shear:.3f}\d* +50 +0\.136', capsys.readouterr().out)
    saved = Bands.load(tmp_path / 'out/bands_damped.npz')
    assert np.allclose(saved.decay, 0.05)
    assert saved.frequencies_Hz[-1, 0] == pytest.approx(shear, rel=1e-9)
    with pytest.raises(ValueError, match='uncertainty: tolerances are those of the bands'):
        Scene.model_validate(OF_A_FILE | {'uncertainty': {'stiffness_percent': 1.0}}, context={'folder': tmp_path})
