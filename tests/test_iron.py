"""Hard and soft iron of a magnetometer, and deviation of a compass, as states: found by turns with an honest sd,
described, heeded at the start.
"""

import dataclasses

import numpy as np
import pytest

import navfilter as nf
from navfilter.calibration.parts import constants_of, opened
from navfilter.check.description import describe_vehicle
from navfilter.io import write_vehicle
from navfilter.io.toml_editing import write_calibrated
from navfilter.models.alignment import align
from navfilter.simulation.manoeuvres import ChangeSpeed, Straight, Turn
from navfilter.simulation.motion import Motion
from navfilter.simulation.scenarios import COMPASS, survey, survey_vehicle, transit
from navfilter.simulation.simulate import StartErrors, simulate

DEG = np.pi / 180.0
#: Microtesla, as the simulator has them.
HARD_UT, SOFT, FIELD_UT = 2.0, 0.03, 47.0


def vehicle(noise_deg=1.0, **changes):
    given = {"hard_iron_sd": HARD_UT, "soft_iron_sd": SOFT} | changes
    compass = nf.Heading(rate_hz=5.0, magnetometer=True, error=nf.White(sd=noise_deg * DEG), **given)
    dvl = nf.BodyVelocity(rate_hz=4.0, error=nf.White(sd=0.01))
    gps = nf.Position(rate_hz=1.0, error=nf.White(sd=1.0))
    return nf.Vehicle(imu=nf.Imu(rate_hz=20.0), sensors={"compass": compass, "dvl": dvl, "gps": gps})


WAY = Motion((ChangeSpeed(1.5, 5.0), *(Straight(15.0), Turn(90.0, 8.0)) * 6), latitude_deg=45.0)
NAMES = [f"compass.hard_iron_{axis}" for axis in "xyz"] + [
    f"compass.soft_iron_{axes}" for axes in ("xx", "zz", "xy", "xz", "yz")
]


def drawn(mission, what):
    note = next(note for note in mission.notes if note.startswith(f"compass: {what} error"))
    return [float(value) for value in note.split("error ")[1].split()]


@pytest.mark.parametrize("noise_deg", [0.2, 1.0])
def test_iron_is_found_by_turns_with_an_honest_sd(noise_deg):
    """20 seeds, prior drawn as it is described: the squared error over the variance is 1 in the mean, where the
    equation leaves out more than the noise, too.
    """
    described, square, gained, heading = vehicle(noise_deg), [], [], []
    for seed in range(20):
        mission = simulate(described, WAY, seed=seed, start=StartErrors(heading_sd_deg=5.0))
        track = nf.replay(described, mission)
        at = [track.state_names.index(name) for name in NAMES]
        error = track.states[-1, at] - np.array(drawn(mission, "hard_iron") + drawn(mission, "soft_iron"))
        square.append((error / track.states_sd[-1, at]) ** 2)
        gained.append(track.states_sd[-1, at] / track.states_sd[0, at])
        heading.append(track.errors(mission.truth).heading[-1] ** 2 / track.covariance[-1, 8, 8])
    # chi-square of 20: 0.37 to 2.0 holds 99 %; of eight, of which those of the vertical are prior still
    assert np.all((np.mean(square, axis=0) > 0.3) & (np.mean(square, axis=0) < 2.2)), np.mean(square, axis=0)
    assert 0.3 < np.mean(heading) < 2.2, np.mean(heading)
    gained = dict(zip(NAMES, np.median(gained, axis=0), strict=True))
    assert gained["compass.soft_iron_xx"] < 0.2 and gained["compass.soft_iron_xy"] < 0.2
    assert gained["compass.hard_iron_x"] < 0.6  # what is left is h against A times the vertical field, as in all below
    assert gained["compass.hard_iron_z"] > 0.5 and gained["compass.soft_iron_zz"] > 0.5


