"""Kernels called by their address: what calls them is compiled once, whatever they are, and they are compiled only
where a vehicle has them.

A kernel that is called by its name is compiled into its caller again. By its address it costs 0.2 us a call.
"""

from collections.abc import Callable
from typing import Any

import numba
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

_settings: Any = config
#: What has an address, in the order in which it was asked for.
_KNOWN: dict[int, Callable[..., None]] = {}
_AT: dict[Callable[..., None], tuple[tuple[Any, ...], int]] = {}
_ROW, _TABLE = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
_PLACES = types.Array(types.int64, 1, "C")
#: z, nav, rate, par, cfg, H, res, see `navfilter.kernels.measurement`.
EQUATION = (_ROW, _ROW, _ROW, _ROW, _ROW, _TABLE, _ROW)
#: z, near, P, first, cfg, R, see there.
BEND = (_ROW, _TABLE, _TABLE, types.int64, _ROW, _TABLE)
#: nav, xd, drv, samples, Phid, Qd, Cr, acc, trace, see `navfilter.kernels.strapdown`.
STEPS = (_ROW, _ROW, _ROW, *(_TABLE,) * 6)
#: The same, with seconds in the place of samples, and without a trace.
HOLD = (_ROW, _ROW, _ROW, types.float64, _TABLE, _TABLE, _TABLE, _TABLE)
#: recent, nav, drv, errors, rows, gravity, see `navfilter.kernels.delayed_state`.
MOTION = (_TABLE, _ROW, _ROW, _ROW, _TABLE, _ROW)
#: equation, motion, facts, z, nav, rate, par, cfg, recent, drv, Cr, xd, since_s, variance, tilt, H, near, res, R: see
#: there.
SIGHT = (
    *(types.int64, types.int64, *(_ROW,) * 6, _TABLE, _ROW, _TABLE, _ROW),
    *(types.float64, types.float64, _TABLE, _TABLE, _TABLE, _ROW, _TABLE),
)
#: bench, spot, P, nav, x, acc, drv, Cr, recent, z, variance, count, since_s, see `navfilter.kernels.batch`.
CORRECTION = (
    *(_ROW, _PLACES, _TABLE, _ROW, _ROW, _TABLE, _ROW, _TABLE, _TABLE, _ROW, _ROW),
    *(types.int64, types.float64),
)
#: What Python hands to `navfilter.kernels.batch.run_batch`, for those who compile it ahead.
_READINGS = types.Array(types.boolean, 1, "C")
_MATRIX_OF_PLACES = types.Array(types.int64, 2, "C")
STRETCH = (
    *(_ROW, _PLACES, _ROW, _ROW, _MATRIX_OF_PLACES, _TABLE, _TABLE),
    types.Tuple((_TABLE, _TABLE)),
    types.Tuple((_ROW, _ROW, _TABLE, _TABLE)),
    types.Tuple((_ROW, _TABLE, _TABLE, _TABLE, _TABLE, _TABLE, _ROW, _ROW)),
    *(_TABLE, _ROW, _ROW),
    types.Tuple((_ROW, _TABLE, _MATRIX_OF_PLACES, _TABLE)),
    types.Tuple((_ROW, _PLACES, _PLACES, _READINGS, _READINGS, _TABLE, _TABLE, _TABLE)),
    types.Tuple((_TABLE, _TABLE, _ROW, _MATRIX_OF_PLACES, _TABLE)),
)
#: The same for `navfilter.kernels.batch.correct_reading`.
PROMPT = (
    *(_MATRIX_OF_PLACES, _TABLE, _ROW, _ROW),
    *(types.boolean, types.float64, types.float64, *(types.int64,) * 3),
)
#: The same for `navfilter.kernels.batch.propagate_sample`.
SAMPLE = (_MATRIX_OF_PLACES, _TABLE, types.float64, types.float64, types.int64)
#: The same for `navfilter.kernels.open_loop_residual.judge_level`.
LEVEL = (_ROW, types.float64, types.float64)
#: The same for `navfilter.kernels.noise_scale.update_scale`.
SCATTERED = (
    *(_ROW, _ROW, _ROW, types.int64, types.int64, _TABLE, types.int64, _TABLE, _ROW, _TABLE),
    *(types.float64, types.boolean),
)
#: The same for `navfilter.kernels.batch.readmission`.
READMISSION = (_ROW, _PLACES, _TABLE, _ROW, _ROW, _ROW, _TABLE, _TABLE, _TABLE)


def address(kernel: Callable[..., None], signature: tuple[Any, ...]) -> int:
    """Where a kernel stands, compiled for these arguments; without the JIT a number that `named` knows."""
    known = _AT.get(kernel)
    if known is not None and known[0] is signature:  # types take long to look up
        return known[1]
    if _settings.DISABLE_JIT:
        at = len(_KNOWN) + 1
    else:
        compiled = _dispatcher(kernel).get_compile_result(types.void(*signature))
        at = int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))
    _AT[kernel], _KNOWN[at] = (signature, at), kernel
    return at


def _dispatcher(kernel: Callable[..., None]) -> Any:
    """A user's own kernel may be a function that is not marked for numba yet."""
    return kernel if hasattr(kernel, "get_compile_result") else numba.njit(kernel)


def named(at: int) -> Callable[..., None]:
    """The kernel at an address."""
    return _KNOWN[at]


def _caller(signature: tuple[Any, ...]) -> Any:
    """Calls what stands at an address, with a tuple of arguments of these types."""
    if _settings.DISABLE_JIT:
        return lambda at, given: _KNOWN[int(at)](*given)

    @intrinsic
    def call(context, at, given):
        def generate(context, builder, _, values):
            function = context.call_conv.get_function_type(types.none, signature)
            pointer = builder.inttoptr(values[0], function.as_pointer())
            given = cgutils.unpack_tuple(builder, values[1])
            status, _ = context.call_conv.call_function(builder, pointer, types.none, signature, given)
            with builder.if_then(status.is_error, likely=False):
                context.call_conv.return_status_propagate(builder, status)
            return context.get_dummy_value()

        return types.void(types.int64, types.Tuple(signature)), generate

    return call


at_equation, at_bend, at_steps, at_hold = _caller(EQUATION), _caller(BEND), _caller(STEPS), _caller(HOLD)
at_motion, at_sight, at_correction = _caller(MOTION), _caller(SIGHT), _caller(CORRECTION)
