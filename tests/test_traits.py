"""Every tool with every trait of a structure: it refuses in words what it does not declare, and ignores nothing that it does.

That the answers are right is compared with oracles in the tests of the rooms; here the answer must change with the trait.
"""

import inspect
import re
import zlib
from dataclasses import fields, is_dataclass
from functools import partial

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixedPlane

import magphonon as mp
from magphonon import (
    DrivenVerlet,
    InversePower,
    MagneticRepulsion,
    bands,
    design,
    lattices,
    response,
    stability,
    stiffness,
    waves,
)
from magphonon.bands.bands import cut_off
from magphonon.dynamics import highest_frequency, write_lammps_input
from magphonon.dynamics.engine import frequency_bound
from magphonon.interactions import UprightMagnets
from magphonon.response import Dof
from magphonon.stiffness import AllNeighbours, LinearSystem
from magphonon.traits import TOOLS, TRAITS, takes, trait

LAW, K = InversePower(16.0, 4.0), 80.0
Q = np.array([[0.3, 0.1, 0.0], [0.45, 0.2, 0.0]])
CELL, PATCH = lattices.honeycomb(1.0, 1.0), lattices.triangular(1.0, 1.0).repeat((3, 3, 1))
PATCH.pbc = False
"""A lattice, and a patch with free rim, at rest by dead loads."""


def made(atoms, law=LAW, k=K, **given):
    """The atoms with a calculator, at rest."""
    atoms = atoms.copy()
    atoms.calc = MagneticRepulsion(atoms, law, foundation=k, **given)
    if not atoms.pbc.any():
        atoms.calc = atoms.calc.balanced(range(len(atoms)))
    return atoms


def every(atoms):
    atoms = atoms.copy()
    atoms.calc = AllNeighbours(atoms, LAW, foundation=K)
    return atoms


def held(atoms):
    atoms = made(atoms)
    atoms.set_constraint(FixAtoms([1]))
    return atoms


HAVE = {  # how a structure comes by a trait, or by another feature
    'all neighbours': every,
    'gyration': partial(made, gyration=2.0),
    'constraints': held,
    'out of plane': lambda atoms: made(atoms, k=[[K, K, 500.0]], dim=3),
    'conventional': partial(made, model='conventional'),
    'attraction': lambda atoms: made(atoms, strengths=np.resize([1.0, -0.1, 1.2], len(atoms))),
    'oblique': lambda atoms: made(atoms, UprightMagnets(LAW), [[K, K, 500.0]], dim=3),
    'radii': lambda atoms: made(atoms, radii=np.resize([0.42, 0.5, 0.6], len(atoms))),
    'unlike': lambda atoms: made(atoms, k=K + 5.0 * np.arange(len(atoms))),
}


def path(atoms):
    return bands.band_path(atoms, 'GMK', 4)


def numbers(found):
    """All numbers of a result, in one row."""
    if isinstance(found, (Atoms, str)) or found is None:
        return found.positions.ravel() if isinstance(found, Atoms) else np.zeros(0)
    if is_dataclass(found):
        return numbers([getattr(found, f.name) for f in fields(found) if f.name not in ('path', 'case', 'system')])
    if isinstance(found, (tuple, list)):
        return np.concatenate([np.zeros(0), *map(numbers, found)])
    values = np.ravel(found)
    return np.nan_to_num(values.astype(complex)) if values.dtype.kind in 'biufc' else np.zeros(0)


def judged(atoms):
    found = mp.verdict(atoms, damping=0.01)
    assert str(found)  # for which every check is made
    return *vars(found['buckling']).values(), found['timestep_limit']


def lammps(atoms, tmp_path):
    write_lammps_input(tmp_path, atoms, 0.01, 10)
    return [zlib.crc32(file.read_bytes()) for file in sorted(tmp_path.iterdir())]


def moved(atoms):
    dyn = DrivenVerlet(atoms, 0.01, engine='ase')
    dyn.atoms.positions[0, 0] += 0.01
    dyn.run(20)
    return dyn.atoms.positions - PATCH.positions


def displaced(atoms):
    atoms.positions[1, :2] += 0.01, 0.02
    return atoms


def pushed(atoms):
    force = np.zeros((len(atoms), 3))
    force[4, :2] = 1e-3, 2e-3
    return force


