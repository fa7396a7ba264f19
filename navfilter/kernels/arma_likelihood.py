"""Gaussian likelihood of one channel: a slow drift with known noise, slow errors, an ARMA error, known white noise.

``y[t] = sees' d[t] + n[t] + v[t]``: d holds the navigation error's chain of integrators and the slow part of the
sensor's error, side by side; n is the ARMA error in observer form, ``z+ = M z + g e``, ``n = z[0] + e`` with ``g = c -
a``; v is white. Process and measurement noise share e, which the filter (predictor form, Anderson and Moore 1979,
section 5.5) takes into account. A slow error and fast ones in one observer form would be ill-conditioned: several poles
within 0.03 of the unit circle leave nothing but rounding of the start's covariance.

A chain (3, r, r) describes d: transition U over one tick (upper triangular), noise of one tick, covariance at the
start (of the states after the diffuse ones, which come first). Parameter vector ``theta = [a (m), c (m), ln sd]``, a
and c padded with zeros to m = max(p, q). ``rules`` holds [diffuse states, longest gap, clip, white variance].

`LANES` models go through the series side by side, as values of eight numbers (`navfilter.kernels.compiling.registers`).
A matrix has a row for each element, row ``i n + j`` for element (i, j); of symmetric ones only the upper triangle is
kept.

Most of the time of a tick would go into its loops, and into numbers that are put away and fetched again. So for the
shapes that learners have, Python runs `_tick` once while the kernel is compiled, with values that write down what is
done to them (`vectors.Written`): of all loops and conditions nothing is left, and numbers stay in registers.
"""

import math

import numpy as np
from numba import types

from navfilter.kernels import arma_fit
from navfilter.kernels.compiling.decorators import UNCOUNTED, njit
from navfilter.kernels.compiling.registers import LANES, all_of, lanes, load, magnitude, stand_for, store
from navfilter.kernels.compiling.vectors import Written, write_out

DIFFUSE, LONGEST_GAP, CLIP, WHITE = 0, 1, 2, 3
TRANSITION, NOISE, START = 0, 1, 2
# Of a slow part: over one tick, by its correlation time [s]; ln of the unit; what is believed of ln sd and ln tau.
RATE_S, LOG_UNIT, LOG_SHARE, CENTRE, SPREAD, CENTRE_TAU, TAU_SPREAD, SLOW = range(8)
# Below this the integrals of a slow part's noise are series of so many terms: their closed form cancels.
NEAR, TERMS = 0.1, 12
# Curvatures count as at least this when they are damped.
FLATTEST = 1e-9
HALF_LOG_2PI = 0.9189385332046727
# Variances multiplied before one looks how large the product is, and what is large and small then: those of the widest
# scales, 1e35, do not overflow yet.
TOGETHER = 8
SMALL, LARGE = 1e-20, 1e20
# Samples whose derivatives are summed at a time: they stay in the first cache.
STRETCH = 64
# Ticks between two steps of a recursion [1] (chosen: what a step costs is little beside the filters then).
STEP = 32
# What a recursion sums: minus the log-likelihood of what moves, and by how much it tells samples better than what
# stands, not below minus as much as makes a difference.
COST, GAIN, TOLD = range(3)
# Of a chain and a fast part: how many integrators, states of a slow part beside them, and of the fast one. These are
# the usual ones of a learner.
SHAPES = [(d, s, m) for d in (2, 3) for s, most in ((1, 4), (2, 2)) for m in range(most + 1)]
NUMBERS = np.array([100 * d + 10 * s + m for d, s, m in SHAPES])


def _root(u):
    """Square roots."""
    return u.called("sqrt") if isinstance(u, Written) else np.sqrt(u)


def _smaller(u, v):
    """The smaller one of each two."""
    return u.called("minnum", v) if isinstance(u, Written) else np.fmin(u, v)


def _larger(u, v):
    """The larger one of each two."""
    return u.called("maxnum", v) if isinstance(u, Written) else np.fmax(u, v)


for _function, _name in ((_root, "sqrt"), (_smaller, "minnum"), (_larger, "maxnum")):
    stand_for(_function, _name)


@njit(apart=True, cache=True, nogil=True, error_model="numpy")
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
        arma_fit.matrix_product(A, P, T)
        arma_fit.matrix_product_transposed(T, A, B)
        for i in range(m):
            for j in range(m):
                if not abs(B[i, j]) < 1e300:
                    return False
                P[i, j] += B[i, j]
                worst = max(worst, abs(B[i, j]))
                top = max(top, abs(P[i, j]))
        if not worst > 1e-17 * top:
            return True
        arma_fit.matrix_product(A, A, T)
        for i in range(m):
            for j in range(m):
                A[i, j] = T[i, j]
    return False


