"""All neighbours: exact lattice sums, the error of the nearest-neighbour assumption, and the rest positions of truncated
lattices.
"""

from dataclasses import replace

import numpy as np

from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices, read_scene, relaxed, units
from magphonon.bands import bloch_modes, sound_speeds
from magphonon.interactions import Yukawa
from magphonon.interactions.pair_laws import repulsion
from magphonon.plotting.axes import COLOURS, legend_above, new_axes
from magphonon.plotting.bands import plot_bands
from magphonon.scenes import ready_scene, reference
from magphonon.stiffness import AllNeighbours
from magphonon.stiffness.ewald import lattice_sum

from .rows import BRANCHES, Check, Outcome, Reported, pairs, save_picture

M = np.array([0.5, 0, 0])
AS_BUILT = 'as built: {} (Hz), {}'
"""Name of a row of the table "the paper's model, and the lattice as built" in the report."""
EFFECTS = {'paper': "the paper's model", 'neighbours': 'all neighbours', 'mass': 'mass of the pillars',
           'all': 'both together'}
PLACES = ('cut-off', 0, 0), ('M, shear', 1, 0), ('M, longitudinal', 1, 1), ('K', 2, 0)
MAGNIFIED = 50  # displacements in the picture of the relaxed patch
RADII = np.array([1.2, 1.8, 2.2, 2.8, 3.2, 4.2, 5.7, 7.7, 10.3, 14.2, 20.3, 28.3])  # in spacings, between shells


def main(out):
    """Sums against closed forms; the prototype with all neighbours and the mass of its pillars; shells and patches."""
    known = reference()['all_neighbours']
    checks = [*_closed_forms(known), *_prototype(known), *_as_built(known)]
    patch, rest = _relaxation()
    f = repulsion(patch.calc.laws, 10 * units.mm)
    checks += [Check('control: force left on a row inside the rim, third neighbours, unrelaxed (f(L0))', rest.before / f, 0, 0.1,
                     control='magnets that stay in place'),
               Check('force left on this row once relaxed (f(L0))', rest.after / f, 0, 1e-9)]
    return Outcome(checks, [_draw_shells(out), _draw_prototype(out), _draw_relaxation(out, patch, rest)])


def _closed_forms(known):
    cell, chain = lattices.triangular(1.0, 1.0), lattices.chain(1.0, 1.0)
    dipoles = InversePower(b=3.0, a=4.0)
    chain.calc = MagneticRepulsion(chain, dipoles)
    nearest = sound_speeds(chain)[1] ** 2, bloch_modes(chain, [M])[0][0, 1] ** 2
    cell.calc, chain.calc = AllNeighbours(cell, dipoles), AllNeighbours(chain, dipoles)
    c_T, c_L = sound_speeds(cell)
    other = AllNeighbours(cell, dipoles, split=1.4).bloch_matrix(np.array([[0.2, 0.1, 0]]))
    ours = cell.calc.bloch_matrix(np.array([[0.2, 0.1, 0]]))
    return [
        Check('sum of r^-3 over the triangular lattice', lattice_sum(cell, 3), known['S_3_triangular'], 1e-14),
        Check('dipole crystal c_L^2', c_L**2, known['dipole_c_L_squared'], 1e-11),
        Check('dipole crystal c_T^2', c_T**2, known['dipole_c_T_squared'], 1e-11),
        Check('dipole crystal c_L/c_T, sqrt(11)', c_L / c_T, 11**0.5, 1e-11),
        Check('dipole chain, c^2 / that of nearest neighbours, zeta(3)', sound_speeds(chain)[1] ** 2 / nearest[0],
              known['dipole_chain_c_squared'], 1e-12),
        Check('dipole chain, omega^2 at X / that of nearest neighbours, 31/32 zeta(5)',
              bloch_modes(chain, [M])[0][0, 1] ** 2 / nearest[1], known['dipole_chain_edge_squared'], 1e-12),
        Check('Bloch matrix with another split of the sums, relative difference',
              abs(ours - other).max() / abs(ours).max(), 0, 1e-11,
              by='two methods'),
    ]


def _prototype(known):
    scene = read_scene(ready_scene('neighbours'))
    nearest, heavier = read_scene(ready_scene('prototype')).atoms(), scene.atoms()
    everyone = _without_pillars(heavier, nearest)
    direct, law = nearest.copy(), nearest.calc.laws
    direct.calc = MagneticRepulsion(direct, law, foundation=nearest.calc.parameters.foundation, cutoff=303 * units.mm)
    shear = [at_M(atoms)[0] for atoms in (nearest, everyone, direct)]
    share = heavier.get_masses()[0] / everyone.get_masses()[0] - 1
    return [
        *pairs('prototype M, all neighbours (Hz)', at_M(everyone), known['prototype_M_Hz'], 1e-9, BRANCHES),
        Check('M shear, direct sum over 30 spacings (Hz)', shear[2], known['prototype_M_Hz'][0], 1e-4),
        Check('control: M shear of nearest neighbours (Hz)', shear[0], known['prototype_M_Hz'][0], 0.05,
              control='nearest neighbours'),
        Check('moving mass of the pillar / mass of the magnet', share, known['pillar_share'], 1e-3),
        *(Reported(f'{branch} at M, all neighbours and the pillars\' mass / the paper\'s model', ratio, 1)
          for branch, ratio in zip(('shear', 'longitudinal'), at_M(heavier, scene.foundation) / at_M(nearest), strict=True)),
    ]


