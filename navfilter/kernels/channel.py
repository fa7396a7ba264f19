"""Gaussian likelihood of one channel: a slow drift with known noise, an ARMA error, and known white noise.

``y[t] = d[t] + n[t] + v[t]``: d is the first of r integrators in a chain, in units per tick, so that its transition is
``exp`` of the shift matrix (``1/(j-i)!`` above the diagonal) whatever the period; n is the ARMA error in observer form,
``z+ = M z + g e``, ``n = z[0] + e`` with ``g = c - a``; v is white. Process and measurement noise share e, which the
filter (predictor form, Anderson and Moore 1979, section 5.5) takes into account.

Parameter vector ``theta = [a (m), c (m), ln sd]``, a and c padded with zeros to m = max(p, q, 1). ``rules`` holds
[diffuse states, longest gap, clip, white variance]. Only the upper triangle of P is kept; row and column n are zero.
"""

import math

import numpy as np
from numba import njit

DIFFUSE, LONGEST_GAP, CLIP, WHITE = 0, 1, 2, 3
HALF_LOG_2PI = 0.9189385332046727


@njit(cache=True, nogil=True, error_model="numpy")
def stationary(a, c, P):
    """Stationary covariance of the observer state for unit innovations into `P`, by doubling; False if there is none."""
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
        _product(A, P, T, False)
        _product(T, A, B, True)
        for i in range(m):
            for j in range(m):
                if not abs(B[i, j]) < 1e300:
                    return False
                P[i, j] += B[i, j]
                worst = max(worst, abs(B[i, j]))
                top = max(top, abs(P[i, j]))
        if not worst > 1e-17 * top:
            return True
        _product(A, A, T, False)
        A[:, :] = T
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _product(A, B, out, transposed):
    for i in range(A.shape[0]):
        for j in range(A.shape[0]):
            s = 0.0
            for k in range(A.shape[0]):
                s += A[i, k] * (B[j, k] if transposed else B[k, j])
            out[i, j] = s


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _move(x, a, taylor, r, m):
    """``x = F x`` in place: the chain advances one tick, the observer state shifts."""
    for i in range(r):
        s = x[i]
        for k in range(i + 1, r):
            s += taylor[k - i] * x[k]
        x[i] = s
    first = x[r]
    for i in range(m):
        x[r + i] = x[r + i + 1] - a[i] * first


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _spread(P, L, scale, a, g, var, Q, taylor, save, r, m):
    """``P = F P F' + noise - scale L L'`` in place on the upper triangle."""
    for j in range(m + 1):
        save[j] = P[r, r + j]
    for i in range(m):
        b = save[i + 1] - a[i] * save[0]
        gi = var * g[i]
        li = scale * L[r + i]
        for j in range(i, m):
            P[r + i, r + j] = P[r + i + 1, r + j + 1] - a[i] * save[j + 1] - a[j] * b + gi * g[j] - li * L[r + j]
    for i in range(r):
        save[i] = P[i, r]
    for i in range(r):
        li = scale * L[i]
        for j in range(m):
            s = P[i, r + j + 1] - a[j] * save[i]
            for k in range(i + 1, r):
                s += taylor[k - i] * (P[k, r + j + 1] - a[j] * save[k])
            P[i, r + j] = s - li * L[r + j]
    # Row by row from the left, then column by column: elements still needed have not been overwritten.
    for i in range(r):
        for j in range(i, r):
            s = 0.0
            for k in range(i, r):
                row = 0.0
                for n in range(j, r):
                    row += taylor[n - j] * (P[k, n] if k <= n else P[n, k])
                s += taylor[k - i] * row
            P[i, j] = s + Q[i, j] - scale * L[i] * L[j]


@njit(cache=True, nogil=True, error_model="numpy")
def _collapse(X, w, A, x, P, n):
    """End of a diffuse start: the states given the first r samples (de Jong 1991). X and w are consumed."""
    r = w.size
    # Gauss-Jordan on [X | w, A' is transformed along]: columns of A become A X^-1.
    for k in range(r):
        top = k
        for i in range(k + 1, r):
            if abs(X[k, i]) > abs(X[k, top]):
                top = i
        for i in range(r):
            X[i, k], X[i, top] = X[i, top], X[i, k]
        for i in range(n):
            A[i, k], A[i, top] = A[i, top], A[i, k]
        pivot = 1.0 / X[k, k]
        for i in range(r):
            X[i, k] *= pivot
        for i in range(n):
            A[i, k] *= pivot
        for j in range(r):
            if j != k:
                f = X[k, j]
                for i in range(r):
                    X[i, j] -= f * X[i, k]
                for i in range(n):
                    A[i, j] -= f * A[i, k]
    for i in range(n):
        for k in range(r):
            x[i] += A[i, k] * w[k]
        for j in range(i, n):
            for k in range(r):
                P[i, j] += A[i, k] * A[j, k]


