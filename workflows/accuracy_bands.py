"""The band diagram of a cell of one magnet, by closed form, Bloch matrix and finite differences, and the lowest branches of cells
of hundreds of magnets.
"""

import tempfile
from functools import partial
from itertools import product

import numpy as np

from magphonon import MagneticRepulsion, analytic_bands, read_scene
from magphonon.scenes import ready_scene
from magphonon.stiffness.matrices import bloch_matrix, mass_weighted, model_stiffness, signed_root

from .accuracy import Candidate, Chart, cheapest, measure
from .rows import Check

BRANCHES = 8    # asked of the large cell
DISTANCE = 1e-5  # in spacings, where only the supercell is varied
TIGHT = 1e-9


def chart(quick):
    """Error of the frequencies, in units of the highest, against time."""
    cell = read_scene(ready_scene('prototype')).atoms()
    side, wavevectors = (12, 3) if quick else (16, 10)
    path = cell.cell.bandpath('GMKG', npoints=300, pbc=cell.pbc)
    one = one_magnet(cell, path, f'one magnet, {len(path.kpts)} wavevectors', quick)
    large = f'{side**2} magnets, {BRANCHES} lowest branches, {wavevectors} wavevectors'
    many = many_magnets(cell, side, wavevectors, large, quick)
    return Chart('Band diagram of the prototype', one + many, read(one, many), checks(one, many),
                 'largest error / highest frequency')


def read(one, many):
    """The conclusion of the chart in words."""
    def quickest(table, *names):
        return cheapest([m for m in table if m.method.startswith(names)], TIGHT)

    exact, assembled = quickest(one, 'closed'), quickest(one, 'Bloch')
    numerical, ase = quickest(one, 'phonopy'), quickest(one, 'ase')
    every, lowest = quickest(many, 'dense'), quickest(many, 'Bloch')
    alone, two, *_, widest = (m for m in one if m.method == 'phonopy n x n')
    return (f'One magnet: the Bloch matrix, exact to round-off, takes {assembled.seconds / exact.seconds:.0f} times as long as '
            f'the closed form. To reach {TIGHT:g}, phonopy takes {numerical.seconds / assembled.seconds:.0f} times as long as '
            f'the Bloch matrix and ase.phonons {ase.seconds / assembled.seconds:.0f} times, both with displacements to both '
            f'sides. With displacements to one side, the error is of first order where branches cross. A supercell of 1 x 1 is '
            f'off by {alone.error:.1g}, 2 x 2 by {two.error:.0e}, and {widest.setting} by {widest.error:.0e}; the last takes '
            f'{widest.seconds / two.seconds:.0f} times as long as 2 x 2. Hundreds of magnets: the lowest branches alone '
            f'take {every.seconds / lowest.seconds:.1f} times less time than all.')


def checks(one, many):
    """Checks of the errors and orders of the methods against those of theory."""
    def errors(method):
        return np.array([m.error for m in one if m.method == method])

    def order(method):  # of the three largest displacements, 1e-2 to 1e-4 of the spacing
        return np.polyfit(np.log(10.0) * np.array([-2, -3, -4]), np.log(errors(method)[:3]), 1)[0]

    found = {m.method: m.error for m in many}
    both, one_side = order('phonopy 3x3, plus-minus'), order('phonopy 3x3, one-sided')
    return [
        Check('closed form of the bands, error in 80-bit arithmetic', errors('closed form')[0], 0, 1e-14),
        Check('Bloch matrix, error', errors('Bloch matrix')[0], 0, 1e-13),
        Check('phonopy, order of the error, displaced to both sides', both, 2, 0.03),  # next: (d/L0)^2, 1e-4, and its coefficient
        Check('ase.phonons, order of the error', order('ase.phonons 3x3'), 2, 0.03),
        Check('phonopy, order of the error, displaced to one side', one_side, 1, 0.03),
        Check('control: phonopy, displaced to one side, taken as second order', one_side, 2, 0.3,
              control='one-sided differences'),
        Check('control: error of a supercell of 1 x 1', errors('phonopy n x n')[0], 0, 0.1, control='a supercell of one cell'),
        *(Check(f'{method}, error of the lowest branches of a large cell', found[method], 0, 1e-12)
          for method in ('dense, all branches', 'Bloch matrix, lowest')),
    ]


