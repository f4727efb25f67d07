"""Packings: a ten-thousandth of a contact halves the shear modulus.  `python -m workflows.packings [-o DIR] [SPHERES [SEEDS]]`

Discs of two sizes, 1 to 1.4, half and half, are packed at pressures from 1e-1 to 1e-4 of an energy per mean diameter squared.
The table has the means over the seeds; the printed number is that of C. C. Sartor, S. A. Ridout and E. I. Corwin,
arXiv:2006.09592: their pressure is made dimensionless by the mean volume of a particle and by the energy eps of
`U = eps (1 - r/d)^2`, and rises by 1.23/dim with the share of space beyond jamming.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from magphonon.interactions import Overlap
from magphonon.plotting.axes import COLOURS, legend_of_set, letter_panels, panels, print_style
from magphonon.stability import prestress_reserve
from magphonon.stiffness import elastic_moduli, packing

from .rows import save_picture

PRESSURES = np.geomspace(1e-1, 1e-4, 7)
MODELS = 'conventional', 'complete'
SHOWN = {2: 1.0, 6: 0.4}  # the pressures 1e-2 and 1e-4 whose densities of states are drawn, and how boldly
PRINTED = 1.23


@dataclass(frozen=True)
class State:
    """One packing at one pressure, in energies of a contact and mean diameters."""

    excess: float  # contacts of a sphere beyond the fewest
    fraction: float
    shear: dict  # of both models
    weak: float  # mean of D* over D0 of a contact
    factor: float  # on D*, at which it collapses
    omega: dict  # natural frequencies of both models
    volume: float  # mean of the spheres

    @classmethod
    def of(cls, found):
        calc, n, dim = found.atoms.calc, len(found.atoms), found.atoms.calc.dim
        r = calc.bonds.lengths
        hessians = {model: calc.rest_hessian(model).toarray() for model in MODELS}
        return cls(2 * found.contacts / n - 2 * dim + 2 * dim / n, found.fraction,
                   {model: elastic_moduli(found.atoms, model).shear for model in MODELS},
                   float((-calc.law.dphi(r) / r / calc.law.d2phi(r)).mean()), prestress_reserve(found.atoms).factor,
                   {model: np.sqrt(np.maximum(np.linalg.eigvalsh(H)[dim:], 0)) for model, H in hessians.items()},
                   float(np.pi * (found.radii**2).mean()))


def ladder(spheres, seed):
    """The states of one packing, as it becomes looser."""
    radii, states, found = np.where(np.arange(spheres) % 2, 1.4, 1.0) / 2.4, [], None
    for pressure in PRESSURES:
        found = packing(radii, pressure, Overlap(1.0), seed) if found is None else found.at(pressure)
        states.append(State.of(found))
    return states


def exponent(values):
    """Slope of logarithms over those of the pressure, below its scaling limit of 1e-2."""
    return np.polyfit(np.log(PRESSURES[2:]), np.log(values[2:]), 1)[0]


def table(every):
    """Lines of text: the means over the seeds at each pressure, and what follows from them."""
    def mean(of):
        return np.array([[of(state) for state in states] for states in every]).mean(axis=0)

    excess, phi, G0, G = (mean(of) for of in (lambda s: s.excess, lambda s: s.fraction, lambda s: s.shear['conventional'],
                                              lambda s: s.shear['complete']))
    weak, factor = mean(lambda s: s.weak), mean(lambda s: s.factor)
    lines = ['pressure   contacts beyond the fewest   G of D0   G of D0 + D*   share of D* in G   D*/D0 of a contact   '
             'collapses at']
    lines += [f'{p:8.1e}   {z:26.3f}   {g0:7.4f}   {g:12.4f}   {1 - g / g0:16.2f}   {w:18.1e}   {f:7.2f} D*'
              for p, z, g0, g, w, f in zip(PRESSURES, excess, G0, G, weak, factor, strict=True)]
    rise = 2 * np.diff(2 * PRESSURES[-2:] * every[0][0].volume)[0] / np.diff(phi[-2:])[0]  # eps is half of the energy here
    return [*lines, '', f'exponents of the pressure: contacts {exponent(excess):.3f}, G of D0 {exponent(G0):.3f}, G of D0 + D* '
            f'{exponent(G):.3f} (1/2 each in a large packing)',
            f'pressure over the share of space beyond jamming, times dim: {rise:.3f} (printed: {PRINTED})',
            f'share of space at jamming: {phi[-1] - (phi[-2] - phi[-1]) / (np.sqrt(10) - 1):.4f}']


def draw(every, out):
    """Three panels: contacts and G against pressure, densities of states, and the share of G that D* takes."""
    figure, axes = panels(1, 3, width=7.0, height=2.6)
    letter_panels(axes.ravel())
    left, middle, right = axes.ravel()

    def mean(of):
        return np.mean([[of(state) for state in states] for states in every], axis=0)

    left.loglog(PRESSURES, mean(lambda s: s.excess), 'ko-', markersize=3.5)
    left.annotate('contacts beyond\nthe fewest', (PRESSURES[3], mean(lambda s: s.excess)[3]), (-4, 4), textcoords='offset points',
                  ha='right', fontsize='small')
    left.annotate('$G$', (PRESSURES[3], mean(lambda s: s.shear['complete'])[3]), (6, -12), textcoords='offset points')
    edges, lines = np.linspace(0, 2.6, 27), []
    for model, line, colour in (('conventional', 's--', COLOURS[1]), ('complete', 'd-', COLOURS[0])):
        lines += left.loglog(PRESSURES, mean(lambda s, model=model: s.shear[model]), line, color=colour, markersize=3.5)
        for k, shade in SHOWN.items():
            omega = np.concatenate([states[k].omega[model] for states in every])
            density = np.histogram(omega, edges)[0] / len(omega) / np.diff(edges)
            middle.plot((edges[1:] + edges[:-1]) / 2, density, line[1:], color=colour, alpha=shade)
    left.set(xlabel='pressure (energy/diameter$^2$)', ylabel='per disc; energy/diameter$^2$')
    middle.set(xlabel='frequency (rad per unit of time)', ylabel='density of states', ylim=(0, None))
    middle.annotate('pale: 1e-4, full: 1e-2', (0.03, 0.97), xycoords='axes fraction', va='top', fontsize='small')
    for states in every:
        right.semilogx([s.weak for s in states], [1 - s.shear['complete'] / s.shear['conventional'] for s in states], 'o',
                       color=COLOURS[0], markersize=3)
    across = np.geomspace(3e-5, 0.3, 50)
    right.semilogx(across, across, ':', color='0.4')
    right.annotate('as much as in a contact', (0.04, 0.04), (-4, 6), textcoords='offset points', ha='right', fontsize='small')
    right.set(xlabel='$D^{*}/D^0$ of a contact', ylabel='share of $D^{*}$ in $G$', ylim=(0, 1))
    legend_of_set(figure, handles=lines, labels=['$D^0$', '$D^0+D^{*}$'])
    return save_picture(figure, out / 'packings.png',
                        'Packed discs: D* is a ten-thousandth of a contact, and takes half of the shear modulus.')


def main(arguments=None):
    """Pack, print the table, draw."""
    parser = argparse.ArgumentParser(prog='python -m workflows.packings', description=__doc__.partition('\n')[0])
    parser.add_argument('spheres', type=int, nargs='?', default=1024)
    parser.add_argument('seeds', type=int, nargs='?', default=4)
    parser.add_argument('-o', '--out', type=Path, default=Path('out'), metavar='DIR')
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    every = [ladder(options.spheres, seed) for seed in tqdm(range(options.seeds), desc='packings', disable=None)]
    print(f'{options.spheres} discs, means over {options.seeds} packings\n')
    print('\n'.join(table(every)))
    with print_style():
        draw(every, options.out)


if __name__ == '__main__':
    main()
