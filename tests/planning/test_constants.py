"""The numbers of the planner that are measured or chosen: a factor of three in any of them is seen here or beside it."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import golden

from magphonon import InversePower, MagneticRepulsion, ToneBurst, lattices, read_scene, ready_scene
from magphonon.bands.bloch import bloch_modes
from magphonon.dynamics.engine import highest_frequency
from magphonon.planning import bands, peak, plan, scene, waveform
from magphonon.planning.bands import Edge, neighbour_shells, plan_bands
from magphonon.planning.peak import highest_peak, plan_peak
from magphonon.planning.plan import Method, Plan, Settings
from magphonon.planning.waveform import as_model, difference, plan_waveform, strip
from magphonon.response.frf import Place
from magphonon.response.propagation import propagate
from magphonon.scenes.scene import scene_of
from workflows.situations import Beam, Waveform

LAW = InversePower(1.0, 4.0)


class Bare:
    """A law of which no sum over all neighbours is known."""

    def __init__(self, law):
        self.phi, self.dphi, self.d2phi = law.phi, law.dphi, law.d2phi


def lattice(kind, law=LAW, foundation=0.0):
    cell = getattr(lattices, kind)(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, law, foundation=foundation)
    return cell


def path(cell, points='GMKG', npoints=60):
    return cell.cell.bandpath(points, npoints=npoints, pbc=cell.pbc)


# --- bands -----------------------------------------------------------------------------------------------------------

@pytest.fixture(scope='module')
def tight():
    """The cell and the plan for which no sum is good enough."""
    cell = lattice('triangular', InversePower(1.0, 2.0), 2.0)
    return cell, plan_bands(cell, path(cell), 1e-9)


def test_a_loose_plan_looks_at_few_neighbours_and_a_tight_one_as_far_as_sums_are_cheap(tight):
    """Rows at 3 spacings, six times as far in a chain; the last reach is one where a sum costs more than the exact one."""
    cell, chain = lattice('triangular', foundation=2.0), lattice('chain', foundation=8.0)
    assert 'with neighbours to 3 spacings' in plan_bands(cell, path(cell), 0.9).evidence[0]
    assert 'with neighbours to 19 spacings' in plan_bands(chain, path(chain, 'GX'), 0.9).evidence[0]
    *_, longest, exact = tight[1].methods
    assert exact.cost < longest.cost < 4 * exact.cost  # not twice as far as that


def test_the_shells_of_successive_methods_cost_a_fifth_more(tight):
    costs = np.array([m.cost for m in tight[1].methods if m.settings.model == 'complete' and m.settings.shells != 'all'])
    ratios = costs[10:] / costs[9:-1]  # below ten, one shell more is a larger part
    assert 1.1 < np.median(ratios) < 1.3


def test_the_exact_sum_costs_as_much_as_the_bonds_that_take_its_time(tight):
    """By the processor's time of the bands at 60 wavevectors: 1042 to 2713 bonds a particle in three lattices and two reaches."""
    cell, found = tight
    bonds = np.cumsum([len(shell) for shell in neighbour_shells(cell, bands.REACHES[-1])])
    cheaper = [m.settings.shells for m in found.methods if m.settings.shells != 'all' and m.cost < found.methods[-1].cost]
    assert 1042 < bonds[max(cheaper) - 1] < 2713


def test_wavevectors_stand_near_the_ends_of_a_leg():
    cell = lattice('triangular')
    leg = path(cell, 'GM', 301)
    looked = np.linalg.norm(bands._looked_at(leg), axis=1) / np.linalg.norm(leg.kpts[-1])
    inside = looked[(looked > 0) & (looked < 1)]
    assert 0.02 < inside.min() < 0.05
    assert 0.02 < 1 - inside.max() < 0.05
    assert np.diff(looked).max() < 0.3


