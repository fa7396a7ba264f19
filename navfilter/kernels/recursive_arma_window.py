"""Window kernels of the online ARMA estimator: passes over the samples kept, and the polish.

theta = [a, c, b] with p, q coefficients and m regressors, n = p + q + m, r = max(p, q).

``buf``
    (1 + m, L) samples in working units: row 0 the series (NaN = missing), the others the regressors.
``carry``
    (3 + m, width) filter memory before the first sample of ``buf``: [-y lags, e lags], the same filtered by 1/C,
    filtered -y lags p.. q-1, filtered lags of each regressor.
``work``
    (5 + m, r + L) scratch of a pass: -y, e, filtered -y, filtered e, counted e, filtered regressors; the first r
    columns are the memory.
``normal``
    (n + 1, n + 1) sums of products of [psi, e].

The window is recomputed at every hop, never down-dated: a difference of sums does not heal after a burst.
"""

import math

import numpy as np

from navfilter.kernels import arma_fit
from navfilter.kernels.compiling.decorators import njit


@njit(cache=True, error_model="numpy")
def _dot(a, i, b, j, count):
    """Sum of a[i:i+count] * b[j:j+count] in eight lanes: fixed order, so the same on every machine."""
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
    x = a[i : i + count]
    y = b[j : j + count]
    whole = count - count % 8
    for k in range(0, whole, 8):
        s0 += x[k] * y[k]
        s1 += x[k + 1] * y[k + 1]
        s2 += x[k + 2] * y[k + 2]
        s3 += x[k + 3] * y[k + 3]
        s4 += x[k + 4] * y[k + 4]
        s5 += x[k + 5] * y[k + 5]
        s6 += x[k + 6] * y[k + 6]
        s7 += x[k + 7] * y[k + 7]
    total = ((s0 + s4) + (s1 + s5)) + ((s2 + s6) + (s3 + s7))
    for k in range(whole, count):
        total += x[k] * y[k]
    return total


@njit(cache=True, error_model="numpy")
def _lag_block(normal, top, left, a, b, rows, cols, lo, hi):
    """normal[top+i, left+j] = sum over t in [lo, hi) of a[t-1-i] * b[t-1-j], by shifting the first row and column."""
    for j in range(cols):
        normal[top, left + j] = _dot(a, lo - 1, b, lo - 1 - j, hi - lo)
    for i in range(1, rows):
        normal[top + i, left] = _dot(a, lo - 1 - i, b, lo - 1, hi - lo)
    for i in range(1, rows):
        for j in range(1, cols):
            normal[top + i, left + j] = (
                normal[top + i - 1, left + j - 1] + a[lo - 1 - i] * b[lo - 1 - j] - a[hi - 1 - i] * b[hi - 1 - j]
            )


@njit(cache=True, error_model="numpy")
def _residuals(theta, p, q, buf, count, work):
    """Rows -y and e of `work` from the samples; missing ones are filled by prediction. Returns how many are missing."""
    r = max(p, q)
    m = buf.shape[0] - 1
    missing = 0
    for t in range(count):
        work[0, r + t] = -buf[0, t]
        if np.isnan(buf[0, t]):
            missing += 1
    e = work[1]
    if missing == 0:
        for t in range(count):
            e[r + t] = buf[0, t]
        for k in range(p):
            a = theta[k]
            for t in range(count):
                e[r + t] -= a * work[0, r + t - 1 - k]
    for j in range(m):
        b = theta[p + q + j]
        if missing == 0:
            for t in range(count):
                e[r + t] -= b * buf[1 + j, t]
    for t in range(r, r + count):
        total = e[t]
        if missing > 0:
            total = -work[0, t]
            for k in range(p):
                total -= theta[k] * work[0, t - 1 - k]
            for j in range(m):
                total -= theta[p + q + j] * buf[1 + j, t - r]
        for k in range(q - 1, -1, -1):
            total -= theta[p + k] * e[t - 1 - k]
        if missing > 0 and np.isnan(total):
            filled = 0.0
            for k in range(p):
                filled += theta[k] * work[0, t - 1 - k]
            for j in range(m):
                filled += theta[p + q + j] * buf[1 + j, t - r]
            for k in range(q):
                filled += theta[p + k] * e[t - 1 - k]
            work[0, t] = -filled
            total = 0.0
        e[t] = total
    return missing


