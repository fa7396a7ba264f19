"""Kalman kernels: fold the drive's compound transition, tick a sensor's block, correct, and smooth backward.

Symbols: P covariance, Phi transition, Q process noise, H measurement Jacobian, R measurement noise, S innovation
covariance, K gain. Errors e here are *true minus estimated*, so a correction is +K (measured - predicted).
"""

import math

import numpy as np

from navfilter.kernels import consistency, symmetric
from navfilter.kernels.compiling.decorators import COUNTED, UNCOUNTED, flat, njit, shaped
from navfilter.kernels.compiling.registers import all_of, eight, not_zero, put
from navfilter.kernels.compiling.vectors import WIDE, less_half, rank2_update, weighted


@njit(apart=True, cache=True, **UNCOUNTED)
def _product(A, B, out):
    """A (r, k) B (k, n) into out, as many columns as it has: nine rows and eight columns at least.

    Nine rows and eight columns at a time, their sums in registers: a library of linear algebra takes longer to begin
    than such a product. Each sum goes from the first term to the last, multiplied and added in one rounding where the
    processor can.
    """
    for i in range(0, out.shape[0], 9):
        r = min(i, out.shape[0] - 9)
        for j in range(0, out.shape[1], WIDE):
            c = min(j, out.shape[1] - WIDE)
            s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = s8 = all_of(0.0)
            for k in range(A.shape[1]):
                b = eight(B[k], c)
                s0 = s0 + all_of(A[r, k]) * b
                s1 = s1 + all_of(A[r + 1, k]) * b
                s2 = s2 + all_of(A[r + 2, k]) * b
                s3 = s3 + all_of(A[r + 3, k]) * b
                s4 = s4 + all_of(A[r + 4, k]) * b
                s5 = s5 + all_of(A[r + 5, k]) * b
                s6 = s6 + all_of(A[r + 6, k]) * b
                s7 = s7 + all_of(A[r + 7, k]) * b
                s8 = s8 + all_of(A[r + 8, k]) * b
            put(out[r], c, s0)
            put(out[r + 1], c, s1)
            put(out[r + 2], c, s2)
            put(out[r + 3], c, s3)
            put(out[r + 4], c, s4)
            put(out[r + 5], c, s5)
            put(out[r + 6], c, s6)
            put(out[r + 7], c, s7)
            put(out[r + 8], c, s8)


@njit(apart=True, cache=True, **UNCOUNTED)
def _navigation(P, acc, T, A, head):
    """Phi P Phi' of the nine of navigation into head (9, 9), before it is made symmetric. T (9, m or more) holds
    columns of Phi P then; A (m, 9): work.
    """
    m = acc.shape[1]
    _product(acc[:9], P[:m], T)
    for i in range(9):
        for j in range(m):
            A[j, i] = T[i, j]
    _product(acc[:9], A, head)
    consistency.arc_term(P, head)


@njit(cache=True, **UNCOUNTED)
def _reach(row, i):
    """From where to where a row of a transition is not zero; that of a state by itself alone is found at once, that of
    white noise alone (the last state of a moving average) is its own, though zero.
    """
    alone, last = row[i] != 0.0, row.size - WIDE
    for part in range(0, row.size, WIDE):
        begin = min(part, last)
        alone = alone and not_zero(eight(row, begin)) == (begin <= i < begin + WIDE)
    if alone:
        return i, i + 1
    first, last = row.size, 0
    for r in range(row.size):
        if row[r] != 0.0:
            first, last = min(first, r), r + 1
    return (first, last) if last else (i, i + 1)


@njit(apart=True, cache=True, **UNCOUNTED)
def present(P, acc, nav, inertial, own, work, out):
    """What `fold` would leave in P, without folding: of navigation (the first 81 of out), then the variances of all
    other states (n - 9). inertial, own: whether `consistency.attitude_second_order` comes before. work: 9 (2m + 9).
    """
    m, n = acc.shape[1], P.shape[0]
    heading = acc[0, 8], acc[1, 8], acc[3, 8], acc[4, 8]
    down = acc[m + 5, 5]
    if inertial:
        consistency.attitude_second_order(P, acc, nav, own, work)
    T, A, head = shaped(work[: 9 * m], 9, m), shaped(work[9 * m :][: 9 * m], m, 9), work[18 * m :][:81]
    head = shaped(head, 9, 9)
    _navigation(P, acc, T, A, head)
    for i in range(9):
        for j in range(i + 1):
            s = 0.5 * (head[i, j] + head[j, i] + acc[m + i, j] + acc[m + j, i])
            out[9 * i + j] = s
            out[9 * j + i] = s
    for i in range(9, m):
        first, last = _reach(acc[i], i)
        s = acc[m + i, i]
        for r in range(first, last):
            carried = 0.0
            for k in range(first, last):
                carried += acc[i, k] * P[k, r]
            s += carried * acc[i, r]
        out[72 + i] = s
    for i in range(m, n):
        out[72 + i] = P[i, i]
    acc[0, 8], acc[1, 8], acc[3, 8], acc[4, 8] = heading
    acc[m + 5, 5] = down


