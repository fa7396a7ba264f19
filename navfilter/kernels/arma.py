"""Online ARMA kernels: one recursive prediction-error step, and the passes over a window that polish it.

Everything an estimator owns lies in a few contiguous arrays, so that a step is one call with nothing to unpack.
With p, q the orders, m the number of regressors (1 for a constant), n = p + q + m and r = max(p, q):

``s``
    the state, a table of rows: header of scalars, theta, phi, psi, the filtered lags that psi does not hold, gain,
    trial, scratch, then P (n rows), then the filter memory of each regressor (m rows).
``buf``
    (1 + m, L) the latest samples in working units: row 0 the series (NaN = missing), the others the regressors.
``carry``
    (3 + m, width) filter memory before the first sample of ``buf``: phi, psi, more lags, one row per regressor.
``work``
    (5 + m, r + L) scratch of a pass: -y, e, filtered -y, filtered e, counted e, filtered regressors; the first r
    columns are the memory.

Signs are those of ``scipy.signal.lfilter([1, *c], [1, *a], e)``; theta = [a, c, b], phi = [-y lags, e lags, u].
``error_model="numpy"`` only drops the test for division by zero (worth 25 % of a step); it is not ``fastmath``.
"""

import math

import numpy as np
from numba import njit

# Rows of the state.
HEAD, THETA, PHI, PSI, MORE, GAIN, TRIAL, SCRATCH, COV = 0, 1, 2, 3, 4, 5, 6, 7, 8
# Slots of the header; counts are floats so that one array holds the whole state.
AR, MA, EXOG, ELS = 0, 1, 2, 3  # p, q, m, 1 = extended least squares
LAM, LAM_END, LAM_RATE = 4, 5, 6  # forgetting factor now, its limit, its rate of approach
RADIUS_A, RADIUS_C = 7, 8  # largest pole and zero radius that a step may reach
VAR, CAP = 9, 10  # innovation variance in working units; largest VAR * trace(P)
CLIP, SPREAD = 11, 12  # clip at CLIP * SPREAD (0 = never); SPREAD is the robust innovation sd
ORIGIN, UNIT = 13, 14  # working value = (x - ORIGIN) * UNIT
POS, DUE = 15, 16  # samples in buf, and the number at which window work is due
SETTLE = 17  # samples still without an update after a gap
RUNNING = 18  # 0 while the first samples are only collected
MISSED, CLIPPED, IDLE, HELD, REPEATED, SEEN = 19, 20, 21, 22, 23, 24  # counters
INNOVATION, LAST = 25, 26  # last a-priori residual (working units), last finite sample as it came
CENTRE = 27  # 1 = the first finite sample becomes ORIGIN
WIDTH = 32  # least number of columns: the header's

BEYOND = 1e75  # larger working values overflow when squared: taken as missing


