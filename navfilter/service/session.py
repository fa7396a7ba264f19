"""What a run does with each line: everything here follows from the lines alone, never from a clock of the computer.

So a log that is fed again gives the same output, bit for bit, however the lines came in blocks.

Dead reckoning live: which attitude belongs to a velocity, as far as is known when it must be decided.

A velocity waits until an attitude of its own time or later has arrived, and then gets the attitude interpolated to its
time: the same numbers as the replay of a recording. It waits `PATIENCE_S` at the most, by the stamps of whatever else
arrives; then the newest attitude holds if it is at most one period of the drive older, else the velocity is dropped.
What arrives behind a waiting velocity waits with it, so that the order of arrival stays.
"""

import dataclasses
import datetime
import json
import math
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from navfilter.filter.imu_intake import ImuIntake
from navfilter.foundation.quoting import json_value
from navfilter.io.json_lines import BadLine, Item, Note, Reading, StartLine, start_from, streams_of
from navfilter.models.alignment import align
from navfilter.models.health import Health
from navfilter.models.magnetic import believable
from navfilter.models.mission import Mission
from navfilter.models.start import Start
from navfilter.models.state import NavState
from navfilter.models.vehicle import Vehicle
from navfilter.navigation.lanes.navigator import LaneNavigator
from navfilter.navigation.navigator import Navigator
from navfilter.service.protocol import event_line, integrity_fields, state_fields, to_line


