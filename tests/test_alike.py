"""Axes that are described alike use what the others show of their slow errors."""

import math
from dataclasses import replace

import numpy as np
import pytest

import navfilter as nf
import navfilter.learning.axis_learner as learner_module
from navfilter.learning.axis_learner import Learner, hop_together
from navfilter.learning.hierarchical_prior import APART, alike
from navfilter.learning.moment_matching import slow_psd
from navfilter.learning.slow_posterior import ABSENT, Line, _weighed
from navfilter.learning.slow_prior import SlowPrior
from navfilter.models.navigation_drift import Drift
from navfilter.simulation.faults import draw_error

PERIOD_S = 0.5
PRIOR = SlowPrior(0.02, 60.0, 500.0)
#: Of a level axis of a DVL beside a tactical unit [m/s]: what is slower than some ten seconds is hidden. Of an upright
#: one nothing is.
HIDING, CLEAR = Drift((1e-4, 3e-4, 0.0), PERIOD_S), Drift((), PERIOD_S)
ORDERS = [(0, 0), (1, 0)]


# --- the sum --------------------------------------------------------------------------------------------------------


def posterior(seed, told, prior=PRIOR):
    """Of an axis whose evidence bends in ln sd and ln tau, about a place of its own."""
    rng = np.random.default_rng(seed)
    place = prior.centre[0] + rng.normal(), prior.centre[1] + rng.normal()
    lines = {ABSENT: Line(np.array([math.log(prior.sd_limits[0])]), np.array([-told]), 0.0, 1.0)}
    for order in (1, 2):
        for number, log_tau in enumerate(np.log(prior.taus_s)):
            log_sd = place[0] + 0.4 * np.arange(-3.0, 4.0)
            evidence = -told * ((log_sd - place[0]) ** 2 + 0.5 * (log_tau - place[1]) ** 2) - 0.3 * order
            lines[order, number] = Line(log_sd, evidence, place[0], 0.3)
    return _weighed(lines, prior)


def split(spread):
    """How far the centre is from the prior's, and axes from the centre: together the prior's spread."""
    apart = min(APART, spread / math.sqrt(2.0))
    return math.sqrt(spread**2 - apart**2), apart


def by_loops(posteriors, priors):
    """Weights of all nodes: the joint posterior of centre and axes, one centre after the other."""
    prior = priors[0]

    def gauss(x):
        return math.exp(-0.5 * x * x)

    spreads, (apart, apart_tau) = zip(split(prior.spread), split(prior.tau_spread), strict=True)
    lines = [np.arange(-25, 26) / 25.0 * 5.0 * spread for spread in spreads]
    centres = [
        (prior.centre[0] + x, prior.centre[1] + y, gauss(x / spreads[0]) * gauss(y / spreads[1]))
        for x in lines[0]
        for y in lines[1]
    ]

    def given(log_sd, log_tau, centre):
        among = sum(gauss((t - centre[1]) / apart_tau) for t in np.log(prior.taus_s))
        return gauss((log_sd - centre[0]) / apart) * gauss((log_tau - centre[1]) / apart_tau) / max(among, 1e-30)

    tables = []
    for one, own in zip(posteriors, priors, strict=True):
        # as far from what is believed of this axis as the centre is from what is believed of the first
        log_sd = one.log_sd - own.centre[0] + prior.centre[0]
        nodes = list(zip(log_sd, np.log(one.tau_s), one.weight, strict=True))
        mean = [sum(c[2] * given(s, t, c) for c in centres) / sum(c[2] for c in centres) for s, t, _ in nodes]
        # times the posterior by itself, over the prior that is in it
        tables.append(
            [[w if k == 0 else w * given(s, t, c) / mean[k] for k, (s, t, w) in enumerate(nodes)] for c in centres]
        )
    out = []
    for axis, table in enumerate(tables):
        weights = np.zeros(len(table[0]))
        for number, centre in enumerate(centres):
            others = math.prod(sum(other[number]) for k, other in enumerate(tables) if k != axis)
            weights += centre[2] * others * np.array(table[number])
        out.append(weights / weights.sum())
    return out


@pytest.mark.parametrize("spread", [1.2, PRIOR.spread, 0.5], ids=["doubtful", "usual", "sure"])
@pytest.mark.parametrize("medians", [(0.5, 0.5, 0.5), (0.5, 0.8, 1.0)])
def test_it_is_the_joint_posterior_of_centre_and_axes(medians, spread):
    """However wide the prior: its spread is that of the centre and of axes about it together."""
    priors = [replace(PRIOR, median=median, spread=spread) for median in medians]
    axes = zip(((1, 5.0), (2, 0.3), (3, 1.0)), priors, strict=True)
    posteriors = [posterior(seed, told, prior) for (seed, told), prior in axes]
    told = alike(list(zip(posteriors, priors, strict=True)))
    for found, weights in zip(told, by_loops(posteriors, priors), strict=True):
        # the grid of the centres ends at 3.5 sd
        assert np.abs(found.weight - weights).sum() < 2e-3