@njit(cache=True, **UNCOUNTED)
def store_transition(acc, mem):
    """The compound transition into a channel's memory, before it is folded: for the smoother, and for learning."""
    m = acc.shape[1]
    symmetric.copy(flat(acc), mem[: m * m])


@njit(cache=True, **UNCOUNTED)
def _nonzero(numbers):
    """How many of some numbers are not 0."""
    count, rest = 0, numbers.size % WIDE
    for i in range(0, numbers.size - rest, WIDE):
        count += not_zero(eight(numbers, i))
    for i in range(numbers.size - rest, numbers.size):
        count += numbers[i] != 0.0
    return count


@njit(cache=True, **UNCOUNTED)
def _moving_states(acc):
    """How many of the leading states a compound transition moves: those behind them are constants, which it leaves as
    they are, and which gather no noise.
    """
    m, whole = acc.shape[1], flat(acc)
    k = m
    while k > 9 and acc[m + k - 1, k - 1] == 0.0 and acc[k - 1, k - 1] == 1.0:
        k -= 1
    while _nonzero(whole[k * m : m * m]) != m - k:  # one of them moves by another
        k += 1
    return k


@njit(apart=True, cache=True, **UNCOUNTED)
def fold(P, acc, nav, T):
    """P <- Phi P Phi' + Q for the leading m states.

    acc (4m rows) holds Phi and Q, m rows each, then work areas; it is reset to identity and zero. Navigation (nine
    rows) depends on all of them, a drive's state on few: only where a row is not zero is it multiplied. What a constant
    has in P with all that does not move either stays.

    C_nb in nav is made orthonormal again to first order (its rounding grows with the number of products). T: (m, n)
    work.
    """
    m, n, moving = acc.shape[1], P.shape[0], _moving_states(acc)
    # the drive's work areas in acc are free between its steps
    work = flat(acc[2 * m :])
    A, head, begins, ends = shaped(work[: 9 * m], m, 9), shaped(work[9 * m :][:81], 9, 9), work[-2 * m :], work[-m:]
    _navigation(P, acc, T[:9], A, head)
    for i in range(9, moving):
        first, last = _reach(acc[i], i)
        begins[i], ends[i] = first, last
        weighted(acc[i][first:last], P[first:last], T[i])
    for i in range(9):
        for j in range(i + 1):
            s = 0.5 * (head[i, j] + head[j, i] + acc[m + i, j] + acc[m + j, i])
            P[i, j] = s
            P[j, i] = s
    for i in range(9, moving):
        first, last = int(begins[i]), int(ends[i])
        for j in range(i + 1):
            s = 0.5 * (acc[m + i, j] + acc[m + j, i]) + T[j, first] * acc[i, first]
            for r in range(first + 1, last):
                s += T[j, r] * acc[i, r]
            P[i, j] = s
            P[j, i] = s
    for i in range(9, moving):
        if ends[i] - begins[i] != 1.0 or acc[i, i] != 1.0:
            for j in range(moving, n):
                P[i, j] = T[i, j]
                P[j, i] = T[i, j]
    symmetric.mirror_columns(T, P, int(9), moving)
    whole = flat(acc)
    for part in (whole[: moving * m], whole[m * m : (m + moving) * m]):
        for i in range(part.size):
            part[i] = 0.0
    for i in range(moving):
        acc[i, i] = 1.0
    _orthonormal(nav, T[0])


@njit(cache=True, **UNCOUNTED)
def _orthonormal(nav, E):
    """C_nb in nav, orthonormal again to first order. E: work, nine of it."""
    for i in range(3):
        for j in range(3):
            E[3 * i + j] = 0.0
            for a in range(3):
                E[3 * i + j] += nav[6 + 3 * a + i] * nav[6 + 3 * a + j]
    for i in range(3):
        x, y, z = nav[6 + 3 * i], nav[7 + 3 * i], nav[8 + 3 * i]
        for j in range(3):
            nav[6 + 3 * i + j] += 0.5 * (nav[6 + 3 * i + j] - (x * E[j] + y * E[3 + j] + z * E[6 + j]))


