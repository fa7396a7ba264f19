"""Scenarios of campaigns: what is true, what is believed, what goes wrong, and where the thesis's coefficients come
from.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from navfilter.models.error_models import per_axis
from navfilter.models.state import wrap
from navfilter.simulation import scenarios as studies
from navfilter.simulation.scenarios import GYROS, MOTIONS, STUDIES, stage
from navfilter.simulation.simulate import Changing

TABLES = {t["name"]: t for t in json.loads((Path(__file__).parent / "appendix_a.json").read_text())["tables"]}
DEG = np.pi / 180.0


def compass_error(staged, mission):
    """Reading minus truth [deg], outliers left out."""
    compass, truth = mission.streams["compass"], mission.truth
    yaw = np.interp(compass.time_s, truth.time_s, np.unwrap(truth.column("yaw_rad")))
    error = np.degrees(wrap(compass.value[:, 0] - yaw))
    return compass.time_s[np.abs(error) < 6.0], error[np.abs(error) < 6.0]


@pytest.mark.parametrize("name", STUDIES)
def test_every_scenario_gives_a_mission_that_its_vehicle_can_read(name):
    staged = stage(name, duration_s=90.0, imu_rate_hz=50.0)
    mission = staged.mission(1)
    assert (
        set(mission.streams) == {"imu", *staged.vehicle.sensors}
        and mission.truth is not None
        and mission.start is not None
    )
    assert staged.study.sensor in {*staged.vehicle.sensors, "gyro"} and staged.learnt in staged.vehicle.sensors
    if not name.startswith(("compass-sd-", "compass-tau-")):
        assert staged.vehicle.sensors["compass"].error == studies.BELIEF
    assert (staged.truth is None) == (staged.study.kind == "changing")


@pytest.mark.parametrize("name", STUDIES)
def test_what_is_believed_is_not_what_is_true(name):
    staged = stage(name)
    sensors = staged.vehicle.sensors
    believed = staged.vehicle.drive.models[:3] if staged.study.sensor == "gyro" else sensors[staged.learnt].models
    true = staged.faults[staged.study.sensor].true_error
    assert isinstance(true, Changing) or tuple(believed) != per_axis(true, len(believed), name)
    assert all(staged.faults[s].true_error is None for s in staged.faults if s != staged.study.sensor)


@pytest.mark.parametrize("gyro", GYROS)
def test_motion_and_gyro_are_parameters_and_the_name_may_carry_them(gyro):
    for motion in MOTIONS:
        staged = stage("compass-gm2", motion=motion, gyro=gyro, duration_s=600.0)
        named = stage(f"compass-gm2/{motion}/{gyro}", duration_s=600.0)
        assert staged.name == named.name and staged.vehicle == named.vehicle and staged.motion == named.motion
        here = staged.motion.at(np.arange(200.0, 450.0))
        turned = np.ptp(np.unwrap(here.attitude[:, 2])) / DEG
        # the wander of a straight course is a few degrees, a lawnmower turns by 180
        assert (turned > 150.0) == (motion == "lawnmower")
    white = staged.vehicle.drive.gyro.parts[0].density / DEG * 60.0
    assert white == pytest.approx(0.3 if gyro == "tactical" else 3.0)


def test_everything_goes_wrong_that_should():
    staged = stage("compass-white", duration_s=1800.0, imu_rate_hz=10.0)
    mission = staged.mission(3)
    dvl, gps, truth = mission.streams["dvl"], mission.streams["gps"], mission.truth
    gaps = np.diff(dvl.time_s)
    # a loss ends between two pings of 0.25 s: the gap is up to two of them longer
    assert np.all(np.abs(np.sort(gaps)[-3:] - [15.0, 30.0, 60.0]) <= 0.5 + 1e-9) and np.sort(gaps)[-4] < 0.3
    depth = -np.interp(gps.time_s, truth.time_s, truth.column("height_m"))
    assert depth.max() < 0.3 and gps.time_s[0] < 1.0 and gps.time_s[-1] > 1790.0 and np.diff(gps.time_s).max() > 1500.0
    yaw = np.interp(mission.streams["compass"].time_s, truth.time_s, np.unwrap(truth.column("yaw_rad")))
    far = np.abs(np.degrees(wrap(mission.streams["compass"].value[:, 0] - yaw))) > 6.0
    # 14 400 readings, one in 500 an outlier, of which 76 % are beyond 6 deg (sd 20 deg): 22 expected
    assert 8 <= far.sum() <= 40


@pytest.mark.parametrize(("name", "sd"), [("compass-white", 0.5), ("compass-rolling", 0.495), ("compass-mixed", 0.63)])
def test_the_compass_errs_as_much_as_its_scenario_says(name, sd):
    staged = stage(name, duration_s=900.0, imu_rate_hz=10.0)
    errors = np.concatenate([compass_error(staged, staged.mission(seed))[1] for seed in (1, 2)])
    # the slow part has a minute of memory: 30 independent values in two missions, 13 % of sd; two of them
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(sd, rel=0.26)


@pytest.mark.parametrize(
    ("name", "before", "after"), [("compass-triples", 0.5, 1.5), ("compass-recoloured", 0.5, 0.583)]
)
def test_changing_noise_changes_after_a_third(name, before, after):
    staged = stage(name, imu_rate_hz=10.0)
    time, error = compass_error(staged, staged.mission(2))
    for rows, sd in ((time < 900.0, before), (time >= 900.0, after)):
        # 15 s of memory: 30 independent values in 900 s
        assert np.sqrt(np.mean(error[rows] ** 2)) == pytest.approx(sd, rel=0.3)


def test_oscillating_errors_are_of_order_four_and_two():
    for name in ("compass-swell", "compass-rolling"):
        block = stage(name).truth["compass"].block(0.125)
        # AR(2) + AR(2): as many states as the ARMA(4,2) that it equals
        assert block.size == 4 and block.r == 0.0


# ------------------------------------------------------------------------------------- the thesis


def test_the_compass_of_case_2_is_printed_and_stable():
    table = TABLES["Lab1 hdg WT"]
    assert list(studies.LAB1_AR) == table["a"] and list(studies.LAB1_MA) == table["b"]
    assert pytest.approx(table["sample_period_s"]) == 1.0 / studies.LAB1_RATE_HZ
    assert (
        abs(np.roots([1.0, *studies.LAB1_AR])).max() < 0.9992 and abs(np.roots([1.0, *studies.LAB1_MA])).max() < 0.9932
    )


def test_the_comb_is_case_4_but_for_its_unit_root():
    table = TABLES["Lab2 hdg AIC"]
    assert list(studies.LAB2_AR) == table["a"] and list(studies.LAB2_MA) == table["b"]
    model = stage("compass-comb").truth["compass"]
    assert model.ma == studies.LAB2_MA
    printed, used = (np.sort_complex(np.roots([1.0, *ar])) for ar in (table["a"], model.ar))
    moved = np.abs(printed - used) > 1e-9
    assert moved.sum() == 1 and abs(printed[moved][0]) > 0.9998
    # a minute at the published rate
    assert used[moved][0].real == pytest.approx(np.exp(-0.11 / 60.0), abs=1e-9)
    lines = np.degrees(np.angle(used[(np.abs(used) > 0.99) & ~moved]))
    assert sorted(np.round(np.abs(lines) / 36.0).astype(int).tolist()) == [2, 2, 3, 3, 4, 4, 5]


def test_the_gps_has_the_first_two_correlations_of_the_printed_tenth_order():
    ten = studies.scaled(tuple(TABLES["GPS lon WT"]["a"]), (), 1.0).block(1.0)
    two = studies.scaled(studies.GPS_AR, (), 1.0).block(1.0)
    for lag in (0, 1, 2):
        values = [float(b.C @ np.linalg.matrix_power(b.Phi, lag) @ b.P0 @ b.C) for b in (ten, two)]
        assert values[0] == pytest.approx(values[1], abs=1e-7)
    assert TABLES["GPS lon WT"]["sample_period_s"] == pytest.approx(1.0 / studies.GPS_RATE_HZ)


def test_the_gyro_is_what_is_left_of_the_roll_rate_without_its_unit_root():
    table = TABLES["Roll AIC"]
    model = stage("gyro-thesis").truth["gyro"][0].parts[1]
    assert (len(model.ar), len(model.ma)) == (2, 2)
    for printed, used in ((table["a"], model.ar), (table["b"], model.ma)):
        pair = [z for z in np.roots([1.0, *printed]) if abs(z.imag) > 1e-6]
        assert np.sort_complex(pair) == pytest.approx(np.sort_complex(np.roots([1.0, *used])), abs=1e-6)
        assert np.abs(np.roots([1.0, *used])).max() < 1.0
    # at low frequencies it is as noisy as the operator believes
    vehicle = stage("gyro-thesis").vehicle
    density = model.sd * (1.0 + sum(model.ma)) / (1.0 + sum(model.ar)) * np.sqrt(vehicle.drive.period_s)
    assert density == pytest.approx(vehicle.drive.gyro.parts[0].density, rel=1e-9)


# ------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("name", "how", "says"),
    [
        ("compass", {}, "no scenario"),
        ("compass-gm2/sideways", {}, "gyro must be"),
        ("compass-gm2", {"motion": "circle"}, "motion must be"),
        ("compass-gm2", {"gyro": "fog"}, "gyro must be"),
        ("compass-gm2", {"duration_s": -1.0}, "must be positive"),
        ("compass-gm2", {"imu_rate_hz": 0.0}, "must be positive"),
    ],
)
def test_wrong_names_are_refused(name, how, says):
    with pytest.raises(ValueError, match=says):
        stage(name, **how)


# ------------------------------------------------------------------------------------- hard ones


@pytest.mark.parametrize("name", [name for name, study in STUDIES.items() if study.kind != "changing"])
def test_the_oracle_is_told_the_truth_and_the_vehicle_is_not(name):
    staged = stage(name)
    assert staged.oracle is not None and staged.oracle != staged.vehicle and staged.changes_s is None
    told, sensor = staged.truth[staged.study.sensor], staged.study.sensor
    if sensor in staged.vehicle.sensors:
        assert staged.oracle.sensors[sensor].error == told
    assert (told == staged.faults[sensor].true_error) == (staged.study.told is None)


@pytest.mark.parametrize("name", ["compass-coarse", "compass-tails"])
def test_what_no_error_model_can_say_is_told_as_white_noise_of_its_size(name):
    staged = stage(name, duration_s=900.0, imu_rate_hz=10.0)
    error = np.concatenate([compass_error(staged, staged.mission(seed))[1] for seed in (1, 2)])
    # differences leave the slow error out: 14 400 of them, and the white part counts twice
    quick, white = np.diff(error), staged.truth["compass"].parts[1].sd / DEG
    # tails of kurtosis 25: 2 % of one sigma; a rounding error changes little while the course is straight
    within = 0.08 if name == "compass-tails" else 0.25
    assert np.std(quick) / np.sqrt(2.0) == pytest.approx(white, rel=within)


def test_a_coarse_compass_reads_whole_degrees():
    readings = np.degrees(
        stage("compass-coarse", duration_s=90.0, imu_rate_hz=10.0).mission(1).streams["compass"].value
    )
    assert np.abs(readings - np.round(readings)).max() < 1e-9


def test_a_deviation_is_in_the_readings_and_in_nobodys_description():
    staged = stage("compass-deviation", duration_s=300.0, imu_rate_hz=10.0)
    assert staged.vehicle.sensors["compass"].deviation_sd_rad != staged.real.sensors["compass"].deviation_sd_rad
    notes = [note for note in staged.mission(1).notes if "deviation" in note]
    assert len(notes) == 1 and notes != [note for note in staged.mission(2).notes if "deviation" in note]


@pytest.mark.parametrize(
    ("name", "sd", "tau"),
    [("over", 3.0, 10.0), ("under", 1.0 / 3.0, 0.1)],
)
def test_wrong_descriptions_are_wrong_by_as_much_as_they_say(name, sd, tau):
    for what, factor in (("sd", sd), ("tau", tau)):
        staged = stage(f"compass-{what}-{name}")
        (slow, white), (true, noise) = (
            m.parts for m in (staged.vehicle.sensors["compass"].error, staged.truth["compass"])
        )
        assert white == noise
        wrong = slow.sd / true.sd if what == "sd" else slow.tau_s / true.tau_s
        right = slow.tau_s == true.tau_s if what == "sd" else slow.sd == true.sd
        assert wrong == pytest.approx(factor) and right


@pytest.mark.parametrize("name", ["compass-5min", "compass-10min"])
def test_a_short_mission_turns_too(name):
    for motion in MOTIONS:
        staged = stage(name, motion=motion)
        assert staged.duration_s in (300.0, 600.0)
        course = np.unwrap(staged.motion.at(np.arange(0.0, staged.duration_s)).attitude[:, 2])
        assert (np.ptp(course) / DEG > 150.0) == (motion == "lawnmower")


def test_fixes_are_there_for_half_of_the_way():
    staged = stage("gps-slow", imu_rate_hz=10.0)
    dive = np.diff(staged.mission(1).streams["gps"].time_s).max()
    assert 600.0 < dive < 900.0


@pytest.mark.parametrize(("name", "when"), [("compass-triples", 900.0), ("compass-recoloured", 900.0)])
def test_a_changing_error_has_a_time_and_no_oracle(name, when):
    staged = stage(name)
    assert staged.changes_s == when and staged.oracle is None
