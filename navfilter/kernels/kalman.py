"""Kalman kernels: fold the drive's compound transition, tick a sensor's block, correct, and smooth backward.

Symbols: P covariance, Phi transition, Q process noise, H measurement Jacobian, R measurement noise, S innovation
covariance, K gain. Errors e here are *true minus estimated*, so a correction is +K (measured - predicted).
"""

import math

import numpy as np

from navfilter.kernels.compiling.decorators import apart, flat, njit, shaped
from navfilter.kernels.compiling.registers import all_of, eight, not_zero, put, times
from navfilter.kernels.compiling.vectors import WIDE, less_half, mirror, product, rank2_update, weighted

#: Of kernels that allocate nothing: numba is not to count references to arrays, see `navfilter.kernels`.
UNCOUNTED: dict = {"_nrt": False}
COUNTED: dict = {"_nrt": True}


@apart
@njit(cache=True, **UNCOUNTED)
def _multiply(A, B, out):
    """`product`, compiled once."""
    product(A, B, out)


@apart
@njit(cache=True, **UNCOUNTED)
def _navigation(P, acc, T, A, head):
    """Phi P Phi' of the nine of navigation into head (9, 9), before it is made symmetric. T (9, m or more) holds
    columns of Phi P then; A (m, 9): work.
    """
    m = acc.shape[1]
    _multiply(acc[:9], P[:m], T)
    for i in range(9):
        for j in range(m):
            A[j, i] = T[i, j]
    _multiply(acc[:9], A, head)
    _bend(P, head)


@njit(cache=True, **UNCOUNTED)
def _bend(P, head):
    """Second-order term of the position by the heading, for as much as the way has grown: on another heading it is an
    arc. It lies across the first-order one, along the way; half the way times the square of the heading's error, whose
    mean square is 3/4 of the first-order covariance squared (Jazwinski, 1970, sec. 9.3: second-order filter).
    """
    before = P[0, 8] * P[0, 8] + P[1, 8] * P[1, 8]
    north, east = head[0, 8], head[1, 8]
    after = north * north + east * east
    if after > before:
        share = 0.75 * (after - before) / after
        head[0, 0] += share * east * east
        head[1, 1] += share * north * north
        head[0, 1] -= share * north * east
        head[1, 0] -= share * north * east


@njit(cache=True, **UNCOUNTED)
def turns_along(P, north, east):
    """Whether this velocity is known in the vehicle's axes, so that by more than half it turns with the heading's
    error. Fixes tell it from north on: then it does not.
    """
    return P[4, 8] * north - P[3, 8] * east >= 0.5 * P[8, 8] * (north * north + east * east)


@apart
@njit(cache=True, **UNCOUNTED)
def discount_heading(P, acc, nav, own, work):
    """Before a fold of an inertial drive: what an error of the heading does to velocity and position counts as far as
    the change of velocity is known by which it does so.

    A heading error turns that change. But an error of tilt or of an accelerometer looks like one too, and as much of
    its square as that has variance would be information about the heading out of nothing: errors in variables (Fuller,
    1987, sec. 1.1). The part of the square beyond its variance is unbiased, and shrinks the slope. work: 2m.

    Not where the velocity turns with the heading before the fold, own: see `turns_along`. What was felt wrongly is in
    that velocity, too, and turned by the same heading error. Nor beside a log (own 2): as much as is taken here from
    what turns with the heading would be news to it, for it reads how the velocity changes in the vehicle's axes.
    """
    m, north, east = acc.shape[1], acc[3, 8], acc[4, 8]
    if own > 1.0 or (own != 0.0 and turns_along(P, nav[3] - east, nav[4] + north)):
        return
    variance, own, carried = acc[m + 3, 3] + acc[m + 4, 4], work[:m], work[m : 2 * m]
    for axis in (3, 4):
        for i in range(m):
            own[i] = acc[axis, i]
        own[axis] -= 1.0
        own[8] = 0.0
        weighted(own, P, carried)
        for i in range(m):
            variance += carried[i] * own[i]
    square = north * north + east * east
    share = 1.0 - variance / square if square > variance else 0.0
    for i in (0, 1, 3, 4):
        acc[i, 8] *= share


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


