"""Files of arrays say what they hold: the unit and the axes of each."""

import json
import tracemalloc

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
    again = kind.load(tmp_path / 'x.npz')
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


def _in_thz(arrays):
    told = json.loads(str(arrays['units']))
    told['omega']['unit'] = 'THz'
    return arrays | {'units': json.dumps(told)}


@pytest.mark.parametrize(('spoil', 'fault'), [
    (lambda arrays: {name: arrays[name] for name in arrays if name != 'omega'}, 'others, or in other units'),
    (lambda arrays: {name: arrays[name] for name in arrays if name != 'units'}, 'lacks units, as files before 0.4; numpy.load'),
    (lambda arrays: arrays | {'units': '{'}, ''), (lambda arrays: arrays | {'power': np.zeros(3)}, 'power'),
    (_in_thz, 'others, or in other units'),
], ids=['an array lacks', 'the units lack', 'units that are no JSON', 'an array more', 'another unit'])
def test_files_of_other_arrays_are_refused(spoil, fault, prototype, tmp_path):
    file = tmp_path / 'x.npz'
    MADE[Bands](prototype).save(file)
    Bands.load(file)  # the control
    with pytest.raises(ValueError, match=r'not a complete file of spectra .* compute them again'):
        Spectrum.load(file)
    with np.load(file) as data:
        np.savez(tmp_path / 'y.npz', **spoil(dict(data)))
    (tmp_path / 'cut.npz').write_bytes(file.read_bytes()[:-100])
    for name, told_fault in (('y', fault), ('cut', '')):
        with pytest.raises(ValueError, match=rf'not a complete file of bands \(.*{told_fault}.* compute them again'):
            Bands.load(tmp_path / f'{name}.npz')
    with pytest.raises(FileNotFoundError, match=r'there is no file .* compute bands'):
        Bands.load(tmp_path / 'none.npz')


def test_a_compressed_file_is_not_unpacked(prototype, tmp_path):
    """A file of 60 kB that would fill 64 MB is refused before."""
    file = tmp_path / 'bands.npz'
    MADE[Bands](prototype).save(file)
    with np.load(file) as data:
        arrays = dict(data)
    Bands.load(file)  # the control
    np.savez_compressed(file, **arrays | {'omega': np.zeros((2**22, 2))})
    assert file.stat().st_size < 1e5
    tracemalloc.start()
    with pytest.raises(ValueError, match=r'does not pack.* small file .* fill the memory'):
        Bands.load(file)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**22


def test_units_are_what_the_numbers_are_in(prototype, paper, tmp_path):
    """The frequencies at M from the file alone, against the reference in Hz."""
    path = prototype.cell.bandpath('GM', npoints=5, pbc=prototype.pbc)
    analytic_bands(prototype, path, model='conventional').save(tmp_path / 'x.npz')
    arrays, said = told(tmp_path / 'x.npz')
    factor = {'rad/ms': 1e3 / (2 * np.pi), 'rad/s': 1 / (2 * np.pi)}[said['omega']['unit']]
    assert arrays['omega'][-1] * factor == pytest.approx(paper['prototype']['M_conventional_Hz'], rel=1e-9)
    assert said['cell']['unit'] == 'mm'
    assert np.linalg.norm(arrays['cell'][0]) == pytest.approx(10.0)  # the spacing, 0.01 m
