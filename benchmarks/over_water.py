"""Hours of sailing on a compass and the speed through the water: how far off is the next fix?

Positions are given for the first half hour, then one fix in 2, 5 or 10 minutes. What is judged is the error at the next
fix just before it is used, against plain dead reckoning and against a plain learner: scale and rotation of the log
fitted to all fixes so far, and the drift of the last interval carried into the next. Recordings: ``yacht-*`` below
NAVFILTER_DATA.
"""

from __future__ import annotations

import datetime
import lzma
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from harness import Array, Options, Table, data_root, flag, main, quick

from navfilter.models.error_models import GaussMarkov, White
from navfilter.models.mechanisation import DeadReckoning
from navfilter.models.mission import Mission, Stream
from navfilter.models.sensors import Heading, Position, WaterVelocity
from navfilter.models.start import Start
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay

KNOT, DEG, EARTH_RADIUS_M = 1852.0 / 3600.0, math.pi / 180.0, 6.371e6
KNOWN_S, EVERY_MIN = 1800.0, (2, 5, 10)
#: Between the fixes that tell which log it is: there are fourteen of them in the first half hour [s].
CHOICE_S = 120.0
#: Errors of a log that may be. The second is fouled: it reads too much or too little for a quarter of an hour.
LOGS = {"rough": GaussMarkov(sd=0.05, tau_s=100.0), "fouled": GaussMarkov(sd=0.3, tau_s=1000.0)}
#: By how much headings and speeds, which are damped, come after the fixes, as the READMEs say [s].
LATE_S = {"flensburg": 2.5, "geneva": 2.5, "20140805": 1.5, "20140820": 1.5}
#: Of the place and year, east positive [deg].
VARIATION_DEG = {"flensburg": 2.7, "geneva": 1.6, "20140805": 1.6, "20140820": 1.6, "auckland": 19.9, "trieste": 3.5}


class Sailed(NamedTuple):
    """A recording: seconds, latitude and longitude [rad], heading [rad, true], speed through the water [m/s]."""

    name: str
    time_s: Array
    place: Array
    heading: Array
    speed: Array


def text_of(path: Path) -> list[str]:
    """Its lines."""
    return lzma.decompress(path.read_bytes()).decode(errors="replace").splitlines()


def nmea(path: Path) -> Iterator[tuple[float, float, float, float, float]]:
    """Time, latitude, longitude, heading, speed; degrees and knots. Sentences that are no ``$II`` are damaged."""
    heading = speed = math.nan
    for line in text_of(path):
        field = line.strip().split("*")[0].split(",")
        try:
            if field[0] == "$IIHDG":
                heading = float(field[1])
            elif field[0] == "$IIVHW":
                speed = float(field[5])
            elif field[0] == "$IIRMC":
                when = datetime.datetime.strptime(field[9] + field[1][:6], "%d%m%y%H%M%S")
                north = (int(field[3][:2]) + float(field[3][2:]) / 60.0) * (1 if field[4] == "N" else -1)
                east = (int(field[5][:3]) + float(field[5][3:]) / 60.0) * (1 if field[6] == "E" else -1)
                yield when.replace(tzinfo=datetime.UTC).timestamp(), north, east, heading, speed
        except (ValueError, IndexError):
            continue


def expedition(path: Path) -> Iterator[tuple[float, float, float, float, float]]:
    """The same of a log of numbered values."""
    names: list[str] = []
    number: dict[str, str] = {}
    last: dict[str, float] = {}
    for line in text_of(path):
        field = line.strip().split(",")
        if line.startswith("!"):
            if not names:
                names = field[1:]
            elif not number:
                number = dict(zip(names, field[1:], strict=False))
            continue
        if not number:
            continue
        values = dict(zip(field[2::2], field[3::2], strict=False))
        for name in ("BSP", "HDG", "Lat", "Lon"):
            if number[name] in values:
                last[name] = float(values[number[name]])
        if len(last) == 4 and number["Lat"] in values:
            yield float(field[1]) * 86400.0, last["Lat"], last["Lon"], last["HDG"], last["BSP"]


