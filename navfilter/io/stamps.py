"""Stamps of one recording: counters that begin anew, stamps that no neighbour supports, and runs behind one another."""

import bisect
import datetime
import itertools
from typing import NamedTuple

import numpy as np

from navfilter.foundation.arrays import Array, Ints, Mask

#: A longer way between two stamps that follow each other is none of one recording [s].
_ERA_S = 100 * 86400.0
#: Stamps of another era that are no more than such a share of most are mistakes, not a run; so is a single one.
_FEW_OF_ALL = 0.1
#: A clock has begun anew where at least so many rows repeat times of at least so many rows before.
_AGAIN = 5
#: A stamp is out of its place if it is by so many rows, and so many usual steps.
_FAR = 10
#: More steps back than the first, and than such a share of all, are shuffled rows: they are sorted.
_BACK, _SHUFFLED = 3, 0.1
#: So many steps back are looked at.
_MOST_BACK = 200
#: A late stamp lies no farther back than this share of a counter's length.
_LATE = 0.1
#: Counters that begin anew: of 16 and 32 bits, of the seconds and milliseconds of a day and of a week.
_COUNTERS = (2.0**16, 2.0**32, 86400.0, 86400e3, 604800.0, 604800e3)


def continued(raw: Array, period: float) -> Array:
    """A counter that begins anew after `period`, without its jumps; NaN stays.

    A reading from before the jump that comes behind it is late and not a period later: it fills a place that was left.
    A jump ahead by most of a period that fills none is a gap.
    """
    known = np.flatnonzero(np.isfinite(raw))
    x = raw[known]
    if x.size < 2:
        return raw
    step = np.diff(x, prepend=x[0])
    turns = np.cumsum(step < -0.5 * period).astype(float)
    usual = float(np.median(np.abs(step[1:])))
    for k in np.flatnonzero(step > 0.5 * period).tolist():
        before = x[:k] + period * turns[:k]
        late = x[k] + period * (turns[k] - 1.0)
        fills = np.min(np.abs(before - late)) > 0.25 * usual
        if before.min() <= late + usual and before.max() - late < _LATE * period and fills:
            turns[k:] -= 1.0
    result = raw.copy()
    result[known] = x + period * turns
    return result


def full_after(raw: Array) -> float | None:
    """The length of a counter, of those that are usual, that the stamps fill to its end and begin anew; None: they do
    not.
    """
    known = raw[np.isfinite(raw)]
    step = np.diff(known)
    back = np.flatnonzero(step < 0.0)
    if not back.size or not (step > 0.0).any():
        return None
    usual = float(np.median(step[step > 0.0]))
    for period in _COUNTERS:
        full = (known[back] >= period - 2.0 * usual) & (known[back] < period) & (known[back + 1] <= 2.0 * usual)
        if full.any() and known.max() < period and usual < _LATE * period:
            return period
    return None


class Runs(NamedTuple):
    """Parts of a recording between the places where its clock begins anew.

    Attributes
    ----------
    rows : tuple of (int, int)
        First and last row of each, counted from 0.
    spans_s : tuple of (float, float)
        Earliest and latest stamp of each.
    """

    rows: tuple[tuple[int, int], ...]
    spans_s: tuple[tuple[float, float], ...]


def strays(time_s: Array) -> Mask:
    """Stamps that no neighbour supports: of another era, or far from their place where there is no room for them."""
    stray = np.zeros(time_s.size, dtype=bool)
    known = np.flatnonzero(np.isfinite(time_s))
    if known.size < 2:
        return stray
    far = _eras(time_s[known])
    counts = np.bincount(far)
    most = int(counts.max())
    few = (counts == 1) & (most > 1) | (counts <= _FEW_OF_ALL * most)
    stray[known[few[far]]] = True
    known = known[~few[far]]
    if np.all(np.diff(time_s[known]) >= 0.0) or _begins(time_s[known]):
        return stray
    stray[known[_displaced(time_s[known])]] = True
    return stray


