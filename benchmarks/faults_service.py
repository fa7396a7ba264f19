"""Faults of what is around the filter, for `faults.py service`."""

from __future__ import annotations

import json
import resource
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from faults_schedules import VERDICT, counted, schedules, without_counts
from harness import Options, Table
from live_run import Dive, Process

import navfilter as nf
from navfilter.io.json_lines import Reading
from navfilter.playback.replay import drive_samples
from navfilter.service.log import LOG_FILE, log_items

EVERYTHING = "schedules of everything"
Verdict = tuple[int, int, int]


def states(output: list[bytes]) -> list[bytes]:
    """Lines of states, without those of events."""
    return [line for line in output if b'"event"' not in line]


def killed(dive: Dive, folder: Path, rng: np.random.Generator) -> Verdict:
    """SIGKILL at a random instant while readings come in, then resumed; and the file ends in the middle of a line."""
    often = ["--snapshot-every", "0.5", "--fsync", "0.2"]
    arguments = [*dive.arguments, "--log", folder / "log", "--resume", *often, "--quiet"]
    at_s = float(rng.integers(5, 50))
    process = Process(*arguments)
    seen = next(k for k, line in enumerate(dive.lines) if json.loads(line)["time_s"] > at_s) + 1
    process.send(dive.lines[:seen])
    process.read_until(at_s)
    time.sleep(rng.uniform(0.0, 0.3))
    process.end(signal.SIGKILL)
    whole = [item.raw for item in log_items(folder / "log" / LOG_FILE, dive.vehicle) if isinstance(item, Reading)]
    with (folder / "log" / LOG_FILE).open("ab") as log:
        log.write(b'{"sensor":"imu","time_s":')
    process = Process(*arguments)
    process.send(dive.lines[len(whole) :])
    end = states(process.end())
    return process.code != 0, max(0, seen - 1 - len(whole)), end[-1:] != states(dive.output)[-1:]


def garbage(dive: Dive, folder: Path, rng: np.random.Generator) -> Verdict:
    """Random bytes between the lines."""
    lines = [*dive.lines]
    for _ in range(200):
        size = int(rng.integers(1, 400))
        at = int(rng.integers(len(lines)))
        lines.insert(at, rng.integers(0, 256, size).astype(np.uint8).tobytes().replace(b"\n", b"") + b"\n")
    process = Process(*dive.arguments, "--log", folder / "log", "--quiet")
    process.send(lines)
    end = states(process.end())
    same = bool(end) and without_counts(end[-1]) == without_counts(states(dive.output)[-1])
    return process.code != 0, 0, not same


def full_disk(dive: Dive, folder: Path, rng: np.random.Generator) -> Verdict:
    """No file may grow beyond a random size."""
    limit = int(rng.integers(10_000, 1_000_000))

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    process = Process(*dive.arguments, "--log", folder / "log", "--quiet", preexec_fn=limited)
    process.send(dive.lines)
    end = states(process.end())
    return process.code != 0, 0, end[-1:] != states(dive.output)[-1:]


