"""Broken, odd and hostile input for every reader: whatever arrives, the answer is a result or one clear error.

Targets: vehicle.toml, mission.toml, text tables, containers (.npz, .npy, .mat), missions saved by navfilter, readings
as JSON lines, the log of `navfilter run`, logs of other makers' formats and what `mission --init` makes of them, whole
command lines of check, vehicle, replay (of several missions too) and calibrate, snapshots of a navigator (as damaged
bytes, with the damage sealed again under a right checksum, and with single values and shapes exchanged). Inputs are
made from valid examples by cutting, doubling, splicing and flipping bytes, and by exchanging tokens: numbers for
extreme ones, keys and words for others of the same format, lines for other lines. What is accepted is used: a vehicle
is described, checked, written and read back, also with other constants in a copy of its file, a mission's streams must
be sorted and finite, a restored navigator goes on with a covariance that is one.

Counted as unhandled: every exception that is not the reader's own kind of error, a message without words or with a
traceback in it, an accepted input that is not what it must be, an answer that takes more than 10 s of processor time,
and a crash.

With ``--atheris`` (pip install atheris) the inputs are chosen by the coverage they reach, through the same mutations.
There is no other software to compare with: the figures are counts. The exit code is 1 when something was not handled.
"""

from __future__ import annotations

import contextlib
import faulthandler
import hashlib
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
from fuzz_commands import command_target, foreign_log_target
from fuzz_mutations import Mutator
from fuzz_states import edited_target
from fuzz_targets import (
    Refused,
    Target,
    container_target,
    lines_target,
    log_target,
    mission_target,
    native_target,
    snapshot_target,
    table_target,
    vehicle_target,
)
from harness import Options, Table, flag, main, quick
from pydantic import BaseModel

LONGEST_S = 10.0


#: By name: how each target is made in a folder of its own.
TARGETS: dict[str, Callable[[Path], Target]] = {
    "vehicle.toml": vehicle_target,
    "mission.toml": mission_target,
    "text tables": table_target,
    "containers": container_target,
    "saved missions": native_target,
    "JSON lines": lines_target,
    "log of a run": log_target,
    "logs": foreign_log_target,
    "command lines": command_target,
    "snapshots": lambda folder: snapshot_target(folder, sealed=False),
    "snapshots, resealed": lambda folder: snapshot_target(folder, sealed=True),
    "snapshots, edited": lambda folder: edited_target(),
}


def targets(folder: Path, names: list[str] | None) -> list[Target]:
    """The targets of these names, or all."""
    unknown = set(names or ()) - set(TARGETS)
    if unknown:
        raise SystemExit(f"no target {', '.join(sorted(unknown))} (targets: {', '.join(TARGETS)})")
    made = []
    for k, name in enumerate(names or TARGETS):
        own = folder / str(k)
        own.mkdir()
        made.append(TARGETS[name](own))
    return made


@dataclass
class Count:
    """What became of the inputs of one target."""

    inputs: int = 0
    refused: int = 0
    accepted: int = 0
    unhandled: int = 0
    seconds: float = 0.0
    kinds: Counter[str] = field(default_factory=Counter)


def too_slow(*_: Any) -> None:
    """Alarm: an answer takes too long."""
    raise TimeoutError(f"no answer within {LONGEST_S} s of processor time")


def watch() -> None:
    """See crashes and what takes too long; overflows are expected."""
    faulthandler.enable()
    signal.signal(signal.SIGPROF, too_slow)
    np.seterr(all="ignore")


def judge(target: Target, data: bytes, count: Count, keep: Path | None) -> None:
    """Run one input and count what became of it."""
    count.inputs += 1
    signal.setitimer(signal.ITIMER_PROF, LONGEST_S)
    try:
        target.run(data)
        count.accepted += 1
    except Refused:
        count.refused += 1
    except Exception as error:
        count.unhandled += 1
        places = traceback.extract_tb(error.__traceback__)
        ours = next((place for place in reversed(places) if "/navfilter/" in place.filename), places[-1])
        kind = f"{type(error).__name__} in {Path(ours.filename).name}:{ours.lineno} ({str(error)[:80]})"
        kind = re.sub(r"0x[0-9a-f]+|\d{3,}", "#", kind)
        count.kinds[kind] += 1
        if keep is not None and count.kinds[kind] <= 3:
            keep.mkdir(parents=True, exist_ok=True)
            name = f"{target.name.replace(' ', '-')}-{hashlib.sha256(data).hexdigest()[:10]}"
            (keep / name).write_bytes(data)
            (keep / f"{name}.txt").write_text("".join(traceback.format_exception(error)))
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


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
        told = [str(x) for x in (inputs, seed, keep or "", f"{folder}/count")]
        command = [sys.executable, __file__, "--child", target.name, *told]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
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
    """Fuzz one target under libFuzzer, which ends the process, and write the count at the end."""
    import atheris

    watch()
    with tempfile.TemporaryDirectory() as folder:
        target = targets(Path(folder), [name])[0]
        for name, module in list(sys.modules.items()):
            if name.startswith(("navfilter.io", "navfilter.navigation.snapshot", "navfilter.service", "tomllib")):
                instrument(module, name)
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

        limits = ["-max_len=200000", "-verbosity=0", "-handle_alrm=0"]
        arguments = [sys.argv[0], str(corpus), f"-runs={inputs}", f"-seed={seed + 1}", *limits]
        atheris.Setup(arguments, one, custom_mutator=mutate)
        with contextlib.suppress(SystemExit):
            atheris.Fuzz()


def fuzz_all(options: Options) -> dict[str, Any]:
    """Feed every reader and print what became of the inputs."""
    watch()
    inputs = 20_000 if options.quick else options.inputs
    table = Table("reader<20 inputs>9d refused>9d accepted>9d unhandled>9d seconds>9.1f")
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as folder:
        chosen = targets(Path(folder), options.targets)
        whole = sum(target.share for target in chosen)
        for target in chosen:
            number = max(int(inputs * target.share / whole + 0.999), len(target.examples))
            count = (with_atheris if options.atheris else fuzz)(target, number, options.seed, options.keep)
            table.add({"reader": target.name, **vars(count)})
            for kind, times in count.kinds.most_common(12):
                print(f"    {times} x {kind}", flush=True)
    names = ("inputs", "refused", "accepted", "unhandled", "seconds")
    table.add({"reader": "all", **{name: sum(row[name] for row in table.rows) for name in names}})
    return {"targets": table.rows}


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(sys.argv[2], *map(int, sys.argv[3:5]), Path(sys.argv[5]) if sys.argv[5] else None, Path(sys.argv[6]))
    flags = [
        flag("--inputs", type=int, default=1_000_000, help="in total (default: %(default)s)"),
        flag("--targets", nargs="+", metavar="NAME"),
        flag("--seed", type=int, default=0),
        flag("--atheris", action="store_true", help="inputs chosen by coverage"),
        flag("--keep", type=Path, metavar="DIR", help="keep what was not handled"),
        quick("20 000 inputs"),
    ]
    figures = main(__doc__, {fuzz_all: flags})
    sys.exit(1 if figures["targets"][-1]["unhandled"] else 0)
