"""Scenes of particles from files, and scenes written from atoms: the same structure to the same bits."""

import ase.io
import numpy as np
import pytest
from ase.constraints import FixAtoms, FixBondLength
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices, modes, read_scene, relaxed, units as u
from magphonon.bands.bloch import bloch_modes
from magphonon.cli.main import main
from magphonon.scenes import write_scene
from magphonon.scenes.scene import Scene
from magphonon.stiffness import AllNeighbours
from tests.oracles import LAWS, Gaussian

LAW = {'kind': 'inverse_power', 'b_N_m_a': 1.6209e-10, 'a': 4.5824, 'shells': 1}
B = 1.6209e-10 * u.N * u.m**4.5824


def written(folder, seed):
    """Atoms with a calculator, drawn at random, and the scene that was written of them."""
    rng = np.random.default_rng(seed)
    name = ('triangular', 'honeycomb', 'square')[seed % 3]
    law = list(LAWS.values())[seed % 3]
    cell = getattr(lattices, name)(9.0 + rng.uniform(), rng.uniform(0.5, 1))
    if seed % 2:
        atoms = lattices.ribbon(cell, 3)
        atoms.positions[:, 0] += 0.01 * rng.normal(size=len(atoms))
    else:
        atoms = lattices.parallelogram(cell, 4, 5)
    atoms.set_masses(rng.uniform(0.5, 1.5, len(atoms)))
    atoms.calc = MagneticRepulsion(atoms, law, foundation=6 * law.d2phi(9.5), cutoff=12.0)
    atoms = relaxed(atoms).atoms
    write_scene(atoms, folder / 'mine.toml', 'A scene, "mine" \\ yours')
    return atoms


@pytest.mark.parametrize('seed', range(6))
def test_a_scene_written_from_python_is_the_same_to_the_last_bit(seed, tmp_path):
    atoms = written(tmp_path, seed)
    scene = read_scene(tmp_path / 'mine.toml')
    for again in (scene.atoms(), scene.perfect_cell()):
        assert np.array_equal(again.positions, atoms.positions)
        assert np.array_equal(again.get_forces(), atoms.get_forces())
        assert np.array_equal(again.get_masses(), atoms.get_masses())
        assert np.array_equal(again.calc.rest_hessian().toarray(), atoms.calc.rest_hessian().toarray())
        assert [c.todict() for c in again.constraints] == [c.todict() for c in atoms.constraints]
    assert scene.title == 'A scene, "mine" \\ yours'
    assert scene.finite == (not seed % 2)
    if seed % 2:
        q = [[0.3, 0, 0]]
        assert np.array_equal(bloch_modes(scene.atoms(), q)[0], bloch_modes(atoms, q)[0])
        assert scene.band_path().path == 'GX'
    assert sorted(file.name for file in tmp_path.iterdir()) == ['mine.toml', 'mine.traj']


@pytest.mark.slow
def test_commands_run_on_what_was_written(tmp_path, capsys):
    """`check` and `bands` of a strip between walls; `check` and `frf` of a patch; the others refuse in words."""
    written(tmp_path, 3)
    scene = str(tmp_path / 'mine.toml')
    assert main(['check', '--verbose', scene]) == 0
    assert 'The held particles and the foundation give a cut-off frequency' in capsys.readouterr().out
    assert main(['bands', '--verbose', scene, '-o', str(tmp_path / 'out')]) == 0
    said = capsys.readouterr().out
    assert 'particles from mine.traj' in said
    assert 'squared frequencies by phonopy and of the complete model differ' in said
    for command in ('burst', 'frf'):
        assert main([command, scene, '-o', str(tmp_path / command)]) == 2
        assert f'no table [{command}]' in capsys.readouterr().err


