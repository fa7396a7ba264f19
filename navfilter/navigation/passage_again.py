"""Inputs that a run has had already, once more in stretches."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navfilter.faults.sensor_monitor import Watch
from navfilter.filter.events import Measurement
from navfilter.learning.input_buffer import AS_BEFORE, BEFORE, FROZEN, SENSOR, TIME_S, VALUES, Kept
from navfilter.navigation.batch_runner import Passage
from navfilter.navigation.measurements import Readings

if TYPE_CHECKING:
    from navfilter.navigation.run import Run

__all__ = ["PassageAgain"]

Array = NDArray[np.float64]


class PassageAgain(Passage):
    """Takes a navigator once more through inputs that it has had: the sensors' health is not counted again.

    Parameters
    ----------
    nav : Run
    inputs : Kept
    """

    def __init__(self, nav: Run, inputs: Kept) -> None:
        samples, heads = inputs.samples.whole(inputs.samples.count), inputs.readings.whole(inputs.readings.count)
        flat, names = inputs.values.whole(inputs.values.count)[:, 0], tuple(nav.filter.channels)
        self._frozen, self._as_before = heads[:, FROZEN] != 0.0, heads[:, AS_BEFORE] != 0.0
        sensor = np.array([names.index(name) for name in inputs.names], np.int64)[heads[:, SENSOR].astype(np.int64)]
        ends = heads[:, VALUES].astype(np.int64)
        begins, row = np.append(0, ends)[:-1], np.empty(len(heads), np.int64)
        values: list[Array | list[Array]] = []
        sds: list[list[Any] | None] = []
        for i in range(len(names)):
            mine = np.flatnonzero(sensor == i)
            row[mine] = np.arange(mine.size)
            sizes = ends[mine] - begins[mine]
            if mine.size and (sizes == sizes[0]).all():
                values.append(flat[begins[mine, None] + np.arange(sizes[0])])
            else:
                values.append([flat[begins[k] : ends[k]] for k in mine])
            own = [inputs.sds.get(k) for k in mine.tolist()] if inputs.sds else []
            sds.append(own if any(sd is not None for sd in own) else None)
        times, before = heads[:, TIME_S].copy(), heads[:, BEFORE].astype(np.int64)
        given = Readings(times, times, sensor, row, names, tuple(values), tuple(sds))
        super().__init__(nav, samples[:, 0].copy(), samples[:, 1:].copy(), given, 0, before)

    def _watched(self) -> list[Watch]:
        return [Watch(math.inf, math.inf) for _ in self._readings.names]

    def _repeated(self) -> NDArray[np.bool_]:
        return self._as_before

    def _lay_out(self) -> None:
        super()._lay_out()
        self._good[self._frozen[self._begin : self._end]] = False  # learning wants to hear of that

    def _feed(self, samples: Array) -> None:
        self.nav.feed(samples)

    def _correct(self, at: int) -> None:
        self.nav.feed(self._reading(at))

    def _reading(self, at: int, frozen: bool = False) -> Measurement:
        return super()._reading(at, bool(self._frozen[at]))

    def _finish(self) -> None:
        pass
