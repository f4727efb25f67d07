"""Sets of wavenumber-frequency maps with one legend, one colour bar and equal scales; and waves in the lattice, signed."""

import numpy as np

from magphonon import units
from magphonon.plotting.axes import COLOURS, legend_of_set
from magphonon.plotting.waves import plot_wave

from .checks import BRANCHES

RADIANS = lambda f: 2 * np.pi * f, lambda omega: omega / (2 * np.pi)
SIGNED = 'RdBu_r'
"""Colours of displacements to both sides."""


def plot_map(ax, wave, carrier_Hz, top_Hz):
    """A map up to `top_Hz` with its ridge and branches, and the carrier of the burst; legend and colour bar are the set's."""
    plot_wave(wave, ax)
    if ax.get_legend() is not None:
        ax.get_legend().remove()
    if image_of(ax).colorbar is not None:
        image_of(ax).colorbar.remove()
    ax.axhline(carrier_Hz, color=COLOURS[4], linewidth=0.8, zorder=1.5, label='carrier')
    ax.set_ylim(0, top_Hz)


def image_of(ax):
    """The map on its axes."""
    return ax.collections[0]


def finish_maps(figure, axes):
    """One legend and one colour bar for all maps, labels at the outer axes alone."""
    for ax in axes.flat:
        ax.label_outer()
    figure.colorbar(image_of(axes[0, 0]), ax=axes, label='power (dB)', aspect=30, pad=0.02)
    legend_of_set(figure, ncols=5)


def plot_signed(ax, patch, values, largest, site, unit=units.m):
    """One component of the displacements of all particles, red to one side and blue to the other; lengths in `unit`."""
    rest = patch.calc.reference.positions[:, :2] / unit
    image = ax.tripcolor(*rest.T, values, cmap=SIGNED, vmin=-largest, vmax=largest, shading='gouraud', rasterized=True)
    ax.plot(*rest[site.row].T, ':', color='k', linewidth=1, label=r'measured, along $\mathbf{R}_2$')
    ax.plot(*rest[site.driven].T, '-', color='k', linewidth=2, label='driven')
    ax.set(aspect='equal')
    return image


def name_branches(ax, shear, longitudinal):
    """Name the branches at M, which is about a third of the way from Gamma over M and K to Gamma; heights of the axes."""
    for name, height in zip(BRANCHES, (shear, longitudinal), strict=True):
        ax.text(0.366, height, name, ha='center', va='center', transform=ax.transAxes)
