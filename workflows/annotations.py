"""What the workflows write on pictures of bands: an axis in rad/s, and the names of the branches."""

import numpy as np

from .checks import BRANCHES

RADIANS = lambda f: 2 * np.pi * f, lambda omega: omega / (2 * np.pi)
"""Functions of an axis in rad/s beside one in Hz."""


def name_branches(ax, shear, longitudinal):
    """Name the branches at M, which is about a third of the way from Gamma over M and K to Gamma; heights of the axes."""
    for name, height in zip(BRANCHES, (shear, longitudinal), strict=True):
        ax.text(0.366, height, name, ha='center', va='center', transform=ax.transAxes)
