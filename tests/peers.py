"""What other programs find for the bands of our atoms, each as its own users run it, beside ours.

Each peer is a function of a cell, the cells of a supercell, and an empty directory; it returns the frequencies that it calls THz
and those of the analytic Bloch matrix in Hz, shape (wavevectors, modes).  `python tests/peers.py` prints the table of the page
"With other tools": the largest difference of each peer, in Hz.
"""

import numpy as np
from ase import Atoms

from magphonon import InversePower, MagneticRepulsion, finite_displacements, lattices, relaxed, units as u
from magphonon.bands import bloch_modes, write_band_yaml, write_phonopy_params
from magphonon.stiffness import for_ase_tools, with_vacancies

LAW = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
Q = np.array([[0.0, 0, 0], [0.5, 0, 0], [1 / 3, 1 / 3, 0], [0.13, 0.31, 0], [-0.2, 0.4, 0]])
DISPLACEMENT = 1e-4  # 1e-5 of the spacing; with the 0.01 of most tools the curvature of the law shifts frequencies by 1e-6


def prototype():
    cell = lattices.triangular(10 * u.mm, 0.707 * u.g)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=19.6757 * u.N / u.m)
    return cell


def honeycomb():
    cell = lattices.honeycomb(10 * u.mm, 0.707 * u.g)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=200 * u.N / u.m)
    return cell


def vacancy():
    cell = lattices.triangular(10 * u.mm, 0.707 * u.g)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=120 * u.N / u.m)
    nine = cell.repeat((3, 3, 1))
    nine.calc = cell.calc.on(nine)
    return relaxed(with_vacancies(nine, [4])).atoms


STRUCTURES = {'prototype': (prototype, (5, 5, 1)), 'honeycomb': (honeycomb, (3, 3, 1)), 'vacancy': (vacancy, (3, 3, 1))}


def ours(cell, q):
    return bloch_modes(cell, q)[0] * 1e3 / (2 * np.pi)


