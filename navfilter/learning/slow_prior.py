"""The slow part of a sensor's error: what is believed of it beforehand, and its states beside the drift.

A window holds a slow error a few times or never, and the drift of the navigation explains it as well: what is not known
of it has to be carried as variance. So it is always in the model, with a prior from the vehicle file, and never left to
a fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from navfilter.foundation.arrays import Array, Ints
from navfilter.models.error_models import CORRELATION_CONSTANTS, Block, ErrorModel, RandomWalk, block_level
from navfilter.models.learned_arma import LONGEST_SPAN_S, LearnedArma
from navfilter.models.navigation_drift import Drift

#: The time constant of a data sheet is that of the whole error; its slow part is about twice as slow.
SLOWER = 2.0
#: Probability that there is no slow error beside quick ones or white noise, where none is described [1].
UNDESCRIBED = 0.95


@dataclass(frozen=True)
class SlowPrior:
    """What is believed of a slow error before any reading: ``ln sd ~ N(ln(median * sd), spread^2)``, ``ln tau ~ N(ln
    tau_s, tau_spread^2)`` between two limits, of second order with a given probability; with another one there is none.

    Parameters
    ----------
    sd : float
        Standard deviation of the coloured error in the vehicle file [unit].
    tau_s : float
        Its correlation time [s].
    span_s : float
        Time that the window holds [s]. Errors quicker than a sixtieth of it are the fast part's.

    Attributes
    ----------
    median : float
        A vehicle file states the whole of an error: the mean of the slow part's variance is what is stated. So a
        lognormal has its median at `exp(-spread^2)`, 0.62.
    spread : float
        Standard deviation of ln sd: a data sheet is believed within a factor of two.
    tau_spread : float
        Standard deviation of ln tau: time constants are hardly believed, within a factor of seven.
    second_order : float
        Probability that it is smooth: of second order.
    absent : float
        Probability that there is none.
    """

    sd: float
    tau_s: float
    span_s: float
    median: float = 2.0 ** -math.log(2.0)
    spread: float = math.log(2.0)
    tau_spread: float = 2.0
    second_order: float = 0.3
    absent: float = 0.2

    @property
    def quickest_s(self) -> float:
        """The fast part's poles are at least this quick, by their natural frequency [s]."""
        return self.span_s / 60.0

    @cached_property
    def taus_s(self) -> Array:
        """Nodes of the correlation time: a fiftieth of the span, and by twos up to two and a half times it [s]."""
        return self.span_s / 50.0 * 2.0 ** np.arange(8.0)

    @property
    def sd_limits(self) -> tuple[float, float]:
        """No slow error is smaller or larger than this [unit]."""
        return 0.01 * self.sd, 30.0 * self.sd

    def log_density(self, order: Ints | int, log_sd: Array | float, log_tau: Array | float) -> Array:
        """Of one node or several, but for a constant, shape (K,)."""
        centre, centre_tau = self.centre
        off, off_tau = (log_sd - centre) / self.spread, (log_tau - centre_tau) / self.tau_spread
        return np.asarray(np.array(self.log_share)[order - 1] - 0.5 * (off * off + off_tau * off_tau))

    @cached_property
    def log_share(self) -> tuple[float, float]:
        """ln of the probability of either order."""
        return math.log(1.0 - self.second_order), math.log(self.second_order)

    @cached_property
    def centre(self) -> tuple[float, float]:
        """ln sd and ln tau."""
        return math.log(self.median * self.sd), math.log(self.tau_s)

    @cached_property
    def log_mass(self) -> float:
        """Of all nodes, with the constant that `log_density` is without."""
        off = (np.log(self.taus_s) - math.log(self.tau_s)) / self.tau_spread
        return math.log(math.sqrt(2.0 * math.pi) * self.spread * float(np.exp(-0.5 * off**2).sum()))


def described_blocks(model: ErrorModel, period_s: float) -> tuple[Block, ...]:
    """The parts of an error model of the vehicle file, per sample; random walks in it are the drift's."""
    return tuple(part.block(period_s) for part in model.terms if not isinstance(part, RandomWalk))


