"""Logs of other makers' formats and whole command lines, for `fuzz.py`."""

from __future__ import annotations

import contextlib
import io
import lzma
import os
import shlex
import shutil
from pathlib import Path

from fuzz_targets import Target, demand, refusing, sound

from navfilter.commands.cli import main
from navfilter.io import VehicleError, write_vehicle
from navfilter.io.logs.draft import draft
from navfilter.io.logs.survey import survey, survey_text
from navfilter.models.mission import MissionError
from navfilter.report import report
from navfilter.simulation.scenarios import simulate_scenario

#: Beginnings of logs: an ending, and a file below the recordings (NAVFILTER_DATA).
LOGS = (
    (".bag", "logs/ros1/robot_localization_test2.bag"),
    (".mcap", "logs/ros2/derived_from_test2_mcap/derived_from_test2_mcap.mcap"),
    (".nmea", "logs/nmea/pynmeagps_pygpsdata-nmea4.log"),
    (".nmea", "logs/nmea/ugps_nmea_log.txt"),
    (".ulg", "logs/px4/sample_log_small.ulg"),
    (".bin", "logs/ardupilot/ardusub_small.BIN"),
    (".tlog", "logs/ardupilot/ardusub_small.tlog"),
    (".pd0", "logs/pd0/RDI_withBT.000"),
    (".ad2cp", "logs/nortek/VelEchoBT01.ad2cp"),
    (".dat", "glider-slocum-ru28/ru28_2017_113_3_1_dbd.dat.xz"),
)
#: What is read without any package, and needs no recordings.
WRITTEN = (
    (".alog", b"".join(b"%.2f INS_YAW pNav %.1f\n%.2f GPS_X pGPS 12.5\n" % (k / 4, k, k / 4) for k in range(40))),
    (
        ".json",
        b"".join(
            b'{"time": %d.0, "vx": 0.1, "vy": 0.0, "vz": 0.0, "fom": 0.01, "altitude": 5.0, "velocity_valid": true, '
            b'"status": 0, "format": "json_v3", "type": "velocity", "time_of_validity": %d}\n' % (k, 10**15 + k)
            for k in range(20)
        ),
    ),
    (".nmea", b"$GPGGA,120000,4500.00,N,00400.00,W,1,8,1.0,0,M,,M,,*61\r\n" * 5),
)
PIECE = 12_000  # bytes of each


def foreign_log_target(folder: Path) -> Target:
    """Logs by the first byte: the survey of one, and the two files that `navfilter mission --init` makes of it."""
    kinds = [*WRITTEN]
    for ending, name in LOGS if os.environ.get("NAVFILTER_DATA") else ():
        path = Path(os.environ["NAVFILTER_DATA"], name)
        data = lzma.decompress(path.read_bytes()) if path.suffix == ".xz" else path.read_bytes()
        kinds.append((ending, data if len(data) < 3 * PIECE else data[:PIECE]))

    def run(data: bytes) -> None:
        path = folder / f"log{kinds[data[0] % len(kinds) if data else 0][0]}"
        path.write_bytes(data[1:])
        try:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                found = refusing((MissionError,), lambda: survey(path))
                demand(bool(survey_text(found)), "no survey")
                sound(refusing((MissionError, VehicleError, ValueError), lambda: draft(found, folder)).mission)
        finally:
            path.unlink()

    examples = [bytes([k]) + data for k, (_, data) in enumerate(kinds)]
    return Target("logs", examples, run, 0.003, text=False)


#: Command lines; A holds the mission.toml that follows, B is whole.
LINES = (
    "check A --vehicle vehicle.toml",
    "vehicle --check vehicle.toml",
    "replay A --vehicle vehicle.toml --out out --force",
    "replay A --vehicle vehicle.toml --smooth --from 2 --to 8 --out out --force",
    "replay B.npz --vehicle vehicle.toml --without depth --withhold gps:3-6 --out out --force",
    "calibrate A B.npz --vehicle vehicle.toml --out calibrated.toml --force",
    "calibrate B.npz --vehicle vehicle.toml --open clock,scale --each gps --json c.json --out calibrated.toml --force",
    "calibrate B.npz --vehicle vehicle.toml --truth 0.05 --open all --out calibrated.toml --force",
)
COMMANDS = ("check", "vehicle", "replay", "calibrate")


def command_target(folder: Path) -> Target:
    """A command line, and the mission.toml of the first mission it names; an exit code and words, never a traceback."""
    vehicle, mission = simulate_scenario("reckoning", 1, 20.0)
    write_vehicle(vehicle, folder / "vehicle.toml")
    (folder / "A").mkdir()
    mission.save(folder / "B.npz")
    whole = b'name = "A"\n'
    for name, stream in mission.streams.items():
        table = folder / "A" / f"{name}.csv"
        rows = [",".join(["t", *stream.columns])]
        readings = zip(stream.time_s.tolist(), stream.value.tolist(), strict=True)
        rows += [",".join(map(repr, (t, *v))) for t, v in readings]
        table.write_text("\n".join(rows))
        columns = ", ".join(f'"{column}"' for column in stream.columns)
        kind = {"gps": "position", "compass": "heading"}.get(name, name)
        whole += f'[streams.{name}]\nfile = "{name}.csv"\ntime = {{column = "t"}}\n'.encode()
        whole += f"{kind} = {{columns = [{columns}]}}\n".encode()
    start = mission.start
    whole += (
        f"[start]\ntime_s = 0.0\nlatitude_deg = {start.latitude_deg}\nlongitude_deg = {start.longitude_deg}\n".encode()
    )
    report.render_report = lambda *given, **more: ""  # figures read nothing, and take seconds

    def run(data: bytes) -> None:
        line, _, text = data.partition(b"\n")
        try:
            words = shlex.split(line.decode("utf-8", "replace"))
        except ValueError:
            words = []
        # what reads elsewhere, listens or simulates for hours is no business of these readers
        if not words or words[0] not in COMMANDS or any(w.startswith("/") or ".." in w or "\0" in w for w in words):
            words = ["check", "A", "--vehicle", "vehicle.toml"]
        (folder / "A" / "mission.toml").write_bytes(text)
        out, before = io.StringIO(), os.getcwd()
        os.chdir(folder)
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
                code = main(words)
        except SystemExit as end:
            code = end.code
        finally:
            os.chdir(before)
            shutil.rmtree(folder / "out", ignore_errors=True)
        said = out.getvalue()
        demand(code in (0, 1, 2), f"exit code {code}")
        demand("Traceback" not in said and "Error:" not in said, f"a traceback: {said[-200:]}")
        demand(code != 2 or len(said) > 10, "no word")

    examples = [line.encode() + b"\n" + whole for line in LINES]
    return Target("command lines", examples, run, 0.003)
