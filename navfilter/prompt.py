"""An ordinary reading live: one call of a kernel takes it, as in a replay one takes many."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.filter import shifts
from navfilter.filter.events import Outcome
from navfilter.filter.history import Reading
from navfilter.kernels import listen, strapdown, stretch

if TYPE_CHECKING:
    from navfilter.learning.listener import Listener
    from navfilter.navigator import Navigator

__all__ = ["Prompt"]

Array = NDArray[np.float64]
_NO_RING, _NO_CURSOR = np.zeros((1, 1)), np.zeros(1, np.int64)


class Prompt:
    """Takes the readings of one sensor, to the last bit as `Navigator.correct` does, where nothing is to be decided but
    by the kernel: they are in time, no clock is in doubt, and nothing was wrong with those before.

    Parameters
    ----------
    nav : Navigator
        With a history.
    name : str
    """

    def __init__(self, nav: Navigator, name: str) -> None:
        assert nav.history is not None
        self._nav, self._name, self._history = nav, name, nav.history
        self._gravity, self._behind = nav.vehicle.drive.gravity, nav.behind[name]
        self._listener: Listener | None = None
        self._ear = self._heard_by(None)

    def take(self, stamp_s: float, value: ArrayLike) -> Outcome | None:
        """What became of a reading; None where it is no ordinary one: then nothing has been done.

        Parameters
        ----------
        stamp_s, value
            As for `Navigator.correct`, without a standard deviation of its own.
        """
        try:
            z, stamp_s = np.array(value, dtype=np.float64, ndmin=1), float(stamp_s)
        except (TypeError, ValueError):
            return None
        nav = self._nav
        filter, learning, history, watch = nav.filter, nav.learning, self._history, nav.watches[self._name]
        memory, channels = filter.memory, filter.channels
        channel = channels[self._name]
        sensor, kept, shift = channel.sensor, channel.memory, memory.intake.offset_s
        time_s, raw = stamp_s + (shift - sensor.time_offset_s), z.tobytes()
        early_s = time_s - memory.time_s
        if not (early_s >= -stretch.SAME_S and time_s - memory.sample_s <= filter.ahead_s and time_s > kept.last_s):
            return None
        if raw == watch.value or channel.doubted or not channel.spot.item(stretch.EQUATION):
            return None
        if nav.waiting.readings or not learning.is_quiet:
            return None
        for name in self._behind:
            if channels[name].memory.last_s == time_s:
                return None
        if z.ndim > 1 or len(z) < sensor.reads or channel.has_dived(time_s):
            return None
        reading = sensor.read(z)
        if reading is None or not nav.clock.passes(stamp_s):
            return None
        looks = time_s >= shifts.due_s(filter)
        if not looks:  # one after the other
            history.ready(memory.time_s)
        if learning.is_early(time_s):
            return None
        # ---- from here on it is taken
        watch.value, watch.same, watch.since_s = raw, 1, time_s
        given = Reading(self._name, time_s, z, None)
        learning.keep(given)
        listener = learning.listeners.get(self._name)
        ring, cursor = _NO_RING, _NO_CURSOR
        if listener is not None:
            ring, cursor = listener.memory.ring, listener.memory.cursor
        if listener is not self._listener:
            self._listener, self._ear = listener, self._heard_by(listener)
        channel.reading, channel.gate[:] = reading, channel.limits
        used = stretch.prompt(
            *(filter.bench, channel.spot, filter.drive_spot, memory.nav, memory.x, memory.P, memory.acc, memory.drv),
            *(filter.Phid, filter.Qd, filter.drive_output, memory.recent, reading, early_s, channel.ticks(time_s)),
            *(learning.fed_back, channel.places, self._ear, ring, cursor),
        )
        memory.unfolded, kept.last_s = 0, time_s
        if early_s > stretch.SAME_S and memory.drv.item(strapdown.STARTED):
            memory.time_s = time_s
        if used:
            channel.stuck = channel.stale = False
            channel.use(time_s)
            nis, dof, _ = channel.verdict.tolist()
            outcome = Outcome("used", nis, int(dof))
            if listener is not None:
                for change in learning.attended(listener, outcome, time_s):
                    filter.adopt(change, nav.told)
            if looks:
                filter.take_up(nav.told)
        else:
            correction = filter.concluded(channel, time_s, False)
            nav.told(correction, z)
            filter.take_up(nav.told)
            outcome = correction.outcome
        history.note(given, shift)
        watch.note(outcome.status, time_s, outcome.nis, outcome.dof, memory.nav)
        return outcome

    def _heard_by(self, listener: Listener | None) -> Array:
        """What `navfilter.kernels.stretch.prompt` listens with."""
        kind, mount = (listen.NOTHING, np.zeros(9)) if listener is None else (listener.kind, listener.mount)
        return np.array([kind, self._gravity, *mount])
