"""A campaign: seeds -> missions -> one run per model -> results, on all cores or on a cluster, continued where it was
stopped.

A job is one seed: its mission is simulated once and replayed with every model, so that models are compared on the same
missions. What a job returns depends on nothing but the settings, the seed and the model; which process does it does not
matter.

The folder of a campaign: one small file per run and model, written whole or not at all, and told apart from other
campaigns.
"""

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.evaluation.baselines import fitted_kinds, replay_rival, rivals
from navfilter.evaluation.montecarlo.scores import TRACKS, curve_times, run_record
from navfilter.evaluation.montecarlo.slots import Slots, slots
from navfilter.foundation.arrays import AnyArray
from navfilter.models.mission import Mission
from navfilter.playback.replay import replay, replay_heard
from navfilter.simulation.scenarios import Staged, stage
from navfilter.track.track import Track

Record = dict[str, AnyArray]


def fingerprint(settings: Mapping[str, Any]) -> str:
    """Short digest of the settings of a campaign; equal settings, equal digest."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that is there whole or not at all, whatever kills the program."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(part, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


class Store:
    """Finished runs of one campaign.

    Parameters
    ----------
    folder : path
        Made when it is not there.
    settings : dict
        Everything that the numbers depend on, but for seed and model; kept in ``campaign.json``.

    Raises
    ------
    ValueError
        When the folder holds the runs of a campaign with other settings: which ones differ.
    """

    def __init__(self, folder: str | Path, settings: Mapping[str, Any]) -> None:
        self.folder = Path(folder)
        self.fingerprint = fingerprint(settings)
        self._runs = self.folder / "runs"
        self._runs.mkdir(parents=True, exist_ok=True)
        plan = self.folder / "campaign.json"
        if plan.exists():
            _compare(plan, settings)
        else:
            write_whole(plan, json.dumps(dict(settings), indent=1).encode())

    def path(self, seed: int, model: str) -> Path:
        """Where the run of this seed and model is kept."""
        return self._runs / model / f"{seed:08d}.npz"

    def save(self, seed: int, model: str, record: Record) -> None:
        """Keep a finished run."""
        path = self.path(seed, model)
        path.parent.mkdir(exist_ok=True)
        buffer = io.BytesIO()
        whole: Any = record | {"fingerprint": np.array(self.fingerprint), "checksum": np.array(_checksum(record))}
        np.savez_compressed(buffer, **whole)
        write_whole(path, buffer.getvalue())

    def load(self, seed: int, model: str) -> Record | None:
        """A finished run, or None when it is not there, damaged, or of other settings: then it has to be run again."""
        try:
            with np.load(self.path(seed, model), allow_pickle=False) as file:
                record = {name: file[name] for name in file.files}
            mark, checksum = str(record.pop("fingerprint")), str(record.pop("checksum"))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None
        return record if mark == self.fingerprint and checksum == _checksum(record) else None


def _checksum(record: Record) -> str:
    digest = hashlib.sha256()
    for name in sorted(record):
        array = np.ascontiguousarray(record[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def _compare(plan: Path, settings: Mapping[str, Any]) -> None:
    try:
        there = json.loads(plan.read_text())
        keys = sorted({*there, *settings})
    except (ValueError, TypeError):
        raise ValueError(
            f"{plan} is damaged. Delete the folder {plan.parent}, or choose another one with --out."
        ) from None
    other = [
        f"{key} {there.get(key)!r} there, {settings.get(key)!r} here"
        for key in keys
        if there.get(key) != settings.get(key)
    ]
    if other:
        raise ValueError(
            f"{plan.parent} holds the runs of a campaign with other settings ({'; '.join(other)}). "
            "Choose another folder with --out, or delete that one."
        )


@dataclass(frozen=True)
class Campaign:
    """Everything that the numbers of a campaign depend on, but for seeds and models.

    Parameters
    ----------
    scenario : str
        Key of `navfilter.simulation.scenarios.STUDIES`.
    motion, gyro : str
        See `navfilter.simulation.scenarios.stage`.
    duration_s : float, optional
        Default: that of the scenario.
    score_from_s : float, optional
        Time from which runs are scored. Default: one window of the learner (500 s at 8 Hz), a third of a mission that
        is not even three windows long.
    smooth : bool
        Whether the smoother runs too.
    imu_rate_hz : float
    """

    scenario: str
    motion: str = "lawnmower"
    gyro: str = "tactical"
    duration_s: float | None = None
    score_from_s: float | None = None
    smooth: bool = True
    imu_rate_hz: float = 100.0

    def __post_init__(self) -> None:
        staged = stage(
            self.scenario, motion=self.motion, gyro=self.gyro, duration_s=self.duration_s, imu_rate_hz=self.imu_rate_hz
        )
        scenario, motion, gyro = staged.name.split("/")
        score_from_s = self.score_from_s
        if score_from_s is None:
            score_from_s = min(staged.window_s, staged.duration_s / 3.0)
        if not 0.0 <= score_from_s < staged.duration_s:
            raise ValueError(
                f"scoring must start within the mission of {staged.duration_s:g} s, found {score_from_s:g} s."
            )
        whole = {"scenario": scenario, "motion": motion, "gyro": gyro, "duration_s": staged.duration_s}
        for key, value in (whole | {"score_from_s": float(score_from_s)}).items():
            object.__setattr__(self, key, value)

    @property
    def name(self) -> str:
        """Scenario, motion and gyro."""
        return f"{self.scenario}/{self.motion}/{self.gyro}"

    @property
    def staged(self) -> Staged:
        """The scenario, made ready."""
        return _staged(self)

    @property
    def slots(self) -> Slots:
        """Parts of the mission that are scored apart."""
        return slots(float(self.duration_s or 0.0), self.staged.changes_s)

    @property
    def settings(self) -> dict[str, Any]:
        """As they stand in ``campaign.json``, the state of the program included."""
        return {**asdict(self), "program": program()}


@cache
def _staged(campaign: Campaign) -> Staged:
    return stage(
        campaign.scenario,
        motion=campaign.motion,
        gyro=campaign.gyro,
        duration_s=campaign.duration_s,
        imu_rate_hz=campaign.imu_rate_hz,
    )


@cache
def program() -> str:
    """Version, and a digest of the source that runs depend on: runs of a changed program must not be mixed with older
    ones.
    """
    root = Path(__file__).parents[2]
    aside = {"commands", "report", "rendering", "check", "io", "identification", "service"}
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        place = path.relative_to(root)
        if place.parts[0] not in aside:
            digest.update(place.as_posix().encode() + b"\0" + path.read_bytes())
    return f"{version('navfilter')} {digest.hexdigest()[:12]}"


def run_seed(campaign: Campaign, seed: int, models: Sequence[str]) -> dict[str, Record]:
    """Simulate the mission of one seed and run every model on it.

    Parameters
    ----------
    campaign : Campaign
    seed : int
    models : sequence of str
        See `navfilter.evaluation.baselines`.

    Returns
    -------
    dict of str to dict of str to ndarray
        By model, see `navfilter.evaluation.montecarlo.scores.run_record`.
    """
    staged, records = campaign.staged, {}
    mission = staged.mission(seed)
    for model, track in _tracks(campaign, staged, mission, models):
        records[model] = run_record(track, mission, staged.learnt, float(campaign.score_from_s or 0.0), campaign.slots)
    return {model: records[model] for model in models}


def _tracks(campaign: Campaign, staged: Staged, mission: Mission, models: Sequence[str]) -> Iterator[tuple[str, Track]]:
    """Runs with each model on the sensor under study; everything else as described, which for everything else is the
    truth.
    """
    how: dict[str, Any] = {"smooth": campaign.smooth, "output_rate_hz": 1.0}
    if "oracle" in models:
        if staged.oracle is None:
            raise ValueError(
                f'"oracle" needs one true model for the whole mission, but {staged.name} changes. Leave it out.'
            )
        # not a rival by sensors: the truth may be that of the gyro, or more than an error model
        yield "oracle", replay(staged.oracle, mission, **how)
    series, others = None, [model for model in models if model != "oracle"]
    if "vehicle" in others and fitted_kinds(others):
        # one run of the vehicle as described gives its track and the series that the others are fitted to
        track, series = replay_heard(staged.vehicle, mission, (staged.learnt,), **how)
        yield "vehicle", track
        others.remove("vehicle")
    vehicles = rivals(others, staged.vehicle, mission, sensors=(staged.learnt,), series=series)
    yield from (
        (model, replay_rival(model, vehicle, mission, (staged.learnt,), **how)) for model, vehicle in vehicles.items()
    )


@dataclass(frozen=True)
class Results:
    """All runs of a campaign.

    Attributes
    ----------
    campaign : Campaign
    models : tuple of str
    seeds : ndarray, shape (n,)
    scores : ndarray, shape (models, 2, n, len(SCORES))
        By track: forward, smoothed (NaN when it was not run).
    slots : ndarray, shape (models, 2, n, len(campaign.slots), len(SLOT_SCORES))
        The same apart, see `navfilter.evaluation.montecarlo.slots`.
    curves : ndarray of float32, shape (models, 2, n, len(CURVES), m)
    time_s : ndarray, shape (m,)
        Of the curves.
    cpu_s : ndarray, shape (models, n)
        Processor time of every run; the only figure that differs from one execution to the next.
    """

    campaign: Campaign
    models: tuple[str, ...]
    seeds: np.ndarray
    scores: np.ndarray
    slots: np.ndarray
    curves: np.ndarray
    time_s: np.ndarray
    cpu_s: np.ndarray

    @property
    def tracks(self) -> tuple[str, ...]:
        """Labels of the tracks that there are."""
        return TRACKS if self.campaign.smooth else TRACKS[:1]


def run_campaign(
    campaign: Campaign,
    seeds: Sequence[int],
    models: Sequence[str],
    folder: str | Path,
    executor: Executor | None = None,
    progress: Callable[[int], Any] | None = None,
) -> Results:
    """Run what is not yet in the folder, and collect everything.

    Parameters
    ----------
    campaign : Campaign
    seeds : sequence of int
        One mission each.
    models : sequence of str
        See `navfilter.evaluation.baselines`.
    folder : path
        Finished runs are kept there as they come; a campaign that was stopped continues from them.
    executor : concurrent.futures.Executor, optional
        See `navfilter.evaluation.montecarlo.workers`. Default: this process.
    progress : callable, optional
        Called with the number of runs finished, those found in the folder included.

    Returns
    -------
    Results

    Raises
    ------
    ValueError
        When the folder belongs to a campaign with other settings, or a run fails.
    ChildProcessError
        When a worker process dies.
    """
    store = Store(folder, campaign.settings)
    missing = {seed: [model for model in models if store.load(seed, model) is None] for seed in seeds}
    found = len(seeds) * len(models) - sum(map(len, missing.values()))
    if progress is not None and found:
        progress(found)
    for seed, records in _finished(campaign, {s: m for s, m in missing.items() if m}, executor):
        for model, record in records.items():
            store.save(seed, model, record)
        if progress is not None:
            progress(len(records))
    return collect(campaign, seeds, models, store)


def _finished(campaign: Campaign, jobs: dict[int, list[str]], executor: Executor | None) -> Iterator[tuple[int, Any]]:
    """Results of the jobs as they come."""
    if executor is None:
        yield from ((seed, run_seed(campaign, seed, models)) for seed, models in jobs.items())
        return
    futures: dict[Future[Any], int] = {
        executor.submit(run_seed, campaign, s, tuple(models)): s for s, models in jobs.items()
    }
    try:
        for future in as_completed(list(futures)):
            # popped, so that a finished job's curves do not stay in memory until the last one is done
            seed = futures.pop(future)
            yield seed, _result(future, seed)
    finally:
        for future in futures:
            future.cancel()


def _result(future: Future[Any], seed: int) -> Any:
    try:
        return future.result()
    except BrokenProcessPool:
        raise ChildProcessError(
            "a worker process died (was the memory used up?); finished runs are kept: run it again, perhaps with fewer "
            "workers"
        ) from None
    except ValueError as error:
        raise ValueError(f"the run of seed {seed} failed: {error}") from error


def collect(campaign: Campaign, seeds: Sequence[int], models: Sequence[str], store: Store) -> Results:
    """Read all the runs back from the folder."""
    records: list[list[Record]] = []
    for model in models:
        loaded = [store.load(seed, model) for seed in seeds]
        if any(record is None for record in loaded):
            raise ValueError(
                f"{store.folder} has lost runs of {model} since they were finished. Run the campaign again."
            )
        records.append([record for record in loaded if record is not None])
    stacked = {
        key: np.array([[record[key] for record in row] for row in records])
        for key in ("scores", "slots", "curves", "cpu_s")
    }
    scores, slots, curves = (np.swapaxes(stacked[key], 1, 2) for key in ("scores", "slots", "curves"))
    time_s = curve_times(float(campaign.duration_s or 0.0))
    return Results(campaign, tuple(models), np.array(seeds), scores, slots, curves, time_s, stacked["cpu_s"])
