"""Densities of states of patches: against all modes with the same kernel, against bands, against Dyson's chain."""

from functools import cache

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine
from motion import L0, LAW, MASS
from scipy.integrate import cumulative_trapezoid
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed
from magphonon.bands import lattice_density
from magphonon.response import density_of_states, natural_frequencies
from magphonon.response.chebyshev import Interval, SpectralMoments, stable_interval, whole_interval
from magphonon.stiffness import LinearSystem

K0 = 0.12  # N/mm, on which all the lattices here are stable
COUNT = 64


def kernel(omega, modes, interval, count=COUNT):
    """Peak of each mode, shape (frequencies, modes), by Jackson's definition: the factors are the correlation of a sine arch."""
    arch = np.sin(np.pi * np.arange(1, count + 1) / (count + 1))
    g = np.array([arch[n:] @ arch[: count - n] for n in range(count)]) / (arch @ arch)
    here, there = (np.arccos(((np.sign(w) * w**2 - interval.centre) / interval.radius).clip(-1, 1)) for w in (omega, modes))
    n = np.arange(1, count)
    series = g[0] + 2 * (np.cos(np.outer(here, n)) * g[1:]) @ np.cos(np.outer(n, there))
    apart = interval.radius * np.sin(here)
    slope = np.divide(2 * abs(omega), apart, out=np.full(len(omega), 2 / np.sqrt(interval.highest)), where=omega != 0)
    return series / np.pi * (slope if interval.lowest == 0 else np.where(omega == 0, 0, slope))[:, None]


@cache
def disturbed(seed, model='complete'):
    """A drawn structure at rest: a patch of any shape with a rim, or a periodic one, random masses, some magnets missing."""
    rng = np.random.default_rng(seed)
    kind = ('triangular', 'square', 'honeycomb', 'kagome')[seed % 4]
    cell = getattr(lattices, kind)(L0, MASS)
    if seed % 3 == 0:
        atoms = cell.repeat((4, 5, 1))
    elif seed % 3 == 1:
        atoms = lattices.parallelogram(cell, 6, 5)
    else:
        atoms = lattices.hexagon(cell, 35.0)
    atoms.set_masses(MASS * rng.uniform(0.5, 1.5, len(atoms)))
    free = np.flatnonzero(atoms.get_tags() == 0)
    del atoms[rng.choice(free, rng.integers(0, 3), replace=False).tolist()]
    foundation = K0 if seed % 5 else 0.0  # without one, what is periodic may not be stable
    strengths = rng.uniform(0.9, 1.1, len(atoms))
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=K0, strengths=strengths, model=model)
    atoms = relaxed(atoms).atoms
    if not foundation:  # the same places, softer: an unstable structure is answered, too
        soft = atoms.copy()
        load = K0 * (atoms.calc.anchors - atoms.positions)
        soft.calc = MagneticRepulsion(soft, LAW, bonds=atoms.calc.bonds, load=load, strengths=strengths, model=model)
        atoms = soft
    atoms.calc.set(model=model)
    if seed % 2:
        atoms.set_constraint([*atoms.constraints, FixedLine([free[0]], (3, 4, 0))])
    return cell, atoms


def all_modes(system):
    """Frequencies, vectors and the interval that the package should take."""
    squares, vectors = np.linalg.eigh(system.K.toarray())
    interval = stable_interval(system.K) if squares[0] > 0 else whole_interval(system.K)
    return np.sign(squares) * np.sqrt(abs(squares)), vectors, interval


def test_drawn_structures_are_stable_and_unstable_ones():
    lowest = [natural_frequencies(disturbed(seed)[1])[0] for seed in range(8)]
    assert min(lowest) < 0 < max(lowest)


@pytest.mark.parametrize('seed', few_first([1, 5, 0, 2, 3, 4], 2))
def test_total_density_is_that_of_all_modes_within_its_error(seed):
    _, atoms = disturbed(seed)
    system = LinearSystem.of(atoms)
    found = density_of_states(system, moments=COUNT, vectors=40, seed=seed)
    assert found.modes == system.K.shape[0]
    omega, _, interval = all_modes(system)
    exact = kernel(found.omega, omega, interval).sum(axis=1)
    off = (found.density - exact)[found.error > 1e-9 * exact.max()] / found.error[found.error > 1e-9 * exact.max()]
    # of 64 frequencies and 40 random vectors the largest Student's t is 4 or so; a density of few modes is no normal variable
    assert abs(off).max() < 7
    assert 0.3 < np.sqrt(np.mean(off**2)) < 2
    conventional = natural_frequencies(disturbed(seed, 'conventional')[1])
    wrong = kernel(found.omega, conventional, interval).sum(axis=1)
    assert (abs(found.density - wrong) / np.maximum(found.error, 1e-9 * exact.max())).max() > 14


