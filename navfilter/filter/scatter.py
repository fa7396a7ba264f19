"""The noise of a sensor that scatters by more than its error model says.

Its readings are refused one after the other, and do not agree with each other either: so neither the state is wrong
nor has the sensor jumped. By how much they scatter shows in the second differences of successive residuals (von
Neumann, 1941), which know nothing of a constant, of a scale, of a state that goes astray. What they have beyond the
error model is added to the variance of the next reading, axis by axis: it passes the gate again, and weighs what it is
worth. Its NIS goes on to be that of the description, by which health and verdict say that the sensor is noisy. One
that scatters by so much that it says nothing (another unit) is refused until that is over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.slack import reckoned, walked, wander
from navfilter.kernels import listen

if TYPE_CHECKING:
    from navfilter.filter.channel import Channel
    from navfilter.filter.filter import Filter

__all__ = ["Scatter", "beyond", "heard", "variances"]

Array = NDArray[np.float64]
#: It is looked at once so many readings were refused within the last ones, the older the less [1]: of good ones three
#: in a thousand are.
REFUSED, READINGS = 3.0, 16.0
#: By so many differences at most, and at the earliest [1].
MOST, LEAST = 48, 8
#: It ends when this many do not show it any more [1].
ENDS = 16
#: The largest quarter of them says nothing: a reading that is far off is in two of them. Of the squares of normal
#: variables the others have this mean [1].
KEPT, MEAN_OF_KEPT = 0.75, 0.3685
#: A variance that is larger by less than this factor is no noise that was not described [1]: so far off is one estimate
#: by `LEAST` differences in a hundred.
LARGER = 2.5
#: One that is larger by more is no noise [1]: a thousand times the sd is another unit, a hundred times bad reception.
NO_NOISE = 300.0**2
#: Readings further apart than so many periods tell no noise [1].
APART = 3.0
#: The square of a second difference of white noise is so many times its variance [1]; of a random walk, twice that of a
#: step.
WHITE, STEP = 6.0, 2.0


@dataclass(frozen=True)
class Scatter:
    """How a sensor scatters.

    Attributes
    ----------
    refused : float
        Its last readings that were refused, older ones counting less.
    time_s : float
        Of the last reading [s].
    last : tuple of float
        Residual of that one, then by how much it differed from the one before; empty while nothing is looked at.
    bends : tuple of tuple of float
        Second differences of its readings by axis, then what else than noise is in each, as variances of one reading.
    excess : tuple of float
        What is added to the variance of the next reading, by axis; empty where nothing is. Infinite: it says nothing.
    alone : int
        So many readings on end, up to the last, were refused.
    """

    refused: float
    time_s: float
    last: tuple[float, ...] = ()
    bends: tuple[tuple[float, ...], ...] = ()
    excess: tuple[float, ...] = ()
    alone: int = 0

    @property
    def watched(self) -> bool:
        """Whether every reading has to be heard."""
        return bool(self.last)

    @property
    def worthless(self) -> bool:
        """Whether it says nothing."""
        return math.inf in self.excess


def variances(kept: Scatter, plain: Array) -> Array:
    """White variances of a reading, with what it scatters by beyond them."""
    return np.asarray(plain + np.array(kept.excess)) if kept.excess and not kept.worthless else plain


def heard(filter: Filter, channel: Channel, time_s: float, frozen: bool) -> float:
    """Take a reading, and return its NIS by the description of its sensor.

    Parameters
    ----------
    filter : Filter
    channel : Channel
        As its kernel left it; its memory takes note.
    time_s : float
        Of the reading [s].
    frozen : bool
        The value has not changed for suspiciously long.
    """
    kept, (nis, dof, used) = channel.memory.scatter, channel.verdict.tolist()
    watched = kept is not None and kept.watched
    if (used and not watched) or not (dof and math.isfinite(nis)):
        return nis  # a stretch does not tell these
    kept, a = kept or Scatter(0.0, time_s), channel.axes
    dt = time_s - kept.time_s
    refused = kept.refused * math.exp(-max(dt, 0.0) / (READINGS * channel.period_s)) + (not used)
    if frozen or channel.aside or filter.watch.busy(filter.memory.watch) or not (watched or refused >= REFUSED):
        channel.memory.scatter = Scatter(refused, time_s)
        return nis
    residual, bends, excess = channel.note[3 : 3 + a].copy(), kept.bends, np.array(kept.excess)
    added = bool(kept.excess) and not kept.worthless
    step = np.full(a, math.nan)
    if watched and dt <= APART * channel.period_s:
        before, step_before = np.array(kept.last).reshape(2, a)
        step = residual - before
        channel.wrap(step)
        slack = _known(filter, channel, added or kept.alone > 1)
        bends = (*bends, (*(step - step_before).tolist(), *slack.tolist()))[-MOST:]
    plain = np.diag(channel.R) - excess if added else np.diag(channel.R)
    plain = plain + _wandered(filter, channel)
    table = np.array(bends).reshape(-1, 2 * a)
    own, other = table[:, :a], table[:, a:]
    found = beyond(own, other, plain) if beyond(own[-ENDS:], other[-ENDS:], plain) else ()
    if len(bends) == MOST and not found and refused < 1.0:
        channel.memory.scatter = None
    else:
        last, alone = (*residual.tolist(), *step.tolist()), 0 if used else kept.alone + 1
        channel.memory.scatter = Scatter(refused, time_s, last, bends, found, alone)
    return _by_description(channel, excess) if added else nis


def _is_apart(filter: Filter, channel: Channel) -> bool:
    """Whether what leads its readings astray goes as the time: a velocity, and a height, beside accelerometers."""
    kind = channel.sensor.open_loop
    return filter.inertial and (kind == listen.VELOCITY or (kind == listen.POSITION and channel.axes == 1))


def _known(filter: Filter, channel: Channel, alone: bool) -> Array:
    """What of a second difference of such a sensor is no noise, as a variance of one reading, by axis; else 0.

    One that is corrected from reading to reading errs by what is known of it. Left alone it goes away with a tilt, an
    accelerometer or a vertical velocity that is wrong: as the time, and nothing of that is in a second difference.
    """
    if not _is_apart(filter, channel):
        return np.zeros(channel.axes)
    dt = channel.period_s
    pushed = walked(dt, filter.drive_output, filter.vehicle.drive.period_s)
    pushed *= STEP if channel.sensor.open_loop == listen.VELOCITY else dt**2
    seen = 0.0 if alone else np.maximum(np.diag(channel.S[: channel.axes] - channel.R), 0.0)
    return np.asarray((wander(channel, dt) * STEP + pushed) / WHITE + seen)


def _wandered(filter: Filter, channel: Channel) -> Array:
    """What drive and coloured error add now to the variance of a reading of any other, by axis; else 0."""
    if _is_apart(filter, channel):
        return np.zeros(channel.axes)
    memory, dt = filter.memory, channel.period_s
    drive = filter.drive_output, filter.vehicle.drive.period_s
    speed = math.hypot(*memory.nav[3:6].tolist())
    return np.asarray((wander(channel, dt) + reckoned(channel.sensor, memory.P, speed, dt, *drive)) * STEP / WHITE)


def beyond(bends: Array, slack: Array, white: Array) -> tuple[float, ...]:
    """What a sensor scatters by beyond its variances, by axis; empty where it does not, or where nobody can tell.

    Parameters
    ----------
    bends : ndarray, shape (k, axes)
        Second differences of its readings; NaN where a component was missing.
    slack : ndarray, shape (k, axes)
        What else than its noise is in each, as a variance of one reading.
    white : ndarray, shape (axes,)
        Its variances.

    Examples
    --------
    >>> readings = np.random.default_rng(1).normal(scale=[0.1, 0.01], size=(40, 2))
    >>> bends = np.diff(readings, n=2, axis=0)
    >>> x, y = beyond(bends, np.zeros_like(bends), np.array([1e-4, 1e-4]))
    >>> bool(0.006 < x < 0.018), y
    (True, 0.0)
    """
    excess = []
    for own, column, other in zip(white.tolist(), bends.T, slack.T, strict=True):
        known = np.isfinite(column)
        square, other = column[known] ** 2 / WHITE, other[known]
        ratio, beyond_it = _usual(square / (own + other)), 0.0
        if ratio > NO_NOISE:
            beyond_it = math.inf
        elif ratio > LARGER:
            telling = other <= np.median(other)  # half of all
            beyond_it = min(max(_usual((square - other)[telling]) - own, (LARGER - 1.0) * own), NO_NOISE * own)
        excess.append(beyond_it)
    return tuple(excess) if any(excess) else ()


def _usual(squares: Array) -> float:
    """Mean of squares of normal variables; 0 where they are too few."""
    kept = np.sort(squares)[: int(KEPT * len(squares))] if len(squares) >= LEAST else np.zeros(1)
    return float(kept.mean()) / MEAN_OF_KEPT


def _by_description(channel: Channel, excess: Array) -> float:
    """NIS of a reading without the variances that were added to its own."""
    a = channel.axes
    seen = np.isfinite(channel.note[3 + a : 3 + 2 * a])
    residual, S = channel.note[3 : 3 + a][seen], (channel.S[:a] - np.diag(excess))[np.ix_(seen, seen)]
    return float(residual @ np.linalg.solve(S, residual))
