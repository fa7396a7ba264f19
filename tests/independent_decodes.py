"""Logs decoded a second time, by nothing but `struct`, `csv`, `sqlite3` and splitting lines.

Navfilter's readers and ``mission --init`` are held against them.

A decode is a mapping of quantities to times and values: ``position`` (latitude, longitude [deg]), ``heading`` [deg] as
the file has it, ``depth`` [m] or ``pressure`` [Pa], ``velocity`` [m/s] forward, right, down (or along the beams), each
with times in seconds since 1970, or of the log's own clock where it has no UTC.
"""

from __future__ import annotations

import csv
import datetime
import lzma
import math
import re
import sqlite3
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

Decode = dict[str, tuple[np.ndarray, np.ndarray]]
_UNIX = datetime.datetime(1970, 1, 1)
KN = 1852.0 / 3600.0


def _gathered(rows: dict[str, list[tuple[Any, ...]]]) -> Decode:
    """Rows (time, value, value, ...) as arrays."""
    found = {name: np.array(own, dtype=float) for name, own in rows.items() if own}
    return {name: (own[:, 0], own[:, 1:]) for name, own in found.items()}


def _lines(path: Path) -> Iterator[str]:
    with (lzma.open if path.suffix == ".xz" else open)(path, "rb") as file:
        for raw in file.read().splitlines():
            yield raw.decode("latin-1")


def _ddmm(text: str, letter: str) -> float:
    at = text.index(".") - 2
    return (float(text[:at]) + float(text[at:]) / 60.0) * (-1.0 if letter in "SW" else 1.0)


def nmea(heading: str, fixes: str, field: Callable[[list[str]], float | None]) -> Callable[[Path], Decode]:
    """Sentences of a yacht: fixes with the UTC of their own, headings and speeds in the order of the file."""

    def decode(path: Path) -> Decode:
        rows: dict[str, list[tuple[Any, ...]]] = {"position": [], "heading": [], "velocity": []}
        time_s, date = math.nan, None
        for line in _lines(path):
            found = re.search(r"[$!]([^*$!]*)\*([0-9A-F]{2})", line)
            if found is None or len(found[1]) < 5:
                continue
            total = 0
            for letter in found[1].encode("latin-1"):
                total ^= letter
            if total != int(found[2], 16):
                continue
            cells = found[1].split(",")
            kind = cells[0][2:]
            if kind == "RMC" and len(cells) > 9 and len(cells[9]) == 6 and cells[2] == "A":
                date = datetime.datetime.strptime(cells[9], "%d%m%y")
            if kind in ("RMC", "GGA") and date is not None and len(cells[1]) >= 6:
                clock = 3600 * int(cells[1][:2]) + 60 * int(cells[1][2:4]) + float(cells[1][4:])
                time_s = (date - _UNIX).total_seconds() + clock
            if kind == fixes and fixes == "RMC" and cells[2] == "A":
                rows["position"].append((time_s, _ddmm(cells[3], cells[4]), _ddmm(cells[5], cells[6])))
            elif kind == "GGA" and cells[0].endswith(fixes) and cells[6] not in ("", "0"):
                rows["position"].append((time_s, _ddmm(cells[2], cells[3]), _ddmm(cells[4], cells[5])))
            elif kind == heading and not math.isnan(time_s):
                value = field(cells)
                rows["heading"] += [] if value is None else [(time_s, value)]
            elif kind == "VHW" and not math.isnan(time_s) and cells[5]:
                rows["velocity"].append((time_s, KN * float(cells[5]), 0.0, 0.0))
        return _gathered(rows)

    return decode


def _hdg(cells: list[str]) -> float | None:
    """With deviation and variation where the sentence has them."""
    if not cells[1]:
        return None
    signed = [float(cells[k]) * (-1.0 if cells[k + 1] == "W" else 1.0) if cells[k] else 0.0 for k in (2, 4)]
    return (float(cells[1]) + sum(signed)) % 360.0


