"""The readers that `fuzz.py` feeds, valid examples for them, and what must hold of what they accept."""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.sparse
from harness import MAPPINGS

import navfilter as nf
from navfilter.check.description import describe_vehicle
from navfilter.check.plausibility import check_vehicle
from navfilter.io import VehicleError, read_mission, read_vehicle, write_vehicle
from navfilter.io.json_lines import BAD_KINDS, BadLine, LineParser, Reading
from navfilter.io.table import TableOptions
from navfilter.io.text_tables import read_table
from navfilter.io.toml_editing import write_calibrated
from navfilter.io.vehicle_template import vehicle_template
from navfilter.models.mission import MissionError
from navfilter.service.protocol import Lines


class Refused(Exception):
    """The input was answered with a clear error."""


class Broken(Exception):
    """An accepted input is not what it must be, or a refusal is not clear."""


@dataclass
class Target:
    """A reader, valid examples for it, and the share of all inputs it gets."""

    name: str
    examples: list[bytes]
    run: Callable[[bytes], None]
    share: float
    text: bool = True


def clear(error: BaseException, kinds: tuple[type[BaseException], ...]) -> bool:
    """Whether an error is of the reader's own kind, with words that are none of the machinery's."""
    text = str(error)
    ours = isinstance(error, OSError) or type(error) in kinds
    return ours and len(text) > 10 and "Traceback" not in text and "pydantic" not in text


def refusing(kinds: tuple[type[BaseException], ...], work: Callable[[], Any]) -> Any:
    """The result of `work`; its own kinds of error become `Refused`."""
    try:
        return work()
    except (ValueError, OSError) as error:
        if clear(error, kinds):
            raise Refused from None
        raise


def demand(holds: bool, what: str) -> None:
    """Raise unless what must hold holds."""
    if not holds:
        raise Broken(what)


#: Every key that constants are given by, a watch, and a learnt model.
CALIBRATED = b"""
name = "x"
[drive]
type = "imu"
rate_hz = 100
max_speed_m_s = 3.0
max_turn_deg_s = 40
gyro_scale_sd = 0.01
accel_misalignment_sd_deg = 0.5
calibrated = {"gyro.scale_x" = [0.01, 0.001]}
[sensors.dvl]
type = "body-velocity"
rate_hz = 4
error = {model = "white", sd = 0.01}
scale_sd = [0.01, 0.02, 0.0]
misalignment_sd_deg = 1.0
time_offset_s = 0.1
time_offset_sd_s = 0.2
lever_arm_b_m = [0.5, 0, 0.1]
lever_arm_sd_m = [0.3, 0.3, 0.1]
mounting_deg = [0, 0, 3.0]
calibrated = {scale_x = [0.02, 0.001], misalignment_z_deg = [1.0, 0.1]} # by hand
[sensors.compass]
type = "heading"
rate_hz = 8
deviation_sd_deg = [1, 2]
calibrated = {bias_deg = [0.5, 0.1]}
error = {model = "learned-arma", window = 400, prior = [{model = "white", sd_deg = 1}]}
"""


def recalibrated(vehicle: nf.Vehicle) -> nf.Vehicle:
    """The vehicle with other constants, as a calibration finds them."""
    sensors = {
        name: s if s.from_drive else replace(s, time_offset_s=s.time_offset_s + 0.125)
        for name, s in vehicle.sensors.items()
    }
    return nf.Vehicle(vehicle.drive, sensors, vehicle.name)


def vehicle_target(folder: Path) -> Target:
    """vehicle.toml; what is accepted is described, checked, and written and read back."""
    path, back = folder / "vehicle.toml", folder / "back.toml"
    examples = [vehicle_template(drive).encode() for drive in ("imu", "dead-reckoning")]
    # Without the words between the keys more of the mutations meet something that is read.
    examples += [re.sub(rb"(?m)^#(?! ).*\n|^# .*\n", b"", text) for text in examples for _ in range(2)]
    examples += [re.sub(rb"(?m)^#(?=[^ #\n])", b"", text) for text in examples[:2]]
    examples += [p.read_bytes() for p in sorted(MAPPINGS.glob("*/*/vehicle.toml"))[::3]]
    examples += [
        b"""
[drive] type = "imu" rate_hz = 100 gyro = {x = {model = "white", sd = 1}, y = [{model = "arma", ar = [-0.9], sd = 1}],
z = {model = "white", sd = 1}} [sensors.c] type = "heading" rate_hz = 8 error = {model = "learned-arma", orders = [[1,
0], [2, 1]], window = 400, hop = 10, prior = [{model = "white", sd_deg = 1}]} [sensors.d] type = "depth" error =
{model = "learned-arma", adopted = {ar = [-0.9], ma = [0.1], sd = 1, covariance = [[1, 0], [0, 1]], sd_log_s0 = 0.5,
flags = ["x"]}}
""",
        CALIBRATED,
        CALIBRATED,
    ]

    def run(data: bytes) -> None:
        path.write_bytes(data)
        vehicle = refusing((VehicleError,), lambda: read_vehicle(path))
        demand(read_vehicle(write_vehicle(vehicle, back)) == vehicle, "what is written does not come back")
        demand(refusing((ValueError,), lambda: describe_vehicle(vehicle)).startswith("Vehicle "), "no description")
        refusing((ValueError,), lambda: check_vehicle(vehicle))
        found = recalibrated(vehicle)
        copied = write_calibrated(found, vehicle, back, path, "found by a test")
        again = read_vehicle(back)  # constants are written with seven digits
        for name, sensor in found.sensors.items() if copied else ():
            off_s = abs(again.sensors[name].time_offset_s - sensor.time_offset_s)
            demand(
                off_s <= 1e-6 * max(1.0, abs(sensor.time_offset_s)), "constants written into a copy do not come back"
            )

    return Target("vehicle.toml", examples, run, 0.02)


