"""What stands between a raw sensor stream and an estimator: repeats, resolution, differencing."""

import math
from dataclasses import replace

import numpy as np

from navfilter.foundation.arguments import needs, numbers
from navfilter.foundation.arrays import ArrayLike
from navfilter.foundation.display import Shown
from navfilter.timeseries.model import ArmaModel
from navfilter.timeseries.online.order_bank import ArmaBank
from navfilter.timeseries.online.recursive import RecursiveArma


class FrontEnd(Shown):
    """Conditions the samples of one sensor channel and feeds them to an online estimator.

    The first `learn` samples are looked at before any is passed on: the step of the digits is found, and how often a
    value repeats. If values repeat far more often than the digits explain, the sensor is slower than the logger, and
    repeats are dropped (time does not advance); if they repeat now and then, it gets stuck, and repeats count as
    missing. Mean, regressors and clipping of innovations are the estimator's (`mean`, `exog`, `clip`): they are
    carried beside the coefficients, because subtracting them first shortens slow correlations.

    Parameters
    ----------
    estimator : RecursiveArma or ArmaBank
        Fed with the conditioned samples.
    difference : {0, 1, 2}
        Times to difference (ARIMA): 1 turns random walk + white noise into MA(1).
    season : int
        Lag of a further, seasonal difference (0 = none).
    repeats : {"auto", "drop", "missing", "keep"}
        What to do with a value equal to the one before.
    learn : int
        Samples looked at first.

    Examples
    --------
    >>> import numpy as np, navfilter as nf
    >>> walk = np.cumsum(0.02 * np.random.default_rng(0).normal(size=8000))
    >>> level = walk + np.random.default_rng(1).normal(size=8000)
    >>> front = FrontEnd(nf.RecursiveArma(0, 1, 4000, mean=False), difference=1)
    >>> front.update_many(level)
    >>> bool(-1.0 < front.model.ma[0] < -0.95)
    True
    """

    def __init__(
        self,
        estimator: RecursiveArma | ArmaBank,
        *,
        difference: int = 0,
        season: int = 0,
        repeats: str = "auto",
        learn: int = 200,
    ) -> None:
        needs("FrontEnd: estimator", estimator, RecursiveArma, ArmaBank)
        if difference not in (0, 1, 2):
            raise ValueError(f"difference must be 0, 1 or 2, found {difference}. More would only add noise.")
        if int(season) != season or season < 0:
            raise ValueError(f"season must be a lag in samples, 0 for none, found {season}.")
        if repeats not in ("auto", "drop", "missing", "keep"):
            raise ValueError(f'repeats must be "auto", "drop", "missing" or "keep", found {repeats!r}.')
        if learn < 20:
            raise ValueError(f"learn must be at least 20 samples, found {learn}.")
        self.estimator = estimator
        self.difference, self.season, self.repeats, self.learn = int(difference), int(season), repeats, int(learn)
        self.resolution = 0.0
        self.dropped = 0
        self._exog = isinstance(estimator, RecursiveArma) and estimator.n_exog > 0
        self._held: list[tuple[float, ArrayLike | None]] = []
        self._handling = "keep" if repeats == "auto" else repeats
        self._learnt = False
        self._last = math.nan
        self._lags = [math.nan] * self.difference
        self._season_lags = [math.nan] * self.season

    def _shown(self) -> tuple[str, dict[str, object]]:
        looking = f", looking at the first {self.learn} samples" * (not self._learnt)
        title, rows = self.estimator._shown()
        repeats = f"{self._handling}, {self.dropped} so far"
        rows = {"resolution": f"{self.resolution:.4g}", "repeats": repeats, "difference": self.difference, **rows}
        return f"FrontEnd of {title}{looking}", rows

    def update(self, x: float, exog: ArrayLike | None = None) -> None:
        """Take one raw sample (NaN if it is missing) and the estimator's regressors, if it has any."""
        if self._learnt:
            self._pass_on(float(x), exog)
            return
        self._held.append((float(x), exog))
        if len(self._held) >= self.learn:
            self.flush()

    def update_many(self, series: ArrayLike, exog: ArrayLike | None = None) -> None:
        """Take raw samples in order, shape (N,), with regressors of shape (N, k)."""
        xs = numbers(series, "series")
        if xs.ndim != 1:
            raise ValueError(f"series must be one-dimensional, found shape {xs.shape}. Use one front end per channel.")
        us = None if exog is None else np.asarray(exog, dtype=np.float64).reshape(xs.size, -1)
        for i, x in enumerate(xs):
            self.update(x, None if us is None else us[i])

    def flush(self) -> None:
        """Look at what is held now, and pass it on: for a record shorter than `learn`."""
        first = np.array([x for x, _ in self._held])
        self.resolution = find_resolution(first)
        if self.repeats == "auto":
            seen, expected = repeat_share(first, self.resolution)
            if seen > 3.0 * expected + 0.05:
                self._handling = "drop" if seen > 0.3 else "missing"
        self._learnt = True
        held, self._held = self._held, []
        for x, exog in held:
            self._pass_on(x, exog)

    def _pass_on(self, x: float, exog: ArrayLike | None) -> None:
        if x == self._last and self._handling != "keep":
            self.dropped += 1
            if self._handling == "drop":
                return
            x = math.nan
        else:
            self._last = x
        for i in range(self.difference):
            x, self._lags[i] = x - self._lags[i], x
        if self.season:
            x, oldest = x - self._season_lags[0], x
            self._season_lags = [*self._season_lags[1:], oldest]
        if self._exog and isinstance(self.estimator, RecursiveArma):
            self.estimator.update(x, exog)
        else:
            self.estimator.update(x)

    @property
    def quantisation_variance(self) -> float:
        """Variance of the rounding error, ``resolution^2 / 12`` (Ah-Chong 2003, eq 2.36)."""
        return self.resolution**2 / 12.0

    @property
    def is_quantised(self) -> bool:
        """Whether the digits are coarser than the innovations: rounding is then not white noise, nor small."""
        return self.resolution > self.estimator.model.sd

    @property
    def model(self) -> ArmaModel:
        """The estimator's model with flags "quantised", "repeats" (dropped or missing) and "differenced" added."""
        model = self.estimator.model
        flags = set(model.flags)
        if self._learnt and self.resolution > model.sd:
            flags.add("quantised")
        if self.dropped:
            flags.add("repeats")
        if self.difference or self.season:
            flags.add("differenced")
        return replace(model, flags=frozenset(flags))


