"""Fingerprints of values: equal for what computes the same, different for what may compute something else.

Numbers and arrays are known by their bits, dataclasses by their fields, other objects by what a copy of them would be
made from, and functions by their code together with everything it reads: constants, defaults, captured variables and the
globals that it names, functions among them.  What belongs to the standard library or to an installed package is known by
its name and version.
"""

import dis
import sys
import types
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cached_property
from hashlib import sha256
from importlib import import_module
from pathlib import Path

import numpy as np

INSTALLED = {'site-packages', 'dist-packages'}
"""Directories that hold installed packages, those of a parent environment included."""
BUILT_IN = (types.BuiltinFunctionType, types.MethodWrapperType, types.WrapperDescriptorType, types.MethodDescriptorType,
            types.ClassMethodDescriptorType, types.GetSetDescriptorType, types.MemberDescriptorType)
MACHINERY = {'__dict__', '__weakref__', '__doc__', '__module__', '__firstlineno__', '__static_attributes__',
             '__dataclass_fields__', '__dataclass_params__', '__match_args__', '__annotations__', '_abc_impl'}
"""Attributes of a class that do not affect any result."""


class Unknowable(ValueError):
    """A value whose fingerprint cannot be taken, such as an open file."""


def fingerprint(value: object) -> str:
    """Fingerprint of a value, 64 hexadecimal digits.

    Raises
    ------
    Unknowable
        If it holds something that cannot be copied, such as an open file or a generator, or draws random numbers.
    """
    try:
        return _Fingerprint().of(value).hex()
    except RecursionError:
        raise Unknowable(f'a {type(value).__name__} is nested too deeply') from None


class _Fingerprint:
    """One fingerprint in the making; what refers to itself, such as a recursive function, is met once."""

    def __init__(self):
        self._met = {}

    def of(self, value):
        kind = type(value)
        if value is None or kind in (bool, int, float, complex, str, bytes, range, slice) or value is Ellipsis:
            return _hash(kind.__name__, repr(value))
        if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            array = np.asarray(value)
            return _hash(kind.__name__, array.dtype.str, repr(array.shape), np.ascontiguousarray(array).tobytes())
        if id(value) in self._met:
            return _hash('met', repr(self._met[id(value)][0]))
        self._met[id(value)] = len(self._met), value  # keeps temporary objects alive, whose id another could get
        return self._compound(value, kind)

    def _compound(self, value, kind):
        if kind in (tuple, list):
            return _hash(kind.__name__, *map(self.of, value))
        if kind in (set, frozenset):
            return _hash(kind.__name__, *sorted(map(fingerprint, value)))
        if isinstance(value, dict | types.MappingProxyType):
            return _hash(self.of(kind), *sorted(_hash(fingerprint(name), self.of(entry)) for name, entry in _named(value)))
        if isinstance(value, np.ndarray):
            return _hash('objects', repr(value.shape), self.of(value.tolist()))
        if isinstance(value, types.CodeType):
            return self._code(value)
        if isinstance(value, types.ModuleType):
            return self._module(value, ())
        if isinstance(value, type):
            return self._class(value)
        if isinstance(value, types.FunctionType):
            return self._library_function(value) if _is_library(value.__module__) else self._function(value)
        if isinstance(value, types.MethodType):
            return _hash('method', self.of(value.__func__), self.of(value.__self__))
        if isinstance(value, BUILT_IN):
            owner = getattr(value, '__self__', None)
            owner = None if isinstance(owner, types.ModuleType) else owner
            return _hash('built in', value.__name__, str(getattr(value, '__module__', '')), self.of(owner))
        if isinstance(value, property | cached_property | staticmethod | classmethod):
            names = ('fget', 'fset', 'fdel', 'func', '__func__')
            return _hash(kind.__name__, *(self.of(getattr(value, name, None)) for name in names))
        if isinstance(value, np.ufunc) and value is getattr(np, value.__name__, None):
            return _hash('ufunc', value.__name__)
        for name in ('py_func', '__wrapped__'):  # compiled by numba, kept by functools.lru_cache
            if isinstance(getattr(value, name, None), types.FunctionType):
                return _hash(name, self.of(getattr(value, name)))
        return self._object(value, kind)

    def _object(self, value, kind):
        if isinstance(value, np.random.Generator | np.random.RandomState | np.random.BitGenerator):
            raise Unknowable(f'{value!r} draws other random numbers each time; draw them once into an array, and read that')
        if is_dataclass(value):
            return _hash(self.of(kind), *(_hash(field.name, self.of(getattr(value, field.name))) for field in fields(value)))
        try:
            recipe = value.__reduce_ex__(4)
        except Exception as error:
            raise Unknowable(f'{value!r} cannot be copied ({error})') from None
        if isinstance(recipe, str):
            return _hash('global', recipe, self.of(kind))
        make, arguments, state, *items = (*recipe, None, None, None)[:5]
        if isinstance(state, dict):  # a cached property is computed from the rest, sooner or later
            state = {name: part for name, part in state.items() if not isinstance(getattr(kind, name, None), cached_property)}
        return _hash('object', self.of(kind), self.of(make), self.of(arguments), self.of(state),
                     *(self.of(list(part)) if part is not None else b'' for part in items))

    def _library_function(self, function):
        return _hash('of a package', _library_name(function), self.of(_captured(function)))

    def _function(self, function):
        read = []
        for name in sorted(_globals(function.__code__) & function.__globals__.keys()):
            found = function.__globals__[name]
            is_module = isinstance(found, types.ModuleType)
            read += [name, self._module(found, _names(function.__code__)) if is_module else self.of(found)]
        return _hash('function', self.of(function.__code__), self.of(function.__defaults__), self.of(function.__kwdefaults__),
                     self.of(_captured(function)), *read)

    def _code(self, code):
        return _hash('code', code.co_code, repr((code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount,
                                                 code.co_flags, code.co_names, code.co_freevars, code.co_cellvars)),
                     getattr(code, 'co_exceptiontable', b''), *map(self.of, code.co_consts))

    def _module(self, module, read):
        """A module of a package by its version, another one by what is read of it."""
        if _is_library(module.__name__):
            return _hash('module', module.__name__, _version(module.__name__))
        known = [name for name in sorted(read) if name in vars(module)]
        return _hash('module', *(_hash(name, self.of(vars(module)[name])) for name in known))

    def _class(self, kind):
        if _is_library(kind.__module__):
            return _hash(_library_name(kind))
        own = sorted((name, value) for name, value in vars(kind).items() if name not in MACHINERY)
        return _hash('class', kind.__name__, *map(self.of, kind.__bases__), *(_hash(name, self.of(value)) for name, value in own))


