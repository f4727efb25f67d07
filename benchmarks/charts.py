"""Error against cost, a panel for each question: `python benchmarks/charts.py [-o docs]` writes charts.png and charts.csv.

The panels of bands, bursts, responses and large motion are those of `python -m workflows speed_accuracy`; five more are measured
here: coming to rest, densities of states, fits of a law, the lowest modes of large cells by the accuracy of their factors, and
how much arithmetic an error needs.  Which method is the quickest to some errors is printed for
each panel, and stands at the foot of charts.csv.  The cost is CPU time, which other load on the machine stretches less than the
time on the wall; on two machines the order of the methods is the same, the times are not.
"""

import argparse
import os
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import process_time
from warnings import catch_warnings, simplefilter

os.environ['OMP_NUM_THREADS'] = '1'  # before numpy is loaded: all methods on one core

import numpy as np
from ase.optimize import FIRE, LBFGS
from scipy import sparse
from scipy.optimize import minimize
from scipy.sparse.linalg import LinearOperator, eigsh, lobpcg, spilu, splu, spsolve

from magphonon import DrivenVerlet, MagneticRepulsion, lattices, read_scene, relaxed
from magphonon.bands.density import lattice_density
from magphonon.dynamics.engine import highest_frequency
from magphonon.dynamics.splittings import SPLITTINGS, step_within
from magphonon.interactions import SharedErrors, fit_forces
from magphonon.interactions.force_tables import Forces
from magphonon.plotting.axes import letter_panels, panels, print_style
from magphonon.response import density_of_states
from magphonon.scenes import ready_scene
from magphonon.stiffness import LinearSystem
from magphonon.stiffness.lowest import lowest_eigenpairs
from workflows import accuracy, accuracy_bands, accuracy_frf, accuracy_nonlinear, accuracy_transient
from workflows.accuracy import Candidate, cheapest, looks_of, measure, panels_of, plot_work_precision, spoken, write_table
from workflows.rows import save_picture

accuracy.perf_counter = process_time
COLUMNS, WIDTH_in = 2, 8.5
TITLES = {'one magnet, 300 wavevectors': 'bands of one magnet, over the highest frequency',
          '144 magnets, 8 lowest branches, 3 wavevectors': 'lowest bands of 144 magnets',
          'N = 1024': 'a tone burst in 1024 magnets, after 200 ms',
          'N = 1024, 400 frequencies': '400 frequencies of 1024 magnets',
          f'Amplitude {accuracy_nonlinear.AMPLITUDES[1]:g} L0': '144 magnets plucked by 1 % of the spacing'}
"""What the panels of the workflows are called here; others of theirs are left out."""
STATED = 'what it states'
"""No method, but the standard error that a fit gives itself."""


