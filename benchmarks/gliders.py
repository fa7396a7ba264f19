"""Gliders: an hour under water on compass, pitch and depth, a fix before and after. How far off is the first fix?

A glider has no velocity sensor. Its speed follows from how fast the depth changes at which pitch: the filter is told
that nobody knows the speed along the body, that hardly any is across it, and the depth gauge does the rest. What is
left is the current, as large as the glider's own speed. It is judged by the error at the first fix after each dive,
just before it is used, against plain dead reckoning (speed by the rate of the depth over the tangent of the pitch), and
against a plain learner: the current that the fixes around the dive before showed. Recordings: ``glider-*`` below
NAVFILTER_DATA, tables of Slocum gliders.
"""

from __future__ import annotations

import datetime
import math
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from dead_reckoning import EARTH_RADIUS_M
from harness import DEG, Options, Table, data_root, flag, main, quick

from navfilter.foundation.utc import date_text
from navfilter.io import read_mission
from navfilter.models.error_models import Cycle, ErrorModel, GaussMarkov, White
from navfilter.models.magnetic import declination
from navfilter.models.mechanisation import DeadReckoning
from navfilter.models.mission import Mission, Stream
from navfilter.models.sensors import Depth, Heading, Position, WaterVelocity
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay
from navfilter.track.track import Track

#: Above it waves and wind move the glider, and the pitch says nothing [m].
DIVES_M = 1.5
#: Silence of the fixes that is a dive [s].
DIVE_S = 1200.0
TIDE_S = 44714.0
CURRENTS: dict[str, ErrorModel] = {
    "first order": GaussMarkov(sd=0.2, tau_s=10800.0),
    "second order": GaussMarkov(sd=0.2, tau_s=10800.0, order=2),
    "with a tide": GaussMarkov(sd=0.1, tau_s=86400.0) + Cycle(sd=0.15, period_s=TIDE_S, tau_s=5 * 86400.0),
}
MAPPING = """
zero_s = "first"
[streams.attitude]
{log}
attitude = {{columns = ["m_roll", "m_pitch", "m_heading"], unit = "rad"}}
where = {{column = "m_heading", known = true}}
[streams.velocity]
{log}
velocity = {{columns = [{{column = "log_time", scale = 0.0}}, {{constant = 0.0}}, {{constant = 0.0}}]}}
[streams.depth]
{log}
depth = "m_depth"
where = {{column = "m_depth", known = true}}
[streams.gps]
{log}
position = {{columns = ["m_gps_lat", "m_gps_lon"], unit = "deg"}}
where = {{column = "m_gps_lat", known = true}}
only_changes = true
"""


class Dive(NamedTuple):
    """From the last fix before it to the first after it.

    Attributes
    ----------
    begin_s, end_s : float
    made, own : complex
        Between the fixes, and by compass, pitch and depth alone: north + i east [m].
    """

    begin_s: float
    end_s: float
    made: complex
    own: complex


def recorded(only: str) -> Iterator[Mission]:
    """Every glider, with no velocity where it is at the surface, and fixes only from there."""
    for folder in sorted(data_root().glob("glider-*")):
        if only not in folder.name:
            continue
        log = f'file = "{folder}/*.dat*"\ntopic = "glider"\ntime = {{column = "log_time"}}'
        with tempfile.TemporaryDirectory() as place:
            (Path(place) / "mission.toml").write_text(MAPPING.format(log=log))
            mission = read_mission(place)
        streams, depth = dict(mission.streams), mission.streams["depth"]
        t = streams["velocity"].time_s
        dives = np.interp(t, depth.time_s, depth.value[:, 0]) > DIVES_M
        streams["velocity"] = replace(streams["velocity"], value=np.where(dives[:, None], np.zeros(3), np.nan))
        # a heading once a minute is enough at the surface: the last one holds to the end
        attitude = streams["attitude"]
        streams["attitude"] = Stream(
            np.append(attitude.time_s, t[-1]), np.vstack([attitude.value, attitude.value[-1:]]), attitude.columns
        )
        gps = streams["gps"]
        above = np.interp(gps.time_s, depth.time_s, depth.value[:, 0]) < DIVES_M
        streams["gps"] = Stream(gps.time_s[above], gps.value[above], gps.columns)
        day = date_text(mission.begin_s, mission.epoch_utc_s)[:10]  # type: ignore[index]
        yield replace(mission, name=folder.name, streams=streams, date=datetime.date.fromisoformat(day))


