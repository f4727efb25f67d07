"""Maps of measured fields along a path through the zone, and their motion at one frequency, drawn in SI on matplotlib axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from ase import Atoms
from ase.dft.kpoints import BandPath
from numpy.typing import NDArray

from .. import units
from ..bands.bloch import bloch_modes, branch_names, first_zone
from .axes import COLOURS, PREFIXES, label_frequencies, legend_of_set, letter_panels, panels, prefix_power
from .bands import label_path
from .waves import LINES, POWER, draw_power

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..waves.fields import Field, FieldMap
    from ..waves.ridge_tables import RidgePoints

HIGHEST = 1.1  # frequency of a picture in the highest one of the bands
ARROWS = 0.8  # length of the longest arrow of a shape in spacings


def plot_field(found: FieldMap, path: BandPath, cell: Atoms, points: RidgePoints | None) -> Figure:
    """Draw the power of each branch along a path and the bands of both models, with ridge points and their uncertainties."""
    x = path.get_linear_kpoint_axis()[0]
    bands = {model: units.hertz(bloch_modes(cell, path.kpts, model)[0]) for model in LINES}
    names = branch_names(len(cell))
    figure, axes = panels(len(cell), 2, height=2.9 * len(cell))
    letter_panels(axes, [f'{name} motion' if len(cell) == 1 else name for name in names])
    for branch, (ax, name) in enumerate(zip(axes.ravel().tolist(), names, strict=True)):
        power = found.power[branch]
        image = draw_power(ax, x, units.hertz(found.omega), (power / power.max(axis=1, keepdims=True)).T)
        for model, (colour, line) in LINES.items():
            ax.plot(x, bands[model][:, branch], line, color=colour, label=model)
        if points is not None:
            own = np.array([motion == name for motion in points.motions])[points.ridge]
            away = (path.kpts - points.q[:, None]) @ cell.cell.reciprocal().array
            nearest = np.linalg.norm(away, axis=2).argmin(axis=1)
            ax.errorbar(x[nearest[own]], points.frequencies_Hz[own], 1.96 * units.hertz(points.sigma_omega[own]), fmt='o',
                        color=COLOURS[3], markerfacecolor='white', linewidth=0.9, label='ridge, 95 %')
        label_path(ax, path)
        ax.set(xlabel='wavevector', ylim=(0, min(HIGHEST * max(map(np.max, bands.values())), units.hertz(found.omega[-1]))))
        if not branch % 2:
            label_frequencies(ax.yaxis)
    figure.colorbar(image, ax=axes, label=f'{POWER}, of each wavevector', pad=0.02, aspect=30)
    legend_of_set(figure, ncols=3)
    return figure


def plot_field_at(field: Field, cell: Atoms, omega: float, at: tuple[NDArray[np.float64], NDArray[np.float64],
                                                                    NDArray[np.complex128]]) -> Figure:
    """Draw the motion at one frequency: its power at each wavevector, contours of both models, and its shape at the points."""
    k, power, shape = at
    figure, axes = panels(1, 2, height=3.1)
    zone, plane = axes[0]
    largest = abs(shape).max()
    prefix = prefix_power(largest / units.m)
    letter_panels(axes, [f'{units.hertz(omega):.4g} Hz, wavevectors',
                         f'points, longest arrow {largest / units.m / 10.0**prefix:.3g} {PREFIXES[prefix]}m'])
    image = draw_power(zone, k, k, power / power.max())
    grid = np.stack(np.meshgrid(k, k), axis=-1).reshape(-1, 2)
    q = np.pad(grid @ cell.cell.array[:2, :2].T / (2 * np.pi), ((0, 0), (0, 1)))
    for model, (colour, line) in LINES.items():
        for branch in bloch_modes(cell, q, model)[0].T:
            if branch.min() < omega < branch.max():
                zone.contour(k, k, branch.reshape(len(k), -1), [omega], colors=colour, linestyles=line)
        zone.plot([], [], line, color=colour, label=model)
    corners = first_zone(cell.cell.array)
    zone.plot(*corners[[*range(len(corners)), 0]].T, color='0.4', linewidth=0.8, label='zone')
    zone.set(xlabel='$k_x$ (rad/mm)', ylabel='$k_y$ (rad/mm)', aspect='equal')
    figure.colorbar(image, ax=zone, label=POWER, pad=0.02)
    arrows = shape.real * ARROWS * field.spacing / largest
    plane.quiver(*field.sites.T, *arrows.T, angles='xy', scale_units='xy', scale=1, color=COLOURS[0])
    plane.set(xlabel='x (mm)', ylabel='y (mm)', aspect='equal')
    legend_of_set(figure, ncols=3)
    return figure