def test_an_edge_that_is_the_root_of_a_rounded_eigenvalue_has_no_plan():
    """Sliding modes of the honeycomb: a spring of 1e-12 of the largest stiffness is known to some 1e-4, one of 1e-13 to 1e-3."""
    top = bloch_modes(lattice('honeycomb'), np.zeros((1, 3)))[0].max()
    for share, good in ((2e-6, True), (5e-7, False)):
        cell = lattice('honeycomb', foundation=(share * top) ** 2)
        edge = Edge('sliding', np.zeros(3), 0)
        if good:
            assert plan_bands(cell, path(cell), 0.5, edge).methods
        else:
            with pytest.raises(ValueError, match='zero or imaginary'):
                plan_bands(cell, path(cell), 0.5, edge)


def test_the_reference_may_lack_a_quarter_of_the_tolerance():
    cell = lattice('triangular', Bare(LAW), 2.0)
    lacking = plan_bands(cell, path(cell), 0.9).methods[-1].error
    assert 'neighbours to 3 spacings' in plan_bands(cell, path(cell), lacking / 0.2).evidence[0]
    assert 'neighbours to 6.24 spacings' in plan_bands(cell, path(cell), lacking / 0.3).evidence[0]


def test_a_change_of_bands_below_a_thousandth_is_not_mentioned(monkeypatch):
    prototype = read_scene(ready_scene('prototype'))
    for error, lines in ((5e-4, 0), (2e-3, 1)):
        monkeypatch.setattr(scene, '_error_of_shells', lambda *_, error=error: (error, True))
        assert len(scene.neglected(prototype)) == lines


@pytest.mark.parametrize(('reach_mm', 'words'), [
    (16.0, 'ends before the next ones'), (18.0, 'ends within the reach of the others')])
def test_what_the_neighbours_beyond_a_table_do_is_told_as_a_guess(reach_mm, words):
    """The second neighbours are 17.3 mm away; a table to 18 mm knows them, but not those that a plan compares with."""
    tables = tomllib.loads(ready_scene('prototype').read_text())
    r = np.linspace(0.008, reach_mm / 1e3, 30)
    tables['law'] = {'kind': 'table', 'shells': 1, 'distances_m': r.tolist(),
                     'forces_N': (1.6209e-10 * r**-4.5824).tolist()}
    told = scene.neglected(scene_of(tables))
    assert len(told) == 1
    assert words in told[0]


# --- costs, steps ----------------------------------------------------------------------------------------------------

def test_the_cost_of_an_eigenvalue_problem_is_that_of_the_textbook():
    """Golub and Van Loan: 9 n^3 with vectors; a plan compares methods whose costs are mostly several times apart."""
    assert 1 / 1.5 < plan.EIGENSOLVE / 9 < 1.5


def oscillator(springs=0.0):
    """A magnet between three held ones, on springs of its own along x and y."""
    atoms = lattices.oscillator(0.0, 1.0, 1.0)
    atoms.calc = MagneticRepulsion(atoms, LAW, bonds=lattices.OSCILLATOR_BONDS, foundation=springs).balanced([3])
    return atoms


def test_steps_are_short_enough_and_not_shorter():
    """Verlet's frequency is asin(x)/x of the true one, x = w dt/2; in proportion to the square of the step it is 1 + x^2/6."""
    atoms, along = oscillator([[5.0, 0.0]]), Place(3, np.array([0.0, 1.0, 0.0]))
    omega = np.linspace(0.3, 3, 100) * highest_frequency(atoms)
    loose, tight = (plan_peak(atoms, along, along, omega, 0.01, tolerance, 1e-6).methods[-1] for tolerance in (0.9, 1e-4))
    x = loose.settings.dt * highest_frequency(atoms) / 2
    assert 1.05 < (np.arcsin(x) / x - 1) / (x**2 / 6) < 1.3
    assert 0.5 < tight.error / 1e-4 < 0.9


