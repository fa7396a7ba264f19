"""Gaussian likelihood of one channel: a slow drift with known noise, slow errors, an ARMA error, known white noise.

``y[t] = sees' d[t] + n[t] + v[t]``: d holds the navigation error's chain of integrators and the slow part of the
sensor's error, side by side; n is the ARMA error in observer form, ``z+ = M z + g e``, ``n = z[0] + e`` with ``g = c -
a``; v is white. Process and measurement noise share e, which the filter (predictor form, Anderson and Moore 1979,
section 5.5) takes into account. A slow error and fast ones in one observer form would be ill-conditioned: several poles
within 0.03 of the unit circle leave nothing but rounding of the start's covariance.

``chain`` (3, r, r) describes d: transition U over one tick (upper triangular), noise of one tick, covariance at the
start (of the states after the diffuse ones, which come first). Parameter vector ``theta = [a (m), c (m), ln sd]``, a
and c padded with zeros to m = max(p, q, 1). ``rules`` holds [diffuse states, longest gap, clip, white variance,
tolerance]. Only the upper triangle of P is kept; row and column n are zero.
"""

import math

import numpy as np
from numba import njit

DIFFUSE, LONGEST_GAP, CLIP, WHITE, TOLERANCE = 0, 1, 2, 3, 4
TRANSITION, NOISE, START = 0, 1, 2
SHORTEST, LONGEST = 3, 10
FIRST, AGAIN = 32, 8
# Of states that are seen side by side, a gain below this part of the largest one counts as that large.
SMALL_PART = 0.3
HALF_LOG_2PI = 0.9189385332046727


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


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _move(x, U, a, r, m):
    """``x = F x`` in place: the chain advances one tick, the observer state shifts."""
    for i in range(r):
        s = U[i, i] * x[i]
        for k in range(i + 1, r):
            s += U[i, k] * x[k]
        x[i] = s
    first = x[r]
    for i in range(m):
        x[r + i] = x[r + i + 1] - a[i] * first


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _spread(P, L, scale, a, g, var, chain, save, r, m):
    """``P = F P F' + noise - scale L L'`` in place on the upper triangle."""
    U, Q = chain[TRANSITION], chain[NOISE]
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
            s = U[i, i] * (P[i, r + j + 1] - a[j] * save[i])
            for k in range(i + 1, r):
                s += U[i, k] * (P[k, r + j + 1] - a[j] * save[k])
            P[i, r + j] = s - li * L[r + j]
    # Row by row from the left, then column by column: elements still needed have not been overwritten.
    for i in range(r):
        for j in range(i, r):
            s = 0.0
            for k in range(i, r):
                row = 0.0
                for n in range(j, r):
                    row += U[j, n] * (P[k, n] if k <= n else P[n, k])
                s += U[i, k] * row
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


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _gain(P, L, U, sees, a, g, var, noise, r, m):
    """Variance S of the innovation; ``L = F P h + covariance of process and measurement noise``, gain times S."""
    for i in range(r):
        L[i] = P[i, r]
    for i in range(m):
        L[r + i] = P[r, r + i]
    for k in range(r):
        if sees[k] != 0.0:
            for i in range(k):
                L[i] += sees[k] * P[i, k]
            for i in range(k, r + m):
                L[i] += sees[k] * P[k, i]
    S = L[r] + noise
    for k in range(r):
        S += sees[k] * L[k]
    _move(L, U, a, r, m)
    for i in range(m):
        L[r + i] += var * g[i]
    return S


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(M, B):
    """``B = M^-1 B`` by elimination with partial pivoting; M is consumed."""
    n = M.shape[0]
    for k in range(n):
        top = k
        for i in range(k + 1, n):
            if abs(M[i, k]) > abs(M[top, k]):
                top = i
        if top != k:
            for j in range(k, n):
                M[k, j], M[top, j] = M[top, j], M[k, j]
            for j in range(B.shape[1]):
                B[k, j], B[top, j] = B[top, j], B[k, j]
        pivot = 1.0 / M[k, k]
        for i in range(k + 1, n):
            f = M[i, k] * pivot
            if f != 0.0:
                for j in range(k + 1, n):
                    M[i, j] -= f * M[k, j]
                for j in range(B.shape[1]):
                    B[i, j] -= f * B[k, j]
    for k in range(n - 1, -1, -1):
        pivot = 1.0 / M[k, k]
        for j in range(B.shape[1]):
            s = B[k, j]
            for i in range(k + 1, n):
                s -= M[k, i] * B[i, j]
            B[k, j] = s * pivot