def expedition(path: Path) -> Decode:
    """Number, value, number, value; the second line says which number is which column."""
    rows: dict[str, list[tuple[Any, ...]]] = {"position": [], "heading": [], "velocity": []}
    text = list(csv.reader(_lines(path)))
    names, numbers = text[0], text[1]
    at = dict(zip(names[1:], numbers[1:], strict=True))
    for cells in text[2:]:
        if not cells or cells[0].startswith("!"):
            continue
        found = dict(zip(cells[::2], cells[1::2], strict=False))
        time_s = 86400.0 * (float(found["0"]) - 25569.0)
        if at["HDG"] in found:
            rows["heading"].append((time_s, float(found[at["HDG"]])))
        if at["BSP"] in found:
            rows["velocity"].append((time_s, KN * float(found[at["BSP"]]), 0.0, 0.0))
        if at["Lat"] in found:
            rows["position"].append((time_s, float(found[at["Lat"]]), float(found[at["Lon"]])))
    return _gathered(rows)


def astra(path: Path) -> Decode:
    """A rule, names, and rows parted by tabs."""
    rows: dict[str, list[tuple[Any, ...]]] = {"position": [], "heading": [], "velocity": []}
    text = list(_lines(path))
    names = text[1].split("\t")
    for line in text[2:]:
        cells = dict(zip(names, line.split("\t"), strict=False))
        if len(cells) < 12:
            continue
        moment = datetime.datetime.strptime(f"{cells['Date']} {cells['Time']}", "%d/%m/%y %H:%M:%S")
        time_s = (moment - _UNIX).total_seconds()
        place = [_ddmm(cells[key][:-1], cells[key][-1]) for key in ("Latitudine", "Longitudine")]
        rows["position"].append((time_s, *place))
        rows["heading"].append((time_s, float(cells["Heading"])))
        rows["velocity"].append((time_s, KN * float(cells["Boatspeed"]), 0.0, 0.0))
    return _gathered(rows)


def slocum(path: Path) -> Decode:
    """The sixth label line and on; the first fix of the file is an old one until there is another."""
    text = list(_lines(path))
    names, rows = text[14].split(), [line.split() for line in text[17:]]
    at = {name: k for k, name in enumerate(names)}
    found: dict[str, list[tuple[Any, ...]]] = {"position": [], "heading": [], "depth": []}
    old: list[str] | None = None
    for cells in rows:
        time_s = float(cells[at["m_present_time"]])
        place = [cells[at[name]] for name in ("m_gps_lat", "m_gps_lon")]
        if place[0] != "NaN":
            old = old or place
            if place != old or old == ["new"]:
                old = ["new"]
                values = [math.copysign(int(abs(v) / 100) + abs(v) % 100 / 60, v) for v in map(float, place)]
                found["position"].append((time_s, *values))
        if cells[at["m_heading"]] != "NaN":
            found["heading"].append((time_s, math.degrees(float(cells[at["m_heading"]]))))
        if cells[at["m_depth"]] != "NaN":
            found["depth"].append((time_s, float(cells[at["m_depth"]])))
    return _gathered(found)