def find_resolution(series: ArrayLike) -> float:
    """Step of the digits of a series: the number whose multiples all its gaps are; 0 if there is none.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.random.default_rng(0).normal(size=300)
    >>> round(find_resolution(np.round(x / 0.25) * 0.25), 6), find_resolution(x)
    (0.25, 0.0)
    """
    x = numbers(series, "series")
    values = np.unique(x[np.isfinite(x)])
    if values.size < 2:
        return 0.0
    gaps = np.diff(values)
    # Gaps that are rounding of the numbers themselves are none.
    gaps = gaps[gaps > 1e-12 * np.max(np.abs(values))]
    if gaps.size == 0:
        return 0.0
    # Digits may have been rounded twice (a pressure step printed in centimetres): gaps are multiples up to a quarter.
    step = float(gaps.min())
    step = float(np.mean(gaps[gaps < 1.5 * step]))
    multiples = gaps / step
    if np.max(multiples) > 1e6 or np.any(np.abs(multiples - np.round(multiples)) > 0.25):
        return 0.0
    return float(gaps.sum() / np.sum(np.round(multiples)))


def repeat_share(series: ArrayLike, resolution: float) -> tuple[float, float]:
    """Share of samples equal to the one before, and the share that rounding to `resolution` explains."""
    x = numbers(series, "series")
    steps = np.diff(x[np.isfinite(x)])
    if steps.size == 0:
        return 0.0, 0.0
    spread = math.sqrt(0.5 * math.pi) * float(np.mean(np.abs(steps)))
    if spread == 0.0:
        return 1.0, 1.0
    seen = float(np.mean(steps == 0.0))
    wide = resolution / spread
    if wide == 0.0:
        return seen, 0.0
    # Expectation of 1 - |step|/resolution where positive, the step being normal: two values share a cell.
    gap = math.sqrt(2.0 / math.pi) * (1.0 - math.exp(-0.5 * wide * wide)) / wide
    return seen, math.erf(wide / math.sqrt(2.0)) - gap
