"""What one stream shows by itself: rate, gaps, repeated stamps, bursts, missing and held values, quantisation."""

import math
import statistics
from collections.abc import Iterator
from typing import Any

import numpy as np

from navfilter.check.finding import Finding, Severity
from navfilter.foundation.display import counted
from navfilter.models.mission import Array, Mission, Stream
from navfilter.models.state import wrap

#: No sensor of navigation gives readings in shorter steps [s] (chosen: a second is 1.2e-5 days, 1e-3 of it is of a fast
#: inertial unit).
_FASTEST_S = 5e-5
#: Readings that were buffered come faster than this one after the other [s].
_EMPTYING_S = 0.05
#: A number that stands for no reading comes so often, and lies so many times farther from its neighbours than most of
#: the others (that share) do; it is looked for among so many that come most often; the others are such a share.
_SENTINELS, _FAR, _USUAL, _MARKS, _LEAST_OTHERS = 5, 5.0, 0.99, 3, 0.05
#: Of changes of readings that are coarse, not held, so many come right after another [1].
_AT_ONCE = 0.2


def stream_findings(name: str, stream: Stream, mission: Mission) -> Iterator[Finding]:
    """Findings about one stream alone."""
    if len(stream) < 2:
        cure = "Check the file and the sentinels in the mission.toml."
        yield Finding("error", "few", name, f"only {counted(len(stream), 'readings')}.", cure)
        return
    yield from _timing(name, stream, mission)
    yield from _values(name, stream)


def _timing(name: str, stream: Stream, mission: Mission) -> Iterator[Finding]:
    step = np.diff(stream.time_s)
    moving = step[step > 0.0]
    if not moving.size:
        cure = "Check the time column and its unit."
        yield Finding("error", "stamps", name, "all readings have the same time.", cure)
        return
    usual = float(np.median(moving))
    span = stream.time_s[-1] - stream.time_s[0]
    mean_rate = (len(stream) - 1) / span
    if mean_rate * _FASTEST_S > 1.0:
        text = f"{mean_rate:.4g} readings in a second: nothing measures so often."
        cure = "In which unit are its times: day, h, min? Say it in time: unit."
        yield Finding("error", "clock-unit", name, text, cure)
    text = f"{len(stream)} readings from {stream.time_s[0]:.2f} to {stream.time_s[-1]:.2f} s, {mean_rate:.4g} Hz"
    yield Finding("info", "rate", name, f"{text} (usual step {usual:.4g} s).")
    repeated = int(np.count_nonzero(step == 0.0))
    if repeated:
        cure = "The navigator counts them as duplicates; drop them if the values are equal too."
        coarse = repeated > 0.8 * len(step)
        if coarse:
            cure = "The stamps are too coarse: export them with their fractions, or ends_only = true in time."
        text = f"{counted(repeated, 'readings')} with the time of the one before."
        yield Finding("error" if coarse else "warning", "stamps", name, text, cure)
    gaps = step > 5.0 * usual
    if gaps.any():
        worst = int(np.argmax(step))
        text = f"{counted(int(gaps.sum()), 'gaps')}, the longest {step[worst]:.3g} s at {stream.time_s[worst]:.2f} s."
        # fixes are not to be had under water
        grave: Severity = "warning" if step[worst] > 20.0 * usual and "latitude_rad" not in stream.columns else "info"
        cure = "The filter carries on without; check that nothing was lost on the way."
        yield Finding(grave, "gap", name, text, cure)
    ratio = moving[(moving > 1.5 * usual) & (moving <= 5.0 * usual)] / usual
    if usual > 0.0 and ratio.size and float(np.mean(np.abs(ratio - np.round(ratio)) < 0.1)) > 0.9:
        lost = int(np.sum(np.round(ratio) - 1.0))
        text = f"about {lost} readings are missing here and there, of {len(stream) + lost}."
        yield Finding("info", "gap", name, text)
    # Bursts: many steps far shorter and far longer than the mean step, as stamps of reception have.
    mean = span / (len(stream) - 1)
    bursty = float(np.mean((step < 0.3 * mean) | (step > 2.0 * mean)))
    if bursty > 0.1 and not _even(moving[moving <= mean]):
        text = (
            f"{100 * bursty:.0f} % of the steps are far from the mean of {mean:.4g} s: stamps of reception, in bursts?"
        )
        yield Finding("warning", "stamps", name, text, "If the sensor has an even rate, set time.ends_only = true.")
    late = stream.time_s[0] - mission.begin_s
    if late > max(10.0 * usual, 5.0):
        yield Finding("info", "span", name, f"starts {late:.1f} s after the first stream.")
    early = _others_end_s(name, mission) - stream.time_s[-1]
    if early > max(10.0 * usual, 5.0):
        severity: Severity = "warning" if early > 20.0 * usual and "latitude_rad" not in stream.columns else "info"
        cure = "Was its file cut, or did it fail? What it holds is not held from then on."
        yield Finding(severity, "span", name, f"ends {early:.1f} s before the others.", cure)


def _others_end_s(name: str, mission: Mission) -> float:
    """When most of the other streams end [s], fixes apart, which are not to be had under water; NaN where there are
    none. Of one whose clock runs too fast, not all others end early.
    """
    others = [s for other, s in mission.streams.items() if other != name and len(s) and "latitude_rad" not in s.columns]
    return statistics.median_low(float(s.time_s[-1]) for s in others) if others else math.nan


