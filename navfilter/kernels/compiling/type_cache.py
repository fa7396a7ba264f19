"""What numba finds out again for every statement: the type of an operation on types that it has met before.

For each ``a + b`` of numbers it tries all that is registered for the operator, arrays, strings and dates included, and
what does not fit leaves an error with its text. Of 20 000 operations in the kernels of a vehicle 550 differ. Where they
are remembered, kernels are compiled in a sixth less time. Errors that are still made are never seen: where colorama is
installed numba wraps the terminal anew for each.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import errors
from numba.core.types.functions import BaseFunction

from navfilter.kernels.compiling.decorators import KNOWN


@contextmanager
def calls_remembered() -> Iterator[None]:
    """Within it numba remembers the types of operations and built-in functions.

    Only those that are their own implementation for any types: what else is called may have to be compiled.
    """
    if not KNOWN:
        yield
        return
    resolve, known = BaseFunction.get_call_type, {}
    colours: Any = type(errors.termcolor())
    coloured = vars(colours).get("_markup")  # None where colorama is not installed

    def remembered(self: Any, context: Any, args: Any, kws: Any) -> Any:
        key = id(self), id(context), args
        if kws or key not in known:
            found = resolve(self, context, args, kws)
            if kws or found is None or self._impl_keys.get(found.args) is not self.typing_key:
                return found
            known[key] = self, found  # kept, so that no other gets its id
        return known[key][1]

    setattr(BaseFunction, "get_call_type", remembered)  # noqa: B010
    if coloured is not None:
        colours._markup = lambda scheme, text, *_, **__: text
    try:
        yield
    finally:
        setattr(BaseFunction, "get_call_type", resolve)  # noqa: B010
        if coloured is not None:
            colours._markup = coloured
