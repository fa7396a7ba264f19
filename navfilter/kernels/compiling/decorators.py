"""How kernels are compiled: each once, and without what nobody uses.

numba copies what a kernel calls into it, with all that this calls in turn, and optimises the copies anew: two thirds of
what the optimiser had to do. A kernel that is compiled `apart` is called as a function of its own instead. Its callers
know it by a symbol, which is defined when they are compiled, and again before they are loaded from numba's cache. Small
ones that are called in loops are better copied.
"""

import ctypes
import functools
import hashlib
import importlib
import inspect
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
from numba import config, types
from numba.core import cgutils
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.extending import _Intrinsic
from numba.core.typed_passes import NativeLowering
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin
from numba.np.arrayobj import make_array, populate_array

#: Passes of numba that look for what no kernel has: closures, expressions of whole arrays, literals to unroll.
_IDLE = {
    *("InlineClosureLikes", "MakeFunctionToJitFunction", "WithLifting", "RewriteDynamicRaises", "FindLiterallyCalls"),
    *("LiteralUnroll", "LiteralPropagationSubPipelinePass", "InlineOverloads", "NopythonRewrites"),
}
#: Versions of numba whose insides are as these decorators take them; with any other kernels are compiled as by numba
#: itself, which takes twice the time.
FROM, BELOW = (0, 65), (0, 69)
KNOWN = FROM <= tuple(int(part) for part in numba.__version__.split(".")[:2]) < BELOW

#: What is worth vectors is written in vectors (`strapdown`, `kalman`, `registers`): those that LLVM makes of loops over
#: two to four dozen numbers are no quicker, and double the code that it has to look through.
OPTIMISER = {"LOOP_VECTORIZE": 0, "SLP_VECTORIZE": 0}

#: Of kernels that allocate nothing: numba is not to count references to arrays, see `navfilter.kernels`; and of those
#: that do, where such call them.
UNCOUNTED: dict = {"_nrt": False}
COUNTED: dict = {"_nrt": True}

#: What defines kernels that are called by symbols, by these.
_definitions: dict[str, Callable[[], Any]] = {}

#: Where kernels stand, and how one of their files imports from others.
_KERNELS = Path(__file__).parents[1]
_IMPORT = re.compile(r"^from (navfilter\.kernels[\w.]*) import \(?([\w\s,]*)", re.MULTILINE)

_settings: Any = config
_Base: Any = _Intrinsic
_Native: Any = NativeLowering


