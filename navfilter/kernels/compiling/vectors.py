"""What kernels do to whole rows of matrices, written in the instructions of wide registers.

LLVM makes such instructions of plain loops, too, but only where it can prove that arrays do not overlap, and then it
has twice the code to look through. Each function here stands for itself without the compiler, in NumPy; with it, what
builds its instructions stands below it.
"""

import numpy as np
from numba import types
from numba.core import cgutils

from navfilter.kernels.compiling.decorators import UNCOUNTED, flat, njit
from navfilter.kernels.compiling.registers import (
    LANES,
    VECTOR,
    all_of,
    call,
    compiled,
    eight,
    fetch,
    if_below,
    put,
    put_away,
    spread,
    times,
    transpose,
)

WIDE = LANES
# Which of eight numbers each is.
COLUMNS = np.arange(float(WIDE))
_ir = cgutils.ir
_INDEX = _ir.IntType(32)


@njit(cache=True, inline="always", **UNCOUNTED)
def weighted(f, A, out):
    """The sum of f (k,) times the first k rows of A into out, as many columns as it has: eight at least.

    Three registers at a time, which may overlap; rows whose factor is zero are left out.
    """
    last, width, rows = out.size - WIDE, A.shape[1], flat(A)
    for begin in range(0, out.size, 3 * WIDE):
        i, j, k = min(begin, last), min(begin + WIDE, last), min(begin + 2 * WIDE, last)
        x = y = z = all_of(0.0)
        for r in range(f.size):
            if f[r] != 0.0:
                row, factor = r * width, all_of(f[r])
                x = x + times(factor, eight(rows, row + i))
                y = y + times(factor, eight(rows, row + j))
                z = z + times(factor, eight(rows, row + k))
        put(out, i, x)
        put(out, j, y)
        put(out, k, z)


@njit(cache=True, inline="always", **UNCOUNTED)
def _fresh(row, j, done):
    """Eight numbers of a row from j on; zeros for the first, of what has been done before."""
    return if_below(eight(COLUMNS, 0), done, all_of(0.0), eight(row, j))


@njit(cache=True, **UNCOUNTED)
def rank2_update(P, u, w):
    """P <- P - u' w - w' u of rows u and w (a, n): symmetric to the bit where P (n, n) was; n: eight at least.

    Three pairs of rows at a time, or one: each element of P is fetched and put away once for them.
    """
    n, rows, whole = P.shape[0], flat(P), u.shape[0] // 3 * 3
    for begin in range(0, n, WIDE):
        j = min(begin, n - WIDE)
        done = all_of(float(begin - j))
        for r in range(0, whole, 3):
            f0, f1, f2 = _fresh(u[r], j, done), _fresh(u[r + 1], j, done), _fresh(u[r + 2], j, done)
            g0, g1, g2 = _fresh(w[r], j, done), _fresh(w[r + 1], j, done), _fresh(w[r + 2], j, done)
            for i in range(n):
                value = eight(rows, i * n + j)
                value = value - (times(all_of(u[r, i]), g0) + times(all_of(w[r, i]), f0))
                value = value - (times(all_of(u[r + 1, i]), g1) + times(all_of(w[r + 1, i]), f1))
                value = value - (times(all_of(u[r + 2, i]), g2) + times(all_of(w[r + 2, i]), f2))
                put(rows, i * n + j, value)
        for r in range(whole, u.shape[0]):
            f0, g0 = _fresh(u[r], j, done), _fresh(w[r], j, done)
            for i in range(n):
                less = times(all_of(u[r, i]), g0) + times(all_of(w[r, i]), f0)
                put(rows, i * n + j, eight(rows, i * n + j) - less)


@njit(cache=True, **UNCOUNTED)
def add_product(P, u, w):
    """P <- P + u' w of rows u and w (a, n), a product that is symmetric: of each eight columns of P (n, n) the rows
    from the first of them on, so all that is not above the diagonal; n: eight at least.
    """
    n, rows, whole = P.shape[0], flat(P), u.shape[0] // 3 * 3
    for begin in range(0, n, WIDE):
        j = min(begin, n - WIDE)
        done = all_of(float(begin - j))
        for r in range(0, whole, 3):
            g0, g1, g2 = _fresh(w[r], j, done), _fresh(w[r + 1], j, done), _fresh(w[r + 2], j, done)
            for i in range(begin, n):
                value = eight(rows, i * n + j) + times(all_of(u[r, i]), g0)
                value = value + times(all_of(u[r + 1, i]), g1)
                put(rows, i * n + j, value + times(all_of(u[r + 2, i]), g2))
        for r in range(whole, u.shape[0]):
            g = _fresh(w[r], j, done)
            for i in range(begin, n):
                put(rows, i * n + j, eight(rows, i * n + j) + times(all_of(u[r, i]), g))


@njit(cache=True, **UNCOUNTED)
def less_half(P, f, A, out):
    """Row P less half the sum of f (k,) times the first k rows of A into out, as many columns as it has: eight at
    least. One after the other.
    """
    for begin in range(0, out.size, WIDE):
        j = min(begin, out.size - WIDE)
        total = eight(P, j)
        for r in range(f.size):
            total = total - times(all_of(f[r] * 0.5), eight(A[r], j))
        put(out, j, total)


@njit(cache=True, **UNCOUNTED)
def mirror(M, i, j):
    """The square block of eight rows from i and eight columns from j on, transposed to across the diagonal."""
    n = M.shape[1]
    transpose(flat(M), i * n + j, n, flat(M), j * n + i, n)


