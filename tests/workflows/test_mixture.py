"""The eigenvalues that the workflow `other_fields` quotes are those of matscipy's Hessian."""

import numpy as np
import pytest

from workflows.other_fields import BY_MATSCIPY, REACH, SIZES, mixture


@pytest.mark.peer
def test_quoted_eigenvalues_are_those_of_matscipy():
    peer = pytest.importorskip('matscipy.calculators.pair_potential')
    atoms, kinds = mixture(), (18, 36)
    atoms.numbers = np.take(kinds, atoms.get_tags())
    laws = {(kinds[i], kinds[j]): peer.calculator.LennardJonesCut(law.epsilon, law.sigma, REACH) for (i, j), law in SIZES.items()}
    known = np.linalg.eigvalsh(peer.PairPotential(laws).get_hessian(atoms).toarray())
    assert [known[n] for n in BY_MATSCIPY] == pytest.approx([*BY_MATSCIPY.values()], rel=1e-9)
    assert known[20] != pytest.approx(1.00001 * BY_MATSCIPY[20], rel=1e-9)