# --- one magnet in the cell ------------------------------------------------------------------------------------------

def closed_form(cell, kpts, cost=None, real=float):
    """Frequencies in rad/ms of the triangular lattice with nearest neighbours, shape (wavevectors, 2), ascending.

        omega^2 = k/m + (alpha + beta)/2m sum_b s_b -+ (alpha - beta)/2m |sum_b s_b e^{2 i theta_b}|

    with alpha = phi'' along and beta = phi'/r across the bonds, which point at theta_b = 0, 60 and 120 degrees, and
    s_b = 4 sin^2(k.R_b/2).
    """
    calc, m, L0 = cell.calc, real(cell.get_masses()[0]), cell.cell.lengths()[0]
    alpha, beta = real(calc.laws.d2phi(L0)), real(calc.laws.dphi(L0)) / real(L0)
    pi = 4 * np.arctan(real(1))
    k1, k2 = pi * kpts[:, :2].T.astype(real)
    s = 4 * np.sin([k1, k2, k2 - k1]) ** 2
    turn = np.exp(2j * pi * np.arange(3).astype(real) / 3)
    mean, split = (alpha + beta) / 2 * s.sum(axis=0), (alpha - beta) / 2 * abs(turn @ s)
    return np.sqrt((real(calc.parameters.foundation) + np.stack([mean - split, mean + split], axis=1)) / m)


def finite_differences(cell, kpts, supercell, distance, both_sides, cost):
    """Frequencies from phonopy alone, without the checks of `magphonon.finite_displacements`; particles move in x and y."""
    from phonopy import Phonopy
    from phonopy.structure.atoms import PhonopyAtoms

    from magphonon.bands.force_constants import _supercell_atoms

    unit = PhonopyAtoms(symbols=cell.get_chemical_symbols(), masses=cell.get_masses(), cell=cell.cell.array,
                        positions=cell.positions)
    phonon = Phonopy(unit, np.diag(supercell), primitive_matrix='P', is_symmetry=False)
    phonon.generate_displacements(distance, is_plusminus=both_sides, is_diagonal=False)
    displaced = _supercell_atoms(phonon, cell.pbc)
    displaced.calc = cell.calc.on(displaced)
    forces = []
    for structure in phonon.supercells_with_displacements:
        displaced.positions = structure.positions
        forces.append(displaced.get_forces())
    cost['force evaluations'] += len(forces)
    phonon.forces = forces
    phonon.produce_force_constants(calculate_full_force_constants=False)
    D = phonon.run_qpoints(kpts, with_dynamical_matrices=True).dynamical_matrices
    n = len(cell)
    in_plane = D.reshape(-1, n, 3, n, 3)[:, :, :2, :, :2].reshape(-1, 2 * n, 2 * n)
    cost['eigensolves'] += len(kpts)
    return signed_root(np.linalg.eigvalsh(in_plane))


def ase_phonons(cell, kpts, distance, cost):
    """Frequencies from ase.phonons without the sum rule; ase.phonons displaces to both sides, and keeps forces in files."""
    from ase import units as ase_units
    from ase.phonons import Phonons

    supercell = (3, 3, 1)
    with tempfile.TemporaryDirectory() as folder:
        phonons = Phonons(cell, cell.calc.on(cell.repeat(supercell)), supercell=supercell, delta=distance, name=folder + '/ase')
        phonons.run()
        phonons.read(method='standard', acoustic=False)
        energies = phonons.band_structure(kpts, verbose=False)
    cost['force evaluations'] += 1 + 6 * len(cell)
    cost['eigensolves'] += len(kpts)
    omega = energies / (ase_units._hbar * 1e10 / np.sqrt(ase_units._e * ase_units._amu))
    return np.sort(omega, axis=1)[:, -2 * len(cell):]  # those along z are zero