@njit(cache=True, error_model="numpy")
def _load(carry, p, q, m, work):
    """Memory before the buffer into the first columns of `work`."""
    r = max(p, q)
    work[:, :r] = 0.0
    for k in range(p):
        work[0, r - 1 - k] = carry[0, k]
        work[2, r - 1 - k] = carry[1, k]
    for k in range(q):
        work[1, r - 1 - k] = carry[0, p + k]
        work[3, r - 1 - k] = carry[1, p + k]
        for j in range(m):
            work[5 + j, r - 1 - k] = carry[3 + j, k]
    for k in range(p, q):
        work[2, r - 1 - k] = carry[2, k - p]


@njit(cache=True, error_model="numpy")
def memory_after(count, p, q, work, carry):
    """Filter memory after `count` samples of the last pass, from `work` into `carry`."""
    m = work.shape[0] - 5
    end = max(p, q) + count - 1
    for k in range(p):
        carry[0, k] = work[0, end - k]
        carry[1, k] = work[2, end - k]
    for k in range(q):
        carry[0, p + k] = work[1, end - k]
        carry[1, p + k] = work[3, end - k]
        for j in range(m):
            carry[3 + j, k] = work[5 + j, end - k]
    for k in range(p, q):
        carry[2, k - p] = work[2, end - k]


@njit(cache=True, error_model="numpy")
def window_pass(theta, p, buf, span, carry, work, normal):
    """Filter the first span[1] samples with theta; sums of squares and products over span[0]: into `normal`.

    normal[:n, :n] = sum psi psi', normal[n, :n] = normal[:n, n] = sum psi e, normal[n, n] = sum e^2. Returns the number
    of residuals counted: missing samples and the max(p, q) after each of them are left out.
    """
    lo, count = span
    m = buf.shape[0] - 1
    n = theta.size
    q = n - p - m
    r = max(p, q)
    _load(carry, p, q, m, work)
    missing = _residuals(theta, p, q, buf, count, work)
    for t in range(r, r + count):
        fy = work[0, t]
        fe = work[1, t]
        for k in range(q - 1, -1, -1):
            fy -= theta[p + k] * work[2, t - 1 - k]
            fe -= theta[p + k] * work[3, t - 1 - k]
        work[2, t] = fy
        work[3, t] = fe
        for j in range(m):
            fu = buf[1 + j, t - r]
            for k in range(q - 1, -1, -1):
                fu -= theta[p + k] * work[5 + j, t - 1 - k]
            work[5 + j, t] = fu
    used = 0
    settle = 0
    for t in range(count):
        keep = True
        if missing > 0:
            if np.isnan(buf[0, t]):
                settle = r
                keep = False
            elif settle > 0:
                settle -= 1
                keep = False
        work[4, r + t] = work[1, r + t] if keep else 0.0
        if keep and t >= lo:
            used += 1
    first = r + lo
    size = count - lo
    if p > 0:
        _lag_block(normal, int(0), int(0), work[2], work[2], p, p, first, first + size)
    if q > 0:
        _lag_block(normal, p, p, work[3], work[3], q, q, first, first + size)
    if p > 0 and q > 0:
        _lag_block(normal, int(0), p, work[2], work[3], p, q, first, first + size)
    for j in range(m):
        u = work[5 + j]
        for i in range(p):
            normal[i, p + q + j] = _dot(work[2], first - 1 - i, u, first, size)
        for i in range(q):
            normal[p + i, p + q + j] = _dot(work[3], first - 1 - i, u, first, size)
        for i in range(j + 1):
            normal[p + q + i, p + q + j] = _dot(work[5 + i], first, u, first, size)
        normal[p + q + j, n] = _dot(u, first, work[4], first, size)
    for i in range(p):
        normal[i, n] = _dot(work[2], first - 1 - i, work[4], first, size)
    for i in range(q):
        normal[p + i, n] = _dot(work[3], first - 1 - i, work[4], first, size)
    normal[n, n] = _dot(work[4], first, work[4], first, size)
    for i in range(n + 1):
        for j in range(i):
            normal[i, j] = normal[j, i]
    return used