class Row:
    """Eight numbers in a function that is being written out; constants beside it are numbers or arrays. Multiplied and
    added in one rounding where the processor can: every step of the filter goes by `imu_steps` or `imu_hold` as they
    are compiled, so that bits stay the same.
    """

    __array_ufunc__ = None
    flags: tuple = ("contract",)

    def __init__(self, builder, value):
        self.builder, self.value = builder, value

    def _with(self, instruction, one, other):
        pair = [
            v.value if isinstance(v, Row) else _ir.Constant(VECTOR, np.broadcast_to(v, WIDE).tolist())
            for v in (one, other)
        ]
        return type(self)(self.builder, getattr(self.builder, instruction)(*pair, flags=self.flags))

    def __add__(self, other):
        return self._with("fadd", self, other)

    def __radd__(self, other):
        return self._with("fadd", other, self) if np.any(other) else self

    def __sub__(self, other):
        return self._with("fsub", self, other)

    def __rsub__(self, other):
        return self._with("fsub", other, self)

    def __mul__(self, other):
        return self._with("fmul", self, other)

    def __rmul__(self, other):
        return self._with("fmul", other, self) if np.any(other != 1.0) else self

    def __truediv__(self, other):
        return self._with("fdiv", self, other)

    def called(self, name, *others):
        """One of the compiler's own functions."""
        return type(self)(self.builder, call(self.builder, name, self.value, *[other.value for other in others]))


class Written(Row):
    """One whose zeros may have either sign."""

    flags = ("contract", "nsz")


def build_panels(carried, panel, alone, numbers, turns, errors):
    """Build two functions on panels of `WIDE` columns, for kernels, from one on rows: ``carried(x, e, f, C, half)``.

    The first nine rows x of a panel are replaced. ``alone(Z, f)`` has no errors e; ``panel(Z, e, by, f, C)`` has rows
    e of errors, multiplied by a number. Each row stands in one register, where those are wide enough, or in two.

    Parameters
    ----------
    carried : callable
        On rows, as arrays or as `Row`; half: half the first of f.
    panel, alone : callable
        What they do without the compiler.
    numbers, turns, errors : int
        How many numbers f and C hold, and how many rows e.
    """

    @compiled(alone, types.void, types.Array, types.Array)
    @compiled(panel, types.void, types.Array, types.Array, types.Float, types.Array, types.Array)
    def build(context, builder, kinds, arguments):
        given = [
            context.make_array(kind)(context, builder, value=value).data if isinstance(kind, types.Array) else value
            for kind, value in zip(kinds.args, arguments, strict=True)
        ]
        Z, *e, f, C = given if len(given) > 2 else (*given, None)

        def place(data, i):
            return builder.gep(data, [_ir.Constant(_INDEX, WIDE * i)])

        def at(data, i):
            return Row(builder, fetch(builder, place(data, i)))

        def number(data, i):
            return Row(builder, spread(builder, builder.load(builder.gep(data, [_ir.Constant(_INDEX, i)]))))

        f, x, rows, turn = [number(f, i) for i in range(numbers)], [at(Z, i) for i in range(9)], [], []
        if len(e):
            by = Row(builder, spread(builder, e[1]))
            rows, turn = [by * at(e[0], i) for i in range(errors)], [number(C, i) for i in range(turns)]
        for i, y in enumerate(carried(x, rows, f, turn, 0.5 * f[0])):
            put_away(builder, y.value, place(Z, i))
        return context.get_dummy_value()


class WrittenRows:
    """Rows of an array in a function that is being written out: read when first used, written at the end."""

    def __init__(self, builder, first=None):
        self.builder, self.first, self.rows, self.read = builder, first, {}, {}

    def store(self, row, value):
        """Put a value into a row."""
        self.rows[row] = value

    def load(self, row):
        """A row as it is by now."""
        if row not in self.rows:
            self.rows[row] = self.read[row] = Written(self.builder, fetch(self.builder, self._at(row)))
        return self.rows[row]

    def _at(self, row):
        return self.builder.gep(self.first, [_ir.Constant(_ir.IntType(64), row * LANES)])

    def write(self):
        """Those that are others now."""
        for row, value in self.rows.items():
            if value is not self.read.get(row):
                put_away(self.builder, value.value, self._at(row))


def write_out(function, write, cases, arrays, numbers):
    """Let a function of a case, arrays and eights of numbers be written out for kernels, instruction by instruction.

    Parameters
    ----------
    function : callable
        What it does without the compiler.
    write : callable
        Runs it once for a case, on `WrittenRows` and `Written`, which write down what is done to them.
    cases : sequence of int
    arrays, numbers : list of type
        Of its arguments behind the case.
    """

    @compiled(function, types.void, types.Integer, *arrays, *numbers)
    def build(context, builder, kinds, arguments):
        count = 1 + len(arrays)
        pointers = [
            context.make_array(kind)(context, builder, value=value).data
            for kind, value in zip(kinds.args[1:count], arguments[1:count], strict=True)
        ]
        given = [Written(builder, value) for value in arguments[count:]]
        after = builder.append_basic_block("after")
        choice = builder.switch(arguments[0], after)
        for case in cases:
            block = builder.append_basic_block(f"case{case}")
            choice.add_case(_ir.Constant(arguments[0].type, case), block)
            builder.position_at_end(block)
            rows = [WrittenRows(builder, first) for first in pointers]
            write(case, rows, given, lambda: WrittenRows(builder))
            for array in rows:
                array.write()
            builder.branch(after)
        builder.position_at_end(after)
        return context.get_dummy_value()
