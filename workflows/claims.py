"""The paper's statements about D*: when it vanishes, that it acts at any amplitude, and the error of frozen bond directions."""

import numpy as np
from ase import Atoms
from ase.calculators.calculator import all_changes
from scipy import sparse
from scipy.sparse.linalg import spsolve

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, analytic_bands, lattices, read_scene, units
from magphonon.dynamics import Recorder
from magphonon.interactions import Spring
from magphonon.plotting.axes import COLOURS, legend_of_set, letter_panels, panels
from magphonon.response.frf import harmonic_response
from magphonon.scenes import ready_scene, reference
from magphonon.waves.wave_source import burst_setup

from .oscillator import oscillator
from .rows import BRANCHES, Check, Outcome, Reported, pairs, save_picture

LAW = InversePower(b=1e4 * units.N * units.m**4, a=4.0)
L0, MASS = 1 * units.m, 1 * units.kg
AMPLITUDES = (1e-10, 1e-6, 1e-4)       # in L0; above, the frequency follows the square of the amplitude
VISIBLE = 1e-2                         # in L0: where it does so visibly
LOOPS = np.array([1e-3, 2e-3, 4e-3])   # in L0, radii of the loop around which the literal force does work
STEPS_PER_PERIOD, PERIODS = 40, 10
DRAWN = 50
FREE = 3                               # the oscillator's free particle among its four
BEAM = 4**4                            # bending stiffness of a beam 1/4 inch across over that of a pillar of 1/16 inch


class OnlyMagnitude(MagneticRepulsion):
    """The paper's words "only the magnitude is updated", taken literally: the force -phi'(|R + du|) n along the bond at rest.

    It is no gradient of an energy.
    """

    def calculate(self, atoms=None, properties=('forces',), system_changes=all_changes):
        """Compute the forces only, for particles without foundation, with their dead load."""
        super().calculate(atoms, ['forces'], system_changes)
        R, C = self.bond_vectors, self.bonds.incidence
        r = np.linalg.norm(R + C @ self.displacements(atoms), axis=1)
        push = -C.T @ ((self.law.dphi(r) / self.bonds.lengths)[:, None] * R)
        self.results = {'forces': self.load + np.pad(push, ((0, 0), (0, 1)))}


def main(out):
    """Each claim as numbers, each with a wrong model that must fail it."""
    paper = reference()['triangular']
    checks = [*without_static_force(), *never_hardens(), *at_every_amplitude(paper), *literal_update(paper), *loop_work()]
    beams, picture = elastic_rim(out)
    return Outcome([*checks, *beams], [picture])


def without_static_force():
    """Springs at their natural length carry no static force: both models agree, until the springs are compressed."""
    def at_M(length, model):
        cell = lattices.triangular(L0, MASS)
        cell.calc = MagneticRepulsion(cell, Spring(1.0, length))
        return analytic_bands(cell, cell.cell.bandpath('M', npoints=1, pbc=cell.pbc), model).omega[0]

    free = np.sqrt([2 / MASS, 6 / MASS])  # shear and longitudinal at M, of springs of 1 N/mm
    compressed = 'these springs compressed by 10 %, shear at M, complete / D0 alone'
    ratio = at_M(1.1 * L0, 'complete')[0] / at_M(1.1 * L0, 'conventional')[0]
    return [*pairs("springs without static force (phi' = 0), M, complete model", at_M(L0, 'complete') / free, (1, 1), 1e-12,
                   BRANCHES),
            Check(f'{compressed}, sqrt((2 - 6/10)/2)', ratio, 0.7**0.5, 1e-12),
            Check(f'control: {compressed}', ratio, 1, 0.05, control='D0')]


def never_hardens():
    """D*(k) of random cells has no positive eigenvalue, because repulsive laws have phi' < 0; with springs that pull it has."""
    def largest(law, rng):
        cell = Atoms('H2', cell=np.eye(3) + rng.normal(0, 0.15, (3, 3)) * np.outer([1, 1, 0], [1, 1, 0]),
                     scaled_positions=[(0, 0, 0), (0.5, *rng.uniform(0.3, 0.7, 1), 0)], pbc=(True, True, False))
        cell.calc = MagneticRepulsion(cell, law, cutoff=rng.uniform(1.1, 2.2))
        q = np.pad(rng.uniform(-0.5, 0.5, (8, 2)), ((0, 0), (0, 1)))
        complete, D0 = (cell.calc.bloch_matrix(q, model) for model in ('complete', 'conventional'))
        return np.linalg.eigvalsh(complete - D0).max() / abs(D0).max()

    what = f'largest eigenvalue of D*(k) / largest entry of D0(k), {DRAWN} drawn cells'
    repulsive = [largest(InversePower(1e-3, rng.uniform(0.5, 8)), rng) for rng in map(np.random.default_rng, range(DRAWN))]
    pulling = [largest(Spring(1.0, 0.1), rng) for rng in map(np.random.default_rng, range(DRAWN))]
    return [Check(f'{what}, repulsive laws', max(0, *repulsive), 0, 1e-12),
            Check(f'control: {what}, for springs that pull (smallest value)', min(pulling), 0, 1e-3, control='springs that pull')]