@pytest.mark.slow
def test_a_finite_structure_is_driven(tmp_path, capsys):
    atoms = written(tmp_path, 0)
    path = tmp_path / 'mine.toml'
    middle, other = (atoms.positions[k, :2] / u.m for k in np.flatnonzero(atoms.get_tags() == 0)[[0, -1]])
    path.write_text(path.read_text() + f"""
[frf]
from_Hz = 20.0
to_Hz = 90.0
points = 20
damping_per_s = 5.0
force = {{at_m = {middle.tolist()}, direction_deg = 0.0}}
response = {{at_m = {other.tolist()}, direction_deg = 90.0}}
""")
    assert main(['check', '--verbose', str(path)]) == 0
    assert 'Structure:' in capsys.readouterr().out
    assert main(['frf', '--verbose', str(path), '-o', str(tmp_path / 'out')]) == 0
    scene = read_scene(path)
    driven, source, answer = scene.shaken('conventional')
    assert driven.calc.model == 'conventional'
    assert np.array_equal(driven.positions[source.particle, :2] / u.m, middle)
    assert np.array_equal(driven.positions[answer.particle, :2] / u.m, other)
    assert scene.atoms().calc.model == 'complete'  # each has its own


def scene_in(folder, file, law=LAW, tables=(), **lattice):
    """The scene of a file in a folder, with further tables."""
    return Scene.model_validate({'title': 'mine', 'lattice': {'kind': 'file', 'file': file} | lattice, 'law': law} | dict(tables),
                                context={'folder': folder})


def csv(tmp_path, text, **lattice):
    (tmp_path / 'p.csv').write_text(text)
    return scene_in(tmp_path, 'p.csv', **lattice)


def test_a_table_of_positions_in_metres_is_a_lattice(tmp_path):
    """The honeycomb of two masses, typed as a table, against the ready one."""
    text = '# by hand\nx_m, y_m, mass_kg\n0, 0, 0.0007\n0.0, 0.01, 0.00105\n'
    vectors = [[0.01 * np.sqrt(3), 0.0], [0.005 * np.sqrt(3), 0.015]]
    atoms = csv(tmp_path, text, cell_m=vectors).atoms()
    ready = Scene.model_validate({'title': 'ready', 'law': LAW, 'lattice': {
        'kind': 'honeycomb', 'spacing_m': 0.01, 'mass_kg': 0.0007, 'relative_masses': [1.0, 1.5]}}).atoms()
    q = np.array([[0.5, 0, 0], [1 / 3, 1 / 3, 0], [0.21, 0.4, 0]])
    found = bloch_modes(atoms, q)[0]
    # bonds of both honeycombs differ by round-off, and perhaps by a rotation by 120 degrees, which M and K do not see
    assert_allclose(found[:2], bloch_modes(ready, q)[0][:2], rtol=1e-7, atol=1e-9)
    assert atoms.pbc.tolist() == [True, True, False]
    in_mm = csv(tmp_path, 'y_mm;x_mm;mass_g\n0;0;0,7\n10,0;0;1,05\n', cell_m=vectors).atoms()
    assert_allclose(in_mm.positions, atoms.positions, atol=1e-14)
    assert_allclose(in_mm.get_masses(), atoms.get_masses(), rtol=1e-14)
    lighter = csv(tmp_path, text.replace('0.00105', '0.0007'), cell_m=vectors).atoms()
    assert abs(bloch_modes(lighter, q)[0] - found).max() > 0.05 * found.max()  # the control


