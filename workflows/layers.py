"""Motion out of the plane: a branch due to supports and D* alone, for grains, upright magnets, and a plasma crystal."""

import numpy as np
from scipy.optimize import brentq

from magphonon import (
    DrivenVerlet,
    InversePower,
    MagneticRepulsion,
    analytic_bands,
    finite_displacements,
    lattices,
    phonopy_bands,
    units,
    verdict,
)
from magphonon.bands import band_path
from magphonon.interactions import UprightMagnets, Yukawa
from magphonon.interactions.magnet_pairs import magnet_law, pair_force
from magphonon.interactions.magnets import Ring
from magphonon.plotting.axes import COLOURS, legend_above, new_axes
from magphonon.plotting.bands import label_path
from magphonon.stiffness import AllNeighbours
from magphonon.stiffness.matrices import MODELS

from .closed_forms import plasma_layer
from .rows import Check, Outcome, pairs, save_picture

L0, MASS = 10.0, 0.7                   # mm, g
LAW = InversePower(b=6000.0, a=4.0)    # of dipoles, N mm^a
IN_PLANE = 0.05                        # N/mm
KAPPA = 1.0                            # of the plasma crystal that is drawn
SUPPORTS = 6.0, 4.1517, 3.2            # its trap, over the unit of frequency: above, at and below the gate
RING = Ring(6.35, 1.5875, 3.175, 1.3 * units.T)  # mm: the paper's, 1/4 x 1/16 x 1/8 inch
STEP = 1e-3                            # mm, of the height of one ring over another
GROWTH_STEPS, GROWTH_DT = 400, 0.02    # ms


def main(out):
    """Each known result, with a wrong model that must fail it."""
    return Outcome([*triangular_lattice(), *upright_magnets(), *threshold(), *plasma_crystal()], [picture(out)])


def layer(law, support):
    """A triangular lattice whose particles move out of their plane, on supports of that stiffness in N/mm."""
    atoms = lattices.triangular(L0, MASS)
    atoms.calc = MagneticRepulsion(atoms, law, foundation=[[IN_PLANE, IN_PLANE, support]])
    return atoms


def triangular_lattice():
    """Nearest neighbours and a force along the bond: omega_z^2 drops by 9 f/(L m) at K; phonopy finds the same bands."""
    atoms = layer(LAW, 1.5)
    force = -LAW.dphi(L0)
    K = np.array([[2 / 3, 1 / 3, 0]])
    drops = [1.5 - atoms.calc.bloch_matrix(K, model)[0, 2, 2].real for model in ('complete', 'conventional')]
    path = band_path(atoms, 'GMKG', 61)
    squares = [bands.omega ** 2 for bands in (analytic_bands(atoms, path), phonopy_bands(finite_displacements(atoms), path),
                                              analytic_bands(atoms, path, 'conventional'))]
    apart = [abs(other - squares[0]).max() / squares[0].max() for other in squares[1:]]
    return [Check('triangular layer, central force: drop of omega_z^2 at K, in f/(L m)', drops[0] * L0 / force, 9.0, 1e-9),
            Check('control: drop of omega_z^2 at K without D*', drops[1] * L0 / force, 9.0, 0.5, control='D0'),
            Check('phonopy against the Bloch matrix, share of the highest squared frequency', apart[0], 0.0, 1e-8,
                  by='two methods'),
            Check('control: phonopy against D0 and the supports', apart[1], 0.0, 1e-2, control='D0')]


def upright_magnets():
    """Laplace's equation: upright dipoles push out of the plane three times as strongly as a force along the bond."""
    force = -LAW.dphi(L0)
    law = UprightMagnets(magnet_law(RING))
    ends = [pair_force(RING, RING, (L0, 0, z))[2] for z in (STEP, -STEP)]
    stiffness = -(ends[0] - ends[1]) / (2 * STEP)
    D = layer(UprightMagnets(LAW), 1.5).calc.bloch_matrix(np.array([[2 / 3, 1 / 3, 0]]))
    return [Check('triangular layer, upright dipoles: drop of omega_z^2 at K, in f/(L m)',
                  (1.5 - D[0, 2, 2].real) * L0 / force, 27.0, 1e-9),
            Check("rings: stiffness of a pair out of the plane by Laplace's equation, N/mm", law.vertical(L0), stiffness, 1e-6,
                  by='two methods'),
            Check("control: phi'/r, as of a force along the bond", law.planar.dphi(L0) / L0, stiffness, 0.3,
                  control='a force along the bond')]