def bloch(cell, path, cost, branches=None):
    """Frequencies from magphonon's Bloch matrix, of all branches or of the lowest."""
    cost['eigensolves'] += len(path.kpts)
    return analytic_bands(cell, path, branches=branches).omega


def one_magnet(cell, path, panel, quick):
    """Candidates: every method for the bands of a cell of one particle."""
    kpts, L0 = path.kpts, cell.cell.lengths()[0]
    exact = closed_form(cell, kpts, real=np.longdouble)
    candidates = [Candidate('closed form', '', partial(closed_form, cell, kpts), panel),
                  Candidate('Bloch matrix', '', partial(bloch, cell, path), panel)]
    for d in np.logspace(-2, -7, 6):
        for both, sides in ((True, 'plus-minus'), (False, 'one-sided')):
            candidates.append(Candidate(f'phonopy 3x3, {sides}', f'd = {d:.0e} L0',
                                        partial(finite_differences, cell, kpts, (3, 3, 1), d * L0, both), panel))
        candidates.append(Candidate('ase.phonons 3x3', f'd = {d:.0e} L0', partial(ase_phonons, cell, kpts, d * L0), panel))
    for n in (1, 2, 4, 6) if quick else (1, 2, 4, 6, 10, 20):
        candidates.append(Candidate('phonopy n x n', f'n = {n}',
                                    partial(finite_differences, cell, kpts, (n, n, 1), DISTANCE * L0, True), panel))
    return measure(candidates, lambda omega: abs(omega - exact).max() / exact.max(), repeats=3 if quick else 25, patience=0.5)


# --- hundreds of magnets in the cell ---------------------------------------------------------------------------------

def folded(cell, kpts, side):
    """Lowest branches of a supercell of side x side cells: those of one cell at all wavevectors that fold onto `kpts`."""
    shifts = np.array(list(product(range(side), range(side), (0,))))
    every = (kpts[:, None] + shifts) / side
    omega = closed_form(cell, every.reshape(-1, 3), real=np.longdouble).reshape(len(kpts), -1)
    return np.sort(omega, axis=1)[:, :BRANCHES]


def dense(cell, kpts, cost):
    """All eigenvalues of the full Bloch matrix, one wavevector after the other."""
    calc = cell.calc
    K = model_stiffness(calc.bonds.vectors[:, :2], calc.laws)
    cost['eigensolves'] += len(kpts)
    D = (mass_weighted(bloch_matrix(calc.bonds, K, q[None], calc.parameters.foundation), cell.get_masses()) for q in kpts)
    return np.array([signed_root(np.linalg.eigvalsh(each[0])[:BRANCHES]) for each in D])


def many_magnets(cell, side, wavevectors, panel, quick):
    """Candidates for the lowest branches of a large cell, whose exact bands are the folded bands of a small cell."""
    large = cell.repeat((side, side, 1))
    large.calc = MagneticRepulsion(large, cell.calc.laws, **cell.calc.parameters)
    path = large.cell.bandpath('GMKG', npoints=wavevectors, pbc=large.pbc)
    exact = folded(cell, path.kpts, side)
    top = closed_form(cell, np.array([[1 / 2, 0, 0]]), real=np.longdouble).max()
    candidates = [Candidate('dense, all branches', '', partial(dense, large, path.kpts), panel),
                  Candidate('Bloch matrix, lowest', '', partial(bloch, large, path, branches=BRANCHES), panel)]
    if not quick:  # displaces every particle: seconds
        def phonopy(cost):
            distance = DISTANCE * cell.cell.lengths()[0]
            return finite_differences(large, path.kpts, (1, 1, 1), distance, True, cost)[:, :BRANCHES]
        candidates.append(Candidate('phonopy, plus-minus', f'd = {DISTANCE:.0e} L0', phonopy, panel))
    return measure(candidates, lambda omega: abs(omega - exact).max() / top, repeats=2 if quick else 5,
                   patience=0.2 if quick else 1.0)
