"""Files of bands whose writing is interrupted; test_saved.py has what holds for files of all results."""

import errno

import numpy as np
import pytest
from cells import cell_of

from magphonon import analytic_bands
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


@pytest.mark.parametrize(('number', 'words'), [(errno.ENOSPC, 'make room'), (errno.EACCES, 'as it was')])
def test_a_full_disk_and_nothing_else_is_told_in_our_words(number, words):
    with pytest.raises(OSError, match=words), room_for('bands.npz'):
        raise OSError(number, 'as it was')