def relaxed(atoms):
    """Without its dead load the patch grows."""
    atoms.calc = atoms.calc.about(atoms, load=np.zeros((len(atoms), 3)))
    return mp.relaxed(atoms).atoms


UP, DOWN, HARDER = Dof(4, (0, 1, 0)), Dof(5, (0.6, 0.8, 0)), [design.StiffnessDerivative(foundation=1.0, mass=0.2)]
SPREAD = design.Tolerances({'p': HARDER[0]}, np.eye(1))
CELLS = {
    'analytic_bands': lambda a: mp.analytic_bands(a, path(a)),
    'bloch_modes': lambda a: bands.bloch_modes(a, Q)[0],
    'damped_modes': lambda a: bands.bloch.damped_modes(a, Q, [0.1, 0.2])[0],
    'group_velocities': lambda a: mp.bands.group_velocities(a, Q).omega,
    'cut_off': cut_off,
    'sound_speeds': mp.bands.sound_speeds,
    'lattice_density': lambda a: bands.lattice_density(a, steps=6),
    'band_ranges': lambda a: bands.density.band_ranges(a, 6),
    'complex_bands': lambda a: abs(mp.bands.complex_bands(a, (0, 1, 0), [9.5]).xi[:, :2]),
    'neighbour_shifts': lambda a: bands.neighbour_shifts(a, Q),
    'converged_shells': lambda a: bands.converged_shells(a, Q, 1e-3),
    'finite_displacements': lambda a: mp.phonopy_bands(mp.finite_displacements(a), path(a)).omega,
    'critical_foundation': lambda a: mp.critical_foundation(a).k,
    'softest_of': lambda a: stability.buckling.softest_of(a).lowest,
    'frequency_shifts': lambda a: stability.frequency_shifts(a),
    'verdict': judged,
    'elastic_moduli': stiffness.elastic_moduli,
    'for_ase_tools': lambda a: displaced(mp.stiffness.for_ase_tools(a)).get_forces(),
    'frequency_sensitivities': lambda a: design.frequency_sensitivities(a, Q, HARDER),
    'frequency_spread': lambda a: design.frequency_spread(a, Q, SPREAD).std,
    'branch': lambda a: waves.branch(a, (0, 1, 0), 0).omega,
}
PATCHES = {
    'modes': lambda a: mp.modes(a).omega,
    'natural_frequencies': response.natural_frequencies,
    'local_modes': lambda a: response.local_modes(a, (0.0, 9.5)).omega,
    'frequency_response': lambda a: mp.frequency_response(a, pushed(a), [5.0, 9.0], 0.1),
    'harmonic_response': lambda a: response.harmonic_response(a, pushed(a), [5.0, 9.0], 0.1),
    'receptance': lambda a: response.receptance(a, UP, DOWN, [5.0, 9.0], 0.1),
    'propagate': lambda a: mp.propagate(a, [0.5, 1.0], [mp.ToneBurst(4, (0, 1), 1e-4, omega=5.0)]).displacements,
    'density_of_states': lambda a: response.density_of_states(a, np.linspace(5, 12, 9)),
    'critical_foundation': lambda a: mp.critical_foundation(a).k,
    'frequency_shifts': lambda a: stability.frequency_shifts(a),
    'mode_scatter': lambda a: design.mode_scatter(a, stiffness.Scatter(strength=0.01))[1],
    'write_lammps_input': lammps,
    'DrivenVerlet': moved,
    'highest_frequency': highest_frequency,
    'frequency_bound': lambda a: frequency_bound(a, 1e-3),
    'verdict': judged,
    'relaxed': relaxed,
}
ABOVE = {'out of plane', 'oblique'}  # here motion in the plane is the same with these, and all motion out of it is faster
SEEN = {'analytic_bands', 'bloch_modes', 'damped_modes', 'group_velocities', 'lattice_density', 'band_ranges', 'modes',
        'propagate', 'natural_frequencies', 'density_of_states', 'finite_displacements', 'frequency_spread',
        'verdict'}
