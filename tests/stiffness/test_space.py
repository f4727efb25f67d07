"""Structures in space that no period holds, and gyration about any axis: against an energy and equations of the test's own."""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixedLine, FixedPlane
from numpy.testing import assert_allclose
from scipy.linalg import expm
from structures import few_first

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices, modes
from magphonon.response import frequency_response
from magphonon.stiffness import LinearSystem, Scatter, scattered, with_vacancies
from tests.oracles import second_derivatives

pytestmark = pytest.mark.filterwarnings('ignore:the foundation of')  # stiff on purpose: all waves are real

B, A = 3000.0, 4.0


def cluster(seed, **given):
    """Particles drawn in a box, all bonded, with masses, strengths and springs of their own; some attract each other."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 7))
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])[rng.choice(8, n, replace=False)]
    atoms = Atoms(f'Nd{n}', 10.0 * corners + rng.uniform(-1, 1, (n, 3)), masses=rng.uniform(0.5, 2, n))
    strengths = rng.uniform(0.5, 1.0, n) * (1 - 2 * (np.arange(n) < seed % 3))  # of either sign
    springs = rng.uniform(4.0, 8.0, (n, 3)) if seed % 2 else 6.0
    atoms.calc = MagneticRepulsion(atoms, InversePower(B, A), cutoff=30.0, strengths=strengths, foundation=springs, **given)
    atoms.calc = atoms.calc.balanced(range(n))
    return atoms, rng


def energy_of(atoms, springs):
    """Sum over all pairs of B/(a - 1) s s r^(1 - a), and of the springs, analytic in the displacements, flat."""
    i, j = np.triu_indices(len(atoms), 1)
    s, R = atoms.calc.strengths, atoms.positions[j] - atoms.positions[i]

    def energy(u):
        u = u.reshape(*u.shape[:-1], -1, 3)
        d = R + u[..., j, :] - u[..., i, :]
        pairs = s[i] * s[j] * B / (A - 1) * (d * d).sum(axis=-1) ** ((1 - A) / 2)
        return pairs.sum(axis=-1) + (springs * u**2).sum(axis=(-2, -1)) / 2

    return energy


def stiffness(atoms):
    return second_derivatives(energy_of(atoms, atoms.calc.sites.foundation), np.zeros(3 * len(atoms)), radius=1.0)


def velocity_matrix(g, masses):
    """What -m v x g is of v, dense: by NumPy's cross product of each unit vector."""
    C = np.zeros((3 * len(masses), 3 * len(masses)))
    for k, (one, m) in enumerate(zip(g, masses, strict=True)):
        for x in range(3):
            C[3 * k : 3 * k + 3, 3 * k + x] = -m * np.cross(np.eye(3)[x], one)
    return C


def frequencies(K, C, masses):
    """Positive w of all motion e^{-iwt} of M u'' + C u' + K u = 0, by the matrix of first order."""
    n, M = len(K), np.repeat(masses, 3)[:, None]
    s = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-K / M, -C / M]]))
    return np.sort(abs(s.imag))[::2]


@pytest.mark.parametrize('seed', range(6))
def test_modes_of_drawn_clusters_are_those_of_their_energy(seed):
    atoms, _ = cluster(seed)
    H, M = stiffness(atoms), np.repeat(atoms.get_masses(), 3)
    expected = np.sqrt(np.linalg.eigvalsh(H / np.sqrt(np.outer(M, M))))
    assert atoms.calc.dim == 3
    assert not atoms.calc.layer
    assert_allclose(modes(atoms).omega, expected, rtol=1e-9)
    atoms.calc.set(model='conventional')
    assert abs(modes(atoms).omega / expected - 1).max() > 1e-3  # without D*


def test_a_tetrahedron_needs_no_foundation_to_be_in_space():
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 4.0
    atoms = Atoms('H4', corners, masses=np.ones(4))
    atoms.calc = MagneticRepulsion(atoms, InversePower(B, A), foundation=0.0)
    forces = atoms.get_forces()
    r = np.linalg.norm(corners[0] - corners[1])
    assert_allclose(forces, 3 * B * r**-A * np.sqrt(2 / 3) * corners / np.linalg.norm(corners[0]), rtol=1e-12)
    with pytest.raises(ValueError, match='planar particles must share one z'):
        MagneticRepulsion(atoms, InversePower(B, A), dim=2)


