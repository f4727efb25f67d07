"""What compiled code shares: options, the cache on disk, hints for vector units, and counters that threads wait for.

This module loads numba, so it is imported only where something is compiled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from warnings import warn

from llvmlite import ir
from numba import njit, types
from numba.core.options import DefaultOptions
from numba.extending import intrinsic

if TYPE_CHECKING:
    from typing import Any

SPINS = 2000  # number of checks of a counter, after which the core is left to another thread
COUNTED = {'_nrt': False} if hasattr(DefaultOptions, '_nrt') else {}
"""An internal option of numba that switches off reference counts of arrays, which take longer than a short run of slots."""
OPTIONS = {'error_model': 'numpy', 'fastmath': {'contract'}, 'nogil': True, 'no_cfunc_wrapper': True, **COUNTED}


class Spare:
    """The disk cache of numba, made optional: code that cannot be read or written there is compiled again."""

    told = False  # whether the user has been warned

    def __init__(self, cache: Any) -> None:
        self._cache = cache

    def __getattr__(self, name):
        return getattr(self._cache, name)

    def load_overload(self, *arguments: Any) -> Any:
        return self._without(self._cache.load_overload, arguments)

    def save_overload(self, *arguments: Any) -> Any:
        return self._without(self._cache.save_overload, arguments)

    def _without(self, call, arguments):
        try:
            return call(*arguments)
        except Exception as error:  # a damaged file may raise anything, a full disk OSError
            if not Spare.told:
                Spare.told = True
                warn(f"numba's cache in {self._cache.cache_path} cannot be used ({error!r}): compiled steps are compiled again "
                     'in each process, which takes seconds; empty this folder, or set NUMBA_CACHE_DIR to another', stacklevel=2)
            return None


def kept(function):
    """Compile a function, and keep the result on disk if numba finds a folder that it may write to."""
    try:
        compiled = njit(cache=True, **OPTIONS)(function)
    except RuntimeError:
        return njit(**OPTIONS)(function)
    compiled._cache = Spare(compiled._cache)
    return compiled


@intrinsic
def vectorise(typing_context):
    """Promise that arrays of the calling function do not overlap, and ask for wide vectors: worth a factor of 1.5."""
    def code(context, builder, signature, arguments):
        function = builder.function
        try:
            set.add(function.attributes, '"prefer-vector-width"="512"')  # a name of LLVM's; llvmlite's own `add` knows only some
            function.attributes.add('noinline')  # neither would hold within another function
            for argument in function.args:
                if argument.type.is_pointer and 'noalias' not in argument.attributes:
                    argument.add_attribute('noalias')
        except (AttributeError, TypeError, ValueError) as error:
            warn(f'this version of numba takes no hints for vector units ({error}): compiled steps are slower', stacklevel=2)
        return context.get_dummy_value()

    return types.void(), code


def written_out(text, name, **names):
    """The function `name` of a text, which is written out for what is known from types, such as a number of terms."""
    exec(text, names)  # noqa: S102  of nothing but numbers of terms
    return names[name]


def _place(context, builder, array_type, array, index):
    return builder.gep(context.make_array(array_type)(context, builder, value=array).data, [index])


@intrinsic
def read(typing_context, array, index):
    """Read an entry written by another thread, so that all that it wrote before is visible too."""
    def code(context, builder, signature, arguments):
        return builder.load_atomic(_place(context, builder, array, *arguments), 'acquire', 8)

    return types.int64(array, types.intp), code


@intrinsic
def tell(typing_context, array, index, value):
    """Write an entry for another thread, which also sees all that was written before."""
    def code(context, builder, signature, arguments):
        builder.store_atomic(arguments[2], _place(context, builder, array, *arguments[:2]), 'release', 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.int64), code


@intrinsic
def leave_core(typing_context):
    """Let another thread have the core."""
    def code(context, builder, signature, arguments):
        kind = ir.FunctionType(ir.IntType(32), [])
        builder.call(builder.module.globals.get('sched_yield') or ir.Function(builder.module, kind, 'sched_yield'), [])
        return context.get_dummy_value()

    return types.void(), code


@njit(no_cpython_wrapper=True, **OPTIONS)
def wait(done, place, count):
    """Wait until the counter at `place` has reached `count`."""
    tries = 0
    while read(done, place) < count:
        tries += 1
        if tries > SPINS:
            leave_core()
