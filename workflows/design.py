"""Design: the prototype recovered from two of its frequencies, and a design limited by stability."""

import numpy as np

from magphonon import read_scene, ready_scene, units
from magphonon.bands.bloch import bloch_modes
from magphonon.plotting.axes import COLOURS, UNSTABLE, legend_of_set, letter_panels, panels
from magphonon.scenes.plans import DesignPlan
from magphonon.scenes.scene import reference
from magphonon.scenes.tolerances import varied

from .rows import Check, Outcome, save_picture

HERTZ = 2 * np.pi * units.Hz
M = [[0.5, 0, 0]]
SOFT = 2.5        # an exponent below 3: without a foundation the triangular lattice buckles
WEAK = 10.0       # a foundation in N/m that holds it from some spacing on
SHARE = 0.6       # of the cut-off: the frequency wanted of it
SPACINGS_m = 0.007, 0.02


def main(out):
    """Spacing and foundation against the paper's; the soft lattice against its closed form; a frequency out of reach."""
    paper = reference()['prototype']
    scene = read_scene(ready_scene('design'))
    k, (found,) = scene.design.solve(scene)
    m, a = paper['mass'], paper['a']
    f_over_L = ((2 * np.pi * paper['M_complete_Hz'][0]) ** 2 * m - paper['k_eq']) / (2 * a)  # if the edge were D0's
    conventional = (paper['b'] / f_over_L) ** (1 / (a + 1))
    checks = [
        Check('design: spacing of the prototype (m)', found.spacing / units.m, paper['spacing'], 1e-9),
        Check('design: its foundation (N/m)', k / (units.N / units.m), paper['k_eq'], 1e-9),
        Check('control: spacing designed with D0 alone (m)', conventional, paper['spacing'], 0.1, control=True),
    ]

    soft, verge, cut_off = soft_lattice(scene, paper['f_at_spacing'] * paper['spacing'] ** SOFT)
    expected = verge * (1 - SHARE**2) ** (-1 / (SOFT + 1))  # w^2 = (k/m) (1 - (verge/L)^(a+1))
    _, (held,) = wish(soft, SHARE * cut_off).solve(soft)
    checks.append(Check(f'design: a = {SOFT}, M shear at {SHARE:g} of the cut-off, spacing (m)', held.spacing / units.m, expected,
                        1e-9))
    reach = cut_off * np.sqrt(1 - (verge / SPACINGS_m[1]) ** (SOFT + 1))
    checks.append(Check('design: largest frequency that the error message offers (Hz)', offered(soft, 2 * reach), reach, 1e-5))
    return Outcome(checks, [draw(out, scene, found, soft, held, verge)])


def soft_lattice(scene, b):
    """The scene with an exponent below 3 and a weak foundation; the spacing in m at which it buckles; its cut-off in Hz."""
    law = scene.law.model_copy(update={'a': SOFT, 'b_N_m_a': b})
    foundation = scene.foundation.model_copy(update={'pillar': None, 'stiffness_N_per_m': WEAK})
    verge = (2 * (3 - SOFT) * b / WEAK) ** (1 / (SOFT + 1))
    return (scene.model_copy(update={'law': law, 'foundation': foundation}), verge,
            np.sqrt(WEAK / scene.lattice.mass_kg) / (2 * np.pi))


def wish(scene, frequency):
    """A [design] table that asks for this frequency in Hz of the shear branch at M."""
    return DesignPlan(edge={'point': 'M', 'branch': 1, 'frequency_Hz': frequency}, spacings_m=list(SPACINGS_m))


def offered(scene, frequency):
    """The upper end in Hz of the range that the error message names if a frequency cannot be reached."""
    try:
        wish(scene, frequency).solve(scene)
    except ValueError as error:
        return float(str(error).rpartition(' to ')[2].removesuffix(' Hz'))
    return np.nan


def draw(out, scene, found, soft, held, verge):
    """Draw the frequency of shear at M over the spacing, in both lattices and models, with the designs found."""
    figure, (axes,) = panels(1, 2, height=2.5)
    stiff = reference()['prototype']['k_eq']
    letter_panels(axes, [f'prototype: $a$ = {scene.law.a:.2f}, $k$ = {stiff:.1f} N/m', f'$a$ = {SOFT}, $k$ = {WEAK:g} N/m'])
    spacings = np.linspace(*SPACINGS_m, 60) * units.m
    aside = ((-6, -12), 'right'), ((8, 8), 'left')  # where no curve runs
    for ax, case, k, answer, (place, side) in zip(axes, (scene, soft), (stiff, WEAK), (found, held), aside, strict=True):
        for model, line, colour in (('complete', '-', COLOURS[0]), ('conventional', '--', COLOURS[1])):
            f = [shear(case, L, k * units.N / units.m, model) for L in spacings]
            ax.plot(spacings / units.mm, f, line, color=colour, label=model)
        wanted = answer.value / HERTZ
        ax.plot(answer.spacing / units.mm, wanted, 'o', color='k', markersize=5, label='found for the wanted frequency')
        ax.annotate(f'{wanted:.3g} Hz', (answer.spacing / units.mm, wanted), place, textcoords='offset points', ha=side)
        ax.set(xlabel='spacing $L_0$ (mm)', xlim=np.array(SPACINGS_m) * 1e3, ylim=(0, 170))
    axes[1].axvspan(SPACINGS_m[0] * 1e3, verge * 1e3, zorder=0, **UNSTABLE)
    axes[1].text(SPACINGS_m[0] * 1e3 + 0.4, 12, 'buckles', bbox={'facecolor': 'w', 'linewidth': 0, 'pad': 1.5})
    axes[0].set_ylabel('shear frequency at M (Hz)')
    axes[1].tick_params(labelleft=False)
    legend_of_set(figure)
    return save_picture(figure, out / 'design.png',
                        'Spacings found for a wanted shear frequency at M. For an exponent a below 3 the static forces buckle '
                        'the lattice at small spacings. The conventional model does not show this; for the other law it gives a '
                        'wrong spacing.')


def shear(scene, spacing, k, model):
    """The lower frequency at M in Hz, NaN where that mode is unstable."""
    atoms = varied(scene, {'spacing': spacing / (scene.lattice.spacing_m * units.m)}).atoms()
    atoms.calc.set(foundation=k)
    omega = bloch_modes(atoms, M, model)[0][0, 0]
    return omega / HERTZ if omega >= 0 else np.nan
