"""What a calibration is worth: it must predict what it has not seen, stretch by stretch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from navfilter.foundation.arguments import within
from navfilter.foundation.arrays import Array
from navfilter.models.mission import Mission
from navfilter.models.vehicle import Vehicle
from navfilter.playback.held_out import Withheld, score
from navfilter.playback.replay import replay
from navfilter.track.track import Track

Interval = tuple[float, float]
#: The stretches of a mission are dealt out to so many parts; each is withheld once.
FOLDS = 4
#: A stretch is so long [s]: with fixes, and without any, when all sensors are withheld.
FIXES_S, ALL_S = 60.0, 30.0
#: At least so many stretches are cut.
LEAST = 2 * FOLDS
#: Fixes farther apart than this lie in different spells [s].
SPELL_S = 10.0
#: What one reading may cost at most: an outlier tells nothing of the constants.
MOST_NIS = 30.0


@dataclass(frozen=True)
class Stretches:
    """What is withheld of a mission, part by part.

    Attributes
    ----------
    sensors : tuple of str
        Whose readings are withheld: those that give fixes, or without fixes all that correct.
    fixes : bool
    parts : tuple of tuples of (float, float)
        Intervals on the mission clock [s] of each part.
    """

    sensors: tuple[str, ...]
    fixes: bool
    parts: tuple[tuple[Interval, ...], ...]

    def without(self, mission: Mission, part: int) -> Mission:
        """The mission without what this part withholds."""
        for name in self.sensors:
            mission = mission.hide(name, *self.parts[part])
        return mission


@dataclass(frozen=True)
class Prediction:
    """How well readings that were withheld are predicted.

    Attributes
    ----------
    count : int
        Readings.
    rms_m : float
        Horizontal error at the fixes; NaN without fixes.
    sd_m : float
        The same as predicted.
    inside : float
        Share of the fixes inside the 95 % ellipse; NaN without fixes.
    cost : float
        Minus the mean log-likelihood of a reading, up to a constant. Of fixes, each as those before it predict it.
    """

    count: int
    rms_m: float
    sd_m: float
    inside: float
    cost: float

    @property
    def loss(self) -> float:
        """What is compared: the cost, or the error at fixes where none was worked out."""
        return self.rms_m if math.isnan(self.cost) else self.cost


def stretches_of(vehicle: Vehicle, mission: Mission) -> Stretches:
    """Cut a mission into stretches, and deal them out; what it begins with is never withheld.

    Raises
    ------
    ValueError
        When it is too short to be cut.
    """
    correcting = [
        name for name, sensor in vehicle.sensors.items() if not sensor.from_drive and len(mission.stream(name))
    ]
    fixes = tuple(name for name in correcting if vehicle.sensors[name].gives == "position")
    names = fixes or tuple(correcting)
    time_s = np.unique(np.concatenate([np.empty(0), *(_valid_times(mission, name) for name in names)]))
    if len(time_s) < 2 * LEAST:
        raise ValueError(
            f'mission "{mission.name}" holds {len(time_s)} readings of {", ".join(names) or "no correcting sensor"}: '
            "too few to calibrate by, and to see what that is worth."
        )
    steps = np.diff(time_s)
    length = min(FIXES_S if fixes else ALL_S, float(steps[steps < SPELL_S].sum()) / LEAST)
    number = np.unique(np.floor((time_s - time_s[0]) / max(length, 1e-3)))[1:]
    begins = time_s[0] + number * length
    parts = tuple(
        tuple((float(begin), float(np.nextafter(begin + length, -math.inf))) for begin in begins[k::FOLDS])
        for k in range(FOLDS)
    )
    return Stretches(names, bool(fixes), parts)


def _valid_times(mission: Mission, name: str) -> Array:
    stream = mission.stream(name)
    return stream.time_s[np.isfinite(stream.value).any(axis=1)]


def predicted(
    vehicle: Vehicle, mission: Mission, stretches: Stretches, part: int, whole: Track | None = None
) -> Prediction | None:
    """How a vehicle predicts what one part withholds; None where nothing of it can be compared.

    Parameters
    ----------
    vehicle : Vehicle
        With constants that were found without this part.
    mission : Mission
    stretches : Stretches
    part : int
    whole : Track, optional
        Of the vehicle by all of the mission; default: it is run.

    Notes
    -----
    Compared is the likelihood of the readings of the part in a run that is given them, each as those before it predict
    it: the product is that of all of them together (prediction error decomposition; Harvey, 1989, sec. 3.4). The error
    at fixes that a run is not given is what their own errors make of it, which last as long as a stretch: constants
    that erred by a third were refused as often as they were kept.
    """
    whole = whole or replay(vehicle, mission, output_rate_hz=1.0)
    of_all = _by_innovations(whole, stretches, part)
    if not stretches.fixes or of_all is None:
        return of_all
    fixes = _at_fixes(replay(vehicle, stretches.without(mission, part)), mission, stretches, part)
    return None if fixes is None else replace(fixes, cost=of_all.cost * of_all.count / fixes.count)


def _at_fixes(track: Track, mission: Mission, stretches: Stretches, part: int) -> Prediction | None:
    found = []
    for name in stretches.sensors:
        stream = mission.stream(name)
        scored = score(track, Withheld(name, stream.keep(within(stream.time_s, stretches.parts[part]))))
        if scored is not None:
            found.append(Prediction(scored.count, scored.rms_m, scored.sd_m, scored.inside, math.nan))
    return together(found)


def _by_innovations(track: Track, stretches: Stretches, part: int) -> Prediction | None:
    cost, count = 0.0, 0
    for name in stretches.sensors:
        r = track.residuals[name]
        rows = within(r.time_s, stretches.parts[part]) & np.isfinite(r.nis) & (r.dof > 0)
        spread = np.log(np.where(np.isfinite(r.sd[rows]), np.maximum(r.sd[rows], 1e-12), 1.0)).sum()
        cost += float(0.5 * np.minimum(r.nis[rows], MOST_NIS).sum() + spread)
        count += int(rows.sum())
    return Prediction(count, math.nan, math.nan, math.nan, cost / count) if count else None


def together(found: Sequence[Prediction]) -> Prediction | None:
    """Several predictions as one."""
    if not found:
        return None
    weight = np.array([one.count for one in found], dtype=float)
    square, sd, inside, cost = (
        float(np.average(values, weights=weight))
        for values in zip(*((one.rms_m**2, one.sd_m**2, one.inside, one.cost) for one in found), strict=True)
    )
    return Prediction(int(weight.sum()), math.sqrt(square), math.sqrt(sd), inside, cost)
