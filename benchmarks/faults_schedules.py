"""Random schedules of everything that can happen around `navfilter run`, for `faults.py service`.

The processes of a schedule are forks of this one: it has imported the program and compiled its kernels, so that a
schedule costs a second and a thousand of them can be run. What runs in a fork is the command itself, with descriptors,
signals and limits of its own. Only its warm-up is left out, which the other kinds of `faults.py service` have.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import resource
import shutil
import signal
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import chain
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from live_run import Dive, run_session

from navfilter.commands.cli import main
from navfilter.io.json_lines import Reading
from navfilter.service import loop
from navfilter.service.log import LOG_FILE, log_items

#: Counts of a schedule by which it is judged.
VERDICT = ("crash", "lost_readings", "other_state")
#: What has been published for so long is in the log: the thread that writes it is no further behind [s].
ACKNOWLEDGED_S = 1.0
#: Far beyond what anything here takes; reached only when something hangs [s].
PATIENCE_S = 120.0
#: By the last digit of the seed: a scenario and its length [s]. The longest is long enough for a model to be adopted.
DIVES = (("lawnmower", 40.0), *[("lawnmower", 20.0)] * 4, *[("reckoning", 150.0)] * 5)
#: Of a process that had not begun: the interpreter's own answer to these signals.
TOO_SOON = (-signal.SIGTERM, -signal.SIGHUP)
HUNG = -99


class Forked:
    """The command as a fork of this process; its states are read by a thread.

    Parameters
    ----------
    arguments : sequence
        Of ``navfilter run``.
    errors : int
        Its standard error.
    reader : str
        Of its states: "quick", "slow", "none" (nobody reads until the end), "gone".
    limit : int
        Largest size of a file [bytes].
    """

    def __init__(self, arguments: Sequence[Any], errors: int, reader: str, limit: int = 1 << 40) -> None:
        (given, self._input), (self._output, written) = os.pipe(), os.pipe()
        self.pid = os.fork()
        if not self.pid:
            self._become([str(argument) for argument in arguments], (given, written, errors), limit)
        for handle in (given, written):
            os.close(handle)
        self.seen: list[tuple[float, float]] = []  # when it was read, time of the state
        self.lines: list[bytes] = []
        self.code: int | None = None
        self._reader, self._ended = reader, threading.Event()
        if reader == "gone":
            os.close(self._output)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _become(self, arguments: list[str], handles: tuple[int, int, int], limit: int) -> None:
        """In the fork: the command, and the end of it."""
        code = 70
        try:
            # under other numbers first: one of them may stand where another is to go
            moved = [os.dup(handle) for handle in handles]
            for number, handle in enumerate(moved):
                os.dup2(handle, number)
            os.closerange(3, 256)
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # as the interpreter has it
            code = main(["run", *arguments])
        except BaseException as error:
            with contextlib.suppress(OSError):
                os.write(2, f"{error!r}\n".encode())
        finally:
            os._exit(code)

    def _read(self) -> None:
        if self._reader == "gone":
            return
        if self._reader == "none":
            self._ended.wait()
        rest = b""
        while data := os.read(self._output, 2048 if self._reader == "slow" else 1 << 16):
            *whole, rest = (rest + data).split(b"\n")
            now = time.monotonic()
            for line in whole:
                if b'"event"' not in line:
                    self.lines.append(line)
                    with contextlib.suppress(ValueError):  # what was dropped tears no line, the end may
                        self.seen.append((now, json.loads(line)["time_s"]))
            if self._reader == "slow" and not self._ended.is_set():
                time.sleep(0.02)

    def send(self, lines: list[bytes], close: bool = False) -> None:
        """Give it lines; it may be gone."""
        with contextlib.suppress(OSError):
            view = memoryview(b"".join(lines))
            while view:
                view = view[os.write(self._input, view[: 1 << 16]) :]
        if close:
            self.close()

    def close(self) -> None:
        """The end of its input."""
        if self._input is not None:
            os.close(self._input)
            self._input = None

    def end(self, number: int | None = None) -> None:
        """Send a signal, or let it come to its end; its exit code is then known."""
        if number is not None:
            os.kill(self.pid, number)
        until = time.monotonic() + PATIENCE_S
        self._ended.set()
        while not (found := os.waitpid(self.pid, os.WNOHANG))[0]:
            if time.monotonic() > until:
                os.kill(self.pid, signal.SIGKILL)
                self.code = HUNG
                os.waitpid(self.pid, 0)
                break
            time.sleep(0.005)
        else:
            self.code = os.waitstatus_to_exitcode(found[1])
        self._thread.join()
        if self._reader != "gone":
            os.close(self._output)


def stderr_of(rng: np.random.Generator) -> tuple[int, list[int]]:
    """A standard error that is there, full, gone, or not drained; and all handles to be closed behind it."""
    kind = int(rng.integers(4))
    if kind in (0, 1):
        handle = os.open(("/dev/null", "/dev/full")[kind], os.O_WRONLY)
        return handle, [handle]
    reading, writing = os.pipe()
    if kind == 2:
        os.close(reading)
        return writing, [writing]
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(65536))
    os.set_blocking(writing, True)
    return writing, [writing, reading]


def noisy(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    """Lines with garbage between them."""
    lines = [*lines]
    for _ in range(int(rng.integers(0, 30))):
        noise = rng.bytes(int(rng.integers(1, 2000)))
        lines.insert(int(rng.integers(len(lines) + 1)), noise + b"\n")
    return lines


def clock_changed(lines: list[bytes], rng: np.random.Generator) -> list[bytes]:
    """Stamps moved from a line on, as of a computer whose clock is set: by milliseconds to days, either way."""
    at, by_s = int(rng.integers(len(lines))), float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-3.0, 5.0))
    moved = []
    for line in lines[at:]:
        fields = json.loads(line)
        fields["time_s"] += by_s
        moved.append(json.dumps(fields).encode() + b"\n")
    return [*lines[:at], *moved]


def without_counts(line: bytes) -> dict[str, Any]:
    """A state without the count of bad lines."""
    return {key: value for key, value in json.loads(line).items() if key != "bad_lines"}


def logged(dive: Dive, folder: Path) -> list[bytes]:
    """The readings in a log, as they came."""
    file = folder / LOG_FILE
    if not file.exists():
        return []
    return [item.raw for item in log_items(file, dive.vehicle) if isinstance(item, Reading)]


def broken_off(dive: Dive, lines: list[bytes], folder: Path, rng: np.random.Generator, sent: int) -> Forked | None:
    """One process of a schedule that is not the last; None where its folder was deleted.

    With a deleted log its snapshot goes too, for it may know more than the log.
    """
    arguments = [*dive.arguments, "--log", folder, "--resume", "--snapshot-every", "0.1", "--fsync", "0.05"]
    before = (folder / LOG_FILE).stat().st_size if (folder / LOG_FILE).exists() else 0
    handle, behind = stderr_of(rng)
    reader = ("quick", "slow", "none", "gone")[int(rng.integers(4))]
    process = Forked(arguments, handle, reader)
    end = int(rng.integers(sent, len(lines)))
    sending = threading.Thread(target=process.send, args=(noisy(lines[sent:end], rng),))
    sending.start()
    time.sleep(rng.uniform(0.0, 0.8))
    # what is deleted before it is opened is another case: nothing was there
    if deleted := rng.random() < 0.2 and opened(folder / LOG_FILE, before):
        shutil.rmtree(folder, ignore_errors=True)
    if rng.random() < 0.3:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGHUP)
    number = (signal.SIGKILL, signal.SIGTERM, None)[int(rng.integers(3))]
    if number is None:
        sending.join(PATIENCE_S)
        process.close()
    process.end(number)
    sending.join(PATIENCE_S)
    process.close()
    for one in behind:
        os.close(one)
    if deleted:
        (folder / "snapshot").unlink(missing_ok=True)
    return None if deleted else process


def opened(file: Path, before: int, patience_s: float = 5.0) -> bool:
    """Wait until a process has begun to write its log."""
    until = time.monotonic() + patience_s
    while time.monotonic() < until:
        with contextlib.suppress(OSError):
            if file.stat().st_size > before:
                return True
        time.sleep(0.005)
    return False


def unlogged(process: Forked, lines: list[bytes], whole: int, ended_s: float) -> int:
    """Readings that are not in the log, and whose states had been published for a while when the process ended."""
    seen = [time_s for read_s, time_s in process.seen if read_s < ended_s - ACKNOWLEDGED_S]
    if not seen:
        return 0
    # of the lines of its own time a state may know the first ones only
    known = next((k for k, line in enumerate(lines) if json.loads(line)["time_s"] >= seen[-1]), 0)
    return max(0, known - whole)


def schedule(dive: Dive, folder: Path, seed: int) -> dict[str, Any]:
    """Several processes one after another on one log, and whatever can happen to them."""
    rng = np.random.default_rng(seed)
    set_clock = rng.random() < 0.3
    lines = clock_changed(dive.lines, rng) if set_clock else dive.lines
    output = run_session(dive.vehicle, lines, dive.options) if set_clock else dive.output
    wanted = without_counts([line for line in output if b'"event"' not in line][-1])
    log, lost, sent, crashes = folder / "log", 0, 0, []
    for _ in range(int(rng.integers(1, 4))):
        process = broken_off(dive, lines, log, rng, sent)
        ended_s = time.monotonic()
        whole = logged(dive, log)
        lost += whole != lines[: len(whole)]
        if process is not None:
            lost += 0 if set_clock else unlogged(process, lines, len(whole), ended_s)
            begun = bool(process.lines) or len(whole) > sent
            if process.code not in (0, -signal.SIGKILL) and (begun or process.code not in TOO_SOON):
                crashes.append(process.code)
        sent = len(whole)
        if not sent:  # deleted, or never begun: what is left beside it belongs to nothing
            shutil.rmtree(log, ignore_errors=True)
            continue
        with (log / LOG_FILE).open("ab") as end:
            end.write(b'{"sensor":"imu","ti' * int(rng.integers(2)))
        snapshot = log / "snapshot"
        if snapshot.exists() and rng.random() < 0.4:
            data = bytearray(snapshot.read_bytes())
            data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
            snapshot.write_bytes(data)
    (handle, behind), limit = stderr_of(rng), int(rng.choice([10_000, 300_000, 1 << 40]))
    last = Forked([*dive.arguments, "--log", log, "--resume"], handle, ("quick", "slow")[int(rng.integers(2))], limit)
    last.send(noisy(lines[sent:], rng), close=True)
    last.end()
    for one in behind:
        os.close(one)
    if last.code != 0:
        crashes.append(last.code)
    same = bool(last.lines) and without_counts(last.lines[-1]) == wanted
    return {"seed": seed, "crash": len(crashes), "codes": crashes, "lost_readings": lost, "other_state": int(not same)}


def schedules(seeds: Sequence[int], workers: int = 1) -> list[dict[str, Any]]:
    """What became of the schedules of these seeds, on so many processes."""
    if workers > 1:
        parts = [list(seeds[k::workers]) for k in range(workers)]
        with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
            return sorted(chain.from_iterable(pool.map(schedules, parts)), key=lambda row: row["seed"])
    loop.warm = lambda say, vehicle: say("compiled in the process that was forked")
    rows = []
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as name:
        dives = {kind: Dive(Path(name), *kind) for kind in dict.fromkeys(DIVES)}
        gc.collect()
        gc.freeze()
        for seed in seeds:
            folder = Path(name) / str(seed)
            folder.mkdir()
            rows.append(schedule(dives[DIVES[seed % 10]], folder, seed))
            if any(rows[-1][key] for key in VERDICT):
                print(f"  schedule {rows[-1]}", flush=True)
            shutil.rmtree(folder)
    return rows


def counted(rows: Sequence[dict[str, Any]]) -> dict[str, int]:
    """The verdicts of many schedules together."""
    total: Counter[str] = Counter()
    for row in rows:
        total.update({key: row[key] for key in VERDICT})
    return {key: total[key] for key in VERDICT}
