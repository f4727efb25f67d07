"""Foundations that change: a gap for waves in one direction, growth and its threshold, and a front through sites with two
wells.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from magphonon import (
    DrivenVerlet,
    InversePower,
    MagneticRepulsion,
    OnSite,
    Travelling,
    floquet_bands,
    lattices,
    read_scene,
    units,
    verdict,
)
from magphonon.plotting.axes import COLOURS, panels
from magphonon.plotting.floquet import plot_floquet

from .rows import Check, Outcome, save_picture

HZ = 2 * np.pi * units.Hz
EPS, W, ROWS = 0.05, 8 * HZ, 3          # depth and frequency of the modulation, rows per wave
GAP = -0.1254903                        # q along Gamma-M at which the gap is narrowest
DAMPING = 4 / units.s
MODELS = {'complete': -3, 'conventional': 0}
"""What D* adds to the exponent in the stiffness of shear across the rows."""
A, C, U, U2, K = 0.05, 0.5, 0.01, 0.3, 6.0  # of the front: depth of the wells, losses, their distance, the hill between, springs
NUMBER = 140                            # rows


def main(out):
    """Closed forms of coupled modes and an independent integration; controls: D0 alone, or the other side of a threshold."""
    fronts = {model: front(model) for model in MODELS}
    return Outcome([*gap(), *gain(), *speeds(fronts)], [picture(out, fronts)])


def prototype(eps, omega=W, rows=ROWS):
    """A cell of the prototype, with a modulation across the rows, or the same everywhere without rows."""
    cell = read_scene('prototype').perfect_cell()
    kap = (0, 2 * np.pi / (rows * cell.cell.array[1, 1]) if rows else 0)
    cell.calc = cell.calc.about(cell, foundation=Travelling(cell.calc.foundation, eps, omega, kap))
    return cell


def shear(q, model='complete'):
    """Angular frequency of shear across the rows: `m w^2 = k + (a - 3) f/L (1 - cos 2 pi q)`; D0 alone: a for a - 3."""
    cell = read_scene('prototype').perfect_cell()
    law, L = cell.calc.law, cell.calc.bonds.lengths[0]
    across = (law.a + MODELS[model]) * abs(law.dphi(L)) / L
    return np.sqrt((cell.calc.foundation + across * (1 - np.cos(2 * np.pi * q))) / cell.get_masses()[0])


def pair(bands):
    """The two frequencies between which the shear wave is split, and the smallest share of a wave that is not coupled."""
    by_weight = np.argsort(bands.weight[0])
    return np.sort(bands.omega[0, by_weight[1:3]].real), bands.weight[0, by_weight[2]]


def gap():
    """Shear that runs against the modulation couples to another wave; shear that runs with it does not."""
    cell = prototype(EPS)
    there, back = (floquet_bands(cell, [0, q, 0], tolerance=1e-11) for q in (GAP, -GAP))
    (low, high), _ = pair(there)
    crossing = {model: brentq(lambda q, model=model: shear(q + 1 / ROWS, model) - shear(q, model) - W, -1 / 6, 0)
                for model in MODELS}
    k, m = cell.calc.site_stiffness, cell.get_masses()[0]
    coupled = EPS * k / (2 * m * np.sqrt(shear(GAP) * shear(GAP + 1 / ROWS)))
    multipliers, T = monodromy(cell)
    away = abs(np.exp(-1j * there.omega[0] * T)[:, None] - multipliers).min(axis=1).max() / T
    wrong = abs(np.exp(-1j * back.omega[0] * T)[:, None] - multipliers).min(axis=1).max() / T
    return [Check('width of the gap at -q, in Hz', (high - low) / HZ, 0.476629, 2e-6),
            Check('width of this gap by coupled modes, eps k/(2 m sqrt(w1 w2)), in Hz', (high - low) / HZ, coupled / HZ, 2e-4),
            Check('middle of this gap in Hz, where two waves of the mean lattice differ by W', shear(crossing['complete']) / HZ,
                  33.18603, 1e-6),
            Check('control: D0 alone', shear(crossing['conventional'], 'conventional') / HZ, 33.18603, 0.01, control=True),
            Check('quasi-frequencies minus those from the monodromy matrix of three rows, in rad/ms', away, 0, 1e-11),
            Check('control: those at +q', wrong, 0, 1e-4, control=True),
            Check('share of the main harmonic at +q, where there is no gap', pair(back)[1], 1, 1e-3),
            Check('control: at -q', pair(there)[1], 1, 0.1, control=True)]


def monodromy(cell):
    """e^{-i w T} of all waves of three rows, by an integration of the equations of motion over one period of the modulation."""
    law, rows = cell.calc.parameters.foundation, cell.repeat((1, ROWS, 1))
    D = cell.calc.about(cell, foundation=law.k).on(rows).bloch_matrix(np.array([[0, ROWS * GAP, 0]]))[0]
    m, n = cell.get_masses()[0], 2 * ROWS

    def motion(t, y):
        x, v = y.reshape(2, n, -1)
        pumped = np.repeat(law.eps * np.cos(law.W * t - rows.positions @ law.kap), 2)
        return np.stack([v, -(D @ x + law.k * pumped[:, None] * x) / m]).ravel()

    T = 2 * np.pi / law.W
    end = solve_ivp(motion, (0, T), np.eye(2 * n, dtype=complex).ravel(), 'DOP853', rtol=1e-12, atol=1e-13).y[:, -1]
    return np.linalg.eigvals(end.reshape(2 * n, 2 * n)), T


def gain():
    """Shear half way to M on springs that change together at twice its frequency."""
    w = shear(0.25)

    def growth(eps, damping=0.0, model='complete'):
        return floquet_bands(prototype(eps, 2 * w, None), [0, 0.25, 0], model, damping).growth[0]

    cell = prototype(EPS)
    formula = EPS * cell.calc.site_stiffness / (4 * cell.get_masses()[0] * w)
    threshold = brentq(lambda eps: growth(eps, DAMPING), 0.07, 0.09, xtol=1e-9)
    held = [verdict(prototype(eps, 2 * w, None), damping=DAMPING).stable for eps in (0.0816, 0.0818)]
    return [Check('growth at W = 2 w, in 1/s', growth(EPS) * units.s, 1.223413, 1e-6),
            Check('growth at W = 2 w by eps k/(4 m w), in 1/s', growth(EPS) * units.s, formula * units.s, 1e-5),
            Check('control: D0 alone', growth(EPS, model='conventional') * units.s, 1.223413, 0.5, control=True),
            Check('depth above which it grows, with losses of 4 per s', threshold, 0.0817, 1e-3),
            Check('verdict at a depth of 0.0816: stable', held[0], 1, 1e-12),
            Check('verdict at a depth of 0.0818: stable', held[1], 0, 1e-12)]


def front(model):
    """Speed in rows per time and shapes of a front of shear through rows with two wells each, f = L = m = 1, a = 4."""
    rows = lattices.triangular(1.0, 1.0).repeat((1, NUMBER, 1))
    rows.pbc = (True, False, False)
    law = OnSite.along((1, 0), lambda u: A * (u**4 / (4 * U**2) - (1 + U2) * u**3 / (3 * U) + U2 * u**2 / 2),
                       lambda u: A * u * (u / U - U2) * (u / U - 1),
                       lambda u: A * (3 * u**2 / U**2 - 2 * (1 + U2) * u / U + U2), k=[[0.0, K]])
    rows.calc = MagneticRepulsion(rows, InversePower(1.0, 4.0), foundation=law, model=model).balanced(range(NUMBER))
    width = np.sqrt(2 * stiffness(model) / A)
    rows.positions[:, 0] += U / (1 + np.exp((np.arange(NUMBER) - 55) / width))
    dyn, shapes = DrivenVerlet(rows, 0.1, damping=C, engine='numpy'), []
    for _ in range(3):
        dyn.run(700)
        shapes.append(dyn.displacements[:, 0] / U)
    return (shapes[2].sum() - shapes[1].sum()) / 70, shapes


def stiffness(model):
    """Stiffness of the bonds between two rows against shear, (a - 3) f/2L; with D0 alone a f/2L."""
    return (4 + MODELS[model]) / 2


def speeds(fronts):
    """Speed of the front in the continuous chain, q sqrt(k/(c^2 + m q^2)) with q = sqrt(A/2) (1 - 2 u2)."""
    q = np.sqrt(A / 2) * (1 - 2 * U2)
    formula = {model: q * np.sqrt(stiffness(model) / (C**2 + q**2)) for model in MODELS}
    return [Check('front through the rows, in rows per time', fronts['complete'][0], formula['complete'], 5e-3),
            Check('control: D0 alone', fronts['conventional'][0], formula['complete'], 0.5, control=True),
            Check('front with D0 alone, against the formula for D0', fronts['conventional'][0], formula['conventional'], 5e-3)]


def picture(out, fronts):
    """Draw the gaps of the ready scene, and the front."""
    cell = read_scene('modulated').atoms()
    q = np.linspace(-0.5, 0.5, 161)
    row = cell.cell.array[1, 1]
    figure, axes = panels(1, 2, height=3.0)
    left, right = axes.flat
    plot_floquet(floquet_bands(cell, np.outer(q, [0, 1, 0]), tolerance=1e-3), 2 * np.pi * q / row, ax=left)
    left.set(ylim=(20, 60), xlabel='wavevector (rad/m): against the modulation, with it')
    left.get_legend().remove()
    left.set_title('(a)', loc='left')
    for (model, (_, shapes)), style, name in zip(fronts.items(), ('-', '--'), ('$D^0+D^*$', '$D^0$ alone'), strict=True):
        for n, u in enumerate(shapes):
            right.plot(u, style, color=COLOURS[list(MODELS).index(model)], label=name if not n else None)
    right.set(xlabel='row', ylabel='$u/U$')
    right.set_title('(b)', loc='left')
    right.legend()
    return save_picture(figure, out / 'modulation.png',
                        'Foundations that change. (a) Shear waves on springs that a wave modulates by 30 % at 8 Hz (ready scene '
                        '"modulated"): gaps open at different wavevectors for waves that run against it and with it. (b) A '
                        'front through rows '
                        'with two wells each, at three times: with D0 alone it runs twice as fast.')