def test_columns_of_a_table(tmp_path):
    text = ('x_m,y_m,held,strength,stiffness_N_per_m,relative_damping\n'
            '0,0,1,1,0,1\n0.01,0,0,0.5,30,0.3\n0.02,0,1,1,0,0\n')
    scene = csv(tmp_path, text, mass_kg=0.0007)
    atoms = scene.cell()
    assert scene.finite
    assert atoms.constraints[0].index.tolist() == [0, 2]
    assert_allclose(atoms.arrays['strength'], [1, 0.5, 1])
    assert_allclose(atoms.arrays['stiffness'], [0, 0.03, 0])
    assert_allclose(atoms.arrays['relative_damping'], [1, 0.3, 0])
    assert_allclose(atoms.get_masses(), 0.7)
    assert_allclose(atoms.positions[:, 0], [0, 10, 20])
    calc = scene.atoms().calc
    assert_allclose(calc.strengths, [1, 0.5, 1])
    assert_allclose(calc.foundation, [[0, 0], [0.03, 0.03], [0, 0]])
    with pytest.raises(ValueError, match='the file has a column with the stiffness'):
        csv(tmp_path, text, mass_kg=1e-3, tables={'foundation': {'stiffness_N_per_m': 3.0}})


@pytest.mark.parametrize('name', ['p.extxyz', 'p.cif', 'p.vasp', 'p.json'])
def test_files_of_ase_are_read_in_mm(name, tmp_path):
    """A cubic crystal; formats keep five to sixteen digits."""
    cell = lattices.fcc(10.0, 0.7)
    if name == 'p.cif':
        cell = cell.copy()
        cell.set_masses(None)
    ase.io.write(tmp_path / name, cell)
    masses = {} if name in ('p.extxyz', 'p.json') else {'mass_kg': 0.0007}
    scene = scene_in(tmp_path, name, **masses)
    assert scene.lattice.spacing_m == pytest.approx(0.01, rel=1e-4)
    ready = lattices.fcc(10.0, 0.7)
    ready.calc = MagneticRepulsion(ready, InversePower(B, 4.5824))
    q = [[0.5, 0.5, 0.5]]
    assert_allclose(np.sort(bloch_modes(scene.atoms(), q)[0]), bloch_modes(ready, q)[0], rtol=2e-3)


def test_what_a_file_of_ase_leaves_open_is_told(tmp_path):
    """Which frame of a film is taken; and that lengths in metres make a crystal denser than any metal."""
    film = [lattices.triangular(spacing, 0.7) for spacing in (8.0, 9.0, 10.0)]
    ase.io.write(tmp_path / 'film.extxyz', film)
    with pytest.warns(UserWarning, match='a film of 3 frames; the scene takes the last one'):
        scene = scene_in(tmp_path, 'film.extxyz')
    assert scene.lattice.spacing_m == pytest.approx(0.01)
    ase.io.write(tmp_path / 'POSCAR', lattices.fcc(0.01, 0.7), format='vasp')
    with pytest.warns(UserWarning, match=r'denser than any metal; check their units, .* \(g and mm in files that ASE reads\)'):
        scene_in(tmp_path, 'POSCAR', mass_kg=7e-4)
    (tmp_path / 'grains.data').write_text('LAMMPS\n\n1 atoms\n1 atom types\n\n0 10 xlo xhi\n0 10 ylo yhi\n0 10 zlo zhi\n\n'
                                          'Atoms # sphere\n\n1 1 1.0 2.5 0 0 0\n')  # of which ASE reads no frame
    with pytest.raises(ValueError, match=r'ASE reads no structure in .*grains\.data .*; give one in a format of ASE'):
        scene_in(tmp_path, 'grains.data')


@pytest.mark.parametrize('column', ['held', 'mass_kg', 'stiffness_N_per_m'])
def test_columns_of_tables_mean_nothing_to_ase(column, tmp_path):
    """They must not be read and forgotten in silence."""
    atoms = lattices.honeycomb(10.0, 0.7)
    ase.io.write(tmp_path / 'mine.extxyz', atoms)
    scene_in(tmp_path, 'mine.extxyz')
    atoms.set_array(column, np.array([0, 1]))
    ase.io.write(tmp_path / 'mine.extxyz', atoms)
    with pytest.raises(ValueError, match=f'has the column {column}, which only tables'):
        scene_in(tmp_path, 'mine.extxyz')