@njit(cache=True, **UNCOUNTED)
def is_identity(A):
    """Whether a transition is the identity, and its noise zero if it stands below: A (m or 2m, m)."""
    m = A.shape[1]
    if A[0, 3] != 0.0:
        return False  # velocity moves the position: nearly every other one ends here
    diagonal = 0
    for i in range(m):
        diagonal += A[i, i] == 1.0
    return diagonal == m == _nonzero(flat(A))


@njit(apart=True, cache=True, **COUNTED)
def power(Phi, Q, count, W):
    """Phi^count and the noise gathered in as many ticks, by doubling. W (4, b, b): result Phi, result Q, and the square
    and its noise.
    """
    b = Phi.shape[0]
    A, B, F, G = W[0], W[1], W[2], W[3]
    U = np.empty((b, b))
    V = np.empty((b, b))
    for i in range(b):
        for j in range(b):
            A[i, j] = 1.0 if i == j else 0.0
            B[i, j] = 0.0
            F[i, j] = Phi[i, j]
            G[i, j] = Q[i, j]
    while count > 0:
        for step in range(2):
            if step == 0 and count % 2 == 0:
                continue
            # B <- F B F' + G and A <- F A; in the second round the same with F and G themselves (squaring)
            X = A if step == 0 else F
            Y = B if step == 0 else G
            for i in range(b):
                for j in range(b):
                    s, t = 0.0, 0.0
                    for r in range(b):
                        s += F[i, r] * X[r, j]
                        t += F[i, r] * Y[r, j]
                    U[i, j] = s
                    V[i, j] = t
            for i in range(b):
                for j in range(i + 1):
                    s = G[i, j]
                    for r in range(b):
                        s += V[i, r] * F[j, r]
                    Y[i, j] = s
            for i in range(b):
                for j in range(b):
                    X[i, j] = U[i, j]
                    if j > i:
                        Y[i, j] = Y[j, i]
        count //= 2


@njit(apart=True, cache=True, **UNCOUNTED)
def advance_block(P, x, start, A, B, T):
    """Advance the block at `start` of the state (its own clock): x <- A x, P <- A P A' + B on its rows and columns. T:
    (b, n) work.
    """
    b, n = A.shape[0], P.shape[0]
    for i in range(b):
        weighted(A[i], P[start:], T[i])
    for i in range(b):
        symmetric.copy(T[i], P[start + i])
    for i in range(b):
        for j in range(start):
            P[j, start + i] = T[i, j]
        for j in range(start + b, n):
            P[j, start + i] = T[i, j]
    for j in range(b):
        first, last = b, 0
        for r in range(b):
            if A[j, r] != 0.0:
                first, last = min(first, r), r + 1
        for i in range(j, b):
            s = B[i, j]
            for r in range(first, last):
                s += T[i, start + r] * A[j, r]
            P[start + i, start + j] = s
            P[start + j, start + i] = s
    for i in range(b):
        s = 0.0
        for r in range(b):
            s += A[i, r] * x[start - 9 + r]
        T[i, 0] = s
    for i in range(b):
        x[start - 9 + i] = T[i, 0]


@njit(apart=True, cache=True, **UNCOUNTED)
def _invert(S):
    """The inverse of the upper half of S (2a, a), definite and symmetric, into its lower half (Gauss and Jordan)."""
    a = S.shape[1]
    for i in range(a):
        for j in range(a):
            S[a + i, j] = S[i, j]
    for k in range(a):
        p = 1.0 / S[a + k, k]
        S[a + k, k] = 1.0
        for j in range(a):
            S[a + k, j] *= p
        for i in range(a):
            if i != k:
                f = S[a + i, k]
                S[a + i, k] = 0.0
                for j in range(a):
                    S[a + i, j] -= f * S[a + k, j]
    for i in range(a):
        for j in range(i):
            s = 0.5 * (S[a + i, j] + S[a + j, i])
            S[a + i, j] = s
            S[a + j, i] = s