@njit(cache=True, nogil=True, error_model="numpy", **UNCOUNTED)
def _move(x, at, U, used, a, r, m):
    """``x = F x`` in place, for the rows from `at` on: the chain advances one tick, the observer state shifts."""
    for i in range(r):
        s = load(x, at + i) * load(U, i * r + i)
        for k in range(i + 1, r):
            if used[0, i, k]:
                s = s + load(U, i * r + k) * load(x, at + k)
        store(x, at + i, s)
    if m > 0:
        first = load(x, at + r)
        for i in range(m - 1):
            store(x, at + r + i, load(x, at + r + i + 1) - load(a, i) * first)
        store(x, at + r + m - 1, all_of(0.0) - load(a, m - 1) * first)


def _tick(P, x, L, K, U, Q, used, sees, a, g, noise, corner, noted, y, weight, high, low, r, m):
    """One tick: the gain of a reading y, the state and its covariance after it and moved on.

    ``L = F P h + g``, ``K = weight L / S``, ``x = F x + K v``, ``P = F P F' + Q - K L'`` in place, P on the upper
    triangle; a weight of 0 is a tick without a reading. Row 0 of `noted` is v in standard deviations, row 1 its
    variance S.
    """
    n, last, zero = r + m, r + m - 1, all_of(0.0)
    variance, z = load(noise, 0), y
    for i in range(n):
        s = zero
        if m > 0:
            s = load(P, i * n + r if i <= r else r * n + i)
        for k in range(r):
            if sees[k] != 0.0:
                s = s + all_of(sees[k]) * load(P, i * n + k if i <= k else k * n + i)
        store(L, i, s)
        if i == r:
            variance, z = variance + s, z - load(x, i)
        elif i < r and sees[i] != 0.0:
            variance, z = variance + all_of(sees[i]) * s, z - all_of(sees[i]) * load(x, i)
    inverse, root = weight / variance, _root(variance)
    z = z * root * inverse
    store(noted, 0, z)
    store(noted, 1, variance)
    push = _larger(_smaller(z, high), low) * root
    for i in range(r):
        s, moved = load(L, i), load(x, i)
        if used[0, i, i]:
            s, moved = s * load(U, i * r + i), moved * load(U, i * r + i)
        for k in range(i + 1, r):
            if used[0, i, k]:
                s, moved = s + load(U, i * r + k) * load(L, k), moved + load(U, i * r + k) * load(x, k)
        store(L, i, s)
        store(K, i, s * inverse)
        store(x, i, moved + s * inverse * push)
    top, before = load(L, r % n), load(x, r % n)
    for i in range(r, n):
        s, moved = zero, zero
        if i < last:
            s, moved = load(L, i + 1), load(x, i + 1)
        s, moved = s - load(a, i - r) * top + load(g, i - r), moved - load(a, i - r) * before
        store(L, i, s)
        store(K, i, s * inverse)
        store(x, i, moved + s * inverse * push)
    # the chain, row by row: each becomes itself and later ones
    for i in range(r):
        if used[0, i, i]:
            u = load(U, i * r + i)
            store(P, i * n + i, load(P, i * n + i) * u)
            for j in range(i):
                store(P, j * n + i, load(P, j * n + i) * u)
            for j in range(i, n):
                store(P, i * n + j, load(P, i * n + j) * u)
        for k in range(i + 1, r):
            if used[0, i, k]:
                u, cross = load(U, i * r + k), load(P, i * n + k)
                store(P, i * n + i, load(P, i * n + i) + u * (cross + cross + u * load(P, k * n + k)))
                for j in range(i):
                    store(P, j * n + i, load(P, j * n + i) + u * load(P, j * n + k))
                for j in range(i + 1, k):
                    store(P, i * n + j, load(P, i * n + j) + u * load(P, j * n + k))
                for j in range(k, n):
                    store(P, i * n + j, load(P, i * n + j) + u * load(P, k * n + j))
    for i in range(r):
        row, k = i * n, load(K, i)
        for j in range(i, r):
            s = load(P, row + j) - k * load(L, j)
            if used[1, i, j]:
                s = s + load(Q, row + j)
            store(P, row + j, s)
        top = load(P, row + r % n)
        for j in range(r, n):
            s = zero
            if j < last:
                s = load(P, row + j + 1)
            store(P, row + j, s - load(a, j - r) * top - k * load(L, j))
    for j in range(m):
        store(corner, j, load(P, r * n + r + j))
    for i in range(m):
        row, k, ai = (r + i) * n + r, load(K, r + i), load(a, i)
        before = zero - ai * load(corner, 0)
        if i < m - 1:
            before = before + load(corner, i + 1)
        for j in range(i, m):
            s = load(Q, row + j) - k * load(L, r + j) - load(a, j) * before
            if j < m - 1:
                s = s - ai * load(corner, j + 1) + load(P, row + n + j + 1)
            store(P, row + j, s)


