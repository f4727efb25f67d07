"""Gyration: a one-way wave along the edge that D0 alone predicts and the lattice does not have."""

import numpy as np
from ase.constraints import FixAtoms
from scipy.optimize import brentq

from magphonon import (
    InversePower,
    MagneticRepulsion,
    ToneBurst,
    analytic_bands,
    lattices,
    propagate,
    read_scene,
    units,
    verdict,
)
from magphonon.bands import band_gaps, bloch_modes, chern_numbers, edge_flow, edge_weights
from magphonon.plotting.axes import COLOURS, letter_panels, panels
from magphonon.plotting.bands import plot_edge_bands
from magphonon.scenes import ready_scene
from magphonon.stiffness import LinearSystem

from . import closed_forms
from .rows import Check, Outcome, Reported, pairs, save_picture

A, K, G = 4.0, 6.0, 1.55                # exponent, foundation over f/L, gyration over sqrt(f/(L m))
ROWS = 20                               # cells across the strip
CYCLES, FORCE = 60, 1e-6                # of the burst, which must fit into the gap; f
BESIDE = 5.0                            # L, from the source to where energy has travelled
HILL = 1.41, 1.42                       # gyration on either side of sqrt(2)
MODELS = {'complete': 3 * (A - 1), 'conventional': 3 * A}
"""Diagonal stiffness D in each model, in f/L: the three bonds of a particle of the honeycomb add up to D/2 along x and y."""


def main(out):
    """Closed forms, Chern numbers, a strip, a burst and a hill; the controls are D0 alone, or the other side of a threshold."""
    gaps = {model: band_gaps(honeycomb(G), 60, model)[1] for model in MODELS}
    return Outcome([*closing(), *numbers(), *edges(gaps), *bursts(gaps), *hill()], [bands_of_edges(out), waves(out, gaps)])


def with_magnets(atoms, g=G, model='complete'):
    """The structure with f = L = m = 1."""
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, A), foundation=K, gyration=g, model=model)
    return atoms


def honeycomb(g):
    """The unit cell of the honeycomb with f = L = m = 1."""
    return with_magnets(lattices.honeycomb(1.0, 1.0), g)


def closing():
    """The gyration at which the second and third branch meet at Gamma, sqrt(k + g^2/4) + g/2 = sqrt(k + 2 D + g^2/4) - g/2."""
    def gap(g, model):
        """A number that is positive as long as both magnets of the cell move alike in the second branch."""
        (omega,), (shapes,) = bloch_modes(honeycomb(g), np.zeros((1, 3)), model, vectors=True)
        alike = abs(shapes[1, 0] + shapes[1, 1]).max() > abs(shapes[1, 0] - shapes[1, 1]).max()
        return (omega[2] - omega[1]) * (1 if alike else -1)

    found = {model: brentq(gap, 1.0, 2.0, args=(model,), xtol=1e-12) for model in MODELS}
    formula = MODELS['complete'] / np.sqrt(4 * K + 2 * MODELS['complete'])
    return [Check('rate g at which the middle gap closes at Gamma, in sqrt(f/(L m))', found['complete'], formula, 1e-9),
            Check('control: D0 alone', found['conventional'], formula, 0.1, control='D0'),
            Check('D0 alone: this rate g, against the formula for D0', found['conventional'], 12 / np.sqrt(48), 1e-9)]


def numbers():
    """Chern numbers on both sides of the closing of the gap, from the lowest band up."""
    bands = 'first', 'second', 'third', 'fourth'
    here = chern_numbers(honeycomb(G)), chern_numbers(honeycomb(G), 'conventional')
    below, above = (np.round(closed_forms.chern(A, K, g), 9) for g in (1.0, G))
    return [*pairs('Chern number below, g = 1', chern_numbers(honeycomb(1.0)), below, 1e-9, bands),
            *pairs('Chern number above, g = 1.55', here[0], above, 1e-9, bands),
            Check('control: D0 alone, second band at g = 1.55', here[1][1], above[1], 0.5, control='D0')]


def edges(gaps):
    """The gap of the lattice, and the waves in this gap that run along the held edges of a strip."""
    strip = with_magnets(lattices.ribbon(lattices.honeycomb(1.0, 1.0), ROWS))
    flows = {model: edge_flow(strip, gap.mean(), model) for model, gap in gaps.items()}
    slope, ends = abs(flows['conventional'].velocity).mean() / strip.cell.lengths()[0], ('from', 'to')
    return [*pairs('middle gap', gaps['complete'], closed_forms.middle_gap(A, K, G), 1e-9, ends),
            *pairs('middle gap with D0 alone', gaps['conventional'], closed_forms.middle_gap(A, K, G, False), 1e-9, ends),
            Check('control: D0 alone, upper end of the middle gap', gaps['conventional'][1], closed_forms.middle_gap(A, K, G)[1],
                  1e-2, control='D0'),
            Check('waves along the edges of the strip within the gap', len(flows['complete'].q), 0, 1e-12),
            Check('control: D0 alone', len(flows['conventional'].q), 0, 0.5, control='D0'),
            Check('D0 alone: net number of waves along the right edge', flows['conventional'].right, 1, 1e-12),
            Check('D0 alone: net number of waves along the left edge', flows['conventional'].left, -1, 1e-12),
            Reported('D0 alone: speed of these waves d omega/dk / period of the strip', slope)]


