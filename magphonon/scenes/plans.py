"""The tables of a scene that say what to compute, in SI: bands, frequency responses and tone bursts. [design] states
wanted frequencies, from which the tables of a lattice that has them are computed.
"""

from __future__ import annotations

import json
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from .. import units as u
from ..design.inverse import Design, NoDesign, foundation_for, spacings_for
from ..design.objectives import BandEdge, Level, Objective, Rest, Worst, band_gap
from ..design.site_designs import Robust
from ..errors import one_of
from ..response.frf import Dof
from ..stability.buckling import critical_foundation
from ..stiffness.defects import Scatter
from ..stiffness.rest import LinearSystem, freedom
from ..waves.ridge_tables import DRIVEN
from .fields import (
    Angle,
    Angles,
    AtLeastTwo,
    Count,
    Counts,
    Duration,
    Energy,
    Force,
    Frequencies,
    Frequency,
    NotNegative,
    Point,
    Positive,
    Rate,
    Spacing,
    Table,
    Text,
    listed,
    within,
)
from .laws import InversePowerLaw
from .structures import Percent
from .tolerances import varied

if TYPE_CHECKING:
    from ..dynamics.motion import Motion
    from ..waves.wave_source import Burst, BurstRecord, BurstSetup
    from .scene import Scene

HERTZ = 2 * np.pi * u.Hz  # one hertz in rad/ms
WIDTH_dB, FLOOR = 1.0, 1e-3  # of the soft minimum; level below which quieter is no better, in the largest response before
MESH_POINTS = 24
"""Number of wavevectors along each reciprocal vector among which the ends of a branch are searched for; M and K are among
them."""


class Damped(Table):
    """Base of the tables with one damping, which the file of the particles may vary from particle to particle."""

    if TYPE_CHECKING:
        damping_per_s: float | None

    def damping_of(self, atoms: Atoms) -> Any:
        """Damping rate gamma in 1/ms: one number, or one for each particle if their file has the column relative_damping."""
        return self.damping_per_s / u.s * atoms.arrays.get('relative_damping', 1.0)  # pyright: ignore[reportOptionalOperand]  it is given


class BandPlan(Damped):
    """The path of the bands, and phonopy's supercell."""

    path: Text | None = Field(None, description="the special points in order, such as 'GMKG'; by default those of ASE")
    points: AtLeastTwo = Field(200, description='the number of wavevectors along the path')
    supercell: Counts | None = Field(None, description="phonopy's supercell, one number for each periodic direction; by "
                                                       'default the smallest in which no bond spans half of it')
    damping_per_s: Rate | None = Field(None, description='the damping force per momentum in 1/s; if given, the bands of '
                                                         'the complete model are computed again, with the decay of each mode',
                                       examples=[4.0])
    temperature_J: Energy | None = Field(None, description='kT in J; if given, the motion of the supercell in a bath of this '
                                                           'temperature is computed, which gives the stiffness of waves in '
                                                           'thermal motion', examples=[2.4e-5])

    @property
    def beyond(self) -> str:
        """The given keys that linear bands without losses do not support, in words; empty if there are none."""
        return ' and '.join(f'bands.{key}' for key in ('damping_per_s', 'temperature_J') if getattr(self, key) is not None)


class Pick(Table):
    """A particle of a patch, given by its position, and a direction in the plane."""

    at_m: Point = Field(description='the position [x, y] in m; the particle nearest to it is taken',
                        examples=[[0.03, 0.035]])
    direction_deg: Angle = Field(description='the direction in degrees from the x axis', examples=[0.0])

    def of(self, patch: Atoms) -> Dof:
        """The Dof in a patch: the particle nearest to the position, and the unit vector of the direction."""
        distance = np.linalg.norm(patch.positions[:, :2] - np.array(self.at_m) * u.m, axis=1)
        particle, angle = distance.argmin(), self.direction_deg * u.deg
        x, y = patch.positions[particle, :2] / u.m
        if distance[particle] > patch.calc.bonds.lengths.min():
            raise ValueError(f'.at_m = {list(self.at_m)} is outside the patch; the nearest particle is at [{x:.6g}, {y:.6g}]')
        if not freedom(patch)[0][particle]:
            raise ValueError(f'.at_m = {list(self.at_m)} is on the held rim, nearest to [{x:.6g}, {y:.6g}]; move it inside')
        return Dof(int(particle), np.array([np.cos(angle), np.sin(angle), 0]))


