"""What is wrong is refused in the package's own words, with the value and the mend.

Each case is a call, the value that its message must show, and words of the mend.  The error must be raised in a file of
the package: a complaint of numpy, ASE, phonopy or pydantic that shines through fails the test.
"""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from ase.dft.kpoints import BandPath

import magphonon
from magphonon import (
    Bands,
    Harmonic,
    InversePower,
    MagneticRepulsion,
    PrescribedMotion,
    Tabulated,
    analytic_bands,
    explicit_bonds,
    find_bonds,
    finite_displacements,
    group_velocities,
    lattices,
    phonopy_bands,
    plot_bands,
    read_scene,
    ready_scene,
    sound_speeds,
)
from magphonon.bands import foundation_recovered
from magphonon.bands.phonopy_files import write_band_yaml, write_phonopy_params
from magphonon.bands.zone import ZoneMap, frequency_ratio, zone_map
from magphonon.cli.results import results
from magphonon.files import whole_file
from magphonon.plotting.modes import plot_mode
from magphonon.plotting.zone import plot_ratio, plot_zone
from magphonon.stiffness import bond_stiffness

PACKAGE = Path(magphonon.__file__).parent
NAN, INF = float('nan'), float('inf')
LAW = InversePower(b=1.0, a=4.0)
TRIANGLE = [(0, 0, 0), (1, 0, 0), (0.5, 0.8, 0)]


def magnets(positions=TRIANGLE, masses=1.0, **options):
    return Atoms(f'Nd{len(positions)}', positions=positions, masses=[masses] * len(positions), **options)


def cell(lattice=lattices.triangular, spacing=1.0, law=LAW, **options):
    atoms = lattice(spacing, 1.0)
    atoms.calc = MagneticRepulsion(atoms, law, **options)
    return atoms


def changed(change, after=False):
    """A cell that is changed before it gets its calculator, or after."""
    atoms = lattices.triangular(1.0, 1.0)
    if after:
        atoms.calc = MagneticRepulsion(atoms, LAW, foundation=0.1)
    change(atoms)
    if not after:
        atoms.calc = MagneticRepulsion(atoms, LAW)
    return atoms


def path(lattice=lattices.triangular, points='GM', spacing=1.0):
    atoms = lattice(spacing, 1.0)
    return atoms.cell.bandpath(points, npoints=5, pbc=atoms.pbc)


def bands(vectors=False, **options):
    return analytic_bands(cell(), path(**options), vectors=vectors)


def repulsion(reference=None, laws=LAW, **options):
    return MagneticRepulsion(magnets() if reference is None else reference, laws, **options)


def set_on(**parameters):
    repulsion().set(**parameters)


def moved(change):
    """Forces on a triangle of magnets after `change(atoms)`."""
    atoms = magnets()
    atoms.calc = repulsion(atoms)
    change(atoms)
    return atoms.get_forces()


def push(k, where):
    return lambda atoms: atoms.positions.__setitem__(k, where)


def held(atoms):
    atoms.set_constraint(FixAtoms([0]))
    return atoms


def with_cell(atoms, lengths):
    atoms.cell[:] = np.diag(lengths)
    atoms.calc = MagneticRepulsion(atoms, LAW)
    return atoms


class Nonsense:
    """A law with the three methods, and NaN for a force."""

    phi = dphi = d2phi = staticmethod(lambda r: np.nan * r)

    def __repr__(self):
        return 'Nonsense()'


def in_file(text):
    """The call on a file with this content."""
    def call(folder, reader):
        (folder / 'x').write_bytes(text)
        return reader(folder / 'x')
    return call


def npz_bytes(**arrays):
    from io import BytesIO

    file = BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def opened(context):
    with context:
        pass


def results_in(folder):
    return results(SimpleNamespace(output=folder, force=False))