def test_scattered_positions_repel_within_a_cutoff_and_relax(tmp_path):
    rng = np.random.default_rng(5)
    atoms = lattices.triangular(10.0, 0.7).repeat((4, 4, 1))
    atoms.positions[:, :2] += 0.3 * rng.normal(size=(16, 2))
    rows = '\n'.join(f'{x!r},{y!r}' for x, y in (atoms.positions[:, :2] / u.m).tolist())
    vectors = (atoms.cell.array[:2, :2] / u.m).tolist()
    with pytest.raises(ValueError, match=r'p\.csv.*cutoff_m'):
        csv(tmp_path, 'x_m,y_m\n' + rows, mass_kg=0.0007, cell_m=vectors)
    loose = csv(tmp_path, 'x_m,y_m\n' + rows, mass_kg=0.0007, cell_m=vectors, cutoff_m=0.0135)
    with pytest.raises(ValueError, match='not at rest'):
        analytic_bands(loose.atoms(), loose.lattice.path('GM', 3))
    settled = csv(tmp_path, 'x_m,y_m\n' + rows, mass_kg=0.0007, cell_m=vectors, cutoff_m=0.0135, positions='anchors')
    # without pillars they find back to the perfect lattice, but for a shift of the whole
    u_ = settled.atoms().positions - lattices.triangular(10.0, 0.7).repeat((4, 4, 1)).positions
    assert_allclose(u_ - u_.mean(axis=0), 0, atol=1e-7)


def test_a_cluster_in_space_moves_in_space(tmp_path, capsys):
    """A tetrahedron of bars turns and moves as a whole, and its closed form is that of a molecule X4: k/m times 1, 2 and 4."""
    (tmp_path / 'p.csv').write_text('x_m,y_m,z_m\n0.1,0.1,0.1\n0.1,-0.1,-0.1\n-0.1,0.1,-0.1\n-0.1,-0.1,0.1\n')
    (tmp_path / 's.toml').write_text('''title = "x"
lattice = {kind = "file", file = "p.csv", mass_kg = 2.0}
law = {kind = "members"}
[[members]]
between = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
stiffness_N_per_m = 50.0
tension_N = 0.0
''')
    found = modes(read_scene(tmp_path / 's.toml').atoms()).omega ** 2 / (50.0 * u.N / u.m / (2.0 * u.kg))
    assert_allclose(found, np.repeat([0, 1, 2, 4], [6, 2, 3, 1]), atol=1e-12)
    assert main(['check', str(tmp_path / 's.toml')]) == 0
    assert 'Stable, even without a foundation, besides 6 rigid motions of the whole.' in capsys.readouterr().out