class MovingWall(Table):
    """A side of the held rim that moves to and fro, on a shaker, in place of a force."""

    side_deg: Angle = Field(description='the direction in degrees from the x axis in which the wall lies: it consists of the '
                                        'held particles that lie farther in this direction than all free ones', examples=[270.0])
    direction_deg: Angle = Field(description='the direction in degrees from the x axis in which the wall moves', examples=[0.0])

    def of(self, patch: Atoms) -> NDArray[np.float64]:
        """Displacements of the wall per unit of its amplitude, zero for all other particles; shape (particles, 3)."""
        side, along = (np.array([np.cos(angle), np.sin(angle)]) for angle in (self.side_deg * u.deg, self.direction_deg * u.deg))
        free, reach = freedom(patch)[0], patch.positions[:, :2] @ side
        wall = ~free & (reach > reach[free].max() + 1e-6 * patch.calc.bonds.lengths.min())
        if not wall.any():
            raise ValueError(f'.side_deg = {self.side_deg!r}: no particle is held on this side of the free ones')
        return wall[:, None] * np.append(along, 0.0)


GYRATION_SEEN_FROM = 'bench', 'floor'


class FrfPlan(Damped):
    """Displacement per harmonic force as a function of frequency; in a patch, the places of the force and of the response."""

    from_Hz: Frequency = Field(description='the lowest frequency in Hz')
    to_Hz: Frequency = Field(description='the highest frequency in Hz')
    points: AtLeastTwo = Field(description='the number of frequencies')
    damping_per_s: Rate = Field(description='the damping force per momentum in 1/s, which is the width of a peak in rad/s')
    base_deg: Angle | None = Field(None, description='the direction in degrees from the x axis in which the whole bench '
                                   'is shaken, in place of [frf.force]; the response is then per displacement of the bench, seen '
                                   'from the floor', examples=[90.0])
    gyration_seen_from: Annotated[str, BeforeValidator(partial(one_of, '', choices=GYRATION_SEEN_FROM))] | None = Field(
        None, description='with base_deg and particles that gyrate: "bench" if gyration turns the motion relative to the bench, '
                          'as with gyroscopes on pillars, or "floor" if it turns all motion, that of the bench included, as on '
                          'a rotating bench or for charges in a field', examples=['floor'])
    force: Pick | None = None
    wall: MovingWall | None = None
    response: Pick | None = None

    @model_validator(mode='after')
    def _rising(self):
        if not self.from_Hz < self.to_Hz:
            raise ValueError(f'.to_Hz must lie above from_Hz = {self.from_Hz!r}, not {self.to_Hz!r}')
        return self

    @property
    def omega(self) -> NDArray[np.float64]:
        """Angular frequencies in rad/ms."""
        return 2 * np.pi * np.linspace(self.from_Hz, self.to_Hz, self.points) * u.Hz

    @property
    def damping(self) -> float:
        """Damping rate gamma in 1/ms."""
        return self.damping_per_s / u.s