def in_plane(frequencies):
    """Those of the motion in the plane: the third of the modes along z, at zero, are the lowest."""
    frequencies = np.sort(frequencies, axis=-1)
    return frequencies[..., frequencies.shape[-1] // 3 :]


def from_phonopy(phonon, cell):
    """A phonopy.Phonopy may have chosen another primitive cell: the wavevectors are the same in rad/mm, not in fractions."""
    k = Q @ np.linalg.inv(cell.cell.array).T
    return in_plane(phonon.run_qpoints(k @ phonon.primitive.cell.T).frequencies), ours(cell, Q)


def ase_phonons(cell, cells, directory):
    from ase import units as ase_units
    from ase.phonons import Phonons

    atoms = for_ase_tools(cell)
    phonons = Phonons(atoms, atoms.calc, supercell=cells, delta=DISPLACEMENT, name=str(directory / 'ase'))
    phonons.run()
    phonons.read(method='standard', acoustic=False)
    energies = phonons.band_structure(Q, verbose=False)
    return in_plane(energies / (ase_units._hplanck * ase_units.J) / 1e12), ours(cell, Q)


def ase_vibrations(cell, cells, directory):
    from ase.vibrations import Vibrations

    patch = for_ase_tools(cell).repeat((2, 2, 1))  # its modes are those of the wavevectors that fit
    patch.calc = for_ase_tools(cell).calc
    found = Vibrations(patch, delta=DISPLACEMENT, nfree=2, name=str(directory / 'vib'))
    found.run()
    frequencies = found.get_frequencies().real * 0.0299792458  # cm^-1 to THz
    fits = [[i / 2, j / 2, 0] for i in (0, 1) for j in (0, 1)]
    return in_plane(frequencies), np.sort(ours(cell, np.array(fits)).ravel())


def janus_core(cell, cells, directory):
    from janus_core.calculations.phonons import Phonons

    phonons = Phonons(struct=for_ase_tools(cell), supercell=list(cells), displacement=DISPLACEMENT, write_results=False)
    phonons.run()
    return from_phonopy(phonons.results['phonon'], cell)


def matcalc(cell, cells, directory):
    from matcalc import PhononCalc

    atoms = for_ase_tools(cell)
    phonons = PhononCalc(atoms.calc, supercell_matrix=np.diag(cells), atom_disp=DISPLACEMENT, relax_structure=False,
                         write_phonon=False)
    return from_phonopy(phonons.calc(atoms)['phonon'], cell)


def hiphive(cell, cells, directory):
    from hiphive import ClusterSpace, ForceConstantPotential, StructureContainer
    from hiphive.utilities import prepare_structures
    from sklearn.linear_model import LinearRegression

    phonon, ideal = phonopy_of(cell, cells)
    periodic = for_ase_tools(cell)
    periodic.pbc = True  # hiphive takes no other
    space = ClusterSpace(periodic, [1.2 * cell.calc.bonds.lengths.max()], acoustic_sum_rules=False)
    rng = np.random.default_rng(1)  # the displacements are to one side: their error is of first order
    container = StructureContainer(space)
    for _ in range(8):
        shaken = ideal.copy()
        shaken.positions[:, :2] += 0.01 * DISPLACEMENT * rng.normal(size=(len(shaken), 2))
        container.add_structure(prepare_structures([shaken], ideal, ideal.calc)[0])
    fit = LinearRegression(fit_intercept=False).fit(*container.get_fit_data())
    found = ForceConstantPotential(space, fit.coef_).get_force_constants(ideal)
    phonon.force_constants = found.get_fc_array(order=2)
    return from_phonopy(phonon, cell)


def symfc(cell, cells, directory):
    """It imposes the acoustic sum rule, always."""
    phonon, _ = phonopy_of(cell, cells)
    phonon.produce_force_constants(fc_calculator='symfc')
    return from_phonopy(phonon, cell)


def dynasor(cell, cells, directory):
    from dynasor import ModeProjector

    phonon, ideal = phonopy_of(cell, cells)
    phonon.produce_force_constants()
    periodic = for_ase_tools(cell)
    periodic.pbc = True
    modes = ModeProjector(periodic, ideal, phonon.force_constants)
    return in_plane(modes.omegas / (2 * np.pi) * 1e3), ours(cell, modes.q_reduced)


def phonopy_of(cell, cells):
    """A phonopy.Phonopy as its own users make it, with forces of displaced supercells, and its supercell as atoms."""
    from phonopy import Phonopy
    from phonopy.structure.atoms import PhonopyAtoms

    atoms = for_ase_tools(cell)
    phonon = Phonopy(PhonopyAtoms(symbols=atoms.get_chemical_symbols(), cell=atoms.cell, positions=atoms.positions,
                                  masses=atoms.get_masses()), np.diag(cells), primitive_matrix='P')
    phonon.generate_displacements(distance=DISPLACEMENT)
    ideal, *displaced = (Atoms(s.symbols, positions=s.positions, cell=s.cell, masses=s.masses, pbc=True, calculator=atoms.calc)
                         for s in (phonon.supercell, *phonon.supercells_with_displacements))
    phonon.forces = [one.get_forces() for one in displaced]
    return phonon, ideal


def phonopy(cell, cells, directory):
    phonon, _ = phonopy_of(cell, cells)
    phonon.produce_force_constants()
    return from_phonopy(phonon, cell)


def phonopy_load(cell, cells, directory):
    return from_phonopy(loaded(cell, cells, directory), cell)


def loaded(cell, cells, directory):
    import phonopy

    write_phonopy_params(finite_displacements(cell, cells), directory / 'phonopy_params.yaml')
    return phonopy.load(directory / 'phonopy_params.yaml')


def euphonic(cell, cells, directory):
    from euphonic import ForceConstants, ureg

    write_phonopy_params(finite_displacements(cell, cells), directory / 'phonopy_params.yaml')
    constants = ForceConstants.from_phonopy(path=directory, summary_name='phonopy_params.yaml')
    found = constants.calculate_qpoint_phonon_modes(Q).frequencies / ureg('planck_constant')
    return in_plane(found.to('THz').magnitude), ours(cell, Q)


def pymatgen(cell, cells, directory):
    from pymatgen.io.phonopy import get_ph_bs_symm_line

    path = cell.cell.bandpath('GMKG', npoints=20, pbc=cell.pbc)
    write_band_yaml(finite_displacements(cell, cells), path, directory / 'band.yaml')
    found = get_ph_bs_symm_line(directory / 'band.yaml')
    return in_plane(found.bands.T), ours(cell, np.array([q.frac_coords for q in found.qpoints]))


def seekpath(cell, cells, directory):
    phonon = loaded(cell, cells, directory)
    phonon.auto_band_structure(npoints=7)
    found = phonon.band_structure
    k = np.concatenate(found.qpoints) @ np.linalg.inv(phonon.primitive.cell).T
    return in_plane(np.concatenate(found.frequencies)), ours(cell, k @ cell.cell.array.T)


PEERS = {peer.__name__: peer for peer in (ase_phonons, ase_vibrations, phonopy, phonopy_load, seekpath, euphonic, symfc,
                                          janus_core, matcalc, pymatgen, hiphive, dynasor)}


def difference(peer, structure, directory):
    """Largest difference of a peer's frequencies from ours, and the largest frequency, in Hz."""
    make, cells = STRUCTURES[structure]
    found, expected = PEERS[peer](make(), cells, directory)
    assert found.shape == expected.shape
    return abs(found - expected).max(), expected.max()


if __name__ == '__main__':
    import tempfile
    import warnings
    from pathlib import Path

    warnings.simplefilter('ignore')
    print('| tool |', ' | '.join(STRUCTURES), '|')
    for peer in PEERS:
        found = []
        for structure in STRUCTURES:
            with tempfile.TemporaryDirectory() as folder:
                found.append(f'{difference(peer, structure, Path(folder))[0]:.1e}')
        print('|', ' | '.join([peer, *found]), '|', flush=True)
