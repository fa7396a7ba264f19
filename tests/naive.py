"""Readable NumPy twins of the kernels, one function of the same name per kernel, a section per kernel file."""

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

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
