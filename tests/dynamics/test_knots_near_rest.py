"""A slope of the force that jumps near rest, at a knot of a table: an integral of the slope goes wrong past it."""

import numpy as np
import pytest

from magphonon.dynamics.bond_increments import DEGREE, SMALL, Increments, octave_piece, pieces
from magphonon.dynamics.cages import BROKEN_BOND, CONTACT
from magphonon.interactions import Tabulated

REST = 10.0


class Broken:
    """A force of straight lines between its knots."""

    def __init__(self, r, f):
        self.r, self.f, self.slopes = r, f, np.diff(f) / np.diff(r)

    def dphi(self, r):
        return -np.interp(r, self.r, self.f)

    def d2phi(self, r):
        return -self.slopes[np.clip(np.searchsorted(self.r, r) - 1, 0, len(self.slopes) - 1)]


def drawn(seed):
    """A law with knots at some 0.0003 to 0.03 of the length from rest, and the generator that drew it."""
    rng = np.random.default_rng(seed)
    near = REST * (1 + rng.choice([-1, 1], 4) * 10 ** rng.uniform(-3.5, -1.6, 4))
    r = np.sort(np.concatenate([[0.5, 60], near, rng.uniform(1, 40, 20)]))
    f = np.sort(250 / (r + 5) ** 3 * rng.uniform(0.98, 1.02, len(r)))[::-1]
    law = (Broken if rng.random() < 0.5 else Tabulated)(r, f)
    return Increments(law, str(rng.choice(['complete', 'conventional'])), np.array([REST])), rng


def difference(law, e):
    """H(e) as the difference of two forces."""
    r = law.length(e, REST)
    f, f0 = -law.potential.dphi(r), -law.potential.dphi(REST)
    return f / r - f0 / REST if law.model == 'complete' else (f - f0) / REST


def allowed(law, H, e):
    """1e-12 of the force and of what the stiffness at rest would give; the rounding of two forces and lengths."""
    stiffness = abs(law.slope(0.0, REST))
    return 1e-12 * (abs(H) + abs(e) * stiffness) + 1e-14 * (stiffness - law.potential.dphi(REST) / REST)


def integral(law, e):
    x, weights = np.polynomial.legendre.leggauss(12)
    return e * (weights / 2 @ law.slope((x[:, None] + 1) / 2 * e, REST))


@pytest.mark.filterwarnings('ignore:the readings at')  # knots are drawn close together on purpose, and their exponents at random
@pytest.mark.parametrize('seed', range(2, 8))
def test_past_a_knot_near_rest_the_forces_are_still_those_of_the_law(seed):
    law, rng = drawn(seed)  # seed 1 needs too many pieces, and is left to the law itself
    piece = pieces(law, 0, CONTACT, BROKEN_BOND)
    e = rng.choice([-1, 1], 4000) * 10 ** rng.uniform(-5, np.log10(SMALL), 4000)
    w = 1 + piece.per_increment * e
    n = octave_piece(w) - piece.first
    while (piece.child[n] >= 0).any():
        n = np.where(piece.child[n] < 0, n, piece.child[n] + (w >= piece.centre[n]))
    H = e * sum(piece.coefficients[n, k] * (w - piece.centre[n]) ** k for k in range(DEGREE + 1))
    expected = difference(law, e)
    limit = allowed(law, expected, e)
    assert (abs(H - expected) < limit).all()
    assert (abs(law.exact(e, REST) - expected) < limit).all()
    assert (abs(integral(law, e) - expected) > 10 * limit).any()  # the control
