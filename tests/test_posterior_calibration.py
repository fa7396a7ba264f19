"""The posterior of the slow part is calibrated: truths drawn from its prior fall where it says they do."""

import math

import numpy as np
import pytest

import navfilter as nf
import navfilter.learning.axis_learner as learner_module
from navfilter.learning.axis_learner import Learner
from navfilter.learning.learned_model import slow_psd
from navfilter.learning.slow_prior import SlowPrior
from navfilter.models.navigation_drift import Drift
from navfilter.simulation.simulate import draw_error

PERIOD_S, WINDOW, WHITE = 0.5, 1000, 0.2
#: Of a tactical gyro [deg]: random walk, bias and its walk.
DRIFT = Drift((0.005, 2.8e-4 / 60.0), PERIOD_S, (math.inf, 1.4e-3))
#: Truths are of first order, and there always: what can be drawn without a corner of the grid.
PRIOR = SlowPrior(0.6, 60.0, 500.0, second_order=1e-6, absent=1e-6)
HOPS_S = (60.0, 120.0, 240.0, 500.0, 750.0, 1000.0)
DRAWS = 48


def truth(random):
    """From the prior, between the nodes of its grid."""
    taus = PRIOR.taus_s
    while True:
        tau_s = PRIOR.tau_s * math.exp(PRIOR.tau_spread * random.standard_normal())
        if taus[0] < tau_s < taus[-1]:
            return PRIOR.median * PRIOR.sd * math.exp(PRIOR.spread * random.standard_normal()), tau_s


def series(sd, tau_s, random, draw):
    n = round(HOPS_S[-1] / PERIOD_S)
    bias = DRIFT.start_sd[1] * random.standard_normal() + np.cumsum(
        DRIFT.density[1] * math.sqrt(PERIOD_S) * random.standard_normal(n)
    )
    heading = np.cumsum(bias * PERIOD_S + DRIFT.density[0] * math.sqrt(PERIOD_S) * random.standard_normal(n))
    error = nf.GaussMarkov(sd=sd, tau_s=tau_s) + nf.White(sd=WHITE)
    return heading + draw_error(error, PERIOD_S, n, draw, "compass")


@pytest.fixture(scope="module")
def ranks():
    """Share of the posterior below the true power at 2 mHz, of each draw at each hop."""
    seen, out = [], np.empty((DRAWS, len(HOPS_S)))
    whole = learner_module.learnt_from

    def noted(likelihood, found):
        seen.append(found)
        return whole(likelihood, found)

    frequency = np.array([0.002])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learner_module, "learnt_from", noted)
        for draw in range(DRAWS):
            random = np.random.default_rng([draw, 90210])
            sd, tau_s = truth(random)
            y, last = series(sd, tau_s, random, draw), 0
            learner = Learner([(0, 0), (1, 0)], WINDOW, DRIFT, prior=PRIOR)
            true = slow_psd(np.ones(1), np.array([sd]), np.array([tau_s]), frequency)[0, 0]
            for k, hop_s in enumerate(HOPS_S):
                end = round(hop_s / PERIOD_S)
                learner.hop(y[max(0, end - WINDOW) : end], end - last)
                last, out[draw, k] = end, 0.0
                for _, posterior, weight in seen[-1]:
                    power = slow_psd(posterior.order, np.exp(posterior.log_sd), posterior.tau_s, frequency)[:, 0]
                    out[draw, k] += weight * posterior.weight[power < true].sum()
    return out


@pytest.mark.slow
@pytest.mark.parametrize("hop", range(len(HOPS_S)))
def test_truths_drawn_from_the_prior_are_where_the_posterior_says(ranks, hop):
    """Ranks are uniform. Of 48 more than 9 beyond a limit of 5 % have a probability of 1e-4, a mean rank that is off by
    0.16 (3.8 of its standard deviations) as well.
    """
    own = ranks[:, hop]
    assert (own > 0.95).sum() <= 9 and (own < 0.05).sum() <= 9
    assert abs(own.mean() - 0.5) < 0.16


@pytest.mark.slow
def test_the_ranks_find_a_posterior_that_is_too_narrow(ranks):
    """What the limits can see: the same truths judged by half the width in ln S would be refused."""
    from scipy.stats import norm

    narrow = norm.cdf(2.0 * norm.ppf(np.clip(ranks, 1e-6, 1.0 - 1e-6)))
    assert ((narrow > 0.95).sum(axis=0) + (narrow < 0.05).sum(axis=0)).max() > 18