@njit(apart=True, cache=True, **UNCOUNTED)
def innovation(P, H, res, R, S, PH, out):
    """Innovation covariance S = H P H' + R, its inverse, P H' and the normalised innovation squared (NIS).

    A component whose residual is NaN is missing: zero residual, zero row of H, unit variance. A reading without white
    noise of its own gets 1e-12 of its predicted variance, so that P stays definite. S: (2a, a) receives S, then its
    inverse; PH: (a, n), P H' transposed; out: NIS, number of components used.
    """
    a, n = H.shape
    used = 0
    for i in range(a):
        missing = math.isnan(res[i])
        S[a + i, 0] = 0.0 if missing else 1.0
        if missing:
            res[i] = 0.0
            for j in range(n):
                H[i, j] = 0.0
        else:
            used += 1
        weighted(H[i], P, PH[i])
        for j in range(i + 1):
            s = 0.0
            for r in range(n):
                f = H[j, r]
                if f != 0.0:
                    s += PH[i, r] * f
            if i == j:
                # 1e-60: S is invertible even where nothing is uncertain
                s = 1.0 if missing else s + max(R[i, i], 1e-12 * s, 1e-60)
            elif S[a + i, 0] * S[a + j, 0] > 0.0:
                s += R[i, j]
            S[i, j] = s
            S[j, i] = s
    nis = 0.0
    if a == 1:
        S[1, 0] = 1.0 / S[0, 0]
        nis = res[0] * res[0] / S[0, 0]
    elif a != 3:
        _invert(S)
        for i in range(a):
            for j in range(a):
                nis += res[i] * S[a + i, j] * res[j]
    else:
        b, c, d, e, f, g = S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]
        m0, m1, m2 = e * g - f * f, d * f - c * g, c * f - d * e
        det = b * m0 + c * m1 + d * m2
        S[3, 0], S[3, 1], S[3, 2] = m0 / det, m1 / det, m2 / det
        S[4, 0], S[4, 1], S[4, 2] = S[3, 1], (b * g - d * d) / det, (c * d - b * f) / det
        S[5, 0], S[5, 1], S[5, 2] = S[3, 2], S[4, 2], (b * e - c * c) / det
        for i in range(3):
            for j in range(3):
                nis += res[i] * S[3 + i, j] * res[j]
    out[0], out[1] = nis, used


@njit(apart=True, cache=True, **UNCOUNTED)
def correct(P, nav, x, res, S, PH, K, turn, T):
    """Closed-loop correction after `innovation`: gain, Joseph covariance, feedback into the nominal state, attitude
    reset.

    Joseph's form for the gain as rounded, P - K PH - PH' K' + K S K' = P - K W' - W K' with W = PH' - K S / 2, which
    costs O(n^2 a) and leaves P symmetric to the bit (Bierman, 1977, sec. V.2).
    The tilts left over are expressed at the corrected heading: P <- G P G', G = I + [d x]/2 + [d x]^2/6 (left Jacobian;
    Markley, 2003), d the correction of the heading alone. That of the tilts is not among it where a velocity in the
    vehicle's axes tells them by gravity, whatever the heading is: by G a correction of tilt would become one of the
    heading, whose sum over thousands of readings is information out of noise. Else see `consistency.turn_tilts`. K: (n,
    a) receives the gain, turn: (1,) the heading's correction. T: (2a, n) work.
    """
    n, a = K.shape
    # u: columns of K; w: half of what they are multiplied with, P H' and what rounding left of the gain
    u, w = T[:a], T[a:]
    for r in range(a):  # S and its inverse are symmetric to the bit
        weighted(S[a + r], PH, u[r])
    for r in range(a):
        own = u[r]
        for i in range(n):
            K[i, r] = own[i]
        less_half(PH[r], S[r], u, w[r])
    rank2_update(P, u, w)
    change = w[0]
    weighted(res, u, change)
    turn[0] = feed_back(nav, x, change)
    consistency.reset_heading(P, 0.5 * turn[0])


@njit(cache=True, **UNCOUNTED)
def feed_back(nav, x, change):
    """Take an estimated error (n,) into the nominal state and the error states; returns what the heading turns by."""
    nav[0] += change[0] / nav[15]
    nav[1] += change[1] / (nav[16] * math.cos(nav[0]))
    nav[2] -= change[2]
    for i in range(3, 6):
        nav[i] += change[i]
    x0, y0, z0, others = change[6], change[7], change[8], change[9:]
    for i in range(others.size):
        x[i] += others[i]
    t2 = x0 * x0 + y0 * y0 + z0 * z0
    # C <- exp([d x]) C, column by column (Rodrigues); the series holds to 1e-16 below t2 = 1e-8
    t = math.sqrt(t2)
    p, q = (math.sin(t) / t, (1.0 - math.cos(t)) / t2) if t2 > 1e-8 else (1.0 - t2 / 6.0, 0.5 - t2 / 24.0)
    for j in range(3):
        u, v, w = nav[6 + j], nav[9 + j], nav[12 + j]
        f, g, h = y0 * w - z0 * v, z0 * u - x0 * w, x0 * v - y0 * u
        nav[6 + j] = u + p * f + q * (y0 * h - z0 * g)
        nav[9 + j] = v + p * g + q * (z0 * f - x0 * h)
        nav[12 + j] = w + p * h + q * (x0 * g - y0 * f)
    return z0


