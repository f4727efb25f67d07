"""Atoms for other tools against closed forms, and every tool that is installed against our bands."""

import importlib
import warnings

import numpy as np
import peers
import pytest
from ase.constraints import FixAtoms
from ase.data import atomic_masses
from structures import few_first

from magphonon import MagneticRepulsion, analytic_bands, lattices, units as u
from magphonon.stiffness import for_ase_tools
from magphonon.stiffness.other_tools import GRAM

MODULES = {'symfc': 'symfc', 'euphonic': 'euphonic', 'janus_core': 'janus_core.calculations.phonons', 'matcalc': 'matcalc',
           'pymatgen': 'pymatgen.io.phonopy', 'hiphive': 'hiphive', 'dynasor': 'dynasor', 'seekpath': 'seekpath'}
CONSTANTS = 1.3e-7
"""Tools compute with different values of the elementary charge and the atomic mass: those of 1986 in phonopy give frequencies
lower by this fraction than those of today."""


@pytest.mark.filterwarnings('ignore')  # of the other programs
@pytest.mark.parametrize('structure', few_first(peers.STRUCTURES, 1))
@pytest.mark.parametrize('peer', [pytest.param(name, marks=[pytest.mark.peer] if name in MODULES else []) for name in peers.PEERS
                                  if name != 'symfc'])
def test_other_tools_find_the_same_bands(peer, structure, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if peer in MODULES:
        try:
            importlib.import_module(MODULES[peer])
        except ImportError as error:
            pytest.skip(str(error))
    found, highest = peers.difference(peer, structure, tmp_path)
    assert found < 1.5 * CONSTANTS * highest


@pytest.mark.peer
def test_symfc_imposes_the_sum_rule_which_erases_the_foundation(tmp_path):
    pytest.importorskip('symfc')
    found, expected = peers.symfc(peers.prototype(), (5, 5, 1), tmp_path)
    assert expected[0].min() > 26
    assert abs(found[0]).max() < 1e-3  # Hz


def test_masses_are_those_of_the_symbols_and_unscaled_ones_are_far_off(tmp_path):
    cell = peers.prototype()
    atoms = for_ase_tools(cell)
    np.testing.assert_allclose(atoms.get_masses(), atomic_masses[60], rtol=1e-12)
    assert cell.get_masses() == [0.707]
    assert cell.calc is not atoms.calc
    # the control: the cell itself in a tool of ASE
    right, _ = peers.ase_vibrations(cell, (1, 1, 1), tmp_path / 'scaled')
    peers.for_ase_tools, kept = (lambda same: same), peers.for_ase_tools
    try:
        wrong, _ = peers.ase_vibrations(cell, (1, 1, 1), tmp_path / 'as it is')
    finally:
        peers.for_ase_tools = kept
    np.testing.assert_allclose(wrong, right * np.sqrt(GRAM), rtol=1e-6)  # 5.72 THz for 58.23 Hz


def test_the_unit_of_mass_is_that_of_phonopys_constants():
    from phonopy.physical_units import get_physical_units

    assert pytest.approx((2 * np.pi * get_physical_units().DefaultToTHz / 1e3) ** 2, rel=1e-13) == GRAM


def unequal():
    cell = lattices.honeycomb(10 * u.mm, 0.707 * u.g)
    cell.set_masses([0.5, 1.3])
    cell.calc = MagneticRepulsion(cell, peers.LAW, foundation=0.2)
    return cell


def test_masses_that_no_table_can_know_are_told(tmp_path):
    cell = unequal()
    with pytest.warns(UserWarning, match='tools that look masses up by symbol, such as matcalc'):
        atoms = for_ase_tools(cell)
    assert atoms.get_masses()[1] / atoms.get_masses()[0] == pytest.approx(2.6)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', UserWarning)
        found, expected = peers.phonopy(cell, (3, 3, 1), tmp_path)
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_a_relaxation_by_ase_finds_the_rest(tmp_path):
    from ase.optimize import BFGS

    atoms = for_ase_tools(peers.honeycomb()).repeat((2, 2, 1))
    atoms.calc = for_ase_tools(peers.honeycomb()).calc
    rest = atoms.positions.copy()
    atoms.positions[:, :2] += np.random.default_rng(1).normal(scale=0.05, size=(len(atoms), 2))
    assert BFGS(atoms, logfile=None).run(fmax=0.05, steps=200)
    assert abs(atoms.positions - rest).max() < 1e-4  # mm; at rest by ASE's usual threshold means so here too


def test_what_is_refused():
    cell = peers.honeycomb()
    cell.set_constraint(FixAtoms([0]))
    with pytest.raises(ValueError, match='does not support particles that are held or guided'):
        for_ase_tools(cell)
    with pytest.raises(ValueError, match='as calculator; attach'):
        for_ase_tools(cell.copy())


def test_a_lattice_that_buckles_a_little_is_imaginary_for_the_thresholds_of_tools(tmp_path):
    """At -0.01 THz, that of matcalc and pymatgen; with kHz for THz it would pass."""
    cell = lattices.square(10 * u.mm, 0.707 * u.g)
    cell.calc = MagneticRepulsion(cell, peers.LAW, foundation=0.0)
    needed = -(analytic_bands(cell, 'GXMG').omega.min() ** 2) * 0.707
    assert needed < 0
    cell.calc = MagneticRepulsion(cell, peers.LAW, foundation=-0.999 * needed)
    lowest = peers.phonopy_of(cell, (3, 3, 1))
    lowest[0].produce_force_constants()
    worst = lowest[0].run_qpoints([[0.5, 0, 0], [0.5, 0.5, 0]]).frequencies.min()
    assert -5 < worst < -0.01
