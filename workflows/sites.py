"""Sites that differ: local modes, a missing magnet, disorder, pressure and moduli."""

import numpy as np
from ase.constraints import FixAtoms, FixedLine

from magphonon import InversePower, MagneticRepulsion, lattices, modes, relaxed, units
from magphonon.bands import band_gaps, bloch_modes
from magphonon.plotting import new_axes
from magphonon.plotting.modes import plot_shape
from magphonon.response import density_of_states, local_modes, localisation
from magphonon.scenes.scene import reference
from magphonon.stiffness import LinearSystem, elastic_moduli

from .closed_forms import PROTOTYPE, hole_in_honeycomb
from .rows import Check, Outcome, Reported, pairs, save_picture

LIGHT = (0.3, 0.6)                     # masses of the light particle, over those of the others
STRONG, WEAK = InversePower(b=1.0, a=6.0), InversePower(b=1.0, a=3.0)  # of equal force at L = 1, of stiffness 6 and 3
CELLS = 10                             # of the honeycomb patch, along each vector
AROUND = 0.045                         # m, seen to each side of the missing magnet
CHAIN = 6000                           # particles of the disordered chain
LOW = (0.2, 0.4, 0.8)                  # its frequencies, over sqrt(k/m), where waves are long


def main(out):
    """Each known result, with a wrong model that must fail it."""
    known = reference()
    honeycomb, local = missing_magnet(out, known['sites'])
    checks = [*light_mass(), *dimerised_chain(), *honeycomb, *pressed_lattice(), *disordered_chain()]
    return Outcome(checks, [local])


def along_x(particles, **options):
    """A chain of unit spacing, mass and stiffness that moves along itself, periodic unless its ends are held."""
    walls = options.pop('walls', False)
    chain = lattices.chain(1.0, 1.0).repeat((particles, 1, 1))
    chain.set_tags(np.resize(options.pop('tags', [0]), particles))
    chain.set_masses(options.pop('masses', np.ones(particles)))
    held = [0, particles - 1] if walls else []
    chain.pbc = (not walls, False, False)
    chain.set_constraint([FixAtoms(held), FixedLine(np.setdiff1d(np.arange(particles), held), (1, 0, 0))][0 if walls else 1:])
    chain.calc = MagneticRepulsion(chain, options.pop('law', InversePower(b=0.25, a=4.0)), **options)
    return chain


def light_mass():
    """One light particle in a chain has a mode of its own above the band: omega/omega_max = 1/sqrt(mu (2 - mu))."""
    rows = []
    for mu in (*LIGHT, 1.0):
        masses = np.ones(101)
        masses[50] = mu
        top = modes(along_x(101, masses=masses)).omega[-1] / 2  # omega_max = 2 sqrt(k/m)
        if mu < 1:
            rows.append(Check(f'chain with one mass of {mu:g}: its mode / band edge', top, (mu * (2 - mu)) ** -0.5, 1e-9))
    return [*rows, Check(f'control: the chain without it, against the mode of {mu:g}', top, (LIGHT[1] * (2 - LIGHT[1])) ** -0.5,
                         0.02, control='equal masses')]


def dimerised_chain():
    """Two kinds of magnets in pairs, A A B B: springs k1 and k2 in turn; one way to end the chain has a mode at each end."""
    laws, k1, k2 = {(0, 0): STRONG, (1, 1): STRONG, (0, 1): WEAK}, 6.0, 3.0
    squares = bloch_modes(along_x(4, law=laws, tags=[0, 0, 1, 1]), [[0, 0, 0]])[0][0] ** 2  # the zone of k1, k2, folded once
    edges = pairs('dimerised chain, omega^2 m', squares[1:], (2 * k2, 2 * k1, 2 * (k1 + k2)), 1e-9,
                  ('lower edge', 'upper edge', 'top'))
    gap = np.sqrt([2 * k2 * 1.01, 2 * k1 * 0.99])
    ends, other = (local_modes(along_x(42, law=laws, tags=tags, walls=True), gap) for tags in ([0, 0, 1, 1], [0, 1, 1, 0]))
    u = abs(ends.shapes[0, :, 0] + np.array([1, -1])[:, None] * ends.shapes[1, :, 0])
    left = u[u[:, 1].argmax()]  # of the sum and the difference, that at the left end
    return [*edges, *pairs('dimerised chain: modes at its ends, omega^2 m', ends.omega**2, [k1 + k2] * 2, 1e-5,
                           ('first', 'second')),
            Check('decay per cell of the modes at the ends of the dimerised chain', left[3] / left[1], k2 / k1, 1e-4),
            Check('number of modes in the gap with the bonds exchanged', len(other.omega), 0, 1e-9),
            Check('control: number of modes in the gap with the strong bond at the wall', len(ends.omega), 0, 0.5,
                  control='the other end of the chain')]


