"""ASE calculator of particles that repel each other and stand on an elastic foundation."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from ase.calculators.calculator import PropertyNotImplementedError, all_changes
from scipy import sparse

from ..errors import finite, one_of
from ..interactions.bond_laws import checked_potential, law_along
from ..interactions.upright import UprightMagnets
from ..lattices.bonds import Bonds, explicit_bonds, find_bonds, image_of, repeat_bonds
from .bond import MODELS, bond_stiffness, leaves_the_plane, model_stiffness, upright_forces
from .cells import NO_STRESS, carried, same_cell, stress_per_volume
from .matrices import bloch_matrix, bloch_series, hessian
from .positions import from_reference, minimum_image, refuse_motion_out_of_the_plane, shortest_period
from .repulsion import masses_of
from .restartable import Restartable
from .scale import warn_of_units
from .sites import displacement_components, of_sites, range_of, refuse_infinite, site_springs, site_strengths

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from ase import Atoms
    from numpy.typing import ArrayLike, NDArray

    from ..interactions.bond_laws import Potential
    from ..interactions.pair_laws import PairLaw
    from .sites import Foundation

CALCULATOR_MODELS = ('complete', 'conventional', 'literal')
HESSIAN_PARTS = ('D0', 'Dstar', 'foundation', 'all')
NO_ENERGY = "the literal conventional force does work around a closed loop: it has no energy or Hessian; use model='conventional'"


class MagneticRepulsion(Restartable):
    """Pair repulsion between particles about their rest positions, with foundation springs.

    With the rest vector R and length r0 of a bond, its unit vector n, the relative displacement du of its ends and
    the displacement u of each particle from rest, the energy is

        complete      E = sum_bonds [phi(|R + du|) - phi(r0)] + sum_particles (k u^2 / 2 - h.u)
        conventional  E = sum_bonds [phi(r0 + n.du) - phi(r0)] + sum_particles (k u^2 / 2 - h.u)

    Every site may be its own: springs k of its own along each direction, a strength s of its own, by which the energy of the
    pair i, j is s_i s_j phi, and a kind, its ASE tag, by which phi is chosen.  `law` is the pair law of each bond.

    Rest and anchors are two things.  A foundation spring is slack at its anchor; at rest it pulls with -k (rest - anchor),
    and with the dead load this makes the constant force h = load - k (rest - anchor).  In a perfect lattice both places
    coincide and h = 0; after `magphonon.relaxed` they differ where a defect or a rim has moved the particles.

    The conventional model freezes the bond directions.  The paper's own words, "only the magnitude is updated",
    can also mean the force -phi'(|R + du|) n: `model='literal'`.  That force is not conservative, so it has
    neither energy nor Hessian; it is here to be compared with.

    Particles in a structure that is not periodic in all three directions are planar: they must share one z, and
    neither forces nor foundation act along it.  (Magnets are in truth unstable out of the plane; supports hold them.)
    A foundation with three components, `foundation=[[k, k, kz]]`, lets them move out of the plane: kz is the stiffness of
    their supports along z.  Then the repulsion acts along the line between two particles, or as that of
    `magphonon.interactions.UprightMagnets`.

    Parameters
    ----------
    reference : ase.Atoms
        The rest configuration: its positions are, modulo periodic images, the origin of displacements; the energy is zero
        there.  That forces balance in it is not required here, but it is for every linear answer (`magphonon.stiffness.rest`).
    potential : PairLaw, or mapping from pairs of kinds to PairLaw
        Pair law in mm, mJ; `magphonon.interactions.PairLaw` says how to write your own.  Where particles are of different
        kinds, a law for each pair of kinds that repel each other, `{(0, 0): one, (0, 1): another}`, in either order.  The kind
        of a particle is its tag in `reference`, `atoms.get_tags()`; magphonon's patches number their rows from the rim there,
        `atoms.set_tags` makes kinds of them.
    foundation : float or array_like, shape (particles,), (1, dim) or (particles, dim)
        Stiffness of the spring between each particle and its anchor, N/mm: one number, one for each particle, for each
        direction, or for both.
    strengths : array_like, shape (particles,), optional
        Strength s of each particle, by default 1: two of them repel by the law `s_i s_j phi(r)`, as magnets of these
        moments, relative to those that the law was measured with, do.
    anchors : array_like, shape (particles, 3), optional
        Where the foundation springs are slack, in mm; the positions of the reference if not given.
    load : array_like, shape (particles, 3), optional
        Dead load: a constant force on each particle in N, such as the weight or the push that holds an oscillator against
        its magnets.  What acts on a held particle has no effect.
    model : {'complete', 'conventional', 'literal'}
    shells : int
        Number of neighbour shells that interact.
    cutoff : float, optional
        Instead of `shells`: the distance in mm within which particles interact.
    bonds : Bonds or sequence of (i, j) or (i, j, shift), optional
        Instead of either: the interacting pairs.  Their vectors are taken at the reference.

    Warns
    -----
    UserWarning
        If law, foundation and masses give frequencies of less than 1e-4 or more than 1e13 Hz: most likely numbers in SI
        without their units.

    Raises
    ------
    ValueError
        For a reference that is not planar, coincident particles, a mass or parameter that is not positive, a cutoff
        on a shell of neighbours, an unknown model; for Bonds that belong to other positions; for bonded particles whose
        kinds have no law.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> cell = lattices.square(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=5.0)
    >>> float(abs(cell.get_forces()).max())  # in balance by symmetry
    0.0
    >>> cell.calc.get_hessian(cell).shape
    (3, 3)
    """

    implemented_properties: ClassVar[list[str]] = ['energy', 'free_energy', 'energies', 'forces', 'stress', 'hessian']
    default_parameters: ClassVar = {'foundation': 0.0, 'model': 'complete'}
    saved: ClassVar[tuple[str, ...]] = ('foundation', 'strengths', 'model', 'bonds', 'anchors', 'load')
    pairwise = True
    atoms: Any  # of ASE, which declares them as None
    parameters: Any
    bloch_models = MODELS

    def __init__(self, reference: Atoms, potential: Potential, *, foundation: Foundation | ArrayLike = 0.0,
                 strengths: ArrayLike | None = None, model: str = 'complete', shells: int = 1, cutoff: float | None = None,
                 bonds: Bonds | Sequence[Any] | None = None, anchors: ArrayLike | None = None,
                 load: ArrayLike | None = None) -> None:
        self._potential = checked_potential(potential)
        masses_of(reference)
        self.reference = reference.copy()
        self.reference.calc = None
        self._strengths = site_strengths(np.ones(len(reference)) if strengths is None else strengths, len(reference))
        self.dim = displacement_components(reference, foundation)
        first = not isinstance(bonds, Bonds)  # what is made of another calculator hands on its bonds
        reach = f'shells={shells}' if cutoff is None else f'cutoff={cutoff:g}'
        self._reach = reach if bonds is None else f'bonds={len(bonds)}'
        if bonds is None:
            bonds = find_bonds(self.reference, shells, cutoff)
        elif not isinstance(bonds, Bonds):
            bonds = explicit_bonds(self.reference, bonds)
        if bonds.particles != len(reference):
            raise ValueError(f'the bonds join {bonds.particles} particles, but the reference has {len(reference)}; '
                             'find them in this structure, or use repeat_bonds')
        if not len(bonds):
            raise ValueError(f'no two of the {len(reference)} particles are bonded, so nothing repels; keep at least one pair of '
                             'neighbours')
        bonds = bonds.fitted(self.reference)
        height = max(np.ptp(reference.positions[:, 2]), abs(bonds.vectors[:, 2]).max())
        if self.dim == 2 and height > 1e-9 * bonds.lengths.min():
            raise ValueError(f'planar particles must share one z, but z ranges over {height:g} mm, periodic images included; '
                             'a structure in space is periodic along three vectors')
        self.bonds = bonds
        shape = (len(reference), 3)
        self._anchors = self.reference.get_positions() if anchors is None else finite('anchors', anchors, shape).copy()
        self._load = np.zeros(shape) if load is None else finite('load', load, shape).copy()
        for fixed in self._anchors, self._load, self.reference.positions:  # forces are made of them once
            fixed.flags.writeable = False
        if self.dim == 2 and self.load[:, 2].any():
            raise ValueError(f'the load pushes particle {np.flatnonzero(self.load[:, 2])[0]} along z, but the structure is '
                             'planar; give it a direction in the plane')
        law = law_along(self._potential, bonds.i, bonds.j, self.reference.get_tags(), self._strengths)
        self._law = law.planar if isinstance(law, UprightMagnets) and self.dim == 2 else law
        if isinstance(self._law, UprightMagnets) and not height <= 1e-9 * bonds.lengths.min():
            raise ValueError(f'upright magnets stand on a plane, but z ranges over {height:g} mm; give them one z')
        refuse_infinite(self._law, bonds)
        super().__init__(foundation=foundation, model=model)
        if first:
            warn_of_units(self)

    @property
    def potential(self) -> Potential:
        """The pair law, or those of pairs of kinds, as given; others belong to another calculator."""
        return self._potential

    @property
    def law(self) -> PairLaw:
        """The pair laws laid along the bonds, for distances whose first axis is that of the bonds.

        `magphonon.interactions.BondLaws`; the one law itself where all bonds have the same and all strengths are 1.
        """
        return self._law

    @property
    def strengths(self) -> NDArray[np.float64]:
        """Strength of each particle, shape (particles,); read-only, as those of another calculator."""
        return self._strengths

    @property
    def anchors(self) -> NDArray[np.float64]:
        """Positions at which the foundation springs are slack in mm, shape (particles, 3); read-only."""
        return self._anchors

    @property
    def load(self) -> NDArray[np.float64]:
        """Dead load in N, shape (particles, 3); read-only: `about(atoms, load)` makes a calculator with another one."""
        return self._load

    @property
    def foundation(self) -> Foundation:
        """Stiffness of the spring between each particle and its anchor, N/mm: one number, or shape (particles, dim)."""
        return self.parameters.foundation

    @property
    def model(self) -> str:
        """Model of the forces: 'complete', 'conventional' or 'literal'."""
        return self.parameters.model

    @property
    def linear_model(self) -> str:
        """Model of the stiffness at rest: there the literal forces change as the conventional ones."""
        return 'complete' if self.model == 'complete' else 'conventional'

    @property
    def layer(self) -> bool:
        """Whether particles of a plane may move out of it, each on a support of its own."""
        return self.dim == 3 and not self.reference.pbc.all()

    @property
    def bond_vectors(self) -> NDArray[np.float64]:
        """Vectors of the bonds at rest in mm, shape (bonds, dim)."""
        return self.bonds.vectors[:, : self.dim]

    def set(self, **parameters: Any) -> dict[str, Any]:
        """Change `foundation` or `model`; whatever was computed before is forgotten.

        Raises
        ------
        ValueError
            For an unknown name or an impossible value.
        """
        for name in parameters:
            one_of('parameter', name, tuple(self.default_parameters))
        if 'foundation' in parameters:
            parameters['foundation'] = site_springs(parameters['foundation'], len(self.reference), self.dim, self.layer)
        if 'model' in parameters:
            one_of('model', parameters['model'], CALCULATOR_MODELS)
        changed = super().set(**parameters)
        self.reset()
        return changed

    def on(self, supercell: Atoms) -> MagneticRepulsion:
        """The same calculator on a supercell of its reference, whatever the order of the particles there."""
        bonds = repeat_bonds(self.bonds, self.reference, supercell)
        image = image_of(self.reference, supercell)
        reference = supercell.copy()
        reference.set_tags(self.reference.get_tags()[image])  # a kind is a tag, and phonopy knows no tags
        return MagneticRepulsion(reference, self.potential, bonds=bonds, load=self.load[image], model=self.model,
                                 foundation=of_sites(self.foundation, image), strengths=self.strengths[image],
                                 anchors=supercell.positions - self.slack[image])

    def about(self, atoms: Atoms, load: ArrayLike | None = None, **parameters: Any) -> MagneticRepulsion:
        """The same calculator with the present positions of `atoms` as its rest; `load` and `parameters` may change, too.

        The pairs of particles stay, their vectors are taken anew; anchors and load stay.  Nothing is required of the forces
        at the new rest: `magphonon.stiffness.rest.at_rest` looks whether they balance.  The cell may be another one where
        nothing is anchored (`magphonon.stiffness.cells`).
        """
        if not same_cell(self, atoms):
            rest, bonds = carried(self, atoms)
            carrier = MagneticRepulsion(rest, self.potential, bonds=bonds, strengths=self.strengths, **self.parameters)
            return carrier.about(atoms, load, **parameters)
        rest = self.reference.copy()
        rest.positions[:, : self.dim] += self.displacements(atoms)
        return MagneticRepulsion(rest, self.potential, bonds=self.bonds.at(rest), anchors=self.anchors, strengths=self.strengths,
                                 load=self.load if load is None else load, **self.parameters | parameters)

    def in_plane(self) -> MagneticRepulsion:
        """The same calculator of a layer without motion out of its plane."""
        return MagneticRepulsion(self.reference, self.potential, bonds=self.bonds, anchors=self.anchors, load=self.load,
                                 strengths=self.strengths, model=self.model, foundation=np.asarray(self.foundation)[:, :2])

    def balanced(self, particles: NDArray[Any] | Sequence[int]) -> MagneticRepulsion:
        """The same calculator with the dead load that balances all other forces on some particles at rest."""
        load = self.load.copy()
        rest = np.zeros((len(load), self.dim))
        load[particles, : self.dim] -= self._forces(rest, self._repulsion(rest)[1])[particles]
        return self.about(self.reference, load)

    def __repr__(self) -> str:
        own = f', strengths={range_of(self.strengths)}' if (self.strengths != 1).any() else ''
        return (f'{type(self).__name__}({self.potential!r}, {self._reach}, foundation={range_of(self.foundation)}{own}, '
                f'model={self.model!r}) of {len(self.reference)} particles')

    def get_property(self, name: str, atoms: Atoms | None = None, allow_calculation: bool = True) -> Any:
        if name == 'hessian':  # it takes long and is no part of a trajectory, so it is never cached
            return self.get_hessian(atoms if atoms is not None else self.atoms) if allow_calculation else None
        if self.model == 'literal' and name in ('energy', 'free_energy', 'energies'):
            raise PropertyNotImplementedError(NO_ENERGY)
        if name == 'stress' and (np.any(self.foundation) or self.load.any() or self.model != 'complete'):
            raise PropertyNotImplementedError(NO_STRESS)
        return super().get_property(name, atoms, allow_calculation)

    def calculate(self, atoms: Atoms | None = None, properties: Any = ('energy',), system_changes: Any = all_changes) -> None:
        super().calculate(atoms, properties, system_changes)
        here = self if same_cell(self, self.atoms) else self.about(self.atoms)
        u = here.displacements(self.atoms)
        if self.dim == 2:
            refuse_motion_out_of_the_plane(here, self.atoms)
        energy, gradient = here._repulsion(u)
        self.results = {'forces': np.zeros((len(u), 3))}
        self.results['forces'][:, : self.dim] = here._forces(u, gradient)
        if self.model != 'literal':
            energies = here._energies(u, energy - self._rest[3])
            self.results.update(energies=energies, energy=energies.sum(), free_energy=energies.sum())
        if 'stress' in properties:
            self.results['stress'] = stress_per_volume(self, self.atoms)

    def displacements(self, atoms: Atoms) -> NDArray[np.float64]:
        """Displacements from rest in mm, shape (particles, dim), by minimum image in the periodic directions.

        Raises
        ------
        ValueError
            If the atoms differ from the reference in number, cell or periodicity, or a position is not finite.
        """
        return self._minimum_image(from_reference(self, atoms))[:, : self.dim]

    def _minimum_image(self, u):
        return minimum_image(u, self.reference, self._shortest_period)

    @cached_property
    def _shortest_period(self):
        return shortest_period(self.reference)

    @cached_property
    def _rest(self):
        """Bond vectors R, lengths r0 and directions n at rest, and phi(r0)."""
        R = self.bond_vectors
        r0 = np.linalg.norm(R, axis=1)
        return R, r0, R / r0[:, None], self.law.phi(r0)

    @cached_property
    def slack(self) -> NDArray[np.float64]:
        """How far the foundation springs are stretched at rest: from the anchors to rest in mm, shape (particles, 3)."""
        return self._minimum_image(self.reference.positions - self.anchors)

    @property
    def spring_forces(self) -> NDArray[np.float64]:
        """Forces of the foundation at rest, `-k (rest - anchor)`, in N, shape (particles, dim)."""
        return -self.foundation * self.slack[:, : self.dim]

    @property
    def offset(self) -> NDArray[np.float64]:
        """Constant force `load - k (rest - anchor)` on each particle in N, shape (particles, dim)."""
        return self.load[:, : self.dim] + self.spring_forces

    def _geometry(self, u):
        """Bond lengths that enter the law, and the directions along which the force acts."""
        R, r0, n, _ = self._rest
        du = self.bonds.incidence @ u
        if self.model == 'conventional':
            return self._separated(r0 + np.einsum('bx,bx->b', n, du)), n
        bond = R + du
        length = self._separated(np.sqrt(np.einsum('bx,bx->b', bond, bond)))
        return length, bond / length[:, None] if self.model == 'complete' else n

    def _separated(self, length):
        if length.size and not length.min() > 0:
            b = length.argmin()
            raise ValueError(f'particles {self.bonds.i[b]} and {self.bonds.j[b]} coincide or have passed through each other '
                             f'(distance {length[b]:g} mm along their bond); start from smaller displacements')
        return length

    def _repulsion(self, u):
        """Energy of each bond in mJ and its gradient by the bond vector in N, shapes (bonds,) and (bonds, dim)."""
        law = self.law
        if leaves_the_plane(law, self.bond_vectors) and self.model == 'complete':
            return upright_forces(self.bond_vectors + self.bonds.incidence @ u, law)
        length, n = self._geometry(u)
        return law.phi(length), law.dphi(length)[:, None] * n

    def _forces(self, u, gradient):
        return self.offset - self.bonds.incidence.T @ gradient - self.foundation * u

    def _energies(self, u, shared):
        """Energy of each particle, with half of what each of its bonds has gained since rest."""
        bonds = 0.5 * (np.bincount(self.bonds.i, shared, len(u)) + np.bincount(self.bonds.j, shared, len(u)))
        return bonds + np.einsum('ix,ix->i', 0.5 * self.foundation * u - self.offset, u)

    def rest_stiffness(self, model: str = 'complete') -> NDArray[np.float64]:
        """Stiffness of each bond at rest, shape (bonds, dim, dim), in N/mm."""
        return model_stiffness(self.bond_vectors, self.law, model)

    def rest_hessian(self, model: str = 'complete') -> sparse.csr_array:
        """Hessian at rest, with the foundation, in N/mm: sparse, shape (particles * dim, particles * dim)."""
        return hessian(self.bonds, self.rest_stiffness(model), self.foundation)

    def bloch_matrix(self, q: NDArray[np.float64], model: str = 'complete') -> NDArray[np.complex128]:
        """Bloch matrix at rest, with the foundation, in N/mm; see `stiffness.bloch_matrix`."""
        return bloch_matrix(self.bonds, self.rest_stiffness(model), q, self.foundation)

    def bloch_series(self, along: NDArray[np.float64],
                     model: str = 'complete') -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.complex128]]:
        """The same without foundation to second order in the wavevector k `along`; see `stiffness.bloch_series`."""
        R = (self.bonds.shift @ self.reference.cell.array)[:, : self.dim]
        return bloch_series(self.bonds, self.rest_stiffness(model), R @ along)

    def singular(self, along: NDArray[np.float64], model: str = 'complete') -> NDArray[np.float64]:
        """Zero, shape (dim, dim): with a finite number of neighbours nothing outgrows the second order in long waves."""
        return np.zeros((self.dim, self.dim))

    def get_hessian(self, atoms: Atoms, part: str = 'all') -> sparse.csr_array:
        """Second derivatives of the energy at the present positions, or one part of them.

        Parameters
        ----------
        atoms : ase.Atoms
        part : {'all', 'D0', 'Dstar', 'foundation'}
            'all' is their sum in the complete model; the conventional model has no 'Dstar'.

        Returns
        -------
        scipy.sparse.csr_array, shape (3 * particles, 3 * particles)
            In N/mm; ASE's order of components.  Rows along z are empty for planar particles.
        """
        one_of('part', part, HESSIAN_PARTS)
        if self.model == 'literal':
            raise PropertyNotImplementedError(NO_ENERGY)
        length, n = self._geometry(self.displacements(atoms))
        D0, Dstar = bond_stiffness(length[:, None] * n, self.law)
        if self.model == 'conventional':
            Dstar = np.zeros_like(Dstar)
        K = {'D0': D0, 'Dstar': Dstar, 'foundation': 0 * D0, 'all': D0 + Dstar}[part]
        k = self.foundation if part in ('all', 'foundation') else 0.0
        H = hessian(self.bonds, K, k)
        to_space = sparse.kron(sparse.eye_array(len(atoms)), sparse.eye_array(3, self.dim), format='csr')
        return sparse.csr_array(to_space @ H @ to_space.T)
