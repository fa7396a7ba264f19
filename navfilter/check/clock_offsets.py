"""Clocks that are far off, so that a stream follows none of the others: one keeps GPS time and another one UTC, or was
set by hand.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from navfilter.check.course_fit import WINDOW_S, Paths, share, without_gaps
from navfilter.check.finding import Finding
from navfilter.check.series import Series, correlation, factors, window_edges
from navfilter.models.mission import Array

#: Delays are looked for up to this, or a quarter of the time that both are there [s], in steps of so much [s].
MOST_S, STEP_S = 120.0, 0.5
#: Less is found where sensors are compared closely [s].
LEAST_S = 2.5
#: What a delay leaves unexplained at most [1], and of what is left without one [1].
LEFT, OF_THAT = 0.19, 0.3
#: What follows, or goes the other way, with less than this unexplained, at a delay up to that, needs no other [1], [s].
CLOSE, CLOSELY_S = 0.1, 1.0
#: So many windows are compared at least.
LEAST_WINDOWS = 20
#: Rates of clocks up to this are looked for [1]: 400 rows over 400 s are off by a four hundredth.
RATE = 0.01
#: A drift of less over a mission is none [s].
DRIFT_S = 0.3
#: Steps are those of a rate in whole numbers, or a whole number of seconds, within this share.
ROUND = 2e-4
#: A rate told by noisy comparisons is believed beyond so many standard deviations, and where it leaves so much less.
SURER, EXPLAINS = 5.0, 0.97
#: By how much clocks differ that people mix up [s].
KNOWN = {18.0: "GPS time is 18 s ahead of UTC", 37.0: "TAI is 37 s ahead of UTC", 19.0: "TAI is 19 s ahead of GPS time"}


def late_by(reference: Series, other: Series, window_s: float) -> float | None:
    """By how much a series is late against another one that it follows, by their increments over windows; None where it
    follows closely as it is, or with no delay.

    Parameters
    ----------
    reference, other : (ndarray, ndarray)
        Times [s] and values of what should be the same but for a constant factor.
    window_s : float
    """
    begin, end = (pick(reference[0][i], other[0][i]) for pick, i in ((max, 0), (min, -1)))

    def unexplained(late_s: float) -> float:
        """One that goes the other way is no clock's."""
        edges = window_edges(begin + max(-late_s, 0.0), end - window_s - max(late_s, 0.0), window_s / 4.0)
        if edges.size < LEAST_WINDOWS:
            return 1.0
        wanted, found = (
            np.interp(edges + window_s + shift, *series) - np.interp(edges + shift, *series)
            for series, shift in ((reference, 0.0), (other, late_s))
        )
        agreement, _ = correlation(wanted, found)
        return 1.0 - (agreement if abs(late_s) <= LEAST_S else max(agreement, 0.0)) ** 2

    return _best(unexplained, min(MOST_S, 0.25 * (end - begin)))


def late_path_by(paths: Paths, left: float) -> float | None:
    """By how much a velocity and its heading are late against the positions; None as for `late_by`.

    Parameters
    ----------
    paths : Paths
    left : float
        What is unexplained of the positions' way without a large delay, whatever the signs [1].
    """
    first = max(paths.time_s[0], paths.heading[0][0])
    last = min(paths.time_s[-1], paths.heading[0][-1]) - WINDOW_S
    wanted = paths.moved(paths.places.time_s, paths.places.plane)

    def unexplained(late_s: float) -> float:
        there = (paths.edges + late_s >= first) & (paths.edges + late_s <= last)
        if np.count_nonzero(there) < max(LEAST_WINDOWS, 0.5 * there.size) or not wanted[there].any():
            return 1.0
        if abs(late_s) <= LEAST_S:
            return left
        return share(paths.way(paths.body, late_s)[there], wanted[there])[0]

    return _best(unexplained, min(MOST_S, 0.25 * float(paths.edges[-1] - paths.edges[0])))


class ClockFit(NamedTuple):
    """How the stamps of a series lie against those of another one that shows the same.

    Attributes
    ----------
    late_s, late_sd : float
        By how much it is late in the middle, and the sd of that [s].
    rate, rate_sd : float
        By what share its seconds are too many: 0.0025 where 400 s were stretched over 401 s.
    left, left_without : float
        What is unexplained of the increments, so and with a delay alone [1].
    """

    late_s: float
    late_sd: float
    rate: float
    rate_sd: float
    left: float
    left_without: float


