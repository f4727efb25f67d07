"""Numbers that the comments of ready scenes quote as results, computed here to the digits that are printed.

Shares of a wave, which only a run can tell, are not among them.
"""

import re

import numpy as np
import pytest

from magphonon import read_scene, ready_scene, units as u
from magphonon.bands.bloch import bloch_modes
from magphonon.interactions.pair_laws import repulsion
from magphonon.response import natural_frequencies
from magphonon.scenes import ready_scenes, reference

PILLAR = 3 * 71e9 * (np.pi * 7.9375e-4**4 / 4) / 0.15**3  # N/m
MASS, L, A = 7.07e-4, 0.01, 4.5824
FORCE = 1.6209e-10 * L**-A
CHARGE = np.sqrt(3.3e-20 * 4 * np.pi * 8.8541878128e-12) / 1.602176634e-19
ZIGZAG = 3.5 * 1.2020569031595942 * 1.602176634e-19**2 / (4 * np.pi * 8.8541878128e-12 * 5e-6**3)  # N/m
ROD = 33 / 140 * 2700 * np.pi * 7.9375e-4**2 * 0.15 / MASS


def hertz(squared):
    """Of a squared frequency in rad^2/s^2."""
    return np.sqrt(squared) / (2 * np.pi)


def shear(name):
    """Lower branch at M by the sum over all neighbours; tests of stiffness compare that sum with others."""
    scene = read_scene(name)
    return u.hertz(bloch_modes(scene.perfect_cell(), scene.special_points['M'][None])[0][0, 0])


def local_modes():
    """Frequencies of the vacancy between the bands."""
    f = u.hertz(natural_frequencies(read_scene('vacancy').atoms()))
    return f[(f > 71) & (f < 86)]


def turn(k):
    """From node 0 of the prism to its node k, in degrees."""
    x, y = read_scene('prism').lattice.cell().positions[k, :2]  # node 0 is at (x, 0)
    return np.degrees(np.arctan2(y, x))


# of shear waves at 40 Hz along Gamma-M with 4 /s, per row: f^2 = cut-off^2 + (edge sin(xi/2))^2
DECAY = (2 * np.arcsin(np.sqrt(40**2 + 1j * 40 * 4 / (2 * np.pi) - 26.550686524**2) / 51.8276683282)).imag


def far_shells():
    """Share of the stiffness phi'' of the fcc crystal beyond its second shell, of distances from 1 on."""
    n = np.arange(-8, 9)
    points = np.stack(np.meshgrid(n, n, n), axis=-1).reshape(-1, 3)
    squared = (points**2).sum(axis=1)[points.sum(axis=1) % 2 == 0] / 2.0
    stiffness = squared[squared > 0] ** -7.0  # r^-14
    return stiffness[squared[squared > 0] > 2.5].sum() / stiffness.sum()


