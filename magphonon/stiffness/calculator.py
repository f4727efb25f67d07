"""ASE calculator of particles that repel each other and are tied to an elastic foundation; its cell may change.

Without a foundation the energy depends on the bonds alone: as the cell changes, the bonds join the same pairs of particles across
the same periods, and the energy has a stress.  With a foundation or a dead load, a changed cell is refused, because it is not
known whether these follow the cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from ase import Atoms
from ase.calculators.calculator import PropertyNotImplementedError
from ase.geometry import find_mic, minkowski_reduce
from ase.stress import full_3x3_to_voigt_6_stress
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from ..errors import Unstable, indices, one_of
from ..interactions.bond_laws import Laws, checked_laws
from ..lattices.bonds import Bonds, bonds_of, image_of, lengths_of, repeat_bonds
from .matrices import (
    BROKEN_BOND,
    MODELS,
    Model,
    bloch_gradient,
    bloch_matrix,
    bloch_series,
    displaced,
    hessian,
    interaction_along,
    model_stiffness,
)
from .plausibility import refuse_infinite, warn_of_units
from .repulsion import Repulsion, masses_of
from .sites import (
    Foundation,
    Sites,
    displacement_components,
    from_reference,
    range_of,
    refuse_height,
    refuse_motion_out_of_the_plane,
    same,
)

NO_STRESS = ('the stress on a cell is defined by its bonds in the complete model; a foundation or a dead load adds external '
             'forces: use a calculator without them, or if bonds balance magphonon.stiffness.elastic_moduli(atoms).stress')
ACROSS = 1e-9  # relative change of the cell across its periodic directions above which the change is not round-off
HESSIAN_PARTS = ('D0', 'Dstar', 'foundation', 'all')


class PairCalculator(Repulsion):
    """Pair repulsion between particles about their rest positions, with foundation springs.

    Three arguments are enough: the structure at rest, the law of its bonds, and the stiffness of the supports.

    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> cell = lattices.square(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=5.0)
    >>> float(abs(cell.get_forces()).max())  # in balance by symmetry
    0.0
    >>> cell.calc.get_hessian(cell).shape
    (3, 3)

    With the rest vector R and length r0 of a bond, its unit vector n, the relative displacement du of its ends and
    the displacement u of each particle from rest, the energy is

        complete      E = sum_bonds [phi(|R + du|) - phi(r0)] + sum_particles (k u^2 / 2 - h.u)
        conventional  E = sum_bonds [phi(r0 + n.du) - phi(r0)] + sum_particles (k u^2 / 2 - h.u)

    Particles may differ: each may have its own spring constants k along each direction, its own strength s (the energy of
    the pair i, j is s_i s_j phi), and its own kind, given by its ASE tag, which selects phi.  `law` is the pair law of each bond.

    The rest position of a particle and the anchor of its spring may differ.  A foundation spring is slack at its anchor; at rest
    it pulls with -k (rest - anchor). Together with the dead load this is the constant force h = load - k (rest - anchor).  In a
    perfect lattice both positions coincide and h = 0; after `magphonon.relaxed` they differ near defects and rims.

    The conventional model keeps the bond directions fixed.  Where forces are not along the bond, phi is a function of the
    vector: of R + du in the complete model, of R (r0 + n.du)/r0 in the conventional one.

    Particles that share one z are planar, unless the structure is periodic in all three directions: no force acts along z.
    (Real magnets are unstable out of the plane, and supports hold them.)  A foundation `[[k, k, kz]]` with three components lets
    them move out of the plane: kz is the stiffness of their supports along z.  The repulsion then acts along the line between two
    particles, or as `magphonon.interactions.UprightMagnets` describes. All other structures move in three dimensions.

    Parameters
    ----------
    reference : ase.Atoms
        The rest configuration: displacements are measured from its positions, modulo periodic images, and the energy is zero
        there.  The forces need not balance there, except for linear results (`magphonon.stiffness.rest`).
    laws : PairLaw, or mapping from pairs of kinds to PairLaw
        Pair law in mm, mJ; `magphonon.interactions.PairLaw` says how to write your own.  For particles of different kinds
        give a law for each pair of kinds that repel each other, `{(0, 0): one, (0, 1): another}`, in either order.  The kind
        of a particle is its tag in `reference`, `atoms.get_tags()`.  In patches made by magphonon the tags count the rows from
        the rim; `atoms.set_tags` replaces them by kinds.
    foundation : float or array_like, shape (particles,), (1, dim) or (particles, dim)
        Stiffness of the spring between each particle and its anchor, N/mm: one number, one for each particle, for each
        direction, or for both.
    strengths : array_like, shape (particles,), optional
        Strength s of each particle, by default 1: two particles repel by the law `s_i s_j phi(r)`.  For magnets s is the
        magnetic moment divided by that of the magnets with which the law was measured; those of opposite signs attract each
        other, as if one were upside down.
    anchors : array_like, shape (particles, 3), optional
        Where the foundation springs are slack, in mm; the positions of the reference if not given.
    load : array_like, shape (particles, 3), optional
        Dead load: a constant force on each particle in N, such as the weight or the push that holds an oscillator against
        its magnets.  A load on a held particle has no effect.
    model : {'complete', 'conventional'}
    shells : int
        Number of neighbour shells that interact.
    cutoff : float, optional
        Instead of `shells`: the distance in mm within which particles interact.
    bonds : Bonds or sequence of (i, j) or (i, j, shift), optional
        The interacting pairs, instead of `shells` and `cutoff`.  Their vectors are computed at the reference.
    gyration : float or array_like, shape (particles,), or in space (3,) or (particles, 3)
        g in rad/ms, for all particles or for each.  The force `m u' x g` turns velocities about the vector g, or about z if g
        is a number: the force on gyroscopes, on a rotating bench (g is twice its rate) or on charges in a magnetic field.  In
        the plane it is `m g J u'`, J = [[0, 1], [-1, 0]], and turns clockwise.  It does no work and is not part of the ASE
        `forces`: tools of this package include it, as `DrivenVerlet` does, or refuse it; ASE's own dynamics ignores it.
    radii : float or array_like, shape (particles,), optional
        Radii R in mm: the laws are then functions of `r/(R_i + R_j)`, as between soft spheres (`magphonon.interactions.Overlap`).
    dim : {2, 3}, optional
        Number of components of a displacement; by default it follows from the positions, the cell and the foundation.

    Warns
    -----
    UserWarning
        If law, foundation and masses give frequencies of less than 1e-4 or more than 1e13 Hz: most likely SI numbers were
        given without their units.
    """

    implemented_properties: ClassVar[list[str]] = ['energy', 'free_energy', 'energies', 'forces', 'stress', 'hessian']
    default_parameters: ClassVar = dict.fromkeys(Sites.names(settable=True), 0.0) | {'model': 'complete'}
    saved: ClassVar[tuple[str, ...]] = ('model', 'bonds', *Sites.names(seldom=False))
    seldom: ClassVar[tuple[str, ...]] = (*Sites.names(seldom=True), 'dim')
    pairwise = True
    atoms: Any  # of ASE, which declares them as None
    parameters: Any
    bloch_models = MODELS

    def __init__(self, reference: Atoms, laws: Laws, *, foundation: Foundation | ArrayLike = 0.0,
                 strengths: ArrayLike | None = None, model: Model = 'complete', shells: int = 1, cutoff: float | None = None,
                 bonds: Bonds | Sequence[Any] | None = None, anchors: ArrayLike | None = None,
                 load: ArrayLike | None = None, gyration: ArrayLike = 0.0, radii: ArrayLike | None = None,
                 dim: int | None = None) -> None:
        """Build the calculator for a structure at rest; the class says what the arguments are."""
        self._laws = checked_laws(laws)
        masses_of(reference)
        self.reference = reference.copy()
        self.reference.calc = None
        first = not isinstance(bonds, Bonds)  # a calculator made from another one receives its Bonds
        reach = f'shells={shells}' if cutoff is None else f'cutoff={cutoff:g}'
        self._reach = reach if bonds is None else f'bonds={len(bonds)}'
        self.bonds = bonds = bonds_of(self.reference, bonds, shells, cutoff)
        self.dim = displacement_components(reference, foundation, dim, bonds)
        self.reference.positions.flags.writeable = False  # constant forces are computed from them once
        self._sites = Sites(strengths, anchors, load, foundation, gyration, radii).checked(self.reference, self.dim)
        self.interaction = interaction_along(self._laws, bonds, self.reference.get_tags(), self.strengths, self.dim,
                                             self._sites.radii)
        refuse_height(self.reference, bonds, self.dim, central=self.interaction.central(self.dim) is not None)
        refuse_infinite(self)
        super().__init__(model=model)
        self.parameters |= {name: vars(self._sites)[name] for name in Sites.names(settable=True)}
        if first:
            warn_of_units(self)

    @property
    def anchors(self) -> NDArray[np.float64]:
        """Positions at which the foundation springs are slack in mm, shape (particles, 3); read-only."""
        return self._sites.anchors

    @property
    def load(self) -> NDArray[np.float64]:
        """Dead load in N, shape (particles, 3); read-only: `about(atoms, load)` makes a calculator with another load."""
        return self._sites.load

    @property
    def model(self) -> Model:
        """Model of the forces and of their stiffness at rest: 'complete' or 'conventional'."""
        return self.parameters.model

    @property
    def bond_vectors(self) -> NDArray[np.float64]:
        """Vectors of the bonds at rest in mm, shape (bonds, dim)."""
        return self.bonds.vectors[:, : self.dim]

    def set(self, **parameters: Any) -> dict[str, Any]:
        if 'model' in parameters:
            one_of('model', parameters['model'], MODELS)
        return super().set(**parameters)

    def changed(self, reference: Atoms | None = None, bonds: Bonds | None = None, sites: Sites | None = None, *,
                laws: Any = None, model: Model | None = None, dim: int | None = None) -> PairCalculator:
        here = self.reference if reference is None else reference
        if bonds is None:
            bonds = self.bonds if reference is None else self.bonds.at(reference)
        return PairCalculator(here, self.laws if laws is None else laws, bonds=bonds, model=model or self.model,
                                 dim=dim or self.dim, **vars(self.sites if sites is None else sites))

    def on(self, supercell: Atoms) -> PairCalculator:
        """The same calculator on a supercell of its reference, whatever the order of the particles there."""
        bonds = repeat_bonds(self.bonds, self.reference, supercell)
        image = image_of(self.reference, supercell)
        reference = supercell.copy()
        reference.set_tags(self.reference.get_tags()[image])  # tags are kinds, and phonopy does not keep tags
        return self.changed(reference, bonds, replace(self.sites[image], anchors=supercell.positions - self.slack[image]))

    def about(self, atoms: Atoms, load: ArrayLike | None = None, *, model: Model | None = None, **sites: Any) -> PairCalculator:
        """The same calculator with the present positions of `atoms` as its reference, and another load, model or `sites`.

        The pairs of particles, the anchors and the load stay; the bond vectors are computed again.  The forces at the new
        rest need not balance: `LinearSystem.of` checks that.  The cell may differ if nothing is anchored
        (`magphonon.stiffness.calculator`).
        """
        if not same_cell(self, atoms):
            rest, bonds = carried(self, atoms)
            return self.changed(rest, bonds, replace(self.sites, anchors=None)).about(atoms, load, model=model, **sites)
        rest = self.reference.copy()
        rest.positions[:, : self.dim] += self.displacements(atoms)
        return self.changed(rest, sites=replace(self.sites, load=self.load if load is None else load, **sites), model=model)

    def balanced(self, particles: NDArray[Any] | Sequence[int]) -> PairCalculator:
        """The same calculator with the dead load that balances all other forces at rest on the particles with these indices."""
        load, particles = self.load.copy(), indices('particles', particles, len(self.reference))
        rest = np.zeros((len(load), self.dim))
        load[particles, : self.dim] -= (self.offset - self._pulls(rest)[1])[particles]
        return self.about(self.reference, load)

    def __repr__(self) -> str:
        own = f', strengths={range_of(self.strengths)}' if (self.strengths != 1).any() else ''
        own += f', gyration={range_of(self.gyration)}' if np.any(self.gyration) else ''
        return (f'{type(self).__name__}({self.laws!r}, {self._reach}, foundation={range_of(self.foundation)}{own}, '
                f'model={self.model!r}) of {len(self.reference)} particles')

    def get_property(self, name: str, atoms: Atoms | None = None, allow_calculation: bool = True) -> Any:
        if name == 'hessian':  # it is expensive and not part of a trajectory, so it is never cached
            return self.get_hessian(atoms if atoms is not None else self.atoms) if allow_calculation else None
        if name == 'stress' and (self.tied or self.load.any() or self.model != 'complete'):
            raise PropertyNotImplementedError(NO_STRESS)
        return super().get_property(name, atoms, allow_calculation)

    def answers(self, atoms: Atoms, properties: Any) -> dict[str, Any]:
        here = self if same_cell(self, atoms) else self.about(atoms)
        # what stays is allocated before what goes, so that no holes are left in memory
        forces, at_rest, u = np.zeros((len(atoms), 3)), self._energy_at_rest, here.displacements(atoms)
        if self.dim == 2:
            refuse_motion_out_of_the_plane(here, atoms)
        half, pull = here._pulls(u, at_rest)
        for of_all, force in zip(forces.T, (here.offset - pull - here.foundation * u).T, strict=False):
            of_all[:] = force
        energies = np.einsum('ix,ix->i', 0.5 * here.foundation * u - here.offset, u) + half
        total = energies.sum()
        found = {'forces': forces, 'energies': energies, 'energy': total, 'free_energy': total}
        return found | {'stress': stress_per_volume(self, atoms)} if 'stress' in properties else found

    def displacements(self, atoms: Atoms) -> NDArray[np.float64]:
        """Displacements from rest in mm, shape (particles, dim), by minimum image in the periodic directions."""
        return self._minimum_image(from_reference(self, atoms, self.dim))

    def _minimum_image(self, u):
        limit = self._shortest_period**2 / 4  # below it u is its own minimum image
        if limit < np.inf and np.einsum('ix,ix->i', u, u).max(initial=0) > limit:
            dim, space = u.shape[1], np.zeros((len(u), 3))
            space[:, :dim] = u
            u = np.ascontiguousarray(find_mic(space, self.reference.cell, self.reference.pbc)[0][:, :dim])  # pyright: ignore[reportArgumentType]  three pbc
        return u

    @cached_property
    def _shortest_period(self):
        """Length of the shortest lattice vector in mm; infinite for a finite structure."""
        periodic = self.reference.pbc
        reduced = minkowski_reduce(self.reference.cell.array, periodic)[0]  # pyright: ignore[reportArgumentType]  three pbc
        return np.linalg.norm(np.asarray(reduced)[periodic], axis=1).min(initial=np.inf)

    @cached_property
    def _energy_at_rest(self):
        """Energy of each bond at rest in mJ."""
        return self.interaction.forces(self.bond_vectors)[0]

    @cached_property
    def bond_forces(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Sums over the bonds of each particle at rest, in N: of gradients, shape (particles, dim), and sizes, (particles, 1).

        Its own images push a particle from both sides alike.
        """
        if (self.bonds.i == self.bonds.j).all():
            return np.zeros((self.bonds.particles, self.dim)), np.zeros((self.bonds.particles, 1))
        gradient = self.interaction.forces(self.bond_vectors)[1]
        return self.bonds.net(gradient), self.bonds.total(lengths_of(gradient)[:, None])

    @cached_property
    def slack(self) -> NDArray[np.float64]:
        """Extension of the foundation springs at rest: vectors from anchor to rest in mm, shape (particles, 3)."""
        rest = self.reference.positions
        return np.broadcast_to(0.0, rest.shape) if self.anchors is rest else self._minimum_image(rest - self.anchors)

    @property
    def spring_forces(self) -> NDArray[np.float64]:
        """Forces of the foundation at rest, `-k (rest - anchor)` of springs, in N, shape (particles, dim)."""
        return -self.foundation * self.slack[:, : self.dim]

    @cached_property
    def offset(self) -> NDArray[np.float64]:
        """Constant force `load - k (rest - anchor)` on each particle in N, shape (particles, dim)."""
        return np.asfortranarray(self.load[:, : self.dim] + self.spring_forces)

    def displaced(self, u: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64] | None]:
        """Bond vectors at displacements `u` from rest, shape (particles, dim), their lengths and directions; see
        `matrices.displaced`.
        """
        R, limit = self.bond_vectors, self._shortest_period**2 / 16
        # As a lattice drifts, its particles reach the next cell one by one: u of two ends may be measured from different images
        if limit < np.inf and np.einsum('ix,ix->', u, u) > limit:  # cheaper than the largest u
            R, u = R + self._minimum_image(self.bonds.relative(u)), 0 * u
        return displaced(self.bonds, *self.bonds.stretched(R, u), self.interaction, self.model)

    def _pulls(self, u, at_rest: Any = 0.0):
        """Sums over the bonds of each particle at displacements u: half of the energies beyond those `at_rest` in mJ, shape
        (particles,), and the gradients by the positions in N, (particles, dim).
        """
        vectors, r, n = self.displaced(u)
        law, rows = self.interaction.central(self.dim), np.empty((self.dim + 1, len(r)))
        if law is None:
            energy, gradient = self.interaction.forces(vectors)
            rows[:-1] = gradient.T if n is None else (gradient * n).sum(axis=1) * n.T
        else:
            energy = law.phi(r)
            np.multiply(law.dphi(r) / r, vectors.T, out=rows[:-1])
        np.subtract(energy, at_rest, out=rows[-1])
        near, far = self.bonds.at_ends(rows)
        return 0.5 * (near[-1] + far[-1]), (far[:-1] - near[:-1]).T

    def rest_stiffness(self, model: Model | None = None) -> NDArray[np.float64]:
        """Stiffness of each bond at rest in the given model or the calculator's own, in N/mm, shape (bonds, dim, dim)."""
        return model_stiffness(self.bond_vectors, self.interaction, model or self.model)

    def rest_hessian(self, model: Model | None = None) -> sparse.csr_array:
        """Hessian at rest, with the foundation, in N/mm: sparse, shape (particles * dim, particles * dim)."""
        return hessian(self.bonds, self.rest_stiffness(model), self.foundation)

    def bloch_matrix(self, q: NDArray[np.float64], model: Model | None = None) -> NDArray[np.complex128]:
        """Bloch matrix at rest, with the foundation, in N/mm; see `matrices.bloch_matrix`."""
        return bloch_matrix(self.bonds, self.rest_stiffness(model), q, self.foundation)

    def bloch_gradient(self, q: NDArray[np.float64], model: Model | None = None) -> NDArray[np.complex128]:
        return bloch_gradient(self.bonds, self.rest_stiffness(model), q, self.reference.cell.array)

    def bloch_series(self, along: NDArray[np.float64],
                     model: Model | None = None) -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.complex128]]:
        """Bloch matrix without foundation to second order in the wavevector k `along`; see `stiffness.bloch_series`."""
        R = (self.bonds.shift @ self.reference.cell.array)[:, : self.dim]
        return bloch_series(self.bonds, self.rest_stiffness(model), R @ along)

    def singular(self, along: NDArray[np.float64], model: Model | None = None) -> NDArray[np.float64]:
        """Zero, shape (dim, dim): with finitely many neighbours no term exceeds the second order in long waves."""
        return np.zeros((self.dim, self.dim))

    def get_hessian(self, atoms: Atoms, part: str = 'all') -> sparse.csr_array:
        """Second derivatives of the energy at the present positions, or one part of them.

        Parameters
        ----------
        atoms : ase.Atoms
        part : {'all', 'D0', 'Dstar', 'foundation'}
            'all' is the sum of the three in the complete model; in the conventional model 'Dstar' is zero.

        Returns
        -------
        scipy.sparse.csr_array, shape (3 * particles, 3 * particles)
            In N/mm, with the components in ASE's order.  Rows along z are empty for planar particles.
        """
        one_of('part', part, HESSIAN_PARTS)
        D0, Dstar = self.interaction.stiffness(self.displaced(self.displacements(atoms))[0])
        if self.model == 'conventional':
            Dstar = np.zeros_like(Dstar)
        K = {'D0': D0, 'Dstar': Dstar, 'foundation': 0 * D0, 'all': D0 + Dstar}[part]
        H = hessian(self.bonds, K, self.foundation if part in ('all', 'foundation') else 0.0)
        to_space = sparse.kron(sparse.eye_array(len(atoms)), sparse.eye_array(3, self.dim), format='csr')
        return sparse.csr_array(to_space @ H @ to_space.T)

    def forces_beyond_rest(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Change of the forces due to displacements `u` from rest: N, both of shape (particles, dim)."""
        return self.bond_forces[0] - self._pulls(u)[1] - self.foundation * u


MagneticRepulsion = PairCalculator
"""Another name of `PairCalculator`, for the magnets of the paper."""


def measure(atoms: Atoms) -> float:
    """Length, area or volume of a cell: of a chain in mm, of a planar lattice in mm^2, of a crystal in space in mm^3."""
    periods = atoms.cell.array[atoms.pbc]
    return float(np.sqrt(np.linalg.det(periods @ periods.T)))


def same_cell(calc: PairCalculator, atoms: Atoms) -> bool:
    """Whether the atoms are in the cell of the calculator's reference."""
    return same(atoms.cell.array, calc.reference.cell.array)


def carried(calc: PairCalculator, atoms: Atoms) -> tuple[Atoms, Bonds]:
    """Reference and bonds of a calculator, strained homogeneously from its cell to that of `atoms`."""
    reference, cell = calc.reference, atoms.cell
    anchored = not atoms.pbc.any() or calc.tied or calc.load.any()
    if anchored or len(atoms) != len(reference) or not np.array_equal(atoms.pbc, reference.pbc):
        from_reference(calc, atoms)  # says so
    if calc.model != 'complete':
        raise ValueError(f"the cell differs from the reference, where the model {calc.model!r} fixes the directions of bonds; "
                         "use model='complete', or make a calculator for this cell")
    strain = np.linalg.solve(reference.cell.complete().array, cell.complete().array)
    rest = reference.copy()
    rest.set_cell(cell)
    rest.positions = reference.positions @ strain
    bonds = replace(calc.bonds, vectors=calc.bonds.vectors @ strain, cutoff=None)
    for b in np.flatnonzero(bonds.lengths > BROKEN_BOND * calc.bonds.lengths)[:1]:
        raise Unstable(f'the cell has grown until the particles {bonds.i[b]} and {bonds.j[b]} are {bonds.lengths[b]:.4g} mm '
                       f'apart instead of {calc.bonds.lengths[b]:.4g} mm and no longer neighbours: only a pressure holds a '
                       'lattice of repelling particles together; give a pressure, as scalar_pressure= to FrechetCellFilter')
    return rest, bonds


def bond_virial(calc: PairCalculator, u: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
    """Derivative of the energy of the bonds by the strain at displacements `u`: gradients times R, in mJ, shape (dim, dim)."""
    R = calc.bond_vectors + (calc.bonds.incidence @ u if np.ndim(u) else 0.0)
    return np.einsum('bx,by->xy', calc.interaction.forces(R)[1], R)


def stress_per_volume(calc: PairCalculator, atoms: Atoms) -> NDArray[np.float64]:
    """Stress as defined by ASE, `dE/d strain` divided by the volume of the cell, in N/mm^2, Voigt's order xx, yy, zz, yz, xz, xy.

    It is negative where particles repel each other.  The volume contains the height of a planar cell, which has no physical
    meaning: `magphonon.stiffness.elastic_moduli(atoms).stress` is the force per length.
    """
    if not (atoms.pbc.any() and atoms.cell.rank == 3):
        raise ValueError('a stress as defined by ASE is a force per area of a periodic cell with a volume; give the cell three '
                         'vectors (the length of the vector normal to a planar lattice only divides the stress)')
    before, after = (abs(np.linalg.det(at.cell.array)) / measure(at) for at in (calc.reference, atoms))
    if abs(after - before) > ACROSS * before:
        raise ValueError(f'perpendicular to its periodic directions the cell changes from {before:.6g} to {after:.6g} mm (mm^2 '
                         'for a chain), which has no meaning and would change the stress. Keep these vectors: give filters of '
                         'ASE mask=(1, 1, 0, 0, 0, 1) for a planar lattice, (1, 0, 0, 0, 0, 0) for a chain along x, and no '
                         'hydrostatic_strain')
    here = calc if same_cell(calc, atoms) else calc.about(atoms)
    stress = np.zeros((3, 3))
    stress[: calc.dim, : calc.dim] = bond_virial(here, here.displacements(atoms)) / atoms.get_volume()
    return full_3x3_to_voigt_6_stress(stress)
