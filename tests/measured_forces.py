"""Forces made up as if measured, for the tests of fits."""

from functools import cache
from importlib.resources import files

import numpy as np

from magphonon import InversePower
from magphonon.interactions import Forces, repulsion
from magphonon.scenes.scene import read_scene, ready_scene

L0, A = 10.0, 4.5824
LAW = InversePower(0.2369 * L0**A, A)
R = np.linspace(8, 15, 15)
SYNTHETIC = files('magphonon.data') / 'synthetic_force.csv'


@cache
def rings():
    return read_scene(ready_scene('rings')).law.potential()


def synthetic_forces(law, r, sigma, seed):
    """Forces of a `law` at distances `r` with Gaussian noise `sigma` (N)."""
    return Forces(r, repulsion(law, r) + np.random.default_rng(seed).normal(scale=sigma, size=len(r)), np.full(len(r), sigma))


def write(folder, text):
    (folder / 'data.csv').write_text(text)
    return str(folder / 'data.csv')


def table_of(r, f, header='r_m,f_N', join=','):
    return header + '\n' + ''.join(f'{x!r}{join}{y!r}\n' for x, y in zip(r.tolist(), f.tolist(), strict=True))