def test_a_slow_error_of_the_compass_is_not_taken_for_iron():
    """Eight dives of a quarter of an hour with a tactical unit. The slope of a reading by the soft iron held the error
    of that reading, which the residual shows as well: soft iron xy was -0.017 in each of them, whatever it really was,
    and believed to 0.0017 (NEES 100; of the smoothed heading 3.3).
    """
    plain = survey_vehicle()
    compass = nf.Heading(rate_hz=8.0, error=COMPASS, magnetometer=True, hard_iron_sd=HARD_UT, soft_iron_sd=0.02)
    described = nf.Vehicle(plain.drive, {**plain.sensors, "compass": compass})
    dives, off, heading = survey(900.0, surface_s=40.0, depth_m=20.0), [], []
    for seed in range(8):
        mission = simulate(described, dives, seed=seed, duration_s=900.0)
        track = nf.replay(described, mission, smooth=True, output_rate_hz=1.0)
        at = [track.state_names.index(name) for name in NAMES]
        error = track.states[-1, at] - np.array(drawn(mission, "hard_iron") + drawn(mission, "soft_iron"))
        off.append(error / track.states_sd[-1, at])
        heading.append(np.nanmean(track.nees(track.errors(mission.truth))["heading"]))
    # chi-square of 8: below 2.75 with 99.5 %; the mean of 8 scatters by 0.35
    assert np.all(np.mean(np.square(off), axis=0) < 2.75), np.mean(np.square(off), axis=0)
    assert np.all(np.abs(np.mean(off, axis=0)) < 1.2), np.mean(off, axis=0)
    assert np.mean(heading) < 2.0, heading


def test_a_deviation_beside_a_micromechanical_unit_is_honest():
    """16 dives of a quarter of an hour. The compass errs slowly and scatters little, so that it seems to be read
    exactly; what an error of the heading does to an error of the deviation is not in the linear equation. Deviations
    were half a degree off, to the same side in every dive, and believed to a quarter (NEES 3 to 6; seeds 701 to 740).
    """
    plain = survey_vehicle(mems=True)
    compass = dataclasses.replace(
        plain.sensors["compass"], bias_sd_rad=2.0 * DEG, deviation_sd_rad=(2.0 * DEG, 1.0 * DEG)
    )
    described = nf.Vehicle(plain.drive, {**plain.sensors, "compass": compass})
    dives, off = survey(900.0, surface_s=40.0, depth_m=20.0), []
    names = [f"compass.{name}" for name in ("one_cycle_sin", "one_cycle_cos", "two_cycle_sin", "two_cycle_cos")]
    for seed in range(16):
        mission = simulate(described, dives, seed=seed, duration_s=900.0)
        track = nf.replay(described, mission, output_rate_hz=1.0)
        at = [track.state_names.index(name) for name in names]
        off.append((track.states[-1, at] - drawn(mission, "deviation")[1:]) / track.states_sd[-1, at])
    # chi-square of 16: below 2.14 with 99.5 %; the mean of 16 scatters by 0.25, and legs of one line show one error
    assert np.all(np.mean(np.square(off), axis=0) < 2.2), np.mean(np.square(off), axis=0)
    assert np.all(np.abs(np.mean(off, axis=0)) < 0.8), np.mean(off, axis=0)


def test_keys_of_a_vehicle_toml_and_what_is_said_of_them(tmp_path):
    text = """
    [drive]
    type = "imu"
    rate_hz = 50
    [sensors.compass]
    type = "heading"
    magnetometer = true
    hard_iron_sd = 5e-6
    soft_iron_sd = 0.05
    """
    (tmp_path / "vehicle.toml").write_text(text)
    read = nf.read_vehicle(tmp_path)
    assert [p.name for p in read.sensors["compass"].parameters()] == [name.split(".")[1] for name in NAMES]
    assert "hard_iron_x" in describe_vehicle(read)
    assert nf.read_vehicle(write_vehicle(read, tmp_path / "again.toml")).sensors == read.sensors
    assert [doubt.field for doubt in nf.Heading(magnetometer=True, soft_iron_sd=5.0).doubts()] == ["soft_iron_sd"]


@pytest.mark.parametrize(
    ("hard", "soft", "deviation", "said"),
    [
        (2.0, 0.0, (0.03, 0.0), ["hard iron is a deviation of one cycle:"]),
        (0.0, 0.02, (0.0, 0.03), ["soft iron is a deviation of two cycles:"]),
        (2.0, 0.02, (0.03, 0.03), ["hard iron", "soft iron"]),
        (2.0, 0.0, (0.0, 0.03), []),
        (0.0, 0.0, (0.03, 0.03), []),
    ],
)
def test_iron_and_deviation_say_the_same_twice(hard, soft, deviation, said):
    """Both as states, a single one of them had a NEES of 20: only their sum is told."""
    compass = nf.Heading(magnetometer=True, hard_iron_sd=hard, soft_iron_sd=soft, deviation_sd_rad=deviation)
    doubts = list(compass.doubts())
    assert len(doubts) == len(said)
    for doubt, words in zip(doubts, said, strict=True):
        assert words in doubt.text and doubt.field == "deviation_sd_rad" and "Leave out" in doubt.cure


