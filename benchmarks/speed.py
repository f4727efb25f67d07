"""What is fast, and by how much: `python benchmarks/speed.py [ROW ...]` measures and prints one table,
in the form of docs/measured.md.

A line is a job and its peer, run in turns in one process, of which the least time of several rounds counts; a peer that is
not installed is left out.  A line says what error the time bought.  A row that fails says so, and the others go on.
Seconds are those of the processor, which other users of the machine do not lengthen much; two threads are timed by the clock.
"""

import argparse
import ctypes
import os
import sys
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from tempfile import TemporaryDirectory
from time import perf_counter, process_time, thread_time

os.environ.setdefault('OMP_NUM_THREADS', '1')

import numpy as np
from matplotlib.ticker import EngFormatter
from numpy.polynomial.chebyshev import chebinterpolate
from scipy import sparse
from scipy.integrate import solve_ivp
from scipy.sparse.linalg import expm_multiply, splu

from magphonon import (
    DrivenVerlet,
    InversePower,
    MagneticRepulsion,
    analytic_bands,
    finite_displacements,
    frequency_response,
    lattices,
    modes,
    phonopy_bands,
    propagate,
    units as u,
)
from magphonon.bands import bloch_modes
from magphonon.dynamics.lammps import write_lammps_input
from magphonon.dynamics.splittings import SPLITTINGS
from magphonon.stiffness import LinearSystem
from magphonon.stiffness.factors import factorised as factors_of

sys.path.append(str(Path(__file__).parents[1] / 'tests'))
from lammps_session import lammps_session

LAW, FOUNDATION, DT = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824), 19.6757 * u.N / u.m, 0.1 * u.ms
ROUNDS, SECONDS = 7, 0.15
PATIENCE = 2.0
"""A job of more seconds is run once."""


@dataclass
class Result:
    """A line of the table: what a job and its peer take per unit of work, as a rule in seconds."""

    job: str
    peer: str
    taken: float
    by_peer: float
    error: float  # nan where the answer is the same

    @property
    def ratio(self):
        return self.by_peer / self.taken

    def __str__(self):
        """As a row of a table of docs/measured.md."""
        show, error = EngFormatter('s', places=1), '' if np.isnan(self.error) else f'{self.error:.0e}'
        return f'| {self.job} | {show(self.taken)} | {self.peer} | {show(self.by_peer)} | {self.ratio:.1f} | {error} |'


def in_turns(jobs, together=1, clock=thread_time):
    """The least seconds of each, per repeat; `jobs` is name -> function(repeats), of so many repeats `together`."""
    def seconds(job, repeats):
        start = clock()
        job(repeats)
        return (clock() - start) / repeats

    best = {name: seconds(job, 2 * together) if together > 1 else seconds(job, 1) for name, job in jobs.items()}
    repeats = {name: together * max(1, round(SECONDS / (together * best[name] + 1e-9))) for name in jobs}
    for _ in range(ROUNDS):
        for name, job in jobs.items():
            if best[name] * together < PATIENCE:
                best[name] = min(best[name], seconds(job, repeats[name]))
    return best


def answered(**jobs):
    """The least seconds of functions without arguments, on all the threads that they start, and what each of them returns."""
    answers = {}

    def repeat(name, repeats):
        for _ in range(repeats):
            answers[name] = jobs[name]()

    return in_turns({name: partial(repeat, name) for name in jobs}, clock=process_time), answers


def apart(a, b):
    """Largest difference by the largest entry."""
    return abs(a - b).max() / abs(b).max()


# --- time steps

def patch(n):
    """`n x n` magnets and their random displacements, a thousandth of the spacing."""
    atoms = lattices.parallelogram(lattices.triangular(10 * u.mm, 0.707 * u.g), n, n)
    return atoms, displaced(atoms)


def displaced(atoms):
    """Random displacements, none at the rim."""
    displacements = np.zeros((len(atoms), 3))
    displacements[:, :2] = 1e-2 * np.random.default_rng(1).standard_normal((len(atoms), 2))
    return displacements * (atoms.get_tags() != lattices.RIM)[:, None]


