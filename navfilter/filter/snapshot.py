"""Snapshots: a navigator as bytes and back, so that a vehicle goes on after a restart as if nothing had happened.

A snapshot is a line that says what it is, a line of JSON (format, fingerprint of the vehicle, checksum, size), and an npz archive
without pickled objects. It holds the oldest checkpoint of the history and everything that was fed since: feeding it again gives the
present state to the last bit, and late readings still find their place.
"""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import io
import json
import os
import tempfile
import zipfile
from collections import Counter
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navfilter.arma.model import ArmaModel
from navfilter.error_models import Arma, ErrorModel, GaussMarkov, RandomWalk, Sum, White
from navfilter.filter.filter import Memory
from navfilter.filter.history import Reading
from navfilter.learning.learned import LearnedArma
from navfilter.start import Start
from navfilter.vehicle import Vehicle

if TYPE_CHECKING:
    from navfilter.navigator import Navigator

__all__ = ["fingerprint", "read", "write"]

Array = NDArray[np.float64]
MAGIC = b"navfilter snapshot\n"
FORMAT = 1
MODELS: dict[str, type] = {t.__name__: t for t in (White, RandomWalk, GaussMarkov, Arma, LearnedArma, Sum, ArmaModel)}


def fingerprint(vehicle: Vehicle) -> str:
    """Hexadecimal digest of everything that describes a vehicle."""
    return hashlib.sha256(repr((vehicle.name, vehicle.drive, dict(vehicle.sensors))).encode()).hexdigest()


# ---------------------------------------------------------------- values as JSON


def plain(value: Any) -> Any:
    """An error model, or a tuple of them, as what JSON can hold."""
    if isinstance(value, (ErrorModel, ArmaModel)):
        fields = {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}  # type: ignore[arg-type]
        return {"type": type(value).__name__, **fields}
    if isinstance(value, np.ndarray):
        return {"array": value.tolist(), "shape": list(value.shape)}
    if isinstance(value, frozenset):
        return {"set": sorted(value)}
    if isinstance(value, tuple):
        return [plain(v) for v in value]
    return value


def revive(value: Any) -> Any:
    """The inverse of `plain`."""
    if isinstance(value, list):
        return tuple(revive(v) for v in value)
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return np.array(value["array"], dtype=np.float64).reshape(value["shape"])
    if "set" in value:
        return frozenset(value["set"])
    kind = MODELS[value["type"]]
    return kind(**{name: revive(v) for name, v in value.items() if name != "type"})


# ---------------------------------------------------------------- writing


def write(nav: Navigator, path: str | PathLike[str] | None) -> bytes:
    """See `navfilter.navigator.Navigator.snapshot`."""
    if nav._tape is not None:
        raise ValueError("a run with a tape keeps no snapshot: make the navigator without one.")
    payload = _payload(nav)
    header = {
        "format": FORMAT,
        "vehicle": fingerprint(nav.vehicle),
        "name": nav.vehicle.name,
        "time_s": nav.time_s,
        "sha256": hashlib.sha256(payload).hexdigest(),
        "size": len(payload),
    }
    data = MAGIC + json.dumps(header).encode() + b"\n" + payload
    if path is not None:
        _replace(Path(path), data)
    return data