@njit(cache=True, error_model="numpy")
def _inside(s, at, order, radius):
    """Schur-Cohn: are all roots of 1 + s[TRIAL, at] z^-1 + ... inside |z| < radius? NaN answers no."""
    inverse = 1.0 / radius
    power = 1.0
    for i in range(order):
        power *= inverse
        s[SCRATCH, i] = s[TRIAL, at + i] * power
    for top in range(order - 1, 0, -1):
        k = s[SCRATCH, top]
        if not abs(k) < 1.0:
            return False
        scale = 1.0 / (1.0 - k * k)
        for i in range((top + 1) // 2):
            j = top - 1 - i
            front = s[SCRATCH, i]
            back = s[SCRATCH, j]
            s[SCRATCH, i] = (front - k * back) * scale
            s[SCRATCH, j] = (back - k * front) * scale
    return order == 0 or abs(s[SCRATCH, 0]) < 1.0


@njit(cache=True, error_model="numpy")
def _remember(s, y, e, p, q):
    """Push y and e into the lags, and their versions filtered by 1/C into psi (unfiltered for least squares)."""
    fy = -y
    fe = e
    if s[HEAD, ELS] == 0.0:
        for k in range(q - 1, p - 1, -1):
            fy -= s[THETA, p + k] * s[MORE, k - p]
        for k in range(min(p, q) - 1, -1, -1):
            fy -= s[THETA, p + k] * s[PSI, k]
        for k in range(q - 1, -1, -1):
            fe -= s[THETA, p + k] * s[PSI, p + k]
    if q > p:
        for i in range(q - p - 1, 0, -1):
            s[MORE, i] = s[MORE, i - 1]
        s[MORE, 0] = s[PSI, p - 1] if p > 0 else fy
    for i in range(p + q - 1, 0, -1):
        s[PHI, i] = s[PHI, i - 1]
        s[PSI, i] = s[PSI, i - 1]
    if q > 0:
        s[PHI, p] = e
        s[PSI, p] = fe
    if p > 0:
        s[PHI, 0] = -y
        s[PSI, 0] = fy


@njit(cache=True, error_model="numpy")
def _adapt(s, y, e, p, q, n):
    """Gauss-Newton step of theta and P; returns the residual after the step."""
    weight = s[PSI, 0]
    for i in range(n):
        s[GAIN, i] = s[COV, i] * weight
    for j in range(1, n):
        weight = s[PSI, j]
        for i in range(n):
            s[GAIN, i] += s[COV + j, i] * weight
    spread = 0.0
    trace = 0.0
    for i in range(n):
        spread += s[PSI, i] * s[GAIN, i]
        trace += s[COV + i, i]
    lam = s[HEAD, LAM]
    # Without excitation there is nothing to learn, and forgetting would only let P grow.
    if not (spread > 1e-6 * (1.0 - lam) and spread < 1e12):
        s[HEAD, IDLE] += 1.0
        return e
    inverse = 1.0 / (lam + spread)
    step = e * inverse
    residual = e
    for _ in range(5):
        for i in range(n):
            s[TRIAL, i] = s[THETA, i] + step * s[GAIN, i]
        if _inside(s, 0, p, s[HEAD, RADIUS_A]) and _inside(s, p, q, s[HEAD, RADIUS_C]):
            residual = y
            for i in range(n):
                s[THETA, i] = s[TRIAL, i]
                residual -= s[PHI, i] * s[THETA, i]
            break
        s[HEAD, HELD] += 1.0
        step *= 0.5
    grow = 1.0 / lam if trace * s[HEAD, VAR] < s[HEAD, CAP] else 1.0
    # The product of the two gains first: it commutes, so P stays symmetric to the last bit. With the other order its
    # skew part grows like lam^-t and ruins the estimate after some ten windows.
    for j in range(n):
        weight = s[GAIN, j]
        for i in range(n):
            s[COV + j, i] = (s[COV + j, i] - (weight * s[GAIN, i]) * inverse) * grow
    return residual


@njit(cache=True, error_model="numpy")
def _predict(s, p, q, m, n):
    """Filter the regressors of this instant by 1/C, and return the one-step prediction."""
    for j in range(m):
        row = COV + n + j
        filtered = s[PHI, p + q + j]
        if s[HEAD, ELS] == 0.0:
            for k in range(q - 1, -1, -1):
                filtered -= s[THETA, p + k] * s[row, k]
        for k in range(q - 1, 0, -1):
            s[row, k] = s[row, k - 1]
        if q > 0:
            s[row, 0] = filtered
        s[PSI, p + q + j] = filtered
    predicted = 0.0
    for i in range(n):
        predicted += s[PHI, i] * s[THETA, i]
    return predicted


@njit(cache=True, error_model="numpy")
def _clip(s, e):
    """Innovation limited to CLIP robust standard deviations."""
    # The median of |e| is followed by steps of one per cent: robust, and a tripled noise is reached in 200 samples.
    if abs(e) > 0.6744897501960817 * s[HEAD, SPREAD]:
        s[HEAD, SPREAD] *= 1.01
    else:
        s[HEAD, SPREAD] *= 0.99
    limit = s[HEAD, CLIP] * s[HEAD, SPREAD]
    if abs(e) > limit:
        s[HEAD, CLIPPED] += 1.0
        return math.copysign(limit, e)
    return e


@njit(cache=True, error_model="numpy")
def _step(s, buf, x):
    p = int(s[HEAD, AR])
    q = int(s[HEAD, MA])
    m = int(s[HEAD, EXOG])
    n = p + q + m
    pos = int(s[HEAD, POS])
    s[HEAD, POS] = pos + 1
    s[HEAD, SEEN] += 1.0
    for j in range(m):
        buf[1 + j, pos] = s[PHI, p + q + j]
    if s[HEAD, CENTRE] == 1.0 and abs(x) < BEYOND:
        s[HEAD, CENTRE] = 0.0
        s[HEAD, ORIGIN] = x
    y = (x - s[HEAD, ORIGIN]) * s[HEAD, UNIT]
    seen = abs(y) < BEYOND
    if seen:
        if x == s[HEAD, LAST]:
            s[HEAD, REPEATED] += 1.0
        s[HEAD, LAST] = x
        buf[0, pos] = y
    else:
        s[HEAD, MISSED] += 1.0
        buf[0, pos] = np.nan
    if s[HEAD, RUNNING] == 0.0:
        return pos + 1 >= s[HEAD, DUE]

    predicted = _predict(s, p, q, m, n)
    if not seen:
        # The missing value is replaced by its expectation; what follows within the lags is not learnt from.
        s[HEAD, SETTLE] = max(p, q)
        _remember(s, predicted, 0.0, p, q)
        return pos + 1 >= s[HEAD, DUE]
    e = y - predicted
    if s[HEAD, CLIP] > 0.0:
        e = _clip(s, e)
        y = predicted + e
        buf[0, pos] = y
    s[HEAD, INNOVATION] = e
    posterior = e
    lam = s[HEAD, LAM]
    if s[HEAD, SETTLE] > 0.0:
        s[HEAD, SETTLE] -= 1.0
    else:
        if n > 0:
            posterior = _adapt(s, y, e, p, q, n)
        s[HEAD, VAR] += (1.0 - lam) * (e * posterior - s[HEAD, VAR])
        s[HEAD, LAM] = s[HEAD, LAM_END] + (lam - s[HEAD, LAM_END]) * s[HEAD, LAM_RATE]
    _remember(s, y, posterior, p, q)
    return pos + 1 >= s[HEAD, DUE]


@njit(cache=True, error_model="numpy")
def rml_step(s, buf, x):
    """One sample through one estimator; True when window work is due. O(n^2), no allocation.

    Recursive prediction error (Soderstrom 1973, Ljung 1977): e = y - phi'theta, K = P psi / (lam + psi'P psi),
    theta += K e, P = (P - K psi'P) / lam, psi = phi / C; the residual after the step enters phi.
    """
    return _step(s, buf, x)


@njit(cache=True, error_model="numpy")
def rml_run(s, buf, xs, us, start):
    """Samples xs[start:] with regressors us through one estimator until window work is due; returns where it stopped."""
    held = int(s[HEAD, AR]) + int(s[HEAD, MA]) + int(s[HEAD, EXOG]) - us.shape[1]
    for i in range(start, xs.size):
        for j in range(us.shape[1]):
            s[PHI, held + j] = us[i, j]
        if _step(s, buf, xs[i]):
            return i + 1
    return xs.size


@njit(cache=True, error_model="numpy")
def bank_run(states, bufs, xs, start):
    """The same for several estimators with one schedule: states (k, rows, width), bufs (k, rows, L)."""
    for i in range(start, xs.size):
        due = False
        for j in range(states.shape[0]):
            if _step(states[j], bufs[j], xs[i]):
                due = True
        if due:
            return i + 1
    return xs.size


@njit(cache=True, error_model="numpy")
def bank_step(states, bufs, x):
    """One sample through several estimators; True when window work is due."""
    due = False
    for j in range(states.shape[0]):
        if _step(states[j], bufs[j], x):
            due = True
    return due


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
def _save(carry, p, q, m, work, count):
    """Memory after `count` samples of `work` into `carry`."""
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
def window_pass(theta, p, buf, count, lo, carry, work, normal):
    """Filter `count` samples with theta; sums of squares and products over [lo, count) into `normal`.

    normal[:n, :n] = sum psi psi', normal[n, :n] = normal[:n, n] = sum psi e, normal[n, n] = sum e^2. Returns the number
    of residuals counted: missing samples and the max(p, q) after each of them are left out.
    """
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
        _lag_block(normal, 0, 0, work[2], work[2], p, p, first, first + size)
    if q > 0:
        _lag_block(normal, p, p, work[3], work[3], q, q, first, first + size)
    if p > 0 and q > 0:
        _lag_block(normal, 0, p, work[2], work[3], p, q, first, first + size)
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
def polish(s, theta, buf, lo, carry, work, normal, passes):
    """Levenberg-Gauss-Newton on the window from `theta` (refined in place), inside the two radii.

    A step is kept only if the sum of squares falls. Ends when the step left is 0.01 standard deviations, or after
    `passes` passes. On return `work` and `normal` belong to theta. Returns (residuals counted, 1 if converged else 0).
    """
    p = int(s[HEAD, AR])
    q = int(s[HEAD, MA])
    n = theta.size
    count = int(s[HEAD, POS])
    used = window_pass(theta, p, buf, count, lo, carry, work, normal)
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
                s[TRIAL, i] = trial[i]
            if _inside(s, 0, p, s[HEAD, RADIUS_A]) and _inside(s, p, q, s[HEAD, RADIUS_C]):
                break
            share *= 0.6
        else:
            break
        window_pass(trial, p, buf, count, lo, carry, work, other)
        if other[n, n] < normal[n, n]:
            stale = False
            theta[:] = trial
            fell = normal[n, n] - other[n, n]
            normal[:, :] = other
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
        window_pass(theta, p, buf, count, lo, carry, work, normal)
    return used, done


@njit(cache=True, error_model="numpy")
def adopt(s, theta, carry, work, normal, used):
    """Make the polished theta the running estimate: P = (sum psi psi')^-1, the innovation variance, the memory."""
    p = int(s[HEAD, AR])
    q = int(s[HEAD, MA])
    n = theta.size
    m = n - p - q
    end = np.zeros((3 + m, carry.shape[1]))
    _save(end, p, q, m, work, int(s[HEAD, POS]))
    for i in range(p + q):
        s[PHI, i] = end[0, i]
        s[PSI, i] = end[1, i]
    for i in range(q - p):
        s[MORE, i] = end[2, i]
    for j in range(m):
        for k in range(q):
            s[COV + n + j, k] = end[3 + j, k]
    for i in range(n):
        s[THETA, i] = theta[i]
    if used > 0:
        s[HEAD, VAR] = normal[n, n] / used
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
            s[COV + j, i] = column[i]
            s[COV + i, j] = column[i]
    return True


@njit(cache=True, error_model="numpy")
def slide(s, buf, carry, work, hop):
    """Drop the oldest `hop` samples; the filter memory at the new beginning comes from the last pass."""
    p = int(s[HEAD, AR])
    q = int(s[HEAD, MA])
    _save(carry, p, q, buf.shape[0] - 1, work, hop)
    keep = int(s[HEAD, POS]) - hop
    for i in range(buf.shape[0]):
        for t in range(keep):
            buf[i, t] = buf[i, t + hop]
    s[HEAD, POS] = keep


@njit(cache=True, error_model="numpy")
def long_ar(x, order, a):
    """AR(order) by Levinson-Durbin on the biased autocovariances of x; returns the residual variance."""
    n = x.size
    cov = np.empty(order + 1)
    for k in range(order + 1):
        cov[k] = _dot(x, k, x, 0, n - k) / n
    a[:] = 0.0
    variance = cov[0]
    previous = np.empty(order)
    for k in range(order):
        if not variance > 1e-14 * cov[0]:
            break
        total = cov[k + 1]
        for i in range(k):
            total += a[i] * cov[k - i]
        reflection = -total / variance
        previous[:] = a
        for i in range(k):
            a[i] = previous[i] + reflection * previous[k - 1 - i]
        a[k] = reflection
        variance *= 1.0 - reflection * reflection
    return variance


@njit(cache=True, error_model="numpy")
def rough_start(s, x, order, theta):
    """Hannan-Rissanen (1982), first two stages: residuals of a long AR, then least squares of x on lags of both.

    x has no mean and no gaps. theta[:p + q] is set, pulled inside radius 0.995 if need be. False: no solution.
    """
    p = int(s[HEAD, AR])
    q = int(s[HEAD, MA])
    k = p + q
    n = x.size
    a = np.zeros(order)
    long_ar(x, order, a)
    e = x.copy()
    for j in range(order):
        for t in range(j + 1, n):
            e[t] += a[j] * x[t - 1 - j]
    e[:order] = 0.0
    minus = -x
    lo = min(order + max(p, q), n)
    normal = np.zeros((k + 1, k + 1))
    if p > 0:
        _lag_block(normal, 0, 0, minus, minus, p, p, lo, n)
    if q > 0:
        _lag_block(normal, p, p, e, e, q, q, lo, n)
    if p > 0 and q > 0:
        _lag_block(normal, 0, p, minus, e, p, q, lo, n)
    for i in range(k):
        for j in range(i):
            normal[i, j] = normal[j, i]
    factor = np.empty((k, k))
    solution = np.empty(k)
    for i in range(p):
        solution[i] = _dot(minus, lo - 1 - i, x, lo, n - lo)
    for i in range(q):
        solution[p + i] = _dot(e, lo - 1 - i, x, lo, n - lo)
    if not _cholesky(normal, k, 1e-8, factor):
        return False
    _solve(factor, k, solution)
    for at, size in ((0, p), (p, q)):
        for _ in range(400):
            for i in range(k):
                s[TRIAL, i] = solution[i]
            if _inside(s, at, size, 0.995):
                break
            shrink = 1.0
            for i in range(size):
                shrink *= 0.98
                solution[at + i] *= shrink
    for i in range(k):
        theta[i] = solution[i]
    return True
