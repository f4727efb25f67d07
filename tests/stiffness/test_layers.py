"""Motion out of the plane: nothing but D* and the supports act on it."""

import numpy as np
import pytest
from oracles import second_derivatives

from magphonon import InversePower, MagneticRepulsion, finite_displacements, lattices, phonopy_bands, units as u, verdict
from magphonon.bands import band_path, bloch_modes, sound_speeds
from magphonon.interactions import UprightMagnets, Yukawa
from magphonon.stability import frequency_shifts
from magphonon.stiffness import AllNeighbours, elastic_moduli

M, K = [0.5, 0, 0], [2 / 3, 1 / 3, 0]


@pytest.mark.parametrize(('kappa', 'at_M', 'at_K', 'gate'),
                         [(1.0, 6.988902886, 7.418527680, 4.1517), (3.0, 1.649228234, 1.815066641, 2.5276)])
def test_a_yukawa_crystal_with_all_neighbours_softens_as_known_and_touches_the_longitudinal_branch_at_its_gate(
        kappa, at_M, at_K, gate):
    """Numbers in units of Q^2/(4 pi eps0 m a^3), from a real-space sum to convergence by others."""
    atoms = lattices.triangular(1.0, 1.0)
    path = band_path(atoms, 'GMKG', 61)
    gaps = []
    for support in (gate - 1e-3, gate + 1e-3):
        atoms.calc = AllNeighbours(atoms, Yukawa(c=1.0, kappa=kappa), foundation=[[0, 0, support**2]])
        D = atoms.calc.bloch_matrix(np.array([M, K]))
        assert support**2 - D[:, 2, 2].real == pytest.approx([at_M, at_K], abs=1e-9)
        in_plane = np.linalg.eigvalsh(atoms.calc.bloch_matrix(path.kpts)[:, :2, :2])[:, 1]
        gaps.append((atoms.calc.bloch_matrix(path.kpts)[:, 2, 2].real - in_plane).min())
    assert gaps[0] < 0 < gaps[1]
    at = abs(path.kpts - path.special_points['M']).sum(axis=1).argmin()
    phonon = finite_displacements(atoms, (2, 2, 1))  # M fits the supercell
    assert phonopy_bands(phonon, path).omega[at] == pytest.approx(bloch_modes(atoms, path.kpts[at])[0][0], rel=1e-7)


def test_long_waves_out_of_the_plane_are_unstable_without_supports():
    atoms = lattices.triangular(10.0, 0.7)
    law = InversePower(6000.0, 4.0)
    atoms.calc = MagneticRepulsion(atoms, law, foundation=[[0, 0, 0]])
    # sum over bonds of k_zz (k.R)^2/2 = 3/2 k_zz L^2 k^2
    assert sound_speeds(atoms).min() == pytest.approx(-np.sqrt(1.5 * -law.dphi(10.0) * 10.0 / 0.7), rel=1e-9)


def test_upright_dipoles_have_the_stiffness_of_the_dipoles_energy():
    moment = 500 * u.A * u.mm**2
    c = u.mu0 * moment**2 / (4 * np.pi)

    def energy(d):
        R2 = (d * d).sum(axis=-1)
        return c * (R2**-1.5 - 3 * d[..., 2] ** 2 * R2**-2.5)

    H = second_derivatives(lambda x: energy(x + np.array([10.0, 0, 0])), np.zeros(3))
    law = InversePower.dipoles(moment)
    assert UprightMagnets(law).vertical(10.0) == pytest.approx(H[2, 2], rel=1e-11)
    assert law.dphi(10.0) / 10.0 == pytest.approx(H[2, 2] / 3, rel=1e-11)  # control: three times too weak


def test_moduli_in_the_plane_are_those_of_the_planar_lattice():
    law = InversePower(6000.0, 4.5824)
    planar, layer = lattices.honeycomb(10.0, 0.7), lattices.honeycomb(10.0, 0.7)
    planar.calc = MagneticRepulsion(planar, law, shells=2)
    layer.calc = MagneticRepulsion(layer, law, shells=2, foundation=[[0.0, 0.0, 3.0]])
    constants = elastic_moduli(planar).constants
    assert elastic_moduli(layer).constants[:2, :2, :2, :2] == pytest.approx(constants, rel=1e-10, abs=1e-14)
    layer.calc = MagneticRepulsion(layer, UprightMagnets(law), shells=2, foundation=[[0.0, 0.0, 3.0]])
    for tool in (elastic_moduli, frequency_shifts):
        with pytest.raises(ValueError, match='keep to motion in the plane'):
            tool(layer)
    layer.calc = layer.calc.in_plane()
    assert elastic_moduli(layer).constants == pytest.approx(constants, rel=1e-10, abs=1e-14)


@pytest.mark.parametrize(('support', 'holds'), [(9.0, True), (5.0, False)])
def test_gyration_about_the_normal_holds_nothing_out_of_the_plane(support, holds):
    cell = lattices.honeycomb(1.0, 1.0)
    for g in 0.0, 1.5:  # the supports must exceed 6 f/r of the three bonds, in both
        cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=[[6.0, 6.0, support]], gyration=g)
        judged = verdict(cell)
        assert judged['out_of_plane'].needed == pytest.approx(6.0, rel=1e-9)
        assert judged.fine == holds
    cell.calc.set(gyration=[[0.5, 0.0, 1.5]])  # it turns motion in the plane into such out of it
    assert verdict(cell).case.inside.held == holds
