"""band.yaml and phonopy_params.yaml: what other programs read in them."""

import os
import shutil
import subprocess
import sysconfig

import numpy as np
import phonopy
import pytest
import yaml
from ase.dft.kpoints import BandPath
from numpy.testing import assert_allclose
from oracles import Pairs, lattice

from magphonon import InversePower, MagneticRepulsion, finite_displacements, lattices, phonopy_bands, units as u
from magphonon.bands import write_band_yaml, write_phonopy_params


def honeycomb():
    """Two unequal masses with more digits than phonopy writes, on a foundation that keeps the lattice stable."""
    cell = lattices.honeycomb(spacing=10 * u.mm, mass=1 * u.g)
    cell.set_masses([0.70712345678, 0.5000001234])
    cell.calc = MagneticRepulsion(cell, InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824), foundation=100 * u.N / u.m)
    return cell


@pytest.fixture(scope='module')
def cell():
    return honeycomb()


@pytest.fixture(scope='module')
def phonon(cell):
    return finite_displacements(cell)


@pytest.fixture
def path(cell):
    return cell.cell.bandpath('GMKG', npoints=30, pbc=cell.pbc)


def run(directory, program, *arguments):
    """One of phonopy's commands, as a user types it; the directory is full of files that must not matter."""
    for name in ('FORCE_CONSTANTS', 'FORCE_SETS', 'BORN'):
        (directory / name).write_text('9 9\nnonsense\n')
    command = shutil.which(program, path=sysconfig.get_path('scripts'))
    done = subprocess.run([command, *arguments], cwd=directory, env=os.environ | {'MPLBACKEND': 'agg'},
                          capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr


def read_bands(file):
    points = yaml.load(file.read_text(), yaml.CSafeLoader)['phonon']
    return np.array([[band['frequency'] for band in point['band']] for point in points])


# --- phonopy_params.yaml -------------------------------------------------------------------------------------------


def test_phonopy_load_turns_the_file_back_into_the_same_bands(phonon, path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ('FORCE_CONSTANTS', 'FORCE_SETS', 'BORN'):
        (tmp_path / name).write_text('9 9\nnonsense\n')
    write_phonopy_params(phonon, 'phonopy_params.yaml')

    loaded = phonopy.load('phonopy_params.yaml', is_nac=False)  # no BORN of nonsense; nothing else is needed

    # force constants are written with 15 decimals, 1e-14 of the largest here
    expected = phonopy_bands(phonon, path)
    assert_allclose(phonopy_bands(loaded, path).omega, expected.omega, rtol=1e-11)
    assert_allclose(loaded.run_qpoints(path.kpts).frequencies[:, 2:], expected.frequencies_Hz, rtol=1e-11)


def of_any_size(seed):
    """A lattice of spheres of 0.1 um to one of boulders; its squared frequencies at some wavevectors, by complex steps of phi."""
    rng = np.random.default_rng(seed)
    spacing, mass = 10 ** rng.uniform(-7, 4), 10 ** rng.uniform(-21, 6)
    cell = lattice(rng.choice(['square', 'triangular', 'honeycomb', 'kagome']), spacing, mass)
    cell.set_masses(mass * rng.uniform(0.5, 2, len(cell)))
    law = InversePower(b=0.2 * mass * spacing * spacing**4.6, a=4.6)
    cell.calc = MagneticRepulsion(cell, law, foundation=0.5 * mass)
    q = rng.uniform(-0.5, 0.5, (5, 3)) * [1, 1, 0]
    m = np.repeat(cell.get_masses(), 2)
    D = Pairs(cell, law, 1.2 * spacing).bloch(cell.positions, q) + 0.5 * mass * np.eye(len(m))
    return cell, q, np.linalg.eigvalsh(D / np.sqrt(m * m[:, None]))


@pytest.mark.filterwarnings('ignore:a mass of', 'ignore:a force of')  # sizes are drawn over decades
@pytest.mark.parametrize('seed', range(8))
def test_files_keep_the_digits_of_lattices_of_any_size(seed, tmp_path):
    cell, q, squares = of_any_size(seed)
    phonon = finite_displacements(cell)
    write_phonopy_params(phonon, tmp_path / 'params.yaml')
    loaded = phonopy.load(tmp_path / 'params.yaml', is_symmetry=False, symprec=phonon.symmetry.tolerance)
    for one in phonon, loaded:
        omega = phonopy_bands(one, BandPath(cell.cell, q)).omega
        assert_allclose(omega * abs(omega), squares, rtol=0, atol=1e-8 * squares.max())  # finite differences, 1e-9 of a frequency
    assert_allclose(loaded.forces, phonon.forces, rtol=1e-12, atol=0)
    assert_allclose(loaded.displacements, phonon.displacements, rtol=1e-12, atol=0)
    ends = {'G': np.zeros(3), 'X': np.array([0.5, 0, 0])}  # ASE recognises no lattice of less than 1e-6 mm
    write_band_yaml(phonon, BandPath(cell.cell, list(ends.values()), ends, 'GX'), tmp_path / 'band.yaml')
    data = yaml.load((tmp_path / 'band.yaml').read_text(), yaml.CSafeLoader)
    assert_allclose([point['mass'] for point in data['points']], cell.get_masses(), rtol=1e-15)
    assert_allclose(data['lattice'], cell.cell.array, rtol=1e-15)


def test_phonopys_own_save_would_cost_the_masses_their_digits(phonon, path, tmp_path):
    phonon.save(tmp_path / 'saved.yaml', settings={'force_constants': True})
    loaded = phonopy.load(tmp_path / 'saved.yaml', symmetrize_fc=False, is_symmetry=False, is_nac=False)
    assert abs(phonopy_bands(loaded, path).omega / phonopy_bands(phonon, path).omega - 1).max() > 1e-8
    assert loaded.unit_conversion_factor != pytest.approx(1e3 / (2 * np.pi), rel=0.1)  # nor does it keep the unit


COMMAND = '--nosym', '--nonac', '--band', '0 0 0  1/2 0 0  1/3 1/3 0', '--band-points', '3'


@pytest.mark.slow
@pytest.mark.parametrize('flags', [('--no-sym-fc',), ()], ids=['never symmetrised', 'symmetrised'])
def test_the_phonopy_command_finds_the_same_bands_unless_it_symmetrises(flags, cell, phonon, tmp_path):
    write_phonopy_params(phonon, tmp_path / 'phonopy_params.yaml')
    run(tmp_path, 'phonopy', *flags, *COMMAND, 'phonopy_params.yaml')
    kpts = [[0, 0, 0], [1 / 4, 0, 0], [1 / 2, 0, 0], [1 / 2, 0, 0], [5 / 12, 1 / 6, 0], [1 / 3, 1 / 3, 0]]
    expected = phonopy_bands(phonon, BandPath(cell.cell, kpts)).frequencies_Hz
    found = read_bands(tmp_path / 'band.yaml')[:, 2:]
    if flags:
        assert_allclose(found, expected, atol=1e-9)  # Hz; the file has ten decimals
    else:
        assert expected[0, 0] > 40
        assert abs(found[0, :2]).max() < 1e-3  # the gap is gone


# --- band.yaml -----------------------------------------------------------------------------------------------------


def test_band_yaml_holds_the_bands_their_labels_and_units(phonon, path, tmp_path):
    write_band_yaml(phonon, path, tmp_path / 'band.yaml')
    data = yaml.load((tmp_path / 'band.yaml').read_text(), yaml.CSafeLoader)
    assert data['labels'] == [[r'$\Gamma$', 'M'], ['M', 'K'], ['K', r'$\Gamma$']]
    assert (data['frequency_unit'], data['length_unit']) == ('Hz', 'mm')
    assert sum(data['segment_nqpoint']) == data['nqpoint'] == len(path.kpts) + 2  # M and K end one piece and start the next

    qpoints = np.array([point['q-position'] for point in data['phonon']])
    assert_allclose(qpoints, np.insert(path.kpts, joints(path), path.kpts[joints(path)], axis=0), atol=1e-7)
    expected = phonopy_bands(phonon, path).frequencies_Hz
    expected = np.insert(expected, joints(path), expected[joints(path)], axis=0)
    assert_allclose(read_bands(tmp_path / 'band.yaml')[:, 2:], expected, atol=1e-9)


def joints(path):
    """Indices of the inner special points, M and K."""
    return [np.flatnonzero(abs(path.kpts - path.special_points[name]).max(axis=1) < 1e-9)[0] for name in 'MK']


def test_band_yaml_has_what_the_viewer_asks_for(cell, phonon, path, tmp_path):
    # phononwebsite's reader of band.yaml takes these keys, three complex components per particle and mode, and turns
    # them into motion with the phase of the particle, e^{2 pi i q.s}: that is the phase of our cells' modes
    write_band_yaml(phonon, path, tmp_path / 'band.yaml')
    data = yaml.load((tmp_path / 'band.yaml').read_text(), yaml.CSafeLoader)
    assert {'lattice', 'nqpoint', 'npath', 'supercell_matrix', 'points', 'phonon', 'calculator'} <= set(data)
    assert data['supercell_matrix'] == [[2, 0, 0], [0, 2, 0], [0, 0, 1]]
    assert_allclose(data['lattice'], cell.cell.array, atol=1e-12)

    point = data['phonon'][5]  # no degeneracy here
    modes = np.array([band['eigenvector'] for band in point['band']]) @ [1, 1j]
    assert modes.shape == (6, 2, 3)
    assert abs(modes[2:, :, 2]).max() < 1e-9
    positions = np.array([atom['coordinates'] for atom in data['points']])
    motion = modes[2:, :, :2] * np.exp(2j * np.pi * positions @ point['q-position'])[:, None]
    ours = phonopy_bands(phonon, path, vectors=True).vectors[5]
    overlap = abs(np.einsum('mix,nix->mn', ours.conj(), motion))
    # q-positions have seven decimals
    assert_allclose(overlap, np.eye(4), atol=1e-5)
    without_phase = abs(np.einsum('mix,nix->mn', ours.conj(), modes[2:, :, :2]))
    assert abs(without_phase - np.eye(4)).max() > 1e-2


@pytest.mark.slow
def test_phonopy_bandplot_draws_it(phonon, path, tmp_path):
    write_band_yaml(phonon, path, tmp_path / 'band.yaml')
    run(tmp_path, 'phonopy-bandplot', '--ylabel', 'Frequency (Hz)', '-o', 'bands.png', 'band.yaml')
    assert (tmp_path / 'bands.png').read_bytes().startswith(b'\x89PNG')


def test_a_path_with_a_jump_is_written_in_pieces(cell, phonon, tmp_path):
    jump = cell.cell.bandpath('GM,KG', npoints=12, pbc=cell.pbc)
    write_band_yaml(phonon, jump, tmp_path / 'band.yaml')
    data = yaml.load((tmp_path / 'band.yaml').read_text(), yaml.CSafeLoader)
    assert data['labels'] == [[r'$\Gamma$', 'M'], ['K', r'$\Gamma$']]
    assert data['nqpoint'] == len(jump.kpts)


# --- refusals and whole files ----------------------------------------------------------------------------------------


def test_paths_without_names_are_refused(cell, phonon, tmp_path):
    with pytest.raises(ValueError, match='names no special points'):
        write_band_yaml(phonon, BandPath(cell.cell, [[0, 0, 0], [0.1, 0, 0]]), tmp_path / 'band.yaml')
    points = cell.cell.bandpath('GMK', npoints=0, pbc=cell.pbc).special_points
    with pytest.raises(ValueError, match="path 'GMK' does not run from M to K"):
        write_band_yaml(phonon, BandPath(cell.cell, [points['G'], points['M']], points, 'GMK'), tmp_path / 'band.yaml')
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize('number', [np.nan, np.inf])
def test_numbers_that_are_none_are_not_written(number, cell, path, tmp_path):
    phonon = finite_displacements(cell)
    constants = phonon.force_constants.copy()
    constants[0, 1, 0, 0] = number
    phonon.force_constants = constants
    for write in (lambda file: write_band_yaml(phonon, path, file), lambda file: write_phonopy_params(phonon, file)):
        with pytest.raises(FloatingPointError, match=f'force constants would be {number} in 1 of .* entries of x.yaml'):
            write(tmp_path / 'x.yaml')
    assert not list(tmp_path.iterdir())
