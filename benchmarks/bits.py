"""Hashes of some thirty runs, to show that a change of the code has changed no number.

Every run is made twice the same from a seed: replays (with and without learning, smoothed, iterated, with lanes, by
dead reckoning, with beams, USBL, clocks as states, a sensor of a user's own), live loops with late readings, faults,
snapshots in the middle, a log of JSON lines. What is hashed is every value of what comes out, in their order; of
snapshots the values without the names and the format's number. So names of classes and files may change, numbers may
not. The reference is another commit of this package; no other software is compared.

    python benchmarks/bits.py --against main         makes the runs of that commit, too, in a tree of its own
    python benchmarks/bits.py --json before.json     keeps the hashes of this tree,
    python benchmarks/bits.py --against before.json  for many looks on the same machine

Compiled code differs from machine to machine: hashes of another machine say nothing, so none are kept with the code.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from harness import MAPPINGS, ROOT, Options, data_root, flag, hour, main, quick

sys.path.insert(0, str(ROOT / "tests"))
import faults_outcomes as faults
from feeding import delayed, events_of, in_blocks, one_by_one
from live_run import as_lines, run_session

import navfilter as nf
from navfilter.simulation.scenarios import simulate_scenario

#: What differs from run to run, or belongs to the description and not to the run.
LEFT_OUT = {"cpu_s", "waited_s", "vehicle"}
#: One minute of the first fault in `faults_outcomes`, on a vehicle: which rules they go through is the point.
FAULTS = (
    ("tactical", "compass turned by 180 deg for good"),
    ("tactical", "DVL in mm/s for a minute"),
    ("tactical", "gyros frozen for 30 s"),
    ("tactical", "clock of the drive alone +2 s for good"),
    ("tactical", "fixes drawn off at 0.5 m/s, 50 m"),
    ("tactical", "bursts stamped on receipt"),
    ("mems", "DVL tracks the water (current of 0.3 m/s)"),
    ("mems", "gyro z doubled for good"),
    ("mems", "depth +5 m for good"),
    ("iron", "hard iron of half the field for a minute"),
    ("reckoning", "compass 25 deg off for a minute"),
    ("lane", "accelerometer x +50 mg for good"),
)


def leaves(value: Any) -> Iterator[Any]:
    """The plain values and arrays of anything, in their order."""
    if isinstance(value, np.ndarray | np.generic | float | int | str | bytes | bool | None.__class__ | Enum):
        yield value
    elif hasattr(value, "arrays"):  # of a store of rows
        yield from leaves(value.arrays())
    elif dataclasses.is_dataclass(value):
        for f in dataclasses.fields(value):
            if f.name not in LEFT_OUT:
                yield from leaves(getattr(value, f.name))
    elif isinstance(value, dict):
        for key, item in value.items():
            if key not in LEFT_OUT:
                yield str(key)
                yield from leaves(item)
    elif isinstance(value, tuple | list):
        for item in value:
            yield from leaves(item)
    else:
        yield str(value)


class Digest:
    """The hash of everything that is put in, and how much that is."""

    def __init__(self) -> None:
        self._sha, self.values = hashlib.sha256(), 0

    def put(self, value: Any) -> None:
        """Add all values of something."""
        for leaf in leaves(value):
            data = np.ascontiguousarray(leaf).tobytes() if isinstance(leaf, np.ndarray) else repr(leaf).encode()
            self._sha.update(data)
            self.values += leaf.size if isinstance(leaf, np.ndarray) else 1

    def text(self) -> str:
        """Its first half; enough to tell two runs apart."""
        return self._sha.hexdigest()[:32]


def snapshot_values(data: bytes) -> list[Any]:
    """The values of a snapshot in sorted order, without keys: fields may move from one part to another."""
    with np.load(io.BytesIO(data.split(b"\n", 2)[2]), allow_pickle=False) as archive:
        meta, floats, integers = (archive[name] for name in ("meta", "floats", "integers"))
    plain: list[str] = []

    def walk(value: Any) -> None:
        if isinstance(value, dict) and value.get("") == "dict":
            for _, item in value["items"]:
                walk(item)
        elif isinstance(value, dict):
            for key, item in value.items():
                if key not in ("", "at", "shape"):
                    walk(item)
        elif isinstance(value, list):
            for item in value:
                walk(item)
        elif value is not None and value is not False:
            plain.append(repr(value))

    walk(json.loads(meta.tobytes()))
    floats = np.where(np.isnan(floats), np.nan, floats + 0.0)  # signs of NaN and zero have no order
    return [np.sort(floats), np.sort(integers), sorted(plain)]


def track_values(track: nf.Track) -> Any:
    """Everything that a track holds, its models as plain values."""
    return [track, track.adopted(), track.to_frame().to_numpy(dtype=float, na_value=np.nan)]


def replayed(vehicle: nf.Vehicle, mission: nf.Mission, **settings: Any) -> Any:
    """What a replay gives."""
    return track_values(nf.replay(vehicle, mission, **settings))


def live(vehicle: nf.Vehicle, mission: nf.Mission, feed: Callable[[Any, Any], Any], restart: bool = True) -> Any:
    """A live run without threads: outcomes, state, health, snapshots; restored from one half way."""
    events, nav = events_of(vehicle, mission), nf.Navigator(vehicle, mission.start, threads=False)
    half, found = len(events) // 2, []
    for part in (events[:half], events[half:]):
        found.append(feed(nav, part))
        state = nav.state
        snapshot = nav.snapshot()
        found += [state, snapshot_values(snapshot), nav.counts]
        if restart:
            nav = nf.Navigator.restore(vehicle, snapshot)
    return found


def late(nav: nf.Navigator, events: Any) -> Any:
    """Some of the readings come up to a second late."""
    names = [name for name in nav.vehicle.sensors if name != "depth"]
    return one_by_one(nav, delayed(events, names, 1.0, 1, 0.2))


def blocks(nav: nf.Navigator, events: Any) -> Any:
    """Samples in blocks of random length."""
    in_blocks(nav, events, np.random.default_rng(1))
    return []


def own_sd(nav: nf.Navigator, events: Any) -> Any:
    """Every third reading with a standard deviation of its own."""
    outcomes = []
    for k, e in enumerate(events):
        if e.sensor == "drive":
            nav.step(e.time_s, e.value[:3], e.value[3:])
        else:
            sd = None if k % 3 else np.full(len(e.value), 0.05 if e.sensor != "gps" else 1e-6)
            outcomes.append(nav.correct(e.sensor, e.time_s, e.value, sd))
    return outcomes


def learning(vehicle: nf.Vehicle, *names: str) -> nf.Vehicle:
    """The vehicle that learns these sensors' errors."""
    return vehicle.with_error(**dict.fromkeys(names, nf.LearnedArma()))