def recorded(only: str) -> Iterator[Sailed]:
    """Every yacht; only while she moves."""
    for path in sorted([*data_root().glob("yacht-*/*TXT.xz"), *data_root().glob("yacht-csv-1hz/auckland*")]):
        name = next(key for key in VARIATION_DEG if key in path.name)
        if only not in name:
            continue
        rows = np.array(list(expedition(path) if name == "auckland" else nmea(path)))
        rows = rows[np.isfinite(rows).all(axis=1)]
        rows = rows[np.concatenate([[True], np.diff(np.maximum.accumulate(rows[:, 0])) > 0.0])]
        moving = np.flatnonzero(rows[:, 4] > 1.0)
        rows = rows[moving[0] : moving[-1] + 1]
        t = rows[:, 0] - rows[0, 0]
        heading = np.unwrap((rows[:, 3] + VARIATION_DEG[name]) * DEG)
        late = LATE_S.get(name, 0.0)
        heading, speed = (np.interp(t + late, t, values) for values in (heading, KNOT * rows[:, 4]))
        yield Sailed(name, t, rows[:, 1:3] * DEG, heading, speed)


def vehicle(log: GaussMarkov) -> Vehicle:
    """A current that turns within half an hour, a leeway and a log that are rough, a compass that nobody compensated.

    That compass is as `navfilter calibrate` takes one to be of which nothing is said.
    """
    rough, white = GaussMarkov(sd=0.05, tau_s=100.0), White(sd=1.0)
    water = WaterVelocity(
        error=(log + white, rough + white, White(sd=0.05)),
        zero_is_invalid=False,
        scale_sd=0.1,
        current_sd_m_s=0.3,
        current_tau_s=1800.0,
    )
    compass = Heading(error=White(sd=3.0 * DEG), bias_sd_rad=5.0 * DEG, deviation_sd_rad=(5.0 * DEG, 2.0 * DEG))
    drive = DeadReckoning(rate_hz=1.0, attitude=compass, velocity=water, tilt=White(sd=1.0 * DEG))
    fixes = Position(rate_hz=1.0, error=White(sd=2.5), gate_probability=1.0 - 1e-9)
    return Vehicle(drive, {"gps": fixes}, "yacht")


def described(sailed: Sailed) -> tuple[str, Vehicle]:
    """The log that makes fixes likelier of which one in two minutes is given, of the first half hour alone."""
    first = sailed.time_s <= KNOWN_S
    begun = Sailed(sailed.name, *(values[first] for values in sailed[1:]))
    likely = {}
    for log, error in LOGS.items():
        seen = replay(vehicle(error), mission(begun, CHOICE_S, known_s=0.0)).residuals["gps"]
        gap, sd = seen.value[:, :2], seen.sd[:, :2]
        likely[log] = float(np.sum(-0.5 * (gap / sd) ** 2 - np.log(sd)))
    log = max(likely, key=likely.__getitem__)
    return log, vehicle(LOGS[log])


def mission(sailed: Sailed, every_s: float, known_s: float = KNOWN_S) -> Mission:
    """With all fixes of the first half hour, and one in so many seconds then."""
    t, zero = sailed.time_s, np.zeros(len(sailed.time_s))
    given = t <= known_s
    for time_s in np.arange(known_s + every_s, t[-1], every_s):
        given[np.searchsorted(t, time_s)] = True
    streams = {
        "attitude": Stream(t, np.column_stack([zero, zero, sailed.heading]), ("roll_rad", "pitch_rad", "yaw_rad")),
        "velocity": Stream(t, np.column_stack([sailed.speed, zero, zero]), ("v_x_m_s", "v_y_m_s", "v_z_m_s")),
        "gps": Stream(
            t[given],
            np.column_stack([sailed.place, zero])[given],
            ("latitude_rad", "longitude_rad", "height_m"),
        ),
    }
    ahead = sailed.speed[0] * np.exp(1j * sailed.heading[0])
    start = Start(
        latitude_deg=math.degrees(sailed.place[0, 0]),
        longitude_deg=math.degrees(sailed.place[0, 1]),
        heading_deg=math.degrees(sailed.heading[0]),
        velocity_n=(ahead.real, ahead.imag, 0.0),
        position_sd_m=5.0,
        velocity_sd_m_s=0.5,
        heading_sd_deg=5.0,
    )
    return Mission(sailed.name, streams, None, start)


