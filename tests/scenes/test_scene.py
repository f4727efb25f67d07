"""Scenes: what a file turns into, and the scenes that come with the package."""

import math
from importlib.resources import files

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import ready_scene

from magphonon import MagneticRepulsion, units as u
from magphonon.interactions.pair_laws import repulsion
from magphonon.scenes.scene import read_scene, ready_scenes, reference
from magphonon.stiffness.rest import freedom

# A law of each kind, with forces of some tenths of a newton at 10 mm
LAWS = {
    'inverse_power': {'b_N_m_a': 1.6209e-10, 'a': 4.5824},
    'dipoles': {'moment_A_m2': 0.0889},
    'yukawa': {'strength_J_m': 1.5e-5, 'screening_length_m': 0.02},
    'coulomb': {'charge_C': 5e-8},
    'hertz': {'diameter_m': 0.0101, 'youngs_modulus_Pa': 1e6, 'poisson_ratio': 0.3},
    'table': {'distances_m': [0.008, 0.01, 0.012, 0.015], 'forces_N': [0.66, 0.2369, 0.103, 0.037]},
}


# --- what comes with the package -------------------------------------------------------------------------------------


def test_every_ready_scene_reads_and_says_where_its_numbers_come_from():
    assert {'prototype', 'ideal', 'square'} <= set(ready_scenes())
    for file in ready_scenes().values():
        assert read_scene(file).title
        numbers = [line for line in file.read_text().splitlines() if '=' in line and any(c.isdigit() for c in line.split('#')[0])
                   and not line.startswith(('#', 'title'))]
        assert numbers
        assert all('#' in line for line in numbers), f'{file.name} has a number without its source'


def test_reference_is_what_the_formulas_give():
    """The closed forms of the paper; digits as printed in data/reference.toml."""
    tables = reference()
    t, p, o = tables['triangular'], tables['prototype'], tables['oscillator']
    a, f = 4, 1e4
    assert_allclose(t['M_complete'], np.sqrt([(2 * a - 6) * f, (6 * a - 2) * f]), rtol=1e-12)
    assert_allclose(t['M_conventional'], np.sqrt([2 * a * f, 6 * a * f]), rtol=1e-12)
    assert_allclose([t['c_T'], t['c_L']], np.sqrt([3 / 8 * (a - 3) * f, 3 / 8 * (3 * a - 1) * f]), rtol=1e-12)
    assert_allclose(p['f_at_spacing'], p['b'] * p['spacing'] ** -p['a'], rtol=1e-11)
    inertia = math.pi * p['pillar_radius'] ** 4 / 4
    assert_allclose(p['k_eq'], 3 * p['youngs_modulus'] * inertia / p['pillar_height'] ** 3, rtol=1e-10)
    assert_allclose(np.add(o['D_xx'], o['D_yy']), 3 * (a - 1) * f, rtol=1e-12)  # traces: three bonds, (a - 1) f/L0 each
    assert files('magphonon.data').joinpath('reference.toml').read_text().count('arXiv:1911.10410')


# --- what a file turns into ------------------------------------------------------------------------------------------


@pytest.mark.parametrize('kind', LAWS)
def test_every_law(kind, scene_file):
    """Forces in SI by the formula of each law, at 10 and 11 mm."""
    scene = read_scene(scene_file({'law': {'kind': kind, **LAWS[kind], 'shells': 1}}))
    r = np.array([0.010, 0.011])
    expected = {
        'inverse_power': 1.6209e-10 * r**-4.5824,
        'dipoles': 3e-7 * 0.0889**2 * r**-4.0,  # 3 mu0/(4 pi) = 3e-7 N/A^2
        'yukawa': 1.5e-5 * np.exp(-r / 0.02) * (1 / r**2 + 1 / (0.02 * r)),
        'coulomb': 8.9875517862e9 * 5e-8**2 * r**-2,
        'hertz': 1e6 * np.sqrt(0.0101) / (3 * (1 - 0.3**2)) * np.maximum(0.0101 - r, 0) ** 1.5,
        'table': [0.2369, np.nan],
    }[kind]
    known = np.isfinite(expected)
    # mu0 departs from 4e-7 pi by 1.3e-10 in CODATA 2022; the other conversions are exact to round-off
    assert_allclose(repulsion(scene.law.potential(), r * u.m)[known], np.array(expected)[known] * u.N, rtol=1e-9)


