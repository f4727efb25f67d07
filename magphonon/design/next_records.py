"""What to measure next: by how much one more record would narrow the intervals of a fit, from Jacobians at the fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from .. import units as u
from ..bands.bloch import bloch_modes
from ..findings import Proposal
from ..response.frf import Dof
from ..response.transfer_functions import TransferFunction
from ..waves.ridge_tables import RidgePoints
from .dispersion_fits import DispersionFit, uncertainty, whitening
from .least_squares import best
from .sensitivities import StiffnessDerivative, frequency_sensitivities
from .site_unknowns import eliminated, normal_matrices
from .transfer_fits import ParametricLattice, TransferFit, responses

RANGES = np.linspace(0.4, 3.0, 4)  # ends of the phases, from one particle to the next, that one more burst covers
MORE = 4  # points of a burst
PLACES = 12  # free particles at which one more receiver is considered
AVERAGED = 4  # times that a transfer function may be measured
AXES = {'x': (1.0, 0.0, 0.0), 'y': (0.0, 1.0, 0.0)}


def after_ridges(fit: DispersionFit, points: RidgePoints, cell: Atoms, changes: Mapping[str, StiffnessDerivative],
                 along: Mapping[str, NDArray[np.float64]]) -> list[Proposal]:
    """Proposals for the next measurement: a burst along the row with the most points, or one of the quantities `along`.

    Parameters
    ----------
    fit, points
        The fit and the points to which it belongs.
    cell, changes
        The fitted lattice, and what each parameter changes in it.
    along : dict of ndarray, shape (parameters,)
        Quantities that other means can measure, each as the powers of the parameters whose product it is.
    """
    rows, which = np.unique((points.q / points.xi[:, None]).round(9), axis=0, return_inverse=True)
    row, modes = rows[np.bincount(np.ravel(which)).argmax()], np.array(fit.branches)[points.ridge]
    points, plans = replace(points, sigma_xi=fit.sigma_xi), {}
    for branch in sorted(set(modes.tolist())):
        own = np.flatnonzero(modes == branch)
        like = own[np.argsort(points.sigma_omega[own])[len(own) // 2]]
        for ends in pairwise(RANGES):
            xi = np.linspace(*ends, MORE)
            more = points[np.r_[: len(points), np.full(MORE, like)]]
            more.xi[-MORE:], more.q[-MORE:] = xi, np.outer(xi, row)
            low, high = np.sort(u.hertz(bloch_modes(cell, more.q[[-MORE, -1]])[0][:, branch]))
            plans[f'measure {MORE} points of branch {branch + 1} from {low:.3g} to {high:.3g} Hz'] = (
                _information(fit, cell, changes, more) - _information(fit, cell, changes, points))
    return best(fit.sigma_along, fit.scatter, along, plans)


def _information(fit: DispersionFit, cell: Atoms, changes: Mapping[str, StiffnessDerivative],
                 points: RidgePoints) -> NDArray[np.float64]:
    """Information of the points about the parameters; the unknown shift that all points of a branch share is eliminated."""
    n, modes = np.arange(len(points)), np.array(fit.branches)[points.ridge]
    _, slopes = frequency_sensitivities(cell, points.q, [changes[name] for name in fit.names])
    sigma, by_xi = uncertainty(cell, points, modes)
    J = whitening(points, modes, points.shift * by_xi / sigma) @ (slopes[:, n, modes] / sigma).T
    return J.T @ J


def after_responses(fit: TransferFit, build: Callable[[dict[str, float]], ParametricLattice],
                    functions: Sequence[TransferFunction], along: Mapping[str, NDArray[np.float64]]) -> list[Proposal]:
    """Proposals for the next measurement: one more receiver in the patch, longer averages, or one of the quantities `along`.

    The `fit` is that of `build` to `functions`, with or without unknowns of its sites.
    """
    built = build(fit.by_name)
    first, n, system = functions[0], len(fit.names), built.system
    unseen = np.setdiff1d(np.flatnonzero(system.mobile), [one.answer.particle for one in functions])  # pyright: ignore[reportAttributeAccessIssue]  a Dof since `with_dofs`
    asked = [(k, axis) for k in unseen[np.unique(np.linspace(0, len(unseen) - 1, PLACES).astype(int))] for axis in AXES]
    noise = None if first.sigma is None else np.median(first.sigma)
    more = [replace(first, answer=Dof(int(k), np.array(AXES[axis])), sigma=noise) for k, axis in asked]
    size = np.split(responses(built, more), len(more)) if more else []  # a noise that is not stated is a share of the peaks
    more = [replace(one, response=h) for one, h in zip(more, size, strict=True)]
    parts = normal_matrices(fit, build, [*functions, *more])
    measured = np.sum(parts[: len(functions)], axis=0)
    now, places = eliminated(measured, n), system.calc.anchors[:, :2] / u.m
    plans = {f'measure along {axis} at ({places[k, 0]:.3g}, {places[k, 1]:.3g}) m': eliminated(measured + part, n) - now
             for (k, axis), part in zip(asked, parts[len(functions) :], strict=True)}
    plans[f'average {AVERAGED} times as long'] = eliminated(AVERAGED * measured, n) - now
    return best(fit.sigma_along, fit.scatter, along, plans)