@njit(cache=True, nogil=True, error_model="numpy")
def channel_filter(y, theta, Q, rules, e, lns):
    """Standardised innovations and ln S of a series with gaps; returns minus the log-likelihood.

    y (N,) with NaN where a sample is missing; Q (r+1, r) noise of the chain per tick and, last, the variances of its
    start. The first DIFFUSE states start diffuse: as many known samples of a segment fix them and do not count (their
    density does not depend on theta). A run of more than LONGEST_GAP missing samples ends a segment. Innovations beyond
    CLIP standard deviations enter the state clipped and the likelihood by Huber's function. `e` (N,) is NaN and `lns` 0
    where nothing counts. Infinite if not stationary, or so nearly integrating that the start's covariance is only rounding.
    """
    r, m = Q.shape[1], (theta.size - 1) // 2
    n, d = r + m, int(rules[DIFFUSE])
    a, c, var = theta[:m], theta[m : 2 * m], math.exp(2.0 * theta[2 * m])
    noise, clip, longest = var + rules[WHITE], rules[CLIP], int(rules[LONGEST_GAP])
    g, start = c - a, np.zeros((m, m))
    P, x, L, save = np.zeros((n + 1, n + 1)), np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1)
    A, column, X, w = np.zeros((n, d)), np.zeros(n + 1), np.zeros((d, d)), np.zeros(d)
    taylor = np.array([1.0, 1.0, 1.0 / 2.0, 1.0 / 6.0])  # 1/k!
    if not stationary(a, c, start):
        return math.inf
    total = 0.0
    missing, known = longest + 1, 0
    for t in range(y.size):
        seen = not math.isnan(y[t])
        e[t], lns[t] = math.nan, 0.0
        if not seen:
            missing += 1
            if missing > longest:
                continue
        elif missing > longest:
            known = 0
            x[:], P[:, :], A[:, :] = 0.0, 0.0, 0.0
            for i in range(m):
                for j in range(m):
                    P[r + i, r + j] = var * start[i, j]
            for i in range(d):
                A[i, i] = 1.0
            for i in range(d, r):
                P[i, i] = Q[r, i]
        scale, gain = 0.0, 0.0
        if seen:
            missing = 0
            for i in range(r):
                L[i] = P[0, i] + P[i, r]
            for i in range(m):
                L[r + i] = P[0, r + i] + P[r, r + i]
            S = L[0] + L[r] + noise
            _move(L, a, taylor, r, m)
            for i in range(m):
                L[r + i] += var * g[i]
            scale, residual, root = 1.0 / S, y[t] - x[0] - x[r], math.sqrt(S)
            gain = residual * scale
            if known >= d:
                z, size = residual / root, abs(residual / root)
                e[t], lns[t] = z, math.log(S)
                total += 0.5 * lns[t] + HALF_LOG_2PI
                if size > clip:
                    total += clip * (size - 0.5 * clip)
                    gain *= clip / size
                else:
                    total += 0.5 * z * z
        _move(x, a, taylor, r, m)
        for i in range(n):
            x[i] += gain * L[i]
        _spread(P, L, scale, a, g, var, Q, taylor, save, r, m)
        if known < d:
            for k in range(d):
                for i in range(n):
                    column[i] = A[i, k]
                weight = column[0] + column[r]
                _move(column, a, taylor, r, m)
                for i in range(n):
                    A[i, k] = column[i] - (weight * scale * L[i] if seen else 0.0)
                if seen:
                    X[known, k] = weight / root
            if seen:
                w[known] = residual / root
                if known == d - 1:
                    _collapse(X, w, A, x, P, n)
        if seen:
            known += 1
    return total if total < math.inf else math.inf


@njit(cache=True, nogil=True, error_model="numpy")
def channel_scores(y, theta, Q, rules, free, steps, E, LNS, info, gradient):
    """Minus the log-likelihood, its gradient and the Fisher information in the parameters ``theta[free]``.

    Derivatives of innovations and ln S by differences of `steps`; with z the standardised innovation,
    ``gradient = sum(psi(z) dz + dlnS / 2)`` and ``info = sum(dv dv'/S + dlnS dlnS'/2)``, ``dv/sqrt(S) = dz + z dlnS/2``
    (Harvey 1989, eqs 3.4.69-70). `E` and `LNS` (k+1, N) receive innovations and ln S in row 0, derivatives in the others.
    A step that leaves the stationary region gives an infinite derivative: the caller chooses steps that do not.
    """
    k = free.size
    clip = rules[CLIP]
    value = channel_filter(y, theta, Q, rules, E[0], LNS[0])
    moved = theta.copy()
    for i in range(k):
        moved[free[i]] = theta[free[i]] + steps[i]
        if not channel_filter(y, moved, Q, rules, E[i + 1], LNS[i + 1]) < math.inf:
            return math.inf
        moved[free[i]] = theta[free[i]]
    info[:, :] = 0.0
    gradient[:] = 0.0
    for t in range(y.size):
        z = E[0, t]
        if math.isnan(z):
            continue
        psi = min(max(z, -clip), clip)
        for i in range(k):
            by_s = (LNS[i + 1, t] - LNS[0, t]) / steps[i]
            by_z = (E[i + 1, t] - z) / steps[i]
            gradient[i] += psi * by_z + 0.5 * by_s
            E[i + 1, t] = by_z + 0.5 * z * by_s
            LNS[i + 1, t] = by_s
            for j in range(i + 1):
                info[i, j] += E[i + 1, t] * E[j + 1, t] + 0.5 * by_s * LNS[j + 1, t]
    for i in range(k):
        for j in range(i):
            info[j, i] = info[i, j]
    return value
