"""Smoothed more than once: linearised anew around the heading that the smoother found."""

import dataclasses

import numpy as np

from navfilter.calibration.parts import constants_of, described
from navfilter.models.alignment import align
from navfilter.models.mission import Mission
from navfilter.models.start import Start
from navfilter.models.vehicle import Vehicle
from navfilter.playback.replay import replay
from navfilter.track.track import Track


def smoothed(
    vehicle: Vehicle,
    mission: Mission,
    passes: int = 2,
    *,
    start: Start | None = None,
    output_rate_hz: float | None = 5.0,
    progress: bool = False,
) -> Track:
    """A mission smoothed so many times, each time but the first around the heading that the last one found.

    Parameters
    ----------
    vehicle : Vehicle
        Without lanes.
    mission : Mission
    passes : int
    start, output_rate_hz, progress
        As in `navfilter.replay`.

    Raises
    ------
    ValueError
        For no pass, for a vehicle with lanes, and as `navfilter.replay`.

    Notes
    -----
    To the filter a position moves along a straight line when the heading is corrected, in truth along an arc. After a
    way d on a heading that is wrong by a there are d a^2 / 2 missing, which fixes make an error of the scale (iterated
    smoother; Bell, 1994, "The iterated Kalman smoother as a Gauss-Newton method").
    """
    if passes < 1:
        raise ValueError(f"passes must be at least 1, found {passes!r}.")
    if vehicle.lanes():
        raise ValueError("a vehicle with lanes is smoothed once: give it one drive, and no imus, for several passes.")
    start = start or mission.start or align(vehicle, mission)
    how = {"smooth": True, "output_rate_hz": output_rate_hz, "progress": progress}
    track = replay(vehicle, mission, start=start, **how)  # type: ignore[arg-type]
    for _ in range(1, passes):
        vehicle, start = again(vehicle, start, track)
        track = replay(vehicle, mission, start=start, **how)  # type: ignore[arg-type]
    return track


def again(vehicle: Vehicle, start: Start, track: Track) -> tuple[Vehicle, Start]:
    """Vehicle and start for another pass, around what the smoother said of them.

    The start, and the constants of what measures the heading, which would draw it back. What else is constant is linear
    enough. All standard deviations stay, so that the mission is not believed twice: a mean alone moves, which hardly
    counts where the mission tells it.

    Parameters
    ----------
    vehicle : Vehicle
    start : Start
    track : Track
        Smoothed, of a replay with both.
    """
    moved = []
    for one in constants_of(vehicle):
        sensor = vehicle.sensors.get(one.part[-1]) if one.part[0] == "sensors" else None
        if one.part == ("drive", "attitude") or (sensor is not None and sensor.observes.corrects == "heading"):
            value = float(track.state(one.name)[0][-1])
            # a clock goes into its key, and its state begins at zero
            moved.append(one._replace(value=value + (one.value if one.folded else 0.0)))
    latitude, longitude, roll, pitch, heading = np.degrees(
        [track.latitude[0], track.longitude[0], *track.attitude[0]]
    ).tolist()
    begun = dataclasses.replace(
        start,
        time_s=float(track.time_s[0]),
        latitude_deg=latitude,
        longitude_deg=longitude,
        height_m=float(track.height[0]),
        velocity_n=tuple(track.velocity_n[0].tolist()),
        roll_deg=roll,
        pitch_deg=pitch,
        heading_deg=heading,
    )
    return described(vehicle, moved), begun
