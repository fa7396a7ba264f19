"""A campaign: seeds -> missions -> one run per model -> results, on all cores or on a cluster, continued where it was
stopped.

A job is one seed: its mission is simulated once and replayed with every model, so that models are compared on the same
missions. What a job returns depends on nothing but the settings, the seed and the model; which process does it does not
matter.

The folder of a campaign: one small file per run and model, written whole or not at all, and told apart from other
campaigns.

What a campaign says: figures with intervals over its runs, ratios between models, as text, CSV, JSON and npz.

Intervals over the runs of a campaign. Within a run the errors depend on each other; the runs do not.
"""

import hashlib
import io
import json
import math
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from navfilter.evaluation.baselines import fitted_kinds, replay_rival, rivals
from navfilter.evaluation.montecarlo.scores import CURVES, SCORES, TRACKS, curve_times, run_record
from navfilter.evaluation.montecarlo.slots import RMS, SLOT_SCORES, Slots, slots
from navfilter.foundation.arrays import AnyArray, Array, ArrayLike, Ints
from navfilter.foundation.atomic_files import replacing_binary
from navfilter.foundation.quoting import json_value
from navfilter.models.mission import Mission
from navfilter.playback.replay import replay, replay_heard
from navfilter.rendering.page import table_text
from navfilter.simulation.scenarios import Staged, stage
from navfilter.track.track import Track

Record = dict[str, AnyArray]


def fingerprint(settings: Mapping[str, Any]) -> str:
    """Short digest of the settings of a campaign; equal settings, equal digest."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that is there whole or not at all, whatever kills the program."""
    with replacing_binary(path, synced=True) as file:
        file.write(content)


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


#: Value, lower end, upper end.
Estimate = tuple[float, float, float]

RESAMPLES = 4000
#: All intervals hold 95 %.
_TAILS = (0.5 - 0.5 * 0.95, 0.5 + 0.5 * 0.95)
_NOTHING: Estimate = (math.nan, math.nan, math.nan)


def mean_interval(values: ArrayLike) -> Estimate:
    """Mean over runs with its interval by Student's t.

    Parameters
    ----------
    values : array_like, shape (n,)
        One per run; NaN is left out.

    Returns
    -------
    value, low, high : float
        No interval (NaN) for a single run.

    Examples
    --------
    >>> [round(v, 4) for v in mean_interval([1.0, 2.0, 3.0])]
    [2.0, -0.4841, 4.4841]
    """
    x = _finite(values)
    if x.size == 0:
        return _NOTHING
    mean = float(x.mean())
    if x.size == 1:
        return mean, math.nan, math.nan
    half = float(stats.t.ppf(_TAILS[1], x.size - 1) * x.std(ddof=1) / math.sqrt(x.size))
    return mean, mean - half, mean + half


def rms_interval(values: ArrayLike) -> Estimate:
    """Root mean square over runs of their root mean squares, with its percentile bootstrap interval (Efron &
    Tibshirani, 1993, ch. 13).
    """
    return ratio_interval(values, np.ones_like(values, dtype=np.float64))