@apart
@njit(cache=True, **UNCOUNTED)
def present(P, acc, nav, inertial, own, work, out):
    """What `fold` would leave in P, without folding: of navigation (the first 81 of out), then the variances of all
    other states (n - 9). inertial, own: whether the heading is discounted before. work: 9 (2m + 9).
    """
    m, n = acc.shape[1], P.shape[0]
    kept0, kept1, kept3, kept4 = acc[0, 8], acc[1, 8], acc[3, 8], acc[4, 8]
    if inertial:
        discount_heading(P, acc, nav, own, work)
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
    acc[0, 8], acc[1, 8], acc[3, 8], acc[4, 8] = kept0, kept1, kept3, kept4


@njit(cache=True, **UNCOUNTED)
def note(acc, mem):
    """The compound transition into a channel's memory, before it is folded: for the smoother, and for learning."""
    m = acc.shape[1]
    _copy(flat(acc), mem[: m * m])


@njit(cache=True, **UNCOUNTED)
def _copy(of, to):
    """The first of some numbers to others, eight at least. A loop over numbers goes one by one."""
    last = to.size - WIDE
    for i in range(0, last, WIDE):
        put(to, i, eight(of, i))
    put(to, last, eight(of, last))


@apart
@njit(cache=True, **UNCOUNTED)
def _across(T, M, rows, begin):
    """The columns from `begin` on of so many leading rows of T, eight at least, into M, and across its diagonal."""
    n = M.shape[0]
    if n - begin < WIDE:
        for i in range(rows):
            for j in range(begin, n):
                M[i, j] = T[i, j]
                M[j, i] = T[i, j]
        return
    for i in range(rows):
        _copy(T[i][begin:], M[i][begin:])
    for j in range(begin, n, WIDE):
        for i in range(0, rows, WIDE):
            mirror(M, min(i, rows - WIDE), min(j, n - WIDE))


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
def _moving(acc):
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


@apart
@njit(cache=True, **UNCOUNTED)
def fold(P, acc, nav, T):
    """P <- Phi P Phi' + Q for the leading m states.

    acc (4m rows) holds Phi and Q, m rows each, then work areas; it is reset to identity and zero. Navigation (nine
    rows) depends on all of them, a drive's state on few: only where a row is not zero is it multiplied. What a constant
    has in P with all that does not move either stays.

    C_nb in nav is made orthonormal again to first order (its rounding grows with the number of products). T: (m, n)
    work.
    """
    m, n, moving = acc.shape[1], P.shape[0], _moving(acc)
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
    _across(T, P, int(9), moving)
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
def unmoved(A):
    """Whether a transition is the identity, and its noise zero if it stands below: A (m or 2m, m)."""
    m = A.shape[1]
    if A[0, 3] != 0.0:
        return False  # velocity moves the position: nearly every other one ends here
    diagonal = 0
    for i in range(m):
        diagonal += A[i, i] == 1.0
    return diagonal == m == _nonzero(flat(A))


@apart
@njit(cache=True, **COUNTED)
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


@apart
@njit(cache=True, **UNCOUNTED)
def tick(P, x, start, A, B, T):
    """Advance the block at `start` of the state (its own clock): x <- A x, P <- A P A' + B on its rows and columns. T:
    (b, n) work.
    """
    b, n = A.shape[0], P.shape[0]
    for i in range(b):
        weighted(A[i], P[start:], T[i])
    for i in range(b):
        _copy(T[i], P[start + i])
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


@apart
@njit(cache=True, **UNCOUNTED)
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


@apart
@njit(cache=True, **UNCOUNTED)
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