def vehicle(current: ErrorModel) -> Vehicle:
    """One description for all gliders.

    The speed along the body may be 0.3 m/s and another one after two minutes; across it there is only the angle of
    attack, some degrees of the speed.
    """
    along, across = GaussMarkov(sd=0.3, tau_s=120.0), GaussMarkov(sd=0.02, tau_s=120.0)
    water = WaterVelocity(error=(along, across, across), zero_is_invalid=False, current=current)
    compass = Heading(error=White(sd=2.0 * DEG), bias_sd_rad=3.0 * DEG, magnetic=True)
    drive = DeadReckoning(
        rate_hz=1.12,
        attitude=compass,
        velocity=water,
        tilt=GaussMarkov(sd=1.0 * DEG, tau_s=600.0),
        hold_density=0.02,
    )
    depth = Depth(rate_hz=0.21, error=White(sd=0.1))
    fixes = Position(rate_hz=0.2, error=White(sd=5.0), gate_probability=1.0 - 1e-12)
    return Vehicle(drive, {"depth": depth, "gps": fixes}, "glider")


def dives_of(mission: Mission) -> list[Dive]:
    """Every dive, by plain dead reckoning."""
    depth, gps, attitude = (mission.streams[name] for name in ("depth", "gps", "attitude"))
    t = np.arange(mission.begin_s, mission.end_s, 1.0)
    near = np.interp(t, depth.time_s, depth.value[:, 0])
    smooth = np.convolve(np.pad(near, 10, mode="edge"), np.ones(21) / 21.0, "valid")
    pitch, heading = (np.interp(t, attitude.time_s, np.unwrap(attitude.value[:, k])) for k in (1, 2))
    lat, lon = np.degrees(gps.value[0, :2])
    heading = heading + declination(float(lat), float(lon), 0.0, mission.date)
    steep = (np.abs(pitch) > 11.0 * DEG) & (smooth > 1.0)
    speed = np.where(steep, np.abs(np.gradient(smooth)) / np.maximum(np.tan(np.abs(pitch)), 0.1), 0.0)
    way = np.cumsum(speed * np.exp(1j * heading))
    north = EARTH_RADIUS_M * (gps.value[:, 0] - gps.value[0, 0])
    east = EARTH_RADIUS_M * math.cos(gps.value[0, 0]) * (gps.value[:, 1] - gps.value[0, 1])
    place, fixed = north + 1j * east, gps.time_s
    own = np.interp(fixed, t, way.real) + 1j * np.interp(fixed, t, way.imag)
    return [
        Dive(fixed[k], fixed[k + 1], place[k + 1] - place[k], own[k + 1] - own[k])
        for k in np.flatnonzero(np.diff(fixed) > DIVE_S)
    ]


def at_the_first_fix(track: Track, dive: Dive) -> tuple[float, float, float]:
    """Error just before the fix after a dive [m], its predicted sd [m], and NEES per axis."""
    seen = track.residuals["gps"]
    row = int(np.argmin(np.abs(seen.time_s - dive.end_s)))
    gap, sd = seen.value[row, :2], seen.sd[row, :2]
    return float(np.hypot(*gap)), float(np.hypot(*sd)), float(np.mean((gap / sd) ** 2))


def gliders(options: Options) -> list[dict[str, Any]]:
    """Every dive of every glider with three descriptions of the current."""
    columns = "current<13 recording<20 dive_min>8.0f made_m>6.0f plain_m>7.0f learner_m>9.0f filter_m>8.0f sd_m>5.0f"
    table = Table(f"{columns} nees>5.2f")
    for mission in recorded(options.only):
        dives = dives_of(mission)
        for label, current in list(CURRENTS.items())[-1 if options.quick else 0 :]:
            track = replay(vehicle(current), mission)
            before: complex | None = None
            for dive in dives:
                span = dive.end_s - dive.begin_s
                error, sd, nees = at_the_first_fix(track, dive)
                row = {"current": label, "recording": mission.name, "dive_min": span / 60.0, "made_m": abs(dive.made)}
                row |= {"plain_m": abs(dive.made - dive.own), "filter_m": error, "sd_m": sd, "nees": nees}
                if before is not None:
                    row["learner_m"] = abs(dive.made - dive.own - before * span)
                table.add(row)
                before = (dive.made - dive.own) / span
    for label in dict.fromkeys(row["current"] for row in table.rows):
        rows = [row for row in table.rows if row["current"] == label and "learner_m" in row]
        found = {key: np.median([row[key] for row in rows]) for key in ("plain_m", "learner_m", "filter_m")}
        medians = ", ".join(f"{key} {value:.0f}" for key, value in found.items())
        ratio = found["filter_m"] / min(found["plain_m"], found["learner_m"])
        inside = 100.0 * np.mean([2.0 * row["nees"] < 5.991 for row in rows])
        print(f"{label}: medians after the first dive {medians}; {ratio:.2f} of the better; {inside:.0f} % inside")
    return table.rows


if __name__ == "__main__":
    only = flag("--only", default="", help="only recordings whose name contains this")
    main(__doc__, {gliders: [only, quick("only the current with a tide")]})
