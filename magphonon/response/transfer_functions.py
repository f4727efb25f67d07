"""Measured transfer functions: tables of text, universal files (dataset 58), and raw records of a drive and its answer.

Whatever was measured, displacement, velocity or acceleration, a TransferFunction is a displacement per force, or per displacement
of a shaken bench: H of a velocity is divided by i w, H of an acceleration by -w^2. `order` keeps what was measured, because noise
is white in that quantity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import units as u
from ..errors import finite, one_of, positive
from ..quantities import FORCE, FREQUENCY, LENGTH, MOTIONS, PURE, TIME
from ..readers import content
from ..tables import MOST_BYTES, read_table
from ..universal import NO_FUNCTIONS, node_places, unit_of_label
from .frf import Dof

PER_FORCE = {f'{name}_per_N': factor / u.N for name, (factor, _) in MOTIONS.items()}
ORDERS = {f'{name}_per_N': order for name, (_, order) in MOTIONS.items()}
ESTIMATORS = 'H1', 'H2'
LAYOUT = ('transfer functions have the columns frequency_Hz, then re_m_per_N,im_m_per_N or amplitude_m_per_N,phase_deg (or mm, '
          'um, m_per_s, m_per_s2; re,im or amplitude,phase_deg alone for a shaken bench), and, where wanted, sigma_m_per_N, '
          'x_m,y_m,direction_deg of the point and drive_x_m,drive_y_m,drive_deg; records have time_s, drive_N and answer_m, '
          'answer_m_per_s or answer_m_per_s2, and record for several hits')
COLUMNS = {'frequency': FREQUENCY, 'time': TIME, 'drive': {'N': u.N}, 'record': PURE, 'phase': {'deg': u.deg, 'rad': 1.0},
           'answer': {name: factor for name, (factor, _) in MOTIONS.items()},
           'direction': {'deg': u.deg}, 'x': LENGTH, 'y': LENGTH, 'drive_x': LENGTH, 'drive_y': LENGTH,
           'drive_deg': {'': u.deg}, **dict.fromkeys(('re', 'im', 'amplitude', 'sigma'), PER_FORCE | PURE)}
ASKED = {'columns': COLUMNS, 'needed': [('frequency', 'time'), ('re', 'amplitude', 'answer')], 'layout': LAYOUT}
RESPONSE_FUNCTION, FREQUENCY_AXIS = 4, 18  # of dataset 58
QUANTITIES = {8: 0, 11: 1, 12: 2}  # ordinates of dataset 58: displacement, velocity, acceleration
FORCES = 9, 13  # force of reaction, and of excitation
INDEPENDENT = 18 / 19
"""Independent averages of many segments that overlap by a half, as a share of their number: under a Hann window neighbours share
(1/6)^2 of their spectrum (Welch 1967)."""
MOST_CUT = 0.9  # length of the shortest record, in the longest: shorter ones were cut before they died down
SEGMENTS = 8  # parts, half of each in the next one, of a continuous record


@dataclass(frozen=True, eq=False)
class TransferFunction:
    """One measured transfer function.

    Attributes
    ----------
    name : str
        Name of the file and the point.
    omega : ndarray, shape (frequencies,)
        In rad/ms.
    response : ndarray of complex, shape (frequencies,)
        In mm/N; if the bench is shaken, displacement per displacement of the bench.
    sigma : float or ndarray, shape (frequencies,), optional
        Standard uncertainty of real and imaginary part, in the unit of the response.
    order : {0, 1, 2}
        0, 1 or 2 if displacement, velocity or acceleration was measured.
    answer, drive : Dof, ndarray or None
        Where the motion is measured and driven: a Dof of a structure; or, as it was read, x and y in mm and the direction in rad,
        shape (3,); or None if the scene says where.  The drive of a fit may be the direction in which the bench is shaken, shape
        (3,).
    shaken : bool
        Whether the response is to the motion of the bench.
    coherence : ndarray, shape (frequencies,), optional
    """

    name: str
    omega: np.ndarray
    response: np.ndarray
    sigma: Any = None
    order: int = 0
    answer: Dof | np.ndarray | None = None
    drive: Dof | np.ndarray | None = None
    shaken: bool = False
    coherence: np.ndarray | None = None


def read_transfer(path: str | PathLike[str], estimator: str = 'H1') -> list[TransferFunction]:
    r"""Read transfer functions from a table of text or a universal file, or estimate one from raw records in a table.

    Parameters
    ----------
    path : path-like
        The columns of a table are listed in its error messages and on the page "Files".  A universal file holds functions of the
        type 4 in dataset 58, and the places of its nodes in dataset 15 or 2411.
    estimator : {'H1', 'H2'}
        Estimator for raw records, see `estimated`.

    Raises
    ------
    ValueError
        The message names the file and the column or node, and says how to correct it.

    Examples
    --------
    >>> import tempfile
    >>> from magphonon.response import read_transfer
    >>> file = tempfile.mkdtemp() + '/f.csv'
    >>> with open(file, 'w') as table:
    ...     _ = table.write('frequency_Hz,amplitude_mm_per_N,phase_deg\n20,0.5,-90\n21,0.25,-120\n')
    >>> [one] = read_transfer(file)
    >>> one.response.round(3)
    array([ 0.   -0.5j  , -0.125-0.217j])
    """
    one_of('the estimator', estimator, ESTIMATORS)
    held = content(path, MOST_BYTES)
    functions = _of_datasets(path, held) if isinstance(held, list) else _table(path, held, estimator)
    kept = []
    for one in functions:
        order = np.argsort(one.omega)
        omega = one.omega[order]
        if len(omega) < 2 or (np.diff(omega) == 0).any():
            raise ValueError(f'{one.name}: a transfer function needs at least two frequencies, each only once; if there are '
                             'several points, name them in x_m, y_m and direction_deg, otherwise keep one measurement')
        if not one.response.any():
            raise ValueError(f'{one.name} is zero at every frequency; was the answer recorded?')
        inside = order[omega > 0]  # no acceleration tells a displacement at zero
        rate = (1j * one.omega[inside]) ** one.order
        sigma = None if one.sigma is None else np.broadcast_to(one.sigma, one.omega.shape)[inside] / abs(rate)
        if sigma is not None and not (sigma > 0).all():
            raise ValueError(f'{one.name}: sigma must be positive; leave the column out where it is not known')
        kept.append(replace(one, omega=one.omega[inside], response=one.response[inside] / rate, sigma=sigma,
                            coherence=None if one.coherence is None else one.coherence[inside]))
    return kept


def estimated(drive: ArrayLike, answer: ArrayLike, dt: float, estimator: str = 'H1',
              segment: int | None = None) -> tuple[NDArray[Any], NDArray[np.complex128], NDArray[Any], NDArray[Any]]:
    """A transfer function and its coherence from records of a drive and its answer, by spectra of `scipy.signal`.

    H1 = S_xy/S_xx is not biased by noise in the answer, and H2 = S_yy/S_yx is not biased by noise in the drive. With noise in
    both, the truth lies between them.

    Parameters
    ----------
    drive, answer : array_like, shape (frames,) or (records, frames)
        Several records are separate hits, each long enough for the motion to die out. A single record is continuous and is
        divided into segments under a Hann window.
    dt : float
        Time between frames in ms.
    estimator : {'H1', 'H2'}
    segment : int, optional
        Frames of a segment of one record.  It must be several times 1/gamma long, or peaks are blurred; by default there are 8
        segments that overlap by a half.

    Returns
    -------
    omega : ndarray, shape (frequencies,)
        In rad/ms.
    H : ndarray of complex, shape (frequencies,)
    coherence : ndarray, shape (frequencies,)
        Share of the answer that follows the drive; 1 for a single record.
    sigma : ndarray, shape (frequencies,)
        Standard uncertainty of real and imaginary part, `|H| sqrt((1 - c)/(2 n c))` after n averages (Bendat and Piersol, Random
        Data, Sec. 9.2); NaN for a single record.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.response import estimated
    >>> x = np.random.default_rng(0).standard_normal(2**14)
    >>> omega, H, coherence, sigma = estimated(x, 2 * x, 1.0, segment=256)
    >>> bool(abs(H - 2).max() < 1e-9)
    True
    """
    from scipy.signal import csd

    x, y = np.atleast_2d(finite('drive', drive)), np.atleast_2d(finite('answer', answer))
    positive('dt', dt, 'ms')
    if x.shape != y.shape or x.shape[1] < 16:
        raise ValueError(f'drive and answer must be records of equal length, 16 frames or more, not {x.shape} and {y.shape}')
    settings: dict[str, Any]
    if len(x) > 1:
        settings, averages = {'nperseg': x.shape[1], 'window': 'boxcar', 'detrend': False}, len(x)
    else:
        segment = segment or 2 * x.shape[1] // (SEGMENTS + 1)
        settings = {'nperseg': segment}
        averages = (2 * x.shape[1] // segment - 1) * INDEPENDENT
    spectra = [np.mean(csd(a, b, 1 / dt, **settings)[1], axis=0) for a, b in ((x, x), (x, y), (y, y))]
    f = csd(x, x, 1 / dt, **settings)[0]
    xx, xy, yy = spectra[0].real, spectra[1], spectra[2].real
    with np.errstate(divide='ignore', invalid='ignore'):
        H = xy / xx if one_of('the estimator', estimator, ESTIMATORS) == 'H1' else yy / xy.conj()
        coherence = abs(xy) ** 2 / (xx * yy)
        share = np.sqrt(np.maximum(1 - coherence, 0) / (2 * averages * coherence))
        sigma = abs(H) * share if averages > 1 else np.full(len(f), np.nan)
    return 2 * np.pi * f, H, coherence, sigma


def _table(path, held, estimator):
    table = read_table(path, **ASKED, held=held)
    if {'time', 'drive', 'answer'} <= table.columns.keys():
        return [_from_records(table, estimator, *one) for one in _by_place(table)]
    parts = {'frequency', 're', 'im', 'amplitude', 'phase'} & table.columns.keys()
    if parts not in ({'frequency', 're', 'im'}, {'frequency', 'amplitude', 'phase'}):
        raise ValueError(f'{path} holds neither transfer functions nor records; {LAYOUT}')
    sizes = [name for name in ('re', 'im', 'amplitude', 'sigma') if name in table]
    if len({table.told[name].unit for name in sizes}) > 1:
        raise ValueError(f'{path}: {table.named(*sizes)} must have the same unit')
    per = table.told[sizes[0]].unit
    table.refuse('amplitude', table.get('amplitude', 0.0) < 0, 'not be negative (was it exchanged with the phase?)')
    h = table['re'] + 1j * table['im'] if 're' in table else table['amplitude'] * np.exp(1j * table['phase'])
    sigma = table.columns.get('sigma')
    return [TransferFunction(name, table['frequency'][rows], h[rows], sigma if sigma is None else sigma[rows],
                             ORDERS.get(per or '', 0), answer, drive, shaken=not per)
            for name, rows, answer, drive in _by_place(table, shaken=not per)]


def _by_place(table, shaken=False):
    """Yield name, rows, and place and direction of answer and drive of each function in a table; None for a place not given."""
    answer = _places(table, 'x', 'y', 'direction')
    drive = _places(table, *(['drive_deg'] if shaken and 'drive_x' not in table else ['drive_x', 'drive_y', 'drive_deg']))
    keys = np.column_stack([np.zeros(len(table)), *(place for place in (answer, drive) if place is not None)])
    _, of = np.unique(keys, axis=0, return_inverse=True)
    for group in dict.fromkeys(of.ravel().tolist()):
        rows = np.flatnonzero(of.ravel() == group)
        name = table.path
        if answer is not None:
            x, y, angle = answer[rows[0]]
            name = f'{table.path}, ({x:g}, {y:g}) mm, {angle / u.deg:.4g} degrees'
        yield str(name), rows, *(None if place is None else place[rows[0]] for place in (answer, drive))


def _places(table, *names):
    """Place and direction in each row, x, y and the angle, shape (rows, 3); None if the table has no such columns."""
    given = [name for name in names if name in table]
    if not given:
        return None
    if len(given) < len(names):
        raise ValueError(f'{table.path} has only {table.named(*given)}; a measured point needs x_m, y_m and direction_deg, a '
                         'force drive_x_m, drive_y_m and drive_deg')
    return np.column_stack([*[np.zeros(len(table))] * (3 - len(names)), *(table[name] for name in names)])


def _from_records(table, estimator, name, rows, place, source):
    """One transfer function from some rows of a table, which hold the records of one place, one record for each hit."""
    number = table.get('record', 0.0)[rows]
    split = [rows[number == one] for one in np.unique(number)]
    frames, most = min(map(len, split)), max(map(len, split))
    if frames < MOST_CUT * most:
        raise ValueError(f'{name}: its records have from {frames} to {most} frames; omit the records that were cut short')
    t = np.array([table['time'][own[:frames]] for own in split])
    dt = float(np.median(np.diff(t))) if frames > 1 else 0.0
    if not dt > 0 or abs(np.diff(t) - dt).max() > 0.01 * dt:
        raise ValueError(f'{name}: the times of each record must rise in the same equal steps; resample it')
    drive, answer = (np.array([table[what][own[:frames]] for own in split]) for what in ('drive', 'answer'))
    omega, H, coherence, sigma = estimated(drive, answer, dt, estimator)
    order = MOTIONS[table.told['answer'].unit][1]
    good = np.isfinite(H) & (omega > 0)
    known = np.isfinite(sigma[good]).all() and (sigma[good] > 0).all()
    return TransferFunction(name, omega[good], H[good], sigma[good] if known else None, order, place, source,
                            coherence=coherence[good])


def _of_datasets(path, sets):
    (metre, places), newton = node_places(path, sets), next((one['force'] for one in sets if one['type'] == 164), 1.0)
    functions = [one for one in sets if one['type'] == 58]
    found = [_function(path, one, metre, newton, places) for one in functions if one['func_type'] == RESPONSE_FUNCTION]
    if not found:
        types = sorted({one['func_type'] for one in functions})
        raise ValueError(f'{path} {NO_FUNCTIONS} (type 4 of dataset 58), but functions of the types {types}; '
                         'export transfer functions, or the raw records as a table')
    if len(found) > 1 and not places:
        raise ValueError(f'{path} does not say where its nodes are, and all of {", ".join(one.name for one in found)} would be '
                         'taken for the point of [frf.response]; export the geometry too (dataset 15), or one function per file')
    return found


def _function(path, one, metre, newton, places):
    """The transfer function of a dataset in a file whose units of length and force are 1/metre and 1/newton."""
    name = f'{path}, node {one["rsp_node"]}, direction {one["rsp_dir"]}'
    what, per = one['ordinate_spec_data_type'], one['orddenom_spec_data_type']
    shaken, order = what == per, QUANTITIES.get(what, 0)
    if what not in QUANTITIES or per not in (what, 0, *FORCES) or one['abscissa_spec_data_type'] not in (0, FREQUENCY_AXIS):
        raise ValueError(f'{name}, is not a displacement, velocity or acceleration per force or per motion of the bench (types '
                         f'{what} and {per}); export it as one of these')
    if not np.imag(one['data']).any():
        raise ValueError(f'{name}, has no imaginary part; export complex functions')
    motions = {name: factor for name, (factor, own) in MOTIONS.items() if own == order}
    own = u.m * u.s**-order / metre
    under = unit_of_label(path, one, 'orddenom', *((motions, own) if shaken else (FORCE, u.N / newton)))
    ratios = {f'{a}_per_{b}': x / y * under for a, x in motions.items() for b, y in FORCE.items()}  # in one label
    unit = unit_of_label(path, one, 'ordinate', motions | ratios, own) / under
    hertz = unit_of_label(path, one, 'abscissa', FREQUENCY | {'rad/s': 1 / u.s}, FREQUENCY['Hz'])
    drive = _end(path, one, 'ref', places, needed=not shaken)
    return TransferFunction(name, hertz * np.asarray(one['x'], float), unit * np.asarray(one['data'], complex), None,
                            0 if shaken else order, _end(path, one, 'rsp', places), drive, shaken=shaken)


def _end(path, one, end, places, needed=True):
    """Place and direction of one end of a function: x, y and the angle; None if the file has no geometry, or not of this end."""
    node, direction = int(one[f'{end}_node']), int(one[f'{end}_dir'])
    if not places or not (needed or node in places):
        return None
    if node not in places:
        raise ValueError(f'{path}: node {node} is not in its geometry (datasets 15 and 2411); export it again')
    if abs(direction) not in (1, 2):
        raise ValueError(f'{path}: node {node} is measured or driven in the direction {direction}; only x and y (1, 2) lie in '
                         'the plane')
    return np.array([*places[node], {1: 0.0, 2: np.pi / 2}[abs(direction)] + np.pi * (direction < 0)])