def bursts(gaps):
    """A burst of 60 cycles on a magnet of the rim, in the middle of the gap: where its energy is when the burst ends."""
    shares = {model: burst(lattices.parallelogram(lattices.honeycomb(1.0, 1.0), 60, 10), gap.mean(), model)
              for model, gap in gaps.items()}
    (there, back, energy), with_dstar = shares['conventional'], shares['complete']
    travels = sum(with_dstar[:2]) * with_dstar[2] / energy
    return [Check('burst, D0 alone: share of its energy that does not run to the right', 1 - there, 0, 0.16),
            Check('burst, D0 alone: share of its energy that runs to the left', back, 0, 1e-3),
            Check('energy that travels with D* / energy that enters with D0 alone', travels, 0, 1e-3),
            Check('control: D0 alone: share of its energy that travels', there + back, 0, 0.4, control='D0')]


def burst(patch, omega, model):
    """Shares of the energy along the rim to the right and to the left of the source, and the whole energy."""
    place, source, energy = sent(patch, omega, model)
    along, inwards = (place - place[source]).T
    return *(energy[(inwards < BESIDE) & side].sum() / energy.sum() for side in (along > BESIDE, along < -BESIDE)), energy.sum()


def sent(patch, omega, model):
    """Positions, the source (in the middle of the lower rim), and the energy of each magnet at the end of the burst."""
    patch = with_magnets(patch, model=model)
    place = patch.positions[:, :2] - patch.positions[:, :2].mean(axis=0)
    free = np.flatnonzero(LinearSystem.of(patch, 'gyration').mobile)
    source = free[np.argmin(abs(place[free, 0]) + 10 * place[free, 1])]
    drive = ToneBurst(source, (0, 1), FORCE, omega, cycles=CYCLES)
    end = propagate(patch, [drive.end], [drive], tolerance=1e-6)
    u, v = end.displacements[0], end.velocities[0]
    H = patch.calc.rest_hessian(model)
    return place, source, ((v**2).sum(axis=1) + (u * (H @ u.ravel()).reshape(u.shape)).sum(axis=1)) / 2


def hill():
    """One free magnet on a hill of stiffness -1/2, which is stable by gyration for g above sqrt(2)."""
    atoms = lattices.square(1.0, 1.0).repeat((3, 3, 1))
    atoms.pbc = False
    atoms.set_constraint(FixAtoms([n for n in range(9) if n != 4]))
    held = []
    for g in HILL:
        atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 0.5), foundation=0.5, gyration=g)
        held.append(verdict(atoms).stable)
    return [Check(f'a hill of stiffness -1/2, g = {g}: verdict stable', stable, expected, 1e-12)
            for g, stable, expected in zip(HILL, held, (0, 1), strict=True)]


def bands_of_edges(out):
    """Draw bands of a strip of the ready scene, with D0 alone and with the static forces."""
    cell = read_scene(ready_scene('gyro')).atoms()
    strip, calc = lattices.ribbon(cell, 20), cell.calc
    strip.calc = MagneticRepulsion(strip, calc.laws, foundation=calc.foundation, gyration=calc.gyration)
    path = strip.cell.bandpath([[-0.5, 0, 0], [0.5, 0, 0]], npoints=81, pbc=strip.pbc)
    figure, axes = panels(1, 2, height=3.0)
    letter_panels(axes, ['$D^0$ alone', '$D^0+D^{*}$'])
    for ax, model in zip(axes.flat, ('conventional', 'complete'), strict=True):
        bands = analytic_bands(strip, path, model, vectors=True)
        plot_edge_bands(bands, edge_weights(strip, bands, depth=3.1 * calc.bonds.lengths.min()), ax=ax)
        low, high = units.hertz(band_gaps(cell, 60, model)[1])
        ax.axhspan(low, high, color=COLOURS[2], alpha=0.25, linewidth=0)
        ax.set(ylim=(4.1, 5.4), xlabel='$k_x L_x$')
        ax.set_xticks(bands.path.get_linear_kpoint_axis()[0][::40], ['$-\\pi$', '0', '$\\pi$'])
    axes.flat[1].get_legend().remove()
    axes.flat[1].set_ylabel('')
    return save_picture(figure, out / 'gyration_edges.png',
                        'Magnets on a bench that turns 72 times a minute: bands of a strip with held edges around the '
                        'second gap of the lattice (shaded). With D0 alone one wave along each edge crosses the gap; with the '
                        'static forces none does.')


def waves(out, gaps):
    """Draw where in a hexagon the energy of the burst is when it ends."""
    figure, axes = panels(1, 2, height=3.2)
    largest = None
    letter_panels(axes, ['$D^0$ alone', '$D^0+D^{*}$'])
    for ax, model in zip(axes.flat, ('conventional', 'complete'), strict=True):
        place, source, energy = sent(lattices.hexagon(lattices.honeycomb(1.0, 1.0), 15.0), gaps[model].mean(), model)
        largest = np.sqrt(energy.max()) if largest is None else largest
        dots = ax.scatter(*place.T, c=np.sqrt(energy) / largest, s=14, cmap='Blues', vmin=0, vmax=1, edgecolors='0.6',
                          linewidths=0.2)
        ax.plot(*place[source], marker='*', markersize=9, color=COLOURS[1], markeredgecolor='k', markeredgewidth=0.5)
        ax.set(aspect='equal', xlabel='$x/L$', ylabel='$y/L$')
    figure.colorbar(dots, ax=axes, shrink=0.8, label='amplitude, share of the largest in (a)')
    return save_picture(figure, out / 'gyration_wave.png',
                        'The same burst of 60 cycles on one magnet of the rim (star), in the middle of the gap of each model: '
                        '(a) D0 alone sends it one way round the rim; (b) with the static forces nothing travels.')
