"""Stretched stamps of a velocity or of positions, told by the way that leads from one to the other."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navfilter.check.clock_offsets import LEAST_S, RATE, SURER, ClockFit
from navfilter.check.course_fit import Complex, Paths, displacement, without_gaps
from navfilter.check.series import factors, integral, window_edges
from navfilter.models.mission import Array

#: Displacements are compared over windows of these lengths [s], the first of which says where to begin; over so many
#: at most.
WINDOWS_S, MOST_WINDOWS = (10.0, 5.0, 20.0), 2000
#: Fewer windows say nothing [1].
LEAST_WINDOWS = 40
#: Delays up to this are looked for [s], in steps of so much [s], at both ends of a mission, so long each [s].
MOST_S, STEP_S, END_S = 60.0, 0.5, 600.0
#: A rate counts where windows of two lengths say so by so many sds, and none says the opposite [1].
SURE_TWICE = 3.0
#: Differences for slopes, of a delay [s] and of a rate [1].
BY_S, BY_RATE = 0.3, 3e-4
#: What errs by more times the median is an outlier [1].
OUTLIER = 5.0


class PathClock(NamedTuple):
    """How a velocity's stamps lie against positions.

    Attributes
    ----------
    fit : ClockFit
        Of the velocity against the positions.
    whole : bool
        The heading lies as the velocity does: the positions have another clock than both. Else the velocity has
        another clock than both others.
    """

    fit: ClockFit
    whole: bool


def path_clock(paths: Paths, sure: bool = False) -> PathClock | None:
    """How a velocity's stamps lie against those of positions, which it leads to by the heading.

    Parameters
    ----------
    paths : Paths
    sure : bool
        The velocity's own clock is right.

    Returns
    -------
    PathClock or None
        None where the rate is none, or windows of several lengths do not say the same, of the same clock.

    Notes
    -----
    Displacement = scale and turn of that by dead reckoning, and of what a lever arm swings, which in turns looks like a
    delay (Gauss-Newton, in delay and rate, without outliers).
    """
    begin: dict[bool, tuple[float, float] | None] = {True: None, False: None}
    found: list[PathClock] = []
    for length_s in WINDOWS_S:
        both = []
        for whole in (True,) if sure else (True, False):
            begin[whole], fit = _fit(_Windows.of(paths, length_s), paths, whole, begin[whole])
            both += [PathClock(fit, whole)] if fit is not None else []
        found += [min(both, key=lambda one: one.fit.left)] if both else []
    if len(found) < 2 or len({one.whole for one in found}) > 1:
        return None
    best = min(found, key=lambda one: one.fit.rate_sd)
    apart = [abs(fit.rate - best.fit.rate) / math.hypot(fit.rate_sd, best.fit.rate_sd) for fit, _ in found]
    alike = all(fit.rate * best.fit.rate > 0.0 for fit, _ in found)
    many = sum(abs(fit.rate) > SURE_TWICE * fit.rate_sd for fit, _ in found) > 1
    return best if alike and many and max(apart) < SURER else None


class _Windows(NamedTuple):
    """Starts of the windows, their length, and the displacement of the positions in each."""

    edges: Array
    length_s: float
    wanted: Complex

    @classmethod
    def of(cls, paths: Paths, length_s: float) -> _Windows:
        """Across no gap."""
        times = paths.places.time_s
        begin = max(paths.time_s[0], paths.heading[0][0], times[0]) + LEAST_S
        end = min(paths.time_s[-1], paths.heading[0][-1], times[-1]) - LEAST_S
        edges = window_edges(begin, end - length_s, max(length_s / 3.0, (end - begin) / MOST_WINDOWS))
        gap_s = max(0.5 * length_s, 3.0 * float(np.median(np.diff(times))))
        edges = without_gaps(edges, times, paths.time_s, window_s=length_s, gap_s=gap_s)
        return cls(edges, length_s, displacement(edges, length_s, times, paths.places.plane))

    def part(self, begin_s: float, end_s: float) -> _Windows:
        """Those of a time."""
        inside = (self.edges >= begin_s) & (self.edges + self.length_s <= end_s)
        return _Windows(self.edges[inside], self.length_s, self.wanted[inside])


def _fit(
    windows: _Windows, paths: Paths, whole: bool, known: tuple[float, float] | None
) -> tuple[tuple[float, float] | None, ClockFit | None]:
    """Where it begins, unless that is known, and the fit with windows of one length."""
    if windows.edges.size < LEAST_WINDOWS:
        return known, None
    begin, end = float(windows.edges[0]), float(windows.edges[-1] + windows.length_s)
    middle, span_s = 0.5 * (begin + end), end - begin

    def ways(of: _Windows, late_s: float, rate: float) -> tuple[Complex, Complex]:
        """Displacements by dead reckoning and of a metre of lever arm."""
        near = slice(*np.searchsorted(paths.time_s, (of.edges[0] - 2.0 * MOST_S, of.edges[-1] + 2.0 * MOST_S)))
        stamps = paths.time_s[near]
        at = stamps - late_s - rate * (stamps - middle)
        turn = np.exp(1j * np.interp(stamps if whole else at, *paths.heading))
        pairs = (paths.body[near] * turn).view(float).reshape(-1, 2)
        path = integral(stamps if whole else at, pairs) @ np.array([1.0, 1j])
        return displacement(of.edges, of.length_s, at, path), displacement(of.edges, of.length_s, at, turn)

    def left(of: _Windows, late_s: float, rate: float) -> tuple[complex, Complex]:
        """Scale and turn, and what is left of the displacements."""
        columns = np.column_stack(ways(of, late_s, rate))
        best = np.linalg.lstsq(columns, of.wanted, rcond=None)[0]
        return complex(best[0]), np.asarray(of.wanted - columns @ best)

    late_s, rate = known = known or _begin(windows, left, begin, end)
    spread = np.full(2, np.inf)
    for _ in range(3):
        ratio, off = left(windows, late_s, rate)
        kept = _kept(off)
        way, arm = ways(windows, late_s, rate)
        slopes = [
            (ways(windows, late_s + s, rate + r)[0] - ways(windows, late_s - s, rate - r)[0]) / (2.0 * (s + r))
            for s, r in ((BY_S, 0.0), (0.0, BY_RATE))
        ]
        parts = (ratio * slopes[0], ratio * slopes[1], ratio * way, 1j * ratio * way, arm, 1j * arm)
        columns = np.column_stack([np.ascontiguousarray(part[kept]).view(float) for part in parts])
        best, sds = factors(columns, np.ascontiguousarray(windows.wanted[kept]).view(float))
        late_s, rate, spread = late_s + float(best[0]), rate + float(best[1]), sds[:2]
        if abs(late_s) > MOST_S or abs(rate) > 2.0 * RATE:
            return known, None
    kept = _kept(left(windows, late_s, rate)[1])
    power = float(np.sum(np.abs(windows.wanted[kept]) ** 2))

    def unexplained(late_s: float, rate: float) -> float:
        return float(np.sum(np.abs(left(windows, late_s, rate)[1][kept]) ** 2)) / power

    without = min(unexplained(late_s + share * abs(rate) * span_s, 0.0) for share in np.linspace(-0.5, 0.5, 9))
    return known, ClockFit(late_s, float(spread[0]), rate, float(spread[1]), unexplained(late_s, rate), without)


def _kept(off: Complex) -> NDArray[np.bool_]:
    size = np.abs(off)
    return np.asarray(size <= OUTLIER * float(np.median(size)))


def _begin(
    windows: _Windows, left: Callable[[_Windows, float, float], tuple[complex, Complex]], begin: float, end: float
) -> tuple[float, float]:
    """Delay in the middle and rate, by the delays that fit the first and the last minutes."""
    length_s = min(0.5 * (end - begin), END_S)
    ends = [windows.part(begin, begin + length_s), windows.part(end - length_s, end)]
    if min(part.edges.size for part in ends) < 8:
        return 0.0, 0.0
    most_s = min(LEAST_S + 0.5 * RATE * (end - begin), MOST_S)
    delays = np.arange(-most_s, most_s + 0.5 * STEP_S, STEP_S)
    at = []
    for part in ends:
        off = [float(np.median(np.abs(left(part, float(s), 0.0)[1]))) for s in delays]
        at.append(float(delays[int(np.argmin(off))]))
    return 0.5 * (at[0] + at[1]), (at[1] - at[0]) / max(end - begin - length_s, 1.0)
