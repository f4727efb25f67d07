"""The foundation that a lattice needs, over its spacing and the exponent of its law, is that of the lattice made anew."""

import numpy as np
import pytest

from magphonon import InversePower, MagneticRepulsion, Yukawa, critical_foundation, lattices
from magphonon.stability import stability_boundary, stability_boundary_of_exponents

LATTICES = ('chain', 'square', 'triangular', 'honeycomb', 'kagome')


def made(kind, spacing, law, shells=1, foundation=0.0):
    cell = getattr(lattices, kind)(spacing, 1.3)
    cell.calc = MagneticRepulsion(cell, law, shells=shells, foundation=foundation)
    return cell


@pytest.mark.parametrize('kind', LATTICES)
def test_over_spacings_it_is_that_of_the_lattice_of_this_spacing(kind):
    rng = np.random.default_rng(LATTICES.index(kind))
    spacing, shells, scales = rng.uniform(0.5, 20), int(rng.integers(1, 3)), np.sort(rng.uniform(0.6, 1.7, 2))
    law = Yukawa(rng.uniform(1, 9), rng.uniform(0.5, 2) / spacing)
    border = stability_boundary(made(kind, spacing, law, shells, foundation=rng.uniform(0, 1)), scales)
    anew = [critical_foundation(made(kind, scale * spacing, law, shells))[0] for scale in scales]
    # two meshes find the same minimum, each to about 1e-12 of the stiffest bond
    np.testing.assert_allclose(border.needed, anew, rtol=1e-9, atol=1e-9 * law.d2phi(0.6 * spacing))


@pytest.mark.parametrize('kind', LATTICES)
def test_over_exponents_it_is_that_of_a_law_with_the_same_force_at_the_spacing(kind):
    rng = np.random.default_rng(10 + LATTICES.index(kind))
    spacing, force, shells, exponents = rng.uniform(0.5, 20), rng.uniform(0.1, 5), 2, np.sort(rng.uniform(1.2, 9, 2))
    border = stability_boundary_of_exponents(made(kind, spacing, InversePower(force * spacing**3.0, 3.0), shells), exponents)
    anew = [critical_foundation(made(kind, spacing, InversePower(force * spacing**a, a), shells))[0] for a in exponents]
    np.testing.assert_allclose(border.needed[np.isin(border.at, exponents)], anew, rtol=1e-9, atol=1e-9 * 9 * force / spacing)


def test_a_triangular_lattice_needs_a_foundation_below_the_exponent_three():
    rng = np.random.default_rng(20)
    spacing, force = rng.uniform(0.5, 20), rng.uniform(0.1, 5)
    cell = made('triangular', spacing, InversePower(force * spacing**5.0, 5.0))
    border = stability_boundary_of_exponents(cell, [1.5, 2.9, 4.1])
    np.testing.assert_allclose(border.at, [1.5, 2.9, 3.0, 4.1], atol=2e-9)  # the interval of the search
    np.testing.assert_allclose(border.needed, np.array([3.0, 0.2, 0.0, 0.0]) * force / spacing, rtol=1e-9)  # 2 (3 - a) f/L at M


def test_a_law_without_an_exponent_is_refused():
    with pytest.raises(ValueError, match=r'Yukawa.* has no exponent to change; it must be an InversePower'):
        stability_boundary_of_exponents(made('square', 1.0, Yukawa(1.0, 1.0)), [2.0, 3.0])
