"""A structure about its rest, `LinearSystem`. All linear results go through it.

A particle has three positions: its anchor, where its foundation spring is slack; its position in the reference of the
calculator, from which displacements are measured; and its present position.  In a perfect lattice they coincide.  Linear
equations of motion hold about positions where the static forces balance along all directions that the constraints leave free.
Static forces are the same in all models: the force of a bond at its present length, along its present direction.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms, FixCartesian, FixedLine, FixedPlane
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from ..errors import NotAtRest, indices
from ..lattices.bonds import lengths_of
from ..traits import refuse, running
from .calculator import PairCalculator, same_cell
from .matrices import Model, growth, mass_weighted
from .repulsion import Repulsion, masses_of, repulsion_of

ROUND_OFF = 1e-11  # fraction of the cancelling forces below which their sum is round-off
BALANCED = 1e-6  # largest force left, in largest bond forces; it changes a linear result by about the same fraction
PLACES = 1e-14  # relative round-off of positions, summed over bonds; it acts on springs that are slack at rest
ELSEWHERE = 1e-3
"""Distance from the reference, as a fraction of the shortest bond, from which balanced particles are at another rest; closer ones
may be displaced so little that their forces only seem balanced."""
TILT = 1e-12  # relative component of a direction that is round-off, as after a rotation in the plane or about the normal
AMU = 1.66053907e-24  # in g
HELD = 1e-12  # relative component of a blocked force below which it is round-off of the direction


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """The linear equations of motion of a structure about an equilibrium, within its constraints.

    With the Hessian H, foundation included, and the orthonormal directions P that the constraints leave free,

        M u'' + H u = f        u = S y        S = M^-1/2 P
        y'' + K y = S^T f      K = S^T H S

    and for a periodic structure K(q), with the Bloch matrix in place of H.  Losses c and gyration g of the sites (1/ms, rad/ms)
    add a term:

        y'' + B y' + K y = S^T f      B = P^T (c - g (x) J) P      J = [[0, 1], [-1, 0]]

    where masses cancel; in space the force of gyration is m u' x g.  Every linear tool begins with `LinearSystem.of(atoms)`
    and accepts such a system in place of the atoms: make it once for several questions about one structure.

    Attributes
    ----------
    atoms : ase.Atoms
        A copy of the structure in this equilibrium, from which its calculator measures displacements.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, modes
    >>> from magphonon.stiffness import LinearSystem
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> system = LinearSystem.of(patch)  # computed once, for several questions
    >>> len(modes(system).omega)
    38
    """

    atoms: Atoms

    @classmethod
    def of(cls, atoms: Atoms | LinearSystem, *also: str) -> LinearSystem:
        """The system about the present positions of the atoms; a LinearSystem is returned unchanged.

        Traits that the calling tool does not declare (`magphonon.traits.takes`) are refused. A caller without a declaration
        accepts structures described by masses and stiffness, and the traits that it names in `also`, such as 'gyration'.

        With AllNeighbours, whose stiffness is not known bond by bond, the system has only `bloch` matrices.

        Raises
        ------
        NotAtRest
            If the forces do not balance: the message says by how much, on which particle, and what to do.
        ValueError
            For another calculator, constraints other than FixAtoms, FixCartesian, FixedLine and FixedPlane, or a refused trait.
        """
        refuse(atoms, running(*also))
        if isinstance(atoms, LinearSystem):
            return atoms
        if not getattr(atoms.calc, 'pairwise', True) and isinstance(atoms.calc, Repulsion):  # the latter alone takes 0.1 ms
            return cls._of_sums(atoms)
        calc = repulsion_of(atoms)
        freedom(atoms)  # refuses other constraints
        there = same_cell(calc, atoms) and np.array_equal(atoms.positions, calc.reference.positions)
        moved = not there and (not same_cell(calc, atoms) or calc.displacements(atoms).any())
        system = cls.about(calc.about(atoms) if moved else calc, atoms)
        if system.left.any() and moved and same_cell(calc, atoms) and not cls.about(calc, atoms).left.any():
            away = np.linalg.norm(calc.displacements(atoms), axis=1).max()
            return system.balanced(f'set the positions back to those of atoms.calc.reference, where the forces balance (up to '
                                   f'{away:.3g} mm away), or ')
        return system.balanced()

    @classmethod
    def _of_sums(cls, atoms):
        """The system for AllNeighbours, whose sums hold at its reference only."""
        freedom(atoms)
        sums: Any = atoms.calc
        away = np.linalg.norm(sums.displacements(atoms), axis=1).max()
        if away > ROUND_OFF * sums.bonds.shortest:
            raise NotAtRest(f'particles are up to {away:.3g} mm away from the reference of AllNeighbours, whose sums hold only '
                            'there; make a new AllNeighbours at these positions')
        return cls.about(sums, atoms).balanced()

    @classmethod
    def nearest(cls, atoms: Atoms | LinearSystem, push: NDArray[np.float64] | None = None, *also: str) -> LinearSystem:
        """The system about the equilibrium of a moving structure, at whose positions the forces need not balance.

        The rest is the reference if the forces balance there. The rest is the present positions if the forces are smaller there,
        or if the present positions are another equilibrium, well away from the reference.

        Parameters
        ----------
        atoms : ase.Atoms or LinearSystem
            With PairCalculator; a system is returned unchanged.
        push : ndarray, shape (particles, 3), optional
            Constant forces of drives, in N, that become part of the dead load.
        *also : str
            Traits that the caller accepts, as in `of`.
        """
        refuse(atoms, running(*also))
        if isinstance(atoms, LinearSystem):
            return atoms
        calc = repulsion_of(atoms)
        calc = calc if same_cell(calc, atoms) else calc.about(atoms)
        calc = calc if push is None else calc.about(calc.reference, calc.load + push)
        reference, u = cls.about(calc, atoms), calc.displacements(atoms)
        left = reference.left.max(initial=0.0)
        if not u.any() or (not left and abs(u).max() <= ELSEWHERE * calc.bonds.shortest):
            return reference
        if calc.model == 'complete':
            with suppress(ValueError):  # of bonds out of range
                forces = reference.static + calc.forces_beyond_rest(u)
                if reference.unbalanced(forces).max(initial=0.0) > left:
                    return reference
        here = cls.about(calc.about(atoms), atoms)
        return here if here.left.max(initial=0.0) <= left else reference

    @classmethod
    def about(cls, calc: Repulsion, atoms: Atoms) -> Self:
        """The system about the reference of `calc`, whether or not the forces balance there."""
        atoms = atoms.copy()
        atoms.positions[:, : calc.dim] = calc.reference.positions[:, : calc.dim]
        atoms.calc = calc
        return cls(atoms)

    def balanced(self, instead: str = '') -> Self:
        """The same system, or NotAtRest if the forces do not balance; `instead` says what else the user can do about it."""
        if not self.left.any():
            return self
        calc: Any = self.atoms.calc
        k = self.left.argmax()
        mend = 'relax it with an optimiser of ASE, and make AllNeighbours at the relaxed positions'
        if calc.pairwise:
            mend = ('relax it: magphonon.relaxed(atoms).atoms in Python, or positions = "anchors" in the table [lattice] of a '
                    'scene whose particles are in a file. If these positions are truly at rest, as in a photo, add the constant '
                    'forces that hold it: atoms.calc.balanced(particles), or positions = "rest"')
        raise NotAtRest('the structure is not at rest, as linear theory requires: a net static force of '
                        f'{self.left[k]:.4g} N acts on particle {k} (the largest force in a bond is {calc.largest[0]:.4g} N), '
                        f'and {np.count_nonzero(self.left)} of {len(self)} particles are not in equilibrium; {instead}{mend}')

    def moving(self) -> Self:
        """The same system, or ValueError if nothing is free: a structure that cannot move has no modes and no response."""
        if self.atoms.constraints:
            freedom(self.atoms)  # refuses those that are not supported
        if not self.directions:
            raise ValueError('the constraints hold every particle; free at least one')
        return self

    def without_B(self) -> LinearSystem:
        """The system at the same rest with B = 0."""
        calc: Any = self.atoms.calc
        return LinearSystem.about(calc.about(calc.reference, gyration=0.0), self.atoms)

    def __len__(self) -> int:
        return len(self.atoms)

    @cached_property
    def calc(self) -> PairCalculator:
        """The calculator, whose reference is the rest; ValueError for AllNeighbours, whose bonds are not known."""
        return repulsion_of(self.atoms)

    @property
    def dim(self) -> int:
        """Number of components of a displacement."""
        return self.atoms.calc.dim  # pyright: ignore[reportOptionalMemberAccess, reportAttributeAccessIssue]  which `about` sets

    @cached_property
    def masses(self) -> NDArray[np.float64]:
        """Masses of the particles in g, shape (particles,)."""
        _warn_of_symbols(self.atoms)
        return masses_of(self.atoms)

    @cached_property
    def static(self) -> NDArray[np.float64]:
        """The static forces in this equilibrium in N, shape (particles, dim)."""
        return static_forces(self.calc)

    @cached_property
    def left(self) -> NDArray[np.float64]:
        """The unbalanced static forces along free directions, in N, shape (particles,); zero if less than BALANCED."""
        calc: Any = self.atoms.calc
        if len(self) == 1 and not calc.pairwise:
            return np.zeros(1)  # by symmetry
        return self.unbalanced(self.static if calc.pairwise else calc.get_forces(self.atoms)[:, : self.dim])

    def unbalanced(self, forces: NDArray[np.float64]) -> NDArray[np.float64]:
        """The part of `forces` (N) along free directions, shape (particles,), and zero if less than BALANCED."""
        if not forces.any() or not (left := lengths_of(self._along_free(forces))).any():
            return np.zeros(len(self))
        calc: Any = self.atoms.calc
        return left * (left > max(BALANCED * calc.largest[0], self.jitter))

    @property
    def jitter(self) -> float:
        """Force in N that may act on a particle because positions are rounded."""
        calc: Any = self.atoms.calc
        shaken = PLACES * max(abs(calc.reference.positions).max(), calc.bonds.longest)  # in mm
        return float(shaken * (calc.largest[1] + np.max(calc.foundation)))

    def _along_free(self, forces):
        mobile, guided, barred = self._freedom
        forces = forces * mobile[:, None]
        forces[guided] -= np.einsum('gxy,gy->gx', barred, forces[guided])
        return forces

    @cached_property
    def free(self) -> sparse.csr_array:
        """Orthonormal directions P in which the constraints let particles move, shape (particles * dim, free).

        Each column is one direction of one particle.  Directions held by constraints other than FixAtoms, FixedLine and
        FixedPlane count as free.
        """
        n, dim = len(self), self.dim
        if not self.atoms.constraints:
            return sparse.csr_array((np.ones(n * dim), np.arange(n * dim), np.arange(n * dim + 1)))
        mobile, guided, barred = self._freedom
        blocks = np.zeros((n, dim, dim))
        blocks[mobile] = np.eye(dim)
        for particle, projector in zip(guided, barred, strict=True):
            blocked, along = np.linalg.eigh(projector)
            blocks[particle] = along * (blocked < 0.5)  # the directions that are not blocked
        free = sparse.csr_array(sparse.bsr_array((blocks, np.arange(n), np.arange(n + 1))))
        free.eliminate_zeros()
        return free[:, np.flatnonzero(abs(free).sum(axis=0))]

    @cached_property
    def _freedom(self):
        """What `freedom` returns; if it refuses a constraint, all particles count as free."""
        try:
            return freedom(self.atoms)
        except ValueError:
            return np.ones(len(self), bool), np.zeros(0, int), np.zeros((0, self.dim, self.dim))

    @property
    def mobile(self) -> NDArray[np.bool_]:
        """Whether each particle can move in any direction, shape (particles,)."""
        return self._freedom[0]

    @property
    def directions(self) -> int:
        """Number of free directions."""
        return self.free.shape[1] if self.atoms.constraints else len(self) * self.dim

    @cached_property
    def shapes(self) -> sparse.csr_array:
        """Displacements S for unit coordinates y, in g^-1/2, shape (particles * dim, free); forces enter as `S^T f`."""
        return sparse.csr_array(sparse.diags_array(1 / np.sqrt(np.repeat(self.masses, self.dim))) @ self.free)

    @cached_property
    def hessian(self) -> sparse.csr_array:
        """Hessian H of all particles in N/mm, of the calculator's `model`."""
        return self.calc.rest_hessian(self.calc.model)

    @cached_property
    def stiffness(self) -> sparse.csr_array:
        """Hessian of the free directions, `P^T H P`, in N/mm."""
        return sparse.csr_array(self.free.T @ self.hessian @ self.free)

    @cached_property
    def K(self) -> sparse.csr_array:
        """Matrix of squared frequencies, `S^T H S`, in rad^2/ms^2, shape (free, free)."""
        return sparse.csr_array(self.shapes.T @ self.hessian @ self.shapes)

    @cached_property
    def turning(self) -> float:
        """The largest rate of gyration in rad/ms; zero if nothing gyrates."""
        return self.atoms.calc.turning  # pyright: ignore[reportOptionalMemberAccess, reportAttributeAccessIssue]  which `about` sets

    @property
    def rate(self) -> Any:
        """B of each site without losses, in 1/ms, force per momentum: shape (1 or particles, dim, dim), or zero."""
        return self.atoms.calc.rate  # pyright: ignore[reportOptionalMemberAccess, reportAttributeAccessIssue]  which `about` sets

    def B(self, damping: ArrayLike = 0.0) -> sparse.csr_array:
        """Matrix of the velocities, `P^T (c - g (x) J) P`, in 1/ms, for the damping c (1/ms) of all sites or of each.

        It is the same in weighted coordinates: c and g are forces per momentum.  A guided particle does not gyrate.
        """
        n = len(self)
        blocks = np.broadcast_to(damping, n)[:, None, None] * np.eye(self.dim) + self.rate
        return sparse.csr_array(self.free.T @ sparse.bsr_array((blocks, np.arange(n), np.arange(n + 1))) @ self.free)

    @cached_property
    def spectrum(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Eigenvalues of K, ascending, and its eigenvectors in columns; only for small structures, since the time grows as
        directions^3.
        """
        squares, vectors = np.linalg.eigh(self.K.toarray())
        return squares, vectors

    def bloch(self, q: NDArray[np.float64], model: Model | None = None) -> NDArray[np.complex128]:
        """Matrices of squared frequencies K(q) in rad^2/ms^2, shape (wavevectors, free, free); q of shape (wavevectors, 3)."""
        calc: Any = self.atoms.calc
        return self.reduced(calc.bloch_matrix(q, model))

    def reduced(self, D: NDArray[Any]) -> NDArray[Any]:
        """`S^T D S` of matrices of all displacements, shape (..., particles * dim, particles * dim)."""
        weighted = mass_weighted(D, self.masses)
        if not self.atoms.constraints:
            return weighted
        P = self.free.toarray()
        return P.T @ weighted @ P

    @cached_property
    def stable(self) -> bool:
        """Whether stiffness alone holds the structure: no squared frequency is negative, apart from round-off."""
        from .lowest import none_negative, proves_stable  # late: bands need neither

        return proves_stable(self) or none_negative(self.K)

    def proved(self, proof: Callable[[], bool]) -> None:
        """Keep that the structure is `stable`, if that is not known and a cheaper `proof` than those here shows it."""
        if 'stable' not in vars(self) and proof():
            vars(self)['stable'] = True

    def growth(self, damping: ArrayLike = 0.0) -> float:
        """Rate in 1/ms of the mode that grows fastest, zero if none does; gyration may hold a structure that stiffness does not.

        Losses (1/ms, of all sites or of each), however small, destroy such stability by gyration.
        """
        return 0.0 if self.stable else float(growth(self.B(damping).toarray(), self.K.toarray()))

    def recorded(self, particles: ArrayLike | None) -> NDArray[np.int_]:
        """Indices of the particles whose motion is wanted, as an array; None means all of them."""
        if particles is None:
            return np.arange(len(self))
        return indices('particles', particles, len(self))

    def rows(self, particles: NDArray[np.int_]) -> tuple[NDArray[np.int_], sparse.csr_array]:
        """The free directions in which some particles move, and the block of `shapes` of these particles and directions."""
        own = self.shapes[(particles[:, None] * self.dim + np.arange(self.dim)).ravel()]
        wanted = np.zeros(self.free.shape[1], bool)  # np.unique takes a hundred times as long
        wanted[own.indices] = True
        rows = np.flatnonzero(wanted)
        return rows, own[:, rows]


def _warn_of_symbols(atoms: Atoms) -> None:
    """Warn of masses that were not given: ASE then uses those of the symbols, whose numbers would be taken as grams."""
    if not atoms.has('masses') and len(atoms):
        mass, symbol = atoms.get_masses()[0], atoms.symbols[0]
        warnings.warn(f'the particles have only the masses of their symbols, {mass:.6g} for {symbol}, which count as grams; '
                      'give them, as atoms.set_masses([0.7 * units.g] * len(atoms)), or for atomic masses '
                      f'atoms.set_masses(atoms.get_masses() * {AMU:.6g}), here {mass * AMU:.4g} g', stacklevel=4)


def static_forces(calc: PairCalculator, push: Any = 0.0) -> NDArray[np.float64]:
    """Sum of the forces of bonds, foundation, dead load and a constant push in N, shape (particles, dim); zero in balance.

    The round-off of forces that cancel is set to zero; a load or push (N, shape (particles, 3)) on balanced particles is kept,
    however small.
    """
    (pull, strength), springs = calc.bond_forces, calc.spring_forces
    total, size = springs - pull, 2 * np.maximum.reduce(abs(springs.T))[:, None] + strength
    total[abs(total) <= ROUND_OFF * size] = 0
    for given in (calc.load, push) if np.ndim(push) else (calc.load,):
        if not given.any():
            continue
        given = components(given, calc.dim)
        # a load on balanced particles has nothing to cancel
        size = np.where(total, size, 0) + abs(given).max(axis=1, keepdims=True)
        total = total + given
        total[abs(total) <= ROUND_OFF * size] = 0
    return total


def components(forces: NDArray[Any], dim: int) -> NDArray[Any]:
    """Components of forces in the dimensions of the structure, shape (..., dim); a force out of its plane is refused."""
    if dim == 2 and forces[..., 2].any():
        raise ValueError('a force pushes along z, but the structure is planar; give it a direction in the plane')
    return forces[..., :dim]


def freedom(atoms: Atoms) -> tuple[NDArray[np.bool_], NDArray[np.int_], NDArray[np.float64]]:
    """Mask of the particles that FixAtoms does not hold, indices of those that FixedLine or FixedPlane guides, and for each of
    these the projector on its blocked directions, shape (guided, dim, dim); other constraints are refused.
    """
    mobile, dim = np.ones(len(atoms), bool), getattr(atoms.calc, 'dim', 2)
    barred = {}
    for constraint in atoms.constraints:
        blocked = _blocked(constraint, dim)
        if blocked.trace() > dim - 0.5:  # all directions
            mobile[constraint.index] = False
            continue
        if blocked.any() and barred.keys() & set(constraint.index):
            raise ValueError(f'{constraint!r} guides a particle that another constraint already guides')
        barred |= dict.fromkeys(constraint.index.tolist() if blocked.any() else [], blocked)
    guided = np.array([k for k in sorted(barred) if mobile[k]], int)
    return mobile, guided, np.array([barred[k] for k in guided]).reshape(-1, dim, dim)


def _blocked(constraint, dim):
    """The projector on the directions, of the first `dim` ones, that a constraint blocks."""
    if isinstance(constraint, FixAtoms):
        return np.eye(dim)
    if isinstance(constraint, FixCartesian):
        return np.diag(constraint.mask[:dim].astype(float))
    if type(constraint) not in (FixedLine, FixedPlane):
        raise ValueError(f'only FixAtoms, FixCartesian, FixedLine and FixedPlane are supported, not {constraint!r}')
    d = np.where(abs(constraint.dir) > TILT, constraint.dir, 0.0)
    if d[:dim].any() and d[dim:].any():
        raise ValueError(f'{constraint!r} guides a particle out of the plane')
    dd = np.outer(d, d)[:dim, :dim]
    return np.eye(dim) - dd if isinstance(constraint, FixedLine) else dd


def refuse_held(forces: NDArray[Any], atoms: Atoms, what: str) -> None:
    """Refuse forces on particles, shape (particles, 3), that constraints block completely.

    Only a force without any effect is a mistake: forces of which a part acts are accepted, such as a push that also hits a held
    rim. The message names the pushing object, `what`, and the particles.
    """
    left = np.array(forces)
    for constraint in atoms.constraints:
        if isinstance(constraint, FixAtoms | FixCartesian | FixedLine | FixedPlane):
            constraint.adjust_forces(atoms, left)
    largest = abs(forces).max(initial=0)
    if largest and abs(left).max() <= HELD * largest:
        pushed = np.flatnonzero(abs(forces).max(axis=1))
        raise ValueError(f'{what} pushes {f"particle {pushed[0]}" if len(pushed) == 1 else f"particles {pushed.tolist()}"} only '
                         'where constraints hold (FixAtoms, or FixedLine and FixedPlane across their free direction) and would '
                         'do nothing; push a particle that is free, or along its free direction')