def recipe() -> tuple[nf.Vehicle, nf.Mission]:
    """The manual's altimeter, taken from its page."""
    page = (ROOT / "docs" / "pages" / "recipes.md").read_text(encoding="utf-8")
    code = page.split("```python\n# altimeter.py\n", 1)[1].split("```", 1)[0]
    folder = Path(tempfile.mkdtemp())
    (folder / "bits_altimeter.py").write_text(code, encoding="utf-8")
    sys.path.insert(0, str(folder))
    from bits_altimeter import Altimeter  # type: ignore[import-not-found]

    from navfilter.simulation.scenarios import SCENARIOS, survey_vehicle
    from navfilter.simulation.simulate import simulate

    base = survey_vehicle()
    own = Altimeter(rate_hz=2.0, bottom_height_m=-60.0, offset_sd_m=0.5)
    vehicle = dataclasses.replace(base, sensors={**base.sensors, "altimeter": own})
    return vehicle, simulate(vehicle, SCENARIOS["lawnmower"].motion(120.0), seed=1, duration_s=120.0)


def fault(which: str, name: str) -> Any:
    """A run with a fault: outcomes, states, counts."""
    vehicle, _ = faults.mission_of(1, which)
    outcome, off = faults.fly(faults.cases(vehicle)[name], 1, which)
    found = [outcome.counts, outcome.first_s, outcome.crashes, off]
    return [*found, [(t, state, state.health) for t, state in outcome.states]]