class Pairing:
    """Pairs the two streams of `DeadReckoning`.

    Parameters
    ----------
    period_s : float
        Nominal period of the drive [s].
    late_s : (2,) float
        How late the stamps of attitude and velocity are [s]; it is taken off.
    """

    #: A velocity waits so long for its attitude [s].
    PATIENCE_S = 1.0
    #: Attitudes that are kept, for velocities that come late.
    KEPT = 500
    #: An attitude that is so much older than the newest one means that the clock was set back [s].
    SET_BACK_S = 10.0
    #: More than this never waits.
    LONGEST_QUEUE = 1000

    def __init__(self, period_s: float, late_s: tuple[float, float] = (0.0, 0.0)) -> None:
        self._period_s, self._late_s = period_s, dict(zip(("attitude", "velocity"), late_s, strict=True))
        self._time_s: list[float] = []
        self._angles: list[list[float]] = []
        self._last: list[float] = []
        self._turns = [0.0, 0.0, 0.0]
        self._waiting: deque[Reading] = deque()
        self.counts = {"attitude-invalid": 0, "attitude-backward": 0, "attitude-clock-set-back": 0, "unpaired": 0}

    def take(self, reading: Reading) -> Iterator[tuple[Reading, list[float] | None]]:
        """What a new reading lets go, in order: a velocity with its attitude, or any other reading with None."""
        latest = reading.time_s if math.isfinite(reading.time_s) else -math.inf
        reading = reading._replace(time_s=reading.time_s - self._late_s.get(reading.sensor, 0.0))
        if reading.sensor == "attitude":
            self._attitude(reading)
        elif reading.sensor == "velocity" or self._waiting:
            self._waiting.append(reading)
        else:
            yield reading, None
            return
        yield from self._released(latest)

    def end(self) -> Iterator[tuple[Reading, list[float] | None]]:
        """Everything that still waits: there will be no other attitude."""
        yield from self._released(math.inf)

    def _released(self, latest_s: float) -> Iterator[tuple[Reading, list[float] | None]]:
        while self._waiting:
            first = self._waiting[0]
            if first.sensor != "velocity":
                yield self._waiting.popleft(), None
                continue
            covered = bool(self._time_s) and self._time_s[-1] >= first.time_s
            patience_s = self.PATIENCE_S + self._late_s["attitude"]  # `latest_s` is a stamp, the other a time
            if not covered and latest_s - first.time_s <= patience_s and len(self._waiting) < self.LONGEST_QUEUE:
                return
            attitude = self._at(self._waiting.popleft().time_s)
            if attitude is None:
                self.counts["unpaired"] += 1
            else:
                yield first, attitude

    def _attitude(self, reading: Reading) -> None:
        angles = reading.value[:3]
        if not all(map(math.isfinite, angles)):
            self.counts["attitude-invalid"] += 1
            return
        if self._time_s and reading.time_s <= self._time_s[-1]:
            if self._time_s[-1] - reading.time_s < self.SET_BACK_S:
                self.counts["attitude-backward"] += 1
                return
            self.counts["attitude-clock-set-back"] += 1
            self._time_s, self._angles = [], []
        # the arithmetic of numpy.unwrap, so that the replay of a recording gives the same bits
        for k, angle in enumerate(angles if self._last else ()):
            step = angle - self._last[k]
            if abs(step) >= math.pi:
                wrapped = (step + math.pi) % (2.0 * math.pi) - math.pi
                self._turns[k] += (math.pi if wrapped == -math.pi and step > 0.0 else wrapped) - step
        self._last = list(angles)
        self._time_s.append(reading.time_s)
        self._angles.append([angle + turn for angle, turn in zip(angles, self._turns, strict=True)])
        if len(self._time_s) > self.KEPT:
            del self._time_s[: self.KEPT // 2], self._angles[: self.KEPT // 2]

    def _at(self, time_s: float) -> list[float] | None:
        """Attitude at a time; None where none is near enough."""
        t = self._time_s
        if not t or time_s < t[0] - self._period_s or time_s > t[-1] + self._period_s:
            return None
        k = bisect_left(t, time_s)
        if k == 0 or k == len(t):
            return self._angles[min(k, len(t) - 1)]
        before, after = self._angles[k - 1], self._angles[k]
        return [float(np.interp(time_s, t[k - 1 : k + 1], (before[i], after[i]))) for i in range(3)]

    # ---------------------------------------------------------------- snapshot
    def snapshot(self) -> dict[str, Any]:
        """Everything, as JSON can hold it."""
        return {
            "time_s": self._time_s,
            "angles": self._angles,
            "last": self._last,
            "turns": self._turns,
            "waiting": [[r.sensor, r.time_s, r.value, r.sd] for r in self._waiting],
            "counts": self.counts,
        }

    def restore(self, saved: dict[str, Any]) -> None:
        """The inverse of `snapshot`."""
        self._time_s, self._angles = list(saved["time_s"]), list(saved["angles"])
        self._last, self._turns, self.counts = list(saved["last"]), list(saved["turns"]), dict(saved["counts"])
        # JSON has no NaN: null stands for a missing component, as in a line
        self._waiting = deque(
            Reading(name, t, _missing(value), _missing(sd), b"") for name, t, value, sd in saved["waiting"]
        )


def _missing(values: list[float | None] | None) -> Any:
    return None if values is None else [math.nan if v is None else v for v in values]


@dataclass(frozen=True, kw_only=True)
class Options:
    """How a run was asked for, as far as it decides the output.

    Parameters
    ----------
    rate_hz : float
        States per second of the readings' clock.
    align_s : float
        Without a start the first readings of so many seconds are aligned.
    start : dict, optional
        Keyword arguments of `Start`; without ``time_s`` it is the first reading of the drive.
    date : datetime.date, optional
        For the magnetic declination.
    """

    rate_hz: float = 1.0
    align_s: float = 5.0
    start: dict[str, Any] | None = None
    date: datetime.date | None = None

    def to_json(self) -> dict[str, Any]:
        """As the log holds it."""
        return dict(json_value(dataclasses.asdict(self)))

    @classmethod
    def from_json(cls, saved: dict[str, Any]) -> "Options":
        """The inverse of `to_json`; raises ValueError where it cannot be."""
        try:
            start = None if saved["start"] is None else start_from(saved["start"])
            date = None if saved["date"] is None else datetime.date.fromisoformat(saved["date"])
            options = cls(rate_hz=float(saved["rate_hz"]), align_s=float(saved["align_s"]), start=start, date=date)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"the options of this run cannot be read: {error!r}.") from None
        if not (0.0 < options.rate_hz < math.inf and 0.0 < options.align_s < math.inf):
            raise ValueError(
                f"the options of this run make no sense: rate_hz {options.rate_hz}, align_s {options.align_s}."
            )
        return options