class BurstPlan(Table):
    """Bursts through the patch, one after the other, each from rest."""

    source: Annotated[str, BeforeValidator(partial(one_of, '', choices=DRIVEN))] = Field(
        description="'row' or 'point', for waves that enter at the lower edge of the patch; or 'bench' for a shaken bench: "
                    'force_N is then the mass of the heaviest particle times the acceleration of the bench, and motion is '
                    'relative to it')
    carriers_Hz: Frequencies = Field(description='the carrier frequency of each burst in Hz')
    directions_deg: Angles = Field(description='the direction of the force of each burst in degrees from the x axis')
    cycles: Annotated[Positive, within(0.5, 1e6, 'carrier periods')] = Field(
        description='the number of carrier periods in a burst')
    force_N: Force = Field(description='the largest force on a particle in N')
    damping_ratio: Annotated[NotNegative, within(0, 1, 'shares of critical damping')] = Field(
        description='the damping, as a fraction of the critical damping at the carrier frequency')
    duration_s: Duration = Field(description='the length of the record in s')
    tolerance: Annotated[Positive, within(1e-9, 0.1, 'of the largest displacement')] | None = Field(
        None, description='the allowed error of the displacements due to time steps and arithmetic, as a fraction of the '
                          'largest displacement; by default steps are short, of order two and in double precision',
        examples=[1e-3])

    @model_validator(mode='after')
    def _belong_together(self):
        if not self.carriers_Hz:
            raise ValueError('.carriers_Hz names no burst; give at least one carrier')
        if len(self.directions_deg) != len(self.carriers_Hz):
            raise ValueError(f'.directions_deg must hold a direction for each of the {len(self.carriers_Hz)} carriers, '
                             f'not {list(self.directions_deg)}')
        if len(set(self.names)) < len(self.names):
            raise ValueError(f' lists a burst twice, among {", ".join(self.names)}; keep one of them')
        longest = self.cycles / min(self.carriers_Hz)
        if not self.duration_s > longest:
            raise ValueError(f'.duration_s must be longer than the longest burst, {longest:.6g} s, not {self.duration_s!r}')
        return self

    @property
    def names(self) -> list[str]:
        """Names of the bursts, in messages and file names."""
        return [f'{f:.6g}Hz_{angle:.6g}deg' for f, angle in zip(self.carriers_Hz, self.directions_deg, strict=True)]

    def burst(self, k: int, site: BurstSetup) -> Burst:
        """Burst number k at the particles of a BurstSetup: its drive, damping and duration, as a Burst."""
        from ..waves.wave_source import Burst

        omega, angle = 2 * np.pi * self.carriers_Hz[k] * u.Hz, self.directions_deg[k] * u.deg
        drive = site.burst((np.cos(angle), np.sin(angle)), self.force_N * u.N, omega, self.cycles)
        return Burst(drive, 2 * self.damping_ratio * omega, self.duration_s * u.s)

    def send(self, k: int, cell: Atoms, patch: Atoms, **engine: Any) -> tuple[BurstSetup, BurstRecord]:
        """Send burst number k through a patch; returns its BurstSetup and BurstRecord.

        `engine`, `threads`, `ranks`, `directory` and `film` are those of `magphonon.waves.run_burst`.
        """
        from ..waves.spectrum import FEWEST
        from ..waves.wave_source import burst_setup, run_burst

        where = burst_setup(cell, patch, self.source)
        if len(where.row) < FEWEST:
            raise ValueError(f'the row along R2 has {len(where.row)} particles inside the rim, and a map of waves needs at least '
                             f'{FEWEST}; enlarge [patch]')
        burst = self.burst(k, where)
        return where, run_burst(patch, where, burst.drive, burst.damping, burst.duration, tolerance=self.tolerance, **engine)


class VibrometerPlan(Table):
    """The virtual vibrometer that measures the row."""

    sampling_rate_Hz: Frequency = Field(description='the sampling rate in Hz')
    noise_m: Annotated[NotNegative, within(0, 1e6, 'metres')] = Field(description='the standard deviation of each sample in m')

    def measure(self, row: Motion, seed: int = 0) -> Motion:
        """The motion of a row as the vibrometer measures it; `seed` is that of its noise."""
        from ..waves.vibrometer import sampled

        return sampled(row, self.sampling_rate_Hz * u.Hz, self.noise_m * u.m, seed)


