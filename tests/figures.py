"""What is drawn for the tests of plots, and what they read off the axes."""

import io

import numpy as np
from matplotlib.quiver import Quiver

from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices, units as u


def ideal(lattice=lattices.triangular, foundation=0.0):
    """Sec. IV of the paper: f = 1e4 N m^4 r^-4 on particles of 1 kg, 1 m apart."""
    cell = lattice(1 * u.m, 1 * u.kg)
    cell.calc = MagneticRepulsion(cell, InversePower(b=1e4 * u.N * u.m**4, a=4), foundation=foundation * u.N / u.m)
    return cell


def bands_of(cell, path='GMKG', npoints=300, **options):
    return analytic_bands(cell, cell.cell.bandpath(path, npoints=npoints, pbc=cell.pbc), **options)


def drawn(ax):
    """Draw the figure, as every warning is an error, and return its axes."""
    ax.figure.savefig(io.BytesIO())
    return ax


def legend_of(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def texts_of(ax):
    return {text.get_text() for text in ax.texts}


def only(kind, ax):
    (artist,) = [artist for artist in ax.collections if isinstance(artist, kind)]
    return artist


def arrows_of(ax):
    arrows = only(Quiver, ax)
    return arrows.XY.T, np.array([arrows.U, arrows.V])
