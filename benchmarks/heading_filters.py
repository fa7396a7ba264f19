"""Adaptive Kalman filters to compare with, written from their published ideas, on the heading problem of `heading_toy`.

The problem: y[k] = d[k] + n[k], compass minus gyro-integrated heading. d is the drift of the gyro (heading and bias,
noise known), n the compass's error. Every filter here estimates d; they differ in what they believe of n.

Sage-Husa (A. P. Sage and G. W. Husa, "Adaptive filtering with unknown prior statistics", Joint Automatic Control
Conference, 1969): n is white, its variance R follows the innovations with exponential forgetting, ``R += w (nu^2 - H
P- H' - R)``.

IWAKF, innovations-whitening adaptive Kalman filter (M. Almuhaihi and D. S. Bernstein, "An adaptive Kalman filter that
learns the coloring dynamics of the process noise", arXiv 2604.21644, 2026). Known to the author of this file: the
abstract and the introduction. The idea taken from there: put an unknown colouring filter into the augmented state and
choose its parameters such that the empirical autocorrelation of the innovations is as small as possible. Derived
here, because it was not read:

- the coloured noise is that of the compass instead of the process; augmented, it is process noise of the state, as in
  the paper;
- colouring filter: ARMA(p, q), by partial (reflection) coefficients, so that every trial is stable and invertible;
- cost: squares of the empirical autocorrelations of the normalised innovations at lags 1 to L, by Gauss-Newton with
  trust region over the last window, warm-started at each hop from the last answer;
- whiteness alone leaves the power of the noise open, so that the lag-zero term, ln mean(nu^2/S), is driven to zero as
  well, and a penalty keeps the variance of the colouring filter within a factor of ten of that of the detrended
  window (without it, poles and zeros crowd at 1 in half of the cases and the filter breaks down).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from harness import Array
from numba import njit
from scipy.optimize import least_squares

import navfilter as nf
from navfilter.models.error_models import Arma

#: The innovations of the first samples tell of the start, not of the noise.
SETTLED = 100


@dataclass(frozen=True)
class Gyro:
    """What is known of the heading's slow error: root PSDs of rate noise and bias walk, sd at the start (rad, s)."""

    density: tuple[float, float]
    start_sd: tuple[float, float]
    period_s: float


@dataclass(frozen=True)
class Filtered:
    """Result of a filter: estimated drift and its variance after each sample, innovations and their variances."""

    estimate: Array
    variance: Array
    innovation: Array
    innovation_variance: Array

    @property
    def loglik(self) -> float:
        """Gaussian log-likelihood after the first samples, without its constant."""
        nu, S = self.innovation[SETTLED:], self.innovation_variance[SETTLED:]
        return float(-0.5 * np.sum(np.log(S) + nu**2 / S))


@njit(cache=True)
def _noise_step(x, P, a, h, q):
    """One tick of the companion-form noise states 2 ... n-1 in place: x <- F x, P <- F P F' + q h h', in O(n^2)."""
    n = x.size
    r = n - 2
    first = x[2]
    for i in range(r):
        x[2 + i] = (x[3 + i] if i + 1 < r else 0.0) - a[i] * first
    for j in range(n):
        top = P[2, j]
        for i in range(r):
            P[2 + i, j] = (P[3 + i, j] if i + 1 < r else 0.0) - a[i] * top
    for j in range(n):
        top = P[j, 2]
        for i in range(r):
            P[j, 2 + i] = (P[j, 3 + i] if i + 1 < r else 0.0) - a[i] * top
    for i in range(r):
        for j in range(r):
            P[2 + i, 2 + j] += q * h[i] * h[j]


@njit(cache=True)
def _filter(y, dt, q_heading, q_bias, P, a, h, q, white, forgetting, out):
    """Kalman filter of y = heading + ARMA noise + white; with `forgetting` > 0 the white variance adapts (Sage-Husa).

    `out` takes estimate, variance, innovation, its variance and the white variance per sample, shape (n, 5).
    """
    n = P.shape[0]
    x = np.zeros(n)
    gain = np.zeros(n)
    row = np.zeros(n)
    weight = 1.0
    floor = 1e-4 * white
    for k in range(y.size):
        if k > 0:
            x[0] += dt * x[1]
            for j in range(n):
                P[0, j] += dt * P[1, j]
            for j in range(n):
                P[j, 0] += dt * P[j, 1]
            P[0, 0] += q_heading
            P[1, 1] += q_bias
            if n > 2:
                _noise_step(x, P, a, h, q)
        for j in range(n):
            row[j] = P[0, j] + (P[2, j] if n > 2 else 0.0)
        spread = row[0] + (row[2] if n > 2 else 0.0)
        nu = y[k] - x[0] - (x[2] if n > 2 else 0.0)
        if forgetting > 0.0:
            # (1-b)/(1-b^(k+1)): a plain mean at first, exponential in the long run
            weight = weight / (weight + forgetting)
            if k >= 10:
                white = max(white + weight * (nu * nu - spread - white), floor)
        S = spread + white
        for j in range(n):
            gain[j] = row[j] / S
        for i in range(n):
            x[i] += gain[i] * nu
            for j in range(n):
                P[i, j] -= gain[i] * row[j]
        for i in range(n):
            for j in range(i):
                P[i, j] = P[j, i]
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = x[0], P[0, 0], nu, S, white