class EdgePlan(Table):
    """Edge of a band: the frequency of a branch at a special point."""

    point: Text = Field(description="the special point, such as 'M'")
    branch: Count = Field(description='the branch, counted from 1 by frequency')
    frequency_Hz: Frequency = Field(description='the wanted frequency in Hz')

    key: ClassVar = 'design.edge.frequency_Hz'
    name = property(lambda self: f'branch {self.branch} at {self.point}')
    wanted = property(lambda self: self.frequency_Hz * HERTZ)

    def target(self, scene: Scene) -> Objective:
        points = scene.special_points
        if self.point not in points:
            raise ValueError(f'design.edge.point of the {scene.lattice.kind} lattice must be one of {", ".join(points)}, '
                             f'not {self.point!r}')
        _check_branch('edge.branch', self.branch, scene, 0)
        return BandEdge(points[self.point], self.branch, sharp=np.inf)


class GapPlan(Table):
    """Gap between a branch and the next one, over the whole zone."""

    above_branch: Count = Field(description='the branch below the gap, counted from 1 by frequency', examples=[1])
    width_Hz: Frequency = Field(description='the wanted width of the gap in Hz', examples=[10.0])

    key: ClassVar = 'design.gap.width_Hz'
    name = property(lambda self: f'gap above branch {self.above_branch}')
    wanted = property(lambda self: self.width_Hz * HERTZ)

    def target(self, scene: Scene) -> Objective:
        _check_branch('gap.above_branch', self.above_branch, scene, 1)
        axes = [np.arange(MESH_POINTS) / MESH_POINTS if periodic else [0.0] for periodic in scene.perfect_cell().pbc]
        return band_gap(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3), self.above_branch, np.inf)


def _check_branch(key, branch, scene, above):
    branches = len(scene.lattice.cell()) * scene.perfect_cell().calc.dim
    if branch > branches - above:
        raise ValueError(f'design.{key} must be at most {branches - above}, as the {scene.lattice.kind} lattice has {branches} '
                         f'branches, not {branch}')


def _range(value):
    if len(value) != 2 or not value[0] < value[1]:
        raise ValueError(f' must be a range [least, largest], not {list(value)!r}')
    return value


Range = Annotated[tuple[Positive, ...], listed, AfterValidator(_range)]


class SiteTarget(Table):
    """A frequency that is to be loud at one place, quiet at another, or both; a target counts by its level in dB."""

    frequency_Hz: Frequency = Field(description='the frequency in Hz of the force of [frf.force]', examples=[60.0])
    loud: Pick | None = None
    quiet: Pick | None = None

    @model_validator(mode='after')
    def _something(self):
        if self.loud is None and self.quiet is None:
            raise ValueError(' has no target; give [design.targets.loud], [design.targets.quiet] or both')
        return self

    @property
    def name(self) -> str:
        """Name of the target in messages and file names, such as '60Hz'."""
        return f'{self.frequency_Hz:.6g}Hz'

    def level(self, source: Dof, patch: Atoms, damping: float, floor: float) -> Objective:
        """Objective: the level in dB at the loud place minus that at the quiet place."""
        def at(pick):
            return Level(source, pick.of(patch), self.frequency_Hz * HERTZ, damping, floor)

        if self.loud is None:
            return -1.0 * at(self.quiet)
        return at(self.loud) if self.quiet is None else at(self.loud) - at(self.quiet)


class SiteRanges(Table):
    """What may vary from site to site, and within which factors."""

    strength: Range | None = Field(None, description='the least and the largest factor of the strength of each magnet',
                                   examples=[[0.85, 1.15]])
    spring: Range | None = Field(None, description='the least and the largest factor of the stiffness under each particle',
                                 examples=[[0.8, 1.25]])
    mass: Range | None = Field(None, description='the least and the largest factor of the mass of each particle',
                               examples=[[0.5, 2.0]])

    def bounds(self) -> dict[str, tuple[float, float]]:
        """The ranges in the form that `magphonon.design.optimise` takes."""
        return {name: bounds for name in type(self).model_fields if (bounds := getattr(self, name)) is not None}


