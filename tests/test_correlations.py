"""Residuals that follow the motion: said with the right cause, and never where nothing is wrong."""

import math
import re

import numpy as np
import pytest

import navfilter as nf
from navfilter.evaluation.assessment import judge
from navfilter.evaluation.correlations import FALSE_ALARMS, correlation, correlation_doubts, correlations
from navfilter.evaluation.diagnostics import evidence
from navfilter.simulation.manoeuvres import ChangeSpeed, FigureEight, Straight, Turn
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import reckoning_vehicle, stage, survey, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate

DEG = math.pi / 180.0
PIECES = (FigureEight(rate_deg_s=8.0), ChangeSpeed(0.6, 4.0), Straight(15.0), ChangeSpeed(1.5, 4.0), Turn(130.0))
WAY = Motion((ChangeSpeed(1.5, 5.0), *PIECES * 2), latitude_deg=50.0, longitude_deg=5.0)
FIXES = nf.Position(rate_hz=1.0, error=nf.White(sd=0.5), lever_arm_b_m=(-0.4, 0.0, -0.2))


def inertial():
    plain = survey_vehicle()
    imu = nf.Imu(rate_hz=20, gyro=plain.drive.gyro, accel=plain.drive.accel)
    return nf.Vehicle(imu, {**{n: s for n, s in plain.sensors.items() if n != "gps"}, "usbl": FIXES})


def reckoning():
    return nf.Vehicle(reckoning_vehicle().drive, {"usbl": FIXES})


def run(vehicle, seed, **faults):
    mission = simulate(vehicle, WAY, seed=seed, faults=faults)
    return nf.replay(vehicle, mission, output_rate_hz=2.0), mission


@pytest.mark.parametrize("vehicle", [inertial(), reckoning()], ids=["imu", "reckoning"])
def test_no_false_word_and_honest_significance_over_50_seeds(vehicle):
    """One false word is allowed in 10 000 missions; what is compared scatters as it should."""
    z, words = [], []
    for seed in range(50):
        track, mission = run(vehicle, seed)
        found = correlations(track, mission)
        z += [one.r * math.sqrt(one.effective) for one in found]
        words += list(correlation_doubts(track, mission))
    assert words == [] and len(z) >= 50 * 3
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.4, np.sqrt(np.mean(np.square(z)))


@pytest.mark.parametrize(
    ("vehicle", "fault", "sensor", "said", "key"),
    [
        (inertial(), {"compass": Faults(time_offset_s=0.3)}, "compass", "turn rate", "time_offset_sd_s"),
        (
            inertial(),
            {"compass": Faults(deviation_rad=(0, 3 * DEG, 0, 0, 0))},
            "compass",
            "heading",
            "deviation_sd_deg",
        ),
        (inertial(), {"usbl": Faults(time_offset_s=0.6)}, "usbl", "along the vehicle", "time_offset_sd_s"),
        (inertial(), {"usbl": Faults(lever_arm_m=(1.0, 0.0, 0.0))}, "usbl", "along the vehicle", "lever_arm_sd_m"),
        (reckoning(), {"usbl": Faults(lever_arm_m=(0.0, 1.0, 0.0))}, "usbl", "across it", "lever_arm_sd_m"),
        (reckoning(), {"velocity": Faults(time_offset_s=1.0)}, "usbl", "acceleration", "[drive.velocity]"),
    ],
)
def test_each_cause_is_said_with_its_key(vehicle, fault, sensor, said, key):
    track, mission = run(vehicle, 1, **fault)
    found = [finding for finding in correlation_doubts(track, mission) if finding.stream == sensor]
    assert any(said in finding.text and key in finding.cure for finding in found), found
    verdict = judge(track, mission, evidence(track))
    assert verdict.trusted and "to be used with care" in verdict.headline
    assert any(said in line for line in verdict.lines()) and any(key in cure for cure in verdict.cures())


@pytest.mark.parametrize(
    ("fault", "said", "size", "key"),
    [
        (Faults(time_offset_s=0.3), "time_offset", 0.3, "time_offset_sd_s"),
        (Faults(lever_arm_m=(0.5, 0.0, 0.0)), "lever_arm_x", 0.5, "lever_arm_sd_m"),
        (Faults(lever_arm_m=(0.0, 0.5, 0.0)), "lever_arm_y", 0.5, "lever_arm_sd_m"),
    ],
)
def test_of_a_velocity_the_cause_is_found_and_said_with_its_size(fault, said, size, key):
    """What has become a state leaves nothing in the innovations."""
    track, mission = run(inertial(), 1, dvl=fault)
    assert track.counts["arm-or-clock"] == 1 and not [one for one in correlation_doubts(track, mission) if one.error]
    verdict = judge(track, mission, evidence(track))
    found = re.search(rf"{said} (\S+) (?:s|m) \(sd", " ".join(verdict.lines()))
    assert found and float(found[1]) == pytest.approx(size, rel=0.1)
    assert verdict.trusted and any(key in cure for cure in verdict.cures())


