"""The oscillator of Sec. III: static forces in the stiffness of one particle, and where they make it unstable."""

from dataclasses import replace

import numpy as np

from magphonon import InversePower, MagneticRepulsion, lattices, units
from magphonon.plotting.axes import COLOURS, UNSTABLE, legend_above, letter_panels, panels
from magphonon.scenes.scene import reference
from magphonon.stiffness.matrices import signed_root

from .rows import Check, Outcome, pairs, save_picture

LAW = InversePower(b=1e4 * units.N * units.m**4, a=4.0)
ROUND_OFF = 1e-9  # of the largest stiffness
FORCE = 0.55  # length of the longest arrow of a force in its drawing, in spacings


def stiffness(theta0, model='complete'):
    """Stiffness matrix of the free particle in N/m, shape (2, 2)."""
    atoms = oscillator(theta0, model)
    return atoms.calc.get_hessian(atoms).toarray()[9:11, 9:11] / (units.N / units.m)


def oscillator(theta0, model='complete'):
    """The paper's oscillator at the angle `theta0` in rad, held by a constant force: M = 1 kg, L0 = 1 m."""
    atoms = lattices.oscillator(theta0, spacing=1 * units.m, mass=1 * units.kg)
    atoms.calc = MagneticRepulsion(atoms, LAW, bonds=lattices.OSCILLATOR_BONDS, model=model).balanced([3])
    return atoms


def at_angle(theta0):
    """Name in the tables of an angle given in rad."""
    return f'theta0 = {np.rad2deg(theta0):.0f} deg'


def main(out):
    """Stiffness and frequencies at the paper's four angles, and as curves over the angle."""
    paper = reference()['oscillator']
    angles = np.pi * np.array(paper['theta0_over_pi'])
    complete = np.array([stiffness(t) for t in angles])
    conventional = np.array([stiffness(t, 'conventional') for t in angles])
    scale = 1.2e5  # the largest stiffness; entries that vanish are compared with it
    at, checks = [at_angle(t) for t in angles], []
    for name, values in (('D_xx', complete[:, 0, 0]), ('D_yy', complete[:, 1, 1]),
                         ('D0_xx', conventional[:, 0, 0]), ('D0_yy', conventional[:, 1, 1])):
        rows = pairs(f'oscillator {name} / largest stiffness', values / scale, np.array(paper[name]) / scale, 1e-9, at)
        printed = replace(rows[-1], by='printed: arXiv:1911.10410, Sec. III, D0 and D* at 90 degrees')
        checks += [*rows[:-1], printed]
        if name == 'D_xx':  # of the four that are printed D* alters this one
            checks.append(printed.against(conventional[-1, 0, 0] / scale))
    checks += pairs('oscillator omega_y (rad/s)', signed_root(complete[:, 1, 1]), paper['omega_y'], 1e-9, at)
    checks += pairs('oscillator omega_y, D0 alone (rad/s)', signed_root(conventional[:, 1, 1]), paper['omega_y_D0'], 1e-9, at)
    shifts = signed_root(complete[:, 1, 1]) - signed_root(conventional[:, 1, 1])
    paper_shifts = np.subtract(paper['omega_y'], paper['omega_y_D0'])
    checks += pairs('oscillator shift of omega_y by D* (rad/s), smaller at each larger angle', shifts, paper_shifts, 1e-8, at)
    checks += [Check(f'control: D0 alone as omega_y (rad/s), {name}', np.sqrt(d), w, 0.03, control='D0')
               for name, d, w in zip(at[:3], conventional[:3, 1, 1], paper['omega_y'], strict=False)]
    loads = [oscillator(t).calc.load[3, 1] / units.N for t in angles]
    checks += pairs('oscillator balancing force (N)', loads, paper['balancing_force_y'], 1e-9, at)

    from scipy.optimize import brentq

    critical = brentq(lambda t: stiffness(t)[0, 0], 0.8, 1.2, xtol=1e-13)
    checks.append(Check('oscillator critical angle (deg)', np.rad2deg(critical), paper['theta_critical_deg'], 1e-9))
    growth = np.sqrt(-stiffness(np.pi / 2)[0, 0])
    checks.append(Check('oscillator growth rate at pi/2 (1/s)', growth, paper['growth_rate_at_pi_over_2'], 1e-9))
    return Outcome(checks, [draw(out, critical)])