class SiteParts(Table):
    """Parts that can be bought, as factors; what is not listed may have any value within its range."""

    strength: Annotated[tuple[Positive, ...], listed] = Field((), description='possible factors of the strength',
                                                              examples=[[0.9, 1.0, 1.1]])
    spring: Annotated[tuple[Positive, ...], listed] = Field((), description='possible factors of the stiffness of pillars',
                                                            examples=[[0.8, 1.0, 1.2]])
    mass: Annotated[tuple[Positive, ...], listed] = Field((), description='possible factors of the mass',
                                                          examples=[[0.5, 1.0, 2.0]])


class SiteScatterPlan(Table):
    """Scatter from one specimen to the next that the design must tolerate."""

    strength_percent: Percent = Field(0.0, description='the standard deviation of the strengths in percent', examples=[1.0])
    stiffness_percent: Percent = Field(0.0, description='the standard deviation of the stiffnesses in percent', examples=[1.0])
    mass_percent: Percent = Field(0.0, description='the standard deviation of the masses in percent', examples=[1.0])
    draws: Count = Field(8, description='the number of specimens drawn at random; take 24 or more for a design to be built',
                         examples=[24])


class DesignPlan(Table):
    """The wanted frequencies; everything else stays as it is in the scene.

    The foundation follows from the cut-off, the spacing from an edge or a gap; with targets every site of the patch is designed.
    """

    cut_off_Hz: Frequency | None = Field(None, description='the wanted lowest frequency at Gamma in Hz; it sets the foundation')
    edge: EdgePlan | None = None
    gap: GapPlan | None = None
    spacings_m: Annotated[tuple[Spacing, ...], listed, AfterValidator(_range)] | None = Field(
        None, description='the smallest and the largest spacing in m; the spacing for an edge or a gap is sought between them')
    targets: Annotated[tuple[SiteTarget, ...], listed] = ()
    over: SiteRanges | None = None
    parts: SiteParts | None = None
    scatter: SiteScatterPlan | None = None
    starts: Count = Field(1, description='the number of starts for a design of every site; the best is kept', examples=[3])
    steps: Count = Field(60, description='the number of iterations of each start', examples=[60])

    @model_validator(mode='after')
    def _something(self):
        if self.targets or self.over:
            if self.cut_off_Hz or self.spacing_from or not (self.targets and self.over and self.over.bounds()):
                raise ValueError(' of every site needs [[design.targets]] and [design.over] with a range, and may not have a '
                                 'cut-off, an edge or a gap')
            return self
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
        if scene.single:
            raise ValueError('design is for lattices, not for the oscillator; remove [design]')
        if self.targets:
            if scene.patch is None and not scene.finite:
                raise ValueError('design.targets are responses of a finite structure; add [patch]')
            if scene.frf is None or scene.frf.force is None or scene.frf.damping_per_s is None:
                raise ValueError('design.targets are responses to the force of [frf.force], with the damping of [frf]; add them')
            return
        if self.cut_off_Hz is not None and np.ptp(scene.lattice.cell().get_masses()):
            raise ValueError('design.cut_off_Hz is the frequency of uniform motion, which does not exist for particles of '
                             'different masses; remove it, and give the foundation')
        if self.spacing_from is not None:
            self.spacing_from.target(scene)

    def foundation(self, scene: Scene) -> float:
        """Stiffness of the foundation in N/mm, from the cut-off if it is given, otherwise from the scene."""
        atoms = scene.perfect_cell()
        return atoms.calc.foundation if self.cut_off_Hz is None else foundation_for(atoms, self.cut_off_Hz * HERTZ)

    def sites(self, scene: Scene) -> tuple[Atoms, Dof, Objective, Robust | None]:
        """The patch, the Dof of the force, the soft minimum of the targets in dB, and the scatter that a design must tolerate."""
        patch: Any = scene.counted().patch_atoms()
        frf = scene.frf
        try:
            source = frf.force.of(patch)
            rest = Rest(LinearSystem.about(patch.calc, patch))
            omega, damping = self.targets[0].frequency_Hz * HERTZ, frf.damping
            floor = FLOOR * abs(rest.response(source, omega, damping)).max()
            levels = tuple(target.level(source, patch, damping, floor) for target in self.targets)
        except ValueError as error:
            raise ValueError(f'design.targets or frf.force: {str(error).lstrip(".")}') from None
        robust = None
        if self.scatter is not None:
            s = self.scatter
            percent = (s.strength_percent, s.mass_percent, s.stiffness_percent)
            robust = Robust(Scatter(0.0, *(value / 100 for value in percent)), s.draws, WIDTH_dB)
        return patch, source, Worst(levels, WIDTH_dB), robust

    def solve(self, scene: Scene) -> tuple[float, list[Design]]:
        """The foundation in N/mm and every `Design` that meets the table, for a definite number of shells (`Scene.counted`)."""
        scene = scene.counted()
        k, present = self.foundation(scene), scene.lattice.spacing_m * u.m

        def build(spacing):
            atoms = varied(scene, {'spacing': spacing / present}).perfect_cell()
            atoms.calc.set(foundation=k)
            return atoms

        if self.spacing_from is None:
            needed, _ = critical_foundation(build(present), 'complete')
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
                needed = min(critical_foundation(build(spacing), 'complete')[0] for spacing in (low, high))
                raise ValueError(f'design.spacings_m: the lattice buckles at every spacing from {low / u.m:g} to {high / u.m:g} '
                                 f'm on a foundation of {_si(k)}; it needs at least {_si(needed)}, a cut-off of '
                                 f'{self._cut_off(scene, needed):.6g} Hz') from None
            stable = ' and '.join(f'from {a / u.m:.6g} to {b / u.m:.6g} m' for a, b in error.stable)
            least, most = (value / HERTZ for value in error.reach)
            raise ValueError(f'{self.spacing_from.key}, {self.spacing_from.name}: no spacing gives '
                             f'{self.spacing_from.wanted / HERTZ:g} Hz; where the lattice is stable, {stable}, the value goes '
                             f'from {least:.6g} to {most:.6g} Hz') from None

    def _cut_off(self, scene, k):
        return np.sqrt(k / scene.perfect_cell().get_masses()[0]) / HERTZ