def frequency_at_M(model, amplitude):
    """Frequency in rad/s of the standing shear wave at M that starts at rest with this amplitude (in L0), from time steps."""
    patch = lattices.triangular(L0, MASS).repeat((1, 2, 1))
    patch.calc = OnlyMagnitude(patch, LAW) if model == 'literal' else MagneticRepulsion(patch, LAW, model=model)
    pattern = np.exp(2j * np.pi * patch.get_scaled_positions() @ (0, 1, 0)).real[:, None] * shear_at_M(patch)
    patch.positions[:, :2] += amplitude * L0 * pattern
    top = np.sqrt(6 * LAW.a * -LAW.dphi(L0) / (L0 * MASS))
    dyn = DrivenVerlet(patch, 2 * np.pi / top / STEPS_PER_PERIOD)
    recorder = Recorder(dyn, interval=1)
    dyn.run(2 * PERIODS * STEPS_PER_PERIOD)
    q = np.einsum('tix,ix->t', recorder.displacements, pattern)
    falls = np.flatnonzero((q[:-1] > 0) & (q[1:] <= 0))
    times = [crossing(q[k - 1:k + 3], recorder.times[k - 1:k + 3]) for k in falls]
    omega = 2 * np.pi * (len(times) - 1) / (times[-1] - times[0])
    return 2 / dyn.dt * np.sin(omega * dyn.dt / 2) / (units.rad / units.s)  # of the equation, not of its time steps


def shear_at_M(patch):
    """Unit vector along which the shear wave at M moves: along the rows that slide over each other."""
    across = patch.cell.reciprocal().array[1, :2]
    return np.array([-across[1], across[0]]) / np.linalg.norm(across)


def crossing(q, t):
    """Time at which the cubic through four samples is zero."""
    roots = np.roots(np.polyfit(t - t[1], q, 3))
    real = roots[abs(roots.imag) < 1e-9 * (t[1] - t[0])].real
    return t[1] + real[abs(real - (t[2] - t[1]) / 2).argmin()]


def at_every_amplitude(paper):
    """D* halves the shear frequency at M however small the motion: its effect does not need large displacements."""
    rows = []
    for A in AMPLITUDES:
        complete, conventional = (frequency_at_M(model, A) for model in ('complete', 'conventional'))
        at = f'M shear in time at an amplitude of {A:g} L0'
        rows += [Check(f'{at} (rad/s)', complete, paper['M_complete'][0], 1e-6),
                 Check(f'{at}, complete / D0 alone', complete / conventional, 0.5, 1e-6),
                 Check(f'control: {at}, D0 alone (rad/s)', conventional, paper['M_complete'][0], 0.4, control='D0')]
    return [*rows, Reported(f'M shear in time at an amplitude of {VISIBLE:g} L0 (rad/s), and of small motion',
                            frequency_at_M('complete', VISIBLE), paper['M_complete'][0])]


def literal_update(paper):
    """In time steps that update "only the magnitude" of the force, the frequency is that of D0 alone."""
    here = frequency_at_M('literal', AMPLITUDES[1])
    what = 'M shear in time, only the magnitude updated'
    return [Check(f'{what}, against D0 alone (rad/s)', here, paper['M_conventional'][0], 1e-6),
            Check('control: M shear in time, only the magnitude updated, against D0 + D* (rad/s)',
                  here, paper['M_complete'][0], 0.4, control='only the magnitude updated')]


