"""Axes of one instrument that are described alike have like slow errors: what one of them shows, the others may use.

The readings of a level axis cannot tell an error of some minutes from the drift of the tilt, those of an upright one
can. So the slow errors of such axes have a common centre in ln sd and ln tau, of which as little is known beforehand as
of each by itself, and lie about it. That is a hierarchical prior (Gelman et al., Bayesian Data Analysis, 2013, ch. 5),
summed up over a grid of centres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from navfilter.learning.slow_posterior import SlowPosterior
from navfilter.learning.slow_prior import SlowPrior

__all__ = ["APART", "alike"]

Array = NDArray[np.float64]
#: How far the slow errors of such axes are from their centre, in ln sd and in ln tau: a factor of two, but no farther
#: than the centre is from the prior's.
APART = math.log(2.0)
#: Centres reach so far about the prior's [its sd], and are from one to the next as far as axes are apart: of densities
#: so wide the sum is the integral to 1e-8.
REACH = 3.5
#: No node is less probable than this beside a centre.
LEAST_DENSITY = 1e-30


def alike(axes: Sequence[tuple[SlowPosterior, SlowPrior]]) -> list[SlowPosterior]:
    """The posteriors of axes that are described alike, each with what the others say of the centre.

    Parameters
    ----------
    axes : sequence of (SlowPosterior, SlowPrior)
        Each axis by itself, and what is believed of it: the same but for the size, which is told by its fast part.
    """
    if len(axes) < 2:
        return [posterior for posterior, _ in axes]
    prior = axes[0][1]
    belief = np.outer(_centres(prior.spread)[1], _centres(prior.tau_spread)[1])
    densities = [_densities(*axis) for axis in axes]
    # an error that is not there says nothing of the centre
    said = [
        np.log((by_sd * one.weight[:, None]).T @ by_tau)
        for (one, _), (by_sd, by_tau) in zip(axes, densities, strict=True)
    ]
    together = np.sum(said, axis=0)
    out = []
    for (one, own_prior), (by_sd, by_tau), own in zip(axes, densities, said, strict=True):
        share = belief * np.exp(together - own - (together - own).max())
        factor = ((by_sd @ (share / share.sum())) * by_tau).sum(axis=1)
        out.append(one.told(own_prior, np.log(factor)))
    return out


def _apart(spread: float) -> float:
    """How far axes are from their centre, of which and of them together this is the prior's spread."""
    return min(APART, spread / math.sqrt(2.0))


@lru_cache(maxsize=16)
def _centres(spread: float) -> tuple[Array, Array]:
    """A grid of centres, as far as they are from the prior's, and what is believed of them, with the sum one."""
    apart = _apart(spread)
    common = math.sqrt(spread**2 - apart**2)
    steps = math.ceil(REACH * common / apart)
    centres = np.arange(-steps, steps + 1) * apart
    belief: Array = np.exp(-0.5 * (centres / common) ** 2)
    return np.asarray(centres, dtype=np.float64), np.asarray(belief / belief.sum())


def _densities(posterior: SlowPosterior, prior: SlowPrior) -> tuple[Array, Array]:
    """Density of each node given the centre over that given the prior: in ln sd (n, m), and in ln tau (n, k)."""
    (log_sd, by), (log_tau, by_time), nodes = _centres(prior.spread), _centres(prior.tau_spread), np.log(prior.taus_s)
    apart, apart_tau = _apart(prior.spread), _apart(prior.tau_spread)
    by_sd = np.exp(-0.5 * ((posterior.log_sd[:, None] - prior.centre[0] - log_sd) / apart) ** 2)
    by_tau = np.exp(-0.5 * ((nodes[:, None] - prior.centre[1] - log_tau) / apart_tau) ** 2)
    # times have limits: of a centre beyond them all the probability is between them, too
    by_tau /= np.maximum(by_tau.sum(axis=0), LEAST_DENSITY)
    by_tau = by_tau[np.argmin(np.abs(np.log(posterior.tau_s)[:, None] - nodes), axis=1)]
    by_sd, by_tau = np.maximum(by_sd, LEAST_DENSITY), np.maximum(by_tau, LEAST_DENSITY)
    by_sd[0], by_tau[0] = 1.0, 1.0  # none at all
    return by_sd / (by_sd @ by)[:, None], by_tau / (by_tau @ by_time)[:, None]
