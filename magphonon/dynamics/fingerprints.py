"""Fingerprints of values: equal for what computes the same, different for what may compute something else.

Numbers and arrays are known by their bits, dataclasses by their fields, other objects by what a copy of them would be
made from, all of them by their attributes too, and functions by their code together with everything it reads: constants,
defaults, captured variables and the globals that it names, functions among them.  What belongs to the standard library or to
an installed package is known by its name and version.

A module without a version is known by what the code names of it, as `settings.AMPLITUDE`.  Where it could read anything of
it, as by `getattr(settings, name)`, by a module kept in an object or by an import within a function, its fingerprint cannot
be taken.

What a function gets from outside Python's variables is not seen: files that it opens, the environment (`os.environ`), the
clock, `sys.modules`, the internal state of a package or of compiled code.
"""

import dis
import sys
import types
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cached_property
from hashlib import sha256
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np

INSTALLED = {'site-packages', 'dist-packages'}
"""Directories that hold installed packages, those of a parent environment included."""
BUILT_IN = (types.BuiltinFunctionType, types.MethodWrapperType, types.WrapperDescriptorType, types.MethodDescriptorType,
            types.ClassMethodDescriptorType, types.GetSetDescriptorType, types.MemberDescriptorType)
PLAIN = dict, types.MappingProxyType
MACHINERY = {'__dict__', '__weakref__', '__doc__', '__module__', '__firstlineno__', '__static_attributes__',
             '__dataclass_fields__', '__dataclass_params__', '__match_args__', '__annotations__', '_abc_impl'}
"""Attributes of a class that do not affect any result."""

LOADS = {'LOAD_GLOBAL', 'LOAD_NAME', 'LOAD_DEREF', 'LOAD_CLASSDEREF', 'LOAD_FROM_DICT_OR_GLOBALS', 'LOAD_FROM_DICT_OR_DEREF'}
"""Instructions that load a variable from outside a function."""
READERS_OF_ANYTHING = {'eval', 'exec', 'globals', '__import__'}
"""Built-in functions through which code reads variables that it does not name."""


class Unknowable(ValueError):
    """A value whose fingerprint cannot be taken, such as an open file."""