def _run(y: Array, gyro: Gyro, model: nf.ArmaModel | None, white: float, forgetting: float) -> Array:
    a, h, start, q = np.zeros(0), np.zeros(0), np.zeros((0, 0)), 0.0
    if model is not None:
        block = Arma(tuple(model.ar), tuple(model.ma), model.sd).block(gyro.period_s)
        r, q = block.size, model.sd**2
        a, h = np.zeros(r), np.zeros(r)
        a[: model.p], h[: model.q + 1] = model.ar, np.r_[1.0, model.ma]
        start = block.P0
    P = np.zeros((2 + a.size, 2 + a.size))
    P[0, 0], P[1, 1] = np.square(gyro.start_sd)
    P[2:, 2:] = start
    out = np.empty((y.size, 5))
    drive = np.square(gyro.density) * gyro.period_s
    _filter(y, gyro.period_s, drive[0], drive[1], P, a, h, q, white, forgetting, out)
    return out


def filter_heading(y: Array, gyro: Gyro, model: nf.ArmaModel) -> Filtered:
    """Filter that believes in one ARMA model of the compass's error (white noise is order (0, 0)).

    Parameters
    ----------
    y : ndarray, shape (n,)
        Compass minus gyro-integrated heading, rad.
    gyro : Gyro
    model : ArmaModel
        In rad.
    """
    colour = model.p + model.q > 0
    # a millionth of white noise beside a coloured one keeps P positive where poles and zeros crowd
    out = _run(y, gyro, model if colour else None, (1e-6 if colour else 1.0) * model.sd**2, 0.0)
    return Filtered(*out.T[:4])


def sage_husa(y: Array, gyro: Gyro, white: float, forgetting: float) -> tuple[Filtered, Array]:
    """Sage-Husa adaptive R: white compass noise whose variance follows the innovations.

    Parameters
    ----------
    y, gyro
        As for `filter_heading`.
    white : float
        Variance to begin with, rad^2; a ten-thousandth of it is the floor.
    forgetting : float
        b of Sage and Husa, below 1: memory of 1/(1-b) samples.

    Returns
    -------
    filtered : Filtered
    R : ndarray, shape (n,)
        The variance in force.
    """
    out = _run(y, gyro, None, white, forgetting)
    return Filtered(*out.T[:4]), out[:, 4]


def polynomial(partial: Array) -> Array:
    """Coefficients c1 ... cn of the stable polynomial with these reflection coefficients (Levinson step-up)."""
    c = np.zeros(0)
    for k in partial:
        c = np.r_[c + k * c[::-1], k]
    return c


def partials(c: Array) -> Array:
    """Partial coefficients of the stable polynomial c1 ... cn: the reverse of `polynomial` (Schur-Cohn step-down)."""
    found = []
    while c.size:
        found.append(c[-1])
        c = (c[:-1] - c[-1] * c[-2::-1]) / (1.0 - c[-1] ** 2)
    return np.array(found[::-1])


@dataclass
class Iwakf:
    """Learner of the IWAKF: whitens the innovations of the filter over a window, see the module's docstring.

    Parameters
    ----------
    gyro : Gyro
    p, q : int
        Orders of the colouring filter.
    lags : int
        L, the number of autocorrelations that are driven to zero.
    """

    gyro: Gyro
    p: int = 4
    q: int = 2
    lags: int = 40
    _last: Array | None = field(default=None, init=False)

    def hop(self, y: Array) -> nf.ArmaModel:
        """Learn the colouring filter from the readings of a window, starting where the last hop ended.

        Parameters
        ----------
        y : ndarray, shape (n,)
            Compass minus gyro-integrated heading, rad.
        """
        t = np.linspace(-1.0, 1.0, y.size)
        flat = y - np.polyval(np.polyfit(t, y, 1), t)
        begins = [self._last] if self._last is not None else self._starts(flat)
        of = (y, float(flat.var()))
        fits = [
            least_squares(self._residual, begin, args=of, x_scale=0.3, max_nfev=40, diff_step=1e-4) for begin in begins
        ]
        self._last = min(fits, key=lambda fit: fit.cost).x
        return self._model(self._last)

    def _starts(self, flat: Array) -> list[Array]:
        """Two places to begin: an AR(p) of the detrended series; a short memory with the power of its increments."""
        autoregression = nf.timeseries.burg(flat, self.p)
        zeros = np.zeros(self.q)
        short = np.r_[-1.0, np.zeros(self.p - 1), zeros, np.log(np.std(np.diff(flat)))]
        long = np.r_[np.arctanh(np.clip(partials(autoregression.ar), -0.99, 0.99)), zeros, np.log(autoregression.sd)]
        return [short, long]

    def _model(self, theta: Array) -> nf.ArmaModel:
        # tanh keeps the coefficients inside the circle; 0.999 keeps poles where a window can tell them from a bias
        partial = 0.999 * np.tanh(np.clip(theta[:-1], -6.0, 6.0))
        return nf.ArmaModel(polynomial(partial[: self.p]), polynomial(partial[self.p :]), float(np.exp(theta[-1])))

    def _residual(self, theta: Array, y: Array, variance: float) -> Array:
        model = self._model(theta)
        off = max(abs(float(np.log(model.variance / variance))) - np.log(10.0), 0.0)
        run = filter_heading(y, self.gyro, model)
        if not np.all(run.innovation_variance > 0.0):
            return np.full(self.lags + 2, 1e3)
        nu = (run.innovation / np.sqrt(run.innovation_variance))[SETTLED:]
        size = float(nu @ nu)
        acf = np.array([nu[k:] @ nu[:-k] for k in range(1, self.lags + 1)]) / size
        return np.sqrt(nu.size) * np.r_[acf, np.log(size / nu.size) / np.sqrt(2.0), off]
