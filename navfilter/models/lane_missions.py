"""What one lane of a vehicle reads of a mission, and a run as if one of the inertial units were the only one."""

from collections.abc import Sequence

import numpy as np

from navfilter.models.lane_clock import UPRIGHT, coasting_times, level_times
from navfilter.models.mission import Mission, Stream
from navfilter.models.start import Start
from navfilter.models.vehicle import DEAD_RECKONING, LEVEL, Vehicle


def lane_mission(vehicle: Vehicle, mission: Mission, name: str, start: Start | None = None) -> Mission:
    """A mission as one lane reads it: its unit as "imu"; without a unit, a clock, and that the vehicle is level.

    Raises
    ------
    ValueError
        When the unit has no stream.
    """
    if name == DEAD_RECKONING:
        assert start is not None
        times = coasting_times(start, vehicle.lanes()[name].drive.rate_hz, 1, mission.end_s)
        level = level_times(start, 1, mission.end_s)
        mission = mission.with_stream("imu", Stream(times, np.zeros((len(times), 6))))
        return mission.with_stream(LEVEL, Stream(level, np.tile(UPRIGHT, (len(level), 1))))
    if name not in mission.streams:
        have = ", ".join(mission.streams) or "none"
        raise ValueError(
            f'"{name}" has no stream in this mission (streams: {have}); it is an inertial unit of the vehicle. Add '
            f"[streams.{name}] to the mission.toml, or take [imus.{name}] out of the vehicle.toml."
        )
    return mission.with_stream("imu", mission.streams[name])


def of_one_unit(vehicle: Vehicle, mission: Mission, unit: str) -> tuple[Vehicle, Mission]:
    """A vehicle with lanes and its mission as if it had one inertial unit, and no lane beside it; any other vehicle
    and its mission as they are.

    Raises
    ------
    ValueError
        For a unit that the vehicle does not have, or without a stream.
    """
    if unit not in vehicle.units:
        raise ValueError(f'"{unit}" is no inertial unit of this vehicle (units: {", ".join(vehicle.units)}).')
    lanes = vehicle.lanes()
    return (lanes[unit], lane_mission(vehicle, mission, unit)) if lanes else (vehicle, mission)


def last_unit(vehicle: Vehicle, lanes: Sequence[tuple[float, str]]) -> str:
    """The inertial unit that was in force last: the one that the smoothed track follows.

    Parameters
    ----------
    vehicle : Vehicle
    lanes : sequence of (float, str)
        Of `navfilter.Track.lanes`.
    """
    units = vehicle.units
    return next((name for _, name in reversed(lanes) if name in units), next(iter(units)))
