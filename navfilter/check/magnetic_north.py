"""Where a magnetic heading is hardly one: near a magnetic pole, whose field is vertical."""

import datetime
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from navfilter.check.finding import Finding, Severity
from navfilter.models.magnetic import BLACKOUT_NT, CAUTION_NT, North, believable, north
from navfilter.models.mission import Mission
from navfilter.models.state import wrap
from navfilter.models.vehicle import Vehicle

#: A kilometre on the Earth [deg].
KM_DEG = 0.009


def north_findings(mission: Mission, vehicle: Vehicle | None) -> Iterator[Finding]:
    """That a compass hardly points where the mission is: below the horizontal fields from which on the World Magnetic
    Model itself warns of compasses, and declares them useless.

    Parameters
    ----------
    mission : Mission
        Its first place counts, that of its start, of its fixes or of its truth.
    vehicle : Vehicle, optional
        Says which headings are magnetic; without one those of a field are.
    """
    compasses, place = _compasses(mission, vehicle), place_of(mission)
    dated = mission.date is not None or getattr(mission.start, "date", None) is not None
    for name, sensor in compasses.items():
        if sensor is not None and sensor.declination_rad is None and not (dated and place is not None):
            lacks = " and ".join(["a date"] * (not dated) + ["a place"] * (place is None))
            text = f"its heading counts from magnetic north, and the declination there needs {lacks}."
            cure = "Set date in the mission.toml" if not dated else "Give a [start]"
            yield Finding("error", "north", name, text, f"{cure}, or declination_deg in the vehicle.toml.")
    if not compasses or place is None:
        return
    latitude, longitude = place
    date = believable(mission.date or datetime.date(1970, 1, 1))
    there = north(latitude, longitude, 0.0, date)
    if there.horizontal_nt >= CAUTION_NT:
        return
    up, right = -math.copysign(KM_DEG, latitude), KM_DEG / max(math.cos(math.radians(latitude)), KM_DEG)
    beside = north(latitude + up, longitude, 0.0, date), north(latitude, longitude + right, 0.0, date)
    by_km = math.hypot(*(float(wrap(other.declination - there.declination)) for other in beside))
    for name, sensor in compasses.items():
        yield _finding(name, sensor, there, by_km)


def place_of(mission: Mission) -> tuple[float, float] | None:
    """Latitude and longitude where the mission begins, or of a fix in its middle [deg]."""
    if mission.start is not None:
        return mission.start.latitude_deg, mission.start.longitude_deg
    for stream in (*mission.streams.values(), mission.truth):
        if stream is not None and "latitude_rad" in stream.columns:
            place = np.degrees([stream.column("latitude_rad"), stream.column("longitude_rad")])
            known = place[:, np.isfinite(place).all(axis=0) & place.any(axis=0) & (np.abs(place[0]) <= 90.0)]
            if known.size:
                latitude, longitude = known[:, known.shape[1] // 2].tolist()
                return latitude, longitude
    return None


def _compasses(mission: Mission, vehicle: Vehicle | None) -> dict[str, Any]:
    """What counts from magnetic north, by name; without a vehicle the fields."""
    if vehicle is None:
        return {name: None for name, stream in mission.streams.items() if "field_x_T" in stream.columns}
    found: dict[str, Any] = {**vehicle.sensors} | ({"attitude": vehicle.drive.compass} if vehicle.drive.compass else {})
    return {
        name: sensor
        for name, sensor in found.items()
        if getattr(sensor, "magnetic", False) or getattr(sensor, "magnetometer", False)
    }


def _finding(name: str, sensor: Any, there: North, by_km: float) -> Finding:
    """What it is about; a warning where a compass is of no use, or where the covariance cannot know it."""
    lost, sd_deg = there.horizontal_nt < BLACKOUT_NT, math.degrees(there.sd)
    text = (
        f"the horizontal magnetic field is {there.horizontal_nt:.0f} nT here (dip {math.degrees(there.dip):.1f} deg): "
        f"{'no compass is to be believed' if lost else 'compasses hardly point'}. The declination of a model errs by "
        f"{sd_deg:.2g} deg (sd), and it changes by {math.degrees(by_km):.2g} deg in a kilometre"
    )
    if sensor is None or getattr(sensor, "magnetometer", False):
        text += f", and a tilt of 0.1 deg turns the heading by {0.1 * abs(math.tan(there.dip)):.1f} deg"
    if sensor is not None and sensor.declination_rad is not None and not sensor.declination_sd_rad:
        cure = f"vehicle.toml has a declination as if it were exact: set declination_sd_deg = {sd_deg:.2g} beside it."
        return Finding("warning", "north", name, f"{text}.", cure)
    grave: Severity = "warning" if lost else "info"
    cure = "Take the heading from a gyrocompass or two antennas, or leave it to fixes and velocity." if lost else ""
    return Finding(grave, "north", name, f"{text}.", cure)
