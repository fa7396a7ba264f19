"""What a mission holds for a vehicle: the samples of its drive, and the readings of its sensors in their order."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from navfilter.foundation.arrays import Array, Ints
from navfilter.models.mission import Mission, Stream
from navfilter.models.vehicle import Vehicle

#: Readings that are farther from the drive than this are of another clock [s]: a dive may be without any for long.
DAY_S = 86400.0


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

    def later(self, by_s: Array, which: Ints | slice = slice(None)) -> "MeasurementSequence":
        """Some of them by times that are later by so much; of equal times those first that have waited."""
        time_s = (self.time_s + by_s)[which]
        order = np.lexsort((by_s[which] <= 0.0, time_s))
        kept = {name: getattr(self, name)[which][order] for name in ("stamp_s", "sensor", "row")}
        return replace(self, time_s=time_s[order], **kept)


def drive_samples(vehicle: Vehicle, mission: Mission) -> tuple[Array, Array]:
    """Samples of the drive: times (n,) and six values (n, 6); attitude is interpolated to the times of the velocity.

    Raises
    ------
    ValueError
        When a stream is missing, empty or has the wrong number of columns.
    """
    wanted = [(name, 6 // len(vehicle.drive.streams)) for name in vehicle.drive.streams]
    for name, columns in wanted:
        _require(mission, name, "the vehicle's drive needs it", "choose another [drive] in the vehicle.toml")
        if not len(mission.streams[name]):
            raise ValueError(f'stream "{name}" of this mission is empty; the vehicle\'s drive needs it.')
        if mission.streams[name].value.shape[1] < columns:
            raise ValueError(
                f'stream "{name}" has {mission.streams[name].value.shape[1]} columns, but its drive takes {columns}.'
            )
    return vehicle.drive.samples(mission.streams)


def _require(mission: Mission, name: str, why: str, instead: str) -> None:
    if name not in mission.streams:
        have = ", ".join(mission.streams) or "none"
        raise ValueError(
            f'"{name}" has no stream in this mission (streams: {have}); {why}. Add [streams.{name}] to the '
            "mission.toml, "
            f"or {instead}."
        )


def readings_of(vehicle: Vehicle, mission: Mission, begin_s: float) -> MeasurementSequence:
    """All readings of the correcting sensors from a time on [s], in the order in which they were taken.

    Raises
    ------
    ValueError
        When a stream is missing or has too few columns.
    """
    names, streams = tuple(vehicle.sensors), []
    for name in names:
        if vehicle.sensors[name].from_drive:
            streams.append(Stream(np.empty(0), np.empty((0, 1))))
            continue
        leave_out = f"leave the sensor out: --without {name}, or take [sensors.{name}] out of the vehicle.toml"
        _require(mission, name, f'the vehicle has a sensor "{name}"', leave_out)
        width, sensor = mission.streams[name].value.shape[1], vehicle.sensors[name]
        if width < sensor.reads:
            raise ValueError(
                f'stream "{name}" has {width} columns, but a {type(sensor).__name__} takes {sensor.reads}.'
            )
        streams.append(mission.streams[name])
    stamps = np.concatenate([np.empty(0), *(s.time_s for s in streams)])
    _check_clocks(vehicle, mission, stamps)
    sizes = np.array([len(stream) for stream in streams], dtype=int)
    late_s = np.repeat([vehicle.sensors[name].time_offset_s for name in names], sizes)
    times = stamps - late_s if late_s.any() else stamps
    number = np.concatenate([np.empty(0, int), *(np.full(len(s), i) for i, s in enumerate(streams))])
    rows = np.concatenate([np.empty(0, int), *(np.arange(len(s)) for s in streams)])
    order = np.lexsort((rows, number, times))
    order = order[times[order] >= begin_s - 1e-9]
    values, sds = tuple(s.value for s in streams), tuple(_sds(s) for s in streams)
    return MeasurementSequence(times[order], stamps[order], number[order], rows[order], names, values, sds)


def _check_clocks(vehicle: Vehicle, mission: Mission, stamps: Array) -> None:
    """Refuse readings of another day than the drive's: none of them would ever be used."""
    drive = [mission.streams[name].time_s for name in vehicle.driving if len(mission.streams.get(name, ()))]
    if not drive or not len(stamps):
        return
    begin_s, end_s = min(times[0] for times in drive), max(times[-1] for times in drive)
    if max(stamps.min() - end_s, begin_s - stamps.max()) > DAY_S:
        raise ValueError(
            f"the drive's stream is of {begin_s:.10g} to {end_s:.10g} s, all readings of the sensors of "
            f"{stamps.min():.10g} to {stamps.max():.10g} s: bring them to one clock (Stream.later, or offset_s in "
            "mission.toml)."
        )


def _sds(stream: Stream) -> list[Array | None] | None:
    """What `Navigator.correct` takes as the standard deviation of each reading; None where none has its own."""
    if stream.sd is None or np.isnan(stream.sd).any(axis=1).all():
        return None
    return [None if np.isnan(row).any() else row for row in stream.sd]
