"""The page of packings: its table, its picture, and the numbers that others have printed."""

import re

import pytest

from workflows import packings


@pytest.mark.slow
def test_the_table_has_a_line_for_each_pressure_and_the_picture_is_drawn(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(packings, 'PRESSURES', packings.PRESSURES[:4])
    monkeypatch.setattr(packings, 'SPECTRA', {2: 1.0, 3: 0.5})
    packings.main(['64', '2', '-o', str(tmp_path)])
    told = capsys.readouterr().out
    assert len(re.findall(r'^\| \d\.\de-\d\d \| \S+\(\d+\) \|', told, re.M)) == 4
    assert told.count('printed: 1.23') == 2
    assert len(re.findall('exponents: contacts', told)) == 2
    assert (tmp_path / 'packings.png').exists()


@pytest.mark.parametrize(('values', 'words'), [([1.0, 1.2], '1.1(1)'), ([0.05, 0.051, 0.052], '0.0510(6)'), ([3.14159], '3.14')])
def test_a_mean_has_its_standard_error_in_brackets(values, words):
    assert packings.told(values) == words


@pytest.mark.slow
def test_packings_of_256_discs_have_the_printed_numbers():
    """A tenth of the spread of ten seeds of 1024 discs (1.21 to 1.26) is the least that 256 discs can tell."""
    every = [packings.ladder(256, seed) for seed in range(3)]
    contacts, alone, together = (packings.exponent(packings.each(every, *of)).mean() for of in (
        ('excess',), ('shear', 0), ('shear', 1)))
    assert contacts == pytest.approx(0.5, abs=0.05)
    assert alone > together  # finite size: D* gives way
    told = packings.printed(every, 2)
    assert float(re.search(r'times dim: ([\d.]+)', told)[1]) == pytest.approx(1.23, rel=0.08)
    assert float(re.search(r'jamming at ([\d.]+)', told)[1]) == pytest.approx(0.845, abs=0.01)
    for states in every:
        assert all(state.factor > 1 for state in states)
        assert states[2].shear[0] > 1.2 * states[2].shear[1]  # the control: D0 alone
        assert states[2].weak < 0.02
