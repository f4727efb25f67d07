"""Band diagrams and mode shapes, drawn in SI on matplotlib axes.

Every function takes a result and `ax`, and returns the axes.  Without `ax` it makes a figure of its own, which
pyplot never sees: `ax.figure.savefig('bands.png')`.  To show it on a screen, pass `ax=plt.figure().gca()`.
"""

from itertools import product

import numpy as np

from . import units
from .rest import repulsion_of
from .zone import ROUND_OFF

COLOURS = ('#0072B2', '#D55E00', '#000000', '#009E73', '#CC79A7', '#E69F00', '#56B4E9')
"""Okabe and Ito's colours, which colour-blind readers tell apart; in grey the line styles do."""

UNSTABLE = {'facecolor': '0.9', 'edgecolor': '0.6', 'hatch': '///', 'linewidth': 0}
"""Look of every region where modes are unstable."""

NEGLIGIBLE = 3e-5
"""Frequencies below this fraction of the highest one are zero in a picture, whatever their sign.

Squared frequencies by phonopy are good to 1e-9 of the highest one, and this is the root of it; growth as slow could not be seen.
"""

PREFIXES = {-6: 'µ', -3: 'm', 0: '', 3: 'k', 6: 'M', 9: 'G', 12: 'T'}
"""Prefixes of the unit by the power of ten."""

MARKERS = 40  # on each branch: few enough to see the line behind them

# Of a mode shape, in lattice constants: half the window, cells that fill it; and the longest arrow in bond lengths.
WINDOW, REACH, ARROW = 2.4, 5, 0.42


def new_axes(width=5.2, height=4.0):
    """Axes of a figure of its own, `width` x `height` in inches."""
    from matplotlib.figure import Figure

    return Figure((width, height), dpi=200, layout='compressed').add_subplot()


def legend_above(ax, **options):
    """Legend above the axes, where it covers no data, in as many columns as the figure is wide enough for."""
    options = {'loc': 'lower center', 'bbox_to_anchor': (0.5, 1.0), 'ncols': 3, 'frameon': False} | options
    for columns in range(options['ncols'], 0, -1):
        legend = ax.legend(**options | {'ncols': columns})
        if legend.get_window_extent().width < ax.figure.bbox.width:
            break
    return legend


def point_name(name):
    """Name of a special point as it is printed: Γ for G, an index lowered."""
    name = 'Γ' if name == 'G' else name
    return name if len(name) == 1 else f'{name[0]}$_{{{name[1:].lstrip("_")}}}$'


