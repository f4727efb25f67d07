"""Impacts on structures whose rest needs a load or bent springs, against an energy written here.

A row between held ends, all motion along it: while two neighbours are held at a distance all others relax, and as the energy is
convex, there is one place for them.
"""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixedLine

from magphonon import InversePower, MagneticRepulsion, relaxed
from magphonon.dynamics.cages import BROKEN_BOND, CONTACT
from magphonon.stability import escape_speeds

N = 5


class Row:
    """Energy of a row in mJ: f = r^-a of nearest neighbours, springs k to the anchors, constant forces `load`."""

    def __init__(self, a, k, anchors, load):
        self.a, self.k, self.anchors, self.load = a, k, anchors, load

    def energy(self, x):
        return ((np.diff(x) ** (1 - self.a)).sum() / (self.a - 1) + self.k / 2 * ((x - self.anchors) ** 2).sum() - self.load @ x)

    def force(self, x):
        push = np.diff(x) ** -self.a
        return np.append(0, push) - np.append(push, 0) - self.k * (x - self.anchors) + self.load

    def hessian(self, x):
        each = self.a * np.diff(x) ** (-self.a - 1)
        K = self.k * np.eye(N)
        for b, stiffness in enumerate(each):
            K[b : b + 2, b : b + 2] += stiffness * np.array([[1, -1], [-1, 1]])
        return K

    def relaxed_at(self, i, j, d, rest):
        """The positions of least energy with the particles i and j at the distance d, by Newton's method; both ends are held."""
        P = np.eye(N)
        P[j] = P[i]  # the two move together
        P = np.delete(P, sorted({0, N - 1, j} | ({i} if j == N - 1 else set())), axis=1) if i else np.delete(
            np.eye(N), sorted({0, N - 1, j}), axis=1)
        first = rest[0] if i == 0 else rest[-1] - d if j == N - 1 else (rest[0] + rest[-1] - d) / 2
        x = np.interp(np.arange(N), [0, i, j, N - 1], [rest[0], first, first + d, rest[-1]])
        for _ in range(200):
            step = P @ np.linalg.solve(P.T @ self.hessian(x) @ P, P.T @ self.force(x))
            while (np.diff(x + step) <= 0).any() or self.energy(x + step) > self.energy(x) + 1e-12:
                step = step / 2
            x = x + step
            if abs(step).max() < 1e-9:
                break
        return x

    def barrier(self, rest):
        """The least energy that takes a bond to contact, breaks it, or brings two next neighbours as near as two neighbours."""
        lengths, least = np.diff(rest), np.inf
        ways = [(i, i + 1, share * lengths[i]) for i in range(N - 1) for share in (CONTACT, BROKEN_BOND)]
        for i, j, end in ways + [(i, i + 2, lengths.min()) for i in range(N - 2)]:
            climbed = [self.energy(self.relaxed_at(i, j, d, rest)) for d in np.linspace(rest[j] - rest[i], end, 9)[1:]]
            least = min(least, max(climbed) - self.energy(rest))
        return least


def drawn(seed):
    """A row at rest under a load, or on bent springs, and what it is made of."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(np.append(0, rng.uniform(0.85, 1.15, N - 1)))
    a, k, masses = rng.uniform(2, 5), rng.uniform(0.5, 3), rng.uniform(0.5, 2, N)
    masses[[0, -1]] = 0.4  # held, and not the heaviest
    atoms = Atoms(f'Nd{N}', np.column_stack([x, 0 * x, 0 * x]), masses=masses)
    atoms.set_constraint([FixAtoms([0, N - 1]), FixedLine(list(range(1, N - 1)), (1, 0, 0))])
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, a), bonds=[(i, i + 1) for i in range(N - 1)], foundation=k)
    if seed % 2:
        atoms = relaxed(atoms).atoms
        row = Row(a, k, x, np.zeros(N))
    else:
        atoms.calc = atoms.calc.balanced(range(1, N - 1))
        row = Row(a, k, x, 0 * x)
        row.load = -row.force(x)
    return atoms, row


def lost(atoms, row, particle, speed):
    """Whether a bond is lost after a shot, by a velocity Verlet written here."""
    x, v, masses = atoms.positions[:, 0].copy(), np.zeros(N), atoms.get_masses()
    rest, v[particle], dt = np.diff(x), speed, 0.002 / abs(speed)
    for _ in range(int(8 / abs(speed) / dt)):
        v[1:-1] += dt / 2 * (row.force(x) / masses)[1:-1]
        x += dt * v
        v[1:-1] += dt / 2 * (row.force(x) / masses)[1:-1]
        apart = np.diff(x)
        if (apart < CONTACT * rest).any() or (apart > BROKEN_BOND * rest).any() or (x[2:] - x[:-2]).min() < rest.min():
            return True
    return False


@pytest.mark.slow
@pytest.mark.parametrize('seed', [0, 1, 4, 5])
def test_impacts_on_a_row_that_a_load_or_bent_springs_hold(seed):
    """Control: the constant force of both with the other sign, as if it pushed the other way."""
    atoms, row = drawn(seed)
    x, masses = atoms.positions[:, 0], atoms.get_masses()
    assert abs(row.force(x)[1:-1]).max() < 1e-9
    escape, barrier = escape_speeds(atoms), row.barrier(x)
    assert escape.safe == pytest.approx(np.sqrt(2 * barrier / masses.max()), rel=2e-3)  # the drag ends within 5e-4 of a distance
    wrong = Row(row.a, row.k, x, row.k * (x - row.anchors) - row.load)
    assert escape.safe != pytest.approx(np.sqrt(2 * wrong.barrier(x) / masses.max()), rel=1e-2)
    for particle in range(1, N - 1):
        for sign in (-1, 1):
            assert not lost(atoms, row, particle, sign * 0.98 * np.sqrt(2 * barrier / masses[particle]))
    assert lost(atoms, row, escape.particle, 1.03 * escape.leaves * np.sign(escape.direction[0]))