@njit(cache=True, **UNCOUNTED)
def memory_offsets(dims):
    """Where things stand in a channel's memory ``mem``: starts of H, K, inverse S, res, turn, then of S, PH, near,
    verdict, work, and the end. Before near the slopes by a scale that has jumped, an axis each, see `fault_states`.

    dims: axes a, states n, head m, ticked block b, its start, states of its error models, parameters; what follows is
    not looked at. Everything before S has the layout of a tape record (see `smooth_record`), which starts with the
    head's transition (m x m) and the tick's (b x b).
    """
    a, n, m, b = dims[0], dims[1], dims[2], dims[3]
    H = m * m + b * b
    K = H + a * n
    inverse = K + n * a
    res = inverse + a * a
    turn = res + a
    S = turn + 6
    PH = S + 2 * a * a
    near = PH + a * n + a
    verdict = near + a * (9 + dims[6])
    work = verdict + 7 + 2 * a  # behind the verdict stands what is noted of readings: see `stretch.LAST_S`
    return H, K, inverse, res, turn, S, PH, near, verdict, work, work + max(m, b, 2 * a) * n + 4 * b * b


@njit(apart=True, cache=True, **UNCOUNTED)
def predict(P, nav, x, acc, model, mem, dims, count):
    """Before a reading: fold the transition, and tick the sensor's block `count` times, whose transition goes into
    `mem`. model: (2, b, b), Phi and Q. Where several sensors read at once, there is nothing to fold for the later ones.
    """
    n, m, b, start = dims[1], dims[2], dims[3], dims[4]
    work = memory_offsets(dims)[9]
    if is_identity(acc[: 2 * m]):
        _orthonormal(nav, mem[work : work + 9])
    else:
        fold(P, acc, nav, shaped(mem[work : work + m * n], m, n))
    if b == 0:
        return
    A = shaped(mem[m * m : m * m + b * b], b, b)
    if count > 1:
        end = memory_offsets(dims)[10]
        W = mem[end - 4 * b * b : end].reshape((4, b, b))
        power(model[0], model[1], count, W)
        model = W
    for i in range(b):
        for j in range(b):
            A[i, j] = model[0, i, j] if count > 0 else 1.0 if i == j else 0.0
    if count > 0:
        advance_block(P, x, start, A, model[1], shaped(mem[work : work + b * n], b, n))


@njit(apart=True, cache=True, **UNCOUNTED)
def update(P, nav, x, C, R, mem, dims, limits):
    """A reading, after its sensor filled `near` and `res` in `mem`: take the coloured error off, form the NIS, correct
    if it passes.

    H of the drive's states is what the caller has left there (0 but for readings of the past). C: (a, errors) output
    rows of the error models, R: (a, a) white covariance, limits: (a + 1,) gates by the number of components used; the
    first says more than which share of the components has to remain when single ones that contradict the others are
    left out, infinite: none ever is. dims: those of `memory_offsets`, then where a deviation begins, see
    `consistency.turn_deviation`; 0: none (below it: what the caller turns, see `consistency.turn_current`). Leaves the
    verdict: NIS, components used, 1 if the state was corrected, then residuals (NaN where missing) and their variances
    (NaN also where left out).
    """
    a, n, start, errors, par = dims[0], dims[1], dims[4], dims[5], dims[6]
    iH, iK, ii, ir, it, iS, iP, ine, iv, iw, _ = memory_offsets(dims)
    H, near, res = shaped(mem[iH : iH + a * n], a, n), shaped(mem[ine:iv], a, 9 + par), mem[ir : ir + a]
    for i in range(a):
        for j in range(errors):
            res[i] -= C[i, j] * x[start - 9 + j]
    _whole_jacobian(H, near, C, start, dims[2])
    S, PH, out = shaped(mem[iS:iP], 2 * a, a), shaped(mem[iP : iP + a * n], a, n), mem[iv : iv + 3 + 2 * a]
    missing = 0
    for i in range(a):
        missing += math.isnan(res[i])
        out[3 + i] = res[i]
    innovation(P, H, res, R, S, PH, out)
    out[2] = 0.0
    for i in range(a):
        out[3 + a + i] = math.nan if math.isnan(out[3 + i]) else S[i, i]
    if missing == a:
        return
    fits = out[0] <= limits[int(out[1])]
    if not fits and math.isfinite(limits[0]):
        fits = _fits_without_some(P, H, near, C, R, S, PH, res, out, limits, start, dims[2])
    if not fits:
        return
    out[2] = 1.0
    T = shaped(mem[iw : iw + 2 * a * n], 2 * a, n)
    correct(P, nav, x, res, S, PH, shaped(mem[iK:ii], n, a), mem[it : it + 1], T)
    if dims[7] > 0:
        consistency.turn_deviation(P, mem[iK:ii], res[0], dims[7])
    for i in range(a):
        for j in range(a):
            mem[ii + i * a + j] = S[a + i, j]