@apart
@njit(cache=True, **UNCOUNTED)
def correct(P, nav, x, res, S, PH, K, turn, T):
    """Closed-loop correction after `innovation`: gain, Joseph covariance, feedback into the nominal state, attitude
    reset.

    Joseph's form for the gain as rounded, P - K PH - PH' K' + K S K' = P - K W' - W K' with W = PH' - K S / 2, which
    costs O(n^2 a) and leaves P symmetric to the bit (Bierman, 1977, sec. V.2).
    The tilts left over are expressed at the corrected heading: P <- G P G', G = I + [d x]/2 + [d x]^2/6 (left Jacobian;
    Markley, 2003), d the correction of the heading alone. That of the tilts is not among it where a velocity in the
    vehicle's axes tells them by gravity, whatever the heading is: by G a correction of tilt would become one of the
    heading, whose sum over thousands of readings is information out of noise. Else see `turn_tilts`. K: (n, a) receives
    the gain, turn: (1,) the heading's correction. T: (2a, n) work.
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
    turn[0] = z0
    _reset(P, 0.5 * z0)


@njit(cache=True, **UNCOUNTED)
def _same(M, first):
    """Three rows and columns symmetric to the last bit."""
    for i in range(first, first + 3):
        for j in range(first, i):
            s = 0.5 * (M[i, j] + M[j, i])
            M[i, j] = s
            M[j, i] = s


@apart
@njit(cache=True, **UNCOUNTED)
def _follow(M, first, last):
    """Columns of a symmetric M become what its rows first to last, nine at most, are now; but not in those rows."""
    n, high = M.shape[0], max(last, WIDE)
    for j in range(high, n if n - high >= WIDE else high, WIDE):
        mirror(M, high - WIDE, min(j, n - WIDE))
    for i in range(first, last):
        for j in range(first):
            M[j, i] = M[i, j]
        for j in range(last, high if n - high >= WIDE else n):
            M[j, i] = M[i, j]


@njit(cache=True, inline="always")
def _both_tilts(whole, at, j, c, half):
    """The rows of the two tilts, which begin at `at`, turned: eight numbers from j on of each."""
    u, v = eight(whole, at[0] + j), eight(whole, at[1] + j)
    return times(c, u) - times(half, v), times(c, v) + times(half, u)


@njit(cache=True, **UNCOUNTED)
def _reset(M, half):
    """M <- G M G' for the rotation of the tilts by half of what the heading turns, to second order. M: symmetric."""
    n, whole, c = M.shape[0], flat(M), 1.0 - 2.0 * half * half / 3.0
    at, many, by = (6 * n, 7 * n), all_of(c), all_of(half)
    last = n - WIDE
    u, v = _both_tilts(whole, at, last, many, by)  # overlaps those before
    for j in range(0, last, WIDE):
        p, q = _both_tilts(whole, at, j, many, by)
        put(whole, at[0] + j, p)
        put(whole, at[1] + j, q)
    put(whole, at[0] + last, u)
    put(whole, at[1] + last, v)
    _follow(M, int(6), int(8))
    for i in range(6, 8):
        a, b = M[i, 6], M[i, 7]
        M[i, 6] = c * a - half * b
        M[i, 7] = c * b + half * a
    _same(M, int(6))


