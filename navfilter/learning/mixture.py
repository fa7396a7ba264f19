"""The description stays a hypothesis beside what was learnt, weighed by what navigation feels.

One step ahead a sensor scatters by little; what a filter makes of it depends on sums over a minute. A model that is
right one step ahead may be wrong there, and readings say so only slowly. So what is handed out is a mixture of both,
with the spectrum ``(1 - pi) S_learnt + pi S_described``. Beforehand one is as likely as the other; then ``pi = 1 / (1 +
exp(l_learnt - l_described))``, where l is the exact Gaussian log-likelihood of the sums over `HORIZON_S` of the
open-loop series, beside its drift. What readings scatter by from one to the next is known, and stands in both.

Once there are sums, each band is weighed by what tells of it. What a lag T holds back thousands of readings have told,
there the description has no share: the spectrum is ``S_learnt + pi H (S_described - S_learnt)``, ``H = 1 / (1 + (w
T)^2)``. Of half their length it has the noise bandwidth of sums; where a drift hides the error from them it is shorter
by as much, down to the slowest pole of a fast part.
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
from navfilter.models.error_models import Block, ErrorModel, GaussMarkov, block_diagonal, block_level, joined_block
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


def described_share(likelihood: Likelihood, described: Block, learnt: Block) -> tuple[float, float] | None:
    """The probability pi of the description beside what was learnt, both per sample, and how much of what sums tell is
    of the error, not of the drift, from 0 to 1; None while there are fewer than `LEAST` sums of the series.
    """
    twice = replace(described, C=math.sqrt(2.0) * described.C, r=2.0 * described.r)
    (ours, count, _), (theirs, _, log), (_, _, other) = (_sums(likelihood, one) for one in (learnt, described, twice))
    if count < LEAST or not math.isfinite(ours - theirs):
        return None
    return float(expit(theirs - ours).clip(LEAST_SHARE, 1.0 - LEAST_SHARE)), (other - log) / (count * math.log(2.0))


def _sums(likelihood: Likelihood, block: Block) -> tuple[float, int, float]:
    """Log-likelihood of the sums by a model of the error, how many there are, and the log of their variances."""
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
    register, beside = register_block(fast), [part.block(period_s) for part in learnt.slow]
    noise = sum(block.r for block in beside)
    # readings scatter by as much from one to the next, whatever is described
    scatter = max(sum(block.r for block in blocks), noise + fast.sd**2)
    weighed = described_share(likelihood, replace(joined_block(blocks), r=scatter), joined_block([register, *beside]))
    told = np.array([_moment(part, block, period_s) for part, block in zip(described, blocks, strict=True)])
    if weighed is None:
        pi, sd, white = 0.5, math.sqrt(0.5) * fast.sd, 0.5 * (scatter + noise)
        parts = [(told[told[:, 0] > 0.0], pi), (moments, 1.0 - pi)]
    else:
        (pi, tells), sd, white = weighed, fast.sd, noise
        lag_s = max(0.5 * HORIZON_S * tells, likelihood.prior.quickest_s if likelihood.prior else 0.0)
        (slow, _), (_, quick) = _lagged(told, lag_s), _lagged(moments, lag_s)
        # half of S(0): of a process variance times correlation time
        power, known = (float(one[:, 1:].prod(axis=1).sum()) for one in (slow, quick))
        known += 0.5 * period_s * (block_level(register) + noise)
        slow[:, 3] *= (power - min(power, known)) / max(power, known)  # the description is no more than all of it
        parts = [(slow, pi), (quick, pi), (moments, 1.0 - pi)]
    if fast.p + fast.q == 0:
        sd, white = math.sqrt(sd**2 + white), 0.0
    model = ArmaModel(fast.ar, fast.ma, sd, fast.covariance, fast.sd_log_s0, fast.effective_window)
    both = np.concatenate([one * [1.0, 1.0, weight, 1.0] for one, weight in parts])
    return LearnedModel(model, nearest(both, model, white, period_s), learnt.spectrum)


def _moment(part: ErrorModel, block: Block, period_s: float) -> list[float]:
    """A described part as one of the moments: order, 0 of white noise, correlation time [s], weight, variance."""
    if isinstance(part, GaussMarkov):
        return [min(part.order, 2), part.tau_s, 1.0, block.variance]
    # of a Gauss-Markov process S(0) is twice variance times correlation time
    tau_s = 0.5 * block_level(block) * period_s / block.variance if block.size else 0.5 * period_s
    return [float(block.size > 0), max(tau_s, 0.1 * period_s), 1.0, block.variance]


def _lagged(moments: Array, lag_s: float) -> tuple[Array, Array]:
    """What a lag lets through of processes, which has all their power at zero frequency, and what it holds back, which
    has what they scatter by from one reading to the next; together they have their variance.
    """
    order, tau_s, weight, variance = moments.T
    share = tau_s / (tau_s + lag_s)
    slow = [np.minimum(order + 1.0, 2.0), tau_s + lag_s, weight, variance * share]
    return np.column_stack(slow), np.column_stack([order, tau_s * (1.0 - share), weight, variance * (1.0 - share)])