def disordered(n, off=0.02):
    """The patch in any order, magnets off their places by up to a fraction of the spacing."""
    atoms, _ = patch(n)
    rng = np.random.default_rng(5)
    atoms.positions[:, :2] += off * 10 * rng.uniform(-1, 1, (len(atoms), 2))
    atoms = atoms[rng.permutation(len(atoms))]
    atoms.set_array('site', None)
    return atoms, displaced(atoms)


def moving(atoms, displacements, foundation=FOUNDATION, cutoff=13.0):
    """A copy with bonds up to a distance, that starts from the displacements."""
    copy = atoms.copy()
    copy.calc = MagneticRepulsion(atoms, LAW, foundation=foundation, cutoff=cutoff)
    copy.positions += displacements
    return copy


def stepper(start, engine='compiled', threads=1, every=10):
    """`run(steps)` with an observer every so many steps, and the displacements after the first 100."""
    dyn = DrivenVerlet(moving(*start), DT, engine=engine, threads=threads if engine == 'compiled' else None)
    dyn.attach(lambda: None, every)
    dyn.run(100)
    return dyn.run, dyn.displacements


def exact(start, steps=100):
    """Displacements by ASE's loop, with the law itself instead of polynomials."""
    dyn = DrivenVerlet(moving(*start), DT, engine='ase')
    dyn.run(steps)
    return dyn.displacements