@njit(cache=True, nogil=True, error_model="numpy")
def _shape(used, sees, m):
    """Number of a shape: of d integrators with a slow part of s states and m of a fast one; -1 for another chain."""
    r = sees.size
    for s in range(min(r, 3)):
        d, same = r - s, True
        for i in range(r):
            same = same and sees[i] == (1.0 if i == 0 or (i == d and s > 0) else 0.0)
            for j in range(i, r):
                near = (i < d) == (j < d)
                same = same and used[0, i, j] == (near and (i < j or i >= d)) and (near or not used[1, i, j])
        if same and (100 * d + 10 * s + m == NUMBERS).any():
            return 100 * d + 10 * s + m
    return -1


def _pattern(d, s):
    """What `_set_up` finds of such a shape, and how a reading sees it."""
    r = d + s
    near = np.triu((np.arange(r) < d)[:, None] == (np.arange(r) < d))
    moved = near & ~np.diag(np.arange(r) < d)
    return np.array([moved, near]), np.eye(r)[0] + (np.arange(r) == d) * (s > 0)


def _tick_in_a_row(shape, P, x, K, U, Q, a, g, noise, noted, y, weight, high):
    """`_tick` of one of these shapes, which the compiler is given instruction by instruction."""
    d, s, m = shape // 100, shape // 10 % 10, shape % 10
    used, sees = _pattern(d, s)
    L, corner = np.zeros((d + s + m, LANES)), np.zeros((m, LANES))
    _tick(P, x, L, K, U, Q, used, sees, a, g, noise, corner, noted, y, weight, high, -high, d + s, m)


def _write_tick(shape, rows, numbers, fresh):
    """`_tick` of a shape on values that write down what is done to them."""
    (P, x, K, U, Q, a, g, noise, noted), (y, weight, high) = rows, numbers
    d, s, m = shape // 100, shape // 10 % 10, shape % 10
    used, sees = _pattern(d, s)
    low = np.zeros(LANES) - high
    _tick(P, x, fresh(), K, U, Q, used, sees, a, g, noise, fresh(), noted, y, weight, high, low, d + s, m)


write_out(_tick_in_a_row, _write_tick, NUMBERS.tolist(), [types.Array] * 9, [lanes] * 3)
_tick_by_loops = njit(cache=True, nogil=True, error_model="numpy", **UNCOUNTED)(_tick)


@njit(apart=True, cache=True, nogil=True, error_model="numpy")
def _set_up(thetas, chains, begin, rules, starts, U, used, a, g, Q, start, noise, able):
    """The models from `begin` on in lanes; those behind the last repeat it, those without a stationary start are not
    `able`. Where none starts, what a start wants is not worked out.
    """
    last, r, m = len(thetas) - 1, chains.shape[2], a.shape[0]
    n, d = r + m, int(rules[DIFFUSE])
    unit = np.zeros((m, m))
    for lane in range(LANES):
        theta, chain = thetas[min(begin + lane, last)], chains[min(begin + lane, last)]
        same = lane > 0
        for i in range(2 * m):
            same = same and theta[i] == thetas[min(begin + lane - 1, last), i]
        if same or not starts:
            able[lane] = not starts or able[lane - 1]
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
                used[0, i, j] = used[0, i, j] or chain[TRANSITION, i, j] != (1.0 if i == j else 0.0)
                used[1, i, j] = used[1, i, j] or chain[NOISE, i, j] != 0.0


