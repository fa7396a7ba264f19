"""What a vehicle.toml leaves out is said with the key to add, and nothing is said of one that is whole."""

import math
from dataclasses import replace

import numpy as np
import pytest

import navfilter as nf
from navfilter.evaluation.assessment import judge
from navfilter.evaluation.diagnostics import evidence
from navfilter.evaluation.omitted_parameters import left_out, left_out_doubts
from navfilter.simulation.manoeuvres import ChangeSpeed, FigureEight, Straight, Turn
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import reckoning_vehicle, simulate_scenario, survey_vehicle
from navfilter.simulation.simulate import Faults, simulate

DEG = math.pi / 180.0
PIECES = (FigureEight(rate_deg_s=8.0), ChangeSpeed(0.6, 4.0), Straight(15.0), ChangeSpeed(1.5, 4.0), Turn(130.0))
WAY = Motion((ChangeSpeed(1.5, 5.0), *PIECES * 2), latitude_deg=50.0, longitude_deg=5.0)
FIXES = nf.Position(rate_hz=1.0, error=nf.White(sd=0.3), lever_arm_b_m=(-0.4, 0.0, -0.2))


def inertial(**changed):
    plain = survey_vehicle()
    imu = nf.Imu(rate_hz=20, gyro=plain.drive.gyro, accel=plain.drive.accel)
    sensors = {**{n: s for n, s in plain.sensors.items() if n != "gps"}, "usbl": FIXES}
    return nf.Vehicle(imu, {n: replace(s, **changed.get(n, {})) for n, s in sensors.items()})


def mistaken(real, believed, seed=3):
    """A run of a mission that errs as one vehicle says, with another one."""
    mission = simulate(real, WAY, seed=seed)
    return nf.replay(believed, mission, output_rate_hz=2.0), mission


@pytest.mark.parametrize(
    ("sensor", "left", "kind", "key"),
    [
        ("dvl", {"scale_sd": 0.02}, "scale", "scale_sd"),
        ("dvl", {"misalignment_sd_rad": 2.0 * DEG}, "mounting", "misalignment_sd_deg"),
        ("dvl", {"lever_arm_sd_m": (0.5, 0.5, 0.5)}, "lever-arm", "lever_arm_sd_m"),
        ("usbl", {"time_offset_sd_s": 0.6}, "clock", "time_offset_sd_s"),
        ("usbl", {"lever_arm_sd_m": (1.0, 1.0, 1.0)}, "lever-arm", "lever_arm_sd_m"),
        ("compass", {"bias_sd_rad": 2.0 * DEG}, "bias", "bias_sd_deg"),
        ("compass", {"deviation_sd_rad": (3.0 * DEG, DEG)}, "deviation", "deviation_sd_deg"),
        ("depth", {"offset_sd_m": 1.0}, "offset", "offset_sd_m"),
    ],
)
def test_what_is_left_out_is_said_with_its_key(sensor, left, kind, key):
    """Each of these made the track go elsewhere than was predicted; of most of them no residual said so."""
    track, mission = mistaken(inertial(**{sensor: left}), inertial())
    (one, *_) = left_out(track, mission)
    assert (one.part, one.kind) == (("sensors", sensor), kind) or (("sensors", sensor), kind) in one.alike
    verdict = judge(track, mission, evidence(track))
    assert any(key in cure and f"[sensors.{sensor}]" in cure for cure in verdict.cures()), str(verdict)
    assert "Nothing speaks" not in verdict.headline


def test_what_is_found_is_what_it_is():
    track, mission = mistaken(inertial(dvl={"scale_sd": 0.02}), inertial())
    (one,) = left_out(track, mission)
    ((own, unit, value, sd),) = one.found
    (note,) = (note for note in mission.notes if note.startswith("dvl: scale"))
    assert (own, unit) == ("scale", "1") and abs(value - float(note.split()[-1])) < 4.0 * sd
    assert one.moved.most > one.moved.predicted and one.moved.square > 1.0


def test_nothing_is_said_of_a_whole_description():
    """Chance says a word once in some hundred missions."""
    assert [left_out(*mistaken(inertial(), inertial(), seed)) for seed in range(20)] == [()] * 20


