"""Walls that move: a strip shaken at its side, the solitary wave of Toda."""

import numpy as np
from ase.constraints import FixAtoms, FixedLine

from magphonon import DrivenVerlet, MagneticRepulsion, ToneBurst, frequency_response, lattices, propagate, read_scene, units as u
from magphonon.dynamics import PrescribedMotion, Recorder
from magphonon.plotting.axes import new_axes

from .losses import C, closed
from .rows import Check, Outcome, save_picture

ROWS, SEEN = 400, 41
KAPPA, START = 1.1, 8.0  # of Toda's wave


class Toda:
    """Energy e^{-(r - L)}: the pair law whose chain Toda solved."""

    def phi(self, r):
        return np.exp(10.0 - r)

    def dphi(self, r):
        return -self.phi(r)

    def d2phi(self, r):
        return self.phi(r)


def main(out):
    """The displacement of rows behind a shaken side is `e^{i xi n}`; a pushed end sends the exact solitary wave."""
    steady = {model: shaken(model) for model in ('complete', 'conventional')}
    ten = {model: abs(row[10]) for model, row in steady.items()}
    true = np.exp(-1j * closed(40.0).conj() * np.arange(SEEN))  # of e^{i omega t}
    checks = [
        Check('amplitude ten rows behind a side shaken at 40 Hz, losses 4 /s', ten['complete'], abs(true[10]), 1e-5),
        Check('rows behind it: largest misfit to e^(i xi n)', abs(steady['complete'] - true).max(), 0.0, 1e-5),
        Check('amplitude ten rows behind it, D0 alone', ten['conventional'],
              np.exp(-10 * closed(40.0, 'conventional').imag), 1e-2),
        Check('control: D0 alone against the lattice: largest misfit of rows', abs(steady['conventional'] - true).max(), 0.0, 0.5,
              control='D0'),
        stepped()]
    times, found, exact, linear = toda()
    checks += [Check('Toda chain, end pushed by its solitary wave: largest misfit (mm)', abs(found - exact).max(), 0.0, 1e-5),
               Check('control: Toda chain, linear answer: misfit (mm)', abs(linear - exact).max(), 0.0, 0.3,
                     control='the linear answer')]
    return Outcome(checks, [picture(out, steady, true), toda_picture(out, times, found, exact)])


def strip(rows, model='complete'):
    """Rows of the prototype, periodic across with one particle in each; the outer rows are held."""
    cell = read_scene('prototype').atoms()
    atoms = cell.repeat((1, rows, 1))
    atoms.pbc = (True, False, False)
    atoms.calc = MagneticRepulsion(atoms, cell.calc.laws, foundation=cell.calc.parameters.foundation,
                                   model=model).balanced([0, rows - 1])
    atoms.set_constraint(FixAtoms([0, rows - 1]))
    return atoms


def shaken(model):
    """Amplitudes of the first rows behind a row that moves along itself at 40 Hz, divided by that of this row."""
    walls = np.zeros((ROWS, 3))
    walls[0, 0] = 1.0
    return frequency_response(strip(ROWS, model), None, [2 * np.pi * 40 * u.Hz], C / u.s, np.arange(SEEN),
                              walls=walls).response[0, :, 0]


def stepped():
    """Time steps behind a side that moves by a burst, against the exact linear motion."""
    atoms, burst = strip(40), PrescribedMotion(ToneBurst([0], (1, 0), 1e-4, 2 * np.pi * 40 * u.Hz, 3))
    dyn = DrivenVerlet(atoms, 1.0, [burst], C / u.s, order=4)
    seen = Recorder(dyn, interval=20)
    dyn.run(120)
    exact = propagate(strip(40), seen.times, [burst], C / u.s).displacements
    return Check('side moved by a burst: largest misfit of the time steps behind it to the exact motion / its amplitude',
                 abs(seen.displacements - exact).max() / 1e-4, 0.0, 2e-3)


def toda():
    """`u_n = 2 kappa + ln[(1 + e^{2 (kappa (n - 1) - s t)})/(1 + e^{2 (kappa n - s t)})]`, s = sinh(kappa) (Toda, 1967)."""
    n = 20
    chain = lattices.chain(10.0, 1.0).repeat((n, 1, 1))
    chain.pbc = False
    chain.calc = MagneticRepulsion(chain, Toda()).balanced([0, n - 1])
    chain.set_constraint([FixAtoms([0, n - 1]), FixedLine(range(1, n - 1), (1, 0, 0))])

    def exact(k, t):
        x = 2 * KAPPA * k - 2 * np.sinh(KAPPA) * (t - START)
        return 2 * KAPPA + np.logaddexp(0, x - 2 * KAPPA) - np.logaddexp(0, x)

    wall = PrescribedMotion(lambda t: [[exact(0, t), 0.0, 0.0]], [0])
    linear, pushed = chain.copy(), DrivenVerlet(chain, 0.08, [wall], order=4)
    linear.calc = chain.calc
    seen = Recorder(pushed, interval=2)
    pushed.run(220)
    inner = np.arange(n - 4)  # before the far end sends anything back
    straight = propagate(linear, seen.times, [wall]).displacements[:, inner, 0]
    return seen.times, seen.displacements[:, inner, 0], exact(inner, seen.times[:, None]), straight


def picture(out, steady, true):
    """Draw the amplitudes of the rows and the closed form."""
    ax, n = new_axes(), np.arange(SEEN)
    for row, mark, label in zip(steady.values(), 'os', ('complete, $D^0+D^{*}$', 'conventional, $D^0$'), strict=True):
        ax.plot(n, abs(row), mark, fillstyle='none', label=label)
    ax.plot(n, abs(true), '-', color='black', label='$|e^{i\\xi n}|$')
    ax.set(xlabel='rows behind the shaken side', ylabel='amplitude / amplitude of the side', ylim=(0, 1.02))
    ax.legend()
    return save_picture(ax.figure, out / 'walls.png', 'A side of the prototype is shaken along its own direction at 40 Hz, with '
                                                      'losses of 4 /s.')


def toda_picture(out, times, found, exact):
    """Draw the motion of every third particle of the Toda chain."""
    ax = new_axes()
    for k, style in zip((0, 5, 10), ('-', '--', ':'), strict=True):
        (line,) = ax.plot(times, exact[:, k], style, label=f'particle {k}' if k else 'end, moved')
        ax.plot(times[::5], found[::5, k], 'o', color=line.get_color(), fillstyle='none')
    ax.set(xlabel='time (ms)', ylabel='displacement (mm)')
    ax.legend()
    return save_picture(ax.figure, out / 'walls_toda.png', (
        'A Toda chain whose end moves as in its solitary wave: time steps (marks), exact solution (lines).'))
