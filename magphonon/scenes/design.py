"""The table [design] of a scene: the wanted frequencies, in SI, and the tables of a lattice that has them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from .. import units as u
from ..design.inverse import BandEdge, Design, Gap, NoDesign, foundation_for, spacings_for
from ..stability.buckling import foundation_needed
from .fields import Count, Frequency, Spacing, Table, Text, listed
from .lattices import ALL
from .tolerances import varied

if TYPE_CHECKING:
    from .scene import Scene

HERTZ = 2 * np.pi * u.Hz
"""One hertz in rad/ms."""


class EdgePlan(Table):
    """Edge of a band: the frequency of a branch at a special point."""

    point: Text = Field(description="the special point, such as 'M'")
    branch: Count = Field(description='the branch, counted from 1 by frequency')
    frequency_Hz: Frequency = Field(description='the wanted frequency in Hz')

    key: ClassVar = 'design.edge.frequency_Hz'
    name = property(lambda self: f'branch {self.branch} at {self.point}')
    wanted = property(lambda self: self.frequency_Hz * HERTZ)

    def target(self, scene: Scene) -> BandEdge | Gap:
        points = scene.special_points
        if self.point not in points:
            raise ValueError(f'design.edge.point of the {scene.lattice.kind} lattice must be one of {", ".join(points)}, '
                             f'not {self.point!r}')
        _check_branch('edge.branch', self.branch, scene, 0)
        return BandEdge(points[self.point], self.branch - 1)


class GapPlan(Table):
    """Gap between a branch and the next one, over the whole zone."""

    above_branch: Count = Field(description='the branch below the gap, counted from 1 by frequency', examples=[1])
    width_Hz: Frequency = Field(description='the wanted width in Hz', examples=[10.0])

    key: ClassVar = 'design.gap.width_Hz'
    name = property(lambda self: f'gap above branch {self.above_branch}')
    wanted = property(lambda self: self.width_Hz * HERTZ)

    def target(self, scene: Scene) -> BandEdge | Gap:
        _check_branch('gap.above_branch', self.above_branch, scene, 1)
        return Gap(self.above_branch - 1)


def _check_branch(key, branch, scene, above):
    branches = len(scene.lattice.cell()) * scene.atoms().calc.dim
    if branch > branches - above:
        raise ValueError(f'design.{key} must be at most {branches - above}, as the {scene.lattice.kind} lattice has {branches} '
                         f'branches, not {branch}')


def _range(value):
    if len(value) != 2 or not value[0] < value[1]:
        raise ValueError(f' must be a range [least, largest], not {list(value)!r}')
    return value


class DesignPlan(Table):
    """The wanted frequencies; everything else stays as it is in the scene.

    The foundation follows from the cut-off, the spacing from an edge or a gap.
    """

    cut_off_Hz: Frequency | None = Field(None, description='the wanted lowest frequency at Gamma in Hz; the foundation follows')
    edge: EdgePlan | None = None
    gap: GapPlan | None = None
    spacings_m: Annotated[tuple[Spacing, ...], listed, AfterValidator(_range)] | None = Field(
        None, description='the least and the largest spacing in m between which one is sought for an edge or a gap')

    @model_validator(mode='after')
    def _something(self):
        if self.edge is not None and self.gap is not None:
            raise ValueError(' has both [design.edge] and [design.gap], but only one spacing to meet them; keep one of them')
        if self.spacing_from is None and self.cut_off_Hz is None:
            raise ValueError(' is empty; give cut_off_Hz, [design.edge] or [design.gap]')
        if (self.spacing_from is None) != (self.spacings_m is None):
            raise ValueError('.spacings_m is the range in which a spacing for [design.edge] or [design.gap] is sought; '
                             'give it together with one of them')
        return self

    @property
    def spacing_from(self) -> EdgePlan | GapPlan | None:
        """The edge or the gap that fixes the spacing, or None."""
        return self.edge or self.gap

    def check(self, scene: Scene) -> None:
        """Raise ValueError for a point or a branch that the scene's lattice does not have."""
        if scene.single or scene.law.shells == ALL:
            what = 'the oscillator' if scene.single else f"law.shells = '{ALL}'"
            raise ValueError(f'design is for lattices with a number of shells, not for {what}; take [design] out')
        if self.cut_off_Hz is not None and np.ptp(scene.lattice.cell().get_masses()):
            raise ValueError('design.cut_off_Hz is the frequency of uniform motion, which particles of different masses do not '
                             'have; take it out, and give the foundation')
        if self.spacing_from is not None:
            self.spacing_from.target(scene)

    def foundation(self, scene: Scene) -> float:
        """Stiffness in N/mm: that of the cut-off, or the scene's."""
        atoms = scene.atoms()
        return atoms.calc.foundation if self.cut_off_Hz is None else foundation_for(atoms, self.cut_off_Hz * HERTZ)

    def solve(self, scene: Scene) -> tuple[float, list[Design]]:
        """The foundation in N/mm and every `Design` that meets the table.

        Raises
        ------
        ValueError
            If there is none, with the range that can be reached.
        """
        k, present = self.foundation(scene), scene.lattice.spacing_m * u.m

        def build(spacing):
            atoms = varied(scene, {'spacing': spacing / present}).atoms()
            atoms.calc.set(foundation=k)
            return atoms

        if self.spacing_from is None:
            needed, _ = foundation_needed(build(present))
            if needed > k:
                raise ValueError(f'design.cut_off_Hz = {self.cut_off_Hz:g} gives a foundation of {_si(k)}, but at the spacing of '
                                 f'{present / u.m:g} m the lattice needs {_si(needed)}; raise the cut-off to '
                                 f'{self._cut_off(scene, needed):.6g} Hz or more, or the spacing')
            return k, [Design(present, self.cut_off_Hz * HERTZ, 0.0, needed)]
        low, high = (limit * u.m for limit in self.spacings_m)
        try:
            return k, spacings_for(build, self.spacing_from.target(scene), self.spacing_from.wanted, (low, high))
        except NoDesign as error:
            if not error.stable:
                needed = min(foundation_needed(build(spacing))[0] for spacing in (low, high))
                raise ValueError(f'design.spacings_m: the lattice buckles at every spacing from {low / u.m:g} to {high / u.m:g} '
                                 f'm on a foundation of {_si(k)}; it needs at least {_si(needed)}, a cut-off of '
                                 f'{self._cut_off(scene, needed):.6g} Hz') from None
            stable = ' and '.join(f'from {a / u.m:.6g} to {b / u.m:.6g} m' for a, b in error.stable)
            least, most = (value / HERTZ for value in error.reach)
            raise ValueError(f'{self.spacing_from.key}, {self.spacing_from.name}: no spacing gives '
                             f'{self.spacing_from.wanted / HERTZ:g} Hz; where the lattice is stable, {stable}, it reaches '
                             f'{least:.6g} to {most:.6g} Hz') from None

    def _cut_off(self, scene, k):
        return np.sqrt(k / scene.atoms().get_masses()[0]) / HERTZ