@contextmanager
def lammps_stepper(atoms, displacements, suffix, every, dt=DT):
    """LAMMPS at its fastest honest setting on one core: `run(steps)` that stops whenever an observer would look.

    A tabulated pair force with linear interpolation, foundation springs, a neighbour list that is built once, no output.
    Pairs within a cutoff take the place of bonds, which are right at any strain but take LAMMPS 1.5 times as long.  Its forces
    are checked first.
    """
    start = atoms.copy()
    start.positions += displacements
    expected = atoms.calc.get_forces(start)
    with TemporaryDirectory() as directory:
        write_lammps_input(directory, atoms, dt, steps=0, interpolation='linear', points=100_000)
        with_pairs(Path(directory, 'in.lammps'), atoms.calc.bonds.cutoff)
        with lammps_session(directory, *suffix) as lammps:
            x = start.positions.ravel()
            lammps.command('timer off')  # a tenth of the step of a hundred particles
            lammps.scatter_atoms('x', 1, 3, (ctypes.c_double * len(x))(*x))
            lammps.command('run 0 post no')
            forces = np.array(lammps.gather_atoms('f', 1, 3)).reshape(-1, 3)
            free = abs(displacements).any(axis=1)  # LAMMPS sums no forces between fixed particles
            error = apart(forces[free], expected[free])
            # a linear table of 100 000 points is good for 1e-8 of the forces of bonds, whose sum falls with the displacements
            if not error < 1e-7 * max(1, 0.04 / abs(displacements).max()):
                raise RuntimeError(f'LAMMPS {suffix} has forces of its own: they differ by {error:.1e} of the largest force')

            def run(steps):
                for _ in range(steps // every):
                    lammps.command(f'run {every} pre no post no')

            def moved(steps):
                """Displacements after some steps from the start at rest, and the seconds of the steps."""
                lammps.scatter_atoms('x', 1, 3, (ctypes.c_double * len(x))(*x))
                lammps.command('velocity all set 0 0 0')
                lammps.command('run 0 post no')
                begin = thread_time()
                lammps.command(f'run {steps} pre no post no')
                taken = thread_time() - begin
                return taken, np.array(lammps.gather_atoms('x', 1, 3)).reshape(-1, 3)[:, :2] - atoms.positions[:, :2]

            def split(steps, order):
                """The same by a splitting of the package around the forces of LAMMPS, which itself moves nothing."""
                lammps.command('unfix motion')
                method, h, count = SPLITTINGS[order], 100 * u.ms / steps, len(atoms)
                which = np.array(lammps.numpy.extract_atom('id'))[:count] - 1
                free = atoms.get_tags()[which] != lattices.RIM
                accelerate = (free / atoms.get_masses()[which])[:, None]
                places, v = lammps.numpy.extract_atom('x')[:count], np.zeros((count, 3))
                places[:] = start.positions[which]
                lammps.command('run 0 post no')
                places, forces = lammps.numpy.extract_atom('x')[:count], lammps.numpy.extract_atom('f')[:count]
                begin = thread_time()
                for _ in range(steps):
                    v += method.kicks[0] * h * accelerate * forces
                    for kick, drift in zip(method.kicks[1:], method.drifts, strict=True):
                        places += drift * h * v
                        lammps.command('run 1 pre no post no')
                        v += kick * h * accelerate * forces
                taken, end = thread_time() - begin, np.empty((count, 2))
                end[which] = places[:, :2]
                return taken, end - atoms.positions[:, :2]

            run.moved, run.split = moved, split
            run(100)
            yield run


def with_pairs(file, cutoff):
    """Let LAMMPS find pairs by their distance instead of by the list of bonds, which is right while none crosses the cutoff."""
    text = file.read_text()
    for old, new in (('lj/coul 0 1 1\nbond_style special', 'lj/coul 1 1 1\nbond_style zero nocoeff'),
                     ('LAW0', f'LAW0 {cutoff:.17g}'), ('neighbor 0 bin', f'neighbor {0.02 * cutoff:.17g} bin'),
                     ('exclude group all all', 'exclude group fixed fixed')):
        if text.count(old) != 1:
            raise RuntimeError(f'the input for LAMMPS has changed: {old!r} is not in it')
        text = text.replace(old, new)
    file.write_text(text)


def steps(job, start, every=10):
    """Compiled steps on one thread against the faster one of LAMMPS's styles."""
    atoms, displacements, _ = start
    run, end = stepper(start, every=every)
    jobs = {'magphonon': run}
    with ExitStack() as stack:
        at_rest = atoms.copy()
        at_rest.calc = moving(*start).calc
        try:  # the plain styles are the faster ones on small patches, their OPENMP versions, on one thread, on large ones
            for name, suffix in (('plain', ()), ('omp', ('-package', 'omp', '1', '-suffix', 'omp'))):
                jobs[f'LAMMPS {name}'] = stack.enter_context(lammps_stepper(at_rest, displacements, suffix, every))
        except ImportError:
            print(f'{job}: LAMMPS is not installed')
        best = in_turns(jobs, every)
    error, count, own = apart(end, exact(start)), len(atoms), best.pop('magphonon')
    if best:
        peer = min(best, key=best.get)
        yield Result(f'{job}, {count} magnets', peer, own / count, best[peer] / count, error)


def time_to_error(strain, n=100, duration=100 * u.ms):
    """(seconds, error) of runs with shorter and shorter steps, by method; `n x n` magnets, displaced at random up to a strain."""
    atoms, displacements = patch(n)
    start = moving(atoms, 0 * displacements)
    i, j = start.calc.bonds.i, start.calc.bonds.j
    displacements *= strain * 10 / abs(displacements[j] - displacements[i]).max()

    def run(method, steps):
        dyn = DrivenVerlet(moving(atoms, displacements), duration / steps, engine='compiled', threads=1,
                           order=int(method[6]), tolerance=1e-4 if 'tolerance' in method else None)
        rest = dyn.irun(steps)
        next(rest)  # what is made ready for the run
        begin = thread_time()
        for _ in rest:
            pass
        return thread_time() - begin, dyn.displacements

    exact, counts = run('order 6', 700)[1], {
        'order 2': (500, 1000, 2000, 5000, 10_000), 'order 4': (50, 65, 80, 120, 200), 'order 6': (32, 40, 50, 70, 100),
        SHORT: (32, 40, 50, 70, 100)}
    runs = [{(method, steps): run(method, steps) for method in counts for steps in counts[method]} for _ in range(3)]
    found = {method: [(min(each[method, steps][0] for each in runs), apart(runs[0][method, steps][1], exact)) for steps in own]
             for method, own in counts.items()}
    try:
        for steps in 500, 1000, 2000, 5000, 10_000:
            with lammps_stepper(start, displacements, (), 10, duration / steps) as stepper:
                runs = [stepper.moved(steps) for _ in range(2)]
            found.setdefault('LAMMPS', []).append((min(s for s, _ in runs), apart(runs[0][1], exact)))
        for steps in 36, 50, 70:
            with lammps_stepper(start, displacements, (), 10) as stepper:
                taken, moved = stepper.split(steps, 6)
            found.setdefault('LAMMPS, forces of order 6', []).append((taken, apart(moved, exact)))
    except ImportError:
        print('motion: LAMMPS is not installed')
    try:
        for steps in 32, 40, 50, 70:
            taken, moved = jax_steps(start, displacements, steps, duration / steps)
            found.setdefault('JAX on the grid, order 6', []).append((taken, apart(moved, exact)))
    except ImportError:
        print('motion: JAX is not installed')
    return found


def jax_steps(start, displacements, steps, dt, method=SPLITTINGS[6]):
    """Steps in single precision as an expert in JAX writes them: forces as increments on the grid, from shifted arrays.

    Returns the seconds of the steps and the displacements at the end.
    """
    import jax

    jnp, bonds, calc, count = jax.numpy, start.calc.bonds, start.calc, len(start)
    offsets, first = np.unique(bonds.j - bonds.i, return_index=True)
    reach, r0, f0 = int(offsets.max()), bonds.lengths.min(), -float(calc.laws.dphi(bonds.lengths.min()))
    x = np.linspace(-0.03, 0.03, 200)   # of r^2/r0^2 - 1; what a force over its distance gains there
    gain = np.polynomial.polynomial.polyfit(x, (-calc.laws.dphi(r0 * np.sqrt(1 + x)) / np.sqrt(1 + x) - f0) / r0 / x, 4)
    mobile = jnp.array((start.get_tags() != lattices.RIM) / start.get_masses(), jnp.float32)

    def force(u):
        wide, total = jnp.pad(u, ((0, 0), (reach, reach))), -float(calc.parameters.foundation) * u
        for offset, R in zip(offsets.tolist(), bonds.vectors[first, :2].tolist(), strict=True):
            du = wide[:, offset:offset + count + reach] - wide[:, :count + reach]  # of the bond from each site to its right
            strain = ((2 * R[0] + du[0]) * du[0] + (2 * R[1] + du[1]) * du[1]) / r0**2
            h = strain * sum(c * strain**k for k, c in enumerate(gain.tolist()))
            pull = jnp.stack([h * R[k] + (f0 / r0 + h) * du[k] for k in (0, 1)])
            total += pull[:, reach - offset:reach - offset + count] - pull[:, reach:reach + count]
        return total

    @jax.jit
    def run(u):
        def step(_, state):
            u, v = state
            for kick, drift in zip((2 * method.kicks[0], *method.kicks[1:-1]), method.drifts, strict=True):
                v += kick * dt * mobile * force(u)   # the last kick of a step and the first of the next are one
                u += drift * dt * v
            return u, v

        return jax.lax.fori_loop(0, steps, step, (u, -method.kicks[0] * dt * mobile * force(u)))[0]

    begin = jnp.array(displacements[:, :2].T, jnp.float32)
    run(begin).block_until_ready()
    spent = process_time()
    end = np.array(run(begin)).T
    return process_time() - spent, end


SHORT = 'order 6, tolerance 1e-4'


def threads():
    """Two threads against one; the error is whether any bit differs."""
    for n in 32, 100, 316, 1000:
        (one, at_one), (two, at_two) = stepper(patch(n)), stepper(patch(n), threads=2)
        best = in_turns({'one': one, 'two': two}, 10, perf_counter)
        yield Result(f'two threads, {n * n} magnets', 'one thread', best['two'] / n**2, best['one'] / n**2,
                     apart(at_two, at_one))


def sizes(sides=(32, 100, 316, 1000)):
    """Seconds for each magnet, beside those for a patch of a tenth of them, and the peak of memory up to here."""
    before = {}
    for n in sides:
        atoms, (run, _) = kicked(n * n), stepper(patch(n), every=100)
        force, row = middle_force(atoms)
        jobs = {'propagate': lambda atoms=atoms: propagate(atoms, [DURATION]),
                'one frequency': lambda atoms=atoms, a=(force, OMEGA[:1], GAMMA, row): frequency_response(atoms, *a),
                'modes(10)': lambda atoms=atoms: modes(atoms, 10), '100 steps': lambda run=run: run(100)}
        for job, function in jobs.items():
            taken = answered(own=function)[0]['own'] / n**2
            job_there = f'{job}, {n * n} magnets, {getrusage(RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB'
            yield Result(job_there, 'a tenth', taken, before.get(job, taken), np.nan)
            before[job] = taken


# --- bands

def cells(lattice=lattices.triangular, side=1, scatter=0.0):
    """The paper's magnets and pillars in side x side cells of a lattice; masses scatter by a fraction."""
    cell = lattice(10 * u.mm, 0.707 * u.g).repeat((side, side, 1))
    cell.set_masses(cell.get_masses() * (1 + scatter * np.random.default_rng(side).normal(size=len(cell))))
    cell.calc = MagneticRepulsion(cell, LAW, foundation=FOUNDATION)
    return cell


def bands():
    """A path of 300 wavevectors: from the atoms, and with the objects of both ready."""
    cell = cells()
    system, phonon = LinearSystem.of(cell), finite_displacements(cell)
    path = cell.cell.bandpath('GMKG', npoints=300, pbc=cell.pbc)
    best, found = answered(own=lambda: analytic_bands(cell, path).omega,
                           phonopy=lambda: phonopy_bands(finite_displacements(cell), path).omega,
                           ready=lambda: bloch_modes(system, path.kpts)[0], theirs=lambda: phonon.run_qpoints(path.kpts))
    error = apart(found['phonopy'], found['own'])
    for job, own, peer in ('from the atoms', 'own', 'phonopy'), ('objects ready', 'ready', 'theirs'):
        yield Result(f'300 wavevectors, {job}', f'phonopy, error {error:.0e}', best[own], best[peer],
                     apart(found['ready'], found['own']))


def large_cells(side, *others):
    """The eight lowest branches of cells of disorder at ten wavevectors, for each, against all of them and against phonopy."""
    cell = cells(side=side, scatter=0.1)
    path = cell.cell.bandpath('GMKG', npoints=10, pbc=cell.pbc)
    peers = {'dense': lambda: analytic_bands(cell, path), 'phonopy': lambda: phonopy_bands(finite_displacements(cell), path)}
    best, found = answered(own=lambda: analytic_bands(cell, path, branches=8), **{name: peers[name] for name in others})
    error = abs(found['own'].omega - found['dense'].omega[:, :8]).max() / found['dense'].omega.max()
    for name in others:
        yield Result(f'8 lowest branches of {len(cell)} magnets', f'{name}, all branches', best['own'] / 10, best[name] / 10,
                     error)


def mesh():
    """A million wavevectors, each, and phonopy's at some thousands of them."""
    for name in 'triangular', 'honeycomb':
        cell = cells(getattr(lattices, name))
        phonon = finite_displacements(cell, supercell=(3, 3, 1))
        q = np.random.default_rng(0).uniform(size=(10**6, 3)) * cell.pbc
        best, found = answered(own=lambda cell=cell, q=q: bloch_modes(cell, q)[0],
                               phonopy=lambda phonon=phonon, q=q: phonon.run_qpoints(q[:4000]).frequencies)
        own = found['own'][:4000]
        theirs = found['phonopy'] * 2 * np.pi / 1e3
        out_of_plane = np.argsort(abs(theirs), axis=1)[:, : len(cell)]  # which nothing holds
        np.put_along_axis(theirs, out_of_plane, np.inf, axis=1)
        theirs = np.sort(theirs, axis=1)[:, : own.shape[1]]
        yield Result(f'a mesh of 1e6 wavevectors, {name}', f'phonopy, error {apart(theirs, own):.0e}', best['own'] / 1e6,
                     best['phonopy'] / 4000, np.nan)


# --- linear tools, from the atoms to the answer

DURATION, KICK = 20 * u.ms, 1e-6
OMEGA, CHOSEN = 2 * np.pi * np.linspace(32, 143, 100) * u.Hz, 50
"""Of the response, within the bands; the answer at one of them is compared."""
GAMMA, BELOW = 20 / u.s, 2 * np.pi * 80 * u.Hz


def kicked(particles):
    """A patch with random momenta in g mm/ms; the motion is linear, so that their size does not matter."""
    side = round(np.sqrt(particles))
    atoms = lattices.parallelogram(lattices.triangular(10 * u.mm, 0.707 * u.g), side, side)
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=FOUNDATION)
    atoms.set_momenta(KICK * np.random.default_rng(0).normal(size=(len(atoms), 3)) * (1, 1, 0))
    return atoms