def missing_magnet(out, known):
    """A honeycomb patch of two masses with one magnet missing: local modes lie in the gap once the other magnets have relaxed."""
    law, _ = prototype(reference()['prototype'])
    cell = lattices.honeycomb(10.0, 0.707)
    cell.set_masses([0.707, 1.5 * 0.707])
    k = known['foundation'] * units.N / units.m
    cell.calc = MagneticRepulsion(cell, law, foundation=k)
    gap = band_gaps(cell)[0]
    patch = cell.repeat((CELLS, CELLS, 1))
    hole = patch.positions[CELLS * (CELLS + 1), :2]
    del patch[CELLS * (CELLS + 1)]  # a light one
    patch.calc = MagneticRepulsion(patch, law, foundation=k)
    rest = relaxed(patch)
    held = local_modes(rest.atoms, gap)
    found, unmoved = units.hertz(held.omega), local_modes(LinearSystem.about(patch.calc, patch), gap)
    low, high = units.hertz(np.array(gap))
    ax = plot_shape(rest.atoms, held.shapes[2], ax=new_axes(height=2.6), defects=[hole],
                    title=f'{found[2]:.2f} Hz, in the gap of {low:.2f} to {high:.2f} Hz')
    x, y = hole / units.m
    ax.set(xlim=(x - AROUND, x + AROUND), ylim=(y - AROUND, y + AROUND))
    ax.figure.colorbar(ax.collections[0], ax=ax, label='share of the kinetic energy')
    picture = save_picture(ax.figure, out / 'missing_magnet.png', (
        'A local mode around a missing magnet (cross), towards which the other magnets have moved by up to '
        f'{rest.shift:.2g} mm.'))
    exact = hole_in_honeycomb(PROTOTYPE, known['foundation'], cells=CELLS)
    exact = exact[(exact > low) & (exact < high)]
    return [*pairs('honeycomb, a magnet missing: local modes (Hz)', found, exact, 1e-7,
                   ('first', 'second', 'third')),
            Check('control: number of local modes before the other magnets move', len(unmoved.omega), 3, 0.5,
                  control='magnets that stay in place'),
            Reported('farthest that a magnet moves towards the hole (mm)', rest.shift, 10)], picture


def pressed_lattice():
    """Nearest neighbours on a triangular lattice: stress and moduli in closed form, and speeds of sound under static stress."""
    rows = []
    for a in (4.0, 4.5824):
        law = InversePower(b=1.0, a=a)
        cell = lattices.triangular(1.0, 1.0)
        cell.calc = MagneticRepulsion(cell, law)
        found, area = elastic_moduli(cell), np.sqrt(3) / 2
        slow, fast = found.speeds([0.6, 0.8]) ** 2
        without = np.einsum('ijkl,j,l->ik', found.constants, [1, 0], [1, 0])[1, 1] * area
        what = f'triangular lattice, a = {a:g}, f = L = m = 1'
        rows += [Check(f'{what}: pressure', found.pressure, np.sqrt(3), 1e-12),
                 Check(f'{what}: c_T^2 from the moduli', slow, 3 / 8 * (a - 3), 1e-12),
                 Check(f'{what}: c_L^2 from the moduli', fast, 3 / 8 * (3 * a - 1), 1e-12),
                 Check(f'{what}: bulk modulus over the pressure', found.bulk / found.pressure, (a + 1) / 2, 1e-12),
                 Check(f'control: {what}: c_T^2 from the second derivatives of the energy alone', without, 3 / 8 * (a - 3), 0.5,
                       control='moduli without the pressure')]
    return rows


def prototype(known):
    """Law and foundation of the paper's prototype."""
    return InversePower(b=known['b'] * units.N * units.m ** known['a'], a=known['a']), known['k_eq'] * units.N / units.m


def disordered_chain():
    """Random masses between 0.2 and 1.8: modes counted by the transfer matrix, and the localisation length of long waves."""
    masses = np.random.default_rng(0).uniform(0.2, 1.8, CHAIN)
    chain = along_x(CHAIN, masses=masses)
    omega = np.array([0.25, 0.5, 1.0, 1.5, 1.95])
    ratio, below = np.full(len(omega), 2.0), np.zeros(len(omega))
    for mass in masses:  # Sturm: every change of sign of the displacements is a mode below
        ratio = 2 - mass * omega**2 - 1 / ratio
        below += ratio < 0
    return [*(Check(f'disordered chain, share of modes below {w:g} sqrt(k/m)', a, b, 0.05)
              for w, a, b in zip(omega, shares(chain, omega), below / CHAIN, strict=True)),
            Check('control: chain of equal masses, share of modes below 1.95 sqrt(k/m)',
                  shares(along_x(CHAIN), omega)[-1], below[-1] / CHAIN, 0.05, control='equal masses'),
            # some 50 modes at each frequency, of lengths that scatter by 60 %
            Check('power of the frequency in the localisation length of long waves', reach_power(chain), -2, 0.25),
            Check('control: chain of equal masses, power of the frequency in this length',
                  reach_power(along_x(CHAIN // 10)), -2, 0.25, control='equal masses')]


def shares(chain, omega):
    """Shares of the modes below some frequencies, from the density of states."""
    found = density_of_states(chain, moments=512, vectors=8)
    steps = found.density * np.gradient(found.omega) / found.modes
    return np.array([steps[found.omega <= w].sum() for w in omega])


def reach_power(chain):
    """Slope of the mean localisation length over the frequency of the modes, on logarithmic axes."""
    lengths = [localisation(local_modes(chain, (w - 0.01 / w, w + 0.01 / w)), chain).length.mean() for w in LOW]
    return np.polyfit(np.log(LOW), np.log(lengths), 1)[0]
