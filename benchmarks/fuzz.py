"""Broken, odd and hostile input for every reader: whatever arrives, the answer is a result or one clear error.

Targets: vehicle.toml, mission.toml, text tables, containers (.npz, .npy, .mat), missions saved by navfilter, readings as JSON lines, the
log of `navfilter run`, snapshots of a navigator (as damaged bytes, and with the damage sealed again under a right checksum). Inputs are
made from valid examples by cutting, doubling, splicing and flipping bytes, and by exchanging tokens: numbers for extreme ones, keys and
words for others of the same format, lines for other lines. What is accepted is used: a vehicle is described, checked, written and read
back, a mission's streams must be sorted and finite, a restored navigator goes on with a covariance that is one.

Counted as unhandled: every exception that is not the reader's own kind of error, a message without words or with a traceback in it, an
accepted input that is not what it must be, an answer that takes more than 10 s, and a crash.

python benchmarks/fuzz.py [--inputs N] [--targets NAME ...] [--seed N] [--atheris] [--json PATH] [--keep DIR]

With ``--atheris`` (pip install atheris) the inputs are chosen by the coverage they reach, through the same mutations.

The property tests use the same examples every time. To search with others, as often as wished:

pytest --hypothesis-profile=search --hypothesis-seed=RANDOM tests
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import hashlib
import io
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import types
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.sparse
from pydantic import BaseModel

import navfilter as nf
from navfilter.check.description import describe_vehicle
from navfilter.check.plausibility import check_vehicle
from navfilter.io import VehicleError, read_mission, read_vehicle, write_vehicle
from navfilter.io.json_lines import BAD_KINDS, BadLine, LineParser, Reading
from navfilter.io.mission_schema import GROUPS
from navfilter.io.tables import TableOptions, read_table
from navfilter.io.units import SUFFIXES, UNITS
from navfilter.io.vehicle_template import vehicle_template
from navfilter.mission import MissionError
from navfilter.service.protocol import Lines

RECORDINGS = Path(__file__).parents[1] / "tests" / "recordings"
LONGEST_S = 10.0
#: Words that mean something to one of the readers.
WORDS = [
    *"""name drive sensors type model error imu dead-reckoning heading body-velocity depth position zero-velocity white random-walk
    gauss-markov arma learned-arma adopted prior orders window hop ar ma sd density start_sd tau_s order rate_hz gyro accel tilt
    attitude velocity lever_arm_b_m mounting_deg scale_sd streams truth start file time column columns unit axes constant mean
    invalid invalid_above valid_range sources only_changes average every resample_hz hide windows zero_s first from date log
    sensor time_s value rate_b force_b event bad lost latitude_deg longitude_deg heading_deg position_sd_m table transpose
    delimiter decimal comment skip_lines skip_rows header max_gap_s rollover ends_only iso8601 reference ecef enu order wxyz""".split(),  # noqa: SIM905
    *GROUPS,
    *(unit for unit in UNITS if unit),
    *(f"sd_{suffix}" for suffix in SUFFIXES),
]
NUMBERS = """0 -0.0 1 -1 2 3 4 7 10 0.5 -2.5 100 1e-3 1e-9 1e-300 5e-324 1e9 1e12 1e20 1e300 1.7976931348623157e308 1e400 -1e400 inf
    -inf nan 9223372036854775807 9223372036854775808 -9223372036854775809 99999999999999999999999 0x7f 0b1 1_000 00 1e 1. .5 +1
    1e-400 180 360 2026-06-01 2026-13-01 0000-00-00 12:00:00 2026-06-01T00:00:00Z true false null NaN Infinity""".split()  # noqa: SIM905
PIECES = [
    *rb"[[[[ ]]]] {{ }} [] {} = == , ,, ; : . .. # % $ ${X} $HOME".split(),
    *(b'"', b'"""', b"'", b"'''", b"\\", b"\\u0000", b"\\ud800", b"\x00", b"\xff", b"\xef\xbb\xbf", b"\xc3\x28", b"\r", b"\r\n", b"\t"),
    b" ",
    b"[" * 500,
    b'{"a":' * 500,
    b"9" * 5000,
    b"x" * 70000,
    b"\n\n\n",
    "é日本\u2028\U0001f600".encode(),
]
TOKEN = re.compile(rb'"[^"\n]*"|[+-]?[0-9][0-9A-Za-z_.+:-]*|[A-Za-z_][A-Za-z0-9_-]*|[\[\]{}=,:;#]')


# --- mutations --------------------------------------------------------------------------------------------------------


class Mutator:
    """Makes broken inputs out of valid ones.

    Parameters
    ----------
    examples : list of bytes
    text : bool
        Whether tokens and lines mean something.
    """

    def __init__(self, examples: list[bytes], text: bool) -> None:
        self.examples, self.text = examples, text

    def make(self, rng: random.Random, given: bytes | None = None) -> bytes:
        """One input: an example (or the one given) after one to eight mutations."""
        data = rng.choice(self.examples) if given is None else given
        for _ in range(min(1 + int(rng.expovariate(1.2)), 8)):
            data = self._token(data, rng) if self.text and rng.random() < 0.75 else self._bytes(data, rng)
        return data[:200_000]

    def _bytes(self, data: bytes, rng: random.Random) -> bytes:
        if not data:
            return rng.choice(PIECES)
        a = rng.randrange(len(data))
        b = min(len(data), a + rng.choice((1, 1, 2, 4, 8, 64, 1000)))
        match rng.randrange(7):
            case 0:
                return data[:a] + bytes([data[a] ^ (1 << rng.randrange(8))]) + data[a + 1 :]
            case 1:
                return data[:a] + rng.randbytes(b - a) + data[b:]
            case 2:
                return data[:a] + data[b:]
            case 3:
                return data[:a] + data[a:b] * rng.choice((2, 3, 50)) + data[b:]
            case 4:
                return data[:a]
            case 5:
                other = rng.choice(self.examples)
                return data[:a] + other[rng.randrange(len(other) + 1) :]
            case _:
                return data[:a] + rng.choice(PIECES) + data[a:]

    def _token(self, data: bytes, rng: random.Random) -> bytes:
        if rng.random() < 0.2:
            return self._lines(data, rng)
        tokens = list(TOKEN.finditer(data))
        if not tokens:
            return data + rng.choice(WORDS).encode()
        chosen = rng.choice(tokens)
        old = chosen.group()
        if old[:1] in b'[]{}=,:;#"' and rng.random() < 0.5:
            new = rng.choice((b"", old * 2, rng.choice(tokens).group(), b'"' + rng.choice(WORDS).encode() + b'"'))
        elif re.match(rb"[+-]?[0-9]", old) or rng.random() < 0.35:
            new = rng.choice(NUMBERS).encode() if rng.random() < 0.8 else rng.choice((b"[1.0, 2.0]", b"{}", b'"x"', b"[]", b"[[1, 0]]"))
        elif rng.random() < 0.2:
            new = rng.choice(tokens).group()
        else:
            new = rng.choice(WORDS).encode()
            if old.startswith(b'"'):
                new = b'"' + new + b'"'
        return data[: chosen.start()] + new + data[chosen.end() :]

    def _lines(self, data: bytes, rng: random.Random) -> bytes:
        lines = data.split(b"\n")
        k, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        match rng.randrange(4):
            case 0:
                del lines[k]
            case 1:
                lines.insert(j, lines[k])
            case 2:
                lines[k], lines[j] = lines[j], lines[k]
            case _:
                lines.insert(j, rng.choice(rng.choice(self.examples).split(b"\n")))
        return b"\n".join(lines)


# --- targets ----------------------------------------------------------------------------------------------------------


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


@dataclass
class Count:
    """What became of the inputs of one target."""

    inputs: int = 0
    refused: int = 0
    accepted: int = 0
    unhandled: int = 0
    seconds: float = 0.0
    kinds: Counter[str] = field(default_factory=Counter)


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


def vehicle_target(folder: Path) -> Target:
    """vehicle.toml; what is accepted is described, checked, and written and read back."""
    path, back = folder / "vehicle.toml", folder / "back.toml"
    examples = [vehicle_template(drive).encode() for drive in ("imu", "dead-reckoning")]
    # Without the words between the keys more of the mutations meet something that is read.
    examples += [re.sub(rb"(?m)^#(?! ).*\n|^# .*\n", b"", text) for text in examples for _ in range(2)]
    examples += [re.sub(rb"(?m)^#(?=[^ #\n])", b"", text) for text in examples[:2]]
    examples += [p.read_bytes() for p in sorted(RECORDINGS.glob("*/*/vehicle.toml"))[::3]]
    examples += [
        b"""
[drive]
type = "imu"
rate_hz = 100
gyro = {x = {model = "white", sd = 1}, y = [{model = "arma", ar = [-0.9], sd = 1}], z = {model = "white", sd = 1}}
[sensors.c]
type = "heading"
rate_hz = 8
error = {model = "learned-arma", orders = [[1, 0], [2, 1]], window = 400, hop = 10, prior = [{model = "white", sd_deg = 1}]}
[sensors.d]
type = "depth"
error = {model = "learned-arma", adopted = {ar = [-0.9], ma = [0.1], sd = 1, covariance = [[1, 0], [0, 1]], sd_log_s0 = 0.5, flags = ["x"]}}
"""
    ]

    def run(data: bytes) -> None:
        path.write_bytes(data)
        vehicle = refusing((VehicleError,), lambda: read_vehicle(path))
        demand(read_vehicle(write_vehicle(vehicle, back)) == vehicle, "what is written does not come back")
        demand(refusing((ValueError,), lambda: describe_vehicle(vehicle)).startswith("Vehicle "), "no description")
        refusing((ValueError,), lambda: check_vehicle(vehicle))

    return Target("vehicle.toml", examples, run, 0.06)


def sound(mission: nf.Mission) -> None:
    """What every mission must be."""
    for name, stream in mission.streams.items():
        demand(bool(np.isfinite(stream.time_s).all()), f"{name}: a time is not finite")
        demand(bool((np.diff(stream.time_s) >= 0.0).all()), f"{name}: times go back")
        demand(stream.value.shape[0] == stream.time_s.size and stream.value.shape[1] == len(stream.columns), f"{name}: wrong shape")
        demand(not np.isinf(stream.value).any(), f"{name}: infinite values")


TABLE = (
    b"t,a,b,c,d,h\n" + b"\n".join(b"%d.%d,%.3f,%.3f,1e-3,4,%.1f" % (k // 4, k % 4, k * 0.1, -k * 0.1, k * 10.0) for k in range(40)) + b"\n"
)
MISSION = b"""name = "dive"
date = 2026-06-01
zero_s = "first"
windows = [[0.0, 5.0]]
[streams.imu]
file = "log.csv"
time = {column = "t", unit = "s", offset_s = 1.0}
rate = {columns = ["a", "b", {constant = 0.0}], unit = "deg/s", axes = "x,-y,-z", mounting_deg = [0, 0, 90]}
force = {columns = ["a", {mean = ["a", "b"]}, "c"], unit = "g", scale = 2.0, invalid = [-1.0], invalid_above = 50.0, valid_range = [-9, 9]}
[streams.compass]
file = "log.csv"
time = {rate_hz = 4.0, start_s = 1.0}
only_changes = true
heading = {column = "h", unit = "deg", offset = "90 deg"}
[streams.dvl]
sources = [
  {file = "log.csv", time = {column = 0, rollover = 10.0}, velocity = {columns = [1, 2, 3], unit = ["m/s", "cm/s", "kn"]}},
  {file = "log.npz", table = "x", time = {column = 0}, max_gap_s = 1.0, velocity = {columns = [1, 2, 3]}},
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
    examples = [MISSION, *(b'name = "one"' + section + b"\n" for section in sections if section.startswith(b"\n[streams"))]
    examples += [sections[-2] + sections[-1]]

    def run(data: bytes) -> None:
        path.write_bytes(data)
        sound(refusing((MissionError,), lambda: read_mission(path)))

    return Target("mission.toml", examples, run, 0.06)


def table_target(folder: Path) -> Target:
    """Text tables, alone and through a mission.toml; the first byte chooses how they are read."""
    (folder / "mission.toml").write_bytes(MISSION)
    write_companions(folder)
    options = [TableOptions(), TableOptions(delimiter=";", decimal=","), TableOptions(header=("p", "q")), TableOptions(skip_lines=2)]
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
    columns = {"x": values, "s": {"t": values[:, 0], "c": "text", "n": {"k": 1.0}}, "z": values + 1j, "i": values.astype(np.int16), "e": []}
    cells = {"cell": np.array([values, "abc", 1.0], dtype=object), "sparse": scipy.sparse.csc_array(values), "x": values}
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
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=100), sensors={"compass": nf.Heading(), "gps": nf.Position(), "dvl": nf.BodyVelocity()})
    parsers = [lambda: LineParser(vehicle), lambda: LineParser(), lambda: LineParser(notes=True)]

    def run(data: bytes) -> None:
        parser = parsers[data[0] % 3 if data else 0]()
        # In pieces, as they come through a pipe.
        cutter = Lines()
        found = [*cutter.feed(data[1 : len(data) // 2]), *cutter.feed(data[len(data) // 2 :] if len(data) > 1 else b""), *cutter.end()]
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
    return Target("JSON lines", examples, run, 0.70)


def log_target(folder: Path) -> Target:
    """The log folder of `navfilter run`."""
    columns = b'imu = ["a", "b", "c", "d", "e", "f"]\ncompass = ["heading_rad"]\ngps = ["x", "y", "z"]\n'
    (folder / "mission.toml").write_bytes(b'name = "log"\n[log]\nfile = "log.jsonl"\n[log.columns]\n' + columns)

    def run(data: bytes) -> None:
        (folder / "log.jsonl").write_bytes(data)
        sound(refusing((MissionError,), lambda: read_mission(folder)))

    return Target("log of a run", [b"\n".join(NOTES[:1] + LINES * 3 + NOTES) + b"\n", b"\n".join(LINES)], run, 0.03)


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
    magic, header, payload = whole.split(b"\n", 2)

    def restore(data: bytes) -> None:
        back = refusing((ValueError,), lambda: nf.Navigator.restore(vehicle, data))
        for k in range(1, 4):
            back.step(back.time_s + 0.1 * k, np.zeros(3), np.array([0.0, 0.0, -9.8]))
        if not sealed:
            P = back.state.covariance
            demand(bool(np.isfinite(P).all()) and float(np.linalg.eigvalsh(P).min()) > -1e-9, "no covariance after restoring")

    def run(data: bytes) -> None:
        if not sealed:
            restore(data)
            return
        meta = {**json.loads(header), "sha256": hashlib.sha256(data).hexdigest(), "size": len(data)}
        restore(magic + b"\n" + json.dumps(meta).encode() + b"\n" + data)

    if sealed:
        return Target("snapshots, resealed", [payload], run, 0.02, text=False)
    return Target("snapshots", [whole], run, 0.04, text=False)


def targets(folder: Path, names: list[str] | None) -> list[Target]:
    """Every target, each with a folder of its own."""

    def own(name: str) -> Path:
        made = folder / name
        made.mkdir()
        return made

    made = [
        vehicle_target(own("v")),
        mission_target(own("m")),
        table_target(own("t")),
        container_target(own("c")),
        native_target(own("n")),
        lines_target(own("l")),
        log_target(own("r")),
        snapshot_target(own("s"), sealed=False),
        snapshot_target(own("z"), sealed=True),
    ]
    unknown = set(names or ()) - {target.name for target in made}
    if unknown:
        raise SystemExit(f"no target {', '.join(sorted(unknown))} (targets: {', '.join(target.name for target in made)})")
    return [target for target in made if not names or target.name in names]


# --- the run ----------------------------------------------------------------------------------------------------------


def too_slow(*_: Any) -> None:
    """Alarm: an answer takes too long."""
    raise TimeoutError(f"no answer within {LONGEST_S} s")


def judge(target: Target, data: bytes, count: Count, keep: Path | None) -> None:
    """Run one input and count what became of it."""
    count.inputs += 1
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    try:
        target.run(data)
        count.accepted += 1
    except Refused:
        count.refused += 1
    except Exception as error:
        count.unhandled += 1
        place = traceback.extract_tb(error.__traceback__)[-1]
        ours = next((f for f in reversed(traceback.extract_tb(error.__traceback__)) if "/navfilter/" in f.filename), place)
        kind = f"{type(error).__name__} in {Path(ours.filename).name}:{ours.lineno} ({str(error)[:80]})"
        kind = re.sub(r"0x[0-9a-f]+|\d{3,}", "#", kind)
        count.kinds[kind] += 1
        if keep is not None and count.kinds[kind] <= 3:
            keep.mkdir(parents=True, exist_ok=True)
            name = f"{target.name.replace(' ', '-')}-{hashlib.sha256(data).hexdigest()[:10]}"
            (keep / name).write_bytes(data)
            (keep / f"{name}.txt").write_text("".join(traceback.format_exception(error)))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def fuzz(target: Target, inputs: int, seed: int, keep: Path | None) -> Count:
    """The own mutations, in this process."""
    count, rng, mutator = Count(), random.Random(f"{seed} {target.name}"), Mutator(target.examples, target.text)
    for example in target.examples:
        judge(target, example, count, keep)
    if count.refused == count.inputs:
        raise SystemExit(f"{target.name}: none of the examples is accepted; the target tests nothing.")
    began = time.perf_counter()
    while count.inputs < inputs:
        judge(target, mutator.make(rng), count, keep)
    count.seconds = time.perf_counter() - began
    return count


def with_atheris(target: Target, inputs: int, seed: int, keep: Path | None) -> Count:
    """The same through atheris, in a process of its own: libFuzzer ends the process it runs in."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            __file__,
            "--child",
            target.name,
            "--inputs",
            str(inputs),
            "--seed",
            str(seed),
            "--json",
            f"{folder}/count",
        ]
        done = subprocess.run(command + (["--keep", str(keep)] if keep else []), cwd=folder, capture_output=True, text=True)
        try:
            found = json.loads(Path(folder, "count").read_text())
        except FileNotFoundError:
            raise SystemExit(f"{target.name}: atheris died:\n{done.stderr[-2000:]}") from None
    return Count(**{**found, "kinds": Counter(found["kinds"])})


def instrument(owner: Any, module: str) -> None:
    """Let libFuzzer see which lines of a module's functions, and of its classes' methods, are reached."""
    import atheris

    for key, value in list(vars(owner).items()):
        if getattr(value, "__module__", None) != module:
            continue
        if isinstance(value, types.FunctionType):
            setattr(owner, key, atheris.instrument_func(value))
        elif isinstance(value, type) and not issubclass(value, BaseModel | tuple):
            instrument(value, module)


def child(name: str, inputs: int, seed: int, keep: Path | None, path: Path) -> None:
    """Fuzz one target under libFuzzer and write the count at the end."""
    import atheris

    with tempfile.TemporaryDirectory() as folder:
        target = targets(Path(folder), [name])[0]
        for module in [
            m for n, m in sys.modules.items() if n.startswith(("navfilter.io", "navfilter.filter.snapshot", "navfilter.service", "tomllib"))
        ]:
            instrument(module, module.__name__)
        corpus = Path(folder, "corpus")
        corpus.mkdir()
        for k, example in enumerate(target.examples):
            (corpus / str(k)).write_bytes(example)
        count, began, mutator = Count(), time.perf_counter(), Mutator(target.examples, target.text)

        def one(data: bytes) -> None:
            judge(target, data, count, keep)
            if count.inputs % 500 == 0 or count.inputs >= inputs:
                count.seconds = time.perf_counter() - began
                path.write_text(json.dumps(vars(count)))

        def mutate(data: bytes, most: int, number: int) -> bytes:
            rng = random.Random(number)
            return mutator.make(rng, data)[:most] if rng.random() < 0.7 else atheris.Mutate(data, most)

        arguments = [sys.argv[0], str(corpus), f"-runs={inputs}", f"-seed={seed + 1}", "-max_len=200000", "-verbosity=0", "-handle_alrm=0"]
        atheris.Setup(arguments, one, custom_mutator=mutate)
        with contextlib.suppress(SystemExit):
            atheris.Fuzz()


def row(name: str, count: Count) -> str:
    """One line of the table."""
    rate = count.inputs / count.seconds if count.seconds else 0.0
    numbers = f"{count.inputs:10d}{count.refused:10d}{count.accepted:10d}{count.unhandled:10d}{rate:12.0f}"
    return f"{name:22}{numbers}"


def main() -> int:
    """Run everything and print the table; exit code 1 when something was not handled."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=1_000_000, help="in total (default: %(default)s)")
    parser.add_argument("--targets", nargs="+", metavar="NAME")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--atheris", action="store_true", help="inputs chosen by coverage")
    parser.add_argument("--json", type=Path, metavar="PATH")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep what was not handled")
    parser.add_argument("--child", metavar="NAME", help=argparse.SUPPRESS)
    options = parser.parse_args()
    faulthandler.enable()
    signal.signal(signal.SIGALRM, too_slow)
    np.seterr(all="ignore")
    if options.child:
        child(options.child, options.inputs, options.seed, options.keep, options.json)
        return 0
    counts: dict[str, Count] = {}
    print(f"{'':22}{'inputs':>10}{'refused':>10}{'accepted':>10}{'unhandled':>10}{'per second':>12}")
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as folder:
        chosen = targets(Path(folder), options.targets)
        whole = sum(target.share for target in chosen)
        for target in chosen:
            number = max(int(options.inputs * target.share / whole + 0.999), len(target.examples))
            counts[target.name] = (with_atheris if options.atheris else fuzz)(target, number, options.seed, options.keep)
            print(row(target.name, counts[target.name]), flush=True)
            for kind, times in counts[target.name].kinds.most_common(12):
                print(f"    {times} x {kind}", flush=True)
    names = ("inputs", "refused", "accepted", "unhandled", "seconds")
    total = Count(**{name: sum(getattr(c, name) for c in counts.values()) for name in names})
    print(row("all", total))
    if options.json:
        rows = {name: vars(count) for name, count in {**counts, "all": total}.items()}
        options.json.write_text(json.dumps({"atheris": options.atheris, "seed": options.seed, "targets": rows}, indent=1))
    return 1 if total.unhandled else 0


if __name__ == "__main__":
    sys.exit(main())
