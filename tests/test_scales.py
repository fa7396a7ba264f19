"""Scale and misalignment axis by axis: found with an honest sd, as sensor and as drive; two wheels each for itself."""

import numpy as np
import pytest

import navfilter as nf
from navfilter.check.plausibility import check_vehicle
from navfilter.evaluation.correlations import constants
from navfilter.io import write_vehicle
from navfilter.simulation.manoeuvres import ChangeSpeed, Dive, Straight, Turn
from navfilter.simulation.motion import Motion
from navfilter.simulation.simulate import StartErrors, simulate

DEG = np.pi / 180.0
SEEDS = 20
#: Turns and dives at two speeds; a vehicle that goes ahead tells its forward scale, the other axes only by a little.
LEGS = (Straight(30.0), Turn(90.0, 8.0), Dive(12.0, pitch_deg=15.0), ChangeSpeed(2.5, 5.0), Straight(20.0))
LEGS += (Turn(-120.0, 8.0), Dive(-8.0, pitch_deg=15.0), ChangeSpeed(1.2, 5.0))
WAY = Motion((ChangeSpeed(1.5, 10.0), *LEGS, *LEGS), latitude_deg=45.0, depth_m=5.0)
#: Small enough that products of two of them do not count.
CALIBRATION = {"scale_sd": (0.01, 0.007, 0.015), "misalignment_sd_rad": (0.004, 0.007, 0.01)}
#: Mounted at 45 deg, so that two axes see the speed.
DVL = nf.BodyVelocity(
    rate_hz=4.0,
    error=nf.White(sd=0.01),
    mounting_rad=(0.0, 0.0, np.pi / 4),
    lever_arm_b_m=(0.5, 0.0, 0.1),
    **CALIBRATION,
)
FIXES = {"gps": nf.Position(rate_hz=1.0, error=nf.White(sd=0.3)), "depth": nf.Depth(error=nf.White(sd=0.05))}


def inertial():
    compass = nf.Heading(rate_hz=4.0, error=nf.White(sd=0.5 * DEG))
    return nf.Vehicle(imu=nf.Imu(rate_hz=50.0), sensors={"dvl": DVL, "compass": compass, **FIXES}), "dvl"


def reckoning():
    drive = nf.DeadReckoning(
        rate_hz=4.0, attitude=nf.Heading(error=nf.White(sd=0.3 * DEG)), velocity=DVL, tilt=nf.White(sd=0.1 * DEG)
    )
    return nf.Vehicle(drive, FIXES), "velocity"


def drawn(mission, owner):
    """What the simulator drew: scales, then the misalignment."""
    found = []
    for what in ("scale", "misalignment"):
        note = next(note for note in mission.notes if note.startswith(f"{owner}: {what} error"))
        found += [float(value) for value in note.split("error ")[1].split()]
    return np.array(found)


@pytest.mark.parametrize("build", [inertial, reckoning])
def test_scales_and_misalignment_are_found_with_an_honest_sd(build):
    """Prior drawn as it is described; the squared error over the variance is 1 in the mean."""
    vehicle, owner = build()
    names = [f"{owner}.{what}_{axis}" for what in ("scale", "misalignment") for axis in "xyz"]
    square, gained = [], []
    for seed in range(SEEDS):
        mission = simulate(vehicle, WAY, seed=seed, start=StartErrors(heading_sd_deg=3.0))
        track = nf.replay(vehicle, mission)
        at = [track.state_names.index(name) for name in names]
        sd = track.states_sd[-1, at]
        square.append(((track.states[-1, at] - drawn(mission, owner)) / sd) ** 2)
        gained.append(sd / track.states_sd[0, at])
    assert len(constants(track)) == 6
    # chi-square of 20: 0.37 to 2.0 holds 99 %, one of six states 0.28 to 2.3
    assert np.all((np.mean(square, axis=0) > 0.28) & (np.mean(square, axis=0) < 2.3)), np.mean(square, axis=0)
    # what the speed along one axis looks like across it is told best, the axis that sees speed in dives alone hardly
    gained = np.median(gained, axis=0)
    assert np.all(gained < [0.6, 0.8, 1.0, 0.9, 0.6, 0.6]) and gained[2] > 0.8, gained