def pd0(path: Path) -> Decode:
    """Ensembles with their checksums; GGA of the blocks 0x2022, positions of the blocks 0x2000; the clock of the
    instrument put right by either.
    """
    data, at = path.read_bytes(), 0
    rows: dict[str, list[tuple[Any, ...]]] = {
        "heading": [],
        "velocity": [],
        "position": [],
        "pressure": [],
        "speed": [],
    }
    ahead, fixes = [], []
    while (at := data.find(b"\x7f\x7f", at)) >= 0 and at + 4 <= len(data):
        size = int.from_bytes(data[at + 2 : at + 4], "little")
        one = data[at : at + size]
        if (
            size < 7
            or at + size + 2 > len(data)
            or sum(one) & 0xFFFF != int.from_bytes(data[at + size : at + size + 2], "little")
        ):
            at += 1
            continue
        at += size + 2
        offsets = struct.unpack_from(f"<{one[5]}H", one, 6)
        ends = dict(zip(sorted(offsets), [*sorted(offsets)[1:], size], strict=True))
        blocks = [(struct.unpack_from("<H", one, k)[0], one[k : ends[k]]) for k in offsets]
        by = dict(blocks)
        leader, fixed = by[0x80], by[0]
        year, month, day, hour, minute, second, hundredth = leader[4:11]
        year += 2000
        if len(leader) >= 65 and leader[57] == 20:
            year, month, day, hour, minute, second, hundredth = 2000 + leader[58], *leader[59:65]
        clock = (datetime.datetime(year, month, day, hour, minute, second) - _UNIX).total_seconds() + 0.01 * hundredth
        rows["heading"].append((clock, 0.01 * struct.unpack_from("<H", leader, 18)[0]))
        if len(leader) >= 52 and (fixed[31] & 0x20):
            rows["pressure"].append((clock, 101325.0 + 10.0 * struct.unpack_from("<i", leader, 48)[0]))
        if 0x600 in by and -32768 not in (raw := struct.unpack_from("<4h", by[0x600], 24))[:3]:
            v = [1e-3 * one for one in raw]
            frame = (fixed[25] >> 3) & 3
            if frame == 3:  # what no rotation changes
                rows["speed"].append((clock, math.sqrt(sum(one * one for one in v[:3]))))
            else:
                rows["velocity"].append((clock, *(v if frame == 0 else (-v[1], -v[0], v[2]))))
        for kind, block in blocks:
            if kind == 0x2022 and struct.unpack_from("<H", block, 2)[0] == 104 and block[14 + 35 : 14 + 36]:
                before = struct.unpack_from("<d", block, 6)[0]
                text = block[14:]
                lat, ns, lon, ew, quality = struct.unpack_from("<dcdcB", text, 17)
                if quality:
                    of_day = 3600 * int(text[7:9]) + 60 * int(text[9:11]) + float(text[11:16])
                    ahead.append((clock - before - of_day + 43200) % 86400 - 43200)
                    fixes.append((of_day, clock, lat * (1 - 2 * (ns == b"S")), lon * (1 - 2 * (ew == b"W"))))
            if kind == 0x2000:
                d, m, y, _, _, _, _, last, lat, lon = struct.unpack_from("<BBHIiiiIii", block, 2)
                if 1 <= m <= 12 and 1 <= d <= 31 and 1990 < y < 2100:
                    utc = (datetime.datetime(y, m, d) - _UNIX).total_seconds() + 1e-4 * last
                    ahead.append(clock - utc)
                    rows["position"].append((clock, lat * 180.0 / 2**31, lon * 180.0 / 2**31))
    late = float(np.median(ahead)) if ahead else 0.0
    for of_day, clock, lat, lon in fixes:
        utc = clock - late
        rows["position"].append((of_day + 86400.0 * round((utc - of_day) / 86400.0) + late, lat, lon))
    return {name: (times - late, values) for name, (times, values) in _gathered(rows).items()}


def nortek(path: Path) -> Decode:
    """Headers of ten bytes; heading and pressure of every record."""
    data, at = path.read_bytes(), 0
    rows: dict[str, list[tuple[Any, ...]]] = {"heading": [], "pressure": []}
    while at + 10 <= len(data) and data[at] == 0xA5:
        kind, size = data[at + 2], struct.unpack_from("<H", data, at + 4)[0]
        body = data[at + 10 : at + 10 + size]
        at += 10 + size
        if kind in (0x15, 0x16, 0x17) and len(body) == size:
            year, month, day, hour, minute, second = body[8:14]
            moment = datetime.datetime(1900 + year, month + 1, day, hour, minute, second)
            time_s = (moment - _UNIX).total_seconds() + 1e-4 * struct.unpack_from("<H", body, 14)[0]
            pressure, heading = struct.unpack_from("<IH", body, 20)
            rows["heading"].append((time_s, 0.01 * heading))
            rows["pressure"].append((time_s, 101325.0 + 10.0 * pressure))
    return _gathered(rows)


