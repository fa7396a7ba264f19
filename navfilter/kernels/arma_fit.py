"""Kernels of the batch fit. Observer form: ``z+ = M z + g e``, ``y = z[0] + e`` with ``g = c - a``.

Coefficient vectors `a` and `c` are padded with zeros to the common length r = max(p, q, 1) of the state z.
"""

import math

import numpy as np

from navfilter.kernels.compiling.decorators import njit

# Roots are found when none moves by more than this part any more: the next round would square it. Near a multiple root
# they never settle.
CLOSE, ROUNDS = 1e-10, 60
# A root smaller than this is 0; a pole that is pushed away from 1 is damped by this part of its natural frequency.
TINY, LEAST_DAMPING = 1e-12, 0.05


@njit(cache=True, nogil=True)
def arma_filter(y, a, c, z, e):
    """Residuals ``C e = A y`` from the observer state `z`, which is advanced in place."""
    r = z.size
    last = r - 1
    for t in range(y.size):
        yt = y[t]
        et = yt - z[0]
        e[t] = et
        for i in range(last):
            z[i] = z[i + 1] + (c[i] * et - a[i] * yt)
        z[last] = c[last] * et - a[last] * yt


@njit(cache=True, nogil=True)
def impulse_response(c, w):
    """Impulse response of 1/C into `w`; returns the length after which it stays below 1e-17 of its maximum."""
    r = c.size
    n = w.size
    peak = 0.0
    quiet = 0
    for t in range(n):
        s = 1.0 if t == 0 else 0.0
        for i in range(min(r, t)):
            s -= c[i] * w[t - 1 - i]
        w[t] = s
        peak = max(peak, abs(s))
        quiet = quiet + 1 if abs(s) < 1e-17 * peak else 0
        if quiet > r:
            w[t:] = 0.0
            return t + 1
    return n


@njit(apart=True, cache=True, nogil=True)
def lag_products(x, y, out):
    """``out[k] = sum_t x[t] y[t+k]`` for every k of `out`."""
    n = min(x.size, y.size)
    m = out.size
    out[:] = 0.0
    whole = max(n - m + 1, 0)
    blocks = whole - whole % 4
    for t in range(0, blocks, 4):
        x0, x1, x2, x3 = x[t], x[t + 1], x[t + 2], x[t + 3]
        for k in range(m):
            out[k] += (x0 * y[t + k] + x1 * y[t + k + 1]) + (x2 * y[t + k + 2] + x3 * y[t + k + 3])
    for t in range(blocks, n):
        for k in range(min(m, n - t)):
            out[k] += x[t] * y[t + k]


@njit(cache=True, nogil=True)
def inner_products(X, G):
    """``G = X X'`` for few long rows; unlike BLAS it starts no threads."""
    m, n = X.shape
    for i in range(m):
        for j in range(i + 1):
            s0 = 0.0
            s1 = 0.0
            s2 = 0.0
            s3 = 0.0
            whole = n - n % 4
            for t in range(0, whole, 4):
                s0 += X[i, t] * X[j, t]
                s1 += X[i, t + 1] * X[j, t + 1]
                s2 += X[i, t + 2] * X[j, t + 2]
                s3 += X[i, t + 3] * X[j, t + 3]
            for t in range(whole, n):
                s0 += X[i, t] * X[j, t]
            G[i, j] = (s0 + s1) + (s2 + s3)
            G[j, i] = G[i, j]


@njit(cache=True, nogil=True)
def without_inputs(y, R, b, out):
    """``out = y - R' b``, the series without its fitted inputs (rows of R)."""
    for t in range(y.size):
        out[t] = y[t]
    for i in range(b.size):
        f = b[i]
        for t in range(y.size):
            out[t] -= f * R[i, t]


@njit(cache=True, nogil=True)
def shift_gram(x, y, first, G):
    """Inner products of delayed copies, ``G[i, j] = sum_t x[t-i-first] y[t-j]``, zero before the start.

    Only the products with one delay are summed over time; the others lose one term at the end per step down a diagonal.
    """
    n = x.size
    rows, columns = G.shape[0] + first, G.shape[1]
    down = np.empty(rows)
    lag_products(x, y, down)
    across = np.empty(columns)
    lag_products(y, x, across)
    for i in range(rows):
        for j in range(columns):
            k = min(i, j)
            s = down[i - j] if i >= j else across[j - i]
            for m in range(k):
                s -= x[n - 1 - (i - k + m)] * y[n - 1 - (j - k + m)]
            if i >= first:
                G[i - first, j] = s


@njit(cache=True, nogil=True)
def matrix_product(A, B, out):
    """A B, of square matrices, into `out`."""
    for i in range(A.shape[0]):
        for j in range(A.shape[0]):
            s = 0.0
            for k in range(A.shape[0]):
                s += A[i, k] * B[k, j]
            out[i, j] = s


@njit(cache=True, nogil=True)
def matrix_product_transposed(A, B, out):
    """A B' into `out`."""
    for i in range(A.shape[0]):
        for j in range(A.shape[0]):
            s = 0.0
            for k in range(A.shape[0]):
                s += A[i, k] * B[j, k]
            out[i, j] = s


