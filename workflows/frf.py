"""The oscillator's frequency response: all angles and frequencies in one run, compared with the closed form."""

import numpy as np
from ase.constraints import FixedLine

from magphonon import DrivenVerlet, units
from magphonon.dynamics import Harmonic, Recorder
from magphonon.plotting.axes import COLOURS, legend_of_set, letter_panels, panels
from magphonon.response.frf import harmonic_response
from magphonon.response.stepped import impulse_response, replicas, steady_amplitudes
from magphonon.scenes.scene import reference

from . import ase_loop, closed_forms
from .oscillator import at_angle, draw_oscillator, oscillator
from .rows import Check, Outcome, save_picture

# The paper gives neither damping nor force nor time step.  These are chosen:
OMEGA = np.linspace(100, 400, 121) * units.rad / units.s
DAMPING = 12 / units.s   # one damper for all: ratios 4.2, 2.8, 2.3 and 1.7 %, resonances all 12 rad/s wide
DT = 0.06 * units.ms     # Verlet raises a resonance by (omega dt)^2/24 <= 1.8e-5, which costs 5e-4 on its flank
FORCE = 0.01 * units.N   # moves the particle by 6e-6 L0 at most
IMPULSE = 1 * units.N * units.ms
FRAME = 1.2 * units.ms   # 13 frames to the shortest period
STEADY = 3e-4            # share of the transient that may be left
TOLERANCE = 1e-3
SPARSE = 5               # unconstrained, every so many frequencies
FEW = 20                 # D0 alone, every so many


def main(out):
    """Amplitudes and phases of the driven magnet (guided, free, and after one impulse) beside the linear theory."""
    paper = reference()['oscillator']
    angles = np.pi * np.array(paper['theta0_over_pi'])
    guided, free, impulse = respond(angles, OMEGA)
    complete, checks = [closed_form(t, OMEGA) for t in angles], []
    conventional, _, _ = respond(angles, OMEGA[::FEW], 'conventional')
    stiff = from_the_stiffness(angles)
    for k, (theta0, omega_0) in enumerate(zip(angles, paper['omega_y'], strict=True)):
        at = at_angle(theta0)
        step, phase = OMEGA[1] - OMEGA[0], np.angle(guided[:, k] / complete[k])
        checks += [
            Check(f'frf peak (rad/s), {at}', OMEGA[abs(guided[:, k]).argmax()] * units.s, omega_0, step * units.s / omega_0),
            Check(f'frf amplitude, error against the closed form, {at}', departure(guided[:, k], complete[k]), 0, TOLERANCE),
            Check(f'frf phase, error against the closed form (rad), {at}', abs(phase).max(), 0, 2 * TOLERANCE),  # twice as steep
            Check(f'frf from one impulse, error against the closed form, {at}',
                  departure(impulse.response[:, k], complete[k]), 0, TOLERANCE),
            Check(f'frf from the stiffness matrix, error against the closed form, {at}',
                  departure(stiff[:, k], complete[k]), 0, 1e-9),
        ]
        off = departure(conventional[:, k], complete[k][::FEW])
        if theta0 < np.pi / 2:
            checks += [Check(f'frf, free horizontally, error against the closed form, {at}',
                             departure(free[:, k], complete[k][::SPARSE]), 0, TOLERANCE),
                       Check(f'control: frf amplitude, time steps of D0 alone, {at}', off, 0, 0.5, control='D0')]
        else:
            checks.append(Check(f'frf amplitude, time steps of D0 alone, which is right here, {at}', off, 0, TOLERANCE))
    checks += ase_loop.resonance(paper['omega_y'][0], DAMPING * units.s)
    return Outcome(checks, [draw(out, paper, guided, free, complete)])


def departure(response, theory):
    """Largest relative difference of the amplitudes over the whole curve."""
    return abs(abs(response) / abs(theory) - 1).max()


def closed_form(theta0, omega):
    """Vertical displacement per force in mm/N, shape (frequencies,), guided along a line, without which pi/2 is unstable."""
    return closed_forms.receptance(theta0, omega * units.s, DAMPING * units.s) * units.m / units.N


def from_the_stiffness(angles):
    """The same responses without time steps, shape (frequencies, angles)."""
    atoms, magnets = batch(angles, range(len(angles)), 'complete')
    atoms.set_constraint([*atoms.constraints, FixedLine(magnets, (0, 1, 0))])
    push = np.zeros((len(atoms), 3))
    push[magnets, 1] = 1.0
    return harmonic_response(atoms, push, OMEGA, DAMPING).response[:, magnets, 1]


