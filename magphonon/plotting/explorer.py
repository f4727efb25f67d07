"""The explorer: one page of HTML in which sliders move the bands of both models, and a click on a branch moves the lattice.

The page computes bands and modes itself, from the bonds of one cell, by the Bloch matrix (Eq. 18).  Its text, style and scripts
are the files in `explorer_page`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from ase import Atoms
from ase.dft.kpoints import BandPath
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from .. import __version__, units
from ..interactions.pair_laws import InversePower
from ..stiffness.rest import freedom
from ..traits import Tool, refuse
from .zone import upwards

FORCES = 10.0
"""The slider of the spacing goes from ten times the force between nearest neighbours to a tenth, as far as the law is known."""
EXPONENTS = (1.0, 12.0)  # least range of the slider of the exponent
FOUNDATIONS = 8.0
"""The slider of the foundation goes up to this multiple of f/L, of which a kagome lattice needs 6, or of the present stiffness if
that is more."""
VALUES = 100  # a slider has this number of values or more, about up to twice as many
POINTS = 201  # wavevectors along the path
ROUNDED = 1e-9  # relative room for round-off of lengths at the ends of a law
SCRIPTS = 'bloch', 'border', 'chart', 'motion', 'burst', 'burst_view', 'share', 'page'
TAKEN = Tool('the page of a structure', __name__, frozenset({'constraints'}))
UNITS = {'m': 1.0, 'mm': 1e3, 'µm': 1e6, 'nm': 1e9}  # units of the spacing, by how many of them are a metre


@dataclass(frozen=True)
class Slider:
    """The values of a slider, ascending, and the index of the scene's own value among them."""

    values: NDArray[np.float64]
    scene: int