def fitted_clock(reference: Series, other: Series, window_s: float) -> ClockFit | None:
    """Delay and rate of a series' clock against that of another; None where they have too little in common.

    Parameters
    ----------
    reference, other : (ndarray, ndarray)
        Times [s] and values of what should be the same but for a constant factor.
    window_s : float
        Increments are compared over windows of this length.
    """
    begin, end = (pick(reference[0][i], other[0][i]) for pick, i in ((max, 0), (min, -1)))
    edges = window_edges(begin + LEAST_S, end - LEAST_S - window_s, window_s / 4.0)
    edges = without_gaps(edges, reference[0], other[0], window_s=window_s, gap_s=max(window_s, LEAST_S))
    if edges.size < 10 * LEAST_WINDOWS:
        return None
    middle = 0.5 * float(edges[0] + edges[-1])

    def increments(series: Series, late_s: float, rate: float) -> Array:
        ahead, here = (np.interp(at + late_s + rate * (at - middle), *series) for at in (edges + window_s, edges))
        return np.asarray(ahead - here)

    wanted = increments(reference, 0.0, 0.0)

    def alike(late_s: float, rate: float) -> float:
        return correlation(wanted, increments(other, late_s, rate))[0]

    # a clock that runs at another rate blurs any one delay: first the best of a few rates
    grid = [(s, r) for s in np.linspace(-LEAST_S, LEAST_S, 41) for r in np.linspace(-RATE, RATE, 9)]
    late_s, rate = max(grid, key=lambda one: alike(*one))
    by_s = 0.5 * float(np.median(np.diff(other[0])))
    sd = np.array([math.inf, math.inf])
    for _ in range(4):
        here = increments(other, late_s, rate)
        if correlation(wanted, here)[0] < 1.0 - LEFT:
            return None
        change = (increments(other, late_s + by_s, rate) - increments(other, late_s - by_s, rate)) / (2.0 * by_s)
        columns = np.column_stack([np.ones(wanted.size), here, change, change * (edges - middle)])
        best, spread = factors(columns, wanted)
        if abs(best[1]) < 1e-9:
            return None
        late_s, rate = late_s + float(best[2] / best[1]), rate + float(best[3] / best[1])
        sd = np.abs(spread[2:] / best[1])
        if abs(late_s) > LEAST_S or abs(rate) > 2.0 * RATE:
            return None
    delays = late_s + np.linspace(-0.5, 0.5, 21) * abs(rate) * (edges[-1] - edges[0])
    without = 1.0 - max(alike(float(s), 0.0) for s in delays) ** 2
    return ClockFit(float(late_s), float(sd[0]), float(rate), float(sd[1]), 1.0 - alike(late_s, rate) ** 2, without)


def stretched_finding(name: str, what: str, fit: ClockFit, step_s: float, span_s: float) -> Finding:
    """That a stream's stamps, so far apart and over so long [s], are stretched, and how to scale them."""
    own, scale = step_s / (1.0 + fit.rate), 1.0 / (1.0 + fit.rate)
    ends = (fit.late_s + side * fit.rate * span_s for side in (-0.5, 0.5))
    text = what.format("late by {:+.2f} s at the beginning and by {:+.2f} s at the end,".format(*ends))
    cure = "Its stamps are stretched, or rows are missing: set time.scale = "
    within = max(ROUND, min(SURER * fit.rate_sd, 0.3 * abs(fit.rate)))
    if _is_round(own, within) and not _is_round(step_s):
        own = round(own) if own >= 1.0 - within else 1.0 / round(1.0 / own)
        cure += f"{own / step_s:.5f} (rows are then {own:.4g} s apart, and were printed as {step_s:.6g})"
    else:
        cure += f"{scale:.5f} (or {1.0 / scale:.5f} for the other, where several streams say this of it)"
    return Finding("error", "clock", name, f"{text}.", f"{cure} in time of [streams.{name}].")


def noisy_stretch_finding(name: str, what: str, fit: ClockFit | None, time_s: Array) -> Iterator[Finding]:
    """The same of stamps [s] that are compared by what errs much, where it is sure."""
    span_s = float(time_s[-1] - time_s[0])
    if fit is None or abs(fit.rate) < max(SURER * fit.rate_sd, 2.0 * DRIFT_S / span_s):
        return
    if fit.left < EXPLAINS * fit.left_without:
        yield stretched_finding(name, what, fit, float(np.median(np.diff(time_s))), span_s)


def _is_round(step_s: float, within: float = ROUND) -> bool:
    """Whether a step is one that people set: so many in a second, or so many seconds."""
    times = 1.0 / step_s if step_s < 1.0 else step_s
    return abs(times / max(round(times), 1) - 1.0) < within


def _best(unexplained: Callable[[float], float], most_s: float) -> float | None:
    """The delay that explains most, if it is a large one and does so by far better than a small one."""
    if most_s <= LEAST_S:
        return None
    late_s = np.arange(-most_s, most_s + 0.5 * STEP_S, STEP_S)
    left: Array = np.array([unexplained(float(s)) for s in late_s])
    near = np.abs(late_s) <= LEAST_S
    best = int(np.argmin(left))
    if near[best] or np.min(left[np.abs(late_s) <= CLOSELY_S]) < CLOSE:
        return None
    finer = {float(s): unexplained(float(s)) for s in late_s[best] + np.linspace(-STEP_S, STEP_S, 21)}
    found = min(finer, key=lambda s: finer[s])
    return found if finer[found] <= min(LEFT, OF_THAT * float(np.min(left[near]))) else None


def far_finding(name: str, what: str, late_s: float) -> Iterator[Finding]:
    """That a stream is so late against another, and what that may be.

    Parameters
    ----------
    name : str
        Of the stream.
    what : str
        What is late, and against what: two parts of a sentence around ``{}``.
    late_s : float
        Negative: early [s].
    """
    text = what.format(f"{abs(late_s):.1f} s {'late' if late_s > 0.0 else 'early'}")
    known = next((words for s, words in KNOWN.items() if abs(abs(late_s) - s) < STEP_S), "")
    cure = f"One of the two has another clock{f': {known}' if known else ''}. Set time.offset_s = {-late_s:.1f} in"
    cure = f"{cure} [streams.{name}] on top of what it is now, or the opposite there."
    yield Finding("error", "clock", name, text, cure)
