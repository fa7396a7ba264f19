"""The noise of a sensor that scatters by more than its error model says.

Its readings are refused one after the other, and do not agree with each other either: so neither the state is wrong
nor has the sensor jumped. By how much they scatter shows in the second differences of successive residuals (von
Neumann, 1941), which know nothing of a constant, of a scale, of a state that goes astray. What they have beyond the
error model is added to the variance of the next reading, axis by axis: it passes the gate again, and weighs what it is
worth. Its NIS goes on to be that of the description, by which health and verdict say that the sensor is noisy. One
that scatters by so much that it says nothing (another unit) is refused until that is over.

What leads the readings astray is no noise. Of a velocity, and of a height, beside accelerometers it goes as the time, a
tilt or an acceleration that is wrong, and nothing of that is in a second difference but what the sensor corrects from
reading to reading. Of any other it is what drive and coloured error may add from one reading to the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.monitor import FilterState
from navfilter.filter.sensor_channel import Channel
from navfilter.kernels import noise_scale as kernels
from navfilter.models.sensors.observable import Observable

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NoiseScale:
    """How a sensor scatters.

    Attributes
    ----------
    noted : ndarray
        See `navfilter.kernels.noise_scale`; it is not written to.
    """

    noted: Array

    @property
    def watched(self) -> bool:
        """Whether every reading has to be heard."""
        return bool(self.noted[kernels.WATCHED])

    @property
    def excess(self) -> Array:
        """What is added to the variance of the next reading, by axis. Infinite: it says nothing."""
        axes = (self.noted.size - kernels.LAST) // (3 + 2 * kernels.MOST)
        return self.noted[kernels.LAST + 2 * axes : kernels.LAST + 3 * axes]

    @property
    def worthless(self) -> bool:
        """Whether it says nothing."""
        return bool(np.isinf(self.excess).any())

    def is_of(self, axes: int) -> bool:
        """Whether a kernel can go by it, of a sensor of so many axes: it may have come from outside."""
        if not isinstance(self.noted, np.ndarray) or self.noted.shape != (size(axes),):
            return False
        count, place = self.noted[[kernels.COUNT, kernels.NEXT]]
        return bool(0.0 <= count <= kernels.MOST and 0.0 <= place < kernels.MOST)

    @classmethod
    def of(cls, noted: Array) -> NoiseScale | None:
        """What a kernel has noted; None where nothing is."""
        return None if noted[kernels.TIME_S] == -math.inf else cls(noted)


def size(axes: int) -> int:
    """Elements of what is remembered of a sensor of so many axes."""
    return kernels.LAST + 3 * axes + 2 * axes * kernels.MOST


def facts_size(axes: int) -> int:
    """Elements of its facts."""
    return kernels.BY_AXIS + 3 * axes + max(3 * kernels.MOST, axes * (axes + 1))


def noted(channel: Channel) -> Array:
    """What is noted of a channel, to be written to."""
    kept = channel.faults.scatter
    if kept is not None:
        return kept.noted.copy()
    fresh = np.zeros(size(channel.axes))
    fresh[kernels.TIME_S] = -math.inf
    return fresh


def facts(filter: FilterState, channel: Channel) -> Array:
    """What the kernel has to know of a channel."""
    if channel.facts is not None and not channel.offset:  # where it has jumped, errors go with the speed
        return channel.facts
    sensor, a = channel.sensor, channel.axes
    velocity = sensor.observes is Observable.VELOCITY_BODY
    kind = kernels.HEADING if sensor.observes.north is not None else kernels.VELOCITY if velocity else kernels.OTHER
    height = sensor.observes is Observable.HEIGHT
    known = np.zeros(facts_size(a))
    known[kernels.LASTING], known[kernels.KIND] = filter.inertial and (velocity or height), kind
    known[kernels.PERIOD_S], known[kernels.DRIVE_PERIOD_S] = channel.period_s, filter.period_s
    change = channel.wander(channel.period_s) if channel.offset else np.minimum(channel.step, channel.most)
    known[kernels.BY_AXIS : kernels.BY_AXIS + a] = change
    known[kernels.BY_AXIS + a : kernels.BY_AXIS + 2 * a] = channel.group.r
    channel.facts = known
    return known


def variances(kept: NoiseScale, plain: Array) -> Array:
    """White variances of a reading, with what it scatters by beyond them."""
    return plain if kept.worthless else np.asarray(plain + kept.excess)


def note_reading(filter: FilterState, channel: Channel, time_s: float, frozen: bool) -> tuple[float, bool]:
    """Take a reading; returns its NIS by the description of its sensor, and whether it is evidence of nothing.

    Parameters
    ----------
    filter : FilterState
    channel : Channel
        As its kernel left it; its memory takes note.
    time_s : float
        Of the reading [s].
    frozen : bool
        The value has not changed for suspiciously long.
    """
    kept, (nis, dof, used) = channel.faults.scatter, channel.verdict.tolist()
    if (used and (kept is None or not kept.watched)) or not (dof and math.isfinite(nis)):
        return nis, frozen  # a batch does not tell these
    memory, note, at = filter.memory, noted(channel), channel.places
    north = -1 if channel.sensor.observes.north is None else channel.sensor.observes.north
    ignored = frozen or channel.faults.aside is not None or memory.monitor.is_busy
    of = note, facts(filter, channel), channel.mem, int(at[5]), int(at[8]), channel.R, north
    nis = kernels.update_scale(*of, memory.P, memory.nav, filter.drive_output, float(time_s), bool(ignored))
    channel.faults.scatter = scatter = NoiseScale.of(note)
    return float(nis), frozen or (scatter is not None and scatter.worthless)