@njit(cache=True, **UNCOUNTED)
def places(dims):
    """Where things stand in a channel's memory ``mem``: starts of H, K, inverse S, res, turn, then of S, PH, near,
    verdict, work, and the end.

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
    near = PH + a * n
    verdict = near + a * (9 + dims[6])
    work = verdict + 8 + 2 * a  # behind the verdict stands what is noted of readings: see `stretch.LAST_S`
    return H, K, inverse, res, turn, S, PH, near, verdict, work, work + max(m, b, 2 * a) * n + 4 * b * b


@apart
@njit(cache=True, **UNCOUNTED)
def predict(P, nav, x, acc, model, mem, dims, count):
    """Before a reading: fold the transition, and tick the sensor's block `count` times, whose transition goes into
    `mem`. model: (2, b, b), Phi and Q. Where several sensors read at once, there is nothing to fold for the later ones.
    """
    n, m, b, start = dims[1], dims[2], dims[3], dims[4]
    work = places(dims)[9]
    if unmoved(acc[: 2 * m]):
        _orthonormal(nav, mem[work : work + 9])
    else:
        fold(P, acc, nav, shaped(mem[work : work + m * n], m, n))
    if b == 0:
        return
    A = shaped(mem[m * m : m * m + b * b], b, b)
    if count == 1:
        for i in range(b):
            for j in range(b):
                A[i, j] = model[0, i, j]
        tick(P, x, start, A, model[1], shaped(mem[work : work + b * n], b, n))
    elif count > 1:
        end = places(dims)[10]
        W = mem[end - 4 * b * b : end].reshape((4, b, b))
        power(model[0], model[1], count, W)
        for i in range(b):
            for j in range(b):
                A[i, j] = W[0, i, j]
        tick(P, x, start, A, W[1], shaped(mem[work : work + b * n], b, n))
    else:
        for i in range(b):
            for j in range(b):
                A[i, j] = 1.0 if i == j else 0.0


@apart
@njit(cache=True, **UNCOUNTED)
def update(P, nav, x, C, R, mem, dims, limits):
    """A reading, after its sensor filled `near` and `res` in `mem`: take the coloured error off, form the NIS, correct
    if it passes.

    H of the drive's states is what the caller has left there (0 but for readings of the past). C: (a, errors) output
    rows of the error models, R: (a, a) white covariance, limits: (a + 1,) gates by the number of components used; the
    first says more than which share of the components has to remain when single ones that contradict the others are
    left out, infinite: none ever is. dims: those of `places`, then where a deviation begins, see `turn_deviation`; 0:
    none (below it: what the caller turns, see `turn_current`). Leaves the verdict: NIS, components used, 1 if the state
    was corrected, then residuals (NaN where missing) and their variances (NaN also where left out).
    """
    a, n, start, errors, par = dims[0], dims[1], dims[4], dims[5], dims[6]
    iH, iK, ii, ir, it, iS, iP, ine, iv, iw, _ = places(dims)
    H, near, res = shaped(mem[iH : iH + a * n], a, n), shaped(mem[ine:iv], a, 9 + par), mem[ir : ir + a]
    for i in range(a):
        for j in range(errors):
            res[i] -= C[i, j] * x[start - 9 + j]
    _whole_jacobian(H, near, C, start, dims[2])
    S, PH, out = shaped(mem[iS:iP], 2 * a, a), shaped(mem[iP:ine], a, n), mem[iv : iv + 3 + 2 * a]
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
        turn_deviation(P, mem[iK:ii], res[0], dims[7])
    for i in range(a):
        for j in range(a):
            mem[ii + i * a + j] = S[a + i, j]


@njit(cache=True, inline="always")
def _with_turned(whole, n, first, of, j, x, y, z):
    """Eight numbers from column j on of three rows, with the cross products added: see `_add_turned`."""
    u, v, w = eight(whole, of * n + j), eight(whole, (of + 1) * n + j), eight(whole, (of + 2) * n + j)
    a, b, c = eight(whole, first * n + j), eight(whole, (first + 1) * n + j), eight(whole, (first + 2) * n + j)
    return (
        a + (times(v, z) - times(w, y)),
        b + (times(w, x) - times(u, z)),
        c + (times(u, y) - times(v, x)),
    )


@njit(cache=True, **UNCOUNTED)
def _add_turned(M, first, of, x, y, z):
    """Add to three rows and columns of M, which is symmetric, the cross products of three others with (x, y, z)."""
    n, whole, p, q, r = M.shape[0], flat(M), all_of(x), all_of(y), all_of(z)
    last = n - WIDE
    d, e, f = _with_turned(whole, n, first, of, last, p, q, r)  # overlaps those before
    for j in range(0, last, WIDE):
        a, b, c = _with_turned(whole, n, first, of, j, p, q, r)
        put(whole, first * n + j, a)
        put(whole, (first + 1) * n + j, b)
        put(whole, (first + 2) * n + j, c)
    put(whole, first * n + last, d)
    put(whole, (first + 1) * n + last, e)
    put(whole, (first + 2) * n + last, f)
    _follow(M, first, first + 3)
    for j in range(first, first + 3):
        u, v, w = M[j, of], M[j, of + 1], M[j, of + 2]
        M[j, first] += v * z - w * y
        M[j, first + 1] += w * x - u * z
        M[j, first + 2] += u * y - v * x
    _same(M, first)


@apart
@njit(cache=True, **UNCOUNTED)
def turn_velocity(P, nav, before, change):
    """After a velocity in the vehicle's axes has changed the estimate: what a rotation does to the velocity it also
    does to the change. before: the three of the velocity until then; change (3,) is written for the smoother.

    What is known is the velocity in the vehicle's axes. An error psi of the attitude turns it, by ``psi x v``, so the
    covariance with the attitude has to follow v. Else what a reading changes would be something that does not turn with
    the rest, and the next reading would tell the heading from the noise of this one; an invariant error state (Barrau
    and Bonnabel, 2017, IEEE Trans. Automatic Control 62) has that by its coordinates.
    """
    north, east, down = nav[3] - before[0], nav[4] - before[1], nav[5] - before[2]
    change[0], change[1], change[2] = north, east, down
    _add_turned(P, int(3), int(6), north, east, down)


@njit(cache=True, **UNCOUNTED)
def _reset_tilts(M, p, q):
    """M <- G M G' for the rotation of the attitude by half a change of the tilts, to first order. M: symmetric."""
    n = M.shape[0]
    for j in range(n):
        u, v, w = M[6, j], M[7, j], M[8, j]
        M[6, j], M[7, j], M[8, j] = u + q * w, v - p * w, w + p * v - q * u
    _follow(M, int(6), int(9))
    for i in range(6, 9):
        u, v, w = M[i, 6], M[i, 7], M[i, 8]
        M[i, 6], M[i, 7], M[i, 8] = u + q * w, v - p * w, w + p * v - q * u
    _same(M, int(6))


