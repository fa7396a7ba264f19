"""The posterior of the slow part: prior times likelihood over its order, correlation time and standard deviation.

For each order and node of ln tau the evidence is a smooth function of ln sd, known at a few places around its peak; it
adds up from hop to hop. Sums over ln sd and ln tau give what a filter needs: the mean covariance of the slow part, and
how sure the spectrum is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from navfilter.error_models import CORRELATION_CONSTANTS, GaussMarkov
from navfilter.learning.likelihood import Likelihood
from navfilter.learning.slow import SlowNode, SlowPrior

__all__ = ["Line", "SlowPosterior", "follow", "slow_psd"]

Array = NDArray[np.float64]
#: A node of the prior: order, and number of the correlation time.
Place = tuple[int, int]

#: Places around the peak, in standard deviations: a spline through them holds the mass to 1e-3.
AROUND = (-4.5, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.5)
#: Evidence so far below the peak of its line is not kept: it would only bend the spline.
DEEP = 80.0
#: Curvature of the log-posterior in ln sd counts as at least this: flat lines are wide, not endless.
FLATTEST = 0.5
#: Places on which a line is summed, and steps between two nodes of ln tau.
FINE, STEPS = 96, 5
#: A part with less than this of the slow variance is left out.
LEAST_SHARE = 1e-4


class Line(NamedTuple):
    """Evidence along ln sd for one order and correlation time.

    Attributes
    ----------
    log_sd, evidence : ndarray, shape (k,)
        Places (unit of the series) and the log-likelihood there, but for a constant common to all lines.
    peak, step : float
        Where the posterior had its peak, and in what steps to look for it next time.
    """

    log_sd: Array
    evidence: Array
    peak: float
    step: float


@dataclass(frozen=True, eq=False)
class SlowPosterior:
    """Weighted nodes of the slow part.

    Attributes
    ----------
    lines : dict of (order, number of tau) to Line
    order, tau_s, log_sd, weight : ndarray, shape (n,)
        Nodes, their weights with the sum one.
    moments : ndarray, shape (m, 4)
        On a finer grid of tau: order, tau [s], weight, mean of sd^2.
    """

    lines: dict[Place, Line]
    order: Array
    tau_s: Array
    log_sd: Array
    weight: Array
    moments: Array

    @property
    def mode(self) -> SlowNode:
        """The most probable node."""
        best = int(np.argmax(self.weight))
        return SlowNode(int(self.order[best]), float(np.exp(self.log_sd[best])), float(self.tau_s[best]))

    def parts(self) -> tuple[GaussMarkov, ...]:
        """At most two processes whose sum has the mean variance and zero-frequency power of the posterior.

        The mean covariance function is a sum over all nodes: what is quicker than its mean ln tau goes into one
        process, what is slower into another, so that a few long correlation times do not make all of it slow.
        """
        order, tau, variance = self.moments[:, 0], self.moments[:, 1], self.moments[:, 2] * self.moments[:, 3]
        total = float(variance.sum())
        if not total > 0.0:
            return ()
        quick = np.log(tau) <= float(variance @ np.log(tau)) / total
        out = []
        for half in (quick, ~quick):
            part = float(variance[half].sum())
            if part > LEAST_SHARE * total:
                second = float(variance[half & (order == 2)].sum()) > 0.5 * part
                mean = float(variance[half] @ tau[half]) / part
                out.append(GaussMarkov(sd=math.sqrt(part), tau_s=mean, order=2 if second else 1))
        return tuple(out)


def slow_psd(order: Array, sd: Array, tau_s: Array, frequency_hz: Array) -> Array:
    """One-sided power spectral density of Gauss-Markov processes [unit^2/Hz], shape (nodes, frequencies)."""
    beta = np.array([CORRELATION_CONSTANTS[1], CORRELATION_CONSTANTS[2]])[np.asarray(order, int) - 1] / tau_s
    w2 = (2.0 * np.pi * np.asarray(frequency_hz)) ** 2
    b, s2 = beta[:, None], np.square(sd)[:, None]
    first = 4.0 * s2 * b / (b**2 + w2)
    second = 8.0 * s2 * b**3 / (b**2 + w2) ** 2
    return np.asarray(np.where(np.asarray(order)[:, None] == 2, second, first))


def follow(
    likelihood: Likelihood, theta: Array, p: int, known: Mapping[Place, Line], first: int, forgetting: float
) -> SlowPosterior:
    """The posterior of the slow part, given the fast one.

    Parameters
    ----------
    likelihood : Likelihood
        With a prior.
    theta : ndarray
        Fast and slow parameters: where to look.
    p : int
        Number of AR coefficients.
    known : dict of (order, number of tau) to Line
        Evidence of earlier hops; empty at the first.
    first : int
        Samples from here on are new; the others have been counted in `known`.
    forgetting : float
        Share of the earlier evidence that still counts.
    """
    prior = likelihood.prior
    assert prior is not None
    fast, here = theta[:-2], (float(theta[-2]) - likelihood.log_unit, float(theta[-1]))
    taus = prior.taus_s
    lines: dict[Place, Line] = {}
    tops, masses, means, nodes = [], [], [], []
    for order in (1, 2):
        for number, tau in enumerate(taus.tolist()):
            place, old = (order, number), known.get((order, number))
            # along the ridge of equal driving noise
            guess = (here[0] + 0.5 * (math.log(tau) - here[1]), 0.3) if old is None else (old.peak, old.step)
            search = _Search(likelihood, fast, p, order, tau, old if first > 0 else None, first, forgetting)
            lines[place] = line = search.line(*guess)
            at, log_mass = _summed(line, order, math.log(tau), prior)
            top = float(log_mass.max())
            mass = np.exp(log_mass - top)
            tops.append(top + math.log(float(mass.sum())))
            masses.append(mass / mass.sum())
            means.append(math.log(float(mass @ np.exp(2.0 * at)) / float(mass.sum())))
            nodes.append(at)
    highest = max(tops)
    lines = {place: line._replace(evidence=line.evidence - highest) for place, line in lines.items()}
    level = np.exp(np.maximum(np.array(tops) - highest, -700.0))
    weight = np.concatenate([w * m for w, m in zip(level / level.sum(), masses, strict=True)])
    orders = np.repeat([1.0, 2.0], taus.size)
    return SlowPosterior(
        lines,
        order=np.repeat(orders, FINE),
        tau_s=np.repeat(np.tile(taus, 2), FINE),
        log_sd=np.concatenate(nodes),
        weight=weight,
        moments=_between(taus, np.array(tops) - highest, np.array(means)),
    )


def _between(taus: Array, tops: Array, means: Array) -> Array:
    """Weights and means of sd^2 between the nodes of ln tau, see `SlowPosterior.moments`."""
    nodes = np.log(taus)
    fine = np.linspace(nodes[0], nodes[-1], STEPS * (nodes.size - 1) + 1)
    rows = []
    for order in (1, 2):
        part = slice((order - 1) * nodes.size, order * nodes.size)
        level = np.maximum(tops[part], -50.0)
        curve = np.minimum(CubicSpline(nodes, level, bc_type="natural")(fine), level.max() + 0.5)
        squares = np.exp(np.interp(fine, nodes, means[part]))
        rows.append(np.column_stack([np.full(fine.size, float(order)), np.exp(fine), np.exp(curve), squares]))
    out = np.vstack(rows)
    out[:, 2] /= out[:, 2].sum()
    return out


def _summed(line: Line, order: int, log_tau: float, believed: SlowPrior) -> tuple[Array, Array]:
    """Places along a line, and the log of the posterior's mass at each."""
    if line.log_sd.size == 1:
        at = np.full(FINE, line.log_sd[0])
        return at, np.full(FINE, float(line.evidence[0]) + believed.log_density(order, float(at[0]), log_tau) - math.log(FINE))
    at = np.linspace(line.log_sd[0], line.log_sd[-1], FINE)
    prior = np.array([believed.log_density(order, float(u), log_tau) for u in line.log_sd])
    return at, _curve(line.log_sd, line.evidence + prior, at) + math.log(at[1] - at[0])


