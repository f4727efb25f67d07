"""Other fields: ions, electrons, gyroscopes, tensegrity, strings, foams and argon; closed forms and numbers of public codes.

Most references are closed forms of the theory of a field, written out here from knowledge of it, not read in its publications.
Those of others say so: frequencies that TsgFEM saved, numbers in the tests of IonSim.jl, the Hessian of matscipy, vibrations by
ASE.

Not found in full text, and therefore not among the rows: the tables of Wang et al. 2018 (one-way gap), Chong et al. 2021, Lee et
al. 2025 (magnets on cantilevers) and Watkins et al. 2020 (demultiplexer), the Chern numbers of the spindle lattice of Mitchell et
al. 2018, and the numbers of the two magnetic companions of Bonsall and Maradudin.
"""

import tempfile
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from ase import Atoms, __version__ as ase_version
from ase.build import bulk
from ase.calculators.lj import LennardJones as LennardJonesOfASE
from ase.cluster import Icosahedron
from ase.constraints import FixAtoms
from ase.vibrations import Vibrations
from scipy.optimize import brentq
from scipy.special import zeta

from magphonon import InversePower, analytic_bands, critical_foundation, lattices, modes, relaxed
from magphonon.bands import chern_numbers, sound_speeds
from magphonon.interactions import Spring
from magphonon.plotting.axes import COLOURS, legend_of_set, new_axes
from magphonon.scenes.scene import reference
from magphonon.stiffness import AllNeighbours, PairCalculator, net, self_stress
from magphonon.stiffness.matrices import lossless_modes

from .rows import Check, Outcome, save_picture
from .tensegrity import STRUCTURES

CHARGES = InversePower(1.0, 2.0)
IONS, ZIGZAG, ELECTRONS, PENNING = 'ions in a trap', 'zigzag of ions', 'electrons on helium', 'ions in a Penning trap'
GYROSCOPES, TENSIONS, STRINGS = 'gyroscopes', 'chain of tensions', 'strings and membranes'
PRISMS, TENSEGRITIES, NETS, FOAM, ARGON = 'tensegrity prisms', 'tensegrities', 'taut honeycomb', 'dry foam', 'argon'
MIXED, MIXTURE, STRESSED = 'ions of two masses', 'mixture of two sizes', 'stressed lattice'
IONSIM = 'open code or data: tests of IonSim.jl (05ff3a84)'
PRINTED_IONS = 'printed: Phys. Rev. A 103, 012610, as quoted in the tests of IonSim.jl (6d182298)'
MATSCIPY = 'open code or data: Hessian of matscipy 1.3.1'
TSGFEM = 'open code or data: results saved by TsgFEM (f26da6a)'
VIBRATIONS = f'open code or data: Vibrations of ASE {ase_version}, run here'
MASS = 1.0
ZERO = 1e-6  # of the highest squared frequency: below it a mode is a mechanism or a motion of the whole body


@dataclass(frozen=True)
class Row:
    """A number of a field, its reference, and the number of D0 alone: None where that is not finite, or the same."""

    field: str
    what: str
    here: float
    reference: float
    alone: float | None
    tolerance: float = 1e-9
    by: str = 'closed form'

    @property
    def checks(self):
        """The row and, as its control, the number of D0 alone."""
        row = Check(f'{self.field}: {self.what}', float(self.here), float(self.reference), self.tolerance, by=self.by)
        return [row] if self.alone is None else [row, row.against(self.alone)]


def main(out):
    """Numbers of each field, and a picture of the numbers that D0 alone gives."""
    fields = (_ion_chains, _ions_of_two_masses, _zigzag, _electrons, _penning, _gyroscopes, _tensions, _strings, _prisms,
              _tensegrities, _honeycombs, _stressed_lattice, _argon_cluster, _mixture)
    rows = [row for field in fields for row in field()]
    return Outcome([check for row in rows for check in row.checks], [_draw(out, rows)])