def _replace(path: Path, data: bytes) -> None:
    """Write beside, sync, rename, sync the folder: the name always stands for one whole snapshot."""
    handle, name = tempfile.mkstemp(prefix=path.name + ".", suffix=".part", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _payload(nav: Navigator) -> bytes:
    memory, log = (nav.memory(), []) if nav._history is None else nav._history.kept()
    arrays = {f"state/{i}": a for i, a in enumerate(memory.arrays)}
    listeners: dict[str, Any] = {}
    for name, (_, mark) in memory.channels.items():
        listener = nav.channel(name).listener
        if listener is None:
            continue
        (cursor, due, models, levels), learners = listener.kept(mark)
        listeners[name] = [cursor, due, plain(models), levels]
        arrays[f"ring/{name}"] = listener.ring
        for axis, kept in enumerate(learners):
            arrays |= {f"learner/{name}/{axis}/{key}": v for key, v in (kept or {}).items()}
    still = _still(nav, memory, arrays)
    start = dataclasses.asdict(nav.start)
    start["date"] = None if nav.start.date is None else nav.start.date.isoformat()
    items = []
    for i, item in enumerate(log):
        if isinstance(item, Reading):
            items.append([item.name, item.time_s, None if item.sd is None else np.ravel(item.sd).tolist(), item.frozen])
            arrays[f"log/{i}"] = item.value
        else:
            items.append([])
            arrays[f"log/{i}"] = item
    early = nav._early[: memory.early] if nav._early is not None else []
    beginning: list[Any] = []
    arrays["early/samples"] = np.concatenate([np.empty((0, 7)), *(fed for fed in early if isinstance(fed, np.ndarray))])
    for fed in early:
        if isinstance(fed, np.ndarray):
            beginning.append(len(fed))
        else:
            name, time_s, value, sd, frozen = fed
            beginning.append([name, time_s, np.ravel(value).tolist(), None if sd is None else np.ravel(sd).tolist(), frozen])
    now = memory.in_force
    parts = {name: getattr(now.drive, name) for name in ("gyro", "accel") if hasattr(now.drive, name)}
    meta = {
        "start": start,
        "history_s": 0.0 if nav._history is None else nav._history.length_s,
        "clock": memory.clock,
        "intake": memory.intake,
        "channels": {name: clock for name, (clock, _) in memory.channels.items()},
        "listeners": listeners,
        "still": still,
        "counts": memory.counts,
        "models": {name: plain(error) for name, error in (parts | {n: s.error for n, s in now.sensors.items()}).items()},
        "watches": {
            name: [dict(w.outcomes), w.used_s, w.heard_s, w.nis, w.value.hex(), w.same, w.since_s] for name, w in nav._watches.items()
        },
        "log": items,
        "early": None if nav._early is None else beginning,
    }
    arrays["meta"] = np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)
    out = io.BytesIO()
    np.savez(out, **arrays)  # type: ignore[arg-type]
    return out.getvalue()


# ---------------------------------------------------------------- reading