def ratio_interval(values: ArrayLike, others: ArrayLike) -> Estimate:
    """Ratio of the root mean squares of two models over the same missions, resampled in pairs.

    Parameters
    ----------
    values, others : array_like, shape (n,)
        Of the model and of the one that it is compared with, run by run; a run that one of them lacks (NaN) is left
        out.

    Returns
    -------
    value, low, high : float

    Examples
    --------
    >>> ratio_interval([1.0, 2.0, 3.0], [2.0, 4.0, 6.0])
    (0.5, 0.5, 0.5)
    """
    a, b = np.asarray(values, dtype=np.float64), np.asarray(others, dtype=np.float64)
    if a.shape != b.shape:
        raise ValueError(f"the two models must have the same runs, found {a.shape} and {b.shape}.")
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both] ** 2, b[both] ** 2
    if a.size == 0 or not b.any():
        return _NOTHING
    value = math.sqrt(a.mean() / b.mean())
    if a.size == 1:
        return value, math.nan, math.nan
    pick = _resampled(a.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.sqrt(a[pick].mean(axis=1) / b[pick].mean(axis=1))
    low, high = np.quantile(ratios, _TAILS)
    return value, float(low), float(high)


def share_interval(values: ArrayLike) -> Estimate:
    """Share of the runs for which something holds (1, not 0), with Wilson's interval (1927).

    Examples
    --------
    >>> [round(v, 4) for v in share_interval([1, 1, 1, 0])]
    [0.75, 0.3006, 0.9544]
    """
    x = _finite(values)
    if x.size == 0:
        return _NOTHING
    n, p, z = x.size, float(x.mean()), float(stats.norm.ppf(_TAILS[1]))
    centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return p, max(centre - half, 0.0), min(centre + half, 1.0)


def estimate(quantity: str, values: ArrayLike) -> Estimate:
    """A figure of a campaign by its kind: a root mean square, a share of the runs, or a mean."""
    if "rms" in quantity or quantity == "end_m":
        return rms_interval(values)
    if quantity in ("white", "adopted"):
        return share_interval(values)
    value, low, high = mean_interval(values)
    # with few runs Student's interval does not know that no figure is negative, and that no share is more than all
    most = 1.0 if quantity.startswith("beyond") else math.inf
    return value, max(low, 0.0) if math.isfinite(low) else low, min(high, most) if math.isfinite(high) else high


def interval_text(value: float, low: float = math.nan, high: float = math.nan, form: str = ".3f") -> str:
    """A value with its interval, as far as there are any.

    Examples
    --------
    >>> interval_text(1.0, 0.5, 2.0, ".1f"), interval_text(1.0), interval_text(math.nan)
    ('1.0 (0.5..2.0)', '1.000', '-')
    """
    if not math.isfinite(value):
        return "-"
    return format(value, form) + (f" ({format(low, form)}..{format(high, form)})" if math.isfinite(low) else "")


def _finite(values: ArrayLike) -> Array:
    x = np.asarray(values, dtype=np.float64).ravel()
    return x[np.isfinite(x)]


def _resampled(n: int) -> Ints:
    """Rows of resampled runs; the same ones every time, so that a table can be made again."""
    return np.random.default_rng(20030501).integers(0, n, size=(RESAMPLES, n))


#: What is divided by that of other models, and by which.
_DIVIDED = ("heading_rms_deg", "position_rms_m")
REFERENCES: dict[str, tuple[str, ...]] = {"gm1-fitted": _DIVIDED, "oracle": _DIVIDED}
_MAIN = {
    "heading_rms_deg": ("heading rms [deg]", ".4f"),
    "position_rms_m": ("position rms [m]", ".2f"),
    "end_m": ("end of dive [m]", ".2f"),
    "end_pct": ("[% of way]", ".3f"),
    "anees_position": ("ANEES position", ".2f"),
    "anees_heading": ("ANEES heading", ".2f"),
}
_INNOVATIONS = {
    "nis_sensor": ("NIS", ".3f"),
    "nis_all": ("NIS of all sensors", ".3f"),
    "white": ("white", ".0%"),
    "ljung_box": ("Ljung-Box/dof", ".1f"),
    "rejected_pct": ("rejected [%]", ".2f"),
    "adopted": ("runs with adoptions", ".0%"),
    "adoptions": ("adoptions", ".1f"),
}
#: By reference: what is divided by its own.
_SLOT_RATIOS = {
    "oracle": tuple(name for name in SLOT_SCORES if not name.startswith("beyond")),
    "gm1-fitted": tuple(name for name in SLOT_SCORES if "_rms_" in name),
    "vehicle": tuple(name for name in SLOT_SCORES if "_rms_" in name),
}
#: By figure: the columns of its table, as (quantity, reference, title, format, factor).
_TABLES = {
    what: (
        (rms, "", f"rms [{unit}]", form, 1.0),
        *((rms, name, f"/ {name}", ".3f", 1.0) for name in _SLOT_RATIOS),
        (f"anees_{what}", "", "ANEES", ".2f", 1.0),
        (f"anees_{what}", "oracle", "/ oracle's", ".2f", 1.0),
        (f"beyond_{what}", "", "beyond 3 sigma [%]", ".2f", 100.0),
    )
    for what, rms, unit, form in (
        ("heading", "heading_rms_deg", "deg", ".4f"),
        ("position", "position_rms_m", "m", ".3f"),
    )
}


@dataclass(frozen=True)
class SlotRow:
    """One figure of one model in one slot, with its 95 % interval over the runs.

    Attributes
    ----------
    model, track : str
    begin_s, end_s : float
        The slot; the last one is all of them together. NaN: what is scored of the whole run.
    quantity : str
        One of `navfilter.evaluation.montecarlo.slots.SLOT_SCORES`, or of the whole run of `SCORES`.
    reference : str
        Of a ratio: the model that is divided by, on the same missions; else empty.
    value, low, high : float
        NaN where there is none.
    runs : int
        That it rests on.
    """

    model: str
    track: str
    begin_s: float
    end_s: float
    quantity: str
    reference: str
    value: float
    low: float
    high: float
    runs: int


#: By reference, track, quantity and model.
_Found = dict[tuple[str, str, str, str], SlotRow]


def rows(results: Results) -> list[SlotRow]:
    """All figures of all models and tracks, and their ratios to those of the references."""
    return [
        SlotRow(model, track, math.nan, math.nan, *figure)
        for m, model in enumerate(results.models)
        for t, track in enumerate(results.tracks)
        for figure in figures(results.models, results.scores[:, t], m, SCORES, REFERENCES)
    ]


def table(results: Results) -> str:
    """Everything that is worth reading on a terminal."""
    campaign, found = results.campaign, {(r.reference, r.track, r.quantity, r.model): r for r in rows(results)}
    study, learnt = campaign.staged.study, campaign.staged.learnt
    begin, end = float(campaign.score_from_s or 0.0), float(campaign.duration_s or 0.0)
    parts = [
        f"{campaign.name}: {study.sensor} - {study.about}\n{len(results.seeds)} runs (seeds {results.seeds[0]} to "
        f"{results.seeds[-1]}), {end:g} s each, scored from {begin:g} s; 95 % intervals over the runs."
    ]
    for track in results.tracks:
        parts.append(f"{track}\n{_block(results.models, track, _MAIN, found)}")
    parts.append(f"innovations of {learnt}, forward\n{_block(results.models, 'forward', _INNOVATIONS, found)}")
    for reference in REFERENCES:
        others = [model for model in results.models if model != reference]
        if others and reference in results.models:
            ratios = _ratio_block(others, reference, results.tracks, found)
            parts.append(f"divided by {reference} on the same missions\n{ratios}")
    apart = slot_rows(results)
    if apart:
        parts.append(slot_table(results, apart))
    return "\n\n".join(parts)


def _block(models: Iterable[str], track: str, columns: dict[str, tuple[str, str]], found: _Found) -> str:
    lines = [
        [model, *(_cell(found.get(("", track, key, model)), form) for key, (_, form) in columns.items())]
        for model in models
    ]
    return table_text(["model", *(title for title, _ in columns.values())], lines)


def _ratio_block(models: Iterable[str], reference: str, tracks: Iterable[str], found: _Found) -> str:
    keys = [(track, quantity) for quantity in _DIVIDED for track in tracks]
    header = ["model", *(f"{quantity.split('_')[0]} rms, {track}" for track, quantity in keys)]
    lines = [[model, *(_cell(found.get((reference, *key, model)), ".3f") for key in keys)] for model in models]
    return table_text(header, lines)


def _cell(row: SlotRow | None, form: str) -> str:
    return "-" if row is None else interval_text(row.value, row.low, row.high, form)


def write_tables(results: Results, folder: Path) -> list[str]:
    """Write table.txt, results.csv, slots.csv, results.json and runs.npz; returns the names."""
    names = ("model", "track", "quantity", "reference", "value", "low", "high", "runs")
    found = [{name: row[name] for name in names} for row in map(_dict, rows(results))]
    content = {
        "campaign": results.campaign.settings,
        "models": list(results.models),
        "seeds": results.seeds.tolist(),
        "results": found,
        "slots": [_dict(row) for row in slot_rows(results)],
    }
    write_whole(folder / "table.txt", (table(results) + "\n").encode())
    write_whole(folder / "results.csv", _csv(found, names))
    write_whole(folder / "slots.csv", _csv(content["slots"], [field.name for field in fields(SlotRow)]))
    write_whole(folder / "results.json", (json.dumps(content, indent=1) + "\n").encode())
    write_whole(folder / "runs.npz", _npz(results))
    return ["table.txt", "results.csv", "slots.csv", "results.json", "runs.npz"]


def _dict(row: SlotRow) -> dict[str, Any]:
    return {key: json_value(value) for key, value in asdict(row).items()}


def _csv(found: list[dict[str, Any]], columns: Sequence[str]) -> bytes:
    text: str = pd.DataFrame(found, columns=columns, dtype=object).to_csv(index=False, lineterminator="\n")
    return text.encode()


def _npz(results: Results) -> bytes:
    buffer, n = io.BytesIO(), len(results.tracks)
    np.savez_compressed(
        buffer,
        models=np.array(results.models),
        tracks=np.array(results.tracks),
        score_names=np.array(SCORES),
        slot_score_names=np.array(SLOT_SCORES),
        curve_names=np.array(CURVES),
        time_s=results.time_s,
        slot_times_s=np.array(results.campaign.slots).reshape(-1, 2),
        seeds=results.seeds,
        scores=results.scores[:, :n],
        slots=results.slots[:, :n],
        curves=results.curves[:, :n],
        cpu_s=results.cpu_s,
    )
    return buffer.getvalue()


# --- slot by slot -----------------------------------------------------------------------------------------------------


def slot_rows(results: Results) -> list[SlotRow]:
    """All figures of all models, tracks and slots, and those of all slots together."""
    cut, values = _with_all(results)
    found = []
    for m, model in enumerate(results.models):
        for t, track in enumerate(results.tracks):
            for s, (begin, end) in enumerate(cut):
                for figure in figures(results.models, values[:, t, :, s], m, SLOT_SCORES, _SLOT_RATIOS):
                    found.append(SlotRow(model, track, begin, end, *figure))
    return found


def _with_all(results: Results) -> tuple[Slots, Array]:
    """Slots and figures of the runs, all slots together as one more."""
    cut, values = results.campaign.slots, results.slots
    if not cut:
        return cut, values
    weights = np.diff(np.array(cut), axis=1)
    power = values ** np.where(np.char.find(SLOT_SCORES, "rms") >= 0, 2.0, 1.0)
    known = np.isfinite(power) * weights
    with np.errstate(divide="ignore", invalid="ignore"):
        together = np.nansum(power * weights, axis=-2) / known.sum(axis=-2)
    together[..., RMS] = np.sqrt(together[..., RMS])
    return (*cut, (cut[0][0], cut[-1][1])), np.concatenate([values, together[..., None, :]], axis=-2)


def figures(
    models: tuple[str, ...], values: Array, m: int, names: tuple[str, ...], ratios: dict[str, tuple[str, ...]]
) -> Iterator[tuple[str, str, float, float, float, int]]:
    """Figures of one model over its runs, and their ratios to those of the references on the same missions.

    Parameters
    ----------
    models : tuple of str
    values : ndarray, shape (models, runs, figures)
    m : int
        Which model.
    names : tuple of str
        Of the figures.
    ratios : dict of str to tuple of str
        By reference: what is divided by its own.

    Yields
    ------
    quantity, reference, value, low, high, runs
        As in `SlotRow`.
    """
    for q, quantity in enumerate(names):
        own = values[m, :, q]
        if not np.isfinite(own).any():
            continue
        yield quantity, "", *estimate(quantity, own), int(np.isfinite(own).sum())
        for reference, compared in ratios.items():
            if quantity in compared and reference in models and reference != models[m]:
                other = values[models.index(reference), :, q]
                yield quantity, reference, *_ratio(quantity, own, other), int(np.isfinite(own + other).sum())


def _ratio(quantity: str, values: Array, others: Array) -> Estimate:
    """Of root mean squares, or of means."""
    if "rms" in quantity:
        return ratio_interval(values, others)
    value, low, high = ratio_interval(np.sqrt(values), np.sqrt(others))
    return value**2, low**2, high**2


def named(begin_s: float, end_s: float) -> str:
    """A slot as it stands in tables."""
    return f"{begin_s:g}-{end_s:g} s"


def slot_table(results: Results, found: Iterable[SlotRow]) -> str:
    """Tables of heading and position by slots, for every track."""
    by = {(r.track, r.begin_s, r.end_s, r.model, r.quantity, r.reference): r.value for r in found}
    cut, parts = list(dict.fromkeys((r.begin_s, r.end_s) for r in found)), []
    for track in results.tracks:
        for what, columns in _TABLES.items():
            there = [c for c in columns if not c[1] or (c[1] in results.models and len(results.models) > 1)]
            lines = []
            for slot in cut:
                for model in results.models:
                    of = (track, *slot, model)
                    values = (
                        factor * by.get((*of, key, reference), math.nan) for key, reference, _, _, factor in there
                    )
                    cells = (interval_text(value, form=c[3]) for value, c in zip(values, there, strict=True))
                    lines.append([named(*slot), model, *cells])
            header = ["slot", "model", *(title for _, _, title, _, _ in there)]
            parts.append(f"{what} by slots, {track}\n{table_text(header, lines)}")
    return "\n\n".join(parts)