# --- peaks -----------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize(('ratio', 'rivals'), [(0.95, 2), (0.6, 1)])
def test_a_peak_almost_as_high_is_a_rival(ratio, rivals):
    """Two modes along x and y; pushed and seen along an axis between them, the peaks are cos^2/(gamma w) and sin^2/(gamma w)."""
    atoms = oscillator([[30.0, 0.0]])
    K = atoms.calc.get_hessian(atoms).toarray()[9:11, 9:11]
    assert abs(K[0, 1]) < 1e-12
    wx, wy = np.sqrt(np.diag(K))
    tilt = np.arctan(np.sqrt(ratio * wy / wx))
    place = Place(3, np.array([np.cos(tilt), np.sin(tilt), 0.0]))
    found = highest_peak(atoms, place, place, np.linspace(0.5 * min(wx, wy), 2 * max(wx, wy), 100), 1e-4)
    assert len(found.rivals) == rivals


@pytest.mark.parametrize(('side', 'small'), [(20.0, True), (32.0, False)])
def test_some_hundred_particles_are_diagonalised_and_a_thousand_are_not(side, small, monkeypatch):
    """The time of an eigenvalue problem grows with the third power of their number: 30 times as long is too long."""
    patch = lattices.rectangle(lattices.square(1.0, 1.0), side, side)
    patch.calc = MagneticRepulsion(patch, LAW, foundation=5.0)
    free = 2 * np.count_nonzero(patch.get_tags() == 0)
    assert 400 < free < 1000 if small else 1000 < free < 2700
    said = []
    for name in ('modes', '_peak_of_field'):
        def called(*_, name=name):
            said.append(name)
            raise InterruptedError
        monkeypatch.setattr(peak, name, called)
    place = Place(0, np.array([1.0, 0.0, 0.0]))
    with pytest.raises(InterruptedError):
        highest_peak(patch, place, place, np.array([1.0, 2.0]), 0.1)
    assert said == ['modes' if small else '_peak_of_field']


# --- waveforms -------------------------------------------------------------------------------------------------------

class Changing(waveform._Trial):
    """Trial runs whose motion changes, when the step dt/fine is doubled, by what a function tells."""

    def __init__(self, change):
        self._dt, self.change = 1.0, change


def test_a_change_by_a_fifth_is_small_enough_to_be_a_square():
    """Of one, the error is a third; an error that is no square is looked for with half the step."""
    assert Changing({1: 0.15, 2: 0.01}.get).step_error(1) == pytest.approx(0.15 / 3)
    assert Changing({1: 0.3, 2: 0.01}.get).step_error(1) == pytest.approx(0.01 / 3 * 4)


def test_steps_that_do_not_converge_with_an_eighth_of_the_step_are_given_up():
    assert Changing(lambda fine: 0.1 if fine >= 8 else 1.0).step_error(1) == pytest.approx(0.1 / 3 * 64)
    assert Changing(lambda fine: 0.1 if fine >= 16 else 1.0).step_error(1) == np.inf


def test_frames_tell_the_carrier_and_its_harmonics(monkeypatch):
    """A dozen in each period: what vibrates five times as fast is still seen."""
    pilot, said = strip(lattice('triangular'), 8), []

    def called(atoms, times, *_):
        said.append(times[1] - times[0])
        raise InterruptedError

    monkeypatch.setattr(waveform, 'propagate', called)
    burst = ToneBurst([4], (0, 1), 1e-3, 0.05 * golden)
    with pytest.raises(InterruptedError):
        plan_waveform(pilot, burst, np.array([4]), 0.0, 2 * burst.end, 0.1)
    assert 10 < 2 * np.pi / burst.omega / said[0] < 15


def trial(situation, share, fine):
    drive, row, damping, duration = situation._burst
    dt = 0.5 / highest_frequency(situation._atoms)
    interval = 2 * max(1, int(np.pi / drive.omega / 12 / dt))
    return waveform._Trial(situation._atoms, drive, row, damping, (dt, interval, int(duration / dt)), share)(fine)


