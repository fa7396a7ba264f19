"""Gaussian likelihood of one channel: a slow drift with known noise, slow errors, an ARMA error, known white noise.

``y[t] = sees' d[t] + n[t] + v[t]``: d holds the navigation error's chain of integrators and the slow part of the
sensor's error, side by side; n is the ARMA error in observer form, ``z+ = M z + g e``, ``n = z[0] + e`` with ``g = c -
a``; v is white. Process and measurement noise share e, which the filter (predictor form, Anderson and Moore 1979,
section 5.5) takes into account. A slow error and fast ones in one observer form would be ill-conditioned: several poles
within 0.03 of the unit circle leave nothing but rounding of the start's covariance.

A chain (3, r, r) describes d: transition U over one tick (upper triangular), noise of one tick, covariance at the
start (of the states after the diffuse ones, which come first). Parameter vector ``theta = [a (m), c (m), ln sd]``, a
and c padded with zeros to m = max(p, q, 1). ``rules`` holds [diffuse states, longest gap, clip, white variance].

`LANES` models go through the series side by side: their numbers are one value of a type of its own, and what is done to
one is done to all, in few instructions where the processor has them. ``_load(array, row)`` reads such a value from an
array whose last axis has length `LANES`; ``row`` counts over all its other axes. ``_store`` writes it there. (A loop
over sixteen elements would be turned into such instructions only where the compiler can prove that arrays do not
overlap.) A matrix has a row for each element, row ``i n + j`` for element (i, j); of symmetric ones only the upper
triangle is kept. Without the compiler such a value is an array.
"""

import math
import operator

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model

from navfilter.kernels.decorators import apart, njit

UNCOUNTED: dict = {"_nrt": False}
DIFFUSE, LONGEST_GAP, CLIP, WHITE = 0, 1, 2, 3
TRANSITION, NOISE, START = 0, 1, 2
HALF_LOG_2PI = 0.9189385332046727
# Variances multiplied before one looks how large the product is, and what is large and small then: those of the widest
# scales, 1e35, do not overflow yet.
TOGETHER = 8
SMALL, LARGE = 1e-20, 1e20
# Models at a time. Two of the widest registers there are: one is worked on while the other waits.
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


def _load(array, row):
    """Sixteen numbers from a row of an array."""
    return array.reshape(-1, LANES)[row].copy()


def _store(array, row, value):
    """Sixteen numbers into a row of an array."""
    array.reshape(-1, LANES)[row] = value


def _all_of(number):
    """Sixteen times the same number."""
    return np.full(LANES, number)


def _root(u):
    """Square roots."""
    return np.sqrt(u)


def _magnitude(u):
    """Absolute values."""
    return np.abs(u)


def _smaller(u, v):
    """The smaller one of each two."""
    return np.fmin(u, v)


def _larger(u, v):
    """The larger one of each two."""
    return np.fmax(u, v)


def _compiled(function, result, *kinds):
    """Decorates what builds the instructions that stand for a function, or operator, in a kernel."""

    def generic(self, arguments, keywords):
        found = [types.unliteral(argument) for argument in arguments]
        other = result is _lanes and _lanes in kinds and _lanes not in found
        return None if other else signature(result, *found)

    infer_global(function)(type(f"_Of{function.__name__}", (AbstractTemplate,), {"generic": generic}))
    return lower_builtin(function, *kinds)


def _place(context, builder, kinds, arguments):
    """Pointer to sixteen numbers: row `arguments[1]` of an array."""
    array = context.make_array(kinds[0])(context, builder, value=arguments[0])
    row = context.cast(builder, arguments[1], kinds[1], types.intp)
    first = builder.gep(array.data, [builder.mul(row, _ir.Constant(row.type, LANES))])
    return builder.bitcast(first, _VECTOR.as_pointer())


@_compiled(_load, _lanes, types.Array, types.Integer)
def _build_load(context, builder, kinds, arguments):
    value = builder.load(_place(context, builder, kinds.args, arguments))
    value.align = 8
    return value


@_compiled(_store, types.void, types.Array, types.Integer, _lanes)
def _build_store(context, builder, kinds, arguments):
    builder.store(arguments[2], _place(context, builder, kinds.args, arguments), align=8)
    return context.get_dummy_value()


@_compiled(_all_of, _lanes, types.Float)
def _build_all(context, builder, kinds, arguments):
    index, nothing = _ir.IntType(32), _ir.Constant(_VECTOR, _ir.Undefined)
    first = builder.insert_element(nothing, arguments[0], _ir.Constant(index, 0))
    return builder.shuffle_vector(first, nothing, _ir.Constant(_ir.VectorType(index, LANES), [0] * LANES))