def test_what_is_described_is_not_said():
    """With the state the residuals no longer follow; it is not even compared."""
    plain = inertial()
    unsure = nf.Vehicle(
        plain.drive,
        {**plain.sensors, "dvl": nf.BodyVelocity(rate_hz=4, error=nf.White(sd=0.01), time_offset_sd_s=0.3,
                                                 lever_arm_b_m=(0.5, 0.0, 0.1), lever_arm_sd_m=(0.3, 0.3, 0.3))},
    )  # fmt: skip
    track, mission = run(unsure, 1, dvl=Faults(time_offset_s=0.3))
    assert not any(one.sensor == "dvl" for one in correlations(track, mission))
    assert [f.text for f in correlation_doubts(track, mission)] == []


def test_the_correlation_of_slow_series_is_worth_less():
    """Independent series of 30 samples' memory: r * sqrt(effective) is standard normal, r * sqrt(n) is far from it."""
    rng, z, naive = np.random.default_rng(1), [], []
    for _ in range(200):
        x, y = (np.convolve(rng.normal(size=2100), 0.967 ** np.arange(300))[300:2100] for _ in range(2))
        r, effective = correlation(x, y)
        z.append(r * math.sqrt(effective))
        naive.append(r * math.sqrt(len(x)))
    # of 200 independent values the rms is within 0.1 of its mean (95 %); a finite sum of lags leaves some 10 % more
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.3 and np.sqrt(np.mean(np.square(naive))) > 3.0


def test_the_manual_states_the_rate():
    from pathlib import Path

    page = (Path(__file__).parent.parent / "docs" / "pages" / "replay.md").read_text(encoding="utf-8")
    assert f"once in {1.0 / FALSE_ALARMS:.0f} missions" in page


@pytest.mark.parametrize("motion", ["lawnmower", "lawnmower/mems"])
def test_a_deviation_of_half_a_degree_is_said(motion):
    """It is gone from the residuals soon after each turn, yet the heading was a degree off and nothing was said."""
    staged = stage(f"compass-deviation/{motion}", imu_rate_hz=50.0)
    prior = staged.vehicle.sensors["compass"].error
    for vehicle in (staged.vehicle, staged.vehicle.with_error(compass=nf.LearnedArma(prior=prior))):
        mission = staged.mission(302)
        words = list(correlation_doubts(nf.replay(vehicle, mission, output_rate_hz=2.0), mission))
        assert [word.stream for word in words] == ["compass"] and "deviates" in words[0].text
        assert "deviation_sd_deg" in words[0].cure


def test_a_pitch_that_the_reading_itself_has_moved_is_no_acceleration():
    """A DVL that errs with the waves and is believed moves the pitch beside a micromechanical unit, and with it what
    gravity is taken off the accelerometer: a correlation of 0.16 to 0.20 with itself, "its clock is off" each time.
    """
    staged = stage("dvl-coloured/mems", duration_s=1200.0, imu_rate_hz=50.0)
    for seed in (401, 402):
        mission = staged.mission(seed)
        track = nf.replay(staged.vehicle, mission, output_rate_hz=2.0)
        (one,) = (one for one in correlations(track, mission) if one.motion == "acceleration")
        assert abs(one.r) < 0.1 and list(correlation_doubts(track, mission)) == []


@pytest.mark.parametrize("error", ["white", "slow-2min", "rolling"])
def test_no_deviation_is_said_of_a_compass_that_errs_otherwise(error):
    staged = stage(f"compass-{error}", imu_rate_hz=50.0)
    for seed in (1, 2):
        mission = staged.mission(seed)
        assert list(correlation_doubts(nf.replay(staged.vehicle, mission, output_rate_hz=2.0), mission)) == []


@pytest.mark.parametrize("by_s", [1.0, -1.0])
def test_a_compass_whose_clock_is_set_on_the_way_is_said(by_s):
    """Over the whole run it is half as much; and what is ahead follows the turn before its stamp."""
    vehicle = inertial()
    mission = simulate(vehicle, survey(500.0), seed=3, duration_s=500.0)
    stream = mission.streams["compass"]
    time_s = stream.time_s + by_s * (stream.time_s > 0.5 * mission.end_s)
    order = np.argsort(time_s, kind="stable")
    kept = order[np.diff(time_s[order], prepend=-1.0) > 0.0]
    late = mission.with_stream("compass", nf.Stream(time_s[kept], stream.value[kept], stream.columns))
    track = nf.replay(vehicle, late, output_rate_hz=2.0)
    (word,) = (one for one in correlation_doubts(track, late) if one.stream == "compass")
    assert "its clock is off" in word.text and ("set on the way" in word.cure) == ("second half" in word.text)
    halves = {one.motion: one.r for one in correlations(track, late) if one.sensor == "compass"}
    motion = "turn rate just before" if by_s > 0.0 else "turn rate"
    assert abs(halves[f"{motion}, in the second half"]) > 0.3 > abs(halves[f"{motion}, in the first half"])