def ions(places, springs, gyration=0.0, masses=None):
    """Charges at rest in a trap, which is one anchor for all of them; their masses are one by default."""
    atoms = Atoms(f'H{len(places)}', places, masses=np.ones(len(places)) if masses is None else masses)
    atoms.calc = PairCalculator(atoms, CHARGES, bonds=list(combinations(range(len(places)), 2)), foundation=[springs],
                                anchors=np.zeros((len(places), 3)), gyration=gyration, dim=3)
    return relaxed(atoms).atoms


def conventional(atoms):
    """The structure with the stiffness D0 alone."""
    blind = atoms.copy()
    blind.calc = atoms.calc.about(atoms, model='conventional')
    return blind


def without_static_forces(atoms):
    """Squared frequencies of D0 and the supports together, ascending."""
    return np.linalg.eigvalsh(atoms.calc.rest_hessian('conventional').toarray() / MASS)


def _ion_chains():
    k = 20.0
    crystals = {n: ions(np.linspace(-n / 2, n / 2, n)[:, None] * [0, 0, 1.0], [k, k, 1.0]) for n in (2, 3, 4)}
    long = ions(np.linspace(-3, 3, 10)[:, None] * [0, 0, 1.0], [200.0, 200.0, 1.0])
    found = {n: modes(crystal) for n, crystal in crystals.items()}
    w2, alone = {n: one.omega**2 for n, one in found.items()}, without_static_forces(crystals[3])
    z = {n: np.sort(crystal.positions[:, 2]) for n, crystal in crystals.items()}
    yield Row(IONS, 'two ions, place (1/4)^(1/3)', z[2][1], 0.25 ** (1 / 3), None)
    yield Row(IONS, 'two ions, stretch, omega^2 = 3', w2[2][1], 3, None)
    yield Row(IONS, 'three ions, place (5/4)^(1/3)', z[3][2], 1.25 ** (1 / 3), None)
    yield Row(IONS, 'three ions, third axial mode, omega^2 = 29/5', w2[3][2], 29 / 5, None)
    yield Row(IONS, 'four ions, fourth axial mode, omega^2', w2[4][3], 9.308, None, 1e-4, IONSIM)
    shape = abs(found[4].shapes[3][crystals[4].positions[:, 2].argsort(), 2])
    for n, printed in enumerate((0.2132, 0.6742)):
        share = shape[n] / np.linalg.norm(shape)
        yield Row(IONS, f'four ions, fourth axial mode, motion of ion {n + 1}', share, printed, None, 3e-4, IONSIM)
    yield Row(IONS, 'four ions, ratio of their places', z[4][3] / z[4][2], 0.06392393573 / 0.0202155287427, None, 1e-8, IONSIM)
    known = 0.2821, 0.85378, 1.4504, 2.10003, 2.8708
    for place, printed in zip(np.sort(long.positions[:, 2])[5:], known, strict=True):
        yield Row(IONS, f'ten ions, place {printed}', place, printed, None, 2e-4, IONSIM)
    for axial, n in ((1, 8), (3, 6), (29 / 5, 4)):
        exact, blind = k + (1 - axial) / 2, alone[n] if axial > 1 else None
        yield Row(IONS, f'three ions, across the axis, k + (1 - {axial:g})/2', w2[3][n], exact, blind, 1e-6)


def _ions_of_two_masses():
    """Two ions in one static trap, by hand: `K = [[2, -1], [-1, 2]]` along it, k - 1/2 and 1/2 across; a printed chain."""
    k = 20.0
    for mu in (0.25, 3.0):
        pair = ions(np.array([[0, 0, -1.0], [0, 0, 1.0]]), [k, k, 1.0], masses=[1.0, mu])
        w2, blind, sum_ = modes(pair).omega ** 2, modes(conventional(pair)).omega ** 2, 1 + 1 / mu
        for n, sign in enumerate((-1, 1)):
            name = f'masses 1 and {mu:g}, {("lower", "upper")[n]} mode'
            yield Row(MIXED, f'{name} along the axis, omega^2', w2[n], sum_ + sign * np.sqrt(sum_**2 - 3 / mu), None)
            across = ((k - 0.5) * sum_ + sign * np.sqrt((k - 0.5) ** 2 * sum_**2 - 4 * k * (k - 1) / mu)) / 2
            yield Row(MIXED, f'{name} across it, omega^2', w2[2 + 2 * n], across, blind[2 + 2 * n])
    ytterbium, barium = 170.936 * 1.66054e-27, 2.28997e-25  # kg; four and one of them
    five = ions(np.linspace(-2.5, 2.5, 5)[:, None] * [0, 0, 1.0], [30.0, 30.0, 1.0], masses=[1, 1, 1, 1, barium / ytterbium])
    omega = modes(five).omega[:5]
    for n, megahertz in enumerate((0.280, 0.388, 0.480, 0.570), 2):  # of 0.158 for the lowest; last digits are rounded
        yield Row(MIXED, f'five ions, axial mode {n} (MHz)', 0.158 * omega[n - 1] / omega[0], megahertz, None, 5e-3, PRINTED_IONS)


