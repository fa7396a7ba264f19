"""What a white description says of low frequencies and the readings cannot: it stays believed.

A vehicle file that states white noise states its power at zero frequency too, and with it how fast many readings make a
mean sure. Readings show the power of the frequencies at which the drift of the navigation does not hide it. Where they
scatter by much less than was described, what is missing may be slower than they can tell: constants that change with
the motion, such as scale and delay, are described like this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.learning.initial_values import with_slow_parts
from navfilter.learning.likelihood import Likelihood, Point, maximise
from navfilter.learning.settings import EFFORT
from navfilter.learning.slow_posterior import SlowPosterior, follow
from navfilter.learning.slow_prior import SlowPrior, slow_prior
from navfilter.learning.zero_frequency import zero_frequency
from navfilter.models.error_models import ErrorModel, GaussMarkov, RandomWalk, Sum, block_level
from navfilter.models.navigation_drift import Drift
from navfilter.timeseries.model import ArmaModel

__all__ = ["SlowErrorEvidence", "WhitePriorTest", "white_description"]

Array = NDArray[np.float64]
#: A part with a smaller probability is none.
IMPROBABLE = 1e-3
#: The slow part that stands for none, in its standard deviation.
NOTHING = 1e-4


class SlowErrorEvidence(NamedTuple):
    """A slow error beside a fast one, where a description has none.

    Attributes
    ----------
    likelihood : Likelihood
    point : Point
        The fast part beside the slow one.
    posterior : SlowPosterior
        Of the slow one.
    gain : float
        What the readings say for it: logarithm of the Bayes factor against the fast part alone.
    """

    likelihood: Likelihood
    point: Point
    posterior: SlowPosterior
    gain: float


@dataclass(frozen=True)
class WhitePriorTest:
    """White noise as it stands in a vehicle file.

    Parameters
    ----------
    level : float
        Its power at zero frequency, per sample [unit^2].
    span_s : float
        Time that the window holds [s].
    usual : SlowPrior, optional
        Slow errors as the sensor's kind has them, there or not with even odds: what is doubted where the readings are
        not white.
    """

    level: float
    span_s: float
    usual: SlowPrior | None = None

    @property
    def slowest_s(self) -> float:
        """A fast part alone has poles at least this quick [s]: what is slower is a slow error."""
        return math.inf if self.usual is None else self.usual.quickest_s

    def doubt(self, found: Point, series: Array, drift: Drift, white: float) -> SlowErrorEvidence | None:
        """What speaks for a slow error beside a fast one that was found alone; None where none can be looked for.

        Parameters
        ----------
        found : Point
            The fast part: the maximum of its own likelihood.
        series : ndarray, shape (n,)
            What it was learnt from.
        drift : Drift
        white : float
            Known white variance in the series.
        """
        if self.usual is None:
            return None
        both = Likelihood(series, drift, white, self.usual)
        starts = with_slow_parts(both, [found.theta], found.p)
        beside = maximise(both, starts, found.p, EFFORT.first_passes, 1)
        if not math.isfinite(beside.value):
            return None
        posterior = follow(both, beside.theta, found.p, {}, 0, 1.0)
        # the posterior's odds are against none beside a fast part that may have counted on one
        smallest = 1, [math.log(self.usual.tau_s)], [math.log(self.usual.sd_limits[0])], 0
        less = both.lines(both.fast(beside.theta, 1), found.p, *smallest) - both.lines(found.theta, found.p, *smallest)
        return SlowErrorEvidence(both, beside, posterior, posterior.log_odds - float(less[0]))

    def unseen(self, found: ArmaModel, series: Array, drift: Drift, white: float) -> tuple[GaussMarkov, ...]:
        """The slow part that stays believed: none where the readings have the power that was described, within a
        factor of two, or exclude it.

        It has what is missing at zero frequency, with any of the correlation times of a slow part. Whether it is there
        or the description was too careful is even beforehand; the likelihood of the window decides, and one process
        with the mean variance and the mean power at zero frequency is handed out.

        Parameters
        ----------
        found : ArmaModel
            What was learnt.
        series : ndarray, shape (n,)
            What it was learnt from.
        drift : Drift
        white : float
            Known white variance in the series.
        """
        has = zero_frequency(found)
        missing = self.level - has
        if not missing > has:
            return ()
        taus = SlowPrior(1.0, self.span_s, self.span_s).taus_s
        variance = missing * drift.period_s / (2.0 * taus)
        likelihood = Likelihood(series, drift, white, SlowPrior(math.sqrt(self.level), self.span_s, self.span_s))
        fast = np.concatenate([found.ar, found.ma, [math.log(found.sd) + likelihood.log_unit]])

        log_sd = 0.5 * np.log([*variance, NOTHING**2 * variance[-1]])
        values = likelihood.lines(fast, found.p, 1, np.log([*taus, taus[-1]]), log_sd, 0)
        gain = values[-1] - values[:-1]
        there = np.exp(np.clip(np.where(np.isfinite(gain), gain, -700.0), -700.0, 700.0)) / taus.size
        share = there / (1.0 + float(there.sum()))
        mean = float(share @ variance)
        if not float(share.sum()) > IMPROBABLE:
            return ()
        return (GaussMarkov(sd=math.sqrt(mean), tau_s=float(share @ (variance * taus)) / mean),)


def white_description(
    model: ErrorModel, period_s: float, span_s: float, kind: ErrorModel | None = None
) -> WhitePriorTest | None:
    """What a description without coloured noise says; None where it has some, or says nothing.

    Parameters
    ----------
    model : ErrorModel
        Of the vehicle file.
    period_s : float
        Of the sensor [s].
    span_s : float
        Time that the window holds [s].
    kind : ErrorModel, optional
        Usual error of the sensor's kind: slow errors are doubted that are as slow, of the size that was described.
    """
    if slow_prior(model, period_s, span_s) is not None:
        return None
    parts = model.parts if isinstance(model, Sum) else (model,)
    level = sum(block_level(part.block(period_s)) for part in parts if not isinstance(part, RandomWalk))
    if not level > 0.0:
        return None
    usual = None if kind is None else slow_prior(kind, period_s, span_s)
    return WhitePriorTest(level, span_s, None if usual is None else replace(usual, sd=math.sqrt(level), absent=0.5))