def loop_work():
    """Work of the oscillator's force around a small loop: the force taken literally is not conservative, the others are.

    In a whole lattice, and in a loop about the rest position, symmetry makes the work zero; this loop passes through rest.
    """
    def work(model, radius, points=64):
        atoms, total = oscillator(np.pi / 4, 'complete' if model == 'literal' else model), 0.0
        if model == 'literal':
            atoms.calc = OnlyMagnitude(atoms, LAW, bonds=atoms.calc.bonds, load=atoms.calc.load)
        atoms.set_constraint()
        rest = atoms.get_positions()
        for t in 2 * np.pi * np.arange(points) / points:
            atoms.positions[FREE] = rest[FREE] + radius * L0 * np.array([1 + np.cos(t), np.sin(t), 0])
            along = np.array([-np.sin(t), np.cos(t), 0]) * radius * L0 * 2 * np.pi / points
            total += atoms.get_forces()[FREE] @ along
        return total

    def scaled(model):
        return abs(np.array([work(model, radius) for radius in LOOPS])) / (-LAW.dphi(L0) * L0 * LOOPS**3)

    literal = abs(np.array([work('literal', radius) for radius in LOOPS]))
    power = np.polyfit(np.log(LOOPS), np.log(literal), 1)[0]
    what = 'work around a loop of radius u / (f L0 (u/L0)^3)'
    return [Check(f'{what}, complete model', scaled('complete').max(), 0, 1e-6),
            Check('work around this loop, D0 alone with projected lengths', scaled('conventional').max(), 0, 1e-6),
            Check('control: work around this loop, only the magnitude updated', scaled('literal').max(), 0, 1e-6,
                  control='only the magnitude updated'),
            Check('power of the radius in the work, if only the magnitude of the force is updated', power, 3, 0.02)]


def elastic_rim(out):
    """The prototype's rim on beams of 1/4 inch, which bend, instead of an ideally held rim: the change along the measured row."""
    scene = read_scene(ready_scene('prototype'))
    patch = scene.patch_atoms()
    where = burst_setup(scene.atoms(), patch, scene.burst.source)
    damping = 4 / units.s
    omega = 2 * np.pi * np.array(scene.burst.carriers_Hz) * units.Hz
    push = np.zeros((len(patch), 3), complex)
    push[where.driven, 1] = 1e-4 * units.N
    held = harmonic_response(patch, push, omega, damping).response[:, where.row, :2]
    bent, sag = on_beams(patch, push, omega, damping)
    bent = bent[:, where.row]
    off = abs(bent - held).max(axis=(1, 2)) / abs(held).max(axis=(1, 2))
    figure, axes = panels(2, 2, height=1.6)
    letter_panels(axes, [f'{carrier:g} Hz' for carrier in scene.burst.carriers_Hz])
    x = np.arange(len(where.row))
    for ax, a, b in zip(axes.flat, held, bent, strict=True):
        ax.semilogy(x, abs(a[:, 1]) / units.m * 1e6, '-', color=COLOURS[0], label='rim held')
        ax.semilogy(x, abs(b[:, 1]) / units.m * 1e6, 'o', color=COLOURS[1], fillstyle='none', label='rim on beams of 1/4 inch')
        ax.set(xlabel='steps along the measured row', ylabel='amplitude (µm)', ylim=(3e-3, 2))
        ax.label_outer()
    legend_of_set(figure)
    return [Reported('rim on beams: how far static repulsion bends the beams (mm), and the spacing', sag / units.mm, 10),
            *(Reported(f'rim on beams: change along the measured row at {carrier:g} Hz / largest amplitude', change)
              for carrier, change in zip(scene.burst.carriers_Hz, off, strict=True))], \
        save_picture(figure, out / 'elastic_rim.png', (
            'The prototype with a rigidly held rim, as everywhere else here, and with a rim on elastic beams of 1/4 inch. A beam '
            f'is {BEAM} times as stiff as a pillar; static repulsion bends it outwards by {sag / units.mm:.2g} mm.'))


def on_beams(patch, push, omega, damping):
    """Steady displacements in mm, shape (frequencies, particles, 2), and the displacement of the rim at rest in mm."""
    calc, free = patch.calc, patch.copy()
    rim = np.unique(np.concatenate([constraint.index for constraint in patch.constraints]))
    free.set_constraint()
    free.calc = calc
    plane = (3 * np.arange(len(patch))[:, None] + np.arange(2)).ravel()
    extra = np.zeros((len(patch), 2))
    extra[rim] = (BEAM - 1) * calc.parameters.foundation
    beams = sparse.diags_array(extra.ravel())
    for _ in range(20):  # Newton's method for the rest state on beams
        u = free.positions[:, :2] - patch.positions[:, :2]
        residual = free.get_forces()[:, :2] - extra * u
        K = sparse.csr_array(free.calc.get_hessian(free))[plane][:, plane] + beams
        step = spsolve(K.tocsc(), residual.ravel()).reshape(-1, 2)
        free.positions[:, :2] += step
        if abs(step).max() < 1e-12 * L0:
            break
    K = sparse.csr_array(free.calc.get_hessian(free))[plane][:, plane] + beams
    M = sparse.diags_array(np.repeat(patch.get_masses(), 2))
    answer = [spsolve((K + (1j * damping * w - w**2) * M).tocsc(), push[:, :2].ravel()).reshape(-1, 2) for w in omega]
    return np.array(answer), np.linalg.norm(free.positions - patch.positions, axis=1)[rim].max()
