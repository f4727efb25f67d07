"""The burst that moves in the page of the explorer is the exact motion of the package, in Chromium, wherever its sliders are."""

from pathlib import Path

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms

from magphonon import InversePower, MagneticRepulsion, ToneBurst, propagate, units as u
from magphonon.stiffness import relaxed

from .test_explorer_in_browser import MADE, browser, opened, slide  # noqa: F401  fixtures

pytestmark = [pytest.mark.browser, pytest.mark.slow]
ROOT = Path(__file__).parents[2]
PLANAR = ['triangular', 'honeycomb', 'kagome, two shells', 'square by Yukawa']
RUN = '''([carrier, damping, gyration, removed, time]) => {
  const burst = view.burst;
  Object.assign(burst, {playing: false});
  for (const [name, value] of Object.entries({carrier, damping, gyration})) {
    document.querySelector(`#burst [name=${name}]`).value = value;
  }
  if (removed) {
    burst.tool = 'remove';
    burst.act(burst.patch.keys.indexOf(burst.source));
    burst.tool = 'push';
  }
  burst.restart();
  const u = Object.fromEntries(MODELS.map(model => [model, (burst.bursts[model].advance(time), [...burst.bursts[model].u])]));
  const {x, y, mass, held} = burst.patch;
  return {u, x, y, mass, held: [...held], drive: burst.drive, rest: burst.rest && [...burst.rest], gone: burst.gone.size,
          words: document.querySelector('#burst .words').textContent};
}'''


def structure(made, told, state, model):
    """The patch of the page as the package makes it from the places of its particles; it finds the bonds itself."""
    places = np.column_stack([told['x'], told['y'], np.zeros(len(told['x']))]) * state['spacing_m'] * u.m
    atoms = Atoms('H' * len(places), places, masses=np.array(told['mass']) * u.kg,
                  constraint=FixAtoms(np.flatnonzero(told['held'])))
    cell = made.cell(**state)
    law, reach = cell.calc.law, cell.calc.bonds.lengths.max() * (1 + 1e-3)
    g = told['drive']['gyration_rad_per_s'] * 1e-3
    springs = state['foundation_N_per_m'] * u.N / u.m
    atoms.calc = MagneticRepulsion(atoms, law, cutoff=reach, model=model, gyration=g, foundation=springs)
    return atoms


def exact_motion(told, model, atoms, time):
    """What the page says of a model, in mm, once it has been found to be the exact motion."""
    drive, own = told['drive'], np.array(told['u'][model]) * u.m
    burst = ToneBurst(drive['source'], drive['direction'], drive['force_N'] * u.N, 2e-3 * np.pi * drive['carrier_Hz'],
                      cycles=drive['cycles'])
    exact = propagate(atoms, [0.0, time * 1e3], [burst], damping=drive['damping_per_s'] * 1e-3).displacements[-1]
    assert abs(own - exact[:, :2].ravel()).max() < 0.01 * abs(exact).max()
    return own


@pytest.mark.parametrize(('name', 'removed'), [*((name, False) for name in PLANAR), ('triangular', True)])
def test_the_burst_of_the_page_is_the_exact_motion(name, removed, opened):  # noqa: F811
    rng, page, made = np.random.default_rng(PLANAR.index(name)), opened(MADE[name]), MADE[name]
    state = slide(page, foundation=page.evaluate('data.sliders.foundation.values.length - 1'))
    lowest = page.evaluate('Math.min(...view.bands.complete.flat())')
    highest = page.evaluate('Math.max(...view.bands.conventional.flat())')
    carrier = rng.uniform(lowest, (lowest + highest) / 2)
    time = 6.0 / carrier
    damping, gyration = rng.uniform(0, 1.0 / time), 0.0 if removed else rng.uniform(0.1, 1.0) * lowest
    told = page.evaluate(RUN, [carrier, damping, gyration, removed, time])
    assert told['gone'] == int(removed), told['words']
    drive, motions = told['drive'], {}
    assert drive['carrier_Hz'] == pytest.approx(carrier, rel=0.02)  # the slider has steps
    for model in ('complete', 'conventional'):
        atoms = structure(made, told, state, model)
        if removed:
            atoms = relaxed(atoms).atoms
            away = atoms.positions[:, :2] - structure(made, told, state, model).positions[:, :2]
            np.testing.assert_allclose(np.ravel(away), np.array(told['rest']) * u.m, atol=1e-6 * made.spacing)
        motions[model] = exact_motion(told, model, atoms, time)
    apart = abs(motions['complete'] - motions['conventional']).max()
    assert apart > 0.1 * abs(motions['complete']).max()  # the other model would not pass


@pytest.mark.parametrize('removed', [False, True])
def test_the_tone_in_a_structure_from_a_table_is_the_exact_motion(removed, opened):  # noqa: F811
    rng, page = np.random.default_rng(7 + removed), opened('demultiplexer')
    carrier, time = rng.uniform(45, 95), rng.uniform(0.1, 0.2)
    if removed:  # one of the middle
        page.evaluate('view.burst.source = view.burst.patch.keys[63]')
    told = page.evaluate(RUN, [carrier, rng.uniform(1, 8), 0.0 if removed else rng.uniform(10, 60), removed, time])
    assert told['gone'] == int(removed), told['words']
    drive, motions = told['drive'], {}
    table = np.delete(np.genfromtxt(ROOT / 'data/demultiplexer.csv', delimiter=',', skip_header=1), [63] * removed, axis=0)
    for model in ('complete', 'conventional'):
        atoms = Atoms('H' * len(table), np.column_stack([table[:, :2], np.zeros(len(table))]) * u.m,
                      masses=table[:, 2] * u.kg, constraint=FixAtoms(np.flatnonzero(table[:, 5])))
        law = InversePower(1.6209e-10 * u.N * u.m**4.5824, 4.5824)
        atoms.calc = MagneticRepulsion(atoms, law, cutoff=45 * u.mm, strengths=table[:, 3], model=model,
                                       gyration=drive['gyration_rad_per_s'] * 1e-3, foundation=table[:, 4] * u.N / u.m)
        atoms = relaxed(atoms).atoms
        motions[model] = exact_motion(told, model, atoms, time)
    apart = abs(motions['complete'] - motions['conventional']).max()
    assert apart > 0.1 * abs(motions['complete']).max()
