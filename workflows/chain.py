"""The chain: D* has no longitudinal part, and acts on the transverse motion alone."""

import numpy as np

from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices, units
from magphonon.plotting.axes import new_axes
from magphonon.plotting.bands import plot_bands

from .rows import Check, Outcome, save_picture

LAW = InversePower(b=1e4 * units.N * units.m**4, a=4.0)  # of Sec. IV, with the spacing and mass
FOUNDATION = 5e4 * units.N / units.m  # chosen: below 4 f(L0)/L0 = 4e4 N/m the chain buckles sideways


def main(out):
    """Longitudinal band against its closed form, transverse band unstable without a foundation."""
    L0, m, k, law = 1 * units.m, 1 * units.kg, FOUNDATION, LAW
    cell = lattices.chain(L0, m)
    cell.calc = MagneticRepulsion(cell, law, foundation=k)
    path = cell.cell.bandpath('GX', npoints=101, pbc=cell.pbc)
    xi = 2 * np.pi * path.kpts[:, 0]
    complete, conventional = (analytic_bands(cell, path, model) for model in ('complete', 'conventional'))

    def closed(stiffness):  # omega^2 of a chain of springs on a foundation
        return (k + 2 * stiffness * (1 - np.cos(xi))) / m

    along, across = closed(law.d2phi(L0)), closed(law.dphi(L0) / L0)
    longitudinal = np.max(complete.omega, axis=1) ** 2
    transverse = np.sign(complete.omega[:, 0]) * complete.omega[:, 0] ** 2
    top = along.max()
    checks = [
        Check('chain longitudinal omega^2, complete: misfit / largest value',
              abs(longitudinal - along).max() / top, 0.0, 1e-12),
        Check('chain longitudinal omega^2, D0 alone: misfit / largest value',
              abs(conventional.omega[:, 1] ** 2 - along).max() / top, 0.0, 1e-12),
        Check('chain transverse omega^2, complete: misfit / largest value', abs(transverse - across).max() / top, 0.0, 1e-12),
        Check('control: transverse omega^2, D0 alone: misfit / largest value',
              abs(conventional.omega[:, 0] ** 2 - across).max() / top, 0.0, 0.1, control='D0'),
    ]
    bare = cell.copy()
    bare.calc = MagneticRepulsion(bare, law)
    edge = analytic_bands(bare, path).omega[-1, 0]
    checks.append(Check('chain without foundation, growth rate at X (1/s)', -edge * units.s,
                        reference_growth(law, L0, m) * units.s, 1e-9))
    ax = plot_bands(complete, ax=new_axes(), label='complete')
    plot_bands(conventional, ax=ax, linestyle='--', label='conventional')
    for name, place in (('longitudinal,\nboth models', (0.05, 0.7)), ('transverse', (0.05, 0.35))):
        ax.text(*place, name, transform=ax.transAxes)
    caption = 'The chain: the longitudinal band is the same in both models, the transverse band is not.'
    return Outcome(checks, [save_picture(ax.figure, out / 'chain.png', caption)])


def reference_growth(law, L0, m):
    """Growth rate of the zigzag at X without a foundation, `2 sqrt(f/(L0 m))`, in 1/ms."""
    return 2 * np.sqrt(-law.dphi(L0) / L0 / m)