def lines() -> Any:
    """A log of ten thousand JSON lines through a session, and again with a restart in the middle."""
    from navfilter.service.session import Options as Settings

    vehicle, mission = simulate_scenario("lawnmower", 1, 90.0)
    vehicle = learning(vehicle, "compass")
    start = {k: v for k, v in dataclasses.asdict(mission.start).items() if v is not None}
    sent = as_lines(vehicle, mission)[:10_000]
    out = run_session(vehicle, sent, Settings(start=start, date=start["date"]))
    return [json.loads(line) for line in out]


def clocks() -> tuple[nf.Vehicle, nf.Mission]:
    """The standard ten minutes with clock and lever arm of the DVL as states."""
    vehicle, mission = hour(10.0)
    dvl = dataclasses.replace(vehicle.sensors["dvl"], time_offset_sd_s=0.2, lever_arm_sd_m=(0.1, 0.1, 0.1))
    return dataclasses.replace(vehicle, sensors={**vehicle.sensors, "dvl": dvl}), mission


def runs(options: Options) -> Iterator[tuple[str, Callable[[], Any]]]:
    """All runs by name."""
    short = 120.0 if options.quick else 900.0

    def scene(name: str, seconds: float = short) -> tuple[nf.Vehicle, nf.Mission]:
        return simulate_scenario(name, 1, seconds)

    yield "simulated", lambda: [scene("demo", 300.0)[1].streams, scene("miscalibrated", 300.0)[1].streams]
    yield "demo, smoothed", lambda: replayed(*scene("demo"), smooth=True)
    yield "smoothed, all rows", lambda: replayed(*scene("lawnmower", 300.0), smooth=True, output_rate_hz=None)
    yield "lawnmower, learnt", lambda: replayed(_learnt("lawnmower"), scene("lawnmower")[1], smooth=True)
    yield "hour learnt", lambda: replayed(*_eight(short), smooth=True)
    yield "iterated", lambda: replayed(_learnt("lawnmower"), scene("lawnmower", 300.0)[1], iterate=2)
    yield "reckoning, smoothed", lambda: replayed(*scene("reckoning"), smooth=True)
    yield "beams", lambda: replayed(*faults.mission_of(1, "beams"), smooth=True)
    yield "USBL", lambda: replayed(*faults.mission_of(1, "usbl"), smooth=True)
    yield "AHRS", lambda: replayed(*faults.mission_of(1, "ahrs"))
    yield "magnetometer with iron", lambda: replayed(*faults.mission_of(1, "iron"))
    yield "water track", lambda: replayed(*faults.mission_of(1, "water"))
    yield "ranges", lambda: replayed(*faults.mission_of(1, "ranges"))
    yield "wheels", lambda: replayed(*faults.mission_of(1, "wheels"))
    yield "lanes", lambda: replayed(*faults.mission_of(1, "lanes"), smooth=True)
    yield "clock and lever arm as states", lambda: replayed(*clocks(), smooth=True)
    yield "a sensor by the recipe", lambda: replayed(*recipe(), smooth=True)
    yield "live", lambda: live(*scene("lawnmower", 300.0), one_by_one)
    yield "live, learnt", lambda: live(_learnt("lawnmower"), scene("lawnmower", 300.0)[1], one_by_one)
    yield "live, late readings", lambda: live(_learnt("lawnmower"), scene("lawnmower", 300.0)[1], late)
    yield "live, blocks", lambda: live(*scene("lawnmower", 300.0), blocks)
    yield "live, sd of their own", lambda: live(*scene("lawnmower", 300.0), own_sd)
    yield "live, a sensor by the recipe", lambda: live(*recipe(), one_by_one)
    yield "live, reckoning", lambda: live(*scene("reckoning", 300.0), one_by_one)
    yield "JSON lines", lines
    for which, name in FAULTS:
        yield f"fault, {which}: {name}", lambda which=which, name=name: fault(which, name)
    if options.recordings:
        for name in ("snapir-auv-1hz/01", "wid-car-rtk/08", "auv-lake-sea-10hz", "sonia-auv-pool"):
            yield f"recording {name}", lambda name=name: recording(name)
    if options.library:
        for which in options.library.split(","):
            vehicle, _ = faults.mission_of(1, which)
            for name, case in faults.cases(vehicle).items():
                if (which, name) not in FAULTS and faults.befalls(name, case, which):
                    yield f"fault, {which}: {name}", lambda which=which, name=name: fault(which, name)


