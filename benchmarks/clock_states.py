"""Clocks that nobody knows on real recordings, as states: what is found, and what dead reckoning makes of it.

For `recordings.py clocks`. Nothing but the sd of the clock is added to the vehicles of the mapping files; what is
varied is the offset that is described.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace

import car_clocks as car
from harness import MAPPINGS

from navfilter.models.mission import Mission
from navfilter.models.vehicle import Vehicle

#: By how much the DVL of each dive is ahead of the truth, as the README of the recordings has it [s].
SNAPIR = {"01": 1.45, "02": 1.55, "03": 1.5, "05": 0.55, "06": 0.65, "07": 1.5, "08": 1.4, "10": 1.5, "12": 0.6}
#: By how much less, as `navfilter calibrate` finds in the first 100 s of the nine dives [s].
CALIBRATED_S = 0.32
SNAPIR_SD_S, CAR_SD_S = 0.5, 0.3


def auv(trial: str, ahead_s: float, sd_s: float) -> tuple[Mission, Vehicle]:
    """A dive on the DVL's own clock, which is described as so much ahead."""
    folder = MAPPINGS / "snapir-auv-1hz" / trial
    text = re.sub(r"offset_s = [-\d.]+", "offset_s = 0.0", (folder / "mission.toml").read_text())
    mission, vehicle = car.read_text(text, (folder / "vehicle.toml").read_text())
    drive = vehicle.drive
    # what the vehicle is known to be late beside the published shift is part of the mapping, not of what is varied
    velocity = replace(drive.velocity, time_offset_s=-ahead_s, time_offset_sd_s=sd_s)  # type: ignore[attr-defined]
    return replace(mission, name=f"snapir {trial}"), replace(vehicle, drive=replace(drive, velocity=velocity))  # type: ignore[call-arg]


def wheels(trial: str, label: str, sd_s: float) -> tuple[Mission, Vehicle]:
    """A trial of the car with one of the mappings of `car_clocks`, and a clock of both wheels together in doubt."""
    mission, vehicle = car.mappings(trial)[label]
    odometer = replace(vehicle.sensors["odometer"], time_offset_sd_s=sd_s)
    return mission, replace(vehicle, sensors={**vehicle.sensors, "odometer": odometer})


def cases(quick: bool) -> Iterator[tuple[str, str, str, Mission, Vehicle]]:
    """What is compared: vehicle, what is described, name of the clock's state, mission and vehicle."""
    shifts = {
        "as published": SNAPIR,
        "0.3 s more": {trial: shift + 0.3 for trial, shift in SNAPIR.items()},
        "0.3 s less": {trial: shift - 0.3 for trial, shift in SNAPIR.items()},
        "1.5 s for all": dict.fromkeys(SNAPIR, 1.5),
        "calibrated by nine beginnings": {trial: shift - CALIBRATED_S for trial, shift in SNAPIR.items()},
    }
    for label, shift in shifts.items():
        for sd_s in (0.0, SNAPIR_SD_S):
            for trial in list(SNAPIR)[: 1 if quick else None]:
                mission, vehicle = auv(trial, shift[trial], sd_s)
                yield "auv", f"{label}, sd {sd_s:g} s", "velocity.time_offset", mission, vehicle
    for label in ("as mapped (published lags)", "own sensors"):
        for sd_s in (0.0, CAR_SD_S):
            for trial in car.TRIALS[: 1 if quick else None]:
                mission, vehicle = wheels(trial, label, sd_s)
                yield "car", f"{label}, sd {sd_s:g} s", "odometer.time_offset", mission, vehicle