@njit(cache=True, error_model="numpy")
def _cholesky(a, n, ridge, factor):
    """Lower factor of a[:n, :n] with its diagonal raised by `ridge` (relative); False when not positive definite."""
    for i in range(n):
        for j in range(i + 1):
            total = a[i, j]
            if i == j:
                total += ridge * a[i, i]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i == j:
                if not total > 1e-14 * a[i, i]:
                    return False
                factor[i, i] = math.sqrt(total)
            else:
                factor[i, j] = total / factor[j, j]
    return True


@njit(cache=True, error_model="numpy")
def _solve(factor, n, b):
    """b <- (L L')^-1 b."""
    for i in range(n):
        for k in range(i):
            b[i] -= factor[i, k] * b[k]
        b[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= factor[k, i] * b[k]
        b[i] /= factor[i, i]


@njit(cache=True, error_model="numpy")
def polish(theta, p, buf, span, carry, work, normal, limits):
    """Levenberg-Gauss-Newton on the window from `theta` (refined in place).

    Poles stay within limits[0] and zeros within limits[1]. A step is kept only if the sum of squares falls. Ends when
    the step left is 0.01 standard deviations, or after limits[2] passes. On return `work` and `normal` belong to
    theta. Returns (residuals counted, 1 if converged else 0).
    """
    n = theta.size
    q = n - p - (buf.shape[0] - 1)
    passes = int(limits[2])
    used = window_pass(theta, p, buf, span, carry, work, normal)
    if n == 0 or used <= n or not normal[n, n] > 0.0:
        return used, 1
    trial = np.empty(n)
    step = np.empty(n)
    factor = np.empty((n, n))
    other = np.empty((n + 1, n + 1))
    damping = 1e-4
    stale = False
    done = 0
    for _ in range(passes - 1):
        for i in range(n):
            step[i] = normal[i, n]
        while not _cholesky(normal, n, damping, factor) and damping < 1e6:
            damping *= 10.0
        if damping >= 1e6:
            break
        _solve(factor, n, step)
        gained = 0.0
        for i in range(n):
            gained += step[i] * normal[i, n]
        if not gained > 1e-4 * normal[n, n] / used:
            done = 1
            break
        share = 1.0
        for _ in range(30):
            for i in range(n):
                trial[i] = theta[i] + share * step[i]
            if (
                arma_fit.largest_reflection(trial[:p], limits[0]) < 1.0
                and arma_fit.largest_reflection(trial[p : p + q], limits[1]) < 1.0
            ):
                break
            share *= 0.6
        else:
            break
        window_pass(trial, p, buf, span, carry, work, other)
        if other[n, n] < normal[n, n]:
            stale = False
            for i in range(theta.size):
                theta[i] = trial[i]
            fell = normal[n, n] - other[n, n]
            for i in range(normal.shape[0]):
                for j in range(normal.shape[1]):
                    normal[i, j] = other[i, j]
            damping = max(0.1 * damping, 1e-9)
            if share < 1.0 and fell < 1e-3 * normal[n, n] / used:
                done = 1
                break
        else:
            stale = True
            damping = max(10.0 * damping, 1e-3)
            if damping > 1e4:
                break
    if stale:
        window_pass(theta, p, buf, span, carry, work, normal)
    return used, done


@njit(cache=True, error_model="numpy")
def window_covariance(normal, n, out):
    """out <- inverse of normal[:n, :n], with as little ridge as makes it positive definite; False when none does."""
    factor = np.empty((n, n))
    column = np.empty(n)
    ridge = 1e-10
    while not _cholesky(normal, n, ridge, factor):
        ridge *= 10.0
        if ridge > 1e3:
            return False
    for j in range(n):
        column[:] = 0.0
        column[j] = 1.0
        _solve(factor, n, column)
        for i in range(j + 1):
            out[j, i] = column[i]
            out[i, j] = column[i]
    return True