def _compile_all():
    """Operators are instructions, the other functions are the compiler's own."""
    symbols = {operator.add: "fadd", operator.sub: "fsub", operator.mul: "fmul", operator.truediv: "fdiv"}
    for symbol, instruction in symbols.items():

        @_compiled(symbol, _lanes, _lanes, _lanes)
        def build_operator(context, builder, kinds, arguments, instruction=instruction):
            return getattr(builder, instruction)(*arguments, flags=("contract",))

    for function, name in ((_root, "sqrt"), (_magnitude, "fabs"), (_smaller, "minnum"), (_larger, "maxnum")):
        count = function.__code__.co_argcount

        @_compiled(function, _lanes, *[_lanes] * count)
        def build_function(context, builder, kinds, arguments, name=name):
            kind = _ir.FunctionType(_VECTOR, [_VECTOR] * len(arguments))
            called = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64")
            return builder.call(called, arguments)


_compile_all()


@apart
@njit(cache=True, nogil=True, error_model="numpy")
def stationary(a, c, P):
    """Stationary covariance of the observer state for unit innovations into `P`, by doubling; False if there is
    none.
    """
    m = a.size
    A = np.zeros((m, m))
    T = np.zeros((m, m))
    B = np.zeros((m, m))
    for i in range(m):
        A[i, 0] = -a[i]
        if i + 1 < m:
            A[i, i + 1] = 1.0
        for j in range(m):
            P[i, j] = (c[i] - a[i]) * (c[j] - a[j])
    for _ in range(60):
        worst = 0.0
        top = 0.0
        _product(A, P, T)
        _product_transposed(T, A, B)
        for i in range(m):
            for j in range(m):
                if not abs(B[i, j]) < 1e300:
                    return False
                P[i, j] += B[i, j]
                worst = max(worst, abs(B[i, j]))
                top = max(top, abs(P[i, j]))
        if not worst > 1e-17 * top:
            return True
        _product(A, A, T)
        for i in range(m):
            for j in range(m):
                A[i, j] = T[i, j]
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _product(A, B, out):
    for i in range(A.shape[0]):
        for j in range(A.shape[0]):
            s = 0.0
            for k in range(A.shape[0]):
                s += A[i, k] * B[k, j]
            out[i, j] = s


@njit(cache=True, nogil=True, error_model="numpy")
def _product_transposed(A, B, out):
    """``A B'``."""
    for i in range(A.shape[0]):
        for j in range(A.shape[0]):
            s = 0.0
            for k in range(A.shape[0]):
                s += A[i, k] * B[j, k]
            out[i, j] = s


@njit(cache=True, nogil=True, error_model="numpy", inline="always", **UNCOUNTED)
def _move(x, at, U, used, a, r, m):
    """``x = F x`` in place, for the rows from `at` on: the chain advances one tick, the observer state shifts."""
    for i in range(r):
        s = _load(x, at + i) * _load(U, i * r + i)
        for k in range(i + 1, r):
            if used[i, k]:
                s = s + _load(U, i * r + k) * _load(x, at + k)
        _store(x, at + i, s)
    first = _load(x, at + r)
    for i in range(m - 1):
        _store(x, at + r + i, _load(x, at + r + i + 1) - _load(a, i) * first)
    _store(x, at + r + m - 1, _all_of(0.0) - _load(a, m - 1) * first)