def respond(angles, omega, model='complete', dt=DT, steady=STEADY):
    """Responses in the time domain, all in one run.

    For every angle and frequency there is a replica that is guided along a vertical line and driven.  For every angle but the
    last, which is unstable, there are also free replicas; a sideways push at the start shows whether they are stable.  One more
    guided replica for every angle only receives a vertical impulse.

    Parameters
    ----------
    angles : ndarray
        In rad.
    omega : ndarray
        In rad/ms.
    model : {'complete', 'conventional'}
    dt, steady : float
        Time step in ms, and share of the transient that may be left.

    Returns
    -------
    guided : ndarray of complex, shape (frequencies, angles)
        In mm/N.
    free : ndarray of complex, shape (every SPARSE-th frequency, angles - 1)
    impulse : FrequencyResponse
        Of shape (frequencies, angles).
    """
    one, few = np.arange(len(angles)), omega[::SPARSE]
    on_line, off_line = (len(omega), len(one)), (len(few), len(one) - 1)
    which = [np.broadcast_to(one, on_line), np.broadcast_to(one[:-1], off_line), one]
    frequencies = [np.broadcast_to(omega[:, None], on_line), np.broadcast_to(few[:, None], off_line)]
    which, frequencies = (np.concatenate([x.ravel() for x in parts]) for parts in (which, frequencies))
    atoms, magnets = batch(angles, which, model)
    guided, free, struck = np.split(magnets, np.cumsum([np.prod(on_line), np.prod(off_line)]))
    driven = np.append(guided, free)

    atoms.set_constraint([*atoms.constraints, FixedLine(np.append(guided, struck), (0, 1, 0))])
    momenta = np.zeros((len(atoms), 3))
    momenta[free, 0] = momenta[struck, 1] = IMPULSE
    atoms.set_momenta(momenta)
    dyn = DrivenVerlet(atoms, dt, [Harmonic(driven, (0, 1), FORCE, frequencies, phase=np.pi / 2)], DAMPING)
    ringing, recorder = (Recorder(dyn, particles, interval=round(FRAME / dt)) for particles in (struck, driven))
    amplitudes, _ = steady_amplitudes(dyn, recorder, frequencies, axis=1, tolerance=steady)
    on, off = np.split(amplitudes / FORCE, [len(guided)])
    impulse = impulse_response(ringing.displacements[..., 1], ringing.interval * dt, IMPULSE, omega)
    return on.reshape(on_line), off.reshape(off_line), impulse


def batch(angles, which, model):
    """Many oscillators in one Atoms (number r at the angle `angles[which[r]]`), and the indices of their free magnets."""
    each = [oscillator(theta0, model) for theta0 in angles]
    return replicas([each[k] for k in which]), 3 + 4 * np.arange(len(which))


def draw(out, paper, guided, free, complete):
    """Draw the amplitude over frequency at each angle, with both natural frequencies and a sketch of the oscillator."""
    omega, unit = OMEGA * units.s, units.mm / units.N
    figure, axes = panels(2, 2, height=2.1)
    angles = [np.pi * share for share in paper['theta0_over_pi']]
    letter_panels(axes, [rf'$\theta_0 = {np.rad2deg(theta0):.0f}°$' for theta0 in angles])
    for k, (ax, theta0) in enumerate(zip(axes.flat, angles, strict=True)):
        ax.axvline(paper['omega_y'][k], color=COLOURS[0], label=r'$\omega_0$ of $D^0+D^{*}$')
        ax.axvline(paper['omega_y_D0'][k], color=COLOURS[1], linestyle='--', label=r'$\omega_0$ of $D^0$ alone')
        ax.plot(omega, abs(complete[k]) / unit, color='0.6', label='closed form')
        ax.plot(omega, abs(guided[:, k]) / unit, '.', color='k', markersize=2, label='simulated, on its line')
        if k < free.shape[1]:
            ax.plot(omega[::SPARSE], abs(free[:, k]) / unit, 'o', color=COLOURS[3], fillstyle='none', label='simulated, free')
        inset = ax.inset_axes((0.04 if k > 1 else 0.72, 0.5, 0.26, 0.48))
        draw_oscillator(inset, oscillator(theta0), named=False)
        inset.set_in_layout(False)
        ax.set(xlim=(omega[0], omega[-1]), ylim=(0, 1.05 * abs(guided).max() / unit))
    for ax in axes[1]:
        ax.set_xlabel(r'angular frequency $\omega$ (rad/s)')
    for ax in axes[:, 0]:
        ax.set_ylabel('displacement / force (mm/N)')
    legend_of_set(figure)
    return save_picture(figure, out / 'frf.png', 'Fig. 2 of the paper: frequency response of the oscillator. It peaks where '
                        'D0 + D* says; D0 alone is right only at 90 degrees, where all magnets stand in one line.')