def plot_bands(bands, ax=None, label=None, **line):
    """Frequencies along the path; unstable modes below zero, as -|f|, in a shaded region.

    Parameters
    ----------
    bands : Bands
    ax : matplotlib.axes.Axes, optional
        Axes with other bands along the same path, to draw over them.
    label : str, optional
        One entry in the legend.
    **line
        Properties of `matplotlib.lines.Line2D`.  Markers are thinned unless `markevery` is given.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If the axes show bands along another path.
    """
    from matplotlib.cbook import normalize_kwargs
    from matplotlib.lines import Line2D

    ax = new_axes() if ax is None else ax
    x, ticks, names = bands.path.get_linear_kpoint_axis()
    at, names = _joined(ticks, [point_name(name) for name in names])
    if not ax.lines:
        ax.set_prop_cycle(color=COLOURS)
        ax.set_xticks(at, names)
        ax.grid(axis='x', color='0.7', linewidth=0.8)
        ax.tick_params(axis='x', length=0)
        ax.set_xlim(x[0], x[-1])
    elif len(ax.get_xticks()) != len(at) or not np.allclose(ax.get_xticks(), at, rtol=1e-6, atol=1e-9 * x[-1]):
        raise ValueError(f'these bands run along another path ({bands.path.path}, {x[-1]:g}/mm long) than those on the axes; '
                         'compute both on the same path')
    x, f = _broken(x, bands.frequencies_Hz, bands.path.kpts)
    look = {'markevery': max(1, len(x) // MARKERS)} | normalize_kwargs(line, Line2D)
    (first,) = ax.plot(x, f[:, 0], label=label, **look)
    ax.plot(x, f[:, 1:], **{'color': first.get_color()} | look)  # unlabelled: one entry in the legend
    _from_zero(ax)
    if label is not None:
        legend_above(ax)
    return ax


def _joined(ticks, names):
    """Ticks and names with one tick, 'X,M', where the path jumps."""
    at = np.unique(ticks)
    return at, [','.join(dict.fromkeys(name for tick, name in zip(ticks, names, strict=True) if tick == here)) for here in at]


def _broken(x, f, kpts):
    """Branches with a gap where the path jumps: there ASE's axis stands still and the wavevector does not."""
    jumps = np.flatnonzero((np.diff(x) == 0) & np.diff(kpts, axis=0).any(axis=1)) + 1
    return np.insert(x, jumps, np.nan), np.insert(f, jumps, np.nan, axis=0)


def _from_zero(ax):
    """Let the frequency axis start at zero, or below the lowest unstable mode, with the range under zero shaded."""
    for patch in [patch for patch in ax.patches if patch.get_gid() == 'unstable']:
        patch.remove()
    for text in [text for text in ax.texts if text.get_gid() == 'unstable']:
        text.remove()
    f = np.concatenate([line.get_ydata() for line in ax.lines])
    top, bottom = 1.05 * np.nanmax(f), 0.0
    if np.nanmin(f) < -NEGLIGIBLE * np.nanmax(abs(f)):
        bottom = np.nanmin(f) - 0.05 * (np.nanmax(f) - np.nanmin(f))
        ax.axhspan(bottom, 0, gid='unstable', zorder=0, **UNSTABLE)
        ax.text(1.01, bottom / 2, 'unstable', gid='unstable', rotation=90, va='center', transform=ax.get_yaxis_transform())
    ax.set_ylim(bottom, top)
    _print_in_suitable_unit(ax, max(top, -bottom))


def _print_in_suitable_unit(ax, largest):
    """Let the frequency axis, whose data are in Hz, print kHz or MHz where numbers of Hz would be unreadable."""
    from matplotlib.ticker import FuncFormatter, ScalarFormatter

    power = 0
    if largest > 0 and not 0.1 <= largest < 2e4:
        power = int(np.clip(3 * (np.log10(largest) // 3), min(PREFIXES), max(PREFIXES)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda f, _: f'{f / 10.0**power:.12g}') if power else ScalarFormatter())
    ax.set_ylabel(f'frequency ({PREFIXES[power]}Hz)')


def plot_mode(atoms, bands, q, mode, ax=None):
    """Shape of a mode: particles at rest, their orbits, and their displacements at the moment of the largest one.

    Modes of equal frequency may be mixed at will; of those one choice is drawn, and called degenerate.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell of a planar lattice with its MagneticRepulsion.
    bands : Bands
        Of these atoms, with modes (`vectors=True`).
    q : str or int
        Name of a special point on the path, or index of a wavevector of the path.
    mode : int
        Branch by ascending frequency, from 0; it is printed from 1.
    ax : matplotlib.axes.Axes, optional

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If the bands hold no modes, or the path has no such point, or the mode does not exist.
    """
    from matplotlib.collections import LineCollection

    if bands.vectors is None:
        raise ValueError('these bands were computed without modes; ask for them with vectors=True')
    where = _wavevector(bands.path, q)
    if not 0 <= mode < bands.omega.shape[1]:
        raise ValueError(f'mode must be 0 to {bands.omega.shape[1] - 1}, not {mode!r}')
    ax = new_axes(4.6, 4.6) if ax is None else ax
    bonds = repulsion_of(atoms).bonds
    cells = np.array(list(product(range(-REACH, REACH + 1), range(-REACH, REACH + 1), (0,))))
    rest = ((cells @ atoms.cell.array)[:, None] + atoms.positions)[..., :2] / units.m
    u = _displacements(bands.vectors[where, mode], atoms.get_masses(), bands.path.kpts[where], cells)
    u *= ARROW * bonds.lengths.min() / units.m / abs(u).max()  # of the longest orbit

    ends = np.stack([rest[:, bonds.i], rest[:, bonds.i] + bonds.vectors[:, :2] / units.m], axis=-2)
    ax.add_collection(LineCollection(ends.reshape(-1, 2, 2), colors='0.88', linewidths=1, zorder=1))
    turn = np.exp(1j * np.linspace(0, 2 * np.pi, 49))
    orbits = rest[..., None, :] + (u[..., None, :] * turn[:, None]).real
    ax.add_collection(LineCollection(orbits.reshape(-1, len(turn), 2), colors='0.55', linewidths=0.8, zorder=2))
    x, y = rest.reshape(-1, 2).T
    ax.plot(x, y, 'o', color='0.4', markerfacecolor='white', zorder=3)
    ax.quiver(x, y, *u.real.reshape(-1, 2).T, color=COLOURS[0], angles='xy', scale_units='xy', scale=1, width=0.007, zorder=4)

    half = WINDOW * atoms.cell.lengths()[:2].min() / units.m
    title = f'{_printed_wavevector(bands.path, where)}, branch {mode + 1}\n{_printed_frequency(bands, where, mode)}'
    ax.set(xlabel='$x$ (m)', ylabel='$y$ (m)', xlim=(-half, half), ylim=(-half, half), aspect='equal', title=title)
    return ax


def _displacements(vector, masses, q, cells):
    """Complex displacements of a mass-weighted mode in the `cells`, in its phase where the largest one is real."""
    u = vector / np.sqrt(masses)[:, None]
    largest = u.flat[abs(u).argmax()]
    return u * largest.conj() / abs(largest) * np.exp(2j * np.pi * cells @ q)[:, None, None]


def _wavevector(path, q):
    """Index on the path of a named special point, or of itself."""
    if isinstance(q, str):
        if q not in path.special_points:
            raise ValueError(f'the path has no special point {q!r}; it knows {", ".join(path.special_points)}')
        distance = abs(path.kpts - path.special_points[q]).max(axis=1)
        if distance.min() > 1e-6:
            raise ValueError(f'the path {path.path} does not pass through {q}; choose a path that does')
        return distance.argmin()
    if not 0 <= q < len(path.kpts):
        raise ValueError(f'q must be the name of a special point or an index from 0 to {len(path.kpts) - 1}, not {q!r}')
    return q


def _printed_wavevector(path, where):
    """Name of a special point, or the fractions of the reciprocal vectors."""
    for name, point in path.special_points.items():
        if abs(path.kpts[where] - point).max() < 1e-6:
            return point_name(name)
    return '$q$ = ({:.3g}, {:.3g})'.format(*path.kpts[where])


def _printed_frequency(bands, where, mode):
    """Frequency and polarisation, or the growth rate of an unstable mode."""
    if bands.omega[where, mode] < 0:
        return f'unstable, grows at {-bands.omega[where, mode] * units.s:.4g} 1/s'
    others = np.delete(bands.omega[where], mode)
    degenerate = abs(others - bands.omega[where, mode]).min(initial=np.inf) < ROUND_OFF * abs(bands.omega).max()
    polarisation = 'degenerate' if degenerate else bands.polarisations[where, mode]
    return f'{bands.frequencies_Hz[where, mode]:.4g} Hz' + (f', {polarisation}' if polarisation else '')