def _curve(x: Array, y: Array, at: Array) -> Array:
    """A smooth curve through evidence; beyond its ends it never rises."""
    if x.size == 1:
        return np.full(np.shape(at), y[0])
    if x.size == 2:
        return np.interp(at, x, y)
    spline = CubicSpline(x, y, bc_type="natural")
    low, high = np.minimum(at - x[0], 0.0), np.maximum(at - x[-1], 0.0)
    ends = max(float(spline(x[0], 1)), 0.0) * low + min(float(spline(x[-1], 1)), 0.0) * high
    return np.asarray(spline(np.clip(at, x[0], x[-1])) + ends)


class _Search:
    """Looks for the peak of one line, and measures the evidence around it."""

    def __init__(
        self,
        likelihood: Likelihood,
        fast: Array,
        p: int,
        order: int,
        tau_s: float,
        known: Line | None,
        first: int,
        forgetting: float,
    ) -> None:
        self.likelihood, self.fast, self.p, self.order = likelihood, fast, p, order
        self.log_tau, self.known, self.first, self.forgetting = math.log(tau_s), known, first, forgetting
        self.evidence: dict[float, float] = {}
        assert likelihood.prior is not None
        self.prior = likelihood.prior
        low, high = np.log(self.prior.sd_limits).tolist()
        self.low, self.high = low, high

    def at(self, log_sd: float) -> float:
        """The log-posterior at one place."""
        key = round(log_sd, 6)
        if key not in self.evidence:
            likelihood = self.likelihood
            theta = np.r_[self.fast, key + likelihood.log_unit, self.log_tau]
            value = likelihood.value(theta, self.p, self.order)
            new = -likelihood.since(self.first) if math.isfinite(value) else -math.inf
            old = self.known
            before = 0.0 if old is None else float(_curve(old.log_sd, old.evidence, np.array([key]))[0])
            self.evidence[key] = new + self.forgetting * before
        return self.evidence[key] + self.prior.log_density(self.order, key, self.log_tau)

    def line(self, guess: float, step: float) -> Line:
        """The line around its peak."""
        u = min(max(guess, self.low), self.high)
        value = self.at(u)
        below = above = value
        for _ in range(16):
            below, above = self.at(u - step), self.at(u + step)
            if max(below, above) > value:
                moved = u - step if below > above else u + step
                if not self.low <= moved <= self.high:
                    break
                u, value, step = moved, max(below, above), min(1.6 * step, 1.5)
                continue
            if 2.0 * value - below - above < 10.0:
                break
            step /= 2.5
        bend = (2.0 * value - below - above) / step**2
        curvature = max(bend, FLATTEST) if math.isfinite(bend) else FLATTEST
        offset = (above - below) / (2.0 * step * curvature) if math.isfinite(above - below) else 0.0
        peak, sd = u + min(max(offset, -step), step), 1.0 / math.sqrt(curvature)
        for k in AROUND:
            if self.low - 0.5 < peak + k * sd < self.high + 0.5:
                self.at(peak + k * sd)
        places = np.array(sorted(self.evidence))
        evidence = np.array([self.evidence[float(k)] for k in places])
        total = evidence + np.array([self.prior.log_density(self.order, float(k), self.log_tau) for k in places])
        kept = np.flatnonzero(np.isfinite(total) & (total > np.max(total) - DEEP))
        inside = slice(int(kept[0]), int(kept[-1]) + 1) if kept.size else slice(0, 1)
        evidence = np.maximum(evidence, -1e300)
        return Line(places[inside], evidence[inside], peak, min(max(1.5 * sd, 0.02), 0.7))