"""Tools whose answers show motion out of the plane."""
SAME = {  # traits that change no answer, by the tool
    'cut_off': {'all neighbours', 'conventional', 'radii'},  # all particles move alike
    'sound_speeds': {'unlike'}, 'elastic_moduli': {'unlike'},  # of the lattice without its springs
    'converged_shells': {'all neighbours'},
    'verdict': {'gyration', 'constraints', 'conventional', 'oblique'},  # stiffness holds it, by the complete model
    'highest_frequency': {'gyration'},  # the limit of a step is that of stiffness
    'frequency_bound': {'gyration', 'constraints', 'conventional'},
    'relaxed': {'gyration', 'conventional'},  # statics are those of the complete model
}
OWN = {  # what a tool that takes a trait refuses of it in words of its own, and what these begin with
    'complex_bands': {'constraints': 'no bond has a component'}, 'neighbour_shifts': {'attraction': 'strengths'},
    'converged_shells': {'attraction': 'strengths'},
}


def asked(ask, atoms, tmp_path):
    return numbers(ask(atoms, tmp_path) if 'tmp_path' in inspect.signature(ask).parameters else ask(atoms))


LONG = {'finite_displacements'}  # tools that take several seconds for all traits


@pytest.mark.parametrize(('tool', 'base'), [pytest.param(name, base, marks=[pytest.mark.slow] * (name in LONG))
                                            for base, tools in ((CELL, CELLS), (PATCH, PATCHES)) for name in tools])
def test_no_trait_is_ignored(tool, base, tmp_path):
    ask = (CELLS if base is CELL else PATCHES)[tool]
    plain = asked(ask, made(base), tmp_path)
    taken = TOOLS[tool].takes | HAVE.keys() - TRAITS.keys()  # no tool refuses the others
    for name, have in HAVE.items():
        if name == 'all neighbours' and base is PATCH:
            continue
        atoms = have(base)
        if name not in taken:
            words = '|'.join(re.escape(one.words) for one in TRAITS.values() if one.has(atoms, atoms.calc))
            with pytest.raises(ValueError, match=f'{tool} does not support ({words})'):
                asked(ask, atoms, tmp_path)
        elif name in OWN.get(tool, ()):
            with pytest.raises(ValueError, match=OWN[tool][name]):
                asked(ask, atoms, tmp_path)
        elif name not in SAME.get(tool, set()) | (set() if tool in SEEN else ABOVE):
            found = asked(ask, atoms, tmp_path)
            assert found.shape != plain.shape or not np.allclose(found, plain, rtol=1e-6, atol=1e-9), name


UNEQUAL, B = np.array([1.2, 0.8]), 16.0


def of_unequal(base, way, strengths=UNEQUAL):
    """Particles of two strengths and springs: s_i s_j phi by their strengths, or as the laws of two kinds."""
    kinds = (np.arange(len(base)) % 3 == 1).astype(int)
    atoms = base.copy()
    atoms.set_tags(kinds)
    atoms.set_masses(np.array([0.7, 0.9])[kinds])
    springs = K * np.array([[1.0, 1.1], [1.2, 0.9]])[kinds]
    if way == 'strengths':
        return made(atoms, k=springs, strengths=strengths[kinds])
    if way == 'radii':  # phi = b r^-3/3 of r/(R_i + R_j)
        return made(atoms, k=springs, radii=strengths[kinds] / 2)
    if way == 'sums of radii':
        laws = {(i, j): InversePower(((strengths[i] + strengths[j]) / 2) ** 3 * 16.0, 4.0) for i, j in ((0, 0), (0, 1), (1, 1))}
        return made(atoms, laws, k=springs)
    laws = {(i, j): InversePower(strengths[i] * strengths[j] * B, 4.0) for i, j in ((0, 0), (0, 1), (1, 1))}
    return made(atoms, laws, k=springs)


NO_RADII = {'frequency_sensitivities', 'frequency_spread', 'mode_scatter', 'for_ase_tools', 'sound_speeds',
            'Structure'}
APART = {'write_lammps_input', 'neighbour_shifts', 'converged_shells', 'for_ase_tools'}
"""Tools that are not compared: of files, of one law, of sums that end elsewhere."""


@pytest.mark.parametrize(('given', 'alike'), [('strengths', 'kinds'), ('radii', 'sums of radii')])
@pytest.mark.parametrize(('tool', 'base'), [(name, base) for base, tools in ((CELL, CELLS), (PATCH, PATCHES)) for name in tools
                                            if name not in APART])
