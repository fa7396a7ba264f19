"""Vehicle and mission as instructions for parts of the mission want them: `[[during]]` of a mission.toml."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from navfilter.io.vehicle_toml import changed
from navfilter.models.during import During, alias
from navfilter.models.learned_arma import larger
from navfilter.models.mission import Mission
from navfilter.models.sensors import Sensor
from navfilter.models.vehicle import Vehicle


def instructed(vehicle: Vehicle, mission: Mission) -> tuple[Vehicle, Mission]:
    """Vehicle and mission with what `Mission.during` says put into them.

    A sensor that is described otherwise for a time stands beside itself under another name ("dvl@2"), and has the
    readings of that time. It goes on where it was, see `navfilter.filter.model_change.handover`.

    Parameters
    ----------
    vehicle : Vehicle
    mission : Mission

    Returns
    -------
    vehicle : Vehicle
    mission : Mission
        Without instructions; its notes say what was done.

    Raises
    ------
    ValueError
        For a sensor that there is not, a key that it has not, and of what drives for anything but "off".
    """
    if not mission.during:
        return vehicle, mission
    sensors, streams = dict(vehicle.sensors), dict(mission.streams)
    notes = list(mission.notes)
    for name in dict.fromkeys(one.sensor for one in mission.during):
        own = [one for one in mission.during if one.sensor == name]
        _check(vehicle, mission, name, own)
        stream = streams[name]
        applies = np.array([(stream.time_s >= one.from_s) & (stream.time_s <= one.to_s) for one in own])
        kinds, which = np.unique(applies, axis=1, return_inverse=True)
        count = 1
        for k, kind in enumerate(kinds.T):
            said = [one for one, is_so in zip(own, kind, strict=True) if is_so]
            rows, plain = which.ravel() == k, not said
            if any(one.off for one in said):
                continue
            if plain:
                streams[name] = stream.keep(rows)
                continue
            count += 1
            other = alias(name, count)
            sensors[other], streams[other] = _described(name, sensors[name], said), stream.keep(rows)
        if not (~applies.any(axis=0)).any():
            streams[name] = stream.keep(slice(0, 0))
        notes += [f"during: {one}; {np.count_nonzero(rows)} readings" for one, rows in zip(own, applies, strict=True)]
    silent = [one.sensor for one in mission.during if one.sensor in sensors and not len(streams[one.sensor])]
    sensors = {name: sensor for name, sensor in sensors.items() if name not in silent}
    return dataclasses.replace(vehicle, sensors=sensors), dataclasses.replace(
        mission, streams=streams, notes=tuple(notes), during=()
    )


def _check(vehicle: Vehicle, mission: Mission, name: str, own: Sequence[During]) -> None:
    sensor, drives = vehicle.sensors.get(name), name in vehicle.driving
    if (sensor is None and not drives) or name not in mission.streams:
        have = ", ".join(n for n in mission.streams if n in vehicle.sensors or n in vehicle.driving) or "none"
        raise ValueError(f'[[during]]: "{name}" is no sensor of this vehicle with a stream (these are: {have}).')
    if sensor is None and any(not one.off for one in own):
        raise ValueError(f'[[during]]: of what drives, such as "{name}", only off = true can be said for a time.')


def _described(name: str, sensor: Sensor, said: Sequence[During]) -> Sensor:
    """The sensor as several instructions want it, the later ones last."""
    for one in said:
        sensor = changed(sensor, dict(one.keys), f"[[during]] of {name}")
        if one.noise != 1.0:
            error = sensor.error
            each = error if isinstance(error, tuple) else (error,)
            models = tuple(larger(model, one.noise) for model in each)
            sensor = dataclasses.replace(sensor, error=models if isinstance(error, tuple) else models[0])
    return sensor
