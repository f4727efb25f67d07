"""Work that passes two seconds shows a bar on a terminal, and an interrupt in the middle of it loses nothing."""

import sys
from io import StringIO

import pytest
from scene_files import ready_scene
from tqdm import tqdm

from magphonon.bands import bloch, force_constants
from magphonon.cli.main import main
from magphonon.response import chebyshev, frf

PLACES = (bloch, force_constants, chebyshev, frf)
"""Modules with a bar of their own."""
SMALL = {'side_m = 0.3 ': 'side_m = 0.14 ', 'points = 251 ': 'points = 60 ', 'points = 300': 'points = 40', 'at_m = [0.0, 0.1]':
         'at_m = [0.0, 0.05]', 'carriers_Hz = [30, 40, 50, 60]': 'carriers_Hz = [60]', 'duration_s = 0.5': 'duration_s = 0.13',
         'directions_deg = [90, 90, 90, 90]': 'directions_deg = [90]'}


class Terminal(StringIO):
    def isatty(self):
        return True


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """With scenes in it; time does not matter: every bar shows at once, a small zone is computed in parts as a large one is."""
    text = ready_scene('bench').read_text()
    for old, new in SMALL.items():
        text = text.replace(old, new)
    (tmp_path / 'prototype.toml').write_text(text)
    monkeypatch.setattr(bloch, 'BATCH_BYTES', 2**10)
    return tmp_path


def bars(monkeypatch, bar=tqdm):
    """Give every place a bar that does not wait for two seconds, and return what it was asked for."""
    asked = []

    def at_once(*arguments, delay, **options):
        asked.append((delay, options['disable']))
        return bar(*arguments, **options)

    for place in PLACES:
        monkeypatch.setattr(place, 'tqdm', at_once)
    monkeypatch.setattr('tqdm.tqdm', at_once)
    return asked


CASES = [('bands', ['wavevectors', 'displacements']), ('frf', ['products'])]


@pytest.mark.slow
@pytest.mark.parametrize(('command', 'names'), CASES)
def test_bars(command, names, folder, monkeypatch):
    """On a terminal each kind of long work has its bar; elsewhere there is none."""
    asked = bars(monkeypatch)
    arguments = [command, str(folder / 'prototype.toml'), '-o', str(folder / 'out'), '--force']
    for stream, shown in ((Terminal(), True), (StringIO(), False)):
        monkeypatch.setattr(sys, 'stderr', stream)
        assert main(arguments) == 0
        assert [name in stream.getvalue() for name in names] == [shown for _ in names]
        assert shown or stream.getvalue() == ''
    assert {delay for delay, _ in asked} == {2}
    assert {disable for _, disable in asked} <= {None, True}
