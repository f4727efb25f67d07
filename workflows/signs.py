"""Couplings of both signs: a chain of springs k1 and -k1/2 buckles in waves of six spacings, unless pillars hold it."""

import numpy as np
from ase.constraints import FixedLine
from scipy.optimize import brentq

from magphonon import InversePower, MagneticRepulsion, critical_foundation, lattices, propagate, units as u
from magphonon.bands.bloch import bloch_modes
from magphonon.interactions import Attraction
from magphonon.plotting.axes import new_axes

from .rows import Check, Outcome, save_picture

A = 4.5824
LAW = InversePower(b=1.6209e-10 * u.N * u.m**A, a=A)  # of the prototype: k1 = a f/L0 = 108.6 N/m
SECOND = Attraction(InversePower(b=2**A * LAW.b, a=A))  # at twice the distance -k1/2
MAGNETS = 4  # in the cell, each of its own kind: the kinds tell which attract each other
TOO_SOFT = 0.4  # foundation in k1, where half of it is needed


def main(out):
    """Bands, foundation needed and range of growing waves, against `omega^2 m = k - 2 k1 cos(xi) (1 - cos(xi))`."""
    bare, k1 = chain(0.0)
    found, q = critical_foundation(bare)
    qs = np.linspace(-0.45, 0.5, 7)
    bands = np.array([np.sort(squares(bare, x)) for x in qs]) / k1
    folded = np.sort([closed((x + np.arange(MAGNETS)) * 2 * np.pi / MAGNETS) for x in qs], axis=1)
    soft = chain(TOO_SOFT)[0]
    true = np.arccos((1 + np.array([1, -1]) * np.sqrt(1 - 2 * TOO_SOFT)) / 2)
    edges = [brentq(lambda xi, n=n: np.sort(squares(soft, xi * MAGNETS / (2 * np.pi)))[n], *ends)  # folded: two grow at the lower
             for n, ends in ((1, (0.6, 0.785)), (0, (1.1, 1.5)))]
    phases = (q[0] + np.arange(MAGNETS) - MAGNETS / 2) * 2 * np.pi / MAGNETS
    only = bare.copy()
    only.calc = MagneticRepulsion(only, bare.calc.laws[0, 1], shells=2)
    return Outcome([
        Check('chain of both signs: omega^2 of its bands, largest misfit / k1', abs(bands - folded).max(), 0.0, 1e-5),
        Check('chain of both signs: foundation needed / k1', found / k1, 0.5, 1e-5),
        Check('chain of both signs: phase of its softest wave (rad)', abs(phases[closed(phases).argmin()]), np.pi / 3, 1e-5),
        *(Check(f'on a foundation of 0.4 k1: {name} end of the waves that grow (rad)', edge, one, 1e-5)
          for name, edge, one in zip(('lower', 'upper'), edges, true, strict=True)),
        Check('on a foundation of 0.4 k1: growth rate in time steps (1/s)', growth(soft) * u.s,
              np.sqrt((0.5 - TOO_SOFT) * k1 / bare.get_masses()[0]) * u.s, 1e-4),
        Check('control: all magnets repel: foundation needed / k1', critical_foundation(only).k / k1, 0.5, 0.5,
              control='magnets that all repel'),
    ], [picture(out)])


def chain(share):
    """A cell of the prototype's magnets, 10 mm apart and guided along the chain, on a foundation of `share` k1; k1 in N/mm."""
    atoms = lattices.chain(10 * u.mm, 0.707 * u.g).repeat((MAGNETS, 1, 1))
    atoms.set_tags(range(MAGNETS))
    laws = {(a, b): SECOND if (a, b) in ((0, 2), (1, 3)) else LAW for a in range(MAGNETS) for b in range(a, MAGNETS)}
    k1 = LAW.d2phi(10 * u.mm)
    atoms.calc = MagneticRepulsion(atoms, laws, shells=2, foundation=share * k1)
    atoms.set_constraint(FixedLine(range(MAGNETS), (1, 0, 0)))
    return atoms, k1


def closed(xi, share=0.0):
    """Squared frequency times mass in units of k1, in closed form."""
    return share - 2 * np.cos(xi) * (1 - np.cos(xi))


def squares(atoms, q):
    """Squared frequencies times mass in N/mm at the wavevector q of the cell."""
    omega = bloch_modes(atoms, [[q, 0, 0]])[0][0]
    return omega * abs(omega) * atoms.get_masses()[0]


def growth(cell):
    """Growth rate of three cells, whose waves have phases of sixths of a turn, after a random push."""
    atoms = cell.repeat((3, 1, 1))
    atoms.calc = cell.calc.on(atoms)
    atoms.set_constraint(FixedLine(range(len(atoms)), (1, 0, 0)))
    atoms.set_momenta(np.random.default_rng(1).normal(size=(len(atoms), 3)) * [1e-6, 0, 0])
    moved = abs(propagate(atoms, [150.0, 160.0], particles=[0]).displacements[:, 0, 0])
    return np.log(moved[1] / moved[0]) / 10.0


def picture(out):
    """Draw squared frequencies over the phase on three foundations."""
    ax, xi = new_axes(), np.linspace(0, np.pi, 200)
    for share, style in zip((0.0, TOO_SOFT, 0.55), ('-', '--', ':'), strict=True):
        (line,) = ax.plot(xi / np.pi, closed(xi, share), style, label=f'foundation of {share:g} $k_1$')
        atoms, k1 = chain(share)
        at = np.linspace(0.05, 0.95, 10)
        folded = [squares(atoms, x * MAGNETS / 2) / k1 for x in at]
        lowest = [own[abs(own - closed(np.pi * x, share)).argmin()] for x, own in zip(at, folded, strict=True)]
        ax.plot(at, lowest, 'o', color=line.get_color(), fillstyle='none')
    ax.axhspan(-1, 0, color='0.9')
    ax.set(xlabel=r'phase per magnet, $\xi/\pi$', ylabel=r'$\omega^2 m/k_1$', xlim=(0, 1), ylim=(-1, 5))
    ax.legend()
    return save_picture(ax.figure, out / 'signs.png', (
        'A chain whose neighbours repel and whose second neighbours attract half as stiffly: bands (marks) and closed form; '
        'waves in the grey band grow.'))