CASES = {
    # laws
    'b NaN': (lambda: InversePower(b=NAN, a=4), 'nan', 'must be a positive number in N mm^a'),
    'table short': (lambda: Tabulated([1, 2, 3], [3, 2, 1]), '(3,)', 'at least 4 points'),
    'table NaN': (lambda: Tabulated([1, 2, 3, 4], [4, NAN, 2, 1]), 'f[1] is nan', 'must be a finite number'),
    'table unsorted': (lambda: Tabulated([1, 3, 2, 4], [4, 3, 2, 1]), '3.', 'sort them and drop repeats'),
    'table attracts': (lambda: Tabulated([1, 2, 3, 4], [4, 3, 2, -1]), '-1 N', 'must be positive (repulsive)'),
    'table left': (lambda: Tabulated([1, 2, 3, 4], [4, 3, 2, 1]).dphi(5.5), '5.5 mm', 'extend the measurement'),

    # lattices and patches
    'angle beyond': (lambda: lattices.oscillator(30, 1, 1), '30', '30 * units.deg'),
    'patch fraction': (lambda: lattices.parallelogram(lattices.square(1, 1), 2.5, 4), '2.5', 'n1 must be a whole number'),
    'patch of a chain': (lambda: lattices.parallelogram(lattices.chain(1, 1), 4, 4), '(1, 0, 0)', 'planar cell'),
    'patch too small': (lambda: lattices.parallelogram(lattices.square(1, 1), 2, 2), '4 particles', 'make it larger'),

    # bonds
    'shells zero': (lambda: find_bonds(magnets(), shells=0), '0', 'shells must be a whole number of at least 1'),
    'shells too many': (lambda: find_bonds(magnets(), shells=9), '9', 'lower the number'),
    'cutoff short': (lambda: find_bonds(magnets(), cutoff=0.25), '0.25 mm', 'increase it'),
    'cutoff on a shell': (lambda: find_bonds(lattices.square(1, 1), cutoff=2**0.5), '1.41421', 'move it between two shells'),
    'coincident': (lambda: find_bonds(magnets([(0, 0, 0), (0, 0, 0), (1, 0, 0)])), '0 and 1', 'move one of them'),
    'position NaN': (lambda: find_bonds(magnets([(0, 0, 0), (1, NAN, 0)])), 'particle 1', 'must be a finite number'),
    'alone': (lambda: find_bonds(magnets([(0, 0, 0)])), '1 particles', 'add particles'),
    'bond outside': (lambda: explicit_bonds(magnets(), [(0, 3)]), '(0, 3)', 'counted from 0'),
    'bond to itself': (lambda: explicit_bonds(magnets(), [(1, 1)]), '(1, 1)', 'name another particle'),
    'bond twice': (lambda: explicit_bonds(magnets(), [(0, 1), (1, 0)]), '(1, 0)', 'list each pair once'),
    'bond across': (lambda: explicit_bonds(magnets(), [(0, 1, (1, 0, 0))]), '(1, 0, 0)', 'keep its shift 0'),
    'bond between points': (lambda: explicit_bonds(magnets(), [(0, 0.5)]), '0.5', 'whole numbers'),
    'bond none': (lambda: explicit_bonds(magnets(), []), '[]', 'at least one pair'),
    'bond of no length': (lambda: explicit_bonds(magnets([(0, 0, 0)] * 2), [(0, 1)]), '0 and 1 coincide', 'move one of them'),
    'stiffness of no length': (lambda: bond_stiffness(np.zeros((1, 2)), LAW), '[0. 0.]', 'joins two particles'),

    # calculator
    'foundation negative': (lambda: repulsion(foundation=-2.5), '-2.5', 'must be a zero or positive number in N/mm'),
    'model unknown': (lambda: repulsion(model='full'), "'full'", "one of 'complete', 'conventional'"),
    'law without methods': (lambda: repulsion(laws=4.5), '4.5', 'see magphonon.interactions.PairLaw'),
    'law of NaN': (lambda: repulsion(laws=Nonsense()), 'force nan N', 'check its parameters'),
    'law out of reach': (lambda: repulsion(laws=Tabulated([2, 3, 4, 5], [4, 3, 2, 1])),
                         '0.943398 mm', 'extend the measurement'),
    'reference not planar': (lambda: repulsion(magnets([(0, 0, 0), (1, 0, 0.5)]), dim=2), '0.5 mm', 'must share one z'),
    'set unknown': (lambda: set_on(fundation=1), "'fundation'", "one of 'foundation', 'gyration', 'model'"),
    'set text': (lambda: set_on(foundation='stiff'), "'stiff'", 'must be a zero or positive number'),
    'other number': (lambda: repulsion().get_forces(magnets([(0, 0, 0), (1, 0, 0)])),
                     '3 particles, not 2', 'calculator.on(supercell)'),
    'other cell': (lambda: moved(lambda atoms: atoms.set_cell([3, 3, 3])),
                   'differs from the reference', 'make a calculator for this cell'),
    'displaced to NaN': (lambda: moved(push(2, NAN)), 'particle 2', 'finite number'),
    'displaced onto another': (lambda: moved(push(2, (0, 0, 0))), '0 and 2 coincide', 'start from smaller displacements'),
    'Hessian part': (lambda: repulsion().get_hessian(magnets(), part='D1'), "'D1'", "one of 'D0', 'Dstar'"),
    'supercell of another': (lambda: cell().calc.on(lattices.square(1, 1) * (3, 3, 1)),
                             'images of the cell', 'build it with repeat()'),

    # bands
    'bands model': (lambda: analytic_bands(cell(), path(), model='D0'), "'D0'", "one of 'complete', 'conventional'"),
    'bands without law': (lambda: analytic_bands(lattices.triangular(1, 1), path()), 'None', 'attach atoms.calc'),
    'bands of a patch': (lambda: analytic_bands(with_cell(magnets(), (9, 9, 9)), path()), 'not periodic', 'use the unit cell'),
    'path of another cell': (lambda: analytic_bands(cell(), path(lattices.square)), 'another shape', 'atoms.cell.bandpath'),
    'path as a list': (lambda: analytic_bands(cell(), ['G', 'M']), 'list', 'get one from atoms.cell.bandpath'),
    'path of unknown points': (lambda: analytic_bands(cell(), 'GQ'), 'GQ', 'your own wavevectors'),
    'wavevector NaN': (lambda: group_velocities(cell(), [[0.25, NAN, 0]]), 'q[0, 1] is nan', 'must be a finite number'),
    'wavevector planar': (lambda: group_velocities(cell(), [[0.25, 0.5]]), '(1, 2)', 'three fractions'),
    'wavevector text': (lambda: group_velocities(cell(), 'GMK'), "'GMK'", 'must hold numbers'),
    'sound nowhere': (lambda: sound_speeds(cell(), (0, 0)), '[0. 0.]', 'must not be zero'),
    'sound in space': (lambda: sound_speeds(cell(), (1, 0, 0)), '(3,)', 'must have the shape (2,)'),
    'modes not kept': (lambda: bands().polarisations, 'without modes', 'vectors=True'),
    'zone of a chain': (lambda: zone_map(cell(lattices.chain)), '(1, 0, 0)', 'along a path instead'),
    'zones that differ': (lambda: frequency_ratio(zone_map(cell(), 6), zone_map(cell(), 12)), '(', 'same atoms and steps'),

    # phonopy
    'displace without law': (lambda: finite_displacements(lattices.square(1, 1)), 'None', 'attach atoms.calc'),
    'displace a patch': (lambda: finite_displacements(with_cell(magnets(), (9, 9, 9))), 'not periodic', 'displace the unit cell'),
    'displace held particles': (lambda: finite_displacements(held(cell())), 'hold every particle', 'free at least one'),
    'supercell narrow': (lambda: finite_displacements(cell(), (2, 2, 1)), '(2, 2, 1)', 'give supercell=(3, 3, 1)'),
    'supercell tall': (lambda: finite_displacements(cell(), (3, 3, 2)), '(3, 3, 2)', 'give supercell=(3, 3, 1)'),
    'supercell planar': (lambda: finite_displacements(cell(), (3, 3)), '(3, 3)', 'as (3, 3, 1)'),
    'supercell fraction': (lambda: finite_displacements(cell(), (3, 3.5, 1)), '3.5', 'supercell[1] must be a whole number'),
    'distance zero': (lambda: finite_displacements(cell(), distance=0), 'not 0', 'distance must be a positive number in mm'),
    'distance of round-off': (lambda: finite_displacements(cell(), distance=0.9e-12), '9e-13', 'The default is'),
    'displace ghosts': (lambda: finite_displacements(changed(lambda atoms: setattr(atoms, 'symbols', 'X'))), "'X'", 'particle 0'),
    'displace a cell of two vectors': (lambda: finite_displacements(changed(lambda atoms: atoms.cell.__setitem__(2, 0))),
                                       'not 2', 'three lattice vectors'),
    'displace another cell': (lambda: finite_displacements(changed(lambda atoms: atoms.set_cell(1.1 * atoms.cell.array), True)),
                              'differs from the reference', 'make a calculator for this cell'),
    'distance large': (lambda: finite_displacements(cell(), distance=0.5), '0.5 mm', 'The default is'),
    'phonon without forces': (lambda: foundation_recovered(None), 'NoneType', 'finite_displacements(atoms)'),
    'phonopy path': (lambda: phonopy_bands(finite_displacements(cell()), path(spacing=2)),
                     'another shape', 'atoms.cell.bandpath'),

    # particles that do not exist
    'balanced nobody': (lambda: repulsion().balanced([99]), '[99]', 'indices from 0 to 2'),
    'balanced mask': (lambda: repulsion().balanced([True, False, True]), 'True, False', 'indices from 0 to 2'),
    'verdict drive': (lambda: magphonon.verdict(cell(), [Harmonic([99], (1, 0), 1.0, 2.0)]), '99', 'particles 0 to 0'),
    'verdict wall': (lambda: magphonon.verdict(cell(), [PrescribedMotion(Harmonic([7], (1, 0), 1.0, 2.0))]), '7', '0 to 0'),

    # pictures
    'drawn on another path': (lambda: plot_bands(bands(points='GK'), ax=plot_bands(bands())), 'GK', 'on the same path'),
    'mode without modes': (lambda: plot_mode(cell(), bands(), 'M', 0), 'without modes', 'vectors=True'),
    'mode beyond': (lambda: plot_mode(cell(), bands(vectors=True), 'M', 2), '2', 'must be 0 to 1'),
    'mode at no point': (lambda: plot_mode(cell(), bands(vectors=True), 'Z', 0), "'Z'", 'it has G, M, K'),
    'mode off the path': (lambda: plot_mode(cell(), bands(vectors=True), 'K', 0), 'K', 'choose a path that does'),
    'mode past the path': (lambda: plot_mode(cell(), bands(vectors=True), 5, 0), '5', 'from 0 to 4'),
    'zone of a line': (lambda: plot_zone(path(lattices.chain, 'GX')), 'GX', 'planar lattices'),
    'ratio of no branch': (lambda: plot_ratio(*[zone_map(cell(), 6)] * 2, branch=-1), '-1', 'must be 0 to 1'),

    # scenes by name
    'ready scene': (lambda: ready_scene('protoype'), "'protoype'", "'prototype'"),
}

