"""Words for compiled functions that numba lacks, or takes long to compile: addresses, bits of numbers, counters of threads."""

import os
from functools import cache

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from .machine_code import FLOATS, INDICES, INTS


@intrinsic
def floats(typing_context, addresses, n):
    """The numbers at address n of a table."""
    return FLOATS(INTS, types.intp), _at


@intrinsic
def ints(typing_context, addresses, n):
    """The integers at address n of a table."""
    return INTS(INTS, types.intp), _at


@intrinsic
def indices(typing_context, addresses, n):
    """The short integers at address n of a table."""
    return INDICES(INTS, types.intp), _at


def _at(context, builder, signature, arguments):
    address = builder.load(builder.gep(arguments[0], [arguments[1]]))
    return builder.inttoptr(address, context.get_value_type(signature.return_type))


@intrinsic
def past(typing_context, numbers, n):
    """The address of the number n, and so of those that follow it."""

    def code(context, builder, signature, arguments):
        return builder.gep(arguments[0], [arguments[1]])

    return numbers(numbers, types.intp), code


@cache
def row(count):
    """The function of `numbers`, n and step that takes `count` of the numbers, the first one at n: a tuple.

    Taken before a loop, they stay in registers, however many there are.  Where they are read within a loop, LLVM proves of the
    first ones only that nothing in the loop changes them, and does not vectorise a loop with about thirty of them.
    """
    taken = types.UniTuple(types.float64, count)

    @intrinsic
    def row(typing_context, numbers, n, step):
        def code(context, builder, signature, arguments):
            start, n, step = arguments
            places = [builder.add(n, builder.mul(ir.Constant(step.type, k), step)) for k in range(count)]
            return context.make_tuple(builder, taken, [builder.load(builder.gep(start, [place])) for place in places])

        return taken(FLOATS, types.intp, types.intp), code

    return row


@intrinsic
def horner(typing_context, coefficients, x):
    """The polynomial with a tuple of coefficients, that of the constant first, at x."""

    def code(context, builder, signature, arguments):
        *others, value = cgutils.unpack_tuple(builder, arguments[0])
        for c in reversed(others):
            value = builder.fadd(builder.fmul(value, arguments[1], flags=('contract',)), c, flags=('contract',))
        return value

    return types.float64(coefficients, types.float64), code


@intrinsic
def order(typing_context, x):
    """Bits of |x| as an integer: they have the order of |x|, nan above inf, and a maximum that vector units know."""

    def code(context, builder, signature, arguments):
        bits = builder.bitcast(arguments[0], ir.IntType(64))
        return builder.and_(bits, ir.Constant(ir.IntType(64), 2**63 - 1))

    return types.int64(types.float64), code


@intrinsic
def magnitude(typing_context, bits):
    """The number of which these are the bits."""

    def code(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], ir.DoubleType())

    return types.float64(types.int64), code


@intrinsic
def bits_of(typing_context, x):
    """Bits of x as an integer."""

    def code(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), code


@intrinsic
def higher(typing_context, a, b):
    """The larger of two integers."""

    def code(context, builder, signature, arguments):
        a, b = arguments
        return builder.select(builder.icmp_signed('>', a, b), a, b)

    return types.int64(types.int64, types.int64), code


@intrinsic
def vectorise(typing_context):
    """Promise that the arguments of the calling function do not overlap (C's restrict), and ask for wide vectors."""

    def code(context, builder, signature, arguments):
        function = builder.function
        set.add(function.attributes, '"prefer-vector-width"="512"')  # a name of LLVM's; llvmlite's own `add` knows only some
        function.attributes.add('noinline')  # neither would hold within another function
        for argument in function.args:
            if isinstance(argument.type, ir.PointerType) and 'noalias' not in argument.attributes:
                argument.add_attribute('noalias')
        return context.get_dummy_value()

    return types.void(), code


@intrinsic
def seen(typing_context, counters, n):
    """The counter n as another thread has left it; what that thread wrote before is there as well."""

    def code(context, builder, signature, arguments):
        return builder.load_atomic(builder.gep(arguments[0], [arguments[1]]), 'acquire', 8)

    return types.int64(INTS, types.intp), code


@intrinsic
def show(typing_context, counters, n, value):
    """Set the counter n for other threads, after all that was written before."""

    def code(context, builder, signature, arguments):
        builder.store_atomic(arguments[2], builder.gep(arguments[0], [arguments[1]]), 'release', 8)
        return context.get_dummy_value()

    return types.void(INTS, types.intp, types.int64), code


@intrinsic
def leave_core(typing_context):
    """Let another thread run on this core."""

    def code(context, builder, signature, arguments):
        name = 'SwitchToThread' if os.name == 'nt' else 'sched_yield'
        builder.call(cgutils.get_or_insert_function(builder.module, ir.FunctionType(ir.IntType(32), []), name), [])
        return context.get_dummy_value()

    return types.void(), code