@njit(cache=True, nogil=True, error_model="numpy", inline="always", **UNCOUNTED)
def _spread(P, L, Q, U, used, a, corner, r, m):
    """``P = F P F' + Q - L L'`` in place on the upper triangle."""
    n = r + m
    # the chain, row by row: each becomes itself and later ones
    for i in range(r):
        if used[i, i]:
            u = _load(U, i * r + i)
            _store(P, i * n + i, _load(P, i * n + i) * u)
            for j in range(i):
                _store(P, j * n + i, _load(P, j * n + i) * u)
            for j in range(i, n):
                _store(P, i * n + j, _load(P, i * n + j) * u)
        for k in range(i + 1, r):
            if used[i, k]:
                u, cross = _load(U, i * r + k), _load(P, i * n + k)
                _store(P, i * n + i, _load(P, i * n + i) + u * (cross + cross + u * _load(P, k * n + k)))
                for j in range(i):
                    _store(P, j * n + i, _load(P, j * n + i) + u * _load(P, j * n + k))
                for j in range(i + 1, k):
                    _store(P, i * n + j, _load(P, i * n + j) + u * _load(P, j * n + k))
                for j in range(k, n):
                    _store(P, i * n + j, _load(P, i * n + j) + u * _load(P, k * n + j))
    zero, last = _all_of(0.0), n - 1
    for i in range(r):
        row, li = i * n, _load(L, i)
        for j in range(i, r):
            _store(P, row + j, _load(P, row + j) + _load(Q, row + j) - li * _load(L, j))
        first = _load(P, row + r)
        for j in range(r, last):
            _store(P, row + j, _load(P, row + j + 1) - _load(a, j - r) * first - li * _load(L, j))
        _store(P, row + last, zero - _load(a, m - 1) * first - li * _load(L, last))
    for j in range(m):
        _store(corner, j, _load(P, r * n + r + j))
    for i in range(m):
        row, li, ai = (r + i) * n, _load(L, r + i), _load(a, i)
        before = _load(corner, i + 1) - ai * _load(corner, 0)
        for j in range(i, m - 1):
            s = _load(Q, row + r + j) - li * _load(L, r + j) - ai * _load(corner, j + 1) - _load(a, j) * before
            _store(P, row + r + j, _load(P, row + n + r + j + 1) + s)
        _store(P, row + last, _load(Q, row + last) - li * _load(L, last) - _load(a, m - 1) * before)


@apart
@njit(cache=True, nogil=True, error_model="numpy")
def _set_up(thetas, chains, rules, U, used, a, g, Q, start, noise, able):
    """The models in lanes; those behind the last repeat it, those without a stationary start are not `able`."""
    count, r, m = len(thetas), chains.shape[2], a.shape[0]
    n, d = r + m, int(rules[DIFFUSE])
    unit = np.zeros((m, m))
    for lane in range(LANES):
        theta, chain = thetas[min(lane, count - 1)], chains[min(lane, count - 1)]
        same = lane > 0
        for i in range(2 * m):
            same = same and theta[i] == thetas[min(lane, count) - 1, i]
        if same:
            able[lane] = able[lane - 1]
        else:
            able[lane] = stationary(theta[:m], theta[m : 2 * m], unit)
        var = math.exp(2.0 * theta[2 * m])
        noise[0, lane] = var + rules[WHITE]
        for i in range(m):
            a[i, lane], g[i, lane] = theta[i], var * (theta[m + i] - theta[i])
            for j in range(i, m):
                Q[(r + i) * n + r + j, lane] = g[i, lane] * (theta[m + j] - theta[j])
                start[(r + i) * n + r + j, lane] = var * unit[i, j]
        for i in range(r):
            for j in range(i, r):
                U[i * r + j, lane], Q[i * n + j, lane] = chain[TRANSITION, i, j], chain[NOISE, i, j]
                start[i * n + j, lane] = chain[START, i, j] if i >= d else 0.0
                used[i, j] = used[i, j] or chain[TRANSITION, i, j] != (1.0 if i == j else 0.0)


