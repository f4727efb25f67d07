"""`magphonon fit FILE.csv`: the law of repulsion from measured forces."""

HELP = 'the law of repulsion from measured forces'
BENT = 3.0
"""Standard uncertainties by which the exponent must change before an inverse power is called wrong."""


def add_arguments(parser):
    parser.add_argument('file', metavar='FILE.csv', help='table with the columns r_m,f_N or r_m,f_N,sigma_N')
    parser.add_argument('--spacing', metavar='M', type=float, help='working spacing in m (default: the middle distance)')
    parser.add_argument('--contact', metavar='M', type=float, default=0.0,
                        help='distance of the centres at contact in m: a measurement below it is refused')
    parser.add_argument('--offset', action='store_true', help='fit the zero of the distance scale too')
    parser.add_argument('-o', '--output', metavar='DIR', help='directory for the picture and the entries for a scene file')


def run(options):
    import numpy as np

    from .. import units as u
    from ..errors import not_negative, positive
    from ..fits import curvature, fit_inverse_power, fit_spline, read_forces, scene_entry

    contact = not_negative('--contact', options.contact, 'm') * u.m
    forces = read_forces(options.file, contact)
    middle = forces.r[len(forces.r) // 2]
    spacing = middle if options.spacing is None else positive('--spacing', options.spacing, 'm') * u.m
    fits = {'force': fit_inverse_power(forces, spacing, 'force', options.offset),
            'log': fit_inverse_power(forces, spacing, 'log', options.offset)}
    try:
        fits['curve'] = fit_spline(forces, spacing)
    except ValueError as error:
        note = f'no smooth curve: {error}'
    else:
        note = None
    bend = curvature(forces) if len(forces.r) >= 4 else np.nan
    advised = 'curve' if abs(bend) > BENT and 'curve' in fits and not options.offset else 'force'
    if options.output is not None:
        _write(options, forces, fits)
    print(_report(options.file, forces, fits, bend, note))
    print(f'\nfor a scene file, {fits[advised].name}:\n\n{scene_entry(fits[advised])}', end='')
    if options.output is not None:
        print(f'\nthe picture and all entries are in {options.output}')


def _write(options, forces, fits):
    from ..fitplots import plot_fits
    from ..fits import scene_entry
    from ..results import results

    with results(options, table=options.file) as out:
        plot_fits(forces, list(fits.values())).savefig(out / 'fit.png')
        for name, fit in fits.items():
            (out / f'law_{name}.toml').write_text(scene_entry(fit), encoding='utf-8')


def _report(file, forces, fits, bend, note):
    """What each law says at the working spacing, and whether a power holds."""
    import numpy as np

    from .. import units as u

    some = next(iter(fits.values()))
    known = 'with' if forces.sigma is not None else 'without'
    lines = [f'{file}: {len(forces.r)} forces from {forces.r[0] / u.m:g} to {forces.r[-1] / u.m:g} m, {known} uncertainties',
             '', f'{f"at {some.spacing / u.m:g} m":44}{"f (N)":>22}{"df/dr (N/m)":>22}{"exponent":>20}{"chi2/freedom":>16}']
    for fit in fits.values():
        f, slope = (f'{value / unit:.6g} +- {sigma / unit:.2g}'
                    for value, sigma, unit in zip(fit.at_spacing, fit.sigma, (u.N, u.N / u.m), strict=True))
        a, chi2 = f'{fit.exponent:.5g} +- {fit.exponent_sigma:.2g}', f'{fit.chi2:.4g}/{fit.freedom:.4g}'
        lines.append(f'{fit.name:44}{f:>22}{slope:>22}{a:>20}{chi2 if np.isfinite(fit.chi2) else "-":>16}')
    var = some.strength_covariance
    if var[0, 0] > 0:
        lines.append(f'b alone is known to a factor exp({np.sqrt(var[0, 0]):.2g}), as its correlation with a is '
                     f'{var[0, 1] / np.sqrt(var[0, 0] * var[1, 1]):.6f}: f and df/dr are what was measured')
    if some.offset:
        lines += [f'zero of the distances: {some.offset / u.m:.4g} +- {some.offset_sigma / u.m:.2g} m in force, '
                  f'{fits["log"].offset / u.m:.4g} +- {fits["log"].offset_sigma / u.m:.2g} m in log force',
                  'An offset bends a law as the shape of the magnets does: fit it where the zero of the distances is in doubt.']
    elif abs(bend) > BENT:
        lines.append(f'No inverse power holds: the exponent {"rises" if bend > 0 else "falls"} with the distance by '
                     f'{abs(bend):.1f} standard uncertainties.')
    elif np.isfinite(bend):
        lines.append(f'An inverse power holds as far as these data can tell: the exponent changes by {abs(bend):.1f} '
                     'standard uncertainties.')
    return '\n'.join(lines if note is None else [*lines, note])