@njit(apart=True, cache=True, **UNCOUNTED)
def _whole_jacobian(H, near, C, start, head):
    """H (a, n) from the sensor's own near (a, 9 + parameters) and the output rows C of its error models; that of the
    drive's states (9 to `head`) stays.
    """
    a, errors = C.shape
    for i in range(a):
        for j in range(head, H.shape[1]):
            H[i, j] = 0.0
        for j in range(9):
            H[i, j] = near[i, j]
        for j in range(errors):
            H[i, start + j] = C[i, j]
        for j in range(9, near.shape[1]):
            H[i, start + errors + j - 9] = near[i, j]


@njit(apart=True, cache=True, **COUNTED)
def _fits_without_some(P, H, near, C, R, S, PH, res, out, limits, start, head):
    """Whether the reading passes its gate when the components that contradict the others most are left out, one by one.

    Without component i the NIS is smaller by (S^-1 res)_i^2 / (S^-1)_ii. Leaves the innovation of what remains, or of
    the whole reading where that does not fit.
    """
    a = len(res)
    left = np.zeros(a)
    remaining = int(out[1])
    least = limits[0] * remaining
    while remaining - 1 > least:
        worst, most = -1, -1.0
        for i in range(a):
            if not math.isnan(out[3 + i]) and left[i] == 0.0:
                s = 0.0
                for j in range(a):
                    s += S[a + i, j] * res[j]
                if s * s / S[a + i, i] > most:
                    worst, most = i, s * s / S[a + i, i]
        if worst < 0:
            break  # nothing can be compared: the NIS is no number
        left[worst] = 1.0
        remaining -= 1
        _whole_jacobian(H, near, C, start, head)
        for i in range(a):
            res[i] = out[3 + i] if left[i] == 0.0 else math.nan
        innovation(P, H, res, R, S, PH, out)
        if out[0] <= limits[remaining]:
            for i in range(a):
                if left[i] != 0.0:
                    out[3 + a + i] = math.nan
            return True
    _whole_jacobian(H, near, C, start, head)
    for i in range(a):
        res[i] = out[3 + i]
    innovation(P, H, res, R, S, PH, out)
    return False


