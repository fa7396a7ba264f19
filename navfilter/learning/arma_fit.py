"""One channel of a correcting sensor: a slow navigation error with known noise, and the sensor's ARMA error.

``y[k] = d1[k] + n[k] + v[k]``. The drift d1 is the first of a chain of integrators whose noise is known from the
instruments that drive the filter; it starts diffuse. n is the ARMA error to learn, v known white noise. Reading minus
prediction would hide the low frequencies of n, because the prediction follows them; here both compete in one
likelihood, and how well they can be told apart is in the covariance (Harvey 1989, chapter 3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from navfilter.learning.initial_values import grown_point, padded_start
from navfilter.learning.likelihood import Likelihood, maximise
from navfilter.models.navigation_drift import Drift
from navfilter.models.spectrum import log_spread
from navfilter.timeseries.initial_values import tidy_series
from navfilter.timeseries.model import ArmaModel
from navfilter.timeseries.order_criterion import criterion


@dataclass(frozen=True, eq=False)
class ChannelFit:
    """An ARMA error fitted by the channel likelihood.

    Attributes
    ----------
    model : ArmaModel
        With the covariance of ``[ar, ma]`` and `sd_log_s0` from the joint information, ln sd included.
    loglik : float
        Log-likelihood, the diffuse start integrated out.
    bic : float
        ``-2 loglik + (p + q + 1) ln n``.
    n : int
        Innovations that count.
    """

    model: ArmaModel
    loglik: float
    bic: float
    n: int


def fit_channel(
    series: ArrayLike,
    drift: Drift,
    p: int,
    q: int,
    *,
    white: float = 0.0,
    start: ArmaModel | None = None,
    passes: int = 30,
) -> ChannelFit:
    """Fit an ARMA(p, q) error beside a drift of known noise, by Fisher scoring of the exact likelihood.

    Parameters
    ----------
    series : array_like, shape (N,)
        Samples on a uniform grid; NaN is a missing one.
    drift : Drift
        The slow error and the period.
    p, q : int
        Orders.
    white : float
        Variance of known white noise in the series beside the ARMA error.
    start : ArmaModel, optional
        Where to begin (of the same or a lower order); default: several starts, the best of which is followed.
    passes : int
        Most scoring passes.

    Returns
    -------
    ChannelFit

    Raises
    ------
    ValueError
        For a series with infinite, too few or constant samples, and for bad orders or variances.

    Examples
    --------
    >>> import navfilter as nf
    >>> noise = nf.simulate_arma([-0.95], [], 0.2, 3000, seed=1)
    >>> fit = fit_channel(noise + 0.001 * np.arange(3000), Drift((0.0, 0.0), 0.125), 1, 0)
    >>> fit.model.ar.round(2), round(fit.model.sd, 2)
    (array([-0.95]), 0.2)
    """
    if min(p, q) < 0 or int(p) != p or int(q) != q:
        raise ValueError(f"orders must be whole numbers, at least 0, found ({p}, {q}).")
    if not (math.isfinite(white) and white >= 0.0):
        raise ValueError(f"white must be a variance (finite, not negative), found {white}.")
    y = tidy_series(series, 10 + 3 * (p + q) + drift.order, "fit_channel", gaps=True)
    likelihood = Likelihood(y, drift, white)
    if start is None:
        point = grown_point(likelihood, p, q, passes)
    elif start.p > p or start.q > q:
        raise ValueError(f"start has orders ({start.p}, {start.q}), above ({p}, {q}).")
    else:
        theta = np.r_[start.ar, start.ma, math.log(max(start.sd * likelihood.unit, 1e-300))]
        point = maximise(likelihood, [padded_start(theta, start.p, p, q)], p, passes)
    theta, covariance = point.theta, point.covariance
    (value,), innovations = likelihood.standardised([theta], p)
    n, ar, ma = int(np.isfinite(innovations).sum()), theta[:p], theta[p:-1]
    of_s0 = float(log_spread(ar, ma, covariance, np.zeros(1))[0])
    model = ArmaModel(ar, ma, math.exp(theta[-1]) / likelihood.unit, covariance[:-1, :-1], of_s0, float(n))
    loglik = n * math.log(likelihood.unit) - float(value)
    return ChannelFit(model, loglik, criterion("bic", -2.0 * loglik, theta.size, n), n)
