"""Losses: from row to row a wave decays twice as fast as D0 alone predicts, because D* makes it slow."""

import numpy as np

from magphonon import InversePower, MagneticRepulsion, frequency_response, lattices, propagate, read_scene, units as u
from magphonon.bands import complex_bands, group_velocities
from magphonon.bands.bloch import damped_modes
from magphonon.plotting.axes import new_axes
from magphonon.scenes import reference

from .rows import Check, Outcome, save_picture

C = 4.0  # 1/s
GAMMA_M = (0, 1, 0)  # of waves behind a row
ROWS = 400
SHOWN = np.linspace(27.5, 58.0, 62)  # Hz


def main(out):
    """Decay per row of shear waves in the prototype: closed form, behind a row of sources, and by the group velocity."""
    cell, checks = read_scene('prototype').atoms(), []
    for f in (30.0, 40.0, 50.0):
        xi = shear(cell, f)
        checks += [Check(f'shear along Gamma-M at {f:g} Hz, c = 4 /s: phase per row (rad)', xi.real, closed(f).real, 1e-8),
                   Check(f'shear along Gamma-M at {f:g} Hz, c = 4 /s: decay per row', xi.imag, closed(f).imag, 1e-7)]
    k = closed(40.0, c=0).real
    speed = group_velocities(cell, [[0, k / (2 * np.pi), 0]]).velocity[0, 0] @ GAMMA_M[:2] / row_height(cell)
    checks += [Check('decay at 40 Hz behind a row of sources (400 rows)', behind_a_row(cell), closed(40.0).imag, 1e-5),
               Check('decay at 40 Hz by the group velocity, c/(2 v)', C / u.s / (2 * speed), closed(40.0).imag, 2e-4),
               Check('decay at 40 Hz, D0 alone', shear(cell, 40.0, 'conventional').imag,
                     closed(40.0, 'conventional').imag, 1e-7),
               Check('control: decay at 40 Hz, D0 alone, compared with the lattice',
                     shear(cell, 40.0, 'conventional').imag, closed(40.0).imag, 0.2, control='D0'),
               *each_its_own()]
    return Outcome(checks, [picture(out, cell)])


def closed(f, model='complete', c=C):
    """Shear along Gamma-M, `f^2 + i f c/2 pi = cut-off^2 + (edge sin(xi/2))^2`; with D* the edge is that of 2 (a - 3)."""
    known, mass, L = reference()['prototype'], 7.07e-4, 0.01
    a = 4.5824
    edge = np.sqrt((2 * a - 6 * (model == 'complete')) * 1.6209e-10 * L**-a / (L * mass)) / (2 * np.pi)
    return 2 * np.arcsin(np.sqrt(f**2 + 1j * f * c / (2 * np.pi) - known['gamma_Hz'] ** 2) / edge)


def shear(cell, f, model='complete'):
    """Complex wavenumber of the shear wave per row; at these frequencies that of the longitudinal wave is smaller."""
    xi = complex_bands(cell, GAMMA_M, [2 * np.pi * f * u.Hz], model, damping=C / u.s).xi[0]
    return xi[xi.real.argmax()]


def row_height(cell):
    """Distance of two rows in mm; a velocity divided by it is in rows per ms."""
    return cell.cell.array[1, 1]


def behind_a_row(cell):
    """Decay per row in the response of a strip whose lowest row is pushed along itself."""
    strip = cell.repeat((1, ROWS, 1))
    strip.pbc = (True, False, False)
    strip.calc = MagneticRepulsion(strip, cell.calc.laws, foundation=cell.calc.parameters.foundation).balanced([0, ROWS - 1])
    force = np.zeros((ROWS, 3))
    force[0, 0] = 1.0
    rows = np.arange(10, 90)  # what comes back from the far side has fallen by e^-14
    response = frequency_response(strip, force, [2 * np.pi * 40 * u.Hz], C / u.s, rows).response[0, :, 0]
    return -np.polyfit(rows, np.log(abs(response)), 1)[0]


def each_its_own():
    """A chain in which every other particle loses energy: its poles and its free decay, compared with the roots of a quartic."""
    chain, k, c = lattices.chain(1.0, 1.0).repeat((2, 1, 1)), 5.0, 0.6
    chain.calc = MagneticRepulsion(chain, InversePower(1.0, 4.0), foundation=k)
    # along x: (s^2 + c s + k + 8) (s^2 + k + 8) = (8 cos(xi/2))^2 with springs of a f/L = 4
    q, still = 0.3, [1, 0, k + 8]
    lossy = np.polyadd(still, [0, c, 0])
    poles = np.roots(np.polysub(np.polymul(lossy, still), [(8 * np.cos(np.pi * q)) ** 2]))
    omega, decay, shapes = damped_modes(chain, [[q, 0, 0]], [c, 0.0], vectors=True)
    along = abs(shapes[0, :, :, 0]).max(axis=1) > 0.5
    found = np.sort_complex(-decay[0, along] + 1j * omega[0, along])
    true = np.sort_complex(poles[poles.imag > 0])
    ring = chain.copy()
    ring.calc = chain.calc
    ring.set_momenta([[1e-3, 0, 0], [1e-3, 0, 0]])  # xi = 0: both together
    slow = np.roots(np.polysub(np.polymul(lossy, still), [64]))
    times = np.linspace(0, 60, 7)
    u_t = propagate(ring, times, damping=[c, 0.0]).displacements[:, :, 0]
    V = np.array([np.ones(4), slow, slow**2, slow**3])
    weights = np.linalg.solve(V, [0, 1e-3, -c * 1e-3, (c**2 - k) * 1e-3])  # u, u', u'', u''' of the lossy one at t = 0
    exact = (np.exp(np.outer(times, slow)) @ weights).real
    return [*(Check(f'chain with losses at every other particle: {name} of mode {n + 1}', getattr(one, part) * sign,
                    getattr(two, part) * sign, 1e-9)
              for n, (one, two) in enumerate(zip(found, true, strict=True))
              for name, part, sign in (('frequency (rad/ms)', 'imag', 1), ('decay (1/ms)', 'real', -1))),
            Check('chain with losses at every other particle: its ringing, largest misfit / amplitude',
                  abs(u_t[:, 0] - exact).max() / abs(exact).max(), 0.0, 1e-8)]


def picture(out, cell):
    """Draw the decay per row over frequency, with D* and without, and the estimate c/(2 v)."""
    ax = new_axes()
    for model, style, label in (('complete', '-', 'complete, $D^0+D^{*}$'), ('conventional', '--', 'conventional, $D^0$')):
        ax.plot(SHOWN, [shear(cell, f, model).imag for f in SHOWN], style, label=label)
    f = np.array([30.0, 40.0, 50.0])
    ax.plot(f, closed(f).imag, 'o', color='black', fillstyle='none', label='closed form')
    ax.set(xlabel='frequency (Hz)', ylabel='decay per row', ylim=(0, None))
    ax.legend()
    return save_picture(ax.figure, out / 'losses.png', (
        'Decay of shear waves of the prototype along Γ-M, losses 4 /s: D* makes them slow, so they lose more on the way.'))
