"""How good a track is where no truth is known: what returning fixes say, and what the smoother changed."""

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import gammaincc

from navfilter.filter.records import OUTCOMES
from navfilter.foundation.chi_square import chi_square_limit
from navfilter.track.track import Track

#: A time without fixes is an outage when it is longer than this [s], and than so many of their usual steps.
OUTAGE_S, OUTAGE_STEPS = 30.0, 5.0


@dataclass(frozen=True)
class Surfacing:
    """The first fix after a time without, against what was predicted for it.

    Attributes
    ----------
    sensor : str
    time_s : float
        Of the fix [s].
    without_s : float
        Since the fix before, or since the start of the run [s].
    distance_m : float
        Travelled since then [m].
    error_m : float
        Horizontal distance of the fix from its prediction [m].
    sd_m : float
        Predicted rms of that distance [m], the error of the fix included.
    inside : bool
        Whether the fix lies where 95 % of such fixes should (NIS against chi-square).
    used : bool
        False: the gate rejected it.
    chance : float
        Probability of one so far off, by NIS.
    """

    sensor: str
    time_s: float
    without_s: float
    distance_m: float
    error_m: float
    sd_m: float
    inside: bool
    used: bool
    chance: float = math.nan

    @property
    def percent(self) -> float:
        """The error in per cent of the distance travelled; NaN at a standstill."""
        return 100.0 * self.error_m / self.distance_m if self.distance_m > 0.0 else math.nan

    def __str__(self) -> str:
        # of less than it is off, a share says nothing
        share = f", {self.percent:.2f} % of {self.distance_m:.0f} m" if self.percent < 100.0 else ""
        where = "inside the 95 % range" if self.inside else "outside the 95 % range"
        return (
            f"{self.sensor} at {self.time_s:.0f} s, after {self.without_s:.0f} s without: {self.error_m:.2f} m "
            f"off{share}; predicted sd {self.sd_m:.2f} m, {where}{'' if self.used else ', rejected'}"
        )


@dataclass(frozen=True)
class Outage:
    """The longest time without a fix.

    Attributes
    ----------
    begin_s, end_s : float
        [s].
    drift_m : float or None
        Error that the fix at its end found [m]; None where the run ended without one.
    sd_m : float
        Predicted rms of the horizontal position at its end [m].
    """

    begin_s: float
    end_s: float
    drift_m: float | None
    sd_m: float


@dataclass(frozen=True)
class Separation:
    """Horizontal distance between the forward and the smoothed track.

    Attributes
    ----------
    rms_m, most_m : float
    most_s : float
        Time of the largest one [s].
    sd_most_m : float
        Largest predicted rms of the smoothed horizontal position [m].
    predicted_m : float
        Rms that the covariances predict: the difference of an honest pair has the covariance P_forward - P_smoothed.
    """

    rms_m: float
    most_m: float
    most_s: float
    sd_most_m: float
    predicted_m: float


@dataclass(frozen=True)
class Evidence:
    """What a run says of its own quality.

    Attributes
    ----------
    surfacings : tuple of Surfacing
    outage : Outage or None
        None where no time without fixes was long enough to be one.
    sd_end_m, sd_most_m, sd_most_s : float
        Predicted rms of the forward run's horizontal position [m]: at the end, the largest, and when [s].
    separation : Separation or None
        None without a smoothed track.
    """

    surfacings: tuple[Surfacing, ...]
    outage: Outage | None
    sd_end_m: float
    sd_most_m: float
    sd_most_s: float
    separation: Separation | None

    def to_dict(self) -> dict[str, Any]:
        """The same as plain values, as it stands in ``summary.json``."""
        plain = dataclasses.asdict(self)
        for entry, found in zip(plain["surfacings"], self.surfacings, strict=True):
            entry["percent"] = found.percent
        return plain

    def lines(self, most: int = 5) -> Iterator[str]:
        """The same in words, one line per fact; of many surfacings the worst `most`, in the order of their times."""
        if self.outage is not None:
            o = self.outage
            drift = "no fix ended it" if o.drift_m is None else f"{o.drift_m:.2f} m of drift found by the next fix"
            length = f"{o.end_s - o.begin_s:.0f} s ({o.begin_s:.0f} to {o.end_s:.0f} s)"
            yield f"longest time without a fix: {length}, {drift}; predicted sd {o.sd_m:.2f} m"
        worst = sorted(self.surfacings, key=lambda s: s.error_m / max(s.sd_m, 1e-9))[-most:]
        yield from (f"surfacing: {found}" for found in sorted(worst, key=lambda s: s.time_s))
        if len(self.surfacings) > most:
            inside = sum(s.inside for s in self.surfacings)
            yield f"surfacings: {len(self.surfacings)} (above the worst {most}), {inside} inside the 95 % range"
        yield (
            f"predicted sd of the horizontal position: {self.sd_end_m:.2f} m at the end, "
            f"{self.sd_most_m:.2f} m at most (at {self.sd_most_s:.0f} s)"
            f"{'' if self.separation is None else f', {self.separation.sd_most_m:.2f} m at most when smoothed'}"
        )
        if self.separation is not None:
            s = self.separation
            yield (
                f"forward and smoothed track differ by {s.rms_m:.2f} m rms (predicted {s.predicted_m:.2f} m), "
                f"{s.most_m:.2f} m at most (at {s.most_s:.0f} s)"
            )