def recording(name: str) -> Any:
    """A recording with its mapping, plain and learnt."""
    data_root()
    folder = MAPPINGS / name
    found = next(iter(sorted(folder.rglob("mission.toml")))).parent
    mission, vehicle = nf.read_mission(found), nf.read_vehicle(found if (found / "vehicle.toml").exists() else folder)
    return [replayed(vehicle, mission, smooth=True)]


def _learnt(scenario: str) -> nf.Vehicle:
    return learning(simulate_scenario(scenario, 1, 10.0)[0], "compass", "dvl")


def _eight(seconds: float) -> tuple[nf.Vehicle, nf.Mission]:
    vehicle, mission = hour(seconds / 60.0)
    return learning(vehicle, "compass", "dvl", "depth", "gps"), mission


def hashes_of(commit: str) -> dict[str, Any]:
    """The hashes of a commit, by its own script with the same arguments, in a tree that is gone afterwards."""
    asked = [word for word in sys.argv[1:] if word not in ("--against", commit, f"--against={commit}")]
    with tempfile.TemporaryDirectory() as folder:
        tree, found = Path(folder) / "tree", Path(folder) / "found.json"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(tree), commit], check=True)
        try:
            script = [sys.executable, str(tree / "benchmarks" / "bits.py"), *asked, "--json", str(found)]
            subprocess.run(script, check=True, env=os.environ | {"PYTHONPATH": str(tree)}, stdout=subprocess.DEVNULL)
            return dict(json.loads(found.read_text())["figures"])
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)


def bits(options: Options) -> dict[str, Any]:
    """Make the runs, print their hashes; compare them with those of ``--against``."""
    given = options.against
    reference = {} if not given else json.loads(Path(given).read_text())["figures"] if Path(given).is_file() else None
    reference = hashes_of(given) if reference is None else reference
    found: dict[str, Any] = {}
    wrong = []
    nf.warm_up()
    for name, run in runs(options):
        if options.only not in name:
            continue
        began, digest = time.perf_counter(), Digest()
        try:
            digest.put(run())
        except Exception as error:
            if options.strict:
                raise
            digest.put(f"{type(error).__name__}: {error}")
            print(f"  {type(error).__name__}: {error}")
        found[name] = {"hash": digest.text(), "values": digest.values}
        same = reference.get(name, {}).get("hash")
        said = "" if not reference else "new" if same is None else "same" if same == digest.text() else "DIFFERENT"
        wrong += [name] * (said == "DIFFERENT")
        print(f"{digest.text()}  {time.perf_counter() - began:6.1f} s  {said:9s}  {name}", flush=True)
    if reference:
        print(f"{len(wrong)} of {len(found)} runs differ" + (": " + "; ".join(wrong) if wrong else ""))
        options.failed = bool(wrong)
    return found


if __name__ == "__main__":
    main(
        __doc__ or "",
        {
            bits: [
                quick("minutes in place of quarters of an hour"),
                flag(
                    "--against",
                    metavar="COMMIT",
                    help="compare with this commit, or with the hashes of a JSON file; exit code 1 where any differ",
                ),
                flag("--only", default="", help="runs whose name holds this"),
                flag("--recordings", action="store_true", help="recordings, too (NAVFILTER_DATA)"),
                flag("--library", default="", metavar="VEHICLES", help="all faults of these vehicles, too"),
                flag("--strict", action="store_true", help="stop at an exception"),
            ]
        },
    )
