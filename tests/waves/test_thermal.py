"""The stiffness that thermal noise shows, in records drawn from exact distributions."""


import numpy as np
import pytest

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.bands import bloch_modes
from magphonon.stiffness import LinearSystem
from magphonon.waves import thermal_bands

LAW = InversePower(1.0, 4.0)


def drawn_record(system, kT, frames, rng):
    """Independent frames of the exact distribution of harmonic forces, by the one symmetric root K^-1/2."""
    squares, modes = np.linalg.eigh(system.stiffness.toarray())
    y = rng.normal(size=(frames, len(squares))) * np.sqrt(kT)
    return (y @ (modes / np.sqrt(squares)) @ (system.free @ modes).T).reshape(frames, len(system), -1)


def misses(seed, kT=1e-3, partial=False, model='complete'):
    """(found - true)/error of drawn cells in supercells, or of hexagons and parts of them; (wavevectors, branches)."""
    rng = np.random.default_rng([seed, 7])
    cell = getattr(lattices, ['triangular', 'honeycomb', 'square', 'kagome'][seed % 4])(1.0, 1.0)
    cell.set_masses(rng.uniform(0.5, 2, len(cell)))
    cell.calc = MagneticRepulsion(cell, LAW, foundation=rng.uniform(7, 10))
    if partial:
        atoms, q = lattices.hexagon(cell, 4.0), [(0.21, 0.1, 0), (0.5, 0, 0)]
        atoms.calc = MagneticRepulsion(atoms, LAW, foundation=cell.calc.foundation).balanced(np.arange(len(atoms)))
    else:
        atoms, q = cell.repeat((4, 3, 1)), [(0.25, 0, 0), (0.5, 1 / 3, 0), (0, 0, 0)]
        atoms.calc = cell.calc.on(atoms)
    drawn = atoms.copy()
    drawn.calc = atoms.calc.about(atoms, model=model) if model != 'complete' else atoms.calc
    u = drawn_record(LinearSystem.of(drawn), kT, 200, rng)
    found = thermal_bands(atoms, u, kT, cell, q)
    np.testing.assert_allclose(found.linear, bloch_modes(cell, q)[0])
    return (found.omega - found.linear) / found.error, found


@pytest.mark.parametrize('partial', [False, True])
def test_the_error_covers_what_is_true(partial):
    z = np.concatenate([misses(seed, partial=partial)[0].ravel() for seed in range(8)])
    # of about 100 numbers, of 19 degrees of freedom each; the control, a record of D0 alone, fails the same
    assert abs(z.mean()) < 0.4
    assert 0.8 < z.std() < 1.35
    wrong = np.concatenate([misses(seed, partial=partial, model='conventional')[0].ravel() for seed in range(4)])
    assert wrong.mean() > 2 * 0.4


def test_few_frames_and_a_window_are_taken_off():
    _, found = misses(1)
    assert (found.bias > 0).all()  # of the inverse of a mean
    z, found = misses(4, partial=True)
    assert abs(found.bias / found.error).max() > 1  # a narrow window at a curved branch
    assert abs(z).max() < 4


def test_what_does_not_serve_is_refused():
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=4.0)
    atoms = cell.repeat((4, 3, 1))
    atoms.calc = cell.calc.on(atoms)
    u = np.random.default_rng(0).normal(size=(200, 12, 2))
    with pytest.raises(ValueError, match='does not fit'):
        thermal_bands(atoms, u, 1e-3, cell, [(0.3, 0, 0)])
    with pytest.raises(ValueError, match='too few'):
        thermal_bands(atoms, u[:50], 1e-3, cell, [(0.25, 0, 0)])
    with pytest.raises(ValueError, match='shape'):
        thermal_bands(atoms, u[:, :5], 1e-3, cell, [(0.25, 0, 0)])


def test_gyration_does_not_change_the_stiffness_of_waves():
    """<u u> = kT D^-1 whatever g is: the frequencies are the roots of the stiffness written here, not those of the bands."""
    cell, g = lattices.triangular(1.0, 1.0), 4.0
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=3.0, gyration=g)
    atoms, q, kT = cell.repeat((4, 4, 1)), [(0.5, 0, 0), (0.25, 0.25, 0)], 1e-9
    atoms.calc = cell.calc.on(atoms)
    n = np.array([[np.cos(t), np.sin(t)] for t in np.pi / 3 * np.arange(3)])
    phase = np.array([[1, 0], [0, 1], [-1, 1]]) @ np.array(q)[:, :2].T
    D = 3 * np.eye(2) + np.einsum('bq,bxy->qxy', 2 - 2 * np.cos(2 * np.pi * phase), 5 * n[:, :, None] * n[:, None] - np.eye(2))
    exact = np.sqrt(np.linalg.eigvalsh(D))
    u = drawn_record(LinearSystem.of(atoms, 'gyration'), kT, 600, np.random.default_rng(5))
    found = thermal_bands(atoms, u, kT, cell, q)
    np.testing.assert_allclose(found.linear, exact)
    assert abs((found.omega - exact) / found.error).max() < 4
    assert abs((found.omega - bloch_modes(cell, q)[0]) / found.error).max() > 8  # the control: frequencies with gyration
