"""law.force_N: the force between neighbours tells b, and holds while the exponent or the spacing of the scene changes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from magphonon import read_scene, units as u
from magphonon.interactions.pair_laws import repulsion
from magphonon.scenes import fit_bands, ready_scene
from magphonon.scenes.band_fits import varied
from magphonon.scenes.scene import scene_of

F = 1.6209e-10 * 0.01**-4.5824


def tables_of(scene):
    return scene.model_dump(mode='json', exclude_none=True)


def with_force(name='prototype', **changes):
    tables = tables_of(read_scene(ready_scene(name)))
    del tables['law']['b_N_m_a']
    tables['law'] |= {'force_N': F}
    for key, value in changes.items():
        table, _, key = key.partition('__')
        tables[table][key] = value
    return scene_of(tables)


@pytest.mark.parametrize('seed', range(4))
def test_the_force_at_the_spacing(seed):
    draw = np.random.default_rng(seed)
    a, L, f = draw.uniform(1.5, 8), draw.uniform(0.002, 0.05), draw.uniform(0.01, 1)
    scene = with_force(law__a=a, lattice__spacing_m=L, law__force_N=f)
    assert_allclose(repulsion(scene.law.potential(), L * u.m) / u.N, f, rtol=1e-12)
    assert_allclose(repulsion(scene.law.potential(), 2 * L * u.m) / u.N, f * 2**-a, rtol=1e-12)
    again = scene_of(tables_of(scene))
    assert again == scene
    lattice = scene.lattice.model_copy(update={'spacing_m': 1.1 * L})
    moved = scene.model_copy(update={'lattice': lattice})  # the same magnets, further apart
    assert_allclose(repulsion(moved.law.potential(), 1.1 * L * u.m) / u.N, f * 1.1**-a, rtol=1e-12)
    steeper = varied(scene, {'a': 1.2})
    assert_allclose(repulsion(steeper.law.potential(), L * u.m) / u.N, f, rtol=1e-12)


def test_it_is_the_same_scene_as_by_b():
    cells = with_force().perfect_cell(), read_scene('prototype').perfect_cell()
    a, b = (cell.calc.get_hessian(cell).toarray() for cell in cells)
    assert_allclose(a, b, rtol=1e-12, atol=1e-12 * abs(b).max())


@pytest.mark.parametrize(('law', 'words'), [({'b_N_m_a': 1.0, 'force_N': 1.0}, 'has both of b_N_m_a and force_N'),
                                            ({}, 'has neither of b_N_m_a and force_N')])
def test_one_of_both(law, words):
    tables = tables_of(read_scene('prototype'))
    with pytest.raises(ValueError, match=words):
        scene_of(tables | {'law': {'kind': 'inverse_power', 'a': 4.0, 'shells': 1} | law})


def test_tolerances_of_the_force_and_of_the_exponent_at_this_force():
    from magphonon.bands.bloch import bloch_modes
    from magphonon.design.sensitivities import frequency_sensitivities

    scene, q = with_force(), [[0.0, 0.5, 0.0]]
    tables = tables_of(scene)
    scene = scene_of(tables | {'uncertainty': {'force_percent': 1.0, 'exponent': 0.05}})
    changes = scene.uncertainty.tolerances(scene).changes
    assert list(changes) == ['force', 'exponent']
    _, slopes = frequency_sensitivities(scene.perfect_cell(), q, list(changes.values()))
    h = 1e-5
    for slope, name, per in zip(slopes, ('force', 'a'), (1.0, scene.law.a), strict=True):
        up, down = (bloch_modes(varied(scene, {name: np.exp(s * h)}).perfect_cell(), np.array(q))[0] for s in (1, -1))
        assert_allclose(slope, (up - down) / (2 * h * per), rtol=1e-6)


@pytest.mark.slow
def test_fits_know_it():
    from magphonon.bands.bloch import bloch_modes
    from magphonon.scenes.band_fits import NEAREST
    from magphonon.waves.ridge_tables import RidgePoints

    scene = with_force()
    xi = np.tile(np.linspace(0.6, 2.8, 12), 2)
    q, ridge, one = np.outer(xi / (2 * np.pi), [0, 1, 0]), np.repeat([0, 1], 12), np.ones(24)
    omega = bloch_modes(scene.perfect_cell(), q)[0][range(24), ridge]
    points = RidgePoints(('1', '2'), ('transverse', 'longitudinal'), ridge, q, xi, 0 * xi, omega, 1e-3 * omega, one, 0 * xi)
    fits = fit_bands(with_force(law__force_N=1.2 * F, law__a=4.0), points)
    for (name, (value, relative)), truth in zip(fits.values().items(), (F, 4.5824), strict=False):
        assert abs(value / truth - 1) < 1.96 * relative, name
    alone = fits.values(part=NEAREST)
    assert_allclose([alone[name][0] for name in ('force', 'a')], [F, 4.5824], rtol=1e-3)  # the prior of the exponent pulls
