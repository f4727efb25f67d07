"""Measurements made up for the tests of charts."""

from workflows import accuracy
from workflows.accuracy import Measurement


def point(seconds, error, method='m', setting='', panel=''):
    return Measurement(panel, method, setting or f'{seconds}', error, seconds, seconds, dict.fromkeys(accuracy.COUNTERS, 0))