@apart
@njit(cache=True, nogil=True, error_model="numpy", **UNCOUNTED)
def _through(
    y, sees, rules, first, E, V, U, used, a, g, P, Q, start, x, L, A, X, w, noise, total, product, corner, spare
):
    """The loop of `channel_filter`, where nothing is allocated: with references to arrays counted it takes a sixth
    longer. Adds what samples say to `total`, and what is left of their variances is in `product`; returns how many
    count.
    """
    r, m = sees.size, a.shape[0]
    n, d, longest, noted = r + m, int(rules[DIFFUSE]), int(rules[LONGEST_GAP]), E.size > 0
    high, low, half, inverse = _all_of(rules[CLIP]), _all_of(-rules[CLIP]), _all_of(0.5), _all_of(0.0)
    missing, known, counted = longest + 1, 0, 0
    top = int(0)  # a literal would compile a `_move` of its own
    for t in range(y.size):
        seen = not math.isnan(y[t])
        if noted and (known < d or not seen or missing > longest):
            _store(E, t, _all_of(math.nan))
            _store(V, t, _all_of(1.0))
        if not seen:
            missing += 1
            if missing > longest:
                continue
            for i in range(n):
                _store(L, i, _all_of(0.0))
            _move(x, top, U, used, a, r, m)
            inverse = _all_of(0.0)
        else:
            if missing > longest:
                known = 0
                _begin(P, x, A, start, n, d)
            missing = 0
            variance, z = _load(noise, 0), _all_of(y[t]) - _load(x, r)
            for i in range(n):
                s = _load(P, i * n + r if i <= r else r * n + i)
                for k in range(r):
                    if sees[k] != 0.0:
                        s = s + _all_of(sees[k]) * _load(P, i * n + k if i <= k else k * n + i)
                _store(L, i, s)
                if i == r:
                    variance = variance + s
                elif i < r and sees[i] != 0.0:
                    variance, z = variance + _all_of(sees[i]) * s, z - _all_of(sees[i]) * _load(x, i)
            _move(L, top, U, used, a, r, m)
            _move(x, top, U, used, a, r, m)
            inverse = _all_of(1.0) / _root(variance)
            z = z * inverse
            # a diffuse state is not known yet: any innovation is ordinary
            clipped = _larger(_smaller(z, high), low) if known >= d else z
            for i in range(n):
                s = _load(L, i) if i < r else _load(L, i) + _load(g, i - r)
                s = s * inverse
                _store(L, i, s)
                _store(x, i, _load(x, i) + s * clipped)
            if known >= d:
                if noted:
                    _store(E, t, z)
                    _store(V, t, variance)
                if t >= first:
                    size, short = _magnitude(z), _magnitude(clipped)
                    _store(total, 0, _load(total, 0) + short * (size - half * short))
                    _store(product, 0, _load(product, 0) * variance)
                    counted += 1
                    if counted % TOGETHER == 0:
                        _take_logarithms(product, total)
            else:
                _store(w, known, z)
        _spread(P, L, Q, U, used, a, corner, r, m)
        if known < d:
            for k in range(d):
                weight = _load(A, k * n + r)
                for i in range(r):
                    if sees[i] != 0.0:
                        weight = weight + _all_of(sees[i]) * _load(A, k * n + i)
                weight = weight * inverse
                _move(A, k * n, U, used, a, r, m)
                for i in range(n):
                    _store(A, k * n + i, _load(A, k * n + i) - _load(L, i) * weight)
                if seen:
                    _store(X, known * d + k, weight)
            if seen and known == d - 1:
                _collapse(X, w, A, x, P, n, d, spare)
        if seen:
            known += 1
    return counted


@njit(cache=True, nogil=True, error_model="numpy")
def channel_filter(y, thetas, chains, sees, rules, first, E, V, values):
    """Minus the log-likelihood of several models, at most `LANES`, into `values` (K,): of the samples from `first` on,
    given those before. Innovations in standard deviations and their variances go into `E` and `V` (N, LANES), where
    those are not empty.

    thetas (K, 2m+1), chains (K, 3, r, r); y (N,) with NaN where a sample is missing; sees (r,) how the reading sees the
    chain. The first DIFFUSE states start diffuse: as many known samples of a segment fix them and do
    not count (their density does not depend on theta). A run of more than LONGEST_GAP missing samples ends a segment.
    Innovations beyond CLIP standard deviations enter the state clipped and the likelihood by Huber's function. Where
    nothing counts, `E` is NaN and `V` 1. Infinite for a model that is not stationary, or so nearly integrating that the
    start's covariance is only rounding.
    """
    r, m = sees.size, (thetas.shape[1] - 1) // 2
    n, d = r + m, int(rules[DIFFUSE])
    U, used, able = np.zeros((r * r, LANES)), np.zeros((r, r), np.bool_), np.zeros(LANES, np.bool_)
    P, Q, start = np.zeros((n * n, LANES)), np.zeros((n * n, LANES)), np.zeros((n * n, LANES))
    a, g, corner = np.zeros((m, LANES)), np.zeros((m, LANES)), np.zeros((m + 1, LANES))
    x, L = np.zeros((n, LANES)), np.zeros((n, LANES))
    A, X, w = np.zeros((d * n, LANES)), np.zeros((d * d, LANES)), np.zeros((d, LANES))
    noise, total, product = np.zeros((1, LANES)), np.zeros((1, LANES)), np.ones((1, LANES))
    _set_up(thetas, chains, rules, U, used, a, g, Q, start, noise, able)
    spare = np.zeros((d, d)), np.zeros((n, d))
    counted = _through(
        *(y, sees, rules, first, E, V, U, used, a, g, P, Q, start, x, L, A, X, w, noise, total, product, corner, spare)
    )
    for k in range(values.size):
        value = total[0, k] + 0.5 * math.log(product[0, k]) + counted * HALF_LOG_2PI
        values[k] = value if able[k] and value < math.inf else math.inf