@pytest.mark.parametrize("scenario", ["lawnmower", "mems", "reckoning"])
def test_nothing_is_said_of_the_scenarios(scenario):
    for seed in (1, 2):
        vehicle, mission = simulate_scenario(scenario, seed, 400.0)
        assert left_out(nf.replay(vehicle, mission, output_rate_hz=2.0), mission) == ()


@pytest.mark.parametrize("late_s", [1.0, -1.0])
@pytest.mark.parametrize("dive", [5, 12])
def test_the_clock_of_a_dvl_that_nobody_described_is_named_with_its_size(recording, dive, late_s):
    folder = recording(f"snapir-auv-100hz/{dive:02d}")
    vehicle, mission = nf.read_vehicle(folder), nf.read_mission(folder)
    vehicle = vehicle.with_error(dvl=nf.White(sd=0.02))
    dvl = mission.streams["dvl"]
    late = mission.with_stream("dvl", replace(dvl, time_s=dvl.time_s + late_s))
    first = left_out(nf.replay(vehicle, late, output_rate_hz=1.0), late)[0]
    assert (first.part[-1], first.kind) == ("dvl", "clock")
    assert first.found[0][2] == pytest.approx(late_s, abs=0.1)


def test_two_that_are_left_out_are_both_said():
    real = inertial(dvl={"scale_sd": 0.03}, depth={"offset_sd_m": 1.0})
    track, mission = mistaken(real, inertial())
    assert {(one.part[-1], one.kind) for one in left_out(track, mission)} == {("dvl", "scale"), ("depth", "offset")}


def test_noise_that_is_described_wrong_is_no_constant():
    real = inertial(usbl={"error": nf.GaussMarkov(sd=1.2, tau_s=20.0)})
    track, mission = mistaken(real, inertial(usbl={"error": nf.White(sd=0.2)}))
    assert left_out(track, mission) == ()


def test_what_scatters_for_it_is_not_given_another_sd():
    """With the lever arm no sensor scatters by more than described: it is the arm, and not the noise."""
    track, mission = mistaken(inertial(usbl={"lever_arm_sd_m": (1.0, 1.0, 1.0)}), inertial())
    verdict = judge(track, mission, evidence(track))
    assert any("mean NIS is 4.3" in line and "not with that which is left out" in line for line in verdict.lines()), (
        str(verdict)
    )
    assert not any("another sd" in cure for cure in verdict.cures())


def test_a_learning_vehicle_is_held_with_what_it_has_learnt():
    slow = nf.LearnedArma(prior=nf.GaussMarkov(sd=0.6 * DEG, tau_s=30.0))
    track, mission = mistaken(inertial(dvl={"scale_sd": 0.03}), inertial(compass={"error": slow}))
    assert [(one.part[-1], one.kind) for one in left_out(track, mission)] == [("dvl", "scale")]


def test_the_velocity_of_a_drive_is_said_under_its_own_table():
    plain = nf.Vehicle(reckoning_vehicle().drive, {"usbl": FIXES})
    real = replace(plain.drive, velocity=replace(plain.drive.velocity, scale_sd=0.03))
    track, mission = mistaken(nf.Vehicle(real, plain.sensors), plain)
    (finding,) = left_out_doubts(track, mission)
    assert finding.stream == "velocity" and "scale_sd = 0.03 to [drive.velocity] of vehicle.toml" in finding.cure


def test_a_track_that_stays_where_it_was_makes_a_remark():
    """A centimetre of a lever arm is told by good fixes; it is nothing to be careful about."""
    good = {"usbl": {"error": nf.White(sd=0.02)}}
    plain = inertial(**good)
    mission = simulate(plain, WAY, seed=3, faults={"usbl": Faults(lever_arm_m=(0.015, 0.0, 0.0))})
    found = list(left_out_doubts(nf.replay(plain, mission, output_rate_hz=2.0), mission))
    assert all(finding.severity == "info" for finding in found), found


def test_a_run_that_came_to_nothing_is_not_tried():
    track, mission = mistaken(inertial(), inertial())
    lost = replace(track, covariance=np.full_like(track.covariance, np.nan))
    assert left_out(lost, mission) == ()