@pytest.mark.parametrize(('text', 'lattice', 'message'), [
    ('x_m,y_m\n0,0\n', {'mass_kg': 1e-3}, 'one particle without periodic images'),
    ('x_m,y_m\n0,0\n0.01,0\n', {}, 'mass_kg is missing'),
    ('x_m,y_m,mass_kg\n0,0,1\n0.01,0,1\n', {'mass_kg': 1e-3}, 'the file has masses of its own'),
    ('x_m,y_m,held\n0,0,2\n0.01,0,1\n', {'mass_kg': 1e-3}, 'line 2 of .*: held must be 0 or 1, not 2'),
    ('x_m,y_m,mass_kg\n0,0,1\n0.01,0,-1\n', {}, 'line 3 of .*: mass_kg must be positive, not -1'),
    ('x_m,y_m\n0,0\n0,1e300\n', {'mass_kg': 1e-3}, 'line 3 of .*: y_m must lie within 1e6 m, not 1e'),
    ('x_m,y_m\n0,0\n-2e6,0\n', {'mass_kg': 1e-3}, 'line 3 of .*: x_m must lie within 1e6 m, not -2e'),
    ('x_m,y_m\n0,0\n0,0\n', {'mass_kg': 1e-3}, 'it puts the nearest particles 0 m apart'),
    ('x_m,y_m\n0,0\n0.01,0\n', {'mass_kg': 1e-3, 'cell_m': [[1, 0], [0, 1], [1, 1]]}, 'cell_m must hold one or two'),
])
def test_unsuitable_tables_are_refused(text, lattice, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        csv(tmp_path, text, **lattice)


def test_unsuitable_files_and_scenes_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r'none\.traj cannot be read'):
        scene_in(tmp_path, 'none.traj')
    (tmp_path / 'noise.xyz').write_text('nothing of the kind')
    with pytest.raises(ValueError, match=r'ASE reads no structure in .*noise\.xyz'):
        scene_in(tmp_path, 'noise.xyz')
    atoms = written(tmp_path, 1)
    with pytest.raises(ValueError, match=r'foundation: law\.kind = "saved" takes law, bonds'):
        scene_in(tmp_path, 'mine.traj', {'kind': 'saved'}, {'foundation': {'stiffness_N_per_m': 1.0}})
    with pytest.raises(ValueError, match=r'mine\.traj has a cell of its own; remove cell_m'):
        scene_in(tmp_path, 'mine.traj', cell_m=[[1, 0]])
    bare = lattices.ribbon(lattices.triangular(10.0, 0.7), 3)
    ase.io.write(tmp_path / 'bare.traj', bare)
    with pytest.raises(ValueError, match='written without a calculator of magphonon'):
        scene_in(tmp_path, 'bare.traj', {'kind': 'saved'})
    with pytest.raises(ValueError, match='uncertainty: tolerances are those of the bands'):
        scene_in(tmp_path, 'bare.traj', tables={'uncertainty': {'mass_percent': 1.0}})
    bare.set_constraint(FixBondLength(0, 1))
    ase.io.write(tmp_path / 'rods.traj', bare)
    with pytest.raises(ValueError, match='only FixAtoms, FixCartesian, FixedLine and FixedPlane are supported'):
        scene_in(tmp_path, 'rods.traj')
    with pytest.raises(ValueError, match=r'belongs to lattice\.kind = "file"'):
        Scene.model_validate({'title': 'mine', 'law': {'kind': 'saved'},
                              'lattice': {'kind': 'square', 'spacing_m': 0.01, 'mass_kg': 1e-3}})
    with pytest.raises(ValueError, match=r'a scene is a file NAME\.toml, not mine\.json'):
        write_scene(atoms, tmp_path / 'mine.json')
    with pytest.raises(ValueError, match='made of atoms with PairCalculator or AllNeighbours, not with None'):
        write_scene(bare, tmp_path / 'other.toml')
    cell = lattices.triangular(10.0, 0.7)
    cell.calc = MagneticRepulsion(cell, Gaussian())
    with pytest.raises(ValueError, match=r'Gaussian.*is not one of .*InversePower'):
        write_scene(cell, tmp_path / 'other.toml')
    assert not list(tmp_path.glob('other*'))
    held = lattices.triangular(10.0, 0.7).repeat((2, 1, 1))
    held.set_constraint(FixAtoms([0]))
    ase.io.write(tmp_path / 'held.traj', held)
    with pytest.raises(ValueError, match='it needs constraints and tags to mark its rim'):
        scene_in(tmp_path, 'held.traj', tables={'patch': {'kind': 'parallelogram', 'cells_1': 9, 'cells_2': 9}})


def test_all_neighbours_are_written_too(tmp_path):
    cell = lattices.honeycomb(10.0, 0.7)
    cell.calc = AllNeighbours(cell, LAWS['yukawa'], foundation=0.1)
    write_scene(cell, tmp_path / 'all.toml')
    q = np.array([[0.2, 0.1, 0]])
    assert np.array_equal(read_scene(tmp_path / 'all.toml').atoms().calc.bloch_matrix(q), cell.calc.bloch_matrix(q))