def test_evidence_stays_what_it_was_and_an_axis_by_itself_too():
    """What the others say is no evidence of this axis: at the next hop it would count twice."""
    one, other = posterior(1, 5.0), posterior(2, 0.3)
    told = alike([(one, PRIOR), (other, PRIOR)])[1]
    assert not np.allclose(told.weight, other.weight)
    assert told.lines is other.lines
    assert alike([(one, PRIOR)]) == [one]


def test_an_error_that_is_not_there_says_nothing():
    none = posterior(1, 5.0)
    none = none.given(0.0)
    other = posterior(2, 0.3)
    np.testing.assert_allclose(alike([(none, PRIOR), (other, PRIOR)])[1].weight, other.weight, rtol=1e-9)


# --- axes -----------------------------------------------------------------------------------------------------------


def series(sd, tau_s, drift, seed, n=1000):
    rng = np.random.default_rng([seed, 77])
    d = np.zeros(n)
    for density in reversed(drift.density):
        d = np.cumsum(d * PERIOD_S + density * math.sqrt(PERIOD_S) * rng.standard_normal(n))
    error = nf.GaussMarkov(sd=sd, tau_s=tau_s) + nf.White(sd=0.01)
    return d + draw_error(error, PERIOD_S, n, seed, "dvl")


def power(learnt):
    return sum(2.0 * part.sd**2 * part.tau_s for part in learnt.slow)


def learners(*priors):
    return [Learner(ORDERS, 1000, drift, prior=prior) for drift, prior in zip((HIDING, CLEAR), priors, strict=True)]


def test_a_level_axis_has_the_times_that_an_upright_one_shows():
    ratios = []
    for seed in range(4):
        told = [series(0.015, 15.0, HIDING, seed), series(0.015, 15.0, CLEAR, 100 + seed)]
        alone = [learner.hop(y) for learner, y in zip(learners(PRIOR, PRIOR), told, strict=True)]
        level, upright = hop_together(learners(PRIOR, PRIOR), told)
        # the upright one knows it by itself
        assert power(upright) == pytest.approx(power(alone[1]), rel=0.5)
        assert power(level) < power(alone[0])
        ratios.append((power(alone[0]) / (2.0 * 0.015**2 * 15.0), power(level) / (2.0 * 0.015**2 * 15.0)))
    alone, level = np.median(ratios, axis=0)
    assert alone > 10.0 and 0.5 < level < 0.3 * alone


def test_axes_that_are_described_differently_learn_each_by_itself():
    told = [series(0.015, 15.0, HIDING, 1), series(0.015, 15.0, CLEAR, 2)]
    priors = PRIOR, replace(PRIOR, sd=0.01)
    alone = [learner.hop(y) for learner, y in zip(learners(*priors), told, strict=True)]
    for found, own in zip(hop_together(learners(*priors), told), alone, strict=True):
        assert found.slow == own.slow and found.spectrum == own.spectrum


def test_truths_of_axes_that_are_alike_are_where_the_posterior_says(monkeypatch):
    """Centres are drawn from the prior, and the axes about them: ranks of the true power at 2 mHz of the level axis are
    uniform. Of 40 more than 8 beyond a limit of 5 % have a probability of 1e-4, a mean rank that is off by 0.17 (3.7 of
    its standard deviations) as well.
    """
    prior = replace(PRIOR, second_order=1e-6, absent=1e-6)
    (centre_sd, apart), (centre_tau, apart_tau) = split(prior.spread), split(prior.tau_spread)
    seen, whole = [], learner_module.learnt_from

    def noted(likelihood, point, posterior, n):
        seen.append(posterior)
        return whole(likelihood, point, posterior, n)

    monkeypatch.setattr(learner_module, "learnt_from", noted)
    rng, ranks, log_taus = np.random.default_rng(20), [], np.log(prior.taus_s)
    while len(ranks) < 40:
        centre = prior.centre[0] + centre_sd * rng.normal(), prior.centre[1] + centre_tau * rng.normal()
        log_sd, log_tau = (
            middle + by * rng.normal(size=2) for middle, by in zip(centre, (apart, apart_tau), strict=True)
        )
        if not (log_taus[0] < log_tau.min() and log_tau.max() < log_taus[-1]):
            continue
        drawn = [
            series(math.exp(s), math.exp(t), drift, 1000 * k + len(ranks))
            for k, (s, t, drift) in enumerate(zip(log_sd, log_tau, (HIDING, CLEAR), strict=True))
        ]
        hop_together(learners(prior, prior), drawn)
        level, frequency = seen[-2], np.array([0.002])
        true = slow_psd(np.ones(1), np.exp(log_sd[:1]), np.exp(log_tau[:1]), frequency)[0, 0]
        found = slow_psd(level.order, np.exp(level.log_sd), level.tau_s, frequency)[:, 0]
        ranks.append(level.weight[found < true].sum())
    ranks = np.array(ranks)
    assert (ranks > 0.95).sum() <= 8 and (ranks < 0.05).sum() <= 8
    assert abs(ranks.mean() - 0.5) < 0.17
