"""Files of bands: interrupted and spoiled; test_saved.py has what holds for files of all results."""

import errno
import json

import numpy as np
import pytest
from cells import cell_of

from magphonon import analytic_bands
from magphonon.bands import Bands
from magphonon.files import room_for


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


def _other_unit(arrays):
    told = json.loads(str(arrays['units']))
    told['omega']['unit'] = 'THz'
    return json.dumps(told)


# what of a good file is changed, to what, and what is said of it
SPOILED = {
    'NaN in the cell': ('cell', lambda a: a['cell'] * np.nan, 'cell holds NaN or infinity'),
    'another unit': ('units', _other_unit, "the unit of omega is 'rad/ms', and not 'THz'"),
    'units that are none': ('units', lambda a: '[]', 'its units are missing'),
    'units that are no JSON': ('units', lambda a: '{', 'it cannot be read'),
    'units without one': ('units', lambda a: '{}', "the unit of cell is 'mm', and not None"),
    'a short cell': ('cell', lambda a: a['cell'][:2], r'cell has the shape \(2, 3\)'),
    'wavevectors in the plane': ('kpts', lambda a: a['kpts'][:, :2], r'kpts has the shape \(12, 2\)'),
    'text': ('omega', lambda a: a['omega'].astype(str), 'omega holds no numbers'),
    'one axis more': ('omega', lambda a: a['omega'][None], 'omega has 3 axes'),
    'complex frequencies': ('omega', lambda a: 1j * a['omega'], 'omega has .* the type complex128'),
    'a path elsewhere': ('path', lambda a: 'GZ', 'goes through Z'),
    'modes of another lattice': ('vectors', lambda a: a['vectors'][..., :1], 'vectors has the shape'),
}


@pytest.mark.parametrize(('name', 'spoil', 'words'), SPOILED.values(), ids=SPOILED)
def test_files_whose_arrays_do_not_fit_are_refused(name, spoil, words, tmp_path):
    atoms = cell_of('triangular')
    file = tmp_path / 'bands.npz'
    analytic_bands(atoms, atoms.cell.bandpath('GM', npoints=12, pbc=atoms.pbc), vectors=True).save(file)
    Bands.load(file)  # the control
    with np.load(file) as data:
        arrays = dict(data)
    arrays[name] = spoil(arrays)
    np.savez(file, **arrays)
    with pytest.raises(ValueError, match=rf'not a complete file of bands \(.*{words}.*\); compute them again'):
        Bands.load(file)


@pytest.mark.parametrize(('number', 'words'), [(errno.ENOSPC, 'make room'), (errno.EACCES, 'as it was')])
def test_a_full_disk_and_nothing_else_is_told_in_our_words(number, words):
    with pytest.raises(OSError, match=words), room_for('bands.npz'):
        raise OSError(number, 'as it was')