def cut_log(dive: Dive, folder: Path, rng: np.random.Generator) -> Verdict:
    """The log ends at a random byte, and there is no snapshot: what it has is fed again, the rest is sent."""
    process = Process(*dive.arguments, "--log", folder / "log", "--quiet")
    process.send(dive.lines[: len(dive.lines) // 2])
    process.end(signal.SIGTERM)
    log = folder / "log" / LOG_FILE
    data = log.read_bytes()
    head = data.index(b"\n") + 1
    log.write_bytes(data[: int(rng.integers(head, len(data)))])
    (folder / "log" / "snapshot").unlink(missing_ok=True)
    whole = [item.raw for item in log_items(log, dive.vehicle) if isinstance(item, Reading)]
    process = Process(*dive.arguments, "--log", folder / "log", "--resume", "--quiet")
    process.send(dive.lines[len(whole) :])
    end = states(process.end())
    same = bool(end) and without_counts(end[-1]) == without_counts(states(dive.output)[-1])
    return process.code != 0, 0, not same


def damaged_snapshots(dive: Dive, folder: Path, rng: np.random.Generator) -> Verdict:
    """A snapshot of the navigator with bits turned, cut, lengthened, or bytes put in, 200 times."""
    nav = nf.Navigator(dive.vehicle, dive.mission.start)
    times, values = drive_samples(dive.vehicle, dive.mission)
    for t, v in zip(times[:2000].tolist(), values[:2000], strict=True):
        nav.step(t, v[:3], v[3:])
    data, crashes, others = nav.snapshot(), 0, 0
    for _ in range(200):
        at, how = int(rng.integers(len(data))), int(rng.integers(4))
        bad = bytearray(data)
        if how == 0:
            bad[at] ^= 1 << int(rng.integers(8))
        elif how == 1:
            del bad[at:]
        elif how == 2:
            bad += bytes(int(rng.integers(1, 100)))
        else:
            bad[at:at] = rng.integers(0, 256, 7).astype(np.uint8).tobytes()
        try:
            other = nf.Navigator.restore(dive.vehicle, bytes(bad))
        except ValueError:
            continue
        except Exception as error:
            print(f"  {type(error).__name__}: {error} (way {how}, byte {at} of {len(data)})")
            crashes += 1
        else:
            others += other.snapshot() != data
    return crashes, 0, others


KINDS: dict[str, Callable[[Dive, Path, np.random.Generator], Verdict]] = {
    "SIGKILL at a random instant, half a line": killed,
    "garbage between the lines (200)": garbage,
    "disk full at a random size": full_disk,
    "log cut at a random byte": cut_log,
    "damaged snapshots (200)": damaged_snapshots,
}


def service(options: Options) -> list[dict[str, Any]]:
    """Faults of what is around the filter: killed processes, full disks, cut logs, damaged snapshots, garbage.

    Each kind runs for several seeds on one minute of a simulated lawnmower through ``navfilter run`` as a process
    (snapshots in memory without one). What must hold: after SIGKILL at a random instant, `--resume` and the readings
    that the log does not have, the last state is that of an undisturbed run to the bit, and of the readings whose
    states were seen nothing is missing from the log; garbage between the lines, a full disk and a log that is cut at
    a random byte leave the last state as it was; a damaged snapshot is refused with a ValueError, always.

    The schedules draw all of it at once: two to four processes one after another on one log, each with a standard error
    that is there, gone, full or not drained, a reader of its states that is quick, slow, asleep or gone, garbage on the
    line, and an end by SIGKILL, SIGTERM or the end of its input; in three of ten the clock of all stamps is set, by
    milliseconds to a day; between the processes the snapshot is damaged or removed, the log gets half a line, its
    folder is deleted under way; the last one may have a full disk. Whatever happens, the last state is that of an
    undisturbed run, and what the log holds is what was sent.
    """
    seeds = 1 if options.quick else options.seeds
    chosen = {kind: run for kind, run in KINDS.items() if options.only in kind}
    nf.warm_up()
    table = Table("kind<42 crash>8d lost_readings>8d other_state>8d of>4d")
    with tempfile.TemporaryDirectory() as name:
        dive = Dive(Path(name), "lawnmower", 60.0)
        for kind, run in chosen.items():
            total: Counter[str] = Counter()
            for seed in range(1, seeds + 1):
                folder = Path(name) / f"{run.__name__}-{seed}"
                folder.mkdir()
                verdict = run(dive, folder, np.random.default_rng(seed))
                total.update(dict(zip(VERDICT, map(int, verdict), strict=True)))
            table.add({"kind": kind, **{key: total[key] for key in VERDICT}, "of": seeds})
    if options.only in EVERYTHING:
        number = 10 if options.quick else options.schedules
        rows = schedules(range(options.first, options.first + number), options.workers)
        table.add({"kind": EVERYTHING, **counted(rows), "of": number, "rows": rows})
    return table.rows
