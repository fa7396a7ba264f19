"""Real recordings, replayed as a vehicle would have to: positions given for a short while, then withheld.

Every recording that the tests have a mission.toml for is replayed from its files (environment variable NAVFILTER_DATA)
under the protocol of its kind, and compared with plain dead reckoning on the same readings: velocity turned by the heading
and summed up, no filter.

| kind | protocol |
|---|---|
| car with RTK | RTK for the first 25 m, then none; and 5 s of RTK in every 60 s, judged in between, filter and smoother |
| AUV with truth | position for the first 100 s, then none |
| lake AUV | GPS withheld one minute at a time (others: position for the first 30 s), judged against the withheld fixes |
| pool AUV | no position at all: distance between the ends of a closed track |
| car, one minute | GNSS for the first 20 s, then none |
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from navfilter.io import read_mission, read_vehicle
from navfilter.io.geodesy import matrix_from_euler
from navfilter.mission import Mission, Stream
from navfilter.playback import replay
from navfilter.sensors import Position
from navfilter.track import Track
from navfilter.vehicle import Vehicle

Array = NDArray[np.float64]
RECORDINGS = Path(__file__).parent.parent / "tests" / "recordings"
EARTH_RADIUS_M = 6.371e6
FOREVER = 1e12


@dataclass(frozen=True)
class Row:
    """One line of the table; errors in metres, None where there is no such figure."""

    recording: str
    protocol: str
    distance_m: float
    end_m: float | None
    end_pct: float | None
    rms_m: float | None
    smoothed_rms_m: float | None
    plain_end_m: float | None
    beyond_3_sigma_pct: float | None
    nis: dict[str, float | None]


# --- positions in metres ----------------------------------------------------------------------------------------------


def plane(stream: Stream) -> tuple[Array, NDArray[np.complex128]]:
    """Times and positions, north + i east [m] from the first one, of a stream or of the truth."""
    known = np.isfinite(stream.column("latitude_rad")) & np.isfinite(stream.column("longitude_rad"))
    latitude, longitude = stream.column("latitude_rad")[known], stream.column("longitude_rad")[known]
    north = latitude - latitude[0]
    return stream.time_s[known], EARTH_RADIUS_M * (north + 1j * np.cos(latitude[0]) * (longitude - longitude[0]))


def errors_at(track: Track, fixes: Stream, begin_s: float, end_s: float) -> tuple[Array, Array]:
    """Error (n, 2) and its covariance (n, 2, 2) of a track, north and east [m], at the fixes inside an interval."""
    inside = (fixes.time_s > begin_s) & (fixes.time_s <= end_s) & np.isfinite(fixes.value[:, :2]).all(axis=1)
    t, value = fixes.time_s[inside], fixes.value[inside]
    latitude, longitude = (np.interp(t, track.time_s, x) for x in (track.latitude, track.longitude))
    error = EARTH_RADIUS_M * np.column_stack([latitude - value[:, 0], (longitude - value[:, 1]) * np.cos(latitude)])
    row = np.clip(np.searchsorted(track.time_s, t), 0, len(track.time_s) - 1)
    return error, track.covariance[row][:, :2, :2]


def beyond_3_sigma(error: Array, P: Array) -> float:
    """Share [%] of errors outside the filter's own 99.7 % ellipse."""
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(P), error)
    return float(100.0 * np.mean(squared > 11.83))


def rms(error: Array) -> float:
    """Root mean square length of errors (n, 2)."""
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))) if len(error) else float("nan")


# --- plain dead reckoning ---------------------------------------------------------------------------------------------


def velocity_of(mission: Mission, vehicle: Vehicle) -> tuple[Stream, Array, complex]:
    """The stream of velocities, the same in body axes with the last valid one held, and its lever arm."""
    name = next(name for name, stream in mission.streams.items() if stream.columns[0] == "v_x_m_s")
    stream = mission.streams[name]
    sensor = vehicle.sensors.get(name) or getattr(vehicle.drive, "velocity_sensor")  # noqa: B009
    v = stream.value @ matrix_from_euler(*(np.array([a]) for a in sensor.mounting_rad))[0].T
    valid = np.flatnonzero(np.isfinite(v).all(axis=1))
    held = valid[np.maximum(np.searchsorted(valid, np.arange(len(v)), side="right") - 1, 0)]
    return stream, v[held], complex(*sensor.lever_arm_b_m[:2])


