"""Readable NumPy twins of the kernels, one function of the same name per kernel, a section per kernel file."""

import itertools
import math

import numpy as np
from scipy import special
from scipy.linalg import block_diag, expm, solve_continuous_lyapunov
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.stats import chi2

from navfilter.kernels import consistency, fault_bank
from navfilter.kernels import strapdown as strapdown_kernels
from navfilter.kernels.compiling import addresses

# ---------------------------------------------------------------- kernels/arma.py: one online step (no gaps, no guard)


def rml_step(theta, P, phi, psi, y, lam):
    """Recursive prediction error, Ljung and Soderstrom: e, then theta and P, then the residual after the step."""
    e = y - phi @ theta
    if psi @ P @ psi <= 1e-6 * (1.0 - lam):  # nothing to learn from: no forgetting either
        return theta, P, e
    K = P @ psi / (lam + psi @ P @ psi)
    theta = theta + K * e
    P = (P - np.outer(K, psi @ P)) / lam
    return theta, P, y - phi @ theta


def rml_run(p, q, xs, theta, P, lam):
    """Feed xs from rest; the lags are kept as whole histories, filtered by the 1/C of each instant."""
    y, e, fy, fe = [0.0] * 30, [0.0] * 30, [0.0] * 30, [0.0] * 30
    for x in xs:
        phi = np.array([-y[-1 - i] for i in range(p)] + [e[-1 - i] for i in range(q)])
        psi = np.array([-fy[-1 - i] for i in range(p)] + [fe[-1 - i] for i in range(q)])
        theta, P, residual = rml_step(theta, P, phi, psi, x, lam)
        c = theta[p:]
        fy.append(x - sum(c[k] * fy[-1 - k] for k in range(q)))
        fe.append(residual - sum(c[k] * fe[-1 - k] for k in range(q)))
        y.append(x)
        e.append(residual)
    return theta, P


def bank_step(orders, xs, thetas, Ps, lam):
    """Several orders on the same samples, none knowing of the others."""
    return [rml_run(p, q, xs, theta, P, lam) for (p, q), theta, P in zip(orders, thetas, Ps, strict=True)]


bank_run = bank_step


# ---------------------------------------------------------------- kernels/arma_window.py: passes over a window


def window_signals(theta, p, y):
    """Residuals and gradient regressors psi, both filtered over the whole series from rest."""
    c = np.r_[1.0, theta[p:]]
    e = lfilter(np.r_[1.0, theta[:p]], c, y)
    fy, fe = lfilter([1.0], c, y), lfilter([1.0], c, e)
    lagged = [np.r_[np.zeros(i), -fy[:-i]] for i in range(1, p + 1)]
    lagged += [np.r_[np.zeros(i), fe[:-i]] for i in range(1, theta.size - p + 1)]
    return e, np.array(lagged).reshape(theta.size, y.size).T


def window_pass(theta, p, y, lo):
    """Sums of products of [psi, e] from sample lo on."""
    e, psi = window_signals(theta, p, y)
    both = np.column_stack([psi, e])[lo:]
    return both.T @ both


def polish(theta, p, y, lo):
    """Least squares of the residuals from sample lo on."""
    return least_squares(lambda t: window_signals(t, p, y)[0][lo:], theta, xtol=1e-14, ftol=1e-14, gtol=1e-14).x


def window_covariance(normal, n):
    """Inverse of the information matrix."""
    return np.linalg.inv(normal[:n, :n])


def memory_after(theta, p, y, count):
    """Lags -y, e and their filtered versions before sample `count`, newest first."""
    q = theta.size - p
    e, _ = window_signals(theta, p, y)
    fy, fe = lfilter([1.0], np.r_[1.0, theta[p:]], y), lfilter([1.0], np.r_[1.0, theta[p:]], e)
    last = slice(count - 1, None, -1)
    return np.r_[-y[last][:p], e[last][:q]], np.r_[-fy[last][:p], fe[last][:q]], -fy[last][p : max(p, q)]


# ---------------------------------------------------------------- kernels/fit.py: batch fit


def arma_filter(y, a, c, z, e):
    """Observer form z+ = M z + g e, y = z[0] + e."""
    M = np.eye(len(z), k=1)
    M[:, 0] -= a
    for t in range(len(y)):
        e[t] = y[t] - z[0]
        z[:] = M @ z + (c - a) * e[t]


def impulse_response(c, w):
    w[:] = lfilter([1.0], np.r_[1.0, c], np.eye(len(w))[0])
    return len(w)


def lag_products(x, y, out):
    for k in range(len(out)):
        out[k] = sum(x[t] * y[t + k] for t in range(min(len(x), len(y)) - k))


def inner_products(X, G):
    G[:] = X @ X.T


def without_inputs(y, R, b, out):
    out[:] = y - R.T @ b


def shift_gram(x, y, first, G):
    def delayed(s, k):
        return np.r_[np.zeros(k), s[: len(s) - k]]

    for i in range(G.shape[0]):
        for j in range(G.shape[1]):
            G[i, j] = delayed(x, i + first) @ delayed(y, j)


def lyapunov(M, Q, rounds, P):
    P[:] = Q
    for k in range(1, min(2**rounds, 5000)):
        A = np.linalg.matrix_power(M, k)
        P += A @ Q @ A.T


def confine(rows, p, q, limits):
    for row in rows:
        for ar, at, count, radius in ((True, 0, p, limits[1]), (False, p, q, limits[2])):
            roots = np.roots(np.r_[1.0, row[at : at + count]]).astype(complex)
            if ar:
                roots = roots * np.minimum(1.0, (radius - 1e-12) / np.maximum(np.abs(roots), 1e-300))
            if ar and count == 1 and limits[0] > 0.0:
                roots = np.minimum(roots.real, np.exp(-limits[0]))
            elif ar:
                logs = np.log(np.where(np.abs(roots) < 1e-12, 1e-12, roots))
                far = logs * limits[0] / np.maximum(np.abs(logs), 1e-12)
                far = np.minimum(far.real, -0.05 * limits[0]) + 1j * far.imag
                roots = np.where(np.abs(logs) < limits[0], np.exp(far), roots)
            size = np.maximum(np.abs(roots), 1e-300)
            inside = size if ar else np.where(size > 1.0, 1.0 / size, size)
            if count and size.max() >= radius:
                roots = roots * np.minimum(inside, radius - 1e-12) / size
            row[at : at + count] = np.atleast_1d(np.poly(roots)).real[1:]
        row[p + q :] = np.clip(row[p + q :], *limits[3:].reshape(-1, 2)[: row.size - p - q].T)


def largest_reflection(c, radius):
    roots = np.roots(np.r_[1.0, c])
    if np.any(np.abs(roots) >= radius):
        return np.inf
    u = np.asarray(c) / radius ** np.arange(1, len(c) + 1)
    worst = 0.0
    while len(u):
        k = u[-1]
        worst = max(worst, abs(k))
        u = (u[:-1] - k * u[-2::-1]) / (1.0 - k * k)
    return worst


def kalman_whiten(Y, a, c, P0, W):
    """Textbook Kalman filter of the observer form; a missing row only predicts."""
    r, logdet, P, z = len(a), 0.0, P0.copy(), np.zeros((Y.shape[1], len(a)))
    M = np.eye(r, k=1)
    M[:, 0] -= a
    g = c - a
    for t in range(len(Y)):
        F = P[0, 0] + 1.0
        W[t] = (Y[t] - z[:, 0]) / np.sqrt(F)
        K = (M @ P[:, 0] + g) / F
        seen = not np.isnan(Y[t, 0])
        z = z @ M.T + (np.outer(Y[t] - z[:, 0], K) if seen else 0.0)
        P = M @ P @ M.T + np.outer(g, g) - (F * np.outer(K, K) if seen else 0.0)
        logdet += np.log(F) if seen else 0.0
    W[np.isnan(Y[:, 0])] = np.nan
    return logdet


def levinson(gamma, ar, pacf):
    for m in range(1, len(ar) + 1):
        T = np.array([[gamma[abs(i - j)] for j in range(m)] for i in range(m)])
        solution = np.linalg.solve(T, gamma[1 : m + 1])
        pacf[m - 1] = solution[-1]
    ar[:] = -solution
    return gamma[0] + ar @ gamma[1:]


def burg_recursion(x, ar):
    f, b, v, found = x[1:], x[:-1], np.mean(x**2), np.array([1.0])
    for _ in range(len(ar)):
        k = -2.0 * (f @ b) / (f @ f + b @ b)
        f, b = (f + k * b)[1:], (b + k * f)[:-1]
        found = np.r_[found, 0.0] + k * np.r_[0.0, found[::-1]]
        v *= 1.0 - k * k
    ar[:] = found[1:]
    return v


# --- kernels/strapdown.py: errors are estimated minus true, vectors in n

RADIUS, E2, RATE = 6378137.0, 6.69437999014e-3, 7.292115e-5
NORTH, EAST, DOWN = np.eye(3)


def skew(v):
    return np.cross(np.eye(3), v)


def rotation(v):
    """exp([v x]) by the matrix exponential."""
    return expm(skew(v))


def rodrigues(t2):
    t = np.sqrt(t2)
    return np.sinc(t / np.pi), 0.5 * np.sinc(0.5 * t / np.pi) ** 2


def rotated(a, b, x, y, z, u, v, w):
    K = skew((x, y, z))
    return tuple((np.eye(3) + a * K + b * K @ K) @ (u, v, w))


def rotation_and_changes(v):
    """exp([v x]) and its derivatives by the three elements of v: an imaginary step is exact to rounding."""
    return rotation(v), [np.imag(rotation(v + 1e-20j * axis)) / 1e-20 for axis in np.eye(3)]


def radii(latitude):
    x = 1.0 - E2 * np.sin(latitude) ** 2
    return RADIUS * (1.0 - E2) / x**1.5, RADIUS / np.sqrt(x)


def gravity(latitude, height):
    e, p, s2 = 9.7803253359, 9.8321849378, np.sin(latitude) ** 2
    k = np.sqrt(1.0 - E2) * p / e - 1.0
    return e * (1.0 + k * s2) / np.sqrt(1.0 - E2 * s2) * (1.0 - 2.0 * height / RADIUS)


def stamps_to_steps(samples, last_s, limits, gap_s, longest_s):
    steps = np.diff(samples[:, 0], prepend=last_s)
    possible = np.abs(samples[:, 1 : 1 + len(limits)]) <= limits
    if not (possible.all() and (steps > 0).all() and (steps <= longest_s).all()):
        return -1
    samples[:, 0] = steps
    return int(np.sum(steps > gap_s))


def _increments(sample, drv):
    """Angle and velocity gathered over one sample; coning and sculling for rates that change linearly."""
    dt, now = sample[0], sample[1:7]
    whole = 1.0
    if not drv[13]:
        drv[0:6], drv[13], whole = now, 1.0, min(max(dt / drv[36], 0.0), 1.0)
    before, rates = drv[0:6].copy(), drv[37] == 0
    inc = 0.5 * dt * (before + now) if rates else whole * now
    unit = dt**2 / 12.0 if rates else 1.0 / 12.0
    (w0, f0), (w1, f1) = before.reshape(2, 3), now.reshape(2, 3)
    inc[:3] += unit * np.cross(w0, w1)
    inc[3:] += unit * (np.cross(w0, f1) + np.cross(f0, w1))
    inc -= drv[6:12]
    drv[6:12], drv[0:6] = 0.0, now
    return inc


def _mechanise(nav, inc, dt):
    """One strapdown step; returns what its transition is built from."""
    lat, h, v, C = nav[0], nav[2], nav[3:6].copy(), nav[6:15].reshape(3, 3).copy()
    rn, re = np.array(radii(lat)) + h
    u = C @ (inc[3:] + 0.5 * np.cross(inc[:3], inc[3:]))
    g = gravity(lat, h - 0.5 * v[2] * dt)
    mid = v + 0.5 * (u + g * dt * DOWN)
    earth = RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    w = earth + np.array([mid[1] / re, -mid[0] / rn, -mid[1] * np.tan(lat) / re])
    p = u - 0.5 * dt * np.cross(w, u)
    nav[3:6] = v + p - dt * np.cross(w + earth, mid) + g * dt * DOWN
    mid = 0.5 * (v + nav[3:6])
    climb = -0.5 * mid[2] * dt
    dlat = mid[0] / (rn + climb) * dt
    nav[0], nav[2] = lat + dlat, h - mid[2] * dt
    nav[1] += mid[1] / ((re + climb) * np.cos(lat + 0.5 * dlat)) * dt
    nav[15:17] = rn + 2 * climb, re + 2 * climb
    C_new = rotation(-w * dt) @ C @ rotation(inc[:3])
    nav[6:15] = C_new.ravel()
    return 0.5 * (C + C_new), p, mid, g, lat, rn, re


def integrate(nav, drv, samples, out):
    for n, sample in enumerate(samples):
        _mechanise(nav, _increments(sample, drv), sample[0])
        if len(out):
            out[n] = nav


def _transport(v, lat, rn, re):
    """Transport rate, and its derivatives with respect to velocity and to position in metres."""
    t, c = np.tan(lat), np.cos(lat)
    by_v = np.array([[0, 1 / re, 0], [-1 / rn, 0, 0], [0, -t / re, 0]])
    by_p = np.zeros((3, 3))
    by_p[2, 0] = -v[1] / (re * c**2 * rn)
    by_p[:, 2] = [v[1] / re**2, -v[0] / rn**2, -v[1] * t / re**2]  # height is minus the down error
    return by_v @ v, by_v, by_p


def _inertial_transition(C, p, v, g, lat, rn, re, dt, Cr):
    """Transition of one strapdown step, trapezoidal: attitude first, then velocity, then position."""
    k = Cr.shape[1] - 1
    earth = RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    earth_by_p = np.zeros((3, 3))
    earth_by_p[:, 0] = -RATE / rn * np.array([np.sin(lat), 0.0, np.cos(lat)])
    rho, rho_by_v, rho_by_p = _transport(v, lat, rn, re)
    F, start = np.zeros((9 + k, 9 + k)), np.eye(3, 9 + k, 6)
    F[6:9, :3], F[6:9, 3:6], F[6:9, 6:9] = (
        -dt * (earth_by_p + rho_by_p),
        -dt * rho_by_v,
        np.eye(3) - dt * skew(earth + rho),
    )
    F[6:9, 9:], F[3:6, 9:] = -dt * C @ Cr[:3, :k], -dt * C @ Cr[3:, :k]
    F[3:6] -= skew(p) @ (0.5 * (F[6:9] + start))
    F[3:6, 3:6] += np.eye(3) - dt * skew(2 * earth + rho) + dt * skew(v) @ rho_by_v
    F[3:6, :3] += dt * skew(v) @ (2 * earth_by_p + rho_by_p)
    F[5, 2] += dt * 2 * g / RADIUS
    F[:3] = 0.5 * dt * (F[3:6] + np.eye(3, 9 + k, 3)) + np.eye(3, 9 + k)
    F[:3, :3] += dt * _curvature(v, lat, rn, re)
    return F


def _curvature(v, lat, rn, re):
    """Derivative of the velocity of a position error, because metres north and east depend on where one is."""
    t = np.tan(lat)
    return np.array([[-v[2] / rn, 0, v[0] / rn], [v[1] * t / rn, -v[2] / re - t * v[0] / rn, v[1] / re], [0, 0, 0]])


def _compound(acc, F):
    m = acc.shape[1]
    acc[:m], acc[m : 2 * m] = F @ acc[:m], F @ acc[m : 2 * m] @ F.T


def _tick_drive(acc, F, xd, Phid, Qd, ticks):
    m = acc.shape[1]
    F[9:, 9:] = Phid if ticks else np.eye(m - 9)
    _compound(acc, F)
    for count in range(ticks):
        if count:
            _compound(acc, block_diag(np.eye(9), Phid))
        acc[m + 9 : 2 * m, 9:] += Qd
        xd[:] = Phid @ xd


