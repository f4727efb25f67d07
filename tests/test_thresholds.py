"""Both sides of every threshold of stability, placed by theory: buckling, the time step, finite differences.

Spacing, mass and static force are 1 (mm, g, N), so that stiffness is in units of f/L0.  Buckling is tested in the zone and by
the growth of a run; growth is compared with the imaginary frequency.
"""

import numpy as np
import pytest
from ase.constraints import FixAtoms
from structures import few_first

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, critical_foundation, lattices, units as u, verdict
from magphonon.bands import force_constants
from magphonon.bands.bloch import bloch_modes
from magphonon.bands.force_constants import finite_displacements, phonopy_bands
from magphonon.interactions import Yukawa

pytestmark = pytest.mark.filterwarnings('ignore:a damping of')  # on both sides of every threshold

GOLDEN = (1 + np.sqrt(5)) / 2

# Foundation needed in f/L0, and the cells in which the softest wave fits.  Chain and square: rows slide, every bond across
# turns by 2u, 4.  Honeycomb: at K no bond changes its length while the three bonds of a particle turn, 3.  Kagome: rigid
# triangles turn by theta against each other, -2 bonds theta^2/2 per particle that moves by theta/sqrt(3), 6.  Triangular: the
# shear wave at M feels 2 (a - 3).
LATTICES = {
    'chain': (4.0, 4.0, (2, 1, 1)),
    'square': (4.0, 4.0, (2, 1, 1)),
    'triangular': (2.0, 2.0, (2, 1, 1)),
    'honeycomb': (4.0, 3.0, (3, 3, 1)),
    'kagome': (4.0, 6.0, (1, 1, 1)),
}


def cell_of(name, law, foundation=0.0, model='complete', repeat=(1, 1, 1)):
    atoms = getattr(lattices, name)(1.0, 1.0).repeat(repeat)
    atoms.calc = MagneticRepulsion(atoms, law, foundation=foundation, model=model)
    return atoms