def test_a_plane_is_in_space_where_dim_says_so():
    cell = lattices.triangular(10.0, 0.7)
    given = {'laws': InversePower(B, A), 'foundation': 5.0}
    others = {}, {'dim': 3}, {'foundation': [[5.0, 5.0, 5.0]]}
    planar, spatial, layer = (MagneticRepulsion(cell, **given | other) for other in others)
    assert (planar.dim, spatial.dim, layer.dim) == (2, 3, 3)
    assert spatial.layer
    q = np.random.default_rng(0).normal(size=(3, 3)) * [1, 1, 0]
    assert np.array_equal(spatial.bloch_matrix(q), layer.bloch_matrix(q))
    assert spatial.in_plane().dim == 2
    with pytest.raises(ValueError, match='dim must be one of 2, 3, not 4'):
        MagneticRepulsion(cell, dim=4, **given)


@pytest.mark.parametrize('seed', range(4))
def test_gyration_about_drawn_axes(seed):
    atoms, rng = cluster(seed)
    n, m = len(atoms), atoms.get_masses()
    g = rng.normal(size=(n, 3)) if seed % 2 else rng.normal(size=(1, 3))
    each = np.broadcast_to(g, (n, 3))
    atoms.calc = atoms.calc.about(atoms, gyration=g)
    H, C = stiffness(atoms), velocity_matrix(each, m)
    system = LinearSystem.of(atoms, 'gyration')
    assert_allclose(system.B().toarray(), C / np.repeat(m, 3)[:, None], atol=1e-15)
    assert system.turning == pytest.approx(np.linalg.norm(each, axis=1).max(), rel=1e-14)
    assert_allclose(modes(atoms).omega, frequencies(H, C, m), rtol=1e-9)
    along_z = velocity_matrix(each * [0, 0, 1], m)
    assert abs(modes(atoms).omega / frequencies(H, along_z, m) - 1).max() > 1e-3  # the control
    force = np.zeros((n, 3))
    force[0] = [1e-3, 2e-3, -1e-3]
    w = 0.7
    expected = np.linalg.solve(H - w**2 * np.diag(np.repeat(m, 3)) + 1j * w * (C + 0.1 * np.diag(np.repeat(m, 3))), force.ravel())
    found = frequency_response(atoms, force, [w], 0.1).response[0]
    assert_allclose(found.ravel(), expected, rtol=0, atol=1e-8 * abs(expected).max())
    for other, kept in ((with_vacancies(atoms, [1]), np.delete(np.arange(n), 1)),
                        (scattered(atoms, Scatter(mass=0.1), 1), np.arange(n)),
                        (MagneticRepulsion.fromdict(atoms.calc.todict()), np.arange(n))):
        assert np.array_equal(np.broadcast_to(getattr(other, 'calc', other).gyration, (len(kept), 3)), each[kept])


def guides(atoms, rng):
    """A held particle, one on a line and one on a plane of drawn directions; the basis of what is left, by SVD, in columns."""
    line, plane = rng.normal(size=(2, 3))
    atoms.set_constraint([FixAtoms([0]), FixedLine(1, line), FixedPlane(2, plane)])
    blocked = np.zeros((3 * len(atoms), 3 * len(atoms)))
    blocked[:3, :3] = np.eye(3)
    blocked[3:6, 3:6] = np.eye(3) - np.outer(line, line) / (line @ line)
    blocked[6:9, 6:9] = np.outer(plane, plane) / (plane @ plane)
    vectors, size, _ = np.linalg.svd(blocked)
    return vectors[:, size < 0.5]


@pytest.mark.parametrize('seed', few_first(range(4), 2))
def test_lines_and_planes_guide_particles_in_space(seed):
    atoms, rng = cluster(seed)
    g, m = rng.normal(size=(len(atoms), 3)), atoms.get_masses()
    P, H = guides(atoms, rng), stiffness(atoms)
    atoms.calc = atoms.calc.about(atoms, gyration=g)
    M, C = P.T @ np.diag(np.repeat(m, 3)) @ P, P.T @ velocity_matrix(g, m) @ P
    n = len(M)
    s = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, P.T @ H @ P), -np.linalg.solve(M, C)]]))
    assert_allclose(modes(atoms).omega, np.sort(abs(s.imag))[::2], rtol=1e-9)
    v = 1e-6 * (P @ rng.normal(size=n)).reshape(-1, 3)
    flow = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, P.T @ H @ P), -np.linalg.solve(M, C)]])
    expected = (P @ (expm(flow) @ np.append(np.zeros(n), P.T @ v.ravel()))[:n]).reshape(-1, 3)
    errors = []
    for dt in 0.02, 0.01:
        moved = atoms.copy()
        moved.calc = atoms.calc
        moved.set_velocities(v)
        run = DrivenVerlet(moved, dt)
        run.run(round(1 / dt))
        errors.append(abs(run.displacements - expected).max() / abs(expected).max())
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.15)
