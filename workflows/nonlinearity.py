"""Nonlinearity: how frequencies shift with the amplitude, in time steps and by perturbation theory.

On its vertical line the oscillator of Fig. 1 softens. In the triangular lattice without a foundation, a = 4, shear at M softens
too, dw/w = -285/16 (A/L0)^2, and the waves that rotate at K stiffen, +475/36 (A/L0)^2: there each particle moves in the potential
of Henon and Heiles.
"""

import numpy as np
from ase.constraints import FixedLine
from scipy.interpolate import CubicSpline

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices, units
from magphonon.bands import bloch_modes
from magphonon.dynamics import Recorder
from magphonon.plotting.axes import COLOURS, legend_above, new_axes
from magphonon.scenes.scene import reference
from magphonon.stability.amplitude_shifts import frequency_shifts

from .frf import batch
from .oscillator import at_angle, oscillator
from .rows import Check, Outcome, save_picture

L0 = 1 * units.m
SHIFTS = {0.0: -275 / 48, 0.5: -35 / 48}  # dw/w over (A/L0)^2 by theta0/pi, for a = 4
AMPLITUDES = np.array([0.005, 0.01, 0.02, 0.035, 0.05, 0.07, 0.1])  # of L0
DT = 0.3 * units.ms   # w dt <= 0.104
PERIODS = 12

LAW = InversePower(b=1.0, a=4.0)
WAVES_OF_PLANE = {'M, shear, standing': ((0.5, 0, 0), 0, (2, 1), -285 / 16),
                  'K, rotating': ((2 / 3, 1 / 3, 0), 0, (3, 3), 475 / 36),
                  'halfway to M, longitudinal, travelling': ((0.25, 0, 0), 1, (4, 1), None)}
"""Wavevector, branch, supercell, and dw/w over (A/L0)^2 in closed form."""
SWING, TURNS = 0.01, 60                # amplitude of L0, and periods of a run


def main(out):
    """Coefficients and slopes against closed forms; the control is D0 alone, with frozen bond directions."""
    angles = np.pi * np.array(reference()['oscillator']['theta0_over_pi'])
    measured = shifts_in_time(angles)
    theory = np.array([shift(theta0) for theta0 in angles])
    checks = []
    for theta0, here, analytic in zip(angles, measured[0] / AMPLITUDES[0] ** 2, theory, strict=True):
        at = at_angle(theta0)
        # the next order, some 30 (A/L0)^2 of this one, and Verlet's own, (w dt)^2/24, leave 1e-3
        by_hand = round(theta0 / np.pi, 6) in SHIFTS
        checks.append(Check(f'oscillator, dw/w / (A/L0)^2 in the time domain, {at}', here, analytic, 5e-3,
                            by='closed form' if by_hand else 'two methods'))
    for theta0, closed in SHIFTS.items():
        by_theory = shift(np.pi * theta0)
        checks.append(Check(f'oscillator by perturbation theory, {at_angle(np.pi * theta0)}', by_theory, closed, 1e-9))
    frozen = shifts_in_time(angles[:1], 'conventional')[0, 0] / AMPLITUDES[0] ** 2
    checks.append(Check('control: oscillator with D0 alone, theta0 = 0 deg', frozen, SHIFTS[0.0], 0.5, control='D0'))

    measured_waves = {name: (in_plane(*wave[:3]), wave) for name, wave in WAVES_OF_PLANE.items()}
    for name, (here, (q, branch, _, closed)) in measured_waves.items():
        found = frequency_shifts(plane(), q).curvature[branch]
        if closed is not None:
            checks.append(Check(f'wave of the plane by perturbation theory, {name}', found, closed, 1e-9))
        # the start leaves out the second harmonic, 4 % of the wave, which beats with it
        checks.append(Check(f'wave of the plane in time, {name}: dw/w / (A/L0)^2', here, closed or found, 3e-2,
                            by='closed form' if closed else 'two methods'))
    q, branch, cells, closed = WAVES_OF_PLANE['K, rotating']
    checks.append(Check('control: wave of the plane with D0 alone, K, rotating', in_plane(q, branch, cells, 'conventional'),
                        closed, 0.1, control='D0'))
    return Outcome(checks, [draw_shifts(out, angles, measured, theory), draw_path(out, measured_waves)])


def shift(theta0):
    """`dw/w` over (A/L0)^2 of the oscillator on its vertical line, by perturbation theory."""
    atoms = oscillator(theta0)
    atoms.set_constraint([*atoms.constraints, FixedLine(3, (0, 1, 0))])
    return frequency_shifts(atoms).curvature[0] * L0**2


def shifts_in_time(angles, model='complete'):
    """Relative change of the frequency of free vibrations at AMPLITUDES, all from one run, shape (amplitudes, angles)."""
    which = np.tile(np.arange(len(angles)), len(AMPLITUDES))
    atoms, replicas = batch(angles, which, model)
    softest = np.sqrt(min(stiffness(theta0, model) for theta0 in angles) / units.kg)
    atoms.set_constraint([*atoms.constraints, FixedLine(replicas, (0, 1, 0))])
    atoms.positions[replicas, 1] -= L0 * np.repeat(AMPLITUDES, len(angles))
    dyn = DrivenVerlet(atoms, DT, engine='ase')  # compiled, each model and range of the law is a kernel of its own
    record = Recorder(dyn, replicas, interval=2)
    dyn.run(int(PERIODS * 2 * np.pi / softest / DT))
    omega = np.empty(len(replicas))
    amplitude = np.empty(len(replicas))
    for r, y in enumerate(record.displacements[..., 1].T):
        curve = CubicSpline(record.times, y)
        rising = [t for t in curve.roots(extrapolate=False) if curve(t, 1) > 0]
        omega[r] = 2 * np.pi * (len(rising) - 1) / (rising[-1] - rising[0])
        turns = curve(curve.derivative().roots(extrapolate=False))
        amplitude[r] = np.ptp(turns) / 2 / L0
    omega_0 = np.sqrt([stiffness(theta0, model) / units.kg for theta0 in angles])[which]
    omega_0 = 2 / DT * np.arcsin(omega_0 * DT / 2)  # Verlet's
    # to a common amplitude: that of the start is one turning point, not half the way between both
    return ((omega / omega_0 - 1) * (np.repeat(AMPLITUDES, len(angles)) / amplitude) ** 2).reshape(-1, len(angles))


