"""Parts of symmetric matrices, eight numbers at a time."""

from navfilter.kernels.compiling.decorators import UNCOUNTED, njit
from navfilter.kernels.compiling.registers import eight, put
from navfilter.kernels.compiling.vectors import WIDE, mirror


@njit(cache=True, **UNCOUNTED)
def copy(of, to):
    """The first of some numbers to others, eight at least. A loop over numbers goes one by one."""
    last = to.size - WIDE
    for i in range(0, last, WIDE):
        put(to, i, eight(of, i))
    put(to, last, eight(of, last))


@njit(apart=True, cache=True, **UNCOUNTED)
def mirror_columns(T, M, rows, begin):
    """The columns from `begin` on of so many leading rows of T, eight at least, into M, and across its diagonal."""
    n = M.shape[0]
    if n - begin < WIDE:
        for i in range(rows):
            for j in range(begin, n):
                M[i, j] = T[i, j]
                M[j, i] = T[i, j]
        return
    for i in range(rows):
        copy(T[i][begin:], M[i][begin:])
    for j in range(begin, n, WIDE):
        for i in range(0, rows, WIDE):
            mirror(M, min(i, rows - WIDE), min(j, n - WIDE))


@njit(cache=True, **UNCOUNTED)
def symmetrise(M, first, end):
    """Rows and columns from `first` to `end` symmetric to the last bit."""
    for i in range(first, end):
        for j in range(first, i):
            s = 0.5 * (M[i, j] + M[j, i])
            M[i, j] = s
            M[j, i] = s


@njit(apart=True, cache=True, **UNCOUNTED)
def mirror_rows(M, first, last):
    """Columns of a symmetric M become what its rows first to last, nine at most, are now; but not in those rows."""
    n, high = M.shape[0], max(last, WIDE)
    for j in range(high, n if n - high >= WIDE else high, WIDE):
        mirror(M, high - WIDE, min(j, n - WIDE))
    for i in range(first, last):
        for j in range(first):
            M[j, i] = M[i, j]
        for j in range(last, high if n - high >= WIDE else n):
            M[j, i] = M[i, j]