def _zigzag():
    chain, k = lattices.chain(1.0, MASS), 10.0
    chain.calc = AllNeighbours(chain, CHARGES, foundation=k)
    q = [[0.5, 0, 0], [0.25, 0, 0]]
    (across, along), (across4, along4) = analytic_bands(chain, q).omega ** 2
    blind, blind4 = analytic_bands(chain, q, 'conventional').omega[:, 0] ** 2
    yield Row(ZIGZAG, 'threshold, 7 zeta(3)/2', critical_foundation(chain).k, 3.5 * zeta(3),
              critical_foundation(chain, 'conventional').k)
    yield Row(ZIGZAG, 'transverse omega^2 at pi, k - 7 zeta(3)/2', across, k - 3.5 * zeta(3), blind)
    yield Row(ZIGZAG, 'longitudinal omega^2 at pi, k + 7 zeta(3)', along, k + 7 * zeta(3), None)
    yield Row(ZIGZAG, 'transverse omega^2 at pi/2, k - 35 zeta(3)/16', across4, k - 35 / 16 * zeta(3), blind4)
    yield Row(ZIGZAG, 'longitudinal omega^2 at pi/2, k + 35 zeta(3)/8', along4, k + 35 / 8 * zeta(3), None)
    crystal = ions(np.array([[0, 0, -1.0], [0, 0, 0], [0, 0, 1.0]]), [3.3, 3.7, 1.0])
    yield Row(ZIGZAG, 'three ions, k = 3.3: omega^2 of the zigzag mode, k - 12/5', modes(crystal).omega[0] ** 2, 0.9,
              without_static_forces(crystal)[0])


def _electrons():
    known, cell, n, k = reference()['all_neighbours'], lattices.triangular(1.0, MASS), 2 / np.sqrt(3), 1e-3
    cell.calc = AllNeighbours(cell, CHARGES)
    q, rate = [[k / (2 * np.pi), k / (4 * np.pi), 0]], 10.0
    plasmon, shear = 2 * np.pi * n * k, known['wigner_shear'] * np.sqrt(n) * k**2
    slow, fast = lossless_modes(MASS * rate * np.array([[0, -1], [1, 0]]), cell.calc.bloch_matrix(np.array(q))[0])[0]
    yield Row(ELECTRONS, 'in a magnetic field: magnetophonon, omega_L omega_T/omega_c', slow, np.sqrt(plasmon * shear) / rate,
              None, 1e-3)
    yield Row(ELECTRONS, 'in a magnetic field: magnetoplasmon^2 - omega_c^2, omega_L^2', fast**2 - rate**2, plasmon, None, 2e-3)