def main():
    """Measure all, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('-o', '--out', type=Path, default=Path('docs'), help='folder of charts.png and charts.csv')
    out = parser.parse_args().out
    table = []
    for question in (accuracy_bands, accuracy_transient, accuracy_frf, accuracy_nonlinear):
        table += question.chart(True).measurements
    table = [replace(m, panel=TITLES[m.panel]) for m in table if m.panel in TITLES]
    for question in (coming_to_rest, densities, fits, large_cells, arithmetic):
        table += question()
        print(*(f'{m.panel}: {m.method}, {m.setting}: {m.error:.1e} in {m.seconds:.3g} s' for m in panels_of(table).popitem()[1]),
              sep='\n', flush=True)
    found = [f'{panel}: {reading(own)}' for panel, own in panels_of(table).items()]
    print(*found, sep='\n')
    write_table(out / 'charts.csv', table, ['CPU time in s; drawn by benchmarks/charts.py', *found])
    with print_style():
        save_picture(drawn(table), out / 'charts.png', 'Error against CPU time of each method that answers a question.')


def drawn(table):
    """A panel for each question, with its methods below."""
    tables = panels_of(table)
    figure, axes = panels(-(-len(tables) // COLUMNS), COLUMNS, width=WIDTH_in, height=3.6)
    for ax in axes.flat[len(tables):]:
        ax.remove()
    axes = axes.ravel()[:len(tables)]
    letter_panels(axes, list(tables))
    for ax, own in zip(axes, tables.values(), strict=True):
        floor = min(m.error for m in own if m.error) / 10  # where errors of zero are drawn
        plot_work_precision([replace(m, error=m.error or floor) for m in own], ax, looks_of(own))
        ax.set(xlabel='CPU time (s)', ylabel='error')
        if np.ptp(np.log10(ax.get_xlim())) > 1:
            ax.tick_params(axis='x', which='minor', labelbottom=False)  # they would cover each other
        ax.legend(loc='upper center', bbox_to_anchor=(0.5, -0.18), ncols=1)
    return figure


def reading(table):
    """The quickest methods to errors of 1e-2, 1e-5 and 1e-8, and how much longer one of another kind takes, in a sentence."""
    said, methods = {}, [m for m in table if not m.method.startswith(STATED)]
    for tolerance in (1e-2, 1e-5, 1e-8):
        if best := cheapest(methods, tolerance):
            kind = best.method.split(',')[0]
            other = cheapest([m for m in methods if m.method.split(',')[0] != kind], tolerance)
            beside = f' ({other.method} takes {spoken(other.seconds / best.seconds)} times as long)' if other else ' alone'
            said.setdefault(f'{best.method}{beside}', []).append(f'{tolerance:g}')
    return '; '.join(f'to {" and ".join(errors)} {words}' for words, errors in said.items()) or 'no method reaches 0.01'


def prototype(n):
    """A patch of n x n magnets of the prototype."""
    cell = read_scene(ready_scene('prototype')).atoms()
    patch = lattices.parallelogram(cell, n, n)
    patch.calc = MagneticRepulsion(patch, cell.calc.laws, **cell.calc.parameters)
    return cell, patch


def coming_to_rest(n=20):
    """Rest of a patch whose magnets differ by 10 %: largest error of a place over the largest shift."""
    cell, patch = prototype(n)
    strengths = np.random.default_rng(0).normal(1, 0.1, len(patch))
    patch.calc = MagneticRepulsion(patch, cell.calc.laws, strengths=strengths, foundation=0.1)
    start, free = patch.positions.copy(), np.repeat(patch.get_tags() == 0, 3) & np.tile([True, True, False], len(patch))
    names = {}

    def atoms():
        moving = patch.copy()
        moving.calc = patch.calc
        return moving

    def newton(steps, cost):
        moving = atoms()
        for _ in range(steps):
            step = np.zeros(len(free))
            H = moving.calc.get_hessian(moving).tocsc()[free][:, free]
            step[free] = spsolve(H, moving.get_forces(apply_constraint=False).ravel()[free])
            moving.positions += step.reshape(-1, 3)
        return moving.positions - start

    exact = newton(12, None)

    def ase(optimiser, fmax, cost):
        moving = atoms()
        run = optimiser(moving, logfile=None)
        run.run(fmax=fmax, steps=300)
        cost['force evaluations'] = run.nsteps
        return moving.positions - start

    def scipy(gtol, cost):
        moving = atoms()

        def energy(x):
            moving.positions.ravel()[free] = start.ravel()[free] + x
            return moving.get_potential_energy(), -moving.get_forces(apply_constraint=False).ravel()[free]

        found = minimize(energy, np.zeros(free.sum()), jac=True, method='L-BFGS-B',
                         options={'gtol': gtol, 'ftol': 0, 'maxiter': 300})
        cost['force evaluations'] = found.nfev
        return moving.positions - start

    def own(cost):
        return relaxed(atoms()).atoms.positions - start

    for fmax in (1e-3, 1e-5, 1e-7):
        names |= {('FIRE of ASE', fmax): partial(ase, FIRE, fmax), ('LBFGS of ASE', fmax): partial(ase, LBFGS, fmax),
                  ('L-BFGS-B of SciPy', fmax): partial(scipy, fmax)}
    names |= {('Newton, SuperLU', steps): partial(newton, steps) for steps in (1, 2, 3, 4)}
    names['relaxed', ''] = own
    panel = f'rest of {len(patch)} magnets, over the largest shift'
    runs = [Candidate(name, str(setting), run, panel) for (name, setting), run in names.items()]
    return measure(runs, lambda u: abs(u - exact).max() / abs(exact).max(), repeats=1)


def densities(n=24):
    """Share of modes below a frequency, of a patch whose magnets differ by 2 %: largest error at 20 frequencies."""
    cell, patch = prototype(n)
    strengths = np.random.default_rng(1).normal(1, 0.02, len(patch))
    patch.calc = MagneticRepulsion(patch, cell.calc.laws, strengths=strengths, **cell.calc.parameters).balanced(
        np.flatnonzero(patch.get_tags() == 0))
    omega = np.sqrt(np.linalg.eigvalsh(LinearSystem.of(patch).K.toarray()))
    at = np.linspace(1.02 * omega[0], 0.98 * omega[-1], 20)
    exact = np.searchsorted(omega, at) / len(omega)

    def below(found):
        steps = np.diff(found.omega) * (found.density[1:] + found.density[:-1]) / 2
        return np.interp(at, found.omega, np.append(0, np.cumsum(steps))) / found.modes

    def by_moments(moments, vectors, cost):
        cost['products'] = moments // 2 * vectors
        return below(density_of_states(patch, moments=moments, vectors=vectors))

    def dense(cost):
        cost['eigensolves'] = 1
        return np.searchsorted(np.sqrt(np.linalg.eigvalsh(LinearSystem.of(patch).K.toarray())), at) / len(omega)

    def endless(steps, cost):
        return below(lattice_density(cell, steps=steps))

    names = {('density_of_states, 8 vectors', f'{m} moments'): partial(by_moments, m, 8) for m in (32, 128, 512, 1024)}
    names |= {('density_of_states, 512 moments', f'{v} vectors'): partial(by_moments, 512, v) for v in (2, 8, 32)}
    names |= {('all eigenvalues, dense', ''): dense}
    names |= {('lattice_density of the perfect lattice', f'{s} steps'): partial(endless, s) for s in (8, 32, 128)}
    runs = [Candidate(*name, run, f'share of the modes of {n * n} magnets below 20 frequencies') for name, run in names.items()]
    return measure(runs, lambda share: abs(share - exact).max(), repeats=2, patience=0.3)


def fits(tables=8, spacing=10.0, shift=0.05, offset=5e-4, screened=12.0):
    """The exponent at 10 mm of `f = e^{-r/12 mm} r^-4` from tables whose rows share zeros of distance (0.05 mm) and of force.

    The error is the root mean square over tables that are drawn, relative to the exponent; that which a fit states is beside it.
    """
    exponent = 4 + spacing / screened

    def force(r):
        return (spacing / r) ** 4 * np.exp((spacing - r) / screened)

    def measured(rows, noise, seed):
        rng, r = np.random.default_rng(seed), np.linspace(8.0, 16.0, rows)
        f, zero = force(r + shift * rng.normal()), offset * rng.normal()
        return Forces(r, f * (1 + noise * rng.normal(size=rows)) + zero, noise * f)

    def own(stated, rows, noise, cost):
        found = [fit_forces(measured(rows, noise, seed), spacing, SharedErrors(distance=shift)) for seed in range(tables)]
        return [exponent + fit.half_widths[2] / 1.96 if stated else fit.exponent for fit in found]

    def line(rows, noise, cost):
        found = [measured(rows, noise, seed) for seed in range(tables)]
        return [-np.polyfit(np.log(table.r), np.log(abs(table.f)), 1)[0] for table in found]

    kinds = ('fit_forces', partial(own, False)), (STATED, partial(own, True)), ('line through logarithms', line)
    names = {(f'{name}, noise {noise:.1%}', f'{rows} rows'): partial(fit, rows, noise)
             for name, fit in kinds for noise in (0.03, 0.003) for rows in (8, 32, 128, 512)}
    runs = [Candidate(*name, run, f'exponent of a law from {tables} tables of forces') for name, run in names.items()]
    return measure(runs, lambda a: np.sqrt(np.mean((np.array(a) / exponent - 1) ** 2)), repeats=1)


def large_cells(side=32, count=8):
    """The lowest squared frequencies of 1024 magnets whose masses scatter, by factors of more and less accuracy."""
    cell, _ = prototype(4)
    large = cell.repeat((side, side, 1))
    large.set_masses(large.get_masses() * (1 + 0.1 * np.random.default_rng(0).normal(size=len(large))))
    large.calc = MagneticRepulsion(large, cell.calc.laws, **cell.calc.parameters)
    K = sparse.csc_array(LinearSystem.of(large).K)
    start = np.random.default_rng(1).normal(size=(K.shape[0], count))
    exact = np.linalg.eigvalsh(K.toarray())[:count]

    def inverted(real, tolerance, cost):
        factors = splu(K.astype(real))

        def solve(x):
            cost['products'] += 1
            return factors.solve(x.astype(real)).astype(float)

        return np.sort(eigsh(K, count, sigma=0.0, OPinv=LinearOperator(K.shape, solve, dtype=float), tol=tolerance,
                             v0=start[:, 0], return_eigenvectors=False))

    def incomplete(drop, cost):
        factors = spilu(K, drop_tol=drop, fill_factor=30)
        with catch_warnings():
            simplefilter('ignore')  # it tells that it was stopped
            return np.sort(lobpcg(K, start.copy(), M=LinearOperator(K.shape, factors.solve, matmat=factors.solve), largest=False,
                                  tol=1e-9, maxiter=12)[0])

    names = {('lowest_eigenpairs', ''): lambda cost: lowest_eigenpairs(sparse.csr_array(K), count)[0],
             ('all eigenvalues, dense', ''): lambda cost: np.linalg.eigvalsh(K.toarray())[:count]}
    names |= {('ARPACK, exact factors', f'tol {t:g}'): partial(inverted, np.float64, t) for t in (1e-1, 1e-3, 0.0)}
    names |= {('ARPACK, factors in single precision', f'tol {t:g}'): partial(inverted, np.float32, t) for t in (1e-1, 1e-3, 1e-6)}
    names |= {('LOBPCG, incomplete factors', f'drop {d:g}'): partial(incomplete, d) for d in (1e-1, 1e-2, 1e-4)}
    panel = f'{count} lowest squared frequencies of a cell of {side**2} magnets'
    runs = [Candidate(*name, run, panel) for name, run in names.items()]
    return measure(runs, lambda squares: abs(squares / exact - 1).max(), repeats=2, patience=1.0)


def arithmetic(n=100, duration=60.0, amplitude=0.01):
    """The plucked patch of large motion with 10 000 magnets: what steps, coefficients and precision an error needs."""
    patch = accuracy_nonlinear.patch_of(n)
    pluck = accuracy_nonlinear.Pluck(patch, amplitude)
    top = highest_frequency(patch)

    def run(dt, order, tolerance, cost):
        atoms = patch.copy()
        atoms.calc = patch.calc
        atoms.positions[:, :2] += pluck.start
        steps = int(np.ceil(duration / dt))
        cost['force evaluations'] = steps * SPLITTINGS[order].stages
        dyn = DrivenVerlet(atoms, duration / steps, engine='compiled', order=order, threads=1, tolerance=tolerance)
        dyn.run(steps)
        return dyn.displacements

    exact = run(0.4 / top, 6, None, {})
    names = {}
    for tolerance in (1e-2, 1e-4, 1e-6):
        dt, order = step_within(tolerance, top, duration, duration)
        names |= {('with that tolerance', tolerance): partial(run, dt, order, tolerance),
                  ('the same steps, exact arithmetic', tolerance): partial(run, dt, order, None)}
    names |= {('velocity Verlet, exact arithmetic', share): partial(run, share * 2 / top, 2, None) for share in (0.4, 0.1)}
    runs = [Candidate(name, str(setting), one, f'{n * n} magnets plucked by {amplitude:.0%}: arithmetic')
            for (name, setting), one in names.items()]
    return measure(runs, lambda u: abs(u - exact).max() / abs(exact).max(), repeats=2, patience=1.0)


if __name__ == '__main__':
    main()
