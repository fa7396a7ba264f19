"""``navfilter run`` for tests and benchmarks: a mission as lines, a session here, the command as a process."""

import dataclasses
import json
import os
import select
import subprocess
import sys
import time

import numpy as np

from navfilter.io import write_vehicle
from navfilter.io.json_lines import LineParser
from navfilter.service.session import Options, Session
from navfilter.simulation.scenarios import simulate_scenario

COMMAND = [sys.executable, "-m", "navfilter", "run"]
PATIENCE_S = 600  # far beyond what anything here takes; reached only when something hangs


def as_lines(vehicle, mission):
    """The mission as it would arrive: by time, the drive before what it carries, the sensors in their order."""
    drive, rows = list(vehicle.driving), []
    for name, stream in mission.streams.items():
        rank = drive.index(name) if name in drive else len(drive) + list(vehicle.sensors).index(name)
        for t, value in zip(stream.time_s.tolist(), stream.value.tolist(), strict=True):
            value = [None if np.isnan(v) else v for v in value]
            fields = {"rate_b": value[:3], "force_b": value[3:6]} if name in vehicle.units else {"value": value}
            rows.append((t, rank, json.dumps({"sensor": name, "time_s": t, **fields}).encode() + b"\n"))
    return [line for _, _, line in sorted(rows, key=lambda row: row[:2])]


class Dive:
    """A simulated mission as files and as lines, with what the navigator makes of it."""

    def __init__(self, folder, scenario, duration_s):
        self.vehicle, self.mission = simulate_scenario(scenario, 1, duration_s)
        self.start = {k: v for k, v in dataclasses.asdict(self.mission.start).items() if v is not None}
        self.lines = as_lines(self.vehicle, self.mission)
        name = f"{scenario}-{duration_s:g}"
        self.toml, self.start_file = folder / f"{name}.toml", folder / f"{name}.json"
        write_vehicle(self.vehicle, self.toml)
        self.start_file.write_text(json.dumps({**self.start, "date": self.start["date"].isoformat()}))
        self.options = Options(start=self.start, date=self.start["date"])
        self.output = run_session(self.vehicle, self.lines, self.options)
        self.arguments = ["--vehicle", str(self.toml), "--start", str(self.start_file)]


def run_session(vehicle, lines, options, stop=True):
    """The output of a session in this process."""
    out, parser = [], LineParser(vehicle)
    session = Session(vehicle, options, lambda line, is_state: out.append(line))
    for line in lines:
        item = parser.parse(line)
        if item is not None:
            session.feed(item)
    if stop:
        session.stop()
    return out


def states(output):
    """The states among lines of output, and the events."""
    rows = [json.loads(line) for line in output]
    return [row for row in rows if "event" not in row], [row for row in rows if "event" in row]


def wait_for(happened):
    """Until what is asked for is so; looked at often, as nothing tells when."""
    until = time.monotonic() + PATIENCE_S
    while not happened():
        assert time.monotonic() < until, "it never happened"
        time.sleep(0.002)


class Process:
    """``navfilter run`` as a process; everything it says is gathered."""

    def __init__(self, *arguments, **more):
        pipe = subprocess.PIPE
        more = {"stdin": pipe, "stdout": pipe, "stderr": pipe, **more}
        self.process = subprocess.Popen([*COMMAND, *map(str, arguments)], **more)
        self.output, self._read = [], b""

    def send(self, lines):
        self.process.stdin.write(b"".join(lines))
        self.process.stdin.flush()

    def read_until(self, time_s):
        """Read output up to the state of this time."""
        while True:
            while b"\n" not in self._read:
                assert select.select([self.process.stdout], [], [], PATIENCE_S)[0], "no output"
                # from the descriptor itself: what a buffered reader has taken already, select does not see
                more = os.read(self.process.stdout.fileno(), 1 << 16)
                assert more, self.process.stderr.read()
                self._read += more
            line, _, self._read = self._read.partition(b"\n")
            self.output.append(line + b"\n")
            if json.loads(line).get("time_s", -1) >= time_s:
                return

    def said(self, word):
        """Read standard error up to a line with this word."""
        while True:
            line = self.process.stderr.readline().decode()
            assert line, f"it never said {word}"
            if word in line:
                return line

    def end(self, number=None, lines=()):
        """Send the last lines and a signal, or let the input end; returns all output."""
        if number is not None:
            self.process.send_signal(number)
        rest, self.errors = self.process.communicate(b"".join(lines), timeout=PATIENCE_S)
        self.output += (self._read + (rest or b"")).splitlines(keepends=True)
        return self.output

    @property
    def code(self):
        return self.process.returncode
