"""Constants of dead reckoning beside what its readings err by: slopes that see these readings steadily."""

import math

import numpy as np
import pytest

import navfilter as nf
from navfilter.kernels import strapdown
from navfilter.simulation.scenarios import survey, turns_and_dives
from navfilter.simulation.simulate import simulate

DEG = math.pi / 180.0
ARM = tuple(f"lever_arm_{axis}" for axis in "xyz")


def scored(vehicle, way, seeds, duration_s, sensor, what, names):
    """Median NEES of position and velocity, and mean squares of the constants' errors in variances, at the end."""
    nees, square = [], []
    for seed in seeds:
        mission = simulate(vehicle, way, seed=seed, duration_s=duration_s)
        track = nf.replay(vehicle, mission, output_rate_hz=1.0)
        of = track.nees(track.errors(mission.truth))
        nees.append([np.nanmean(of[name][track.time_s > 30.0]) for name in ("position", "velocity")])
        note = next(n for n in mission.notes if n.startswith(f"{sensor}: {what} error "))
        places = [track.state_names.index(f"{sensor}.{name}") for name in names]
        off = track.states[-1, places] - np.array(note.split(" error ")[1].split(), dtype=float)
        square.append((off / track.states_sd[-1, places]) ** 2)
    return np.median(nees, axis=0), np.mean(square, axis=0)


def test_slopes_stay_where_a_reading_may_only_err():
    drv = nf.DeadReckoning(rate_hz=4.0, attitude=nf.White(sd=0.01), velocity=nf.White(sd=0.1)).memory(0)
    nav = np.concatenate([[0.7, 0.1, -5.0, 1.0, 0.0, 0.0], np.eye(3).ravel(), [6.37e6, 6.37e6]])
    none, acc, seen = np.zeros((0, 0)), np.vstack([np.eye(9), np.zeros((27, 9))]), []
    for yaw, speed in ((0.0, 1.0), (0.02, 1.2), (-0.02, 0.8), (0.1, 2.0), (0.11, np.nan)):
        sample = np.array([[0.25, 0.0, 0.0, yaw, speed, 0.0, 0.0]])
        strapdown.dead_reckoning_steps(nav, np.zeros(0), drv, sample, none, none, np.zeros((6, 1)), acc)
        seen.append(drv[strapdown.STEADY + 2 : strapdown.STEADY + 4].copy())
    # a fiftieth of what may be an error; all of a turn; nothing of what has not been read
    expected = [[0.0, 1.0], [0.0004, 1.004], [-0.000008, 0.99992], [0.1, 2.0], [0.1002, 2.0]]
    np.testing.assert_allclose(seen, expected, atol=1e-9)


def test_a_heading_that_errs_tells_no_arm():
    """Found by random vehicles: a log that drives, 1.1 m off, beside a DVL of 2 mm/s; both saw the turns that the
    compass made of its errors, and so there was no arm at all: mean squares of 2129, 325 and 1278 variances, NEES of
    the velocity 3.7. 58, 6 and 8 are better, and not right.
    """
    heading = nf.GaussMarkov(sd=0.26 * DEG, tau_s=16.0) + nf.GaussMarkov(sd=0.26 * DEG, tau_s=1.6)
    log = nf.WaterVelocity(
        error=nf.GaussMarkov(sd=0.01, tau_s=30.0) + nf.White(sd=0.005),
        lever_arm_b_m=(-0.9, 0.6, 0.3),
        lever_arm_sd_m=(0.3, 0.3, 0.3),
        current_sd_m_s=0.1,
    )
    drive = nf.DeadReckoning(rate_hz=8.0, attitude=nf.Heading(error=heading), velocity=log, tilt=nf.White(sd=0.1 * DEG))
    bottom = nf.BodyVelocity(rate_hz=1.0, error=nf.White(sd=0.002))
    gps = nf.Position(rate_hz=1.0, error=nf.GaussMarkov(sd=0.8, tau_s=280.0))
    vehicle = nf.Vehicle(drive, {"bottom": bottom, "gps": gps})
    nees, square = scored(vehicle, turns_and_dives(900.0), range(4), 900.0, "velocity", "lever arm", ARM)
    assert np.all(nees < 1.5) and np.all(square < [120.0, 15.0, 20.0]), (nees, square)


def test_an_attitude_that_errs_tells_no_arm_of_fixes():
    """Found by random vehicles: fixes of 3 cm from an antenna that stands 1.7 m off, a tilt that errs by half a degree:
    mean squares of the arm's error 22, 7 and 69 variances, NEES of the position 11; now 2.3, 3.9, 5.2 and 2.4.
    """
    tilt = nf.GaussMarkov(sd=0.5 * DEG, tau_s=40.0) + nf.White(sd=0.3 * DEG)
    heading = nf.Heading(error=nf.GaussMarkov(sd=0.06 * DEG, tau_s=9.0))
    log = nf.WaterVelocity(error=nf.GaussMarkov(sd=0.05, tau_s=100.0), current_sd_m_s=0.27)
    drive = nf.DeadReckoning(rate_hz=8.0, attitude=heading, velocity=log, tilt=tilt)
    error = nf.GaussMarkov(sd=0.026, tau_s=4.6) + nf.White(sd=0.006)
    gps = nf.Position(rate_hz=1.0, error=error, lever_arm_b_m=(1.0, -0.7, 1.2), lever_arm_sd_m=(0.19, 0.19, 0.19))
    vehicle = nf.Vehicle(drive, {"gps": gps})
    nees, square = scored(vehicle, survey(900.0), range(4), 900.0, "gps", "lever arm", ARM)
    assert np.all(nees < 3.5) and np.all(square < 8.0), (nees, square)


