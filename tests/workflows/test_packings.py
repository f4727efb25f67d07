"""The page of packings: its table, its picture, and the numbers that others have printed."""

import re

import pytest

from workflows import packings


@pytest.mark.slow
def test_the_table_has_a_line_for_each_pressure_and_the_picture_is_drawn(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(packings, 'PRESSURES', packings.PRESSURES[:4])
    monkeypatch.setattr(packings, 'SHOWN', {2: 1.0})
    monkeypatch.setattr(packings, 'exponent', lambda values: 0.5)
    packings.main(['32', '1', '-o', str(tmp_path)])
    told = capsys.readouterr().out
    assert len(re.findall(r'^ \d\.\de-\d\d .* D\*$', told, re.M)) == 4
    assert 'printed: 1.23' in told
    assert (tmp_path / 'packings.png').exists()


@pytest.mark.slow
def test_packings_of_256_discs_have_the_printed_numbers():
    """A tenth of the spread of ten seeds of 1024 discs (1.21 to 1.26) is the least that 256 discs can tell."""
    every = [packings.ladder(256, seed) for seed in range(3)]
    told = '\n'.join(packings.table(every))
    contacts, alone, together = map(float, re.search(r'contacts (\S+), G of D0 (\S+), G of D0 \+ D\* (\S+) ', told).groups())
    assert contacts == pytest.approx(0.5, abs=0.05)
    assert alone > together  # finite size: D* gives way
    assert float(re.search(r'times dim: (\S+)', told)[1]) == pytest.approx(packings.PRINTED, rel=0.08)
    assert float(re.search(r'at jamming: (\S+)', told)[1]) == pytest.approx(0.845, abs=0.01)
    for states in every:
        assert all(state.factor > 1 for state in states)
        assert states[2].shear['conventional'] > 1.2 * states[2].shear['complete']  # the control: D0 alone
        assert states[2].weak < 0.02
