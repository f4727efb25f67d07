"""What a time step costs: `python benchmarks/steps.py [PARTICLES ...]`, OMP_NUM_THREADS=1 for steady numbers.

The paper's magnets on a triangular patch with a held rim, undriven, through `DrivenVerlet.run` with an observer every
ten steps: ASE's loop with a plain standard calculator, magphonon's three engines, and LAMMPS where it is installed.
All run in turns, the least of several rounds counts.  The error is that of the displacements after 100 steps, by the
largest one; the reference is the NumPy kernel with the law itself instead of polynomials.  Before that, what one core may do at
best.

Targets on one core: compiled blocks on a patch 10 times as fast as LAMMPS from 10 000 particles on and 5 times at 1000,
NumPy blocks twice from 10 000 on; on any topology compiled twice from 10 000 on; compiled at 1000 particles 50 times as
fast as ASE's loop with the plain calculator.
"""

import sys
from contextlib import ExitStack
from time import perf_counter, thread_time

import numpy as np
from ase.calculators.calculator import Calculator, all_changes
from ase.md.verlet import VelocityVerlet
from lammps_steps import STYLES, lammps_stepper

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices, units as u
from magphonon.dynamics.bond_increments import RANGES

LAW = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
FOUNDATION = 19.6757 * u.N / u.m
DT = 0.1 * u.ms
SIZES = (10, 32, 100, 316, 1000)
ROUNDS, SECONDS = 5, 0.2
ASE_LARGEST = 100_000


class PlainRepulsion(Calculator):
    """What one would write first: absolute positions, a list of pairs, the law as it stands."""

    implemented_properties = ('energy', 'forces')

    def __init__(self, atoms, calc):
        super().__init__()
        self.rest, self.i, self.j = atoms.get_positions(), calc.bonds.i, calc.bonds.j

    def calculate(self, atoms=None, properties=('energy',), system_changes=all_changes):
        super().calculate(atoms, properties, system_changes)
        x = self.atoms.positions
        bond = x[self.j] - x[self.i]
        r = np.linalg.norm(bond, axis=1)
        pull = -(LAW.dphi(r) / r)[:, None] * bond
        displacement = x - self.rest
        forces = -FOUNDATION * displacement
        for k in range(2):
            forces[:, k] += np.bincount(self.j, pull[:, k], len(x)) - np.bincount(self.i, pull[:, k], len(x))
        self.results = {'energy': LAW.phi(r).sum() + FOUNDATION * (displacement**2).sum() / 2, 'forces': forces}


def patch(n):
    """`n x n` magnets and their random displacements, a thousandth of the spacing."""
    atoms = lattices.parallelogram(lattices.triangular(10 * u.mm, 0.707 * u.g), n, n)
    return atoms, _displaced(atoms)