@pytest.mark.parametrize(('kind', 'path', 'particles', 'supercell'), [
    ('chain', 'GX', 1, [3]), ('square', 'GXMG', 1, [3, 3]), ('triangular', 'GM,KG', 1, [4, 3]), ('honeycomb', 'GMKG', 2, [3, 3]),
    ('kagome', 'GMKG', 3, [2, 2]), ('fcc', 'GXWKGL', 1, [3, 3, 3]), ('bcc', 'GHNGP', 1, [3, 3, 3])])
def test_every_lattice(kind, path, particles, supercell, scene_file):
    scene = read_scene(scene_file({'lattice.kind': kind, 'bands.path': path, 'bands.supercell': supercell}))
    atoms = scene.atoms()
    assert len(atoms) == particles
    assert_allclose(atoms.get_masses(), 0.707)  # g
    assert_allclose(atoms.calc.bonds.lengths, 10)  # mm
    assert scene.band_path().path == path
    assert scene.supercell() == (*supercell, *[1] * (3 - len(supercell)))


def test_foundation_in_each_form(scene_file):
    stiffness = {'foundation': {'stiffness_N_per_m': 12.5}}
    assert read_scene(scene_file(stiffness)).atoms().calc.parameters.foundation == pytest.approx(12.5e-3, rel=1e-15)  # N/mm
    assert read_scene(scene_file({'foundation': None})).atoms().calc.parameters.foundation == 0


def test_pillars_with_mass(scene_file):
    """Aluminium pillars: 33/140 of 0.802 g moves with each magnet, 27 % of its mass."""
    scene = read_scene(scene_file({'foundation.pillar.density_kg_per_m3': 2700}))
    expected = 0.707 + 33 / 140 * 2700e-6 * math.pi * 0.79375**2 * 150
    assert_allclose(scene.atoms().get_masses(), expected, rtol=1e-12)
    assert_allclose(scene.patch_atoms().get_masses(), expected, rtol=1e-12)
    assert expected / 0.707 == pytest.approx(1.27, abs=0.005)


@pytest.mark.parametrize('shells', [2, 5, 'auto', 'all'])
def test_in_a_patch_of_several_shells_each_free_particle_has_all_its_neighbours(shells, scene_file):
    patch = read_scene(scene_file({'law.shells': shells, 'patch': {'kind': 'hexagon', 'side_m': 0.03}})).patch_atoms()
    free, calc = freedom(patch)[0], patch.calc
    small = read_scene(scene_file({'law.shells': 1, 'patch': {'kind': 'hexagon', 'side_m': 0.03}})).patch_atoms()
    assert free.sum() == freedom(small)[0].sum() == 19  # the same ones move
    reach = calc.bonds.lengths.max()
    i, j = np.mgrid[-16:17, -16:17].reshape(2, -1)
    r = 10 * np.sqrt(i**2 + j**2 + i * j)
    assert (calc.bonds.coordination[free] == np.sum((r > 0) & (r < reach * (1 + 1e-9)))).all()
    assert abs(patch.get_forces(apply_constraint=False)[free]).max() < 1e-12
    bare = small.copy()  # the control: a rim of one row is too thin
    bare.calc = MagneticRepulsion(bare, calc.laws, cutoff=1.001 * reach)
    assert abs(bare.get_forces(apply_constraint=False)[freedom(bare)[0]]).max() > 1e-4


def test_a_scene_does_not_change():
    scene = read_scene(ready_scene('bench'))
    with pytest.raises(ValueError, match='frozen'):
        scene.lattice.spacing_m = 0.02