@njit(apart=True, cache=True, nogil=True, error_model="numpy", **UNCOUNTED)
def _through(y, sees, rules, first, shape, group, E, V, model, state, past, sums):
    """The loop of `channel_filter`, where nothing is allocated: with references to arrays counted it takes a sixth
    longer. It goes on from `past`: how many samples are missing up to here, and how many the segment holds. Adds what
    samples say to `total`, and what is left of their variances is in `product`; returns how many count.
    """
    U, used, a, g, Q, start, noise = model
    P, x, L, K, A, X, w, corner, noted, spare = state
    total, product = sums
    r, m = sees.size, a.shape[0]
    n, d, longest, groups = r + m, int(rules[DIFFUSE]), int(rules[LONGEST_GAP]), E.shape[1] // LANES
    wanted = E.size > 0 and group < groups
    limit, half = all_of(rules[CLIP]), all_of(0.5)
    missing, known, counted = past[0], past[1], 0
    for t in range(y.size):
        seen = not math.isnan(y[t])
        if seen:
            if missing > longest:
                known = 0
                _begin(P, x, A, start, n, d)
            missing = 0
        else:
            missing += 1
        if wanted and (known < d or not seen):
            store(E, t * groups + group, all_of(math.nan))
            store(V, t * groups + group, all_of(1.0))
        if missing > longest:
            continue
        weight, value = all_of(1.0 if seen else 0.0), all_of(y[t] if seen else 0.0)
        # a diffuse state is not known yet: any innovation is ordinary
        high = limit if known >= d else all_of(math.inf)
        if shape < 0:
            low = all_of(0.0) - high
            _tick_by_loops(P, x, L, K, U, Q, used, sees, a, g, noise, corner, noted, value, weight, high, low, r, m)
        else:
            _tick_in_a_row(shape, P, x, K, U, Q, a, g, noise, noted, value, weight, high)
        if seen and known >= d:
            z, variance = load(noted, 0), load(noted, 1)
            if wanted:
                store(E, t * groups + group, z)
                store(V, t * groups + group, variance)
            if t >= first:
                size = magnitude(z)
                short = _smaller(size, limit)
                store(total, 0, load(total, 0) + short * (size - half * short))
                store(product, 0, load(product, 0) * variance)
                counted += 1
                if counted % TOGETHER == 0:
                    _take_logarithms(product, total)
        if known < d:
            inverse = weight / _root(load(noted, 1))
            for k in range(d):
                by = all_of(0.0)
                if m > 0:
                    by = load(A, k * n + r)
                for i in range(r):
                    if sees[i] != 0.0:
                        by = by + all_of(sees[i]) * load(A, k * n + i)
                _move(A, k * n, U, used, a, r, m)
                for i in range(n):
                    store(A, k * n + i, load(A, k * n + i) - load(K, i) * by)
                if seen:
                    store(X, known * d + k, by * inverse)
            if seen:
                store(w, known, load(noted, 0))
                if known == d - 1:
                    _collapse(X, w, A, x, P, n, d, spare)
        if seen:
            known += 1
    past[0], past[1] = missing, known
    return counted


