"""The posterior of the slow part: prior times likelihood over its order, correlation time and standard deviation.

For each order and node of ln tau the evidence is a smooth function of ln sd, known at a few places around its peak.
Sums over ln sd and ln tau give what a filter needs: the mean covariance of the slow part, and how sure the spectrum is.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from navfilter.foundation.arrays import Array
from navfilter.learning.likelihood import Likelihood, Point
from navfilter.learning.settings import EFFORT
from navfilter.learning.slow_prior import SlowPrior

#: A node of the prior: order, and number of the correlation time.
Place = tuple[int, int]
#: No slow part at all.
ABSENT: Place = (0, 0)

#: Distance of two places on a line, in its standard deviations: of a Gaussian the sum over such places is the integral
#: to 3e-4.
SPACING = 1.5
#: Places around the peak: from 3 standard deviations below to 4.5 or 6 above. The mean of sd^2 sits two above the peak
#: where a line is as wide as the prior.
AROUND, WIDE = (-2, -1, 0, 1, 2, 3), (-2, -1, 0, 1, 2, 3, 4)
#: A line stays where it is while its places hold the posterior: the log-density falls by at most the one from the peak
#: to its neighbours, and by at least the other to both ends.
STEEPEST, SHALLOWEST = 3.0, 3.0
#: A line wider than this in ln sd is wide.
WIDTH = 0.4
#: Curvature of the log-posterior in ln sd counts as at least this: flat lines are wide, not endless.
FLATTEST = 0.5
#: A line so far below the best is not possible [nat].
IMPOSSIBLE = 9.0
#: Steps between two nodes of ln tau.
STEPS = 5


class Line(NamedTuple):
    """Evidence along ln sd for one order and correlation time.

    Attributes
    ----------
    log_sd, evidence : ndarray, shape (k,)
        Places (unit of the series) and the log-likelihood there, but for a constant common to all lines.
    peak, sd : float
        Where the posterior has its peak, and how wide it is.
    """

    log_sd: Array
    evidence: Array
    peak: float
    sd: float


#: A search for a line: it yields places where minus the log-likelihood is wanted, and is sent it there.
Search = Generator[list[float], list[float], Line]


@dataclass(frozen=True, eq=False)
class SlowPosterior:
    """Weighted nodes of the slow part.

    Attributes
    ----------
    lines : dict of (order, number of tau) to Line
        Those that are possible.
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


def log_share(likelihood: Likelihood, point: Point) -> float:
    """Log of what the penalised likelihood of a point is multiplied by where its slow part is integrated out
    (Laplace's approximation), with the prior odds of a slow part that is there, or is not.
    """
    prior = likelihood.prior
    if prior is None:
        return 0.0
    if not point.slow:
        return math.log(max(prior.absent, 1e-300))
    volume = math.sqrt(float(np.linalg.det(point.covariance[-2:, -2:])))
    # nodes of the correlation time stand ln 2 apart
    return math.log((1.0 - prior.absent) * 2.0 * math.pi * volume / math.log(2.0)) - prior.log_mass


def slow_posterior(likelihood: Likelihood, point: Point, known: Mapping[Place, Line] | None = None) -> SlowPosterior:
    """The posterior of the slow part, given the fast one of a point, near the slow one of it or, where lines of an
    earlier look are `known`, near those.
    """
    prior = likelihood.prior
    assert prior is not None
    fast, (here, at), sd = likelihood.fast(point.theta, point.slow), prior.centre, prior.spread
    if point.slow:
        here, at, sd = float(point.theta[-2]) - likelihood.log_unit, float(point.theta[-1]), point.info[-2, -2] ** -0.5
    log_taus = np.log(prior.taus_s).tolist()
    # along the ridge of equal driving noise
    guesses = [(here + 0.5 * (log_tau - at), float(sd)) for log_tau in log_taus]
    lines, best = dict[Place, Line](), [-math.inf]
    for order in (1, 2):
        searches: dict[Place, tuple[float, Search]] = {}
        for number, log_tau in enumerate(log_taus):
            place, look = (order, number), _Look(prior, order, log_tau, best)
            known_line = known and known.get(place)
            searches[place] = log_tau, look.again(known_line) if known_line else look.line(*guesses[number])
        if order == 1:
            # none at all: one too small to matter
            look = _Look(prior, 1, log_taus[-1], best)
            searches[ABSENT] = look.log_tau, look.smallest()
        lines |= _together(likelihood, fast, point.p, order, searches)
        # the peak of second order is near that of first
        guesses = [(lines[order, number].peak, lines[order, number].sd) for number in range(len(log_taus))]
    return _weighed(lines, prior)


