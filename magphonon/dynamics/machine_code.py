"""Functions compiled by numba for addresses of arrays, and kept on disk.

Each is compiled for one signature, of numbers and addresses only: so it serves arrays of any shape, and takes a tenth of a
second to compile, where numba needs seconds for one that takes arrays.  What depends on the kind of law and layout is compiled
for each kind by itself, and called through its address; what calls it need not be compiled again.
"""

import ctypes
import hashlib
import sys
from contextlib import suppress
from pathlib import Path

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.ccallback import CFunc
from numba.core.sigutils import normalize_signature
from numba.extending import intrinsic

FLOATS, INTS, INDICES = types.CPointer(types.float64), types.CPointer(types.int64), types.CPointer(types.uint32)
"""Addresses of numbers, of integers, and of integers of half the size, where many are read."""
IN_PYTHON = {FLOATS: ctypes.c_void_p, INTS: ctypes.c_void_p, types.int64: ctypes.c_int64, types.float64: ctypes.c_double,
             types.void: None}
OPTIONS = {'error_model': 'numpy', 'fastmath': {'contract'}}
FILES = ('machine_code.py', 'intrinsics.py', 'compiled_bonds.py', 'compiled_steps.py', 'law_pieces.py')
"""Files of this folder from which functions or their constants are compiled."""
SOURCES = hashlib.sha256(b''.join(Path(__file__).with_name(name).read_bytes() for name in FILES)).hexdigest()
"""Stamp of all of them: numba looks at the one file that a function stands in."""


class _Kept(FunctionCache):
    """Files of one compiled function, written anew if they are damaged, or if a source has changed.

    Each function has files of its own: where processes compile several at once, numba may take one for the other.
    """

    def __init__(self, function, name):
        super().__init__(function)
        self._cache_file = IndexDataCacheFile(self._cache_path, f'{name}.{sys.implementation.cache_tag}', SOURCES)

    def _index_key(self, sig, codegen):
        return sig, codegen.magic_tuple()

    def load_overload(self, sig, target_context):
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # whatever a pickle of random bytes raises
            self.flush()
            return None

    def save_overload(self, sig, data):
        with suppress(OSError):  # a full disk
            super().save_overload(sig, data)


class Compiled:
    """A compiled function.

    Attributes
    ----------
    address : int
        At which compiled functions call it.
    kept : bool
        Whether it was found in its files.
    call : callable
        With numbers and addresses, by Python, other threads of which may run meanwhile.
    """

    def __init__(self, code):
        self._code, self.address, self.kept = code, code.address, bool(code.cache_hits)
        kinds = [IN_PYTHON[kind] for kind in (code._sig.return_type, *code._sig.args)]
        self.call = ctypes.CFUNCTYPE(*kinds)(self.address)


def compiled(signature, name):
    """Compile a function for the signature, or find it in its files, which have the name."""
    def compile_or_find(function):
        code = CFunc(function, normalize_signature(signature), {}, OPTIONS)
        with suppress(RuntimeError):  # numba finds no folder that it may write: each process compiles for itself
            code._cache = _Kept(function, name)
        code.compile()
        return Compiled(code)

    return compile_or_find


part = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **OPTIONS)
"""Make a function a part of compiled ones."""


def caller(signature):
    """A function which calls one of the signature, compiled before, at an address, with a tuple of arguments."""

    @intrinsic
    def call(typing_context, address, arguments):
        def code(context, builder, typed, values):
            kinds = [context.get_value_type(kind) for kind in (signature.return_type, *signature.args)]
            function = builder.inttoptr(values[0], ir.FunctionType(kinds[0], kinds[1:]).as_pointer())
            return builder.call(function, cgutils.unpack_tuple(builder, values[1]))

        return signature.return_type(types.int64, types.Tuple(signature.args)), code

    return call