def _si(k):
    return f'{k / (u.N / u.m):.6g} N/m'


def tables(scene: Scene, design: Design, k: float) -> str:
    """The tables [lattice] and [foundation] of a design, as text to paste into a scene.

    The stiffness of a pillar is adjusted by its height, because rods come in given radii and are cut to length.
    """
    lines = ['[lattice]', f'kind = "{scene.lattice.kind}"', f'spacing_m = {design.spacing / u.m:.12g}',
             f'mass_kg = {scene.lattice.mass_kg:.12g}']
    masses = scene.lattice.relative_masses  # pyright: ignore[reportAttributeAccessIssue]  no oscillator has [design]
    if masses is not None:
        lines.append(f'relative_masses = {list(masses)}')
    if isinstance(law := scene.law, InversePowerLaw) and law.force_N is not None:
        # the force is that at the spacing from which the design started: b stays
        lines += ['', '[law]', 'kind = "inverse_power"', f'b_N_m_a = {law.b:.12g}', f'a = {law.a:.12g}',
                  f'shells = {json.dumps(law.asked)}']
    pillar = scene.foundation.pillar if scene.foundation else None
    stiffness = k / (u.N / u.m)
    if pillar is not None:
        height = pillar.height_m * (pillar.stiffness_N_per_m / stiffness) ** (1 / 3)
        lines += ['', '[foundation.pillar]', f'youngs_modulus_Pa = {pillar.youngs_modulus_Pa:.12g}',
                  f'radius_m = {pillar.radius_m:.12g}', f'height_m = {height:.12g}']
    elif k:
        lines += ['', '[foundation]', f'stiffness_N_per_m = {stiffness:.12g}']
    return '\n'.join(lines)