class Session:
    """A navigator that is fed with lines.

    Parameters
    ----------
    vehicle : Vehicle
    options : Options
    emit : callable
        Takes each line of output, and whether it is a state (True) or an event.
    note : callable, optional
        Takes notes for the log (the start that was found).
    """

    #: Drive samples are handed over together for so long [s], and never more than so many.
    BLOCK_S, BLOCK = 0.1, 256
    #: The drive is silent after so many readings that are ahead of it, while its time stands still.
    AHEAD = 3
    #: No vehicle is faster or farther from the surface: such a state is none.
    FASTEST_M_S, HIGHEST_M = 3000.0, 100e3
    #: So many seconds of the drive's samples, and so many at least, that bring time no further are no state to trust,
    #: nor are those that bring it less far than by this share of them: a rate that is described ten times too high is
    #: told otherwise. A clock that was set back is found within a quarter of a second, one in doubt within one.
    STALLED_S, STALLED, SLOWEST = 2.0, 20, 0.05
    #: So is a state that readings are so far ahead of [s]; an inertial unit that is silent is stood in for by then.
    BEHIND_S = ImuIntake.SILENT_S + 1.0
    #: A warning about one kind of bad line comes at most so often [s], or when there are ten times as many.
    WARN_EVERY_S = 60.0
    #: Readings that are kept for an alignment: of so many seconds, and never more than so many.
    KEPT_S, KEPT = 65.0, 200_000

    def __init__(
        self,
        vehicle: Vehicle,
        options: Options,
        emit: Callable[[bytes, bool], None],
        note: Callable[[bytes], None] | None = None,
    ) -> None:
        self.vehicle, self.options, self._emit = vehicle, options, emit
        self._note = note or (lambda line: None)
        self.nav: Navigator | LaneNavigator | None = None
        self._lanes = bool(vehicle.lanes())
        self._units = {name: [float(i)] if self._lanes else [] for i, name in enumerate(vehicle.units)}
        self._drive_name = " and ".join(vehicle.imus) or vehicle.drive.streams[-1]
        self._start = options.start
        self._buffer: list[Reading] = []
        self._align_at_s: float | None = None
        self._waited, self._told_date = "", False
        self._pairing = self._new_pairing()
        self._rows: list[list[float]] = []
        self._tick = self._second = -math.inf
        self._due_s = -math.inf
        self._drive_s = self._offset_s = 0.0
        self._ahead, self._stopped_s = 0, -math.inf
        self._most_stalled = max(self.STALLED, round(self.STALLED_S * vehicle.drive.rate_hz) * len(vehicle.driving))
        self._stalled, self._moved_s = 0, -math.inf
        self._least_s = self.SLOWEST * vehicle.drive.period_s / len(vehicle.driving)
        self.bad: dict[str, int] = {}
        self._warned: dict[str, list[float]] = {}
        self._conditions: dict[str, str] = {}

    @property
    def _running(self) -> Navigator | LaneNavigator:
        """The navigator, where there is one."""
        assert self.nav is not None
        return self.nav

    @property
    def _now_s(self) -> float:
        """Mission time of its state [s]."""
        return self._running.time_s

    def _new_pairing(self) -> Pairing | None:
        drive = self.vehicle.drive
        return None if "imu" in drive.streams else Pairing(drive.period_s, drive.late_s)

    # ---------------------------------------------------------------- in
    def feed(self, item: Item) -> None:
        """Take the next line. Drive samples are gathered into blocks, whose ends follow from the stamps alone."""
        if isinstance(item, Reading):
            if self.nav is not None and self._is_stalled(item):
                self._stall(item)
            if self.nav is None:
                self._before_start(item)
            elif self._pairing is not None:
                for reading, attitude in self._pairing.take(item):
                    self._take(reading, attitude)
                    if self.nav is None:
                        break
            else:
                self._take(item, None)
        elif isinstance(item, BadLine):
            self._bad(item)
        elif isinstance(item, StartLine):
            self._start_line(item)
        elif item.event == "stop":
            self.stop()
        elif item.event == "run":
            self._run(item)

    def _flush(self) -> None:
        """Hand over the drive samples that were gathered."""
        if self._rows and self.nav is not None:
            rows, self._rows = self._rows, []
            self.nav.step_samples(np.array(rows))
            self._offset_s = self.nav.offset_s
            if self._ahead and self.nav.time_s > self._stopped_s:
                self._ahead = 0
                if not self._lanes:
                    self._condition(self._drive_name, "good")

    def stop(self) -> None:
        """The end of the readings (of this run): what still waits is used, and the last state is told."""
        if self.nav is not None:
            for reading, attitude in () if self._pairing is None else self._pairing.end():
                if self.nav is not None:
                    self._take(reading, attitude)
            self._flush()
        if self.nav is not None:
            self.nav.finish()
        if self.nav is not None and self._makes_sense(self.nav.state):
            self._state()
        self._tell("stop", time_s=None if self.nav is None else self.nav.time_s, bad_lines=self.bad)

    def _run(self, item: Note) -> None:
        """A run that was resumed may have been asked for another rate."""
        rate_hz = item.fields.get("rate_hz")
        if isinstance(rate_hz, int | float) and 0.0 < rate_hz < math.inf:
            self.options = dataclasses.replace(self.options, rate_hz=float(rate_hz))
            if self.nav is not None:
                self._flush()
                self._next_tick()

    def _take(self, reading: Reading, attitude: list[float] | None) -> None:
        name, time_s = reading.sensor, reading.time_s
        if name in self._units:
            self._rows.append([time_s, *reading.value[:6], *self._units[name]])
        elif attitude is not None:
            self._rows.append([time_s, *attitude, *reading.value[:3]])
        else:
            self._correct(reading)
            return
        self._drive_s = time_s
        block = abs(time_s - self._rows[0][0]) >= self.BLOCK_S or len(self._rows) >= self.BLOCK
        if block or time_s + self._offset_s >= self._due_s:
            self._flush()
            self._ticks()

    def _correct(self, reading: Reading) -> None:
        self._flush()
        outcome = self._running.correct(reading.sensor, reading.time_s, reading.value, reading.sd)
        if outcome.status == "ahead":  # of the drive; a single one may as well have a wild stamp
            self._ahead, self._stopped_s = self._ahead + 1 if self._stopped_s == self._now_s else 1, self._now_s
            if self._ahead >= self.AHEAD and not self._lanes:  # lanes say so themselves
                self._condition(self._drive_name, "silent")
        self._ticks()

    def _is_stalled(self, reading: Reading) -> bool:
        """Whether readings come and come, and time goes no further."""
        time_s = self._now_s
        if self._moves():
            self._stalled, self._moved_s = 0, time_s
        elif reading.sensor in self.vehicle.driving:
            self._stalled += 1
        behind = self._ahead >= self.AHEAD and reading.time_s > time_s + self.BEHIND_S
        return behind or self._stalled >= self._most_stalled

    def _moves(self) -> bool:
        """Whether time has gone on by what the drive's samples since then tell at least."""
        return self.nav is not None and self.nav.time_s > self._moved_s + self._least_s * self._stalled

    def _stall(self, reading: Reading) -> None:
        """Say once that there is no new state, and that the last one is not to be trusted any more."""
        if self._conditions.get("trust") == "stalled":
            return
        what = "do not rise" if reading.sensor in self.vehicle.driving else "have ended"
        was, self._conditions["trust"] = self._conditions.get("trust", "good"), "stalled"
        self._conditions["stalled"] = f"the stamps of {self._drive_name} {what}: no state since {self._now_s:.3f} s"
        self._tell("trust", was=was, time_s=self._now_s, **self._untrusted())
        self._state()

    def _untrusted(self) -> dict[str, Any]:
        """Fields of a state in place of its own where time goes no further."""
        if self._conditions.get("trust") != "stalled" or self._moves():
            return {}
        return {"trust": "lost", "reasons": [self._conditions["stalled"]]}

    # ---------------------------------------------------------------- start
    def _before_start(self, reading: Reading) -> None:
        if len(self._buffer) >= self.KEPT:
            del self._buffer[: self.KEPT // 2]
        self._buffer.append(reading)
        if reading.sensor not in (self._units or self.vehicle.drive.streams[:1]):
            return
        if self._start is not None:
            self._begin(Start(**{"time_s": reading.time_s, "date": self.options.date, **self._start}), "given")
        elif self._align_at_s is None or abs(reading.time_s - self._align_at_s) > 10.0 * self.options.align_s:
            self._align_at_s = reading.time_s + self.options.align_s  # the first reading, or the clock was set
        elif reading.time_s > self._align_at_s:
            self._align_at_s = reading.time_s + 1.0
            self._align()

    def _align(self) -> None:
        streams, _ = streams_of(self._buffer)
        mission = Mission("live", streams, date=self._date(self.options.date))
        try:
            start = align(self.vehicle, mission, self.options.align_s)
        except ValueError as error:
            if str(error) != self._waited:
                self._waited = str(error)
                self._tell("waiting", text=self._waited)
            oldest_s = self._buffer[-1].time_s - self.KEPT_S - self.options.align_s
            self._buffer = [reading for reading in self._buffer if reading.time_s >= oldest_s]
            return
        # Everything within the window must have arrived, so that the same readings in a file align the same.
        if self._buffer[-1].time_s > start.time_s + self.options.align_s:
            self._begin(start, "aligned")

    def _date(self, date: datetime.date | None) -> datetime.date | None:
        """The date, or one that there is a magnetic model for; tells once of another."""
        if date is None or (usable := believable(date)) == date:
            return date
        if not self._told_date:
            self._told_date = True
            self._tell(
                "warning",
                text=f"the clock says {date}: the magnetic declination is that of {usable}, wrong by 0.2 degrees for "
                "each year in between; give --date",
            )
        return usable

    def _begin(self, start: Start, how: str) -> None:
        start = dataclasses.replace(start, date=self._date(start.date))
        fields = json_value({k: v for k, v in dataclasses.asdict(start).items() if v is not None})
        self._note(to_line({"event": "start", "how": how, "start": fields}))
        self._tell("start", how=how, **fields)
        self.nav = (LaneNavigator if self._lanes else Navigator)(self.vehicle, start)
        self._next_tick()
        first = next((r.time_s for r in self._buffer if r.sensor in self.vehicle.driving), start.time_s)
        if abs(first - start.time_s) > ImuIntake.LONGEST_S:
            self._tell(
                "warning", text=f"the start is at {start.time_s} s, the readings at {first} s: is it the same clock?"
            )
        buffer, self._buffer = self._buffer, []
        for reading in buffer:
            if reading.time_s >= start.time_s - 1e-9 or reading.sensor == "attitude":
                self.feed(reading)

    def _start_again(self) -> None:
        """When the readings made so little sense that there is no state any more, look for a start in those to come."""
        self._tell(
            "diverged",
            time_s=self._now_s,
            text="the state is that of no vehicle any more; aligning again, or give a start line",
        )
        self.nav, self._start, self._align_at_s, self._waited, self._offset_s = None, None, None, "", 0.0
        self._rows.clear()
        self._conditions.clear()
        if self._pairing is not None:
            self._pairing = self._new_pairing()

    def _start_line(self, item: StartLine) -> None:
        if self.nav is not None:
            self._bad(BadLine("wrong-start", "a start came after the start; restart the run to start again", b""))
            return
        self._start = item.fields
        if "time_s" in item.fields:
            self._begin(Start(**{"date": self.options.date, **item.fields}), "line")

    # ---------------------------------------------------------------- out
    def _next_tick(self) -> None:
        """The first time at which something is due."""
        t, rate = self._now_s, self.options.rate_hz
        self._tick, self._second = math.floor(t * rate + 1e-6), math.floor(t + 1e-6)
        self._due_s = min((self._tick + 1 - 1e-6) / rate, self._second + 1 - 1e-6)

    def _ticks(self) -> None:
        """Tell the state when the navigator's time has passed the next multiple of the output's period."""
        t = self._now_s
        if t < self._due_s:
            return
        tick, second = self._tick, self._second
        self._next_tick()
        if self._second == second and self._tick == tick:
            return
        state = self._running.state
        if not self._makes_sense(state):
            self._start_again()
            return
        if self._second != second:
            health = self._running.health
            for name, sensor in health.sensors.items():
                self._condition(name, sensor.condition)
            for name, condition in health.axes.items():
                self._condition(name, condition)
            for name, lane in health.lanes.items():
                well = lane.condition in ("in-force", "ready")
                self._condition(f"lane of {name}", "good" if well else lane.condition)
            self._lane(health.lane, health.lane_reason)
            self._drive_clock(health.drive_clock_offset_s)
            self._trust(health)
        if self._tick > tick:
            self._state()

    def _makes_sense(self, state: NavState) -> bool:
        """Whether there is a state at all: finite, and of something that moves on or near the Earth."""
        speed, height = float(np.abs(state.velocity_n).max()), abs(state.height)
        return speed < self.FASTEST_M_S and height < self.HIGHEST_M and bool(np.isfinite(state.sd).all())

    def _state(self) -> None:
        state = self._running.state
        drive = self._running.counts if self._pairing is None else {**self._running.counts, **self._pairing.counts}
        self._emit(to_line({**state_fields(state), **self._untrusted(), "drive": drive, "bad_lines": self.bad}), True)

    def _tell(self, event: str, **fields: Any) -> None:
        self._emit(event_line(event, **fields), False)

    def _condition(self, name: str, condition: str) -> None:
        """Tell when a sensor's condition has changed; that it has been heard at all is no news."""
        was = self._conditions.get(name, "waiting")
        if condition != was:
            self._conditions[name] = condition
            if (was, condition) != ("waiting", "good"):
                self._tell("condition", sensor=name, condition=condition, was=was, time_s=self._now_s)

    def _lane(self, lane: str, reason: str) -> None:
        """Tell when something else carries the state, and why."""
        was = self._conditions.setdefault("lane", lane)
        if lane != was:
            self._conditions["lane"] = lane
            self._tell("lane", lane=lane, was=was, reason=reason, time_s=self._now_s)

    def _trust(self, health: Health) -> None:
        """Tell when the state is to be trusted more, or less, than before, and why."""
        assert health.trust is not None
        was, now = self._conditions.setdefault("trust", "good"), health.trust.level
        if now != was:
            self._conditions["trust"] = now
            said = "lost" if was == "stalled" else was
            self._tell("trust", was=said, time_s=self._now_s, **integrity_fields(health))

    def _drive_clock(self, offset_s: float) -> None:
        """Tell when the clock of the drive alone was set."""
        was = self._conditions.setdefault("drive clock", "0.0")
        if repr(offset_s) != was:
            self._conditions["drive clock"] = repr(offset_s)
            self._tell(
                "drive-clock",
                offset_s=offset_s,
                time_s=self._now_s,
                text=f"the clock of {self._drive_name} alone was set by {-offset_s:.3f} s in all; its "
                "stamps are moved back to those of the others",
            )

    def _bad(self, item: BadLine) -> None:
        count = self.bad[item.kind] = self.bad.get(item.kind, 0) + item.lines
        now, warned = self._drive_s, self._warned.get(item.kind)
        if warned is None or abs(now - warned[0]) >= self.WARN_EVERY_S or count >= 10 * warned[1]:
            self._warned[item.kind] = [now, count]
            self._tell("bad-line", kind=item.kind, count=count, text=item.text)

    # ---------------------------------------------------------------- snapshot
    def snapshot(self) -> tuple[bytes, bytes] | None:
        """What a later process needs beside the log: this session as a line of JSON, and the navigator; None before the
        start.
        """
        if self.nav is None:
            return None
        saved = {
            "options": self.options.to_json(),
            "rows": self._rows,
            "tick": self._tick,
            "second": self._second,
            "drive_s": self._drive_s,
            "ahead": [self._ahead, self._stopped_s],
            "stalled": [self._stalled, self._moved_s],
            "bad": self.bad,
            "warned": self._warned,
            "conditions": self._conditions,
            "pairing": None if self._pairing is None else self._pairing.snapshot(),
        }
        return to_line(saved), self.nav.snapshot()

    def restore(self, session: bytes, nav: bytes) -> None:
        """Continue where `snapshot` was taken.

        Raises
        ------
        ValueError
            When the snapshot is damaged, of another version or of another vehicle.
        """
        restored = (LaneNavigator if self._lanes else Navigator).restore(self.vehicle, nav)
        try:
            self._restore(json.loads(session), restored)
        except (KeyError, TypeError, IndexError, AttributeError) as error:
            raise ValueError(f"the snapshot cannot be read ({error!r}). Move it away to start afresh.") from None

    def _restore(self, saved: dict[str, Any], nav: Navigator | LaneNavigator) -> None:
        self.nav = nav
        self.options, self._offset_s = Options.from_json(saved["options"]), self.nav.offset_s
        self._next_tick()
        self._tick, self._second, self._drive_s = saved["tick"], saved["second"], saved["drive_s"]
        (self._ahead, self._stopped_s), (self._stalled, self._moved_s) = (
            (count, -math.inf if time_s is None else time_s) for count, time_s in (saved["ahead"], saved["stalled"])
        )
        # JSON has no NaN: null stands for a missing component, as in a line
        self._rows = [[math.nan if v is None else v for v in row] for row in saved["rows"]]
        self.bad, self._warned, self._conditions = saved["bad"], saved["warned"], saved["conditions"]
        if self._pairing is not None:
            self._pairing.restore(saved["pairing"])