def _hash(*parts):
    """Digest of texts and bytes, each with its length so that no two lists of them run together to the same."""
    digest = sha256()
    for part in parts:
        part = part.encode() if isinstance(part, str) else part
        digest.update(len(part).to_bytes(8, 'little') + part)
    return digest.digest()


def _named(value):
    return sorted(value.items(), key=lambda item: fingerprint(item[0]))


def _within(code):
    """A code and those of the functions defined within it."""
    yield code
    for part in code.co_consts:
        if isinstance(part, types.CodeType):
            yield from _within(part)


def _names(code):
    """Names of globals and attributes that a code mentions."""
    return {name for part in _within(code) for name in part.co_names}


def _globals(code):
    """Names of globals that a code reads."""
    return {step.argval for part in _within(code) for step in dis.get_instructions(part)
            if step.opname in ('LOAD_GLOBAL', 'LOAD_NAME')}


def _captured(function):
    """What a function has captured of the function around it, as far as it is bound already."""
    held = []
    for cell in function.__closure__ or ():
        with suppress(ValueError):
            held.append(cell.cell_contents)
    return held


def _is_library(module):
    """Whether a module belongs to Python, to this package or to an installed one, all known by their versions."""
    top = str(module).partition('.')[0]
    if top in sys.stdlib_module_names or top in (__package__, 'builtins', 'None'):
        return True
    file = getattr(sys.modules.get(top), '__file__', None)
    return file is not None and not INSTALLED.isdisjoint(Path(file).parts)


def _library_name(value):
    return f'{value.__module__}.{value.__qualname__} {_version(value.__module__)}'


def _version(module):
    top = str(module).partition('.')[0]
    return str(getattr(import_module(top), '__version__', sys.version)) if top != 'None' else sys.version