@njit(apart=True, cache=True, **UNCOUNTED)
def smooth_record(L, lam, record, a, m, b, start, deviation, T):
    """Carry the adjoint (lam, L) backward over one tape record: reset, correction, tick, compound transition.

    Modified Bryson-Frazier form of the fixed-interval (Rauch-Tung-Striebel) solution (Bierman, 1973): only S is
    inverted, so singular predicted covariances do no harm. With D = G (I - K H): lam <- D' lam - H' S^-1 res, L <- D' L
    D + H' S^-1 H, then through the transitions lam <- Phi' lam, L <- Phi' L Phi. After it the smoothed error at the
    record before is -P lam with covariance P - P L P.

    record: Phi (m x m; m = 0 where nothing moved), tick Phi (b x b), then if a > 0: H (a x n), K (n x a), inverse S (a
    x a), res (a), the turn of the heading, the change of velocity that turns with it (3) and that of the tilts (2, see
    `consistency.turn_tilts`), each row by row. `start` is the ticked block's place, b its size (0: none); deviation:
    see `consistency.turn_deviation`, or less the place of a current, see `consistency.turn_current`; 0: none. L (n, n)
    and lam (n,) change; T work, n columns and three times as many rows, at least 3a.
    """
    n = len(lam)
    at = m * m + b * b
    if a > 0:
        H = shaped(record[at : at + a * n], a, n)
        K = shaped(record[at + a * n : at + 2 * a * n], n, a)
        at += 2 * a * n
        Sinv = shaped(record[at : at + a * a], a, a)
        res = record[at + a * a : at + a * a + a]
        half = 0.5 * record[at + a * a + a]
        p, q = 0.5 * record[at + a * a + a + 4], 0.5 * record[at + a * a + a + 5]
        if p != 0.0 or q != 0.0:
            consistency.reset_tilts(L, -p, -q)
            u, v, w = lam[6], lam[7], lam[8]
            lam[6], lam[7], lam[8] = u - q * w, v + p * w, w + q * u - p * v
        if deviation > 0:
            consistency.turn_back(L, lam, consistency.deviation_change(K[:, 0], res[0], deviation), deviation)
        x, y, z = record[at + a * a + a + 1], record[at + a * a + a + 2], record[at + a * a + a + 3]
        if x != 0.0 or y != 0.0 or z != 0.0:  # the other way round than `consistency.turn_velocity`
            consistency.add_turned(L, int(6), int(3), -x, -y, -z)
            u, v, w = lam[3], lam[4], lam[5]
            lam[6] += y * w - z * v
            lam[7] += z * u - x * w
            lam[8] += x * v - y * u
            if deviation < 0:
                consistency.turn_back(L, lam, consistency.current_change(K, res, -deviation), -deviation)
        if half != 0.0:
            consistency.reset_heading(L, -half)
            c, u, v = 1.0 - 2.0 * half * half / 3.0, lam[6], lam[7]
            lam[6] = c * u + half * v
            lam[7] = c * v - half * u
        # L <- (I - K H)' L (I - K H) + H' S^-1 H = L - W H - (W H)', W = V - H' (K' V + S^-1) / 2, V = L K
        for c in range(a):
            f, own = 0.0, T[2 * a + c]
            for j in range(n):
                own[j] = K[j, c]
                f += own[j] * lam[j]
            weighted(own, L, T[c])
            for r in range(a):
                f += Sinv[c, r] * res[r]
            T[a + c, a] = f
        for c in range(a):
            own = T[2 * a + c]
            for r in range(a):
                s = Sinv[c, r]
                for i in range(n):
                    s += own[i] * T[r, i]
                T[a + c, r] = s
        for c in range(a):
            f = T[a + c, a]
            for i in range(n):
                lam[i] -= H[c, i] * f
        W = T[2 * a : 3 * a]
        for c in range(a):
            less_half(T[c], T[a + c][:a], H, W[c])
        rank2_update(L, H, W)
    if b > 0:
        _transition_transposed(L, lam, shaped(record[m * m : m * m + b * b], b, b), start, b, T)
    if m > 0:
        _head_transposed(L, lam, shaped(record[: m * m], m, m), flat(T))
        return
    symmetric.symmetrise(L, int(6), int(9))


@njit(apart=True, cache=True, **UNCOUNTED)
def _transition_transposed(L, lam, Phi, start, b, T):
    """L <- Phi' L Phi and lam <- Phi' lam for a transition that touches b states from `start`."""
    n = len(lam)
    for i in range(b):
        for j in range(n):
            T[i, j] = 0.0
    for r in range(b):
        for i in range(b):
            f = Phi[r, i]
            if f != 0.0:
                for j in range(n):
                    T[i, j] += f * L[start + r, j]
    for i in range(b):
        for j in range(n):
            if j < start or j >= start + b:
                L[start + i, j] = T[i, j]
        for j in range(b):
            L[start + i, start + j] = 0.0
    for r in range(b):
        first, last = b, 0
        for j in range(b):
            if Phi[r, j] != 0.0:
                first, last = min(first, j), j + 1
        for i in range(b):
            f = T[i, start + r]
            for j in range(first, last):
                L[start + i, start + j] += f * Phi[r, j]
    for i in range(n):
        if i < start or i >= start + b:
            for j in range(b):
                L[i, start + j] = T[j, i]
    for i in range(b):
        for j in range(i):
            s = 0.5 * (L[start + i, start + j] + L[start + j, start + i])
            L[start + i, start + j] = s
            L[start + j, start + i] = s
    for i in range(b):
        s = 0.0
        for r in range(b):
            s += Phi[r, i] * lam[start + r]
        T[0, i] = s
    for i in range(b):
        lam[start + i] = T[0, i]


