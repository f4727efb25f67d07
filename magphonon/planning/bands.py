"""The plan for bands: which model, and how many shells of neighbours, a band diagram or one band edge needs.

The methods are compared at a few wavevectors: the special points of the path and some between them, most of them near the
special points, where long-range forces matter most.  An unstable lattice is compared at all wavevectors of the path.  Neighbours
are summed up to a reach.  Those beyond it are treated as a continuum of rho particles per area.  The displacements of these
particles average to zero over a wavelength, so they act like a spring to a medium at rest, of the stiffness

    sum over r > R of (phi'' + phi'/r)/2  ->  pi rho integral of (r phi')'  =  pi rho R f(R)

The error of the reference is estimated by its change from half the reach to the full reach.  This is an upper bound if doubling
the reach at least halves the error.  The reach is doubled until this error is a small part of the tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from ase import Atoms
from ase.dft.kpoints import BandPath

from ..bands.neighbours import is_known, neighbour_shells
from ..interactions.pair_laws import GaussianMixture
from ..lattices.bonds import SHELL_WIDTH, clear_shells, distances_within
from ..stiffness.bond import bond_stiffness
from ..stiffness.matrices import bloch_matrix, mass_weighted, signed_root
from ..stiffness.rest import LinearSystem
from ..stiffness.sites import refuse_unlike
from .plan import ALL, EIGENSOLVE, Method, Plan, Settings

REACHES = (3.3, 6.3, 12.3, 24.3, 48.3)
"""Distances, in spacings, up to which neighbours are summed for the most complete method; each is about twice the one before, as
the estimate of the error asks.  A sum as far as the last one costs more than the Ewald sum (`EWALD_BONDS`)."""
SHELL_RATIO = 1.2
"""Ratio of the numbers of shells of successive methods; at least one shell is added.  The cheapest method that is good enough
thus costs at most a fifth more than one with as many shells as needed."""
CHAIN_FACTOR = 6
"""Factor by which the reach is larger in a chain, where no continuum is added: within 19 spacings
a particle has 38 neighbours there, and 36 within 3.3 spacings of a triangular lattice."""
FRACTIONS = (0, 0.03, 0.06, 0.1, 0.17, 0.25, 0.5, 0.75, 0.9, 0.97)
"""Wavevectors of the comparison, as fractions of a leg of the path.  Long-range forces make the largest errors near the ends of a
leg: at the ends alone they are underestimated (tests/planning/test_band_plans.py)."""
EWALD_BONDS = 1800
"""Number of bonds per particle whose sum takes as long as the Ewald sum over all neighbours.  By the processor's time of bands at
60 wavevectors it was 1042 to 2713 in three lattices with two reaches."""
ROUND_OFF = 1e-6
"""Fraction of the highest frequency below which a frequency is the square root of a rounded eigenvalue: its square is 1e-12 of
the largest one, which is known to some 1e-16."""
REFERENCE_FRACTION = 0.25
"""Largest error of the reference, as a fraction of the tolerance; by as much methods may be judged too severely."""
DOUBT = 0.25
"""Relative uncertainty of an error.  It may be larger between the wavevectors of the comparison: by up to 11 % in the plans of
tests/planning/test_band_plans.py.  At an edge the neighbours beyond the reach are only estimated: the error was larger by up to
21 % in 22459 methods for edges of lattices with exponents from 1.6 to 6, drawn at random."""
TABLE_ENDS = ('the law is not known farther: the errors are those that its continuation could make, and no more neighbours can '
              'be added; measure at larger distances, or take an inverse power, which "magphonon fit" finds')
"""What a plan says if the law ends within the reach of the neighbours."""


@dataclass(frozen=True)
class Edge:
    """One band edge: the frequency of a branch at a wavevector.

    Attributes
    ----------
    name : str
    q : ndarray, shape (3,)
        Fractional coordinates with respect to the reciprocal vectors.
    branch : int
        Index of the branch; the lowest is 0.
    """

    name: str
    q: np.ndarray
    branch: int


def plan_bands(atoms: Atoms, path: BandPath, tolerance: float, edge: Edge | None = None) -> Plan:
    """Plan for the bands along a path, or for one edge of them.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its MagneticRepulsion.  Its number of shells does not matter, because all particles repel each other here.
    path : ase.dft.kpoints.BandPath
    tolerance : float
        Error allowed in the frequencies, relative to the highest one; for an edge, relative to the edge itself.
    edge : Edge, optional

    Returns
    -------
    Plan
        The settings of its methods are `model` and `shells`; `shells` is 'all' for exact sums.

    Examples
    --------
    >>> from magphonon import read_scene, ready_scene
    >>> from magphonon.planning import plan_bands
    >>> scene = read_scene(ready_scene('prototype'))
    >>> plan = plan_bands(scene.perfect_cell(), scene.band_path(), tolerance=0.01)
    >>> plan.choice.settings.model
    'complete'
    """
    refuse_unlike(atoms.calc, 'the plan for bands', 'compare bands of several shells yourself')  # pyright: ignore[reportArgumentType]
    spent, q = 0.0, _looked_at(path) if edge is None else np.array([edge.q])
    if edge is None and _buckles(atoms, q):
        q = path.kpts  # a few wavevectors may miss the largest error, because omega(q) is steep where its square changes sign
    for reach in REACHES:
        plan = _plan_within(atoms, path, tolerance, edge, q, reach, spent)
        spent = plan.cost
        summed = [method for method in plan.methods if method.settings.shells != ALL]
        good = any(method.meets(tolerance) for method in summed)
        if good and summed[-1].error <= REFERENCE_FRACTION * tolerance:  # the longest sum has the error of the reference
            break
        if plan.methods[-1].cost < summed[-1].cost:  # the exact sum is cheaper than a larger reach
            break
    return plan


def _buckles(atoms, q):
    """Whether nearest neighbours alone let the lattice buckle."""
    calc, (nearest, *_) = atoms.calc, neighbour_shells(atoms, 1.5)
    D0, Dstar = bond_stiffness(nearest.vectors[:, : calc.dim], calc.law)
    D = bloch_matrix(nearest, D0 + Dstar, q)
    squares = np.linalg.eigvalsh(mass_weighted(D + calc.foundation * np.eye(D.shape[-1]), atoms.get_masses()))
    return squares.min() < -(ROUND_OFF**2) * squares.max()


def _plan_within(atoms, path, tolerance, edge, q, reach, spent):
    """Plan with the neighbours within `reach` spacings, compared at `q`; `spent` is the cost of earlier estimates."""
    calc: Any = LinearSystem.of(atoms).unheld('plans for bands are those').atoms.calc
    size = len(atoms) * calc.dim
    shells = neighbour_shells(atoms, reach if atoms.pbc.sum() > 1 else CHAIN_FACTOR * reach)
    counts = np.unique(np.floor(SHELL_RATIO ** np.arange(1 + np.floor(np.log(len(shells)) / np.log(SHELL_RATIO)))).astype(int))
    around = distances_within(atoms, 1.1 * shells[-1].lengths.max() + atoms.cell.lengths()[atoms.pbc].max())
    counts = np.array(clear_shells(atoms, around, counts))
    if not len(counts):
        raise ValueError('the shells of neighbours of this cell cannot be told apart, so no method has a number of them; give '
                         'its vectors and positions with more digits')
    continuum = _continuum(atoms, shells[-1].lengths.mean(), q)
    near = max(1, sum(shell.lengths.mean() <= shells[-1].lengths.mean() / 2 for shell in shells))  # within half the distance
    # the two references; they are the same where a measured table knows only the nearest
    beyond = [(near, _continuum(atoms, shells[near - 1].lengths.mean(), q)), (len(shells), continuum)]
    errors = _errors(atoms, q, edge, shells, counts, beyond)

    waves = len(path.kpts) if edge is None else 1
    at = f'at {waves} wavevectors' if waves > 1 else 'at its wavevector'
    bonds = np.cumsum([len(shell) for shell in shells])
    models = ['conventional'] + len(counts) * ['complete']
    methods = [Method(f'{model} linear, ' + ('nearest neighbours' if k == 1 else f'{k} shells'), f'the Bloch matrix {at}',
                      bloch_cost(int(bonds[k - 1]), waves, size, calc.dim, model), float(error), DOUBT,
                      Settings(model, int(k)))
               for model, k, error in zip(models, [counts[0], *counts], errors, strict=True)]
    if isinstance(calc.law, GaussianMixture) and calc.law.decay > 0:
        methods.append(Method('complete linear, all neighbours', f'Ewald sums {at}',
                              bloch_cost(EWALD_BONDS * len(atoms), waves, size, calc.dim, 'complete'), 0.0, 0.0,
                              Settings('complete', ALL)))
    farthest = shells[-1].lengths.mean() / shells[0].lengths.mean()
    compared = (f'compared {f"at {len(q)} wavevectors" if len(q) > 1 else "there"} with neighbours to {farthest:.3g} '
                f'spacing{"s" if farthest > 1 + SHELL_WIDTH else ""}' + (' and a continuum beyond' if continuum.any() else ''))
    evidence = (compared, *([] if is_known(calc.laws, reach * shells[0].lengths.mean()) else [TABLE_ENDS]))
    what = (f'Bands {path.path}', 'the highest frequency') if edge is None else (edge.name, 'itself')
    cost = bloch_cost(bonds[-1], len(q), size, calc.dim, 'complete') + len(errors) * len(q) * EIGENSOLVE * size**3
    return Plan(*what, tolerance, tuple(methods), evidence, spent + cost)


def _errors(atoms, q, edge, shells, counts, continua):
    """Error of the conventional model with the fewest shells of `counts`, then of the complete one with each of them."""
    calc = atoms.calc
    parts = [bond_stiffness(shell.vectors[:, : calc.dim], calc.law) for shell in shells]
    D0, Dstar = (np.cumsum([bloch_matrix(shell, part[k], q) for shell, part in zip(shells, parts, strict=True)], axis=0)
                 for k in (0, 1))
    references = [D0[n - 1] + Dstar[n - 1] + continuum for n, continuum in continua]
    D = np.concatenate([D0[counts[:1] - 1], (D0 + Dstar)[counts - 1], references]) + calc.foundation * np.eye(D0.shape[-1])
    *omega, exact = signed_root(np.linalg.eigvalsh(mass_weighted(D, atoms.get_masses())))
    if edge is None:
        *errors, lacking = abs(omega - exact).max(axis=(1, 2)) / exact.max()
        return np.array(errors) + lacking
    wanted = exact[0, edge.branch]
    stiffest = 2 * sum(np.einsum('bii->', part[0]) for part in parts) / len(atoms)  # the bonds of a particle along themselves
    highest = signed_root(2 * stiffest / atoms.get_masses().min())  # or some less, of all wavevectors
    if not wanted > ROUND_OFF * highest:
        raise ValueError(f'{edge.name} is zero or imaginary and has no relative error; choose another edge, or all bands')
    *errors, lacking = abs(omega - exact)[:, 0, edge.branch] / wanted
    return np.array(errors) + lacking


def bloch_cost(bonds: int, waves: int, size: int, dim: int, model: str) -> float:
    """Number of multiplications for the bands of a cell: bond stiffness, then phases and an eigenvalue problem per wavevector."""
    stiffness = bonds * dim**2 * (2 if model == 'complete' else 1)
    return stiffness + waves * (bonds * dim**2 + EIGENSOLVE * size**3)


def _looked_at(path):
    """Special points of the path and a few wavevectors between them, shape (wavevectors, 3)."""
    x, stops, _ = path.get_linear_kpoint_axis()
    stops = np.unique(stops)
    wanted = np.append((stops[:-1, None] + np.diff(stops)[:, None] * FRACTIONS).ravel(), stops[-1])
    return path.kpts[np.unique(abs(x - wanted[:, None]).argmin(axis=1))]


def _continuum(atoms, R, q):
    """Springs to the neighbours beyond R, shape (wavevectors, size, size); at q = 0 these neighbours move with the cell."""
    calc, plane = atoms.calc, atoms.cell.array[atoms.pbc]
    n, d = len(atoms), len(plane)
    if d == 1:
        return np.zeros((len(q), 1, 1))
    rho = n / np.sqrt(np.linalg.det(plane @ plane.T))
    try:
        spring = {2: np.pi * R, 3: 4 * np.pi / 3 * R**2}[d] * rho * -calc.law.dphi(R)
    except ValueError:  # beyond a measured table
        spring = 0.0
    along = np.kron(np.full((n, n), 1 / n), np.eye(d))
    return spring * (np.eye(n * d) - np.all(abs(q) < 1e-9, axis=1)[:, None, None] * along)
