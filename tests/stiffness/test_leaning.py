"""Leaning magnets, against second differences of the energy of dipoles that turn with their pillars."""

import numpy as np
import pytest

from magphonon import AllNeighbours, InversePower, MagneticRepulsion, Yukawa, lattices, read_scene, units as u
from magphonon.bands.bloch import bloch_modes
from magphonon.cli.main import main
from magphonon.scenes.scene import parts_of, ready_scene, scene_of
from magphonon.stiffness.leaning import leaning

STEP = 3e-3  # mm: differences are off by its square over that of the spacing, 1e-7, and round to 1e-11 N/mm
UPRIGHT = 1e9  # mm: the height of pillars that hardly turn


def dipole(height, u):
    """Moment of a magnet that leans by u, as a vector of unit length, and how far it goes down."""
    s = 1.5 / height
    angle = s * np.linalg.norm(u)
    along = u / np.linalg.norm(u) if angle else u
    return np.append(np.sin(angle) * along, np.cos(angle)), -0.6 * u @ u / height


def energy(law, height, R, ui, uj):
    """Two dipoles whose repulsion upright is the law, b r^-4: (m.m - 3 (m.n)(m.n)) b/(3 r^3)."""
    (mi, zi), (mj, zj) = dipole(height, ui), dipole(height, uj)
    r = np.append(R + uj - ui, zj - zi)
    d = np.linalg.norm(r)
    return law.b / 3 / d**3 * (mi @ mj - 3 * (mi @ r) * (mj @ r) / d**2)


def by_differences(calc, law, height, q):
    """Bloch matrix of the lattice from second differences of the energy of each bond, foundation included."""
    n, bonds = len(calc.reference), calc.bonds
    D = np.kron(np.eye(n), calc.foundation * np.eye(2)).astype(complex)
    for i, j, R, shift in zip(bonds.i, bonds.j, bonds.vectors[:, :2], bonds.shift, strict=True):
        def at(x, R=R):
            return energy(law, height, R, x[:2], x[2:])
        H = np.zeros((4, 4))
        e = STEP * np.eye(4)
        for a in range(4):
            for b in range(4):
                H[a, b] = (at(e[a] + e[b]) - at(e[a] - e[b]) - at(e[b] - e[a]) + at(-e[a] - e[b])) / (4 * STEP**2)
        turn = np.exp(2j * np.pi * shift @ q)
        D[2 * i:2 * i + 2, 2 * i:2 * i + 2] += H[:2, :2]
        D[2 * j:2 * j + 2, 2 * j:2 * j + 2] += H[2:, 2:]
        D[2 * i:2 * i + 2, 2 * j:2 * j + 2] += H[:2, 2:] * turn
        D[2 * j:2 * j + 2, 2 * i:2 * i + 2] += H[2:, :2] * turn.conj()
    return D