@dataclass(frozen=True)
class Explorer:
    """A lattice whose spacing, exponent and foundation a page changes.

    Attributes
    ----------
    atoms : ase.Atoms
        One cell of a planar lattice or a chain, in balance by its symmetry, with its PairCalculator.
    path : ase.dft.kpoints.BandPath
        The wavevectors of the bands, about `POINTS` of them.
    """

    atoms: Atoms
    path: BandPath

    def __post_init__(self) -> None:
        if np.ndim(self.atoms.calc.foundation):
            raise ValueError('the foundation differs from particle to particle or has a part along z, but the page has a single '
                             'slider for the foundation; give one number')
        if not self._force(1.0) > 0:
            raise ValueError(f'at the spacing of {self.spacing:g} mm no force acts between nearest neighbours, so that there is '
                             'nothing to explore; change the spacing')

    @cached_property
    def spacing(self) -> float:
        """The shortest bond in mm."""
        return float(self.atoms.calc.bonds.lengths.min())

    def _force(self, scale: float) -> float:
        """Repulsion of nearest neighbours in N, or tension if they pull, if all bonds are `scale` times as long; NaN if a bond
        leaves the range of its law.
        """
        law, r = self.atoms.calc.law, self.atoms.calc.bonds.lengths
        try:
            here, there = -np.asarray(law.dphi(r)), -np.asarray(law.dphi(scale * r))
        except ValueError:
            return np.nan
        nearest = np.flatnonzero(r < (1 + 1e-6) * self.spacing)
        strongest = nearest[abs(here[nearest]).argmax()]
        return float(np.sign(here[strongest]) * there[strongest])

    @cached_property
    def unit(self) -> str:
        """The unit in which the spacing is printed as 1 to 1000, or metres if there is none."""
        return next((name for name, per_m in UNITS.items() if self.spacing / units.m * per_m >= 1), 'nm')

    @cached_property
    def spacings(self) -> Slider:
        """Slider of the spacings in m."""
        here, per_m = self.spacing / units.m, UNITS[self.unit]
        force = self._force(1.0)
        ends = [_last(lambda scale: force / FORCES <= self._force(scale) <= force * FORCES, end) for end in (1 / FORCES, FORCES)]
        slider = _slider(ends[0] * here * per_m, here * per_m, ends[1] * here * per_m)
        values = slider.values / per_m
        near = values / here * np.array([[1 - ROUNDED], [1 + ROUNDED]])  # a table ends at its last point, not a rounding beyond
        below, above = np.isfinite(np.array([[self._force(scale) for scale in row] for row in near]))
        known = below & above
        return Slider(values[known], int(known[: slider.scene].sum()))

    @cached_property
    def scales(self) -> NDArray[np.float64]:
        """The spacings as multiples of the present one."""
        return self.spacings.values / self.spacings.values[self.spacings.scene]

    @cached_property
    def exponents(self) -> Slider | None:
        """Slider of the exponents of the force; None if the law is no inverse power."""
        law: Any = self.atoms.calc.law
        if not isinstance(law, InversePower):
            return None
        return _slider(min(EXPONENTS[0], law.a / 2), law.a, max(EXPONENTS[1], 2 * law.a))

    @cached_property
    def foundations(self) -> Slider:
        """Slider of the stiffness of the foundation in N/m."""
        here = float(self.atoms.calc.foundation) / units.N * units.m
        static = self._force(1.0) / units.N / (self.spacing / units.m)
        return _slider(0.0, here, FOUNDATIONS * max(here, static))

    def page(self, title: str, scene: str, template: str, border: tuple[Any, Any], beside: str = '') -> str:
        """The text of the page, HTML that refers to nothing outside itself.

        `scene` is the text shown at the end, and `template` the text of a scene with gaps for the values of the sliders. `border`
        is the foundation that the lattice needs, at each of the `exponents` if there are any, otherwise of the `scales`. `beside`
        says what the page omits.
        """
        data = self.data(*border)
        return _page(data | {'template': template}, title, scene, data['border']['over'], f' {beside}' if beside else '')

    def data(self, at: NDArray[np.float64], needed: NDArray[np.float64]) -> dict[str, Any]:
        """The data that the scripts of the page read, in SI; lengths within the cell are multiples of the spacing."""
        atoms, here = self.atoms, self.spacing
        sliders = {'spacing': (self.spacings, self.unit, UNITS[self.unit]), 'exponent': (self.exponents, '', 1.0),
                   'foundation': (self.foundations, 'N/m', 1.0)}
        return {
            'spacing_m': here / units.m,
            'periods': int(np.sum(atoms.pbc)),
            'cell': (atoms.cell.array[:2, :2] / here).tolist(),
            'reciprocal': (self.path.cell.reciprocal().array[:2, :2] * here).tolist(),
            'positions': (atoms.positions[:, :2] / here).tolist(),
            'masses_kg': (atoms.get_masses() / units.kg).tolist(),
            'bonds': self._bonds(),
            'law': self._law(),
            'path': self._path(),
            'sliders': {name: {'values': slider.values.tolist(), 'scene': slider.scene, 'unit': unit, 'per_SI': per_SI}
                        for name, (slider, unit, per_SI) in sliders.items() if slider is not None},
            'border': {'over': 'spacing' if self.exponents is None else 'exponent', 'at': at.tolist(),
                       'needed_N_per_m': (needed / units.N * units.m).tolist()},
        }

    def _bonds(self) -> list[dict[str, Any]]:
        bonds, r = self.atoms.calc.bonds, self.atoms.calc.bonds.lengths
        columns = (bonds.i, bonds.j, bonds.shift[:, :2], bonds.vectors[:, :2] / r[:, None], r / self.spacing)
        names = ('i', 'j', 'shift', 'direction', 'length')
        return [dict(zip(names, row, strict=True)) for row in zip(*(column.tolist() for column in columns), strict=True)]

    def _law(self) -> dict[str, Any]:
        """Numbers of the inverse power; for other laws phi'' and phi'/r of each bond in N/m, at each spacing of the slider."""
        law, r = self.atoms.calc.law, self.atoms.calc.bonds.lengths
        if self.exponents is not None:
            return {'kind': 'power', 'force_N': self._force(1.0) / units.N, 'spacing_m': self.spacing / units.m}
        stiffness = [np.column_stack([law.d2phi(scale * r), law.dphi(scale * r) / (scale * r)]) for scale in self.scales]
        return {'kind': 'table', 'stiffness_N_per_m': (np.array(stiffness) / units.N * units.m).tolist()}

    def _path(self) -> dict[str, Any]:
        sign = upwards(self.path.special_points, self.path.cell)
        kpts, special = sign * self.path.kpts, {name: sign * q for name, q in self.path.special_points.items()}
        x, ticks, names = self.path.get_linear_kpoint_axis()
        named = {k: name for name in names for k in np.flatnonzero(abs(kpts - special[name]).max(axis=1) < 1e-9).tolist()}
        joined: dict[int, list[str]] = {}
        for tick, name in zip(ticks, names, strict=True):
            k = int(abs(x - tick).argmin())
            joined.setdefault(k, []).append(_name(name))
        first = next(name for name in names if name != 'G')
        jumps = np.flatnonzero((np.diff(x) == 0) & np.diff(kpts, axis=0).any(axis=1)) + 1
        return {'q': kpts[:, :2].tolist(), 'axis': (x / x[-1]).tolist(), 'jumps': jumps.tolist(),
                'ticks': [{'at': k, 'name': ','.join(dict.fromkeys(both))} for k, both in joined.items()],
                'named': {k: _name(name) for k, name in named.items()},
                'point': {'name': _name(first), 'at': min(k for k in named if named[k] == first)}}