@njit(apart=True, cache=True, nogil=True, error_model="numpy")
def channel_filter(y, thetas, chains, sees, rules, first, E, V, values):
    """Minus the log-likelihood of several models into `values` (K,): of the samples from `first` on, given those
    before. Innovations in standard deviations and their variances go into `E` and `V` (N, a multiple of `LANES`), of as
    many models as these have room for; empty where none are wanted.

    thetas (K, 2m+1), chains (K, 3, r, r); y (N,) with NaN where a sample is missing; sees (r,) how the reading sees the
    chain. The first DIFFUSE states start diffuse: as many known samples of a segment fix them and do
    not count (their density does not depend on theta). A run of more than LONGEST_GAP missing samples ends a segment.
    Innovations beyond CLIP standard deviations enter the state clipped and the likelihood by Huber's function. Where
    nothing counts, `E` is NaN and `V` 1. Infinite for a model that is not stationary, or so nearly integrating that the
    start's covariance is only rounding.
    """
    r, m = sees.size, (thetas.shape[1] - 1) // 2
    n, d = r + m, int(rules[DIFFUSE])
    U, used, able = np.zeros((r * r, LANES)), np.zeros((2, r, r), np.bool_), np.zeros(LANES, np.bool_)
    P, Q, start = np.zeros((n * n, LANES)), np.zeros((n * n, LANES)), np.zeros((n * n, LANES))
    a, g, corner = np.zeros((m, LANES)), np.zeros((m, LANES)), np.zeros((m + 1, LANES))
    x, L, K = np.zeros((n, LANES)), np.zeros((n, LANES)), np.zeros((n, LANES))
    A, X, w = np.zeros((d * n, LANES)), np.zeros((d * d, LANES)), np.zeros((d, LANES))
    noise, total, product = np.zeros((1, LANES)), np.zeros((1, LANES)), np.ones((1, LANES))
    noted, spare = np.zeros((2, LANES)), (np.zeros((d, d)), np.zeros((n, d)))
    model, state = (U, used, a, g, Q, start, noise), (P, x, L, K, A, X, w, corner, noted, spare)
    sums, past = (total, product), np.empty(2, np.int64)
    for group in range((values.size + LANES - 1) // LANES):
        begin = group * LANES
        used[:] = False
        past[0], past[1] = int(rules[LONGEST_GAP]) + 1, 0
        _set_up(thetas, chains, begin, rules, values.size > 0, U, used, a, g, Q, start, noise, able)
        store(total, 0, all_of(0.0))
        store(product, 0, all_of(1.0))
        counted = _through(y, sees, rules, first, _shape(used, sees, m), group, E, V, model, state, past, sums)
        for k in range(begin, min(begin + LANES, values.size)):
            value = total[0, k - begin] + 0.5 * math.log(product[0, k - begin]) + counted * HALF_LOG_2PI
            values[k] = value if able[k - begin] and value < math.inf else math.inf


@njit(apart=True, cache=True, nogil=True, error_model="numpy", **UNCOUNTED)
def _begin(P, x, A, start, n, d):
    """The state at the start of a segment: the chain diffuse (columns of A) or as known, the ARMA error stationary."""
    for i in range(n * n):
        store(P, i, load(start, i))
    for i in range(n):
        store(x, i, all_of(0.0))
    for i in range(d * n):
        store(A, i, all_of(1.0 if i % (n + 1) == 0 else 0.0))


@njit(apart=True, cache=True, nogil=True, error_model="numpy", **UNCOUNTED)
def _take_logarithms(product, total):
    """Of products of variances that have become large or small half the logarithm is added to the sums, and they begin
    anew.
    """
    for k in range(LANES):
        if not SMALL < product[0, k] < LARGE:
            total[0, k] += 0.5 * math.log(product[0, k])
            product[0, k] = 1.0


@njit(apart=True, cache=True, nogil=True, error_model="numpy", **UNCOUNTED)
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


@njit(apart=True, cache=True, nogil=True, error_model="numpy")
def channel_scores(E, V, steps, clip, info, gradient):
    """Gradient of minus the log-likelihood and the Fisher information, from what `channel_filter` has noted: in lane 0
    of a model, in the others of those with one of its k parameters moved by ``steps[i]``.

    With z the innovation in standard deviations and S its variance, ``gradient = sum(psi(z) dz + dlnS / 2)`` and ``info
    = sum(dv dv'/S + dlnS dlnS'/2)``, ``dv/sqrt(S) = dz + z dlnS/2`` (Harvey 1989, eqs 3.4.69-70); derivatives are
    differences.
    """
    k, groups = steps.size, E.shape[1] // LANES
    per, slopes = np.zeros(groups * LANES), np.zeros(groups * LANES)
    sums, turn = np.zeros((2 * k, groups * LANES)), np.zeros((2 * STRETCH, groups * LANES))
    for i in range(k):
        per[i + 1] = 1.0 / steps[i]
    half = all_of(0.5)
    for begin in range(0, E.shape[0], STRETCH):
        count = 0
        for t in range(begin, min(begin + STRETCH, E.shape[0])):
            z, variance = E[t, 0], V[t, 0]
            if math.isnan(z):
                continue
            clipped, halved, relative = all_of(min(max(z, -clip), clip)), all_of(0.5 * z), all_of(1.0 / variance)
            for group in range(groups):
                row, rate = t * groups + group, load(per, group)
                by_s = (load(V, row) - all_of(variance)) * (rate * relative)
                by_z = (load(E, row) - all_of(z)) * rate
                store(slopes, group, load(slopes, group) + clipped * by_z + half * by_s)
                store(turn, 2 * count * groups + group, by_z + halved * by_s)
                store(turn, (2 * count + 1) * groups + group, by_s)
            count += 1
        for i in range(k):
            for group in range(groups):
                row = 2 * i * groups + group
                of_v, of_s = load(sums, row), load(sums, row + groups)
                for c in range(count):
                    at = 2 * c * groups + group
                    of_v = of_v + all_of(turn[2 * c, i + 1]) * load(turn, at)
                    of_s = of_s + all_of(0.5 * turn[2 * c + 1, i + 1]) * load(turn, at + groups)
                store(sums, row, of_v)
                store(sums, row + groups, of_s)
    for i in range(k):
        gradient[i] = slopes[i + 1]
        for j in range(k):
            info[i, j] = sums[2 * i, j + 1] + sums[2 * i + 1, j + 1]


@njit(cache=True, nogil=True, error_model="numpy")
def _integral(k, x, fading):
    """Of ``s^k exp(-s)`` from 0 to x, k of 0 to 2; `fading` is ``exp(-x)``."""
    if x >= NEAR:
        if k == 0:
            return 1.0 - fading
        return 1.0 - fading * (1.0 + x) if k == 1 else 2.0 - fading * (2.0 + 2.0 * x + x * x)
    total, term = 0.0, x ** (k + 1)
    for n in range(TERMS):
        total += term / (n + k + 1)
        term *= -x / (n + 1)
    return total


@njit(apart=True, cache=True, nogil=True, error_model="numpy")
def slow_part(slow, log_sd, log_tau, rate_s, chain):
    """Transition, noise and start of a Gauss-Markov process of order 1 or 2 over one tick into the last rows and
    columns of `chain` (3, r, r): a cascade of first-order ones, driven at its end.
    """
    step = rate_s / math.exp(log_tau)
    variance, phi = math.exp(2.0 * log_sd), math.exp(-step)
    i = chain.shape[1] - slow
    chain[TRANSITION, i, i] = phi
    if slow == 1:
        chain[NOISE, i, i], chain[START, i, i] = -math.expm1(-2.0 * step) * variance, variance
        return
    # white noise of density 4 b sd^2, in closed form: P0 - Phi P0 Phi' would leave nothing but rounding at small steps
    x, j = 2.0 * step, i + 1
    fading = math.exp(-x)
    zero, one, two = int(0), int(1), int(2)
    chain[TRANSITION, j, j], chain[TRANSITION, i, j] = phi, phi * step
    chain[NOISE, i, i] = 0.5 * variance * _integral(two, x, fading)
    chain[NOISE, i, j] = variance * _integral(one, x, fading)
    chain[NOISE, j, i] = chain[NOISE, i, j]
    chain[NOISE, j, j] = 2.0 * variance * _integral(zero, x, fading)
    chain[START, i, i], chain[START, i, j], chain[START, j, i] = variance, variance, variance
    chain[START, j, j] = 2.0 * variance


@njit(cache=True, nogil=True, error_model="numpy")
def _sizes(k, p, slow, drift):
    """Of k parameters those of the fast part; of its state, and of the chain with the slow part."""
    fast = k - (2 if slow > 0 else 0)
    return fast, max(p, fast - 1 - p), drift.shape[1] + slow


@njit(apart=True, cache=True, nogil=True, error_model="numpy")
def _set_models(rows, p, slow, drift, belief, thetas, chains):
    """What `channel_filter` wants to know of the models in `rows`, see `channel_values`; what is zero stays."""
    fast, m, r = _sizes(rows.shape[1], p, slow, drift)
    for n in range(len(rows)):
        for i in range(p):
            thetas[n, i] = rows[n, i]
        for i in range(fast - 1 - p):
            thetas[n, m + i] = rows[n, p + i]
        thetas[n, 2 * m] = rows[n, fast - 1]
        for part in range(3):
            for i in range(r - slow):
                for j in range(r - slow):
                    chains[n, part, i, j] = drift[part, i, j]
        if slow > 0:
            slow_part(slow, rows[n, fast], rows[n, fast + 1], belief[RATE_S], chains[n])


@njit(apart=True, cache=True, nogil=True, error_model="numpy")
def channel_values(y, rows, p, slow, drift, sees, rules, belief, first, E, V, values):
    """Minus the log-likelihood of several models, less the log-density of their slow parts, into `values` (K,); see
    `channel_filter`.

    rows (K, k): ``[ar (p), ma, ln sd]`` and, with a slow part of order 1 or 2, ``ln sd, ln tau`` of that. drift (3, r,
    r) is the chain beside it; belief (SLOW,) what is believed of it.
    """
    fast, m, r = _sizes(rows.shape[1], p, slow, drift)
    thetas, chains = np.zeros((len(rows), 2 * m + 1)), np.zeros((len(rows), 3, r, r))
    _set_models(rows, p, slow, drift, belief, thetas, chains)
    channel_filter(y, thetas, chains, sees, rules, first, E, V, values)
    for n in range(len(rows) if slow > 0 else 0):
        off = (rows[n, fast] - belief[LOG_UNIT] - belief[CENTRE]) / belief[SPREAD]
        off_tau = (rows[n, fast + 1] - belief[CENTRE_TAU]) / belief[TAU_SPREAD]
        values[n] -= belief[LOG_SHARE] - 0.5 * (off * off + off_tau * off_tau)


@njit(apart=True, cache=True, nogil=True, error_model="numpy")
def difference_steps(theta, p, slow, differences, steps):
    """By how much each parameter is moved for its derivative, into `steps`: the first of the differences that leaves a
    stationary start; the last of them is that of a slow part.
    """
    k, tries = theta.size, differences.size - 1
    fast = k - (2 if slow > 0 else 0)
    q = fast - 1 - p
    m = max(p, q)
    a, c, spare = np.zeros(m), np.zeros(m), np.zeros((m, m))
    for i in range(p):
        a[i] = theta[i]
    for i in range(q):
        c[i] = theta[p + i]
    for i in range(k):
        steps[i] = differences[0 if i < fast else tries]
        for n in range(tries if i < p else 0):
            steps[i] = differences[n]
            a[i] = theta[i] + steps[i]
            if stationary(a, c, spare):
                break
        if i < p:
            a[i] = theta[i]


@njit(cache=True, nogil=True, error_model="numpy")
def channel_point(y, rows, p, slow, drift, sees, rules, belief, differences, E, V, values, info, gradient):
    """`channel_values` of the model in row 0 and of those behind row k, and in rows 1 to k, written here, of the first
    with one of its parameters moved; gradient (k,) and Fisher information (k, k) by these differences.

    differences: see `difference_steps`. Infinite, and NaN, where one of the moved models is not stationary: the caller
    chooses steps that are.
    """
    k = rows.shape[1]
    fast, steps = k - (2 if slow > 0 else 0), np.empty(k)
    difference_steps(rows[0], p, slow, differences, steps)
    for i in range(k):
        for j in range(k):
            rows[i + 1, j] = rows[0, j]
        rows[i + 1, i] += steps[i]
    channel_values(y, rows, p, slow, drift, sees, rules, belief, int(0), E, V, values)
    top = 0.0
    for i in range(k + 1):
        top = max(top, values[i])
    if not top < math.inf:
        values[0] = math.inf
        for i in range(k):
            gradient[i] = math.nan
            for j in range(k):
                info[i, j] = math.nan
        return
    channel_scores(E, V, steps, rules[CLIP], info, gradient)
    if slow > 0:
        gradient[fast] += (rows[0, fast] - belief[LOG_UNIT] - belief[CENTRE]) / belief[SPREAD] ** 2
        gradient[fast + 1] += (rows[0, fast + 1] - belief[CENTRE_TAU]) / belief[TAU_SPREAD] ** 2
        info[fast, fast] += belief[SPREAD] ** -2.0
        info[fast + 1, fast + 1] += belief[TAU_SPREAD] ** -2.0


@njit(cache=True, nogil=True, error_model="numpy")
def damped_steps(theta, gradient, info, dampings, sizes, converged, longest, moved, gains):
    """Where scoring steps lead that are damped more and more (Levenberg), shape (n, k), and what each should gain; only
    for as long as that is more than `converged`: returns how many.

    The parameters from number `sizes` on are logarithms of sizes: none moves by more than `longest`.
    """
    k = theta.size
    L, step = np.empty((k, k)), np.empty(k)
    for n in range(dampings.size):
        for i in range(k):
            for j in range(i + 1):
                s = info[i, j]
                if i == j:
                    s += dampings[n] * max(info[i, i], FLATTEST)
                for h in range(j):
                    s -= L[i, h] * L[j, h]
                L[i, j] = math.sqrt(s) if i == j else s / L[j, j]
        for i in range(k):
            s = -gradient[i]
            for h in range(i):
                s -= L[i, h] * step[h]
            step[i] = s / L[i, i]
        gain = 0.0
        for i in range(k):
            gain += 0.5 * step[i] * step[i]
        if not converged < gain < math.inf:
            return n
        gains[n] = gain
        top = 0.0
        for i in range(k - 1, -1, -1):
            s = step[i]
            for h in range(i + 1, k):
                s -= L[h, i] * step[h]
            step[i] = s / L[i, i]
            if i >= sizes:
                top = max(top, abs(step[i]))
        shrunk = longest / top if top > longest else 1.0
        for i in range(k):
            moved[n, i] = theta[i] + shrunk * step[i]
    return dampings.size


@njit(cache=True, nogil=True, error_model="numpy")
def _begins(y, missing, longest):
    """Whether a segment begins in these samples; `missing` before them."""
    for t in range(y.size):
        if math.isnan(y[t]):
            missing += 1
        else:
            if missing > longest:
                return True
            missing = 0
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def channel_recursion(
    y,
    theta,
    stands,
    steps,
    p,
    slow,
    drift,
    sees,
    rules,
    belief,
    limits,
    known,
    centre,
    keep,
    least,
    state,
    past,
    info,
    told,
):
    """Recursive prediction-error steps (Ljung 1979) of one model, every `STEP` samples and after the last, in place.

    In lane 0 goes the model of `theta`, in the next k those with one of its parameters moved by `steps`, in the last
    one what stands. Their filters go on from `state` (groups, rows, LANES) and `past`, see `state_shape`, from those of
    the samples before; nothing is run again. With the gradient g and the information of the samples between two steps,
    see `channel_scores`, and what is believed, `known` (k,) about `centre` (k,),

        ``J = keep^n J + info,  theta -= (J + J0)^-1 (g + (1 - keep^n) J0 (theta - centre))``

    where n samples are forgotten at once; no step is longer than one standard deviation, and theta stays within
    `limits`, see `confine`. `info` is J; told (TOLD,) is summed up, the gain not below `-least`. Where `keep` is
    negative nothing is forgotten and theta stays.
    """
    k = theta.size
    fast, m, r = _sizes(k, p, slow, drift)
    n, d, groups, moves = r + m, int(rules[DIFFUSE]), len(state), keep > 0.0
    rows, thetas, chains = np.empty((k + 2, k)), np.zeros((k + 2, 2 * m + 1)), np.zeros((k + 2, 3, r, r))
    U, used, able = np.zeros((r * r, LANES)), np.zeros((2, r, r), np.bool_), np.zeros(LANES, np.bool_)
    Q, start, noise = np.zeros((n * n, LANES)), np.zeros((n * n, LANES)), np.zeros((1, LANES))
    a, g, corner = np.zeros((m, LANES)), np.zeros((m, LANES)), np.zeros((m + 1, LANES))
    L, K, noted = np.zeros((n, LANES)), np.zeros((n, LANES)), np.zeros((2, LANES))
    spare, now = (np.zeros((d, d)), np.zeros((n, d))), np.empty(2, np.int64)
    sums, model = (np.zeros((1, LANES)), np.ones((1, LANES))), (U, used, a, g, Q, start, noise)
    E, V, values = np.empty((STEP, groups * LANES)), np.empty((STEP, groups * LANES)), np.empty(groups * LANES)
    gradient, own, trial, gains, undamped = np.empty(k), np.empty((k, k)), np.empty((1, k)), np.empty(1), np.zeros(1)
    for begin in range(0, y.size, STEP):
        part = y[begin : begin + STEP]
        for i in range(k + 2):
            for j in range(k):
                rows[i, j] = theta[j] if i <= k else stands[j]
        for i in range(k):
            rows[i + 1, i] += steps[i]
        _set_models(rows, p, slow, drift, belief, thetas, chains)
        starts = _begins(part, past[0], rules[LONGEST_GAP])
        for group in range(groups):
            used[:] = False
            now[0], now[1] = past[0], past[1]
            _set_up(thetas, chains, group * LANES, rules, starts, U, used, a, g, Q, start, noise, able)
            store(sums[0], 0, all_of(0.0))
            store(sums[1], 0, all_of(1.0))
            at = state[group]
            P, x, A = at[: n * n], at[n * n : n * n + n], at[n * n + n : n * n + n + d * n]
            X, w = at[n * n + n + d * n : n * n + n + d * n + d * d], at[n * n + n + d * n + d * d :]
            lanes = P, x, L, K, A, X, w, corner, noted, spare
            shape = _shape(used, sees, m)
            counted = _through(part, sees, rules, int(0), shape, group, E, V, model, lanes, now, sums)
            for lane in range(LANES):
                value = sums[0][0, lane] + 0.5 * math.log(sums[1][0, lane]) + counted * HALF_LOG_2PI
                values[group * LANES + lane] = value
        past[0], past[1] = now[0], now[1]
        told[COST] += values[0]
        told[GAIN] = max(told[GAIN] + values[k + 1] - values[0], -least)
        channel_scores(E[: part.size], V[: part.size], steps, rules[CLIP], own, gradient)
        left = keep**part.size if moves else 1.0
        for i in range(k):
            gradient[i] += (1.0 - left) * known[i] * (theta[i] - centre[i])
            for j in range(k):
                info[i, j] = left * info[i, j] + own[i, j]
                own[i, j] = info[i, j] + (known[i] if i == j else 0.0)
        if moves and damped_steps(theta, gradient, own, undamped, fast - 1, 0.0, math.inf, trial, gains):
            shrunk = 1.0 / math.sqrt(max(2.0 * gains[0], 1.0))
            for i in range(k):
                trial[0, i] = theta[i] + shrunk * (trial[0, i] - theta[i])
            arma_fit.confine(trial, p, fast - 1 - p, limits)
            for i in range(k):
                theta[i] = trial[0, i]


def state_shape(k, p, slow, drift, rules):
    """Of the state of `channel_recursion`: groups of lanes; covariances, states and what a diffuse start needs."""
    fast, d = k - 2 * (slow > 0), int(rules[DIFFUSE])
    n = len(drift[0]) + slow + max(p, fast - 1 - p)
    return -(-(k + 2) // LANES), n * n + n + d * n + d * d + d, LANES
