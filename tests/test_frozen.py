"""Numbers of the ready scenes as version 0.3.0 gave them: the cut to 0.4.0 removed features and changed none of these.

`python tests/test_frozen.py` prints the numbers of the package as it is, in the form of tests/frozen.json.  That file was written
by the package before the first line left (commit a4f3860b), so it guards against changes; it is no outside reference.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from magphonon import DrivenVerlet, ToneBurst, critical_foundation, frequency_response, modes, read_scene, verdict
from magphonon.bands.bloch import bloch_modes
from magphonon.scenes import ready_scene
from magphonon.stiffness.rest import freedom

FROZEN = Path(__file__).with_name('frozen.json')
SCENES = ('prototype', 'ideal', 'oscillator', 'rings', 'neighbours', 'square', 'gyro', 'layer', 'demultiplexer', 'vacancy',
          'prism', 'tolerances')
OF_0_3_0 = {'demultiplexer': Path(__file__).with_name('ready') / 'demultiplexer.toml'}
"""The device of 0.3.0, in whose place a better one stands."""
DIGITS = {'burst': 1e-6, 'response': 1e-9}
"""Largest change, as a fraction of the largest number of its kind: where none is named 1e-11, twelve digits less one for sums in
another order.  A response near a resonance is fifty times as sensitive as the stiffness; around a vacancy particles rest within
1e-12 of the forces of bonds.  Frequencies are compared as squares, as those of rigid motions are round-off."""
ROUNDED = {'ideal': 20 * np.spacing(44250.0)}
"""Rounding of a burst in mm where it is more: ASE's loop rounds each position at each step, and `ideal` is 44 m wide."""


def numbers(name):
    """Arrays by name: bands and stability of the lattice, modes, response and 200 steps of a burst of the structure."""
    scene = read_scene(OF_0_3_0.get(name, ready_scene(name)))
    found = {}
    for model in ('complete', 'conventional'):
        if not (scene.single or scene.finite):
            cell = scene.perfect_cell()
            points = np.array([scene.special_points[point] for point in sorted(scene.special_points)])
            found[f'{model}: bands at special points'] = bloch_modes(cell, points, model)[0]
        if scene.single or scene.finite or scene.patch is not None:
            found |= {f'{model}: {what}': array for what, array in of_structure(structure(scene, model)).items()}
    atoms = scene.atoms()
    if not (scene.single or scene.finite or name == 'gyro'):  # of particles that gyrate the verdict alone knows it
        found['critical foundation'] = np.array([critical_foundation(scene.perfect_cell(), 'complete')[0]])
    judged = verdict(atoms)
    for what in ('amplitude', 'timestep_limit'):
        value = judged.finding(what).value
        found[what] = np.array([] if value is None else [value])
    found['stable'] = np.array([float(judged.stable)])
    return found


def structure(scene, model):
    """The patch, the finite structure or the oscillator with one of the two models."""
    if not scene.single:
        return scene.patch_atoms(model)
    atoms = scene.perfect_cell()
    atoms.calc.set(model=model)
    return atoms


def of_structure(atoms):
    """Lowest modes, response to a force and a burst: at the free particle nearest the middle, seen there and at its neighbour."""
    free = np.flatnonzero(freedom(atoms)[0])
    away = np.linalg.norm(atoms.positions - atoms.positions[free].mean(axis=0), axis=1)[free]
    driven, seen = free[np.lexsort((free, away.round(6)))[[0, min(1, len(free) - 1)]]]
    size = atoms.calc.dim * len(free)
    lowest = (modes(atoms) if size < 30 else modes(atoms, 6)).omega
    push = np.zeros((len(atoms), 3))
    push[driven, :2] = 0.6, 0.8
    scale = 1 / verdict(atoms)['timestep_limit']   # half the highest frequency
    answer = frequency_response(atoms, push, scale * np.array([0.3, 0.5, 0.8, 1.3]), 0.05 * scale).response
    burst = ToneBurst([driven], (0.6, 0.8), 1e-4 * scale**2 * atoms.get_masses()[driven], 0.6 * scale, 3)
    run = DrivenVerlet(atoms, 0.2 / scale, [burst], damping=0.02 * scale, engine='ase')
    run.run(200)
    return {'lowest modes': lowest * abs(lowest),  # squares, as those of rigid motions are round-off
            'response': np.ravel([answer[:, [driven, seen]].real, answer[:, [driven, seen]].imag]),
            'burst': run.displacements[[driven, seen]].ravel()}


@pytest.mark.parametrize('name', [pytest.param(name, marks=pytest.mark.slow) if name == 'gyro' else name for name in SCENES])
def test_numbers_are_those_of_version_0_3_0(name):
    frozen, found = json.loads(FROZEN.read_text(encoding='utf-8'))[name], numbers(name)
    assert found.keys() == frozen.keys()
    for what, array in found.items():
        there, here = np.array(frozen[what]), np.ravel(array)
        if 'bands' in what:
            there, here = there * abs(there), here * abs(here)
        most = DIGITS.get(what.rpartition(' ')[2], 1e-11) * abs(here).max(initial=0)
        if what.endswith('burst'):
            most = max(most, ROUNDED.get(name, 0.0))
        np.testing.assert_allclose(here, there, rtol=0, atol=most, err_msg=f'{name}: {what}')


if __name__ == '__main__':
    lines = {name: ',\n'.join(f' {json.dumps(what)}: {json.dumps([float(f"{x:.12g}") for x in np.ravel(array)])}'
                              for what, array in numbers(name).items()) for name in SCENES}
    print('{' + ',\n'.join(f'{json.dumps(name)}: {{\n{text}}}' for name, text in lines.items()) + '}')
