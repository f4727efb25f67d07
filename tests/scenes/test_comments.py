"""Numbers that the comments of ready scenes quote as results, computed here to the digits that are printed.

Shares of a wave, which only a run can tell, are not among them.
"""

import re

import numpy as np
import pytest
from ridge_lattices import cantilever
from scipy.optimize import brentq

from magphonon import read_scene, units as u
from magphonon.bands.bloch import bloch_modes
from magphonon.interactions.pair_laws import repulsion
from magphonon.response import natural_frequencies
from magphonon.scenes import ready_scene, ready_scenes, reference

PILLAR = 3 * 71e9 * (np.pi * 7.9375e-4**4 / 4) / 0.15**3  # N/m
MASS, L, A = 7.07e-4, 0.01, 4.5824
FORCE = 1.6209e-10 * L**-A
CHARGE = np.sqrt(3.3e-20 * 4 * np.pi * 8.8541878128e-12) / 1.602176634e-19
ROD = 33 / 140 * 2700 * np.pi * 7.9375e-4**2 * 0.15 / MASS


def hertz(squared):
    """Of a squared frequency in rad^2/s^2."""
    return np.sqrt(squared) / (2 * np.pi)


def shear(name):
    """Lower branch at M by the sum over all neighbours; tests of stiffness compare that sum with others."""
    scene = read_scene(name)
    return u.hertz(bloch_modes(scene.perfect_cell(), scene.special_points['M'][None])[0][0, 0])


def beams():
    """Lower branch at M on aluminium beams: m w^2 = K - k + k(w), with K on springs and the mass m of magnets alone."""
    rod, K = 140 / 33 * ROD * MASS, (1 + ROD) * MASS * (2 * np.pi * shear('neighbours')) ** 2
    w = brentq(lambda w: MASS * w**2 - K + PILLAR * (1 - cantilever(3 * rod * w**2 / PILLAR)), 1, 800)
    return w / (2 * np.pi)


def local_modes():
    """Frequencies of the vacancy between the bands."""
    f = u.hertz(natural_frequencies(read_scene('vacancy').atoms()))
    return f[(f > 71) & (f < 86)]


def turn(k):
    """From node 0 of the prism to its node k, in degrees."""
    x, y = read_scene('prism').lattice.cell().positions[k, :2]  # node 0 is at (x, 0)
    return np.degrees(np.arctan2(y, x))


QUOTED = {  # scene -> words with the number in quotes -> what it is
    'demultiplexer': {'with `1e-3` of the force': lambda: 4.5 ** -A},
    'gyro': {'so soft that `72` turns a minute': lambda: 7.5 / (2 * np.pi) * 60, 'of the bench, `7.5` rad/s': lambda: 15 / 2,
             'less `0.040` = m W^2': lambda: MASS * 7.5**2},
    'ideal': {'as `120` and': lambda: 19.0985931710274 * 2 * np.pi, '`400` rad/s': lambda: 63.6619772367581 * 2 * np.pi},
    'layer': {'`12 000` elementary': lambda: CHARGE,
              'above `1.11e-9`': lambda: reference()['layer']['gate'][0] ** 2 * 3.3e-20 / 8e-4**3},
    'neighbours': {'from `58.2`': lambda: hertz((PILLAR + (2 * A - 6) * FORCE / L) / MASS),
                   'to `67.5` Hz': lambda: np.sqrt(1 + ROD) * shear('neighbours'),
                   '`27` % of a magnet': lambda: 100 * ROD, 'to `59.7` Hz': beams,
                   'k = `19.6757`': lambda: PILLAR},
    # along y the three bonds have n_y^2 = 1, 1/4, 1/4: D0 = 1.5 a f/L, D* = -1.5 f/L
    'oscillator': {'`212.1` rad/s': lambda: np.sqrt(4.5e4),
                   '`33.76` Hz': lambda: hertz(4.5e4), '`244.9` rad/s': lambda: np.sqrt(6e4),
                   '`38.98` Hz': lambda: hertz(6e4), 'ratio of `2.8` %': lambda: 100 * 12 / (2 * np.sqrt(4.5e4)),
                   '`0.05` Hz apart': lambda: (64 - 16) / 960},
    # struts of three cables each at a node are pressed at a turn of 90 - 180/3 degrees
    'prism': {'turned by `30` degrees': lambda: turn(3), 'node `30` degrees further': lambda: turn(3),
              'node `150` degrees further': lambda: turn(4), '(Calladine `1978`)': lambda: 1978},
    'prototype': {'`19.6757` N/m': lambda: PILLAR},
    'rings': {'is `59` % above': lambda: 100 * (repulsion(read_scene('rings').law.potential(), 10.0) / FORCE - 1),
              'weighs `0.7070` g': lambda: 7.5e-3 * np.pi / 4 * (6.35**2 - 1.5875**2) * 3.175},
    'square': {'= `94.8` N/m': lambda: 4 * FORCE / L, 'provide `157.4` N/m': lambda: 8 * PILLAR, 'cut-off, `75` Hz': lambda:
               hertz(8 * PILLAR / MASS), 'at X, `145.6` Hz': lambda: hertz((8 * PILLAR + 4 * A * FORCE / L) / MASS),
               'force of `0.24` N': lambda: FORCE},
    'tolerances': {'chosen: `50` um': lambda: 1e6 * 0.5e-2 * L,
                   'stiffness_percent = `2.9`': lambda: np.hypot(1, np.hypot(4 * 100 * 5e-6 / 7.9375e-4, 3 * 100 * 5e-4 / 0.15))},
    'vacancy': {'at `78.83` Hz twice': lambda: local_modes()[0], 'at `80.27` Hz': lambda: local_modes()[2],
                "prototype's `20` N/m": lambda: PILLAR, '`0.1` Hz': lambda: 40 / 400},
}


@pytest.mark.parametrize(('name', 'quote'), [(name, quote) for name in QUOTED for quote in QUOTED[name]])
def test_a_quoted_number(name, quote):
    assert quote.replace('`', '') in ' '.join(re.sub(r'\n#', ' ', ready_scene(name).read_text(encoding='utf-8')).split())
    printed = quote.split('`')[1].replace(' ', '')
    mantissa, _, power = printed.partition('e')
    whole, _, decimals = mantissa.partition('.')
    zeros = len(whole) - len(whole.rstrip('0')) if not decimals else -len(decimals)  # at the end of a round number
    assert QUOTED[name][quote]() == pytest.approx(float(printed), abs=0.51 * 10.0 ** (int(power or 0) + zeros))


def test_every_ready_scene_with_numbers_is_here():
    assert set(ready_scenes()) == set(QUOTED)