@apart
@njit(cache=True, **UNCOUNTED)
def turn_tilts(P, K, res, change):
    """After a reading where no velocity in the vehicle's axes has been used: the attitude's error left over is
    expressed at the corrected tilts, too, by the first order of the Jacobian of `correct`.

    Fixes tell tilts in north and east, by how the velocity changes. What is left of a tilt's error has a part about the
    axis that the heading turns about; without it the tilt was surer of the heading than it could be. K (n, a), res
    (a,): gain and residuals of the reading; change (2,) is written for the smoother.
    """
    north, east = 0.0, 0.0
    for r in range(len(res)):
        north += K[6, r] * res[r]
        east += K[7, r] * res[r]
    change[0], change[1] = north, east
    _reset_tilts(P, 0.5 * north, 0.5 * east)


@njit(cache=True, **UNCOUNTED)
def _deviated(K, res, first):
    """What turning by one does to the change of a deviation: to sine and cosine of the heading, and of twice it."""
    return K[first + 1] * res, -K[first] * res, 2.0 * K[first + 3] * res, -2.0 * K[first + 2] * res


@apart
@njit(cache=True, **UNCOUNTED)
def _turn(P, by, first):
    """Let states from `first` on follow an error of the heading: `by` is what turning by one does to the change of
    each. P is symmetric.
    """
    n, whole, end = P.shape[0], flat(P), first + len(by)
    own, last = 8 * n, n - WIDE
    for i in range(len(by)):
        row, f = (first + i) * n, all_of(by[i])
        overlapping = eight(whole, row + last) + times(f, eight(whole, own + last))
        for j in range(0, last, WIDE):
            put(whole, row + j, eight(whole, row + j) + times(f, eight(whole, own + j)))
        put(whole, row + last, overlapping)
    _follow(P, first, end)
    for j in range(first, end):
        f = P[j, 8]
        for i in range(len(by)):
            P[j, first + i] += by[i] * f
    for i in range(first, end):
        for j in range(first, i):
            s = 0.5 * (P[i, j] + P[j, i])
            P[i, j] = s
            P[j, i] = s


@apart
@njit(cache=True, **UNCOUNTED)
def turn_deviation(P, K, res, first):
    """After a compass has changed its own deviation: what an error of the heading does to the deviation it also does to
    the change. K (n,): its gain; first: where sine and cosine of the heading, and of twice it, begin.

    Readings tell no heading from a deviation: were the vehicle turned by psi, a bias less by psi and a deviation that
    is turned with it would have them read the same. So errors of the heading and of the deviation go together by what
    that is, and have to follow it. Else each reading would tell a little of the heading by how its slope has changed
    (Huang, Mourikis and Roumeliotis, 2010, International Journal of Robotics Research 29).
    """
    _turn(P, _deviated(K, res, first), first)


@njit(cache=True, **UNCOUNTED)
def _carried(K, res, first):
    """What turning by one does to the change of a current north and east: K (n, a), res (a,)."""
    north, east = 0.0, 0.0
    for r in range(len(res)):
        north += K[first, r] * res[r]
        east += K[first + 1, r] * res[r]
    return -east, north


@apart
@njit(cache=True, **UNCOUNTED)
def turn_current(P, K, res, first):
    """With `turn_velocity`: a current, north and east from `first` on, turns with the heading as the velocity does.

    A log knows the difference of the two in the vehicle's axes. What a reading makes of it is mostly a change of the
    one that is known less, the current; did that not follow the heading, the next reading would tell the heading from
    the noise of this one. K (n, a), res (a,): gain and residuals of the reading.
    """
    _turn(P, _carried(K, res, first), first)


@apart
@njit(cache=True, **UNCOUNTED)
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


@apart
@njit(cache=True, **COUNTED)
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