def _together(
    likelihood: Likelihood, fast: Array, p: int, order: int, searches: Mapping[Place, tuple[float, Search]]
) -> dict[Place, Line]:
    """What searches of one order find, each along its ln tau: what they want to know next is measured side by side."""
    asked = {place: next(search) for place, (_, search) in searches.items()}
    found: dict[Place, Line] = {}
    while asked:
        log_tau = [searches[place][0] for place, log_sd in asked.items() for _ in log_sd]
        values = likelihood.lines(fast, p, order, log_tau, [u for log_sd in asked.values() for u in log_sd])
        answers = iter(values.tolist())
        for place, log_sd in list(asked.items()):
            try:
                asked[place] = searches[place][1].send([next(answers) for _ in log_sd])
            except StopIteration as end:
                found[place] = end.value
                del asked[place]
    return found


def _weighed(lines: dict[Place, Line], prior: SlowPrior) -> SlowPosterior:
    """The places of all lines as nodes: how probable each line is, and how that is shared by its places."""
    lines = {place: lines[place] for place in sorted(lines)}
    order, number = np.array(list(lines)).T
    sizes, there = [line.log_sd.size for line in lines.values()], order > 0
    begins = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    log_sd, evidence = (np.concatenate([line[i] for line in lines.values()]) for i in (0, 1))
    kind, tau_s = np.repeat(np.maximum(order, 1), sizes), np.repeat(prior.taus_s[number], sizes)
    evidence = np.maximum(evidence, -1e300)
    log = evidence + prior.log_density(kind, log_sd, np.log(tau_s))
    tops = np.maximum.reduceat(log, begins)
    shares = np.exp(log - np.repeat(tops, sizes))
    totals = np.add.reduceat(shares, begins)
    shares /= np.repeat(totals, sizes)
    tops += np.log(totals * SPACING * np.array([line.sd for line in lines.values()]))
    absent = prior.log_mass + math.log(max(prior.absent / (1.0 - prior.absent), 1e-300))
    tops = np.where(there, tops, evidence[begins] + absent)
    tops -= tops.max()
    level = np.exp(np.maximum(tops, -700.0))
    level /= level.sum()
    means = np.add.reduceat(shares * np.exp(2.0 * log_sd), begins)[there]
    return SlowPosterior(
        {place: line for (place, line), top in zip(lines.items(), tops.tolist(), strict=True) if top > -IMPOSSIBLE},
        order=kind.astype(np.float64),
        tau_s=tau_s,
        log_sd=log_sd,
        weight=np.repeat(level, sizes) * shares,
        moments=_between(prior.taus_s, tops[there], np.log(means), float(level[there].sum())),
    )


def _between(taus: Array, tops: Array, means: Array, present: float) -> Array:
    """Weights and means of sd^2 between the nodes of ln tau, see `SlowPosterior.moments`; their sum is `present`."""
    smooth, straight = _fine(taus.size)
    level = np.maximum(tops.reshape(2, -1), -50.0)
    out = np.empty((2, len(smooth), 4))
    out[..., 0] = [[1.0], [2.0]]
    out[..., 1] = np.exp(straight @ np.log(taus))
    out[..., 2] = np.exp(np.minimum(level @ smooth.T, level.max(axis=1, keepdims=True) + 0.5))
    out[..., 3] = np.exp(means.reshape(2, -1) @ straight.T)
    out[..., 2] *= present / out[..., 2].sum()
    return out.reshape(-1, 4)


@cache
def _fine(nodes: int) -> tuple[Array, Array]:
    """What makes values on the finer grid of those at so many nodes, `STEPS` from each to the next: natural cubic
    splines, and straight lines.
    """
    places = np.arange(float(nodes))
    fine = np.linspace(0.0, nodes - 1.0, STEPS * (nodes - 1) + 1)
    straight = np.array([np.interp(fine, places, row) for row in np.eye(nodes)]).T
    # second derivatives at the nodes: none at the ends, and no jump of the first one elsewhere
    bends = np.zeros((nodes, nodes))
    inner = np.diff(np.eye(nodes), 2, axis=0)
    bends[1:-1] = np.linalg.solve((inner @ np.eye(nodes)[:, 1:-1]) / 6.0 + np.eye(nodes - 2), inner)
    # between two nodes the straight line, and what bends by one at one node and by nothing at the other
    bent = (straight**3 - straight) / 6.0
    return straight + bent @ bends, straight