@njit(cache=True, nogil=True, error_model="numpy")
def _first_map(maps, a, g, var, noise, chain, sees, r, m):
    """One tick of the covariance recursion as ``P+ = H + A (P^-1 + G)^-1 A'``: ``maps[0]`` holds A, G, H."""
    maps[0, :, :, :] = 0.0
    A, G, H = maps[0, 0], maps[0, 1], maps[0, 2]
    for i in range(r):
        for j in range(i, r):
            A[i, j] = chain[TRANSITION, i, j]
            H[i, j] = H[j, i] = chain[NOISE, i, j]
    for i in range(m):
        A[r + i, r] = -a[i]
        if i + 1 < m:
            A[r + i, r + i + 1] = 1.0
    # Process and measurement noise share e: taken apart first (Anderson and Moore 1979, section 5.5).
    for i in range(m):
        for k in range(r):
            A[r + i, k] -= sees[k] * var * g[i] / noise
        A[r + i, r] -= var * g[i] / noise
        for j in range(m):
            H[r + i, r + j] = var * g[i] * g[j] * (1.0 - var / noise)
    for i in range(r + 1):
        for j in range(r + 1):
            G[i, j] = (sees[i] if i < r else 1.0) * (sees[j] if j < r else 1.0) / noise


@njit(cache=True, nogil=True, error_model="numpy")
def _double(maps, k, work):
    """``maps[k]``: the recursion over twice as many ticks as ``maps[k - 1]`` (Lainiotis 1976)."""
    n = maps.shape[2]
    A, G, H = maps[k - 1, 0], maps[k - 1, 1], maps[k - 1, 2]
    M, B, T = work[:n, :n], work[n : 2 * n], work[2 * n :, :n]
    for i in range(n):
        for j in range(n):
            s = 1.0 if i == j else 0.0
            for o in range(n):
                s += H[i, o] * G[o, j]
            M[i, j] = s
            B[i, j], B[i, n + j] = A[i, j], H[i, j]
    _solve(M, B)
    _product(A, B[:, :n], maps[k, 0])
    _product(A, B[:, n:], T)
    _product_transposed(T, A, maps[k, 2])
    _product(G, B[:, :n], T)
    for i in range(n):
        for j in range(n):
            s = G[i, j]
            for o in range(n):
                s += A[o, i] * T[o, j]
            maps[k, 1, i, j] = s
            maps[k, 2, i, j] += H[i, j]


@njit(cache=True, nogil=True, error_model="numpy")
def _leap(P, out, step, work):
    """Upper triangle of the covariance after the ticks of a map into `out`."""
    n = step.shape[1]
    A, G, H = step[0], step[1], step[2]
    M, B, T = work[:n, :n], work[n : 2 * n, :n], work[2 * n :, :n]
    for i in range(n):
        for j in range(i, n):
            B[i, j] = B[j, i] = P[i, j]
    _product(B, G, M)
    for i in range(n):
        M[i, i] += 1.0
    _solve(M, B)
    _product(A, B, T)
    for i in range(n):
        for j in range(i, n):
            s = H[i, j]
            for o in range(n):
                s += T[i, o] * A[j, o]
            out[i, j] = s


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _alike(L, S, ahead, ahead_S, tolerance, U, sees):
    """Whether two gains are so near to each other that all between them may be interpolated."""
    # of states that are seen side by side only the sum is: the gain of one may cross zero
    floor, together = 1e-6, 0.0
    for i in range(sees.size):
        if sees[i] != 0.0 or U[i, i] != 1.0:
            together = max(together, SMALL_PART * min(abs(L[i]) / S, abs(ahead[i]) / ahead_S))
    for i in range(ahead.size - 1):
        old, new = L[i] / S, ahead[i] / ahead_S
        least = max(floor, together) if i < sees.size else floor
        if i < sees.size and sees[i] == 0.0 and U[i, i] == 1.0:
            least = floor * 1e-3**i
        if not abs(new - old) <= tolerance * max(min(abs(old), abs(new)), least):
            return False
    return abs(ahead_S - S) <= tolerance * min(S, ahead_S)