def test_two_wheels_have_a_scale_of_their_own():
    """Each is a sensor with a stream of its own; only the first brings the constraints."""
    error = (nf.White(sd=0.05), nf.White(sd=0.02), nf.White(sd=0.02))
    wheels = {
        "left": nf.Odometer(rate_hz=10.0, error=error, lever_arm_b_m=(0.0, -0.8, 0.0), scale_sd=0.03),
        "right": nf.Odometer(
            rate_hz=10.0, error=error, lever_arm_b_m=(0.0, 0.8, 0.0), scale_sd=0.03, constrained=False
        ),
    }
    vehicle = nf.Vehicle(imu=nf.Imu(rate_hz=20.0), sensors={**wheels, "gps": FIXES["gps"]})
    way = Motion((ChangeSpeed(2.0, 5.0), Straight(20.0), Turn(90.0, 10.0), Straight(20.0), Turn(-90.0, 10.0)))
    square = []
    for seed in range(SEEDS):
        mission = simulate(vehicle, way, seed=seed, start=StartErrors())
        track = nf.replay(vehicle, mission)
        for name in wheels:
            value, sd = track.state(f"{name}.scale")
            note = next(note for note in mission.notes if note.startswith(f"{name}: scale error"))
            square.append(((value[-1] - float(note.split("error ")[1])) / sd[-1]) ** 2)
            assert sd[-1] < 0.01
    assert 0.5 < np.mean(square) < 1.7  # chi-square of 40, 99.5 %, but for the pairs


def test_one_number_is_one_scale_and_three_are_three():
    plain, each = nf.BodyVelocity(scale_sd=0.01), nf.BodyVelocity(scale_sd=(0.01, 0.02, 0.0))
    angles = ["misalignment_x", "misalignment_y", "misalignment_z"]
    assert [p.name for p in plain.parameters()] == ["scale", *angles]
    assert [p[:2] for p in each.parameters()][:3] == [("scale_x", 0.01), ("scale_y", 0.02), ("scale_z", 0.0)]
    assert nf.BodyVelocity(scale_sd=(0.0,) * 3).parameters() == ()
    turned = nf.DvlBeams(misalignment_sd_rad=(0.0, 0.0, 0.1), current_sd_m_s=0.3).parameters()
    assert [p.name for p in turned] == ["current_north", "current_east", "scale", *angles] and turned[-1].sd == 0.1


@pytest.mark.parametrize("value", [-0.1, np.nan, (0.1, 0.2), (0.1, 0.2, -0.1)])
@pytest.mark.parametrize("name", ["scale_sd", "misalignment_sd_rad"])
def test_what_is_no_sd_is_refused(name, value):
    with pytest.raises(ValueError, match=f"BodyVelocity.{name} must be a finite number >= 0, or three of them"):
        nf.BodyVelocity(**{name: value})


def test_keys_of_a_vehicle_toml(tmp_path):
    text = """
    [drive]
    type = "imu"
    rate_hz = 100
    [sensors.dvl]
    type = "body-velocity"
    scale_sd = [0.01, 0.02, 0.5]
    misalignment_sd_deg = [1, 2, 30]
    """
    (tmp_path / "vehicle.toml").write_text(text)
    vehicle = nf.read_vehicle(tmp_path)
    assert vehicle.sensors["dvl"].scale_sd == (0.01, 0.02, 0.5)
    np.testing.assert_allclose(vehicle.sensors["dvl"].misalignment_sd_rad, np.radians([1.0, 2.0, 30.0]))
    assert nf.read_vehicle(write_vehicle(vehicle, tmp_path / "again.toml")).sensors == vehicle.sensors
    doubted = {finding.stream for finding in check_vehicle(vehicle) if finding.severity == "warning"}
    assert {"sensors.dvl.scale_sd", "sensors.dvl.misalignment_sd_rad"} <= doubted
    (tmp_path / "vehicle.toml").write_text(text.replace("[0.01, 0.02, 0.5]", "[0.01, 0.02]"))
    with pytest.raises(ValueError, match=r"sensors\.dvl\.scale_sd"):
        nf.read_vehicle(tmp_path)
