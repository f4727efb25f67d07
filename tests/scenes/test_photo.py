"""Lattices measured in a photo: the frequencies of the true lattice, which a double loop of its own simulates."""

import numpy as np
import pytest
from scipy.optimize import root

from magphonon import modes, read_scene, units as u
from magphonon.scenes.structures import MOVED

B, A, K, MASS, SPACING = 1.6209e-10 * u.N * u.m**4.5824, 4.5824, 0.045, 0.707, 10.0  # of magnets on pillars, in mm, g and ms
SCENE = """title = "A photo"
[lattice]
kind = "file"
file = "photo.csv"
mass_kg = 7.07e-4
cutoff_m = 0.2
{lattice}
[law]
kind = "inverse_power"
b_N_m_a = 1.6209e-10
a = 4.5824
shells = 1
[foundation]
stiffness_N_per_m = 45.0
"""


class Truth:
    """A hexagon of magnets with some missing, each with its own foot, strength and pillar, its rim held; every pair repels."""

    def __init__(self, rng, missing, rings=4):
        q, r = np.meshgrid(*2 * [np.arange(-rings, rings + 1)])
        ring = np.maximum(np.maximum(abs(q), abs(r)), abs(q + r)).ravel()
        feet = SPACING * np.stack([(q + r / 2).ravel(), r.ravel() * np.sqrt(0.75)], axis=1)[ring <= rings]
        gone = rng.choice(np.flatnonzero(ring[ring <= rings] < rings), missing, replace=False)
        self.feet = np.delete(feet, gone, axis=0)
        self.held = np.delete(ring[ring <= rings] == rings, gone)
        n = len(self.feet)
        self.feet = self.feet + 0.15 * rng.normal(size=(n, 2))
        self.strength, self.k = 1 + 0.025 * rng.normal(size=n), K * (1 + 0.05 * rng.normal(size=n))
        self.rest = self.feet.copy()
        free = ~self.held

        def pull(x, derivative=False):
            at = self.feet.copy()
            at[free] = x.reshape(-1, 2)
            gradient, H = self.gradient(at)
            own = np.repeat(free, 2)
            return H[np.ix_(own, own)] if derivative else gradient[free].ravel()

        found = root(pull, self.feet[free].ravel(), jac=lambda x: pull(x, True), options={'xtol': 1e-13})
        assert abs(found.fun).max() < 1e-10
        self.rest[free] = found.x.reshape(-1, 2)
        omega2, self.shapes = np.linalg.eigh(pull(found.x, True) / MASS)
        assert omega2.min() > 0
        self.frequencies_Hz = np.sqrt(omega2) / (2 * np.pi) * 1e3

    def gradient(self, at):
        """Gradient and second derivatives of the energy, over all pairs within reach."""
        n, both = len(at), np.arange(len(at))
        R = at[:, None] - at
        r = np.linalg.norm(R, axis=2) + np.where(np.eye(n), np.inf, 0)
        f = np.outer(self.strength, self.strength) * B * r**-A
        nn = R[..., :, None] * R[..., None, :] / r[..., None, None] ** 2
        blocks = -(A * nn - (np.eye(2) - nn)) * (f / r)[..., None, None]
        blocks[both, both] = self.k[:, None, None] * np.eye(2) - blocks.sum(axis=1)
        return self.k[:, None] * (at - self.feet) - (f[..., None] * R / r[..., None]).sum(axis=1), \
            blocks.swapaxes(1, 2).reshape(2 * n, 2 * n)


def photographed(folder, truth, rng, noise_mm=0.0, places='rest', keys='positions = "rest"', strengths=False, **columns):
    """The scene of a photo, turned, of any scale, in any order, whose two known points are far outside the magnets."""
    scale, turn, origin = rng.uniform(5, 30), rng.uniform(0, 2 * np.pi), rng.uniform(0, 3000, 2)
    marks = np.array([[-80.0, -70.0], [75.0, -60.0]])

    def seen(at):
        z = scale * np.exp(1j * turn) * (at @ [1, 1j])
        return np.stack([z.real, -z.imag], axis=1) + origin

    at = seen(getattr(truth, places) + noise_mm * rng.normal(size=(len(truth.rest), 2)))
    columns = {'x_px': at[:, 0], 'y_px': at[:, 1], 'held': truth.held.astype(int)} | columns
    if strengths:
        columns |= {'strength': truth.strength, 'stiffness_N_per_m': truth.k / (u.N / u.m)}
    order = rng.permutation(len(at))
    rows = np.stack(list(columns.values()), axis=1)[order]
    (folder / 'photo.csv').write_text('\n'.join([','.join(columns), *(','.join(f'{x:.17g}' for x in row) for row in rows)]))
    text = SCENE.format(lattice=f'{keys}\npoints_px = {seen(marks).tolist()}\npoints_m = {(marks / u.m).tolist()}')
    (folder / 'photo.toml').write_text(text.partition('[foundation]')[0] if strengths else text)
    return read_scene(folder / 'photo.toml')


