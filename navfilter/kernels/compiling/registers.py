"""Eight numbers as one value: what is done to one is done to all, in few instructions where the processor has them.

``load(array, row)`` reads such a value from an array whose last axis is a multiple of `LANES` long; ``row`` counts
those. ``store`` writes it there. (A loop over eight elements would be turned into such instructions only where the
compiler can prove that arrays do not overlap.) Without the compiler such a value is an array.
"""

import operator

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model

__all__ = [
    *("LANES", "VECTOR", "across", "all_below", "all_of", "call", "column", "compiled", "eight", "fetch", "first_six"),
    *("if_below", "if_equal", "lanes", "load", "magnitude", "not_zero", "put", "put_away", "put_column", "spread"),
    *("store", "times", "transposed"),
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


def across(array, first, width, columns):
    """Eight times eight numbers of an array of one axis, `width` apart, from `first` on, as columns of a square one."""
    columns[:] = np.array([array[first + width * i :][:LANES] for i in range(LANES)]).T


def all_of(number):
    """Eight times the same number."""
    return np.full(LANES, number)


def first_six(a, b, c, d, e, f):
    """Six numbers, and two that are 0."""
    return np.array([a, b, c, d, e, f, 0.0, 0.0])


def column(table, j):
    """Six numbers of a column of a table, and two that are 0."""
    return np.append(table[:6, j], [0.0, 0.0])


def put_column(table, j, value):
    """The first six numbers into a column of a table."""
    table[:6, j] = value[:6]


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


def if_equal(a, b, yes, no):
    """One or the other, where two are equal, and where they are not."""
    return np.where(a == b, yes, no)


def all_below(a, b):
    """Whether of the first six numbers all are less than the others'; a NaN is not."""
    return bool(np.all(a[:6] < b[:6]))


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


@compiled(across, types.void, types.Array, types.Integer, types.Integer, types.Array)
def _build_across(context, builder, kinds, arguments):
    of, to = (context.make_array(kinds.args[i])(context, builder, value=arguments[i]).data for i in (0, 3))
    place, width = (context.cast(builder, arguments[i], kinds.args[i], types.intp) for i in (1, 2))
    rows = []
    for _ in range(LANES):
        rows.append(fetch(builder, builder.gep(of, [place])))
        place = builder.add(place, width)
    to = builder.bitcast(to, VECTOR.as_pointer())
    for i, row in enumerate(transposed(builder, rows)):
        builder.store(row, builder.gep(to, [_ir.Constant(_INDEX, i)]), align=8)
    return context.get_dummy_value()


def call(builder, name, *arguments):
    """One of the compiler's own functions."""
    kind = _ir.FunctionType(VECTOR, [VECTOR] * len(arguments))
    called = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64")
    return builder.call(called, arguments)


@compiled(first_six, lanes, *[types.Float] * 6)
def _build_six(context, builder, kinds, arguments):
    value = _ir.Constant(VECTOR, [0.0] * LANES)
    for i, argument in enumerate(arguments):
        value = builder.insert_element(value, argument, _ir.Constant(_INDEX, i))
    return value


def _in_column(context, builder, kinds, arguments):
    """Pointers to the first six numbers of column `arguments[1]` of a table."""
    table = context.make_array(kinds[0])(context, builder, value=arguments[0])
    place, width = (
        context.cast(builder, arguments[1], kinds[1], types.intp),
        cgutils.unpack_tuple(builder, table.shape)[1],
    )
    for _ in range(6):
        yield builder.gep(table.data, [place])
        place = builder.add(place, width)


@compiled(column, lanes, types.Array, types.Integer)
def _build_column(context, builder, kinds, arguments):
    places = _in_column(context, builder, kinds.args, arguments)
    return _build_six(context, builder, kinds, [builder.load(place) for place in places])


@compiled(put_column, types.void, types.Array, types.Integer, lanes)
def _build_put_column(context, builder, kinds, arguments):
    for i, place in enumerate(_in_column(context, builder, kinds.args, arguments)):
        builder.store(builder.extract_element(arguments[2], _ir.Constant(_INDEX, i)), place)
    return context.get_dummy_value()


@compiled(magnitude, lanes, lanes)
def _build_magnitude(context, builder, kinds, arguments):
    return call(builder, "fabs", *arguments)


@compiled(not_zero, types.int64, lanes)
def _build_not_zero(context, builder, kinds, arguments):
    bits = builder.fcmp_unordered("!=", arguments[0], _ir.Constant(VECTOR, [0.0] * LANES))
    return builder.zext(builder.ctpop(builder.bitcast(bits, _ir.IntType(LANES))), _ir.IntType(64))


@compiled(if_below, lanes, lanes, lanes, lanes, lanes)
def _build_if_below(context, builder, kinds, arguments):
    return builder.select(builder.fcmp_ordered("<", *arguments[:2]), *arguments[2:])


@compiled(if_equal, lanes, lanes, lanes, lanes, lanes)
def _build_if_equal(context, builder, kinds, arguments):
    return builder.select(builder.fcmp_ordered("==", *arguments[:2]), *arguments[2:])


@compiled(all_below, types.boolean, lanes, lanes)
def _build_all_below(context, builder, kinds, arguments):
    bits = builder.bitcast(builder.fcmp_ordered("<", *arguments), _ir.IntType(LANES))
    six = _ir.Constant(_ir.IntType(LANES), 2**6 - 1)
    return builder.icmp_unsigned("==", builder.and_(bits, six), six)


def _compile_operators():
    """Operators are instructions. Products and sums may be rounded once, where the processor can."""
    symbols = {operator.add: "fadd", operator.sub: "fsub", operator.mul: "fmul", operator.truediv: "fdiv"}
    for symbol, instruction in symbols.items():

        @compiled(symbol, lanes, lanes, lanes)
        def build_operator(context, builder, kinds, arguments, instruction=instruction):
            return getattr(builder, instruction)(*arguments, flags=("contract",))


_compile_operators()