def test_long_steps_find_the_nonlinearity_to_a_tenth_and_half_of_them_to_a_quarter_of_that():
    """Of four bursts in strips the one that suffers most, by 13 %; the others are 0.2, 1 and 4 % off."""
    situation = Waveform('square', LAW, 8.0, (1, 0), 0.3, 0.1, rows=14)
    found = [difference(trial(situation, 1, fine), trial(situation, waveform.WEAK_AMPLITUDE, fine)) for fine in (1, 2, 4)]
    exact = found[2] + (found[2] - found[1]) / 3
    assert waveform.DOUBT / 2 < found[0] / exact - 1 < 1.5 * waveform.DOUBT
    assert found[1] / exact - 1 == pytest.approx((found[0] / exact - 1) / 4, rel=0.2)


def test_the_weak_burst_is_linear_and_above_round_off():
    """A thousand times as much or as little gives the same; a tenth of the full burst, the control, does not."""
    situation = Waveform('square', LAW, 8.0, (1, 0), 0.3, 0.1, rows=8)
    weak = trial(situation, waveform.WEAK_AMPLITUDE, 1)
    for factor in (1e3, 1e-3):
        assert difference(trial(situation, factor * waveform.WEAK_AMPLITUDE, 1), weak) < 1e-4
    assert difference(trial(situation, 0.1, 1), weak) > 1e-4


def said_of(beam, tolerance, error, monkeypatch):
    """How often a beam plans, with what stand-ins, if the strip finds an `error` of the linear model, in tolerances."""
    said = []

    def called(*arguments):
        said.append(arguments[6:])
        methods = (Method('c', '', 1, 2 * error * tolerance, 0.3, Settings('conventional')),
                   Method('l', '', 1, error * tolerance, 0.3, Settings('complete')),
                   Method('n', '', 9, 0.0, 0.3, Settings('complete', dt=0.1)))
        return Plan('it', 'itself', tolerance, methods, (), 1.0)

    monkeypatch.setattr(waveform, 'plan_waveform', called)
    beam.plan(tolerance)
    return said


def test_a_strip_decides_where_the_patch_could_not_say_otherwise(monkeypatch):
    """The nonlinearity in a strip was up to 2.4 times that in the patch."""
    beam = Beam('square', LAW, 8.0, (0, 1), 0.6, 1e-3)
    assert len(said_of(beam, 1e-2, 2.4, monkeypatch)) == 2
    assert len(said_of(beam, 1e-2, 4.0, monkeypatch)) == 1


def test_what_a_strip_cannot_know_of_its_beam_is_allowed_for(monkeypatch):
    """No bond rotates in the strip, so that what D* does in the patch is done at the sides; elsewhere the strip shows more."""
    def effect(atoms, drive, row, damping, times):
        frozen, exact = (propagate(as_model(atoms, model), times, [drive], damping).displacements[:, row]
                         for model in ('conventional', 'complete'))
        return difference(frozen, exact)

    def both(beam):
        drive, row, damping, duration = beam._burst
        times = np.linspace(0, duration, 61)[1:]
        pilot = strip(beam._cell, len(row) + 2)
        inside = np.flatnonzero(pilot.get_tags() == 0)
        along = replace(drive, particles=inside[:1], amplitude=abs(drive.amplitude).max())
        return effect(beam._atoms, drive, row, damping, times), effect(pilot, along, inside, damping, times)

    straight = Beam('square', LAW, 8.0, (0, 1), 0.6, 1e-3)
    (stand_in,), *_ = said_of(straight, 1e-2, 9.0, monkeypatch)
    patch, narrow = both(straight)
    assert narrow < 1e-9
    assert patch < stand_in.sides < 2 * patch
    patch, narrow = both(Beam('square', LAW, 8.0, (1, 0), 0.3, 1e-3))
    assert stand_in.doubt / 2 < 1 - patch / narrow < 2 * stand_in.doubt
