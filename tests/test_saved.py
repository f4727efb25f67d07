"""Files of arrays say what they hold: the unit and the axes of each; files from before that can still be read."""

import json

import numpy as np
import pytest
from motion import patch

from magphonon import analytic_bands, propagate
from magphonon.bands import lattice_density
from magphonon.bands.bands import Bands
from magphonon.bands.density import DensityOfStates
from magphonon.design.sensitivities import StiffnessDerivative
from magphonon.design.uncertainty import Spread, Tolerances, frequency_spread
from magphonon.dynamics import Harmonic
from magphonon.response import localisation
from magphonon.response.frf import FrequencyResponse, harmonic_response
from magphonon.response.normal_modes import Localisation, Modes, modes
from magphonon.response.propagation import Transient
from magphonon.waves.spectrum import Spectrum, wavenumber_frequency


def told(path):
    """The arrays of a file, and what it says of them."""
    with np.load(path) as data:  # no pickle
        arrays = dict(data)
    return arrays, json.loads(str(arrays.pop('units')))


def response():
    atoms = patch()
    force = np.zeros((len(atoms), 3))
    force[24, 0] = 1.0
    omega = np.array([0.1, 0.2])
    return harmonic_response(atoms, force, omega, 0.01)


def spread(cell):
    tolerances = Tolerances({'mass': StiffnessDerivative(mass=1.0)}, [[1e-4]])
    return frequency_spread(cell, [[0.5, 0, 0], [0.1, 0, 0]], tolerances)


MADE = {
    Bands: lambda cell: analytic_bands(cell, cell.cell.bandpath('GM', npoints=5, pbc=cell.pbc), vectors=True),
    Modes: lambda cell: modes(patch()),
    FrequencyResponse: lambda cell: response(),
    Transient: lambda cell: propagate(patch(), [1.0, 2.0], [Harmonic([24], (1, 0), 1e-3, 0.5)], particles=[24]),
    Spectrum: lambda cell: wavenumber_frequency(np.sin(np.add.outer(np.arange(30.0), np.arange(16))), 0.1),
    Spread: spread,
    DensityOfStates: lambda cell: lattice_density(cell, steps=8),
    Localisation: lambda cell: localisation(modes(patch()), patch()),
}


@pytest.mark.parametrize('kind', MADE, ids=lambda kind: kind.__name__)
def test_every_array_has_a_unit_and_a_name_for_each_axis(kind, prototype, tmp_path):
    made = MADE[kind](prototype)
    made.save(tmp_path / 'x.npz')
    arrays, said = told(tmp_path / 'x.npz')
    assert said.keys() == arrays.keys()
    lengths = {}
    for name, array in arrays.items():
        axes = said[name]['axes']
        assert len(axes) == array.ndim or '...' in axes
        if '...' not in axes:  # the same axis is as long in every array
            assert all(lengths.setdefault(axis, length) == length for axis, length in zip(axes, array.shape, strict=True)
                       if axis not in ('dim', 'vectors'))
    np.savez(tmp_path / 'old.npz', **arrays)  # as it was before units were told
    for file in ('x.npz', 'old.npz'):
        again = kind.load(tmp_path / file)
        assert all(np.array_equal(getattr(again, name), array, equal_nan=array.dtype.kind in 'fc')
                   for name, array in arrays.items() if hasattr(again, name) and name != 'path')


@pytest.mark.parametrize('kind', MADE, ids=lambda kind: kind.__name__)
def test_a_result_shows_itself_in_a_line_whatever_its_size(kind, prototype):
    made = MADE[kind](prototype)
    line = repr(made)
    assert len(line) < 600
    assert '\n' not in line
    assert line.startswith(f'{kind.__name__}(')
    assert all(name in line for name in made.__dataclass_fields__ if getattr(made, name) is not None)


def test_the_line_names_shape_range_and_unit(prototype):
    line = repr(analytic_bands(prototype, prototype.cell.bandpath('GM', npoints=5, pbc=prototype.pbc)))
    assert 'omega=<5 x 2, 0.1668 to 0.9392 rad/ms>' in line  # 2 pi 26.55 Hz and 149.48 Hz


@pytest.mark.parametrize('kind', MADE, ids=lambda kind: kind.__name__)
def test_every_array_that_lacks_is_infinite_or_cut_is_refused(kind, prototype, tmp_path):
    MADE[kind](prototype).save(tmp_path / 'x.npz')
    with np.load(tmp_path / 'x.npz') as data:
        arrays = dict(data)
    kind.load(tmp_path / 'x.npz')  # the control
    lengths = [axis for entry in told(tmp_path / 'x.npz')[1].values() for axis in entry['axes']]
    for name, array in arrays.items():
        entry = told(tmp_path / 'x.npz')[1].get(name)
        if entry is None:  # the units
            continue
        spoiled = [{other: arrays[other] for other in arrays if other != name}]
        if array.dtype.kind in 'fc':
            spoiled.append(arrays | {name: np.full_like(array, np.inf)})
        if entry['axes'] and entry['axes'][0] not in ('...', 'dim', 'vectors') and lengths.count(entry['axes'][0]) > 1:
            spoiled.append(arrays | {name: array[1:]})
        for content in spoiled:
            np.savez(tmp_path / 'y.npz', **content)
            with pytest.raises(ValueError, match=r'not a complete file of .* compute them again'):
                kind.load(tmp_path / 'y.npz')


def test_units_are_what_the_numbers_are_in(prototype, paper, tmp_path):
    """The frequencies at M from the file alone, against the reference in Hz."""
    path = prototype.cell.bandpath('GM', npoints=5, pbc=prototype.pbc)
    analytic_bands(prototype, path, model='conventional').save(tmp_path / 'x.npz')
    arrays, said = told(tmp_path / 'x.npz')
    factor = {'rad/ms': 1e3 / (2 * np.pi), 'rad/s': 1 / (2 * np.pi)}[said['omega']['unit']]
    assert arrays['omega'][-1] * factor == pytest.approx(paper['prototype']['M_conventional_Hz'], rel=1e-9)
    assert said['cell']['unit'] == 'mm'
    assert np.linalg.norm(arrays['cell'][0]) == pytest.approx(10.0)  # the spacing, 0.01 m