@pytest.mark.parametrize("hard", [0.0, HARD_UT])
def test_a_mean_of_magnetometer_readings_knows_of_the_iron(hard):
    described = vehicle(hard_iron_sd=hard, soft_iron_sd=0.0)
    mission = simulate(described, WAY, seed=1, duration_s=20.0)
    readings = mission.streams["compass"].value[:26]  # five seconds
    headings, variance, dip = described.sensors["compass"].headings(readings, np.eye(3), mission.start)
    # 2 uT across a horizontal field of 22 uT are 5 deg
    sd = np.degrees(np.sqrt(variance))
    assert (4.0 < sd < 7.0) if hard else sd < 2.0
    assert abs(np.mean(headings) - mission.truth.value[0, 8]) < 3.0 * np.sqrt(variance)
    # an alignment says ten times less, and 10 deg at most; and what its tilt makes of the field comes to that
    start, by_readings = align(described, mission), 10.0 if hard else 10.0 * np.hypot(sd, 0.5)
    # by its own level, which changes the dip a little
    assert start.heading_sd_deg == pytest.approx(np.hypot(by_readings, dip * start.tilt_sd_deg), rel=0.01)


def test_a_straight_way_tells_no_heading_from_iron():
    """Eight transits of 25 minutes at 69 degrees north, found by random vehicles: what the equation leaves out of iron
    is the same as long as nothing turns. It was believed to be another one every 3 s: heading NEES 3.2, up to 15.
    """
    plain, square = survey_vehicle(), []
    compass = nf.Heading(
        rate_hz=8.0, error=nf.White(sd=0.3 * DEG), magnetometer=True, hard_iron_sd=0.3, soft_iron_sd=0.003
    )
    slow = nf.GaussMarkov(sd=0.02, tau_s=46.0, order=2) + nf.White(sd=0.007)
    dvl = dataclasses.replace(plain.sensors["dvl"], error=slow, rate_hz=1.0, misalignment_sd_rad=2.0 * DEG)
    drive = dataclasses.replace(plain.drive, rate_hz=20.0)
    described = nf.Vehicle(drive, {**plain.sensors, "compass": compass, "dvl": dvl})
    way = dataclasses.replace(transit(1500.0), latitude_deg=69.0)
    for seed in range(8):
        mission = simulate(described, way, seed=seed, duration_s=1500.0, start=StartErrors(heading_sd_deg=7.0))
        track = nf.replay(described, mission, smooth=True, output_rate_hz=1.0)
        square.append([np.mean(t.nees(t.errors(mission.truth))["heading"][60:]) for t in (track.forward, track)])
    # the heading of a straight way is one number a mission: chi-square of eight is below 2.0 in 96 %
    assert np.all(np.mean(square, axis=0) < 2.0), square


def test_calibrate_finds_the_iron_and_writes_it(tmp_path):
    """The vehicle is sure that there is none; a magnetometer has iron instead of the deviation that it makes."""
    sure, mission = vehicle(hard_iron_sd=0.0, soft_iron_sd=0.0), simulate(vehicle(), WAY, seed=3)
    unsure = {one.name for one in constants_of(opened(sure, ["deviation", "iron"], [mission]))}
    assert unsure == {"compass.bias", *NAMES}
    result = nf.calibrate(sure, [mission], kinds=["iron"])
    found, told = {one.name: one for one in result.found}, drawn(mission, "hard_iron") + drawn(mission, "soft_iron")
    assert result.kept and found["compass.soft_iron_xx"].told and found["compass.soft_iron_xy"].told
    for name, true in zip(NAMES, told, strict=True):
        assert abs(found[name].value - true) < 3.0 * found[name].sd, name
    assert found["compass.hard_iron_x"].before_sd == pytest.approx(0.1 * FIELD_UT, rel=0.1)
    write_vehicle(sure, tmp_path / "vehicle.toml")
    write_calibrated(result.vehicle, sure, tmp_path / "found.toml", tmp_path / "vehicle.toml")
    kept, written = result.vehicle.sensors["compass"], nf.read_vehicle(tmp_path / "found.toml").sensors["compass"]
    assert written.hard_iron_sd == pytest.approx(kept.hard_iron_sd) and written.soft_iron_sd == kept.soft_iron_sd
    assert ["compass." + one[0] for one in written.calibrated] == NAMES
    np.testing.assert_allclose([one[1:] for one in written.calibrated], [one[1:] for one in kept.calibrated], atol=1e-6)
