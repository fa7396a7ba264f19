"""Eight numbers as one value: what is done to one is done to all, in few instructions where the processor has them.

``load(array, row)`` reads such a value from an array whose last axis is a multiple of `LANES` long; ``row`` counts
those. ``store`` writes it there. (A loop over eight elements would be transpose into such instructions only where the
compiler can prove that arrays do not overlap.) Without the compiler such a value is an array.
"""

import operator

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model

__all__ = [
    *("LANES", "VECTOR", "all_of", "call", "compiled", "eight", "exchange", "fetch", "if_below", "lanes", "load"),
    *("magnitude", "not_zero", "put", "put_away", "spread", "stand_for", "store", "times", "transpose"),
]

#: Numbers at a time: what the widest registers there are hold.
LANES = 8
_ir = cgutils.ir
VECTOR, _INDEX = _ir.VectorType(_ir.DoubleType(), LANES), _ir.IntType(32)


class _Lanes(types.Type):
    """Eight numbers."""


lanes = _Lanes(name=f"Lanes{LANES}")


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    """A vector of the compiler's."""

    def __init__(self, manager, kind):
        super().__init__(manager, kind, VECTOR)


def load(array, row):
    """Eight numbers from a row of an array, or of what stands for one."""
    return array.load(row) if hasattr(array, "load") else array.reshape(-1, LANES)[row].copy()


def store(array, row, value):
    """Eight numbers into a row of an array, or of what stands for one."""
    if hasattr(array, "store"):
        array.store(row, value)
    else:
        array.reshape(-1, LANES)[row] = value


def eight(array, first):
    """Eight numbers of an array of one axis, from any element on."""
    return array[first : first + LANES].copy()


def put(array, first, value):
    """Eight numbers to where `eight` would read them."""
    array[first : first + LANES] = value


def transpose(A, i, wide, B, j, width):
    """The square block of eight rows, `wide` apart, from element i of A on, transposed to B, rows `width` apart."""
    for k, row in enumerate(np.array([A[i + wide * k :][:LANES] for k in range(LANES)]).T):
        B[j + width * k :][:LANES] = row


def exchange(A, i, wide, B, j, width):
    """`transpose` there and back at once."""
    block = np.array([B[j + width * k :][:LANES] for k in range(LANES)]).T
    transpose(A, i, wide, B, j, width)
    for k, row in enumerate(block):
        A[i + wide * k :][:LANES] = row


def all_of(number):
    """Eight times the same number."""
    return np.full(LANES, number)


def times(a, b):
    """Products, each rounded by itself: those of `*` may be rounded once with a sum."""
    return a * b


def magnitude(value):
    """Absolute values."""
    return np.abs(value)


def not_zero(value):
    """How many of the numbers are not 0."""
    return int(np.count_nonzero(value))


def if_below(a, b, yes, no):
    """One or the other, where the first is the lesser one, and where it is not."""
    return np.where(a < b, yes, no)


def compiled(function, result, *kinds):
    """Decorates what builds the instructions that stand for a function, or operator, in a kernel."""

    def generic(self, arguments, keywords):
        found = [types.unliteral(argument) for argument in arguments]
        other = result is lanes and lanes in kinds and lanes not in found
        return None if other else signature(result, *found)

    infer_global(function)(type(f"_Of{function.__name__}", (AbstractTemplate,), {"generic": generic}))
    return lower_builtin(function, *kinds)


def fetch(builder, place):
    """Eight numbers from where a pointer points to."""
    value = builder.load(builder.bitcast(place, VECTOR.as_pointer()))
    value.align = 8
    return value


def put_away(builder, value, place):
    """Eight numbers to where a pointer points to."""
    builder.store(value, builder.bitcast(place, VECTOR.as_pointer()), align=8)


def spread(builder, number):
    """Eight times the same number."""
    nothing = _ir.Constant(_ir.VectorType(number.type, LANES), _ir.Undefined)
    same = _ir.Constant(_ir.VectorType(_INDEX, LANES), [0] * LANES)
    return builder.shuffle_vector(builder.insert_element(nothing, number, _ir.Constant(_INDEX, 0)), nothing, same)


