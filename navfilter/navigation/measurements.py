"""All readings of a run in the order of their times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from navfilter.foundation.arrays import Array, Ints


@dataclass(frozen=True)
class MeasurementSequence:
    """All readings of the correcting sensors in the order of the times at which they were taken.

    Attributes
    ----------
    time_s, stamp_s : ndarray, shape (n,)
    sensor, row : ndarray of int, shape (n,)
        Which of `names`, and which row of its values.
    names : tuple of str
        Of all sensors, in their order; those that the drive's own samples make have no readings.
    values : tuple of ndarray, or of list of ndarray
        Per sensor.
    sds : tuple of list or None
        Per sensor what `Navigator.correct` takes as the standard deviation of each reading; None where none has its
        own.
    """

    time_s: Array
    stamp_s: Array
    sensor: Ints
    row: Ints
    names: tuple[str, ...]
    values: tuple[Array | list[Array], ...]
    sds: tuple[Sequence[Array | None] | None, ...]

    def sd(self, index: int) -> Array | None:
        """Standard deviation of a reading, where it has its own."""
        sds = self.sds[self.sensor[index]]
        return None if sds is None else sds[self.row[index]]

    def value(self, index: int) -> Array:
        """What was read."""
        return self.values[self.sensor[index]][self.row[index]]

    def rows(self, sensor: int, which: Ints) -> Array | list[Array]:
        """Values of some readings of one sensor."""
        values, rows = self.values[sensor], self.row[which]
        return values[rows] if isinstance(values, np.ndarray) else [values[row] for row in rows.tolist()]

    def later(self, by_s: Array, which: Ints | slice = slice(None)) -> MeasurementSequence:
        """Some of them by times that are later by so much; of equal times those first that have waited."""
        time_s = (self.time_s + by_s)[which]
        order = np.lexsort((by_s[which] <= 0.0, time_s))
        kept = {name: getattr(self, name)[which][order] for name in ("stamp_s", "sensor", "row")}
        return replace(self, time_s=time_s[order], **kept)
