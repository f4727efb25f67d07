"""Scans drawn at random, of plane waves on branches written out by hand: what a vibrometer would record, and its truth."""

import numpy as np


def triangular_branches(xi, direction, spacing, mass, tension, stiffness, foundation):
    """Angular frequencies (points, 2), rising, of plane waves along `direction` (degrees) with the phase xi per spacing.

    Each of the three bonds n adds 2 (1 - cos k.n) (stiffness n n - tension (1 - n n)); tension is force/spacing, and zero in the
    conventional model.  Any consistent units.
    """
    k = np.asarray(xi)[:, None] * [np.cos(np.radians(direction)), np.sin(np.radians(direction))]  # times the spacing
    D = np.zeros((len(k), 2, 2)) + foundation * np.eye(2)
    for angle in (0, 60, 120):
        n = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
        nn = np.outer(n, n)
        D += 2 * (1 - np.cos(k @ n))[:, None, None] * (stiffness * nn - tension * (np.eye(2) - nn))
    return np.sqrt(np.linalg.eigvalsh(D) / mass)


def packet(t, n, xi, omega, carrier, width, start):
    """A burst along a row: plane waves cos(omega t - xi n) on the branch omega(xi), a Gaussian of `width` about the carrier.

    It leaves n = 0 at the time `start`; shape (times, points).
    """
    within = np.linspace(max(carrier - 3 * width, omega[0]), min(carrier + 3 * width, omega[-1]), 200)[1:-1]
    weights = np.exp(-(((within - carrier) / width) ** 2) / 2)
    phases = np.interp(within, omega, xi)
    waves = np.exp(1j * np.multiply.outer(t - start, within)) * weights
    return (waves @ np.exp(-1j * np.multiply.outer(phases, n))).real / weights.sum()


def scene_text(spacing, mass, b, a, foundation):
    """A scene of the triangular lattice in SI with nothing but a lattice, a law and springs."""
    return (f'title = "drawn"\n[lattice]\nkind = "triangular"\nspacing_m = {spacing!r}\nmass_kg = {mass!r}\n[law]\n'
            f'kind = "inverse_power"\nb_N_m_a = {b!r}\na = {a!r}\nshells = 1\n[foundation]\nstiffness_N_per_m = {foundation!r}\n')
