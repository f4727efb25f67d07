"""Other people's papers: ions, Wigner crystals, gyroscopes, tensegrity, strings and foams, each number beside that of D0 alone.

Every reference is a closed form written out here, a printed number, or a number from public code; none comes from the package.
Numbers marked `(printed)` or `(IonSim.jl's tests)` were read in that paper or code; those marked `(quoted from memory)` were not.
All others are closed forms of the theory that a paper uses. We wrote them from knowledge of the field, not from its pages.

Not found in full text, and therefore not among the rows: the tables of Wang et al. 2018 (one-way gap), Chong et al. 2021, Lee et
al. 2025 (magnets on cantilevers) and Watkins et al. 2020 (demultiplexer), the Chern numbers of the spindle lattice of Mitchell et
al. 2018, and the numbers of the two magnetic companions of Bonsall and Maradudin.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from ase import Atoms
from ase.build import bulk
from ase.constraints import FixAtoms
from scipy.optimize import brentq
from scipy.special import zeta

from magphonon import (
    AllNeighbours,
    InversePower,
    PairCalculator,
    Spring,
    analytic_bands,
    chern_numbers,
    critical_foundation,
    find_bonds,
    lattices,
    modes,
    relaxed,
    sound_speeds,
)
from magphonon.plotting.axes import COLOURS, legend_of_set, new_axes
from magphonon.scenes.scene import reference
from magphonon.stiffness import elastic_moduli, net, self_stress
from magphonon.stiffness.matrices import lossless_modes

from .rows import Check, Outcome, save_picture

CHARGES = InversePower(1.0, 2.0)
JAMES = 'James 1998 (Appl. Phys. B 66, 181)'
FISHMAN = 'Fishman et al. 2008 (arXiv:0710.1831)'
WIGNER = 'Bonsall and Maradudin 1977 (PRB 15, 1959)'
PENNING = 'Wang, Keith and Freericks 2013 (arXiv:1211.2842)'
NASH = 'Nash et al. 2015 (arXiv:1504.03362)'
SAMAK = 'Samak and Bilal 2025 (arXiv:2505.22844)'
CALLADINE = 'Calladine 1978 (IJSS 14, 161)'
PRISM = 'Connelly and Terrell 1995 (Structural Topology 21, 59)'
RAYLEIGH = 'Rayleigh 1877 (Theory of Sound, 120 and 194)'
NET = 'RigidPy, question 4 (GitHub, honeycomb in tension)'
PRINCEN = 'Princen 1983 (JCIS 91, 160)'
CRYSTAL = 'Ashcroft and Mermin 1976 (ch. 20)'
MASS = 1.0
ZERO = 1e-6  # of the highest squared frequency: below it a mode is a mechanism or a motion of the whole body


@dataclass(frozen=True)
class Row:
    """A number of a paper, that of the package, and that of D0 alone, which is None where it is not finite."""

    paper: str
    what: str
    here: float
    reference: float
    alone: float | None
    tolerance: float = 1e-9

    @property
    def checks(self):
        """The row and, as its control, the number of D0 alone; if this is the same, the row says so."""
        name = f'{self.paper}: {self.what}'
        row = Check(name, float(self.here), float(self.reference), self.tolerance)
        if self.alone is None:
            return [row]
        alone = Check(f'D0 alone, {name}', float(self.alone), float(self.reference), self.tolerance, control='D0')
        return [row, alone] if alone.passed else [replace(row, quantity=f'{name}; D0 alone says the same')]


def main(out):
    """Numbers of twelve publications, and a picture of the numbers that D0 alone gives."""
    rows = [row for paper in (_ion_chains, _zigzag, _wigner, _penning, _gyroscopes, _anomalies, _strings, _prisms, _honeycombs,
                              _argon) for row in paper()]
    return Outcome([check for row in rows for check in row.checks], [_draw(out, rows)])


def ions(places, springs, gyration=0.0):
    """Charges at rest in a trap, which is one anchor for all of them."""
    atoms = Atoms(f'H{len(places)}', places, masses=np.ones(len(places)))
    atoms.calc = PairCalculator(atoms, CHARGES, bonds=list(combinations(range(len(places)), 2)), foundation=[springs],
                                anchors=np.zeros((len(places), 3)), gyration=gyration, dim=3)
    return relaxed(atoms).atoms


def without_static_forces(atoms):
    """Squared frequencies of D0 and the supports together, ascending."""
    return np.linalg.eigvalsh(atoms.calc.rest_hessian('conventional').toarray() / MASS)


def _ion_chains():
    k = 20.0
    crystals = {n: ions(np.linspace(-n / 2, n / 2, n)[:, None] * [0, 0, 1.0], [k, k, 1.0]) for n in (2, 3, 4)}
    long = ions(np.linspace(-3, 3, 10)[:, None] * [0, 0, 1.0], [200.0, 200.0, 1.0])
    w2 = {n: modes(crystal).omega ** 2 for n, crystal in crystals.items()}
    alone = {n: without_static_forces(crystal) for n, crystal in crystals.items()}
    z = {n: np.sort(crystal.positions[:, 2]) for n, crystal in crystals.items()}
    yield Row(JAMES, 'two ions, place (1/4)^(1/3)', z[2][1], 0.25 ** (1 / 3), None)
    yield Row(JAMES, 'two ions, stretch, omega^2 = 3', w2[2][1], 3, alone[2][1])
    yield Row(JAMES, 'three ions, place (5/4)^(1/3)', z[3][2], 1.25 ** (1 / 3), None)
    yield Row(JAMES, 'three ions, third axial mode, omega^2 = 29/5', w2[3][2], 29 / 5, alone[3][2])
    yield Row(JAMES, "four ions, fourth axial mode, omega^2 = 9.308 (IonSim.jl's tests)", w2[4][3], 9.308, alone[4][3], 1e-4)
    known = 0.2821, 0.85378, 1.4504, 2.10003, 2.8708
    for place, printed in zip(np.sort(long.positions[:, 2])[5:], known, strict=True):
        yield Row(JAMES, f"ten ions, place {printed} (IonSim.jl's tests)", place, printed, None, 2e-4)
    for axial, across in zip((1, 3, 29 / 5), (w2[3][8], w2[3][6], w2[3][4]), strict=True):
        yield Row(JAMES, f'three ions, across the axis, k + (1 - {axial:g})/2', across, k + (1 - axial) / 2, k,
                  1e-9 if axial > 1 else 1e-6)


def _zigzag():
    chain, k = lattices.chain(1.0, MASS), 10.0
    chain.calc = AllNeighbours(chain, CHARGES, foundation=k)
    (across, along), (across4, along4) = analytic_bands(chain, [[0.5, 0, 0], [0.25, 0, 0]]).omega ** 2
    yield Row(FISHMAN, 'zigzag threshold, 7 zeta(3)/2', critical_foundation(chain).k, 3.5 * zeta(3), 0)
    yield Row(FISHMAN, 'transverse omega^2 at pi, k - 7 zeta(3)/2', across, k - 3.5 * zeta(3), k)
    yield Row(FISHMAN, 'longitudinal omega^2 at pi, k + 7 zeta(3)', along, k + 7 * zeta(3), k + 7 * zeta(3))
    yield Row(FISHMAN, 'transverse omega^2 at pi/2, k - 35 zeta(3)/16', across4, k - 35 / 16 * zeta(3), k)
    yield Row(FISHMAN, 'longitudinal omega^2 at pi/2, k + 35 zeta(3)/8', along4, k + 35 / 8 * zeta(3),
              k + 35 / 8 * zeta(3))
    crystal = ions(np.array([[0, 0, -1.0], [0, 0, 0], [0, 0, 1.0]]), [3.3, 3.7, 1.0])
    yield Row(FISHMAN, 'three ions, k = 3.3: omega^2 of the zigzag mode, k - 12/5', modes(crystal).omega[0] ** 2, 0.9, 3.3)


def _wigner():
    known, cell, n, k = reference()['all_neighbours'], lattices.triangular(1.0, MASS), 2 / np.sqrt(3), 1e-3
    cell.calc = AllNeighbours(cell, CHARGES)
    yield Row(WIGNER, 'energy per electron, e^2/r0 (printed)', cell.get_potential_energy() / np.sqrt(np.pi * n),
              known['wigner_energy'], None, 1e-6)
    c_T, _ = sound_speeds(cell)
    yield Row(WIGNER, 'm c_T^2, e^2 sqrt(n) (printed)', c_T**2 / np.sqrt(n), known['wigner_shear'], None, 3e-6)
    q, rate = [[k / (2 * np.pi), k / (4 * np.pi), 0]], 10.0
    plasmon, shear = 2 * np.pi * n * k, known['wigner_shear'] * np.sqrt(n) * k**2
    yield Row(WIGNER, 'plasmon, 2 pi n e^2 k/m', analytic_bands(cell, q).omega[0, 1] ** 2, plasmon, None, 1e-3)
    slow, fast = lossless_modes(MASS * rate * np.array([[0, -1], [1, 0]]), cell.calc.bloch_matrix(np.array(q))[0])[0]
    yield Row(WIGNER, 'in a magnetic field: magnetophonon, omega_L omega_T/omega_c', slow,
              np.sqrt(plasmon * shear) / rate, None, 1e-3)
    yield Row(WIGNER, 'in a magnetic field: magnetoplasmon^2 - omega_c^2, omega_L^2', fast**2 - rate**2, plasmon,
              None, 2e-3)


def _penning():
    """Seven ions: one in the middle, six on a ring whose radius and modes follow by hand."""
    k, kz, g, angles = 1.0, 30.0, 5.0, np.pi / 3 * np.arange(6)
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    crystal = ions(np.vstack([[0, 0, 0], 1.7 * ring]), [k, k, kz], gyration=g)
    chords = 2 * np.sin(angles[1:] / 2)
    R = ((1 + (1 / (2 * chords)).sum()) / k) ** (1 / 3)
    yield Row(PENNING, 'radius of the ring of seven ions', np.linalg.norm(crystal.positions[1:], axis=1).mean(), R, None)
    omega = modes(crystal).omega
    alone = crystal.calc.about(crystal, model='conventional')
    still = crystal.copy()
    still.calc = alone
    blind = modes(still).omega
    for what, exact in (('cyclotron mode of the centre, (sqrt(g^2 + 4 k) + g)/2', (np.sqrt(g**2 + 4 * k) + g) / 2),
                        ('magnetron mode of the centre, (sqrt(g^2 + 4 k) - g)/2', (np.sqrt(g**2 + 4 * k) - g) / 2),
                        ('breathing mode, sqrt(3 k + g^2)', np.sqrt(3 * k + g**2)),
                        ('drumhead mode of the centre, sqrt(kz)', np.sqrt(kz)),
                        ('drumhead tilt, sqrt(kz - k)', np.sqrt(kz - k))):
        yield Row(PENNING, f'{what}', _nearest(omega, exact), exact, _nearest(blind, exact))
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
        yield Row(NASH, name + 'lowest rate at Gamma, k0', at_G[0], k0, blind_G[0], 1e-5)
        yield Row(NASH, name + 'upper rate at Gamma, k0 + 3 (k + T/L)', at_G[1], k0 + 2 * mean, blind_G[1], 1e-5)
        yield Row(NASH, name + 'lower rate at K', at_K[0], np.sqrt((k0 + mean) ** 2 - half**2), blind_K[0], 1e-5)
        yield Row(NASH, name + 'upper rate at K, k0 + 3 (k + T/L)/2', at_K[1], k0 + mean, blind_K[1], 1e-5)
    cell.calc = PairCalculator(cell, Spring(bond, 1.0), foundation=6.0, gyration=30.0)
    yield Row(NASH, 'one-way edges of the honeycomb: |Chern number| of the lower band', abs(chern_numbers(cell)[0]), 1,
              abs(chern_numbers(cell, 'conventional')[0]), 0)


@dataclass(frozen=True)
class Tensions:
    """Constant forces in N between first, second, ... neighbours, at the distances 1, 2, ... mm; they have no stiffness D0."""

    T: tuple

    def phi(self, r):
        return self.dphi(r) * r

    def dphi(self, r):
        return np.array(self.T)[np.round(np.real(r)).astype(int) - 1] + 0 * r

    def d2phi(self, r):
        return 0 * r


def _anomalies():
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
        across = analytic_bands(chain, q).omega[:, 1] ** 2
        exact = (1 - np.cos(2 * np.pi * q[:, 0])) * (np.cos(2 * np.pi * q[:, 0]) - x0) ** 2
        for k in (0, 1):
            yield Row(SAMAK, f'zero at q0 = {360 * share:.0f} deg: omega^2 at {q[k, 0]:g}', across[k], exact[k], 0)
        yield Row(SAMAK, f'zero at q0 = {360 * share:.0f} deg: omega^2 there', across[2], 0, None, 1e-14)


def _strings():
    n, T, k = 5, 0.3, 4.0
    beads = Atoms(f'H{n + 2}', np.arange(n + 2)[:, None] * [1.0, 0, 0], masses=np.ones(n + 2),
                  constraint=FixAtoms([0, n + 1]))
    beads = net(beads, [(i, i + 1, Spring(k, 1 - T / k)) for i in range(n + 1)])
    omega = np.sort(modes(beads).omega)
    for j in (1, 2, 3):
        yield Row(RAYLEIGH, f'string of {n} beads, tone {j}, 2 sqrt(T/(m L)) sin(j pi/(2 n + 2))', omega[j - 1],
                  2 * np.sqrt(T) * np.sin(j * np.pi / (2 * n + 2)), 0)
    cell = lattices.square(1.0, MASS)
    cell.calc = PairCalculator(cell, Spring(k, 1 - T / k), dim=3)
    for name, q in (('M', 0.5), ('half way to M', 0.25)):
        lowest = analytic_bands(cell, [[q, q, 0]]).omega[0, 0] ** 2
        yield Row(RAYLEIGH, f'square net as a membrane, omega^2 at {name}, 8 T/(m L) sin^2', lowest,
                  8 * T * np.sin(np.pi * q) ** 2, 0)


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
        yield Row(PRISM, f'{n} struts: tension over length, cables up over rings, 2 sin(pi/n)', q[2 * n] / q[0],
                  2 * np.sin(np.pi / n), None)
        yield Row(CALLADINE, f'{n} struts: states of self-stress', len(state), 1, None, 0)
        complete, alone = modes(atoms).omega ** 2, without_static_forces(atoms)
        zeros, blind = ((abs(w2) < ZERO * w2.max()).sum() for w2 in (complete, alone))
        yield Row(CALLADINE, f'{n} struts: modes without stiffness by D0, 6 + (3 j - 6) - b + s', blind, 2 * n + 1, None, 0)
        yield Row(CALLADINE, f'{n} struts: modes without stiffness once prestressed, the six rigid motions', zeros, 6, blind, 0)


@dataclass(frozen=True)
class Film:
    """The law of a film, whose tension does not depend on its length."""

    tension: float

    def phi(self, r):
        return self.tension * r

    def dphi(self, r):
        return self.tension + 0 * r

    def d2phi(self, r):
        return 0 * r


def _honeycombs():
    """Speeds of sound of a honeycomb with bond stiffness k along and t across, when the forces on both sublattices balance."""
    cell, k = lattices.honeycomb(1.0, MASS), 1.0
    for stretch in (0.05, 0.2):
        t = k * stretch
        cell.calc = PairCalculator(cell, Spring(k, 1.0 - stretch))
        found, blind = sound_speeds(cell), sound_speeds(cell, model='conventional')
        inner = 3 / 8 * (k - t) ** 2 / (k + t)
        slow, fast = (np.sqrt((1.5 * t + 3 / 8 * c * (k - t) - inner) / 2) for c in (1, 3))
        yield Row(NET, f'stretched by {stretch:g}: shear wave', found[0], slow, blind[0])
        yield Row(NET, f'stretched by {stretch:g}: longitudinal wave', found[1], fast, blind[1])
    cell.calc = PairCalculator(cell, Film(2.0))
    density = 2 * MASS / (1.5 * np.sqrt(3))
    found, blind = (density * sound_speeds(cell, model=model)[1] ** 2 for model in ('complete', 'conventional'))
    yield Row(PRINCEN, 'dry foam, shear modulus sigma/(sqrt(3) a)', found, 1 / np.sqrt(3), blind)


@dataclass(frozen=True)
class LennardJones:
    """The Lennard-Jones law 4 (r^-12 - r^-6)."""

    def phi(self, r):
        return 4 * (r**-12 - r**-6)

    def dphi(self, r):
        return -24 * (2 * r**-13 - r**-7)

    def d2phi(self, r):
        return 24 * (26 * r**-14 - 7 * r**-8)


def _argon():
    """Law cut off at nine spacings, which changes the energy by 0.1 %; the printed numbers have two or three digits."""
    law, cell = LennardJones(), bulk('Ar', 'fcc', a=np.sqrt(2))
    cell.set_masses([MASS])
    r = find_bonds(cell, cutoff=9.1).lengths
    rest = brentq(lambda spacing: (law.dphi(spacing * r) * r).sum(), 1.0, 1.2)
    yield Row(CRYSTAL, 'distance of neighbours, 1.09 sigma (quoted from memory)', rest, 1.09, None, 0.005)
    yield Row(CRYSTAL, 'energy per atom, -8.6 epsilon (quoted from memory)', law.phi(rest * r).sum(), -8.6, None, 0.006)
    cell.set_cell(cell.cell * rest, scale_atoms=True)
    cell.calc = PairCalculator(cell, law, cutoff=9.1 * rest)
    r, volume = rest * r, cell.get_volume()
    yield Row(CRYSTAL, 'bulk modulus, 75 epsilon/sigma^3 (quoted from memory)', elastic_moduli(cell).bulk, 75,
              (law.d2phi(r) * r**2).sum() / (9 * volume), 0.007)


def _draw(out, rows):
    """Draw the number of D0 alone divided by that of the paper, for every row in which both are finite and not zero."""
    ax = new_axes()
    rows = [row for row in rows if row.alone is not None and row.reference]
    papers = list(dict.fromkeys(row.paper for row in rows))
    for row in rows:
        y = papers.index(row.paper)
        ax.plot(row.here / row.reference, y, '|', color=COLOURS[0], markersize=9, label=r'$D^0 + D^*$')
        ax.plot(row.alone / row.reference, y, 'o', color=COLOURS[1], fillstyle='none', markersize=4, label=r'$D^0$ alone')
    ax.set_yticks(range(len(papers)), [paper.split(' (')[0] for paper in papers])
    ax.set_xlabel('computed / published')
    legend_of_set(ax.figure, ncols=2)
    return save_picture(ax.figure, out / 'papers.png', "Other people's numbers, compared with D0 + D* (bars, at 1) and with D0 "
                                                       "alone (rings).")