@apart
@njit(cache=True, nogil=True, error_model="numpy", **UNCOUNTED)
def _begin(P, x, A, start, n, d):
    """The state at the start of a segment: the chain diffuse (columns of A) or as known, the ARMA error stationary."""
    for i in range(n * n):
        _store(P, i, _load(start, i))
    for i in range(n):
        _store(x, i, _all_of(0.0))
    for i in range(d * n):
        _store(A, i, _all_of(1.0 if i % (n + 1) == 0 else 0.0))


@apart
@njit(cache=True, nogil=True, error_model="numpy", **UNCOUNTED)
def _take_logarithms(product, total):
    """Of products of variances that have become large or small half the logarithm is added to the sums, and they begin
    anew.
    """
    for k in range(LANES):
        if not SMALL < product[0, k] < LARGE:
            total[0, k] += 0.5 * math.log(product[0, k])
            product[0, k] = 1.0


@apart
@njit(cache=True, nogil=True, error_model="numpy", **UNCOUNTED)
def _collapse(XS, WS, AS, xs, PS, n, d, spare):
    """End of a diffuse start: the states given the first d samples (de Jong 1991), model by model."""
    X, A = spare
    for lane in range(LANES):
        for i in range(d):
            for k in range(d):
                X[i, k] = XS[i * d + k, lane]
            for k in range(n):
                A[k, i] = AS[i * n + k, lane]
        # Gauss-Jordan on [X | w, A' is transformed along]: columns of A become A X^-1.
        for k in range(d):
            top = k
            for i in range(k + 1, d):
                if abs(X[k, i]) > abs(X[k, top]):
                    top = i
            for i in range(d):
                X[i, k], X[i, top] = X[i, top], X[i, k]
            for i in range(n):
                A[i, k], A[i, top] = A[i, top], A[i, k]
            pivot = 1.0 / X[k, k]
            for i in range(d):
                X[i, k] *= pivot
            for i in range(n):
                A[i, k] *= pivot
            for j in range(d):
                if j != k:
                    f = X[k, j]
                    for i in range(d):
                        X[i, j] -= f * X[i, k]
                    for i in range(n):
                        A[i, j] -= f * A[i, k]
        for i in range(n):
            for k in range(d):
                xs[i, lane] += A[i, k] * WS[k, lane]
            for j in range(i, n):
                for k in range(d):
                    PS[i * n + j, lane] += A[i, k] * A[j, k]


@njit(cache=True, nogil=True, error_model="numpy")
def channel_scores(E, V, steps, clip, info, gradient):
    """Gradient of minus the log-likelihood and the Fisher information, from what `channel_filter` has noted: in lane 0
    of a model, in the others of those with one of its k parameters moved by ``steps[i]``.

    With z the innovation in standard deviations and S its variance, ``gradient = sum(psi(z) dz + dlnS / 2)`` and ``info
    = sum(dv dv'/S + dlnS dlnS'/2)``, ``dv/sqrt(S) = dz + z dlnS/2`` (Harvey 1989, eqs 3.4.69-70); derivatives are
    differences.
    """
    k = steps.size
    per, sums, turn = np.zeros((1, LANES)), np.zeros((2 * k, LANES)), np.zeros((2, LANES))
    slope = np.zeros((1, LANES))
    for i in range(k):
        per[0, i + 1] = 1.0 / steps[i]
    rate, half = _load(per, 0), _all_of(0.5)
    for t in range(E.shape[0]):
        z = E[t, 0]
        if math.isnan(z):
            continue
        by_s = (_load(V, t) - _all_of(V[t, 0])) * rate / _all_of(V[t, 0])
        by_z = (_load(E, t) - _all_of(z)) * rate
        _store(slope, 0, _load(slope, 0) + _all_of(min(max(z, -clip), clip)) * by_z + half * by_s)
        by_v = by_z + _all_of(0.5 * z) * by_s
        _store(turn, 0, by_v)
        _store(turn, 1, by_s)
        for i in range(k):
            _store(sums, i, _load(sums, i) + _all_of(turn[0, i + 1]) * by_v)
            _store(sums, k + i, _load(sums, k + i) + _all_of(0.5 * turn[1, i + 1]) * by_s)
    for i in range(k):
        gradient[i] = slope[0, i + 1]
        for j in range(k):
            info[i, j] = sums[i, j + 1] + sums[k + i, j + 1]