def _penning():
    """Seven ions: one in the middle, six on a ring whose radius and modes follow by hand."""
    k, kz, g, angles = 1.0, 30.0, 5.0, np.pi / 3 * np.arange(6)
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    crystal = ions(np.vstack([[0, 0, 0], 1.7 * ring]), [k, k, kz], gyration=g)
    chords = 2 * np.sin(angles[1:] / 2)
    R = ((1 + (1 / (2 * chords)).sum()) / k) ** (1 / 3)
    yield Row(PENNING, 'radius of the ring of seven ions', np.linalg.norm(crystal.positions[1:], axis=1).mean(), R, None)
    omega = modes(crystal).omega
    blind = modes(conventional(crystal)).omega
    of_all = np.sqrt(g**2 + 4 * k)  # in a mode of all ions together the trap alone acts
    for what, exact, same in (('cyclotron mode of the centre, (sqrt(g^2 + 4 k) + g)/2', (of_all + g) / 2, True),
                              ('magnetron mode of the centre, (sqrt(g^2 + 4 k) - g)/2', (of_all - g) / 2, True),
                              ('breathing mode, sqrt(3 k + g^2)', np.sqrt(3 * k + g**2), False),
                              ('drumhead mode of the centre, sqrt(kz)', np.sqrt(kz), True),
                              ('drumhead tilt, sqrt(kz - k)', np.sqrt(kz - k), False)):
        yield Row(PENNING, what, _nearest(omega, exact), exact, None if same else _nearest(blind, exact))
    for m in (2, 3):  # waves around the ring, in which the middle rests
        softening = (1 + ((1 - np.cos(m * angles[1:])) / chords**3).sum()) / R**3
        exact = np.sqrt(kz - softening)
        yield Row(PENNING, f'drumhead mode with {m} waves on the ring', _nearest(omega, exact), exact,
                  _nearest(blind, exact))


def _nearest(values, exact):
    return values[abs(values - exact).argmin()]


def _gyroscopes():
    """Gyroscopes so fast that inertia is negligible: i psi' = (k0 + bonds) psi/(m g), in units of the bond's rate."""
    g, k0, bond, cell = 3e3, 2.0, 1.0, lattices.honeycomb(1.0, MASS)
    G, K = [[0, 0, 0]], [[1 / 3, -1 / 3, 0]]
    for tension in (0.0, 0.4):
        cell.calc = PairCalculator(cell, Spring(bond, 1.0 - tension), foundation=k0, gyration=g)
        # of the four branches the two lowest are gyrations
        at_G, at_K = (analytic_bands(cell, q).omega[0, :2] * g for q in (G, K))
        blind_G, blind_K = (analytic_bands(cell, q, 'conventional').omega[0, :2] * g for q in (G, K))
        mean, half = 1.5 * (bond + tension), 1.5 * (bond - tension)
        name = f'tension {tension:g} k, '
        alone = (blind_G[1], *blind_K) if tension else (None, None, None)
        exact = k0 + 2 * mean, np.sqrt((k0 + mean) ** 2 - half**2), k0 + mean
        yield Row(GYROSCOPES, name + 'lowest rate at Gamma, k0', at_G[0], k0, None, 1e-5)
        yield Row(GYROSCOPES, name + 'upper rate at Gamma, k0 + 3 (k + T/L)', at_G[1], exact[0], alone[0], 1e-5)
        yield Row(GYROSCOPES, name + 'lower rate at K', at_K[0], exact[1], alone[1], 1e-5)
        yield Row(GYROSCOPES, name + 'upper rate at K, k0 + 3 (k + T/L)/2', at_K[1], exact[2], alone[2], 1e-5)
    cell.calc = PairCalculator(cell, Spring(bond, 1.0), foundation=6.0, gyration=30.0)
    yield Row(GYROSCOPES, 'one-way edges of the honeycomb: |Chern number| of the lower band', abs(chern_numbers(cell)[0]), 1,
              None, 0)


@dataclass(frozen=True)
class Tensions:
    """Constant forces in N, as of films, between neighbours at the distances 1, 2, ... mm; they have no stiffness D0."""

    T: tuple

    def phi(self, r):
        return self.dphi(r) * r

    def dphi(self, r):
        return np.array(self.T)[np.round(np.real(r)).astype(int) - 1] + 0 * r

    def d2phi(self, r):
        return 0 * r