class _Look:
    """Looks for the peak of one line, and measures the evidence around it; `best` is the highest log-posterior that any
    line has found.

    Where minus the log-likelihood is wanted, the methods yield the places, and are sent it.
    """

    def __init__(self, prior: SlowPrior, order: int, log_tau: float, best: list[float]) -> None:
        self.evidence: dict[float, float] = {}
        self.low, self.high = (math.log(limit) for limit in prior.sd_limits)
        self.centre, self.spread = prior.centre[0], prior.spread
        self.log_tau, self.best = log_tau, best
        self.most = float(prior.log_density(order, self.centre, self.log_tau))

    def along(self, places: list[float]) -> Generator[list[float], list[float], list[float]]:
        """The evidence at these places; what is not yet known is measured together."""
        keys = [round(place, 6) for place in places]
        new = [key for key in dict.fromkeys(keys) if key not in self.evidence]
        if new:
            values = yield new
            for key, value in zip(new, values, strict=True):
                self.evidence[key] = -value
        return [self.evidence[key] for key in keys]

    def log_prior(self, place: float) -> float:
        """The log-density of the prior at a place."""
        return self.most - 0.5 * ((place - self.centre) / self.spread) ** 2

    def at(self, *places: float) -> Generator[list[float], list[float], list[float]]:
        """The log-posterior at these places."""
        found = yield from self.along(list(places))
        return [evidence + self.log_prior(place) for evidence, place in zip(found, places, strict=True)]

    def smallest(self) -> Search:
        """The line of the smallest size there is."""
        evidence = yield from self.along([self.low])
        return Line(np.array([self.low]), np.array(evidence), self.low, 1.0)

    def line(self, guess: float, sd: float) -> Search:
        """The line around its peak, which is looked for from a guess of place and width."""
        u, step = min(max(guess, self.low), self.high), SPACING * sd
        value = below = above = 0.0
        for _ in range(16):
            below, value, above = yield from self.at(u - step, u, u + step)
            bend, slope = (2.0 * value - below - above) / step**2, 0.5 * (above - below) / step
            self.best[0] = max(self.best[0], value)
            if bend > 0.0 and value + EFFORT.optimism * 0.5 * slope**2 / bend < self.best[0] - IMPOSSIBLE:
                # no more is to be known of it
                return Line(np.array([u]), np.array((yield from self.along([u]))), u, sd)
            if max(below, above) > value:
                away = math.copysign(2.0 * step, above - below)
                jump = slope / bend if bend > 0.0 and math.isfinite(bend) else away
                moved = min(max(u + min(max(jump, -8.0 * step), 8.0 * step), self.low), self.high)
                if moved == u or not (yield from self.at(moved))[0] > max(below, above):
                    moved = u - step if below > above else u + step
                if not self.low <= moved <= self.high:
                    break
                u, step = moved, min(1.6 * step, 1.5)
                continue
            if not bend * step**2 > 12.0:
                break
            step /= 2.5
        bend = (2.0 * value - below - above) / step**2
        width = 1.0 / math.sqrt(max(bend, FLATTEST)) if math.isfinite(bend) else 1.0 / math.sqrt(FLATTEST)
        offset = 0.5 * (above - below) / step * width**2 if math.isfinite(above - below) else 0.0
        peak = u + min(max(offset, -step), step)
        if abs(peak - u) < 0.5 * step and 0.75 < SPACING * width / step < 1.25:
            peak, width = u, step / SPACING  # what has been measured already will do
        places = [peak + k * SPACING * width for k in (WIDE if width > WIDTH else AROUND)]
        evidence = yield from self.along(places)
        return Line(np.array(places), np.array(evidence), peak, width)

    def again(self, line: Line) -> Search:
        """The line at the places of another one; looked for from the highest where these do not do."""
        places = line.log_sd.tolist()
        evidence = yield from self.along(places)
        log = [one + self.log_prior(place) for one, place in zip(evidence, places, strict=True)]
        highest = max(log)
        top, self.best[0] = log.index(highest), max(self.best[0], highest)
        # the sum over places stands for the integral while the curve bends by less than this from one to the next
        near = 0 < top < len(log) - 1 and highest - min(log[top - 1], log[top + 1]) < STEEPEST
        if near and highest - max(log[0], log[-1]) > SHALLOWEST:
            return line._replace(evidence=np.array(evidence))
        return (yield from self.line(places[top], line.sd))
