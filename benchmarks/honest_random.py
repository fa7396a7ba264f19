"""How honest the filter is about vehicles that nobody has thought of: sensors, rates, errors, constants and ways drawn.

Every case is a vehicle with a unit and some of compass, magnetometer, AHRS, DVL (axes or beams), log, depth gauge,
fixes, USBL, course and rates at rest, each with an error of one of six kinds, with or without constants as states,
driven somewhere on Earth through one of six motions. It errs as it is described, so that NEES is 1 but for chance:
errors live for minutes, and a single mission of a sound filter has more than 5 once in a hundred. A case beyond that is
simulated again, with `--again` other seeds; what it has in the median of these is no chance. With --learn all errors
that are not white are learnt, from a prior that is wrong by up to two in sd and three in time; its rival is the same
vehicle that is told the truth, for there is no other software in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from harness import DEG, Array, Options, Table, flag, main, quick

import navfilter as nf
from navfilter.simulation import presets
from navfilter.simulation.faults import Faults
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, Straight, Surface, Turn, Wait
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import lawnmower, survey, transit, turns_and_dives
from navfilter.simulation.simulate import StartErrors, simulate

#: Scored from then on [s]; a case is looked at again whose NEES is above this [1].
BEGIN_S, ODD = 30.0, 5.0
WHAT = ("position", "velocity", "attitude", "heading")
Random = np.random.Generator


def steep(seconds: float) -> Motion:
    """Down and up by 35 degrees."""
    cycle = (Dive(40.0, 35.0), Straight(duration_s=10.0), Dive(8.0, 35.0), Turn(120.0))
    begin = (Wait(20.0), ChangeSpeed(1.5, 15.0), Straight(duration_s=45.0))
    return Motion((*begin, *cycle * max(1, int(seconds / 110.0)), Surface(), Straight(duration_s=45.0)))


def boat(seconds: float) -> Motion:
    """At the surface, in turns, now faster and now slower."""
    legs = (Turn(90.0), Straight(duration_s=50.0), Turn(-140.0), Straight(duration_s=40.0))
    cycle = (*legs, ChangeSpeed(2.0, 5.0), Straight(duration_s=20.0), ChangeSpeed(5.0, 10.0))
    begin = (Wait(10.0), ChangeSpeed(4.0, 15.0), Straight(duration_s=60.0))
    return Motion((*begin, *cycle * max(1, int(seconds / 200.0))))


MOTIONS = {
    "lawnmower": lawnmower,
    "transit": transit,
    "dives": turns_and_dives,
    "survey": survey,
    "steep": steep,
    "boat": boat,
}


def between(r: Random, least: float, most: float) -> float:
    """One of all orders of magnitude alike."""
    return float(np.exp(r.uniform(math.log(least), math.log(most))))


def chance(r: Random, share: float) -> bool:
    """True in this share of the draws."""
    return bool(r.random() < share)


def error(r: Random, sd: float) -> nf.ErrorModel:
    """Of about this standard deviation: white, slow, smooth, swinging, or of two times."""
    kind, tau_s = int(r.integers(0, 6)), between(r, 2.0, 300.0)
    if kind == 0:
        return nf.White(sd=sd)
    if kind == 1:
        return nf.GaussMarkov(sd=sd, tau_s=tau_s) + nf.White(sd=sd * between(r, 0.1, 1.0))
    if kind == 2:
        return nf.GaussMarkov(sd=sd, tau_s=tau_s, order=2) + nf.White(sd=sd * between(r, 0.05, 0.5))
    if kind == 3:
        return nf.GaussMarkov(sd=sd, tau_s=tau_s)
    if kind == 4:
        radius, turn = r.uniform(0.7, 0.98), r.uniform(0.1, 2.5)
        swing = nf.Arma(ar=(-2.0 * radius * math.cos(turn), radius**2), sd=sd * (1.0 - radius))
        return swing + nf.White(sd=0.2 * sd)
    slow, quicker = nf.GaussMarkov(sd=0.7 * sd, tau_s=tau_s), nf.GaussMarkov(sd=0.7 * sd, tau_s=0.1 * tau_s)
    return slow + quicker + nf.White(sd=0.1 * sd)


def arm(r: Random) -> tuple[float, float, float]:
    """Up to four metres."""
    x, y, z = (r.uniform(-1.0, 1.0, 3) * between(r, 0.1, 4.0)).tolist()
    return x, y, z


def unknown(r: Random, share: float) -> dict[str, Any]:
    """Clock and lever arm as states, in this share of the draws."""
    clock = {"time_offset_sd_s": between(r, 0.02, 0.4)} if chance(r, share) else {}
    return clock | ({"lever_arm_sd_m": (between(r, 0.05, 0.5),) * 3} if chance(r, 0.7 * share) else {})


def unit(r: Random) -> nf.Imu:
    """Tactical or micromechanical, with or without its own constants as states."""
    drive = presets.mems_imu() if chance(r, 0.5) else presets.tactical_imu()
    drive = replace(drive, rate_hz=float(r.choice([20.0, 50.0, 100.0])))
    if chance(r, 0.2):
        drive = replace(drive, gyro_scale_sd=between(r, 1e-4, 5e-3), accel_scale_sd=between(r, 1e-4, 5e-3))
    if chance(r, 0.15):
        drive = replace(drive, gyro_misalignment_sd_rad=between(r, 1e-4, 5e-3))
        drive = replace(drive, accel_misalignment_sd_rad=between(r, 1e-4, 3e-3))
    return drive


def north(r: Random) -> dict[str, nf.Sensor]:
    """A compass, a magnetometer, an AHRS, or nothing that knows north."""
    kind, rate_hz = r.random(), float(r.choice([0.5, 1.0, 4.0, 8.0, 16.0]))
    if kind < 0.15:
        iron = {"hard_iron_sd": between(r, 0.2, 3.0), "soft_iron_sd": between(r, 0.002, 0.03)} if chance(r, 0.5) else {}
        white = nf.White(sd=between(r, 0.1, 1.0) * DEG)
        return {"compass": nf.Heading(rate_hz=rate_hz, magnetometer=True, error=white, **iron)}
    if kind < 0.55:
        own: dict[str, Any] = {"bias_sd_rad": between(r, 0.3, 4.0) * DEG} if chance(r, 0.3) else {}
        if chance(r, 0.3):
            own["deviation_sd_rad"] = (between(r, 0.3, 5.0) * DEG, between(r, 0.2, 2.0) * DEG)
        return {"compass": nf.Heading(rate_hz=rate_hz, error=error(r, between(r, 0.1, 2.5) * DEG), **own)}
    if kind < 0.75:
        tilt = nf.GaussMarkov(sd=0.3 * DEG, tau_s=20.0)
        off = between(r, 0.2, 2.0) * DEG if chance(r, 0.3) else 0.0
        yaw = error(r, between(r, 0.2, 2.0) * DEG)
        return {"ahrs": nf.Attitude(rate_hz=rate_hz, error=(tilt, tilt, yaw), misalignment_sd_rad=off)}
    return {}


def velocity(r: Random) -> dict[str, nf.Sensor]:
    """A DVL, the beams of one, a log, or nothing."""
    kind, rate_hz = r.random(), float(r.choice([0.5, 1.0, 2.0, 5.0, 8.0]))
    place = {"rate_hz": rate_hz, "error": error(r, between(r, 0.003, 0.05)), "lever_arm_b_m": arm(r)}
    more: dict[str, Any] = {"scale_sd": between(r, 0.001, 0.03)} if chance(r, 0.4) else {}
    more |= unknown(r, 0.25)
    if kind < 0.5:
        angle = between(r, 0.2, 3.0) * DEG if chance(r, 0.4) else 0.0
        return {"dvl": nf.BodyVelocity(misalignment_sd_rad=angle, **place, **more)}
    if kind < 0.65:
        return {"dvl": nf.DvlBeams(**place, **more)}
    if kind < 0.8:
        flows = {"current_sd_m_s": between(r, 0.03, 0.5), "current_tau_s": between(r, 300.0, 20000.0)}
        return {"water": nf.WaterVelocity(**place, **flows)}
    return {}


def place(r: Random) -> dict[str, nf.Sensor]:
    """Fixes, and mostly a depth gauge; now and then USBL, course over ground, and rates at rest."""
    found: dict[str, nf.Sensor] = {}
    if chance(r, 0.7):
        offset = between(r, 0.05, 1.0) if chance(r, 0.3) else 0.0
        found["depth"] = nf.Depth(error=error(r, between(r, 0.02, 0.3)), lever_arm_b_m=arm(r), offset_sd_m=offset)
    rate_hz = float(r.choice([0.2, 1.0, 5.0]))
    fixes = {"rate_hz": rate_hz, "error": error(r, between(r, 0.02, 5.0)), "lever_arm_b_m": arm(r)}
    found["gps"] = nf.Position(**fixes, **unknown(r, 0.15))
    if chance(r, 0.25):
        angles = nf.White(sd=between(r, 0.002, 0.02))
        found["usbl"] = nf.Usbl(rate_hz=0.2, error=(nf.White(sd=between(r, 0.2, 3.0)), angles, angles))
    if chance(r, 0.15):
        found["course"] = nf.Course()
    if chance(r, 0.15):
        found["turning"] = nf.ZeroRate()
    return found


@dataclass(frozen=True)
class Case:
    """A vehicle and its way."""

    vehicle: nf.Vehicle
    motion: str
    way: Motion
    duration_s: float
    fixes: str
    start: StartErrors

    @classmethod
    def drawn(cls, number: int) -> Case:
        """That of a number, always the same."""
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
        faults = {"gps": Faults(available=self.fixes)}
        return simulate(self.vehicle, self.way, seed=seed, duration_s=self.duration_s, start=self.start, faults=faults)

    def learns(self, number: int) -> nf.Vehicle:
        """The vehicle with all errors learnt that are not white, from a prior that is wrong."""
        r, learnt = np.random.default_rng([number, 1]), {}
        for name, sensor in self.vehicle.sensors.items():
            hidden = isinstance(sensor, nf.WaterVelocity)  # by the current
            if isinstance(sensor.error, nf.ErrorModel) and not isinstance(sensor.error, nf.White) and not hidden:
                sd = math.sqrt(sensor.mean_variance(0, 1)) * between(r, 0.5, 2.0)
                slow = nf.GaussMarkov(sd=sd, tau_s=between(r, 10.0, 90.0)) + nf.White(sd=0.3 * sd)
                learnt[name] = nf.LearnedArma(prior=slow)
        return self.vehicle.with_error(**learnt) if learnt else self.vehicle

    @property
    def words(self) -> str:
        """What there is."""
        return f"{' '.join(self.vehicle.sensors)}; {self.motion}, {self.duration_s:.0f} s, fixes {self.fixes}"


def figures(vehicle: nf.Vehicle, mission: nf.Mission) -> Array:
    """NEES of `WHAT`, forward, then smoothed."""
    smoothed, found = nf.replay(vehicle, mission, smooth=True, output_rate_hz=1.0), []
    assert smoothed.forward is not None
    for track in (smoothed.forward, smoothed):
        nees, scored = track.nees(track.errors(mission.truth)), track.time_s > BEGIN_S
        found += [float(np.nanmean(nees[what][scored])) for what in WHAT]
    return np.array(found)


def honest_random(options: Options) -> dict[str, Any]:
    """Draw, simulate, replay, print what is odd."""
    heads = [f"{track}_{what}" for track in ("fwd", "sm") for what in WHAT]
    table = Table("case<6 run<8 " + " ".join(f"{head}>{len(head) + 1}.1f" for head in heads) + " vehicle<60")
    found: list[Array] = []
    for number in range(options.first, options.first + (4 if options.quick else options.cases)):
        case = Case.drawn(number)
        told = figures(case.vehicle, case.mission(10 * number))
        nees = figures(case.learns(number), case.mission(10 * number)) if options.learn else told
        found.append(nees)
        if nees.max() <= ODD:
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
    mean, median = np.mean(found, axis=0), np.median(found, axis=0)
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
        flag("--again", type=int, default=5, help="other missions of an odd one"),
        flag("--learn", action="store_true", help="with errors that are learnt"),
        quick("four of them"),
    ]
    main(__doc__, {honest_random: flags})
