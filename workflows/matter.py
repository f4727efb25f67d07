"""Other matter, same theory: colloids, plasma and Wigner crystals, crystals in space, steel balls, chains of two masses."""

import numpy as np

from magphonon import (
    InversePower,
    MagneticRepulsion,
    analytic_bands,
    finite_displacements,
    lattices,
    phonopy_bands,
    read_scene,
    units as u,
)
from magphonon.bands import band_path, bloch_modes, sound_speeds
from magphonon.interactions import Overlap, Yukawa
from magphonon.plotting.axes import legend_of_set, letter_panels, panels
from magphonon.plotting.bands import plot_bands
from magphonon.scenes.scene import reference
from magphonon.stiffness import AllNeighbours

from .rows import Check, Outcome, save_picture

NAMES = {'prototype': 'magnets', 'honeycomb': 'honeycomb, two masses', 'dust': 'dusty plasma', 'wigner': 'Wigner crystal',
         'fcc': 'soft spheres, fcc', 'steel': 'steel balls'}
COINCIDE = 1e-3  # D*/D0 below which no difference can be drawn
BONSALL = 'printed: Bonsall and Maradudin, Phys. Rev. B 15, 1959'
COULOMB, DIPOLES = InversePower(b=1.0, a=2.0), InversePower(b=3.0, a=4.0)


def main(out):
    """Published crystals, phonopy in three dimensions, and how much of the stiffness D* is in each kind of matter."""
    known = reference()['all_neighbours']
    cells = {name: crystal(name) for name in NAMES}
    checks = [*_planar_crystals(known), *_crystals_in_space(known, cells['fcc']),
              Check('steel balls, D*/D0 of a contact, 2/3 overlap / spacing', static_share(cells['steel']),
                    2 / 3 * 3e-6 / 0.019997, 1e-9),
              Check('magnets, D*/D0 of a bond, 1/a', static_share(cells['prototype']), 1 / 4.5824, 1e-12)]
    checks += [Check(f'{NAMES[name]}: largest change of omega^2 by D* / highest omega^2', static_change(cells[name]), 0, 1e-3,
                     control='' if name == 'steel' else 'D0') for name in NAMES]
    return Outcome(checks, [_draw_bands(out, cells)])


def crystal(name):
    """A unit cell of each kind of matter."""
    magnets = read_scene('prototype').atoms()
    if name == 'prototype':
        return magnets
    if name == 'honeycomb':  # on pillars of 80 N/m: those of the prototype would not hold it
        atoms = lattices.honeycomb(10 * u.mm, 0.707 * u.g)
        atoms.set_masses([0.707 * u.g, 1.5 * 0.707 * u.g])
        atoms.calc = MagneticRepulsion(atoms, magnets.calc.laws, foundation=80 * u.N / u.m)
    elif name == 'dust':  # melamine spheres of 8.6 um with 12 000 elementary charges, as far apart as the screening length
        L = 0.8 * u.mm
        atoms = lattices.triangular(L, 5e-13 * u.kg)
        atoms.calc = AllNeighbours(atoms, Yukawa(3.3e-20 * u.J * u.m, 1 / L))
    elif name == 'wigner':  # electrons on helium, 4.4e6 to the square centimetre
        atoms = lattices.triangular(5.1e-6 * u.m, 9.1093837e-31 * u.kg)
        atoms.calc = AllNeighbours(atoms, InversePower.coulomb(1.602176634e-19 * u.A * u.s))
    elif name == 'fcc':  # phi = r^-12, with 18 neighbours
        atoms = lattices.fcc(1.0, 1.0)
        atoms.calc = MagneticRepulsion(atoms, InversePower(12.0, 13.0), shells=2)
    else:  # balls of 20 mm pressed together by 3 um, 55 N in each contact
        atoms = lattices.triangular(19.997 * u.mm, 32.68 * u.g)
        atoms.calc = MagneticRepulsion(atoms, Overlap.spheres(206e3 * u.N / u.mm**2, 0.3, 20 * u.mm))
    return atoms


def static_share(atoms):
    """D*/D0 of nearest neighbours, `-(phi'/r)/phi''`."""
    r, law = atoms.calc.bonds.lengths.min(), atoms.calc.laws
    return -law.dphi(r) / r / law.d2phi(r)


def static_change(atoms):
    """Largest part of a squared frequency that D* takes away over the zone, in units of the highest squared frequency."""
    axis = (np.arange(6) + 0.5) / 6
    q = np.stack(np.meshgrid(*(axis if periodic else [0.0] for periodic in atoms.pbc)), axis=-1).reshape(-1, 3)
    complete, conventional = (bloch_modes(atoms, q, model)[0] for model in ('complete', 'conventional'))
    squares = conventional**2 - complete * abs(complete)
    return abs(squares).max() / (conventional**2).max()


