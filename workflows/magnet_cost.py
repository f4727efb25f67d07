"""The cost of an accurate force between two magnets: sums over rims, magpylib's field on faces, magpylib's mesh."""

from functools import partial

import numpy as np

from magphonon import units as u
from magphonon.interactions.magnet_pairs import magnet_law, pair_force
from magphonon.interactions.pair_laws import repulsion

from .accuracy import Candidate, Chart, cheapest, measure
from .rows import Check

DISTANCES = 10 * u.mm, 7 * u.mm     # of the prototype, and with a gap of a tenth of the diameter
RIMS, SERIES, FIELD, MESH = 'rims of the faces', 'series made once', "magpylib's field on the faces", "magpylib's force on a mesh"
MISSING = "magpylib skipped: pip install 'magphonon[magnets]'"


def chart(ring):
    """Relative error of the force between two rings against wall time, at two distances; with magpylib if it is installed."""
    try:
        import magpylib
    except ImportError:
        magpylib = None
    table, checks = [], []
    for r in DISTANCES:
        exact = pair_force(ring, ring, (r, 0, 0), n=240)[0]
        methods = candidates(ring, r, magpylib)
        own = measure(methods, error=lambda force, exact=exact: abs(force / exact - 1), repeats=3, patience=0.2)
        table += own
        error = {(m.method, m.setting): m.error for m in own}
        at = f'rings {r / u.mm:g} mm apart'
        checks += [Check(f'{at}: 160 points on each rim against 240', error[RIMS, '160'], 0, 1e-9, consistency=True),
                   Check(f'{at}: law against rims', next(m.error for m in own if m.method == SERIES), 0, 1e-9,
                         consistency=True)]
        if magpylib:
            checks += [Check(f'{at}: {FIELD} against rims', error[FIELD, '24'], 0, 1e-9),
                       Check(f'control: {at}: {MESH}, 10 cells', error[MESH, '10'], 0, 1e-3, control=True)]
    return Chart('What the accuracy of a force between two rings costs', table, reading(table), checks, error='relative error')


def candidates(ring, r, magpylib):
    """Methods for the force at the distance `r`; their setting is the number of points or cells."""
    panel, law = f'{r / u.mm:g} mm apart', magnet_law(ring)
    methods = [Candidate(RIMS, str(n), partial(by_rims, ring, r, n), panel) for n in (8, 12, 16, 24, 32, 48, 96, 160)]
    methods.append(Candidate(SERIES, str(len(law.series)), lambda cost: repulsion(law, r), panel))
    if magpylib:
        magnet = partial(magpylib.magnet.CylinderSegment, polarization=(0, 0, ring.remanence / u.T),
                         dimension=(ring.inner / 2 / u.m, ring.outer / 2 / u.m, ring.height / u.m, 0, 360))
        methods += [Candidate(FIELD, str(n), partial(by_field, magnet(), ring, r, n), panel) for n in (2, 4, 6, 8, 12, 16, 24)]
        methods += [Candidate(MESH, str(n), partial(by_mesh, magpylib, magnet, r, n), panel) for n in (10, 100, 1000, 4000)]
    return methods


def by_rims(ring, r, n, cost):
    """Force from the rims of the faces, with `n` points on each circle."""
    return pair_force(ring, ring, (r, 0, 0), n)[0]


def by_field(source, ring, r, n, cost):
    """Force on the charges of the second ring's faces in magpylib's field, sigma B dA: n Gauss times 4 n equidistant points."""
    x, weight = np.polynomial.legendre.leggauss(n)
    angle, half = np.pi * np.arange(4 * n) / (2 * n), (ring.outer - ring.inner) / 4
    radius = ring.inner / 2 + half * (x + 1)
    plane = np.stack([np.outer(radius, np.cos(angle)) + r, np.outer(radius, np.sin(angle))], axis=-1).reshape(-1, 2)
    charge = np.repeat(ring.remanence / u.mu0 * half * weight * radius * np.pi / (2 * n), 4 * n)
    top, bottom = (source.getB(np.insert(plane, 2, z, axis=1) / u.m)[:, 0] for z in (ring.height / 2, -ring.height / 2))
    return charge @ (top - bottom) * u.T


def by_mesh(magpylib, magnet, r, n, cost):
    """Force by magpylib's own mesh of about `n` cells."""
    return magpylib.getFT(magnet(), magnet(position=(r / u.m, 0, 0)), meshing=n)[0][0] * u.N


def reading(table):
    """The conclusion of the chart in words."""
    near = [m for m in table if m.panel == table[0].panel]

    def takes(method, tolerance):
        best = cheapest([m for m in near if m.method == method], tolerance)
        return f'does not reach {tolerance:g}' if best is None else f'takes {1e3 * best.seconds:.2g} ms for {tolerance:g}'

    series = next(m for m in near if m.method == SERIES)
    text = (f'At {table[0].panel}, the sum over rims {takes(RIMS, 1e-9)}; a series, made from it once for all '
            f'distances, then takes {1e6 * series.seconds:.0f} us.')
    if not any(m.method == FIELD for m in near):
        return f'{text} {MISSING}'
    return f'{text} {FIELD} {takes(FIELD, 1e-9)}; {MESH} {takes(MESH, 1e-3)} and {takes(MESH, 1e-9)}.'
