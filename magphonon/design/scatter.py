"""First-order effect of independent scatter of every magnet and every pillar, including the change of the rest positions.

With the displacements x and y, and e = C x in the bonds, the stiffness H changes with the strength s_i of one magnet by

    x.(dH/d ln s_i) y = sum_b e^x_b.K_b e^y_b - sum_b phi'_b n_b.(C w)_b      over the bonds b of the magnet, where
    Phi w = C^T t       t_b = e^x_b.(dK_b/dR) e^y_b                           with the static stiffness Phi of the structure

The second sum comes from the new rest positions: a stronger magnet pushes its neighbours away until the forces balance again.
One solution w serves all magnets.  The derivative with respect to ln k_i is k_i x_i.y_i for the stiffness k_i of a pillar, plus a
term with the force of the pillar if it is bent at rest. It is -omega^2 m_i x_i.y_i with respect to ln m_i, for the mass m_i, and
with respect to positions k_i w_i for the foot of a pillar and (C^T t - Phi w)_i for a held magnet.

If the rest positions were measured, as in a photo, they are known: w = 0, and the derivative is (C^T t)_i for a position.

Any number J, at any frequency, wavevector or time, depends on the lattice through masses and stiffness of bonds and springs
(`Slope`). With G_b = dJ/dK_b in place of e^x (x) e^y, one solution w gives the derivatives of J by all of these quantities
(`site_slopes`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from scipy import linalg, sparse

from ..lattices.bonds import Bonds, lengths_of
from ..response.normal_modes import Modes, modes
from ..stiffness.factors import inverse
from ..stiffness.matrices import Model, hessian, model_stiffness, stiffness_change
from ..stiffness.rest import LinearSystem
from ..stiffness.sites import RAYLEIGH, RODS, cantilever_excess
from ..traits import LIKE, takes

if TYPE_CHECKING:
    from ..interactions.pair_laws import PairInteraction
    from ..stiffness.defects import Scatter

REGULAR = 1e-12
"""Stiffness added to every direction, as a fraction of the largest stiffness, because free translations have none."""
ROUND_OFF = 1e-13  # of forces that cancel
STEP = 1e-20  # relative size of a complex step: no difference is taken, so it may be as small as numbers allow
CROSSING = 1e-9
"""Difference of two squared frequencies, as a fraction of the highest, below which their modes are arbitrary."""


@dataclass(frozen=True)
class Slope:
    """Derivatives of a number by the properties of the bonds and sites of a structure.

    Attributes
    ----------
    bonds : ndarray, shape (bonds, dim, dim)
        Derivatives by the stiffness of each bond.
    springs : ndarray, shape (particles, dim)
        Derivatives by the springs of each site.
    masses : ndarray, shape (particles,)
        Derivatives by the mass of each site.
    """

    bonds: Any = 0.0
    springs: Any = 0.0
    masses: Any = 0.0

    def __add__(self, other: Slope) -> Slope:
        return Slope(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    def __rmul__(self, c: float) -> Slope:
        return Slope(*(c * getattr(self, f.name) for f in fields(self)))

    @property
    def real(self) -> Slope:
        """Slope of the real part of the number."""
        return Slope(*(np.real(getattr(self, f.name)) for f in fields(self)))


def form(bonds: Bonds, x: NDArray[Any], y: NDArray[Any], inertia: Any, q: NDArray[np.float64] | None = None) -> Slope:
    """Slope of `sum x.(K + inertia M) y` over waves with the displacements x and y, shape (particles, dim, waves).

    For a Bloch wave at q, x is the complex conjugate of a mode.
    """
    ex, ey = _elongations(bonds, x, None if q is None else -q), _elongations(bonds, y, q)
    xy = x * y
    return Slope(np.moveaxis((ex[:, :, None] * ey[:, None]).sum(0), -1, 0), xy.sum(2), (inertia * xy.sum(1)).sum(1))


def _elongations(bonds, x, q):
    """Relative displacements `C(q) x` in the bonds, shape (waves, dim, bonds), from x of shape (particles, dim, waves)."""
    ends = x.T.take(bonds.j, -1)
    return (ends if q is None else np.exp(2j * np.pi * (bonds.shift @ q)) * ends) - x.T.take(bonds.i, -1)


@dataclass(frozen=True, eq=False)
class Frame:
    """Which particles the bonds join, and in which directions P the particles can move; with C the incidence matrix.

    Attributes
    ----------
    bonds : Bonds
    free : sparse matrix, shape (particles * dim, free)
        P: orthonormal directions, one of one particle in each column.
    dim : int
    """

    bonds: Bonds
    free: sparse.csr_array
    dim: int

    @cached_property
    def _products(self):
        """C, of displacements and bond vectors with particles and bonds last in memory, its transpose and that of P."""
        rows, n, ends = self.dim * len(self.bonds), self.bonds.particles, np.stack([self.bonds.i, self.bonds.j], axis=1)
        columns = (n * np.arange(self.dim)[:, None, None] + ends).ravel()
        C = sparse.csr_array((np.tile([-1.0, 1.0], rows), columns, 2 * np.arange(rows + 1)), (rows, self.dim * n))
        return C, sparse.csr_array(C.T), sparse.csr_array(self.free.T)

    @cached_property
    def _assembly(self):
        """The sparse matrix that makes the entries of `hessian` from those of K, with the bonds last, and of the springs."""
        size, axes = self.free.shape[0], np.arange(self.dim)[:, None, None]
        ends = self.dim * np.stack([self.bonds.i, self.bonds.j], axis=1)
        of_bonds = (size * (ends[:, [0, 1, 0, 1]] + axes[:, None]) + ends[:, [0, 1, 1, 0]] + axes).reshape(-1, 4)  # their entries
        signs = np.append(np.broadcast_to([1.0, 1.0, -1.0, -1.0], of_bonds.shape), np.ones(size))
        begins = np.append(4 * np.arange(len(of_bonds)), of_bonds.size + np.arange(size + 1))
        each = sparse.csr_array((signs, np.append(of_bonds, (size + 1) * np.arange(size)), begins), (len(begins) - 1, size**2))
        return sparse.csr_array((each @ sparse.kron(self.free, self.free, format='csr')).T)

    @cached_property
    def shares(self) -> sparse.csr_array:
        """Share of each displacement in the free directions, shape (free, particles * dim)."""
        return sparse.csr_array(self.free.power(2).T)

    def stretch(self, u: NDArray[Any]) -> NDArray[Any]:
        """`C u`: changes of the bond vectors, shape (bonds, dim), from displacements, shape (particles, dim)."""
        return (self._products[0] @ u.T.ravel()).reshape(self.dim, -1).T

    def gather(self, pulls: NDArray[Any]) -> NDArray[Any]:
        """`C^T f`: forces on the particles from those in the bonds."""
        return (self._products[1] @ pulls.T.ravel()).reshape(self.dim, -1).T

    def along(self, forces: NDArray[Any]) -> NDArray[Any]:
        """`P^T f`: forces along the free directions, shape (free,)."""
        return self._products[2] @ forces.ravel()

    def spread(self, y: NDArray[Any]) -> NDArray[Any]:
        """`P y`: displacements, shape (particles, dim), from those along the free directions."""
        return (self.free @ y).reshape(-1, self.dim)

    def hessian(self, K: NDArray[np.float64], springs: NDArray[np.float64]) -> NDArray[np.float64]:
        """`P^T (C^T K C + k) P`, as a dense matrix: where each of a hundred particles repels fifty others it is nearly full."""
        return (self._assembly @ np.concatenate([K.T.ravel(), springs.ravel()])).reshape(self.free.shape[1], -1)


@dataclass(eq=False)
class Rest:
    """A structure at rest as arrays. Solutions that several objectives need are computed only once.

    Attributes
    ----------
    frame : Frame
    R : ndarray, shape (bonds, dim)
        Vectors of the bonds at rest in mm.
    interaction : PairInteraction
        Of all bonds.
    springs, spring_forces : ndarray, shape (particles, dim)
        Stiffness of the springs in N/mm, and their forces on the particles at rest in N.
    masses : ndarray, shape (particles,)
        In g.
    model : {'complete', 'conventional'}
        Model of the waves; statics always follow the complete model.
    solve : callable, optional
        Solution of the static equations of the free directions, if it is known.
    bent : ndarray, shape (particles, dim), optional
        Displacements of the particles from their feet in mm, less those of the structure that was given.
    rods : float or ndarray, shape (particles,)
        Moving masses of the rods in g; zero if the springs are no rods.
    """

    frame: Frame
    R: NDArray[np.float64]
    interaction: PairInteraction
    springs: NDArray[np.float64]
    spring_forces: NDArray[np.float64]
    masses: NDArray[np.float64]
    model: Model = 'complete'
    solve: Callable[[NDArray[Any]], NDArray[Any]] | None = None
    bent: NDArray[np.float64] | None = None
    rods: Any = 0.0

    def __post_init__(self) -> None:
        self._known: dict[Any, Any] = {}

    @classmethod
    def of(cls, atoms: Atoms | LinearSystem) -> Rest:
        """The arrays of a structure at rest."""
        system = LinearSystem.of(atoms).moving()
        calc = system.calc
        springs, rods = np.broadcast_to(calc.foundation, (len(system), calc.dim)), system.atoms.arrays.get(RODS, 0.0)
        if np.ndim(rods) > 1 or not np.all(rods >= 0):
            raise ValueError(f'atoms.arrays[{RODS!r}] must be the moving mass of the rod of each site in g, zero or more')
        return cls(Frame(calc.bonds, system.free, calc.dim), calc.bond_vectors, calc.interaction, springs,
                   np.broadcast_to(calc.spring_forces, springs.shape), system.masses, calc.model, rods=rods)

    def once(self, key: Any, compute: Callable[[], Any]) -> Any:
        """The stored result for `key`; `compute` runs only the first time."""
        if key not in self._known:
            self._known[key] = compute()
        return self._known[key]

    def K(self, model: Model) -> NDArray[np.float64]:
        """Stiffness of each bond in N/mm, shape (bonds, dim, dim)."""
        return self.once(model, lambda: model_stiffness(self.R, self.interaction, model))

    @cached_property
    def turns(self) -> NDArray[np.float64]:
        """Derivatives of the stiffness of each bond by its vector, shape (bonds, dim, dim, dim), in N/mm^2.

        With `K = A n(x)n + B P`, where A = phi'', B = phi'/r and P = 1 - n(x)n, this is

            dK_xy/dR_z = (A' n_x n_y + B' P_xy) n_z + (A - B)/r (P_xz n_y + P_yz n_x)
        """
        R, law, axes = self.R, self.interaction.central(self.frame.dim), np.eye(self.frame.dim)
        if law is None:
            return np.stack([stiffness_change(R, axis + 0 * R, self.interaction, self.model) for axis in axes], axis=-1)
        r = lengths_of(R)
        n, stretched = R.T / r, law.d2phi(r + 1j * STEP * r)
        A, dA = np.real(stretched), np.imag(stretched) / (STEP * r)
        B = law.dphi(r) / r * (self.model == 'complete')
        dB = (A - B) / r * (self.model == 'complete')
        nn = n[:, None] * n
        P = axes[..., None] - nn
        Pn = (A - B) / r * P[:, None] * n[:, None]
        return np.moveaxis((dA * nn + dB * P)[:, :, None] * n + Pn + Pn.swapaxes(0, 1), -1, 0)

    @cached_property
    def stiffness(self) -> NDArray[np.float64]:
        """Hessian of the free directions in the model of the waves, N/mm."""
        return self.frame.hessian(self.K(self.model), self.springs)

    @cached_property
    def pull(self) -> NDArray[np.float64]:
        """Gradient `phi' n` of the energy of each bond in N, shape (bonds, dim)."""
        law = self.interaction.central(self.R.shape[1])
        if law is None:
            return self.interaction.forces(self.R)[1]
        r = lengths_of(self.R)
        return (law.dphi(r) / r * self.R.T).T

    @cached_property
    def inertia(self) -> NDArray[np.float64]:
        """Mass along each free direction in g."""
        return self.frame.shares @ np.repeat(self.masses, self.frame.dim)

    @cached_property
    def spectrum(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Squared frequencies, and the modes x in columns, shape (free, modes), normalised to x.M x = 1."""
        root = np.sqrt(self.inertia)
        squares, v = np.linalg.eigh(self.stiffness / np.outer(root, root))
        return squares, v / root[:, None]

    def excess(self, omega: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """By how much rods are stiffer than springs with 33/140 of their mass, in static ones, and the slope of this by ln k.

        Both have the shape (particles, dim).  A stiffer rod is a thicker one: its mass goes with the root of its stiffness k.
        """
        m = np.broadcast_to(self.rods, len(self.springs))[:, None] / RAYLEIGH
        x = np.divide(3 * m * omega**2, self.springs, where=self.springs > 0, out=np.zeros(self.springs.shape))
        excess, slope = self.once(('rods', omega), lambda: cantilever_excess(x))
        return excess, excess - slope / 2

    def response(self, force: NDArray[Any], omega: float, damping: float) -> NDArray[np.complex128]:
        """Displacements for a harmonic force on each particle, both of shape (particles, dim), in mm.

        Rods are cantilevers: their stiffness depends on the frequency.
        """
        def solver():
            G = self.stiffness.T.astype(complex)  # symmetric: as LAPACK has it in memory
            beyond = self.springs * self.excess(omega)[0] + (1j * omega * damping - omega**2) * self.masses[:, None]
            G[np.diag_indices(len(G))] += self.frame.shares @ beyond.ravel()
            factor, pivots, _ = linalg.lapack.zsytrf(G, lower=True, lwork=32 * len(G), overwrite_a=True)  # pyright: ignore[reportAttributeAccessIssue]  not in stubs
            return lambda F: linalg.lapack.zsytrs(factor, pivots, F, lower=True)[0]  # pyright: ignore[reportAttributeAccessIssue]

        return self.frame.spread(self.once((omega, damping), solver)(self.frame.along(force) + 0j))

    def harmonic(self, x: NDArray[Any], y: NDArray[Any], omega: float, damping: float) -> Slope:
        """Slope of `-x.(H - omega^2 M + i omega damping M) y` over two responses, shape (particles, dim)."""
        slope = form(self.frame.bonds, -x[..., None], y[..., None], 1j * omega * damping - omega**2)
        return replace(slope, springs=slope.springs * (1 + self.excess(omega)[1]))

    def statics(self, forces: NDArray[Any]) -> NDArray[Any]:
        """Static displacements of the free directions for forces along them, in the complete model."""
        if self.solve is None:
            P = self.frame.free
            Phi = sparse.csr_array(P.T @ hessian(self.frame.bonds, self.K('complete'), self.springs) @ P)
            self.solve = inverse(sparse.csr_array(Phi + REGULAR * abs(Phi).max() * sparse.eye_array(Phi.shape[0])))
        if np.iscomplexobj(forces):
            return self.solve(np.real(forces)) + 1j * self.solve(np.imag(forces))
        return self.solve(forces)


def site_slopes(rest: Rest, slope: Slope, at_rest: bool = False) -> dict[str, Any]:
    """Derivatives by the `mass` in g, the logarithms of `strength` and `spring`, and the `foot` in mm, of each site.

    Those by springs and feet have the shape (particles, dim).  If the positions were measured `at_rest`, they do not follow.
    """
    frame, push = rest.frame, np.einsum('bxy,bxyz->bz', slope.bonds, rest.turns)
    each = (slope.bonds * rest.K(rest.model)).sum((1, 2))
    on = frame.gather(push)
    w, foot, along = np.zeros_like(on), on, frame.along(on)
    if not at_rest and abs(along).max() > ROUND_OFF * abs(push).max():  # else nothing moves, by symmetry
        w = frame.spread(rest.statics(along))
        e = frame.stretch(w)
        left = on - frame.gather(np.einsum('bxy,by->bx', rest.K('complete'), e)) - rest.springs * w
        foot = rest.springs * w + left - frame.spread(frame.along(left))
        each = each - (rest.pull * e).sum(1)
    strengths = np.zeros(len(on), each.dtype)
    for ends in (frame.bonds.i, frame.bonds.j):  # of a bond to a particle's own image both count
        np.add.at(strengths, ends, each)
    return {'mass': slope.masses, 'strength': strengths, 'spring': rest.springs * slope.springs + rest.spring_forces * w,
            'foot': foot}


class ModeScatter(NamedTuple):
    """Natural frequencies of a structure and their standard deviations, in rad/ms.

    Attributes
    ----------
    omega, std : ndarray, shape (modes,)
        Frequencies, and their standard deviations to first order.  Modes of equal frequency, which the scatter splits, all get
        the root mean square of their group.  NaN for a frequency of zero.
    """

    omega: NDArray[np.float64]
    std: NDArray[np.float64]


@takes(*{*LIKE} - {'radii'})
def mode_scatter(atoms: Atoms | LinearSystem, scatter: Scatter, count: int | Modes | None = None,
                 at_rest: bool = False) -> ModeScatter:
    """Natural frequencies of a structure, and their standard deviations from one specimen to the next, to first order.

    For a periodic cell the modes are the waves whose displacements are equal in all cells. Band edges of a supercell of N
    particles scatter as 1/sqrt(N).

    Parameters
    ----------
    atoms : ase.Atoms
        At rest, with PairCalculator.
    scatter : magphonon.stiffness.Scatter
        Standard deviations of each site: of the logarithms of mass, strength and spring, and of the position of the foot of its
        pillar, or of the particle itself if it is held.
    count : int or Modes, optional
        Number of lowest modes to use, or a `Modes` object; by default all modes.
    at_rest : bool
        Whether the positions were measured at rest, as in a photo, so that they do not follow strengths and springs, and
        `scatter.position` is the standard deviation of these measurements.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import mode_scatter
    >>> from magphonon.stiffness import Scatter
    >>> cells = lattices.triangular(1.0, 1.0).repeat((3, 3, 1))
    >>> cells.calc = MagneticRepulsion(cells, InversePower(1.0, 4.0), foundation=1.0)
    >>> omega, std = mode_scatter(cells, Scatter(stiffness=0.06), count=1)  # of each of nine pillars
    >>> round(float(std[0] / omega[0]), 6)  # 0.06/2/sqrt(9)
    0.01
    """
    system = LinearSystem.of(atoms)
    found = count if isinstance(count, Modes) else modes(system, count)
    squares, rest = found.omega * abs(found.omega), Rest.of(system)
    variance = np.empty(len(squares))
    ends = np.flatnonzero(np.diff(squares) > CROSSING * abs(squares).max()) + 1
    for alike in np.split(np.arange(len(squares)), ends):
        shapes = found.shapes[alike]
        forms = (form(rest.frame.bonds, x[..., None], y[..., None], -squares[alike].mean()) for x in shapes for y in shapes)
        variance[alike] = sum(_variance(rest, scatter, site_slopes(rest, each, at_rest)) for each in forms) / len(alike)
    with np.errstate(divide='ignore', invalid='ignore'):
        uncertain = np.sqrt(variance) / (2 * abs(found.omega))
    return ModeScatter(found.omega, np.where(abs(squares) <= CROSSING * abs(squares).max(), np.nan, uncertain))


def _variance(rest, scatter, slopes):
    """Of a number with these slopes, from the independent scatter of all sites."""
    each = (scatter.mass * rest.masses * slopes['mass'], scatter.strength * slopes['strength'],
            scatter.stiffness * slopes['spring'].sum(1), scatter.position * slopes['foot'])
    return sum(float((one**2).sum()) for one in each)