def njit(*, apart: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` for kernels.

    Parameters
    ----------
    apart : bool
        Other kernels call it as a function of its own, in place of copying it, see `called_apart`.
    **options
        Of numba.

    Returns
    -------
    decorator : callable
    """

    def compiled(function: Callable[..., Any]) -> Any:
        inner = KNOWN and function.__name__.startswith("_")
        lean: dict[str, Any] = {"no_cfunc_wrapper": True, "no_cpython_wrapper": inner, "pipeline_class": _Lean}
        kernel = numba.njit(**(lean if KNOWN else {}), **options)(function)
        _stamp(kernel, function.__module__)
        kernel = Inner(kernel) if inner and not _settings.DISABLE_JIT else kernel
        return called_apart(kernel) if apart else kernel

    return compiled


def _stamp(kernel: Any, module: str) -> None:
    """Let a kernel that numba has kept count as long as its file and those whose kernels it may call hold the same.

    numba looks at the file of the kernel alone, some versions at its time, which is another one in a copy.
    """
    kept = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if kept is not None and module.startswith("navfilter.kernels."):
        kept._source_stamp = checksum(module)


@functools.cache
def checksum(module: str) -> str:
    """Of the file of a module of kernels, and of those that it imports, itself or by another.

    Parameters
    ----------
    module : str
        Of `navfilter.kernels`.
    """
    found, todo = {module}, [module]
    while todo:
        for folder, names in _IMPORT.findall(_source(todo.pop())):
            new = {f"{folder}.{name}" for name in re.findall(r"\w+", names)} | {folder}
            todo += sorted(new - found)
            found |= new
    return hashlib.sha256("".join(_source(name) for name in sorted(found)).encode()).hexdigest()


@functools.cache
def _source(module: str) -> str:
    """Of a module of kernels; nothing of what is none."""
    path = _KERNELS.joinpath(*module.split(".")[2:]).with_suffix(".py")
    return path.read_text(encoding="utf-8") if module.startswith("navfilter.kernels.") and path.is_file() else ""


def called_apart(kernel: Any) -> Any:
    """Mark a compiled kernel of a module of kernels, by the name under which it stands there.

    Parameters
    ----------
    kernel : numba.core.dispatcher.Dispatcher

    Returns
    -------
    Apart
        Is called as the kernel, by kernels and by Python. Without the JIT, or with a version of numba that is not
        known, what was given.
    """
    if _settings.DISABLE_JIT or not KNOWN:
        return kernel
    # a method of Python's would take as long as half a small kernel
    return type("Apart", (Apart,), {"__call__": staticmethod(kernel)})(kernel)


def shaped(flat: Any, rows: int, columns: int) -> Any:
    """Elements that stand one behind the other, be it in a matrix, as one of so many rows and columns: a view that
    nobody counts.

    `reshape` is a call of a library in a kernel, which first finds out whether it can: two per cent of a replay.
    """
    return flat.reshape(rows, columns)


def flat(matrix: Any) -> Any:
    """The elements of a matrix, row by row, as one row: a view like that of `shaped`."""
    return matrix.reshape(matrix.size)


def standing(hand: Any, k: int, kind: Any) -> Any:
    """A matrix of this kind (`numpy.float64` or `numpy.int64`): a view like that of `shaped`. Row k of `hand` says
    where it stands, its rows and columns. Each array that Python hands to a kernel costs half as much as a line of it.
    """
    at, rows, columns = hand[k].tolist()
    size = rows * columns * np.dtype(kind).itemsize
    return np.frombuffer((ctypes.c_char * size).from_address(at), kind).reshape(rows, columns)


def scratch(kind: Any, rows: int, columns: int) -> Any:
    """A matrix of this kind, of no particular numbers, that is gone when the kernel which asks for it returns: it lies
    on the stack, and nobody has to be asked for memory. Not in a loop.
    """
    return np.empty((rows, columns), kind)


@infer_global(scratch)
class _Scratch(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(types.Array(args[0].dtype, 2, "C"), *map(types.unliteral, args))


@infer_global(standing)
class _Standing(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(types.Array(args[2].dtype, 2, "C"), *map(types.unliteral, args))


@infer_global(shaped)
class _Shaped(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(types.Array(args[0].dtype, 2, "C"), *args)


@infer_global(flat)
class _Flat(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        return signature(types.Array(args[0].dtype, 1, "C"), *args)


def _view(context: Any, builder: Any, sig: Any, data: Any, itemsize: Any, lengths: Sequence[Any]) -> Any:
    """An array of these lengths, row by row, where another one begins."""
    view, strides = make_array(sig.return_type)(context, builder), [itemsize]
    for length in reversed(lengths[1:]):
        strides.insert(0, builder.mul(length, strides[0]))
    shape, strides = (cgutils.pack_array(builder, values) for values in (lengths, strides))
    populate_array(view, data=data, shape=shape, strides=strides, itemsize=itemsize, meminfo=None)
    return view._getvalue()


@lower_builtin(shaped, types.Array, types.Integer, types.Integer)
def _build_shaped(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    of = make_array(sig.args[0])(context, builder, value=args[0])
    lengths = [context.cast(builder, *of, types.intp) for of in zip(args[1:], sig.args[1:], strict=True)]
    return _view(context, builder, sig, of.data, of.itemsize, lengths)


@lower_builtin(flat, types.Array)
def _build_flat(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    of = make_array(sig.args[0])(context, builder, value=args[0])
    return _view(context, builder, sig, of.data, of.itemsize, [builder.mul(*cgutils.unpack_tuple(builder, of.shape))])


@lower_builtin(scratch, types.Any, types.Integer, types.Integer)
def _build_scratch(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    kind = sig.return_type.dtype
    lengths = [context.cast(builder, *of, types.intp) for of in zip(args[1:], sig.args[1:], strict=True)]
    data = builder.alloca(context.get_data_type(kind), builder.mul(*lengths))
    return _view(context, builder, sig, data, context.get_constant(types.intp, kind.bitwidth // 8), lengths)


@lower_builtin(standing, types.Array, types.Integer, types.Any)
def _build_standing(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    hand, kind = make_array(sig.args[0])(context, builder, value=args[0]), sig.return_type.dtype
    first = builder.mul(context.cast(builder, args[1], sig.args[1], types.intp), context.get_constant(types.intp, 3))
    where = [builder.add(first, context.get_constant(types.intp, column)) for column in range(3)]
    at, *lengths = [builder.load(builder.gep(hand.data, [place])) for place in where]
    data = builder.inttoptr(at, context.get_data_type(kind).as_pointer())
    return _view(context, builder, sig, data, context.get_constant(types.intp, kind.bitwidth // 8), lengths)


class _Lean(CompilerBase):
    """numba's compiler without what would be idle."""

    def define_pipelines(self) -> list[PassManager]:
        passes = PassManager("kernel")
        for kind, text in DefaultPassBuilder.define_nopython_pipeline(self.state).passes:
            if kind.__name__ not in _IDLE:
                passes.add_pass(_Lowering if kind is NativeLowering else kind, text)
        passes.finalize()
        return [passes]


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(_Native):
    """numba's, with `OPTIMISER` in force: it compiles one function at a time. Symbols that are called are to be defined
    before it is loaded, also where what calls them was linked from numba's cache: numba forgets what that needs.
    """

    _name = "kernel_lowering"

    def run_pass(self, state: Any) -> bool:
        before = {name: getattr(_settings, name) for name in OPTIMISER}
        try:
            vars(_settings).update(OPTIMISER)
            done: bool = super().run_pass(state)
        finally:
            vars(_settings).update(before)
        called = (f.name for f in state.library._final_module.functions if f.is_declaration)
        missing = {_definitions[name] for name in called if name in _definitions} - state.library._reload_init
        state.library._reload_init.update(missing)
        state.reload_init.extend(missing)
        return done


class Inner:
    """A kernel that Python cannot call: it would end the process. Whatever else is asked of it is the kernel's."""

    def __init__(self, kernel: Any) -> None:
        self.kernel = kernel
        functools.update_wrapper(self, kernel.py_func)

    def __call__(self, *args: Any) -> Any:
        raise TypeError(f"{self.kernel.__name__} is called by other kernels only")

    def __getattr__(self, name: str) -> Any:
        return getattr(_kernel(self, name), name)


class Apart(_Base):
    """A kernel with a symbol of its own; whatever else is asked of it is the kernel's."""

    def __init__(self, kernel: Any) -> None:
        self.kernel = kernel
        super().__init__(kernel.__name__, _caller(kernel))
        functools.update_wrapper(self, kernel.py_func)
        self._register()

    def __getattr__(self, name: str) -> Any:
        if name == "_numba_type_":  # by the type of the kernel it would be called like any other
            raise AttributeError(name)
        return getattr(_kernel(self, name), name)


def _kernel(holder: Any, name: str) -> Any:
    """What a kernel that is held apart holds; nothing while copy or pickle make an empty one."""
    if "kernel" not in vars(holder):
        raise AttributeError(name)
    return vars(holder)["kernel"]


def _caller(kernel: Any) -> Callable[..., Any]:
    def call(context, *args):
        args = tuple(types.unliteral(arg) for arg in args)
        returned = _compiled(kernel, args).signature.return_type
        digest = hashlib.sha256(repr((returned, args)).encode()).hexdigest()[:16]
        symbol = f"{kernel.__module__}.{kernel.__name__}.{digest}"
        define = _define(symbol, kernel.__module__, kernel.__name__, args)

        def generate(context, builder, _, values):
            context.active_code_library._reload_init.add(define)
            function = cgutils.get_or_insert_function(
                builder.module, context.call_conv.get_function_type(returned, args), symbol
            )
            status, value = context.call_conv.call_function(builder, function, returned, args, values)
            with builder.if_then(status.is_error, likely=False):
                context.call_conv.return_status_propagate(builder, status)
            return context.get_dummy_value() if returned == types.none else value

        return returned(*args), generate

    own = inspect.signature(kernel.py_func)
    context = inspect.Parameter("context", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    setattr(call, "__signature__", own.replace(parameters=[context, *own.parameters.values()]))  # noqa: B010
    return call


def _compiled(kernel: Any, args: tuple[Any, ...]) -> Any:
    kernel.compile(args)
    return kernel.overloads[args]


def _define(symbol: str, module: str, name: str, args: tuple[Any, ...]) -> Callable[[], Any]:
    """Let all that is loaded from now on find a kernel by its symbol; compile it, or load it, before. Returns what does
    the same again.
    """
    compiled = _compiled(getattr(importlib.import_module(module), name), args)
    llvm.add_symbol(symbol, compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))
    return _definitions.setdefault(symbol, functools.partial(_define, symbol, module, name, args))