def sound(mission: nf.Mission) -> None:
    """What every mission must be."""
    for name, stream in mission.streams.items():
        demand(bool(np.isfinite(stream.time_s).all()), f"{name}: a time is not finite")
        demand(bool((np.diff(stream.time_s) >= 0.0).all()), f"{name}: times go back")
        demand(
            stream.value.shape[0] == stream.time_s.size and stream.value.shape[1] == len(stream.columns),
            f"{name}: wrong shape",
        )
        demand(not np.isinf(stream.value).any(), f"{name}: infinite values")


TABLE = (
    b"t,a,b,c,d,h\n"
    + b"\n".join(b"%d.%d,%.3f,%.3f,1e-3,4,%.1f" % (k // 4, k % 4, k * 0.1, -k * 0.1, k * 10.0) for k in range(40))
    + b"\n"
)
MISSION = b"""name = "dive"
date = 2026-06-01 zero_s = "first" windows = [[0.0, 5.0]] [streams.imu] file = "log.csv" time = {column = "t", unit =
"s", offset_s = 1.0} rate = {columns = ["a", "b", {constant = 0.0}], unit = "deg/s", axes = "x,-y,-z", mounting_deg =
[0, 0, 90]} force = {columns = ["a", {mean = ["a", "b"]}, "c"], unit = "g", scale = 2.0, invalid = [-1.0],
invalid_above = 50.0, valid_range = [-9, 9]} [streams.compass] file = "log.csv" time = {rate_hz = 4.0, start_s = 1.0}
only_changes = true heading = {column = "h", unit = "deg", offset = "90 deg"} [streams.dvl] sources = [
  {file = "log.csv", time = {column = 0, rollover = 10.0}, velocity = {columns = [1, 2, 3], unit = ["m/s", "cm/s",
  "kn"]}}, {file = "log.npz", table = "x", time = {column = 0}, max_gap_s = 1.0, velocity = {columns = [1, 2, 3]}},
]
average = 2
every = 2
hide = [[1.0, 2.0]]
[streams.depth]
file = "log.csv"
delimiter = ","
skip_rows = 1
time = {column = "t", from_first = true, ends_only = true}
depth = {column = "a", unit = "ft", absolute = true}
[streams.gps]
file = "log.csv"
time = {column = "t"}
resample_hz = 2.0
local = {columns = ["a", "b", "c"], origin = {latitude_deg = 45.0, longitude_deg = 10.0}}
hdop = "d"
[truth]
file = "log.csv"
time = {column = "t"}
position = {columns = ["a", "b", "c"], unit = ["deg", "deg", "m"]}
attitude = {columns = ["a", "b", "h"], unit = "deg"}
lever_arm_b_m = [1.0, 0.0, 0.0]
[start]
from = "truth"
heading_sd_deg = 2.0
position_sd_m = [1.0, 1.0, 2.0]
"""


def write_companions(folder: Path) -> None:
    """The files that the examples name."""
    (folder / "log.csv").write_bytes(TABLE)
    np.savez(folder / "log.npz", x=np.arange(160.0).reshape(40, 4) * 0.1, y=np.arange(3))


def mission_target(folder: Path) -> Target:
    """mission.toml with files that are there."""
    write_companions(folder)
    path = folder / "mission.toml"
    sections = [b"\n[" + part for part in MISSION.split(b"\n[")[1:]]
    examples = [
        MISSION,
        *(b'name = "one"' + section + b"\n" for section in sections if section.startswith(b"\n[streams")),
    ]
    examples += [sections[-2] + sections[-1]]

    def run(data: bytes) -> None:
        path.write_bytes(data)
        sound(refusing((MissionError,), lambda: read_mission(path)))

    return Target("mission.toml", examples, run, 0.04)


def table_target(folder: Path) -> Target:
    """Text tables, alone and through a mission.toml; the first byte chooses how they are read."""
    (folder / "mission.toml").write_bytes(MISSION)
    write_companions(folder)
    options = [
        TableOptions(),
        TableOptions(delimiter=";", decimal=","),
        TableOptions(header=("p", "q")),
        TableOptions(skip_lines=2),
    ]
    semicolon = TABLE.replace(b".", b",").replace(b",1e", b";1e")
    spaced = b"# made by a logger\n" + TABLE.replace(b",", b"  ")
    times = b"t,a,b,c,d,h\n" + b"\n".join(b"2026-06-01T00:00:%02dZ,%d,2,3,4,5" % (k, k) for k in range(30))

    def run(data: bytes) -> None:
        chosen = data[0] % 6 if data else 0
        path = folder / "log.csv"
        path.write_bytes(data[1:])
        if chosen < len(options):
            table = refusing((MissionError,), lambda: read_table(path, options[chosen]))
            for name in table.columns:
                values, unreadable = table.numbers(name)
                demand(values.ndim == 1 and 0 <= unreadable <= values.size, "numbers of a column")
        else:
            sound(refusing((MissionError,), lambda: read_mission(folder)))

    examples = [bytes([k]) + text for k in range(6) for text in (TABLE, semicolon, spaced, times)]
    return Target("text tables", examples, run, 0.03)


def container_target(folder: Path) -> Target:
    """.npz, .npy, .mat by the first byte."""
    suffixes = (".npz", ".npy", ".mat")
    values = np.arange(60.0).reshape(20, 3)
    columns = {
        "x": values,
        "s": {"t": values[:, 0], "c": "text", "n": {"k": 1.0}},
        "z": values + 1j,
        "i": values.astype(np.int16),
        "e": [],
    }
    cells = {
        "cell": np.array([values, "abc", 1.0], dtype=object),
        "sparse": scipy.sparse.csc_array(values),
        "x": values,
    }
    buffers = [io.BytesIO() for _ in range(7)]
    np.savez(buffers[0], x=values, t=values[:, 0])
    np.savez_compressed(buffers[1], x=values)
    np.save(buffers[2], values)
    scipy.io.savemat(buffers[3], columns)
    scipy.io.savemat(buffers[4], columns, do_compression=True)
    scipy.io.savemat(buffers[5], cells)
    scipy.io.savemat(buffers[6], {"x": values, "t": values[:, 0]}, format="4")
    kinds = (0, 0, 1, 2, 2, 2, 2)

    def run(data: bytes) -> None:
        path = folder / f"data{suffixes[data[0] % 3 if data else 0]}"
        path.write_bytes(data[1:])
        table = refusing((MissionError,), lambda: read_table(path))
        for name in table.columns:
            table.numbers(name)

    examples = [bytes([kind]) + buffer.getvalue() for kind, buffer in zip(kinds, buffers, strict=True)]
    return Target("containers", examples, run, 0.03, text=False)


def native_target(folder: Path) -> Target:
    """Missions saved by navfilter: damaged bytes."""
    mission = nf.Mission("dive", {"depth": nf.Stream(np.arange(20.0), np.arange(20.0), ("depth_m",))})
    path = folder / "native.npz"
    example = mission.save(path).read_bytes()

    def run(data: bytes) -> None:
        path.write_bytes(data)
        sound(refusing((MissionError,), lambda: read_mission(path)))

    return Target("saved missions", [example], run, 0.03, text=False)


LINES = [
    b'{"sensor": "imu", "time_s": 12.34, "rate_b": [0.0, 0.0, 0.01], "force_b": [0.1, 0.0, -9.8]}',
    b'{"sensor": "compass", "time_s": 12.34, "value": 1.57}',
    b'{"sensor": "gps", "time_s": 12.0, "value": [0.785, -0.07, null], "sd": [2.0, 2.0, 5.0]}',
    b'{"sensor": "dvl", "time_s": 1, "value": [1.0, 0.0, -0.1]}',
    b'{"sensor": "start", "latitude_deg": 45.0, "longitude_deg": -4.0, "heading_deg": 90.0, "date": "2026-06-01"}',
    b'{"sensor": "start", "latitude_deg": 45.0, "longitude_deg": -4.0, "position_sd_m": [1, 2, 3], "time_s": 3.5}',
]
NOTES = [
    b'{"event": "start", "start": {"latitude_deg": 45.0, "longitude_deg": -4.0, "time_s": 1.0}}',
    b'{"event":"bad","kind":"not-json","text":"x"}',
    b'{"event":"lost","count":3}',
]


def lines_target(folder: Path) -> Target:
    """Readings as JSON lines, with a vehicle, without one, and as a log; never an exception."""
    vehicle = nf.Vehicle(
        imu=nf.Imu(rate_hz=100), sensors={"compass": nf.Heading(), "gps": nf.Position(), "dvl": nf.BodyVelocity()}
    )
    parsers = [lambda: LineParser(vehicle), lambda: LineParser(), lambda: LineParser(notes=True)]

    def run(data: bytes) -> None:
        parser = parsers[data[0] % 3 if data else 0]()
        # In pieces, as they come through a pipe.
        cutter = Lines()
        found = [
            *cutter.feed(data[1 : len(data) // 2]),
            *cutter.feed(data[len(data) // 2 :] if len(data) > 1 else b""),
            *cutter.end(),
        ]
        good = False
        for line, cut in found:
            item = parser.too_long(line) if cut else parser.parse(line)
            if isinstance(item, BadLine):
                demand(item.kind in BAD_KINDS and item.raw.endswith(b"\n"), "a bad line of no kind")
                json.loads(item.raw)
            elif isinstance(item, Reading):
                good = True
                demand(np.isfinite(item.time_s) and not np.isinf(item.value).any(), "a reading that is not finite")
            else:
                good = good or item is not None
        if not good:
            raise Refused

    examples = [bytes([k]) + line for k in range(3) for line in LINES + NOTES]
    examples += [b"\x00" + b"\n".join(LINES), b"\x02" + b"\n".join(LINES + NOTES)]
    return Target("JSON lines", examples, run, 0.78)


def log_target(folder: Path) -> Target:
    """The log folder of `navfilter run`."""
    columns = b'imu = ["a", "b", "c", "d", "e", "f"]\ncompass = ["heading_rad"]\ngps = ["x", "y", "z"]\n'
    (folder / "mission.toml").write_bytes(b'name = "log"\n[log]\nfile = "log.jsonl"\n[log.columns]\n' + columns)

    def run(data: bytes) -> None:
        (folder / "log.jsonl").write_bytes(data)
        sound(refusing((MissionError,), lambda: read_mission(folder)))

    return Target("log of a run", [b"\n".join(NOTES[:1] + LINES * 3 + NOTES) + b"\n", b"\n".join(LINES)], run, 0.03)


def seal(whole: bytes, payload: bytes) -> bytes:
    """A snapshot with another payload, under a right checksum."""
    magic, header, _ = whole.split(b"\n", 2)
    meta = {**json.loads(header), "sha256": hashlib.sha256(payload).hexdigest(), "size": len(payload)}
    return magic + b"\n" + json.dumps(meta).encode() + b"\n" + payload


def snapshot_target(folder: Path, *, sealed: bool) -> Target:
    """Snapshots: the bytes damaged, or their content damaged and sealed again under a right checksum."""
    vehicle = nf.Vehicle(
        imu=nf.Imu(rate_hz=10),
        sensors={
            "compass": nf.Heading(rate_hz=1, error=nf.LearnedArma(prior=nf.GaussMarkov(sd=0.01, tau_s=30), window=200)),
            "dvl": nf.BodyVelocity(rate_hz=1),
        },
    )
    nav = nf.Navigator(vehicle, nf.Start(latitude_deg=45.0, longitude_deg=10.0))
    for k in range(1, 41):
        nav.step(0.1 * k, np.zeros(3), np.array([0.0, 0.0, -9.8]))
        if k % 10 == 0:
            nav.correct("compass", 0.1 * k, 0.01)
            nav.correct("dvl", 0.1 * k, np.array([0.0, 0.0, 0.01]))
    whole = nav.snapshot()
    payload = whole.split(b"\n", 2)[2]

    def restore(data: bytes) -> None:
        back = refusing((ValueError,), lambda: nf.Navigator.restore(vehicle, data))
        for k in range(1, 4):
            back.step(back.time_s + 0.1 * k, np.zeros(3), np.array([0.0, 0.0, -9.8]))
        if not sealed:
            P = back.state.covariance
            demand(
                bool(np.isfinite(P).all()) and float(np.linalg.eigvalsh(P).min()) > -1e-9,
                "no covariance after restoring",
            )

    if sealed:
        return Target("snapshots, resealed", [payload], lambda data: restore(seal(whole, data)), 0.01, text=False)
    return Target("snapshots", [whole], restore, 0.02, text=False)
