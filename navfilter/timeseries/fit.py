"""Batch fit of an ARMA model: exact Gaussian likelihood, or least squares of the prediction errors.

Choose the order of an ARMA model: one warm-started sweep over (p, q) with every criterion, and a choice.

Estimates without iteration: Yule-Walker, Burg and Hannan-Rissanen. Useful alone, and as starts for the exact fit.

Gauss-Markov processes of order n: correlation, exact sampling as ARMA(n, n-1), and fits.

An order-n process obeys ``(d/dt + beta)^n x = w``. With ``u = 2 beta |t|`` its autocorrelation is
``e^(-u/2) sum_k Gamma(n) Gamma(n+k) u^(n-k-1) / ((2n-2)! k! Gamma(n-k))``, k = 0 ... n-1 (Gelb 1974, with the factor
Gamma(n+k) that Ah-Chong (2003), eq. 2.42, lacks).
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import brentq, minimize_scalar

from navfilter.foundation.arguments import numbers
from navfilter.foundation.arrays import Array, ArrayLike, Mask
from navfilter.foundation.display import Value, few
from navfilter.kernels import arma_fit as kernels
from navfilter.timeseries.diagnostics import Whiteness, acf, whiteness
from navfilter.timeseries.initial_values import default_long_order, hannan_rissanen_start, long_residuals, tidy_series
from navfilter.timeseries.likelihood import GapFree, Objective, Point, WithGaps, minimise
from navfilter.timeseries.model import ArmaModel, log_s0_sd, spectral_factor
from navfilter.timeseries.order_criterion import CRITERIA, Choice, criterion
from navfilter.timeseries.roots import pull_inside, resolved_radius


def gauss_markov_correlation(order: int, beta_tau: ArrayLike) -> Array:
    """Autocorrelation (1 at zero) of an order-n Gauss-Markov process at ``beta * |tau|``."""
    _check_order(order)
    u = 2.0 * np.abs(np.asarray(beta_tau, dtype=np.float64))
    total = np.zeros_like(u)
    for k in range(order):
        weight = math.gamma(order) * math.gamma(order + k)
        weight /= math.factorial(2 * order - 2) * math.factorial(k) * math.gamma(order - k)
        total = total + weight * u ** (order - k - 1)
    return np.asarray(np.exp(-0.5 * u) * total)


def correlation_product(order: int) -> float:
    """``beta * tau`` at the 1/e point of the autocorrelation: 1, 2.1462, 2.9046, 3.5126 for orders 1 to 4.

    Examples
    --------
    >>> [round(correlation_product(n), 4) for n in (1, 2, 3, 4)]
    [1.0, 2.1462, 2.9046, 3.5126]
    """
    return float(brentq(lambda x: float(gauss_markov_correlation(order, x)) - math.exp(-1.0), 0.1, 60.0, xtol=1e-13))


def _check_order(order: int) -> None:
    if order != int(order) or not 1 <= order <= 8:
        raise ValueError(f"the Gauss-Markov order must be a whole number from 1 to 8, found {order}.")


def gauss_markov_arma(order: int, sd: float, beta: float, rate_hz: float) -> ArmaModel:
    """Exact ARMA(n, n-1) model of the sampled order-n process.

    ``(1 - e^(-beta D) B)^n x`` is the driving noise seen through the spline ``e^(-beta s) B_n(s)``, whose overlaps give
    the moving average without cancellation however short the period D.

    Parameters
    ----------
    order : int
        Order n.
    sd : float
        Standard deviation of the process.
    beta : float
        Inverse time constant, 1/s.
    rate_hz : float
        Sampling rate, Hz.

    Examples
    --------
    >>> gauss_markov_arma(2, 1.0, 1e-4, 1.0).ma.round(5)        # 2 - sqrt(3) for short periods
    array([0.26795])
    """
    _check_order(order)
    if not (sd > 0.0 and beta > 0.0 and rate_hz > 0.0):
        raise ValueError(f"sd, beta and rate_hz must be positive, found {sd}, {beta}, {rate_hz}.")
    step = beta / rate_hz
    ar = np.array([1.0])
    for _ in range(order):
        ar = np.convolve(ar, [1.0, -math.exp(-step)])
    node, weight = np.polynomial.legendre.leggauss(20)
    node, weight = 0.5 * (node + 1.0), 0.5 * weight
    spline = BSpline.basis_element(np.arange(order + 1), extrapolate=False)
    pieces = [np.nan_to_num(spline(i + node)) * np.exp(-step * (i + node)) for i in range(order)]
    gamma = [sum(float(weight @ (pieces[i] * pieces[i + k])) for i in range(order - k)) for k in range(order)]
    # Process variance for unit driving power, in samples: (2n-2)! / (((n-1)!)^2 (2 beta D)^(2n-1)).
    unit = math.factorial(2 * order - 2) / math.factorial(order - 1) ** 2 / (2.0 * step) ** (2 * order - 1)
    ma, drive = spectral_factor(np.array(gamma))
    return ArmaModel(ar[1:], ma, sd * drive / math.sqrt(unit))


@dataclass(frozen=True)
class GaussMarkovFit:
    """A fitted Gauss-Markov process: standard deviation, ``beta`` (1/s), 1/e time ``tau_s``, log-likelihood.

    `loglik` is NaN for a 1/e fit whose model is too smooth for double precision.
    """

    order: int
    sd: float
    beta: float
    tau_s: float
    loglik: float
    model: ArmaModel


def fit_gauss_markov(
    series: ArrayLike, order: int, rate_hz: float, method: str = "likelihood", trend: str = "constant"
) -> GaussMarkovFit:
    """Fit an order-n Gauss-Markov process.

    Parameters
    ----------
    series : array_like, shape (n,)
        Samples; NaN is a missing one.
    order : int
        Order n of the process.
    rate_hz : float
        Sampling rate, Hz.
    method : {"likelihood", "1/e"}
        Exact likelihood of the sampled process (orders above 1: of a few samples per tau), or the lag at
        which the sample autocorrelation falls to 1/e (quick, biased to short times unless the record is many tau long).
    trend : {"constant", "none", "linear"}
        As in `fit_arma`.

    Raises
    ------
    ValueError
        For unusable series and options.
    """
    _check_order(order)
    if method not in ("likelihood", "1/e"):
        raise ValueError(f'method must be "likelihood" or "1/e", found "{method}".')
    if not (isinstance(rate_hz, int | float | np.integer | np.floating) and rate_hz > 0.0):
        raise ValueError(f"rate_hz must be a positive number, found {rate_hz!r}.")
    x = numbers(series, "series")
    lag = _one_over_e_lag(x)
    # An n-fold pole near 1 loses n-1 times the digits of its distance: keep so many samples per tau.
    thin = max(int(lag / {1: np.inf, 2: 200.0}.get(order, 12.0)), 1)
    problem = Problem(x[::thin], order, order - 1, "likelihood", 0, trend, None)
    objective = problem.objective(order, order - 1)

    def value(log_step: float) -> float:
        model = gauss_markov_arma(order, 1.0, math.exp(log_step), 1.0)
        return objective.evaluate(np.r_[model.ar, model.ma]).value

    product = correlation_product(order)
    if method == "1/e":
        log_step = math.log(product / lag * thin)
    else:
        grid = np.linspace(math.log(product / min(20.0 * lag / thin, problem.y.size)), math.log(10.0), 25)
        values = [value(float(g)) for g in grid]
        i = int(np.argmin(values))
        low, high = float(grid[max(i - 1, 0)]), float(grid[min(i + 1, grid.size - 1)])
        log_step = float(minimize_scalar(value, bounds=(low, high), method="bounded", options={"xatol": 1e-6}).x)
    unit = gauss_markov_arma(order, 1.0, math.exp(log_step), 1.0)
    point = objective.evaluate(np.r_[unit.ar, unit.ma])
    sd, loglik = float(np.nanstd(x)), math.nan
    if math.isfinite(point.value):
        fit = fitted(problem, point, objective, True)
        loglik = fit.loglik
        sd = fit.sd / unit.sd if method == "likelihood" else sd
    elif method == "likelihood":
        raise ValueError(f"order {order} is too smooth at this rate for double precision. Use a lower order or 1/e.")
    beta = math.exp(log_step) * rate_hz / thin
    return GaussMarkovFit(order, sd, beta, product / beta, loglik, gauss_markov_arma(order, sd, beta, rate_hz))


def _one_over_e_lag(x: Array) -> float:
    """Lag in samples, interpolated, at which the autocorrelation first falls below 1/e."""
    level = math.exp(-1.0)
    span = 64
    # It does fall: with the mean removed, all lags together sum to -1/2.
    while True:
        span = min(span, x.size - 1)
        r = acf(x, span)
        below = np.flatnonzero(r < level)
        if below.size:
            i = int(below[0])
            return i - 1 + float((r[i - 1] - level) / (r[i - 1] - r[i]))
        span *= 4


@dataclass(frozen=True, eq=False, repr=False)
class OrderTable(Value):
    """Criteria of every order, rows p = 0 ... max_p, columns q = 0 ... max_q.

    Attributes
    ----------
    loglik, aic, aicc, bic, hq : ndarray, shape (max_p+1, max_q+1)
        Exact log-likelihood (never falling along p or q) and criteria; smaller is better.
    sd : ndarray
        Innovation standard deviation.
    whiteness : ndarray
        The thesis's all-lag WT of the residuals; white noise scores 3.855.
    is_white : ndarray of bool
        Calibrated verdict on the residuals (Ljung-Box and cumulative periodogram, 1 %).
    best : tuple of int
        The chosen (p, q).
    fit : ArmaFit
        The fit at the chosen order.
    fits : dict
        All fits, by (p, q).
    """

    loglik: Array
    aic: Array
    aicc: Array
    bic: Array
    hq: Array
    sd: Array
    whiteness: Array
    is_white: Mask
    best: tuple[int, int]
    fit: "ArmaFit"
    fits: "dict[tuple[int, int], ArmaFit]"

    def _shown(self) -> tuple[str, dict[str, object]]:
        most = tuple(size - 1 for size in self.bic.shape)
        rows: dict[str, object] = {"tried": f"{len(self.fits)} orders up to {most}"}
        rows["white residuals"] = f"{int(self.is_white.sum())} of them"
        near = sorted(self.fits, key=lambda order: self.fits[order].bic)[:3]
        rows["least bic"] = ", ".join(f"{order} {self.fits[order].bic:.6g}" for order in near)
        return f"OrderTable, best {self.best}", rows | {name: self.fit._shown()[1][name] for name in ("ar", "ma", "sd")}


def select_order(
    series: ArrayLike,
    max_p: int = 5,
    max_q: int = 5,
    *,
    d: int = 0,
    trend: str = "constant",
    regressors: ArrayLike | None = None,
    threads: int = 2,
) -> OrderTable:
    """Fit every order up to (max_p, max_q) by exact likelihood and choose one.

    Each order starts from its two smaller neighbours padded with a zero, so that the likelihood of nested models never
    falls.

    Parameters
    ----------
    series : array_like, shape (n,)
        Samples; NaN is a missing one.
    max_p, max_q : int
        Largest orders.
    d, trend, regressors
        As in `fit_arma`.
    threads : int
        Orders of equal p + q are fitted side by side (the kernels release the interpreter lock).

    Returns
    -------
    OrderTable
    """
    if threads < 1:
        raise ValueError(f"threads must be at least 1, found {threads}.")
    problem = Problem(series, max_p, max_q, "likelihood", d, trend, regressors)
    cells: dict[tuple[int, int], tuple[Objective, Point, bool]] = {}
    with ThreadPoolExecutor(threads) as pool:
        for total in range(max_p + max_q + 1):
            line = [(p, total - p) for p in range(max_p + 1) if 0 <= total - p <= max_q]
            line.sort(key=lambda order: -min(order))
            for order, cell in zip(line, pool.map(lambda order: _fit_cell(problem, cells, *order), line), strict=True):
                cells[order] = cell
        fits = dict(
            zip(cells, pool.map(lambda cell: fitted(problem, cell[1], cell[0], cell[2]), cells.values()), strict=True)
        )
        tests = dict(zip(fits, pool.map(_whiteness, fits.values()), strict=True))

    def table(value: dict[tuple[int, int], float]) -> Array:
        return np.array([[value[p, q] for q in range(max_q + 1)] for p in range(max_p + 1)])

    columns = {name: table({k: getattr(f, name) for k, f in fits.items()}) for name in _COLUMNS}
    is_white = table({k: float(t.is_white) for k, t in tests.items()}) > 0.5
    best = choose(fits, tests)
    return OrderTable(
        **columns,
        whiteness=table({k: t.wt for k, t in tests.items()}),
        is_white=is_white,
        best=best,
        fit=fits[best],
        fits=fits,
    )


def _whiteness(fit: "ArmaFit") -> Whiteness:
    return whiteness(fit.residuals, fit.p + fit.q)


_COLUMNS = ("loglik", "aic", "aicc", "bic", "hq", "sd")


def _fit_cell(
    problem: "Problem", cells: dict[tuple[int, int], tuple[Objective, Point, bool]], p: int, q: int
) -> tuple[Objective, Point, bool]:
    """Best point at (p, q): from padded neighbours and, where neither gains, from a fresh start."""
    objective = problem.objective(p, q)
    starts = []
    if p:
        smaller = cells[p - 1, q][1].theta
        starts.append(np.r_[smaller[: p - 1], 0.0, smaller[p - 1 :]])
    if q:
        starts.append(np.r_[cells[p, q - 1][1].theta, 0.0])
    if not starts:
        starts.append(np.zeros(0))
    if p + q <= 4:
        starts.extend(problem.starts(p, q))
    # A short race, then the leader alone: over-fitted orders have long flat valleys that are not worth following.
    leader, done = min((minimise(objective, s, limit=3, tolerance=1e-3) for s in starts), key=lambda run: run[0].value)
    if not done:
        leader, done = minimise(objective, leader.theta, limit=10, tolerance=1e-3)
    return objective, leader, done


#: A lead below 2 is "not worth more than a bare mention" (Kass and Raftery, 1995). The gate is tried on many orders, so
#: it is stricter here than for one series. Beyond a quarter of the circle's radius the first-order spread says nothing
#: about cancellation.
TABLE_CHOICE = Choice(lead=2.0, level=1e-3, farthest=0.25, nearest=False)


def choose(fits: "dict[tuple[int, int], ArmaFit]", tests: dict[tuple[int, int], Whiteness]) -> tuple[int, int]:
    """The chosen order among fitted ones.

    The smallest BIC among orders whose residuals pass the whiteness gate and none of whose pole-zero pairs cancels
    within two standard deviations. Of orders with as many coefficients and nearly the same BIC, the one with fewest
    moving-average coefficients: it forgets its start fastest and has no zeros to keep inside the circle.
    """
    candidates = {k: f for k, f in fits.items() if not cancels(f)} or fits
    white = {
        k: f
        for k, f in candidates.items()
        if min(tests[k].ljung_box_p, tests[k].periodogram_p) >= 0.5 * TABLE_CHOICE.level
    }
    candidates = white or candidates
    lead = min(candidates, key=lambda k: candidates[k].bic)
    close = [
        k for k, f in candidates.items() if sum(k) == sum(lead) and f.bic < candidates[lead].bic + TABLE_CHOICE.lead
    ]
    return min(close, key=lambda k: k[1])


def cancels(fit: "ArmaFit") -> bool:
    """Whether some zero lies within two standard deviations of a pole, so that the pair is noise."""
    return TABLE_CHOICE.cancels(fit.ar, fit.ma, fit.covariance)


_DEGREE = {"none": -1, "constant": 0, "linear": 1}
# A long series is first fitted on this many samples, which costs little and leaves few steps for the whole.
PART = 10_000


@dataclass(frozen=True, eq=False, repr=False)
class ArmaFit(Value):
    """A fitted ARMA model with its likelihood and residuals.

    Attributes
    ----------
    ar, ma : ndarray, shapes (p,) and (q,)
        Coefficients of the `d` times differenced series, sign of ``lfilter([1, *ma], [1, *ar], e)``.
    sd : float
        Standard deviation of the innovation.
    covariance : ndarray, shape (p+q, p+q)
        Asymptotic covariance of ``[ar, ma]``.
    loglik : float
        Exact Gaussian log-likelihood of the differenced series at the estimate, whatever the method; that of the
        residuals alone when poles on the circle leave no exact one.
    aic, aicc, bic, hq : float
        ``-2 loglik`` plus the penalty of Akaike, its small-sample form, Schwarz, and Hannan and Quinn, for
        p + q + 1 parameters and the trend coefficients.
    residuals : ndarray, shape (n - d,)
        Prediction errors; NaN where the sample is missing.
    trend : ndarray
        Coefficients of the constant (level at the middle of the series), the slope per sample and the regressors, in
        the unit of the series; those that differencing cancels are left out.
    n : int
        Number of known samples of the differenced series.
    d : int
        Times the series was differenced.
    method : str
        ``"likelihood"`` or ``"prediction-error"``.
    flags : frozenset of str
        ``"short"`` (fewer than 30 samples per coefficient), ``"not converged"``, ``"unit root"`` (a pole above 1 - 3/n,
        which belongs to a random-walk bias), ``"gaps"``.
    """

    ar: Array
    ma: Array
    sd: float
    covariance: Array
    loglik: float
    aic: float
    aicc: float
    bic: float
    hq: float
    residuals: Array
    trend: Array
    n: int
    d: int
    method: str
    flags: frozenset[str]

    def _shown(self) -> tuple[str, dict[str, object]]:
        sds = np.sqrt(np.diag(self.covariance))
        rows: dict[str, object] = {"ar": _with_sds(self.ar, sds[: self.p]), "ma": _with_sds(self.ma, sds[self.p :])}
        rows |= {"sd": f"{self.sd:.4g}", "trend": few(self.trend) or None}
        rows["loglik"] = f"{self.loglik:.6g} of {self.n} samples by {self.method}"
        rows |= {name: f"{getattr(self, name):.6g}" for name in CRITERIA}
        differenced = f", differenced {self.d} times" if self.d else ""
        return f"ArmaFit({self.p}, {self.q}){differenced}", rows | {"flags": ", ".join(sorted(self.flags)) or None}

    @property
    def p(self) -> int:
        """Number of autoregressive coefficients."""
        return int(self.ar.size)

    @property
    def q(self) -> int:
        """Number of moving-average coefficients."""
        return int(self.ma.size)

    @property
    def model(self) -> ArmaModel:
        """The immutable model of the series itself: the `d` unit roots are part of `model.ar`."""
        ar, covariance, q = np.r_[1.0, self.ar], self.covariance, self.q
        for _ in range(self.d):
            longer = np.zeros((ar.size + q, ar.size - 1 + q))
            p = ar.size - 1
            longer[:p, :p] += np.eye(p)
            longer[1 : p + 1, :p] -= np.eye(p)
            longer[p + 1 :, p:] = np.eye(q)
            ar, covariance = np.convolve(ar, [1.0, -1.0]), longer @ covariance @ longer.T
        spread = None if self.d else log_s0_sd(self.ar, self.ma, self.covariance, self.n)
        return ArmaModel(ar[1:], self.ma, self.sd, covariance, spread, float(self.n), self.flags)


def _with_sds(values: Array, sds: Array) -> str | None:
    return ", ".join(f"{value:.4g} +- {sd:.2g}" for value, sd in zip(values, sds, strict=True)) or None


def fit_arma(
    series: ArrayLike,
    p: int,
    q: int,
    method: str = "likelihood",
    *,
    d: int = 0,
    trend: str = "constant",
    regressors: ArrayLike | None = None,
) -> ArmaFit:
    """Fit an ARMA(p, q) model to a recorded series.

    Parameters
    ----------
    series : array_like, shape (n,)
        Samples; NaN marks a missing one.
    p, q : int
        Orders.
    method : {"likelihood", "prediction-error"}
        Exact Gaussian likelihood (stationary start), or the sum of squared prediction errors with the memory from
        before the first sample left free: the choice for series whose pole is at 1. (With gaps both start stationary.)
    d : int
        Times to difference first (ARIMA).
    trend : {"constant", "none", "linear"}
        Mean or straight line, estimated together with the coefficients, never subtracted beforehand: near a unit root
        that would shorten the correlation time.
    regressors : array_like, shape (n,) or (n, k), optional
        Known inputs (temperature, say) whose coefficients are estimated along.

    Returns
    -------
    ArmaFit

    Raises
    ------
    ValueError
        For a series that is constant, too short, infinite, or not one-dimensional, and for unknown options.

    Notes
    -----
    Levenberg-Marquardt on the exact objective with its exact gradient, from Hannan-Rissanen and other starts.

    Examples
    --------
    >>> from navfilter.timeseries.model import simulate_arma
    >>> fit = fit_arma(simulate_arma([-0.8], [0.4], 2.0, 5000, seed=1), p=1, q=1)
    >>> fit.ar.round(2), fit.ma.round(2), round(fit.sd, 1)
    (array([-0.8]), array([0.39]), 2.0)
    """
    problem = Problem(series, p, q, method, d, trend, regressors)
    objective = problem.objective(p, q)
    part = problem.objective(p, q, PART)
    best, converged = _best_of(part, problem.starts(p, q))
    if min(p, q) >= 2 and not problem.gaps and _holds_a_line(part.residuals(best)):
        other = minimise(part, _line_start(problem, p, q))
        best, converged = min((best, converged), other, key=lambda run: run[0].value)
    if part.count < objective.count:
        best, converged = minimise(objective, best.theta)
    return fitted(problem, best, objective, converged)


def _best_of(objective: Objective, starts: list[Array]) -> tuple[Point, bool]:
    """Best minimum from several starts, each later one followed only while it may still win."""
    best, converged = None, False
    for start in starts:
        point, done = minimise(objective, start, limit=4)
        if not done and math.isfinite(point.value) and (best is None or point.value < best.value + 2.0):
            point, done = minimise(objective, point.theta)
        if math.isfinite(point.value) and (best is None or point.value < best.value):
            best, converged = point, done
    if best is None:
        order = f"({objective.p}, {objective.q})"
        raise ValueError(f"no ARMA{order} start has a finite likelihood: the series is predictable without error.")
    return best, converged


def _smooth_periodogram(e: Array) -> Array:
    """Periodogram without the mean, averaged over five ordinates."""
    power = np.abs(np.fft.rfft(e)[1:]) ** 2
    return np.convolve(power, np.full(5, 0.2), mode="same")


def _holds_a_line(e: Array) -> bool:
    """Whether some frequency stands out of white residuals by five times the mean: one in a thousand by chance."""
    power = _smooth_periodogram(e)
    return bool(power.max() > 5.0 * power.mean())


def _line_start(problem: "Problem", p: int, q: int) -> Array:
    """The fit two orders lower, with a pole pair and a zero pair at the strongest frequency it leaves over.

    A weak line under other noise is a narrow valley of the likelihood that regressions on lags do not lead into.
    """
    smaller = problem.objective(p - 2, q - 2, PART)
    point, _ = _best_of(smaller, problem.starts(p - 2, q - 2))
    power = _smooth_periodogram(smaller.residuals(point))
    w = math.pi * float(np.argmax(power) + 1) / power.size
    pole, zero = ([-2.0 * r * math.cos(w), r * r] for r in (0.995, 0.98))
    a, c = np.r_[1.0, point.theta[: p - 2]], np.r_[1.0, point.theta[p - 2 :]]
    return np.r_[np.convolve(a, [1.0, *pole])[1:], np.convolve(c, [1.0, *zero])[1:]]


def fitted(problem: "Problem", point: Point, objective: Objective, converged: bool) -> ArmaFit:
    """The fit at the minimum `point`, in the unit of the series."""
    p, q, n = objective.p, objective.q, problem.count
    H, _ = objective.linearise(point) if p + q else (np.zeros((0, 0)), None)
    exact = point
    if problem.method != "likelihood":
        kind = WithGaps if problem.gaps else GapFree
        exact = kind(problem.y, problem.regressors, p, q, False).evaluate(point.theta)
        exact = exact if math.isfinite(exact.value) else point
    loglik = -exact.value - 0.5 * n * (1.0 + math.log(2.0 * math.pi)) - n * math.log(problem.scale)
    k = p + q + 1 + len(problem.regressors)
    flags = {"gaps"} if problem.gaps else set()
    if n < 30 * (p + q):
        flags.add("short")
    if not converged:
        flags.add("not converged")
    model = ArmaModel(point.theta[:p], point.theta[p:], 1.0)
    if p and np.any(model.poles.real > resolved_radius(n)):
        flags.add("unit root")
        if problem.method != "likelihood":
            # The least sum of squares lies on the circle, where the search had to stop.
            flags.discard("not converged")
    lost = max(p, q) if problem.method != "likelihood" and not problem.gaps else 0
    trend = point.beta / problem.sizes * problem.scale
    trend[:1] += problem.shift * problem.scale
    return ArmaFit(
        ar=model.ar,
        ma=model.ma,
        sd=problem.scale * math.sqrt(point.power / (n - lost)),
        covariance=_covariance(H),
        loglik=loglik,
        **{name: criterion(name, -2.0 * loglik, k, n) for name in CRITERIA},
        residuals=objective.residuals(point) * problem.scale,
        trend=trend,
        n=n,
        d=problem.d,
        method=problem.method,
        flags=frozenset(flags),
    )


def _covariance(H: Array) -> Array:
    """Inverse of the information matrix; a direction without information gets a large but finite variance."""
    if not H.size:
        return np.zeros((0, 0))
    scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    values = np.maximum(values, 1e-12 * values.max())
    inverse = (vectors / values) @ vectors.T / np.outer(scale, scale)
    return np.asarray(0.5 * (inverse + inverse.T))


# --- what is fitted --------------------------------------------------------------------------------------------------


class Problem:
    """A checked and standardised series, ready to be fitted at several orders.

    Parameters are those of `fit_arma`; `p` and `q` are the largest orders that will be asked for.
    """

    def __init__(
        self, series: ArrayLike, p: int, q: int, method: str, d: int, trend: str, regressors: ArrayLike | None
    ) -> None:
        for name, order in (("p", p), ("q", q), ("d", d)):
            if not isinstance(order, int | float | np.integer) or order != int(order) or order < 0:
                raise ValueError(f"{name} must be a whole number, at least 0, found {order!r}.")
        if method not in ("likelihood", "prediction-error"):
            raise ValueError(f'method must be "likelihood" or "prediction-error", found "{method}".')
        if trend not in _DEGREE:
            raise ValueError(f"trend must be one of {list(_DEGREE)}, found {trend!r}.")
        least = d + 3 * (p + q) + 8
        x = tidy_series(series, least, f"fit_arma with orders ({p}, {q})", gaps=True)
        self.method, self.d = method, d
        inputs = _inputs(x.size, _DEGREE[trend], d, regressors)
        x, self.scale = _standardised(np.diff(x, d) if d else x)
        self.shift = float(np.mean(x[np.isfinite(x)]))
        if _DEGREE[trend] >= 0 and d == 0:
            x -= self.shift
        elif abs(self.shift) > 1e6:
            raise ValueError(
                f'the mean is {self.shift:.1e} times the sd: fit it along with trend="constant", or use d=1.'
            )
        else:
            self.shift = 0.0
        self.y, self.known = x, np.isfinite(x)
        self.count = int(self.known.sum())
        self.gaps = self.count < x.size
        if self.count < least - d:
            raise ValueError(f"only {self.count} samples are left after {d} differences across the gaps. Lower d.")
        self.inputs = inputs
        sizes = np.sqrt(np.mean(inputs**2, axis=1)) if inputs.size else np.ones(len(inputs))
        if np.any(sizes == 0.0):
            raise ValueError("a regressor is zero, or vanishes when differenced. Leave it out.")
        self.regressors = np.ascontiguousarray(inputs / sizes[:, None])
        self.sizes = sizes
        self._long: dict[int, Array] = {}

    def objective(self, p: int, q: int, most: int | None = None) -> Objective:
        """The function to minimise at orders (p, q), of the first samples only when there are twice `most`."""
        n = self.y.size
        # A start that barely moves (a sensor switched on later) says nothing about the rest.
        if most is not None and not self.gaps and n >= 2 * most and np.std(self.y[:most]) > 0.1:
            n = most
        kind = WithGaps if self.gaps else GapFree
        inputs = np.ascontiguousarray(self.regressors[:, :n])
        return kind(self.y[:n], inputs, p, q, self.method == "prediction-error")

    def _filled(self) -> Array:
        x = self.y
        if self.gaps:
            where = np.arange(x.size)
            x = np.interp(where, where[self.known], x[self.known])
        if len(self.regressors):
            gram, right = np.empty((len(self.regressors) + 1,) * 2), np.empty_like(x)
            kernels.inner_products(np.vstack([self.regressors, x]), gram)
            beta = np.linalg.lstsq(gram[:-1, :-1], gram[:-1, -1], rcond=1e-12)[0]
            kernels.without_inputs(np.ascontiguousarray(x), self.regressors, beta, right)
            x = right
        return np.ascontiguousarray(x)

    def starts(self, p: int, q: int) -> list[Array]:
        """Start vectors for orders (p, q), the most promising first."""
        x = self._filled()[:PART]
        short = default_long_order(x.size, p, q)
        if short not in self._long:
            self._long[short] = long_residuals(x, short)
        first = hannan_rissanen_start(x, p, q, self._long[short])
        if not (p and q):
            return [first]
        second = np.r_[pull_inside(hannan_rissanen_start(x, p, 0, self._long[short])), np.zeros(q)]
        if -first[:p].sum() < 0.97:
            return [first, second]
        # Near a unit root the regression on levels is blind to everything else: try its difference too.
        change = np.diff(x)
        rest = hannan_rissanen_start(change, p - 1, q, long_residuals(change, short))
        return [first, second, np.r_[np.convolve(np.r_[1.0, rest[: p - 1]], [1.0, -0.999])[1:], rest[p - 1 :]]]


def _inputs(n: int, degree: int, d: int, regressors: ArrayLike | None) -> Array:
    """Trend columns and regressors as rows, differenced like the series; what differencing cancels is left out."""
    middle = np.arange(n, dtype=np.float64) - 0.5 * (n - 1)
    rows = [middle**power for power in range(degree + 1) if power >= d]
    if regressors is not None:
        extra = numbers(regressors, "regressors")
        extra = extra[:, None] if extra.ndim == 1 else extra
        if extra.ndim != 2 or extra.shape[0] != n:
            raise ValueError(f"regressors must have shape ({n},) or ({n}, k) like the series, found {extra.shape}.")
        if not np.all(np.isfinite(extra)):
            raise ValueError("regressors must be finite: interpolate their gaps first.")
        rows.extend(extra.T)
    table = np.array(rows).reshape(len(rows), n)
    return np.diff(table, d, axis=1) if d else table


def _standardised(x: Array) -> tuple[Array, float]:
    """Series over its sd, and that sd, safe for huge offsets and tiny scales."""
    known = x[np.isfinite(x)]
    if not known.size:
        raise ValueError("no difference of two known samples is left: the gaps are too dense.")
    spread = float(known.max() - known.min())
    if spread == 0.0:
        raise ValueError("the series is constant, it has no error to model.")
    if not np.isfinite(spread):
        raise ValueError("the range of the series overflows. Change its unit.")
    level = x / spread
    sd = float(np.std((x[np.isfinite(x)] - known[0]) / spread))
    return np.ascontiguousarray(level / sd), spread * sd