def draw(out, critical):
    """Draw the oscillator and its frequencies over the angle in both models, with the unstable range shaded."""
    theta = np.sort(np.append(np.linspace(0, np.pi / 2, 181), critical))
    figure, axes = panels(1, 2, height=2.7)
    letter_panels(axes)
    drawing, ax = axes[0]
    draw_oscillator(drawing, oscillator(np.pi / 6))
    ax.axvspan(np.rad2deg(critical), 90, **UNSTABLE)
    for model, line in (('complete', '-'), ('conventional', '--')):
        both = np.array([np.diag(stiffness(t, model)) for t in theta])
        for axis, colour in ((1, COLOURS[0]), (0, COLOURS[1])):
            D = both[:, axis]
            D[abs(D) < ROUND_OFF * abs(D).max()] = 0  # at the critical angle
            label = model if axis else None
            ax.plot(np.rad2deg(theta), np.where(D >= 0, signed_root(D), np.nan), line, color=colour, label=label)
    for name, height, colour in (('vertical', 165, COLOURS[0]), ('horizontal', 293, COLOURS[1])):
        ax.text(3, height, name, color=colour)
    ax.text(73.5, 225, 'horizontally\nunstable', ha='center', va='center', bbox={'facecolor': 'w', 'linewidth': 0})
    ax.set(xlabel=r'angle $\theta_0$ (deg)', ylabel=r'natural frequency $\omega$ (rad/s)', xlim=(0, 90), ylim=(0, 400))
    for handle in legend_above(ax, ncols=2).legend_handles:
        handle.set_color('k')  # the colours stand for directions
    return save_picture(figure, out / 'oscillator.png',
                        'Fig. 1 of the paper: the oscillator, drawn at 30 degrees, and its natural frequencies. D* lowers all '
                        'but the vertical one at 90 degrees; above 56.79 degrees the horizontal motion is unstable, which D0 '
                        'alone does not show.')


def draw_oscillator(ax, atoms, named=True):
    """Draw the free magnet, the fixed ones and the static forces, lengths in spacings; `named` adds the angle and names."""
    bonds = atoms.calc.bonds
    L0, n = bonds.lengths[0], np.array([-1, 1])[(bonds.i == 3).astype(int)][:, None] * bonds.vectors[:, :2]  # from the free one
    places = n / L0
    for x, y in places:
        ax.plot([0, x], [0, y], color='0.6', zorder=1)
    size = 5 if named else 3
    ax.plot(*places.T, 's', color='0.4', markersize=size)
    ax.plot(0, 0, 'o', color=COLOURS[0], markersize=1.4 * size, zorder=4)
    ax.set(aspect='equal', xlim=(-1.35, 1.35), ylim=(-1.5, 0.4))
    ax.set_axis_off()
    if not named:
        return
    for (x, y), length in zip(places, bonds.lengths, strict=True):
        push = atoms.calc.laws.dphi(length) / atoms.calc.laws.dphi(L0) * FORCE
        ax.annotate('', xy=(-push * x, -push * y), xytext=(0, 0), arrowprops={'arrowstyle': '->', 'color': COLOURS[1]}, zorder=3)
    theta0 = -np.arctan2(*places[np.argmax(places[:, 0])][::-1])
    arc = np.linspace(0, -theta0, 30)
    ax.plot([0, 1], [0, 0], ':', color='0.4', linewidth=0.8)
    ax.plot(0.45 * np.cos(arc), 0.45 * np.sin(arc), color='0.2', linewidth=0.8)
    ax.text(0.55 * np.cos(theta0 / 2), -0.55 * np.sin(theta0 / 2), r'$\theta_0$', ha='left', va='center')
    ax.text(0.06, -0.6, '$L_0$')
    ax.text(-0.16, 0, 'free', ha='right', va='center')
    ax.text(0.12, -1.02, 'fixed', va='center')
    ax.text(0.08, 0.45, 'static forces', color=COLOURS[1], va='top')
    ax.set_ylim(-1.15, 0.62)
