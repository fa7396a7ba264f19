"""Which part of a mission ``navfilter replay`` runs: ``--from``, ``--to``, ``--start``,
``--withhold`` and ``--during``."""

from __future__ import annotations

import argparse
import dataclasses
import math
import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from navfilter.models.mission import Mission
    from navfilter.models.vehicle import Vehicle
    from navfilter.playback.replay import Withheld

_TIME = r"\+?\d+(?:\.\d*)?(?:e\d+)?"


def with_instructions(options: argparse.Namespace, mission: Mission) -> Mission:
    """The mission with what ``--during`` says beside its own instructions.

    Raises
    ------
    ValueError
        For an instruction that is none.
    """
    from navfilter.models.during import During

    found = list(mission.during)
    for text in options.during:
        sensor, times, what = ([*text.rsplit(":", 2), "", ""])[:3]
        ends = re.fullmatch(rf"({_TIME})?-({_TIME})?", times)
        noise = re.fullmatch(r"noise=(\d+(?:\.\d*)?|\.\d+)", what)
        if not sensor or ends is None or (what != "off" and (noise is None or not float(noise[1]) > 0.0)):
            raise ValueError(
                f"--during: '{text}' is not SENSOR:BEGIN-END:WHAT. Examples: dvl:300-360:off, compass:900-:noise=3."
            )
        begin, end = _clock(ends[1], mission, -math.inf), _clock(ends[2], mission, math.inf)
        factor = 1.0 if noise is None else float(noise[1])
        found.append(During(sensor, begin, end, off=what == "off", noise=factor))
    return dataclasses.replace(mission, during=tuple(found))


def select(options: argparse.Namespace, mission: Mission, vehicle: Vehicle) -> tuple[Mission, tuple[Withheld, ...]]:
    """The mission as the options want it, and what is kept from the filter.

    Parameters
    ----------
    options : Namespace
        With the arguments of `add_arguments`.
    mission : Mission
    vehicle : Vehicle

    Raises
    ------
    ValueError
        For a part of the mission that holds nothing, a start that cannot be, or readings that are not there.
    """
    from navfilter.playback.replay import withhold

    whole = mission
    if options.begin is not None or options.end is not None:
        mission = _between(mission, _clock(options.begin, whole, -math.inf), _clock(options.end, whole, math.inf))
    if options.start is not None:
        mission = mission.with_start(_start(options.start, mission))
    withheld = []
    for text in options.withhold:
        sensor, _, times = text.rpartition(":")
        mission, readings = withhold(mission, vehicle, sensor, _intervals(text, sensor, times, mission, whole))
        withheld.append(readings)
    return mission, tuple(withheld)


def time_of(text: str) -> str:
    """A time as it is written: seconds, or + and seconds from the first reading."""
    if not re.fullmatch(_TIME, text):
        raise argparse.ArgumentTypeError(
            f"must be a time in seconds, or +seconds from the first reading, found '{text}'"
        )
    return text


def _clock(text: str | None, mission: Mission, default: float) -> float:
    """Seconds on the mission clock."""
    if not text:
        return default
    return float(text) + (mission.begin_s if text.startswith("+") else 0.0)


def _between(mission: Mission, begin_s: float, end_s: float) -> Mission:
    if not begin_s < end_s:
        raise ValueError(f"--from must be before --to, found {begin_s:g} and {end_s:g} s.")
    part = mission.between(begin_s, end_s)
    if not any(len(stream) for stream in part.streams.values()):
        raise ValueError(
            f"nothing was recorded from {begin_s:g} to {end_s:g} s: the mission lies from {mission.begin_s:.1f} to "
            f"{mission.end_s:.1f} s. Give other times, or +seconds from its first reading."
        )
    return part


def _start(text: str, mission: Mission) -> Any:
    """The start that is asked for; None: by an alignment."""
    from navfilter.models.start import Start

    if text == "align":
        return None
    known = {field.name: field for field in dataclasses.fields(Start) if field.name not in ("velocity_n", "date")}
    given: dict[str, float] = {}
    for part in text.split(","):
        key, _, value = part.partition("=")
        try:
            given[known[key.strip()].name] = float(value)
        except (KeyError, ValueError):
            raise ValueError(
                f"--start: '{part}' is not KEY=NUMBER with one of {', '.join(known)}. "
                "Example: --start latitude_deg=47.1,longitude_deg=8.2."
            ) from None
    if mission.start is not None:
        return dataclasses.replace(mission.start, **given)
    missing = [key for key in ("latitude_deg", "longitude_deg") if key not in given]
    if missing:
        raise ValueError(f"--start lacks {' and '.join(missing)}, and the mission has no start of its own. Add them.")
    return Start(**{"time_s": mission.begin_s, "date": mission.date, **given})  # type: ignore[arg-type]


def _intervals(text: str, sensor: str, times: str, mission: Mission, whole: Mission) -> list[tuple[float, float]]:
    """The closed intervals that one --withhold names."""
    import numpy as np

    first = re.fullmatch(r"all-but-first-(\d+(?:\.\d*)?)", times)
    if first:
        start_s = -math.inf if mission.start is None else mission.start.time_s
        heard = mission.stream(sensor).time_s
        begin_s = float(heard[min(int(np.searchsorted(heard, start_s)), len(heard) - 1)]) if len(heard) else 0.0
        return [(begin_s + float(first[1]), math.inf)]
    found = []
    for part in times.split(","):
        ends = re.fullmatch(rf"({_TIME})?-({_TIME})?", part)
        if not sensor or ends is None or part == "-":
            raise ValueError(
                f"--withhold: '{text}' is not SENSOR:BEGIN-END in seconds. "
                "Examples: gps:300-900, gps:+600-, gps:all-but-first-120."
            )
        found.append((_clock(ends[1], whole, -math.inf), _clock(ends[2], whole, math.inf)))
    return found