def _si(k):
    return f'{k / (u.N / u.m):.6g} N/m'


def tables(scene: Scene, design: Design, k: float) -> str:
    """The tables [lattice] and [foundation] of a design, as text to paste into a scene.

    Of a pillar the height is adjusted: rods come in given radii, and are cut to length.
    """
    lines = ['[lattice]', f'kind = "{scene.lattice.kind}"', f'spacing_m = {design.spacing / u.m:.12g}',
             f'mass_kg = {scene.lattice.mass_kg:.12g}']
    masses = scene.lattice.relative_masses  # pyright: ignore[reportAttributeAccessIssue]  no oscillator has [design]
    if masses is not None:
        lines.append(f'relative_masses = {list(masses)}')
    pillar = scene.foundation.pillar if scene.foundation else None
    stiffness = k / (u.N / u.m)
    if pillar is not None:
        height = pillar.height_m * (pillar.stiffness_N_per_m / stiffness) ** (1 / 3)
        lines += ['', '[foundation.pillar]', f'youngs_modulus_Pa = {pillar.youngs_modulus_Pa:.12g}',
                  f'radius_m = {pillar.radius_m:.12g}', f'height_m = {height:.12g}']
    elif k:
        lines += ['', '[foundation]', f'stiffness_N_per_m = {stiffness:.12g}']
    return '\n'.join(lines)
