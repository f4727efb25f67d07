"""Files of bands: saved, loaded, interrupted, truncated, spoiled."""

import json
import tracemalloc

import numpy as np
import pytest
from cells import cell_of

from magphonon import Bands, analytic_bands

# Files


@pytest.mark.parametrize('vectors', [False, True])
@pytest.mark.parametrize('name', ['chain', 'kagome'])
def test_saved_and_loaded(tmp_path, name, vectors):
    atoms = cell_of(name)
    bands = analytic_bands(atoms, atoms.cell.bandpath(npoints=20, pbc=atoms.pbc), vectors=vectors)
    bands.save(tmp_path / 'bands.npz')
    back = Bands.load(tmp_path / 'bands.npz')
    np.testing.assert_array_equal(back.omega, bands.omega)
    np.testing.assert_array_equal(back.path.kpts, bands.path.kpts)
    np.testing.assert_array_equal(back.path.cell.array, bands.path.cell.array)
    assert back.path.path == bands.path.path
    assert list(back.path.special_points) == list(bands.path.special_points)
    for point, kpt in bands.path.special_points.items():
        np.testing.assert_array_equal(back.path.special_points[point], kpt)
    if vectors:
        np.testing.assert_array_equal(back.vectors, bands.vectors)
    else:
        assert back.vectors is None


def test_interrupted_writing_leaves_what_was_there(tmp_path, monkeypatch):
    atoms = cell_of('triangular')
    path = atoms.cell.bandpath('GM', npoints=5, pbc=atoms.pbc)
    bands = analytic_bands(atoms, path)

    def interrupted(file, **arrays):
        file.write(b'half of it')
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(np, 'savez', interrupted)
        with pytest.raises(KeyboardInterrupt):
            bands.save(tmp_path / 'bands.npz')
    assert not list(tmp_path.iterdir())

    bands.save(tmp_path / 'bands.npz')
    before = (tmp_path / 'bands.npz').read_bytes()
    monkeypatch.setattr(np, 'savez', interrupted)
    with pytest.raises(KeyboardInterrupt):
        bands.save(tmp_path / 'bands.npz')
    assert [file.name for file in tmp_path.iterdir()] == ['bands.npz']
    assert (tmp_path / 'bands.npz').read_bytes() == before


def test_truncated_files_are_refused(tmp_path):
    atoms = cell_of('triangular')
    file = tmp_path / 'bands.npz'
    analytic_bands(atoms, atoms.cell.bandpath('GM', npoints=5, pbc=atoms.pbc)).save(file)
    whole = file.read_bytes()
    for length in (0, 1, len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole[:length])
        with pytest.raises(ValueError, match='no complete file of bands'):
            Bands.load(file)


def _other_unit(arrays):
    told = json.loads(str(arrays['units']))
    told['omega']['unit'] = 'THz'
    return json.dumps(told)


# what of a good file is changed, to what, and what is said of it
SPOILED = {
    'one frequency less': ('omega', lambda a: a['omega'][:-1], 'kpts is for 12 wavevectors, but omega for 11'),
    'one wavevector less': ('kpts', lambda a: a['kpts'][:-1], 'kpts is for 11 wavevectors, but omega for 12'),
    'all NaN': ('omega', lambda a: a['omega'] * np.nan, 'omega holds NaN or infinity'),
    'NaN in the cell': ('cell', lambda a: a['cell'] * np.nan, 'cell holds NaN or infinity'),
    'another unit': ('units', _other_unit, "the unit of omega is 'rad/ms', and not 'THz'"),
    'units that are none': ('units', lambda a: '[]', 'its units are none'),
    'units that are no JSON': ('units', lambda a: '{', 'it cannot be read as one'),
    'units without one': ('units', lambda a: '{}', "the unit of cell is 'mm', and not None"),
    'a short cell': ('cell', lambda a: a['cell'][:2], r'cell has the shape \(2, 3\)'),
    'wavevectors in the plane': ('kpts', lambda a: a['kpts'][:, :2], r'kpts has the shape \(12, 2\)'),
    'fewer points than names': ('points', lambda a: a['points'][1:], 'but points for'),
    'text': ('omega', lambda a: a['omega'].astype(str), 'omega holds no numbers'),
    'one axis more': ('omega', lambda a: a['omega'][None], 'omega has 3 axes'),
    'complex frequencies': ('omega', lambda a: 1j * a['omega'], 'omega has .* the type complex128'),
    'a path elsewhere': ('path', lambda a: 'GZ', 'goes through Z'),
    'modes of another lattice': ('vectors', lambda a: a['vectors'][..., :1], 'vectors has the shape'),
    'no frequencies': ('omega', None, 'it lacks the array omega'),
    'no modes': ('vectors', None, 'it lacks the array vectors'),  # that it says it has
}


@pytest.mark.parametrize(('name', 'spoil', 'words'), SPOILED.values(), ids=SPOILED)
def test_files_whose_arrays_do_not_fit_are_refused(name, spoil, words, tmp_path):
    atoms = cell_of('triangular')
    file = tmp_path / 'bands.npz'
    analytic_bands(atoms, atoms.cell.bandpath('GM', npoints=12, pbc=atoms.pbc), vectors=True).save(file)
    Bands.load(file)  # the control
    with np.load(file) as data:
        arrays = dict(data)
    if spoil is None:
        del arrays[name]
    else:
        arrays[name] = spoil(arrays)
    np.savez(file, **arrays)
    with pytest.raises(ValueError, match=rf'no complete file of bands \(.*{words}.*\); compute them again'):
        Bands.load(file)


def test_a_compressed_file_is_not_unpacked(tmp_path):
    """A file of 60 kB that would fill 64 MB is refused before."""
    atoms = cell_of('triangular')
    file = tmp_path / 'bands.npz'
    analytic_bands(atoms, 'GM').save(file)
    with np.load(file) as data:
        arrays = dict(data)
    Bands.load(file)  # the control
    np.savez_compressed(file, **arrays | {'omega': np.zeros((2**22, 2))})
    assert file.stat().st_size < 1e5
    tracemalloc.start()
    with pytest.raises(ValueError, match='no complete file of bands'):
        Bands.load(file)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**22
