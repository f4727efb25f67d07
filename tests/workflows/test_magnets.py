"""The accuracy chart of magnets, with and without magpylib; its checks see a wrong force."""

import sys

import pytest

from magphonon import units as u
from magphonon.interactions.magnets import Ring
from workflows import magnet_cost

RING = Ring(6.35, 1.5875, 3.175, 1.3 * u.T)


def test_without_magpylib_the_chart_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, 'magpylib', None)
    chart = magnet_cost.chart(RING)
    assert chart.reading.endswith("magpylib skipped: pip install 'magphonon[magnets]'")
    assert {m.method for m in chart.measurements} == {magnet_cost.RIMS, magnet_cost.SERIES}
    assert all(check.passed for check in chart.checks)


@pytest.mark.slow
@pytest.mark.peer
def test_with_magpylib_the_chart_compares_and_sees_a_wrong_force(monkeypatch):
    pytest.importorskip('magpylib', minversion='5.2')
    assert all(check.passed for check in magnet_cost.chart(RING).checks)
    right = magnet_cost.pair_force
    monkeypatch.setattr(magnet_cost, 'pair_force', lambda *args, **n: right(*args, **n) * (1 + 1e-6))
    failed = [check.quantity for check in magnet_cost.chart(RING).checks if not check.passed]
    assert any(magnet_cost.FIELD in quantity for quantity in failed)