@pytest.mark.parametrize('seed', range(4))
def test_a_photo_of_magnets_of_known_strength_gives_the_frequencies_of_the_lattice(seed, tmp_path):
    """Nothing is left to chance: what differs is the photo, read as that of the feet."""
    rng = np.random.default_rng(seed)
    truth = Truth(rng, missing=1 + seed % 3)
    found = modes(photographed(tmp_path, truth, rng, strengths=True).atoms()).frequencies_Hz
    np.testing.assert_allclose(found, truth.frequencies_Hz, rtol=1e-9)
    twice = modes(photographed(tmp_path, truth, rng, strengths=True, keys='positions = "anchors"').atoms()).frequencies_Hz
    assert abs(twice / truth.frequencies_Hz - 1).max() > 0.03  # the control: moved to rest a second time
    feet = photographed(tmp_path, truth, rng, strengths=True, places='feet', keys='positions = "anchors"')
    np.testing.assert_allclose(modes(feet.atoms()).frequencies_Hz, truth.frequencies_Hz, rtol=1e-7)  # a force of 1e-9 remains


@pytest.mark.parametrize('seed', range(3))
def test_a_noisy_photo_of_magnets_that_differ(seed, tmp_path):
    """Strengths that nobody measured, 2.5 % apart, and a noise of 30 um leave the lowest frequencies within 1 %."""
    rng = np.random.default_rng(seed)
    truth = Truth(rng, missing=1 + seed % 3)
    off = {}
    for positions in ('rest', 'anchors'):
        scene = photographed(tmp_path, truth, np.random.default_rng(seed), noise_mm=0.03, keys=f'positions = "{positions}"')
        off[positions] = np.sqrt(np.mean((modes(scene.atoms()).frequencies_Hz / truth.frequencies_Hz - 1)[:6] ** 2))
    assert off['rest'] < 0.012
    assert off['anchors'] > 2 * off['rest']  # the control


class Row(Truth):
    """A magnet between two held ones so far away that it does not buckle, off their middle by `aside`."""

    spacing = 12.0

    def __init__(self, aside):
        self.rest = self.feet = np.array([[0.0, 0.0], [self.spacing + aside, 0.0], [2 * self.spacing, 0.0]])
        self.held = np.array([True, False, True])


def test_relaxing_what_stands_at_rest_warns(tmp_path):
    """The middle magnet goes back by the share of the bonds in its stiffness."""
    bonds = 2 * A * B * Row.spacing ** (-A - 1)
    farthest = MOVED * Row.spacing * (1 + K / bonds)
    rng = np.random.default_rng(0)
    quiet = photographed(tmp_path, Row(0.9 * farthest), rng, keys='relaxed = true')
    assert quiet.lattice.positions is None
    with pytest.warns(UserWarning, match='for the feet of the pillars and moves the particles by up to 0.0132 mm to rest'):
        photographed(tmp_path, Row(1.1 * farthest), rng, keys='relaxed = true')
    photographed(tmp_path, Row(0.5), rng, keys='positions = "anchors"')  # whoever says so knows


@pytest.mark.parametrize(('columns', 'keys', 'message'), [
    ('x_px,y_px', '', 'the columns x_px,y_px are pixels of a photo; give two different points'),
    ('x_px,y_px', 'points_px = [[0, 0], [9, 9]]', 'give two different points of it'),
    ('x_px,y_px', 'points_px = [[1, 1], [1, 1]]\npoints_m = [[0, 0], [1, 0]]', 'give two different points of it'),
    ('x_px,y_px', 'points_px = [[1, 1]]\npoints_m = [[0, 0]]', 'give two different points of it'),
    ('x_px,y_mm', '', 'has the columns x_px and y_mm; give both in pixels or none'),
    ('x_mm,y_mm', 'points_px = [[0, 0], [9, 9]]', 'belong to a table with the columns x_px,y_px; take them out'),
    ('x_mm,y_mm', 'positions = "feet"', "lattice.positions must be one of 'anchors', 'rest'"),
    ('x_mm,y_mm', 'positions = "rest"\nrelaxed = true', 'positions = "rest" says that they stand at rest; take relaxed out'),
])
def test_refusals(columns, keys, message, tmp_path):
    (tmp_path / 'photo.csv').write_text(f'{columns}\n0,0\n10,0\n')
    (tmp_path / 'photo.toml').write_text(SCENE.format(lattice=keys))
    with pytest.raises(ValueError, match=message):
        read_scene(tmp_path / 'photo.toml')