@apart
@njit(cache=True, **UNCOUNTED)
def smooth_record(L, lam, record, a, m, b, start, deviation, T):
    """Carry the adjoint (lam, L) backward over one tape record: reset, correction, tick, compound transition.

    Modified Bryson-Frazier form of the fixed-interval (Rauch-Tung-Striebel) solution (Bierman, 1973): only S is
    inverted, so singular predicted covariances do no harm. With D = G (I - K H): lam <- D' lam - H' S^-1 res, L <- D' L
    D + H' S^-1 H, then through the transitions lam <- Phi' lam, L <- Phi' L Phi. After it the smoothed error at the
    record before is -P lam with covariance P - P L P.

    record: Phi (m x m; m = 0 where nothing moved), tick Phi (b x b), then if a > 0: H (a x n), K (n x a), inverse S (a
    x a), res (a), the turn of the heading, the change of velocity that turns with it (3) and that of the tilts (2, see
    `turn_tilts`), each row by row. `start` is the ticked block's place, b its size (0: none); deviation: see
    `turn_deviation`, or less the place of a current, see `turn_current`; 0: none. L (n, n) and lam (n,) change; T work,
    n columns and three times as many rows, at least 3a.
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
            _reset_tilts(L, -p, -q)
            u, v, w = lam[6], lam[7], lam[8]
            lam[6], lam[7], lam[8] = u - q * w, v + p * w, w + q * u - p * v
        if deviation > 0:
            _turn_back(L, lam, _deviated(K[:, 0], res[0], deviation), deviation)
        x, y, z = record[at + a * a + a + 1], record[at + a * a + a + 2], record[at + a * a + a + 3]
        if x != 0.0 or y != 0.0 or z != 0.0:  # the other way round than `turn_velocity`
            _add_turned(L, int(6), int(3), -x, -y, -z)
            u, v, w = lam[3], lam[4], lam[5]
            lam[6] += y * w - z * v
            lam[7] += z * u - x * w
            lam[8] += x * v - y * u
            if deviation < 0:
                _turn_back(L, lam, _carried(K, res, -deviation), -deviation)
        if half != 0.0:
            _reset(L, -half)
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
    _same(L, int(6))


@apart
@njit(cache=True, **UNCOUNTED)
def _turn_back(L, lam, by, first):
    """`_turn` backward."""
    n = len(lam)
    for i in range(len(by)):
        lam[8] += by[i] * lam[first + i]
        for j in range(n):
            L[8, j] += by[i] * L[first + i, j]
    for i in range(len(by)):
        for j in range(n):
            L[j, 8] += by[i] * L[j, first + i]


@apart
@njit(cache=True, **UNCOUNTED)
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


@apart
@njit(cache=True, **UNCOUNTED)
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
    _multiply(C, L[:9], T)
    for r in range(9, m):
        for i in range(m):
            f = Phi[r, i]
            if f != 0.0:
                for j in range(n):
                    T[i, j] += f * L[r, j]
    for i in range(m):
        for j in range(9):
            C[i, j] = T[i, j]
    _multiply(C, Phi[:9], A)
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
    _across(T, L, m, m)


@apart
@njit(cache=True, **UNCOUNTED)
def smooth_row(P, L, lam, mean, cov, T):
    """Smoothed error at an epoch: mean = -P lam, cov = P - P L P (symmetric). T: (n, n) work."""
    n = len(lam)
    _multiply(P, L, T)
    _multiply(T, P, cov)
    for i in range(n):
        s = 0.0
        for j in range(n):
            s -= P[i, j] * lam[j]
        mean[i] = s
        for j in range(i + 1):
            s = P[i, j] - 0.5 * (cov[i, j] + cov[j, i])
            cov[i, j] = s
            cov[j, i] = s


@njit(cache=True, **UNCOUNTED)
def smooth_run(L, lam, records, begins, heads, rows, firsts, holds, index, until, means, covs, T, U):
    """Carry the adjoint backward over a run of records, and give the smoothed error at every row of them, the latest
    first: `smooth_record` and `smooth_row` in one call.

    records: flat; begins (r,): where each begins; heads (r, 5): axes, size of the head, size and start of the ticked
    block, place of a deviation. rows: flat, each 17 + (n - 9) values and the lower triangle of P; firsts (q,): where
    each begins; holds (q,): after how many of the records it holds. index: after how many of them the adjoint is;
    until: where to leave it. means (q, n), covs (q, n, n): what is found. T, U: work, n columns, T as many rows as
    `smooth_record` asks for, U 2n.
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