def stiffness(theta0, model):
    """Vertical stiffness in N/mm."""
    atoms = oscillator(theta0, model)
    return atoms.calc.get_hessian(atoms)[10, 10]


def plane():
    """One cell of the triangular lattice, without a foundation."""
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, LAW)
    return cell


def in_plane(q, branch, cells, model='complete'):
    """`dw/w` over (A/L0)^2 of a wave in time steps, from the phase of the wave over many periods."""
    cell = plane()
    w, shapes = bloch_modes(cell, [q], model, vectors=True)
    w, e = w[0, branch], shapes[0, branch, 0, :2]
    if abs(np.diff(bloch_modes(cell, [q], model)[0][0])) < 1e-9 * w:
        e = np.array([1, 1j]) / np.sqrt(2)  # rotates
    e = e / np.sqrt((1 + abs((e * e).sum())) / 2)  # the longer half-axis of its ellipse is one
    atoms = cell.repeat((*cells, 1))
    atoms.calc = cell.calc.on(atoms)
    atoms.calc.set(model=model)
    wave = np.exp(2j * np.pi * (atoms.positions @ np.linalg.inv(cell.cell.array)) @ q)[:, None] * e
    atoms.positions[:, :2] += SWING * wave.real
    momenta = np.zeros((len(atoms), 3))
    momenta[:, :2] = SWING * w * wave.imag  # u = Re(wave e^{-i w t})
    atoms.set_momenta(momenta)
    dyn = DrivenVerlet(atoms, 2 * np.pi / w / 8, engine='ase', order=6)
    t, u = [], []

    def look():
        t.append(dyn.get_time())
        u.append(((dyn.displacements + 1j * dyn.velocities / w) * wave.conj()).sum())

    dyn.attach(look, interval=2)
    dyn.run(8 * TURNS)
    turned = np.unwrap(np.angle(u)) + w * np.array(t)  # the linear wave turns by -w t
    return -np.polyfit(t, turned, 1, w=np.sqrt(np.hanning(len(t))))[0] / w / SWING**2  # beats average out


def draw_shifts(out, angles, measured, theory):
    """Draw the change of frequency over the amplitude."""
    ax = new_axes()
    A = np.linspace(0, AMPLITUDES[-1], 60)
    for k, (theta0, marker) in enumerate(zip(angles, 'os^D', strict=True)):
        ax.plot(A, 100 * theory[k] * A**2, color=COLOURS[k], linestyle=('-', '--', '-.', ':')[k])
        ax.plot(AMPLITUDES, 100 * measured[:, k], marker, color=COLOURS[k], fillstyle='none',
                label=rf'$\theta_0 = {np.rad2deg(theta0):.0f}°$: ${100 * theory[k]:+.1f}\,(A/L_0)^2$ %')
    ax.set(xlabel='amplitude $A/L_0$', ylabel='change of frequency (%)')
    legend_above(ax, ncols=2)
    return save_picture(ax.figure, out / 'oscillator_shift.png',
                        'How the frequency of the oscillator shifts with its amplitude: free vibrations in the time domain '
                        '(marks), perturbation theory (lines).')


def draw_path(out, measured):
    """Draw the shift of both branches along a path, and the shift from time steps where there is a run."""
    ax, path = new_axes(), plane().cell.bandpath('GMKG', npoints=121, pbc=(1, 1, 0))
    x, ticks, names = path.get_linear_kpoint_axis()
    known = [k for k, q in enumerate(path.kpts) if np.linalg.norm(q) > 0.01 and abs(x[k] - ticks[2]) > 1e-9]  # K is a point apart
    shifts, at = frequency_shifts(plane(), path.kpts[known]), np.repeat(x[known], 2)
    for branch, name, line in ((0, 'lower branch', '-'), (1, 'upper branch', '--')):
        ax.plot(at[branch::2], shifts.curvature[branch::2], line, color=COLOURS[branch], label=name)
    for here, (q, _, _, closed) in measured.values():
        place = {0.5: ticks[1], 0.25: ticks[1] / 2}.get(q[0], ticks[2])
        ax.plot(place, here, 'o', color='black', fillstyle='none', label='time steps' if q[0] == 0.5 else None)
        if place == ticks[2]:
            ax.plot(place, closed, 'x', color=COLOURS[0], label='rotating at K')
    for tick in ticks[1:-1]:
        ax.axvline(tick, color='0.7', linewidth=0.8, zorder=0)
    ax.axhline(0, color='0.7', linewidth=0.8, zorder=0)
    ax.set_xticks(ticks, [r'$\Gamma$' if name == 'G' else name for name in names])
    ax.set(ylabel=r'$(\Delta\omega/\omega)/(A/L_0)^2$', ylim=(-40, 40), xlim=(x[0], x[-1]))
    legend_above(ax, ncols=2)
    return save_picture(ax.figure, out / 'amplitude.png',
                        'How the frequency of waves of the triangular lattice (a = 4, no foundation) shifts with their '
                        'amplitude: perturbation theory (lines), time steps (circles). At the poles the second harmonic is '
                        'itself a free wave.')
