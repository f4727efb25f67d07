"""Checkpoints that were damaged or belong to a run that differs in one detail: refused, or the same bits; never otherwise."""

import os
import shutil
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from ase.constraints import FixAtoms

from magphonon import Constant, DrivenVerlet, Harmonic, InversePower, MagneticRepulsion, Recorder, Tabulated, lattices
from magphonon.dynamics.checkpoint import load_checkpoint, run_parts, save_checkpoint
from magphonon.dynamics.fingerprints import Unknowable, fingerprint

STEPS, HALF, EVERY = 120, 60, 20
PUSH = 0.02
CONFIG = SimpleNamespace(push=0.02)


@dataclass(frozen=True)
class Contact:
    """An inverse power and, below `reach`, a stiff contact: the same as without it about rest."""

    stiffness: float = 0.0
    reach: float = 9.0

    def phi(self, r):
        return InversePower(8900.0, 4.5).phi(r) + self.stiffness / 3 * np.clip(self.reach - r, 0, None) ** 3

    def dphi(self, r):
        return InversePower(8900.0, 4.5).dphi(r) - self.stiffness * np.clip(self.reach - r, 0, None) ** 2

    def d2phi(self, r):
        return InversePower(8900.0, 4.5).d2phi(r) + 2 * self.stiffness * np.clip(self.reach - r, 0, None)


class Secret:
    """A drive that says nothing of its strength to whoever would copy it."""

    def __init__(self, amplitude=0.0):
        self.amplitude = amplitude

    def __reduce__(self):
        return Secret, ()

    def __call__(self, t):
        return np.outer(np.arange(19) == 9, [self.amplitude * np.sin(t), 0, 0])


class SecretLaw(InversePower):
    """A law that says nothing of its contact."""

    contact = 0.0

    def __reduce__(self):
        return SecretLaw, (self.b, self.a)

    def dphi(self, r):
        return super().dphi(r) - self.contact * (r < 5)


def pulse(amplitude, start=1.3):
    """A plain function of the time that is zero at the times at which a drive is looked at."""
    profile = np.outer(np.arange(19) == 9, [1.0, 0, 0])
    return lambda t: amplitude * profile * (start < t < start + 1)


def nested(amplitude):
    def strength(t):
        return amplitude * (1.3 < t < 2.3)

    return lambda t: np.outer(np.arange(19) == 9, [strength(t), 0, 0])


def of_a_global(t):
    return np.outer(np.arange(19) == 9, [PUSH * (1.3 < t < 2.3), 0, 0])


def of_a_setting(t):
    return np.outer(np.arange(19) == 9, [CONFIG.push * (1.3 < t < 2.3), 0, 0])


def by_default(amplitude):
    def push(t, strength=amplitude):
        return np.outer(np.arange(19) == 9, [strength * (1.3 < t < 2.3), 0, 0])
    return push


@dataclass(frozen=True)
class Setting:
    """A run; the foreign ones differ in one field."""

    law: object = Contact()
    drives: tuple = (pulse(0.02), Harmonic([8], (1, 0), 0.02, 0.5))
    mass: float = 0.7
    heavier: float = 1.0
    damping: object = 0.001
    foundation: float = 0.02
    model: str = 'complete'
    bonds: object = None
    anchored: float = 0.0
    load: float = 0.0
    held: int = 0
    particles: object = None
    interval: int = 7
    second: int = 5
    watched: int = 11
    engine: str = 'numpy'
    dt: float = 0.1
    seed: int = 3
    shift: float = 0.0
    every: int = EVERY

    def prepare(self):
        atoms = lattices.hexagon(lattices.triangular(10.0, self.mass), 25.0)
        masses = atoms.get_masses()
        masses[9] *= self.heavier
        atoms.set_masses(masses)
        if self.held:
            atoms.set_constraint(FixAtoms([*atoms.constraints[0].index, self.held]))
        one = np.outer(np.arange(len(atoms)) == 9, [1.0, 0, 0])
        atoms.calc = MagneticRepulsion(atoms, self.law, foundation=self.foundation, model=self.model, bonds=self.bonds,
                                       anchors=atoms.positions + self.anchored * one, load=self.load * one)
        v = np.zeros((len(atoms), 3))
        v[:, :2] = np.random.default_rng(self.seed).normal(scale=0.02, size=(len(atoms), 2))
        atoms.set_momenta(masses[:, None] * v)
        atoms.positions[9, 0] += self.shift
        dyn = DrivenVerlet(atoms, self.dt, self.drives, damping=self.damping, engine=self.engine)
        recorders = [Recorder(dyn, self.particles, self.interval), Recorder(dyn, [3, 9], self.second)]
        dyn.attach(lambda: None, self.watched)
        return atoms, dyn, recorders

    def run(self, path, steps=STEPS):
        """Run to the end, from the checkpoint if there is one; what came out."""
        atoms, dyn, recorders = self.prepare()
        dyn.run(steps, checkpoint=path, every=self.every)
        return [atoms.positions, atoms.get_momenta(), dyn.displacements, dyn.velocities, dyn.nsteps,
                *(part for recorder in recorders for part in (recorder.times, recorder.displacements))]