def structure_page(atoms: Atoms, drive: dict[str, Any], title: str, scene: str) -> str:
    """The page of a finite planar structure on anchored springs, which shows a tone that runs through it in both models.

    If magnets are taken out, the others move to a new rest; for this the page needs a single law, an inverse power.
    `drive` holds, in SI, the place of the force, its tone and the damping.
    """
    refuse(atoms, TAKEN)
    calc = atoms.calc
    if calc.dim != 2 or (calc.law.dphi(calc.bonds.lengths) > 0).any():
        raise ValueError('the page takes particles that repel each other in a plane; "magphonon frf" takes every structure')
    law, here = calc.laws, float(calc.bonds.lengths.min())
    if not isinstance(law, InversePower):
        raise ValueError(f'the page takes one inverse-power law, not {law!r}; "magphonon frf" takes every law')
    if np.any(calc.load):
        raise ValueError('the page starts particles at the anchors of their springs and lets them relax, but this '
                         'structure gives the positions at rest; give positions = "anchors"')
    state = {'spacing': here / units.m, 'exponent': law.a, 'foundation': 0.0}
    alone = {name: {'values': [value], 'scene': 0, 'unit': '', 'per_SI': 1.0} for name, value in state.items()}
    data = {'spacing_m': here / units.m, 'periods': 0, 'cell': [], 'positions': [], 'masses_kg': [], 'bonds': [], 'template': '',
            'path': {'q': [], 'point': {'at': 0}}, 'sliders': alone,
            'law': {'kind': 'power', 'force_N': float(-law.dphi(here)) / units.N, 'spacing_m': here / units.m},
            'structure': _structure(atoms, here) | {'drive': drive}}
    return _page(data, title, scene, '', '')


def _structure(atoms, here):
    calc, bonds = atoms.calc, atoms.calc.bonds
    feet, springs, apart = calc.anchors[:, :2], np.broadcast_to(calc.foundation, (len(atoms), 2)), pdist(calc.anchors)
    reach = float(np.linalg.norm(feet[bonds.j] - feet[bonds.i], axis=1).max()) * (1 + ROUNDED)
    if (apart < reach).sum() != len(bonds.i) or np.any(springs[:, 0] != springs[:, 1]):
        raise ValueError('the page needs bonds between all pairs within one cutoff, and supports as stiff along x as along y; '
                         '"magphonon frf" takes every structure')
    x, y = ((feet - (feet.max(axis=0) + feet.min(axis=0)) / 2) / here).T.tolist()
    return {'x': x, 'y': y, 'mass_kg': (atoms.get_masses() / units.kg).tolist(), 'strength': calc.strengths.tolist(),
            'springs_N_per_m': (springs[:, 0] / units.N * units.m).tolist(), 'held': (~freedom(atoms)[0]).astype(int).tolist(),
            'reach': reach / here}


def _page(data: dict[str, Any], title: str, scene: str, over: str, beside: str) -> str:
    folder = files('magphonon.plotting') / 'explorer_page'
    parts = {'page.css': (folder / 'page.css').read_text(encoding='utf-8').strip('\n'),
             'scripts': '\n'.join((folder / f'{name}.js').read_text(encoding='utf-8') for name in SCRIPTS)}
    told = {'title': title, 'scene': scene, 'over': over, 'beside': beside, 'version': __version__}
    parts |= {name: escape(text) for name, text in told.items()}
    parts['data'] = json.dumps(data, ensure_ascii=False, allow_nan=False).replace('<', '\\u003c')
    pieces = (folder / 'page.html').read_text(encoding='utf-8').split('{{')
    return pieces[0] + ''.join(parts[name] + rest for name, _, rest in (piece.partition('}}') for piece in pieces[1:]))


def _name(point: str) -> str:
    return point.replace('G', 'Γ').translate(str.maketrans('0123456789', '₀₁₂₃₄₅₆₇₈₉'))


def _last(holds: Any, end: float) -> float:
    if holds(end):
        return end
    inside, outside = 0.0, np.log(end)
    for _ in range(50):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if holds(np.exp(middle)) else (inside, middle)
    return float(np.exp(inside))


def _slider(low: float, here: float, high: float) -> Slider:
    step = 10.0 ** np.floor(np.log10((high - low) / VALUES))
    step *= next(digit for digit in (5, 2, 1) if digit * step * VALUES <= high - low)
    decimals = max(0, 1 - int(np.floor(np.log10(step))))
    values = np.round(np.arange(np.ceil(low / step - 1e-9), high / step + 1e-9) * step, decimals)
    values = values[abs(values - here) > 1e-6 * step]
    scene = int(np.searchsorted(values, here))
    return Slider(np.insert(values, scene, here), scene)