def _uncalibrated(xd, drv, inc, dt, Cr):
    """Output rows that make errors of the readings: of M times what they are."""
    count = int(drv[88])
    Cr, first = Cr.copy(), len(xd) - count
    for q, code in enumerate(drv[89 : 89 + count].astype(int)):
        Cr[code // 3, first + q] = inc[3 * (code // 9) + code % 3] / dt if dt else 0.0
    drv[107:125] = 0.0
    drv[107 + drv[89 : 89 + count].astype(int)] = xd[first:]
    return Cr


def _inertial_step(nav, xd, inc, dt, drv, Phid, Qd, Cr, acc, ticks):
    m = acc.shape[1]
    if drv[88]:
        Cr = _uncalibrated(xd, drv, inc, dt, Cr)
    parts = _mechanise(nav, inc - dt * Cr[:, :-1] @ xd, dt)
    _tick_drive(acc, _inertial_transition(*parts, dt, Cr), xd, Phid, Qd, ticks)
    drv[14:23] = parts[0].ravel()
    Q, C, gap = acc[m : 2 * m], parts[0], dt > 3 * drv[36]
    unseen = np.minimum(np.repeat(drv[38:40], 3) * dt, [0.1, 0.1, np.inf, np.inf, np.inf, np.inf])
    variance = Cr[:, -1] * drv[36] * max(dt, 0.0) + gap * unseen**2
    speed = C @ np.diag(variance[3:]) @ C.T
    Q[6:9, 6:9] += C @ np.diag(variance[:3]) @ C.T
    Q[3:6, 3:6] += speed
    if gap:
        Q[:3, :3] += 0.25 * dt**2 * speed
        Q[:3, 3:6] += 0.5 * dt * speed
        Q[3:6, :3] += 0.5 * dt * speed


def _ticks(span, period):
    return int(min(max(span / period + 0.5, 1.0), 10000.0))


def imu_steps(nav, xd, drv, samples, Phid, Qd, Cr, acc):
    for sample in samples:
        inc = _increments(sample, drv)
        drv[23:24] += 1.0
        drv[24:30] += sample[1:7]
        drv[30:36] += sample[1:7] ** 2
        dt, drv[12] = sample[0] - drv[12], 0.0
        _inertial_step(nav, xd, inc, dt, drv, Phid, Qd, Cr, acc, _ticks(sample[0], drv[36]))


def _traced(steps):
    def traced(nav, xd, drv, samples, Phid, Qd, Cr, acc, trace):
        for n in range(len(samples)):
            steps(nav, xd, drv, samples[n : n + 1], Phid, Qd, Cr, acc)
            if len(trace):
                left = np.concatenate([nav, xd, acc[: 2 * acc.shape[1]].ravel()])
                trace[n, : len(left)] = left

    return traced


imu_traced = _traced(imu_steps)


def imu_hold(nav, xd, drv, dt, Phid, Qd, Cr, acc):
    inc = drv[0:6] * (dt / drv[36] if drv[37] else dt)
    drv[6:12] += inc
    drv[12] += dt
    _inertial_step(nav, xd, inc, dt, drv, Phid, Qd, Cr, acc, 0)


def euler(roll, pitch, yaw):
    return rotation(yaw * DOWN) @ rotation(pitch * EAST) @ rotation(roll * NORTH)


def _move(nav, d):
    nav[1] += d[1] / (nav[16] * np.cos(nav[0] + 0.5 * d[0] / nav[15]))
    nav[0] += d[0] / nav[15]
    nav[2] -= d[2]
    nav[15:17] = np.array(radii(nav[0])) + nav[2]


def dead_reckoning_steps(nav, xd, drv, samples, Phid, Qd, Cr, acc):
    for sample in samples:
        _dead_reckoning_step(nav, xd, drv, sample, Phid, Qd, Cr, acc)


dead_reckoning_traced = _traced(dead_reckoning_steps)


def _deviated(reading, waves):
    """Deviation is told by the heading: reading = heading + waves(heading)."""
    heading = reading
    for _ in range(3):
        y = heading
        value, slope = (
            np.dot(waves, each)
            for each in (
                (np.sin(y), np.cos(y), np.sin(2 * y), np.cos(2 * y)),
                (np.cos(y), -np.sin(y), 2 * np.cos(2 * y), -2 * np.sin(2 * y)),
            )
        )
        slope = max(slope, -0.5)
        heading = y - (y + value - reading) / (1.0 + slope)
    return reading - heading, 1.0 / (1.0 + slope)


def _dead_reckoning_step(nav, xd, drv, sample, Phid, Qd, Cr, acc):
    k, m = len(xd), len(xd) + 9
    span, started, half = sample[0], drv[13] != 0, 0.5 * sample[0]
    if drv[12]:
        _compound(acc, _hold_on(nav, xd, drv, -drv[12]))
    drv[12] = 0.0
    noise = 2.0 * Cr[:, k] + np.diag(Cr[:, :k] @ Qd @ Cr[:, :k].T)
    dev, par, arm, M = int(drv[41]), int(drv[42]), drv[44:47], drv[47:56].reshape(3, 3)
    late_a, late_v, lever, turn0 = int(drv[65]), int(drv[66]), int(drv[67]), drv[78:87].reshape(3, 3).copy()
    if lever >= 0:
        arm = arm + xd[lever : lever + 3]
        drv[56:59] = turn0 @ arm
    v0, w0, C0 = nav[3:6].copy(), drv[56:59].copy(), nav[6:15].reshape(3, 3).copy()
    current, flow = np.zeros(3), int(drv[125])
    current[:2] = xd[flow : flow + 2] if flow >= 0 else 0.0
    missing = not (np.abs(sample[4:7]) <= drv[62]).all() or not (sample[4:7].any() or drv[63])
    most_s = max(8.0, 20.0 * drv[36])
    drv[131] = drv[131] + span if started and (sample[1:4] == drv[59:62]).all() and sample[1:3].any() else 0.0
    drv[132] = drv[132] + span if started and (sample[4:7] == drv[133:136]).all() and sample[4:7].all() else 0.0
    again = started and sample[3] == drv[61]
    drv[193] = drv[193] + span if again else 0.0
    if drv[193] <= 5.0 * drv[36]:
        drv[195] = min(drv[195] + 1.0, 2000.0)
        drv[194] += (again - drv[194]) / drv[195]
    stuck, held = drv[131] > most_s, drv[193] > most_s and drv[194] < 0.1 and drv[195] >= 100.0
    drv[131] = drv[193] if held else drv[131]
    gained, going, drv[133:136] = sample[4:7] - drv[138:141], drv[141] >= 0 and drv[130] == 0, sample[4:7]
    missing = missing or drv[132] > most_s
    blind = stuck or not np.isfinite(sample[1:4]).all()
    if started and not blind:
        angle = abs((sample[3] - drv[61] + np.pi) % (2 * np.pi) - np.pi)
        odd = angle > 1.5 * (drv[129] + span) + 0.1 and drv[136] < 2
        drv[136], blind = (drv[136] + 1, True) if odd else (0, False)
    drv[141] += span if drv[141] >= 0 else 0.0
    if not missing:
        odd = drv[141] >= 0 and np.abs(sample[4:7] - drv[138:141]).max() > 5.0 * drv[141] + 0.5 and drv[137] < 2
        drv[137], missing = (drv[137] + 1, True) if odd else (0, False)
        if not odd:
            drv[138:141], drv[141] = sample[4:7], 0.0
    per = 1.0 / span if started and span > 0 else 0.0
    if not missing and going:
        drv[149:155], drv[156], drv[197] = _evenly(
            drv[152:155], drv[197], per * M @ gained, per**2 * noise[3:].sum(), span
        )
    elif missing:
        drv[149:152] = 0.0
    held = held and not blind
    unread = drv[131] if (stuck or held) and not drv[129] else span
    drv[129] = drv[129] + span if blind or held else 0.0
    drv[130] = drv[130] + span if missing else 0.0
    if blind:
        sample[1:4] = drv[59:62]
    C_before, nearest = drv[169:178].reshape(3, 3).copy(), sample[1:7] - drv[163:169]
    nearest[:3] = (nearest[:3] + np.pi) % (2 * np.pi) - np.pi
    follow = np.where(started & (np.abs(nearest) <= 3.0 * drv[157:163]), 0.02, 1.0)
    follow[:3], follow[3:] = follow[:3] * (not blind), follow[3:] * (not missing)
    drv[163:169] += follow * np.nan_to_num(nearest)
    drv[169:178] = euler(drv[163], drv[164], drv[165] + drv[43]).ravel()
    # what the readings' errors are thought to be, and how they follow from the drive's states
    E = Cr[:, :k].copy()
    if late_a >= 0 or late_v >= 0:
        late = _change(sample[1:7] - np.r_[drv[59:62], drv[74:77]], drv, sample[0], missing, Cr, Qd)
        seen, drv[187:190] = drv[187:190].copy(), late[3:]
        drv[77], drv[74:77] = not missing, drv[74:77] if missing else sample[4:7]
    if late_a >= 0:
        E[:3, late_a] -= late[:3]
    if late_v >= 0:
        E[3:, late_v] -= late[3:]
    err, bent, straight = E @ xd, 0.0, 1.0
    if dev >= 0:
        bent, straight = _deviated(sample[3] - err[2], xd[dev : dev + 4])
        err[2] += bent
    if late_v >= 0:
        E[3:, late_v] += late[3:] - seen
    roll, pitch, yaw = sample[1:4] - err[:3]
    yaw = np.arctan2(C0[1, 0], C0[0, 0]) if held else yaw + drv[43]  # declination
    C = C0 if blind else euler(roll, pitch, yaw)
    # each angle turns about one of these
    axes = (
        np.zeros((3, 3))
        if blind
        else np.column_stack([C[:, 0], rotation(yaw * DOWN) @ EAST, straight * (not held) * DOWN])
    )
    l0, l1 = (C0 @ arm, C @ arm) if started else (np.zeros(3), np.zeros(3))
    turned = (sample[1:4] - drv[59:62] + np.pi) % (2 * np.pi) - np.pi
    spin = np.zeros(3)
    if blind:
        drv[143:146], drv[155] = 0.0, drv[64]
    else:
        shake = per * _body_angles(*sample[1:3])
        drv[64], spin = per * np.linalg.norm(turned), shake @ turned
        drv[143:149], drv[155], drv[196] = _evenly(drv[146:149], drv[196], spin, per**2 * noise[:3].sum(), span)
    w = C @ np.cross(spin, arm)
    F, J, E_par = np.zeros((m, m)), np.zeros((9, 6)), np.zeros((3, k))
    if missing:
        B = C @ C0.T
        u = B @ (v0 - current + w0)
        F[3:6, 3:6], F[3:6, 6:9] = B, B @ skew(v0 - current)
    else:
        scale, mis = _scale_and_turn(xd[par : par + 4 + 2 * int(drv[87])] if par >= 0 else np.zeros(0))
        D = scale @ rotation(mis)
        y = np.linalg.solve(D, sample[4:7] - err[3:])
        u = C @ M @ y
        J[3:6, 3:6] = C @ M @ np.linalg.inv(D)
        if par >= 0:
            seen = y + np.linalg.solve(D, drv[166:169] - sample[4:7])
            E_par[:, par : par + 4 + 2 * int(drv[87])] = _by_scale_and_turn(scale, mis, seen, drv[87])
    for j in range(3):
        a = axes[:, j]
        moved, du = np.cross(a, l1), np.cross(a, u)
        J[:3, j], J[3:6, j], J[6:9, j] = half * du - moved, du - np.cross(a, w), a
    J[:3, 3:] = half * J[3:6, 3:]
    if flow >= 0:
        F[3:6, 9 + flow : 11 + flow] = (np.eye(3) - (B if missing else 0.0))[:, :2]
    F[:3] = half * F[3:6] + np.eye(3, m)
    F[:3, 3:6] += half * np.eye(3)
    F[:3, 6:9] -= skew(half * w0 + l0)
    if blind:
        # the attitude's error stays: it turns velocity and arm
        F[3:6, 6:9] -= skew(u)
        F[:3, 6:9] += -half * skew(u) + skew(l1)
        F[6:9, 6:9] += np.eye(3)
    if held:
        row = _bearing(C0 @ NORTH)[1]
        F[3:6, 6:9] += np.outer(skew(w - u) @ DOWN, row)
        F[:3, 6:9] += np.outer((skew(l1) - half * skew(u)) @ DOWN, row)
        F[8, 6:9] += row
    if dev >= 0:
        y = drv[165] - bent
        E[2, dev : dev + 4] = np.sin(y), np.cos(y), np.sin(2 * y), np.cos(2 * y)
    F[:9, 9:] -= J @ E + J[:, 3:] @ E_par
    if lever >= 0:
        seen0, turn1 = drv[178:187].reshape(3, 3), started * (drv[169:178].reshape(3, 3) - C_before)
        here, held_turn = slice(9 + lever, 12 + lever), C @ C0.T @ seen0 if missing else np.zeros((3, 3))
        square = 0.0 if blind else turned @ turned
        told = square / (square + 100.0 * noise[:3].sum()) if square else 0.0
        swing = C @ skew(spin)
        F[3:6, here] += held_turn - told * swing
        F[:3, here] += half * (held_turn + seen0) - turn1
        drv[78:87], drv[178:187] = swing.ravel(), told * swing.ravel()
    F[:3, :3] += span * _curvature(v0, nav[0], *nav[15:17])
    gains, known = np.cross(drv[143:146], C.T @ u) + drv[149:152], per and span <= 3 * drv[36]
    bent, drv[190:193] = drv[190:193].copy(), span**2 / 12.0 * C @ gains if known else 0.0
    made = half * (v0 + w0 + u + current) - l1 + l0 + bent - drv[190:193]
    drv[127:129] += made[:2]
    _move(nav, made)
    nav[3:6], nav[6:15], drv[56:59], drv[59:62], drv[12:14] = u + current - w, C.ravel(), w, sample[1:4], (0.0, 1.0)
    _tick_drive(acc, F, xd, Phid, Qd, _ticks(span, drv[36]))
    Q, walk = acc[m : 2 * m], drv[40] ** 2 * span * np.eye(3)
    Q[:9, :9] += J @ np.diag(Cr[:, k]) @ J.T
    if not blind and per:
        unseen, G = 0.125 * drv[196], np.zeros((9, 3))
        G[:3], G[3:6] = -half * C @ skew(arm), C @ skew(arm)
        Q[:9, :9] += G @ (shake @ np.diag(noise[:3]) @ shake.T + unseen * np.eye(3)) @ G.T
        both = G @ shake @ np.diag(Cr[:3, k]) @ J[:, :3].T
        Q[:9, :9] += both + both.T
    if blind:
        Q[6:9, 6:9] += unread * np.diag([0.1**2, 0.1**2, 0.35**2])
    if held:
        Q[8, 8] += unread * 0.35**2
    if (blind or held) and unread > span:
        across = np.array([current[1] - nav[4], nav[3] - current[0]])
        Q[:2, :2] += 0.35**2 * unread**3 / 3.0 * np.outer(across, across)
        Q[:2, 8] += 0.35**2 * unread**2 / 2.0 * across
        Q[8, :2] += 0.35**2 * unread**2 / 2.0 * across
    if missing:
        G = np.vstack([half * np.eye(3), np.eye(3)])
        Q[:6, :6] += G @ walk @ G.T
    elif span > 3 * drv[36]:
        Q[:3, :3] += walk * span**2 / 12.0
        Q[:2, :2] += np.eye(2) * 0.35**2 * (nav[3] ** 2 + nav[4] ** 2) * span**3 / 12.0


def _evenly(before, usual, now, variance, span):
    """As far as it stands out of its noise, and as it is; by how much it was another before; what is usual of that."""
    square, other = now @ now, np.linalg.norm(now - before)
    share = 1.0 - variance / square if square > variance else 0.0
    usual += min(1.0, span / 60.0) * (other**2 - 3.0 * variance - usual)
    return np.r_[share * now, now], other, max(0.0, usual)


def _hold_on(nav, xd, drv, dt):
    F, flow, current, C0, v0 = np.eye(len(xd) + 9), int(drv[125]), np.zeros(3), nav[6:15].reshape(3, 3), nav[3:6]
    if flow >= 0:
        current[:2] = xd[flow : flow + 2]
    C = C0 @ rotation(dt * drv[143:146])
    R = C @ C0.T
    v = R @ (v0 - current) + dt * C @ drv[149:152]
    F[3:6, 3:6], F[3:6, 6:9] = R, R @ skew(v0 - current) - skew(v)
    bow = 0.5 * dt * np.diag([1.0 + (dt * drv[145]) ** 2 / 12.0] * 2 + [1.0])
    F[:3, 3:9] = bow @ (F[3:6, 3:9] + np.eye(3, 6))
    if flow >= 0:
        F[3:6, 9 + flow : 11 + flow] = (np.eye(3) - R)[:, :2]
        F[:3, 9 + flow : 11 + flow] = (dt * np.eye(3) - bow @ (np.eye(3) + R))[:, :2]
    F[:3, :3] += dt * _curvature(v0, nav[0], *nav[15:17])
    _move(nav, bow @ (v0 - current + v) + dt * current)
    nav[3:6], nav[6:15] = v + current, C.ravel()
    return F


def _body_angles(roll, pitch):
    """What changes of roll, pitch and yaw turn the body by."""
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    return np.array([[1.0, 0.0, -sp], [0.0, cr, sr * cp], [0.0, -sr, cr * cp]])


def _scale_and_turn(par):
    """Diagonal matrix of the scales and vector of the misalignment: none, one scale, or three."""
    if not len(par):
        return np.eye(3), np.zeros(3)
    return np.diag(1.0 + par[:-3] * np.ones(3)), par[-3:]


def _by_scale_and_turn(scale, mis, y, each):
    """Derivative of scale R(mis) y."""
    turned, changes = rotation_and_changes(mis)
    by_scale = np.diag(turned @ y)
    by_turn = scale @ np.column_stack([change @ y for change in changes])
    return np.column_stack([by_scale if each else by_scale.sum(axis=1), by_turn])


def _change(step, drv, span, missing, Cr, Qd):
    near, rates = drv[13] != 0 and 0 < span <= 3 * drv[36], drv[68:74]
    known = np.repeat([near, near and not missing and drv[77]], 3)
    step[:3] = (step[:3] + np.pi) % (2 * np.pi) - np.pi
    if not near:
        rates[:] = 0.0
        return np.zeros(6)
    # of a difference of two readings, per second squared: their white noise, and what their slow errors wander by
    white, walk = 2.0 * Cr[:, -1] / span**2, np.diag(Cr[:, :-1] @ Qd @ Cr[:, :-1].T) / span**2
    off = step / span - rates
    share = span / (span + np.where(off**2 > 25.0 * (white + walk), 0.1, 1.0))
    rates[:] = np.where(known, rates + share * off, 0.0)
    # the same of their mean over a second
    steady = span / (span + 1.0)
    noise = steady / (2.0 - steady) * (3.0**2 * steady * white + 10.0**2 * walk)
    square = rates**2
    return rates * np.divide(square, square + noise, out=np.zeros(6), where=square > 0.0)


def dead_reckoning_hold(nav, xd, drv, dt, Phid, Qd, Cr, acc):
    _compound(acc, _hold_on(nav, xd, drv, dt))
    longer, m, v = (drv[12] + dt) ** 2 - drv[12] ** 2, len(acc[0]), nav[3:6].copy()
    drv[12] += dt
    if drv[125] >= 0:
        v[:2] -= xd[int(drv[125]) :][:2]
    # position, velocity and attitude by a turn, and by a change of the velocity: what the next sample makes of it
    arm, half = drv[44:47] + (xd[int(drv[67]) :][:3] if drv[67] >= 0 else 0.0), drv[12] - 0.5 * drv[36]
    swing = nav[6:15].reshape(3, 3) @ arm + 0.5 * drv[36] * drv[56:59]
    turned = np.vstack([skew(swing) - half * skew(v), -skew(v), np.eye(3)])
    gained = np.eye(9)[:, 3:6] + half * np.eye(9, 3)
    acc[m : m + 9, :9] += longer * (
        (drv[155] ** 2 + drv[196]) * turned @ turned.T + (drv[156] ** 2 + drv[197]) * gained @ gained.T
    )


# --- kernels/measurement.py: residual, and derivative of the reading


def _attitude_columns(A, v):
    """Derivative of A v, A taking n to something, when n turns under it: A (v x phi)."""
    return A @ skew(v)


def body_velocity(z, nav, rate, par, cfg, H, res):
    arm, A = cfg[:3], cfg[3:12].reshape(3, 3).T
    C_bn = nav[6:15].reshape(3, 3).T
    y = A @ (C_bn @ nav[3:6] + np.cross(rate, arm))
    scale, mis = _scale_and_turn(par)
    turn, changes = rotation_and_changes(mis)
    D = scale @ turn
    res[:], H[:] = z[:3] - D @ y, 0.0
    H[:, 3:6], H[:, 6:9] = D @ A @ C_bn, _attitude_columns(D @ A @ C_bn, nav[3:6])
    if len(par):
        still = A @ C_bn @ nav[3:6]  # what the rate adds has the noise that the reading is compared with, too
        by_scale, by_turn = np.diag(turn @ still), [scale @ change @ y for change in changes]
        H[:, 9:] = np.column_stack([by_scale if len(par) == 6 else by_scale.sum(axis=1), *by_turn])


def _bearing(n):
    horizontal = n[0] ** 2 + n[1] ** 2
    return np.arctan2(n[1], n[0]), np.array([-n[2] * n[0], -n[2] * n[1], horizontal]) / horizontal


def _deviation(psi, temperature, reference):
    warm = 0.0 if np.isnan(temperature) else temperature - reference
    terms = np.array([1.0, np.sin(psi), np.cos(psi), np.sin(2 * psi), np.cos(2 * psi), warm])
    return terms, np.array([0.0, np.cos(psi), -np.sin(psi), 2 * np.cos(2 * psi), -2 * np.sin(2 * psi), 0.0])


def _half_turn(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def heading(z, nav, rate, par, cfg, H, res):
    psi, row = _bearing(nav[6:15].reshape(3, 3) @ NORTH)
    H[:] = 0.0
    predicted = psi - cfg[0]
    if len(par):
        H[0, 9:], slopes = _deviation(psi - cfg[0], z[1], cfg[1])
        predicted, row = predicted + par @ H[0, 9:], row * (1.0 + par @ slopes)
    H[0, 6:9], res[0] = row, _half_turn(z[0] - predicted)


def magnetometer(z, nav, rate, par, cfg, H, res):
    C, (hard, soft) = nav[6:15].reshape(3, 3), cfg[2:4].astype(int)
    m, A = z[:3], np.eye(3)
    if soft >= 0:
        xx, zz, xy, xz, yz = par[soft:]
        A += np.array([[xx, xy, xz], [xy, -xx, yz], [xz, yz, zz]])
    n = C @ (A @ m - (par[hard : hard + 3] if hard >= 0 else 0.0))
    H[:] = 0.0
    predicted, more = np.arctan2(n[1], n[0]) - cfg[0], np.zeros(3)
    if len(par) and 0 not in (hard, soft):
        psi, turn = _bearing(C @ NORTH)
        H[0, 9:15], slopes = _deviation(psi - cfg[0], z[3], cfg[1])
        predicted, more = predicted + par[:6] @ H[0, 9:15], par[:6] @ slopes * turn
    res[0] = _half_turn(-predicted)
    # what should have been read
    should = np.array([[np.cos(res[0]), -np.sin(res[0]), 0], [np.sin(res[0]), np.cos(res[0]), 0], [0, 0, 1]]) @ n
    m, n = m + C.T @ (should - n), should
    row = _bearing(n)[1] + more
    by = np.array([-n[1], n[0], 0.0]) @ C / (n[0] ** 2 + n[1] ** 2)
    if hard >= 0:
        H[0, 9 + hard : 12 + hard] = -by
    if soft >= 0:
        both = np.outer(by, m) + np.outer(m, by)
        pairs = [both[0, 1], both[0, 2], both[1, 2]]
        H[0, 9 + soft :] = [0.5 * (both[0, 0] - both[1, 1]), 0.5 * both[2, 2], *pairs]
    H[0, 6:9] = row


def depth(z, nav, rate, par, cfg, H, res):
    arm = nav[6:15].reshape(3, 3) @ cfg[:3]
    H[:] = 0.0
    H[0, 2], H[0, 6:9] = 1.0, -skew(arm)[2]
    H[0, 9:] = 1.0
    res[0] = z[0] - (cfg[3] - nav[2] + arm[2] + par.sum())


def position(z, nav, rate, par, cfg, H, res):
    arm = nav[6:15].reshape(3, 3) @ cfg[:3]
    H[:] = 0.0
    H[:, :3], H[:, 6:9] = np.eye(3), -skew(arm)
    east = _half_turn(z[1] - nav[1]) * nav[16] * np.cos(0.5 * (z[0] + nav[0]))
    res[:] = np.array([(z[0] - nav[0]) * nav[15], east, nav[2] - z[2]]) - arm


def earth_rate(z, nav, rate, par, cfg, H, res):
    C_bn, lat = nav[6:15].reshape(3, 3).T, nav[0]
    w = cfg[0] * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    res[:], H[:] = z[:3] - C_bn @ w, 0.0
    H[:, 0] = C_bn @ (cfg[0] * np.array([-np.sin(lat), 0.0, -np.cos(lat)])) / nav[15]
    H[:, 6:9] = _attitude_columns(C_bn, w)


def velocity(z, nav, rate, par, cfg, H, res):
    H[:] = 0.0
    H[:, 3:6], res[:] = np.eye(3), z[:3] - nav[3:6]


# --- kernels/kalman.py: errors here are true minus estimated


def arc_term(P, head):
    before, after = P[:2, 8], head[:2, 8]
    grown, across = after @ after - before @ before, np.array([after[1], -after[0]])
    if grown > 0.0:
        head[:2, :2] += 0.75 * grown * np.outer(across, across) / (after @ after)


def fold(P, acc, nav, T):
    m, n, before = acc.shape[1], len(P), P.copy()
    Phi = block_diag(acc[:m], np.eye(n - m))
    P[:] = Phi @ P @ Phi.T
    arc_term(before, P)
    P[:m, :m] += 0.5 * (acc[m : 2 * m] + acc[m : 2 * m].T)
    acc[:m], acc[m : 2 * m] = np.eye(m), 0.0
    C = nav[6:15].reshape(3, 3)
    nav[6:15] = (C @ (1.5 * np.eye(3) - 0.5 * C.T @ C)).ravel()


def is_identity(A):
    return np.array_equal(A, np.eye(*A.shape))


def turns_with_heading(P, velocity):
    across = np.array([-velocity[1], velocity[0]])
    return P[3:5, 8] @ across >= 0.5 * P[8, 8] * across @ across


def attitude_second_order(P, acc, nav, own, work=None):
    """Noise of the vertical velocity by the tilt squared; and the slope of velocity and position by the heading, shrunk
    by the variance of the change of velocity.
    """
    m, tilt = acc.shape[1], P[6:8, 6:8]
    fourth = np.trace(tilt) ** 2 + 2.0 * np.trace(tilt @ tilt)
    acc[m + 5, 5] += 0.25 * 9.7803253359**2 * math.sqrt(6378137.0 / 9.7803253359) * max(acc[2, 5], 0.0) * fourth
    J = acc[3:5] - np.eye(2, m, 3)
    J[:, 8] = 0.0
    variance = np.trace(J @ P[:m, :m] @ J.T) + acc[m + 3, 3] + acc[m + 4, 4]
    square = np.sum(acc[3:5, 8] ** 2)
    if own > 1 or (own and turns_with_heading(P, nav[3:5] - [acc[4, 8], -acc[3, 8]])):
        return
    acc[[0, 1, 3, 4], 8] *= 1.0 - variance / square if square > variance else 0.0


def present(P, acc, nav, inertial, own, work, out):
    P, acc = P.copy(), acc.copy()
    if inertial:
        attitude_second_order(P, acc, nav, own)
    fold(P, acc, nav.copy(), None)
    out[:] = np.concatenate([P[:9, :9].ravel(), np.diag(P)[9:]])


def power(Phi, Q, count, W):
    """Phi^count and its noise in W[0], W[1]."""
    W[0], W[1] = np.eye(len(Phi)), 0.0
    for _ in range(count):
        W[0], W[1] = Phi @ W[0], Phi @ W[1] @ Phi.T + Q


def advance_block(P, x, start, A, B, T):
    here = slice(start, start + len(A))
    Phi = np.eye(len(P))
    Phi[here, here] = A
    P[:] = Phi @ P @ Phi.T
    P[here, here] += B
    x[start - 9 : start - 9 + len(A)] = A @ x[start - 9 : start - 9 + len(A)]


def innovation(P, H, res, R, S, PH, out):
    missing = np.isnan(res)
    a = len(res)
    res[missing], H[missing] = 0.0, 0.0
    PH[:], S[:a] = H @ P, H @ P @ H.T
    own = np.where(missing, 1.0, np.maximum(np.maximum(np.diag(R), 1e-12 * np.diag(S[:a])), 1e-60))
    S[:a] += np.where(np.eye(a) > 0, np.diag(own), np.where(missing | missing[:, None], 0.0, R))
    S[a:] = np.linalg.inv(S[:a])
    out[0], out[1] = res @ S[a:] @ res, np.sum(~missing)


def reset_heading(M, half):
    G = attitude_reset(2.0 * half, len(M))
    M[:] = G @ M @ G.T


def reset_tilts(M, p, q):
    G = tilts_turn(np.array([2.0 * p, 2.0 * q]), len(M))
    M[:] = G @ M @ G.T


def add_turned(M, first, of, x, y, z):
    G = np.eye(len(M))
    G[first : first + 3, of : of + 3] -= skew(np.array([x, y, z]))
    M[:] = G @ M @ G.T


def turn_back(L, lam, by, first):
    G = np.eye(len(L))
    G[first : first + len(by), 8] = by
    L[:], lam[:] = G.T @ L @ G, G.T @ lam


def deviation_change(K, res, first):
    return deviation_turn(K, res, first)[first : first + 4, 8]


def current_change(K, res, first):
    return current_turn(K, res, first)[first : first + 2, 8]


def attitude_reset(turn, n):
    """How a small error changes when the heading it counts from is turned: left Jacobian of the rotation, to second
    order.
    """
    turn = np.array([0.0, 0.0, float(turn)])
    G = np.eye(n)
    G[6:9, 6:9] += skew(turn) / 2 + skew(turn) @ skew(turn) / 6
    return G


def turn_velocity(P, nav, before, change):
    change[:3] = nav[3:6] - before
    G = velocity_turn(change[:3], len(P))
    P[:] = G @ P @ G.T


def velocity_turn(change, n):
    """How the errors of a velocity that is known in the vehicle's axes change with it."""
    G = np.eye(n)
    G[3:6, 6:9] = -skew(change)
    return G


def turn_tilts(P, K, res, change):
    change[:] = K[6:8] @ res
    G = tilts_turn(change, len(P))
    P[:] = G @ P @ G.T


def tilts_turn(change, n):
    """How the attitude's error changes when tilts that it counts from do, to first order."""
    G = np.eye(n)
    G[6:9, 6:9] += skew(np.r_[change, 0.0]) / 2
    return G


def turn_deviation(P, K, res, first):
    G = deviation_turn(K, res, first)
    P[:] = G @ P @ G.T


def deviation_turn(K, res, first):
    """How the errors of a deviation that no reading tells from the heading change with it."""
    G, (sine, cosine, sine_2, cosine_2) = np.eye(len(K)), K[first : first + 4] * res
    G[first : first + 4, 8] = cosine, -sine, 2 * cosine_2, -2 * sine_2
    return G


def turn_current(P, K, res, first):
    G = current_turn(K, res, first)
    P[:] = G @ P @ G.T


def current_turn(K, res, first):
    """How the errors of a current change that turns with the heading, as the velocity does."""
    G, (north, east) = np.eye(len(K)), K[first : first + 2] @ res
    G[first : first + 2, 8] = -east, north
    return G


def correct(P, nav, x, res, S, PH, K, turn, T=None):
    n, a = K.shape
    K[:] = PH.T @ S[a:]
    d = K @ res
    P[:] = P - K @ PH - PH.T @ K.T + K @ S[:a] @ K.T
    turn[0] = feed_back(nav, x, d)
    G = attitude_reset(turn[0], n)
    P[:] = G @ P @ G.T


def feed_back(nav, x, d):
    nav[0] += d[0] / nav[15]
    nav[1] += d[1] / (nav[16] * np.cos(nav[0]))
    nav[2] -= d[2]
    nav[3:6] += d[3:6]
    nav[6:15] = (rotation(d[6:9]) @ nav[6:15].reshape(3, 3)).ravel()
    x += d[9:]
    return d[8]


def memory_offsets(dims):
    a, n, m, b, _, _, par = dims[:7]
    sizes = [
        m * m + b * b,
        a * n,
        a * n,
        a * a,
        a,
        6,
        2 * a * a,
        a * n + a,
        a * (9 + par),
        7 + 2 * a,
        max(m, b, 2 * a) * n + 4 * b * b,
    ]
    return tuple(np.cumsum(sizes))


def store_transition(acc, mem):
    mem[: acc[0].size ** 2] = acc[: acc[0].size].ravel()


def predict(P, nav, x, acc, model, mem, dims, count):
    m, b, start = dims[2:5]
    fold(P, acc, nav, None)
    if b:
        W = np.zeros((2, b, b))
        power(model[0], model[1], count, W)
        mem[m * m : m * m + b * b] = W[0].ravel()
        advance_block(P, x, start, W[0], W[1], None)


def update(P, nav, x, C, R, mem, dims, limits):
    a, n, m, _, start, errors, par = dims[:7]
    at = memory_offsets(dims)
    H, K = mem[at[0] : at[1]].reshape(a, n), mem[at[1] : at[2]].reshape(n, a)
    S, PH = mem[at[5] : at[6]].reshape(2 * a, a), mem[at[6] : at[7] - a].reshape(a, n)
    near, res = mem[at[7] : at[8]].reshape(a, 9 + par), mem[at[3] : at[4]]
    others = np.zeros((a, start - m)), np.zeros((a, n - start - errors - par))
    H[:] = np.hstack([near[:, :9], H[:, 9:m], others[0], C, near[:, 9:], others[1]])
    res -= C @ x[start - 9 : start - 9 + errors]
    out = mem[at[8] :][: 3 + 2 * a]
    out[3 : 3 + a] = res
    innovation(P, H, res, R, S, PH, out)
    out[3 + a :] = np.where(np.isnan(out[3 : 3 + a]), np.nan, np.diag(S[:a]))
    out[2] = float(out[1] > 0 and out[0] <= limits[int(out[1])])
    if out[1] and not out[2] and np.isfinite(limits[0]):
        out[2] = fits_without_some(P, H.copy(), res.copy(), np.isnan(out[3 : 3 + a]), H, R, S, PH, res, out, limits)
    if out[2]:
        correct(P, nav, x, res, S, PH, K, mem[at[4] : at[4] + 1])
        if dims[7] > 0:
            turn_deviation(P, K[:, 0], res[0], dims[7])
        mem[at[2] : at[3]] = S[a:].ravel()


def fits_without_some(P, whole, given, missing, H, R, S, PH, res, out, limits):
    """Leave out the component without which the NIS is least, and the next, as long as more than a share remains."""

    def form(left):
        H[:], res[:] = whole, np.where(missing | left, np.nan, given)
        innovation(P, H, res, R, S, PH, out)
        return out[0]

    left, least = np.zeros(len(given), bool), limits[0] * np.sum(~missing)
    while np.sum(~missing & ~left) - 1 > least:
        rest = np.flatnonzero(~missing & ~left)
        nis = [form(left | (np.arange(len(given)) == i)) for i in rest]
        left[rest[np.argmin(nis)]] = True
        if form(left) <= limits[int(out[1])]:
            out[3 + len(left) :][left] = np.nan
            return 1.0
    form(np.zeros(len(given), bool))
    return 0.0


def smooth_record(L, lam, record, a, m, b, start, deviation, T):
    """Adjoint of fold, tick, correction and reset, backward: Bierman (1973)."""
    n = len(lam)
    sizes = [m * m, b * b] + ([a * n, n * a, a * a, a, 6] if a else [])
    parts = np.split(record[: sum(sizes)], np.cumsum(sizes)[:-1])
    if a:
        H, K, Sinv = parts[2].reshape(a, n), parts[3].reshape(n, a), parts[4].reshape(a, a)
        turned = deviation_turn(K[:, 0], parts[5][0], deviation) if deviation > 0 else np.eye(n)
        turned = current_turn(K, parts[5], -deviation) if deviation < 0 and parts[6][1:4].any() else turned
        turned = tilts_turn(parts[6][4:], n) @ turned @ velocity_turn(parts[6][1:4], n)
        D = turned @ attitude_reset(parts[6][0], n) @ (np.eye(n) - K @ H)
        lam[:] = D.T @ lam - H.T @ Sinv @ parts[5]
        L[:] = D.T @ L @ D + H.T @ Sinv @ H
    for first, size, part in ((start, b, parts[1]), (0, m, parts[0])):
        Phi = np.eye(n)
        Phi[first : first + size, first : first + size] = part.reshape(size, size)
        lam[:], L[:] = Phi.T @ lam, Phi.T @ L @ Phi


def smooth_row(P, L, lam, mean, cov, T):
    mean[:], cov[:] = -P @ lam, P - P @ L @ P


def drive_step(L, lam, nav, first, out):
    C = nav[6:15].reshape(3, 3)
    for k in range(out.shape[1]):
        at = first if k < 3 else 6
        e = np.zeros(len(lam))
        e[at : at + 3] = C[:, k % 3]
        told = e @ L @ e
        out[:, k] = (e @ lam / told, told**-0.5) if told > 0.0 else np.nan


def smooth_run(L, lam, records, begins, heads, rows, firsts, holds, index, until, means, covs, carried, steps, T, U):
    n = len(lam)
    for after in range(index, until - 1, -1):
        for q in np.flatnonzero(holds == after):
            P = np.zeros((n, n))
            P[np.tril_indices(n)] = rows[firsts[q] + 8 + n :][: n * (n + 1) // 2]
            P += np.tril(P, -1).T
            smooth_row(P, L, lam, means[q], covs[q], None)
            drive_step(L, lam, rows[firsts[q] :], carried, steps[q])
        if after > until:
            smooth_record(L, lam, records[begins[after - 1] :], *heads[after - 1], None)


def cholesky_solve(S, Y):
    """S^-1 Y in whatever precision the arrays have."""
    L = np.zeros_like(S)
    for j in range(len(S)):
        L[j, j] = np.sqrt(S[j, j] - L[j, :j] @ L[j, :j])
        L[j + 1 :, j] = (S[j + 1 :, j] - L[j + 1 :, :j] @ L[j, :j]) / L[j, j]
    Y = np.array(Y, S.dtype)
    for j in range(len(S)):
        Y[j] = (Y[j] - L[j, :j] @ Y[:j]) / L[j, j]
    for j in range(len(S) - 1, -1, -1):
        Y[j] = (Y[j] - L[j + 1 :, j] @ Y[j + 1 :]) / L[j, j]
    return Y


def rts(records, P0):
    """Sample-by-sample Rauch-Tung-Striebel (1965), in extended precision because it inverts predicted covariances.

    `records`: one (Phi, Q, H or None, R, residual, reset) per sample. Returns smoothed corrections to the forward state
    and their covariances: at the start, and after each sample.
    """
    wide, n = np.longdouble, len(P0)
    P, forward = np.asarray(P0, wide), []
    for record in records:
        Phi, Q, H, R, res, G = (None if part is None else np.asarray(part, wide) for part in record)
        predicted = Phi @ P @ Phi.T + Q
        filtered, K = np.zeros(n, wide), np.zeros((n, 1), wide)
        H = np.zeros((1, n), wide) if H is None else H
        if R is not None:
            K = cholesky_solve(H @ predicted @ H.T + R, H @ predicted).T
            filtered = K @ res
        forward.append((P, predicted, Phi, filtered, G))
        P = G @ (predicted - K @ H @ predicted) @ G.T
        P = (P + P.T) / 2
    means, covariances = [np.zeros(n, wide)], [P]
    for before, predicted, Phi, filtered, G in forward[::-1]:
        back = np.asarray(np.linalg.inv(G.astype(float)), wide)
        # the smoothed state after this sample, seen from its prediction, before feedback and reset
        after, covariance = filtered + back @ means[-1], back @ covariances[-1] @ back.T
        gain, unsure = np.zeros((n, n), wide), np.diag(predicted) > 0  # states of zero variance stay as they are
        gain[:, unsure] = cholesky_solve(predicted[np.ix_(unsure, unsure)], (Phi @ before)[unsure]).T
        means.append(gain @ after)
        covariances.append(before + gain @ (covariance - predicted) @ gain.T)
    return means[::-1], covariances[::-1]


def stationary(a, c, P):
    m, g = len(a), c - a
    M = np.eye(m, k=1)
    M[:, :1] -= a[:, None]
    if m and np.abs(np.linalg.eigvals(M)).max() >= 1.0:
        return False
    P[:] = np.linalg.solve(np.eye(m * m) - np.kron(M, M), np.outer(g, g).ravel()).reshape(m, m)
    return True


def channel_filter(y, thetas, chains, sees, rules, first, E, V, values):
    """Each model by itself."""
    for k, (theta, chain) in enumerate(zip(thetas, chains, strict=True)):
        e, S = np.empty(len(y)), np.empty(len(y))
        values[k] = one_channel(y, theta, chain, sees, rules, first, e, S)
        if len(E):
            E[:, k], V[:, k] = e, S


def one_channel(y, theta, chain, sees, rules, first, e, variance):
    return One().go(y, theta, chain, sees, rules, first, e, variance)


class One:
    """The filter of one model of a channel, which goes on from call to call."""

    def __init__(self):
        self.gap, self.x, self.P, self.A, self.rows = math.inf, None, None, None, []

    def go(self, y, theta, chain, sees, rules, first, e, variance):
        r, m = len(sees), (len(theta) - 1) // 2
        d, longest, clip, white = int(rules[0]), rules[1], rules[2], rules[3]
        a, c, var = theta[:m], theta[m:-1], np.exp(2 * theta[-1])
        F, W, start = np.zeros((r + m, r + m)), np.zeros((r + m, r + m)), np.zeros((r + m, r + m))
        F[:r, :r], F[r:, r:] = chain[0], np.eye(m, k=1)
        F[r:, r : r + 1] -= a[:, None]
        shared = np.r_[np.zeros(r), var * (c - a)]  # covariance of process and measurement noise
        W[:r, :r], W[r:, r:] = chain[1], np.outer(shared, shared)[r:, r:] / var
        h = np.r_[sees, np.eye(m)[:1].ravel()]
        start[d:r, d:r] = chain[2][d:, d:]
        unit = np.zeros((m, m))
        if not stationary(a, c, unit):
            return math.inf
        start[r:, r:] = var * unit
        total, x, P, A, rows = 0.0, self.x, self.P, self.A, self.rows
        for t in range(len(y)):
            e[t], variance[t] = np.nan, 1.0
            if np.isnan(y[t]):
                self.gap += 1
                if self.gap <= longest:
                    x, P, A = F @ x, F @ P @ F.T + W, F @ A
                continue
            if self.gap > longest:  # a new segment: some states diffuse (columns A), ARMA error stationary
                x, P, A, rows = np.zeros(r + m), start, np.eye(r + m)[:, :d], []
            self.gap = 0
            v, S = y[t] - h @ x, h @ P @ h + var + white
            K = (F @ P @ h + shared) / S
            z = v / np.sqrt(S)
            if len(rows) < d:
                rows.append(np.r_[h @ A, v] / np.sqrt(S))
                x, A, P = F @ x + K * v, F @ A - np.outer(K, h @ A), F @ P @ F.T + W - S * np.outer(K, K)
                if len(rows) == d:
                    X = np.linalg.inv(np.array(rows)[:, :d])
                    x, P = x + A @ X @ np.array(rows)[:, d], P + A @ X @ X.T @ A.T
                continue
            e[t], variance[t] = z, S
            if t >= first:
                total += 0.5 * np.log(2 * np.pi * S) + (z * z / 2 if abs(z) <= clip else clip * abs(z) - clip**2 / 2)
            x, P = F @ x + K * np.sqrt(S) * np.clip(z, -clip, clip), F @ P @ F.T + W - S * np.outer(K, K)
        self.x, self.P, self.A, self.rows = x, P, A, rows
        return total


def channel_scores(E, V, steps, clip, info, gradient):
    known, k = np.isfinite(E[:, 0]), len(steps)
    z, S = E[known, 0], V[known, 0]
    ds = (V[known, 1 : k + 1].T - S) / S / steps[:, None]
    dz = (E[known, 1 : k + 1].T - z) / steps[:, None]
    dv = dz + 0.5 * z * ds
    gradient[:] = dz @ np.clip(z, -clip, clip) + 0.5 * ds.sum(1)
    info[:] = dv @ dv.T + 0.5 * ds @ ds.T


def matrix_product(A, B, out):
    out[:] = A @ B


def matrix_product_transposed(A, B, out):
    out[:] = A @ B.T


def slow_part(slow, log_sd, log_tau, rate_s, chain):
    """The cascade ``x' = -b x + b (the next one)``, its last driven by white noise."""
    b = rate_s / np.exp(log_tau)
    A, drive = b * (np.eye(slow, k=1) - np.eye(slow)), np.eye(slow)[-1]
    density = (2.0 if slow == 1 else 4.0) * b * np.exp(2 * log_sd)
    places, weights = np.polynomial.legendre.leggauss(40)
    ways = [expm(0.5 * (place + 1.0) * A) @ drive for place in places]
    own = np.ix_(range(3), range(-slow, 0), range(-slow, 0))
    Q = density * sum(0.5 * weight * np.outer(way, way) for weight, way in zip(weights, ways, strict=True))
    chain[own] = [expm(A), Q, solve_continuous_lyapunov(A, -density * np.outer(drive, drive))]


def padded(row, p, slow, drift, belief):
    """Parameters of the fast part and the chain of a model."""
    r, fast = drift.shape[1], row[:-2] if slow else row
    ar, ma = fast[:p], fast[p:-1]
    m = max(len(ar), len(ma))
    chain = np.zeros((3, r + slow, r + slow))
    chain[:, :r, :r] = drift
    if slow:
        slow_part(slow, row[-2], row[-1], belief[0], chain)
    return np.r_[ar, np.zeros(m - len(ar)), ma, np.zeros(m - len(ma)), fast[-1]], chain


def channel_values(y, rows, p, slow, drift, sees, rules, belief, first, E, V, values):
    for k, row in enumerate(rows):
        theta, chain = padded(row, p, slow, drift, belief)
        e, S = np.empty(len(y)), np.empty(len(y))
        values[k] = one_channel(y, theta, chain, sees, rules, first, e, S)
        if slow:
            off = (row[-2] - belief[1] - belief[3]) / belief[4], (row[-1] - belief[5]) / belief[6]
            values[k] -= belief[2] - 0.5 * np.sum(np.square(off))
        if len(E) and k < E.shape[1]:
            E[:, k], V[:, k] = e, S


def difference_steps(theta, p, slow, differences, steps):
    steps[:] = differences[0]
    for i in range(p):
        moved = ((size, np.roots([1.0, *theta[:p] + size * np.eye(len(theta))[i, :p]])) for size in differences[:-1])
        steps[i] = next(size for size, roots in moved if abs(roots).max() < 1.0)
    if slow:
        steps[-2:] = differences[-1]


def channel_point(y, rows, p, slow, drift, sees, rules, belief, differences, E, V, values, info, gradient):
    k = rows.shape[1]
    steps = np.empty(k)
    difference_steps(rows[0], p, slow, differences, steps)
    rows[1 : k + 1] = rows[0] + np.diag(steps)
    channel_values(y, rows, p, slow, drift, sees, rules, belief, 0, E, V, values)
    channel_scores(E, V, steps, rules[2], info, gradient)
    if slow:
        spreads = np.array([belief[4], belief[6]])
        gradient[-2:] += (rows[0, -2:] - [belief[1] + belief[3], belief[5]]) / spreads**2
        info[-2:, -2:] += np.diag(1.0 / spreads**2)


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
    """Lanes of `One` filters, one after the other; `state` is a list of them, and knows what is missing itself."""
    k = len(theta)
    for begin in range(0, len(y), 32):
        part = y[begin : begin + 32]
        rows = np.vstack([theta, theta + np.diag(steps), stands])
        E, V, values = *np.empty((2, len(part), k + 2)), np.empty(k + 2)
        for lane, (row, one) in enumerate(zip(rows, state, strict=True)):
            model = padded(row, p, slow, drift, belief)
            values[lane] = one.go(part, *model, sees, rules, 0, E[:, lane], V[:, lane])
        told[:] = told[0] + values[0], max(told[1] + values[-1] - values[0], -least)
        own, gradient = np.empty((k, k)), np.empty(k)
        channel_scores(E, V, steps, rules[2], own, gradient)
        left = keep ** len(part) if keep > 0.0 else 1.0
        info[:] = left * info + own
        if keep > 0.0:
            gradient += (1.0 - left) * known * (theta - centre)
            whole = info + np.diag(known)
            step = -np.linalg.solve(whole, gradient)
            trial = (theta + step / max(np.sqrt(step @ whole @ step), 1.0))[None]
            confine(trial, p, k - 1 - p - 2 * bool(slow), limits)
            theta[:] = trial[0]


def damped_steps(theta, gradient, info, dampings, sizes, converged, longest, moved, gains):
    for n, damping in enumerate(dampings):
        step = -np.linalg.solve(info + damping * np.diag(np.maximum(np.diag(info), 1e-9)), gradient)
        gain = -0.5 * step @ gradient
        if not gain > converged:
            return n
        gains[n], moved[n] = gain, theta + step * min(1.0, longest / np.abs(step[sizes:]).max())
    return len(dampings)


# ---------------------------------------------------------------- kernels/listen.py: what an open loop would have read


def carry_feedback(undone, Phi):
    """Position, velocity and acceleration fed back, a chain of integrators; heading and the drive's states by Phi."""
    m, dt = len(Phi), Phi[0, 3]
    p, v, v_b, a, a_b = undone[:3], undone[3:6], undone[m : m + 3], undone[m + 3 : m + 6], undone[m + 6 : m + 9]
    p[:], v[:], v_b[:] = p + dt * v + 0.5 * dt**2 * a, v + dt * a, v_b + dt * a_b
    undone[8] += Phi[8, 9:] @ undone[9:m]
    undone[9:m] = Phi[9:, 9:] @ undone[9:m]


def judge_level(ear, nis, dof):
    """ear: kind, noted, capacity, due, factor, level, then the odds of seven levels."""
    levels, odds = 2.0 ** np.arange(7), ear[6:13]
    before = (1.0 - 4e-5) * odds + 4e-5 / 7
    most = round(float(chi2.ppf(chi2.cdf(9.0, 1), dof)), 2)
    log = np.log(before) - 0.5 * (dof * np.log(levels) + ear[5] * min(nis, most) / levels)
    odds[:] = np.exp(log - np.logaddexp.reduce(log))


def after_reading(ear, nis, dof, ticks, learning):
    """ear: as above, then mount. True: another level, or ticks enough."""
    ear[1] += len(range(int(ear[2]))[: max(ticks - 1, 0)]) + 1
    if not learning:
        return False
    changed = False
    if ear[4] and dof and np.isfinite(nis):
        judge_level(ear, nis, dof)
        changed = not 1.0 / ear[4] <= ear[6:13] @ 2.0 ** np.arange(7) / ear[5] <= ear[4]
    return bool(changed or ear[1] >= ear[3])


def sum_likelihood(y, length, skipped, F, Q, C, P, r):
    """One filter with a sum beside its states, tick by tick."""
    n, total, count, logs, done = len(C), 0.0, 0, 0.0, 0
    x, cov = np.zeros(n + 1), np.zeros((n + 1, n + 1))
    cov[:n, :n] = P
    move, add, noise = np.eye(n + 1), np.eye(n + 1), np.zeros((n + 1, n + 1))
    move[:n, :n], add[n, :n], noise[:n, :n] = F, C, Q
    for first in range(0, y.size - length + 1, length):
        stretch = y[first : first + length]
        for value in stretch:
            x, cov = move @ x, move @ cov @ move.T + noise
            if np.isfinite(value):
                x, cov = add @ x, add @ cov @ add.T
        read = np.isfinite(stretch).sum()
        if read:
            S, e = cov[n, n] + read * r, np.nansum(stretch) - x[n]
            if done >= skipped:
                total, count, logs = total - 0.5 * (e**2 / S + np.log(S)), count + 1, logs + np.log(S)
            x, cov, done = x + cov[:, n] * e / S, cov - np.outer(cov[:, n], cov[:, n]) / S, done + 1
        x[n] = cov[n] = cov[:, n] = 0.0
    return total, count, logs


def record_residual(undone, mem, dims, places, nav, C, x, kind, mount, ring, cursor, ticks, Cr, gravity):
    a, n, m, _, start, errors, par = dims[:7]
    at, capacity = places, ring.shape[1]
    K, res, near = mem[at[1] : at[2]].reshape(n, a), mem[at[3] : at[4]], mem[at[7] : at[8]].reshape(a, 9 + par)
    used, C_nb, own = mem[at[8] + 2] != 0, nav[6:15].reshape(3, 3), slice(start, start + errors)
    (still, late_s, clock, _, asked), axes = mount[:5], mount[5:].reshape(-1, 3)
    carry_feedback(undone, mem[: m * m].reshape(m, m))
    d = K @ res * used
    if asked:
        off, variance = mem[at[8] + 3 :][:a], mem[at[8] + 3 + a :][:a]
        told = variance > 0
        undone[2 * m + int(asked)] -= 0.5 * np.sum(
            np.minimum(off[told] ** 2 / variance[told], 25.0) + np.log(variance[told])
        )
    if kind:
        before = x[start - 9 : start - 9 + errors] - d[own]
        closed = mem[at[8] + 3 : at[8] + 3 + a] + C @ before
        constants = (x[start - 9 + errors :] - d[start + errors :])[:par] if len(ring) > a + 1 else np.zeros(0)
        if 0 <= clock < constants.size:
            late_s = late_s + constants[int(clock)]
        gone = late_s * (undone[3:6] - 0.5 * late_s * undone[m + 3 : m + 6])
        open_loop = {
            1: undone[[8]],
            2: near[:, :3] @ (undone[:3] - gone),
            3: axes @ (undone[m : m + 3] - late_s * undone[m + 6 : m + 9]) if kind == 3 else None,
        }
        value = closed + open_loop[kind][:a]
        if kind == 3 and np.linalg.norm(closed + axes @ C_nb.T @ (nav[3:6] - d[3:6])) < still:
            value[:] = np.nan
        noted = [*value, undone[2 * m], *constants, *(near[:, 9:].ravel() if constants.size else ())]
        for column in [*[np.full(len(ring), np.nan)] * min(ticks - 1, capacity), noted]:
            ring[:, cursor[0] % capacity] = column
            cursor[0] += 1
    if not used:
        return
    inertial = gravity > 0
    tilt, force = gravity * np.array([-d[7], d[6], 0.0]), -inertial * Cr[3:, :-1] @ d[9:m]
    heading = np.arctan2(C_nb[1, 0], C_nb[0, 0])
    undone[:3] += d[:3]
    undone[3:6] += inertial * d[3:6]
    undone[8:m] += d[8:m]
    undone[m : m + 3] += C_nb.T @ (d[3:6] + np.cross(nav[3:6], d[6:9]))
    undone[m + 3 : m + 6] += tilt + C_nb @ force
    undone[m + 6 : m + 9] += rotation(heading * DOWN).T @ tilt + force
    undone[2 * m] += C_nb[2] @ force - force[2]


# ---------------------------------------------------------------- kernels/measurement.py: through water that moves


def water_velocity(z, nav, rate, par, cfg, H, res):
    first = int(cfg[12])
    relative, current, plain = nav.copy(), np.array([par[0], par[1], 0.0]), np.zeros((3, 9 + len(par) - first))
    relative[3:6] -= current
    body_velocity(z, relative, rate, par[first:], cfg, plain, res)
    H[:, :9], H[:, 9:11], H[:, 11 : 9 + first] = plain[:, :9], -plain[:, 3:5], 0.0
    H[:, 9 + first :] = plain[:, 9:]


# ---------------------------------------------------------------- kernels/measurement.py: beams of a DVL


def beam_velocity(z, nav, rate, par, cfg, H, res):
    first, D = int(cfg[24]), cfg[12:24].reshape(4, 3)
    current, still = np.zeros(2), np.zeros(3)
    current[:first] = par[:first]
    over, through, gap = np.zeros((3, 9 + len(par) - first)), np.zeros((3, 11 + len(par) - first)), np.zeros((2, 3))
    body_velocity(still, nav, rate, par[first:], cfg, over, gap[0])
    water_velocity(still, nav, rate, np.concatenate([current, par[first:]]), np.append(cfg[:12], 2.0), through, gap[1])
    H[:4] = D @ np.insert(over, [9] * first, 0.0, axis=1)
    H[4:] = D @ np.delete(through, [9, 10][: 2 - first], axis=1)
    res[:] = z[:8] + np.concatenate([D @ gap[0], D @ gap[1]])


# ---------------------------------------------------------------- kernels/measurement.py: acoustic positioning


def earth_axes(latitude, longitude, height, radius, e2):
    """Rows north, east and down in the Earth's axes, and the point there."""
    north = np.array([-np.sin(latitude) * np.cos(longitude), -np.sin(latitude) * np.sin(longitude), np.cos(latitude)])
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    down = np.cross(north, east)
    across = radius / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    return np.array([north, east, down]), -(across + height) * down - [0.0, 0.0, e2 * across * np.sin(latitude)]


def slant_range(z, nav, rate, par, cfg, H, res):
    k, (scale, offset, place) = int(z[1]), cfg[5:8].astype(int)
    A, p = earth_axes(*nav[:3], *cfg[:2])
    arm = nav[6:15].reshape(3, 3) @ cfg[2:5]
    here = slice(place + 3 * k, place + 3 * k + 3)
    d = A @ (cfg[8 + 3 * k : 11 + 3 * k] - p) + (par[here] if place >= 0 else 0.0) - arm
    distance = np.linalg.norm(d)
    u, g = d / distance, 1.0 + (par[scale] if scale >= 0 else 0.0)
    H[:] = 0.0
    H[0, :3], H[0, 6:9] = -g * u, -g * np.cross(arm, u)
    if scale >= 0:
        H[0, 9 + scale] = distance
    if offset >= 0:
        H[0, 9 + offset + k] = 1.0
    if place >= 0:
        H[0, 9:][here] = g * u
    res[0] = z[0] - g * distance - (par[offset + k] if offset >= 0 else 0.0)


def usbl(z, nav, rate, par, cfg, H, res):
    scale, turned, ship = cfg[5:8].astype(int)
    A, p = earth_axes(*nav[:3], *cfg[:2])
    T, arm = z[6:15].reshape(3, 3), nav[6:15].reshape(3, 3) @ cfg[2:5]
    astray = par[ship : ship + 3] if ship >= 0 else np.zeros(3)
    mis, changes = rotation_and_changes(par[turned : turned + 3] if turned >= 0 else np.zeros(3))
    d = T @ (p - z[3:6] + A.T @ (arm + astray))
    e = mis @ d
    r, distance, g = np.linalg.norm(e), np.linalg.norm(d), 1.0 + (par[scale] if scale >= 0 else 0.0)
    bearing, elevation = np.nan_to_num(z[1:3])
    across = np.array([-np.sin(bearing), np.cos(bearing), 0.0])
    sight = np.array([np.cos(elevation) * np.cos(bearing), np.cos(elevation) * np.sin(bearing), np.sin(elevation)])
    flat = (np.eye(3) - np.outer(e, e) / r**2) / r
    J = np.array([np.zeros(3), across @ flat, np.cross(sight, across) @ flat])
    res[:] = z[0] - g * distance, -across @ e / r, -np.cross(sight, across) @ e / r
    if sight @ e < 0.0:
        res[1:] = np.pi
    res[1:][np.isnan(z[1:3]) | np.isnan(z[1])] = np.nan
    H[:] = 0.0
    H[:, :3] = J @ mis @ T @ A.T
    H[0, :3] = g * d / distance @ T @ A.T
    H[:, 6:9] = -H[:, :3] @ skew(arm)
    if scale >= 0:
        H[0, 9 + scale] = distance
    if turned >= 0:
        H[:, 9 + turned : 12 + turned] = np.column_stack([J @ change @ d for change in changes])
    if ship >= 0:
        H[:, 9 + ship : 12 + ship] = H[:, :3]


# ---------------------------------------------------------------- kernels/measurement.py: AHRS, a receiver's velocity


def _angles(C):
    return np.array([np.arctan2(C[2, 1], C[2, 2]), -np.arctan2(C[2, 0], np.hypot(*C[:2, 0])), np.arctan2(*C[1::-1, 0])])


def attitude(z, nav, rate, par, cfg, H, res):
    plain = nav[6:15].reshape(3, 3) @ cfg[1:10].reshape(3, 3)
    turn, by = rotation_and_changes(par if len(par) else np.zeros(3))
    C = plain @ turn.T
    res[:] = z[:3] - _angles(C) + [0.0, 0.0, cfg[0]]
    res[[0, 2]] = _half_turn(res[[0, 2]])
    H[:] = 0.0
    changes = [skew(axis) @ C for axis in np.eye(3)] + [plain @ change.T for change in by][: len(par)]
    for j, D in enumerate(changes):
        tilt = C[:, 0] + 1e-20j * D[:, 0]  # an imaginary step: the derivative is exact to rounding
        H[:, 6 + j] = [
            (C[2, 2] * D[2, 1] - C[2, 1] * D[2, 2]) / (C[2, 1:] @ C[2, 1:]),
            -np.imag(np.arctan(tilt[2] / np.sqrt(tilt[0] ** 2 + tilt[1] ** 2))) / 1e-20,
            (C[0, 0] * D[1, 0] - C[1, 0] * D[0, 0]) / (C[:2, 0] @ C[:2, 0]),
        ]


def ground_velocity(z, nav, rate, par, cfg, H, res):
    w = nav[6:15].reshape(3, 3) @ np.cross(rate, cfg)
    H[:] = 0.0
    H[:, 3:6], H[:, 6:9], res[:] = np.eye(3), -skew(w), z[:3] - nav[3:6] - w


def altitude(z, nav, rate, par, cfg, H, res):
    arm = nav[6:15].reshape(3, 3) @ cfg[:3]
    H[:] = 0.0
    H[0, 2], H[0, 6:9], H[0, 9:] = -1.0, skew(arm)[2], -1.0
    res[0] = z[0] - (nav[2] - arm[2] - cfg[3] - par.sum())


def _mean_motion(motion, begin, end):
    ends = np.cumsum(motion[:, 0])
    inside = np.clip(np.minimum(ends, end) - np.maximum(ends - motion[:, 0], begin), 0.0, None)
    if inside.any():
        return inside @ motion[:, 1:] / inside.sum()
    known = motion[motion[:, 0] > 0, 1:]
    return known[-1] if len(known) else np.zeros(6)


def _motion_about(motion, late_s, window_s):
    """Middle of a window, mean there and growth of the motion."""
    half = 0.5 * window_s
    centre = max(late_s, half)
    older, newer = _mean_motion(motion, centre, centre + half), _mean_motion(motion, centre - half, centre)
    return centre, 0.5 * (older + newer), (newer - older) / half


def earlier(nav, motion, gravity, late_s, window_s, slope_s, then, turn, slope, B):
    (centre, mean, growth), down = _motion_about(motion, late_s, window_s), gravity * DOWN
    rate, ahead = mean[:3] + (centre - late_s) * growth[:3], mean.copy()
    ahead[:3] += (centre - 0.5 * late_s if late_s < 0 else 0.0) * growth[:3]
    begins = np.cumsum(motion[:, 0]) - motion[:, 0]
    pieces = [(min(s, late_s - begin), m) for s, begin, m in zip(motion[:, 0], begins, motion[:, 1:], strict=True)]
    pieces = [(dt, m) for dt, m in pieces if dt > 0]
    pieces.append((late_s - sum(dt for dt, _ in pieces), ahead))
    counts = [int(np.ceil(abs(dt) / 0.02)) for dt, _ in pieces]
    pieces = [(dt / n, m) for (dt, m), n in zip(pieces, counts, strict=True) for _ in range(n)]
    C, v, way, once, twice = nav[6:15].reshape(3, 3), nav[3:6], np.zeros(3), np.zeros(3), np.zeros(3)
    for dt, m in pieces:
        force = C @ rotation(-0.5 * dt * m[:3]) @ m[3:]
        way, twice = way + dt * v - 0.5 * dt**2 * (force + down), twice + dt * once + 0.5 * dt**2 * force
        C, v, once = C @ rotation(-dt * m[:3]), v - dt * (force + down), once + dt * force
    then[:] = nav
    _displace(then, -way)
    then[3:6], then[6:15] = v, C.ravel()
    over_s = min(slope_s, max(2.0 * late_s, window_s))
    centre, mean, growth = _motion_about(motion, late_s, over_s)
    mean[:3] += (centre - late_s) * growth[:3]
    turn[:] = np.concatenate([rate, growth[:3]])
    push = C @ mean[3:] + down
    slope[:] = np.concatenate([v, push, C @ mean[:3]]), np.concatenate([push, C @ growth[3:], C @ growth[:3]])
    B[:] = np.eye(9)
    B[:3, 3:6], B[:3, 6:], B[3:6, 6:] = -late_s * np.eye(3), -skew(twice), skew(once)
    return over_s


def _displace(nav, d):
    """Move by metres in n, radii growing with the height alone."""
    nav[1] += d[1] / (nav[16] * np.cos(nav[0] + 0.5 * d[0] / nav[15]))
    nav[0] += d[0] / nav[15]
    nav[2] -= d[2]
    nav[15:17] -= d[2]


def has_jumped(drv):
    return any(drv[strapdown_kernels.JUMPED : strapdown_kernels.JUMPED + 4])


def until_odd(drv, samples):
    """Up to the first that differs from the one before, or that may not be a reading."""
    if drv[strapdown_kernels.ODD_HEADING] or drv[strapdown_kernels.ODD_VELOCITY]:
        return min(1, len(samples))
    before = np.append(
        drv[strapdown_kernels.PREVIOUS_RPY + 2],
        drv[strapdown_kernels.GOOD_VELOCITY : strapdown_kernels.GOOD_VELOCITY + 3],
    )
    for n, now in enumerate(samples[:, 3:7]):
        turned = abs((now[0] - before[0] + np.pi) % (2.0 * np.pi) - np.pi)
        calm = (
            turned <= strapdown_kernels.SCATTER_RAD
            and (np.abs(now[1:] - before[1:]) <= strapdown_kernels.SCATTER_M_S).all()
        )
        if not calm or not (now[1:].any() or drv[strapdown_kernels.ZERO_IS_VALID]):
            return n + 1
        before = now
    return len(samples)


def check_samples(samples, w, sd, limits, period_s, increments):
    unit = w[6]
    unit[1] = 0.0
    for n, (dt, *values) in enumerate(samples):
        gap, dt_or_1 = not 0.2 * period_s < dt < 3.0 * period_s, dt if increments else 1.0
        for a, raw, s, limit in zip(w[:6], values, sd, limits, strict=True):
            _look_at_axis(a, unit, raw, raw / dt_or_1, s, limit, dt, gap, period_s, period_s if increments else 1.0)
        _look_at_gravity(w, unit, dt)
        rest = np.concatenate([np.zeros(3), unit[5:8] * dt_or_1])
        samples[n, 1:] = np.where(w[:6, 0] > 1, rest, values)
        unit[5:8] += np.cross(unit[5:8], samples[n, 1:4] / dt_or_1 * dt)
        unit[0] += 1.0
        if unit[0] * period_s >= 1.0:
            unit[1] = 1.0
        if unit[1]:
            return n + 1
    return len(samples)


def _look_at_axis(a, unit, raw, x, sd, limit, dt, gap, period_s, per):
    white, seen = 6.0 * sd**2, a[12]
    same = raw == a[3] and seen > 0
    if seen > 0 and abs(raw - a[3]) > 1e-9 * abs(raw):
        a[6] = min(a[6], abs(raw - a[3]))
    if not same or a[0] <= 1:
        a[5] += (same - a[5]) / 2000.0
    a[4], a[3] = a[4] + 1 if same else 1.0, raw
    level = max(a[10], white)
    if seen >= 2 and not gap:
        off = a[7] - 0.5 * (x + a[8])
        lonely = off**2 > 24.0 * level > 0.0 and abs(x - a[8]) < 0.5 * abs(off)
        if lonely and seen * period_s > 10.0 and a[0] == 0:
            a[14], a[15], unit[1] = a[14] + 1, off, 1.0
        square = min(4.0 * off**2, 16.0 * level)
        a[10] += (square - a[10]) * min(1.0, max(period_s / 0.5, 1.0 / seen))
        if a[4] < 3 and a[0] <= 1:
            bound = 16.0 * max(a[11], white) if seen * period_s > 10.0 else np.inf
            a[11] += (min(square, bound) - a[11]) * max(period_s / 600.0, 1.0 / seen if a[0] == 0 else 0.0)
    a[12] = seen = seen + 1
    a[7], a[8] = x, x if gap else a[7]
    a[13] += (x - a[13]) * min(1.0, max(dt / 0.1, 1.0 / seen))
    found, since_s = _found(a, raw, x, sd, limit, white, seen, period_s, per)
    if a[4] == 1:
        a[9] = max(a[9], abs(x))
    usual = max(a[11], white)
    if found == 0 and seen * period_s > 10.0 and usual > 0 and period_s <= 0.025:
        ratio = a[10] / usual
        if ratio > (9.0 if a[0] in (1, 5, 6) else 25.0):
            grave = ratio > 900.0 or a[0] in (5, 6)
            found, since_s = (6 if 2025.0 < ratio < 4900.0 else 5) if grave else 1, 0.1
    if found > 1 or (found and a[0] != 12):
        a[2] = 0.0
        if a[0] < found and a[0] in (0, 1, 5):
            a[0], a[1], unit[1] = found, since_s, 1.0
    elif 0 < a[0] < 7 or a[0] == 12:
        a[2] += dt
        if a[2] >= 1.0:
            a[0], unit[1] = 0.0, 1.0


def _found(a, raw, x, sd, limit, white, seen, period_s, per):
    run, since_s = a[4], a[4] * period_s
    if run >= 3 and abs(x) >= limit:
        return 4, since_s
    if run < 10 or since_s < 0.1 or a[11] <= 0.04 * white:
        return 0, 0.0
    by_noise = special.erf(a[6] / (sd * per * np.sqrt(8.0))) ** 2 if sd > 0 else 0.0
    repeats = max(a[5], by_noise, 1e-300)
    if repeats >= 1.0 or run * np.log(repeats) >= np.log(1e-12):
        return 0, 0.0
    return (3 if raw == 0 else 4 if abs(x) >= a[9] else 2), since_s


def _look_at_gravity(w, unit, dt):
    accel, g = w[3:6], unit[8]
    apart = np.abs(accel[:, 13] - unit[5:8])
    off = np.any((accel[:, 0] <= 1) & (apart > 0.7 * g)) and unit[4]
    unit[2] = unit[2] + dt if off else 0.0
    unit[3] = unit[3] + dt if np.all(apart < 0.35 * g) else 0.0
    if unit[2] >= 0.3:
        size = np.linalg.norm(accel[:, 13])
        found = 8 if size < 0.05 * g else 10 if abs(size - 1) < 0.2 else 9 if abs(size - g) < 0.2 * g else 7
        accel[accel[:, 0] <= 1, :2] = found, 0.4
        unit[2], unit[1] = 0.0, 1.0
    elif unit[3] >= 1.0 and np.any((accel[:, 0] >= 7) & (accel[:, 0] <= 10)):
        accel[(accel[:, 0] >= 7) & (accel[:, 0] <= 10), 0] = 0.0
        unit[1] = 1.0


def largest_change(looks, now, walk, begin):
    added = walk * (now[0] - looks[:, [0]])
    lost = np.maximum(looks[:, 7:10] + added - now[7:10], 0.0)
    nis = np.cumsum([now[10], *looks[::-1, 10]])[:0:-1] / np.arange(len(looks) + 1, 1, -1)
    moved = (now[4:7] - looks[:, 4:7]) ** 2 / np.maximum(lost * np.maximum(nis, 1.0)[:, None] + begin, 1e-300)
    return np.nan_to_num(moved).max()


def compare_estimates(looks, now, gyros, x, P, calm):
    if gyros.size:
        places, before = gyros[0].astype(int), looks[-1].copy()
        now[4:7], now[7:10] = x[places - 9], P[places, places]
        most = before[7:10] + gyros[1] * (now[0] - before[0])
        if not (calm and now[3] == before[3] and np.all(now[7:10] <= 1.001 * most)):
            looks[:] = np.nan
        if largest_change(looks, now, gyros[1], gyros[2]) > 36.0:
            return True
    looks[:] = np.vstack([looks[1:], now])
    return False


# ---------------------------------------------------------------- past
def at(address):
    """The twin of the kernel at an address."""
    return globals()[addresses.named(int(address)).__name__]


def _calibration(drv):
    """Channel, axis and value of each element of M."""
    for element in drv[89:107].astype(int)[: int(drv[88])]:
        yield element // 3, element // 9 * 3 + element % 3, drv[107 + element]


def drive_outputs(drv, Cr, xd, rows, errors):
    reading, k = drv[:6] / (drv[36] if drv[37] else 1.0), len(xd)
    rows[:] = Cr[:, :k]
    for q, (channel, axis, _) in enumerate(_calibration(drv)):
        rows[:, k - int(drv[88]) + q] = np.eye(6)[channel] * reading[axis]
    errors[:] = rows @ xd


def inertial_motion(recent, nav, drv, errors, rows, gravity_):
    values = np.vstack([drv[:6], recent[:, 1:]])
    if drv[37]:
        values /= np.concatenate([drv[36:37], np.where(recent[:, 0] > 0, recent[:, 0], 1.0)])[:, None]
    else:
        known = recent[1:, 0] > 0
        values[1:-1][known] = 0.5 * (recent[:-1, 1:] + recent[1:, 1:])[known]
    M = np.zeros((6, 6))
    for channel, axis, value in _calibration(drv):
        M[channel, axis] = value
    rows[:, 0], rows[:, 1:] = np.append(drv[12], recent[:, 0]), values - (values - values[0]) @ M.T - errors
    gravity_[0] = gravity(nav[0], nav[2])


def dead_reckoning_motion(recent, nav, drv, errors, rows, gravity_):
    rows[:], gravity_[0], count = 0.0, 0.0, np.count_nonzero(recent[:, 0])
    for i, (now, before) in enumerate(itertools.pairwise(recent[:count])):
        (roll, pitch, yaw), (r, p, _) = (now - before + np.pi)[1:4] % (2 * np.pi) - np.pi, now[1:4]
        turned = roll - yaw * np.sin(p), pitch * np.cos(r) + yaw * np.sin(r) * np.cos(p)
        rate = np.array([*turned, yaw * np.cos(r) * np.cos(p) - pitch * np.sin(r)]) / now[0]
        gained = drv[47:56].reshape(3, 3) @ (now - before)[4:]
        gained = np.where(np.abs(gained) <= drv[62], gained, 0.0)
        force = np.cross(rate, nav[6:15].reshape(3, 3).T @ nav[3:6]) + gained / now[0]
        rows[1 + i] = np.concatenate([now[:1], rate, force])
    if count > 1:
        force = np.cross(drv[143:146], nav[6:15].reshape(3, 3).T @ nav[3:6]) + drv[149:152]
        rows[0] = np.concatenate([drv[12:13], drv[143:146], force])


def slope_window_s(variance):
    return max(1.0, 2.0 * np.sqrt(3.0 * variance))


def mean_rate(rows, rate):
    rows = rows[2:]
    rows = rows[: np.argmax(rows[:, 0] <= 0.0)] if (rows[:, 0] <= 0.0).any() else rows
    rows = rows[np.concatenate([[0.0], np.cumsum(rows[:, 0])[:-1]])[: len(rows)] < 0.2]
    rate[:] = rows[:, 0] @ rows[:, 1:4] / max(rows[:, 0].sum(), 1e-9)


def register_room(count):
    return -(-count // 8) * 8


def store_constants(P, x, at, kept):
    count, most = len(kept) - 1, kept.shape[1]
    first = min(at, len(P) - most)
    kept[0, :count], kept[1:] = x[at - 9 :][:count], P[at : at + count, first : first + most]


def consider(P, x, kept, at, untold):
    these, first = np.flatnonzero(untold), min(at, len(P) - kept.shape[1])
    x[at - 9 + these] = kept[0, these]
    P[np.ix_(at + these, at + these)] = kept[np.ix_(1 + these, at - first + these)]


def consider_lever_arm(P, x, near, kept, own, at, drv, Cr, untold):
    if drv[strapdown_kernels.INERTIAL]:
        least = 15.0**2 * Cr[:3, -1].max() * min(1.0, drv[36] / 0.2)
        untold[:] = np.nansum(near[:, 9 + own :][:, :3] ** 2, axis=0) <= least
        consider(P, x, kept, at, untold)


def _hidden(P, H, K, kept, at, untold):
    before = np.diag(kept[1:, at - min(at, len(P) - kept.shape[1]) :])
    untold[:] = before - np.diag(P)[at:][: len(untold)] < 100.0 * np.trace(H @ K) * before**2


def consider_hidden(P, x, H, K, kept, at, untold):
    _hidden(P, H, K, kept, at, untold)
    consider(P, x, kept, at, untold)


def consider_unit(P, x, H, K, kept, at, untold, drv, Cr):
    after, told, k = P.copy(), x.copy(), len(untold)
    _hidden(P, H, K, kept, at, untold)
    consider(P, x, kept, at, untold)
    these, move = np.flatnonzero(untold), np.zeros((len(P), k))
    per = drv[strapdown_kernels.PERIOD_S] if drv[strapdown_kernels.INCREMENTS] else 1.0
    for i in these:
        element = int(drv[strapdown_kernels.ELEMENTS + i])
        C = Cr[element // 3, : Cr.shape[1] - 1 - k]
        by, own = element // 9 * 3 + element % 3, np.argmax(C**2 * np.diag(after)[9:][: len(C)])
        if C[own]:
            move[9 + own, i] = drv[strapdown_kernels.PREVIOUS + by] / per / C[own]
    given = kept[1:, at - min(at, len(P) - kept.shape[1]) :][:, :k] - after[at : at + k, at : at + k]
    given = given * np.outer(untold, untold)
    x += move[9:] @ (untold * (told[at - 9 :][:k] - kept[0, :k]))
    P += move @ given @ move.T
    P[:, at : at + k] -= move @ given
    P[at : at + k] -= given @ move.T


def acceleration_covariance(P, nav, drv, Cr, pushes, work):
    pushes[:] = 0.0
    if drv[strapdown_kernels.INERTIAL]:
        down, C = np.array([0.0, 0.0, gravity(nav[0], nav[2])]), nav[6:15].reshape(3, 3)
        J, k = np.hstack([skew(down), -C @ Cr[3:6, :-1]]), Cr.shape[1] - 1
        pushes[:] = J @ P[6 : 9 + k, 6 : 9 + k] @ J.T


def discount_clock(inner, slope, then, drv, Cr, over_s, gravity, variance, pushes, shared, near, R):
    white = Cr[:, -1] * (drv[36] / over_s if gravity else 2.0 / max(over_s, drv[36]) ** 2)
    C = then[6:15].reshape(3, 3)
    turned, pushed = inner[:, 6:9] @ C, inner[:, 3:6] @ C
    noise, growth = np.hstack([turned, pushed]) ** 2 @ white, inner[:, :9] @ slope[1]
    noise += np.einsum("ij,jk,ik->i", inner[:, 3:6], pushes, inner[:, 3:6])
    told = near[:, -1].copy()
    stands_out = told**2 > 100.0 * noise
    left = np.where(stands_out, 100.0 * noise / np.where(stands_out, told, 1.0), told)
    more = shared * variance * (noise + left**2) + 0.5 * (variance * growth) ** 2
    near[:, -1] -= left
    R += np.diag(np.where(np.isnan(told), 0.0, more))


def delayed_reading(
    equation, motion, facts, z, nav, rate, par, cfg, recent, drv, Cr, xd, since_s, variance, pushes, H, near, res, R
):
    arm, clock, turns, shared, *by_arm = facts
    own, by_arm = len(par) - 3 * int(arm) - int(clock), np.reshape(by_arm, (-1, 3))
    inner, base, ends = np.zeros((len(res), 9 + own)), np.zeros(len(res)), np.zeros(len(res))
    whole = np.nan_to_num(z)

    def ask(nav, rate, moved, res, z=whole):
        place = cfg + by_arm @ (par[own : own + 3] + moved) if arm else cfg
        at(equation)(z, nav, rate, par[:own], place, inner, res)

    outputs, errors = np.zeros((6, len(xd))), np.zeros(6)
    drive_outputs(drv, Cr, xd, outputs, errors)
    rows, g = np.zeros((len(recent) + 1, 7)), np.zeros(1)
    at(motion)(recent, nav, drv, errors, rows, g)
    if not clock:
        ask(nav, rate, np.zeros(3), res, z)
        near[:, : 9 + own], then = inner, nav
    else:
        late_s = since_s + par[-1]
        then, turn, slope, B = np.zeros(17), np.zeros(6), np.zeros((2, 9)), np.zeros((9, 9))
        over_s = earlier(nav, rows, g[0], late_s, 0.2, slope_window_s(variance), then, turn, slope, B)
        rate = turn[:3]
        ask(then, rate, np.zeros(3), res, z)
        near[:, : 9 + own] = inner
        near[:, :9], near[:, -1] = inner[:, :9] @ B, -inner[:, :9] @ slope[0]
        middle = 0.5 * (nav[6:15] + then[6:15]).reshape(3, 3)
        turned = middle @ outputs[:3]
        bent = B[3:6, 6:] @ turned
        place = -0.5 * late_s**2 * (middle @ outputs[3:] + bent / 3.0)
        by = np.vstack([place, late_s * (middle @ outputs[3:] + 0.5 * bent), late_s * turned])
        if g[0]:
            H[:, 9 : 9 + len(xd)] = inner[:, :9] @ by
    if arm:
        told = rate.copy()
        if not clock:
            mean_rate(rows, told)
        steady = then.copy()
        if not drv[strapdown_kernels.INERTIAL]:
            steady[6:15] = drv[169:178]
        ask(steady, told, np.zeros(3), base)
        near[:, 9 : 9 + own] = inner[:, 9:]
        for j in range(3):
            ask(steady, told, 1e-3 * np.eye(3)[j], ends)
            near[:, 9 + own + j] = (base - ends) / 1e-3
    if clock and turns:
        ask(then, rate, np.zeros(3), base)
        ask(then, rate + 1e-3 * turn[3:], np.zeros(3), ends)
        near[:, -1] -= (base - ends) / 1e-3
    if clock:
        discount_clock(inner, slope, then, drv, Cr, over_s, g[0], variance, pushes, shared, near, R)


def velocity_band(P, near, begin, first, turned):
    at = np.r_[:9, first : first + begin]
    known = np.diag(near[:, : 9 + begin] @ P[np.ix_(at, at)] @ near[:, : 9 + begin].T)
    return 3.0 * np.sqrt(max(0.0, np.max(known)) + turned)


def held_slope(new, old, band):
    return np.where(np.abs(new - old) <= band, 0.98 * old + 0.02 * new, new)


def limit_velocity_slopes(P, near, held, begin, first, turned):
    band = velocity_band(P, near, begin, first, turned)
    new = near[:, 9 + begin :][:, : held.shape[1]]
    new[:] = held_slope(new, held, band)


def limit_unread_slopes(P, near, res, first):
    read = np.isfinite(res)
    if len(res) != 3 or read.all():
        return read.sum() >= 3
    at = np.r_[:9, first : first + near.shape[1] - 9]
    for j in np.flatnonzero(~read):
        variance = near[j] @ P[np.ix_(at, at)] @ near[j]
        for i in np.flatnonzero(read):
            about = np.cross(near[i, 3:6], near[j, 3:6])
            unread = near[i, 6:9] @ about
            kept = max(0.0, 1.0 - 9.0 * variance / unread**2)
            near[i, 6:9] -= (1.0 - kept) * unread * about
    return False


def limit_clock_slope(P, near, held, column):
    sd = np.sqrt(np.maximum(np.diag(near[:, :3] @ P[3:6, 3:6] @ near[:, :3].T), 0.0))
    new = near[:, column].copy()
    near[:, column] = np.where((sd > 0.0) & (np.abs(new - held) <= 3.0 * sd), 0.998 * held + 0.002 * new, new)


def _sagitta(slope, distance, P):
    """What a distance of this slope grows by when its ends move across it: the moments of a quadratic form."""
    along = slope / np.linalg.norm(slope)
    return _moments((np.eye(3) - np.outer(along, along)) / distance @ P)


def _moments(bend):
    return 0.5 * np.trace(bend @ bend) + 0.25 * np.trace(bend) ** 2


def range_second_order(z, near, P, first, cfg, R):
    apart, place = np.hstack([np.eye(3), np.zeros((3, len(P) - 3))]), int(cfg[7])
    if place >= 0:
        apart[:, first + place + 3 * int(z[1]) :][:, :3] = -np.eye(3)
    R[0, 0] += max(1.0, cfg[-1] * z[0]) * _sagitta(near[0, :3], z[0], apart @ P @ apart.T)


def deviation_second_order(z, near, P, first, cfg, R):
    sin, cos, sin2, cos2 = near[0, 10:14]
    turns, at = np.array([cos, -sin, 2 * cos2, -2 * sin2]), slice(first + 1, first + 5)
    R[0, 0] += cfg[4] * (turns @ P[at, at] @ turns * P[8, 8] + (turns @ P[at, 8]) ** 2)


def tilt_second_order(z, near, P, first, cfg, R):
    across = near[0, 6:8]
    both = np.array([across, [across[1], -across[0]]])  # what a tilt does to the azimuth, and to the length
    (aa, ab), (_, bb) = both @ P[6:8, 6:8] @ both.T
    R[0, 0] += cfg[5] * (aa * bb + 2.0 * ab**2 + 15.0 / 4.0 * aa**3)


def iron_second_order(z, near, P, first, cfg, R):
    m, hard, soft = z[:3], int(cfg[2]), int(cfg[3])
    tilt_second_order(z, near, P, first, cfg, R)
    if 0 not in (hard, soft):
        deviation_second_order(z, near, P, first, cfg, R)
    x, y, w = m

    def by_soft(q):
        """Rows by which the iron moves the field along q: hard, soft."""
        a, b, c = q
        return -q, np.array([a * x - b * y, c * w, a * y + b * x, a * w + c * x, b * w + c * y])

    if hard >= 0:
        g = -near[0, 9 + hard : 12 + hard]
    else:
        # near is that of the field turned by the residual: what two equations are enough for is no fit to five
        rows, soft_row = np.array([by_soft(axis)[1] for axis in np.eye(3)]).T, near[0, 9 + soft : 14 + soft]
        level = np.linalg.solve(rows[[0, 2]][:, :2], soft_row[[0, 2]])
        rest = soft_row[3:] - rows[3:, :2] @ level
        g = np.array([*level, np.linalg.lstsq(rows[3:, 2:], rest, rcond=None)[0][0]])
    h = 1.0 / np.linalg.norm(g)
    across = h * g
    down = np.sqrt(max(m @ m - h**2, 0.0)) * (-1.0 if near[0, 6:8] @ [np.cos(cfg[0]), np.sin(cfg[0])] > 0 else 1.0)
    along = (h * m + down * np.cross(across, m)) / (h**2 + down**2)
    H = np.zeros((2, near.shape[1] - 9))
    for row, q in zip(H, (across, along), strict=True):
        for at, part in zip((hard, soft), by_soft(q), strict=True):
            if at >= 0:
                row[at : at + len(part)] = part
    S = H @ P[first:, first:][: H.shape[1], : H.shape[1]] @ H.T
    R[0, 0] += cfg[5] * (S[0, 0] * S[1, 1] + 2.0 * S[0, 1] ** 2) / h**4


def usbl_second_order(z, near, P, first, cfg, R):
    sight_, P = near[0, :3] / np.linalg.norm(near[0, :3]), P[:3, :3]
    distance = z[0] if np.isfinite(z[0]) else 1.0 / np.linalg.norm(near[1, :3])
    shared = max(1.0, cfg[-1] * distance)
    R[0, 0] += shared * _sagitta(sight_, distance, P)
    for k in (1, 2):
        both = np.outer(near[k, :3], sight_)
        R[k, k] += shared * _moments((both + both.T) / distance @ P)


# ---------------------------------------------------------------- symmetric
def copy(of, to):
    to[:] = of[: to.size]


def mirror_columns(T, M, rows, begin):
    M[:rows, begin:] = T[:rows, begin:]
    M[begin:, :rows] = M[:rows, begin:].T


def symmetrise(M, first, end):
    block = M[first:end, first:end]
    block[:] = (block + block.T) / 2.0


def mirror_rows(M, first, last):
    others = np.r_[:first, last : len(M)]
    M[others, first:last] = M[first:last, others].T


# ---------------------------------------------------------------- batch
def correction(bench, spot, P, nav, x, acc, drv, Cr, recent, z, variance, count, since_s):
    a, n, m, b, start, errors, par, _ = dims = spot[:8]
    equation, seen, motion, bend, moves, turns, reads_rate = spot[8:15]
    begin, cfg, cfg_size, rate, model, output, white, lever, noise, limits, facts = spot[15:26]
    held_from, held_to = spot[29:31]
    mem, places_, xd = bench[begin:cfg], memory_offsets(dims), x[: m - 9]
    if drv[126]:
        attitude_second_order(P, acc, nav, drv[142])
    if not spot[33]:
        store_transition(acc, mem)
    predict(P, nav, x, acc, bench[model : model + 2 * b * b].reshape(2, b, b), mem, dims, count)
    outputs, off = np.zeros((6, m - 9)), np.zeros(6)
    drive_outputs(drv, Cr, xd, outputs, off)
    if turns or reads_rate:
        bench[rate : rate + 6] = drv[:6] / (drv[36] if drv[37] else 1.0) - off
    H = mem[: places_[1]][places_[0] :].reshape(a, n)
    if reads_rate:
        z, H[:, 9:m] = z[:3] - off[:3], outputs[:3]
    near, res = mem[places_[7] : places_[8]].reshape(a, 9 + par), mem[places_[3] : places_[4]]
    own = x[start - 9 + errors : start - 9 + errors + par]
    here = z, nav, bench[rate : rate + 3], own, bench[cfg : cfg + cfg_size]
    given = len(variance) and not np.isnan(variance[0])
    R = bench[noise : noise + a * a].reshape(a, a)
    R[:] = bench[(lever if given else white) :][: a * a].reshape(a, a) + (np.diag(variance[:a]) if given else 0.0)
    if moves and P[8, 8] > 0.01:
        R += np.eye(a) * 0.5 * (nav[3] ** 2 + nav[4] ** 2) * P[8, 8] ** 2
    held, timed = near[:, 9 + held_from : 9 + held_to].copy(), near[:, -1].copy()
    if seen:
        clock = start + errors + par - 1
        pushes = np.zeros((3, 3))
        acceleration_covariance(P, nav, drv, Cr, pushes, None)
        rest = recent, drv, Cr, xd, since_s, P[clock, clock], pushes, H, near, res, R
        at(seen)(equation, motion, bench[facts : facts + 4 + 3 * cfg_size], *here, *rest)
        if bench[facts + 1]:
            limit_clock_slope(P, near, timed, 8 + par)
    else:
        at(equation)(*here, near, res)
    if held.size:
        turned = np.diag(bench[lever:][: a * a].reshape(a, a)).max()
        limit_velocity_slopes(P, near, held, held_from, start + errors, turned)
    moves = moves and limit_unread_slopes(P, near, res, start + errors)
    if bend:
        at(bend)(z, near, P, start + errors, here[-1], R)
    C, gate = bench[output : output + a * errors].reshape(a, errors), bench[limits : limits + a + 1]
    if spot[34]:
        before = mem[places_[7] - a : places_[7]]
        band = velocity_band(P, near, 0, start + errors, np.diag(bench[lever:][: a * a].reshape(a, a)).max())
        fault_states(bench[spot[34] :], z, nav, x, bench[rate : rate + 6], start, spot[31], C, near, res, before, band)
    believed = bench[limits + a + 1 : limits + 2 * a + 1]
    squares = (C @ x[start - 9 : start - 9 + errors]) ** 2
    beyond, calm = np.any(squares > believed), np.all(squares <= believed / 16.0)
    used = mem[places_[8] + 2]
    mem[places_[9] - 1] = count if calm and used else mem[places_[9] - 1] + count
    correct_and_turn(bench, spot, P, nav, x, drv, Cr, C, R, moves, np.r_[np.inf, np.full(a, -1.0)] if beyond else gate)


def fault_states(table, z, nav, x, motion, start, north, C, near, res, held, band):
    scaled, deviating, flowing, described = table[:4].astype(int)
    table = table[4:]
    for state, at_m_s, axes in table[: 3 * scaled].reshape(-1, 3):
        state, axes = int(state), int(axes)
        held[:axes] = held_slope(np.nan_to_num(z[:axes] - res[:axes]), held[:axes], band)
        C[:axes, state] = held[:axes] / at_m_s
        near[:axes, :9] *= 1.0 + x[start - 9 + state] / at_m_s
    for state, of_rad in table[3 * scaled :][: 2 * deviating].reshape(-1, 2):
        C[north, int(state)] = np.cos(np.arctan2(nav[9], nav[6]) - of_rad)
    for state, component, axes in table[3 * scaled + 2 * deviating :][: 3 * flowing].reshape(-1, 3).astype(int):
        C[:axes, state] = -near[:axes, 3 + component]
    attitude = nav[6:15].reshape(3, 3)
    rate, force = attitude @ motion[:3], attitude @ motion[3:] + [0.0, 0.0, gravity(nav[0], nav[2])]
    table = table[3 * scaled + 2 * deviating + 3 * flowing :][: 3 * described].reshape(-1, 3).astype(int)
    for state, component, axes in table:
        added = np.cross(rate, attitude[:, component]) if component < 3 else np.cross(rate, nav[3:6]) - force
        added *= component != 3 or motion[3:].any()
        if component > 3:
            added = np.cross(nav[3:6], attitude[:, component - 4])
        C[:axes, state] = near[:axes, 3:6] @ added
    if north >= 0:
        error = C[north] @ x[start - 9 :][: C.shape[1]]
        res[north] = _half_turn(res[north] - error) + error


def readmission(bench, spot, P, nav, x, drv, Cr, C, R):
    places_ = memory_offsets(spot[:8])
    res = bench[spot[15] : spot[16]][places_[3] : places_[4]]
    moves = spot[12] and np.isfinite(res).sum() >= 3
    correct_and_turn(bench, spot, P, nav, x, drv, Cr, C, R, moves, np.full(len(res) + 1, np.inf))


def correct_and_turn(bench, spot, P, nav, x, drv, Cr, C, R, moves, limits):
    a, n, m, _, start, errors, par, _ = dims = spot[:8]
    seen, turns, begin, cfg, facts = spot[9], spot[13], spot[15], spot[16], spot[25]
    held_from, held_to = spot[29:31]
    mem, places_ = bench[begin:cfg], memory_offsets(dims)
    H = mem[: places_[1]][places_[0] :].reshape(a, n)
    near, res = mem[places_[7] : places_[8]].reshape(a, 9 + par), mem[places_[3] : places_[4]]
    velocity, turns = nav[3:6].copy(), drv[142] and turns_with_heading(P, nav[3:5])
    if spot[31] >= 0:
        mem[places_[9] - 2] = R[spot[31], spot[31]]
    before, x_before, elements = P.copy(), x.copy(), int(drv[88])

    def kept(where, count):
        known = np.zeros((1 + count, register_room(count)))
        store_constants(before, x_before, where, known)
        return known

    update(P, nav, x, C, R, mem, dims, limits)
    change = mem[places_[4] + 1 : places_[5]]
    change[:] = 0.0
    if mem[places_[8] + 2]:
        drv[142] = max(drv[142], moves * (2 if dims[7] < 0 else 1))
        if moves or turns:
            turn_velocity(P, nav, velocity, change)
            if dims[7] < 0:
                turn_current(P, mem[places_[1] : places_[2]].reshape(n, a), res, -dims[7])
        elif drv[126] and not drv[142]:
            turn_tilts(P, mem[places_[1] : places_[2]].reshape(n, a), res, change[3:])
    if mem[places_[8] + 2]:
        K = mem[places_[1] : places_[2]].reshape(n, a)
        if seen and bench[facts]:
            arm = par - 3 - int(bench[facts + 1])
            where = start + errors + arm
            consider_lever_arm(P, x, near, kept(where, 3), arm, where, drv, Cr, np.empty(3))
        if spot[32]:
            where, count = start + errors + held_from, held_to - held_from
            consider_hidden(P, x, H, K, kept(where, count), where, np.empty(count))
        consider_unit(P, x, H, K, kept(m - elements, elements), m - elements, np.empty(elements), drv, Cr)


IN_HAND = {
    19: "bench nav x drv facts undone ear figures P acc Phid Qd Cr ring heads values plan places cursor",
    15: "nav x drv spans limits sd ends watch P acc Phid Qd Cr piece plan",
}
TABLES = ["P", "acc", "Phid", "Qd", "Cr", "ring", "heads", "values", "watch", "piece", "plan"]


# ---------------------------------------------------------------- noise that is larger than described


def median_square(squares):
    """Mean of squares of normal variables, the largest quarter left out."""
    kept = np.sort(squares)[: int(0.75 * len(squares))]
    return np.mean(kept) / 0.3685 if len(squares) >= 8 else 0.0


def excess_variance(bends, axis, latest, newest, white, work):
    a = bends.shape[1] // 2
    rows = np.roll(bends, -newest - 1, axis=0)[len(bends) - latest :]
    known = np.isfinite(rows[:, axis])
    squares, slack = rows[known, axis] ** 2 / 6.0, rows[known, a + axis]
    ratio = median_square(squares / np.maximum(white + slack, 1e-300))
    if ratio > 300.0**2:
        return math.inf
    if ratio <= 2.5:
        return 0.0
    telling = slack <= np.median(slack)
    return min(max(median_square((squares - slack)[telling]) - white, 1.5 * white), 300.0**2 * white)


def is_worthless(kept, axes):
    return bool(np.isinf(kept[6 + 2 * axes : 6 + 3 * axes]).any())


def widen_variance(kept, facts, variance, axes):
    own = facts[4 + axes : 4 + 2 * axes] if np.isnan(variance[0]) else variance[:axes]
    facts[4 + 2 * axes : 4 + 3 * axes] = own + kept[6 + 2 * axes : 6 + 3 * axes]


def may_have_gone(kind, P, speed, dt, Cr, period_s):
    """Variance by which dead reckoning may err in a time, in the units of a heading (0), velocity (1), or another."""
    C, white = Cr[:, :-1], Cr[:, -1]
    lasting = np.diag(C @ P[9 : 9 + C.shape[1], 9 : 9 + C.shape[1]] @ C.T)
    if kind == 0:
        return lasting[:3].max() * dt**2 + white[:3].max() * period_s * dt
    if kind == 1:
        tilt = 9.81**2 * max(P[6, 6], P[7, 7])
        return (lasting[3:].max() + tilt) * dt**2 + white[3:].max() * period_s * dt
    return (np.diag(P)[3:6].max() + speed**2 * P[8, 8]) * dt**2


def update_scale(kept, facts, mem, S, verdict, R, north, P, nav, Cr, time_s, ignored):
    a, (lasting, kind, period, drive_period) = len(R), facts[:4]
    refused, before_s, watched, alone = kept[:4]
    last, step_before, excess = kept[6 : 6 + 3 * a].reshape(3, a)
    bends, wander, own = kept[6 + 3 * a :].reshape(-1, 2 * a), facts[4 : 4 + a], np.diag(R)
    nis, _, used = mem[verdict : verdict + 3]
    residual, sd = mem[verdict + 3 : verdict + 3 + 2 * a].reshape(2, a)
    S = mem[S : S + a * a].reshape(a, a)
    dt = time_s - before_s
    refused = (refused * math.exp(-max(dt, 0.0) / (16.0 * period)) if refused else 0.0) + (not used)
    if ignored or not (watched or refused >= 3.0):
        kept[:] = 0.0
        kept[:2] = refused, time_s
        return nis
    added = bool(np.any(excess)) and not np.any(np.isinf(excess))
    step = np.full(a, np.nan)
    if watched and dt <= 3.0 * period:
        step = residual - last
        if north >= 0:
            step[north] = (step[north] + np.pi) % (2.0 * np.pi) - np.pi
        slack = np.zeros(a)
        if lasting:
            pushed = Cr[3:, -1].max() * drive_period * period * (2.0 if kind == 1 else period**2)
            seen = 0.0 if added or alone > 1 else np.maximum(np.diag(S) - own, 0.0)
            slack = (2.0 * wander + pushed) / 6.0 + seen
        bends[int(kept[5])] = np.concatenate([step - step_before, slack])
        kept[4:6] = min(kept[4] + 1, 48), (kept[5] + 1) % 48
    if added:
        seen = np.isfinite(sd)
        left = (S - np.diag(excess))[np.ix_(seen, seen)]
        nis = residual[seen] @ np.linalg.solve(left, residual[seen])
    plain = own - (excess if added else 0.0)
    if not lasting:
        speed = np.linalg.norm(nav[3:6])
        plain = plain + (wander + may_have_gone(kind, P, speed, period, Cr, drive_period)) * 2.0 / 6.0
    count, newest = int(kept[4]), int(kept[5] - 1) % 48
    found = [[excess_variance(bends, i, min(count, n), newest, plain[i], None) for i in range(a)] for n in (16, 48)]
    excess[:] = found[1] if any(found[0]) else 0.0
    if count == 48 and not any(excess) and refused < 1.0:
        kept[:] = 0.0
        kept[1] = -math.inf
        return nis
    kept[:4] = refused, time_s, 1.0, 0.0 if used else alone + 1
    last[:], step_before[:] = residual, step
    return nis


# --- the bank of faults ----------------------------------------------------------------------------------------------


def width(bank):
    return fault_bank.WINDOWS * int(bank[fault_bank.SIGNATURES]) + int(bank[fault_bank.BEGUN])


def signatures_of(bank, window):
    c, f = int(bank[fault_bank.SIGNATURES]), int(bank[fault_bank.BEGUN])
    return (0, c, window * c) if window < fault_bank.WINDOWS else (c, c + f, window * c)


def _shapes(bank):
    c, n, channels, f = bank[[fault_bank.SIGNATURES, fault_bank.STATES, fault_bank.CHANNELS, fault_bank.BEGUN]].astype(
        int
    )
    N = fault_bank.WINDOWS * c + f
    windows, told = (fault_bank.WINDOWS + 1,), (channels, fault_bank.HEARD)
    return windows, (c + f, fault_bank.TABLE), (n, N), (N,), (N, N), (N,), told


def places(bank):
    sizes = [fault_bank.ONSETS, *(np.prod(shape) for shape in _shapes(bank))]
    return tuple(np.cumsum(sizes)[1:].astype(int).tolist())


def _bank(bank):
    """Onsets, table, D (n, N), s (N,), J (N, N), what is on top of the odds (N,), what channels have said; views."""
    ends = (fault_bank.ONSETS, *places(bank))
    return [bank[i:j].reshape(shape) for i, j, shape in zip(ends[:-1], ends[1:], _shapes(bank), strict=True)]


def _column(bank, window, k):
    c = int(bank[fault_bank.SIGNATURES])
    return window * c + k - (c if window == fault_bank.WINDOWS else 0)


def _each(bank):
    """Every column's window and signature."""
    for window in range(fault_bank.WINDOWS + 1):
        begins, ends, _ = signatures_of(bank, window)
        yield from ((window, k) for k in range(begins, ends))


def carry(bank, Phi, first):
    D = _bank(bank)[2]
    D[first : first + len(Phi)] = Phi @ D[first : first + len(Phi)]


def larger(own):
    correlation = np.clip(own[fault_bank.PRODUCT] / own[fault_bank.SQUARE], 0.0, fault_bank.CORRELATED)
    return max(own[fault_bank.SQUARE], 1.0) * (1.0 + correlation) / (1.0 - correlation)


def description_slope(component, nav, velocity, motion, output):
    C = nav[6:15].reshape(3, 3)
    rate, force = C @ motion[:3], C @ motion[3:] + np.array([0.0, 0.0, strapdown_kernels.gravity(nav[0], nav[2])])
    if component < 3:
        output[:] = np.cross(rate, C[:, component])
    elif component == 3:
        output[:] = (np.cross(rate, velocity) - force) * bool(motion[3:].any())
    else:
        output[:] = np.cross(velocity, C[:, component - 4])


def _slope(table, k, near, nav, velocity, motion):
    """What a unit of a signature adds to a reading, but for its age; shape (a,)."""
    kind, _, place, _, _, _, read = table[k]
    over_ground, by = (np.arange(len(near)) < read) * near[:, 3:6].T, np.zeros(3)
    if kind in (fault_bank.FLOW_STEP, fault_bank.FLOW_RAMP):
        return -over_ground[int(place)]
    if kind == fault_bank.SCALE:
        return velocity @ over_ground
    if kind == fault_bank.DESCRIBED:
        description_slope(int(place), nav, velocity, motion[:6], by)
        return by @ over_ground
    return np.eye(len(near))[int(place)] if kind in (fault_bank.STEP, fault_bank.RAMP) else np.zeros(len(near))


def take_reading(bank, mem, dims, at, near, nav, motion, band, channel, time_s, value, limit, used):
    onsets, table, D, s, J, _, heard = _bank(bank)
    a, n = dims[0], dims[1]
    H, K = mem[at[0] : at[0] + a * n].reshape(a, n), mem[at[1] : at[1] + n * a].reshape(n, a)
    inverse, y = mem[at[5] + a * a : at[5] + 2 * a * a].reshape(a, a), mem[at[8] + 3 : at[8] + 3 + a]
    seen = ~np.isnan(mem[at[8] + 3 + a : at[8] + 3 + 2 * a])
    own, C = heard[channel], nav[6:15].reshape(3, 3)
    counts = not math.isnan(value)
    if counts and not used:
        signatures = table[: int(bank[fault_bank.SIGNATURES]), fault_bank.CHANNEL]
        counts = limit > 0.0 and value != own[fault_bank.VALUE] and channel in signatures
        if counts and own[fault_bank.REFUSED] == 0.0 and likeliest(bank, 0, time_s) < 0.0:
            begin_window(bank, 0, time_s)
    own[fault_bank.VALUE] = own[fault_bank.VALUE] if math.isnan(value) else value
    held = own[fault_bank.THEN + 6 : fault_bank.THEN + 9]
    new = C.T @ nav[3:6]
    held[:] = held_slope(new, held, band)
    G = np.zeros((a, width(bank)))
    for window, k in _each(bank):
        kind, of, place = table[k, :3]
        column = _column(bank, window, k)
        if kind == fault_bank.DRIFT:
            D[int(place), column] += time_s - bank[fault_bank.READ_S]
        then = own[fault_bank.THEN :] if used else motion
        F = _slope(table, k, near, nav, C @ held, then) if of == channel else np.zeros(a)
        aged = kind in (fault_bank.RAMP, fault_bank.FLOW_RAMP)
        G[:, column] = np.where(seen, H @ D[:, column] + F * (time_s - onsets[window] if aged else 1.0), 0.0)
    bank[fault_bank.READ_S] = time_s
    known = consistency.HELD * bank[fault_bank.RATE_SD] * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    own[fault_bank.THEN : fault_bank.THEN + 6] = held_slope(motion, own[fault_bank.THEN : fault_bank.THEN + 6], known)
    weight = 1.0
    if used:
        own[fault_bank.REFUSED] = 0.0
    elif counts:
        beyond, PH = max(mem[at[8]] / limit, 1.0), mem[at[6] : at[6] + a * n].reshape(a, n)
        common = np.sum(PH * H, axis=1)
        known = np.nanmax((common / (beyond * mem[at[8] + 3 + a : at[8] + 3 + 2 * a] - common))[seen])
        refused = own[fault_bank.REFUSED] + np.array([0.0, known])
        own[fault_bank.REFUSED] = refused[1]
        weight = math.sqrt((1.0 + known) / np.prod(1.0 + refused) / beyond)
    if counts:
        sd, before = np.sqrt(mem[at[8] + 3 + a : at[8] + 3 + 2 * a]), own[fault_bank.BEFORE :]
        share = [weight / math.sqrt(before[w] if before[w] > 0.0 else larger(own)) for w, _ in _each(bank)]
        own[fault_bank.READINGS] += 1.0
        few = np.arange(min(a, fault_bank.AXES))
        own[fault_bank.SUMS + few] += weight * np.where(seen, y / sd, 0.0)[few]
        s += np.square(share) * (G[seen].T @ inverse[np.ix_(seen, seen)] @ y[seen])
        rows, column = np.indices(J.shape)
        J += np.outer(share, share) * (G.T @ inverse @ G) * (rows >= column // 8 * 8)
    if used:
        turn = mem[at[4] : at[5]]
        D -= K @ G
        D[6:9] += skew(np.array([0.0, 0.0, turn[0]])) @ D[6:9] / 2
        D[3:6] -= skew(turn[1:4]) @ D[6:9]
        D[6:9] += skew(np.r_[turn[4:6], 0.0]) @ D[6:9] / 2


def explained(J, s, variance, L, u):
    k = len(s)
    J = J[:k, :k] + np.eye(k) / variance
    L[:k, :k] = np.linalg.cholesky(J)
    u[:k] = np.linalg.solve(L[:k, :k], s)
    return 0.5 * s @ np.linalg.solve(J, s) - 0.5 * np.linalg.slogdet(J * variance)[1]


def judged(bank, window, k, time_s, out):
    onsets, table, D, s, J, more, _ = _bank(bank)
    kind, _, _, variance, rate, together, _ = table[k]
    age = max(time_s - onsets[window], 1.0)
    V = variance / (age**2 if kind in (fault_bank.RAMP, fault_bank.FLOW_RAMP, fault_bank.DRIFT) else 1.0)
    own = _column(bank, window, k) + np.arange(int(together))
    M = np.linalg.inv(J[np.ix_(own, own)] + np.eye(len(own)) / V)
    m = M @ s[own]
    L, u = np.zeros((2, 3, 3))
    out[0] = explained(J[np.ix_(own, own)], s[own], V, L, u[0]) + rate + more[own[0]]
    if kind == fault_bank.DESCRIBED:
        out[0] -= explained(J[np.ix_(own, own)], s[own], V * fault_bank.RIGHT**2, L, u[0])
    out[0] += np.log(age) if window < fault_bank.WINDOWS else 0.0
    place, heading = D[:2, own], D[8:9, own]
    out[1], out[3] = np.linalg.norm(place @ m), np.linalg.norm(heading @ m)
    out[2], out[4] = (np.sqrt(max(np.linalg.eigvalsh(A @ M @ A.T)[-1], 0.0)) for A in (place, heading))


def likeliest(bank, window, time_s):
    table, out, odds = _bank(bank)[1], np.zeros(5), [-math.inf]
    for w, k in _each(bank):
        if w == window and table[k, fault_bank.TOGETHER] > 0.0:
            judged(bank, w, k, time_s, out)
            odds.append(out[0])
    return max(odds)


def begin_window(bank, window, time_s):
    onsets, table, D, _, _, more, heard = _bank(bank)
    for row in heard:
        row[fault_bank.BEFORE + window] = (
            larger(row) if row[fault_bank.TOLD] >= fault_bank.DOUBTED + fault_bank.CONFIRMED else 0.0
        )
    onsets[window] = time_s
    for w, k in _each(bank):
        if w == window:
            column = _column(bank, w, k)
            forget(bank, column)
            more[column] = 0.0
            if table[k, fault_bank.KIND] == fault_bank.STATE:
                D[int(table[k, fault_bank.PLACE]), column] = 1.0


def forget(bank, at):
    _, _, D, s, J, _, _ = _bank(bank)
    s[at], D[:, at], J[at], J[:, at] = 0.0, 0.0, 0.0, 0.0


def look(bank, time_s):
    table, most, found = _bank(bank)[1], -np.inf, np.zeros(5)
    bank[[fault_bank.RADIUS_M, fault_bank.HEADING_RAD]] = 0.0
    for own in _bank(bank)[6]:
        sums = own[fault_bank.SUMS : fault_bank.BEFORE].reshape(2, -1)
        mine = sums[0] != 0.0
        if mine.any():
            mean = np.clip(sums[0, mine] / np.sqrt(own[fault_bank.READINGS]), -fault_bank.MOST, fault_bank.MOST)
            own[fault_bank.TOLD] = told = min(own[fault_bank.TOLD] + 1.0, fault_bank.MEMORY)
            own[fault_bank.SQUARE] += (np.mean(mean**2) - own[fault_bank.SQUARE]) / told
            own[fault_bank.PRODUCT] += (np.mean(mean * sums[1, mine]) - own[fault_bank.PRODUCT]) / told
            sums[0, mine], sums[1, mine] = 0.0, mean
        own[fault_bank.READINGS] = 0.0
    for w in range(fault_bank.WINDOWS + 1):
        odds, is_moved, (begins, ends, _) = [], w < fault_bank.WINDOWS, signatures_of(bank, w)
        for k in range(begins, ends):
            if table[k, fault_bank.TOGETHER] == 0.0:
                continue
            judged(bank, w, k, time_s, found)
            odds.append(found[0])
            share = 1.0 / (1.0 + np.exp(-found[0])) / fault_bank.RISK
            sds = np.sqrt(2.0 * np.log(max(share, 1.0)))
            for at, first in ((fault_bank.RADIUS_M, 1), (fault_bank.HEADING_RAD, 3)):
                bank[at] = max(
                    bank[at],
                    (found[first] + sds * found[first + 1])
                    * (share > 1.0)
                    * is_moved
                    * (bank[fault_bank.LOOKS] >= fault_bank.CONFIRMED),
                )
        turn = bank[fault_bank.LOOKS]
        most = max(most, *odds) if turn >= fault_bank.CONFIRMED else most
        if is_moved and (turn < fault_bank.CONFIRMED or (turn % 2 ** (w + 1) == 2**w and max(odds) < 0.0)):
            begin_window(bank, w, time_s)
    bank[fault_bank.LOOKS] += 1.0
    bank[[fault_bank.LOOKED_S, fault_bank.ODDS]] = time_s, most
    return most