def _as_built(known):
    """The prototype's frequencies with each single effect that the paper's model omits, and with all of them."""
    nearest, heavier = read_scene('prototype'), read_scene('neighbours')
    cells = {'paper': nearest.perfect_cell(), 'neighbours': _without_pillars(heavier.perfect_cell(), nearest.cell()),
             'mass': _without_pillars(nearest.perfect_cell(), heavier.cell()), 'all': heavier.perfect_cell()}
    points = [np.zeros(3), M, nearest.special_points['K']]
    omega = {effect: bloch_modes(atoms, points)[0] for effect, atoms in cells.items()}
    heavy = {effect: heavier.foundation.slowed(omega[effect], heavier.cell().get_masses()) for effect in ('mass', 'all')}
    found = {effect: units.hertz(one) for effect, one in (omega | heavy).items()}
    rows = [Reported(AS_BUILT.format(name, effect), found[effect][where, branch], found['paper'][where, branch])
            for name, where, branch in PLACES for effect in cells]
    return [*rows,
            Check('mass of pillars: cut-off / that of the paper', found['mass'][0, 0] / found['paper'][0, 0],
                  known['pillar_cut_off'], 1e-5)]


def at_M(atoms, pillars=None):
    """Frequencies of shear and of longitudinal waves at M in Hz, on springs or on heavy pillars."""
    omega = bloch_modes(atoms, [M])[0][0]
    return units.hertz(omega if pillars is None else pillars.slowed(omega, atoms.get_masses()))


def _without_pillars(atoms, others):
    """A copy of the cell with other masses."""
    lighter = atoms.copy()
    lighter.calc = atoms.calc
    lighter.set_masses(others.get_masses())
    return lighter


def _draw_shells(out):
    """Error of the shear frequency at M against the distance up to which neighbours are counted, for laws of different range."""
    laws = {'$r^{-2}$ (screened 100 $L_0$)': Yukawa(1.0, 0.01), 'dipoles, $r^{-4}$': InversePower(1.0, 4.0),
            'prototype, $r^{-4.58}$': InversePower(1.0, 4.5824), 'Yukawa, $\\kappa L_0 = 1$': Yukawa(1.0, 1.0)}
    ax = new_axes()
    for k, (label, law) in enumerate(laws.items()):
        cell = lattices.triangular(1.0, 1.0)
        cell.calc = AllNeighbours(cell, law)
        exact = bloch_modes(cell, [M])[0][0, 0]
        errors = []
        for radius in RADII:
            cell.calc = MagneticRepulsion(cell, law, cutoff=radius)
            errors.append(abs(bloch_modes(cell, [M])[0][0, 0] / exact - 1))
        ax.loglog(RADII, errors, marker='osD^'[k], color=COLOURS[k], linestyle=('-', '--', ':', '-.')[k], label=label)
    ticks = (1, 2, 3, 5, 10, 20, 30)
    ax.set_xticks(ticks, map(str, ticks))
    ax.set_xticks([], minor=True)
    ax.set(xlabel='neighbours up to (spacings)', ylabel='error of the shear frequency at M', ylim=(1e-12, 3))
    legend_above(ax, ncols=2)
    return save_picture(ax.figure, out / 'shells.png', 'The error made by counting neighbours only up to a distance R. It '
                                                       'falls like R^(1-a) for forces r^-a, and exponentially for screened '
                                                       'forces.')


def _draw_prototype(out):
    scene = read_scene(ready_scene('neighbours'))
    nearest, heavier = read_scene(ready_scene('prototype')).atoms(), scene.atoms()
    cells = {'nearest neighbours (the paper)': nearest, 'all neighbours': _without_pillars(heavier, nearest),
             'all neighbours, mass of the pillars': heavier}
    ax = new_axes()
    for (label, atoms), style in zip(cells.items(), ('-', '--', '-.'), strict=True):
        bands = analytic_bands(atoms, scene.band_path())
        if atoms is heavier:
            bands = replace(bands, omega=scene.foundation.slowed(bands.omega, atoms.get_masses()))
        plot_bands(bands, ax=ax, linestyle=style, label=label)
    legend_above(ax, ncols=1)
    return save_picture(ax.figure, out / 'prototype_neighbours.png',
                        'What the model of the prototype omits: all neighbours raise the shear branch at M from 58.2 to 67.5 Hz; '
                        'the mass of the pillars, of which 27 % of the mass of a magnet moves, lowers it again, to 59.7 Hz.')


def _relaxation():
    prototype = read_scene(ready_scene('prototype')).atoms()
    patch = lattices.hexagon(prototype, 70 * units.mm)
    patch.calc = MagneticRepulsion(patch, prototype.calc.laws, shells=3, foundation=prototype.calc.parameters.foundation)
    return patch, relaxed(patch)


def _draw_relaxation(out, patch, rest):
    ax = new_axes(height=3.3)
    x, y = patch.positions[:, :2].T / units.mm
    held = patch.get_tags() == lattices.RIM
    dx, dy = (rest.atoms.positions - patch.positions)[~held, :2].T
    ax.plot(x[held], y[held], 's', color='0.5', zorder=4, label='held')
    ax.plot(x[~held], y[~held], 'o', color='k', markersize=2.5, label='free')
    look = {'angles': 'xy', 'scale_units': 'xy', 'scale': 1, 'width': 0.006}
    ax.quiver(x[~held], y[~held], MAGNIFIED * dx, MAGNIFIED * dy, color=COLOURS[1], zorder=3, **look)
    ax.plot([], [], linestyle='', marker=r'$\rightarrow$', color=COLOURS[1], markersize=9,
            label=rf'displacement $\times$ {MAGNIFIED}')
    ax.set(xlabel='$x$ (mm)', ylabel='$y$ (mm)', aspect='equal')
    legend_above(ax)
    return save_picture(ax.figure, out / 'relaxation.png',
                        'A patch of the prototype whose magnets repel up to third neighbours: the held rim is one row only, '
                        f'so the rows inside it move, by {rest.shift:.2g} mm at most.')