def same_bits(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


BASE = Setting()
FEWER = [(i, j) for i in range(19) for j in range(i) if (i, j) != (9, 4)
         and abs(np.linalg.norm(np.diff(BASE.prepare()[0].positions[[i, j]], axis=0)) - 10) < 1e-6]
RANGE = np.linspace(0.5, 40.0, 60)
TABLE = Tabulated(RANGE, 8900 * RANGE**-4.5)
BENT = Tabulated(RANGE, 8900 * RANGE**-4.5 * np.where(RANGE < 4, 1.5, 1))
SHORT, ENDS = (Tabulated(RANGE[8:end], 8900 * RANGE[8:end] ** -4.5) for end in (30, 31))  # from 5.9 to about 20 mm
# the part that is refused; the run whose checkpoint is found, as far as it is not the base; what differs from it
FOREIGN = {
    'amplitude captured by a function': ('drives', {}, {'drives': (pulse(0.5), BASE.drives[1])}),
    'constant in a function': ('drives', {}, {'drives': (lambda t: 0.3 * pulse(0.02)(t), BASE.drives[1])}),
    'amplitude in a nested function': ('drives', {'drives': (nested(0.02),)}, {'drives': (nested(0.5),)}),
    'default argument': ('drives', {'drives': (by_default(0.02),)}, {'drives': (by_default(0.5),)}),
    'time in a function': ('drives', {}, {'drives': (pulse(0.02, 3.3), BASE.drives[1])}),
    'drive class': ('drives', {}, {'drives': (BASE.drives[0], Harmonic([8], (1, 0), 0.021, 0.5))}),
    'one more drive': ('drives', {}, {'drives': (*BASE.drives, Constant([9], (0, 1), 1e-9))}),
    'order of drives': ('drives', {}, {'drives': BASE.drives[::-1]}),
    'drive that hides its strength': ('forces of the drives', {'drives': (Secret(0.02),)}, {'drives': (Secret(0.5),)}),
    'law at short distance': ('law', {}, {'law': Contact(50.0)}),
    'class of the law': ('law', {}, {'law': InversePower(8900.0, 4.5)}),
    'table of the law': ('law', {'law': TABLE}, {'law': BENT}),
    'where the table of the law ends': ('law', {'law': SHORT}, {'law': ENDS}),
    'all masses': ('masses', {}, {'mass': 0.70001}),
    'one mass': ('masses', {}, {'heavier': 1.001}),
    'damping': ('damping', {}, {'damping': 0.0011}),
    'damping of one particle': ('damping', {}, {'damping': 0.001 * (1 + (np.arange(19) == 9))}),
    'foundation': ('foundation or model', {}, {'foundation': 0.0200001}),
    'model': ('foundation or model', {}, {'model': 'conventional'}),
    'anchor of one particle': ('anchors', {}, {'anchored': 1e-6}),
    'load on one particle': ('load', {}, {'load': 1e-6}),
    'one bond less': ('bonds', {}, {'bonds': FEWER}),
    'constraint': ('constraints', {}, {'held': 9}),
    'recorded particles': ('recorders', {}, {'particles': [9]}),
    'interval of a recorder': ('recorders', {}, {'interval': 8}),
    'interval of the second recorder': ('recorders', {}, {'second': 6}),
    'interval of an observer': ('intervals of observers', {}, {'watched': 12}),
    'engine': ('engine', {}, {'engine': 'ase'}),
    'time step': ('time step', {}, {'dt': 0.1 + 1e-12}),
    'velocities at the start': ('start', {}, {'seed': 4}),
    'positions at the start': ('start', {}, {'shift': 1e-14 + 1e-13}),
    'every': ('every', {}, {'every': 30}),
}


@pytest.mark.parametrize(('part', 'found', 'change'), FOREIGN.values(), ids=FOREIGN)
def test_a_run_that_differs_in_one_detail_is_refused_by_name(part, found, change, tmp_path):
    owner = replace(BASE, **found)
    owner.run(tmp_path / 'state.npz', HALF)
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    with pytest.raises(ValueError, match=f'belongs to another run, these differ: .*{part}'):
        replace(owner, **change).run(tmp_path / 'state.npz')
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before
    # the control: the owner goes on to the bits of a run that was never stopped
    assert same_bits(owner.run(tmp_path / 'state.npz'), owner.run(tmp_path / 'whole.npz'))


def test_globals_that_a_drive_reads_are_part_of_the_run(tmp_path, monkeypatch):
    for drive in (of_a_global, of_a_setting):
        owner, path = replace(BASE, drives=(drive,)), tmp_path / f'{drive.__name__}.npz'
        owner.run(path, HALF)
        with monkeypatch.context() as patch:
            patch.setitem(globals(), 'PUSH', 0.5)
            patch.setattr(CONFIG, 'push', 0.5)
            with pytest.raises(ValueError, match='these differ: drives'):
                owner.run(path)
        owner.run(path)


def test_a_law_that_hides_its_contact_is_seen_by_what_it_does(tmp_path):
    law, hard = SecretLaw(8900.0, 4.5), SecretLaw(8900.0, 4.5)
    object.__setattr__(hard, 'contact', 1.0)
    replace(BASE, law=law).run(tmp_path / 'state.npz', HALF)
    with pytest.raises(ValueError, match='these differ: law'):
        replace(BASE, law=hard).run(tmp_path / 'state.npz')


def test_functions_written_again_in_another_place_are_the_same(tmp_path):
    def pulse(amplitude, start=1.3):
        # another line, another comment
        profile = np.outer(np.arange(19) == 9, [1.0, 0, 0])
        return lambda t: amplitude * profile * (start < t < start + 1)

    BASE.run(tmp_path / 'state.npz', HALF)
    again = replace(BASE, drives=(pulse(0.02), Harmonic([8], (1, 0), 0.02, 0.5)))
    assert same_bits(again.run(tmp_path / 'state.npz'), BASE.run(tmp_path / 'whole.npz'))


def test_a_drive_that_could_not_be_known_again_is_refused_with_the_way_out(tmp_path):
    random, count = np.random.default_rng(0), iter(range(1000))
    with open(os.devnull) as file:
        for drive, message in ((lambda t: file and np.zeros((19, 3)), 'cannot be copied.*frozen dataclass'),
                               (lambda t: (15.2 < t < 15.5) * random.normal(size=(19, 3)), 'other random numbers each time'),
                               (lambda t: random.normal(size=(19, 3)), 'other forces when it is asked twice'),
                               (lambda t: 1e-9 * next(count) * np.ones((19, 3)), 'other forces when it is asked twice')):
            owner = replace(BASE, drives=(drive,))
            with pytest.raises(ValueError, match=message):
                owner.run(tmp_path / 'state.npz')
    assert not list(tmp_path.iterdir())
    _, dyn, _ = replace(BASE, drives=(Secret(),)).prepare()
    assert run_parts(dyn, EVERY) == run_parts(dyn, EVERY)


# --- damage ----------------------------------------------------------------------------------------------------------

@pytest.fixture(scope='module')
def stopped(tmp_path_factory):
    """A run stopped half-way, and its end."""
    folder = tmp_path_factory.mktemp('stopped')
    BASE.run(folder / 'state.npz', HALF)
    return folder, BASE.run(tmp_path_factory.mktemp('whole') / 'state.npz')


def outcomes(stopped, place, damaged):
    """Resume from copies in which `damaged`, pairs of a file and its new bytes, replace one file: how many were refused."""
    folder, end = stopped
    words = []
    for k, (name, content) in enumerate(damaged):
        copy = place / str(k)
        shutil.copytree(folder, copy)
        (copy / name).write_bytes(content)
        try:
            out = BASE.run(copy / 'state.npz')
        except ValueError as error:
            words.append(str(error))
        else:
            assert same_bits(out, end), (name, k)
    assert all(str(place) in said and 'delete' in said for said in words)  # own words, that name the file
    return len(words)


@pytest.mark.slow
def test_flipped_bits_are_refused_or_change_nothing(stopped, tmp_path):
    rng = np.random.default_rng(5)
    files = sorted(file.name for file in stopped[0].iterdir())
    assert files == ['state.npz', 'state.npz.frames0', 'state.npz.frames1']
    damaged = []
    for name, count in zip(files, (100, 50, 50), strict=True):
        good = (stopped[0] / name).read_bytes()
        for bit in rng.choice(8 * len(good), count, replace=False):
            bad = bytearray(good)
            bad[bit // 8] ^= 1 << bit % 8
            damaged.append((name, bytes(bad)))
    # every bit of the frames counts; some of a ZIP file, such as its dates, do not
    assert outcomes(stopped, tmp_path / 'frames', damaged[100:]) == 100
    assert outcomes(stopped, tmp_path / 'state', damaged[:100]) > 50
    assert outcomes(stopped, tmp_path / 'whole', [('state.npz', (stopped[0] / 'state.npz').read_bytes())]) == 0  # the control


def test_truncated_files_are_refused(stopped, tmp_path):
    rng = np.random.default_rng(6)
    damaged = []
    for name, count in (('state.npz', 20), ('state.npz.frames0', 10), ('state.npz.frames1', 10)):
        good = (stopped[0] / name).read_bytes()
        damaged += [(name, good[:size]) for size in rng.choice(len(good), count, replace=False)]
    assert outcomes(stopped, tmp_path, damaged) == 40


def test_a_checkpoint_that_lacks_an_array_is_refused_in_own_words(stopped, tmp_path):
    with np.load(stopped[0] / 'state.npz') as data:
        arrays = dict(data)
    for k, name in enumerate(arrays):
        copy = tmp_path / str(k)
        shutil.copytree(stopped[0], copy)
        np.savez(copy / 'state.npz', **{other: array for other, array in arrays.items() if other != name})
        with pytest.raises(ValueError, match='no complete checkpoint'):
            BASE.run(copy / 'state.npz')


class Payload:
    """Makes a file where it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (self.path, 'w')


def test_nothing_in_a_checkpoint_is_ever_executed(tmp_path):
    np.savez(tmp_path / 'state.npz', run=np.array([Payload(str(tmp_path / 'executed'))], dtype=object))
    with pytest.raises(ValueError, match='no complete checkpoint'):
        load_checkpoint(tmp_path / 'state.npz', {})
    assert not (tmp_path / 'executed').exists()
    with np.load(tmp_path / 'state.npz', allow_pickle=True) as data:  # the control: it would be
        data['run'][0].close()
    assert (tmp_path / 'executed').exists()


def test_a_checkpoint_is_replaced_not_overwritten(tmp_path):
    """Who has opened the old one reads it to its end."""
    save_checkpoint(tmp_path / 'state.npz', {'law': 'a'}, {'x': np.zeros(1000)})
    with open(tmp_path / 'state.npz', 'rb') as old:
        save_checkpoint(tmp_path / 'state.npz', {'law': 'a'}, {'x': np.ones(1000)})
        with np.load(old) as data:
            assert not data['x'].any()
    assert load_checkpoint(tmp_path / 'state.npz', {'law': 'a'})['x'].all()


# --- fingerprints ----------------------------------------------------------------------------------------------------

def test_fingerprints_tell_values_apart():
    values = [0, 0.0, False, None, '', b'', (), [], {}, set(), -0.0, float('nan'), 1j, np.float32(0), np.zeros(1), np.zeros(2),
              np.zeros((1, 2)), np.zeros(2, int), [0], (0,), [[0], []], [[], [0]], {'a': 1}, {'b': 1}, {'a': 1, 'b': 1}, {0}, {1},
              np.sin, np.cos, len, max, Contact, Contact(), Contact(1.0), Setting, [].append, [0].append, np.array([None]),
              slice(1), range(1), lambda: 0, lambda: 1, lambda x: x.a, lambda x: x.b, Contact().phi, Contact().dphi, np, os]
    prints = [fingerprint(value) for value in values]
    assert len(set(prints)) == len(values)
    assert prints == [fingerprint(value) for value in values]


def test_fingerprints_of_what_refers_to_itself_end():
    def factorial(n):
        return n * factorial(n - 1) if n else 1

    loop = [1]
    loop.append(loop)
    assert fingerprint(factorial) != fingerprint(loop)
    deep = []
    for _ in range(10_000):
        deep = [deep]
    with pytest.raises(Unknowable, match='nested too deeply'):
        fingerprint(deep)
