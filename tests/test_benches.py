"""One hundred strangers walk from their table of forces to bands, bursts and sliders (`benches`).

A command may refuse only what the stranger chose, such as pillars that are too weak; and what a refusal says must help: its mend,
taken from its words and put into the scene, leads on.
"""

import re
import tomllib

import numpy as np
import pytest
from benches import drawn
from structures import few_first

from magphonon.cli import bands, burst
from magphonon.cli.main import main

MENDS = {  # what a refusal says, and the edit of the scene that follows from it
    r'needs a foundation of (\S+) N/m and has': lambda text, k: founded(text, 1.001 * float(k)),
    r'a foundation of (\S+) N/m holds it': lambda text, k: founded(text, float(k)),
    r'make \[patch\] (\S+) times as large': lambda text, factor: re.sub(
        r'(width_m|height_m) = (\S+)', lambda size: f'{size[1]} = {float(factor) * float(size[2])}', text),
}
WEAK = 1.05  # a foundation below this multiple of what the draw needs is the stranger's own: the fitted law differs by as much


def founded(text, k):
    return re.sub(r'(?s)\[foundation.*?(?=\n\[|$)', f'[foundation]\nstiffness_N_per_m = {k:.6g}\n', text)


def walk(seed, folder, capsys, commands):
    """Take one stranger through the commands; returns the refusals, all mended by their own words."""
    bench, scene, refusals = drawn(seed), folder / 'mine.toml', []
    (folder / 'Kräfte.csv').write_bytes(bench.table)
    assert main(['scene', bench.ready]) == 0
    given = bench.scene(capsys.readouterr().out)
    scene.write_text(given, encoding='utf-8')
    assert main(['fit', str(scene), str(folder / 'Kräfte.csv'), '-o', str(scene), '--force']) == 0
    fitted_scene = tomllib.loads(scene.read_text(encoding='utf-8'))
    law = fitted_scene['law']
    assert {key: table for key, table in fitted_scene.items() if key not in ('law', 'uncertainty')} == {
        key: table for key, table in tomllib.loads(given).items() if key != 'law'}
    fitted = np.exp(np.interp(np.log(bench.spacing), *(np.log(law[key]) for key in ('distances_m', 'forces_N'))))
    assert fitted == pytest.approx(bench.force, rel=0.3), 'a unit was misread'
    for command in commands:
        if command == 'burst' and bench.kind == 'chain':
            continue  # it has no patch
        for _ in range(3):
            status = main([command, str(scene), '--force', '-o', str(folder / 'out') + '.html' * (command == 'explore')][
                : None if command != 'check' else 2])
            words = ''.join(capsys.readouterr())
            if status == 0:
                break
            refusals.append(words)
            found = [(mend, match[1]) for said, mend in MENDS.items() if (match := re.search(said, words))]
            assert found, f'bench {seed}, {command}: {words}'
            assert bench.hole or bench.stiffness < WEAK * bench.needed, f'bench {seed}, {command}, not chosen: {words}'
            for mend, value in found:
                scene.write_text(mend(scene.read_text(encoding='utf-8'), value), encoding='utf-8')
        assert status == 0, f'bench {seed}, {command}: its own mends do not help: {words}'
    return refusals


def without_pictures(monkeypatch):
    monkeypatch.setattr(bands, '_draw', lambda *_: None)
    monkeypatch.setattr(burst, '_draw', lambda *_: None)


@pytest.mark.parametrize('seed', few_first([11, 2, 12], 1))
def test_a_stranger_reaches_bands(seed, tmp_path, capsys, monkeypatch):
    """Of a triangular and a square lattice, and of a triangular one with a hole."""
    without_pictures(monkeypatch)
    walk(seed, tmp_path, capsys, ['check', 'bands'])


@pytest.mark.parametrize('piece', [pytest.param(k, marks=getattr(pytest.mark, 'slow' if k in {1, 4, 5, 8} else 'long'))
                                   for k in range(10)])
def test_one_hundred_strangers(piece, tmp_path, capsys, monkeypatch):
    """All check their scene, every second one draws bands, every tenth sends a burst and opens the sliders.

    Fifteen have pillars that are too weak. Where the foundation is just what the refusal asks for (10, 51, 84), the lattice is on
    the verge of buckling, and its softest frequency is the small difference of large terms.
    """
    without_pictures(monkeypatch)
    for seed in range(10 * piece, 10 * piece + 10):
        (own := tmp_path / str(seed)).mkdir()
        walk(seed, own, capsys, ['check', *['bands'] * (seed % 2), *['burst', 'explore'] * (seed % 10 == 0)])
