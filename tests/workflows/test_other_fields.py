"""Other fields: every row stands, and a wrong law fails the same rows."""

from itertools import combinations

import numpy as np
import pytest
from ase import Atoms

from magphonon import InversePower, lattices, relaxed
from magphonon.stiffness import PairCalculator
from workflows import other_fields


@pytest.mark.slow
def test_every_row_stands(tmp_path):
    assert [check.quantity for check in other_fields.main(tmp_path).checks if not check.passed] == []


@pytest.mark.parametrize('wrong', [InversePower(1.02, 2.0), InversePower(1.0, 2.1)])
def test_control_a_wrong_law_of_the_ions_fails(wrong, monkeypatch):
    monkeypatch.setattr(other_fields, 'CHARGES', wrong)
    failed = [row for row in other_fields._penning() if not row.checks[0].passed]
    assert len(failed) >= (1 if wrong.a == 2.0 else 3)  # frequencies in a trap do not know the charge, places do


@pytest.mark.peer
@pytest.mark.filterwarnings('ignore')  # of a program of 2015
def test_ions_in_a_penning_trap_beside_the_mode_code_of_nist(monkeypatch):
    """`mode_analysis_code.py` of github.com/nistpenning/calc on PYTHONPATH: drumhead modes, and the stiffness of its forces.

    Its own planar Hessian has dx^2 where dy^2 belongs, and is not that of its energy.
    """
    theirs = pytest.importorskip('mode_analysis_code')
    monkeypatch.setattr(np, 'mat', np.asmatrix, raising=False)  # which NumPy 2 took away
    code, n = theirs.ModeAnalysis(N=19), 19
    trap = code.wr * code.wc - code.wr**2 - 0.5
    ions = Atoms(f'H{n}', lattices.hexagon(lattices.triangular(2.5, 1.0), 5.0).positions, masses=np.ones(n))
    springs = [[trap + code.Cw, trap - code.Cw, 1.0]]  # in units of m wz^2, the charges' energy is 1/(2 r)
    ions.calc = PairCalculator(ions, InversePower(0.5, 2.0), bonds=[*combinations(range(n), 2)], foundation=springs,
                               anchors=np.zeros((n, 3)))
    ions = relaxed(ions).atoms
    at = ions.positions[:, :2].T.ravel()
    assert abs(code.force_penning(at)).max() < 1e-9
    H = ions.calc.rest_hessian().toarray().reshape(n, 3, n, 3)
    drum = np.sqrt(np.linalg.eigvalsh(H[:, 2, :, 2]))
    np.testing.assert_allclose(drum, np.sort(code.calc_axial_modes(at)[0]), rtol=1e-10)
    assert np.ptp(np.linalg.eigvalsh(ions.calc.rest_hessian('conventional').toarray().reshape(n, 3, n, 3)[:, 2, :, 2])) < 1e-9
    planar = H[:, :2, :, :2].transpose(1, 0, 3, 2).reshape(2 * n, 2 * n)
    steps = 1e-5 * np.eye(2 * n)
    slopes = np.array([(code.force_penning(at + step) - code.force_penning(at - step)) / 2e-5 for step in steps]) / 2
    np.testing.assert_allclose(planar, slopes, rtol=0, atol=1e-7 * abs(planar).max())
    assert abs(code.hessian_penning(at) / 2 - slopes).max() > 0.1 * abs(slopes).max()