@pytest.mark.parametrize("white", [0.0, 0.03])
def test_noise_of_a_velocity_tells_no_scale_of_its_own(white):
    """One for each axis, of which the vertical one sees little else than noise: 63 and 160 variances off, now 4."""
    error = nf.GaussMarkov(sd=0.03, tau_s=20.0) + nf.White(sd=white)
    dvl = nf.BodyVelocity(error=error, scale_sd=(0.03, 0.03, 0.03))
    heading = nf.Heading(error=nf.GaussMarkov(sd=0.3 * DEG, tau_s=30.0))
    drive = nf.DeadReckoning(rate_hz=4.0, attitude=heading, velocity=dvl, tilt=nf.White(sd=0.1 * DEG))
    sensors = {
        "gps": nf.Position(rate_hz=1.0, error=nf.White(sd=0.3)),
        "depth": nf.Depth(rate_hz=1.0, error=nf.White(sd=0.01)),
    }
    names = [f"scale_{axis}" for axis in "xyz"]
    nees, square = scored(
        nf.Vehicle(drive, sensors), turns_and_dives(900.0), range(4), 900.0, "velocity", "scale", names
    )
    assert np.all(nees < 2.0) and np.all(square < 6.0), (nees, square)


def test_what_a_velocity_errs_by_for_seconds_tells_no_clock_of_its_own():
    """On a way of one speed, which shows no clock: 9 variances off, always to the same side."""
    dvl = nf.BodyVelocity(error=nf.GaussMarkov(sd=0.05, tau_s=3.0) + nf.White(sd=0.007), time_offset_sd_s=0.3)
    drive = nf.DeadReckoning(rate_hz=8.0, attitude=nf.White(sd=0.2 * DEG), velocity=dvl)
    vehicle = nf.Vehicle(drive, {"gps": nf.Position(rate_hz=1.0, error=nf.White(sd=0.1)), "depth": nf.Depth()})
    nees, square = scored(vehicle, survey(500.0), range(21, 29), 500.0, "velocity", "time offset", ["time_offset"])
    assert np.all(nees < 2.0) and square[0] < 4.0, (nees, square)


KNOWN = {"one_cycle_sin": -2.0, "one_cycle_cos": 7.0, "two_cycle_sin": 0.0, "two_cycle_cos": 0.0}
DEVIATED = nf.Heading(
    error=nf.White(sd=0.05 * DEG),
    deviation_sd_rad=(5.0 * DEG, 2.0 * DEG),
    calibrated=tuple((waves, degrees * DEG, 0.0) for waves, degrees in KNOWN.items()),
)


def test_a_deviation_is_told_by_the_heading_and_not_by_what_is_read():
    """Found by random vehicles whose deviation was known: the heading was off by a product of deviations, half a degree
    of seven, NEES 22.
    """
    drive = nf.DeadReckoning(rate_hz=2.0, attitude=DEVIATED, velocity=nf.BodyVelocity(error=nf.White(sd=0.02)))
    vehicle = nf.Vehicle(drive, {"gps": nf.Position(error=nf.White(sd=0.5))})
    mission = simulate(vehicle, turns_and_dives(300.0), seed=1, duration_s=300.0)
    track = nf.replay(vehicle, mission, output_rate_hz=1.0)
    assert 0.5 < np.nanmean(track.nees(track.errors(mission.truth))["heading"][30:]) < 1.5


@pytest.mark.parametrize("what", ["one_cycle_cos", "two_cycle_sin", "yaw"])
def test_slopes_by_a_deviation_are_those_of_what_the_heading_does(what):
    """Of the heading by a deviation, and by an error of the reading, which a deviation makes larger or smaller."""
    drive = nf.DeadReckoning(rate_hz=2.0, attitude=DEVIATED, velocity=nf.BodyVelocity(error=nf.White(sd=0.02)))
    names = [p.name for p in drive.parameters()]
    x = np.zeros(len(names))
    x[names.index("yaw.one_cycle_cos")], x[names.index("yaw.two_cycle_cos")] = 7.0 * DEG, 3.0 * DEG

    def heading(x, yaw):
        drv = drive.memory(0)
        drv[strapdown.DEVIATION] = names.index("yaw.one_cycle_sin")
        nav = np.concatenate([[0.7, 0.1, -5.0, 1.0, 0.0, 0.0], np.eye(3).ravel(), [6.37e6, 6.37e6]])
        m, k = 9 + len(x), len(x)
        acc = np.vstack([np.eye(m), np.zeros((3 * m, m))])
        Cr = np.zeros((6, k + 1))
        Cr[2, -1] = 1.0  # white, of one radian: what it does to the heading is in the noise
        sample = np.array([[0.5, 0.0, 0.0, yaw, 1.0, 0.0, 0.0]])
        strapdown.dead_reckoning_steps(nav, x.copy(), drv, sample, np.eye(k), np.zeros((k, k)), Cr, acc)
        return math.atan2(nav[9], nav[6]), acc

    step, yaw = 1e-6, 1.1
    _, acc = heading(x, yaw)
    if what == "yaw":
        slope = (heading(x, yaw + step)[0] - heading(x, yaw - step)[0]) / (2.0 * step)
        assert acc[9 + len(x) + 8, 8] == pytest.approx(slope**2, rel=1e-6) and abs(slope - 1.0) > 0.05
    else:
        at = names.index(f"yaw.{what}")
        less, more = (x + d * (np.arange(len(x)) == at) for d in (-step, step))
        slope = (heading(more, yaw)[0] - heading(less, yaw)[0]) / (2.0 * step)
        assert acc[8, 9 + at] == pytest.approx(slope, rel=1e-6)
