"""The Allan deviation of a record at rest, with error bars by the degrees of freedom of its own noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from navfilter.foundation.arrays import Array
from navfilter.identification.noise_terms import NoiseFit
from navfilter.timeseries.diagnostics import allan_deviation, allan_edf

#: Averages per decade.
PER_DECADE = 8
#: Probability of an error bar: one standard deviation.
ONE_SIGMA = 0.6827
#: The lowest point needs so many degrees of freedom.
LEAST_EDF = 3.0


@dataclass(frozen=True, eq=False)
class AllanCurve:
    """Overlapping Allan deviation with error bars of one standard deviation.

    Attributes
    ----------
    tau_s, deviation, low, high, edf : ndarray, shape (m,)
        Averaging time, deviation and its bounds [unit], equivalent degrees of freedom.
    model : ndarray, shape (m,)
        Deviation of the fitted terms; NaN at times shorter than the frequencies that were fitted.
    """

    tau_s: Array
    deviation: Array
    low: Array
    high: Array
    edf: Array
    model: Array

    @property
    def lowest(self) -> int:
        """Place of the least deviation among those that are known."""
        known = self.edf >= min(LEAST_EDF, float(self.edf.max()))
        return int(np.argmin(np.where(known, self.deviation, np.inf)))

    @property
    def has_floor(self) -> bool:
        """Whether the deviation rises again behind its least value, by more than chance."""
        k = self.lowest
        return bool(np.any(self.low[k + 1 :] > self.high[k]))


def allan_curve(stretches: Sequence[Array], rate_hz: float, fit: NoiseFit) -> AllanCurve:
    """Of all stretches together, each weighted with its number of differences.

    Parameters
    ----------
    stretches : sequence of ndarray, shape (n,)
        Samples without gaps.
    rate_hz : float
    fit : NoiseFit
        Gives the degrees of freedom, and the deviation of the model.
    """
    longest = max(len(x) for x in stretches)
    top = math.log10(longest // 3)
    counts = np.unique(np.round(np.logspace(0.0, top, int(PER_DECADE * top) + 2)).astype(np.int64))
    total, weight, edf = (np.zeros(counts.size) for _ in range(3))
    for x in stretches:
        some = counts <= x.size // 3
        number = x.size - 2.0 * counts[some] + 1.0
        total[some] += number * allan_deviation(x, rate_hz, counts[some])[1] ** 2
        weight[some] += number
        edf[some] += allan_edf(counts[some], x.size, lambda f: fit.density(f, 1.0 / rate_hz), rate_hz)
    deviation = np.sqrt(total / weight)
    low, high = (deviation * np.sqrt(edf / stats.chi2.ppf(0.5 + sign * ONE_SIGMA / 2.0, edf)) for sign in (1.0, -1.0))
    return AllanCurve(counts / rate_hz, deviation, low, high, edf, _model_allan(fit, counts, rate_hz))


def _model_allan(fit: NoiseFit, counts: NDArray[np.int64], rate_hz: float) -> Array:
    """Allan deviation of the terms of IEEE 952, as sampled."""
    period, tau = 1.0 / rate_hz, counts / rate_hz
    white = fit.terms[0].size ** 2
    # of the tilt: that of quantisation, 3 Q^2 / tau^2
    variance = white / tau + 0.75 * white * (fit.ratio - 1.0) * period / tau**2
    if walk := fit.term("walk"):
        variance = variance + walk.size**2 * (2.0 * counts**2 + 1.0) / (6.0 * counts) * period
    if flicker := fit.term("flicker"):
        variance = variance + flicker.size**2 * 2.0 * math.log(2.0) / math.pi
    fitted = tau >= 0.45 / fit.highest_hz
    return np.where(fitted, np.sqrt(np.maximum(variance, 0.0)), np.nan)