QUOTED = {  # scene -> words with the number in quotes -> what it is
    'chain': {'4 f(L0)/L0 = `4e4` N/m': lambda: 4e4},
    'demultiplexer': {'all pairs within `45` mm': lambda: L * (np.sqrt(19) + np.sqrt(21)) / 2 * 1e3,  # between two shells
                      'rods of `1.51` to': lambda: 0.95 * 2 * 0.79375, 'to `1.67` mm': lambda: 1.05 * 2 * 0.79375},
    'demux': {'with `1e-3` of the force': lambda: 4.5 ** -A},
    'design': {'spacing of `10` mm': lambda: 1e3 * L},
    'disc': {'`7` mm between the rims': lambda: 12 - 5, '`7500` kg/m^3': lambda: 4.4e-4 / (np.pi * 0.0025**2 * 0.003)},
    'dust': {'`12 000` elementary': lambda: CHARGE, 'kappa L0 = `1`': lambda: 1.0,
             '`8.6` um': lambda: 1e6 * (6 * 5e-13 / (np.pi * 1510)) ** (1 / 3),  # melamine has 1510 kg/m^3
             'kappa L0 = `1.618`': lambda: (1 + np.sqrt(5)) / 2},
    'fcc': {'phi = `1` J': lambda: 12 / (13 - 1), '`18` neighbours': lambda: 12 + 6, 'all but `1e-3`': far_shells},
    'gyro': {'so soft that `72` turns a minute': lambda: 7.5 / (2 * np.pi) * 60, 'of the bench, `7.5` rad/s': lambda: 15 / 2,
             'less `0.040` = m W^2': lambda: MASS * 7.5**2},
    'honeycomb': {"prototype's `20` N/m": lambda: PILLAR},
    'ideal': {'as `120` and': lambda: 19.0985931710274 * 2 * np.pi, '`400` rad/s': lambda: 63.6619772367581 * 2 * np.pi},
    'ions': {'threshold of `7.765e-12` N/m': lambda: ZIGZAG, 'trap of `1.8` MHz': lambda:
             1e-6 * np.sqrt(1.1 * ZIGZAG / 6.64e-26) / (2 * np.pi)},
    'layer': {'`12 000` elementary': lambda: CHARGE,
              'above `1.11e-9`': lambda: reference()['layer']['gate'][0] ** 2 * 3.3e-20 / 8e-4**3},
    'measured': {'`19.6757` N/m': lambda: PILLAR, 'neighbours, `17.3` mm': lambda: 10 * np.sqrt(3)},
    'neighbours': {'from `58.2`': lambda: hertz((PILLAR + (2 * A - 6) * FORCE / L) / MASS),
                   'to `67.5` Hz': lambda: np.sqrt(1 + ROD) * shear('neighbours'),
                   '`27` % of a magnet': lambda: 100 * ROD, 'to `59.9` Hz': lambda: shear('neighbours'),
                   'k = `19.6757`': lambda: PILLAR},
    # along y the three bonds have n_y^2 = 1, 1/4, 1/4: D0 = 1.5 a f/L, D* = -1.5 f/L
    'oscillator': {'`212.1` rad/s': lambda: np.sqrt(4.5e4),
                   '`33.76` Hz': lambda: hertz(4.5e4), '`244.9` rad/s': lambda: np.sqrt(6e4),
                   '`38.98` Hz': lambda: hertz(6e4), 'ratio of `2.8` %': lambda: 100 * 12 / (2 * np.sqrt(4.5e4)),
                   '`0.05` Hz apart': lambda: (64 - 16) / 960, 'by `0.8` % of L0': lambda: 100 * 20 / (12 * np.sqrt(4.5e4))},
    'penning': {'chosen: `1.01` MHz': lambda: 1e-6 * np.sqrt(6e-13 / 1.4965e-26) / (2 * np.pi),
                'chosen: `6.4` MHz': lambda: 4e1 / (2 * np.pi)},
    # struts of three cables each at a node are pressed at a turn of 90 - 180/3 degrees
    'prism': {'turned by `30` degrees': lambda: turn(3), 'node `30` degrees further': lambda: turn(3),
              'node `150` degrees further': lambda: turn(4), '(Calladine `1978`)': lambda: 1978},
    'prototype': {'`19.6757` N/m': lambda: PILLAR, 'cut-off of `26.55` Hz': lambda: hertz(PILLAR / MASS),
                  '`0.2` Hz apart': lambda: 50 / 250, 'peaks `0.6` Hz wide': lambda: 4 / (2 * np.pi)},
    'rings': {'is `59` % above': lambda: 100 * (repulsion(read_scene('rings').law.potential(), 10.0) / FORCE - 1),
              'weighs `0.7070` g': lambda: 7.5e-3 * np.pi / 4 * (6.35**2 - 1.5875**2) * 3.175,
              'force_N = `0.2369`': lambda: FORCE},
    'signs': {'k1 = a f/L0 = `108.6` N/m': lambda: A * FORCE / L, 'times that of neighbours: k2 = -k1/`2`': lambda:
              2 / (2**-A * (3.88326e-9 / 1.6209e-10)),
              '4 f/L0 = `94.8` N/m': lambda: 4 * FORCE / L, 'k1/2 = `54.3` N/m': lambda: A * FORCE / L / 2},
    'square': {'= `94.8` N/m': lambda: 4 * FORCE / L, 'provide `157.4` N/m': lambda: 8 * PILLAR, 'cut-off, `75` Hz': lambda:
               hertz(8 * PILLAR / MASS), 'at X, `145.6` Hz': lambda: hertz((8 * PILLAR + 4 * A * FORCE / L) / MASS),
               'force of `0.24` N': lambda: FORCE},
    'steel': {'`3` um less': lambda: 1e6 * (0.02 - 0.019997), 'D* is `1e-4` of D0': lambda: 3e-6 / 1.5 / 0.02,
              '`55` N per contact': lambda: 4 / 3 * 206e9 / (2 * (1 - 0.3**2)) * np.sqrt(0.02 / 4) * 3e-6**1.5,
              '`7800` kg/m^3': lambda: 0.03268 / (np.pi / 6 * 0.02**3)},
    'thermal': {'temperature_J = `2.369e-5`': lambda: FORCE * L / 100},
    'tissue': {'stretched by `11` %': lambda: 100 * (1e-5 / 9e-6 - 1)},
    'tolerances': {'chosen: `50` um': lambda: 1e6 * 0.5e-2 * L,
                   'to `0.6` %': lambda: 100 * np.sqrt(np.array([0.095, x := -0.0045 * A * np.log(L)])
                                                     @ [[1, -0.998], [-0.998, 1]] @ [0.095, x])},
    'vacancy': {'at `78.83` Hz twice': lambda: local_modes()[0], 'at `80.27` Hz': lambda: local_modes()[2],
                "prototype's `20` N/m": lambda: PILLAR, '`0.1` Hz': lambda: 40 / 400},
    'walls': {'cut-off of `26.55` Hz': lambda: hertz(PILLAR / MASS), 'peaks `0.6` Hz wide': lambda: 4 / (2 * np.pi),
              '`0.4` Hz apart': lambda: 50 / 125, 'factor of `1.50`': lambda: np.exp(20 * DECAY)},
    'wigner': {'`4.4e6` electrons': lambda: 1e-4 * 2 / np.sqrt(3) / 5.1e-6**2},
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
    assert {'kagome'} == set(ready_scenes()) - set(QUOTED)
