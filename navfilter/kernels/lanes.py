"""Sixteen numbers side by side, as a type of their own in kernels: what is done to one is done to all, in few
instructions where the processor has them.

``load(array, row)`` reads sixteen numbers from a row of a contiguous array whose last axis has length `LANES`; ``row``
counts over all its other axes. ``store`` writes them there. Between them numbers are added, subtracted, multiplied and
divided as usual. A loop over sixteen elements would be turned into such instructions only where the compiler can prove
that arrays do not overlap.
"""

import operator

from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

__all__ = ["LANES", "all_of", "larger", "load", "magnitude", "root", "smaller", "store"]

#: Two of the widest registers there are: one is worked on while the other waits.
LANES = 16
_ir = cgutils.ir
_VECTOR = _ir.VectorType(_ir.DoubleType(), LANES)


class _Lanes(types.Type):
    """Sixteen numbers."""


_lanes = _Lanes(name=f"Lanes{LANES}")


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    """A vector of the compiler's."""

    def __init__(self, manager, kind):
        super().__init__(manager, kind, _VECTOR)


def _place(context, builder, kinds, arguments):
    """Pointer to sixteen numbers: row `arguments[1]` of an array."""
    array = context.make_array(kinds[0])(context, builder, value=arguments[0])
    row = context.cast(builder, arguments[1], kinds[1], types.intp)
    first = builder.gep(array.data, [builder.mul(row, _ir.Constant(row.type, LANES))])
    return builder.bitcast(first, _VECTOR.as_pointer())


@intrinsic
def load(typing, array, row):
    """Sixteen numbers from a row of an array."""

    def built(context, builder, kinds, arguments):
        value = builder.load(_place(context, builder, kinds.args, arguments))
        value.align = 8
        return value

    return _lanes(array, row), built


@intrinsic
def store(typing, array, row, value):
    """Sixteen numbers into a row of an array."""

    def built(context, builder, kinds, arguments):
        builder.store(arguments[2], _place(context, builder, kinds.args, arguments), align=8)
        return context.get_dummy_value()

    return types.void(array, row, value), built


@intrinsic
def all_of(typing, number):
    """Sixteen times the same number."""

    def built(context, builder, kinds, arguments):
        index = _ir.IntType(32)
        nothing = _ir.Constant(_VECTOR, _ir.Undefined)
        first = builder.insert_element(nothing, arguments[0], _ir.Constant(index, 0))
        return builder.shuffle_vector(first, nothing, _ir.Constant(_ir.VectorType(index, LANES), [0] * LANES))

    return _lanes(types.float64), built


class _OfTwo(AbstractTemplate):
    """An operator between sixteen numbers and sixteen others."""

    def generic(self, arguments, keywords):
        """The type of the result; None where it is another operator's matter."""
        return signature(_lanes, *arguments) if list(arguments) == [_lanes, _lanes] else None


def _operator(symbol, instruction):
    infer_global(symbol)(type(instruction, (_OfTwo,), {}))

    @lower_builtin(symbol, _lanes, _lanes)
    def built(context, builder, kinds, arguments):
        return getattr(builder, instruction)(*arguments, flags=("contract",))


for _symbol, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _operator(_symbol, _instruction)


def _function(name, count):
    """The signature and code of a function of the compiler's on so many times sixteen numbers."""

    def built(context, builder, kinds, arguments):
        kind = _ir.FunctionType(_VECTOR, [_VECTOR] * count)
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64")
        return builder.call(function, arguments)

    return _lanes(*[_lanes] * count), built


@intrinsic
def root(typing, u):
    """Square roots."""
    return _function("sqrt", 1)


@intrinsic
def magnitude(typing, u):
    """Absolute values."""
    return _function("fabs", 1)


@intrinsic
def smaller(typing, u, v):
    """The smaller one of each two."""
    return _function("minnum", 2)


@intrinsic
def larger(typing, u, v):
    """The larger one of each two."""
    return _function("maxnum", 2)