def _eras(x: Array) -> Ints:
    """Which era each stamp is of: stamps far from all others are of another one."""
    order = np.argsort(x, kind="stable")
    era = np.zeros(x.size, dtype=np.int64)
    era[order] = np.concatenate([[0], np.cumsum(np.diff(x[order]) > _ERA_S)])
    return era


def _displaced(x: Array) -> Ints:
    """Rows out of the order of most, far from their place, whose time has another row."""
    chain = _chain(x)
    out = np.setdiff1d(np.arange(x.size), chain)
    times = x[chain]
    if out.size > max(_BACK, _SHUFFLED * x.size) or chain.size < _FAR:
        return np.array([], dtype=np.int64)
    usual = float(np.median(np.diff(times)))
    found = []
    for k in out.tolist():
        at, own = int(np.searchsorted(times, x[k])), int(np.searchsorted(chain, k))
        here = times[min(own, times.size - 1)]
        if abs(at - own) < _FAR or abs(x[k] - here) < _FAR * usual:
            continue
        before, after = times[max(at - 1, 0)], times[min(at, times.size - 1)]
        if before == after or after - before < 1.5 * usual:
            found.append(k)
    return np.array(found, dtype=np.int64)


def _chain(x: Array) -> Ints:
    """Rows of a longest part that does not go back (Fredman, 1975)."""
    ends: list[float] = []
    at: list[int] = []
    before = np.full(x.size, -1, dtype=np.int64)
    for k, value in enumerate(x.tolist()):
        place = bisect.bisect_right(ends, value)
        if place == len(ends):
            ends.append(value)
            at.append(k)
        else:
            ends[place], at[place] = value, k
        before[k] = at[place - 1] if place else -1
    rows, k = [], at[-1]
    while k >= 0:
        rows.append(k)
        k = int(before[k])
    return np.array(rows[::-1], dtype=np.int64)


def runs_of(time_s: Array) -> Runs:
    """The runs of a recording; one, where its clock goes on throughout.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        In the order of the file, NaN where there is no stamp.
    """
    known = np.flatnonzero(np.isfinite(time_s))
    x = time_s[known]
    begins = [0, *_begins(x), x.size]
    parts = [(a, b) for a, b in itertools.pairwise(begins) if b > a]
    rows = tuple((int(known[a]), int(known[b - 1])) for a, b in parts)
    return Runs(rows, tuple((float(x[a:b].min()), float(x[a:b].max())) for a, b in parts))


def _begins(x: Array) -> list[int]:
    """Where a recording begins anew."""
    step = np.diff(x)
    found = set((np.flatnonzero(np.abs(step) > _ERA_S) + 1).tolist())
    back = np.flatnonzero((step < 0.0) & (step >= -_ERA_S)) + 1
    if back.size > min(max(_BACK, _SHUFFLED * x.size), _MOST_BACK):
        return sorted(found)
    for k in back.tolist():
        begin = max((b for b in found if b <= k), default=0)
        before = x[begin:k]
        if not before.size or x[k] >= (last := float(before.max())):
            continue
        ahead = np.flatnonzero(x[k:] > last)
        block = np.unique(x[k : k + (int(ahead[0]) if ahead.size else x.size - k)])
        again = int(np.count_nonzero((before >= block[0]) & (before <= block[-1])))
        alike = int(np.count_nonzero((block >= before.min()) & (block <= last)))
        # a late part fills a place that was left: none begins before all others
        earlier = bool(block[0] < before.min()) and before.size >= _AGAIN
        if block.size >= _AGAIN and (earlier or again >= max(_AGAIN, 0.5 * alike)):
            found.add(k)
    return sorted(found)


def shown(time_s: float) -> str:
    """A stamp as a message has it: with its date where it counts from 1970."""
    if 0.0 < time_s < 4e9 and time_s > 3e8:
        return f"{datetime.datetime.fromtimestamp(time_s, datetime.UTC):%Y-%m-%dT%H:%M:%SZ}"
    return f"{time_s:.6g} s"
