"""Real recordings, replayed as a vehicle would have to: positions given for a short while, then withheld.

They are compared with plain dead reckoning on the same readings: velocity turned by the heading and summed up, no
filter. The recordings are those that ``tests/recordings`` has a mission.toml for (environment variable
NAVFILTER_DATA).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import car_clocks as car
import dive_clocks
import numpy as np
import wrong_constants as put
from clock_states import CALIBRATED_S, SNAPIR, cases
from dead_reckoning import EARTH_RADIUS_M, plain_end_error, plain_path, plane, velocity_of
from harness import MAPPINGS, Array, Options, Table, data_root, fixes_of, flag, main, quick, recorded

from navfilter.calibration.parts import constants_of, described
from navfilter.calibration.passes import smoothed
from navfilter.models.mission import Mission, Stream
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay
from navfilter.track.track import Track


@dataclass(frozen=True)
class Row:
    """One line of the table; errors in metres, None where there is no such figure."""

    recording: str
    protocol: str
    distance_m: float
    end_m: float | None = None
    end_pct: float | None = None
    rms_m: float | None = None
    smoothed_rms_m: float | None = None
    smoothed_nees: float | None = None
    plain_end_m: float | None = None
    beyond_3_sigma_pct: float | None = None
    nis: dict[str, float | None] = field(default_factory=dict)


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


def nees_of(error: Array, P: Array) -> float:
    """Mean normalised error squared of errors (n, 2), per axis."""
    return float(np.mean(np.einsum("ni,nij,nj->n", error, np.linalg.inv(P), error)) / 2.0) if len(error) else math.nan


def rms(error: Array) -> float:
    """Root mean square length of errors (n, 2)."""
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))) if len(error) else float("nan")


def way_of(truth: Stream) -> Array:
    """Distance gone at every known position [m]."""
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(plane(truth)[1])))])


# --- protocols ------------------------------------------------------------------------------------------------------


def without(mission: Mission, vehicle: Vehicle, reference: Stream, *gaps: tuple[float, float]) -> tuple[Track, Any]:
    """Replay without the fixes inside gaps: the forward track; errors there, their covariances, both smoothed."""
    track = replay(vehicle, mission.hide(fixes_of(vehicle), *gaps), smooth=True)
    return track.forward, (*errors_in(track.forward, reference, gaps), *errors_in(track, reference, gaps))


def errors_in(track: Track, fixes: Stream, gaps: Sequence[tuple[float, float]]) -> tuple[Array, Array]:
    """As `errors_at`, in all gaps as far as the track goes."""
    found = [errors_at(track, fixes, begin, min(end, track.time_s[-1])) for begin, end in gaps]
    error, P = (np.concatenate(part) for part in zip(*found, strict=True))
    return error, P


def judged(error: Array, P: Array, back: Array, back_P: Array) -> dict[str, float]:
    """What errors are worth."""
    return {
        "rms_m": rms(error),
        "smoothed_rms_m": rms(back),
        "smoothed_nees": nees_of(back, back_P),
        "beyond_3_sigma_pct": beyond_3_sigma(error, P),
    }


def hidden(mission: Mission, vehicle: Vehicle, until_s: float, protocol: str) -> Row:
    """Positions until a time and none after."""
    truth, distance = mission.truth, float(way_of(mission.truth)[-1])
    forward, errors = without(mission, vehicle, truth, (until_s + 1e-6, math.inf))
    plain = plain_end_error(mission, vehicle, truth, until_s)
    if not len(errors[0]):
        return Row(mission.name, f"ends at {forward.time_s[-1]:.1f} s", distance, plain_end_m=plain)
    end = float(np.hypot(*errors[0][-1]))
    ends = {"end_m": end, "end_pct": 100.0 * end / distance, "plain_end_m": plain}
    return Row(mission.name, protocol, distance, **ends, **judged(*errors), nis=forward.summary(truth)["nis"])


def now_and_then(trial: str, on_s: float = 5.0, every_s: float = 60.0) -> list[Row]:
    """RTK for a few seconds in every minute, judged in between: a trial of the car as mapped, by two passes, and by two
    passes with the constants that all of the RTK tells.
    """
    rows, protocol = [], f"{on_s:.0f} s of {every_s:.0f}"
    mission, vehicle = car.finer(trial)
    cases = {
        protocol: (*recorded(f"wid-car-rtk/{trial}"), 1),
        f"{protocol}, 2 passes": (mission, vehicle, 2),
        f"{protocol}, hindsight": (mission, with_hindsight(mission, vehicle), 2),
    }
    for label, (mission, vehicle, passes) in cases.items():
        truth, distance = mission.truth, float(way_of(mission.truth)[-1])
        starts = np.arange(mission.begin_s, mission.end_s, every_s)
        gaps = [(float(begin + on_s), float(begin + every_s)) for begin in starts]
        forward, errors = without(mission, vehicle, truth, *gaps)
        if passes > 1:
            twice = smoothed(vehicle, mission.hide(fixes_of(vehicle), *gaps), passes)
            errors = (*errors[:2], *errors_in(twice, truth, gaps))
        rows.append(Row(mission.name, label, distance, **judged(*errors), nis=forward.summary(truth)["nis"]))
    return rows


def with_hindsight(mission: Mission, vehicle: Vehicle) -> Vehicle:
    """A vehicle with the constants that all fixes of a mission tell."""
    track, known = replay(vehicle, mission, smooth=True), []
    for one in constants_of(vehicle):
        value, sd = (float(of[-1]) for of in track.state(one.name))
        begins_at_zero = one.folded and not one.own.startswith("misalignment_")
        known.append(one._replace(value=value + (one.value if begins_at_zero else 0.0), sd=sd))
    return described(vehicle, known)


def minute_by_minute(mission: Mission, vehicle: Vehicle, minute_s: float = 60.0) -> Row:
    """Fixes withheld one minute at a time, judged against them."""
    fixes = mission.streams[fixes_of(vehicle)]
    begins = np.arange(fixes.time_s[0] + minute_s, fixes.time_s[-1] - minute_s + 1.0, minute_s).tolist()
    errors = [without(mission, vehicle, fixes, (begin, begin + minute_s))[1] for begin in begins]
    plain = plain_end_error(mission, vehicle, fixes, fixes.time_s[3])
    nis = replay(vehicle, mission).summary(mission.truth)["nis"]
    of = judged(*map(np.vstack, zip(*errors, strict=True)))
    return Row(mission.name, "1 min without", float(way_of(fixes)[-1]), plain_end_m=plain, **of, nis=nis)


def closure(mission: Mission, vehicle: Vehicle) -> Row:
    """Distance between the ends of a track that is said to be closed, from the first to the last valid velocity."""
    track = replay(vehicle, mission)
    stream, _, _ = velocity_of(mission, vehicle)
    last = stream.time_s[np.isfinite(stream.value).all(axis=1)][-1]
    row = int(np.searchsorted(track.time_s, last)) - 1
    north = EARTH_RADIUS_M * (track.latitude - track.latitude[0])
    east = EARTH_RADIUS_M * (track.longitude - track.longitude[0]) * np.cos(track.latitude[0])
    end, distance = float(np.hypot(north[row], east[row])), float(np.hypot(np.diff(north), np.diff(east)).sum())
    t, path = plain_path(mission, vehicle)
    plain = float(abs(path[-1] - path[int(np.searchsorted(t, track.time_s[0]))]))
    nis = track.summary(None)["nis"]
    return Row(mission.name, "closure", distance, end_m=end, end_pct=100.0 * end / distance, plain_end_m=plain, nis=nis)


def known_until(mission: Mission) -> float:
    """Time at which the car has gone 25 m [s]."""
    return float(plane(mission.truth)[0][np.searchsorted(way_of(mission.truth), 25.0)])


def rows_of(name: str) -> list[Row]:
    """All rows of one recording, named as its folder."""
    mission, vehicle = recorded(name)
    if name.startswith("wid-car-rtk"):
        return [hidden(mission, vehicle, known_until(mission), "first 25 m"), *now_and_then(name.split("/")[1])]
    if name.startswith("sonia"):
        return [closure(mission, vehicle)]
    if name.endswith("20220625_0_0"):
        return [minute_by_minute(mission, vehicle)]
    seconds = {"snapir-auv-1hz": 100.0, "auv-lake-sea-10hz": 30.0, "comma2k19": 20.0}[name.split("/")[0]]
    until = mission.streams[fixes_of(vehicle)].time_s[0] + seconds
    return [hidden(mission, vehicle, float(until), f"first {seconds:.0f} s")]


# --- commands -------------------------------------------------------------------------------------------------------

ENDS = (
    "end_m>7.2f end_pct>7.3f rms_m>7.2f smoothed_rms_m>7.2f smoothed_nees>5.2f plain_end_m>7.2f beyond_3_sigma_pct>6.1f"
)


def withheld(options: Options) -> list[dict[str, Any]]:
    """Every recording under the protocol of its kind, against plain dead reckoning on the same readings.

    - car with RTK: RTK for the first 25 m, then none; and 5 s of RTK in every 60 s, judged in between, as mapped and
      smoothed in two passes with a finer description (`car_clocks.finer`), and so with all constants known
    - AUV with truth: position for the first 100 s, then none
    - lake AUV: GPS withheld one minute at a time, judged against these fixes (others: position for the first 30 s)
    - pool AUV: no position at all: distance between the ends of a closed track
    - car, one minute: GNSS for the first 20 s, then none
    """
    data_root()
    names = sorted(str(path.parent.relative_to(MAPPINGS)) for path in MAPPINGS.glob("*/*/mission.toml"))
    # OUTOFWATER was handled in air: the DVL sees no bottom. The dives with their inertial unit have no positions that
    # could be withheld, and are those of snapir-auv-1hz: `dives.py` has them.
    elsewhere = ("OUTOFWATER", "snapir-auv-100hz")
    names = [name for name in names if options.only in name and not any(other in name for other in elsewhere)]
    if options.quick:
        names = list({name.split("/")[0]: name for name in reversed(names)}.values())[::-1]
    table, groups = Table(f"recording<30 protocol<20 distance_m>6.0f {ENDS} nis<4"), {}
    for name in names:
        for row in rows_of(name):
            nis = " ".join(f"{sensor} {value:.2f}" for sensor, value in row.nis.items() if value is not None)
            table.add(asdict(row) | {"nis": nis, "nis_by_sensor": row.nis})
            if row.end_pct is not None and row.protocol != "closure":
                groups.setdefault((row.recording.split(" ")[0], row.protocol), []).append(row.end_pct)
    for (kind, protocol), ends in groups.items():
        print(f"{kind}, {protocol}: median end error {np.median(ends):.3f} %")
    return table.rows


def car_clocks(options: Options) -> dict[str, Any]:
    """The car's wheel clocks, gyro offset and lever arm without RTK, and what that makes of its dead reckoning.

    Per trial: errors with RTK for the first 25 m, with the mapping as it is (published clocks, the rest a state; gyro
    offset from before the first motion), and with the numbers found by the car's own accelerometers and wheels (how:
    module `car_clocks`); and plain dead reckoning on the same mapping.
    """
    data_root()
    x, y = car.lever_arm()
    print(f"the point that does not slip is {x:.2f} m behind and {-y:.2f} m right of the box")
    for trial in car.TRIALS[: 1 if options.quick else None]:
        print(f"{trial}: the first wheel steers {car.steered(trial):.2f} m before the second")
    table, found = Table(f"mapping<26 recording<16 {ENDS}"), {}
    for trial in car.TRIALS[: 1 if options.quick else None]:
        clocks, sd = car.clocks(trial)
        offset, said = car.gyro_offset(trial), ", ".join(f"{clock:.3f}" for clock in clocks)
        found[trial] = {"clocks_s": clocks, "sd_s": sd, "gyro_z_deg_s": offset}
        print(f"{trial}: clocks {said} s (sd {sd:.3f}), gyro z {offset:+.4f} deg/s")
        for label, (mission, vehicle) in car.mappings(trial).items():
            table.add({"mapping": label} | asdict(hidden(mission, vehicle, known_until(mission), label)))
    for label in dict.fromkeys(row["mapping"] for row in table.rows):
        ends = [row["end_pct"] for row in table.rows if row["mapping"] == label]
        print(f"median {label}: {np.median(ends):.3f} %")
    return {"lever_arm_m": (x, y), "trials": found, "table": table.rows}


def clocks(options: Options) -> list[dict[str, Any]]:
    """Clocks as states: AUV, DVL on its own clock, described four ways, 100 s of positions; car, wheels, RTK for 25 m.

    Without and with a standard deviation of the described offset. Offsets are those in all, late positive; NEES of the
    horizontal position after the last fix.
    """
    data_root()
    table = Table("case<32 recording<16 found_s>7.3f sd_s>6.3f end_m>6.2f end_pct>6.3f plain_end_m>6.2f nees>7.2f")
    for kind, label, state, mission, vehicle in cases(options.quick):
        until = known_until(mission) if kind == "car" else float(mission.streams["usbl"].time_s[0] + 100.0)
        track, errors = without(mission, vehicle, mission.truth, (until + 1e-6, math.inf))
        row = hidden(mission, vehicle, until, label)
        nees = nees_of(*errors[:2])
        sensor = vehicle.sensors["odometer"] if kind == "car" else vehicle.drive.velocity_sensor
        found, sd = sensor.time_offset_s, 0.0
        if state in track.state_names:
            at = track.state_names.index(state)
            found, sd = found + float(track.states[-1, at]), float(track.states_sd[-1, at])
        table.add({"case": f"{kind}, {label}", "found_s": found, "sd_s": sd, "nees": nees} | asdict(row))
    for case in dict.fromkeys(row["case"] for row in table.rows):
        rows = [row for row in table.rows if row["case"] == case]
        ends, nees = ([row[key] for row in rows] for key in ("end_pct", "nees"))
        print(f"{case}: median end error {np.median(ends):.3f} %, median NEES {np.median(nees):.2f}")
    return table.rows


def dives(options: Options) -> dict[str, Any]:
    """The clock of the dives' DVL by the first 100 s of the nine, without a filter; `dive_clocks` says how.

    How well it foretells: by how much the ways of these 100 s are off, with a clock as published, as `navfilter
    calibrate` finds it in all nine, and as found here in the eight others; scale and mounting by the eight others.
    """
    data_root()
    late, others = dive_clocks.best(), {trial: dive_clocks.best(trial) for trial in SNAPIR}
    sd = dive_clocks.jackknife(np.array(list(others.values())))
    c, square = dive_clocks.factor(late)
    print(
        f"later than published by {late:.3f} s (sd {sd:.3f}; without one dive {min(others.values()):.3f} to "
        f"{max(others.values()):.3f}), factor {abs(c):.4f}, turned by {math.degrees(np.angle(c)):.2f} deg, "
        f"rms {math.sqrt(square):.3f} m"
    )
    table, found = Table("clock<20 rms_m>6.2f off_m<60"), {"late_s": late, "sd_s": sd, "without_s": others}
    for label, clocks in (
        ("published", dict.fromkeys(SNAPIR, 0.0)),
        ("calibrated", dict.fromkeys(SNAPIR, CALIBRATED_S)),
        ("by the eight others", others),
    ):
        off = [dive_clocks.missed(trial, clock) for trial, clock in clocks.items()]
        said = " ".join(f"{one:.2f}" for one in off)
        table.add({"clock": label, "rms_m": float(np.sqrt(np.mean(np.square(off)))), "off_m": said})
    return found | {"table": table.rows}


def wrong(options: Options) -> list[dict[str, Any]]:
    """Half a metre, 0.3 s, 3 deg and 2 % put into the description of each velocity sensor, one at a time and together.

    The vehicle is unsure of all of them (0.5 m, 0.3 s, 3 deg, 2 %). Positions for the first 100 s (car 25 m, comma2k19
    20 s), as in `withheld`. Error at the end against that of the vehicle as mapped; and of each constant how far it
    ends from what is found by all positions and the right description, where it is told at all: its sd is below 0.8 of
    what it was.
    """
    data_root()
    table = Table(
        "recording<28 wrong<15 end_m>6.2f ratio>5.2f sure_ratio>10.2f constant<15 off>8.4f sd>8.4f told<4 within_2sd<10"
    )
    for name in put.names(options.only, options.quick):
        mission, vehicle = recorded(name)
        begin = mission.streams[fixes_of(vehicle)].time_s[0]
        until = begin + (20.0 if name.startswith("comma") else 100.0)
        until = known_until(mission) if name.startswith("wid") else float(until)
        gap, doubtful = (until + 1e-6, math.inf), put.unsure(vehicle, ())
        known = {own: one.value for own, one in put.found(replay(doubtful, mission)).items()}
        ends = {}
        for label, which in (
            ("sure", None),
            ("nothing", ()),
            *((key, (key,)) for key in put.WRONG),
            ("all", put.WRONG),
        ):
            described = vehicle if which is None else put.unsure(vehicle, which)
            track, errors = without(mission, described, mission.truth, gap)
            ends[label] = float(np.hypot(*errors[0][-1]))
            row = {"recording": mission.name, "wrong": label, "end_m": ends[label]}
            row |= {"ratio": ends[label] / ends.get("nothing", ends[label]), "sure_ratio": ends[label] / ends["sure"]}
            of = {} if which is None else put.found(track)
            for own, one in of.items() if label in ("nothing", "all") else ((own, of[own]) for own in which or ()):
                shift = put.described_value(described, own) - put.described_value(doubtful, own)
                off = one.value + shift - known[own]
                told, near = one.sd < put.TOLD * one.given_sd, abs(off) < 2.0 * one.sd
                row |= {"constant": own, "off": off, "sd": one.sd, "told": str(told), "within_2sd": str(near)}
                table.add(row)
            if not of:
                table.add(row)
    for label in ("nothing", *put.WRONG, "all"):
        rows = [row for row in table.rows if row["wrong"] == label]
        told = [row for row in rows if row.get("told") == "True"]
        ratios = list({row["recording"]: row["ratio"] for row in rows}.values())
        sure = list({row["recording"]: row["sure_ratio"] for row in rows}.values())
        near = sum(row["within_2sd"] == "True" for row in told)
        print(
            f"{label}: end error {np.median(ratios):.2f} (at most {max(ratios):.2f}) of the right description, "
            f"{np.median(sure):.2f} of the mapping; {near} of {len(told)} told constants within 2 sd, "
            f"{len(rows) - len(told)} not told"
        )
    return table.rows


if __name__ == "__main__":
    only = flag("--only", default="", help="only recordings whose name contains this")
    main(
        __doc__,
        {
            withheld: [only, quick("one recording of each kind")],
            car_clocks: [quick("the first trial")],
            clocks: [quick("one recording of each kind")],
            dives: [],
            wrong: [only, quick("one recording of each kind")],
        },
    )
