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

__all__ = ["LANES", "VECTOR", "all_of", "call", "compiled", "lanes", "load", "store"]

#: Numbers at a time: what the widest registers there are hold.
LANES = 8
_ir = cgutils.ir
VECTOR = _ir.VectorType(_ir.DoubleType(), LANES)


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


def all_of(number):
    """Eight times the same number."""
    return np.full(LANES, number)


def compiled(function, result, *kinds):
    """Decorates what builds the instructions that stand for a function, or operator, in a kernel."""

    def generic(self, arguments, keywords):
        found = [types.unliteral(argument) for argument in arguments]
        other = result is lanes and lanes in kinds and lanes not in found
        return None if other else signature(result, *found)

    infer_global(function)(type(f"_Of{function.__name__}", (AbstractTemplate,), {"generic": generic}))
    return lower_builtin(function, *kinds)


def _place(context, builder, kinds, arguments):
    """Pointer to eight numbers: row `arguments[1]` of an array."""
    array = context.make_array(kinds[0])(context, builder, value=arguments[0])
    row = context.cast(builder, arguments[1], kinds[1], types.intp)
    first = builder.gep(array.data, [builder.mul(row, _ir.Constant(row.type, LANES))])
    return builder.bitcast(first, VECTOR.as_pointer())


@compiled(load, lanes, types.Array, types.Integer)
def _build_load(context, builder, kinds, arguments):
    value = builder.load(_place(context, builder, kinds.args, arguments))
    value.align = 8
    return value


@compiled(store, types.void, types.Array, types.Integer, lanes)
def _build_store(context, builder, kinds, arguments):
    builder.store(arguments[2], _place(context, builder, kinds.args, arguments), align=8)
    return context.get_dummy_value()


@compiled(all_of, lanes, types.Float)
def _build_all(context, builder, kinds, arguments):
    index, nothing = _ir.IntType(32), _ir.Constant(VECTOR, _ir.Undefined)
    first = builder.insert_element(nothing, arguments[0], _ir.Constant(index, 0))
    return builder.shuffle_vector(first, nothing, _ir.Constant(_ir.VectorType(index, LANES), [0] * LANES))


def call(builder, name, *arguments):
    """One of the compiler's own functions."""
    kind = _ir.FunctionType(VECTOR, [VECTOR] * len(arguments))
    called = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64")
    return builder.call(called, arguments)


def _compile_operators():
    """Operators are instructions. Products and sums may be rounded once, where the processor can."""
    symbols = {operator.add: "fadd", operator.sub: "fsub", operator.mul: "fmul", operator.truediv: "fdiv"}
    for symbol, instruction in symbols.items():

        @compiled(symbol, lanes, lanes, lanes)
        def build_operator(context, builder, kinds, arguments, instruction=instruction):
            return getattr(builder, instruction)(*arguments, flags=("contract",))


_compile_operators()
