"""How large a foundation the static forces ask for, against published thresholds and against the bands."""

import pytest
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, analytic_bands, foundation_needed, lattices


@pytest.mark.parametrize(('lattice', 'a', 'needed'), [
    # in units f(L0)/L0, nearest neighbours; triangular max(0, 2 (3 - a)), square and chain 4 whatever a
    ('triangular', 2.0, 2.0), ('triangular', 2.5, 1.0), ('triangular', 3.0, 0.0), ('triangular', 4.0, 0.0),
    ('square', 2.0, 4.0), ('square', 4.0, 4.0), ('chain', 4.0, 4.0),
])
def test_foundation_needed(lattice, a, needed):
    atoms = getattr(lattices, lattice)(2.0, 0.7)
    atoms.calc = MagneticRepulsion(atoms, InversePower(b=3.0, a=a), foundation=0.1)
    unit = 3.0 * 2.0**-a / 2.0
    assert_allclose(foundation_needed(atoms)[0], needed * unit, atol=1e-10 * unit)  # round-off is 1e-12 of the largest stiffness
    assert foundation_needed(atoms, model='conventional')[0] == 0.0  # the control: it hides every instability


@pytest.mark.parametrize('lattice', ['square', 'honeycomb', 'kagome'])
def test_foundation_needed_is_where_the_bands_touch_zero(lattice):
    atoms = getattr(lattices, lattice)(1.0, 1.0)
    law = InversePower(b=1.0, a=4.0)
    atoms.calc = MagneticRepulsion(atoms, law)
    needed, _ = foundation_needed(atoms)
    path = atoms.cell.bandpath('GMG' if lattice == 'kagome' else None, npoints=60, pbc=atoms.pbc)
    lowest = {}
    for share in (0.999, 1.001):
        atoms.calc = MagneticRepulsion(atoms, law, foundation=share * needed)
        lowest[share] = analytic_bands(atoms, path).omega.min()
    assert lowest[0.999] < 0 < lowest[1.001]