@njit(cache=True, nogil=True, error_model="numpy")
def _glide(y, t, ticks, x, U, sees, a, L, S, ahead, ahead_S, clip, e, lns, K, slope):
    """`ticks` known samples from `t` on, the gain interpolated between both ends; returns what they add to minus the
    log-likelihood.
    """
    m, n = a.size, x.size - 1
    r = n - m
    for i in range(n):
        K[i] = L[i] / S
        slope[i] = (ahead[i] / ahead_S - K[i]) / ticks
    level, root = math.log(S), 1.0 / math.sqrt(S)
    rise, turn = (math.log(ahead_S) - level) / ticks, (1.0 / math.sqrt(ahead_S) - root) / ticks
    total = ticks * (HALF_LOG_2PI + 0.5 * (level + 0.5 * rise * (ticks - 1)))
    if m <= 2 and _is_small(U, sees, r):
        return total + _glide_small(y, t, ticks, x, U, a, clip, e, lns, K, slope, level, rise, root, turn)
    for k in range(t, t + ticks):
        residual = y[k] - x[r]
        for i in range(r):
            residual -= sees[i] * x[i]
        z = residual * root
        e[k], lns[k] = z, level
        size = abs(z)
        if size > clip:
            total += clip * (size - 0.5 * clip)
            residual *= clip / size
        else:
            total += 0.5 * z * z
        _move(x, U, a, r, m)
        for i in range(n):
            x[i] += K[i] * residual
            K[i] += slope[i]
        level += rise
        root += turn
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _is_small(U, sees, r):
    """Whether the chain is two integrators, alone or beside one slow part of first or second order."""
    if r < 2 or r > 4 or U[0, 0] != 1.0 or U[0, 1] != 1.0 or U[1, 1] != 1.0 or sees[1] != 0.0:
        return False
    apart = True
    for k in range(2, r):
        apart = apart and U[0, k] == 0.0 and U[1, k] == 0.0 and sees[k] == (1.0 if k == 2 else 0.0)
    return apart


@njit(cache=True, nogil=True, error_model="numpy")
def _glide_small(y, t, ticks, x, U, a, clip, e, lns, K, slope, level, rise, root, turn):
    """The loop of `_glide` for two integrators, at most one slow part and two states of the ARMA error, which then stay
    in registers.
    """
    m, total = a.size, 0.0
    r = x.size - 1 - m
    a0, a1 = a[0], a[m - 1] if m == 2 else 0.0
    phi, s, Ks, ss = (U[2, 2], x[2], K[2], slope[2]) if r > 2 else (0.0, 0.0, 0.0, 0.0)
    both, v, Kv, sv = (U[2, 3], x[3], K[3], slope[3]) if r > 3 else (0.0, 0.0, 0.0, 0.0)
    d0, d1, n0, n1 = x[0], x[1], x[r], x[r + 1] if m == 2 else 0.0
    K0, K1, K2, K3 = K[0], K[1], K[r], K[r + 1] if m == 2 else 0.0
    s0, s1, s2, s3 = slope[0], slope[1], slope[r], slope[r + 1] if m == 2 else 0.0
    for k in range(t, t + ticks):
        residual = y[k] - d0 - s - n0
        z = residual * root
        e[k], lns[k] = z, level
        size = abs(z)
        if size > clip:
            total += clip * (size - 0.5 * clip)
            residual *= clip / size
        else:
            total += 0.5 * z * z
        d0, n0, n1 = d0 + d1 + K0 * residual, n1 - a0 * n0 + K2 * residual, K3 * residual - a1 * n0
        d1 += K1 * residual
        s, v = phi * s + both * v + Ks * residual, phi * v + Kv * residual
        K0, K1, K2, K3, Ks, Kv = K0 + s0, K1 + s1, K2 + s2, K3 + s3, Ks + ss, Kv + sv
        level, root = level + rise, root + turn
    x[0], x[1], x[r] = d0, d1, n0
    if r > 2:
        x[2] = s
    if r > 3:
        x[3] = v
    if m == 2:
        x[r + 1] = n1
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _reach(P, after, maps, made, level, far, L, S, ahead, U, sees, a, g, var, noise, tolerance, work):
    """Largest level from `level` down whose 2^level ticks stay within `far` and the tolerance; the covariance then is
    `after`.

    Returns the level (0: none), the variance of the innovation there, and how many maps there are now.
    """
    m = a.size
    r = maps.shape[2] - m
    while level >= SHORTEST:
        if 2**level <= far:
            for k in range(made, level + 1):
                _double(maps, k, work)
            made = max(made, level + 1)
            _leap(P, after, maps[level], work)
            ahead_S = _gain(after, ahead, U, sees, a, g, var, noise, r, m)
            if tolerance < 0.0 or _alike(L, S, ahead, ahead_S, tolerance, U, sees):
                return level, ahead_S, made
        level -= 1
    return 0, S, made


