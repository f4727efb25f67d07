"""An axis in rad/s beside one in Hz, as the paper names its bursts in rad/s."""

import numpy as np


def add_radians(ax):
    """Angular frequencies on the right of axes whose frequencies are in Hz."""
    there_and_back = (lambda f: 2 * np.pi * f), (lambda omega: omega / (2 * np.pi))
    ax.secondary_yaxis('right', functions=there_and_back).set_ylabel(r'$\omega$ (rad/s)')
    ax.tick_params(axis='y', right=False)