@pytest.mark.parametrize('seed', range(6))
def test_bloch_matrices_are_those_of_turning_dipoles(seed):
    rng = np.random.default_rng(seed)
    cell = getattr(lattices, ('triangular', 'square', 'honeycomb')[seed % 3])(rng.uniform(8, 12), 0.7)
    law, height = InversePower(rng.uniform(1e3, 3e3), 4.0), rng.uniform(60, 200)
    calc = MagneticRepulsion(cell, law, shells=1 + seed // 3, foundation=0.02)
    q = np.append(rng.uniform(-0.5, 0.5, 2), 0)
    upright = calc.bloch_matrix(q[None])[0]
    change = by_differences(calc, law, height, q) - by_differences(calc, law, UPRIGHT, q)
    found = leaning(calc, height).bloch_matrix(q[None])[0] - upright
    np.testing.assert_allclose(found, change, rtol=0, atol=1e-5 * abs(change).max())
    # the controls: two thirds of the slope, of a rigid pillar on a hinge, and the change itself, which is no rounding
    assert abs(leaning(calc, 1.5 * height).bloch_matrix(q[None])[0] - upright - change).max() > 0.3 * abs(change).max()
    assert abs(change).max() > 3e-4 * abs(upright).max()


def test_the_prototype_as_built():
    """The numbers of the derivation: 9 c of a foundation of 19.68 N/m, and 11 c at M."""
    scene = read_scene('prototype')
    atoms, leant = scene.perfect_cell(), scene.with_lean(True).perfect_cell()
    c = (1.5 / 150) ** 2 * -atoms.calc.laws.dphi(10.0) * 10 / 3
    for q, share, frequency in ((0, 9, 26.0668), (0.5, 11, 57.9648)):
        before, after = (bloch_modes(one, [[q, 0, 0]])[0][0, 0] for one in (atoms, leant))
        assert (before**2 - after**2) * 0.707 / c == pytest.approx(share, rel=1e-9)
        assert u.hertz(after) == pytest.approx(frequency, abs=1e-4)


def test_all_neighbours_lean_as_many_do():
    cell, law = lattices.triangular(10.0, 0.7), InversePower(2e3, 4.0)
    every = leaning(AllNeighbours(cell, law, foundation=0.02), 150.0)
    for reach in (20, 40):
        many = leaning(MagneticRepulsion(cell, law, cutoff=10.0 * reach + 1, foundation=0.02), 150.0)
        apart = many.foundation - every.foundation
        rest = 1.5 * every.laws.charges.b * 2 * np.pi / (np.sqrt(0.75) * 100) / (10.0 * reach + 1)  # of the integral beyond
        assert apart == pytest.approx(rest, rel=0.2)
    honeycomb = AllNeighbours(lattices.honeycomb(10.0, 0.7), law)
    with pytest.raises(ValueError, match='known for one magnet in a cell and laws in closed form'):
        leaning(honeycomb, 150.0)


def tables(**changes):
    """The prototype's, with leaning pillars and without what asks for upright ones."""
    found, _ = parts_of(read_scene('prototype'))
    found['foundation']['pillar']['lean'] = True
    found['patch']['side_m'] = 0.06
    for name, table in changes.items():
        found[name] = found.get(name, {}) | table if isinstance(table, dict) else table
    return found


def test_a_patch_leans_as_its_lattice_does():
    scene = scene_of(tables())
    patch, cell = scene.patch_atoms(), scene.perfect_cell()
    H = patch.calc.rest_hessian().toarray()
    inside = np.flatnonzero(np.bincount(np.r_[patch.calc.bonds.i, patch.calc.bonds.j]) == 6)
    assert len(inside) > 5
    block = np.mean([cell.calc.bloch_matrix(np.array([[a, b, 0]]))[0] for a in (0, 0.5) for b in (0, 0.5)], axis=0).real
    for site in inside:
        np.testing.assert_allclose(H[2 * site:2 * site + 2, 2 * site:2 * site + 2], block, atol=1e-12)


@pytest.mark.parametrize(('changes', 'message'), [
    ({'disorder': {'seed': 1, 'mass_percent': 1.0}}, r'of a perfect lattice; remove \[disorder\] or lean'),
    ({'uncertainty': {'mass_percent': 1.0}}, r'remove \[uncertainty\] or lean'),
    ({'lattice': {'kind': 'kagome'}, 'patch': None, 'frf': None, 'burst': None, 'vibrometer': None},
     'leaning gives the sites of this lattice different springs, or oblique ones'),
    ({'lattice': {'kind': 'fcc'}, 'patch': None, 'bands': None, 'frf': None, 'burst': None, 'vibrometer': None},
     'is not a perfect lattice of magnets on a plane'),
    ({'foundation': {'pillar': {'youngs_modulus_Pa': 71e9, 'radius_m': 1e-4, 'height_m': 0.15, 'lean': True}}},
     'lean so much that the magnets would tip over'),
])
def test_refusals(changes, message):
    with pytest.raises(ValueError, match=message):
        scene_of({name: table for name, table in tables(**changes).items() if table is not None})


@pytest.mark.slow
def test_check_says_what_leaning_does(capsys, tmp_path):
    """Where it matters: on the prototype, but not on pillars four times as thick, and not where it is taken in."""
    text = ready_scene('prototype').read_text()
    changes = {'mine': {'title': 'title'}, 'thick': {'7.9375e-4': '3.2e-3'},
               'lean': {'height_m = 0.15': 'height_m = 0.15\nlean = true'}}
    for name, changed in changes.items():
        for old, new in changed.items():
            assert old in text
            (tmp_path / f'{name}.toml').write_text(text.replace('side_m = 0.3', 'side_m = 0.06').replace(old, new))
    told = {}
    for name in changes:
        assert main(['check', '--verbose', str(tmp_path / f'{name}.toml')]) == 0
        told[name] = capsys.readouterr().out
    assert 'the lowest branch at Gamma from 26.5507 to 26.0668 Hz, at M from 58.2327 to 57.9649 Hz' in told['mine']
    assert 'Pillars lean' not in told['lean'] + told['thick']
    assert 'cut-off frequency of 26.0668 Hz' in told['lean']
    assert main(['explore', str(tmp_path / 'lean.toml'), '-o', str(tmp_path / 'page.html')]) == 2
    assert 'the explorer does not compute; omit lean' in capsys.readouterr().err


def test_other_laws_keep_their_range():
    law = leaning(MagneticRepulsion(lattices.square(10.0, 0.7), Yukawa(1.0, 0.1), foundation=0.02), 150.0).laws
    assert (law.decay, law.screening) == (1.0, 0.0)  # charges reach farther than what is screened
