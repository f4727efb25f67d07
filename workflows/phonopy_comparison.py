"""phonopy compared with the analytic stiffness: force constants, D*, the foundation, and the error against the displacement."""

import numpy as np

from magphonon import analytic_bands, finite_displacements, phonopy_bands, read_scene
from magphonon.bands import extracted_dstar
from magphonon.plotting.axes import COLOURS, legend_above, new_axes
from magphonon.scenes import ready_scene
from magphonon.stiffness.matrices import bond_stiffness

from .rows import Check, Outcome, save_picture


def main(out):
    """Both methods on the prototype, each with a control, and the error against the displacement."""
    cell = read_scene(ready_scene('prototype')).atoms()
    path = cell.cell.bandpath('GMKG', npoints=60, pbc=cell.pbc)
    phonon = finite_displacements(cell)
    exact = analytic_bands(cell, path).omega
    D0, Dstar = bond_stiffness(cell.calc.bonds.vectors[:, :2], cell.calc.laws)
    extracted = extracted_dstar(phonon, cell)
    checks = [
        Check('phonopy bands - analytic, largest difference / highest frequency', deviation(phonon, path, exact), 0.0, 1e-8,
              by='two methods'),
        Check('D* from phonopy - analytic D*, largest entry / phi"', abs(extracted - Dstar).max() / abs(D0).max(), 0.0, 1e-8,
              by='two methods'),
        Check('control: phonopy bands - D0 alone, largest difference / highest frequency',
              deviation(phonon, path, analytic_bands(cell, path, 'conventional').omega), 0.0, 0.1, control='D0',
              by='two methods'),
    ]
    symmetrised = phonon.replicate()
    symmetrised.force_constants = phonon.force_constants.copy()
    symmetrised.symmetrize_force_constants()
    gap = phonopy_bands(symmetrised, path).omega[0, 0] / exact[0, 0]
    checks.append(Check('control: cut-off left by symmetrised force constants / true', gap, 1.0, 0.5,
                        control='symmetrised force constants'))

    shortest = cell.calc.bonds.lengths.min()
    distances = shortest * np.logspace(-9, -1.3, 24)
    errors = np.array([deviation(finite_displacements(cell, distance=d), path, exact) for d in distances])
    slope = np.polyfit(*np.log([distances[-5:], errors[-5:]]), 1)[0]
    rise = np.polyfit(*np.log([distances[:8], errors[:8]]), 1)[0]
    checks.append(Check('slope of the error above its floor', slope, 2.0, 0.05))  # next term: (d/L0)^2, 1e-2 at most
    checks.append(Check('slope of the error below its floor', rise, -1.0, 0.2))  # round-off scatters
    return Outcome(checks, [draw(out, distances / shortest, errors)])


def deviation(phonon, path, exact):
    """Largest difference of phonopy's frequencies from the exact ones, relative to the highest."""
    return abs(phonopy_bands(phonon, path).omega - exact).max() / exact.max()


def draw(out, d, errors):
    """Draw the error of phonopy's bands against the displacement, with its two asymptotes."""
    ax = new_axes()
    ax.loglog(d, errors, 'o', color=COLOURS[0], label='phonopy against analytic')
    ax.loglog(d[-12:], errors[-1] * (d[-12:] / d[-1]) ** 2, '--', color=COLOURS[1], label=r'$(d/L_0)^2$: curvature')
    ax.loglog(d[:12], errors[0] * d[0] / d[:12], ':', color=COLOURS[2], label=r'$1/d$: round-off')
    ax.axvline(1e-5, color='0.6', lw=0.8, label='default')
    ax.set(xlabel=r'displacement $d/L_0$', ylabel='largest error / highest frequency')
    legend_above(ax, ncols=2)
    return save_picture(ax.figure, out / 'displacement.png',
                        'The error of the frequencies from phonopy, as a function of the size of the displacements.')