def _tensions():
    """A chain that moves across itself and whose frequency is zero at a chosen q0: omega^2 = (1 - cos q) (cos q - cos q0)^2."""
    chain = lattices.chain(1.0, MASS)
    for share in (1 / 2, 1 / 3):
        q0 = 2 * np.pi * share
        x0 = np.cos(q0)
        # (1 - x)(x - x0)^2 = sum over n of k_n 2 (1 - cos n q), x = cos q
        k3, k2 = 1 / 8, -(1 + 2 * x0) / 4
        k1 = (x0**2 + 2 * x0 + 3 / 4) / 2
        chain.calc = PairCalculator(chain, Tensions((k1, 2 * k2, 3 * k3)), shells=3)
        q = np.array([[0.2, 0, 0], [0.35, 0, 0], [share, 0, 0]])
        across, blind = (analytic_bands(chain, q, model).omega[:, 1] ** 2 for model in ('complete', 'conventional'))
        exact = (1 - np.cos(2 * np.pi * q[:, 0])) * (np.cos(2 * np.pi * q[:, 0]) - x0) ** 2
        for k in (0, 1):
            yield Row(TENSIONS, f'zero at q0 = {360 * share:.0f} deg: omega^2 at {q[k, 0]:g}', across[k], exact[k], blind[k])
        yield Row(TENSIONS, f'zero at q0 = {360 * share:.0f} deg: omega^2 there', across[2], 0, None, 1e-14)


def _strings():
    n, T, k = 5, 0.3, 4.0
    beads = Atoms(f'H{n + 2}', np.arange(n + 2)[:, None] * [1.0, 0, 0], masses=np.ones(n + 2),
                  constraint=FixAtoms([0, n + 1]))
    beads = net(beads, [(i, i + 1, Spring(k, 1 - T / k)) for i in range(n + 1)])
    omega, blind = np.sort(modes(beads).omega), np.sort(modes(conventional(beads)).omega)
    for j in (1, 2, 3):
        yield Row(STRINGS, f'string of {n} beads, tone {j}, 2 sqrt(T/(m L)) sin(j pi/(2 n + 2))', omega[j - 1],
                  2 * np.sqrt(T) * np.sin(j * np.pi / (2 * n + 2)), blind[j - 1])
    cell = lattices.square(1.0, MASS)
    cell.calc = PairCalculator(cell, Spring(k, 1 - T / k), dim=3)
    for name, q in (('M', 0.5), ('half way to M', 0.25)):
        lowest, alone = (analytic_bands(cell, [[q, q, 0]], model).omega[0, 0] ** 2 for model in ('complete', 'conventional'))
        yield Row(STRINGS, f'square net as a membrane, omega^2 at {name}, 8 T/(m L) sin^2', lowest,
                  8 * T * np.sin(np.pi * q) ** 2, alone)


def prism(n, height=1.0):
    """Nodes and members of the tensegrity prism of n struts: two rings of cables, n cables up, n struts."""
    turns = 2 * np.pi * np.arange(n) / n
    low, high = (np.stack([np.cos(turns + by), np.sin(turns + by), 0 * turns + z], axis=1)
                 for by, z in ((0, 0.0), (np.pi / 2 - np.pi / n, height)))
    after = (np.arange(n) + 1) % n
    pairs = [*zip(range(n), after, strict=True), *zip(range(n, 2 * n), n + after, strict=True),
             *((i, n + i) for i in range(n)), *zip(range(n), n + after, strict=True)]
    return Atoms(f'H{2 * n}', np.vstack([low, high]), masses=np.ones(2 * n)), [(int(i), int(j)) for i, j in pairs]


def taut_prism(n, k=10.0, tension=0.5):
    """The prism with the self-stress that its geometry allows."""
    nodes, pairs = prism(n)
    bare = net(nodes, [(*pair, Spring(k, 0.0)) for pair in pairs])
    state = self_stress(bare)
    t = tension * state[0] / state[0][0]
    rest = bare.calc.bonds.lengths - t / k
    return net(nodes, [(*pair, Spring(k, length)) for pair, length in zip(pairs, rest.tolist(), strict=True)]), state