def _planar_crystals(known):
    cell, n = lattices.triangular(1.0, 1.0), 2 / np.sqrt(3)  # particles per spacing squared
    cell.calc = AllNeighbours(cell, COULOMB)
    c_T, _ = sound_speeds(cell)
    k = 1e-4
    q, shorter = k * np.array([[1, 1 / 2, 0]]) / (2 * np.pi), 10  # times as short: digits enough for slow waves
    plasmon, blind = bloch_modes(cell, q)[0][0, 1], bloch_modes(cell, shorter * q, 'conventional')[0][0, 0] / (shorter * k)
    shear = Check('Wigner crystal, m c_T^2 (e^2 sqrt(n))', c_T**2 / np.sqrt(n), known['wigner_shear'], 3e-6, by=BONSALL)
    energy = cell.get_potential_energy() / np.sqrt(np.pi * n)
    cell.calc = AllNeighbours(cell, DIPOLES)
    mu = n * sound_speeds(cell)[0] ** 2 / (np.pi * n) ** 1.5
    golden = known['yukawa_shear_stability']
    cell.calc = MagneticRepulsion(cell, Yukawa(1.0, golden))
    nearest, steep = sound_speeds(cell)
    cell.calc = AllNeighbours(cell, Yukawa(1.0, golden))
    return [
        Check('Wigner crystal, energy per electron (e^2/r0)', energy, known['wigner_energy'], 1e-6, by=BONSALL),
        shear, shear.against(blind**2 / np.sqrt(n)),
        Check('Wigner crystal, long plasmon, omega^2/(2 pi n e^2 k/m)', plasmon**2 / (2 * np.pi * n * k), 1, 3e-4),
        Check('colloidal dipole crystal, shear modulus (kT Gamma/L^2)', mu, known['dipole_shear_modulus'], 1e-9),
        Check('plasma crystal at kappa L = 1.618, nearest neighbours: c_T/c_L', nearest / steep, 0, 1e-7),
        Check('control: with all neighbours it is stable: c_T/c_L', np.divide(*sound_speeds(cell)), 0, 0.1,
              control='all neighbours'),
    ]


def _crystals_in_space(known, fcc):
    from scipy.optimize import brentq

    def energy(kind, kappa):  # per particle, Wigner-Seitz radius one
        cell = kind(1.0, 1.0)
        cell.set_cell(cell.cell * (4 * np.pi / 3 / cell.get_volume()) ** (1 / 3))
        return AllNeighbours(cell, Yukawa(1.0, kappa)).get_potential_energy(cell)

    crossing = brentq(lambda kappa: energy(lattices.fcc, kappa) - energy(lattices.bcc, kappa), 0.8, 1.4, xtol=1e-6)
    path = band_path(fcc, 'GXWKGL', 60)
    numerical = phonopy_bands(finite_displacements(fcc, (4, 4, 4)), path).omega
    complete, conventional = (analytic_bands(fcc, path, model).omega for model in ('complete', 'conventional'))

    def apart(omega):
        return abs(omega * abs(omega) - numerical * abs(numerical)).max() / numerical.max() ** 2

    return [
        Check('Yukawa crystals change from bcc to fcc at kappa', crossing, known['yukawa_bcc_fcc'], 5e-4,
              by='printed: Hamaguchi, Farouki and Dubin, Phys. Rev. E 56, 4671'),
        Check('fcc, phonopy in space against D0 + D*, omega^2 / highest omega^2', apart(complete), 0, 1e-8, by='two methods'),
        Check('control: fcc, phonopy against D0 alone', apart(conventional), 0, 0.05, control='D0', by='two methods'),
    ]


def _draw_bands(out, cells):
    figure, axes = panels(2, 3, height=2.0)
    letter_panels(axes, list(NAMES.values()))
    for ax, (name, atoms) in zip(axes.flat, cells.items(), strict=True):
        path = band_path(atoms, 'GXWKGL' if name == 'fcc' else 'GMKG', 121)
        plot_bands(analytic_bands(atoms, path), ax=ax)
        plot_bands(analytic_bands(atoms, path, 'conventional'), ax=ax, linestyle='--')
        if static_share(atoms) < COINCIDE:
            ax.text(0.5, 0.06, 'both models coincide', ha='center', transform=ax.transAxes)
    lines = axes[0, 0].lines
    legend_of_set(figure, handles=[lines[0], lines[-1]], labels=['complete, $D^0+D^{*}$', 'conventional, $D^0$'])
    return save_picture(figure, out / 'matter.png',
                        'Other matter, same theory: the slower the force falls with distance, the more D* softens shear; '
                        'in steel balls D* is 1e-4 of D0, and the two models coincide.')
