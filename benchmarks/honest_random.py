"""How honest the filter is about vehicles that nobody has thought of: sensors, rates, errors, constants and ways drawn.

Every case is a vehicle with a unit and some of compass, magnetometer, AHRS, DVL (axes or beams), log, depth gauge,
fixes, USBL, course and rates at rest, each with an error of one of six kinds, with or without constants as states,
driven somewhere on Earth through one of six motions. It errs as it is described, so that NEES is 1 but for chance:
errors live for minutes, and a single mission of a sound filter has more than 5 once in a hundred. A case beyond that is
simulated again, with `--again` other seeds; what it has in the median of these is no chance. With --learn all errors
that are not white are learnt, from a prior that is wrong by up to two in sd and three in time; its rival is the same
vehicle that is told the truth, for there is no other software in it. With `--drive dead-reckoning` there is no unit:
DVL, wheels, log or what is known of a glider's velocity drive with a compass, with or without clocks, lever arm, scale,
mounting and deviation as states, beside fixes, USBL, ranges, course, depth and a bottom track now and then. With
`--drive acoustic` a unit is placed by ranges to beacons, known or to be found, or by USBL of any kind, or rolls on
wheels, over an altimeter, and hardly sees fixes. `--drive velocities` has two that read a velocity beside a unit, beams
and one of them lost for good; `norths` two that know north, or an AHRS with its own drifts, mostly beside a receiver's
velocity with clock and arm; `sound` a ship that turns, her heading badly known, or beacons that are to be found,
through water that moves; `reckoned-sound` such sound without a unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from harness import Array, Options, Table, flag, main, quick
from honest_constants import drawn
from pygeomag import GeoMag
from random_acoustics import acoustic
from random_kinds import VELOCITIES, lost, norths, reckoned_sound, sound, velocities
from random_reckoning import reckoning
from random_vehicles import MOTIONS, between, chance, north, place, unit, velocity

import navfilter as nf
from navfilter.kernels import open_loop_residual
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import Faults, StartErrors, simulate

#: Scored from then on [s]; a case is looked at again whose NEES is above this [1].
BEGIN_S, ODD = 30.0, 5.0
#: A horizontal field in which a compass hardly points [nT]; the model's own caution zone ends at 6000.
STEEP_NT = (1000.0, 8000.0)
WHAT = ("position", "velocity", "attitude", "heading")
#: Vehicles with several instruments for one thing, see `random_kinds`.
KINDS = {"velocities": velocities, "norths": norths, "sound": sound, "reckoned-sound": reckoned_sound}
#: A unit is not lost under water beside one of them.
CARRIES = {*VELOCITIES, "dvl2", "beams2", "water2", "wheels2", "usbl", "ranges"}


@dataclass(frozen=True)
class Case:
    """A vehicle and its way."""

    vehicle: nf.Vehicle
    motion: str
    way: Motion
    duration_s: float
    fixes: str
    start: StartErrors
    loses: bool = False

    @classmethod
    def of(cls, number: int, drive: str, magnetometer: str | None = None) -> Case:
        """That of a number, always the same."""
        if magnetometer:
            return cls.with_magnetometer(number, magnetometer == "steep")
        if drive in KINDS:
            return cls.of_a_kind(number, drive)
        return {"imu": cls.drawn, "dead-reckoning": cls.reckoned, "acoustic": cls.placed}[drive](number)

    @classmethod
    def of_a_kind(cls, number: int, kind: str) -> Case:
        """One with several instruments for one thing."""
        r = np.random.default_rng([number, 4])
        vehicle, motion, way, duration_s = KINDS[kind](r)
        carried = isinstance(vehicle.drive, nf.DeadReckoning) or CARRIES & vehicle.sensors.keys()
        surfaced = chance(r, 0.3) or motion == "boat" or not carried
        start = StartErrors(heading_sd_deg=between(r, 0.5, 8.0), tilt_sd_deg=between(r, 0.1, 1.0))
        return cls(vehicle, motion, way, duration_s, "always" if surfaced else "surface", start, kind == "velocities")

    @classmethod
    def reckoned(cls, number: int) -> Case:
        """A vehicle without a unit."""
        r = np.random.default_rng([number, 2])
        vehicle, motion, way, duration_s = reckoning(r)
        fixes = "always" if chance(r, 0.4) or motion == "boat" else "surface"
        start = StartErrors(heading_sd_deg=between(r, 0.5, 8.0), tilt_sd_deg=between(r, 0.1, 1.0))
        return cls(vehicle, motion, way, min(duration_s, way.duration_s), fixes, start)

    @classmethod
    def with_magnetometer(cls, number: int, steep: bool) -> Case:
        """One with a unit and a magnetometer, first of a thousand; if `steep`, where a compass hardly points."""
        number *= 1000
        while not getattr((case := cls.drawn(number)).vehicle.sensors.get("compass"), "magnetometer", False):
            number += 1
        r = np.random.default_rng([number, 3])
        while steep:
            north_deg, east_deg = float(r.uniform(-80.0, 85.0)), float(r.uniform(-180.0, 180.0))
            field = GeoMag(base_year=2025).calculate(north_deg, east_deg, 0.0, 2026.5)
            if STEEP_NT[0] < field.h < STEEP_NT[1]:
                way = replace(case.way, latitude_deg=north_deg, longitude_deg=east_deg)
                return replace(case, way=way)
        return case

    @classmethod
    def placed(cls, number: int) -> Case:
        """A vehicle that is placed by sound."""
        r = np.random.default_rng([number, 3])
        vehicle, motion, way, duration_s = acoustic(r)
        start = StartErrors(heading_sd_deg=between(r, 0.5, 8.0), tilt_sd_deg=between(r, 0.1, 1.0))
        fixes = "always" if motion == "boat" else "surface"
        return cls(vehicle, motion, way, min(duration_s, way.duration_s), fixes, start)

    @classmethod
    def drawn(cls, number: int) -> Case:
        """A vehicle with a unit."""
        r = np.random.default_rng(number)
        drive = unit(r)
        vehicle = nf.Vehicle(drive, north(r) | velocity(r) | place(r))
        motion, duration_s = str(r.choice(list(MOTIONS))), float(r.choice([300.0, 600.0, 900.0, 1500.0]))
        north_deg, east_deg = float(r.uniform(-65.0, 75.0)), float(r.uniform(-180.0, 180.0))
        way = replace(MOTIONS[motion](duration_s), latitude_deg=north_deg, longitude_deg=east_deg)
        # a unit alone is lost under water
        surfaced = chance(r, 0.3) or motion == "boat" or not {"dvl", "water"} & set(vehicle.sensors)
        start = StartErrors(heading_sd_deg=between(r, 0.5, 8.0), tilt_sd_deg=between(r, 0.1, 1.0))
        return cls(vehicle, motion, way, min(duration_s, way.duration_s), "always" if surfaced else "surface", start)

    def mission(self, seed: int) -> nf.Mission:
        """Simulated; it errs as described."""
        faults = {"gps": Faults(available=self.fixes)} if "gps" in self.vehicle.sensors else {}
        if "bottom" in self.vehicle.sensors:  # within reach for the first and the last quarter
            quarter_s = 0.25 * self.duration_s
            faults["bottom"] = Faults(dropouts=((quarter_s, 3.0 * quarter_s),))
        given = {"seed": seed, "duration_s": self.duration_s, "start": self.start, "faults": faults}
        mission = simulate(self.vehicle, self.way, **given)
        return lost(self.vehicle, mission, np.random.default_rng([seed, 5])) if self.loses else mission

    def learns(self, number: int) -> nf.Vehicle:
        """The vehicle with all errors learnt that are not white, from a prior that is wrong."""
        r, learnt = np.random.default_rng([number, 1]), {}
        for name, sensor in self.vehicle.sensors.items():
            # by the current, or never told apart from what the reading depends on
            hidden = isinstance(sensor, nf.WaterVelocity) or sensor.open_loop == open_loop_residual.NOTHING
            if isinstance(sensor.error, nf.ErrorModel) and not isinstance(sensor.error, nf.White) and not hidden:
                sd = math.sqrt(sensor.mean_variance(0, 1)) * between(r, 0.5, 2.0)
                slow = nf.GaussMarkov(sd=sd, tau_s=between(r, 10.0, 90.0)) + nf.White(sd=0.3 * sd)
                learnt[name] = nf.LearnedArma(prior=slow)
        return self.vehicle.with_error(**learnt) if learnt else self.vehicle

    @property
    def words(self) -> str:
        """What there is."""
        drive, way = self.vehicle.drive, f"{self.motion}, {self.duration_s:.0f} s, fixes {self.fixes}"
        own = [drive.velocity_sensor.words, f"{drive.rate_hz:g} Hz"] if isinstance(drive, nf.DeadReckoning) else []
        return f"{' '.join([*own, *self.vehicle.sensors])}; {way}"


def figures(vehicle: nf.Vehicle, mission: nf.Mission) -> Array:
    """NEES of `WHAT`, forward, then smoothed."""
    smoothed, found = nf.replay(vehicle, mission, smooth=True, output_rate_hz=1.0), []
    assert smoothed.forward is not None
    for track in (smoothed.forward, smoothed):
        nees, scored = track.nees(track.errors(mission.truth)), track.time_s > BEGIN_S
        found += [float(np.nanmean(nees[what][scored])) for what in WHAT]
    found.append(constants(smoothed.forward, mission))
    return np.array(found)


def constants(track: nf.Track, mission: nf.Mission) -> float:
    """Mean square error of the constants at the end, in variances; NaN where there are none."""
    square = []
    for name, value in drawn(mission).items():
        if name in track.state_names:
            i = track.state_names.index(name)
            sd = track.states_sd[-1, i]
            square += [((track.states[-1, i] - value) / sd) ** 2] if sd > 0.0 else []  # one of several may be known
    return float(np.mean(square)) if square else math.nan


def honest_random(options: Options) -> dict[str, Any]:
    """Draw, simulate, replay, print what is odd."""
    heads = [*(f"{track}_{what}" for track in ("fwd", "sm") for what in WHAT), "constants"]
    table = Table("case<6 run<8 " + " ".join(f"{head}>{len(head) + 1}.1f" for head in heads) + " vehicle<60")
    found: list[Array] = []
    for number in range(options.first, options.first + (4 if options.quick else options.cases)):
        case = Case.of(number, options.drive, options.magnetometer)
        told = figures(case.vehicle, case.mission(10 * number))
        nees = figures(case.learns(number), case.mission(10 * number)) if options.learn else told
        found.append(nees)
        if nees[:-1].max() <= ODD:
            continue
        seeds, again = range(10 * number + 1, 10 * number + 1 + options.again), []
        for seed in seeds:
            again.append(figures(case.learns(number) if options.learn else case.vehicle, case.mission(seed)))
        rows = {"told": told} if options.learn else {}
        rows |= {"once": nees} | ({"median": np.median(again, axis=0)} if again else {})
        for run, values in rows.items():
            table.add(
                {"case": number, "run": run, "vehicle": case.words} | dict(zip(heads, values.tolist(), strict=True))
            )
    mean, median = np.nanmean(found, axis=0), np.nanmedian(found, axis=0)
    for run, values in (("mean", mean), ("median", median)):
        table.add(
            {"case": "all", "run": run, "vehicle": f"{len(found)} vehicles"}
            | dict(zip(heads, values.tolist(), strict=True))
        )
    return {"odd": table.rows, "nees": {head: [float(one[i]) for one in found] for i, head in enumerate(heads)}}


if __name__ == "__main__":
    flags = [
        flag("--cases", type=int, default=200, help="how many"),
        flag("--first", type=int, default=10_000, help="number of the first"),
        flag("--drive", choices=["imu", "dead-reckoning", "acoustic", *KINDS], default="imu", help="what drives"),
        flag("--magnetometer", choices=["anywhere", "steep"], help="only those with one; steep: near a magnetic pole"),
        flag("--again", type=int, default=5, help="other missions of an odd one"),
        flag("--learn", action="store_true", help="with errors that are learnt"),
        quick("four of them"),
    ]
    main(__doc__, {honest_random: flags})