# The same with a directory to try it in: (call(folder), value, mend)
FILE_CASES = {
    'bands missing': (lambda d: Bands.load(d / 'x.npz'), 'x.npz', 'compute bands and save()'),
    'bands foreign': (lambda d: in_file(b'not bands at all')(d, Bands.load), '/x ', 'compute them again and save()'),
    'bands of other arrays': (lambda d: in_file(npz_bytes(omega=np.ones(3)))(d, Bands.load), 'lacks', 'compute them again'),
    'bands nowhere': (lambda d: bands().save(d / 'no' / 'x.npz'), 'no/x.npz', 'choose another place'),
    'zone map foreign': (lambda d: in_file(b'')(d, ZoneMap.load), '/x ', 'and save()'),
    'band.yaml nowhere': (lambda d: write_band_yaml(finite_displacements(cell()), path(), d / 'no' / 'band.yaml'), 'no/band.yaml',
                          'choose another place'),
    'band.yaml without names': (lambda d: write_band_yaml(finite_displacements(cell()), BandPath(cell().cell, [[0.0, 0.0, 0.0]]),
                                                          d / 'band.yaml'), 'no special points', 'atoms.cell.bandpath'),
    'params nowhere': (lambda d: write_phonopy_params(finite_displacements(cell()), d / 'no' / 'p.yaml'), 'no/p.yaml',
                       'choose another place'),
    'file in a file': (lambda d: in_file(b'')(d, lambda file: opened(whole_file(file / 'y'))), 'x/y', 'choose another place'),
    'directory is a file': (lambda d: in_file(b'')(d, lambda file: opened(results_in(file))),
                            '/x is a file', 'name a directory'),
    'directory in a file': (lambda d: in_file(b'')(d, lambda file: opened(results_in(file / 'y'))),
                            'x/y', 'choose another place'),
    'directory in /proc': (lambda d: opened(results_in('/proc/x')), '/proc', 'choose another place'),
    'scene missing': (lambda d: read_scene(d / 'lattice.toml'), 'lattice.toml', '"magphonon scene" lists scenes'),
    'scene is a directory': (lambda d: read_scene(d), 'cannot be read', '"magphonon scene" lists scenes'),
}


