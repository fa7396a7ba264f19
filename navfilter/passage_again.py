"""Inputs that a run has had already, once more in stretches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.health import Watch
from navfilter.filter.history import Reading
from navfilter.passage import Passage, Readings

if TYPE_CHECKING:
    from navfilter.navigator import Navigator

__all__ = ["PassageAgain"]

Array = NDArray[np.float64]


class PassageAgain(Passage):
    """Takes a navigator once more through inputs that it has had: the sensors' health is not counted again.

    Parameters
    ----------
    nav : Navigator
    inputs : sequence
        Samples (rows of time and six values) and readings.
    """

    def __init__(self, nav: Navigator, inputs: Sequence[Array | Reading]) -> None:
        blocks = [item for item in inputs if isinstance(item, np.ndarray)]
        readings = self._given = [item for item in inputs if isinstance(item, Reading)]
        samples = np.concatenate([np.empty((0, 7)), *blocks])
        sizes = [len(item) if isinstance(item, np.ndarray) else 0 for item in inputs]
        before = np.cumsum(sizes)[[isinstance(item, Reading) for item in inputs]] if inputs else np.empty(0, np.int64)
        names = tuple(nav.filter.channels)
        sensor = np.array([names.index(reading.name) for reading in readings], np.int64)
        times, row = np.array([reading.time_s for reading in readings]), np.empty(len(readings), np.int64)
        values: list[list[Array]] = [[] for _ in names]
        sds: list[list[Array | None]] = [[] for _ in names]
        for k, (i, reading) in enumerate(zip(sensor.tolist(), readings, strict=True)):
            row[k] = len(values[i])
            values[i].append(reading.value)
            sds[i].append(reading.sd)
        own = tuple(None if all(sd is None for sd in one) else one for one in sds)
        given = Readings(times, times, sensor, row, names, tuple(values), own)
        super().__init__(nav, samples[:, 0].copy(), samples[:, 1:].copy(), given, 0, before)

    def _watched(self) -> list[Watch]:
        return [Watch(math.inf, math.inf) for _ in self._readings.names]

    def _repeated(self) -> NDArray[np.bool_]:
        return np.array([reading.same for reading in self._given], bool)

    def _lay_out(self) -> None:
        super()._lay_out()
        for k in range(self._begin, self._end):
            if self._given[k].frozen:  # learning wants to hear of that
                self._good[k - self._begin] = False

    def _feed(self, samples: Array) -> None:
        self.nav.feed(samples)

    def _correct(self, at: int) -> None:
        self.nav.feed(self._given[at])

    def _reading(self, at: int, frozen: bool = False) -> Reading:
        return self._given[at]

    def _finish(self) -> None:
        pass