def logarithms(atoms, dt, steps, damping=0.0, start=None):
    """Logarithm of the size of the motion after each fifth of a run, over that of its tiny start, by default a random one."""
    start = np.random.default_rng(0).normal(size=(len(atoms), 2)) if start is None else start
    atoms.positions[:, :2] += 1e-10 * start
    dyn = DrivenVerlet(atoms, dt, damping=damping, engine='ase', allow_unstable=True)
    size = [np.linalg.norm(atoms.calc.displacements(atoms))]
    for _ in range(5):
        dyn.run(steps // 5)
        size.append(np.linalg.norm(dyn.displacements))
    return np.log(np.array(size) / size[0])


def growth(atoms, rate, dt=0.2):
    """Rate over the last two fifths of a run in which the fastest mode, if it has the `rate`, grows by e^15 and is alone."""
    steps = round(15 / rate / dt)
    log = logarithms(atoms, dt, steps)
    return 2 / dt * np.sinh((log[5] - log[3]) / (2 * (steps // 5)) / 2), log.max()  # of the equation, not of Verlet's steps


# Amplitudes of random starts beat; they do not pass this factor without growth.
BOUNDED = np.log(20)


# --- buckling --------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize(('a', 'stable'), [(2.99, False), (3.01, True)])
def test_triangular_holds_itself_above_a_of_3(a, stable):
    law = InversePower(1.0, a)
    assert critical_foundation(cell_of('triangular', law))[0] == pytest.approx(max(0.0, 2 * (3 - a)), abs=1e-10)
    expected = np.sqrt(2 * abs(3 - a))
    rate, largest = growth(cell_of('triangular', law, repeat=(2, 1, 1)), expected)
    if stable:
        assert largest < BOUNDED
    else:
        assert rate == pytest.approx(expected, rel=1e-4)
    # the control: without D* there is nothing to see
    assert growth(cell_of('triangular', law, model='conventional', repeat=(2, 1, 1)), expected)[1] < BOUNDED


@pytest.mark.parametrize('name', few_first(['triangular', 'honeycomb', 'chain', 'square', 'kagome'], 1))
@pytest.mark.parametrize('share', [0.99, 1.01])
def test_foundation_that_just_holds(name, share):
    a, needed, repeat = LATTICES[name]
    law = InversePower(1.0, a)
    assert critical_foundation(cell_of(name, law))[0] == pytest.approx(needed, rel=1e-12)
    square = share * needed - needed
    lowest = bloch_modes(cell_of(name, law, share * needed), [critical_foundation(cell_of(name, law))[1]])[0][0, 0]
    assert lowest * abs(lowest) == pytest.approx(square, rel=1e-9)
    expected = np.sqrt(abs(square))
    rate, largest = growth(cell_of(name, law, share * needed, repeat=repeat), expected)
    if share > 1:
        assert largest < BOUNDED
    else:
        assert rate == pytest.approx(expected, rel=1e-4)
    assert growth(cell_of(name, law, 0.0, 'conventional', repeat), expected)[1] < BOUNDED  # the control


@pytest.mark.parametrize(('share', 'stable'), [(0.999, False), (1.001, True)])
def test_screened_crystal_holds_itself_above_the_golden_ratio(share, stable):
    needed, _ = critical_foundation(cell_of('triangular', Yukawa(c=1.0, kappa=share * GOLDEN)))
    assert (needed == 0) == stable
    # at M the shear wave feels 2 (phi'' + 3 phi'/r) = 2 (kappa^2 - kappa - 1) e^-kappa
    kappa = share * GOLDEN
    assert needed == pytest.approx(max(0.0, -2 * (kappa**2 - kappa - 1) * np.exp(-kappa)), abs=1e-12)


def oscillator(theta0, model='complete'):
    atoms = lattices.oscillator(theta0, 1 * u.m, 1 * u.kg)
    atoms.calc = MagneticRepulsion(atoms, InversePower(1e4 * u.N * u.m**4, 4.0), bonds=lattices.OSCILLATOR_BONDS, model=model)
    atoms.calc = atoms.calc.balanced([3])
    return atoms


@pytest.mark.parametrize('engine', few_first(['ase', 'compiled'], 1))
def test_oscillator_at_a_right_angle_grows_as_its_imaginary_frequency(engine, paper):
    atoms, rate = oscillator(np.pi / 2), paper['oscillator']['growth_rate_at_pi_over_2'] / u.s
    atoms.positions[3, 0] = 1e-6 * u.mm
    dyn = DrivenVerlet(atoms, 0.1 * u.ms, engine=engine)
    x = []
    for _ in range(2):
        dyn.run(400)
        x.append(dyn.displacements[3, 0])
    # cosh(rate t) at 40 and 80 ms; sinh(r dt/2) = rate dt/2 is 1e-5 off, ASE's loop rounds x at 1e-13 of 1 m
    assert np.log(x[1] / x[0]) / (40 * u.ms) == pytest.approx(rate, rel=2e-5)
    assert x[0] > 100 * 1e-6


# --- the time step ---------------------------------------------------------------------------------------------------

@pytest.mark.parametrize('zeta', few_first([0.1, 0.0, 1.0, 5.0], 1))
@pytest.mark.parametrize(('model', 'k'), [('complete', 0.0), ('conventional', 0.0), ('complete', 3.0)])
def test_verlet_with_exact_damping_is_stable_up_to_omega_dt_of_2(model, k, zeta):
    # The top of the triangular bands is at M: (6a - 2) f/L0 with D*, 6a without; + k on a foundation.
    omega = np.sqrt(6 * 4.0 - 2 * (model == 'complete') + k)
    along = np.array([np.sqrt(3), -1]) / 2  # the wave at q = (1/2, 0) and its motion

    def log(omega_dt):
        atoms = cell_of('triangular', InversePower(1.0, 4.0), k, model, (2, 1, 1))
        return logarithms(atoms, omega_dt / omega, 250, 2 * zeta * omega, np.array([along, -along]))

    assert log(1.999).max() < 0.1
    # one step has the trace (1 + det)(1 - (omega dt)^2/2) and the determinant det = exp(-gamma dt)
    det = np.exp(-2 * zeta * 2.001)
    trace = (1 + det) * (1 - 2.001**2 / 2)
    expected = np.log(abs(np.roots([1, -trace, det])).max())
    over = log(2.001)
    assert (over[5] - over[3]) / 100 == pytest.approx(expected, rel=1e-3)  # where the smaller root has faded


# --- at rest ---------------------------------------------------------------------------------------------------------

def test_a_free_edge_is_pushed_by_root_three_times_the_force_of_a_bond():
    # a straight row of the triangular lattice lacks two bonds, at 60 and 120 degrees: 2 sin 60 = sqrt(3)
    strip = lattices.triangular(1.0, 1.0).repeat((6, 5, 1))
    strip.pbc = (1, 0, 0)
    strip.calc = MagneticRepulsion(strip, InversePower(1.0, 4.0))
    push = np.linalg.norm(strip.get_forces(), axis=1)
    y = strip.positions[:, 1]
    edge = (y == y.min()) | (y == y.max())
    np.testing.assert_allclose(push[edge], np.sqrt(3), rtol=1e-12)
    np.testing.assert_allclose(push[~edge], 0, atol=1e-12)
    # both sides of it in the verdict: with the edge held there is rest
    assert verdict(strip)['residual'] == pytest.approx(np.sqrt(3), rel=1e-12)
    strip.set_constraint(FixAtoms(mask=edge))
    assert verdict(strip)['residual'] == 0


# --- finite differences ----------------------------------------------------------------------------------------------

def differences_at_m(d, a=4.0):
    """Shear stiffness at M in f/L0 from central differences of six bond forces, written down apart.

    phonopy displaces along both lattice vectors, and takes the Hermitian part of the Bloch matrix.
    """
    angle = np.pi / 3 * np.arange(6)
    R = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    K = [(pull(R - d * along, a) - pull(R + d * along, a)) / (2 * d) for along in R[:2]]
    K = np.stack(K, axis=2) @ np.linalg.inv(R[:2].T)
    odd = np.round(R @ np.linalg.inv(R[:2])[:, 0]) % 2 == 1  # neighbours that move against the particle, q = (1/2, 0)
    D = 2 * K[odd].sum(axis=0)
    return np.linalg.eigvalsh((D + D.T) / 2)[0]


def pull(R, a):
    return R / np.linalg.norm(R, axis=1)[:, None] ** (a + 1)


@pytest.mark.parametrize(('d', 'stable'), [(1e-3, True), (0.28, True), (0.287, False), (0.5, False)])
def test_too_large_a_displacement_makes_a_stable_lattice_look_unstable(d, stable, monkeypatch):
    # the shear stiffness at M, truly 2 (a - 3) = 2, crosses zero at a displacement of 0.28343 spacings
    monkeypatch.setattr(force_constants, '_checked_distance', lambda distance, shortest: distance)  # which refuses all above 0.1
    monkeypatch.setattr('magphonon.stiffness.sites.OUT_OF_PLANE', 1.0)  # phonopy displaces along z too
    cell = cell_of('triangular', InversePower(1.0, 4.0))
    phonon = finite_displacements(cell, distance=d)
    lowest = shear_at_m(phonon, cell)
    assert lowest == pytest.approx(differences_at_m(d), rel=1e-9)
    assert (lowest > 0) == stable


@pytest.mark.parametrize('L0', few_first([1.0, 3.0, 10.0], 1))
@pytest.mark.parametrize(('name', 'repeat'), [('square', (1, 1, 1)), ('square', (2, 2, 1)), ('honeycomb', (1, 1, 1)),
                                              ('honeycomb', (2, 1, 1)), ('kagome', (1, 1, 1)), ('kagome', (2, 1, 1))])
def test_just_what_is_needed_is_the_verge(name, repeat, L0):
    """At 4, 3 and 6 f/L0; the controls: a little less buckles, a little more is stable."""
    needed = LATTICES[name][1]
    for factor in (1.0, 1 + 1e-8, 1 - 1e-8):
        atoms = getattr(lattices, name)(L0, 1.0).repeat(repeat)
        atoms.calc = MagneticRepulsion(atoms, InversePower(L0**2, 2.0), foundation=factor * needed / L0)
        judged = verdict(atoms)
        assert judged.stable == (factor > 1)
        assert judged.case.unstable == (factor < 1)
        assert (judged.case.inside.growth > 0) == (factor < 1)
        if factor == 1:
            assert judged['buckling'].verge
            assert 'on the verge of buckling in the plane' in judged.finding('buckling').words
            assert str(judged).startswith('NOT OK')
            assert 'nan' not in str(judged)


@pytest.mark.parametrize('repeat', few_first([1, 2, 3], 2))
@pytest.mark.parametrize(('a', 'stable', 'grows'), [(3.0, False, False), (3.01, True, False), (2.99, False, True)])
def test_waves_that_cost_nothing_without_a_foundation_are_the_verge(a, stable, grows, repeat):
    """Rows of a triangular lattice slide at no cost where a = 3: the stiffness against shear goes as (a - 3) f/L0."""
    atoms = lattices.triangular(2.0, 1.0).repeat((repeat, repeat, 1))
    atoms.calc = MagneticRepulsion(atoms, InversePower(2.0**a, a))
    judged = verdict(atoms)
    assert (judged.stable, judged.case.unstable) == (stable, grows)
    assert ('no energy, because the static forces cancel' in judged.finding('buckling').words) == (a == 3)
    atoms.calc.set(foundation=1e-3 if a == 3 else 0.0)
    assert verdict(atoms).stable == (a >= 3)


def shear_at_m(phonon, cell):
    omega = phonopy_bands(phonon, cell.cell.bandpath('M', npoints=1, pbc=cell.pbc)).omega[0, 0]
    return omega * abs(omega)