def test_strengths_and_radii_are_laws_of_kinds(tool, base, given, alike):
    ask = (CELLS if base is CELL else PATCHES)[tool]
    if given == 'radii' and ('radii' in OWN.get(tool, ()) or tool in NO_RADII):
        with pytest.raises(ValueError, match='sum of both radii'):
            ask(of_unequal(base, given))
        return
    found, expected, control = (numbers(ask(of_unequal(base, *way))) for way in (
        (given,), (alike,), (alike, np.array([1.2, 1.2]))))
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-10 * abs(expected).max())  # iterations end at 1e-9
    assert found.shape != control.shape or not np.allclose(found, control, rtol=1e-4, atol=0)


HELPERS = {'prestress_reserve', 'band_gaps', 'edge_weights', 'extracted_dstar', 'hessian_changes', 'response_slopes',
           'series_response', 'internal_strain', 'Shells', 'Structure', 'chern_numbers', 'edge_flow'}
"""Declared, and asked in the tests of their rooms: they take more than a structure."""


def test_every_declared_tool_is_asked():
    assert not TOOLS.keys() - CELLS.keys() - PATCHES.keys() - HELPERS


@pytest.fixture
def new_trait(monkeypatch):
    """All structures have it."""
    made_up = trait('painted', 'particles that are painted', 'wash them')(lambda atoms, calc: calc.painted)
    monkeypatch.setattr(MagneticRepulsion, 'painted', True, raising=False)
    yield made_up
    del TRAITS['painted']


@pytest.mark.parametrize(('tool', 'base'), [*((name, CELL) for name in CELLS), *((name, PATCH) for name in PATCHES)])
def test_a_new_trait_is_refused_everywhere_on_its_first_day(tool, base, new_trait, tmp_path):
    ask = (CELLS if base is CELL else PATCHES)[tool]
    atoms = made(base)
    with pytest.raises(ValueError, match='does not support particles that are painted; wash them'):
        asked(ask, atoms, tmp_path)


def test_also_by_tools_that_declare_nothing(new_trait):
    """At the door to linear theory, for atoms and for systems that others have made."""
    atoms = made(CELL)
    system = LinearSystem.of(atoms, 'painted')
    for door in LinearSystem.of, LinearSystem.nearest:
        for given in atoms, system:
            with pytest.raises(ValueError, match='a tool without a declaration does not support particles that are painted'):
                door(given)
            assert door(given, *((None,) if door == LinearSystem.nearest else ()), 'painted') is not None


def test_a_declaration_holds_for_all_that_a_tool_calls():
    @takes('gyration')
    def own(atoms):
        return LinearSystem.of(atoms).K.toarray()

    try:
        gyrating = HAVE['gyration'](CELL)
        assert own(gyrating).shape == (4, 4)
        with pytest.raises(ValueError, match=r'a tool without a declaration does not support particles that gyrate.*2000 rad/s'):
            LinearSystem.of(gyrating)
        assert LinearSystem.of(gyrating, 'gyration').turning
        with pytest.raises(ValueError, match="own does not support a calculator with model='conventional'"):
            own(HAVE['conventional'](CELL))
    finally:
        del TOOLS[next(name for name in TOOLS if name.endswith('own'))]


def test_supercells_that_other_tools_displace_are_asked_too():
    cell = HAVE['gyration'](CELL)
    large = cell.repeat((2, 2, 1))
    large.calc = cell.calc
    words = f'a tool that displaces particles of its own supercells does not support {TRAITS["gyration"].words}'
    with pytest.raises(ValueError, match=words):
        large.get_forces()


def test_what_is_set_later_is_asked_again():
    patch = made(PATCH)
    response.density_of_states(patch, moments=8, vectors=2)
    patch.calc.set(gyration=1.0)
    with pytest.raises(ValueError, match='density_of_states does not support particles that gyrate'):
        response.density_of_states(patch, moments=8, vectors=2)
    patch.calc.set(gyration=0.0)
    response.density_of_states(patch, moments=8, vectors=2)


def test_planes_that_keep_particles_in_their_plane_hold_nothing():
    cell = made(CELL)
    cell.set_constraint(FixedPlane([0, 1], (0, 0, 1)))
    assert np.array_equal(mp.bands.sound_speeds(cell), mp.bands.sound_speeds(made(CELL)))
    cell.set_constraint(FixedPlane([0, 1], (0, 1, 0)))
    with pytest.raises(ValueError, match='sound_speeds does not support particles that are held or guided'):
        mp.bands.sound_speeds(cell)