def _even(step: Array) -> bool:
    """Whether steps within bursts are those of an even sensor with gaps between, not of a buffer that is emptied."""
    if not step.size:
        return False
    low, usual, high = np.quantile(step, [0.1, 0.5, 0.9])
    return bool(usual > _EMPTYING_S and high - low < 0.2 * usual)


def _values(name: str, stream: Stream) -> Iterator[Finding]:
    missing = float(np.mean(np.isnan(stream.value).any(axis=1)))
    whole: Any = np.isnan(stream.value).all(axis=0)
    if whole.all():
        cure = "Check the columns, the sentinels and valid_range."
        yield Finding("error", "empty", name, "no reading has a value.", cure)
        return
    if missing and not whole.any():
        yield Finding("info", "empty", name, f"{100 * missing:.1f} % of the readings are invalid or incomplete.")
    measured = [k for k in range(stream.value.shape[1]) if not whole[k] and np.nanstd(stream.value[:, k]) > 0.0]
    if not measured and not stream.value.any():
        text = "every value is 0: a stand-in for what was not measured, or a sensor that is dead."
        yield Finding("info", "empty", name, text)
        return
    if not measured:
        cure = "A sensor that is stuck, or the wrong columns."
        yield Finding("warning", "stuck", name, "no value ever changes.", cure)
        return
    values = stream.value[:, measured]
    held = float(np.mean((np.diff(values, axis=0) == 0.0).all(axis=1)))
    if held > 0.5 and not _is_coarse(values):
        text = f"{100 * held:.0f} % of the readings repeat the one before: a slower sensor, held?"
        cure = "If so, set only_changes = true, or the filter takes old news for new."
        yield Finding("warning", "held", name, text, cure)
    yield from _sentinel(name, stream, measured)
    for k in measured:
        yield from _quantisation(name, stream.columns[k], stream.value[:, k])


def _is_coarse(values: Array) -> bool:
    """Whether readings repeat because their steps are coarse: most changes are of one step, and many come at once after
    another, which those of a slower sensor, held, never do.
    """
    changes = np.abs(np.diff(values, axis=0))
    step = np.min(changes, axis=0, initial=np.inf, where=changes > 1e-9 * np.nanmax(np.abs(values)))
    changed = np.flatnonzero((changes > 0.0).any(axis=1))
    if changed.size < 2:
        return False
    return bool(np.mean(changes[changed] < 1.5 * step) > 0.5 and np.mean(np.diff(changed) == 1) > _AT_ONCE)


def _sentinel(name: str, stream: Stream, measured: list[int]) -> Iterator[Finding]:
    """A number that readings without a value have: it comes again and again, and is far from the readings beside it."""
    for k in measured:
        column, values = stream.columns[k], stream.value[:, k]
        known = values[np.isfinite(values)]
        levels, counts = np.unique(known, return_counts=True)
        often = [j for j in np.argsort(counts, kind="stable")[-_MARKS:].tolist() if counts[j] >= _SENTINELS]
        marks = [j for j in often if _is_mark(known, levels[j], column)]
        if marks:
            mark, count = levels[marks[-1]], counts[marks[-1]]
            shown = f"{np.degrees(mark):.6g} deg" if column.endswith("_rad") else f"{mark:.6g}"
            text = f"{count} readings of {column} are exactly {shown}, far from those beside them:"
            text += " a mark for no reading?"
            cure = "If so, name it in invalid = [...] of its columns, in the unit of the file."
            yield Finding("warning", "mark", name, text, cure)
            return


def _is_mark(known: Array, mark: float, column: str) -> bool:
    """Whether readings of this number are farther from those beside them than others are from one another."""
    marked = known == mark
    others, at = known[~marked], np.flatnonzero(~marked)
    if others.size < _SENTINELS or others.size < _LEAST_OTHERS * known.size:
        return False

    def size(step: Array) -> Array:
        return np.abs(wrap(step) if column.endswith("_rad") else step)

    visits = int(np.count_nonzero(np.diff(marked.astype(np.int8)) > 0)) + int(marked[0])
    if visits < _SENTINELS:  # it stays there: so do sensors at rest, unless it is beyond all that they read
        return bool(abs(mark) > _FAR * np.max(np.abs(others)))
    beside = np.searchsorted(at, np.flatnonzero(marked))
    before, after = (others[np.clip(beside - d, 0, others.size - 1)] for d in (1, 0))
    off = np.minimum(size(mark - before), size(mark - after))
    changes = size(np.diff(others))
    changes = changes[changes > 0.0]  # of held readings most are none
    return changes.size > 0 and bool(np.median(off) > _FAR * np.quantile(changes, _USUAL))


def _quantisation(name: str, column: str, values: Array) -> Iterator[Finding]:
    known = values[np.isfinite(values)]
    levels = np.unique(known)
    step = np.diff(levels)
    # Rounding of decimal text makes steps of 1e-16; a quantum is a step that many levels share.
    step = step[step > 1e-9 * max(float(np.abs(levels).max()), 1e-12)]
    if step.size < 2 or levels.size > 0.5 * known.size:
        return
    quantum = float(np.quantile(step, 0.1))
    noise = float(np.std(np.diff(known))) / np.sqrt(2.0)
    if quantum > 0.8 * noise:
        text = f"{column} is quantised in steps of {quantum:.3g}, {levels.size} levels in all."
        cure = f"Its error is at least {quantum / np.sqrt(12.0):.2g} (step / sqrt 12)."
        yield Finding("info", "quantised", name, text, cure)
