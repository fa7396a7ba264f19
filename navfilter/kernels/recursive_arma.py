"""Online ARMA kernels: one recursive prediction-error step.

Everything an estimator owns lies in a few contiguous arrays, so that a step is one call with nothing to unpack.
With p, q the orders, m the number of regressors (1 for a constant), n = p + q + m and r = max(p, q):

``s``
    the state, a table of rows: header of scalars, theta, phi, psi, the filtered lags that psi does not hold, gain,
    trial, scratch, then P (n rows), then the filter memory of each regressor (m rows).
``buf``
    (1 + m, L) the latest samples in working units: row 0 the series (NaN = missing), the others the regressors.

Signs are those of ``scipy.signal.lfilter([1, *c], [1, *a], e)``; theta = [a, c, b], phi = [-y lags, e lags, u].
``error_model="numpy"`` drops the test for division by zero and ``_nrt=False`` the reference counts of the arrays (and
with them the possibility to allocate); the private parts are inlined. A step takes half the time for it; none of it is
``fastmath``.
"""

import math

import numpy as np

from navfilter.kernels.compiling.decorators import njit

OPTIONS: dict = {"error_model": "numpy", "_nrt": False}

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


@njit(cache=True, inline="always", **OPTIONS)
def _inside(s, at, order, radius):
    """Schur-Cohn: are all roots of 1 + s[TRIAL, at] z^-1 + ... inside |z| < radius? NaN answers no."""
    inverse = 1.0 / radius
    power = 1.0
    for i in range(order):
        power *= inverse
        s[SCRATCH, i] = s[TRIAL, at + i] * power
    inside = True
    for top in range(order - 1, -1, -1):
        k = s[SCRATCH, top]
        inside = inside and abs(k) < 1.0
        if inside and top > 0:
            scale = 1.0 / (1.0 - k * k)
            for i in range((top + 1) // 2):
                j = top - 1 - i
                front = s[SCRATCH, i]
                back = s[SCRATCH, j]
                s[SCRATCH, i] = (front - k * back) * scale
                s[SCRATCH, j] = (back - k * front) * scale
    return inside


@njit(cache=True, inline="always", **OPTIONS)
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


@njit(cache=True, inline="always", **OPTIONS)
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
    residual = e
    # Without excitation there is nothing to learn, and forgetting would only let P grow.
    if spread > 1e-6 * (1.0 - lam) and spread < 1e12:
        inverse = 1.0 / (lam + spread)
        step = e * inverse
        tries = 0
        while tries < 5:
            for i in range(n):
                s[TRIAL, i] = s[THETA, i] + step * s[GAIN, i]
            if _inside(s, 0, p, s[HEAD, RADIUS_A]) and _inside(s, p, q, s[HEAD, RADIUS_C]):
                tries = 5
                residual = y
                for i in range(n):
                    s[THETA, i] = s[TRIAL, i]
                    residual -= s[PHI, i] * s[THETA, i]
            else:
                tries += 1
                s[HEAD, HELD] += 1.0
                step *= 0.5
        grow = 1.0 / lam if trace * (s[HEAD, VAR] + 1e-12) < s[HEAD, CAP] else 1.0
        # The product of the two gains first: it commutes, so P stays symmetric to the last bit. With the other order
        # its skew part grows like lam^-t and ruins the estimate after some ten windows.
        for j in range(n):
            weight = s[GAIN, j]
            for i in range(n):
                s[COV + j, i] = (s[COV + j, i] - (weight * s[GAIN, i]) * inverse) * grow
    else:
        s[HEAD, IDLE] += 1.0
    return residual


@njit(cache=True, inline="always", **OPTIONS)
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


@njit(cache=True, inline="always", **OPTIONS)
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


@njit(cache=True, inline="always", **OPTIONS)
def _learn(s, buf, pos, predicted):
    """What a known sample changes; `buf[0, pos]` holds it and receives its clipped value."""
    p = int(s[HEAD, AR])
    q = int(s[HEAD, MA])
    n = p + q + int(s[HEAD, EXOG])
    y = buf[0, pos]
    e = y - predicted
    whole = True
    if s[HEAD, CLIP] > 0.0:
        e = _clip(s, e)
        whole = abs(e) < 0.99 * s[HEAD, CLIP] * s[HEAD, SPREAD]
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
        if whole:
            s[HEAD, VAR] += (1.0 - lam) * (e * posterior - s[HEAD, VAR])
        s[HEAD, LAM] = s[HEAD, LAM_END] + (lam - s[HEAD, LAM_END]) * s[HEAD, LAM_RATE]
    _remember(s, y, posterior, p, q)


@njit(cache=True, **OPTIONS)
def rml_step(s, buf, x):
    """One sample through one estimator; True when window work is due. O(n^2), no allocation.

    Recursive prediction error (Soderstrom 1973, Ljung 1977): e = y - phi'theta, K = P psi / (lam + psi'P psi),
    theta += K e, P = (P - K psi'P) / lam, psi = phi / C; the residual after the step enters phi.
    """
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
    if s[HEAD, RUNNING] == 1.0:
        predicted = _predict(s, p, q, m, n)
        if seen:
            _learn(s, buf, pos, predicted)
        else:
            # The missing value is replaced by its expectation; what follows within the lags is not learnt from.
            s[HEAD, SETTLE] = max(p, q)
            _remember(s, predicted, 0.0, p, q)
    return pos + 1 >= s[HEAD, DUE]


@njit(cache=True, **OPTIONS)
def rml_run(s, buf, xs, start):
    """Samples xs[start:] through one estimator until window work is due; returns where it stops."""
    for i in range(start, xs.size):
        if rml_step(s, buf, xs[i]):
            return i + 1
    return xs.size


@njit(cache=True, **OPTIONS)
def bank_step(states, bufs, x):
    """One sample through several estimators; True when window work is due."""
    due = False
    for j in range(states.shape[0]):
        if rml_step(states[j], bufs[j], x):
            due = True
    return due


@njit(cache=True, **OPTIONS)
def bank_run(states, bufs, xs, start):
    """As `rml_run` for several estimators with one schedule: states (k, rows, width), bufs (k, rows, L)."""
    for i in range(start, xs.size):
        if bank_step(states, bufs, xs[i]):
            return i + 1
    return xs.size