def _prisms():
    for n in (3, 4, 5, 6):
        atoms, state = taut_prism(n)
        q = state[0] / atoms.calc.bonds.lengths
        yield Row(PRISMS, f'{n} struts: tension over length, cables up over rings, 2 sin(pi/n)', q[2 * n] / q[0],
                  2 * np.sin(np.pi / n), None)
        yield Row(PRISMS, f'{n} struts: states of self-stress', len(state), 1, None, 0)
        complete, alone = modes(atoms).omega ** 2, without_static_forces(atoms)
        zeros, blind = ((abs(w2) < ZERO * w2.max()).sum() for w2 in (complete, alone))
        yield Row(PRISMS, f'{n} struts: modes without stiffness by D0, 6 + (3 j - 6) - b + s', blind, 2 * n + 1, None, 0)
        yield Row(PRISMS, f'{n} struts: modes without stiffness once prestressed, the six rigid motions', zeros, 6, blind, 0)


def _honeycombs():
    """Speeds of sound of a honeycomb with bond stiffness k along and t across, when the forces on both sublattices balance."""
    cell, k = lattices.honeycomb(1.0, MASS), 1.0
    for stretch in (0.05, 0.2):
        t = k * stretch
        cell.calc = PairCalculator(cell, Spring(k, 1.0 - stretch))
        found, blind = sound_speeds(cell), sound_speeds(cell, model='conventional')
        inner = 3 / 8 * (k - t) ** 2 / (k + t)
        slow, fast = (np.sqrt((1.5 * t + 3 / 8 * c * (k - t) - inner) / 2) for c in (1, 3))
        yield Row(NETS, f'stretched by {stretch:g}: shear wave', found[0], slow, blind[0])
        yield Row(NETS, f'stretched by {stretch:g}: longitudinal wave', found[1], fast, blind[1])
    cell.calc = PairCalculator(cell, Tensions((2.0,)))
    density = 2 * MASS / (1.5 * np.sqrt(3))
    found, blind = (density * sound_speeds(cell, model=model)[1] ** 2 for model in ('complete', 'conventional'))
    yield Row(FOAM, 'dry foam, shear modulus sigma/(sqrt(3) a)', found, 1 / np.sqrt(3), blind)


def _stressed_lattice():
    """Biot: shear along x and along y is equally fast without stress, otherwise `density (c_xy^2 - c_yx^2) = s_xx - s_yy`."""
    cell, law = lattices.triangular(1.0, MASS), InversePower(1.0, 4.0)
    cell.set_cell(cell.cell.array * [1.1, 0.8, 1.0], scale_atoms=True)
    cell.calc = PairCalculator(cell, law, cutoff=1.2)
    R = np.array([[1, 0], [0, 1], [1, -1]]) @ cell.cell.array[:2, :2]  # a bond of each kind
    r, area = np.linalg.norm(R, axis=1), np.linalg.det(cell.cell.array[:2, :2])
    stress = np.einsum('b,bi,bj->ij', law.dphi(r) / r, R, R) / area
    found, blind = (np.subtract(*(sound_speeds(cell, along, model)[0] ** 2 for along in ((1, 0), (0, 1)))) * MASS / area
                    for model in ('complete', 'conventional'))
    yield Row(STRESSED, 'density (c_xy^2 - c_yx^2), s_xx - s_yy', found, stress[0, 0] - stress[1, 1], blind)


@dataclass(frozen=True)
class LennardJones:
    """The Lennard-Jones law 4 epsilon [(sigma/r)^12 - (sigma/r)^6]."""

    sigma: float = 1.0
    epsilon: float = 1.0

    def phi(self, r):
        return 4 * self.epsilon * ((self.sigma / r) ** 12 - (self.sigma / r) ** 6)

    def dphi(self, r):
        return -24 * self.epsilon / r * (2 * (self.sigma / r) ** 12 - (self.sigma / r) ** 6)

    def d2phi(self, r):
        return 24 * self.epsilon / r**2 * (26 * (self.sigma / r) ** 12 - 7 * (self.sigma / r) ** 6)