def refusal(call):
    """The message of the error that `call` raises, after a check that the package itself raised it."""
    with pytest.raises((ValueError, OSError, NotImplementedError)) as caught:
        call()
    where = Path(caught.traceback[-1].path)
    assert PACKAGE in where.parents, f'{caught.value!r} comes from {where}'
    return str(caught.value)


@pytest.mark.parametrize(('call', 'value', 'mend'), CASES.values(), ids=CASES)
def test_refused_with_value_and_mend(call, value, mend):
    message = refusal(call)
    assert value in message
    assert mend in message


if not Path('/proc').exists():
    del FILE_CASES['directory in /proc']


@pytest.mark.parametrize(('call', 'value', 'mend'), FILE_CASES.values(), ids=FILE_CASES)
def test_files_refused_with_value_and_mend_and_nothing_left(call, value, mend, tmp_path):
    message = refusal(lambda: call(tmp_path))
    assert value in message
    assert mend in message
    assert {file.name for file in tmp_path.rglob('*')} <= {'x'}  # what the case itself put there


def test_truncated_bands_are_refused_at_every_length(tmp_path):
    bands(vectors=True).save(tmp_path / 'whole.npz')
    content = (tmp_path / 'whole.npz').read_bytes()
    for length in np.linspace(0, len(content) - 1, 20).astype(int):
        (tmp_path / 'cut.npz').write_bytes(content[:length])
        assert 'compute them again and save()' in refusal(lambda: Bands.load(tmp_path / 'cut.npz'))
    assert Bands.load(tmp_path / 'whole.npz').path.path == 'GM'  # the control: it was whole


def test_refused_change_changes_nothing():
    calc = repulsion(foundation=0.5)
    refusal(lambda: calc.set(foundation=1.5, model='full'))
    assert calc.parameters == {'foundation': 0.5, 'model': 'complete', 'gyration': 0.0}
