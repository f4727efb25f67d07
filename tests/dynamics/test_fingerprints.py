"""Fingerprints of drives that people write: another amplitude has another one, or a refusal says what cannot be known."""

import functools
import os
import sys
from dataclasses import InitVar, dataclass
from types import ModuleType

import numpy as np
import pytest

from magphonon import ToneBurst
from magphonon.dynamics.fingerprints import Unknowable, fingerprint

settings, package = ModuleType('own_settings'), ModuleType('own_package')
settings.amplitude, package.settings = 1.0, settings


class Scaled(ToneBurst):
    def __init__(self, amplitude):
        super().__init__(3, (0, 1), 1e-2, 1.0)
        self.late = amplitude


class Slotted(ToneBurst):
    __slots__ = ('__amplitude',)

    def __init__(self, amplitude):
        super().__init__(3, (0, 1), 1e-2, 1.0)
        object.__setattr__(self, '_Slotted__amplitude', amplitude)


@dataclass
class Table:
    amplitude: InitVar[float]

    def __post_init__(self, amplitude):
        self.values = amplitude


class Wrapped:
    def __init__(self, amplitude):
        functools.update_wrapper(self, base)
        self.amplitude = amplitude


class Named(dict):
    def __init__(self, amplitude):
        self.amplitude = amplitude


class Array(np.ndarray):
    pass


class Holder:
    def __init__(self):
        self.settings = settings


def base(t):
    return 0 * t


def array(amplitude):
    made = np.zeros(3).view(Array)
    made.amplitude = amplitude
    return made


def with_attribute(amplitude):
    def push(t):
        return push.amplitude * t

    push.amplitude = amplitude
    return push


def in_disguise(amplitude):
    @functools.wraps(np.testing.assert_allclose)
    def push(t):
        return amplitude * t

    del push.__wrapped__
    return push


def with_settings(function):
    """What makes `function` in a world where the settings have an amplitude."""
    def make(amplitude):
        settings.amplitude = amplitude
        return function
    return make


def captured():
    local = settings
    return lambda t: local.amplitude * t


DRIVES = {
    'subclass': Scaled, 'slot of a subclass': Slotted, 'computed from an InitVar': Table, 'object with __wrapped__': Wrapped,
    'dictionary': Named, 'array': array, 'attribute of a function': with_attribute, 'function with another name': in_disguise,
    'partial': lambda amplitude: functools.update_wrapper(functools.partial(np.multiply, amplitude), base),
    'cached': lambda amplitude: functools.lru_cache(lambda t: amplitude * t),
    'module': with_settings(lambda t: settings.amplitude * t),
    'module of a package': with_settings(lambda t: package.settings.amplitude * t),
    'module that was captured': with_settings(captured()),
}


@pytest.mark.parametrize('drive', DRIVES.values(), ids=DRIVES)
def test_another_amplitude_is_another_fingerprint(drive):
    prints = [fingerprint(drive(amplitude)) for amplitude in (1.0, 2.0, 1.0)]
    assert prints[0] != prints[1]
    assert prints[0] == prints[2]  # the control


def imports_inside(t):
    import own_settings
    return own_settings.amplitude * t


def imports_from_inside(t):
    from own_settings import amplitude
    return amplitude * t


def imports_relatively(t):
    from . import own_settings
    return own_settings.amplitude * t


def changes_it(t):
    settings.amplitude = t
    return t


def hands_it_on(t):
    here = settings
    return here.amplitude * t


UNKNOWABLE = {
    'a module in an object': (Holder(), 'anything may be read of the module own_settings, which is handed over as a whole; name'),
    'getattr': (lambda t: settings.amplitude * getattr(settings, t), 'anything may be read of the module own_settings'),
    'getattr of a package': (lambda t: getattr(package.settings, t), 'anything may be read of the module own_settings'),
    'another name': (hands_it_on, 'anything may be read of the module own_settings'),
    'a change': (changes_it, 'anything may be read of the module own_settings'),
    'import': (imports_inside, 'a function imports own_settings when it is called.* at the top of the file'),
    'import from': (imports_from_inside, 'a function imports own_settings when it is called'),
    'relative import': (imports_relatively, r'a function imports \. when it is called'),
    'eval': (lambda t: eval('settings.amplitude') * t,  # noqa: S307  nothing is called
             'calls eval, by which it may read anything; let it name'),
    'globals': (lambda t: globals()['settings'].amplitude * t, 'calls globals, by which it may read anything'),
}


@pytest.mark.parametrize(('drive', 'words'), UNKNOWABLE.values(), ids=UNKNOWABLE)
def test_what_may_read_anything_is_refused_with_the_way_out(drive, words, monkeypatch):
    monkeypatch.setitem(sys.modules, 'own_settings', settings)
    with pytest.raises(Unknowable, match=words):
        fingerprint(drive)


def imports_a_package(t):
    import scipy.special
    return scipy.special.erf(t)


def calls_numpy(t):
    return np.sin(t) + np.sum(t) + os.path.getsize(__file__)


def test_packages_are_known_however_they_are_imported():
    prints = {fingerprint(drive) for drive in (imports_a_package, calls_numpy, np, os, np.sum, np.mean, np.linalg.norm)}
    assert len(prints) == 7