@njit(cache=True, nogil=True)
def lyapunov(M, Q, rounds, P):
    """Sum ``P = Q + M Q M' + ...`` by doubling, at most 2^rounds terms.

    For a stable M and enough rounds this solves ``P = M P M' + Q``.
    """
    n = M.shape[0]
    A = M.copy()
    T = np.empty((n, n))
    B = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            P[i, j] = Q[i, j]
    for _ in range(rounds):
        matrix_product(A, P, T)
        matrix_product_transposed(T, A, B)
        worst = 0.0
        top = 0.0
        for i in range(n):
            for j in range(n):
                worst = max(worst, abs(B[i, j]))
                top = max(top, abs(P[i, j]))
                P[i, j] += B[i, j]
        if not worst > 1e-17 * top:
            break
        matrix_product(A, A, T)
        for i in range(n):
            for j in range(n):
                A[i, j] = T[i, j]


@njit(apart=True, cache=True, nogil=True)
def largest_reflection(c, radius):
    """Largest reflection coefficient of ``1 + c1 q^-1 + ...`` scaled to `radius`: below 1 means all roots inside."""
    n = c.size
    u = np.empty(n)
    f = 1.0
    for i in range(n):
        f /= radius
        u[i] = c[i] * f
    worst = 0.0
    for m in range(n - 1, -1, -1):
        k = u[m]
        if not abs(k) < 1.0:
            return math.inf
        worst = max(worst, abs(k))
        d = 1.0 - k * k
        for i in range((m + 1) // 2):
            left, right = u[i], u[m - 1 - i]
            u[i] = (left - k * right) / d
            u[m - 1 - i] = (right - k * left) / d
    return worst


@njit(apart=True, cache=True, nogil=True, error_model="numpy")
def _roots(c, z):
    """Roots of ``1 + c1 q^-1 + ...`` into `z`, all at a time (Aberth, Math. Comp. 27, 1973)."""
    n, size = c.size, 0.0
    while n and c[n - 1] == 0.0:
        n -= 1
        z[n] = 0.0
    if n:
        size = abs(c[n - 1]) ** (1.0 / n)
    for k in range(n):
        turn = 2.0 * math.pi * k / n + 0.5
        z[k] = complex(size * math.cos(turn), size * math.sin(turn))
    for _ in range(ROUNDS):
        moved = 0.0
        for k in range(n):
            value, slope, others = complex(1.0), complex(0.0), complex(0.0)
            for i in range(n):
                slope = slope * z[k] + value
                value = value * z[k] + c[i]
            if value == 0.0:
                continue
            for j in range(n):
                if j != k and z[j] != z[k]:
                    others += 1.0 / (z[k] - z[j])
            step = value / (slope - value * others)
            if not abs(step) < 1e300:
                step = complex(1e-3 * size)
            z[k] -= step
            moved = max(moved, abs(step) / abs(z[k]))
        if moved < CLOSE:
            break


@njit(apart=True, cache=True, nogil=True, error_model="numpy")
def _from_roots(z, c):
    """Coefficients of the polynomial with these roots, their real parts into `c`."""
    terms = np.zeros(z.size + 1, np.complex128)
    terms[0] = 1.0
    for k in range(z.size):
        for i in range(k + 1, 0, -1):
            terms[i] -= z[k] * terms[i - 1]
    for i in range(c.size):
        c[i] = terms[i + 1].real


@njit(apart=True, cache=True, nogil=True, error_model="numpy")
def _push_from_one(c, distance, z):
    """Roots nearer to 1 than `distance` in natural frequency, ``|ln z|`` per sample, are moved away from it, damped at
    the least.
    """
    if c.size == 1:
        c[0] = max(c[0], -math.exp(-distance))
        return
    _roots(c, z)
    near = False
    for k in range(c.size):
        log = np.log(z[k] if abs(z[k]) > TINY else complex(TINY))
        if abs(log) < distance:
            near = True
            log = log * (distance / abs(log)) if abs(log) > TINY else complex(-distance)
            z[k] = np.exp(complex(min(log.real, -LEAST_DAMPING * distance), log.imag))
    if near:
        _from_roots(z, c)


@njit(apart=True, cache=True, nogil=True, error_model="numpy")
def _pull_inside(c, radius, circle, z):
    """No root beyond `radius`; those beyond `circle` are reflected into the unit circle first."""
    if not c.size or largest_reflection(c, radius) < 1.0:
        return
    _roots(c, z)
    for k in range(c.size):
        size = abs(z[k])
        if size > 0.0:
            wanted = 1.0 / size if size > circle else size
            z[k] *= min(wanted, radius - TINY) / size
    _from_roots(z, c)


@njit(cache=True, nogil=True, error_model="numpy")
def confine(rows, p, q, limits):
    """Keep parameter vectors ``[ar (p), ma (q), sizes ...]``, one a row, within limits, in place.

    limits: how far poles stay from 1 (0: as near as they are), largest radius of a pole, of a zero (those outside the
    unit circle are reflected), then the least and the largest value of each size.
    """
    space = np.empty(max(p, q), np.complex128)
    for n in range(rows.shape[0]):
        row = rows[n]  # contiguous: of one that an iteration gives numba does not know that
        _pull_inside(row[:p], limits[1], math.inf, space[:p])
        if p and limits[0] > 0.0:
            _push_from_one(row[:p], limits[0], space[:p])
            _pull_inside(row[:p], limits[1], math.inf, space[:p])
        _pull_inside(row[p : p + q], limits[2], 1.0, space[:q])
        for i in range(p + q, row.size):
            k = 3 + 2 * (i - p - q)
            row[i] = min(max(row[i], limits[k]), limits[k + 1])


@njit(cache=True, nogil=True)
def kalman_whiten(Y, a, c, P0, W):
    """Exact innovations over their root variances, column by column of `Y`, in units of the innovation sd.

    `P0` is the stationary covariance of the observer state for sd = 1. NaN in the first column marks a missing row.
    Once P has died out the gain is constant and a row costs O(r) (steady-state switch). Returns sum ln F.
    """
    n, columns = Y.shape
    r = a.size
    P = P0.copy()
    T = np.empty((r, r))
    K = np.empty(r)
    z = np.zeros((columns, r))
    logdet = 0.0
    steady = False
    for t in range(n):
        missing = math.isnan(Y[t, 0])
        if missing:
            steady = False
        F = 1.0
        if not steady:
            F = 1.0 + P[0, 0]
            top = _covariance_step(P, T, K, a, c, missing)
            steady = top < 1e-13
        else:
            for i in range(r):
                K[i] = c[i] - a[i]
        root = math.sqrt(F)
        if not missing:
            logdet += math.log(F)
        for m in range(columns):
            level = z[m, 0]
            v = 0.0 if missing else Y[t, m] - level
            W[t, m] = math.nan if missing else v / root
            for i in range(r - 1):
                z[m, i] = z[m, i + 1] - a[i] * level + K[i] * v
            z[m, r - 1] = -a[r - 1] * level + K[r - 1] * v
    return logdet


@njit(cache=True, nogil=True)
def _covariance_step(P, T, K, a, c, missing):
    """One prediction of P in place (Joseph form), the gain into K; returns the largest entry of the new P."""
    r = a.size
    F = 1.0 + P[0, 0]
    for i in range(r):
        up = P[i + 1, 0] if i + 1 < r else 0.0
        K[i] = 0.0 if missing else (up - a[i] * P[0, 0] + c[i] - a[i]) / F
    # Rows of (M - K h') P, then the same from the right.
    for i in range(r):
        for j in range(r):
            up = P[i + 1, j] if i + 1 < r else 0.0
            T[i, j] = up - (a[i] + K[i]) * P[0, j]
    top = 0.0
    for i in range(r):
        for j in range(r):
            up = T[i, j + 1] if j + 1 < r else 0.0
            gi, gj = c[i] - a[i] - K[i], c[j] - a[j] - K[j]
            P[i, j] = up - (a[j] + K[j]) * T[i, 0] + gi * gj
            top = max(top, abs(P[i, j]))
    return top


@njit(cache=True, nogil=True)
def _lengthen(ar, m, k):
    """One coefficient more than the first m, by the reflection coefficient k (Levinson)."""
    for i in range((m + 1) // 2):
        left, right = ar[i], ar[m - 1 - i]
        ar[i] = left + k * right
        ar[m - 1 - i] = right + k * left
    ar[m] = k


@njit(cache=True, nogil=True)
def levinson(gamma, ar, pacf):
    """Levinson-Durbin: AR coefficients and partial autocorrelations from autocovariances; returns sd^2."""
    n = ar.size
    v = gamma[0]
    for m in range(n):
        s = gamma[m + 1]
        for i in range(m):
            s += ar[i] * gamma[m - i]
        k = -s / v if v > 0.0 else 0.0
        pacf[m] = -k
        _lengthen(ar, m, k)
        v *= 1.0 - k * k
    return v


@njit(cache=True, nogil=True)
def burg_recursion(x, ar):
    """Burg's AR coefficients (forward and backward prediction errors, always stable); returns the residual power."""
    n = x.size
    f = x.copy()
    b = x.copy()
    v = 0.0
    for t in range(n):
        v += x[t] * x[t] / n
    for m in range(ar.size):
        top = 0.0
        bottom = 0.0
        for t in range(m + 1, n):
            top += f[t] * b[t - 1]
            bottom += f[t] * f[t] + b[t - 1] * b[t - 1]
        k = -2.0 * top / bottom if bottom > 0.0 else 0.0
        for t in range(n - 1, m, -1):
            ft, bt = f[t], b[t - 1]
            f[t] = ft + k * bt
            b[t] = bt + k * ft
        _lengthen(ar, m, k)
        v *= 1.0 - k * k
    return v
