"""The verdict on constants: said when one has left what vehicle.toml says, and when a mission does not tell it."""

from dataclasses import replace

import navfilter as nf
from navfilter.evaluation.assessment import assess
from navfilter.evaluation.correlations import constants
from navfilter.io.write import labelled
from navfilter.playback.replay import replay
from navfilter.simulation.manoeuvres import ChangeSpeed, Straight, Turn
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import Faults, simulate

TURNS = (
    ChangeSpeed(1.5, 10.0),
    Straight(20.0),
    Turn(90.0, 8.0),
    ChangeSpeed(2.5, 5.0),
    Straight(20.0),
    Turn(90.0, 8.0),
)


def vehicle(**dvl):
    return nf.Vehicle(
        imu=nf.Imu(rate_hz=50.0),
        sensors={
            "dvl": nf.BodyVelocity(rate_hz=4.0, error=nf.White(sd=0.02), lever_arm_b_m=(0.5, 0.0, 0.1), **dvl),
            "gps": nf.Position(rate_hz=1.0, error=nf.White(sd=0.5)),
        },
    )


def findings(described, mission):
    return assess(labelled(replay(described, mission)), mission).verdict.findings


def test_a_clock_and_an_arm_that_have_left_their_prior_are_named_with_the_key():
    way = Motion(TURNS * 2, latitude_deg=45.0)
    wrong = {"dvl": Faults(time_offset_s=0.3, lever_arm_m=(0.0, 1.0, 0.0))}
    mission = simulate(vehicle(), way, seed=1, faults=wrong)
    doubtful = vehicle(time_offset_sd_s=0.1, lever_arm_sd_m=(0.0, 0.3, 0.0))
    found = {f.text.split(" ")[0]: f for f in findings(doubtful, mission) if f.code == "constant"}
    assert set(found) == {"time_offset", "lever_arm_y"}
    assert all(f.severity == "warning" and f.stream == "dvl" for f in found.values())
    assert "time_offset_s = 0.3" in found["time_offset"].cure and "[sensors.dvl]" in found["time_offset"].cure
    assert (
        "y of lever_arm_b_m to 1" in found["lever_arm_y"].cure
        or "y of lever_arm_b_m to 0.9" in found["lever_arm_y"].cure
    )
    # described so, nothing is said
    right = vehicle(time_offset_s=0.3, time_offset_sd_s=0.1)
    right = replace(
        right, sensors=right.sensors | {"dvl": replace(right.sensors["dvl"], lever_arm_b_m=(0.5, 1.0, 0.1))}
    )
    assert not [f for f in findings(right, mission) if f.code == "constant"]


def test_a_straight_mission_does_not_tell_a_lever_arm():
    way = Motion((ChangeSpeed(1.5, 10.0), Straight(60.0)), latitude_deg=45.0)
    described = vehicle(time_offset_sd_s=0.3, lever_arm_sd_m=(0.2, 0.2, 0.2))
    mission = simulate(described, way, seed=2)
    (remark,) = [f for f in findings(described, mission) if f.code == "untold"]
    assert remark.severity == "info"
    assert "dvl.lever_arm_x (sd 0.2 m)" in remark.text and "time_offset" not in remark.text  # it speeds up


def test_no_constant_no_word():
    mission = simulate(vehicle(), Motion(TURNS, latitude_deg=45.0), seed=3)
    track = replay(vehicle(), mission)
    assert constants(track) == ()
    assert not [f for f in findings(vehicle(), mission) if f.code in ("untold", "constant")]


def test_constants_of_a_drive():
    """The clock of a dead-reckoning velocity that is 0.8 s late against a sd of 0.2 s."""
    drive = nf.DeadReckoning(
        rate_hz=5.0,
        attitude=nf.Heading(error=nf.GaussMarkov(sd=0.002, tau_s=60.0)),
        velocity=nf.BodyVelocity(error=nf.White(sd=0.01), time_offset_sd_s=0.2, lever_arm_b_m=(-2.0, 0.0, 0.0)),
    )
    described = nf.Vehicle(drive, {"gps": nf.Position(rate_hz=1.0, error=nf.White(sd=0.1))})
    right = replace(drive, velocity=replace(drive.velocity, time_offset_sd_s=0.0))
    truth = nf.Vehicle(right, described.sensors)
    way = Motion(TURNS * 3, latitude_deg=45.0)
    mission = simulate(truth, way, seed=1, faults={"velocity": Faults(time_offset_s=0.8)})
    (one,) = [f for f in findings(described, mission) if f.code == "constant"]
    assert one.text.startswith("velocity.time_offset is 0.") and "[drive.velocity]" in one.cure