def _argon_cluster():
    """Thirteen atoms, one in the middle of an icosahedron: vibrations by the forces of ASE's own calculator."""
    law, atoms = LennardJones(), Icosahedron('Ar', 2, 1.5)
    atoms.set_masses(np.ones(len(atoms)))
    shape = atoms.positions - atoms.positions[np.linalg.norm(atoms.positions - atoms.positions.mean(0), axis=1).argmin()]
    r = np.linalg.norm(shape[:, None] - shape, axis=2)[np.triu_indices(len(atoms), 1)]
    atoms.positions = shape * brentq(lambda scale: (law.dphi(scale * r) * r).sum(), 0.5, 1.5, xtol=1e-15)
    atoms.calc = PairCalculator(atoms, law, bonds=list(combinations(range(len(atoms)), 2)))
    own, blind = (np.linalg.eigvalsh(atoms.calc.rest_hessian(model).toarray()) for model in ('complete', 'conventional'))
    theirs = atoms.copy()
    theirs.calc = LennardJonesOfASE(sigma=1.0, epsilon=1.0, rc=100.0)
    with tempfile.TemporaryDirectory() as folder:
        vibrations = Vibrations(theirs, name=f'{folder}/ar13', delta=1e-4)
        vibrations.run()
        known = np.linalg.eigvalsh(vibrations.get_vibrations().get_hessian_2d())
    for name, n in (('lowest', 6), ('tenth', 15), ('highest', -1)):
        yield Row(ARGON, f'thirteen atoms, omega^2 of the {name} vibration', own[n], known[n], blind[n], 1e-5, VIBRATIONS)


SIZES = {(0, 0): LennardJones(1.0, 1.0), (0, 1): LennardJones(0.9, 1.5), (1, 1): LennardJones(0.85, 0.5)}
REACH = 1.28
BY_MATSCIPY = {3: 10.24499199936, 20: 75.74207804418, 50: 209.8484379121, 80: 452.7987174436, 95: 872.1032172919}
"""Eigenvalues of the mixture's Hessian by matscipy, counted from 0; the test `tests/workflows/test_mixture.py` computes them."""


def mixture():
    """Thirty-two atoms of two sizes at rest in a periodic box, each with the neighbours of a crystal that their sizes distort."""
    atoms = bulk('Ar', 'fcc', a=1.5, cubic=True).repeat(2)
    atoms.set_tags(np.random.default_rng(46).permutation(32) % 2)
    atoms.set_masses(np.ones(32))
    atoms.calc = PairCalculator(atoms, SIZES, cutoff=REACH)
    return relaxed(atoms).atoms


def _mixture():
    calc = mixture().calc
    found, blind = (np.linalg.eigvalsh(calc.rest_hessian(model).toarray()) for model in ('complete', 'conventional'))
    for n, known in BY_MATSCIPY.items():
        yield Row(MIXTURE, f'eigenvalue {n + 1} of the Hessian', found[n], known, blind[n], 1e-9, MATSCIPY)


def _tensegrities():
    for name, structure in STRUCTURES.items():
        found, blind = (structure.frequencies(model) for model in ('complete', 'conventional'))
        for n, (here, saved, alone) in enumerate(zip(found, structure.saved, blind, strict=True)):
            alike = (name, n) == ('T-bar', 7)  # which stretches a bar and bends nothing
            yield Row(TENSEGRITIES, f'{name}, frequency {n + 1} (Hz)', here, saved, None if alike else alone, 1e-9, TSGFEM)


def _draw(out, rows):
    """Draw the number of D0 alone divided by the reference, for every row in which both are finite and not zero."""
    ax = new_axes()
    rows = [row for row in rows if row.alone is not None and row.reference]
    fields = list(dict.fromkeys(row.field for row in rows))
    for row in rows:
        y = fields.index(row.field)
        ax.plot(row.here / row.reference, y, '|', color=COLOURS[0], markersize=9, label=r'$D^0 + D^{*}$')
        ax.plot(row.alone / row.reference, y, 'o', color=COLOURS[1], fillstyle='none', markersize=4, label=r'$D^0$ alone')
    ax.set_yticks(range(len(fields)), fields)
    ax.set_xlabel('computed / reference')
    legend_of_set(ax.figure, ncols=2)
    return save_picture(ax.figure, out / 'other_fields.png',
                        'Numbers of other fields, computed with D0 + D* (bars, at 1) and with D0 alone (rings).')
