"""Identify a sensor's error model from a recorded series: order, coefficients, whiteness, and what it means in
words.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from navfilter.foundation.arrays import Array, ArrayLike
from navfilter.foundation.display import Value
from navfilter.identification.conditioning import Conditioned, bridged, condition, gap_free
from navfilter.io import units
from navfilter.io.inertial import Series
from navfilter.models.interpretation import Reading, read_model
from navfilter.timeseries.diagnostics import Whiteness, allan_deviation, whiteness
from navfilter.timeseries.fit import (
    ArmaFit,
    GaussMarkovFit,
    OrderTable,
    cancels,
    fit_arma,
    fit_gauss_markov,
    select_order,
)
from navfilter.timeseries.model import ArmaModel

Say = Callable[[str], Any]

#: Samples per coefficient below which an order is not tried.
SAMPLES_PER_COEFFICIENT = 30
#: Largest share of missing samples that is bridged for the order surface (the fit itself treats them exactly).
BRIDGED_SHARE = 0.02
#: With more gaps than that every likelihood is slow, so fewer orders on fewer samples are compared.
GAPPY_ORDER, GAPPY_SAMPLES = 2, 3000


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Value):
    """What was found.

    Attributes
    ----------
    data : Conditioned
        The samples that were used, and what was done to them.
    table : OrderTable or None
        Criteria of every order; None when the order was given.
    fit : ArmaFit
        Model of the (differenced) samples at the chosen order, near-cancelling pairs removed.
    tests : Whiteness
        Of its residuals.
    reading : Reading
        The model in words, and the error model for a vehicle.
    gauss_markov : tuple of GaussMarkovFit
        Fits of order 1 and 2 for comparison, as far as they exist.
    allan_tau_s, allan, allan_model : ndarray
        Allan deviation of the whole record and of the model (NaN where it has none).
    remarks : tuple of str
        What the reader should know before using the model.
    """

    data: Conditioned
    table: OrderTable | None
    fit: ArmaFit
    tests: Whiteness
    reading: Reading
    gauss_markov: tuple[GaussMarkovFit, ...]
    allan_tau_s: Array
    allan: Array
    allan_model: Array
    remarks: tuple[str, ...]

    def _shown(self) -> tuple[str, dict[str, object]]:
        title, rows = self.fit._shown()
        rows |= {"residuals": "white" if self.tests.is_white else "coloured", "error model": self.reading.error}
        rows["remarks"] = " ".join(self.remarks) or None
        return f"Identification by {title}: {self.reading.text}", rows


def identify(
    series: Series | ArrayLike,
    rate_hz: float | None = None,
    *,
    max_p: int = 10,
    max_q: int = 10,
    order: tuple[int, int] | None = None,
    difference: int = 0,
    detrend: bool = False,
    unit: str = "",
    say: Say | None = None,
    **conditions: Any,
) -> Identification:
    """Identify the error model of one series.

    Parameters
    ----------
    series : Series or array_like, shape (n,)
        Samples at a constant rate; NaN is a missing one.
    rate_hz : float, optional
        Sampling rate; that of the `Series` if it is one.
    max_p, max_q : int
        Largest orders to compare; fewer on short series.
    order : (p, q), optional
        Fit this order instead of choosing one.
    difference : int
        Times to difference first (ARIMA).
    detrend : bool
        Estimate a straight line along with the coefficients, not only a constant.
    unit : str
        Unit of the series, as in `navfilter.io.units`.
    say : callable, optional
        Told in a few words what is being done.
    **conditions
        Of `navfilter.identification.conditioning.condition`: ``from_s, to_s, decimate, seasonal_lag, reject,
        max_samples``.

    Returns
    -------
    Identification

    Raises
    ------
    ValueError
        For a series that is constant, empty, all NaN or too short, or an unknown unit, in one line.

    Examples
    --------
    >>> from navfilter.timeseries.model import simulate_arma
    >>> result = identify(simulate_arma([], [0.5], 2.0, 3000, seed=1), 10.0, max_p=2, max_q=2)
    >>> result.reading.text
    "moving average from the device's own filtering; minimal order (0,1)"
    """
    units.unit(unit)
    if not isinstance(series, Series):
        if rate_hz is None:
            raise ValueError("an array has no sampling rate: give rate_hz.")
        series = Series("series", np.asarray(series), float(rate_hz))
    elif rate_hz is not None:
        series = replace(series, rate_hz=float(rate_hz))
    say = say or (lambda text: None)
    data = condition(series, **conditions)
    trend = "linear" if detrend else "constant"
    table, fit, remarks = _chosen(data, max_p, max_q, order, difference, trend, say)
    tests = whiteness(fit.residuals, fit.p + fit.q)
    reading = read_model(fit.model, data.rate_hz, fit.n, unit, tests.is_white, difference)
    say("Gauss-Markov fits and Allan deviation")
    tau, allan, model = _allan(data, fit.model)
    remarks += _remarks(data, fit, tests, (tau, allan, model), table)
    processes = tuple(_gauss_markov(data, trend)) if not difference else ()
    return Identification(data, table, fit, tests, reading, processes, tau, allan, model, (*data.notes, *remarks))


# --- order and coefficients -----------------------------------------------------------------------------------------


def _chosen(
    data: Conditioned, max_p: int, max_q: int, order: tuple[int, int] | None, d: int, trend: str, say: Say
) -> tuple[OrderTable | None, ArmaFit, list[str]]:
    x = data.value
    remarks: list[str] = []
    missing = int(np.isnan(x).sum())
    if order is not None:
        say(f"fitting order ({order[0]},{order[1]})")
        return None, fit_arma(x, *order, d=d, trend=trend), remarks
    room = max((x.size - missing) // (2 * SAMPLES_PER_COEFFICIENT), 1)
    if missing > BRIDGED_SHARE * x.size and gap_free(x).size < 0.5 * x.size:
        room, short = min(room, GAPPY_ORDER), x[:GAPPY_SAMPLES]
        remarks.append(
            f"{100 * missing / x.size:.0f} % of the samples are missing: orders compared on {short.size} samples"
        )
    else:
        short = gap_free(x) if gap_free(x).size >= 0.5 * x.size else bridged(x)
    p, q = min(max_p, room), min(max_q, room)
    if (p, q) != (max_p, max_q):
        remarks.append(
            f"orders up to ({p},{q}) compared, not ({max_p},{max_q}): {x.size - missing} samples carry no more"
        )
    say(f"comparing {(p + 1) * (q + 1)} orders on {short.size} samples")
    table = select_order(short, p, q, d=d, trend=trend)
    fit = table.fit
    if short.size != x.size or missing:
        say(f"fitting order ({fit.p},{fit.q})")
        fit = fit_arma(x, fit.p, fit.q, d=d, trend=trend)
    return table, *_without_pairs(fit, x, d, trend, remarks)


def _without_pairs(fit: ArmaFit, x: Array, d: int, trend: str, remarks: list[str]) -> tuple[ArmaFit, list[str]]:
    """Refit without pole-zero pairs that cancel within their uncertainty, as long as that costs no BIC worth a word."""
    while fit.p and fit.q and cancels(fit):
        smaller = fit_arma(x, fit.p - 1, fit.q - 1, d=d, trend=trend)
        if smaller.bic > fit.bic + 10.0:
            break
        remarks.append(
            f"order ({fit.p},{fit.q}) has a pole and a zero that cancel: ({smaller.p},{smaller.q}) says the same"
        )
        fit = smaller
    return fit, remarks


def _gauss_markov(data: Conditioned, trend: str) -> list[GaussMarkovFit]:
    found = []
    for order in (1, 2):
        try:
            found.append(fit_gauss_markov(bridged(data.value), order, data.rate_hz, trend=trend))
        except ValueError:
            break
    return found


# --- Allan deviation ------------------------------------------------------------------------------------------------


def _allan(data: Conditioned, model: ArmaModel) -> tuple[Array, Array, Array]:
    whole = gap_free(data.whole)
    whole = bridged(data.whole) if whole.size < 0.9 * data.whole.size else whole
    tau, deviation = allan_deviation(whole, data.rate_hz)
    if data.seasonal_lag:
        return tau, deviation, np.full(tau.size, np.nan)
    return tau, deviation, model_allan_deviation(model, np.round(tau * data.rate_hz).astype(int))


def model_allan_deviation(model: ArmaModel, counts: ArrayLike) -> Array:
    """Allan deviation of a model's series at averages over `counts` samples, exactly; up to two unit roots allowed.

    The Allan variance is half the power of the series seen through the filter "mean of m samples minus mean of the m
    before", so the sum of squares of that filter's response behind ``C/A``.

    Examples
    --------
    >>> model_allan_deviation(ArmaModel([], [], 2.0), [1, 4]).round(6)
    array([2., 1.])
    """
    memory = [-1.0 / math.log(abs(p)) for p in model.poles if 0.0 < abs(p) < 1.0 - 1e-7]
    tail = int(min(20.0 * max(memory, default=0.0), 2e5)) + model.q + 2
    result = []
    for m in np.atleast_1d(np.asarray(counts, dtype=np.int64)):
        x = np.zeros(2 * m + tail)
        x[:m], x[m : 2 * m] = 1.0 / m, -1.0 / m
        response = lfilter(np.r_[1.0, model.ma], np.r_[1.0, model.ar], x)
        result.append(model.sd * math.sqrt(0.5 * float(response @ response)))
    return np.array(result)


# --- remarks --------------------------------------------------------------------------------------------------------


def _remarks(
    data: Conditioned, fit: ArmaFit, tests: Whiteness, curves: tuple[Array, Array, Array], table: OrderTable | None
) -> list[str]:
    remarks = []
    if not tests.is_white:
        remarks.append(
            f"residuals are not white (Ljung-Box p = {tests.ljung_box_p:.2g}, periodogram p = "
            f"{tests.periodogram_p:.2g})"
            + (
                f", nor are those of any of the {table.bic.size} orders"
                if table is not None and not table.is_white.any()
                else ""
            )
        )
    e = fit.residuals[np.isfinite(fit.residuals)]
    robust = 1.4826 * float(np.median(np.abs(e - np.median(e))))
    far = int(np.sum(np.abs(e - np.median(e)) > 6.0 * robust)) if robust > 0.0 else 0
    if far:
        remarks.append(
            f"{far} residuals lie beyond 6 robust standard deviations: impulses (see --reject) or heavy tails"
        )
    if data.step > fit.sd:
        remarks.append(
            f"the step {data.step:.4g} exceeds the innovation sd {fit.sd:.4g}: quantised too coarsely for trustworthy "
            "coefficients"
        )
    if "not converged" in fit.flags:
        remarks.append(
            "the likelihood is flat along some direction: coefficients are not unique, poles and spectrum are"
        )
    straight = _straight(data.value)
    if straight > 0.9 and not fit.d and fit.trend.size < 2:
        remarks.append(
            f"a straight line explains {100 * straight:.0f} % of the variance: see --detrend, or --difference 1"
        )
    drift = _drift(*curves) if data.whole.size > 2 * data.value.size else None
    if drift is not None:
        remarks.append(
            f"beyond {drift:.3g} s the whole record wanders more than the model (Allan deviation): a slow drift that "
            "the fitted samples do not show. Use --decimate, or add a RandomWalk"
        )
    return remarks


def _straight(x: Array) -> float:
    """Share of the variance that a straight line explains."""
    known = np.isfinite(x)
    where = np.arange(x.size)[known]
    return float(np.corrcoef(where, x[known])[0, 1]) ** 2


def _drift(tau: Array, allan: Array, model: Array) -> float | None:
    """Averaging time from which on the record's Allan deviation stays above 1.5 times the model's."""
    # The last points of an Allan deviation rest on a handful of averages and say nothing.
    use = np.isfinite(model) & (tau < 0.1 * 3.0 * tau[-1])
    above = allan[use] > 1.5 * model[use]
    if not above.size or not above[-1]:
        return None
    within = np.flatnonzero(~above)
    return float(tau[use][within[-1] + 1 if within.size else 0])
