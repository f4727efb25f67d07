"""Eigenvalues of Hermitian matrices of two rows, against their formula in numbers of 70 digits."""

from decimal import Decimal, localcontext

import numpy as np
import pytest

from magphonon.stiffness.matrices import hermitian_eigenvalues

EPS = np.finfo(float).eps
DRAWN = 150


def to_round_off(D):
    """Eigenvalues, ascending, as Decimals."""
    with localcontext() as context:
        context.prec, context.Emin = 70, -100000
        a, c, x, y = (Decimal(float(part)) for part in (D[0, 0].real, D[1, 1].real, D[1, 0].real, D[1, 0].imag))
        half = ((a - c) ** 2 + 4 * (x * x + y * y)).sqrt() / 2
        return (a + c) / 2 - half, (a + c) / 2 + half


def matrices(a, c, b):
    D = np.empty((DRAWN, 2, 2), dtype=complex)
    D[:, 0, 0], D[:, 1, 1], D[:, 1, 0], D[:, 0, 1] = a, c, b, np.conj(b)
    return D


def drawn(case):
    rng = np.random.default_rng(17)
    a, (x, y) = 1 + rng.uniform(size=DRAWN), rng.normal(size=(2, DRAWN))
    small, b = 10.0 ** rng.uniform(-18, -3, DRAWN), x + 1j * y
    return {'any': lambda: matrices(rng.normal(size=DRAWN), rng.normal(size=DRAWN), b),
            'degenerate': lambda: matrices(a, a * (1 + small), small * b),
            'soft': lambda: matrices(x * x, y * y, x * y),
            'soft beside stiff': lambda: matrices(a, small, 0.3 * np.sqrt(small) * b / abs(b)),
            'opposite': lambda: matrices(a, -a, small * b),
            'zero': lambda: matrices(0, 0, 0),
            'minute': lambda: 1e-300 * matrices(x, y, b)}[case]()


def largest_error(found, D):
    """Largest error as a fraction of the largest eigenvalue of the matrix."""
    exact = [to_round_off(each) for each in D]
    return max(float(max(abs(Decimal(float(value)) - true) for value, true in zip(values, trues, strict=True))
                     / (max(map(abs, trues)) or 1)) for values, trues in zip(found, exact, strict=True))


@pytest.mark.parametrize('case', ['any', 'degenerate', 'soft', 'soft beside stiff', 'opposite', 'zero', 'minute'])
def test_the_closed_form_is_exact_to_a_few_roundings(case):
    D = drawn(case)
    found = hermitian_eigenvalues(D)
    assert (np.diff(found, axis=1) >= 0).all()
    assert largest_error(found, D) < 4 * EPS  # some six roundings, each of half of EPS; measured: at most 1.9


def test_a_soft_mode_beside_a_stiff_one_keeps_its_figures():
    D = drawn('soft beside stiff')
    exact = np.array([float(to_round_off(each)[0]) for each in D])
    # The determinant cancels by less than a tenth, so that roundings stay roundings; LAPACK itself is off by 9 EPS.
    assert (abs(hermitian_eigenvalues(D)[:, 0] - exact) < 16 * EPS * exact).all()
    # the control: the mean minus half of the distance has no figure right
    a, c, b = D[:, 0, 0].real, D[:, 1, 1].real, abs(D[:, 1, 0])
    assert (abs((a + c) / 2 - np.hypot(a - c, 2 * b) / 2 - exact) > 0.5 * exact).sum() > DRAWN / 20


def test_larger_matrices_are_those_of_lapack():
    D = np.random.default_rng(3).normal(size=(5, 4, 3, 3))
    D = D + D.swapaxes(-1, -2)
    assert np.array_equal(hermitian_eigenvalues(D), np.linalg.eigvalsh(D))