@njit(apart=True, cache=True, **UNCOUNTED)
def _head_transposed(L, lam, Phi, work):
    """L <- Phi' L Phi and lam <- Phi' lam for a transition of the leading m states; work: (2 m^2 + m n,).

    As in `fold`: of the rows of Phi behind navigation only what is not zero.
    """
    m, n = Phi.shape[0], len(lam)
    A, B, T = shaped(work[: m * m], m, m), shaped(work[m * m : 2 * m * m], m, m), work[2 * m * m :]
    T = shaped(T[: m * n], m, n)
    C = shaped(work[m * m :][: 9 * m], m, 9)
    for i in range(m):
        for j in range(9):
            C[i, j] = Phi[j, i]
    _product(C, L[:9], T)
    for r in range(9, m):
        for i in range(m):
            f = Phi[r, i]
            if f != 0.0:
                for j in range(n):
                    T[i, j] += f * L[r, j]
    for i in range(m):
        for j in range(9):
            C[i, j] = T[i, j]
    _product(C, Phi[:9], A)
    for r in range(9, m):
        for j in range(m):
            f = Phi[r, j]
            if f != 0.0:
                for i in range(m):
                    A[i, j] += f * T[i, r]
    for i in range(m):
        B[0, i] = 0.0
    for r in range(m):
        f = lam[r]
        for i in range(m):
            B[0, i] += f * Phi[r, i]
    for i in range(m):
        lam[i] = B[0, i]
    for i in range(m):
        for j in range(i + 1):
            s = 0.5 * (A[i, j] + A[j, i])
            L[i, j] = s
            L[j, i] = s
    symmetric.mirror_columns(T, L, m, m)


@njit(apart=True, cache=True, **UNCOUNTED)
def smooth_row(P, L, lam, mean, cov, T):
    """Smoothed error at an epoch: mean = -P lam, cov = P - P L P (symmetric). T: (n, n) work."""
    n = len(lam)
    _product(P, L, T)
    _product(T, P, cov)
    for i in range(n):
        s = 0.0
        for j in range(n):
            s -= P[i, j] * lam[j]
        mean[i] = s
        for j in range(i + 1):
            s = P[i, j] - 0.5 * (cov[i, j] + cov[j, i])
            cov[i, j] = s
            cov[j, i] = s


@njit(apart=True, cache=True, **UNCOUNTED)
def drive_step(L, lam, nav, first, out):
    """The step that a drive would have had to say too much at an epoch for all later readings to fit best, one body
    axis at a time, and its standard deviation: out (2, k).

    A step d along e changes what is left by -d e' L e: d = e' lam / (e' L e), var d = 1 / (e' L e). Their quotient is
    the auxiliary residual of the drive's noise along e (de Jong and Penzer, 1998), normal with unit variance for an
    honest filter. The first three axes are those of the states from `first` (0: position, 3: velocity), the next three
    those of the attitude. NaN where no reading tells it.
    """
    for k in range(out.shape[1]):
        at, axis = first if k < 3 else int(6), k % 3
        f, s = 0.0, 0.0
        for i in range(3):
            e = nav[6 + 3 * i + axis]
            f += e * lam[at + i]
            for j in range(3):
                s += e * L[at + i, at + j] * nav[6 + 3 * j + axis]
        told = s > 0.0
        out[0, k] = f / s if told else math.nan
        out[1, k] = 1.0 / math.sqrt(s) if told else math.nan


@njit(cache=True, **UNCOUNTED)
def smooth_run(L, lam, records, begins, heads, rows, firsts, holds, index, until, means, covs, carried, steps, T, U):
    """Carry the adjoint backward over a run of records, and give the smoothed error at every row of them, the latest
    first: `smooth_record` and `smooth_row` in one call.

    records: flat; begins (r,): where each begins; heads (r, 5): axes, size of the head, size and start of the ticked
    block, place of a deviation. rows: flat, each 17 + (n - 9) values and the lower triangle of P; firsts (q,): where
    each begins; holds (q,): after how many of the records it holds. index: after how many of them the adjoint is;
    until: where to leave it. means (q, n), covs (q, n, n): what is found. carried: the first of the states that a
    drive carries, steps (q, 2, k): see `drive_step`. T, U: work, n columns, T as many rows as `smooth_record` asks for,
    U 2n.
    """
    n = len(lam)
    for q in range(len(firsts) - 1, -2, -1):
        least = holds[q] if q >= 0 else until
        while index > least:
            index -= 1
            a, m, b, start, deviation = heads[index]
            smooth_record(L, lam, records[begins[index] :], a, m, b, start, deviation, T)
        if q >= 0:
            first, P = firsts[q] + 8 + n, U[n:]
            for i in range(n):
                for j in range(i + 1):
                    P[i, j] = rows[first + j]
                    P[j, i] = rows[first + j]
                first += i + 1
            smooth_row(P, L, lam, means[q], covs[q], U[:n])
            drive_step(L, lam, rows[firsts[q] :], carried, steps[q])