def plain_path(mission: Mission, vehicle: Vehicle) -> tuple[Array, NDArray[np.complex128]]:
    """Dead-reckoned path of the reference point (north + i east, from zero); by gyro its first heading is zero."""
    stream, v, lever = velocity_of(mission, vehicle)
    t = stream.time_s
    if "attitude" in mission.streams:
        attitude = mission.streams["attitude"]
        good = np.isfinite(attitude.value).all(axis=1)
        angles = np.unwrap(attitude.value[good], axis=0)
        roll, pitch, yaw = (np.interp(t, attitude.time_s[good], angles[:, k]) for k in range(3))
        v = np.einsum("nij,nj->ni", matrix_from_euler(roll, pitch, 0.0 * yaw), v)
    else:
        imu = mission.streams["imu"]
        speed = np.interp(imu.time_s, t, np.hypot(v[:, 0], v[:, 1]))
        still = speed < 0.02
        rate = imu.value[:, 2] - (imu.value[still, 2].mean() if np.mean(still) > 0.05 else 0.0)
        turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(imu.time_s))])
        yaw = np.interp(t, imu.time_s, turned)
    moving = (v[:, 0] + 1j * v[:, 1]) * np.exp(1j * yaw)
    path = np.concatenate([[0.0], np.cumsum(0.5 * (moving[1:] + moving[:-1]) * np.diff(t))])
    return t, path - lever * (np.exp(1j * yaw) - np.exp(1j * yaw[0]))


def plain_end_error(mission: Mission, vehicle: Vehicle, truth: Stream, until_s: float) -> float:
    """End error [m] of plain dead reckoning that knows the truth until a time.

    By attitude it starts from the last known position; by gyro its start and first heading are fitted to all that is known.
    """
    t, path = plain_path(mission, vehicle)
    times, place = plane(truth)
    inside = (times >= t[0]) & (times <= t[-1])
    times, place = times[inside], place[inside]
    own = np.interp(times, t, path.real) + 1j * np.interp(times, t, path.imag)
    known = times <= until_s
    if "attitude" in mission.streams:
        last = np.flatnonzero(known)[-1]
        return float(abs((own[-1] - own[last]) - (place[-1] - place[last])))
    own, place = own - own[0], place - place[0]
    turn = np.vdot(own[known], place[known])
    return float(abs(own[-1] * turn / abs(turn) - place[-1]))


# --- protocols --------------------------------------------------------------------------------------------------------


def position_name(vehicle: Vehicle) -> str:
    """The name of the vehicle's position sensor."""
    return next(name for name, sensor in vehicle.sensors.items() if isinstance(sensor, Position))


def truth_of(mission: Mission) -> Stream:
    """The truth of a mission that has one."""
    if mission.truth is None:
        raise ValueError(f'mission "{mission.name}" has no truth.')
    return mission.truth


def withheld(mission: Mission, vehicle: Vehicle, until_s: float, protocol: str) -> Row:
    """Positions until a time and none after."""
    truth, name = truth_of(mission), position_name(vehicle)
    smoothed = replay(vehicle, mission.hide(name, (until_s + 1e-6, FOREVER)), smooth=True)
    forward = smoothed.forward
    assert forward is not None  # a smoothed track has one
    end_s = min(truth.time_s[-1], forward.time_s[-1])
    error, P = errors_at(forward, truth, until_s, end_s)
    _, place = plane(truth)
    distance = float(np.abs(np.diff(place)).sum())
    end = float(np.hypot(*error[-1]))
    return Row(
        mission.name,
        protocol,
        distance,
        end,
        100.0 * end / distance,
        rms(error),
        rms(errors_at(smoothed, truth, until_s, end_s)[0]),
        plain_end_error(mission, vehicle, truth, until_s),
        beyond_3_sigma(error, P),
        forward.summary(truth)["nis"],
    )


def now_and_then(mission: Mission, vehicle: Vehicle, on_s: float = 5.0, every_s: float = 60.0) -> Row:
    """Positions for a few seconds in every minute, judged in between."""
    truth = truth_of(mission)
    starts = np.arange(mission.begin_s, mission.end_s, every_s)
    gaps = [(float(begin + on_s), float(begin + every_s)) for begin in starts]
    smoothed = replay(vehicle, mission.hide(position_name(vehicle), *gaps), smooth=True)
    forward = smoothed.forward
    assert forward is not None  # a smoothed track has one
    both = [[errors_at(track, truth, *gap) for gap in gaps] for track in (forward, smoothed)]
    error, smooth_error = (np.vstack([e for e, _ in parts]) for parts in both)
    _, place = plane(truth)
    return Row(
        mission.name,
        f"{on_s:.0f} s of {every_s:.0f}",
        float(np.abs(np.diff(place)).sum()),
        None,
        None,
        rms(error),
        rms(smooth_error),
        None,
        beyond_3_sigma(error, np.vstack([P for _, P in both[0]])),
        forward.summary(truth)["nis"],
    )


