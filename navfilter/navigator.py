"""The navigator: the only thing that runs and changes. `step` carries the state, `correct` takes a reading of any named sensor."""

from __future__ import annotations

import dataclasses
import math
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navfilter.filter import snapshot as snapshots
from navfilter.filter.filter import Outcome
from navfilter.filter.health import Health, Watch
from navfilter.filter.history import History, Reading
from navfilter.filter.tape import Tape
from navfilter.learning.standing import Standing
from navfilter.start import Start
from navfilter.state import NavState
from navfilter.vehicle import Vehicle

__all__ = ["Navigator", "Outcome"]

Array = NDArray[np.float64]


def _when(item: Any) -> float:
    """Time of an input: of its last sample, or of the reading."""
    return float(item[-1, 0]) if isinstance(item, np.ndarray) else float(item[1])


class Navigator(Standing):
    """Error-state extended Kalman filter over a vehicle's sensors, in closed loop.

    Parameters
    ----------
    vehicle : Vehicle
    start : Start
        Where it is and how well that is known.
    tape : Tape, optional
        Write down what smoother and track need. Without one, memory stays flat.
    history_s : float, optional
        Readings may come so late [s]: the state goes back and takes them in their place. Default 2 without a tape; with one nothing may be
        late, because what is on the tape stays there.

    Raises
    ------
    ValueError
        For something that is no vehicle, or a history beside a tape.

    Notes
    -----
    `step` compounds the transition of the drive's samples and folds it into the covariance at every correction and at least once a second:
    the same covariance as folding every sample, without the cost. `state` gives it at any sample.

    A correction between two samples holds the last sample until its time; the next sample then covers what is left.

    Examples
    --------
    >>> import navfilter as nf
    >>> vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors={"depth": nf.Depth(rate_hz=1)})
    >>> nav = nf.Navigator(vehicle, nf.Start(latitude_deg=45.0, longitude_deg=-4.0))
    >>> nav.step(0.01, (0.0, 0.0, 0.0), (0.0, 0.0, -9.806))
    >>> nav.correct("depth", 0.01, 0.02).status
    'used'
    """

    #: Default length of the history [s].
    HISTORY_S = 2.0

    def __init__(self, vehicle: Vehicle, start: Start, tape: Tape | None = None, history_s: float | None = None) -> None:
        super().__init__(vehicle, start, tape)
        length_s = (self.HISTORY_S if tape is None else 0.0) if history_s is None else float(history_s)
        if not (math.isfinite(length_s) and length_s >= 0.0):
            raise ValueError(f"history_s must be a finite number >= 0, found {history_s!r}.")
        if length_s and tape is not None:
            raise ValueError("a run with a tape cannot go back: leave history_s out, and feed the readings in the order of their times.")
        self._history = History(self, length_s) if length_s else None
        self._watches = {name: Watch(sensor.gate_timeout_s) for name, sensor in vehicle.sensors.items()}
        names = list(vehicle.sensors)
        self._behind = {name: names[i + 1 :] for i, name in enumerate(names)}
        self._row = np.empty((1, 7))

    def step(self, time_s: ArrayLike, first: ArrayLike, second: ArrayLike) -> None:
        """Carry the state over one sample of the drive, or a block of them.

        Parameters
        ----------
        time_s : float or array_like, shape (n,)
            Time of the sample(s) [s].
        first, second : array_like, shape (3,) or (n, 3)
            For an `Imu` angular rate [rad/s] and specific force [m/s^2] in b (or increments); for `DeadReckoning` roll, pitch, yaw [rad]
            and velocity in instrument axes [m/s].

        Notes
        -----
        Samples that do not come after the last one are dropped, and so is a single stamp far ahead (`navfilter.filter.intake.Intake`);
        a sample with a NaN or an impossible value repeats the one before (an invalid DVL velocity is held, with growing uncertainty).
        All are counted in `counts`, like gaps of more than three periods.
        """
        try:
            if isinstance(time_s, float) and len(first) == 3 == len(second):
                samples = self._row
                samples[0, 0], samples[0, 1:4], samples[0, 4:7] = time_s, first, second
            else:
                times = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
                values = [np.asarray(v, dtype=np.float64).reshape(times.size, 3) for v in (first, second)]
                samples = np.column_stack([times, *values])
        except (TypeError, ValueError):
            self.counts["bad-sample"] += 1
            return
        self.step_samples(samples)

    def step_samples(self, samples: Array) -> None:
        """As `step`, for rows of time and the six values; the array is used as work space."""
        if self._history is None:
            self.advance(samples)
        elif len(samples):
            self._history.feed(samples)

    def correct(self, name: str, time_s: float, value: ArrayLike, sd: ArrayLike | None = None) -> Outcome:
        """Correct the state with a reading of a named sensor.

        Parameters
        ----------
        name : str
            Key of the sensor in the vehicle.
        time_s : float
            Time of validity [s]: at most `history_s` (without a history about one period of the drive) before the present, at most a second
            after it.
        value : float or array_like
            The reading in SI units and radians; NaN is a missing component.
        sd : float or array_like, optional
            White standard deviation of this one reading, in place of the error model's.

        Returns
        -------
        Outcome
            Never an exception: whatever arrives has a defined outcome.
        """
        watch = self._watches.get(name) if isinstance(name, str) else None
        if watch is None:
            return Outcome("unknown-sensor")
        try:
            z = np.array(value, dtype=np.float64).reshape(-1)
            time_s = float(time_s) + self.intake.offset_s
        except (TypeError, ValueError):
            z, time_s = np.full(1, np.nan), math.nan
        outcome = self._taken(Reading(name, time_s, z, sd, watch.sees(time_s, z)))
        watch.note(outcome.status, time_s, outcome.nis, outcome.dof)
        return outcome

    def _taken(self, reading: Reading) -> Outcome:
        history = self._history
        if history is None:
            return self.take(self._channels[reading.name], *reading[1:])
        # of readings with the same time, those of the sensors named first come first, as in a replay
        overtaken = any(self._channels[name].last_s == reading.time_s for name in self._behind[reading.name])
        if not (reading.time_s < self._time_s - 1e-7 or overtaken):
            outcome = history.feed(reading)
        elif self.intake.in_doubt:
            return Outcome("too-late")
        else:
            outcome = history.late(reading)
            if outcome is None:
                return Outcome("too-late")
            if outcome.status == "used":
                outcome = outcome._replace(status="late-replayed")
        assert outcome is not None
        return outcome

    def _again(self, items: list[Any]) -> None:
        if self._history is None:
            return super()._again(items)
        # The last of it goes through the history, so that late readings find their place
        self._history.begin()
        recent = self._revise_s - self._history.length_s
        split = next((i for i, item in enumerate(items) if _when(item) > recent), len(items))
        super()._again(items[:split])
        for item in items[split:]:
            self._history.feed(item if isinstance(item, np.ndarray) else Reading(*item))
        return None

    @property
    def state(self) -> NavState:
        """The state with its covariance and the health of the sensors, now; a copy."""
        return dataclasses.replace(super().state, health=self.health)

    @property
    def health(self) -> Health:
        """What the sensors are worth at present."""
        sensors = {name: watch.health(self._time_s) for name, watch in self._watches.items()}
        return Health(sensors, dict(self.counts), self.intake.offset_s)

    # ---------------------------------------------------------------- keep and bring back
    def snapshot(self, path: str | PathLike[str] | None = None) -> bytes:
        """Everything that is needed to go on, to the last bit: as bytes, and in a file if `path` is given.

        Parameters
        ----------
        path : path-like, optional
            Written to a temporary file beside it, synced to the disk and renamed: whatever happens there is one whole snapshot.

        Raises
        ------
        ValueError
            For a run with a tape: its records are not kept.
        OSError
            When the file cannot be written.
        """
        return snapshots.write(self, path)

    @classmethod
    def restore(cls, vehicle: Vehicle, source: bytes | str | PathLike[str]) -> Navigator:
        """Go on from a snapshot.

        Parameters
        ----------
        vehicle : Vehicle
            The same as that of the snapshot.
        source : bytes or path-like

        Raises
        ------
        ValueError
            When it is damaged, of another version, or of another vehicle.
        OSError
            When the file cannot be read.
        """
        return snapshots.read(cls, vehicle, source)