@njit(cache=True, nogil=True, error_model="numpy")
def _segment(P, x, A, start, var, P0):
    """The state at the start of a segment: drift diffuse (columns of A) or as known, ARMA error stationary."""
    d, r, m = A.shape[1], P0.shape[0], start.shape[0]
    x[:], P[:, :], A[:, :] = 0.0, 0.0, 0.0
    for i in range(m):
        for j in range(m):
            P[r + i, r + j] = var * start[i, j]
    for i in range(d):
        A[i, i] = 1.0
    for i in range(d, r):
        for j in range(i, r):
            P[i, j] = P0[i, j]


@njit(cache=True, nogil=True, error_model="numpy")
def _carry(A, column, U, sees, a, L, scale, X, row, root, r):
    """One tick of the diffuse columns; what a known sample (`row` not below 0) says of them goes into that row of X."""
    m, n = a.size, A.shape[0]
    column[n] = 0.0
    for k in range(A.shape[1]):
        for i in range(n):
            column[i] = A[i, k]
        weight = column[r]
        for i in range(r):
            weight += sees[i] * column[i]
        _move(column, U, a, r, m)
        for i in range(n):
            A[i, k] = column[i] - (weight * scale * L[i] if row >= 0 else 0.0)
        if row >= 0:
            X[row, k] = weight / root


@njit(cache=True, nogil=True, error_model="numpy")
def channel_filter(y, theta, chain, sees, rules, plan, tolerance, e, lns):
    """Standardised innovations and ln S of a series with gaps; returns minus the log-likelihood.

    y (N,) with NaN where a sample is missing; sees (r,) how the reading sees the chain. The first DIFFUSE states start
    diffuse: as many known samples of a segment fix them and do not count (their density does not depend on theta). A
    run of more than LONGEST_GAP missing samples ends a segment. Innovations beyond CLIP standard deviations enter the
    state clipped and the likelihood by Huber's function. `e` (N,) is NaN and `lns` 0 where nothing counts. Infinite if
    not stationary, or so nearly integrating that the start's covariance is only rounding.

    Where the gain changes by no more than the part `tolerance` over 8 to 256 ticks, it is interpolated between both
    ends; the covariance at the far end is exact (by doubling). 0: every tick by itself. Where it leapt how far (2^level
    ticks) is noted in `plan` (N,), or done as noted there (a `tolerance` below 0).
    """
    r, m = sees.size, (theta.size - 1) // 2
    U = chain[TRANSITION]
    n, d = r + m, int(rules[DIFFUSE])
    a, c, var = theta[:m], theta[m : 2 * m], math.exp(2.0 * theta[2 * m])
    noise, clip, longest, follow = var + rules[WHITE], rules[CLIP], int(rules[LONGEST_GAP]), tolerance < 0.0
    g, start, P, after = c - a, np.zeros((m, m)), np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
    rows = np.zeros((6, n + 1))
    x, L, ahead, column, save, slope = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
    A, X, w, work = np.zeros((n, d)), np.zeros((d, d)), np.zeros(d), np.zeros((3 * n, 2 * n))
    maps, level, wait, until, gap = np.empty((LONGEST + 1, 3, n, n)), SHORTEST - 1, FIRST, 0, -1
    made = int(1)  # a literal would compile a `_reach` of its own
    if not stationary(a, c, start):
        return math.inf
    _first_map(maps, a, g, var, noise, chain, sees, r, m)
    total, missing, known = 0.0, longest + 1, 0
    for t in range(y.size):
        if t < until:
            continue
        seen = not math.isnan(y[t])
        e[t], lns[t] = math.nan, 0.0
        if not seen:
            missing += 1
            if missing > longest:
                continue
        elif missing > longest:
            known, wait = 0, FIRST
            _segment(P, x, A, start, var, chain[START])
        scale, gain, root = 0.0, 0.0, 1.0
        if seen:
            missing, wait = 0, wait - 1
            S = _gain(P, L, U, sees, a, g, var, noise, r, m)
            if known >= d and (plan[t] > 0 if follow else wait <= 0 and tolerance > 0.0):
                while gap < t or (gap < y.size and gap < t + 2**LONGEST and not math.isnan(y[gap])):
                    gap = max(gap, t) + 1
                wanted = plan[t] if follow else min(level + 1, LONGEST)
                level, ahead_S, made = _reach(
                    P, after, maps, made, wanted, gap - t, L, S, ahead, U, sees, a, g, var, noise, tolerance, work
                )
                if level > 0:
                    total += _glide(y, t, 2**level, x, U, sees, a, L, S, ahead, ahead_S, clip, e, lns, save, slope)
                    plan[t], until = level, t + 2**level
                    for i in range(n):
                        for j in range(i, n):
                            P[i, j] = after[i, j]
                    continue
                level, wait = SHORTEST - 1, AGAIN
            scale, residual, root = 1.0 / S, y[t] - x[r], math.sqrt(S)
            for i in range(r):
                residual -= sees[i] * x[i]
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
        _move(x, U, a, r, m)
        for i in range(n):
            x[i] += gain * L[i]
        _spread(P, L, scale, a, g, var, chain, save, r, m)
        if known < d:
            _carry(A, column, U, sees, a, L, scale, X, known if seen else -1, root, r)
            if seen:
                w[known] = residual / root
                if known == d - 1:
                    _collapse(X, w, A, x, P, n)
        if seen:
            known += 1
    return total if total < math.inf else math.inf