def dataflash(path: Path) -> Decode:
    """Messages of the formats that the log describes itself."""
    data, at = path.read_bytes(), 0
    lengths, formats = {0x80: 89}, {}
    size = {
        "b": "b",
        "B": "B",
        "M": "B",
        "h": "h",
        "H": "H",
        "i": "i",
        "I": "I",
        "q": "q",
        "Q": "Q",
        "f": "f",
        "d": "d",
    }
    size |= {"c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "n": "4s", "N": "16s", "Z": "64s", "a": "64s", "g": "e"}
    rows: dict[str, list[tuple[Any, ...]]] = {"heading": [], "pressure": [], "position": []}
    while at + 3 <= len(data):
        kind = data[at + 2]
        if data[at : at + 2] != b"\xa3\x95" or kind not in lengths:
            at += 1
            continue
        body = data[at + 3 : at + lengths[kind]]
        at += lengths[kind]
        if kind == 0x80 and len(body) == 86:
            own, length, name, form, columns = struct.unpack("<BB4s16s64s", body)
            lengths[own] = length
            texts = [text.split(b"\0")[0].decode() for text in (name, form, columns)]
            formats[own] = (texts[0], "<" + "".join(size[c] for c in texts[1]), texts[1], texts[2].split(","))
            continue
        name, form, letters, columns = formats.get(kind, ("", "", "", []))
        if name not in ("ATT", "BARO") or len(body) != struct.calcsize(form):
            continue
        values = dict(zip(columns, struct.unpack(form, body), strict=True))
        scaled = {
            c: values[c] * 0.01 if letter in "cCeE" else values[c] for c, letter in zip(columns, letters, strict=True)
        }
        time_s = 1e-6 * scaled["TimeUS"]
        if name == "ATT":
            rows["heading"].append((time_s, scaled["Yaw"]))
        elif scaled.get("I", scaled.get("Id", 0)) == 1:
            rows["pressure"].append((time_s, scaled["Press"]))
    return _gathered(rows)


def mavlink(path: Path) -> Decode:
    """Frames of MAVLink 1 and 2 behind eight bytes of microseconds since 1970."""
    data, at = path.read_bytes(), 0
    rows: dict[str, list[tuple[Any, ...]]] = {"heading": [], "pressure": [], "position": []}
    while at + 20 <= len(data):
        stamp, magic, size = struct.unpack_from(">Q", data, at)[0], data[at + 8], data[at + 9]
        if magic not in (0xFD, 0xFE) or not 1.5e15 < stamp < 2e15:
            at += 1
            continue
        head = 10 if magic == 0xFD else 6
        signed = 13 if magic == 0xFD and data[at + 10] & 1 else 0
        frame = data[at + 8 : at + 8 + head + size + 2 + signed]
        sender = frame[5:7] if magic == 0xFD else frame[3:5]
        kind = int.from_bytes(frame[7:10], "little") if magic == 0xFD else frame[5]
        body = frame[head : head + size].ljust(80, b"\0")
        at += 8 + len(frame)
        if kind == 30 and sender == b"\1\1":
            rows["heading"].append((1e-6 * stamp, math.degrees(struct.unpack_from("<f", body, 12)[0])))
        elif kind == 137 and sender == b"\1\1":
            rows["pressure"].append((1e-6 * stamp, 100.0 * struct.unpack_from("<f", body, 4)[0]))
        elif kind == 232 and body[61] >= 3:
            rows["position"].append((1e-6 * stamp, *(1e-7 * one for one in struct.unpack_from("<ii", body, 12))))
    return _gathered(rows)


def ulog(path: Path) -> Decode:
    """Formats, subscriptions and data of a PX4 log: the fixes."""
    data, at = path.read_bytes(), 16
    formats: dict[str, str] = {}
    topics: dict[int, str] = {}
    sizes = {"int8_t": "b", "uint8_t": "B", "int16_t": "h", "uint16_t": "H", "int32_t": "i", "uint32_t": "I"}
    sizes |= {"int64_t": "q", "uint64_t": "Q", "float": "f", "double": "d", "bool": "?", "char": "c"}
    rows: dict[str, list[tuple[Any, ...]]] = {"position": [], "force": []}
    while at + 3 <= len(data):
        size, kind = struct.unpack_from("<Hc", data, at)
        body = data[at + 3 : at + 3 + size]
        at += 3 + size
        if kind == b"F":
            name, _, fields = body.decode().partition(":")
            formats[name] = fields
        elif kind == b"A":
            topics[struct.unpack_from("<H", body, 1)[0]] = body[3:].decode() if body[0] == 0 else ""
        elif kind == b"D":
            name = topics.get(struct.unpack_from("<H", body)[0], "")
            if name not in ("vehicle_gps_position", "sensor_combined"):
                continue
            values, place = {}, 2
            for field in formats[name].rstrip(";").split(";"):
                form, label = field.split(" ")
                base, _, count = form.partition("[")
                code = f"<{count.rstrip(']') or 1}{sizes[base]}"
                values[label] = (
                    struct.unpack_from(code, body, place) if place + struct.calcsize(code) <= len(body) else None
                )
                place += struct.calcsize(code)
            time_s = 1e-6 * values["timestamp"][0]
            if name == "vehicle_gps_position" and values["fix_type"][0] >= 3:
                rows["position"].append((time_s, 1e-7 * values["lat"][0], 1e-7 * values["lon"][0]))
                rows.setdefault("utc", []).append((time_s, 1e-6 * values["time_utc_usec"][0]))
            elif name == "sensor_combined":
                rows["force"].append((time_s, *values["accelerometer_m_s2"]))
    clock_s, utc_s = np.array(rows.pop("utc")).T
    begin_s = float(np.median(utc_s - clock_s))
    return {name: (times + begin_s, values) for name, (times, values) in _gathered(rows).items()}


def ros_db3(path: Path) -> Decode:
    """Serialised messages of a ROS 2 bag in SQLite: odometry and forces, turned from forward-left-up."""
    rows: dict[str, list[tuple[Any, ...]]] = {"force": [], "velocity": []}
    with sqlite3.connect(next(path.glob("*.db3")) if path.is_dir() else path) as base:
        kinds = dict(base.execute("select id, type from topics"))
        for topic, raw in base.execute("select topic_id, data from messages order by timestamp"):
            sec, nanosec, size = struct.unpack_from("<iII", raw, 4)
            at = 16 + size
            if kinds[topic] == "nav_msgs/msg/Odometry":
                (size,) = struct.unpack_from("<I", raw, at + -at % 4)
                at += -at % 4 + 4 + size
            at += -(at - 4) % 8
            if kinds[topic] == "sensor_msgs/msg/Imu":
                force = struct.unpack_from("<3d", raw, at + 8 * (4 + 9 + 3 + 9))
                rows["force"].append((sec + 1e-9 * nanosec, force[0], -force[1], -force[2]))
            elif kinds[topic] == "nav_msgs/msg/Odometry":
                v = struct.unpack_from("<3d", raw, at + 8 * (7 + 36))
                rows["velocity"].append((sec + 1e-9 * nanosec, v[0], -v[1], -v[2]))
    return _gathered(rows)


#: Logs whose UTC is written to the millisecond, and those whose sentences have no times of their own: arguments of
#: `compared`.
HOW: dict[str, dict[str, float]] = {
    "logs/px4/sample_log_small.ulg": {"within_s": 1e-3},
    "yacht-irene-1hz/flensburg_20130803_NMEA0004.TXT.xz": {"cycle_s": 2.0},
    "yacht-irene-1hz/geneva_20140629_NMEA0001.TXT.xz": {"cycle_s": 2.0},
    "yacht-psaros33-1hz/20140805_NMEA0020.TXT.xz": {"cycle_s": 2.0},
    "yacht-psaros33-1hz/20140820_NMEA0007.TXT.xz": {"cycle_s": 2.0},
}
_UGPS = nmea("HDT", "GGA", lambda cells: None)
#: Log -> its decode; paths below the folder of the data.
DECODES: dict[str, Callable[[Path], Decode]] = {
    "logs/ros1/robot_localization_test2.bag": lambda path: ros_db3(path.parents[1] / "ros2/derived_from_test2_db3"),
    "logs/ros2/derived_from_test2_db3": ros_db3,
    "logs/ros2/derived_from_test2_mcap": lambda path: ros_db3(path.with_name("derived_from_test2_db3")),
    "logs/ardupilot/ardusub_small.BIN": dataflash,
    "logs/ardupilot/ardusub_small.tlog": mavlink,
    "logs/px4/sample_log_small.ulg": ulog,
    "logs/nmea/ugps_nmea_log.txt": _UGPS,
    "logs/nmea/pynmeagps_pygpsdata-nmea4.log": nmea("HDT", "GNGGA", lambda cells: float(cells[1])),
    "logs/pd0/RDI_withBT.000": pd0,
    "logs/pd0/vmdas01_wh.ENX": pd0,
    "cases/beam.pd0": pd0,
    "cases/local_clock.pd0": pd0,
    "logs/nortek/VelEchoBT01.ad2cp": nortek,
    "glider-slocum-ru28/ru28_2017_113_3_0_dbd.dat.xz": slocum,
    "yacht-irene-1hz/flensburg_20130803_NMEA0004.TXT.xz": nmea("HDG", "RMC", _hdg),
    "yacht-irene-1hz/geneva_20140629_NMEA0001.TXT.xz": nmea("HDG", "RMC", _hdg),
    "yacht-psaros33-1hz/20140805_NMEA0020.TXT.xz": nmea("HDG", "RMC", _hdg),
    "yacht-psaros33-1hz/20140820_NMEA0007.TXT.xz": nmea("HDG", "RMC", _hdg),
    "yacht-csv-1hz/auckland_log-2022Oct27.csv.xz": expedition,
    "yacht-csv-1hz/trieste_log1Hz20170708_1239.log.xz": astra,
}


# --- comparison -----------------------------------------------------------------------------------------------------


#: Readings that have the time of the one before are dropped of what drives, and sentences without a time of their own
#: are spread otherwise over a gap: of either no more than this share [1].
FEW = 0.02


class Compared(NamedTuple):
    """A quantity of a mission against its decode.

    Attributes
    ----------
    readings, decoded : int
        How many there are.
    missing : int
        Readings of the decode without one of the mission at their time.
    apart : float
        Largest difference of all but `FEW` of the readings of either side from the nearest in value that the other has
        at that time, in the unit of the decode (positions [m]).
    """

    readings: int
    decoded: int
    missing: int
    apart: float


def compared(mission: Any, decode: Decode, within_s: float = 1e-4, cycle_s: float = 0.0) -> dict[str, Compared]:
    """What a mission gives of each quantity of a decode; nothing of what it does not have.

    Parameters
    ----------
    mission : Mission
    decode : dict
    within_s : float
        Times agree within this [s].
    cycle_s : float
        So much later than in the decode readings may be, positions apart: sentences have no times of their own [s].
    """
    found = {}
    for quantity, (times, values) in decode.items():
        stream = _stream_of(mission, quantity)
        if stream is None:
            continue
        own_s, own = stream
        known = np.isfinite(own).all(axis=1)
        own_s, own = own_s[known], own[known]
        # nothing but the order tells where UTC is unknown: both begin with the same reading
        own_s = own_s + (times.min() - own_s[0] if mission.epoch_utc_s is None else mission.epoch_utc_s)
        late_s = 0.0 if quantity == "position" else cycle_s
        first, last = (np.searchsorted(own_s, times + side) for side in (-within_s, late_s + within_s))
        back = (np.searchsorted(times, own_s + side) for side in (-late_s - within_s, within_s))
        missing = int(np.count_nonzero(first == last))
        sides = [(values, own, first, last), (own, values, *back)]
        # of several readings of one time it is one of them
        there, here = (
            [
                _apart(quantity, others[a:b], one[None]).min()
                for one, a, b in zip(ours, begin, end, strict=True)
                if a < b
            ]
            for ours, others, begin, end in sides
        )
        apart = max(float(np.quantile(side, 1.0 - FEW, method="lower")) for side in (there, here))
        found[quantity] = Compared(len(own), len(times), missing, apart)
    return found


def _stream_of(mission: Any, quantity: str) -> tuple[np.ndarray, np.ndarray] | None:
    columns = {
        "position": [("latitude_rad", "longitude_rad")],
        "heading": [("yaw_rad",), ("heading_rad",)],
        "depth": [("depth_m",)],
        "pressure": [("pressure_Pa",)],
        "velocity": [("v_x_m_s", "v_y_m_s", "v_z_m_s"), tuple(f"beam_{k}_m_s" for k in range(1, 5))],
        "speed": [("v_x_m_s", "v_y_m_s", "v_z_m_s")],
        "force": [("force_x_m_s2", "force_y_m_s2", "force_z_m_s2")],
    }
    for names in columns.get(quantity, []):
        for stream in mission.streams.values():
            if all(name in stream.columns for name in names):
                own = np.column_stack([stream.column(name) for name in names])
                if quantity == "speed":
                    own = np.linalg.norm(own, axis=1)[:, None]
                if own.any():  # zeros stand in for what was not measured
                    return stream.time_s, np.degrees(own) if names[0].endswith("_rad") else own
    return None


def _apart(quantity: str, own: np.ndarray, other: np.ndarray) -> np.ndarray:
    if quantity == "heading":
        return np.abs((own - other + 180.0) % 360.0 - 180.0)[:, 0]
    if quantity == "position":
        return np.linalg.norm((own - other) * [111.2e3, 111.2e3 * math.cos(math.radians(float(other[0, 0])))], axis=1)
    return np.linalg.norm(own - other, axis=1)