def arbitrary(n):
    """The same with one magnet in thirty missing, in any order, and nothing that tells where it came from.

    The vacancies would draw their neighbours in: a foundation a hundred times as stiff leaves these in place.
    """
    atoms, _ = patch(n)
    atoms = atoms[np.random.default_rng(3).permutation(len(atoms))[len(atoms) // 30 :]]
    atoms.set_array('site', None)
    return atoms, _displaced(atoms)


def _displaced(atoms):
    displacements = np.zeros((len(atoms), 3))
    displacements[:, :2] = 1e-2 * np.random.default_rng(1).standard_normal((len(atoms), 2))
    return displacements * (atoms.get_tags() != lattices.RIM)[:, None]


def moving(atoms, displacements, foundation=FOUNDATION):
    """A copy that starts from the displacements."""
    copy = atoms.copy()
    copy.calc = MagneticRepulsion(atoms, LAW, foundation=foundation)
    copy.positions += displacements
    return copy


def blocks(engine, *start):
    """`seconds(steps)` of an engine, and the displacements after its first 100 steps."""
    dyn = DrivenVerlet(moving(*start), DT, engine=engine)
    dyn.attach(lambda: None, 10)
    return _stepper(dyn, lambda: dyn.displacements)


def plain(*start):
    """The same of ASE's VelocityVerlet with the plain calculator."""
    atoms = moving(*start)
    rest, calc = atoms.calc.reference, atoms.calc
    atoms.calc = PlainRepulsion(rest, calc)
    dyn = VelocityVerlet(atoms, DT)
    dyn.attach(lambda: None, 10)
    return _stepper(dyn, lambda: (atoms.positions - rest.positions)[:, :2])


def _stepper(dyn, displacements):
    dyn.run(100)

    def seconds(steps):
        start = perf_counter()
        dyn.run(steps)
        return perf_counter() - start

    return seconds, displacements()


def exact(*start):
    """Displacements after 100 steps by the law itself."""
    dyn = DrivenVerlet(moving(*start), DT, engine='numpy')
    dyn.run(0)
    dyn._blocks._fit(len(RANGES))
    dyn.run(100)
    return dyn.displacements


def lammps(stack, atoms, displacements, foundation):
    """The same of both styles of LAMMPS, if it is installed."""
    at_rest = atoms.copy()
    at_rest.calc = MagneticRepulsion(atoms, LAW, foundation=foundation)
    try:
        return {f'LAMMPS {style}': stack.enter_context(lammps_stepper(at_rest, DT, displacements, style)) for style in STYLES}
    except ImportError:
        return {}


def compare(title, candidates, count):
    """Run the candidates in turns and print a line for each; `candidates` is name -> (seconds(steps), error)."""
    def seconds(work, steps):  # of this thread, which other users of the machine do not lengthen
        start = thread_time()
        work(steps)
        return thread_time() - start

    best, steps = {}, {}
    for name, (work, _) in candidates.items():
        steps[name] = 10 * max(1, round(SECONDS / (10 * seconds(work, 20) / 20 + 1e-9)))
    for _ in range(ROUNDS):
        for name, (work, _) in candidates.items():
            best[name] = min(best.get(name, np.inf), seconds(work, steps[name]) / steps[name])
    fastest = min((t for name, t in best.items() if name.startswith('LAMMPS')), default=np.nan)
    for name, (_, error) in candidates.items():
        print(f'{title:10s} {count:8d}  {name:22s} {best[name] / count * 1e9:9.2f} ns  {fastest / best[name]:7.2f} x LAMMPS'
              f'   error {error:.0e}', flush=True)


def apart(a, b):
    """Largest difference by the largest entry."""
    return abs(a - b).max() / abs(b).max()


def measure(title, make, n, engines):
    """All candidates on one structure."""
    atoms, displacements = make(n)
    start = atoms, displacements, FOUNDATION if make is patch else 100 * FOUNDATION
    reference = exact(*start)
    candidates = {}
    if len(atoms) <= ASE_LARGEST and make is patch:
        candidates['ASE, plain calculator'] = plain(*start)
    for engine in engines:
        if engine != 'ase' or len(atoms) <= ASE_LARGEST:
            candidates[f'magphonon {engine}'] = blocks(engine, *start)
    with ExitStack() as stack:
        candidates |= lammps(stack, *start)
        compare(title, {name: (seconds, apart(end, reference)) for name, (seconds, end) in candidates.items()}, len(atoms))


def roofline():
    """Print bandwidth of memory and rate of multiply-adds of one core; operations per second."""
    from numba import njit

    from magphonon.dynamics.kernels_numba import vectorise

    @njit(fastmath={'contract'}, error_model='numpy')
    def multiply_add(x, rounds):
        vectorise()
        for _ in range(rounds):
            for k in range(len(x)):
                a = b = c = d = x[k]
                for _ in range(16):
                    a, b, c, d = a * 0.9 + 0.1, b * 0.8 + 0.1, c * 0.7 + 0.1, d * 0.6 + 0.1
                x[k] = a + b + c + d

    a, x = np.ones(2**25), np.ones(1024)
    b = np.empty_like(a)
    multiply_add(x, 1)
    copy, fma = [], []
    for _ in range(ROUNDS):
        start = thread_time()
        b[:] = a
        middle = thread_time()
        multiply_add(x, 3000)
        copy.append(middle - start)
        fma.append(thread_time() - middle)
    bandwidth, rate = 2 * a.nbytes / min(copy) / 1e9, 2 * 64 * 3000 * 1024 / min(fma) / 1e9
    # a step reads and writes u and v and reads d^2 and the push; its 3 bonds take 44 operations each, the motion 20
    print(f'roofline: {bandwidth:.0f} GB/s and {rate:.0f} GFLOP/s of one core allow a particle-step in '
          f'{80 / bandwidth:.1f} ns (from memory) and {152 / rate:.1f} ns (in registers)')
    return 1e9 * rate


if __name__ == '__main__':
    sizes = [round(float(count) ** 0.5) for count in sys.argv[1:]] or SIZES
    roofline()
    for n in sizes:
        measure('patch', patch, n, ('ase', 'numpy', 'compiled'))
        if n * n >= 1000:
            measure('arbitrary', arbitrary, n, ('numpy', 'compiled'))
