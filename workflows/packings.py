"""Packings: a ten-thousandth of a contact halves the shear modulus.  `python -m workflows.packings [-o DIR] [SPHERES [SEEDS]]`

Discs of two sizes, 1 to 1.4, half and half, are packed at pressures from 1e-1 to 1e-4 of an energy per mean diameter squared, and
so are discs with Hertz' law, and spheres.  Standard errors over the seeds are in brackets.  C. C. Sartor, S. A. Ridout and E. I.
Corwin, arXiv:2006.09592, print that pressures (times the mean volume of a particle, over eps of `U = eps (1 - r/d)^2`) rise by
1.23/dim with the share of space beyond jamming, and that contacts beyond the fewest, each counted once, are 0.74 dim 2^(dim/2)
times their root (so the supplement; the main text divides by the power of two, which does not fit its number).
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
SPECTRA = {2: 1.0, 4: 0.7, 6: 0.4}  # the pressures 1e-2, 1e-3 and 1e-4 whose densities of states are drawn, and how boldly
PLATEAU = 0.05, 0.25  # the shares of modes on the plateau of the density of states, through which its onset is found


@dataclass(frozen=True)
class State:
    """One packing at one pressure, in energies of a contact and mean diameters."""

    excess: float  # contacts of a sphere beyond the fewest
    fraction: float
    shear: tuple  # by D0 and by D0 + D*
    bulk: float
    weak: float  # mean of D* over D0 of a contact
    factor: float  # on D*, at which it collapses
    strain: float  # of shear, at which the first contact opens or closes
    omega: list  # natural frequencies by D0 and by D0 + D*
    volume: float  # mean of the spheres

    @classmethod
    def of(cls, found, spectra):
        calc, n, dim = found.atoms.calc, len(found.atoms), found.atoms.calc.dim
        r, moduli = calc.bonds.lengths, [elastic_moduli(found.atoms, model) for model in MODELS]
        hessians = [calc.rest_hessian(model).toarray() for model in MODELS if spectra]
        return cls(2 * found.contacts / n - 2 * dim + 2 * dim / n, found.fraction, tuple(one.shear for one in moduli),
                   moduli[1].bulk, float((-calc.law.dphi(r) / r / calc.law.d2phi(r)).mean()),
                   prestress_reserve(found.atoms).factor, found.linear_strain,
                   [np.sqrt(np.maximum(np.linalg.eigvalsh(H)[dim:], 0)) for H in hessians],
                   found.fraction * abs(np.linalg.det(found.every.cell.array[:dim, :dim])) / len(found.radii))


def ladder(spheres, seed, power=2.0, dim=2):
    """The states of one packing, as it becomes looser."""
    radii, states, found = np.where(np.arange(spheres) % 2, 1.4, 1.0) / 2.4, [], None
    for k, pressure in enumerate(PRESSURES):
        found = found.at(pressure) if found else packing(radii, pressure, Overlap(1.0, power), seed, dim)
        states.append(State.of(found, k in SPECTRA and power == dim == 2))
    return states


def each(every, name, *part):
    """A quantity of every seed at every pressure, shape (seeds, pressures)."""
    return np.array([[getattr(state, name)[part[0]] if part else getattr(state, name) for state in states] for states in every])


def exponent(values):
    """Slopes of logarithms over those of the pressure, below its scaling limit of 1e-2, of each seed."""
    return np.polyfit(np.log(PRESSURES[2:]), np.log(values[:, 2:].T), 1)[0]


def onset(omega):
    """Frequency at which the plateau of the density of states begins: the zero of a line through the number of its modes."""
    share = np.arange(len(omega)) / len(omega)
    slope, start = np.polyfit(omega[on := (share > PLATEAU[0]) & (share < PLATEAU[1])], share[on], 1)
    return -start / slope


def told(values):
    """Mean over the seeds with its standard error in the last digit, as 0.123(4)."""
    if len(values) == 1:
        return f'{values[0]:.3g}'
    error = np.std(values, ddof=1) / np.sqrt(len(values))
    digits = max(0, -int(f'{error:.0e}'.partition('e')[2]))
    return f'{np.mean(values):.{digits}f}({error * 10**digits:.0f})'


def table(every):
    """Lines of Markdown: the means over the seeds at each pressure."""
    G0, G = each(every, 'shear', 0), each(every, 'shear', 1)
    rows = each(every, 'excess'), G0, G, 1 - G / G0, each(every, 'factor')
    weak, strain = (np.exp(np.log(each(every, name)).mean(axis=0)) for name in ('weak', 'strain'))
    return ['| pressure | contacts of a disc beyond the fewest | G of D0 | G of D0 + D\\* | share of D\\* in G | collapses at '
            '| D\\*/D0 of a contact | first change at a strain of |', '|---|---|---|---|---|---|---|---|',
            *(f'| {p:.1e} | ' + ' | '.join(told(row[:, k]) for row in rows) + f' | {weak[k]:.1e} | {strain[k]:.1e} |'
              for k, p in enumerate(PRESSURES))]


def exponents(every):
    """A line of text: how contacts and moduli rise with the pressure."""
    values = each(every, 'excess'), each(every, 'shear', 0), each(every, 'shear', 1), each(every, 'bulk')
    return 'exponents: contacts {}, G of D0 {}, G of D0 + D* {}, K {}'.format(*(told(exponent(value)) for value in values))


def printed(every, dim):
    """A line of text: the numbers that others have printed."""
    phi, P = each(every, 'fraction'), 2 * PRESSURES * each(every, 'volume')  # eps is half of the energy here
    rise, root = np.diff(P)[:, -1] / np.diff(phi)[:, -1], (each(every, 'excess') / np.sqrt(P))[:, -3] / 2 / dim / 2 ** (dim / 2)
    return (f'pressure over the share of space beyond jamming, times dim: {told(dim * rise)} (printed: 1.23); contacts at 1e-3 '
            f'over the root of the pressure: {told(root)} (printed from three dimensions on: 0.74); jamming at '
            f'{told(phi[:, -1] - P[:, -1] / rise)}')


def onsets(every):
    """A line of text: where the plateau begins, over the root of the pressure."""
    which = list(SPECTRA)
    D0, D = ([[onset(states[k].omega[m]) for k in which] for states in every] / PRESSURES[which] ** 0.5 for m in (0, 1))
    return 'onset of the plateau over the root of the pressure: ' + '; '.join(
        f'{PRESSURES[k]:.0e}: D0 {told(D0[:, n])}, D0 + D* {told(D[:, n])}' for n, k in enumerate(which))


def draw(every, out):
    """Three panels: contacts and G against pressure, densities of states, and the share of G that D* takes."""
    figure, axes = panels(1, 3, width=7.0, height=2.6)
    letter_panels(axes.ravel())
    left, middle, right = axes.ravel()
    excess, G = each(every, 'excess').mean(axis=0), [each(every, 'shear', m) for m in (0, 1)]
    left.loglog(PRESSURES, excess, 'ko-', markersize=3.5)
    left.annotate('contacts beyond\nthe fewest', (PRESSURES[3], excess[3]), (-4, 4), textcoords='offset points', ha='right',
                  fontsize='small')
    left.annotate('$G$', (PRESSURES[3], G[1].mean(axis=0)[3]), (6, -12), textcoords='offset points')
    edges, lines = np.linspace(0, 2.6, 27), []
    for m, line, colour in ((0, 's--', COLOURS[1]), (1, 'd-', COLOURS[0])):
        lines += left.loglog(PRESSURES, G[m].mean(axis=0), line, color=colour, markersize=3.5)
        for k, shade in SPECTRA.items():
            density = np.histogram(np.concatenate([states[k].omega[m] for states in every]), edges, density=True)[0]
            middle.plot((edges[1:] + edges[:-1]) / 2, density, line[1:], color=colour, alpha=shade)
    left.set(xlabel='pressure (energy/diameter$^2$)', ylabel='per disc; energy/diameter$^2$')
    middle.set(xlabel='frequency (rad per unit of time)', ylabel='density of states', ylim=(0, 0.7))
    middle.annotate('full: 1e-2, pale: 1e-3, 1e-4', (0.03, 0.97), xycoords='axes fraction', va='top', fontsize='small')
    right.semilogx(each(every, 'weak').ravel(), (1 - G[1] / G[0]).ravel(), 'o', color=COLOURS[0], markersize=3)
    across = np.geomspace(3e-5, 0.3, 50)
    right.semilogx(across, across, ':', color='0.4')
    right.annotate('as much as in a contact', (0.04, 0.04), (-4, 6), textcoords='offset points', ha='right', fontsize='small')
    right.set(xlabel='$D^{*}/D^0$ of a contact', ylabel='share of $D^{*}$ in $G$', ylim=(0, 1))
    legend_of_set(figure, handles=lines, labels=['$D^0$', '$D^0+D^{*}$'])
    return save_picture(figure, out / 'packings.png',
                        'Packed discs: D* is a ten-thousandth of a contact, and takes half of the shear modulus.')


def main(arguments=None):
    """Pack, print the tables, draw."""
    parser = argparse.ArgumentParser(prog='python -m workflows.packings', description=__doc__.partition('\n')[0])
    parser.add_argument('spheres', type=int, nargs='?', default=1024)
    parser.add_argument('seeds', type=int, nargs='?', default=10)
    parser.add_argument('-o', '--out', type=Path, default=Path('out'), metavar='DIR')
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    n, seeds = options.spheres, range(options.seeds)
    every = [ladder(n, seed) for seed in tqdm(seeds, desc='discs', disable=None)]
    print(f'{n} discs, {len(seeds)} seeds\n', *table(every), '', exponents(every), printed(every, 2), onsets(every), sep='\n')
    with print_style():
        draw(every, options.out)
    some = seeds[: (len(seeds) + 1) // 2]
    print(f"{n} discs with Hertz' law, {len(some)} seeds:", exponents([ladder(n, seed, 2.5) for seed in some]))
    print(f'{n // 2} spheres, {len(some)} seeds:', printed([ladder(n // 2, seed, 2.0, 3) for seed in some], 3))


if __name__ == '__main__':
    main()