def legs(sailed: Sailed, every_s: float, *velocities: Array) -> tuple[Any, ...]:
    """What each velocity makes between fixes, the way that was made, and the first leg after the first half hour."""
    t, (lat, lon) = sailed.time_s, sailed.place.T
    place = EARTH_RADIUS_M * (lat + 1j * math.cos(lat[0]) * (lon - lon[0]))
    known = [int(np.searchsorted(t, s)) for s in np.arange(0.0, t[-1], every_s)]
    ways = [np.diff(np.concatenate([[0.0], np.cumsum(v[1:] * np.diff(t))])[known]) for v in velocities]
    return *ways, np.diff(place[known]), int(np.searchsorted(t[known], KNOWN_S - 1.0))


def hindsight(sailed: Sailed, every_s: float) -> Array:
    """Errors at the next fix of what no filter has: a linear prediction that is fitted to all fixes of the recording.

    Scale, also by the speed and as the first cycle of the heading, and heading with two cycles of deviation; and how
    much of the error of the last leg is carried into the next.
    """
    h, v = sailed.heading, sailed.speed * np.exp(1j * sailed.heading)
    of_scale = (1.0, sailed.speed, np.sin(h), np.cos(h))
    of_heading = (1.0, np.sin(h), np.cos(h), np.sin(2.0 * h), np.cos(2.0 * h))
    *ways, made, first = legs(sailed, every_s, *(v * f for f in of_scale), *(1j * v * f for f in of_heading))

    def rest(given: Array, wanted: Array) -> Array:
        """What real factors of the given leave."""
        A, b = np.vstack([given.real, given.imag]), np.concatenate([wanted.real, wanted.imag])
        return wanted - given @ np.linalg.lstsq(A, b, rcond=None)[0]

    error = rest(np.column_stack(ways), made)
    return np.abs(rest(error[first - 1 : -1, None], error[first:]))


def plain(sailed: Sailed, every_s: float) -> tuple[Array, Array]:
    """Errors at the next fix of plain dead reckoning, scale and rotation from all fixes so far, and with the drift of
    the last interval carried on.
    """
    moved, made, first = legs(sailed, every_s, sailed.speed * np.exp(1j * sailed.heading))
    without, with_drift = [], []
    for k in range(first, len(made)):
        turn = np.vdot(moved[:k], made[:k]) / np.vdot(moved[:k], moved[:k])
        error = made - turn * moved
        without.append(abs(error[k]))
        with_drift.append(abs(error[k] - error[k - 1]))
    return np.array(without), np.array(with_drift)


def filtered(track: Any, every_s: float) -> tuple[Array, Array]:
    """Errors at the next fix [m], and whether they lie within the ellipse of 95 %."""
    seen = track.residuals["gps"]
    later = seen.time_s > KNOWN_S + 0.5 * every_s
    gap, sd = seen.value[later, :2], seen.sd[later, :2]
    return np.hypot(*gap.T), np.sum((gap / sd) ** 2, axis=1) < 5.991


def yachts(options: Options) -> list[dict[str, Any]]:
    """Every yacht with a fix in 2, 5 and 10 minutes."""
    table = Table(
        "recording<12 every_min>3.0f fixes>4.0f plain_m>6.1f learner_m>6.1f filter_m>6.1f ratio>5.2f inside>5.1f "
        "hindsight>9.2f log<6"
    )
    for sailed in recorded("20140820" if options.quick else options.only):
        log, described_vehicle = described(sailed)
        for minutes in EVERY_MIN:
            without, learner = plain(sailed, 60.0 * minutes)
            error, inside = filtered(replay(described_vehicle, mission(sailed, 60.0 * minutes)), 60.0 * minutes)
            best = min(np.median(without), np.median(learner))
            table.add(
                {
                    "recording": sailed.name,
                    "every_min": minutes,
                    "fixes": len(error),
                    "plain_m": float(np.median(without)),
                    "learner_m": float(np.median(learner)),
                    "filter_m": float(np.median(error)),
                    "ratio": float(np.median(error) / best),
                    "inside": 100.0 * float(np.mean(inside)),
                    "hindsight": float(np.median(hindsight(sailed, 60.0 * minutes)) / best),
                    "log": log,
                }
            )
    rows = table.rows
    print(
        f"median ratio to the better {np.median([r['ratio'] for r in rows]):.2f}, with hindsight "
        f"{np.median([r['hindsight'] for r in rows]):.2f}; inside the ellipse of 95 %: "
        f"{np.average([r['inside'] for r in rows], weights=[r['fixes'] for r in rows]):.1f} %"
    )
    return rows


if __name__ == "__main__":
    only = flag("--only", default="", help="only recordings whose name contains this")
    main(__doc__, {yachts: [only, quick("the shortest recording")]})
