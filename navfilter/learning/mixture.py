"""The description stays a hypothesis beside what was learnt, weighed by what navigation feels.

One step ahead a sensor scatters by little; what a filter makes of it depends on sums over a minute. A model that is
right one step ahead may be wrong there, and readings say so only slowly. So what is handed out is a mixture of both,
with the spectrum ``(1 - pi) S_learnt + pi S_described``. Beforehand one is as likely as the other; then ``pi = 1 / (1 +
exp(l_learnt - l_described))``, where l is the exact Gaussian log-likelihood of the sums over `HORIZON_S` of the
open-loop series, beside its drift. What readings scatter by from one to the next is known, and stands in both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit

from navfilter.foundation.arrays import Array
from navfilter.kernels.sum_likelihood import sum_likelihood
from navfilter.learning.learned_model import LearnedModel, nearest
from navfilter.learning.likelihood import Likelihood
from navfilter.models.error_models import (
    Block,
    ErrorModel,
    GaussMarkov,
    White,
    block_diagonal,
    block_level,
    joined_block,
)
from navfilter.models.learned_arma import register_block
from navfilter.timeseries.model import ArmaModel

#: Time over which readings are summed up [s] (chosen: a filter between fixes counts on means over a minute; over 20 s,
#: 5 s and one step learnt models of real dives are further off, by a tenth to a fifth).
HORIZON_S = 60.0
#: Sums that the diffuse start of the drift takes up (derived: it has two states, or three whose last is slow), and how
#: many there are at least that weigh anything [1] (chosen).
FIRST, LEAST = 2, 3
#: Neither of the two is ever less probable [1] (chosen: of a variance nobody sees a millionth).
LEAST_SHARE = 1e-6
#: A diffuse start is so many times as wide as the series, as a variance [1], and a rate as in so many ticks (chosen).
DIFFUSE = 100.0


def described_share(likelihood: Likelihood, described: Block, learnt: Block) -> float:
    """The probability pi of the description beside what was learnt, both per sample: 1/2 while there are fewer than
    `LEAST` sums of the series.
    """
    told = [_sums(likelihood, one) for one in (learnt, described)]
    gain = told[0][0] - told[1][0]
    return (
        float(expit(-gain).clip(LEAST_SHARE, 1.0 - LEAST_SHARE)) if told[0][1] >= LEAST and math.isfinite(gain) else 0.5
    )


def _sums(likelihood: Likelihood, block: Block) -> tuple[float, int]:
    """Log-likelihood of the sums by a model of the error, and how many there are."""
    chain, (diffuse, _, _, white), drift = likelihood.chain, likelihood.rules.tolist(), likelihood.drift
    unit, r = likelihood.unit**2, chain.shape[1]
    start = chain[2].copy()
    wide = DIFFUSE * float(np.nanmax(np.abs(likelihood.y))) ** 2
    for i in range(int(diffuse)):
        start[i, i] = wide / DIFFUSE ** (2 * i)
    C = np.concatenate([np.eye(r)[0] * bool(drift.order), block.C])
    return sum_likelihood(
        likelihood.y,
        max(1, round(HORIZON_S / drift.period_s)),
        FIRST,
        block_diagonal([chain[0], block.Phi]),
        block_diagonal([chain[1], unit * block.Q]),
        C,
        block_diagonal([start, unit * block.P0]),
        unit * block.r + white,
    )


def mixed(
    learnt: LearnedModel, moments: Array, likelihood: Likelihood, described: Sequence[ErrorModel]
) -> LearnedModel:
    """What is handed out of what was learnt of a series, with the moments of its slow part (`SlowPosterior`), and
    of the stationary parts of what was described.
    """
    if not described:
        return learnt
    period_s, fast = likelihood.drift.period_s, learnt.model
    blocks = [part.block(period_s) for part in described]
    noise = sum(part.block(period_s).r for part in learnt.slow)
    # readings scatter by as much from one to the next, whatever is described
    white = max(sum(block.r for block in blocks), noise + fast.sd**2)
    own = joined_block([register_block(fast), *(part.block(period_s) for part in learnt.slow)])
    theirs = joined_block([*(replace(block, r=0.0) for block in blocks), White(math.sqrt(white)).block(period_s)])
    pi = described_share(likelihood, theirs, own)
    told = [_moment(part, block, pi, period_s) for part, block in zip(described, blocks, strict=True) if block.size]
    both = np.concatenate([np.reshape(told, (-1, 4)), moments * [1.0, 1.0, 1.0 - pi, 1.0]])
    slow: tuple[ErrorModel, ...] = nearest(both)
    sd, white = fast.sd * math.sqrt(1.0 - pi), math.sqrt(pi * white + (1.0 - pi) * noise)
    if fast.p + fast.q == 0:
        sd, white = math.hypot(sd, white), 0.0
    if white:
        slow = (*slow, White(white))
    model = ArmaModel(fast.ar, fast.ma, sd, fast.covariance, fast.sd_log_s0, fast.effective_window)
    return LearnedModel(model, slow, learnt.spectrum)


def _moment(part: ErrorModel, block: Block, pi: float, period_s: float) -> list[float]:
    """A described part as one of the moments: order, correlation time [s], weight, variance."""
    variance = block.state_variance
    if isinstance(part, GaussMarkov):
        return [min(part.order, 2), part.tau_s, pi, variance]
    # of a Gauss-Markov process S(0) is twice variance times correlation time
    tau_s = 0.5 * (block_level(block) - block.r) * period_s / variance
    return [1.0, max(tau_s, 0.1 * period_s), pi, variance]