def read(kind: type[Navigator], vehicle: Vehicle, source: bytes | str | PathLike[str]) -> Navigator:
    """See `navfilter.navigator.Navigator.restore`."""
    data = source if isinstance(source, bytes) else Path(source).read_bytes()
    payload = _checked(data, vehicle)
    try:
        with zipfile.ZipFile(io.BytesIO(payload)) as whole:
            # numpy reads as much as the header of an array says; only a member read to its end is held against its checksum.
            if damaged := whole.testzip():
                raise ValueError(f"{damaged} is damaged")
        with np.load(io.BytesIO(payload), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except Exception as error:  # numpy, zipfile and zlib raise many unrelated types on broken archives
        raise ValueError(f"the snapshot cannot be read ({error}). Start afresh, or take an older one.") from error
    try:
        return _revived(kind, vehicle, json.loads(arrays.pop("meta").tobytes()), arrays)
    except (KeyError, TypeError, AttributeError, IndexError, ValueError, AssertionError, OverflowError) as error:
        raise ValueError(f"the snapshot cannot be read ({error}). Start afresh, or take an older one.") from error


def _checked(data: bytes, vehicle: Vehicle) -> bytes:
    """The payload of a snapshot that is whole, of this format and of this vehicle."""
    if not data.startswith(MAGIC):
        raise ValueError("this is no snapshot of navfilter. Give the file that Navigator.snapshot(path) wrote.")
    line, _, payload = data[len(MAGIC) :].partition(b"\n")
    try:
        header = json.loads(line)
        number, digest, size, whose = header["format"], header["sha256"], header["size"], header["vehicle"]
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError("the snapshot is damaged: its header cannot be read. Start afresh, or take an older one.") from error
    if number != FORMAT:
        raise ValueError(f"the snapshot has format {number}, this version of navfilter reads {FORMAT}. Start afresh.")
    if len(payload) != size or hashlib.sha256(payload).hexdigest() != digest:
        raise ValueError(f"the snapshot is damaged: {len(payload)} of {size} bytes, or changed ones. Start afresh, or take an older one.")
    if whose != fingerprint(vehicle):
        raise ValueError(
            f'the snapshot is of another vehicle ("{header.get("name")}", or one with other settings). Use the vehicle it was taken with.'
        )
    return payload


def _still(nav: Navigator, memory: Memory, arrays: dict[str, Array]) -> list[Any] | None:
    """What was gathered at rest: its samples go to `arrays`."""
    if nav._still is None:
        return None
    numbers, models, levels, level, block, pending = memory.still
    arrays |= {"still/ring": nav._still.ring, "still/level": level, "still/block": block, "still/pending": pending}
    for axis, kept in enumerate(nav._still.kept(memory.still)):
        arrays |= {f"still/{axis}/{key}": v for key, v in (kept or {}).items()}
    return [numbers, plain(models), levels]


def _still_mark(nav: Navigator, kept: list[Any] | None, arrays: dict[str, Array]) -> Any:
    """The inverse of `_still`."""
    if nav._still is None or kept is None:
        return None
    numbers, models, levels = kept
    learners = [
        {key.removeprefix(f"still/{axis}/"): v for key, v in arrays.items() if key.startswith(f"still/{axis}/")}
        for axis in range(len(nav._still.learners))
    ]
    nav._still.revive(arrays["still/ring"], learners)
    samples = (arrays[f"still/{name}"] for name in ("level", "block", "pending"))
    return tuple(numbers), revive(models), tuple(tuple(axis) for axis in levels), *samples


def _early(items: list[Any], samples: Array) -> list[Any]:
    result: list[Any] = []
    at = 0
    for item in items:
        if isinstance(item, int):
            result.append(samples[at : at + item])
            at += item
        else:
            result.append((item[0], item[1], np.array(item[2], dtype=np.float64), item[3], item[4]))
    return result


def _revived(kind: type[Navigator], vehicle: Vehicle, meta: dict[str, Any], arrays: dict[str, Array]) -> Navigator:
    date = meta["start"].pop("date")
    fields: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in meta["start"].items()}
    start = Start(**fields, date=None if date is None else datetime.date.fromisoformat(date))
    nav = kind(vehicle, start, history_s=meta["history_s"])
    in_force = vehicle
    for name, error in meta["models"].items():
        in_force = in_force.with_error(**{name: revive(error)})
    marks = {}
    for name, (cursor, due, models, levels) in meta["listeners"].items():
        if nav.channel(name).listener is None:
            nav.listen(name, arrays[f"ring/{name}"].shape[1])
        listener = nav.channel(name).listener
        assert listener is not None
        own = f"learner/{name}/"
        learners = [
            {key[len(own) + len(str(axis)) + 1 :]: v for key, v in arrays.items() if key.startswith(f"{own}{axis}/")}
            for axis in range(len(listener.learners))
        ]
        listener.revive(arrays[f"ring/{name}"], learners)
        marks[name] = (cursor, due, revive(models), tuple(tuple(axis) for axis in levels))
    memory = Memory(
        tuple(meta["clock"]),
        tuple(meta["intake"]),
        tuple(arrays[f"state/{i}"] for i in range(6)),
        in_force,
        {name: (tuple(clock), marks.get(name)) for name, clock in meta["channels"].items()},
        meta["counts"],
        None if meta["early"] is None else len(meta["early"]),
        _still_mark(nav, meta["still"], arrays),
    )
    nav._early = None if meta["early"] is None else _early(meta["early"], arrays["early/samples"])
    nav.recall(memory)
    for i, item in enumerate(meta["log"]):
        fed = arrays[f"log/{i}"] if not item else Reading(item[0], item[1], arrays[f"log/{i}"], item[2], item[3])
        assert nav._history is not None
        nav._history.feed(fed)
    for name, (outcomes, used_s, heard_s, nis, value, same, since_s) in meta["watches"].items():
        watch = nav._watches[name]
        watch.outcomes, watch.used_s, watch.heard_s, watch.nis = Counter(outcomes), used_s, heard_s, nis
        watch.value, watch.same, watch.since_s = bytes.fromhex(value), same, since_s
    return nav
