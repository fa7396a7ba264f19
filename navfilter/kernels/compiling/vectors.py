"""What kernels do to whole rows of matrices, written in the instructions of wide registers.

LLVM makes such instructions of plain loops, too, but only where it can prove that arrays do not overlap, and then it
has twice the code to look through. Each function here stands for itself without the compiler, in NumPy; with it, what
builds its instructions stands below it.
"""

import numpy as np
from numba import types
from numba.core import cgutils

from navfilter.kernels.compiling.registers import LANES, VECTOR, call, compiled, fetch, put_away, spread, transposed

# Rows and columns of a product at a time: so many sums fit in the registers, and hide how long each takes.
HIGH, WIDE = 9, 8
# So many terms of each sum of a product at a time: where its nine rows stand is then found out once for them.
STEPS = 4
# So many times as many columns of a weighted sum, and pairs of vectors that are taken off, at a time.
BROAD = 3
_ir = cgutils.ir
_WORD, _INDEX = _ir.IntType(64), _ir.IntType(32)
_ZERO, _PLACES = _ir.Constant(VECTOR, [0.0] * WIDE), _ir.Constant(_ir.VectorType(_WORD, WIDE), list(range(WIDE)))


def product(A, B, out):
    """A (r, k) B (k, n) into out, as many columns as it has: nine rows and eight columns at least."""
    np.dot(A, B[:, : out.shape[1]], out)


def weighted(f, A, out):
    """The sum of f (k,) times the first k rows of A into out, as many columns as it has: eight at least."""
    np.copyto(out, f @ A[: len(f), : len(out)])


def rank2_update(P, u, w):
    """P <- P - u' w - w' u of rows u and w (a, n): symmetric to the bit where P (n, n) was; n: eight at least."""
    for f, g in zip(u, w, strict=True):
        np.subtract(P, np.outer(f, g) + np.outer(g, f), P)


def less_half(P, f, A, out):
    """Row P less half the sum of f (k,) times the first k rows of A into out, as many columns as it has: eight at
    least. One after the other.
    """
    np.copyto(out, P[: len(out)])
    for factor, row in zip(f, A, strict=False):
        np.subtract(out, 0.5 * factor * row[: len(out)], out)


def mirror(M, i, j):
    """The square block of eight rows from i and eight columns from j on, transposed to across the diagonal."""
    np.copyto(M[j : j + WIDE, i : i + WIDE], M[i : i + WIDE, j : j + WIDE].T)


def _built_in(function, count, numbers=0):
    """Decorates what builds the instructions that stand for a function of so many arrays, and then whole numbers, in a
    kernel.
    """

    def built(build):
        @compiled(function, types.void, *(types.Array,) * count, *(types.Integer,) * numbers)
        def generate(context, builder, kinds, arguments):
            given = list(zip(kinds.args, arguments, strict=True))
            arrays = [context.make_array(kind)(context, builder, value=value) for kind, value in given[:count]]
            shapes = [cgutils.unpack_tuple(builder, array.shape) for array in arrays]
            whole = [context.cast(builder, value, kind, types.int64) for kind, value in given[count:]]
            build(builder, [array.data for array in arrays], shapes, *whole)
            return context.get_dummy_value()

        return build

    return built


def _number(value):
    return _ir.Constant(_WORD, value)


def _parts(builder, total, size):
    """Loop over parts of this size."""
    return cgutils.for_range(builder, builder.udiv(builder.add(total, _number(size - 1)), _number(size)), intp=_WORD)


def _begin(builder, part, total, size):
    """Where a part begins: the last one overlaps those before."""
    begin, last = builder.mul(part.index, _number(size)), builder.sub(total, _number(size))
    return builder.select(builder.icmp_signed("<", begin, last), begin, last)


def _place(builder, data, i, width, j):
    return builder.gep(data, [builder.add(builder.mul(i, width), j)])