def fingerprint(value: object) -> str:
    """Fingerprint of a value, 64 hexadecimal digits.

    Raises
    ------
    Unknowable
        If it holds something that cannot be copied, such as an open file or a generator, draws random numbers, or may read
        anything of a module.
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
        if (kind is np.ndarray or isinstance(value, np.generic)) and not value.dtype.hasobject:
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
            entries = sorted(_hash(fingerprint(name), self.of(entry)) for name, entry in _named(value))
            return _hash(self.of(kind), self.of(attributes(value)) if kind not in PLAIN else b'', *entries)
        if kind is np.ndarray:
            return _hash('objects', repr(value.shape), self.of(value.tolist()))
        if isinstance(value, types.CodeType):
            return self._code(value)
        if isinstance(value, types.ModuleType):
            return self._module(value)
        if isinstance(value, type):
            return self._class(value)
        if isinstance(value, types.FunctionType):
            return self._function(value) if _is_own(value) else self._library_function(value)
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
        compiled, wrapped = (getattr(value, name, None) for name in ('py_func', '__wrapped__'))
        if _is_library(kind.__module__) and isinstance(compiled, types.FunctionType):  # by numba
            return _hash('py_func', self.of(compiled))
        if isinstance(wrapped, types.FunctionType):  # as functools.lru_cache has it
            return _hash('__wrapped__', self.of(wrapped), self._object(value, kind))
        return self._object(value, kind)

    def _object(self, value, kind):
        if isinstance(value, np.random.Generator | np.random.RandomState | np.random.BitGenerator):
            raise Unknowable(f'{value!r} draws other random numbers each time; draw them once into an array, and read that')
        own = is_dataclass(value) or isinstance(value, np.ndarray) or not _is_library(kind.__module__)
        held = self.of(attributes(value)) if own else b''
        if is_dataclass(value):
            return _hash(self.of(kind), held,
                         *(_hash(field.name, self.of(getattr(value, field.name))) for field in fields(value)))
        try:
            recipe = value.__reduce_ex__(4)
        except Exception as error:
            raise Unknowable(f'{value!r} cannot be copied ({error})') from None
        if isinstance(recipe, str):
            return _hash('global', recipe, str(getattr(value, '__module__', '')), self.of(kind), held)
        make, arguments, state, *items = (*recipe, None, None, None)[:5]
        if isinstance(state, dict):  # a cached property is computed from the rest, sooner or later
            state = {name: part for name, part in state.items() if not isinstance(getattr(kind, name, None), cached_property)}
        return _hash('object', held, self.of(kind), self.of(make), self.of(arguments), self.of(state),
                     *(self.of(list(part)) if part is not None else b'' for part in items))

    def _library_function(self, function):
        return _hash('of a package', _library_name(function), self.of(list(_captured(function).values())))

    def _function(self, function):
        return _hash('function', self.of(function.__code__), self.of(function.__defaults__), self.of(function.__kwdefaults__),
                     self.of(vars(function)), *self._read(function), *map(self._import, _imports(function.__code__)))

    def _read(self, function):
        """Names and fingerprints of what a function reads from outside."""
        paths = _paths(function.__code__)
        found = {path[0]: function.__globals__[path[0]] for path in paths if path[0] in function.__globals__}
        for name in sorted({path[0] for path in paths} & READERS_OF_ANYTHING - found.keys()):
            raise Unknowable(f'the function {function.__qualname__} calls {name}, by which it may read anything; let it name '
                             'the variables that it reads')
        for name, value in sorted((found | _captured(function)).items()):
            yield name
            if _is_own_module(value):
                yield from (self._part(value, path[1:]) for path in sorted(paths) if path[0] == name)
            else:
                yield self.of(value)

    def _part(self, module, names):
        """The value that is read of a module without a version, by the names after its own, as in `settings.push.AMPLITUDE`."""
        value = module
        for k, name in enumerate(names, 1):
            value = getattr(value, name, None)
            if not _is_own_module(value):
                return _hash(*names[:k], self.of(value))
        return self._module(value)

    def _import(self, module):
        if module.startswith('.') or not _is_library(module):
            raise Unknowable(f'a function imports {module} when it is called, and may read anything of it; import it at the top '
                             'of the file, and name in the function what it reads of it')
        return _hash('import', module, _version(module))

    def _code(self, code):
        return _hash('code', code.co_code, repr((code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount,
                                                 code.co_flags, code.co_names, code.co_freevars, code.co_cellvars)),
                     getattr(code, 'co_exceptiontable', b''), *map(self.of, code.co_consts))

    def _module(self, module):
        if _is_own_module(module):
            name = module.__name__
            raise Unknowable(f'anything may be read of the module {name}, which is handed over as a whole; name in the function '
                             f'what it reads, as {name}.AMPLITUDE, and import {name} at the top of the file')
        return _hash('module', module.__name__, _version(module.__name__))

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


def _paths(code):
    """Variables from outside that a code reads, each with the names of the attributes that follow at once: set of tuples."""
    paths = set()
    for part in _within(code):
        path = ()
        for step in dis.get_instructions(part):
            if path and step.opname in ('LOAD_ATTR', 'LOAD_METHOD'):
                path += (step.argval,)
            elif step.opname not in ('EXTENDED_ARG', 'CACHE'):
                paths.add(path)
                path = (step.argval,) if step.opname in LOADS else ()
        paths.add(path)
    return paths - {()}


def _imports(code):
    """Names of the modules that a code imports, those relative to its package with a dot in front, ascending."""
    found = set()
    for part in _within(code):
        steps = [step for step in dis.get_instructions(part) if step.opname not in ('EXTENDED_ARG', 'CACHE')]
        found |= {'.' * level.argval + step.argval for level, _, step in zip(steps, steps[1:], steps[2:], strict=False)
                  if step.opname == 'IMPORT_NAME'}
    return sorted(found)


def _captured(function):
    """The variables that a function uses of the function around it, as far as they have a value already: dict by name."""
    held = {}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        with suppress(ValueError):
            held[name] = cell.cell_contents
    return held


def attributes(value):
    """Attributes of an object itself, in its dictionary and in slots, by name; a cached property is computed from the others."""
    kind = type(value)
    held = dict(getattr(value, '__dict__', {}))
    for base in kind.__mro__:
        for name, slot in vars(base).items():
            if isinstance(slot, types.MemberDescriptorType):
                with suppress(AttributeError):
                    held[f'{base.__qualname__}.{name}'] = slot.__get__(value)
    return {name: part for name, part in held.items() if not isinstance(getattr(kind, name, None), cached_property)}


def _is_own(function):
    return not _is_library(function.__globals__.get('__name__', '__main__'))  # functools.wraps may have changed __module__


def _is_own_module(value):
    return isinstance(value, types.ModuleType) and not _is_library(value.__name__)


def _is_library(module):
    """Whether a module belongs to Python, to this package or to an installed one, all known by their versions."""
    top = str(module).partition('.')[0]
    if top in sys.stdlib_module_names or top in (__package__.partition('.')[0], 'builtins', 'None'):
        return True
    file = getattr(sys.modules[top], '__file__', None) if top in sys.modules else getattr(find_spec(top), 'origin', None)
    return file is not None and not INSTALLED.isdisjoint(Path(file).parts)


def _library_name(value):
    return f'{value.__module__}.{value.__qualname__} {_version(value.__module__)}'


def _version(module):
    top = str(module).partition('.')[0]
    return str(getattr(import_module(top), '__version__', sys.version)) if top != 'None' else sys.version
