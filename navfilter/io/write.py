"""The files of a run: the track in the formats of `navfilter.io.tracks`, truth.tum, summary.json, and
vehicle_learned.toml where it learnt.
"""

import json
import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from navfilter.foundation import utc
from navfilter.foundation.atomic_files import replacing
from navfilter.foundation.quoting import json_value
from navfilter.io.toml_editing import write_learned
from navfilter.io.tracks.formats import FORMATS, write_track
from navfilter.io.tracks.tum import write_truth
from navfilter.models.during import is_alias
from navfilter.models.fault_bias import unfaulted
from navfilter.models.learned_arma import learned_part
from navfilter.models.mission import Mission
from navfilter.models.vehicle import DEAD_RECKONING, Vehicle
from navfilter.track.track import Track, Tracks, integrity_figures

#: Version of the layout of summary.json: it rises where a key changes its meaning or goes, not where one is new.
SCHEMA = 1
#: Where ``summary.schema.json`` stands.
ROOM = Path(__file__).parent


def labelled(track: Track) -> dict[str, Track]:
    """The runs inside a track by label: ``{"forward": ..}``, or ``{"forward": .., "smoothed": ..}``."""
    runs = {} if track.forward is None else {track.forward.label: track.forward}
    return {**runs, track.label: track}


def write_outputs(
    tracks: Tracks,
    mission: Mission,
    folder: str | os.PathLike[str],
    more: Mapping[str, Any] | None = None,
    vehicle_file: str | os.PathLike[str] | None = None,
    remarks: Mapping[str, str] | None = None,
    formats: Collection[str] = (),
) -> list[Path]:
    """Write every data file of a run; the last track is the result, the others only appear in the summary.

    Parameters
    ----------
    tracks : dict of str to Track
        By label, see `labelled`.
    mission : Mission
        Whose replay they are.
    folder : path-like
        Made when missing; files of the same name are replaced.
    more : dict, optional
        Further entries of ``summary.json``.
    vehicle_file, remarks : optional
        For `navfilter.io.toml_editing.write_learned`: the file that the vehicle was read from, and comments.
    formats : collection of str
        Further formats of the track, by their names in `navfilter.io.tracks.formats.FORMATS`, such as "kml".

    Returns
    -------
    list of Path
        The files written.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    result = list(tracks.values())[-1]
    written = [
        write_track(result, folder / f"track{form.suffix}", mission)
        for form in FORMATS
        if form.always or form.name in formats
    ]
    if mission.truth is not None and write_truth(result, folder / "truth.tum", mission.truth):
        written.append(folder / "truth.tum")
    written.append(write_summary(tracks, mission, folder / "summary.json", more))
    if (learnt := learned_vehicle(result)) is not None:
        written.append(write_learned(learnt, folder / "vehicle_learned.toml", vehicle_file, remarks))
    return written


def learned_vehicle(track: Track) -> Vehicle | None:
    """The vehicle of a run with the error models that were in force at its end: the next dive can begin with them.

    Parameters
    ----------
    track : Track

    Returns
    -------
    Vehicle or None
        None where no model has been learnt.
    """
    last: dict[str, Any] = {}
    for name, history in track.error_models.items():
        error = history[-1][1] if history else None
        models = unfaulted(error if isinstance(error, tuple) else (error,)) if error is not None else ()
        if any(learned is not None and learned.model is not None for learned in map(learned_part, models)):
            # what was learnt of gyros and accelerometers is of the unit in force alone
            unit = track.lanes[-1][1] if name not in track.vehicle.sensors and track.lanes else ""
            key = f"{unit}.{name}" if unit in track.vehicle.imus else name
            if unit != DEAD_RECKONING:
                last[key] = models[0] if len(models) == 1 else models
    last = {name: models for name, models in last.items() if not is_alias(name)}
    known = track.vehicle.without(*(name for name in track.vehicle.sensors if is_alias(name)))
    return known.with_error(**last) if last else None


def summarise(tracks: Tracks, mission: Mission) -> dict[str, Any]:
    """What `write_summary` writes: figures of every run by label; None where there is no truth.

    Parameters
    ----------
    tracks : dict of str to Track
    mission : Mission
        Its truth and its windows are what is scored.

    Returns
    -------
    dict
        "mission", "vehicle", "begin_utc" (None where UTC is unknown), "duration_s", "distance_m" (of the last track),
        "runs".
    """
    result = list(tracks.values())[-1]
    runs = {
        label: track.summary(mission.truth, mission.windows)
        | {"integrity": integrity_figures(track, mission.truth)}
        | _lanes(track)
        for label, track in tracks.items()
    }
    summary = {
        "mission": mission.name,
        "vehicle": result.vehicle.name,
        "begin_utc": utc.date_text(result.time_s[0], result.epoch_utc_s),
        "duration_s": float(result.time_s[-1] - result.time_s[0]),
        "distance_m": result.distance_m,
        "runs": runs,
    }
    return json_value(summary)


def _lanes(track: Track) -> dict[str, Any]:
    """Which lane was in force from when on and why, and how each did, in the mean over the run."""
    history = track.lane_history
    if history is None:
        return {}
    changes = zip(track.lanes, ("", *history.reasons), strict=True)
    known = [np.isfinite(values) for values in (history.gain, history.nis)]
    means = [
        np.where(some.any(axis=0), np.nansum(values, axis=0) / np.maximum(some.sum(axis=0), 1), np.nan).tolist()
        for values, some in zip((history.gain, history.nis), known, strict=True)
    ]
    each = {name: {"gain": gain, "nis": nis} for name, gain, nis in zip(history.names, *means, strict=True)}
    in_force = [{"from_s": from_s, "lane": name, "reason": reason} for (from_s, name), reason in changes]
    return {"lanes": {"in_force": in_force, "each": each}}


def write_summary(
    tracks: Tracks, mission: Mission, path: str | os.PathLike[str], more: Mapping[str, Any] | None = None
) -> Path:
    """Write `summarise`, and `more` behind it, as JSON with keys in a fixed order; what is not a finite number becomes
    null. Its first key says by which version of ``summary.schema.json`` of this folder it is laid out.
    """
    return write_json({"schema": SCHEMA, **summarise(tracks, mission), **(more or {})}, path)


def write_json(value: Any, path: str | os.PathLike[str]) -> Path:
    """Write plain values as JSON; what is not a finite number becomes null."""
    return write_text(json.dumps(json_value(value), indent=2, allow_nan=False, ensure_ascii=False) + "\n", path)


def write_text(text: str, path: str | os.PathLike[str]) -> Path:
    """Write text to a file that is there whole or not at all."""
    with replacing(path) as file:
        file.write(text)
    return Path(path)
