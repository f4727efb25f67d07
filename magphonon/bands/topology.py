"""Topology: Chern numbers of bands, and one-way waves along edges; no smooth change alters them while the gaps stay open.

Bands of particles that gyrate (`PairCalculator(gyration=)`) may have Chern numbers other than zero.  The waves along an edge
then cross a gap in one direction only: their number is the sum of the Chern numbers of all bands below the gap (Hatsugai, Phys.
Rev. Lett. 71, 3697 (1993); gyroscopes: Nash et al., PNAS 112, 14495 (2015)).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from scipy.optimize import brentq

from ..errors import positive
from ..stiffness.matrices import Model, first_order, mass_weighted
from ..stiffness.plausibility import asked_frequencies
from ..stiffness.rest import LinearSystem
from ..traits import LINEAR, takes
from .bloch import PLANAR, in_batches

COARSE, FINE = 24, 192
"""Number of wavevectors along each reciprocal vector: at first, and at most after doublings."""
SMOOTH = 1.5
"""Largest flux through a plaquette, in rad, of a mesh that resolves the curvature: beyond pi the Chern numbers are ambiguous."""
TOUCHING = 1e-9  # gap, as a fraction of the highest frequency, that is round-off
STEPS = 120  # wavevectors along a strip, 0 and 1/2 among them, between which a wave is looked for
CLEAR = 0.8  # least share of the motion in one half of the strip for a wave to belong to its edge


@takes(*LINEAR)
def chern_numbers(cell: Atoms | LinearSystem, model: Model | None = None) -> NDArray[np.int_]:
    """Chern number of each band of a planar lattice; all are zero unless particles gyrate.

    The method is that of Fukui, Hatsugai and Suzuki (J. Phys. Soc. Jpn. 74, 1674 (2005)) for waves `e^{i(k.R - omega t)}`, in
    coordinates whose square is the energy.  The mesh is refined until the flux through each plaquette is small.

    Parameters
    ----------
    cell : ase.Atoms or LinearSystem
        One cell with its PairCalculator.
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.

    Returns
    -------
    ndarray of int, shape (bands,)
        From the lowest band up; their sum is zero. The signs are those of the connection <u|du> of these authors; with i<u|du>
        they would be opposite.

    Raises
    ------
    ValueError
        If two bands touch or nearly touch, because neither then has a Chern number of its own; or if stiffness alone does not
        hold the lattice.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.bands import chern_numbers
    >>> cell = lattices.honeycomb(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=6.0, gyration=1.55)
    >>> chern_numbers(cell), chern_numbers(cell, 'conventional')
    (array([ 1, -1,  1, -1]), array([ 1,  0,  0, -1]))
    """
    system = LinearSystem.of(cell).moving()
    if tuple(system.atoms.pbc) != PLANAR:
        raise ValueError('only bands over a two-dimensional zone have Chern numbers; take one cell of a planar lattice, pbc (1, '
                         '1, 0)')
    turn = np.sign(np.linalg.det(system.atoms.cell.array[:2, :2]))
    steps = COARSE
    while True:
        flux, gaps = _fluxes(system, model, steps)
        if gaps.min() > TOUCHING and abs(flux).max() < SMOOTH:
            return np.rint(turn * flux.sum(axis=(0, 1)) / (2 * np.pi)).astype(int)
        if gaps.min() <= TOUCHING or steps >= FINE:
            band = int(gaps.argmin())
            raise ValueError(f'the bands {band} and {band + 1} (counted from 0) nearly touch and have no Chern numbers of their '
                             f'own: they come within {gaps[band]:.2g} of the highest frequency; change foundation, gyration or '
                             f'law until a gap opens between them')
        steps *= 2


def _fluxes(system, model, steps):
    """Berry flux through each plaquette of the mesh, shape (steps, steps, bands), and relative gaps between bands."""
    n, B = np.arange(steps) / steps, system.B().toarray()
    q = np.stack([*np.meshgrid(n, n, indexing='ij'), np.zeros((steps, steps))], axis=-1).reshape(-1, 3)
    omegas, states = [], []
    for part in in_batches(q, system.calc):
        try:
            omega, z = np.linalg.eigh(first_order(B, system.bloch(part, model)))
        except np.linalg.LinAlgError:
            raise ValueError('stiffness alone does not hold the lattice, and only the bands of positive energy have Chern '
                             'numbers; take a stiffer foundation') from None
        omegas.append(omega[:, len(B) :])
        states.append(z[..., len(B) :])
    z = np.concatenate(states).reshape(steps, steps, 2 * len(B), len(B))
    along = [np.einsum('abxm,abxm->abm', z.conj(), np.roll(z, -1, axis)) for axis in (0, 1)]
    loop = along[0] * np.roll(along[1], -1, 0) * (np.roll(along[0], -1, 1) * along[1]).conj()
    omega = np.concatenate(omegas)
    return np.angle(loop), np.diff(omega, axis=1).min(axis=0) / omega.max()


class EdgeFlow(NamedTuple):
    """Waves that run along the edges of a strip at one frequency.

    Attributes
    ----------
    right, left : int
        Number of waves that run along the period minus the number that run against it, at the edge to the right of the period
        vector (the lower edge of a strip along x) and at the left edge.
    q : ndarray, shape (waves,)
        Wavevectors of the waves, in fractions of the reciprocal vector.
    velocity : ndarray, shape (waves,)
        Group velocities of the waves along the period in mm/ms.
    at_right : ndarray of bool, shape (waves,)
        Whether each wave runs along the right edge.
    """

    right: int
    left: int
    q: np.ndarray
    velocity: np.ndarray
    at_right: np.ndarray


@takes(*LINEAR)
def edge_flow(strip: Atoms | LinearSystem, omega: float, model: Model | None = None) -> EdgeFlow:
    """The waves along the edges of a strip at a frequency within a gap of its lattice, and how many more run one way than the
    other.

    There is a wave at each q at which an eigenvalue of `K(q) - omega^2 - i omega B` vanishes.

    Parameters
    ----------
    strip : ase.Atoms or LinearSystem
        One cell of a strip with its PairCalculator, periodic along one direction, as `lattices.ribbon` cuts it.
    omega : float
        In rad/ms.
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.

    Raises
    ------
    ValueError
        If a wave belongs to neither edge, because the frequency is not in a gap or the strip is too narrow.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.bands import edge_flow
    >>> strip = lattices.ribbon(lattices.honeycomb(1.0, 1.0), 20)
    >>> strip.calc = MagneticRepulsion(strip, InversePower(1.0, 4.0), foundation=6.0, gyration=1.55)
    >>> edge_flow(strip, 3.44, 'conventional')[:2]  # D0 alone
    (1, -1)
    >>> edge_flow(strip, 3.26)[:2]
    (0, 0)
    """
    system = LinearSystem.of(strip).moving()
    atoms, calc = system.atoms, system.calc
    omega = float(asked_frequencies(calc, positive('omega', omega, 'rad/ms'))[0])
    if atoms.pbc.sum() != 1:
        raise ValueError(f'only a strip, periodic in one direction, has edges, but these atoms have {atoms.pbc.sum()} periodic '
                         'directions; lattices.ribbon cuts one out of a lattice')
    B, along = system.B().toarray(), np.flatnonzero(atoms.pbc)[0]
    fixed = omega**2 * np.eye(len(B)) + 1j * omega * B

    def at(q):
        """The matrix K(q) - omega^2 - i omega B."""
        return system.bloch(np.atleast_1d(q)[:, None] * np.eye(3)[along], model) - fixed

    mesh = np.arange(STEPS + 1) / STEPS
    ends = np.concatenate([np.linalg.eigvalsh(at(part)) for part in np.array_split(mesh, STEPS // 10)])
    found: list[tuple[Any, int]] = [(brentq(lambda q, n=n: np.linalg.eigvalsh(at(q)[0])[n], mesh[k], mesh[k + 1], xtol=1e-12), n)
             for k, n in np.argwhere((ends[1:] > 0) != (ends[:-1] > 0))]
    period, P = atoms.cell.array[along], system.free.toarray()
    length = np.linalg.norm(period)
    across = atoms.positions[:, :2] @ [-period[1], period[0]] / length
    low = np.repeat(across < (across[system.mobile].min() + across[system.mobile].max()) / 2, system.dim)
    velocity, at_right = np.empty(len(found)), np.empty(len(found), bool)
    for k, (q, n) in enumerate(found):
        y = P @ np.linalg.eigh(at(q)[0])[1][:, n]
        gradient = calc.bloch_gradient(q * np.eye(3)[[along]], model)
        slope = np.einsum('xab,x->ab', mass_weighted(gradient[:, 0], system.masses), period[: system.dim] / length)
        velocity[k] = (y.conj() @ slope @ y).real / (2 * omega - (y.conj() @ P @ B @ P.T @ y).imag)
        share = (abs(y[low]) ** 2).sum()
        if CLEAR > share > 1 - CLEAR:
            raise ValueError(f'at {omega:.6g} rad/ms the wave at q = {q:.4g} runs along neither edge: {100 * share:.0f} % of it '
                             'is in the half on the right. The frequency is in no gap of the lattice, or the strip is too narrow')
        at_right[k] = share > 0.5
    right, left = (int(np.sign(velocity[side]).sum()) for side in (at_right, ~at_right))
    return EdgeFlow(right, left, np.array([q for q, _ in found]), velocity, at_right)
