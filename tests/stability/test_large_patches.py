"""Verdicts on patches of more than a hundred particles: sparse algebra against dense one, and what is left out is said."""

import numpy as np
import pytest

from magphonon import InversePower, MagneticRepulsion, lattices, verdict
from magphonon.stability import amplitude_shifts, frequency_shifts, verdicts
from magphonon.stability.buckling import critical_spacing, critical_support
from magphonon.stiffness import LinearSystem


def drawn(seed):
    """A patch of 200 to 600 freedoms with masses drawn, stable on its foundation."""
    rng = np.random.default_rng(seed)
    cell = getattr(lattices, rng.choice(['square', 'triangular', 'honeycomb', 'kagome']))(10.0, 1.0)
    patch = lattices.rectangle(cell, *rng.uniform(130, 180, 2))
    patch.set_masses(rng.uniform(0.5, 2.0, len(patch)))
    a = rng.uniform(2, 6)
    law = InversePower(0.3 * 10.0**a, a)
    patch.calc = MagneticRepulsion(patch, law, foundation=rng.uniform(1.0, 2.0) * 0.3)
    return patch, law


@pytest.mark.parametrize('seed', range(4))
def test_supports_of_a_large_patch(seed):
    """Dense algebra with the energy of magnets that obeys Laplace's equation, k_zz = -(phi'' + phi'/r) of each bond."""
    patch, law = drawn(seed)
    X, free = patch.positions[:, :2], patch.get_tags() == 0
    r = np.linalg.norm(X[:, None] - X, axis=2)
    i, j = np.nonzero((r > 0) & (r < 10.1))
    needed = {}
    for magnets in (True, False):
        k = law.dphi(r[i, j]) / r[i, j] + (law.d2phi(r[i, j]) if magnets else 0)
        D = np.zeros((len(X), len(X)))
        np.add.at(D, (i, j), -k if not magnets else k)
        np.add.at(D, (i, i), k if not magnets else -k)
        needed[magnets] = -np.linalg.eigvalsh(D[free][:, free])[0]
        assert critical_support(LinearSystem.of(patch), magnets)[0] == pytest.approx(needed[magnets], rel=1e-10)  # its digits
    judged = verdict(patch)
    assert (judged['supports'].wave, judged['supports'].central) == (pytest.approx(needed[True]), pytest.approx(needed[False]))
    assert needed[True] > 1.2 * needed[False]  # the control: another law out of the plane is seen


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(4))
def test_the_linear_amplitude_of_a_large_patch(seed, monkeypatch):
    """Modes and what follows them by factorisations with the diagonal as pivots, and by dense algebra."""
    patch, _ = drawn(seed)
    sparse = frequency_shifts(patch)
    monkeypatch.setattr(amplitude_shifts, 'DENSE', 10_000)
    dense = frequency_shifts(patch)
    assert sparse.omega == pytest.approx(dense.omega, rel=1e-9)
    assert sparse.curvature == pytest.approx(dense.curvature, rel=1e-5)  # mode shapes whose neighbours are close
    assert verdict(patch)['amplitude'] == pytest.approx(dense.amplitude(0.01), rel=1e-5)
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, 9.0), foundation=1.0)  # the control
    assert abs(frequency_shifts(patch).curvature / dense.curvature - 1).min() > 0.1


def test_what_is_not_judged_is_said(monkeypatch):
    """On each side of the number of freedoms up to which a spacing is searched for."""
    patch, _ = drawn(0)
    size = 2 * int((patch.get_tags() == 0).sum())
    monkeypatch.setattr(verdicts, 'SPACED', size)
    judged = verdict(patch)
    assert not judged.unjudged
    held = critical_spacing(LinearSystem.of(patch))
    assert judged['buckling'].spacing is None if held is None else judged['buckling'].spacing == pytest.approx(10.0 * held)
    monkeypatch.setattr(verdicts, 'SPACED', size - 1)
    judged = verdict(patch)
    assert judged.unjudged == ('the spacing at which the structure buckles',)
    assert 'Not computed for so many particles: the spacing at which the structure buckles.' in str(judged)
    assert judged['buckling'].spacing is None
    small = lattices.hexagon(lattices.triangular(10.0, 1.0), 30.0)
    small.calc = MagneticRepulsion(small, InversePower(1e3, 4.0), foundation=1.0)
    assert verdict(small).unjudged == ()