def evidence(track: Track) -> Evidence:
    """Judge a run by itself: by its fixes, its covariance and its smoothed track, without a truth.

    Parameters
    ----------
    track : Track
        Surfacings, outage and predicted sd are those of its forward run.
    """
    run = track.forward or track
    predicted = run.horizontal_sd()
    worst = int(np.argmax(predicted))
    found = surfacings(track)
    return Evidence(
        surfacings=found,
        outage=_longest_outage(track, found),
        sd_end_m=float(predicted[-1]),
        sd_most_m=float(predicted[worst]),
        sd_most_s=float(run.time_s[worst]),
        separation=None if track.forward is None else _separation(track.forward, track),
    )


def surfacings(track: Track) -> tuple[Surfacing, ...]:
    """Every first fix after an outage, in the order of their times.

    Notes
    -----
    Residual and variance are those of the filter before it took the fix. A rejected fix whose successor is used was an
    outlier and no surfacing: the successor is one. Where the successor is rejected too, the state is in doubt.
    """
    run = track.forward or track
    rows = _heard(run)
    travelled = run.travelled()
    found = []
    for name, i, before_s in _after_outages(run, rows):
        r = run.residuals[name]
        now = float(r.time_s[i])
        begin_m, end_m = np.interp([before_s, now], run.time_s, travelled)
        found.append(
            Surfacing(
                sensor=name,
                time_s=now,
                without_s=now - before_s,
                distance_m=float(end_m - begin_m),
                error_m=float(np.hypot(*r.value[i, :2])),
                sd_m=float(np.hypot(*r.sd[i, :2])),
                inside=bool(r.nis[i] <= chi_square_limit(0.95, max(r.dof[i], 1.0))),
                used=bool(r.used[i]),
                chance=float(gammaincc(0.5 * max(r.dof[i], 1.0), 0.5 * r.nis[i])),
            )
        )
    return tuple(found)


def _heard(run: Track) -> list[tuple[float, str, int]]:
    """Time, sensor and row of every fix that says where the vehicle is, of all sensors together."""
    rows = []
    for name, r in run.residuals.items():
        if name not in run.vehicle.sensors or run.vehicle.sensors[name].gives != "position" or not len(r.time_s):
            continue
        judged = np.flatnonzero(
            (r.used | (r.outcome == OUTCOMES.index("rejected"))) & np.isfinite(r.value[:, :2]).all(axis=1)
        )
        used = r.used[judged]
        outlier = ~used & np.append(used[1:], False)
        rows += [(float(r.time_s[i]), name, int(i)) for i in judged[~outlier]]
    return sorted(rows)


def _least_outage_s(rows: list[tuple[float, str, int]]) -> float:
    steps = np.diff([time_s for time_s, _, _ in rows])
    return max(OUTAGE_S, OUTAGE_STEPS * float(np.median(steps)) if steps.size else 0.0)


def _after_outages(run: Track, rows: list[tuple[float, str, int]]) -> Iterator[tuple[str, int, float]]:
    """Sensor and row of the first fix after each outage, and when the outage began."""
    least_s = _least_outage_s(rows)
    before_s = float(run.time_s[0])
    for time_s, name, i in rows:
        if time_s - before_s > least_s:
            yield name, i, before_s
        before_s = time_s


def _longest_outage(track: Track, found: tuple[Surfacing, ...]) -> Outage | None:
    run = track.forward or track
    rows, predicted = _heard(run), run.horizontal_sd()
    begin_s, end_s = (rows[-1][0] if rows else float(run.time_s[0])), float(run.time_s[-1])
    outages = [Outage(s.time_s - s.without_s, s.time_s, s.error_m, s.sd_m) for s in found]
    if end_s - begin_s > _least_outage_s(rows):
        outages.append(Outage(begin_s, end_s, None, float(predicted[-1])))
    return max(outages, key=lambda o: o.end_s - o.begin_s, default=None)


def _separation(forward: Track, smoothed: Track) -> Separation:
    origin = float(forward.latitude[0]), float(forward.longitude[0])
    if not np.array_equal(forward.time_s, smoothed.time_s):  # of lanes, whose rows stand at times of their own
        smoothed = smoothed.at(forward.time_s)
    apart = np.hypot(*(forward.local(*origin) - smoothed.local(*origin))[:, :2].T)
    after = smoothed.horizontal_sd()
    variance = np.maximum(forward.horizontal_sd() ** 2 - after**2, 0.0)
    worst = int(np.argmax(apart))
    return Separation(
        rms_m=float(np.sqrt(np.mean(apart**2))),
        most_m=float(apart[worst]),
        most_s=float(forward.time_s[worst]),
        sd_most_m=float(after.max()),
        predicted_m=float(np.sqrt(np.mean(variance))),
    )
