"""Fitted values with their 95 % intervals, in words, and the entries that a scene needs for them."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from .. import units as u
from ..design.least_squares import DETERMINED, NORMAL
from ..design.transfer_fits import TransferFit
from ..scenes.scene import Scene

SIGMAS = 'as a guide, noise alone gives 2 sigma in one fit of 20, and 5 sigma in one of two million'
"""How to read a number of standard deviations."""
UNLIKE = 3.0  # the ratio of springs along x and y is reported if it misses the fitted one by these sigmas


def in_a_line(values: Mapping[str, tuple[float, float]], units: Mapping[str, str]) -> str:
    """The determined parameters with their intervals, in one line; `values` hold relative standard uncertainties."""
    spoken = {name: f'{"exponent " * (name == "a")}{name.replace("_", " along ")}' for name in values}
    return ', '.join(f'{spoken[name]} {f"{value:.4g} {units[name]}".rstrip()} ({_ends(value, sigma)})'
                     for name, (value, sigma) in values.items() if sigma <= DETERMINED)


def with_unit(name: str, units: Mapping[str, str]) -> str:
    """The name of a parameter with its unit, as the first cell of its row."""
    return f'{name} ({units[name]})' if units[name] else name


def interval(value: float, sigma: float) -> str:
    """A value with its interval, if it is determined."""
    return f'{value:.4g}, {_ends(value, sigma)}' if sigma <= DETERMINED else 'not determined'  # sigma may be no number


def _ends(value, sigma):
    return f'{value * np.exp(-NORMAL * sigma):.4g} to {value * np.exp(NORMAL * sigma):.4g}'


def unlike_springs(fit: TransferFit) -> str | None:
    """What to change in the scene if its sites show another ratio of the springs along x and y than the fitted one."""
    ratio, sigma = fit.unlike
    stiff, soft = 'xy' if ratio > 0 else 'yx'
    return None if abs(ratio) < UNLIKE * sigma else (
        f'Compared with their stiffness along {soft}, the pillars are stiffer along {stiff} than this fit assumes, by '
        f'{100 * np.expm1(abs(ratio)):.2g} +- {100 * np.exp(abs(ratio)) * sigma:.2g} %. Give [foundation] a stiffness_N_per_m '
        'for x and a stiffness_y_N_per_m, and fit both.')


def entries_of(scene: Scene) -> list[str]:
    """Lines with the law and the springs of a fitted scene, to replace those in its file."""
    law = [f'{key} = {value:.8g}' for key, value in scene.law if isinstance(value, float)]
    law += [f'{key} = {[float(f"{x:.8g}") for x in value]}' for key, value in scene.law if isinstance(value, tuple)]
    law += [f'{key}.{name} = {x:.8g}' for key, value in scene.law if hasattr(value, 'model_fields_set') for name, x in value]
    springs = scene.foundation.changes if scene.foundation else {}
    rows = [f'{name}_N_per_m = {np.max(k) / (u.N / u.m):.8g}' for name, k in springs.items()]
    return ['', 'for a scene file, in place of its [law] and [foundation]:', '',
            '[law]', f'kind = "{scene.law.kind}"', *law, f'shells = {json.dumps(scene.law.asked)}',
            *(['[foundation]', *rows] if rows else [])]