@_built_in(product, 3)
def _build_product(builder, data, shapes):
    """Nine rows and eight columns at a time, their sums in registers: a library of linear algebra takes longer to begin
    than such a product. Each sum goes from the first term to the last, multiplied and added in one rounding where the
    processor can.
    """
    (left, right, out), ((rows, inner), (_, width), (_, n)) = data, shapes
    sums = [cgutils.alloca_once(builder, VECTOR) for _ in range(HIGH)]
    with _parts(builder, rows, HIGH) as high, _parts(builder, n, WIDE) as wide:
        first, column = _begin(builder, high, rows, HIGH), _begin(builder, wide, n, WIDE)
        places = [builder.add(first, _number(i)) for i in range(HIGH)]
        mine = [_place(builder, left, i, inner, _number(0)) for i in places]
        for total in sums:
            builder.store(_ZERO, total)
        several = builder.udiv(inner, _number(STEPS))

        def add(first, count):
            for i in range(count):
                step = builder.add(first, _number(i))
                factors = fetch(builder, _place(builder, right, step, width, column))
                for total, terms in zip(sums, mine, strict=True):
                    term = spread(builder, builder.load(builder.gep(terms, [step])))
                    term = builder.fmul(term, factors, flags=("contract",))
                    builder.store(builder.fadd(builder.load(total), term, flags=("contract",)), total)

        with cgutils.for_range(builder, several, intp=_WORD) as steps:
            add(builder.mul(steps.index, _number(STEPS)), STEPS)
        done = builder.mul(several, _number(STEPS))
        with cgutils.for_range(builder, builder.sub(inner, done), intp=_WORD) as step:
            add(builder.add(done, step.index), 1)
        for i, total in zip(places, sums, strict=True):
            put_away(builder, builder.load(total), _place(builder, out, i, n, column))


@_built_in(weighted, 3)
def _build_weighted(builder, data, shapes):
    """As many columns at a time as `BROAD` registers hold, or eight; rows whose factor is zero are left out."""
    (f, A, out), ((k,), (_, width), (n,)) = data, shapes

    def by(count):
        size = count * WIDE
        sums = [cgutils.alloca_once(builder, VECTOR) for _ in range(count)]
        with _parts(builder, n, size) as wide:
            begin = _begin(builder, wide, n, size)
            columns = [builder.add(begin, _number(WIDE * i)) for i in range(count)]
            for total in sums:
                builder.store(_ZERO, total)
            with cgutils.for_range(builder, k, intp=_WORD) as step:
                factor = builder.load(builder.gep(f, [step.index]))
                with builder.if_then(builder.fcmp_unordered("!=", factor, _ir.Constant(factor.type, 0.0))):
                    factor = spread(builder, factor)
                    for column, total in zip(columns, sums, strict=True):
                        term = builder.fmul(factor, fetch(builder, _place(builder, A, step.index, width, column)))
                        builder.store(builder.fadd(builder.load(total), term), total)
            for column, total in zip(columns, sums, strict=True):
                put_away(builder, builder.load(total), builder.gep(out, [column]))

    with builder.if_else(builder.icmp_signed("<", n, _number(BROAD * WIDE))) as (few, many):
        with few:
            by(1)
        with many:
            by(BROAD)


@_built_in(less_half, 4)
def _build_less_half(builder, data, shapes):
    """Eight columns at a time."""
    (P, f, A, out), (_, (k,), (_, width), (n,)) = data, shapes
    total = cgutils.alloca_once(builder, VECTOR)
    with _parts(builder, n, WIDE) as wide:
        column = _begin(builder, wide, n, WIDE)
        builder.store(fetch(builder, builder.gep(P, [column])), total)
        with cgutils.for_range(builder, k, intp=_WORD) as step:
            factor = builder.load(builder.gep(f, [step.index]))
            factor = spread(builder, builder.fmul(factor, _ir.Constant(factor.type, 0.5)))
            term = builder.fmul(factor, fetch(builder, _place(builder, A, step.index, width, column)))
            builder.store(builder.fsub(builder.load(total), term), total)
        put_away(builder, builder.load(total), builder.gep(out, [column]))