def threshold():
    """Supports that are one tenth too soft for the wave at K: the growth of this wave in a run."""
    needed = 9 * -LAW.dphi(L0) / L0
    stable = [verdict(layer(LAW, factor * needed)).stable for factor in (1.001, 0.999)]
    grown = {model: growth(layer(LAW, 0.9 * needed), model) for model in MODELS}
    exact = np.cosh(np.sqrt(0.1 * needed / MASS) * GROWTH_STEPS * GROWTH_DT)
    return [Check('supports 0.1 % stiffer than 9 f/L: verdict stable', stable[0], 1, 1e-9),
            Check('supports 0.1 % softer: verdict stable', stable[1], 0, 1e-9),
            Check('supports 10 % softer: growth of the wave at K in time steps / cosh', grown['complete'] / exact, 1.0, 1e-3),
            Check('control: this growth in time steps of D0 alone / cosh', grown['conventional'] / exact, 1.0, 0.3, control='D0')]


def growth(cell, model):
    """Amplitude of the wave at K out of the plane at the end of a run, over that at the start."""
    atoms = cell.repeat((3, 3, 1))
    atoms.calc = cell.calc.on(atoms)
    atoms.calc.set(model=model)
    wave = np.cos(2 * np.pi * (atoms.get_scaled_positions() @ [2, 1, 0]))
    atoms.positions[:, 2] += 1e-5 * wave
    DrivenVerlet(atoms, GROWTH_DT).run(GROWTH_STEPS)
    return atoms.positions[:, 2] @ wave / (wave @ wave) / 1e-5


def plasma_crystal():
    """A 2-D Yukawa crystal, all neighbours: the branch at M and K, and the trap at which it touches the longitudinal one."""
    rows = []
    for kappa in (1.0, 3.0):
        _, path, plane, drop = plasma(kappa)
        longitudinal, (at_M, at_K) = plasma_layer(kappa, [[0.5, 0], [2 / 3, 1 / 3]])
        gate = np.sqrt(longitudinal[0] + at_M)  # they touch at M
        rows += pairs(f'plasma crystal, kappa = {kappa:g}, drop of omega_z^2', drop[special(path, 'MK')], [at_M, at_K],
                      1e-9, 'MK')
        touch = brentq(lambda trap: (trap**2 - drop - plane).min(), 1.0, 8.0)  # noqa: B023  used at once
        rows.append(Check(f'trap at which its branch touches the longitudinal one, kappa = {kappa:g}', touch, gate, 1e-9))
        where = path.kpts[(touch**2 - drop - plane).argmin()]
        apart = abs(where - path.special_points['M']).max()
        rows.append(Check('distance from M of the wavevector where they touch', apart, 0.0, 1e-9))
        near = lattices.triangular(1.0, 1.0)
        near.calc = MagneticRepulsion(near, Yukawa(1.0, kappa), foundation=[[0, 0, 1.0]])
        few = 1.0 - near.calc.bloch_matrix(path.kpts[special(path, 'K')])[0, 2, 2].real
        rows.append(Check('control: the drop at K with nearest neighbours alone', few, at_K, 5e-3, control='nearest neighbours'))
    return rows


def plasma(kappa, trap=0.0):
    """The crystal, a path, and along it the squared longitudinal branch and the drop of the branch out of the plane."""
    atoms = lattices.triangular(1.0, 1.0)
    atoms.calc = AllNeighbours(atoms, Yukawa(c=1.0, kappa=kappa), foundation=[[0, 0, trap**2]])
    path = band_path(atoms, 'GMKG', 121)
    D = atoms.calc.bloch_matrix(path.kpts)
    return atoms, path, np.linalg.eigvalsh(D[:, :2, :2])[:, 1], trap**2 - D[:, 2, 2].real


def special(path, names):
    """Distances along a path at which it meets its special points."""
    return [abs(path.kpts - path.special_points[name]).max(axis=1).argmin() for name in names]


def picture(out):
    """Draw the bands of the plasma crystal for three traps; in one, the two branches just touch."""
    ax = new_axes()
    _, path, _, _ = plasma(KAPPA)
    x = path.get_linear_kpoint_axis()[0]
    for number, (trap, style) in enumerate(zip(SUPPORTS, ('-', '--', ':'), strict=True)):
        atoms, path, _, drop = plasma(KAPPA, trap)
        if number == 0:
            plane = np.linalg.eigvalsh(atoms.calc.bloch_matrix(path.kpts)[:, :2, :2])
            ax.plot(x, np.sqrt(plane.clip(0)), color=COLOURS[0], label=['in the plane', None])
        ax.plot(x, np.sqrt(trap**2 - drop), style, color=COLOURS[1], label=rf'out of it, $\Omega_z = {trap:.2f}$')
    label_path(ax, path)
    ax.set(ylim=(0, None), ylabel=r'$\omega/\omega_0$')
    for name, place in (('longitudinal', (0.27, 0.4)), ('shear', (0.16, 0.06))):
        ax.text(*place, name, transform=ax.transAxes)
    legend_above(ax, ncols=2)
    return save_picture(ax.figure, out / 'layers.png',
                        'A plasma crystal (kappa = 1, all neighbours, omega_0^2 = Q^2/(4 pi epsilon_0 m a^3)): as the trap '
                        'softens, the branch out of the plane comes down, touches the longitudinal branch at M and crosses it. '
                        'Without D* the branch out of the plane would be flat.')