def _compile_memory(read, write, step):
    """From an array, and to one: eight numbers from `step` times the number given on."""

    def place(context, builder, kinds, arguments):
        array = context.make_array(kinds[0])(context, builder, value=arguments[0])
        first = context.cast(builder, arguments[1], kinds[1], types.intp)
        return builder.gep(array.data, [builder.mul(first, _ir.Constant(first.type, step))])

    @compiled(read, lanes, types.Array, types.Integer)
    def build_read(context, builder, kinds, arguments):
        return fetch(builder, place(context, builder, kinds.args, arguments))

    @compiled(write, types.void, types.Array, types.Integer, lanes)
    def build_write(context, builder, kinds, arguments):
        put_away(builder, arguments[2], place(context, builder, kinds.args, arguments))
        return context.get_dummy_value()


_compile_memory(load, store, LANES)
_compile_memory(eight, put, 1)


@compiled(all_of, lanes, types.Float)
def _build_all(context, builder, kinds, arguments):
    return spread(builder, *arguments)


@compiled(times, lanes, lanes, lanes)
def _build_times(context, builder, kinds, arguments):
    return builder.fmul(*arguments)


def transposed(builder, rows):
    """Eight such values, the rows of a square block, as those of the block transposed. Without a way through memory:
    what is stored number by number cannot be loaded in rows for a while.
    """
    rows, apart = list(rows), LANES // 2
    while apart:
        mine = [j if j & apart == 0 else LANES + j - apart for j in range(LANES)]
        masks = [_ir.Constant(_ir.VectorType(_INDEX, LANES), [j + add for j in mine]) for add in (0, apart)]
        for i in range(LANES):
            if i & apart == 0:
                pair = rows[i], rows[i + apart]
                rows[i], rows[i + apart] = (builder.shuffle_vector(*pair, mask) for mask in masks)
        apart //= 2
    return rows


def _compile_turns(function, both):
    """Of one block into the other's place, or of both."""

    @compiled(function, types.void, *(types.Array, types.Integer, types.Integer) * 2)
    def build(context, builder, kinds, arguments):
        blocks = []
        for k in (0, 3):
            data = context.make_array(kinds.args[k])(context, builder, value=arguments[k]).data
            place, width = (context.cast(builder, arguments[n], kinds.args[n], types.intp) for n in (k + 1, k + 2))
            rows = [builder.add(place, builder.mul(width, _ir.Constant(width.type, i))) for i in range(LANES)]
            blocks.append([builder.gep(data, [row]) for row in rows])
        moved = [[fetch(builder, place) for place in block] for block in blocks[: 1 + both]]
        for block, rows in zip(reversed(blocks), moved, strict=False):
            for place, row in zip(block, transposed(builder, rows), strict=True):
                put_away(builder, row, place)
        return context.get_dummy_value()


_compile_turns(transpose, False)
_compile_turns(exchange, True)


def call(builder, name, *arguments):
    """One of the compiler's own functions."""
    kind = _ir.FunctionType(VECTOR, [VECTOR] * len(arguments))
    called = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64")
    return builder.call(called, arguments)


def stand_for(function, name):
    """Let one of the compiler's own functions stand for a function of such values in kernels."""

    @compiled(function, lanes, *[lanes] * function.__code__.co_argcount)
    def build_call(context, builder, kinds, arguments):
        return call(builder, name, *arguments)


stand_for(magnitude, "fabs")


@compiled(not_zero, types.int64, lanes)
def _build_not_zero(context, builder, kinds, arguments):
    bits = builder.fcmp_unordered("!=", arguments[0], _ir.Constant(VECTOR, [0.0] * LANES))
    return builder.zext(builder.ctpop(builder.bitcast(bits, _ir.IntType(LANES))), _ir.IntType(64))


@compiled(if_below, lanes, lanes, lanes, lanes, lanes)
def _build_if_below(context, builder, kinds, arguments):
    return builder.select(builder.fcmp_ordered("<", *arguments[:2]), *arguments[2:])


def _compile_operators():
    """Operators are instructions. Products and sums may be rounded once, where the processor can."""
    symbols = {operator.add: "fadd", operator.sub: "fsub", operator.mul: "fmul", operator.truediv: "fdiv"}
    for symbol, instruction in symbols.items():

        @compiled(symbol, lanes, lanes, lanes)
        def build_operator(context, builder, kinds, arguments, instruction=instruction):
            return getattr(builder, instruction)(*arguments, flags=("contract",))


_compile_operators()