@njit(cache=True, nogil=True, error_model="numpy")
def contribution(z, lns, clip):
    """What standardised innovations and ln S of a stretch add to minus the log-likelihood; NaN does not count."""
    total = 0.0
    for t in range(z.size):
        if not math.isnan(z[t]):
            size = abs(z[t])
            total += HALF_LOG_2PI + 0.5 * lns[t]
            total += clip * (size - 0.5 * clip) if size > clip else 0.5 * size * size
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _dot(u, v):
    """Sum of products; in any order, so that several are added at a time."""
    s = 0.0
    for t in range(u.size):
        s += u[t] * v[t]
    return s


@njit(cache=True, nogil=True, error_model="numpy")
def channel_scores(E, LNS, steps, clip, info, gradient):
    """Gradient of minus the log-likelihood and the Fisher information, from innovations and ln S, `E` and `LNS`
    (k+1, N): in row 0 those of a model, in the others those with one of its k parameters moved by ``steps[i]``.

    Derivatives of innovations and ln S are differences; they take the place of those rows. With z the standardised
    innovation, ``gradient = sum(psi(z) dz + dlnS / 2)`` and ``info = sum(dv dv'/S + dlnS dlnS'/2)``, ``dv/sqrt(S) = dz
    + z dlnS/2`` (Harvey 1989, eqs 3.4.69-70).
    """
    n = E.shape[1]
    psi = np.empty(n)
    for t in range(n):
        z = E[0, t]
        psi[t] = 0.0 if math.isnan(z) else min(max(z, -clip), clip)
    for i in range(steps.size):
        per = 1.0 / steps[i]
        slope = 0.0
        for t in range(n):
            z = E[0, t]
            counts = not math.isnan(z)
            by_s = (LNS[i + 1, t] - LNS[0, t]) * per if counts else 0.0
            by_z = (E[i + 1, t] - z) * per if counts else 0.0
            slope += psi[t] * by_z + 0.5 * by_s
            E[i + 1, t] = by_z + 0.5 * z * by_s if counts else 0.0
            LNS[i + 1, t] = by_s
        gradient[i] = slope
        for j in range(i + 1):
            info[i, j] = info[j, i] = _dot(E[i + 1], E[j + 1]) + 0.5 * _dot(LNS[i + 1], LNS[j + 1])