def minute_by_minute(mission: Mission, vehicle: Vehicle, minute_s: float = 60.0) -> Row:
    """Fixes withheld one minute at a time, judged against them."""
    name = position_name(vehicle)
    fixes = mission.streams[name]
    errors, covariances, smooth_errors = [], [], []
    for begin in np.arange(fixes.time_s[0] + minute_s, fixes.time_s[-1] - minute_s + 1.0, minute_s):
        gap = (float(begin), float(begin + minute_s))
        smoothed = replay(vehicle, mission.hide(name, gap), smooth=True)
        assert smoothed.forward is not None  # a smoothed track has one
        error, P = errors_at(smoothed.forward, fixes, *gap)
        errors.append(error)
        covariances.append(P)
        smooth_errors.append(errors_at(smoothed, fixes, *gap)[0])
    whole = replay(vehicle, mission)
    _, place = plane(fixes)
    error = np.vstack(errors)
    return Row(
        mission.name,
        "1 min without",
        float(np.abs(np.diff(place)).sum()),
        None,
        None,
        rms(error),
        rms(np.vstack(smooth_errors)),
        plain_end_error(mission, vehicle, fixes, fixes.time_s[3]),
        beyond_3_sigma(error, np.vstack(covariances)),
        whole.summary(mission.truth)["nis"],
    )


def closure(mission: Mission, vehicle: Vehicle) -> Row:
    """Distance between the ends of a track that is said to be closed, from the first to the last valid velocity."""
    track = replay(vehicle, mission)
    stream, _, _ = velocity_of(mission, vehicle)
    last = stream.time_s[np.isfinite(stream.value).all(axis=1)][-1]
    row = int(np.searchsorted(track.time_s, last)) - 1
    north = EARTH_RADIUS_M * (track.latitude - track.latitude[0])
    east = EARTH_RADIUS_M * (track.longitude - track.longitude[0]) * np.cos(track.latitude[0])
    end = float(np.hypot(north[row], east[row]))
    distance = float(np.hypot(np.diff(north), np.diff(east)).sum())
    t, path = plain_path(mission, vehicle)
    plain = float(abs(path[-1] - path[int(np.searchsorted(t, track.time_s[0]))]))
    nis = track.summary(None)["nis"]
    return Row(mission.name, "closure", distance, end, 100.0 * end / distance, None, None, plain, None, nis)


def rows_of(name: str) -> list[Row]:
    """All rows of one recording, named as its folder."""
    mission, vehicle = read_mission(RECORDINGS / name), read_vehicle(RECORDINGS / name)
    if name.startswith("wid-car-rtk"):
        times, place = plane(truth_of(mission))
        way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(place)))])
        until = float(times[np.searchsorted(way, 25.0)])
        return [withheld(mission, vehicle, until, "first 25 m"), now_and_then(mission, vehicle)]
    if name.startswith("sonia"):
        return [closure(mission, vehicle)]
    if name.endswith("20220625_0_0"):
        return [minute_by_minute(mission, vehicle)]
    seconds = {"snapir-auv-1hz": 100.0, "auv-lake-sea-10hz": 30.0, "comma2k19": 20.0}[name.split("/")[0]]
    until = mission.streams[position_name(vehicle)].time_s[0] + seconds
    return [withheld(mission, vehicle, float(until), f"first {seconds:.0f} s")]


def table(rows: list[Row]) -> str:
    """The rows as a table for people."""

    def cell(value: float | None, digits: int = 2) -> str:
        return "-" if value is None else f"{value:.{digits}f}"

    head = ("recording", "positions", "path m", "end m", "end %", "rms m", "smooth m", "plain m", ">3 sd %", "NIS")
    lines = [head]
    for r in rows:
        nis = " ".join(f"{name} {cell(value)}" for name, value in r.nis.items())
        lines.append(
            (
                r.recording,
                r.protocol,
                cell(r.distance_m, 0),
                cell(r.end_m),
                cell(r.end_pct, 3),
                cell(r.rms_m),
                cell(r.smoothed_rms_m),
                cell(r.plain_end_m),
                cell(r.beyond_3_sigma_pct, 1),
                nis,
            )
        )
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    return "\n".join("  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip() for line in lines)


def medians(rows: list[Row]) -> list[str]:
    """Median end error in % of the distance, per kind of recording and protocol."""
    groups: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        if row.end_pct is not None and row.protocol != "closure":
            groups.setdefault((row.recording.split(" ")[0], row.protocol), []).append(row.end_pct)
    return [f"{kind}, {protocol}: median end error {np.median(v):.3f} %" for (kind, protocol), v in groups.items()]


def main() -> None:
    """Replay everything and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the figures to this file too")
    parser.add_argument("--only", default="", help="only recordings whose name contains this")
    parser.add_argument("--quick", action="store_true", help="one recording of each kind")
    arguments = parser.parse_args()
    if not os.environ.get("NAVFILTER_DATA"):
        parser.error("set the environment variable NAVFILTER_DATA to the folder of the recordings.")
    names = sorted(str(path.parent.relative_to(RECORDINGS)) for path in RECORDINGS.glob("*/*/mission.toml"))
    names = [name for name in names if arguments.only in name]
    if arguments.quick:
        names = list({name.split("/")[0]: name for name in reversed(names)}.values())[::-1]
    rows = []
    for name in names:
        if name.endswith("OUTOFWATER"):
            continue  # handled in air: the DVL sees no bottom
        rows += rows_of(name)
    print(table(rows))
    print("\n".join(["", *medians(rows)]))
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=1))


if __name__ == "__main__":
    main()