def test_the_stated_width_is_that_of_a_peak():
    interval, top = Interval(0.0, 4.0), 2.0
    grid = np.linspace(0, top, 40001)[1:-1]
    for at in (0.1, 0.7, 1.4, 1.9):
        for count in (64, 256):
            mu = np.cos(np.arange(count) * np.arccos((at**2 - 2) / 2))
            found = SpectralMoments(interval, mu[:, None])
            peak = found.density(grid)[:, 0]
            assert np.trapezoid(peak, grid) == pytest.approx(1, rel=1e-4)
            half = grid[peak > peak.max() / 2]
            width = (half[-1] - half[0]) / (2 * np.sqrt(2 * np.log(2)))  # as of a Gaussian
            assert found.width(np.array([at]))[0] == pytest.approx(width, rel=0.05)
            closed = np.pi / (2 * count) * np.sqrt(top**2 - at**2)
            assert found.width(np.array([at]))[0] == pytest.approx(closed, rel=0.02)


@pytest.mark.slow
def test_a_large_patch_has_the_density_of_the_lattice():
    cell = lattices.triangular(L0, MASS)
    atoms = cell.repeat((60, 60, 1))
    cell.calc, atoms.calc = (MagneticRepulsion(which, LAW, foundation=K0) for which in (cell, atoms))
    found = density_of_states(atoms, moments=128, vectors=8)
    fine = np.linspace(0, found.omega[-1] + found.width[0], 4000)
    for model in ('complete', 'conventional'):
        lattice = lattice_density(cell, fine, model=model)
        peaks = kernel(found.omega, lattice.omega, stable_interval(LinearSystem.of(atoms).K), 128)
        share = peaks @ (lattice.density * 2 * lattice.width)
        off = abs(found.density / found.modes - share / lattice.modes) * found.modes / found.error.clip(1e-3 * found.error.max())
        assert off.max() < 6 if model == 'complete' else off.max() > 30  # Student's t of 7 degrees of freedom, 128 frequencies


def chain(count, masses, model='complete'):
    """Particles between two held ones, that move along the chain only."""
    atoms = lattices.chain(L0, MASS).repeat((count + 2, 1, 1))
    atoms.pbc = False
    atoms.set_masses(np.concatenate([[MASS], masses, [MASS]]))
    atoms.calc = MagneticRepulsion(atoms, LAW, model=model)
    atoms.set_constraint([FixAtoms([0, count + 1]), FixedLine(np.arange(1, count + 1), (1, 0, 0))])
    return atoms


def test_dysons_chain_has_as_many_modes_below_as_nodes():
    """Of random masses: the number of negative pivots of the transfer along the chain is that of the modes below omega."""
    count, k = 6000, LAW.d2phi(L0)
    masses = MASS * np.random.default_rng(3).choice([1.0, 3.0], count)
    found = density_of_states(chain(count, masses), moments=256, vectors=8)
    middles = np.arange(40, 500, 20)
    omega = found.omega[middles]
    pivot, below = np.full(len(omega), np.inf), np.zeros(len(omega))
    for m in masses:
        pivot = 2 * k - m * omega**2 - k**2 / pivot
        below += pivot < 0
    ours, sigma = (cumulative_trapezoid(of, found.omega)[middles - 1] for of in (found.density, found.error))
    # the density is smoothed over the width: below by the modes in a width, 0.7 % of them, with peaks of single light particles
    assert (abs(ours - below) < 0.012 * count + 3 * sigma).all()
    equal = density_of_states(chain(count, np.full(count, masses.mean())), moments=256, vectors=2)
    assert abs(cumulative_trapezoid(equal.density, equal.omega)[middles - 1] - below).max() > 0.05 * count


@pytest.mark.parametrize('seed', few_first([1, 2, 0, 3, 4, 5], 2))
def test_a_mode_at_the_bound_of_all_frequencies_is_on_the_default_grid(seed):
    """Rings: an even one has its highest mode exactly at the largest row sum.  A grid of equal steps misses it."""
    rng = np.random.default_rng(seed)
    ring = lattices.chain(1.0, 1.0).repeat((2 * int(rng.integers(1, 6)), 1, 1))
    ring.calc = MagneticRepulsion(ring, InversePower(1.0, 4.0), foundation=rng.uniform(2.5, 12.0))
    found = density_of_states(ring, moments=int(rng.choice([32, 128, 512])), vectors=4)
    exact = natural_frequencies(ring)
    bound = np.sqrt(stable_interval(LinearSystem.of(ring).K).highest)
    assert bound == pytest.approx(exact[-1], rel=1e-12)
    counted = cumulative_trapezoid(found.density, found.omega, initial=0)
    assert counted[-1] == pytest.approx(len(exact), rel=1e-3)
    equal = bound * (np.arange(64) + 0.5) / 64
    control = density_of_states(ring, equal, moments=512, vectors=4)
    assert abs(np.trapezoid(control.density, equal) / len(exact) - 1) > 0.02