def slow_prior(
    model: ErrorModel,
    period_s: float,
    span_s: float,
    within: tuple[float, float] | None = None,
    kind: ErrorModel | None = None,
) -> SlowPrior | None:
    """The prior of the slow part from an error model of the vehicle file.

    Parameters
    ----------
    model : ErrorModel
        Of the vehicle file; random walks in it are the drift's.
    period_s : float
        Of the sensor [s].
    span_s : float
        Time that the window holds [s].
    within : (float, float), optional
        Factors within which the model is believed, as it stands, in standard deviation and correlation time. A model
        that is quicker than any slow error says nothing of one.
    kind : ErrorModel, optional
        Usual error of the sensor's kind. Who describes white noise says how large errors are, not how slow: a slow
        error is as slow as that one's and as large as described, and unlikely; without a kind there is none.
    """
    blocks = described_blocks(model, period_s)
    variance, white = sum(block.state_variance for block in blocks), sum(block.r for block in blocks)
    if not variance > 0.0:
        usual = None if kind is None else slow_prior(kind, period_s, span_s)
        if usual is None or not white > 0.0:
            return None
        return replace(usual, sd=math.sqrt(white), absent=UNDESCRIBED)
    # of a Gauss-Markov process S(0) is twice variance times correlation time
    power = (sum(block_level(block) for block in blocks) - white) * period_s
    sd, tau_s = math.sqrt(variance), power / (2.0 * variance)
    if within is None or tau_s < span_s / 50.0:
        if SLOWER * tau_s >= span_s / 50.0:
            return SlowPrior(sd, SLOWER * tau_s, span_s)
        # a slow error beside quick ones has no more power at zero frequency than was described
        return SlowPrior(sd * math.sqrt(50.0 * SLOWER * tau_s / span_s), span_s / 50.0, span_s, absent=UNDESCRIBED)
    spread, tau_spread = math.log(within[0]), math.log(within[1])
    return SlowPrior(sd, tau_s, span_s, median=1.0, spread=spread, tau_spread=tau_spread)


def believed(part: LearnedArma, period_s: float, kind: ErrorModel | None = None) -> SlowPrior | None:
    """The prior of the slow error of a part that learns at this period; `kind`: see `slow_prior`."""
    return slow_prior(part.prior or part, period_s, span_s(part, period_s), part.prior_within, kind)


def span_s(part: LearnedArma, period_s: float) -> float:
    """Time that the window of a learnt part holds, as far as it counts [s]."""
    return min(part.window * period_s, LONGEST_SPAN_S)


def drift_chain(drift: Drift, unit: float) -> Array:
    """What the channel kernel wants to know of the drift: states in units per tick, times `unit`; shape (3, r, r).

    Transition over one tick, its noise, covariance of the start (0 where it is diffuse); r is at least 1.
    """
    chain = _chain(drift).copy()
    chain[1:] *= unit**2
    return chain


@lru_cache(64)
def _chain(drift: Drift) -> Array:
    r = max(drift.order, 1)
    out = np.zeros((3, r, r))
    out[0] = np.eye(r)
    if drift.order:
        per_tick = drift.per_tick()
        out[0], out[1] = Drift(drift.density, 1.0).transition(), per_tick[:r]
        out[2, range(r), range(r)] = np.where(np.isfinite(per_tick[r]), per_tick[r], 0.0)
    return out


def slow_belief(order: int, prior: SlowPrior | None, period_s: float, log_unit: float) -> Array:
    """What the channel kernel wants to know of a slow part of this order, see `navfilter.kernels.arma_likelihood`;
    without a prior each is as likely as any other.
    """
    centre, spread, log_share = (0.0, 0.0), (math.inf, math.inf), 0.0
    if prior is not None and order:
        centre, spread, log_share = prior.centre, (prior.spread, prior.tau_spread), prior.log_share[order - 1]
    rate_s = CORRELATION_CONSTANTS[order] * period_s if order else 0.0
    return np.array([rate_s, log_unit, log_share, centre[0], spread[0], centre[1], spread[1]])