def first_order(atoms):
    """The system and `(y, v)` at the start, of `(y, v)' = (v, -K y)`."""
    system = LinearSystem.of(atoms)
    v = system.shapes.T @ atoms.get_momenta()[:, :2].ravel()
    return system, np.append(np.zeros_like(v), v)


def exponential(atoms):
    """All displacements at the end by SciPy."""
    system, start = first_order(atoms)
    A = sparse.block_array([[None, sparse.eye_array(len(start) // 2)], [-system.K, None]], format='csr')
    return system.shapes @ expm_multiply(A * DURATION, start, traceA=0.0)[: len(start) // 2]


def dop853(atoms, rtol=1e-10):
    """Steps of the order eight; the tolerance brings the error near to that of `propagate`."""
    system, start = first_order(atoms)
    size = len(start) // 2
    end = solve_ivp(lambda _, x: np.append(x[size:], -(system.K @ x[:size])), (0, DURATION), start, 'DOP853', [DURATION],
                    rtol=rtol, atol=rtol * abs(start).max())
    return system.shapes @ end.y[:size, 0]


def chebyshev(atoms):
    """The same by a dozen lines of SciPy: the series of `sin(t sqrt K)/sqrt K` in Chebyshev's polynomials."""
    system, start = first_order(atoms)
    v = start[len(start) // 2:]
    top = abs(system.K).sum(axis=1).max()  # Gershgorin
    X = sparse.csr_array(system.K * (2 / top) - sparse.eye_array(len(v)))
    c = chebinterpolate(lambda x: DURATION * np.sinc(DURATION * np.sqrt(top * (x + 1) / 2) / np.pi), 200)
    before, now = v, X @ v
    total = c[0] * before + c[1] * now
    for c_n in c[2:np.flatnonzero(abs(c) > 1e-13 * abs(c).max())[-1] + 1]:
        before, now = now, 2 * (X @ now) - before
        total += c_n * now
    return system.shapes @ total


def middle_force(atoms):
    """1 N on the magnet in the middle, and the row of ten that begins there."""
    side = round(np.sqrt(len(atoms)))
    middle = side // 2 * side + side // 2
    force = np.zeros((len(atoms), 3))
    force[middle, 1] = 1.0
    return force, middle + np.arange(10)


def factorised(atoms, refined=False):
    """The response by a sparse LU at one frequency."""
    system, (force, row), w = LinearSystem.of(atoms), middle_force(atoms), OMEGA[CHOSEN]
    source = system.shapes.T @ force[:, :2].ravel()
    D = sparse.csc_array(system.K + (1j * GAMMA * w - w**2) * sparse.eye_array(len(source)))
    lu = splu(D, 'MMD_AT_PLUS_A', diag_pivot_thresh=0.0, options={'SymmetricMode': True})  # pivots off the diagonal would fill it
    y = lu.solve(source + 0j)
    if refined:
        y += lu.solve(source - D @ y)
    return (system.shapes @ y).reshape(-1, 2)[row]


def linear_tools(particles):
    """Free motion after a kick and the response to a force, which is proved stable first, with what SciPy has for them."""
    atoms = kicked(particles)
    force, row = middle_force(atoms)
    best, found = answered(propagate=lambda: propagate(atoms, [DURATION]).displacements[0].ravel(),
                           expm_multiply=partial(exponential, atoms), DOP853=partial(dop853, atoms),
                           chebyshev=partial(chebyshev, atoms))
    reference, called = dop853(atoms, 1e-13), {'chebyshev': 'Chebyshev on CSR'}
    for peer in ('expm_multiply', 'DOP853', 'chebyshev'):
        beside = f'{called.get(peer, peer)}, error {apart(found[peer], reference):.0e}'
        yield Result(f'propagate, {len(atoms)} magnets', beside, best['propagate'], best[peer],
                     apart(found['propagate'], reference))
    best, found = answered(own=lambda: frequency_response(atoms, force, OMEGA, GAMMA, row, 1e-6).response[CHOSEN, :, :2],
                           LU=partial(factorised, atoms))
    reference = factorised(atoms, refined=True)
    yield Result(f'each of 100 frequencies, {len(atoms)} magnets', f'sparse LU, error {apart(found["LU"], reference):.0e}',
                 best['own'] / len(OMEGA), best['LU'], apart(found['own'], reference))


def factors(particles):
    """Factors of K, order of elimination included, by what is installed."""
    K = LinearSystem.of(kicked(particles)).K
    b = np.random.default_rng(0).normal(size=K.shape[0])
    jobs = {'own': lambda: factors_of(K, definite=True).solve(b), 'SuperLU': lambda: factors_of(K).solve(b)}
    try:
        from cvxopt import cholmod, matrix, spmatrix
    except ImportError:
        print('factors: CHOLMOD is not installed')
    else:
        lower = sparse.tril(K, format='coo')
        known = spmatrix(*(matrix(x) for x in (lower.data, lower.row.astype(int), lower.col.astype(int))), K.shape)

        def bare():
            factor, x = cholmod.symbolic(known, uplo='L'), matrix(b)
            cholmod.numeric(known, factor)
            cholmod.solve(factor, x)
            return np.array(x).ravel()

        jobs['CHOLMOD'] = bare
    best, found = answered(**jobs)
    for peer in 'CHOLMOD', 'SuperLU':
        if peer in best:
            error = apart(K @ found['own'], b)
            yield Result(f'sparse factors, {round(particles)} magnets', peer, best['own'], best[peer], error)


STIFF = 100 * FOUNDATION  # places off the lattice would draw their neighbours in
ROWS = {
    'patch 1e4': lambda: steps('patch', (*patch(100), FOUNDATION)),
    'patch 1e5': lambda: steps('patch', (*patch(316), FOUNDATION)),
    'seldom 1e4': lambda: steps('patch, looked at every 100 steps', (*patch(100), FOUNDATION), 100),
    'scattered 1e4': lambda: steps('2 % off their places', (*disordered(100), STIFF)),
    'threads': threads,
    'sizes': sizes,
    'bands': bands,
    'large cells': lambda: [*large_cells(17, 'dense', 'phonopy'), *large_cells(32, 'dense')],
    'mesh': mesh,
    'linear tools 1e4': lambda: linear_tools(1e4),
    'factors': lambda: [*factors(1e4), *factors(1e5)],
}


LONG = {'sizes'}
"""Rows that are measured only if they are named: the others take less than eight minutes together."""


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('rows', nargs='*', metavar='ROW',
                        help=f'of {", ".join(ROWS)}; by default all but {", ".join(sorted(LONG))}')
    options = parser.parse_args()
    if unknown := set(options.rows) - set(ROWS):
        parser.error(f'no row {", ".join(map(repr, unknown))}; there are {", ".join(ROWS)}')
    begin, failed = perf_counter(), []
    print('| job | takes | beside | takes | ratio | error |\n|---|---|---|---|---|---|')
    for name in options.rows or [row for row in ROWS if row not in LONG]:
        before = perf_counter()
        try:
            for result in ROWS[name]():
                print(result, flush=True)
        except Exception as error:  # whatever it is, the other rows can be measured
            failed.append(name)
            print(f'{name} failed: {type(error).__name__}: {error}', flush=True)
        print(f'{name}: {perf_counter() - before:.0f} s', file=sys.stderr)
    print(f'{perf_counter() - begin:.0f} s{"; failed: " + ", ".join(failed) if failed else ""}', file=sys.stderr)
    sys.exit(bool(failed))
