"""Fitted values with their 95 % intervals, in words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..design.least_squares import DETERMINED, NORMAL
from ..findings import spoken


def in_a_line(values: Mapping[str, tuple[float, float]], units: Mapping[str, str]) -> str:
    """Parameters that are determined, each with its interval; `values` hold relative standard uncertainties."""
    return ', '.join(f'{spoken(name).removeprefix("the ")} {f"{value:.4g} {units[name]}".rstrip()} ({_ends(value, sigma)})'
                     for name, (value, sigma) in values.items() if sigma <= DETERMINED)


def with_unit(name: str, units: Mapping[str, str]) -> str:
    """A parameter as the head of its row."""
    return f'{name} ({units[name]})' if units[name] else name


def interval(value: float, sigma: float) -> str:
    """A value with its interval, if it is determined."""
    return f'{value:.4g}, {_ends(value, sigma)}' if sigma <= DETERMINED else 'not determined'  # sigma may be no number


def _ends(value, sigma):
    return f'{value * np.exp(-NORMAL * sigma):.4g} to {value * np.exp(NORMAL * sigma):.4g}'
