"""The engine that learns its inertial unit's errors while the vehicle stands still."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from navfilter.filter.filter import Memory
from navfilter.filter.tape import Tape
from navfilter.learning.learned import learning_part
from navfilter.learning.rest import Stillness
from navfilter.learning.schedule import Learning
from navfilter.start import Start
from navfilter.vehicle import Vehicle

__all__ = ["Standing"]

Array = NDArray[np.float64]


class Standing(Learning):
    """Hands the samples at rest to `Stillness`, and adopts what it learns, in flow.

    The beginning is not done again for a model of the inertial unit: it stands for the noise of samples, and what the filter took for
    certain by it in the first minute at rest is little. When the beginning is done again for the other sensors' sake, the unit's models
    are those learnt until then.
    """

    _still: Stillness | None = None

    def __init__(self, vehicle: Vehicle, start: Start, tape: Tape | None = None) -> None:
        super().__init__(vehicle, start, tape)
        if self._inertial and any(learning_part(model) is not None for model in vehicle.drive.models):
            self._still, self._watching = Stillness(vehicle.drive), True
            self._note_models()

    def _begin(self, vehicle: Vehicle) -> None:
        super()._begin(vehicle)
        if self._still is not None:
            self._still.rewind()
            self._note_models()

    def _note_models(self) -> None:
        if self._tape is not None:
            drive: Any = self._in_force.drive
            self._tape.models |= {name: [(self._time_s, getattr(drive, name))] for name in ("gyro", "accel")}

    def _room(self) -> int:
        return super()._room() if self._still is None else min(super()._room(), self._still.room)

    def _passed(self, samples: Array) -> None:
        still = self._still
        assert still is not None
        still.note(samples)
        if still.room == 0 and still.close(*self._estimates()):
            early = self._early
            for name, models in still.learn().items():
                self.adopt(name, models)
            self._early = early

    def _estimates(self) -> tuple[Array, Array]:
        """Velocity and error of the gyros, each above its standard deviation, shape (2, 3), as of the last time the covariance moved."""
        C, m = self._Cr[:3, :-1], self._head
        spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", C, self._P[9:m, 9:m], C), 0.0))
        speed = np.sqrt(np.maximum(self._P[range(3, 6), range(3, 6)], 0.0))
        return np.array([self._nav[3:6], speed]), np.array([C @ self._xd, spread])

    def memory(self) -> Memory:
        """Everything that changes, copied."""
        kept = super().memory()
        return kept if self._still is None else kept._replace(still=self._still.mark())

    def recall(self, memory: Memory) -> None:
        """Go back to what `memory` holds."""
        super().recall(memory)
        if self._still is not None and memory.still is not None:
            self._still.recall(memory.still)