@_built_in(mirror, 1, 2)
def _build_mirror(builder, data, shapes, i, j):
    ((M,), ((_, n),)) = data, shapes
    rows = [fetch(builder, _place(builder, M, builder.add(i, _number(k)), n, j)) for k in range(WIDE)]
    for k, row in enumerate(transposed(builder, rows)):
        put_away(builder, row, _place(builder, M, builder.add(j, _number(k)), n, i))


@_built_in(rank2_update, 3)
def _build_less_twice(builder, data, shapes):
    """Eight columns at a time, `BROAD` pairs of rows or one: each element of P is fetched and put away once for them.
    Of the last columns those that have been done before are multiplied by zeros.
    """
    (P, u, w), ((n, _), (a, _), _) = data, shapes

    def less(first, count, column, fresh):
        rows = [builder.mul(builder.add(first, _number(i)), n) for i in range(count)]
        pairs = [(builder.gep(u, [row]), builder.gep(w, [row])) for row in rows]
        mine = [[fetch(builder, builder.gep(row, [column])) for row in pair] for pair in pairs]
        mine = [[builder.select(fresh, row, _ZERO) for row in pair] for pair in mine]
        with cgutils.for_range(builder, n, intp=_WORD) as i:
            place = _place(builder, P, i.index, n, column)
            value = fetch(builder, place)
            for pair, (wide_u, wide_w) in zip(pairs, mine, strict=True):
                by_u, by_w = (spread(builder, builder.load(builder.gep(row, [i.index]))) for row in pair)
                value = builder.fsub(value, builder.fadd(builder.fmul(by_u, wide_w), builder.fmul(by_w, wide_u)))
            put_away(builder, value, place)

    whole = builder.udiv(a, _number(BROAD))
    with _parts(builder, n, WIDE) as wide:
        column = _begin(builder, wide, n, WIDE)
        known = builder.sub(builder.mul(wide.index, _number(WIDE)), column)
        fresh = builder.icmp_signed(">=", _PLACES, spread(builder, known))
        with cgutils.for_range(builder, whole, intp=_WORD) as several:
            less(builder.mul(several.index, _number(BROAD)), BROAD, column, fresh)
        done = builder.mul(whole, _number(BROAD))
        with cgutils.for_range(builder, builder.sub(a, done), intp=_WORD) as one:
            less(builder.add(done, one.index), 1, column, fresh)


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


def exchange(X, one, other, of_one, of_other):
    """Two square blocks of panels, whose elements begin at `one` and `other` in X, transposed to where these begin."""
    blocks = [X[begin : begin + WIDE * WIDE].reshape(WIDE, WIDE).T.copy() for begin in (one, other)]
    for begin, block in zip((of_one, of_other), blocks, strict=True):
        np.copyto(X[begin : begin + WIDE * WIDE], block.ravel())


@_built_in(exchange, 1, 4)
def _build_exchange(builder, data, shapes, *begins):
    """In registers, see `registers.transposed`."""
    places = [[builder.gep(data[0], [builder.add(begin, _number(WIDE * i))]) for i in range(WIDE)] for begin in begins]
    blocks = [[fetch(builder, place) for place in block] for block in places[:2]]
    for block, rows in zip(places[2:], blocks, strict=True):
        for place, value in zip(block, transposed(builder, rows), strict=True):
            put_away(builder, value, place)


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
        return self.builder.gep(self.first, [_number(row * LANES)])

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


def copy_row(A, B, i, j, known):
    """Elements j to j + 8 of B to where those from i on stand in A: the first `known`, and zeros for the others."""
    np.copyto(A[i : i + WIDE], np.where(np.arange(WIDE) < known, B[j : j + WIDE], 0.0))


@_built_in(copy_row, 2, 3)
def _build_copy_row(builder, data, shapes, i, j, known):
    """In one register: a panel is loaded in such rows, which have to wait for what was stored in other pieces."""
    to, of = (builder.gep(array, [begin]) for array, begin in zip(data, (i, j), strict=True))
    kept = builder.icmp_signed("<", _PLACES, spread(builder, known))
    put_away(builder, builder.select(kept, fetch(builder, of), _ZERO), to)
